# SPDX-License-Identifier: Apache-2.0
"""The judge: what a plan is, and what was done, by the reference oracle and the author's label.

Nothing here asks the gate. What judge and gate have in common is listed in
docs/spec/measures.md#judge. Source: `alg:missionpair`, `eq:plan-deviation`, `eq:scmh`
"""

from missionpair.judging.check import Checked, check, check_first
from missionpair.judging.forgiving import is_intended
from missionpair.judging.reference import plain, plain_facts
from missionpair.judging.walk import NONE, JudgedEffect, Walk, proved

__all__ = [
    "NONE",
    "Checked",
    "JudgedEffect",
    "Walk",
    "check",
    "check_first",
    "is_intended",
    "plain",
    "plain_facts",
    "proved",
]
