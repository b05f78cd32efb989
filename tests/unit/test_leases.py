# SPDX-License-Identifier: Apache-2.0
"""A released action from its begin to its recorded end, whatever its controller makes of it."""

from __future__ import annotations

from typing import Any

import pytest

from authguard_r.audit.record import read_record
from authguard_r.core.action import Action
from authguard_r.core.encoding import Tag, b64, digest_of
from authguard_r.core.errors import ControllerError, StoreError
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Outcome, Spend
from authguard_r.enforcement.leases import Running, quietly
from authguard_r.enforcement.report import Report
from authguard_r.normalize import Step
from authguard_r.sim.robot import Faults
from fixtures import scenarios

GO = scenarios.navigate("dock", "pharmacy")


class Flight:
    """What a controller of somebody else says; it may say anything."""

    def __init__(self, why: str = "") -> None:
        self.ended: Outcome | None = None
        self.said = why

    def outcome(self) -> Outcome | None:
        return self.ended

    def used(self) -> Spend:
        return Spend(motion_ms=7)

    def why(self) -> str:
        return self.said


class Controller:
    """One that obeys, or does not."""

    def __init__(self, handle: Flight, *, stands: bool = True) -> None:
        self.handle = handle
        self.stops = 0
        self._stands = stands

    def dispatch(self, action: object, lease: object) -> Flight:
        return self.handle

    def stop(self) -> None:
        self.stops += 1
        if self._stands:
            self.handle.ended = Outcome.ABORTED


class Bench:
    """A gate whose controller is somebody else's, and one action of it under way."""

    def __init__(self, handle: Flight | None = None, *, stands: bool = True) -> None:
        self.sim = scenarios.simulation()
        self.sim.gate.management.activate(scenarios.token())
        self.handle = handle or Flight()
        self.controller = Controller(self.handle, stands=stands)
        self.sim.gate.enforcer._watch.controller = self.controller
        self.kept: list[Report] = []

    def submit(self, action: Action = GO, **more: Any) -> Running | Report:
        return self.sim.gate.enforcer.submit(
            Step(action=action, attested=()),
            planner="planner",
            evidence=b64(bytes(32)),
            context=self.sim.binder.context(),
            **more,
        )

    def begin(self, **more: Any) -> Running:
        begun = self.submit(**more)
        assert isinstance(begun, Running)
        return begun

    def keep(self, act: Any, report: Report, seq: int) -> None:
        act.put("proposal", "k", str(report.outcome).encode())

    @property
    def held(self) -> bytes | None:
        found: bytes | None = self.sim.gate.ledger.run(lambda act: act.get("proposal", "k"))
        return found

    @property
    def standing(self) -> Any:
        return self.sim.gate.management.standing("deliver-p1")

    def records(self, kind: str) -> list[Any]:
        rows = [read_record(row.record, where="") for row in self.sim.gate.ledger.store.rows()]
        return [record for record in rows if record.kind == kind]


def test_an_action_that_runs_holds_until_its_controller_says_how_it_ended() -> None:
    bench = Bench()
    running = bench.begin()
    assert running.poll() is None
    assert running.holds
    bench.handle.ended = Outcome.SUCCEEDED
    report = running.poll()
    assert report is not None
    assert (report.outcome, report.reasons, report.outcome_recorded) == (
        Outcome.SUCCEEDED,
        (),
        True,
    )
    assert bench.records("outcome")[-1].open["used"] == {"motion_ms": 7}
    assert "stood_ms" not in bench.records("outcome")[-1].open
    assert bench.controller.stops == 0


@pytest.mark.parametrize(
    ("why", "reason"),
    [("STOPPED", Reason.STOPPED), ("RENEWAL_LOST", Reason.CONTROLLER_FAILED), ("x y", None)],
)
def test_what_a_controller_says_went_wrong_is_a_finding_with_its_words(
    why: str, reason: Reason | None
) -> None:
    bench = Bench(Flight(why))
    bench.handle.ended = Outcome.ABORTED
    report = bench.begin().poll()
    assert report is not None
    (finding,) = report.reasons
    assert finding.reason is (reason or Reason.CONTROLLER_FAILED)
    assert (finding.field, finding.got) == ("controller", why)


def test_a_controller_in_doubt_is_told_to_stop_though_the_lease_holds() -> None:
    bench = Bench()
    running = bench.begin()
    bench.handle.said = "CONTROLLER_FAILED"
    report = running.poll()
    assert bench.controller.stops == 1
    assert report is not None
    assert report.outcome is Outcome.ABORTED
    assert bench.records("outcome")[-1].open["stood_ms"] == 0


def test_a_robot_that_does_not_say_that_it_stands_leaves_an_unknown_outcome() -> None:
    bench = Bench(stands=False)
    running = bench.begin()
    bench.sim.robot.faults = Faults(estimator_dies_ms=0)
    bench.sim.robot.elapsed_ms += 5_000  # nothing is attested meanwhile
    assert running.poll() is None
    assert not running.holds
    within = bench.sim.gate.enforcer._watch.stand_within_ms
    bench.sim.robot.elapsed_ms += within
    assert running.poll() is None
    bench.sim.robot.elapsed_ms += 1
    report = running.poll()
    assert report is not None
    assert report.outcome is Outcome.UNKNOWN
    assert [f.reason for f in report.reasons] == ["STATE_STALE"] * (len(report.reasons) - 1) + [
        "CONTROLLER_FAILED"
    ]
    assert bench.standing.status == "suspended"
    assert len(bench.standing.open) == 1
    assert bench.controller.stops == 1  # once, not at every look
    assert bench.records("outcome")[-1].open["stood_ms"] == within + 1


def test_who_asked_to_be_told_is_told_right_before_the_outcome_is_recorded() -> None:
    bench = Bench()
    running = bench.begin()
    seen: list[int] = []
    running.before_outcome(lambda: seen.append(len(bench.records("outcome"))))
    assert running.poll() is None
    assert seen == []
    bench.handle.ended = Outcome.SUCCEEDED
    running.poll()
    assert seen == [0]


@pytest.mark.parametrize("believed", [True, False])
def test_an_outcome_of_a_superseded_version_is_held_to_the_version_in_force(
    believed: bool,
) -> None:
    bench = Bench()
    running = bench.begin()
    first = digest_of(Tag.MISSION, scenarios.mission())
    second = scenarios.mission("mission-v2.yaml", supersedes=first)
    bench.sim.gate.management.activate(scenarios.token(second))
    bench.handle.ended = Outcome.SUCCEEDED
    if not believed:  # nobody's certificate counts any more
        bench.sim.gate.enforcer.inputs.forget()
        bench.sim.robot._start_ms += 400 * 86_400_000
    report = running.poll()
    assert report is not None
    assert (report.outcome, report.outcome_recorded) == (Outcome.SUCCEEDED, True)
    assert (bench.standing.digest, bench.standing.status) == (
        digest_of(Tag.MISSION, second),
        "active",
    )
    assert bench.standing.open == ()


# what is held beside a decision and an outcome


def test_what_is_kept_is_in_the_same_turn_as_decision_and_outcome() -> None:
    bench = Bench()
    running = bench.begin(on_commit=bench.keep)
    assert bench.held == b"None"
    bench.handle.ended = Outcome.SUCCEEDED
    running.poll()
    assert bench.held == b"succeeded"


@pytest.mark.parametrize("at", ["decision", "outcome"])
def test_a_crash_shows_both_or_none_of_what_is_kept_and_what_is_recorded(at: str) -> None:
    bench = Bench()
    crashing = at == "decision"

    def keep(act: Any, report: Report, seq: int) -> None:
        bench.keep(act, report, seq)
        if crashing:
            raise StoreError("the power went")

    begun = bench.submit(on_commit=keep)
    if at == "decision":
        assert isinstance(begun, Report)
        assert begun.refusal is not None
        assert (bench.held, bench.records("decision")) == (None, [])
        assert bench.standing.uses == {}
        return
    assert isinstance(begun, Running)
    crashing = True
    bench.handle.ended = Outcome.SUCCEEDED
    report = begun.poll()
    assert report is not None
    assert not report.outcome_recorded
    assert (bench.held, bench.records("outcome")) == (b"None", [])
    assert len(bench.standing.open) == 1


def test_what_is_kept_of_an_action_that_was_not_begun_says_so() -> None:
    bench = Bench()

    def refuse(action: object, lease: object) -> Any:
        raise ControllerError("no")

    bench.controller.dispatch = refuse  # type: ignore[method-assign]
    report = bench.submit(on_commit=bench.keep)
    assert isinstance(report, Report)
    assert report.outcome is Outcome.NOT_STARTED
    assert bench.held == b"not_started"


def test_what_is_refused_keeps_nothing() -> None:
    bench = Bench()
    assert isinstance(
        bench.submit(scenarios.navigate("dock", "office-1"), on_commit=bench.keep), Report
    )
    assert bench.held is None


# the world's faults


def test_a_gate_that_cannot_look_stops_the_robot() -> None:
    bench = Bench()
    running = bench.begin()
    bench.sim.robot._start_ms -= 3_600_000  # nobody can say what time it is
    report = running.poll()
    assert report is not None
    assert [f.reason for f in report.reasons] == ["CLOCK_BEHIND"]
    assert bench.controller.stops == 1


def test_only_the_worlds_faults_are_quiet() -> None:
    assert quietly(lambda: 5) == 5

    def gone() -> int:
        raise StoreError("gone")

    assert quietly(gone) is None
    with pytest.raises(ZeroDivisionError):
        quietly(lambda: 1 // 0)
