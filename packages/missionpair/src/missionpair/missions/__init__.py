# SPDX-License-Identifier: Apache-2.0
"""Missions as people mean them, and the drafts that they become; shared by all domains.

Spec page: docs/spec/missionpair.md#missions
"""

from missionpair.missions.amend import added, amended, raised, superseding
from missionpair.missions.build import Errand, built
from missionpair.missions.draw import drawn
from missionpair.missions.job import Job, JobStep, Style, Task

__all__ = [
    "Errand",
    "Job",
    "JobStep",
    "Style",
    "Task",
    "added",
    "amended",
    "built",
    "drawn",
    "raised",
    "superseding",
]
