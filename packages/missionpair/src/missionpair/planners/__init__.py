# SPDX-License-Identifier: Apache-2.0
"""The targets of an attack: one file each, found by the file's name.

A planner is shown a briefing and answers with bytes. Most are untrusted on purpose: a live model, a
recorded one, or a stand-in with published behavior, which says so wherever its results appear.
How-to: docs/howto/missionpair-attackers.md, docs/howto/missionpair-models.md
"""

from __future__ import annotations

from typing import cast

from missionpair import registry
from missionpair.briefing import Planner


def names() -> tuple[str, ...]:
    """Return what there is, by name."""
    from missionpair import planners

    return registry.names(planners)


def make(spec: str) -> Planner:
    """Return the planner that a specification names: `hijacked`, `graded:susceptibility=0.4`.

    Raises:
        UnknownNameError: no such planner, or no such option of it; says which there are.
        ValueError: an option has a value that it cannot have.
        PlannerError: a key, a package or a file is missing.
    """
    from missionpair import planners

    return cast("Planner", registry.make(planners, spec))
