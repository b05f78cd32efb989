# SPDX-License-Identifier: Apache-2.0
"""What campaigns came to, as tables and plots: one HTML page, CSV, LaTeX, JSON, text.

`report` makes it from measures; the writers say how it looks. `compare` sets two campaigns side by
side. Everything is rebuilt from logs. How-to: docs/howto/missionpair-report.md
"""

from missionpair.report.collected import CampaignReport, report
from missionpair.report.mutation import MutantReport, Mutation, mutation_table, read_mutation
from missionpair.report.page import page
from missionpair.report.sheets import payload, sheets
from missionpair.report.tex import tex_files
from missionpair.report.words import lines

__all__ = [
    "CampaignReport",
    "MutantReport",
    "Mutation",
    "lines",
    "mutation_table",
    "page",
    "payload",
    "read_mutation",
    "report",
    "sheets",
    "tex_files",
]
