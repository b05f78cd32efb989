# SPDX-License-Identifier: Apache-2.0
"""What people are told of a gate's witnesses, and of a store that was put back."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from authguard_r.operations.simulation import Simulation
from authguard_r.server.event_bus import EventBus
from authguard_r.server.event_log import EventLog
from authguard_r.server.liveness import Liveness
from authguard_r.server.log_maintenance import LogMaintenance
from authguard_r.store.memory import MemoryStore
from fixtures import scenarios
from fixtures.gate_process import until
from fixtures.restarting_gate import copied
from fixtures.small_witness import SmallWitness, begin, policy
from unit.server.robots import config
from unit.test_anchor import order


class Watched:
    """A gate's vigil, its alerts and its journal."""

    def __init__(self, sim: Simulation, journal: Path) -> None:
        self.sim = sim
        self._path = journal
        self._file = os.open(journal, os.O_WRONLY | os.O_CREAT | os.O_NONBLOCK)
        ledger = sim.gate.ledger
        events = EventBus(ledger, lambda: (), EventLog(self._file))
        self.liveness = Liveness(config(), ledger.mono_ms, events.alert)
        self.vigil = LogMaintenance(sim.gate.anchor, self.liveness, events)
        self.vigil.begin()

    def told(self) -> list[str]:
        lines = [json.loads(line) for line in self._path.read_text().splitlines()]
        return [line["what"] for line in lines if line["event"] == "alert"]

    def alerts(self) -> list[tuple[str, bool]]:
        return [(told["what"], told.get("over", False)) for told in self.liveness.alerts]

    def recorded(self) -> list[str]:
        rows = self.sim.gate.ledger.peek(lambda turn: turn.rows(0, 1_000))
        opened = [json.loads(record)["open"] for _, record, _, _ in rows]
        return [one["what"] for one in opened if "what" in one]

    def close(self) -> None:
        os.close(self._file)


@pytest.fixture
def witness() -> Iterator[SmallWitness]:
    with SmallWitness("one") as one:
        yield one


def test_silence_is_an_alert_with_one_record_and_is_over_when_it_ends(
    witness: SmallWitness, tmp_path: Path
) -> None:
    sim = begin(MemoryStore(), policy(witness, silence_ms=90_000))
    here = Watched(sim, tmp_path / "journal")
    assert here.alerts() == []
    witness.stop()

    def passed() -> list[tuple[str, bool]]:
        sim.gate.enforcer.stop(by="person", is_planner=False)
        sim.robot.pause(60_000)
        here.vigil.look()
        return here.alerts()

    until(passed, "the alert")
    assert here.alerts() == [("the witnesses are silent", False)]
    assert here.told() == ["the witnesses are silent"]
    assert here.recorded().count("the witnesses are silent") == 1
    witness.start()
    until(lambda: [passed(), here.alerts()][1][0][1], "its end")
    assert here.alerts() == [("the witnesses are silent", True)]
    here.close()


def looked(here: Watched, minutes: int) -> None:
    """Let a gate work, look at its log and make checkpoints for some minutes."""
    for _ in range(minutes):
        here.sim.gate.enforcer.stop(by="person", is_planner=False)
        here.sim.robot.pause(60_000)
        here.vigil.look()


@pytest.mark.parametrize("silence_ms", [90_000, 600_000])
def test_a_gate_without_witnesses_never_says_that_they_are_silent(
    tmp_path: Path, silence_ms: int
) -> None:
    """A false alert is a fault: nobody was asked, so nobody is silent."""
    here = Watched(begin(MemoryStore(), policy(silence_ms=silence_ms)), tmp_path / "journal")
    looked(here, minutes=30)
    assert (here.alerts(), here.told()) == ([], [])
    assert "the witnesses are silent" not in here.recorded()
    here.close()


def test_witnesses_that_answer_are_not_silent(witness: SmallWitness, tmp_path: Path) -> None:
    sim = begin(MemoryStore(), policy(witness, silence_ms=90_000, records=1))
    here = Watched(sim, tmp_path / "journal")

    def all_of_it() -> bool:
        here.vigil.look()
        told: Any = sim.gate.anchor.shown()["witness"]
        return bool(told["unwitnessed"] == 0)

    for _ in range(5):
        looked(here, minutes=1)
        until(all_of_it, "the cosignature")
    assert (here.alerts(), here.told()) == ([], [])
    here.close()


def test_a_store_that_was_put_back_is_told_of_at_the_start_or_as_soon_as_it_is_known(
    witness: SmallWitness, tmp_path: Path
) -> None:
    sim = begin(MemoryStore(), policy(witness))
    store = sim.gate.ledger.store
    assert isinstance(store, MemoryStore)
    kept = copied(store)
    sim.gate.management.activate(scenarios.token(scenarios.mission()))
    sim.gate.close()
    witness.stop()
    late = Watched(begin(copied(kept), policy(witness)), tmp_path / "late")
    assert late.alerts() == []
    witness.start()

    def passed() -> list[tuple[str, bool]]:
        late.sim.robot.pause(1_000)
        late.vigil.look()
        return late.alerts()

    until(passed, "the alert")
    early = Watched(begin(kept, policy(witness)), tmp_path / "early")
    for here in (late, early):
        assert here.alerts() == [("the store was rolled back", False)]
        assert here.told() == here.recorded() == ["the store was rolled back"]
        here.vigil.look()
        assert here.alerts() == [("the store was rolled back", False)]
        here.sim.gate.management.accept_store(order(here.sim))
        here.vigil.look()
        assert here.alerts() == [("the store was rolled back", True)]
        assert here.recorded() == ["the store was rolled back"]
        here.close()


def test_without_witnesses_and_with_a_store_that_fits_nothing_is_told_all_day(
    tmp_path: Path,
) -> None:
    here = Watched(begin(MemoryStore(), policy(silence_ms=90_000)), tmp_path / "journal")
    for _ in range(10):
        here.sim.gate.enforcer.stop(by="person", is_planner=False)
        here.sim.robot.pause(600_000)
        here.vigil.look()
    assert (here.alerts(), here.recorded()) == ([], [])
    here.close()
