# SPDX-License-Identifier: Apache-2.0
"""Who has to be asked, whose answer counts, and everything that is no answer.

Every test asserts the state afterwards: what the registry holds, and whether the robot moved.
"""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.approvals import answer
from authguard_r.audit.record import read_record
from authguard_r.core.action import Action
from authguard_r.core.approval import Approval, ApprovalVerdict
from authguard_r.core.encoding import Tag, b64, encode_fast, unb64
from authguard_r.core.errors import AuthGuardError, RefusedError, StoreError
from authguard_r.core.identifiers import GrantId
from authguard_r.core.reasons import Reason
from authguard_r.core.risk import rho
from authguard_r.core.standing import Outcome
from authguard_r.core.token import read_token, sign_object
from authguard_r.keys.certificate import Role
from authguard_r.keys.signer import folder_signer, open_key_file
from authguard_r.normalize import read_plan
from authguard_r.wire.gate_limits import LIMITS
from fixtures import approvals, scenarios, templates
from missionpair.bench import Bench, BenchScene, calls, make_bench, world
from missionpair.suite import at_dock, wide, with_grant


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    return make_bench(tmp_path_factory.mktemp("bench") / "trust")


def moved(scene: BenchScene) -> bool:
    return scene.sim.robot.state.region != "dock"


def used_up(scene: BenchScene) -> tuple[int, int]:
    """Starts used, and requests open."""
    standing = scene.standing()
    return standing.actions, len(standing.requests)


def refused(bench: Bench, scene: BenchScene, token: bytes) -> str:
    """Hand something in that is no answer; return why it was refused and check that nothing is."""
    before = scene.standing()
    with pytest.raises(AuthGuardError) as error:
        scene.sim.gate.management.approve(token)
    assert scene.standing() == before
    assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    assert not moved(scene)
    return str(error.value.reason)


def worthless(bench: Bench, scene: BenchScene, token: bytes) -> str:
    """Hand in an authentic answer that counts for nothing; return the code that says why."""
    item = scene.sim.gate.management.approve(token)
    why = approvals.questions(scene).answered(item)["why_not"]
    assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    assert not moved(scene)
    return str(why)


# how many are asked


def test_the_public_corridor_asks_one(bench: Bench) -> None:
    scene = approvals.scene(bench, "pharmacy")
    assert approvals.outcome(scene) == []
    assert moved(scene)
    decided = approvals.records(scene, "decision")[-1]["open"]
    assert (decided["required"], used_up(scene)) == (1, (1, 0))
    assert "approvers" not in decided


def test_a_restricted_area_asks_an_operator_and_a_supervisor(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room")
    assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    assert [r.required for r in approvals.requests(scene).values()] == [2]
    approvals.hand_in(bench, scene, "supervisor-1")
    assert approvals.outcome(scene) == []
    assert moved(scene)
    assert approvals.records(scene, "decision")[-1]["open"]["approvers"] == [
        {"by": "supervisor-1", "role": "supervisor", "kind": "individual", "verdict": "approve"}
    ]


def test_hazardous_material_asks_t_of_n(bench: Bench) -> None:
    rows = [{"object": "sharps-bin", "source": "station-102", "regions": ["station-102"]}]
    draft = with_grant(wide(bench), "pick-p1", rows=rows, guards=[], done_when=[])
    mission = bench.mission(draft)
    plan = calls(("pick_up", {"object": "Sharps Bin", "force": 20}))
    scene = BenchScene(
        sim=bench.simulation(state=world(bench, "station-102")), mission=mission, plan=plan
    )
    scene.sim.gate.management.activate(bench.sign(mission))
    assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    assert [r.required for r in approvals.requests(scene).values()] == [3]
    approvals.hand_in(bench, scene, "supervisor-1")
    assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    assert scene.sim.robot.state.holding is None
    approvals.hand_in(bench, scene, "safety-officer-1")
    assert approvals.outcome(scene) == []
    assert scene.sim.robot.state.holding == "sharps-bin"


def interlocked(bench: Bench, *to: str) -> BenchScene:
    """A person nearby is what the interlock watches: t people, unless attested state shows none."""
    near = {"variable": "human_distance_mm", "lt": 2_000, "max_age": "1 s"}
    return approvals.scene(bench, *to, states=[{"guard": near, "weight": 30}])


def somebody_comes(scene: BenchScene) -> None:
    robot = scene.sim.robot
    robot.state = msgspec.structs.replace(robot.state, human_distance_mm=1_500)
    robot.pause(200)  # until the estimator has seen it


def test_an_interlock_asks_t_of_n_while_it_is_open(bench: Bench) -> None:
    scene = interlocked(bench, "isolation-room")
    somebody_comes(scene)
    assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    assert [r.required for r in approvals.requests(scene).values()] == [3]
    approvals.hand_in(bench, scene, "supervisor-1", "supervisor-2")
    assert approvals.outcome(scene) == []


def test_an_old_approval_does_not_count_in_a_changed_state(bench: Bench) -> None:
    scene = interlocked(bench, "isolation-room")
    approvals.outcome(scene)
    approvals.hand_in(bench, scene, "supervisor-1", "supervisor-2")
    somebody_comes(scene)
    assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    standing = scene.standing()
    assert (standing.counter, standing.prompts, standing.actions) == (2, 2, 0)
    assert not moved(scene)


# what an answer is bound to


def test_an_approval_for_room_a_is_refused_in_room_b(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room", "office-1")
    approvals.outcome(scene)
    approvals.hand_in(bench, scene, "supervisor-1", "supervisor-2")
    scene.plan = approvals.plan("office-1")
    assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    assert not moved(scene)
    assert used_up(scene) == (0, 1)


def test_another_speed_is_another_question(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    approvals.hand_in(bench, scene, "supervisor-1")
    scene.plan = approvals.plan("isolation-room", 0.7)
    assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    assert scene.standing().counter == 2


def test_t_minus_one_stolen_keys_move_nothing(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room", tau_2=31, t=4)
    approvals.outcome(scene)
    for _ in range(3):  # the same two keys, as often as they like
        approvals.hand_in(bench, scene, "supervisor-1", "supervisor-2")
    assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    assert not moved(scene)
    assert used_up(scene) == (0, 1)


def test_the_missions_signature_never_covers_more_than_one(bench: Bench) -> None:
    """It is the issuer's one approval of a class of actions: whatever needs two needs another."""
    scene = approvals.scene(bench, "isolation-room")
    for _ in range(3):
        assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    assert not moved(scene)


@pytest.mark.parametrize("role", [Role.OPERATOR, Role.SUPERVISOR])
def test_the_issuer_never_counts_twice(bench: Bench, role: Role) -> None:
    roles = ["operator", "safety_officer", "supervisor"]
    scene = approvals.scene(bench, "isolation-room", roles=roles)
    approvals.outcome(scene)
    again = approvals.key_of(bench.folder, "operator-1", role)  # another key, the same person
    token = approvals.signed(bench, approvals.approval(scene), again)
    assert worthless(bench, scene, token) == "ISSUER_MISMATCH"


def test_one_key_under_two_names_is_one_person(bench: Bench) -> None:
    """The authority gave the issuer's key, and an approver's, a second name."""
    scene = approvals.scene(bench, "isolation-room", tau_2=31, t=3)
    approvals.outcome(scene)
    approvals.hand_in(bench, scene, "supervisor-1")
    own = approvals.approval(scene)
    for holder in ("operator-1", "supervisor-1"):
        (key,) = open_key_file(bench.folder / "keys" / f"{holder}.key.pem")
        shadow = approvals.key_of(bench.folder, "shadow", Role.SUPERVISOR, key=key)
        token = approvals.signed(bench, own, shadow)
        assert refused(bench, scene, token) == "ISSUER_MISMATCH"
    assert used_up(scene) == (0, 1)
    approvals.hand_in(bench, scene, "supervisor-2")
    assert approvals.outcome(scene) == []


def test_a_second_name_denies_like_any_other(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    approvals.hand_in(bench, scene, "supervisor-1")
    (key,) = open_key_file(bench.folder / "keys" / "operator-1.key.pem")
    shadow = approvals.key_of(bench.folder, "shadow", Role.SUPERVISOR, key=key)
    no = approvals.signed(bench, approvals.approval(scene, verdict=ApprovalVerdict.DENY), shadow)
    item = scene.sim.gate.management.approve(no, why="no")
    assert item.approver.id == "shadow"
    assert approvals.outcome(scene) == ["APPROVAL_DENIED"]
    assert not moved(scene)


def test_an_approval_binds_robot_and_mission_version(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    own = approvals.approval(scene)
    for changes, why in (
        ({"rid": "lifter-1"}, "ROBOT_MISMATCH"),
        ({"version": 2}, "SUPERSEDED"),
        ({"mission": b64(bytes(32))}, "SUPERSEDED"),
        ({"grant": "go-to-101"}, "ACTION_OUT_OF_SCOPE"),
        ({"scope": b64(bytes(32))}, "ACTION_OUT_OF_SCOPE"),
        ({"situation": b64(bytes(32))}, "GUARD_FALSE"),
        ({"expires_ms": 1}, "EXPIRED"),
        ({"counter": 2}, "APPROVAL_TIMEOUT"),
        ({"mid": "another"}, "APPROVAL_TIMEOUT"),
    ):
        token = approvals.signed(bench, msgspec.structs.replace(own, **changes), "supervisor-1")
        assert worthless(bench, scene, token) == why, changes


def test_approvals_die_with_the_version_that_they_were_for(bench: Bench) -> None:
    draft = approvals.draft(bench, "isolation-room")
    scene = at_dock(bench, draft, approvals.plan("isolation-room"))
    approvals.outcome(scene)
    approvals.hand_in(bench, scene, "supervisor-1")
    next_one = bench.mission({**draft, "version": 2, "supersedes": scene.digest})
    scene.sim.gate.management.activate(bench.sign(next_one))
    assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    assert scene.standing().counter == 2
    assert not moved(scene)


# who may answer


def test_the_wrong_role_is_no_answer(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    own = approvals.approval(scene)
    operator = approvals.key_of(bench.folder, "operator-2", Role.OPERATOR)
    assert worthless(bench, scene, approvals.signed(bench, own, operator)) == "ROLE_DENIED"
    for machine in ("gate-courier-1", "estimator-courier-1", "site-authority-1"):
        assert refused(bench, scene, approvals.signed(bench, own, machine)) == "ROLE_DENIED"


@pytest.mark.parametrize(
    "scope",
    [
        {"robots": ("lifter-1",), "regions": None},
        {"robots": None, "regions": ("dock",)},
        {"robots": (), "regions": ()},
    ],
)
def test_the_wrong_scope_is_no_answer(bench: Bench, scope: dict[str, Any]) -> None:
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    near = approvals.key_of(bench.folder, "supervisor-9", Role.SUPERVISOR, **scope)
    token = approvals.signed(bench, approvals.approval(scene), near)
    assert worthless(bench, scene, token) == "SIGNER_OUT_OF_SCOPE"


def test_a_scope_that_names_robot_and_regions_is_enough(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    near = approvals.key_of(
        bench.folder,
        "supervisor-9",
        Role.SUPERVISOR,
        robots=("courier-1",),
        regions=("dock", "isolation-room"),
    )
    approvals.hand_in(bench, scene, near)
    assert approvals.outcome(scene) == []


def test_a_group_counts_as_its_threshold_and_the_log_names_it(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room", tau_2=31)
    approvals.outcome(scene)
    members = ("supervisor-1", "supervisor-2", "supervisor-3")
    group = approvals.key_of(
        bench.folder, "night-shift", Role.SUPERVISOR, threshold=2, members=members
    )
    approvals.hand_in(bench, scene, group)
    (question,) = approvals.questions(scene).told(None).requests
    assert (question.behind, question.required, question.denied) == (3, 3, False)
    assert approvals.outcome(scene) == []
    named = {
        "by": "night-shift",
        "role": "supervisor",
        "kind": "threshold",
        "threshold": 2,
        "members": list(members),
    }
    decided = approvals.records(scene, "decision")[-1]["open"]
    assert decided["approvers"] == [{**named, "verdict": "approve"}]
    answered = [r["open"] for r in approvals.records(scene, "management") if "verdict" in r["open"]]
    assert answered == [{"verb": "answer", **named, "verdict": "approve", "counter": 1}]


def test_a_groups_members_are_not_counted_beside_it(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room", tau_2=31, t=4)
    approvals.outcome(scene)
    group = approvals.key_of(
        bench.folder,
        "night-shift",
        Role.SUPERVISOR,
        threshold=2,
        members=("supervisor-1", "supervisor-2"),
    )
    approvals.hand_in(bench, scene, group, "supervisor-1", "supervisor-2")
    assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    (question,) = approvals.questions(scene).told(None).requests
    assert question.behind == 3


def test_a_group_in_which_only_the_issuer_is_left_stands_for_nobody(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    group = approvals.key_of(
        bench.folder, "alone", Role.SUPERVISOR, threshold=1, members=("operator-1",)
    )
    token = approvals.signed(bench, approvals.approval(scene), group)
    assert worthless(bench, scene, token) == "ISSUER_MISMATCH"


# what is no answer at all


def test_truncated_and_malleated_answers_are_refused(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    good = approvals.signed(bench, approvals.approval(scene), "supervisor-1")
    token = read_token(good)
    (endorsed,) = token.endorsements
    raw = bytearray(unb64(endorsed.signature))
    raw[40] ^= 1
    order = (1 << 252) + 27742317777372353535851937790883648493
    high = (int.from_bytes(unb64(endorsed.signature)[32:], "little") + order) % (1 << 256)
    changed = {
        "truncated": good[: len(good) // 2],
        "empty": b"",
        "not JSON": b"approve",
        "a bit of the signature": _with(token, signature=b64(bytes(raw))),
        "the group order added": _with(
            token, signature=b64(unb64(endorsed.signature)[:32] + high.to_bytes(32, "little"))
        ),
        "a short signature": _with(token, signature=endorsed.signature[:-4]),
        "another payload": msgspec.json.encode(
            msgspec.structs.replace(token, payload=b64(b"{}")), order="sorted"
        ),
    }
    for name, data in changed.items():
        assert refused(bench, scene, data) in {
            "MALFORMED",
            "NOT_CANONICAL",
            "SIGNATURE_INVALID",
        }, name


def _with(token: Any, **changes: Any) -> bytes:
    (endorsed,) = token.endorsements
    made = msgspec.structs.replace(endorsed, **changes)
    return msgspec.json.encode(msgspec.structs.replace(token, endorsements=(made,)), order="sorted")


def test_a_token_of_another_kind_is_no_answer(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    command = approvals.signed(bench, approvals.approval(scene), "supervisor-1", tag=Tag.SELECTION)
    assert refused(bench, scene, command) == "WRONG_KIND"
    renamed = command.replace(b"authguard-r/selection/1", b"authguard-r/approval/1")
    assert refused(bench, scene, renamed) == "SIGNATURE_INVALID"


def test_a_foreign_and_a_cross_signed_answer_are_refused(bench: Bench, tmp_path: Path) -> None:
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    other = make_bench(tmp_path / "other")
    own = approvals.approval(scene)
    foreign = approvals.signed(other, own, "supervisor-1")
    assert refused(bench, scene, foreign) == "CERTIFICATE_INVALID"
    # somebody else's authority below our root's name, and our leaf below theirs
    ours, theirs = read_token(approvals.signed(bench, own, "supervisor-1")), read_token(foreign)
    (mine,), (strange,) = ours.endorsements, theirs.endorsements
    for chain, signature in (
        ((strange.chain[0], mine.chain[1]), strange.signature),
        ((mine.chain[0], strange.chain[1]), mine.signature),
        (mine.chain, strange.signature),
    ):
        crossed = _with(ours, chain=chain, signature=signature)
        assert refused(bench, scene, crossed) in {"CERTIFICATE_INVALID", "SIGNATURE_INVALID"}
    both = msgspec.json.encode(
        msgspec.structs.replace(ours, endorsements=(mine, strange)), order="sorted"
    )
    assert refused(bench, scene, both) == "CERTIFICATE_INVALID"


def test_two_people_in_one_token_are_no_two_answers(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room", tau_2=31)
    approvals.outcome(scene)
    own = approvals.approval(scene)
    one, two = (read_token(approvals.signed(bench, own, f"supervisor-{n}")) for n in (1, 2))
    both = msgspec.structs.replace(one, endorsements=(*one.endorsements, *two.endorsements))
    token = msgspec.json.encode(both, order="sorted")
    assert refused(bench, scene, token) in {"ISSUER_MISMATCH", "SIGNATURE_INVALID"}


def test_a_duplicated_answer_is_one(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room", tau_2=31)
    approvals.outcome(scene)
    token = approvals.signed(bench, approvals.approval(scene), "supervisor-1")
    for data in (token, token, token.strip(), token):
        scene.sim.gate.management.approve(data)
    assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    (question,) = approvals.questions(scene).told(None).requests
    assert (question.behind, len(question.answers)) == (2, 1)


def test_one_principal_fills_no_store_with_answers_and_can_deny_all_the_same(bench: Bench) -> None:
    at = approvals.scene(bench, "isolation-room")
    approvals.outcome(at)
    first = approvals.approval(at)
    for less_ms in range(LIMITS.kept_answers):
        hand_in = approvals.signed(
            bench,
            msgspec.structs.replace(first, expires_ms=first.expires_ms - less_ms),
            "supervisor-1",
        )
        at.sim.gate.management.approve(hand_in)
        at.sim.gate.management.approve(hand_in)  # nothing new
    more = msgspec.structs.replace(first, expires_ms=first.expires_ms - LIMITS.kept_answers)
    with pytest.raises(RefusedError) as refused:
        at.sim.gate.management.approve(approvals.signed(bench, more, "supervisor-1"))
    assert (refused.value.reason, refused.value.where) == (Reason.BUSY, "approval")
    approvals.hand_in(bench, at, "supervisor-2")  # somebody else's answer is not in the way
    approvals.hand_in(bench, at, "supervisor-1", verdict=ApprovalVerdict.DENY)
    assert approvals.outcome(at) == ["APPROVAL_DENIED"]


@pytest.mark.complete
def test_an_expired_certificate_answers_nothing(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    short = approvals.key_of(bench.folder, "supervisor-8", Role.SUPERVISOR, days=1)
    token = approvals.signed(bench, approvals.approval(scene), short)
    scene.sim.gate.management.approve(token)
    scene.sim.robot.pause(25 * 3_600_000)
    assert "EXPIRED" in approvals.outcome(scene)
    with pytest.raises(AuthGuardError, match="EXPIRED"):
        scene.sim.gate.management.approve(token)
    assert not moved(scene)


# once


def test_a_replayed_answer_counts_for_no_second_action(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    token = approvals.signed(bench, approvals.approval(scene), "supervisor-1")
    scene.sim.gate.management.approve(token)
    assert approvals.outcome(scene) == []
    item = scene.sim.gate.management.approve(token)
    assert approvals.questions(scene).answered(item)["why_not"] == "APPROVAL_TIMEOUT"
    assert approvals.requests(scene) == {}
    assert scene.standing().actions == 1


def test_an_answer_is_used_once_across_restarts(bench: Bench, tmp_path: Path) -> None:
    draft = approvals.draft(bench, "isolation-room")
    mission = bench.mission(draft)
    store = tmp_path / "robot.db"
    scene = BenchScene(
        sim=bench.simulation(store=store), mission=mission, plan=approvals.plan("isolation-room")
    )
    scene.sim.gate.management.activate(bench.sign(mission))
    approvals.outcome(scene)
    token = approvals.signed(bench, approvals.approval(scene), "supervisor-1")
    scene.sim.gate.management.approve(token)
    scene.sim.gate.close()

    scene.sim = bench.simulation(store=store, start_ms=bench.start_ms + 2_000)
    (question,) = approvals.questions(scene).told(None).requests
    assert (question.behind, question.counter) == (2, 1)
    assert approvals.outcome(scene) == []
    scene.sim.gate.close()

    scene.sim = bench.simulation(store=store, start_ms=bench.start_ms + 200_000)
    scene.sim.gate.management.approve(token)
    assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    standing = scene.sim.gate.management.standing(mission.mid)
    assert (standing.actions, standing.counter) == (1, 2)
    scene.sim.gate.close()


def test_the_same_proposal_again_opens_no_second_request(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room")
    for _ in range(4):
        assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    assert (scene.standing().prompts, scene.standing().counter) == (1, 1)
    assert next(r["open"].get("asks") for r in approvals.records(scene, "decision")) == 1


def test_two_answers_at_once_both_count(bench: Bench, tmp_path: Path) -> None:
    draft = approvals.draft(bench, "isolation-room", tau_2=31)
    mission = bench.mission(draft)
    store = tmp_path / "robot.db"
    scene = BenchScene(
        sim=bench.simulation(store=store), mission=mission, plan=approvals.plan("isolation-room")
    )
    scene.sim.gate.management.activate(bench.sign(mission))
    approvals.outcome(scene)
    tokens = [approvals.signed(bench, approvals.approval(scene), f"supervisor-{n}") for n in (1, 2)]
    start, faults = threading.Barrier(2), []

    def answers(token: bytes) -> None:
        start.wait()
        try:
            scene.sim.gate.management.approve(token)
        except Exception as error:  # noqa: BLE001 - the test says which
            faults.append(error)

    threads = [threading.Thread(target=answers, args=(token,)) for token in tokens]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert faults == []
    assert approvals.outcome(scene) == []
    named = approvals.records(scene, "decision")[-1]["open"]["approvers"]
    assert sorted(item["by"] for item in named) == ["supervisor-1", "supervisor-2"]
    scene.sim.gate.close()


def test_a_denial_wins_whenever_it_comes(bench: Bench) -> None:
    for order in (("deny", "approve"), ("approve", "deny")):
        scene = approvals.scene(bench, "isolation-room")
        approvals.outcome(scene)
        for number, verdict in enumerate(order, 1):
            approvals.hand_in(
                bench, scene, f"supervisor-{number}", verdict=ApprovalVerdict(verdict)
            )
        (question,) = approvals.questions(scene).told(None).requests
        assert question.denied
        assert approvals.outcome(scene) == ["APPROVAL_DENIED"]
        assert not moved(scene)
        named = approvals.records(scene, "decision")[-1]["open"]["approvers"]
        assert {item["verdict"] for item in named} == {"approve", "deny"}


def test_nothing_helps_against_a_denial_that_came_in(tmp_path: Path) -> None:
    own, scene = revoking(tmp_path)
    approvals.hand_in(own, scene, "supervisor-1", verdict=ApprovalVerdict.DENY)
    assert approvals.requests(scene)[GrantId("go-to-pharmacy")].denied
    revoke(own, scene, "supervisor-1")
    yes = approvals.signed(own, approvals.approval(scene), "supervisor-2")
    item = scene.sim.gate.management.approve(yes)
    assert approvals.questions(scene).answered(item)["why_not"] == "APPROVAL_DENIED"
    (question,) = approvals.questions(scene).told(None).requests
    assert (question.denied, question.behind, question.answers[0].why_not) == (
        True,
        2,
        "APPROVAL_DENIED",
    )
    assert approvals.outcome(scene) == ["APPROVAL_DENIED"]
    assert "approvers" in approvals.records(scene, "decision")[-1]["open"]
    assert (used_up(scene), moved(scene)) == ((0, 0), False)
    assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]  # asked anew, as the budget allows
    assert scene.standing().counter == 2


def test_a_denial_is_told_after_the_request_ran_out(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    approvals.hand_in(bench, scene, "supervisor-1", verdict=ApprovalVerdict.DENY)
    scene.sim.robot.pause(121_000)
    assert approvals.outcome(scene) == ["APPROVAL_DENIED"]
    assert used_up(scene) == (0, 0)


def test_a_denial_of_before_requests_were_closed_denies_while_it_is_authentic(
    bench: Bench,
) -> None:
    """An older store has the denial's token and no mark; the same token again closes, recorded."""
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    token = approvals.signed(
        bench, approvals.approval(scene, verdict=ApprovalVerdict.DENY), "supervisor-1"
    )
    scene.sim.gate.management.approve(token)
    unmarked(scene)
    approvals.hand_in(bench, scene, "supervisor-2")
    assert approvals.outcome(scene) == ["APPROVAL_DENIED"]
    assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    again = approvals.signed(
        bench, approvals.approval(scene, verdict=ApprovalVerdict.DENY), "supervisor-1"
    )
    scene.sim.gate.management.approve(again)
    unmarked(scene)
    for _ in range(2):
        scene.sim.gate.management.approve(again)
    closing = [r["open"] for r in approvals.records(scene, "management") if "closes" in r["open"]]
    assert [told["counter"] for told in closing] == [1, 2, 2]
    assert approvals.outcome(scene) == ["APPROVAL_DENIED"]


def unmarked(scene: BenchScene) -> None:
    """Take the mark of a denial out of the store."""

    def job(act: Any) -> None:
        standing = act.standing(scene.mission.mid)
        requests = {
            grant: msgspec.structs.replace(request, denied=False)
            for grant, request in standing.requests.items()
        }
        act.hold(msgspec.structs.replace(standing, requests=requests))

    scene.sim.gate.ledger.run(job)


def test_a_denial_closes_a_request_whose_action_nobody_can_tell_any_more(bench: Bench) -> None:
    """The record of the question is gone: an approval is worth nothing then, a denial closes."""
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    store = scene.sim.gate.ledger.store
    store._held["question", f"{scene.mission.mid}:1"] = b"999999"  # type: ignore[attr-defined]
    far = approvals.key_of(bench.folder, "far", Role.SUPERVISOR, robots=("lifter-1",))
    approvals.hand_in(bench, scene, far, verdict=ApprovalVerdict.DENY)
    assert not approvals.requests(scene)[GrantId("go-to-pharmacy")].denied
    approvals.hand_in(bench, scene, "supervisor-1")
    told = approvals.records(scene, "management")[-1]["open"]
    assert told["why_not"] == "APPROVAL_TIMEOUT"
    approvals.hand_in(bench, scene, "supervisor-2", verdict=ApprovalVerdict.DENY)
    assert approvals.requests(scene)[GrantId("go-to-pharmacy")].denied
    assert approvals.outcome(scene) == ["APPROVAL_DENIED"]


def test_an_answer_while_nobody_stands_behind_the_mission_is_kept_and_says_so(
    tmp_path: Path,
) -> None:
    own, scene = revoking(tmp_path)
    revoke(own, scene, "operator-1")
    token = approvals.signed(own, answer_to(scene, verdict=ApprovalVerdict.DENY), "supervisor-1")
    scene.sim.gate.management.approve(token)
    told = approvals.records(scene, "management")[-1]["open"]
    assert (told["verdict"], told["why_not"]) == ("deny", "CERTIFICATE_REVOKED")
    assert "closes" not in told


def answer_to(scene: BenchScene, *, verdict: ApprovalVerdict) -> Approval:
    """Return what an approver would sign, from what the store holds alone."""
    ((grant, request),) = approvals.requests(scene).items()
    verified = scenarios.verified(scene.mission)
    made = answer(verified, grant, request, rid=scene.sim.robot.rid, verdict=verdict)
    return msgspec.structs.replace(made, mission=scene.digest)


def test_an_effective_answer_is_logged_once_however_often_it_comes(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    value = approvals.approval(scene)
    for _ in range(3):
        scene.sim.gate.management.approve(approvals.signed(bench, value, "supervisor-1"))
    operator = approvals.key_of(bench.folder, "operator-2", Role.OPERATOR)
    for _ in range(3):
        scene.sim.gate.management.approve(approvals.signed(bench, value, operator))
    told = [r["open"] for r in approvals.records(scene, "management") if "verdict" in r["open"]]
    assert [(r["by"], r.get("why_not")) for r in told] == [
        ("supervisor-1", None),
        ("operator-2", "ROLE_DENIED"),
    ]


def test_answers_to_what_is_over_fill_no_store(bench: Bench) -> None:
    """However an answer is varied, one mark and one record are left of a person's verdict."""
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    value = approvals.approval(scene)
    approvals.hand_in(bench, scene, "supervisor-1")
    assert approvals.outcome(scene) == []
    store = scene.sim.gate.ledger.store
    for verdict in ApprovalVerdict:
        for less_ms in range(20):
            late = msgspec.structs.replace(
                value, verdict=verdict, expires_ms=value.expires_ms - less_ms
            )
            scene.sim.gate.management.approve(approvals.signed(bench, late, "supervisor-1"))
    told = [r["open"] for r in approvals.records(scene, "management") if "verdict" in r["open"]]
    assert [(r["verdict"], r.get("why_not")) for r in told] == [
        ("approve", None),
        ("approve", "APPROVAL_TIMEOUT"),
        ("deny", "APPROVAL_TIMEOUT"),
    ]
    held = {key: value for key, value in store._held.items() if key[0] == "late-answers"}  # type: ignore[attr-defined]
    marks = [f"supervisor-1:{verdict}" for verdict in ApprovalVerdict]
    assert held == {("late-answers", "deliver-p1:1"): encode_fast(marks)}


def test_an_answer_to_what_nobody_asked_is_a_refusal_like_any_other(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    for changes in ({"counter": 2}, {"counter": 99}, {"mid": "another"}):
        value = approvals.approval(scene, **changes)
        scene.sim.gate.management.approve(approvals.signed(bench, value, "supervisor-1"))
    assert not [r for r in approvals.records(scene, "management") if "verdict" in r["open"]]
    refused = [r["open"]["reasons"] for r in approvals.records(scene, "refusal")]
    assert refused == [["APPROVAL_TIMEOUT"]] * 3  # in a gate's process repeats are counted
    held = scene.sim.gate.ledger.store._held  # type: ignore[attr-defined]
    assert not [key for kind, key in held if kind in {"late-answers", "approvals"}]


def test_a_denial_by_nobody_who_may_answer_denies_nothing(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    approvals.hand_in(bench, scene, "operator-1", verdict=ApprovalVerdict.DENY)
    approvals.hand_in(bench, scene, "supervisor-1")
    assert approvals.outcome(scene) == []
    named = approvals.records(scene, "decision")[-1]["open"]["approvers"]
    assert [item["by"] for item in named] == ["supervisor-1"]


def test_a_timeout_is_a_reason_of_its_own(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    approvals.hand_in(bench, scene, "supervisor-1")
    scene.sim.robot.pause(120_001)
    assert approvals.outcome(scene) == ["APPROVAL_TIMEOUT"]
    assert "approvers" not in approvals.records(scene, "decision")[-1]["open"]
    assert not moved(scene)


# revoked in between


def revoking(tmp_path: Path) -> tuple[Bench, BenchScene]:
    own = make_bench(tmp_path / "trust")
    scene = approvals.scene(own, "isolation-room")
    approvals.outcome(scene)
    return own, scene


def revoke(own: Bench, scene: BenchScene, name: str) -> None:
    """Revoke a principal, as an administrator does, and let the gate have the new list."""
    approvals.revoke(own.folder, scene, folder_signer(own.folder, name))


def test_an_approver_revoked_between_asking_and_answering(tmp_path: Path) -> None:
    own, scene = revoking(tmp_path)
    token = approvals.signed(own, approvals.approval(scene), "supervisor-1")
    revoke(own, scene, "supervisor-1")
    assert refused(own, scene, token) == "CERTIFICATE_REVOKED"


def test_an_approver_revoked_between_answering_and_use(tmp_path: Path) -> None:
    own, scene = revoking(tmp_path)
    approvals.hand_in(own, scene, "supervisor-1")
    revoke(own, scene, "supervisor-1")
    (question,) = approvals.questions(scene).told(None).requests
    assert (question.answers, question.behind) == ((), 1)
    assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    assert not moved(scene)


# a store that fails in the middle


@pytest.mark.parametrize("at", [1, 2])
def test_a_store_that_fails_consumes_nothing_twice(bench: Bench, at: int) -> None:
    """First the answer cannot be kept, then its use; each time nothing happened, or all of it."""
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    token = approvals.signed(bench, approvals.approval(scene), "supervisor-1")
    store, count = scene.sim.gate.ledger.store, []
    run = store.run

    def fails(job: Any, **more: Any) -> Any:
        count.append(1)
        if len(count) == at:
            raise StoreError("the disk is gone")
        return run(job, **more)

    store.run = fails  # type: ignore[method-assign]
    if at == 1:
        with pytest.raises(StoreError):
            scene.sim.gate.management.approve(token)
        assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    else:
        scene.sim.gate.management.approve(token)
        assert approvals.outcome(scene) == ["STORE_UNAVAILABLE"]
        assert used_up(scene) == (0, 1)
    assert not moved(scene)
    store.run = run  # type: ignore[method-assign]
    scene.sim.gate.management.approve(token)
    assert approvals.outcome(scene) == []
    assert used_up(scene) == (1, 0)
    again = approvals.outcome(scene)
    assert again != []
    assert scene.standing().actions == 1


# a planner cannot be less risky by calling things otherwise


@pytest.mark.parametrize(
    "arguments",
    [
        {"destination": "Isolation Room", "speed": 0.8},
        {"destination": "isolation room", "speed": 0.8},
        {"destination": "ISOLATION ROOM", "speed": 0.8},
        {"destination": "isolation-room", "speed": 0.8},
    ],
)
def test_another_spelling_is_as_risky_or_is_refused(
    bench: Bench, arguments: dict[str, Any]
) -> None:
    scene = approvals.scene(bench, "isolation-room")
    scene.plan = calls(("navigate_to", arguments))
    try:
        read_plan(scene.plan, binder=scene.sim.binder)
    except AuthGuardError as error:
        assert str(error.reason) in {"NAME_UNKNOWN", "CLARIFICATION_NEEDED"}  # noqa: PT017
        return
    assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    decided = approvals.records(scene, "decision")[-1]["open"]
    assert (decided["risk"], decided["required"]) == (35, 2)
    assert not moved(scene)


def test_a_way_around_is_as_risky_as_the_worst_of_it(bench: Bench) -> None:
    """Source, destination and route all weigh: naming a harmless end hides no room on the way."""
    scene = approvals.scene(bench, "pharmacy", "isolation-room")
    verified = scenarios.verified(scene.mission)
    policy, facts = verified.mission.risk_policy, scene.sim.gate.facts
    go = Action(type="navigate", tool="base", source="dock", destination="pharmacy")
    past = msgspec.structs.replace(go, route=("isolation-room",))
    out = msgspec.structs.replace(go, source="isolation-room")
    other_tool = msgspec.structs.replace(past, tool="gripper")
    scores = [
        rho(action, policy, state=None, facts=facts, now=scenarios.NOW)
        for action in (go, past, out, other_tool)
    ]
    assert scores[1:] == [scores[0] + 25] * 3


# what people are shown


def test_the_record_of_an_asking_decision_names_its_request(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    (question,) = approvals.questions(scene).told(1).requests
    rows = scene.sim.gate.ledger.peek(lambda turn: turn.rows(question.seq, 1))
    assert read_record(rows[0][1], where="record").open["asks"] == 1


def test_an_answer_of_the_library_is_the_one_that_the_core_knows(bench: Bench) -> None:
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    verified = scene.sim.gate.ledger.run(scene.sim.gate.enforcer.inputs.active_mission)
    ((grant, request),) = approvals.requests(scene).items()
    made = answer(
        verified, grant, request, rid=scene.sim.robot.rid, verdict=ApprovalVerdict.APPROVE
    )
    token = sign_object(made, Tag.APPROVAL, folder_signer(bench.folder, "supervisor-2"))
    assert scene.sim.gate.management.approve(token).approver.id == "supervisor-2"
    assert approvals.outcome(scene) == []


def test_an_answer_before_the_question_is_not_kept(bench: Bench) -> None:
    """Who signs ahead for the next request's number, in the very words, has to sign again."""
    scene = approvals.scene(bench, "isolation-room")
    approvals.outcome(scene)
    next_one = approvals.approval(scene, counter=2, expires_ms=bench.start_ms + 3_600_000)
    scene.sim.gate.management.approve(approvals.signed(bench, next_one, "supervisor-1"))
    scene.sim.robot.pause(121_000)
    assert approvals.outcome(scene) == ["APPROVAL_TIMEOUT"]
    for _ in range(2):
        assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    assert scene.standing().counter == 2
    assert not moved(scene)
    held = scene.sim.gate.ledger.peek(lambda turn: turn.get("approvals", "deliver-p1:2"))
    assert held is None


def test_who_fills_a_template_or_signed_it_has_no_second_name() -> None:
    made = templates.edited((("risk_policy", "tau_1"), 1), (("risk_policy", "tau_2"), 1_000))
    folder = templates.folder(made)
    sim = templates.simulation(folder)
    sim.gate.management.template(templates.signed(made))
    filled = templates.instance(template=templates.digest(made))
    sim.gate.management.activate(templates.token(filled, at=folder))
    go = scenarios.navigate("dock", "pharmacy", speed=800)
    assert scenarios.propose(sim, go).judged.decision.reasons == (Reason.APPROVAL_REQUIRED,)  # type: ignore[union-attr]
    standing = sim.gate.ledger.standing(filled.mid)
    assert standing is not None
    ((grant, request),) = standing.requests.items()
    verified = sim.gate.ledger.run(sim.gate.enforcer.inputs.active_mission)
    value = answer(verified, grant, request, rid=scenarios.RID, verdict=ApprovalVerdict.APPROVE)
    for holder in ("scheduler-0", "operator-1"):
        (key,) = open_key_file(folder / "keys" / f"{holder}.key.pem")
        shadow = approvals.key_of(folder, "shadow", Role.SUPERVISOR, key=key)
        with pytest.raises(RefusedError) as error:
            sim.gate.management.approve(sign_object(value, Tag.APPROVAL, shadow))
        assert error.value.reason is Reason.ISSUER_MISMATCH
    honest = folder_signer(folder, "supervisor-1")
    sim.gate.management.approve(sign_object(value, Tag.APPROVAL, honest))
    assert scenarios.propose(sim, go).outcome is Outcome.SUCCEEDED
