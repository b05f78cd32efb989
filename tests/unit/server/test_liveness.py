# SPDX-License-Identifier: Apache-2.0
"""One alert for each silence, none where nobody has to speak, and refusals in a row counted."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.structs import replace

from authguard_r.core.action import Action
from authguard_r.core.decision import Verdict
from authguard_r.core.identifiers import Identifier
from authguard_r.core.lifecycle import Status
from authguard_r.core.reasons import Reason
from authguard_r.enforcement.report import Refusal, Report
from authguard_r.server.liveness import Liveness, MissionPhase
from authguard_r.sim.robot import Faults
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import ClientRole
from fixtures import scenarios
from unit.server.demo_site import HandClock
from unit.server.robots import config

REFUSED = Report(judged=None, refusal=Refusal(Reason.MALFORMED, "x", "y"))
QUIET = {"planner_silence_ms": 1_000, "estimator_silence_ms": 500}
CLIENT = Identifier("u1.planner")
PHASE = MissionPhase("deliver-p1", 1, Status.ACTIVE)


class Bench:
    def __init__(self, **bounds: Any) -> None:
        self.clock = HandClock()
        self.raised: list[str] = []
        self.phase: MissionPhase | None = PHASE
        self.liveness = Liveness(
            config(**{**QUIET, **bounds}),
            self.clock.mono_ms,
            lambda what, _: self.raised.append(what),
            lambda: self.phase,
        )
        self.liveness.follow()

    def over(self, what: str) -> list[bool]:
        """Return of each such alert whether it is over."""
        alerts = [told for told in self.liveness.alerts if told["what"] == what]
        return [told.get("over", False) for told in alerts]

    def after(self, ms: int, *, active: bool = True, controller: bool = True) -> list[str]:
        """Let time pass and check; return what is new."""
        self.clock.ms += ms
        before = len(self.raised)
        self.liveness.check(active=active, controller=controller)
        return self.raised[before:]


def test_one_alert_for_each_silence_and_another_after_it_was_broken() -> None:
    bench = Bench()
    assert bench.after(0) == []
    assert bench.after(500) == []
    assert bench.after(1) == ["estimator is silent"]
    assert bench.after(600) == ["planner is silent"]
    assert bench.after(60_000) == []
    bench.liveness.hear(ClientRole.PLANNER)
    assert bench.after(1_000) == []
    assert bench.after(1) == ["planner is silent"]


@pytest.mark.parametrize("role", [ClientRole.PLANNER, ClientRole.ESTIMATOR])
def test_a_silence_is_over_with_the_next_word_or_with_the_mission(role: ClientRole) -> None:
    bench, what = Bench(estimator_silence_ms=1_000), f"{role} is silent"
    bench.after(0)
    bench.after(1_000)
    assert bench.over(what) == []
    bench.after(1)
    assert bench.over(what) == [False]
    bench.liveness.hear(role)
    assert bench.over(what) == [True]
    bench.after(1_001)
    assert bench.over(what) == [True, False]
    bench.after(1, active=False)
    assert bench.over(what) == [True, True]


def test_nobody_has_to_speak_without_a_mission_and_silence_counts_from_its_begin() -> None:
    bench = Bench()
    assert bench.after(600_000, active=False, controller=False) == []
    assert bench.after(600_000) == []
    assert bench.after(501) == ["estimator is silent"]
    assert bench.after(1, active=False) == []


def test_a_bound_of_nothing_raises_nothing() -> None:
    bench = Bench(planner_silence_ms=0, estimator_silence_ms=0, refusals=0)
    bench.after(0)
    assert bench.after(10**9) == []
    assert [bench.liveness.judge(CLIENT, REFUSED) for _ in range(50)] == [False] * 50


def test_a_missing_controller_is_told_once_and_again_when_it_goes_again() -> None:
    bench = Bench(planner_silence_ms=0, estimator_silence_ms=0)
    assert bench.after(1, controller=False) == ["controller is not connected"]
    assert bench.after(1, controller=False) == []
    assert bench.after(1) == []
    assert bench.after(1, controller=False) == ["controller is not connected"]


def test_what_is_recorded_already_is_kept_and_not_raised_again() -> None:
    bench = Bench()
    bench.liveness.tell("planner stops", {"by": "u1.planner"})
    assert bench.raised == []
    assert list(bench.liveness.alerts) == [{"what": "planner stops", "by": "u1.planner"}]


ALERTS = {
    "in_time": "the clock is behind",
    "has_store": "the store was moved away",
    "controller": "controller is not connected",
    "only_counts": "refusals are only counted: the disk is full",
}


@pytest.mark.parametrize("what", ALERTS)
def test_what_lasts_is_told_once_each_time_ends_and_is_not_told_without_cause(what: str) -> None:
    bench = Bench()
    usual = {"active": True, "controller": True}
    wrong = what == "only_counts"
    bench.liveness.check(**usual)
    assert bench.raised == []
    for is_wrong in (False, True, True, False, True):
        bench.liveness.check(**usual | {what: is_wrong is wrong})
        alerts = [told for told in bench.liveness.alerts if not told.get("over")]
        assert [told["what"] for told in alerts] == [ALERTS[what]] * is_wrong
    assert bench.raised == [ALERTS[what]] * 2


def test_ages_are_since_the_last_word_and_nothing_for_who_never_spoke() -> None:
    bench = Bench()
    bench.liveness.hear(ClientRole.ESTIMATOR)
    bench.clock.ms += 70
    assert bench.liveness.ages() == {
        "planner_ms": None,
        "estimator_ms": 70,
        "controller_ms": None,
    }


def released(*, succeeds: bool) -> Report:
    sim = scenarios.simulation()
    sim.gate.management.activate(scenarios.token())
    if not succeeds:
        sim.robot.pause(0)
        sim.robot.faults = Faults(controller_refuses=True)
    report: Report = scenarios.propose(sim, scenarios.navigate("dock", "pharmacy"))
    return report


def test_refusals_in_a_row_are_no_progress_and_a_success_begins_anew() -> None:
    bench = Bench(refusals=3)
    judge = bench.liveness.judge
    assert [judge(CLIENT, REFUSED) for _ in range(7)] == [
        *(False, False, True),
        *(False, False, False, False),  # it was said: the same row is no news
    ]
    assert judge(CLIENT, released(succeeds=True)) is False
    assert [judge(CLIENT, REFUSED) for _ in range(3)] == [False, False, True]
    assert judge(CLIENT, released(succeeds=False)) is False  # it got somewhere
    assert bench.raised == ["no progress"] * 2
    assert bench.liveness.alerts[-1] == {"what": "no progress", "client": CLIENT, "refusals": 3}


def asking(action: Action, **changes: Any) -> Report:
    """Return what becomes of an action under a mission whose refusals ask a person."""
    sim = scenarios.simulation()
    sim.gate.management.activate(scenarios.token(scenarios.mission(on_refusal="ask", **changes)))
    report: Report = scenarios.propose(sim, action)
    return report


def test_a_person_is_asked_once_for_a_row_where_the_mission_says_so() -> None:
    bench = Bench(refusals=0)
    refused = asking(scenarios.navigate("dock", "office-1"))
    for name in ("u1.a", "u1.b", "u2.a"):  # a name is nobody else's
        bench.liveness.judge(Identifier(name), refused)
    asked = {"what": "a person is asked", "decision": refused.seq}
    assert list(bench.liveness.alerts) == [{**asked, "client": n} for n in ("u1.a", "u2.a")]
    bench.liveness.judge(Identifier("u1.a"), released(succeeds=True))
    bench.liveness.judge(Identifier("u1.a"), refused)
    assert bench.raised == ["a person is asked"] * 3


CHANGES = {
    "suspended": replace(PHASE, status=Status.SUSPENDED),
    "closing": replace(PHASE, status=Status.CLOSING),
    "next version": replace(PHASE, version=2),
    "another mission": replace(PHASE, mid="another"),
    "ended": None,
}


@pytest.mark.parametrize("change", CHANGES)
def test_alerts_about_a_mission_are_over_once_it_has_changed(change: str) -> None:
    bench = Bench(refusals=1)
    after, row = CHANGES[change], ("no progress", "a person is asked")
    bench.after(0)
    bench.liveness.judge(CLIENT, asking(scenarios.navigate("dock", "office-1")))
    for what in ("planner stops", "false emergency"):
        bench.liveness.tell(what, {})
    bench.after(0)
    assert not any(told.get("over") for told in bench.liveness.alerts)
    bench.phase = after
    bench.after(0)
    assert [bench.over(what) for what in row] == [[True], [True]]
    has_ended = after is None or after.mid != PHASE.mid
    for what in ("planner stops", "false emergency"):
        assert bench.over(what) == [has_ended]


def test_what_is_raised_right_after_a_mission_began_is_not_over_with_the_one_before() -> None:
    bench = Bench(refusals=1)
    bench.after(0)
    bench.liveness.judge(CLIENT, REFUSED)
    bench.phase = replace(PHASE, mid="another")
    bench.liveness.judge(Identifier("u2.planner"), REFUSED)
    bench.after(0)
    assert bench.over("no progress") == [True, False]


@pytest.mark.parametrize("change", ["suspended", "ended"])
def test_who_cannot_succeed_makes_no_row_and_asks_nobody(change: str) -> None:
    bench = Bench(refusals=2)
    refused = asking(scenarios.navigate("dock", "office-1"))
    bench.phase = CHANGES[change]
    assert not any(bench.liveness.judge(CLIENT, refused) for _ in range(5))
    assert bench.raised == []
    bench.phase = PHASE
    bench.after(0)
    assert [bench.liveness.judge(CLIENT, refused) for _ in range(2)] == [False, True]
    assert bench.raised == ["a person is asked", "no progress"]


def test_nobody_is_asked_what_an_approvals_request_asks_already() -> None:
    bench = Bench(refusals=0)
    everything = {**scenarios.draft()["risk_policy"], "tau_1": 0}
    waits = asking(scenarios.navigate("dock", "pharmacy"), risk_policy=everything)
    assert waits.judged is not None
    assert waits.judged.decision.verdict is Verdict.REQUEST_APPROVAL
    bench.liveness.judge(CLIENT, waits)
    assert bench.raised == []


def test_one_planners_refusals_are_not_anothers() -> None:
    bench = Bench(refusals=2)
    for name in ("u1.a", "u2.a"):
        assert bench.liveness.judge(Identifier(name), REFUSED) is False
    assert bench.raised == []


def test_one_users_refusals_are_its_own_under_whatever_name() -> None:
    bench = Bench(refusals=4)
    judge = bench.liveness.judge
    assert [judge(Identifier(f"u5.{n}"), REFUSED) for n in "abab"] == [False, False, False, True]
    assert bench.raised == ["no progress"]
    # the user's row was told; each client's own row is another one
    assert [judge(Identifier("u5.a"), REFUSED) for _ in range(2)] == [False, True]
    assert [judge(Identifier(f"u6.{n}"), REFUSED) for n in range(3)] == [False] * 3
    assert judge(Identifier("u6.0"), released(succeeds=True)) is False  # the user got somewhere
    assert [judge(Identifier(f"u6.{n}"), REFUSED) for n in (3, 4, 5)] == [False] * 3
    assert judge(Identifier("u6.6"), REFUSED) is True


def test_what_is_counted_is_bounded_and_so_is_what_is_shown() -> None:
    bench = Bench(refusals=2)
    for number in range(LIMITS.counted_users):  # each is counted as a client and as a user
        assert bench.liveness.judge(Identifier(f"u{number}.p"), REFUSED) is False
    assert len(bench.liveness._refused) == LIMITS.counted_users
    oldest, newest = Identifier("u0.p"), Identifier(f"u{LIMITS.counted_users - 1}.p")
    assert bench.liveness.judge(oldest, REFUSED) is False  # it was forgotten
    assert bench.liveness.judge(newest, REFUSED) is True
    for _ in range(LIMITS.shown_alerts + 5):
        bench.liveness.alert("x", {})
    assert len(bench.liveness.alerts) == LIMITS.shown_alerts


@pytest.mark.parametrize("active", [True, False])
def test_a_check_changes_no_authority(active: bool) -> None:
    sim = scenarios.simulation()
    sim.gate.management.activate(scenarios.token())
    before = sim.gate.management.standing("deliver-p1")
    bench = Bench()
    bench.after(10**6, active=active, controller=False)
    assert sim.gate.management.standing("deliver-p1") == before


def test_a_silence_that_is_over_is_no_longer_told_as_if_it_lasted() -> None:
    bench = Bench()
    bench.liveness.check(active=True, controller=False)
    assert bench.liveness.alerts[-1] == {"what": "controller is not connected"}
    bench.liveness.alert("no progress", {})
    bench.liveness.check(active=True, controller=True)
    ended, other = bench.liveness.alerts
    assert (ended["over"], "over" in other) == (True, False)
    bench.liveness.check(active=True, controller=False)
    assert "over" not in bench.liveness.alerts[-1]
