# SPDX-License-Identifier: Apache-2.0
"""Grants of a draft, one function for one kind of action."""

from __future__ import annotations

from typing import Any

from missionpair.layouts import Ground
from missionpair.missions.amend import Draft
from missionpair.missions.job import Style

#: How old a reading and the attested place may be, in milliseconds.
AGE_MS = 1_500
#: Longest lease of anything that is no way, in milliseconds.
STILL_MS = 20_000
Rows = list[dict[str, Any]]
#: Types that use the budget of motion.
_DRIVEN = frozenset({"navigate", "survey"})


def guard(variable: str, **compared: Any) -> dict[str, Any]:
    """Return a condition on attested state: `guard("battery_permille", ge=200)`."""
    return {"variable": variable, **compared, "max_age": AGE_MS}


def granted(
    ground: Ground,
    style: Style,
    role: str,
    name: str,
    *,
    rows: Rows,
    limits: dict[str, tuple[int, int]],
    **more: Any,
) -> Draft:
    """Return a grant with everything that the language wants said.

    Args:
        ground: gives type and tool of the role.
        style: how strictly it is held.
        role: what is granted.
        name: the grant's id.
        rows: alternatives.
        limits: bounds of its parameters, in the site's unit.
        more: fields that differ from the usual ones.
    """
    tool = ground.words.tools[role]
    plain: Draft = {
        "id": name,
        "type": tool.type,
        "tool": tool.tool,
        "rows": rows,
        "limits": {key: list(bounds) for key, bounds in sorted(limits.items())},
        "chooser": style.chooser,
        "repeat": 1,
        "starts": 1 + style.spare,
        "max": STILL_MS,
        "irreversible": False,
    }
    return {**plain, **{key: value for key, value in more.items() if value}}


def way_rows(
    ground: Ground, style: Style, source: str, ends: tuple[str, ...], via: tuple[str, ...] = ()
) -> Rows:
    """Return the rows of a way: one for each end, and perhaps one from the corridor."""
    rows = [_way_row(ground, source, end, via) for end in ends]
    lane = ground.lane
    if style.sources > 1 and lane not in {source, *ends} and lane in ground.way(source, ends[0]):
        rows += [_way_row(ground, lane, end, ()) for end in ends]
    return rows


def _way_row(ground: Ground, source: str, end: str, via: tuple[str, ...]) -> dict[str, Any]:
    touched = {*ground.way(source, end), *(ground.way(source, end, via) if via else ())}
    return {"source": source, "destination": end, "regions": sorted(touched)}


def budgets(grants: list[Draft], style: Style, *, steps: int, private: int) -> dict[str, Any]:
    """Return totals that are enough for the mission as it is meant.

    Args:
        grants: of the mission.
        style: how strictly it is held.
        steps: how many actions are meant.
        private: most bytes recorded in all.
    """
    return {
        "actions": steps + style.watch + 4,
        "rate": {"count": style.rate, "per": 10_000},
        "motion": sum(g["max"] * g["starts"] for g in grants if g["type"] in _DRIVEN)
        + 2 * style.max_ms,
        "waiting": 0 if not style.pause else 4 * style.pause,
        "recorded_bytes": private,
        "prompts": style.prompts,
        "planner_stops": 3,
    }


def risk(*, strict: bool = False, tau_2: int = 60, needed: int = 3, valid: int = 120_000) -> Draft:
    """Return the risk policy.

    Args:
        strict: places that are private or restricted, and recording, need approvals.
        tau_2: from this score on, `needed` principals stand behind an action.
        needed: so many, the issuer included.
        valid: how long a question and its answers live, ms.
    """
    tags = {"hazardous": 60, "public": 0, "staff": 4}
    tags |= {"private": 35, "restricted": 40} if strict else {"private": 8, "restricted": 20}
    return {
        "types": {"navigate": 5, "pick": 5, "place": 5, "wait": 2, "scan_obstacles": 0},
        "region_tags": tags,
        "object_classes": {},
        "parameters": [],
        "privacy": 2,
        "otherwise": 1,
        "tau_1": 30,
        "tau_2": tau_2,
        "t": needed,
        "roles": ["safety_officer", "supervisor"],
        "valid": valid,
    }
