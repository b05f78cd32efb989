# SPDX-License-Identifier: Apache-2.0
"""Stops are carried out first and written down after; no flood of them fills the log."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.audit.record import read_record
from authguard_r.core.errors import StoreError
from authguard_r.core.standing import Standing
from authguard_r.wire.messages import ClientRole
from fixtures import scenarios
from unit.server.demo_site import DemoGate


def ready(**more: Any) -> Any:
    sim = scenarios.simulation(**more)
    sim.gate.management.activate(scenarios.token())
    return sim


def records(sim: Any, kind: str) -> list[Any]:
    found = [read_record(row.record, where="") for row in sim.gate.ledger.store.rows()]
    return [record for record in found if record.kind == kind]


def budget() -> int:
    return scenarios.mission().budgets.planner_stops


def test_a_planners_stops_over_its_budget_are_counted_not_recorded_one_by_one() -> None:
    with DemoGate() as house:
        house.activate()
        for number in range(budget() + 1 + 5_000):
            house.gate.enforcer.stopped(by="u5.planner", is_planner=True)
            house.clock.ms += number % 2
        within = house.log("stop")
        assert len(within) == budget() + 2  # those within, the one that is over, and the first past
        assert house.standing.planner_stops == budget() + 1
        (alert,) = house.log("alert")
        assert alert.open["what"] == "planner stops"
        house.clock.ms += house.config.fold_ms
        counted = [r for r in house.log("refusal") if r.link.decision == "counted"]
        assert sum(r.open["repeats"] for r in counted) == 5_000 - 1
        assert len(house.log()) < 20


def test_another_planners_stops_are_not_swallowed_by_its_count() -> None:
    with DemoGate() as house:
        house.activate()
        for _ in range(budget() + 5):
            house.stop(ClientRole.PLANNER, house.service.queries.stops + 1)
        before = len(house.log("stop"))
        house.stop(ClientRole.PLANNER, 10**6, by="other")
        house.stop(ClientRole.AUDITOR, 10**6 + 1)
        assert len(house.log("stop")) == before + 2


def test_a_stop_of_anybody_else_is_recorded_however_many_there_were() -> None:
    sim = ready()
    for _ in range(20):
        sim.gate.enforcer.stopped(by="auditor", is_planner=False, details={"n": 1}, why="smoke")
    assert len(records(sim, "stop")) == 20
    assert sim.gate.management.standing("deliver-p1").planner_stops == 0


def test_only_a_mission_that_can_be_suspended_is() -> None:
    sim = ready()
    for _ in range(2):
        sim.gate.enforcer.stop(by="operator", is_planner=False, suspends=True)
    assert [r.link.decision for r in records(sim, "management")] == [
        "issue",
        "activate",
        "suspend",
    ]
    assert sim.gate.management.standing("deliver-p1").status == "suspended"  # not ended
    idle = scenarios.simulation()
    idle.gate.enforcer.stop(by="operator", is_planner=False, suspends=True)
    assert records(idle, "management") == []


def test_a_mission_that_is_closing_cannot_wait_and_is_ended() -> None:
    sim = ready()
    standing = sim.gate.management.standing("deliver-p1")
    plain = {**msgspec.to_builtins(standing), "status": "closing", "closes_ms": scenarios.START_MS}
    sim.gate.ledger.run(lambda act: act.hold(msgspec.convert(plain, Standing)))
    sim.gate.enforcer.stop(by="operator", is_planner=False, suspends=True)
    assert sim.gate.management.standing("deliver-p1").status == "completed"
    assert records(sim, "management")[-1].link.decision == "complete"


def test_an_operators_stop_without_a_mission_owes_nothing() -> None:
    idle = scenarios.simulation()
    idle.gate.enforcer.stop(by="operator", is_planner=False, suspends=True)
    assert idle.gate.enforcer.settle_stops() is True


def test_a_suspension_that_is_owed_refuses_everything_until_it_is_on_disk() -> None:
    sim = ready()
    run = sim.gate.ledger.store.run

    def slow(job: Any, *, essential: bool = False) -> Any:
        if essential:
            raise StoreError("slow")
        return run(job)

    sim.gate.ledger.store.run = slow
    sim.gate.enforcer.stop(by="operator", is_planner=False, suspends=True)
    assert sim.gate.enforcer.settle_stops() is False
    sim.gate.enforcer.stop(by="planner", is_planner=True)  # takes nothing of it back
    for _ in range(2):
        report = scenarios.propose(sim, scenarios.navigate("dock", "pharmacy"))
        assert (report.refusal.reason, report.refusal.where) == ("STOPPED", "stop")
    assert sim.robot.trace == []
    assert records(sim, "decision") == []
    assert sim.gate.management.standing("deliver-p1").status == "active"
    sim.gate.ledger.store.run = run
    report = scenarios.propose(sim, scenarios.navigate("dock", "pharmacy"))
    assert report.judged.decision.reasons == ("MISSION_SUSPENDED",)
    assert sim.gate.enforcer.settle_stops() is True
    assert [r.link.decision for r in records(sim, "management")] == [
        "issue",
        "activate",
        "suspend",
    ]


@pytest.mark.parametrize("is_planner", [True, False])
def test_what_cannot_be_written_does_not_undo_a_stop(tmp_path: Path, is_planner: bool) -> None:
    sim = ready()

    def gone(*_: Any, **__: Any) -> Any:
        raise StoreError("gone")

    sim.gate.ledger.store.run = gone
    sim.gate.enforcer.stop(by="somebody", is_planner=is_planner, suspends=True)
    assert sim.robot.stops == 1


def test_a_stop_whose_mission_is_gone_from_the_store_is_recorded_all_the_same() -> None:
    sim = ready()
    sim.gate.enforcer.inputs.forget()
    held = sim.gate.ledger.store._held
    for key in [key for key in held if key[0] == "token"]:
        del held[key]
    sim.gate.enforcer.stop(by="planner", is_planner=True)
    assert len(records(sim, "stop")) == 1
