# SPDX-License-Identifier: Apache-2.0
"""The one road: what is refused leaves a code, a place, one record, and nothing executed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.approvals import Selection
from authguard_r.audit.record import read_record
from authguard_r.core.approval import ApprovalVerdict
from authguard_r.core.encoding import Tag, b64, digest_of
from authguard_r.core.errors import AuthGuardError, StoreError
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Outcome
from authguard_r.core.token import sign_object
from authguard_r.enforcement.signed_orders import Command, Verb
from authguard_r.sim.robot import Faults, snapshot_of
from fixtures import scenarios
from missionpair.bench import BenchScene, approve, make_bench, propose
from missionpair.suite import restricted

GO = scenarios.navigate("dock", "pharmacy")


def records(sim: Any, kind: str) -> list[Any]:
    found = [read_record(row.record, where="") for row in sim.gate.ledger.store.rows()]
    return [record for record in found if record.kind == kind]


def ready(**kwargs: Any) -> Any:
    sim = scenarios.simulation(**kwargs)
    sim.gate.management.activate(scenarios.token())
    return sim


def order(verb: Verb, nonce: str, **changes: Any) -> bytes:
    mission = changes.pop("mission", scenarios.mission())
    by = changes.pop("by", "operator-1")
    fields = {
        "verb": verb,
        "mid": mission.mid,
        "version": mission.version,
        "mission": digest_of(Tag.MISSION, mission),
        "nonce": b64(nonce.encode()),
        "expires_ms": scenarios.START_MS + 3_600_000,
        "issued_ms": scenarios.START_MS,
    }
    value = Command(**{**fields, **changes})
    return sign_object(value, Tag.COMMAND, scenarios.folder_signer(scenarios.trust_folder(), by))


# the lease


@pytest.mark.parametrize(
    ("faults", "reason"),
    [
        (Faults(drift_to="office-2"), "OUTSIDE_REGIONS"),
        (Faults(localization_stops_ms=3_000), "STATE_STALE"),
        (Faults(estimator_dies_ms=3_000), "STATE_STALE"),
        (Faults(overspeed_permille=1_500), "BOUND_EXCEEDED"),
    ],
)
def test_a_robot_that_breaks_its_lease_is_stopped(faults: Faults, reason: str) -> None:
    sim = ready(faults=faults)
    report = scenarios.propose(sim, GO)
    assert report.outcome is Outcome.ABORTED
    assert reason in [str(finding.reason) for finding in report.reasons]
    assert sim.robot.state.speed_mm_s == 0
    assert records(sim, "outcome")[-1].link.decision == "aborted"
    assert reason in records(sim, "outcome")[-1].open["reasons"]


def test_a_revocation_in_mid_motion_stops_the_robot() -> None:
    sim = ready()
    pause = sim.robot.pause

    def revoke_after_a_while(duration_ms: int) -> None:
        pause(duration_ms)
        if sim.robot.elapsed_ms == 2_000:
            sim.gate.management.command(order(Verb.REVOKE, "mid"))

    sim.robot.pause = revoke_after_a_while
    report = scenarios.propose(sim, GO)
    assert report.outcome is Outcome.ABORTED
    assert [str(f.reason) for f in report.reasons] == ["REVOKED"]
    assert sim.robot.elapsed_ms <= 2_200


def test_the_end_of_the_mission_in_mid_motion_stops_the_robot() -> None:
    sim = ready()
    sim.robot.pause(25 * 60_000 - 5_000)
    report = scenarios.propose(sim, GO)
    assert report.outcome is Outcome.ABORTED
    assert "EXPIRED" in [str(f.reason) for f in report.reasons]


def test_a_lease_ends_after_its_longest_time() -> None:
    grants = [
        {**g, "max": "5 s"} if g["id"] == "go-to-pharmacy" else g
        for g in scenarios.draft()["grants"]
    ]
    mission = scenarios.mission(grants=grants)
    sim = scenarios.simulation()
    sim.gate.management.activate(scenarios.token(mission))
    report = scenarios.propose(sim, GO)
    assert [str(f.reason) for f in report.reasons] == ["LEASE_ENDED"]


def test_a_failed_grasp_uses_its_start_and_is_no_success() -> None:
    sim = scenarios.simulation(start=scenarios.world("pharmacy"), faults=Faults(grasp_fails=True))
    sim.gate.management.activate(scenarios.token())
    pick = scenarios.Action(
        type="pick",
        tool="gripper",
        object="package-p1",
        source="pharmacy",
        params={"force_mn": 9_000},
    )
    for _ in range(2):
        assert scenarios.propose(sim, pick).outcome is Outcome.FAILED
    third = scenarios.propose(sim, pick)
    assert [str(r) for r in third.judged.decision.reasons] == ["STARTS_EXHAUSTED"]


def test_a_controller_that_does_not_begin_gives_the_start_back() -> None:
    sim = ready(faults=Faults(controller_refuses=True))
    report = scenarios.propose(sim, GO)
    assert report.outcome is Outcome.NOT_STARTED
    assert [str(f.reason) for f in report.reasons] == ["CONTROLLER_FAILED"]
    standing = sim.gate.management.standing("deliver-p1")
    assert (standing.uses["go-to-pharmacy"].starts, standing.actions) == (0, 0)
    assert standing.open == ()
    assert standing.spent.motion_ms == 0


def test_state_that_turns_bad_between_commit_and_dispatch_is_not_started() -> None:
    sim = ready()
    inputs = sim.gate.enforcer.inputs
    first = inputs.refresh
    calls = []

    def refresh() -> Any:
        calls.append(1)
        if len(calls) == 3:  # recovery, decision, the look before dispatch
            sim.robot.state = scenarios.world("office-1")
            sim.robot.pause(50)
        return first()

    inputs.refresh = refresh
    report = scenarios.propose(sim, GO)
    assert report.outcome is Outcome.NOT_STARTED
    assert sim.robot.trace == []


# state that is not the estimator's


def bad_states(sim: Any) -> dict[str, tuple[bytes, str]]:
    """Return snapshots that must not be taken in, and why."""
    robot = sim.robot
    fresh = snapshot_of(robot.state, robot=robot.rid, epoch=1, seq=50)
    old = snapshot_of(robot.state, robot=robot.rid, epoch=1, seq=1)
    folder = scenarios.trust_folder()
    estimator = scenarios.folder_signer(folder, f"estimator-{scenarios.RID}")
    operator = scenarios.folder_signer(folder, "operator-1")
    good = sign_object(fresh, Tag.STATE, estimator)
    return {
        "unsigned": (msgspec.json.encode(fresh), "MALFORMED"),
        "of another role": (sign_object(fresh, Tag.STATE, operator), "ROLE_DENIED"),
        "replayed": (sign_object(old, Tag.STATE, estimator), "STATE_REPLAYED"),
        "another kind": (good.replace(b"state/1", b"site/1"), "WRONG_KIND"),
        "cut": (good[:-9], "MALFORMED"),
    }


@pytest.mark.parametrize("kind", ["unsigned", "of another role", "replayed", "another kind", "cut"])
def test_a_snapshot_that_is_not_the_estimators_is_recorded_and_not_taken_in(kind: str) -> None:
    sim = ready()
    sim.robot.pause(100)
    sim.gate.enforcer.inputs.refresh()
    before = sim.gate.enforcer.inputs.newest
    data, reason = bad_states(sim)[kind]
    sim.robot.latest = lambda: data
    sim.gate.enforcer.inputs.refresh()
    assert sim.gate.enforcer.inputs.newest is before
    assert [r.open["reasons"] for r in records(sim, "intake")] == [[reason]]
    sim.robot.pause(5_000)
    report = scenarios.propose(sim, GO)
    assert "STATE_STALE" in [str(r) for r in report.judged.decision.reasons]
    assert sim.robot.trace == []


def test_a_foreign_snapshot_satisfies_nothing() -> None:
    sim = ready()
    foreign = snapshot_of(sim.robot.state, robot=scenarios.OTHER, epoch=9, seq=1)
    estimator = scenarios.folder_signer(scenarios.trust_folder(), f"estimator-{scenarios.RID}")
    data = sign_object(foreign, Tag.STATE, estimator)
    sim.robot.latest = lambda: data
    before = sim.gate.enforcer.inputs.refresh()
    assert sim.gate.ledger.snapshot != (9, 1)  # nor does it shut the robot's own estimator out
    assert before is None or before.snapshot.robot == scenarios.RID
    assert records(sim, "intake")[-1].open["reasons"] == ["STATE_FOREIGN"]


# both gates


def test_what_is_authorized_but_unsafe_is_refused_and_uses_nothing() -> None:
    near = msgspec.structs.replace(scenarios.world(), human_distance_mm=500)
    sim = ready(start=near)
    report = scenarios.propose(sim, GO)
    assert report.outcome is None
    assert report.judged.decision.verdict == "accept"
    assert not report.judged.safety.safe
    assert records(sim, "decision")[-1].open["safety"]["hazards"] == ["HUMAN_PROXIMITY"]
    standing = sim.gate.management.standing("deliver-p1")
    assert (standing.actions, standing.uses) == (0, {})


def test_a_repair_is_a_new_proposal_and_may_leave_the_mission() -> None:
    near = msgspec.structs.replace(scenarios.world(), human_distance_mm=500)
    sim = ready(start=near)
    repaired = scenarios.propose(sim, GO).judged.safety.repair
    assert scenarios.propose(sim, repaired).outcome is Outcome.SUCCEEDED
    fast = scenarios.draft()
    fast["grants"] = [
        {**g, "limits": {"speed_mm_s": ["0.4 m/s", "0.8 m/s"]}}
        if g["id"] == "go-to-pharmacy"
        else g
        for g in fast["grants"]
    ]
    sim = scenarios.simulation(start=near)
    sim.gate.management.activate(scenarios.token(scenarios.mission(grants=fast["grants"])))
    repaired = scenarios.propose(sim, GO).judged.safety.repair
    again = scenarios.propose(sim, repaired)
    assert [str(r) for r in again.judged.decision.reasons] == ["PARAMETER_OUT_OF_BOUNDS"]


def test_the_log_says_that_safety_was_not_asked_about_what_was_unauthorized() -> None:
    sim = ready()
    scenarios.propose(sim, scenarios.navigate("dock", "office-1"))
    assert records(sim, "decision")[-1].open["safety"] == "not evaluated"


# stop


def test_a_stop_needs_no_mission_and_is_recorded() -> None:
    sim = scenarios.simulation()
    sim.gate.enforcer.stop(by="passer-by", is_planner=False)
    assert sim.robot.stops == 1
    assert records(sim, "stop")[0].open == {"by": "passer-by", "planner": False}


def test_planner_stops_are_counted_and_raise_an_alert() -> None:
    sim = ready()
    for _ in range(4):
        sim.gate.enforcer.stop(by="planner", is_planner=True)
    assert sim.gate.management.standing("deliver-p1").planner_stops == 4
    assert [r.open["what"] for r in records(sim, "alert")] == ["planner stops"]
    assert sim.robot.stops == 4


def test_a_planner_that_stops_without_a_mission_is_obeyed() -> None:
    sim = scenarios.simulation()
    sim.gate.enforcer.stop(by="planner", is_planner=True)
    assert sim.robot.stops == 1


def test_a_stop_is_carried_out_even_when_nothing_can_be_recorded() -> None:
    sim = ready()
    sim.gate.ledger.store.close()
    sim.gate.enforcer.stop(by="operator", is_planner=False)
    assert sim.robot.stops == 1


# faults of ours and of the world


def test_a_fault_in_a_gate_is_a_refusal_and_one_record() -> None:
    class Broken:
        def assess(self, *_: Any) -> Any:
            raise ZeroDivisionError

    sim = ready()
    sim.gate.enforcer._safety = Broken()
    report = scenarios.propose(sim, GO)
    assert report.refusal.reason is Reason.INTERNAL_FAULT
    assert sim.robot.trace == []
    assert [r.open["reasons"] for r in records(sim, "refusal")] == [["INTERNAL_FAULT"]]
    assert sim.gate.management.standing("deliver-p1").actions == 0


def test_a_store_that_is_gone_refuses_and_nothing_moves() -> None:
    sim = ready()
    sim.gate.ledger.store.close()
    report = scenarios.propose(sim, GO)
    assert report.refusal.reason is Reason.STORE_UNAVAILABLE
    assert report.seq is None
    assert sim.robot.trace == []


def test_an_outcome_that_cannot_be_recorded_leaves_the_release_open(tmp_path: Path) -> None:
    sim = ready()
    run, count = sim.gate.ledger.store.run, []

    def fails_at_the_outcome(job: Any, **more: Any) -> Any:
        count.append(1)
        if len(count) == 3:  # recovery, decision, outcome
            raise StoreError("gone")
        return run(job, **more)

    sim.gate.ledger.store.run = fails_at_the_outcome
    report = scenarios.propose(sim, GO)
    assert report.outcome is Outcome.SUCCEEDED
    assert not report.outcome_recorded
    sim.gate.ledger.store.run = run
    standing = sim.gate.management.standing("deliver-p1")
    assert len(standing.open) == 1
    tickets = sim.gate.management.recover()
    assert tickets == (standing.open[0].ticket,)
    assert sim.gate.management.standing("deliver-p1").status == "suspended"
    settle = order(Verb.RESOLVE, "r", ticket=tickets[0], outcome=Outcome.SUCCEEDED)
    assert sim.gate.management.command(settle).uses["go-to-pharmacy"].successes == 1
    assert (
        sim.gate.management.command(
            order(Verb.RESUME, "s", issued_ms=sim.robot.wall_ms() + 1)
        ).status
        == "active"
    )
    assert sim.gate.management.recover() == ()


def test_a_postcondition_settles_an_unknown_outcome() -> None:
    sim = ready(start=scenarios.world("pharmacy"))
    pick = scenarios.Action(
        type="pick",
        tool="gripper",
        object="package-p1",
        source="pharmacy",
        params={"force_mn": 9_000},
    )
    run, count = sim.gate.ledger.store.run, []

    def fails_at_the_outcome(job: Any, **more: Any) -> Any:
        count.append(1)
        if len(count) == 3:  # recovery, decision, outcome
            raise StoreError("gone")
        return run(job, **more)

    sim.gate.ledger.store.run = fails_at_the_outcome
    assert scenarios.propose(sim, pick).outcome is Outcome.SUCCEEDED
    sim.gate.ledger.store.run = run
    sim.robot.pause(100)
    assert sim.gate.management.recover() == ()
    standing = sim.gate.management.standing("deliver-p1")
    assert standing.uses["pick-p1"].successes == 1
    assert standing.status == "active"


def test_resolving_needs_a_release_and_an_outcome() -> None:
    sim = ready()
    for changes in (
        {},
        {"ticket": "A" * 43},
        {"ticket": "A" * 43, "outcome": Outcome.UNKNOWN},
        {"ticket": "A" * 43, "outcome": Outcome.FAILED},
    ):
        with pytest.raises(AuthGuardError, match="TRANSITION_REFUSED"):
            sim.gate.management.command(order(Verb.RESOLVE, f"n{len(changes)}{changes}", **changes))


# activation and updates


def second(mission: Any, **changes: Any) -> Any:
    base = {"version": 2, "supersedes": digest_of(Tag.MISSION, mission), "nonce": "B" * 22}
    return msgspec.structs.replace(mission, **{**base, **changes})


def test_an_update_supersedes_and_carries_what_was_used() -> None:
    sim, mission = ready(), scenarios.mission()
    scenarios.propose(sim, GO)
    standing = sim.gate.management.activate(scenarios.token(second(mission)))
    assert (standing.version, standing.status) == (2, "active")
    assert standing.uses["go-to-pharmacy"].successes == 1


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"version": 3}, "SUPERSEDED"),
        ({"supersedes": "A" * 43}, "SUPERSEDED"),
        ({"version": 1, "supersedes": None}, "TRANSITION_REFUSED"),
        ({"issuer": "operator-2"}, "ROLE_DENIED"),
        ({"rid": "lifter-1"}, "ROBOT_MISMATCH"),
        ({"profile": "A" * 43}, "PROFILE_MISMATCH"),
        ({"site": "A" * 43}, "SITE_MISMATCH"),
        ({"mid": "another"}, "TRANSITION_REFUSED"),
        ({"expiry": "2020-01-02T00:00:00Z", "not_before": "2020-01-01T00:00:00Z"}, "EXPIRED"),
    ],
)
def test_an_update_that_does_not_fit_changes_nothing(changes: dict[str, Any], reason: str) -> None:
    sim, mission = ready(), scenarios.mission()
    before = sim.gate.management.standing("deliver-p1")
    token = scenarios.token(second(mission, **changes), by=changes.get("issuer", "operator-1"))
    with pytest.raises(AuthGuardError, match=reason):
        sim.gate.management.activate(token)
    assert sim.gate.management.standing("deliver-p1") == before


def test_an_update_may_not_forget_what_was_used() -> None:
    sim, mission = ready(), scenarios.mission()
    scenarios.propose(sim, GO)
    fewer = tuple(
        msgspec.structs.replace(g, alternatives=g.alternatives[:1]) for g in mission.actions
    )
    with pytest.raises(AuthGuardError, match="TRANSITION_REFUSED"):
        sim.gate.management.activate(scenarios.token(second(mission, actions=fewer)))


def test_a_first_version_is_needed_first() -> None:
    sim, mission = scenarios.simulation(), scenarios.mission()
    with pytest.raises(AuthGuardError, match="MISSION_UNKNOWN"):
        sim.gate.management.activate(scenarios.token(second(mission)))


def test_a_completed_or_closing_mission_is_not_updated() -> None:
    sim, mission = ready(), scenarios.mission()
    sim.gate.management.command(order(Verb.COMPLETE, "done"))
    with pytest.raises(AuthGuardError, match="TRANSITION_REFUSED"):
        sim.gate.management.activate(scenarios.token(second(mission)))
    with pytest.raises(AuthGuardError, match="MISSION_COMPLETED"):
        sim.gate.management.activate(scenarios.token(mission))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"expires_ms": scenarios.START_MS - 1}, "EXPIRED"),
        ({"mid": "another"}, "MISSION_UNKNOWN"),
        ({"mission_digest": "A" * 43}, "MISSION_UNKNOWN"),
        ({"by": "supervisor-1"}, "ROLE_DENIED"),
    ],
)
def test_a_command_that_does_not_fit_changes_nothing(changes: dict[str, Any], reason: str) -> None:
    sim = ready()
    changes = {("mission_" if k == "x" else k): v for k, v in changes.items()}
    digest = changes.pop("mission_digest", None)
    token = order(Verb.SUSPEND, "n", **changes)
    if digest is not None:
        value = Command(
            verb=Verb.SUSPEND,
            mid="deliver-p1",
            version=1,
            mission=digest,
            nonce="AA",
            expires_ms=scenarios.START_MS + 10**6,
        )
        signer = scenarios.folder_signer(scenarios.trust_folder(), "operator-1")
        token = sign_object(value, Tag.COMMAND, signer)
    with pytest.raises(AuthGuardError, match=reason):
        sim.gate.management.command(token)
    assert sim.gate.management.standing("deliver-p1").status == "active"


def test_an_order_that_the_life_cycle_does_not_know_is_refused() -> None:
    sim = ready()
    with pytest.raises(AuthGuardError, match="TRANSITION_REFUSED"):
        sim.gate.management.command(order(Verb.RESUME, "r", issued_ms=sim.robot.wall_ms() + 1))


@pytest.mark.parametrize(
    ("changes", "by", "reason"),
    [
        ({"mid": "another"}, "operator-1", "MISSION_UNKNOWN"),
        ({"expires_ms": 1}, "operator-1", "EXPIRED"),
        ({"grant": "nothing"}, "operator-1", "SCHEMA_INVALID"),
        ({"row": 9}, "operator-1", "SCHEMA_INVALID"),
        ({}, "operator-2", "ROLE_DENIED"),
        ({"grant": "go-to-101"}, "operator-1", "ROLE_DENIED"),
    ],
)
def test_a_selection_that_does_not_fit_changes_nothing(
    changes: dict[str, Any], by: str, reason: str
) -> None:
    sim, mission = ready(), scenarios.mission()
    fields = {
        "mid": mission.mid,
        "version": 1,
        "mission": digest_of(Tag.MISSION, mission),
        "grant": "pick-p1",
        "row": 0,
        "nonce": "AA",
        "expires_ms": scenarios.START_MS + 10**6,
        "issued_ms": scenarios.START_MS,
    }
    value = Selection(**{**fields, **changes})
    token = sign_object(value, Tag.SELECTION, scenarios.folder_signer(scenarios.trust_folder(), by))
    with pytest.raises(AuthGuardError, match=reason):
        sim.gate.management.select(token)
    assert sim.gate.management.standing("deliver-p1").selected == {}


# approvals


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return make_bench(tmp_path_factory.mktemp("bench") / "trust")


def outcome(scene: BenchScene) -> list[str]:
    report = propose(scene)[-1]
    return [str(r) for r in report.judged.decision.reasons]


def test_a_denial_outweighs_approvals_and_closes_the_request(bench: Any) -> None:
    scene = restricted(bench)
    assert outcome(scene) == ["APPROVAL_REQUIRED"]
    approve(bench, scene, "supervisor-1", "supervisor-2")
    approve(bench, scene, "safety-officer-1", verdict=ApprovalVerdict.DENY)
    assert outcome(scene) == ["APPROVAL_DENIED"]
    assert scene.standing().requests == {}
    assert outcome(scene) == ["APPROVAL_REQUIRED"]
    assert scene.standing().counter == 2


def test_the_same_question_is_asked_once(bench: Any) -> None:
    scene = restricted(bench)
    for _ in range(3):
        assert outcome(scene) == ["APPROVAL_REQUIRED"]
    assert (scene.standing().prompts, scene.standing().counter) == (1, 1)


def test_a_request_runs_out_and_old_answers_do_not_help_the_next(bench: Any) -> None:
    scene = restricted(bench)
    outcome(scene)
    approve(bench, scene, "supervisor-1", "supervisor-2")
    scene.sim.robot.pause(121_000)
    assert outcome(scene) == ["APPROVAL_TIMEOUT"]
    assert outcome(scene) == ["APPROVAL_REQUIRED"]


def test_an_approval_is_used_once(bench: Any) -> None:
    scene = restricted(bench)
    outcome(scene)
    approve(bench, scene, "supervisor-1", "supervisor-2")
    assert outcome(scene) == []
    assert scene.standing().requests == {}


def test_people_are_asked_no_more_often_than_the_mission_allows(bench: Any) -> None:
    scene = restricted(bench)
    seen = []
    for speed in (0.1, 0.2, 0.3, 0.4, 0.5, 0.6):
        from missionpair.bench import calls

        scene.plan = calls(("navigate_to", {"destination": "Isolation Room", "speed": speed}))
        seen.append(outcome(scene))
    assert seen[:5] == [["APPROVAL_REQUIRED"]] * 5
    assert seen[5] == ["BUDGET_EXCEEDED"]


def test_expiry_is_written_down_when_it_is_met() -> None:
    sim = ready()
    sim.robot.pause(26 * 60_000)
    report = scenarios.propose(sim, GO)
    assert "EXPIRED" in [str(r) for r in report.judged.decision.reasons]
    assert sim.gate.management.standing("deliver-p1").status == "expired"


def test_time_never_runs_backwards_and_a_late_clock_is_a_fault() -> None:
    sim = ready()
    scenarios.propose(sim, GO)
    before = sim.gate.ledger.now()
    sim.robot._start_ms -= 1_000
    assert sim.gate.ledger.now().utc_ms >= before.utc_ms
    sim.robot._start_ms -= 3_600_000
    report = scenarios.propose(sim, GO)
    assert report.refusal.reason is Reason.CLOCK_BEHIND
    assert records(sim, "refusal")[-1].open["reasons"] == ["CLOCK_BEHIND"]
    sim.gate.enforcer.stop(by="operator", is_planner=False)
    assert sim.robot.stops == 1


def test_a_safety_officer_may_suspend_a_mission_and_not_resume_it() -> None:
    sim = scenarios.simulation()
    sim.gate.management.activate(scenarios.token())
    sim.gate.management.command(order(Verb.SUSPEND, "1", by="safety-officer-1"))
    with pytest.raises(AuthGuardError, match="may not resume"):
        sim.gate.management.command(
            order(Verb.RESUME, "2", issued_ms=sim.robot.wall_ms() + 1, by="safety-officer-1")
        )
    assert sim.gate.management.standing("deliver-p1").status == "suspended"
    sim.gate.management.command(order(Verb.RESUME, "3", issued_ms=sim.robot.wall_ms() + 1))
    assert sim.gate.management.standing("deliver-p1").status == "active"


def test_an_operators_stop_suspends_until_a_signed_resume() -> None:
    sim = ready()
    sim.gate.enforcer.stop(by="operator", is_planner=False, suspends=True)
    report = scenarios.propose(sim, GO)
    assert [str(r) for r in report.judged.decision.reasons] == ["MISSION_SUSPENDED"]
    assert records(sim, "management")[-1].link.decision == "suspend"
    sim.gate.management.command(order(Verb.RESUME, "go-on", issued_ms=sim.robot.wall_ms() + 1))
    assert scenarios.propose(sim, GO).outcome is Outcome.SUCCEEDED
    idle = scenarios.simulation()
    idle.gate.enforcer.stop(by="operator", is_planner=False, suspends=True)
    assert idle.robot.stops == 1


def test_a_mission_is_not_resumed_while_nobody_knows_what_happened() -> None:
    sim = ready()
    run, count = sim.gate.ledger.store.run, []

    def fails_at_the_outcome(job: Any, **more: Any) -> Any:
        count.append(1)
        if len(count) == 3:
            raise StoreError("gone")
        return run(job, **more)

    sim.gate.ledger.store.run = fails_at_the_outcome
    scenarios.propose(sim, GO)
    sim.gate.ledger.store.run = run
    sim.gate.management.recover()
    with pytest.raises(AuthGuardError, match="TRANSITION_REFUSED"):
        sim.gate.management.command(
            order(Verb.RESUME, "too-soon", issued_ms=sim.robot.wall_ms() + 1)
        )


def test_a_gate_that_starts_recovers_before_its_first_decision(tmp_path: Path) -> None:
    sim = ready(store=tmp_path / "robot.db")
    run, count = sim.gate.ledger.store.run, []

    def dies_before_the_outcome(job: Any, **more: Any) -> Any:
        count.append(1)
        if len(count) == 3:
            raise StoreError("killed")
        return run(job, **more)

    sim.gate.ledger.store.run = dies_before_the_outcome
    scenarios.propose(sim, GO)
    sim.gate.close()
    again = scenarios.simulation(
        store=tmp_path / "robot.db",
        start=scenarios.world("pharmacy"),
        start_ms=scenarios.START_MS + 300_000,
    )
    pick = scenarios.Action(
        type="pick", tool="gripper", object="package-p1", source="pharmacy", params={"force_mn": 9}
    )
    report = scenarios.propose(again, pick)
    assert "MISSION_SUSPENDED" in [str(r) for r in report.judged.decision.reasons]
    again.gate.close()


@pytest.mark.parametrize("how", ["expired", "closed"])
def test_what_time_ended_does_not_stand_in_the_way_of_the_next_mission(how: str) -> None:
    sim = ready()
    if how == "closed":
        first = sim.gate.management.standing("deliver-p1")
        ending = msgspec.structs.replace(first, status="closing", closes_ms=scenarios.START_MS + 1)
        ending = msgspec.convert(msgspec.to_builtins(ending), type(first))
        sim.gate.ledger.run(lambda act: act.hold(ending))
    else:
        sim.robot.pause(26 * 60_000)
    sim.robot.pause(1_000)
    draft = scenarios.draft(mission="deliver-again", window={"for": "2 h"})
    mission = scenarios.mission(**draft)
    assert sim.gate.management.activate(scenarios.token(mission)).status == "active"
    ended = sim.gate.management.standing("deliver-p1").status
    assert ended == ("completed" if how == "closed" else "expired")


def test_a_choice_is_taken_in_once() -> None:
    sim, mission = ready(), scenarios.mission()
    value = Selection(
        mid=mission.mid,
        version=1,
        mission=digest_of(Tag.MISSION, mission),
        grant="pick-p1",
        row=0,
        nonce="AA",
        expires_ms=scenarios.START_MS + 10**6,
        issued_ms=scenarios.START_MS,
    )
    signer = scenarios.folder_signer(scenarios.trust_folder(), "operator-1")
    token = sign_object(value, Tag.SELECTION, signer)
    sim.gate.management.select(token)
    with pytest.raises(AuthGuardError, match="EXPIRED"):
        sim.gate.management.select(token)


def test_an_approver_who_was_revoked_since_does_not_count(bench: Any) -> None:
    scene = restricted(bench)
    outcome(scene)
    approve(bench, scene, "supervisor-1", "supervisor-2")
    inputs = scene.sim.gate.enforcer.inputs

    class Revoked:
        def verify(self, *_: Any, **__: Any) -> Any:
            raise AuthGuardError("revoked", reason=Reason.CERTIFICATE_REVOKED) from None

    from authguard_r.core.errors import AuthenticityError

    class Dead(Revoked):
        def verify(self, *_: Any, **__: Any) -> Any:
            raise AuthenticityError("revoked", reason=Reason.CERTIFICATE_REVOKED)

    standing = scene.standing()
    inputs._verifier = Dead()
    assert scene.sim.gate.ledger.run(lambda act: inputs.answers(act, standing)).approvals == ()


def test_an_old_snapshot_is_not_new_after_a_restart(tmp_path: Path) -> None:
    sim = ready(store=tmp_path / "robot.db")
    scenarios.propose(sim, GO)
    old = sim.gate.enforcer.inputs._held
    sim.gate.close()
    again = scenarios.simulation(store=tmp_path / "robot.db", start_ms=scenarios.START_MS + 300_000)
    again.robot.latest = lambda: old
    assert again.gate.enforcer.inputs.refresh() is None
    again.gate.close()


def test_a_certificate_that_ended_stops_the_decision() -> None:
    sim = ready()
    scenarios.propose(sim, scenarios.navigate("dock", "office-1"))
    kept = sim.gate.enforcer.inputs._verified
    for digest, verified in list(kept.items()):
        issuer = msgspec.structs.replace(verified.issuer, usable_until_ms=scenarios.START_MS - 1)
        kept[digest] = msgspec.structs.replace(verified, issuer=issuer)
    report = scenarios.propose(sim, GO)
    assert [str(r) for r in report.judged.decision.reasons] == ["CERTIFICATE_EXPIRED"]
    assert report.judged.decision.match is None
    assert records(sim, "decision")[-1].open["grant"] == "-"
    assert sim.robot.trace == []


def test_a_registry_entry_that_vanishes_under_way_is_no_recorded_outcome() -> None:
    sim = ready()
    pause = sim.robot.pause

    def lose_the_entry(duration_ms: int) -> None:
        pause(duration_ms)
        sim.gate.ledger.store._held.pop(("standing", "deliver-p1"), None)

    sim.robot.pause = lose_the_entry
    report = scenarios.propose(sim, GO)
    assert not report.outcome_recorded


def test_the_last_success_may_come_by_a_signed_word() -> None:
    grants = [
        {
            **{k: v for k, v in g.items() if k != "done_when"},
            "completes": g["id"] == "go-to-pharmacy",
        }
        for g in scenarios.draft()["grants"]
    ]
    mission = scenarios.mission(grants=grants, closing=None)
    sim = scenarios.simulation()
    sim.gate.management.activate(scenarios.token(mission))
    run, count = sim.gate.ledger.store.run, []

    def fails_at_the_outcome(job: Any, **more: Any) -> Any:
        count.append(1)
        if len(count) == 3:
            raise StoreError("gone")
        return run(job, **more)

    sim.gate.ledger.store.run = fails_at_the_outcome
    scenarios.propose(sim, GO)
    sim.gate.ledger.store.run = run
    (ticket,) = sim.gate.management.recover()
    said = order(Verb.RESOLVE, "a", mission=mission, ticket=ticket, outcome=Outcome.SUCCEEDED)
    assert sim.gate.management.command(said).status == "suspended"
    assert (
        sim.gate.management.command(
            order(Verb.RESUME, "b", issued_ms=sim.robot.wall_ms() + 1, mission=mission)
        ).status
        == "completed"
    )


@pytest.mark.parametrize(
    ("token", "reason"),
    [
        (b"junk", "MALFORMED"),
        (b"", "MALFORMED"),
        ("cut", "MALFORMED"),
        ("space", "NOT_CANONICAL"),
        ("supervisor", "ROLE_DENIED"),
        ("bit", "SIGNATURE_INVALID"),
        ("foreign", "ROBOT_MISMATCH"),
        ("profile", "PROFILE_MISMATCH"),
        ("site", "SITE_MISMATCH"),
        ("past", "EXPIRED"),
    ],
)
def test_a_bad_token_is_refused_with_one_record_and_nothing_changed(
    token: Any, reason: str
) -> None:
    sim, mission = scenarios.simulation(), scenarios.mission()
    good = scenarios.token(mission)
    past = {"not_before": "2020-01-01T00:00:00Z", "expiry": "2020-01-02T00:00:00Z"}
    made = {
        "cut": lambda: good[:-20],
        "space": lambda: good.replace(b'":', b'": ', 1),
        "supervisor": lambda: scenarios.token(mission, by="supervisor-1"),
        "bit": lambda: good.replace(b'"signature":"', b'"signature":"A', 1)[:-5] + good[-4:],
        "foreign": lambda: scenarios.token(msgspec.structs.replace(mission, rid="lifter-1")),
        "profile": lambda: scenarios.token(msgspec.structs.replace(mission, profile="A" * 43)),
        "site": lambda: scenarios.token(msgspec.structs.replace(mission, site="A" * 43)),
        "past": lambda: scenarios.token(msgspec.structs.replace(mission, **past)),
    }
    if token == "bit":
        other = scenarios.token(msgspec.structs.replace(mission, nonce="B" * 22))
        payload = good.split(b'"payload":')[1]
        data = other.split(b'"payload":')[0] + b'"payload":' + payload
    else:
        data = token if isinstance(token, bytes) else made[token]()
    before = len(sim.gate.ledger.store.rows())
    with pytest.raises(AuthGuardError) as refused:
        sim.gate.management.activate(data)
    assert str(refused.value.reason) == reason
    added = sim.gate.ledger.store.rows()[before:]
    assert [read_record(row.record, where="").open["reasons"] for row in added] == [[reason]]
    assert scenarios.propose(sim, GO).refusal.reason is Reason.NO_ACTIVE_MISSION


def test_a_mission_whose_token_is_gone_is_refused() -> None:
    sim = ready()
    sim.gate.enforcer.inputs.forget()
    held = sim.gate.ledger.store._held
    for key in [key for key in held if key[0] == "token"]:
        del held[key]
    report = scenarios.propose(sim, GO)
    assert report.refusal.reason is Reason.STORE_CORRUPT
    assert sim.robot.trace == []
