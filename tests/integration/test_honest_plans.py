# SPDX-License-Identifier: Apache-2.0
"""Honest plans whose every step rests on what the one before has done are accepted, each time.

Gate, robot and estimator as processes; a package is carried to and fro between two places. Each
plan is three steps: pick it up with empty hands, drive with it, put it down where the robot is.
Spec page: docs/spec/state.md#fences
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from authguard_r.wire.messages import ClientRole
from fixtures import scenarios
from fixtures.gate_process import RunningGate

#: Robots that work at the same time, each with processes of its own.
AT_ONCE = 8
PLACES = {"pharmacy": "Pharmacy", "station-101": "Station 101"}
REGIONS = ["pharmacy", "public-corridor", "station-101"]
HELD = {"variable": "holding", "max_age": "1 s"}


def errands(plans: int) -> dict[str, Any]:
    """Return what makes the shipped draft a mission of so many plans."""
    go, pick, carry, place, *_ = scenarios.draft()["grants"]
    often: dict[str, Any] = {"repeat": plans, "starts": 2 * plans, "until": [], "after": []}
    ways = [("pharmacy", "station-101"), ("station-101", "pharmacy")]
    grants = [
        go,
        {**pick, **often, "rows": [_row("package-p1", at) for at in PLACES]},
        {**carry, **often, "rows": [_way(*way) for way in ways]},
        {
            **place,
            **often,
            "completes": False,
            "rows": [_row("package-p1", at, at) for at in PLACES],
        },
    ]
    grants[0] = {**go, "until": []}
    for grant in grants[1:]:
        grant["chooser"] = "trusted_sensor" if grant["type"] == "navigate" else "planner"
    budgets = {**scenarios.draft()["budgets"], "actions": 4 * plans, "motion": "300 min"}
    budgets["rate"] = {"count": 1_000, "per": "10 s"}
    return {
        "grants": grants,
        "guards": [],  # nothing about the battery
        "closing": None,
        "window": {"for": "8 h"},
        "budgets": budgets,
    }


def _row(item: str, source: str, destination: str | None = None) -> dict[str, Any]:
    to = {} if destination is None else {"destination": destination}
    return {"object": item, "source": source, "regions": [source], **to}


def _way(source: str, destination: str) -> dict[str, Any]:
    return {"source": source, "destination": destination, "regions": REGIONS}


def carried(speed: int, plans: int) -> list[list[str]]:
    """Return what became of each step of each plan that one robot was given."""
    found = []
    trust = scenarios.new_trust_folder()  # of its own: gates of one robot run side by side
    with RunningGate(robot=("--speed-up", str(speed)), estimator=True, trust=trust) as gate:
        gate.activate(gate.token(gate.mission(**errands(plans))))
        with gate.client(ClientRole.PLANNER) as planner:
            planner.propose(b'navigate_to(destination="Pharmacy", speed=0.8)')
            here, there = PLACES
            for _ in range(plans):
                steps = (
                    'pick_up(object="P1", force=12)',
                    f'navigate_to(destination="{PLACES[there]}", speed=0.8)',
                    f'put_down(object="P1", at="{PLACES[there]}", force=12)',
                )
                told = planner.propose("\n".join(steps).encode())["steps"]
                found.append([f"{s['execution']['outcome']} {s['reasons']}" for s in told])
                here, there = there, here
    return found


@pytest.mark.parametrize(
    ("speed", "plans", "robots"),
    [
        pytest.param(20, 3, 1, marks=pytest.mark.smoke),
        (20, 40, 1),
        pytest.param(20, 1_000, 25, marks=pytest.mark.complete),
        pytest.param(4, 50, 5, marks=pytest.mark.complete),
        pytest.param(1, 10, 5, marks=pytest.mark.complete),
    ],
)
def test_an_honest_plan_is_accepted_every_time(speed: int, plans: int, robots: int) -> None:
    with ThreadPoolExecutor(AT_ONCE) as pool:
        found = list(pool.map(lambda _: carried(speed, plans // robots), range(robots)))
    steps = [plan for robot in found for plan in robot]
    others = [plan for plan in steps if plan != ["succeeded []"] * 3]
    assert others == [], f"{len(others)} of {len(steps)}: {others[:3]}"
    assert len(steps) == plans
