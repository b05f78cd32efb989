# SPDX-License-Identifier: Apache-2.0
"""A gate's process to measure, and the mission that keeps it busy.

The gate is the product's own command, started as the tests start it; its store lies on the disk
that is measured.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import time_ns
from typing import Any

from authguard_r.authoring.compile.build import compile_draft
from authguard_r.authoring.compile.draft import Draft
from authguard_r.core.encoding import b64
from authguard_r.core.quantities import Now
from authguard_r.site.source import convert
from scene import PLENTY, gate_process, scenarios

_SCAN, _WAIT = "look-out", "stay"


def busy_draft(mid: str) -> dict[str, Any]:
    """Return the shipped mission, with as much looking around and standing still as anybody asks.

    The rate is counted over one second, so that what is remembered of it stays short.
    """
    plain: dict[str, Any] = scenarios.draft(
        mission=mid,
        window={"for": "2 days"},
        budgets={
            "actions": PLENTY,
            "rate": {"count": 1_000, "per": "1 s"},
            "motion": "1 h",
            "waiting": "40000 h",
            "recorded_bytes": 0,
            "prompts": 5,
            "planner_stops": PLENTY,
        },
    )
    for grant in plain["grants"]:
        if grant["id"] == _SCAN:
            grant.update(repeat=PLENTY, starts=PLENTY)
    plain["grants"].append(
        {
            "id": _WAIT,
            "type": "wait",
            "tool": "base",
            "rows": [{}],
            "limits": {"duration_ms": ["0 s", "2 s"]},
            "chooser": "trusted_sensor",
            "repeat": PLENTY,
            "starts": PLENTY,
            "max": "5 s",
            "irreversible": False,
        }
    )
    return plain


def busy_mission(mid: str) -> bytes:
    """Return the draft compiled and signed, valid since a minute ago.

    A gate's simulated time stands still until something moves: it is behind ours.
    """
    now = Now(time_ns() // 1_000_000 - 60_000, 0)
    drafted = convert(busy_draft(mid), Draft, where=mid)
    mission = compile_draft(
        drafted, scenarios.site(), now=now, nonce=b64(scenarios.random_bytes(16))
    )
    return scenarios.token(mission)


@contextmanager
def serving(folder: Path, name: str, **options: Any) -> Iterator[gate_process.RunningGate]:
    """Have a gate run with the busy mission, its store in the folder; options as the tests' own."""
    gate = gate_process.RunningGate(**options)
    gate.store = folder / f"{name}.db"
    with gate:
        gate.activate(busy_mission(name))
        yield gate
