# SPDX-License-Identifier: Apache-2.0
"""What went wrong elsewhere when people were asked; one test per row of the table."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.approvals import open_approval
from authguard_r.client.approvals import shown, signed_answer
from authguard_r.core.approval import ApprovalVerdict
from authguard_r.core.errors import AuthenticityError
from authguard_r.core.quantities import Now
from authguard_r.enforcement.json_views import told_json
from authguard_r.keys.certificate import Role
from authguard_r.keys.signer import folder_signer
from authguard_r.keys.trust import read_trust
from authguard_r.wire.disclosure import Disclosure
from fixtures import approvals
from missionpair.bench import Bench, BenchScene, make_bench, propose

WORDS = "zebra-quarantine-told-by-nurse"


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    return make_bench(tmp_path_factory.mktemp("bench") / "trust")


def test_l5_an_answer_is_somebodys_for_these_arguments_once_and_never_the_requesters(
    bench: Bench,
) -> None:
    scene = approvals.scene(bench, "isolation-room", roles=["operator", "supervisor"])
    approvals.outcome(scene)
    approvals.hand_in(bench, scene, "operator-1")  # the requester himself
    assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    token = approvals.signed(bench, approvals.approval(scene), "supervisor-1")
    scene.sim.gate.management.approve(token)
    scene.plan = approvals.plan("isolation-room", 0.5)  # other arguments
    assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    scene.plan = approvals.plan("isolation-room", 0.8)
    assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]  # the first question died
    scene.sim.gate.management.approve(token)
    assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    assert scene.sim.robot.state.region == "dock"


def test_l5_an_approvers_words_reach_the_log_and_no_planner(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    denied = approvals.approval(scene, verdict=ApprovalVerdict.DENY)
    scene.sim.gate.management.approve(approvals.signed(bench, denied, "supervisor-1"), why=WORDS)
    report = propose(scene)[-1]
    for level in Disclosure:
        assert WORDS not in json.dumps(msgspec.to_builtins(told_json(report, level)))
    rows = scene.sim.gate.ledger.peek(lambda turn: turn.rows(0, 1_000))
    assert [WORDS.encode() in row[2] for row in rows].count(True) == 1
    assert not any(WORDS.encode() in row[1] for row in rows)


def test_l5_a_timeout_is_no_denial(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    scene.sim.robot.pause(121_000)
    assert approvals.outcome(scene) == ["APPROVAL_TIMEOUT"]


def test_l6_one_question_however_often_it_is_proposed(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room")
    for _ in range(50):
        assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    assert scene.standing().prompts == 1  # type: ignore[union-attr]


def test_l20_what_is_shown_is_what_is_signed(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    (question,) = approvals.questions(scene).told(None).requests
    signer = folder_signer(bench.folder, "supervisor-1")
    order = signed_answer(question, ApprovalVerdict.APPROVE, signer)
    now = Now(bench.start_ms, 0)
    opened = open_approval(order.token, verifier=read_trust(bench.folder), now=now).approval
    assert (opened.scope, opened.situation) == (question.scope, question.situation)
    bytes_ = (question.scope_bytes or b"").replace(b"isolation-room", b"pharmacy")
    with pytest.raises(AuthenticityError, match="differs from the bytes to sign"):
        shown(msgspec.structs.replace(question, scope_bytes=bytes_))


def test_l32_the_same_two_people_are_no_three_whatever_they_sign_as(bench: Bench) -> None:
    """A group of two issues, and the same two approve: alone, and as another group."""
    two = ("supervisor-1", "supervisor-2")
    scene = approvals.scene_of_group(bench, *two, threshold=2, tau_2=31, t=3)
    assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    again = approvals.key_of(bench.folder, "night", Role.SUPERVISOR, threshold=2, members=two)
    approvals.hand_in(bench, scene, *two, again)
    assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    (question,) = approvals.questions(scene).told(None).requests
    assert (question.behind, question.required) == (1, 3)
    assert {answer.why_not for answer in question.answers} == {"ISSUER_MISMATCH"}
    approvals.hand_in(bench, scene, "safety-officer-1")
    assert approvals.outcome(scene) == []
    decided = approvals.records(scene, "decision")[-1]["open"]
    assert [item["by"] for item in decided["approvers"]] == ["safety-officer-1"]


@pytest.mark.parametrize("ends", ["revoked", pytest.param("over", marks=pytest.mark.complete)])
def test_l33_a_denial_closes_the_request_whatever_becomes_of_who_denied(
    tmp_path: Path, ends: str
) -> None:
    bench = make_bench(tmp_path / "trust")
    scene = approvals.scene(bench, "isolation-room", valid="30 h")
    approvals.outcome(scene)
    denier = approvals.key_of(bench.folder, "supervisor-7", Role.SUPERVISOR, days=1)
    approvals.hand_in(bench, scene, "supervisor-1")
    approvals.hand_in(bench, scene, denier, verdict=ApprovalVerdict.DENY)
    if ends == "revoked":
        approvals.revoke(bench.folder, scene, denier)
    else:
        scene.sim.robot.pause(25 * 3_600_000)
    approvals.hand_in(bench, scene, "supervisor-2")
    (question,) = approvals.questions(scene).told(None).requests
    assert (question.denied, [item.verdict for item in question.answers]) == (
        True,
        ["approve", "approve"],
    )
    assert approvals.outcome(scene)[-1] == "APPROVAL_DENIED"
    assert scene.sim.robot.state.region == "dock"
    answered = [r["open"] for r in approvals.records(scene, "management") if "counter" in r["open"]]
    assert [(r.get("closes"), r.get("why_not")) for r in answered] == [
        (None, None),
        (True, None),
        (None, "APPROVAL_DENIED"),
    ]


def test_l34_an_answer_to_what_is_over_says_so_and_is_logged_once(
    bench: Bench, tmp_path: Path
) -> None:
    mission = bench.mission(approvals.draft(bench, "isolation-room"))
    store = tmp_path / "robot.db"
    scene = BenchScene(
        sim=bench.simulation(store=store), mission=mission, plan=approvals.plan("isolation-room")
    )
    scene.sim.gate.management.activate(bench.sign(mission))
    approvals.outcome(scene)
    token = approvals.signed(bench, approvals.approval(scene), "supervisor-1")
    scene.sim.gate.management.approve(token)
    assert approvals.outcome(scene) == []

    def answers() -> list[tuple[str, Any]]:
        told = [r["open"] for r in approvals.records(scene, "management")]
        return [(r["by"], r.get("why_not")) for r in told if r["verb"] == "answer"]

    for start_ms in (0, 200_000, 400_000):
        if start_ms:
            scene.sim.gate.close()
            scene.sim = bench.simulation(store=store, start_ms=bench.start_ms + start_ms)
        for _ in range(3):
            item = scene.sim.gate.management.approve(token)
            assert approvals.questions(scene).answered(item)["why_not"] == "APPROVAL_TIMEOUT"
        assert answers() == [("supervisor-1", None), ("supervisor-1", "APPROVAL_TIMEOUT")]
    scene.sim.gate.close()
