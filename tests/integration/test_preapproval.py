# SPDX-License-Identifier: Apache-2.0
"""Consent before anybody asks: narrow in mission, grant, rows, risk, number and time.

Source: section "Threshold Approval Cost". Every test asserts the state afterwards: what the
registry holds, and whether the robot moved.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from authguard_r.core.approval import ApprovalVerdict, PreApproval
from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.identifiers import Digest
from authguard_r.core.reasons import Reason
from authguard_r.core.token import sign_object
from authguard_r.keys.certificate import Role
from authguard_r.keys.signer import FileSigner
from fixtures import approvals
from missionpair.bench import Bench, BenchScene, make_bench, world

#: The isolation room's risk in the shipped mission, which asks one further person.
TO = "isolation-room"


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    return make_bench(tmp_path_factory.mktemp("bench") / "trust")


def consent(scene: BenchScene, **changes: Any) -> PreApproval:
    """Return what a supervisor would sign for every way of the grant, with something changed."""
    mission, now = scene.mission, scene.sim.robot.wall_ms()
    made = PreApproval(
        mid=mission.mid,
        version=mission.version,
        mission=digest_of(Tag.MISSION, mission),
        rid=mission.rid,
        grant=mission.actions[0].id,
        rows=tuple(range(len(mission.actions[0].alternatives))),
        most_risk=mission.risk_policy.tau_2 - 1,
        uses=2,
        expires_ms=now + 60_000,
        issued_ms=now,
    )
    return replace(made, **changes)


def hand_in(
    bench: Bench, scene: BenchScene, said: PreApproval, by: str | FileSigner = "supervisor-1"
) -> bytes:
    token = approvals.signed(bench, said, by, tag=Tag.PREAPPROVAL)  # type: ignore[arg-type]
    scene.sim.gate.management.select(token)
    return token


def moved(scene: BenchScene) -> bool:
    return scene.sim.robot.state.region != "dock"


def back(bench: Bench, scene: BenchScene) -> None:
    """Put the robot back to the dock, as a person would push it."""
    scene.sim.robot.state = world(bench, "dock")
    scene.sim.robot.pause(500)


def asks(scene: BenchScene) -> None:
    """Assert that a person is asked now, and nothing moves."""
    assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    assert not moved(scene)


def refused(
    bench: Bench, scene: BenchScene, said: PreApproval, by: str | FileSigner
) -> tuple[str, str]:
    """Hand in what is refused; return reason and place, and check that nothing came of it."""
    before = scene.standing()
    with pytest.raises(AuthGuardError) as error:
        hand_in(bench, scene, said, by)
    assert scene.standing() == before
    asks(scene)
    return str(error.value.reason), error.value.where


def test_a_low_risk_action_that_was_consented_to_asks_nobody(bench: Bench) -> None:
    scene = approvals.scene(bench, TO)
    said = consent(scene)
    hand_in(bench, scene, said)
    assert approvals.outcome(scene) == []
    assert moved(scene)
    decided = approvals.records(scene, "decision")[-1]["open"]
    assert (decided["required"], decided["preapproved"]) == (2, digest_of(Tag.PREAPPROVAL, said))
    assert "asks" not in decided
    (told,) = [
        r for r in approvals.records(scene, "management") if r["open"]["verb"] == "preapprove"
    ]
    assert told["open"]["by"] == "supervisor-1"
    assert told["open"]["preapproval"] == decided["preapproved"]


def test_each_release_uses_one_and_the_next_one_asks(bench: Bench) -> None:
    scene = approvals.scene(bench, TO)
    said = consent(scene, uses=1)
    hand_in(bench, scene, said)
    assert approvals.outcome(scene) == []
    standing = scene.standing()
    assert standing is not None
    assert standing.preapproved == {digest_of(Tag.PREAPPROVAL, said): 0}
    back(bench, scene)
    asks(scene)


def test_a_token_that_was_used_up_and_is_handed_in_again_gives_nothing(bench: Bench) -> None:
    scene = approvals.scene(bench, TO)
    token = hand_in(bench, scene, consent(scene, uses=1))
    assert approvals.outcome(scene) == []
    back(bench, scene)
    with pytest.raises(AuthGuardError) as error:
        scene.sim.gate.management.select(token)
    assert error.value.reason is Reason.ORDER_TOO_OLD
    asks(scene)


def test_another_row_than_the_ones_consented_to_asks(bench: Bench) -> None:
    scene = approvals.scene(bench, TO, "pharmacy")
    hand_in(bench, scene, consent(scene, rows=(1,)))
    asks(scene)


def test_a_riskier_action_than_consented_to_asks(bench: Bench) -> None:
    scene = approvals.scene(bench, TO)
    asked = approvals.outcome(scene)
    risk = approvals.records(scene, "decision")[-1]["open"]["risk"]
    hand_in(bench, scene, consent(scene, most_risk=risk - 1))
    assert approvals.outcome(scene) == asked == ["APPROVAL_REQUIRED"]
    hand_in(bench, scene, consent(scene, most_risk=risk, issued_ms=scene.sim.robot.wall_ms() + 1))
    assert approvals.outcome(scene) == []
    assert moved(scene)


def test_after_its_end_it_is_worth_nothing(bench: Bench) -> None:
    scene = approvals.scene(bench, TO)
    hand_in(bench, scene, consent(scene, expires_ms=scene.sim.robot.wall_ms() + 5_000))
    scene.sim.robot.pause(6_000)
    asks(scene)


def test_a_third_line_action_asks_whatever_was_consented_to(bench: Bench) -> None:
    """Where t is 2 as well, the line counts, not the number of people."""
    near = {"variable": "human_distance_mm", "lt": 2_000, "max_age": "1 s"}
    states = [{"guard": near, "weight": 500}]
    scene = approvals.scene(bench, TO, states=states, t=2)
    hand_in(bench, scene, consent(scene))
    assert approvals.outcome(scene) == []  # nobody is near
    back(bench, scene)
    scene.sim.robot.state = replace(scene.sim.robot.state, human_distance_mm=1_000)
    scene.sim.robot.pause(500)
    reasons = approvals.outcome(scene)
    assert reasons[-1] == "APPROVAL_REQUIRED"
    assert not moved(scene)


def test_withdrawn_by_its_signer_it_is_worth_nothing(bench: Bench) -> None:
    scene = approvals.scene(bench, TO)
    first = hand_in(bench, scene, consent(scene))
    later = scene.sim.robot.wall_ms() + 1
    hand_in(bench, scene, consent(scene, uses=0, issued_ms=later))
    standing = scene.standing()
    assert standing is not None
    assert standing.preapproved == {}
    asks(scene)
    with pytest.raises(AuthGuardError) as error:
        scene.sim.gate.management.select(first)
    assert error.value.reason is Reason.ORDER_TOO_OLD


def test_a_denial_withdraws_what_was_approved_in_advance(bench: Bench) -> None:
    """The attack: propose once more, or a little slower, after somebody denied."""
    scene = approvals.scene(bench, TO)
    asks(scene)
    hand_in(bench, scene, consent(scene))
    scene.sim.robot.pause(10)
    approvals.hand_in(bench, scene, "safety-officer-1", verdict=ApprovalVerdict.DENY)
    scene.plan = approvals.plan(TO, speed=0.7)
    asks(scene)
    scene.plan = approvals.plan(TO)
    asks(scene)
    old = consent(scene, issued_ms=scene.sim.robot.wall_ms() - 60_000)
    assert refused(bench, scene, old, "supervisor-2") == ("ORDER_TOO_OLD", "preapproval.issued_ms")
    scene.sim.robot.pause(10)
    hand_in(bench, scene, consent(scene))
    assert approvals.outcome(scene) == []
    assert moved(scene)


def test_while_an_action_of_the_grant_is_denied_nothing_approved_in_advance_counts(
    bench: Bench,
) -> None:
    scene = approvals.scene(bench, TO)
    asks(scene)
    approvals.hand_in(bench, scene, "safety-officer-1", verdict=ApprovalVerdict.DENY)
    scene.sim.robot.pause(10)
    hand_in(bench, scene, consent(scene))
    assert approvals.outcome(scene) == ["APPROVAL_DENIED"]
    assert not moved(scene)


def test_signed_by_a_clock_that_runs_ahead_it_is_refused(bench: Bench) -> None:
    """The attack: withdrawn or used up, it would be newer than anything signed since."""
    scene = approvals.scene(bench, TO)
    ahead = consent(scene, issued_ms=scene.sim.robot.wall_ms() + 10**10)
    found = refused(bench, scene, ahead, "supervisor-1")
    assert found == ("NOT_YET_VALID", "preapproval.issued_ms")


def test_an_issued_mission_takes_none(bench: Bench) -> None:
    scene = approvals.scene(bench, TO)
    sim = bench.simulation()
    sim.gate.management.issue(bench.sign(scene.mission))
    waiting = BenchScene(sim=sim, mission=scene.mission, plan=scene.plan)
    with pytest.raises(AuthGuardError) as error:
        hand_in(bench, waiting, consent(waiting))
    assert error.value.reason is Reason.MISSION_NOT_ACTIVE


def test_a_signer_revoked_since_then_does_not_count(bench: Bench) -> None:
    scene = approvals.scene(bench, TO)
    signer = approvals.key_of(bench.folder, "supervisor-7", Role.SUPERVISOR)
    hand_in(bench, scene, consent(scene), signer)
    approvals.revoke(bench.folder, scene, signer)
    asks(scene)


def test_it_dies_with_its_mission_version(bench: Bench) -> None:
    scene = approvals.scene(bench, TO)
    hand_in(bench, scene, consent(scene))
    old = scene.mission
    scene.mission = replace(old, version=2, supersedes=digest_of(Tag.MISSION, old), nonce="A" * 22)
    scene.sim.gate.management.activate(bench.sign(scene.mission))
    asks(scene)
    assert refused(bench, scene, replace(consent(scene), version=1), "supervisor-1") == (
        "MISSION_UNKNOWN",
        "mission",
    )


WRONG: dict[str, tuple[dict[str, Any], str, str]] = {
    "another robot": ({"rid": "lifter-1"}, "ROBOT_MISMATCH", "preapproval.rid"),
    "another mission": ({"mid": "other"}, "MISSION_UNKNOWN", "mission"),
    "another digest": ({"mission": Digest("A" * 43)}, "MISSION_UNKNOWN", "mission"),
    "no such grant": ({"grant": "fly"}, "ACTION_OUT_OF_SCOPE", "preapproval.grant"),
    "no such row": ({"rows": (0, 7)}, "SCHEMA_INVALID", "preapproval.rows"),
    "rows unsorted": ({"rows": (0, 0)}, "SCHEMA_INVALID", "preapproval.rows"),
    "more uses than starts": ({"uses": 6}, "VALUE_OUT_OF_RANGE", "preapproval.uses"),
    "over already": ({"expires_ms": 1}, "VALUE_OUT_OF_RANGE", "preapproval.expires_ms"),
    "beyond the mission": (
        {"expires_ms": 2**52},
        "VALUE_OUT_OF_RANGE",
        "preapproval.expires_ms",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wider_or_foreign_consent_is_refused_by_its_place(bench: Bench, name: str) -> None:
    changes, reason, where = WRONG[name]
    scene = approvals.scene(bench, TO)
    assert refused(bench, scene, consent(scene, **changes), "supervisor-1") == (reason, where)


def test_a_risk_above_the_second_line_is_refused(bench: Bench) -> None:
    """The attack: a consent to what is most risky, given once and reused."""
    scene = approvals.scene(bench, TO)
    said = consent(scene, most_risk=scene.mission.risk_policy.tau_2)
    found = refused(bench, scene, said, "supervisor-1")
    assert found == ("VALUE_OUT_OF_RANGE", "preapproval.most_risk")


def test_only_who_may_answer_may_consent(bench: Bench) -> None:
    scene = approvals.scene(bench, TO)
    elsewhere = approvals.key_of(
        bench.folder, "supervisor-8", Role.SUPERVISOR, regions=("pharmacy",)
    )
    for by, reason in (
        ("operator-1", "ROLE_DENIED"),
        (approvals.key_of(bench.folder, "operator-9", Role.OPERATOR), "ROLE_DENIED"),
        (elsewhere, "SIGNER_OUT_OF_SCOPE"),
        (approvals.key_of(bench.folder, "scheduler-9", Role.SCHEDULER), "ROLE_DENIED"),
    ):
        assert refused(bench, scene, consent(scene), by)[0] == reason


def test_the_issuer_is_no_second_person(bench: Bench) -> None:
    scene = approvals.scene(bench, TO, roles=["operator", "supervisor"])
    assert refused(bench, scene, consent(scene), "operator-1")[0] == "ISSUER_MISMATCH"


def test_a_consent_over_another_tag_is_none(bench: Bench, tmp_path: Path) -> None:
    del tmp_path
    scene = approvals.scene(bench, TO)
    signer = approvals.key_of(bench.folder, "supervisor-6", Role.SUPERVISOR)
    token = sign_object(consent(scene), Tag.SELECTION, signer)
    with pytest.raises(AuthGuardError):
        scene.sim.gate.management.select(token)
    asks(scene)
