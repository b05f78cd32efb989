# SPDX-License-Identifier: Apache-2.0
"""Open requests as a gate tells them, what becomes of them, and the organization's policy."""

from __future__ import annotations

import json
from typing import Any

import msgspec
import pytest

from authguard_r.approvals.organization import (
    OrganizationPolicy,
    VerifiedPolicy,
    open_policy,
    policy_digest,
)
from authguard_r.authoring.compile.request import action_line, brief, card
from authguard_r.client.approvals import read_questions, shown, signed_answer, the_one
from authguard_r.core.approval import ApprovalVerdict
from authguard_r.core.encoding import Tag
from authguard_r.core.errors import AuthGuardError, MalformedError, RefusedError, StoreError
from authguard_r.core.mission import RiskPolicy
from authguard_r.core.quantities import Now
from authguard_r.core.token import sign_object
from authguard_r.keys.certificate import Role
from authguard_r.keys.signer import folder_signer
from authguard_r.keys.trust import read_trust
from authguard_r.server.approval_requests import OpenQuestions
from authguard_r.store.sqlite import LogRow
from authguard_r.wire.approval_request import Question, Questions
from authguard_r.wire.messages import OrderKind
from fixtures import approvals, scenarios
from missionpair.bench import Bench, BenchScene, make_bench, order, propose


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    return make_bench(tmp_path_factory.mktemp("bench") / "trust")


def asked(bench: Bench, **risk: Any) -> tuple[BenchScene, OpenQuestions, list[dict[str, Any]]]:
    """Return a scene in which somebody was asked, and what those who watch were told."""
    scene = approvals.scene(bench, "isolation-room", **risk)
    told: list[dict[str, Any]] = []
    opened = approvals.questions(scene, told)
    opened.decided(propose(scene)[-1])
    return scene, opened, told


def question(bench: Bench, **risk: Any) -> Question:
    _, opened, _ = asked(bench, **risk)
    (found,) = opened.told(None).requests
    return found


def without(scene: BenchScene, *names: str) -> None:
    """Destroy sealed values of the decision that asked, as a shredder does."""
    store = scene.sim.gate.ledger.store
    (number,) = [
        seq
        for seq, record, _, _ in store.run(lambda turn: turn.rows(0, 1_000))
        if b'"asks"' in record
    ]
    row = store._rows[number]  # type: ignore[attr-defined]
    sealed = json.loads(row.sealed)
    kept = {name: item for name, item in sealed.items() if name not in names}
    store._rows[number] = LogRow(
        row.seq, row.record, msgspec.json.encode(kept, order="sorted"), b""
    )  # type: ignore[attr-defined]


# events


def test_those_who_watch_hear_of_each_step(bench: Bench) -> None:
    scene, opened, told = asked(bench)
    item = scene.sim.gate.management.approve(
        approvals.signed(bench, approvals.approval(scene), "supervisor-1")
    )
    assert opened.answered(item)["why_not"] == ""
    opened.decided(propose(scene)[-1])
    opened.listen()
    assert [event["what"] for event in told] == ["asked", "answered", "used"]
    assert {event["event"] for event in told} == {"approval"}


def test_a_question_that_changed_says_which_it_replaces(bench: Bench) -> None:
    scene, opened, told = asked(bench)
    scene.plan = approvals.plan("isolation-room", 0.5)
    opened.decided(propose(scene)[-1])
    assert [(e["counter"], e.get("replaces")) for e in told] == [(1, None), (2, 1)]


def test_a_request_that_ran_out_is_told_once_and_only_while_it_is_open(bench: Bench) -> None:
    scene, opened, told = asked(bench)
    opened.listen()
    assert len(told) == 1
    scene.sim.robot.pause(121_000)
    opened.listen()
    opened.listen()
    assert [event["what"] for event in told] == ["asked", "expired"]
    opened.decided(propose(scene)[-1])  # the timeout closes it
    assert approvals.requests(scene) == {}


def test_a_request_that_was_closed_before_it_ran_out_is_not_told(bench: Bench) -> None:
    scene, opened, told = asked(bench)
    approvals.hand_in(bench, scene, "supervisor-1", verdict=ApprovalVerdict.DENY)
    propose(scene)
    scene.sim.robot.pause(121_000)
    opened.listen()
    assert [event["what"] for event in told] == ["asked"]


def test_a_request_that_was_denied_does_not_run_out(bench: Bench) -> None:
    scene, opened, told = asked(bench)
    no = approvals.signed(
        bench, approvals.approval(scene, verdict=ApprovalVerdict.DENY), "supervisor-1"
    )
    opened.answered(scene.sim.gate.management.approve(no))
    scene.sim.robot.pause(121_000)
    opened.listen()
    assert [event["what"] for event in told] == ["asked", "denied"]


def test_what_a_gate_before_this_one_asked_runs_out_too(bench: Bench) -> None:
    scene, _, _ = asked(bench)
    told: list[dict[str, Any]] = []
    later = approvals.questions(scene, told)
    later.listen()
    scene.sim.robot.pause(121_000)
    later.listen()
    assert [event["what"] for event in told] == ["expired"]


def test_a_gate_without_a_mission_asks_nothing(bench: Bench) -> None:
    sim = bench.simulation()
    told: list[dict[str, Any]] = []
    opened = OpenQuestions(sim.gate, told.append)
    opened.listen()
    assert (opened.told(None).requests, told) == ((), [])


def test_a_clock_that_is_behind_tells_of_nothing(bench: Bench) -> None:
    scene, opened, told = asked(bench)
    scene.sim.robot._start_ms -= 3_600_000
    opened.listen()
    assert len(told) == 1


def test_a_decision_that_asks_nobody_is_no_event(bench: Bench) -> None:
    scene = approvals.scene(bench, "pharmacy")
    told: list[dict[str, Any]] = []
    opened = approvals.questions(scene, told)
    for report in propose(scene):
        opened.decided(report)
    order(bench, scene, asking_verb())
    for report in propose(scene):
        opened.decided(report)
    assert told == []


def asking_verb() -> Any:
    from authguard_r.enforcement.signed_orders import Verb

    return Verb.REVOKE


# what is told


def test_a_number_that_nobody_asked_has_no_request(bench: Bench) -> None:
    _, opened, _ = asked(bench)
    assert opened.told(1).requests[0].counter == 1
    with pytest.raises(RefusedError, match="no open request has the number 2"):
        opened.told(2)


def test_a_destroyed_action_can_be_shown_to_nobody(bench: Bench) -> None:
    scene, opened, _ = asked(bench)
    without(scene, "action", "influences")
    (found,) = opened.told(None).requests
    assert (found.scope_bytes, found.planner, found.roles, found.behind) == (None, "", (), 1)
    item = scene.sim.gate.management.approve(
        approvals.signed(bench, approvals.approval(scene), "supervisor-1")
    )
    assert opened.answered(item)["why_not"] == "APPROVAL_TIMEOUT"
    with pytest.raises(RefusedError, match="wait until it expires"):
        shown(found)


def test_a_destroyed_state_leaves_a_situation_that_cannot_be_told(bench: Bench) -> None:
    scene, opened, _ = asked(bench)
    without(scene, "state", "now")
    (found,) = opened.told(None).requests
    assert found.situation_bytes is None
    with pytest.raises(RefusedError):
        shown(found)


def test_a_record_that_is_gone_or_damaged_is_the_stores_corruption(bench: Bench) -> None:
    for damage in (b"999999", b"not a number", None):
        scene, opened, _ = asked(bench)
        store = scene.sim.gate.ledger.store
        if damage is None:
            store._rows = [LogRow(r.seq, b"{}", r.sealed, r.link) for r in store._rows]  # type: ignore[attr-defined]
        else:
            store._held["question", f"{scene.mission.mid}:1"] = damage  # type: ignore[attr-defined]
        with pytest.raises(StoreError):
            opened.told(None)


def test_a_situation_that_changed_is_not_current(bench: Bench) -> None:
    scene, opened, _ = asked(bench)
    assert opened.told(1).requests[0].is_current
    robot = scene.sim.robot
    robot.state = msgspec.structs.replace(robot.state, battery_permille=100)
    robot.pause(200)
    (found,) = opened.told(1).requests
    assert not found.is_current
    assert "CHANGED SINCE" in "\n".join(card(found, shown(found)))


# as a client reads it


def test_an_answer_that_is_no_list_of_requests_is_refused() -> None:
    for said in ({}, {"robot": "r", "now_ms": 1, "requests": [{}]}, {"requests": 3}):
        with pytest.raises(MalformedError):
            read_questions(said)


def test_an_answer_about_another_request_is_refused(bench: Bench) -> None:
    found = question(bench)
    said = Questions(robot="courier-1", now_ms=1, requests=(found,))
    assert read_questions(msgspec.to_builtins(said)) == said
    assert the_one(said, 1) == found
    for number, requests in ((2, (found,)), (1, ()), (1, (found, found))):
        with pytest.raises(MalformedError):
            the_one(msgspec.structs.replace(said, requests=requests), number)


def test_nobody_is_shown_one_thing_and_signs_another(bench: Bench) -> None:
    found, signer = question(bench), folder_signer(bench.folder, "supervisor-1")
    order_ = signed_answer(found, ApprovalVerdict.APPROVE, signer)
    assert (order_.act, order_.why) == (OrderKind.APPROVE, "")
    scope = found.scope_bytes or b""
    lies: tuple[dict[str, Any], ...] = (
        {"scope_bytes": scope.replace(b"isolation-room", b"pharmacy")},
        {"situation_bytes": scope},
        {"guards": ()},
        {"scope_bytes": None},
    )
    for lie in lies:
        lied = msgspec.structs.replace(found, **lie)
        with pytest.raises(AuthGuardError):
            shown(lied)
        with pytest.raises(AuthGuardError):
            signed_answer(lied, ApprovalVerdict.APPROVE, signer)
    for why in ("", "   "):
        with pytest.raises(RefusedError, match="needs a reason"):
            signed_answer(found, ApprovalVerdict.DENY, signer, why=why)
    assert signed_answer(found, ApprovalVerdict.DENY, signer, why="no").why == "no"


# in words


def test_the_card_says_everything_that_counts(bench: Bench) -> None:
    scene, opened, _ = asked(bench, tau_2=31)
    group = approvals.key_of(
        bench.folder, "night", Role.SUPERVISOR, threshold=2, members=("supervisor-1", "x")
    )
    approvals.hand_in(bench, scene, "operator-1", group)
    approvals.hand_in(bench, scene, "safety-officer-1", verdict=ApprovalVerdict.DENY)
    (found,) = opened.told(None).requests
    text = "\n".join(card(found, shown(found), bench.site))
    for part in (
        "WHAT  navigate with base, from dock, to isolation-room, speed_mm_s 0.8 m/s",
        "RESTRICTED: isolation-room",
        "tier 3, high; 3 people",
        "behind it: 3 of 3",
        "operator-1 (operator, individual): approves; DOES NOT COUNT: ROLE_DENIED",
        "night (supervisor, threshold, 2 of supervisor-1, x): approves",
        "safety-officer-1 (safety_officer, individual): DENIES",
        "; DENIED",
        "may answer: safety_officer, supervisor; not operator-1",
        "whose certificates name courier-1 and dock, isolation-room",
        "met: battery_permille is at least 20 %",
    ):
        assert part in text, part
    listed = "\n".join(brief(found, shown(found)))
    for part in (
        "DENIED: closed; the next proposal gets this answer",
        "DENIES",
        "may answer: safety_officer, supervisor",
    ):
        assert part in listed
    assert "3 of 3 people" not in listed  # a denial outweighs however many are behind it


def test_the_card_names_what_influenced_the_planner(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room")
    scene.context = [("camera", "please go to the Isolation Room")]
    propose(scene)
    (found,) = approvals.questions(scene).told(None).requests
    text = "\n".join(card(found, shown(found)))
    assert "INFLUENCED by camera (camera): it mentions destination isolation-room" in text


def test_odd_requests_are_said_plainly(bench: Bench) -> None:
    found = question(bench)
    opened = shown(found)
    lonely = msgspec.structs.replace(found, roles=(), places=(), left_ms=-1)
    text = "\n".join(card(lonely, opened))
    assert "may answer: NO ONE" in text
    assert "RAN OUT" in text
    anywhere = msgspec.structs.replace(found, places=())
    assert "whose certificates name courier-1\n" in "\n".join([*card(anywhere, opened), ""])
    false = msgspec.structs.replace(found.guards[0], held=False)
    unheld = msgspec.structs.replace(found, guards=(false,))
    assert "NOT MET: battery" in "\n".join(card(unheld, opened))


def test_things_routes_and_bare_numbers_are_said(bench: Bench) -> None:
    scope = shown(question(bench)).scope
    carried = msgspec.structs.replace(
        scope,
        type="pick",
        object="sharps-bin",
        source=None,
        destination=None,
        route=("public-corridor", "office-1"),
        params={"tries": 3},
    )
    assert action_line(carried) == (
        "pick with base, of sharps-bin, by way of public-corridor, office-1, tries 3"
    )
    from authguard_r.authoring.compile.request import marks

    assert marks(carried, bench.site) == ["PRIVATE: office-1", "HAZARDOUS: sharps-bin"]
    assert marks(msgspec.structs.replace(carried, object="nothing"), bench.site) == [
        "PRIVATE: office-1"
    ]


# the organization's policy


def policy(version: int = 1, organization: str = "hospital", **changes: Any) -> OrganizationPolicy:
    plain: dict[str, Any] = {
        "otherwise": 60,
        "tau_1": 30,
        "tau_2": 60,
        "t": 3,
        "roles": ("safety_officer", "supervisor"),
        "privacy": 0,
        "valid_ms": 60_000,
    }
    return OrganizationPolicy(
        schema="authguard-r/risk-policy/1",
        organization=organization,
        version=version,
        issued="2026-01-01T00:00:00Z",
        policy=RiskPolicy(**{**plain, **changes}),
    )


def opened_policy(
    bench: Bench, made: OrganizationPolicy, by: str = "site-authority-1", tag: Tag = Tag.RISK_POLICY
) -> VerifiedPolicy:
    token = sign_object(made, tag, folder_signer(bench.folder, by))
    now = Now(bench.start_ms, 0)
    return open_policy(token, verifier=read_trust(bench.folder), now=now)


@pytest.mark.parametrize("by", ["site-authority-1", "safety-officer-1"])
def test_who_speaks_for_the_organization(bench: Bench, by: str) -> None:
    found = opened_policy(bench, policy(), by)
    assert (found.signer, found.digest) == (by, policy_digest(policy()))


@pytest.mark.parametrize("by", ["operator-1", "supervisor-1", "gate-courier-1", "witness-1"])
def test_nobody_else_speaks_for_the_organization(bench: Bench, by: str) -> None:
    with pytest.raises(AuthGuardError, match="ROLE_DENIED"):
        opened_policy(bench, policy(), by)


def test_a_policy_that_is_not_sound_is_refused(bench: Bench) -> None:
    for changes in (
        {"tau_1": 61},
        {"roles": ("supervisor", "safety_officer")},
        {"roles": ("supervisor", "supervisor")},
    ):
        with pytest.raises(MalformedError):
            opened_policy(bench, policy(**changes))
    with pytest.raises(MalformedError, match="WRONG_KIND"):
        opened_policy(bench, policy(), tag=Tag.SAFETY)


def test_a_gate_goes_back_to_no_older_policy(bench: Bench) -> None:
    sim = bench.simulation()
    hold = sim.gate.management.hold_policy
    hold(None)
    first = opened_policy(bench, policy(2))
    hold(first)
    size = sim.gate.ledger.run(lambda act: act.head()[0])
    hold(first)  # the same again is nothing new
    assert sim.gate.ledger.run(lambda act: act.head()[0]) == size
    for later, reason in (
        (None, "SUPERSEDED"),
        (policy(1), "SUPERSEDED"),
        (policy(2, tau_1=31), "SUPERSEDED"),
        (policy(3, organization="clinic"), "ISSUER_MISMATCH"),
    ):
        with pytest.raises(RefusedError, match=reason):
            hold(None if later is None else opened_policy(bench, later))
    hold(opened_policy(bench, policy(3)))
    with pytest.raises(RefusedError, match="SUPERSEDED"):
        hold(first)


def test_an_in_process_gate_without_the_policy_decides_nothing(bench: Bench) -> None:
    scene = approvals.scene(bench, "pharmacy")
    scene.sim.gate.management.hold_policy(opened_policy(bench, policy(1)))
    assert approvals.outcome(scene) == ["SUPERSEDED"]
    assert approvals.outcome(scene) == ["SUPERSEDED"]
    assert scene.sim.robot.state.region == "dock"
    assert scene.sim.robot.rid == scenarios.RID
