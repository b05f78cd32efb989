# SPDX-License-Identifier: Apache-2.0
"""A store and its write-ahead log that somebody moves away under a gate that runs.

Real processes. Spec page: docs/spec/store.md#moved-away
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest

from authguard_r.core.errors import AuthGuardError
from authguard_r.wire.messages import ClientRole
from fixtures.gate_process import RunningGate, until
from integration.test_gate_watching import FAST, operator

SCAN = b"scan()"
WHAT = "the store was moved away"
#: It is noticed within a second, and the machine may be slow.
SOON_S = 5


def proposed(gate: RunningGate) -> list[str]:
    """Return why a step is refused; empty when it was carried out."""
    with gate.client(ClientRole.PLANNER) as planner:
        try:
            (step,) = planner.propose(SCAN)["steps"]
        except AuthGuardError as error:
            return [str(error.reason)]
    return list(map(str, step["reasons"]))


def alerts(gate: RunningGate) -> list[dict[str, Any]]:
    with operator(gate) as person:
        return [told for told in person.status()["alerts"] if told["what"] == WHAT]


@pytest.mark.smoke
def test_nothing_is_released_once_the_store_was_moved_away_and_an_alert_says_so() -> None:
    with RunningGate(robot=FAST, estimator=True, refusals=0) as gate:
        gate.activate()
        assert proposed(gate) == []
        away = gate.folder / "away"
        away.mkdir()
        files = [path for path in gate.folder.iterdir() if path.name.startswith("robot.db")]
        files = [path for path in files if path.is_file() and not path.name.endswith(".gate")]
        for path in files:
            path.rename(away / path.name)
        moved = time.monotonic()
        assert proposed(gate) == ["STORE_UNAVAILABLE"]
        until(lambda: alerts(gate), "the alert")
        assert time.monotonic() - moved < SOON_S
        for path in files:
            Path(away / path.name).rename(path)
        until(lambda: alerts(gate)[-1].get("over"), "the alert's end")
        until(lambda: proposed(gate) == [], "work that goes on")


def test_a_write_ahead_log_that_alone_was_moved_away_is_missed_as_well() -> None:
    """What is committed is in it: a store without it is an older one."""
    with RunningGate(robot=FAST, estimator=True, refusals=0) as gate:
        gate.activate()
        assert proposed(gate) == []
        wal, away = Path(f"{gate.store}-wal"), gate.folder / "away-wal"
        wal.rename(away)
        moved = time.monotonic()
        assert proposed(gate) == ["STORE_UNAVAILABLE"]
        until(lambda: alerts(gate), "the alert")
        assert time.monotonic() - moved < SOON_S
        assert not wal.exists()  # nor is another one begun
        assert gate.store.exists()
        away.rename(wal)
        until(lambda: alerts(gate)[-1].get("over"), "the alert's end")
        until(lambda: proposed(gate) == [], "work that goes on")
        decided = [record for record in gate.records() if record.kind == "decision"]
        assert len([record for record in decided if record.open["ticket"] != "-"]) == 2
