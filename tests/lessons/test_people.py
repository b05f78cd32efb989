# SPDX-License-Identifier: Apache-2.0
"""What went wrong elsewhere when people were asked; one test per row of the table."""

from __future__ import annotations

import json

import msgspec
import pytest

from authguard_r.approvals import open_approval
from authguard_r.assembly import folder_signer
from authguard_r.client.questions import shown, signed_answer
from authguard_r.core.approval import Verdict
from authguard_r.core.errors import AuthenticityError
from authguard_r.core.quantities import Now
from authguard_r.keys.trust import read_trust
from authguard_r.shapes import Disclosure, told_json
from fixtures import approvals
from missionpair.bench import Bench, make_bench, propose

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
    denied = approvals.approval(scene, verdict=Verdict.DENY)
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
    order = signed_answer(question, Verdict.APPROVE, signer)
    now = Now(bench.start_ms, 0)
    opened = open_approval(order.token, verifier=read_trust(bench.folder), now=now).approval
    assert (opened.scope, opened.situation) == (question.scope, question.situation)
    bytes_ = (question.scope_bytes or b"").replace(b"isolation-room", b"pharmacy")
    with pytest.raises(AuthenticityError, match="not what would be signed"):
        shown(msgspec.structs.replace(question, scope_bytes=bytes_))
