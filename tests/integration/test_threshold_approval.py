# SPDX-License-Identifier: Apache-2.0
"""A group's signature at the gate: three of five people behind one plain Ed25519 signature."""

from __future__ import annotations

import json
import shutil
from itertools import combinations
from pathlib import Path
from typing import Any

import msgspec
import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from authguard_r.approvals import answer
from authguard_r.audit.record import read_record
from authguard_r.cli import call
from authguard_r.core.approval import Approval, ApprovalVerdict
from authguard_r.core.encoding import Tag, digest_of, unb64
from authguard_r.core.errors import AuthenticityError, RefusedError
from authguard_r.core.identifiers import PrincipalId
from authguard_r.core.principals import Endorsed
from authguard_r.core.reasons import Reason
from authguard_r.core.token import sign_object
from authguard_r.frost import curve, signing
from authguard_r.frost.keys import Dealt, deal
from authguard_r.frost.messages import Share, written
from authguard_r.wire.messages import ClientRole
from fixtures import scenarios
from fixtures.gate_process import RunningGate, until
from fixtures.threshold_groups import prepared, signature
from missionpair.bench import Bench, BenchScene, calls, make_bench, propose
from missionpair.suite import at_dock, wide, with_grant

BOARD = ("ana", "ben", "cho", "dee", "eli")
#: A group that the mission's own issuer sits in.
MIXED = ("operator-1", "ana", "ben", "cho", "dee")
ISOLATION, PLANT = "Isolation Room", "Plant Room"


class Group(msgspec.Struct, frozen=True):
    """A certified group with everybody's share: more than any one machine ever has."""

    dealt: Dealt
    chain: tuple[bytes, ...]

    def approve(self, approval: Approval, shares: tuple[Share, ...]) -> bytes:
        """Return the approval token that these members make."""
        return sign_object(approval, Tag.APPROVAL, Signer(self.chain, shares))


class Signer(msgspec.Struct, frozen=True):
    """Members who sign together (`core.ports.Signer`)."""

    chain: tuple[bytes, ...]
    shares: tuple[Share, ...]

    def endorse(self, message: bytes) -> tuple[Endorsed, ...]:
        return ((self.chain, signature(self.shares, message)),)


def certified(bench: Bench, name: str, members: tuple[str, ...], *more: str) -> Group:
    made = deal(PrincipalId(name), tuple(map(PrincipalId, members)), threshold=3)
    file = bench.folder.parent / f"{name}.json"
    file.write_bytes(written(made.group))
    scope = more or ("--every-robot", "--every-region")
    options = ["--trust", str(bench.folder), "--group", str(file), "--role", "supervisor"]
    assert call(["advanced", "frost", "certify", *options, *scope, "--yes"]) == 0
    pem = (bench.folder / "keys" / f"{name}.cert.pem").read_bytes()
    chain = tuple(c.public_bytes(Encoding.DER) for c in x509.load_pem_x509_certificates(pem))
    return Group(made, chain)


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return make_bench(tmp_path_factory.mktemp("bench") / "trust")


@pytest.fixture(scope="module")
def board(bench: Any) -> Group:
    return certified(bench, "board-1", BOARD)


@pytest.fixture(scope="module")
def mixed(bench: Any) -> Group:
    return certified(bench, "board-2", MIXED)


def to(place: str) -> bytes:
    return calls(("navigate_to", {"destination": place, "speed": 0.5}))


def scene_of(bench: Bench, *, needed: int = 4) -> BenchScene:
    """Return a robot at its dock with two rooms that so many principals must let it into."""
    rows = [
        {"source": "dock", "destination": room, "regions": ["dock", room, "public-corridor"]}
        for room in ("isolation-room", "plant-room")
    ]
    draft = wide(bench)
    policy = {**draft["risk_policy"], "tau_2": 31, "t": needed}
    draft = with_grant(
        {**draft, "risk_policy": policy}, "go-to-pharmacy", rows=rows, chooser="planner"
    )
    scene = at_dock(bench, draft, to(ISOLATION))
    assert reasons(scene) == ["APPROVAL_REQUIRED"]
    return scene


def reasons(scene: BenchScene) -> list[str]:
    report = propose(scene)[-1]
    assert report.judged is not None
    return [str(reason) for reason in report.judged.decision.reasons]


def asked(scene: BenchScene, verdict: ApprovalVerdict = ApprovalVerdict.APPROVE) -> Approval:
    standing = scene.standing()
    assert standing is not None
    verified = scene.sim.gate.ledger.run(scene.sim.gate.enforcer.inputs.active_mission)
    ((grant, request),) = standing.requests.items()
    return answer(verified, grant, request, rid=scene.sim.robot.rid, verdict=verdict)


def answers(scene: BenchScene) -> list[Any]:
    rows = [read_record(row.record, where="") for row in scene.sim.gate.ledger.store.rows()]
    return [dict(r.open) for r in rows if dict(r.open).get("verb") == "answer"]


def test_three_of_five_let_an_action_pass_that_needs_four_people(bench: Any, board: Any) -> None:
    scene = scene_of(bench)
    token = board.approve(asked(scene), board.dealt.shares[1:4])
    item = scene.sim.gate.management.approve(token)
    assert (item.approver.id, item.approver.threshold) == ("board-1", 3)
    assert reasons(scene) == []
    assert scene.sim.robot.state.region == "isolation-room"
    standing = scene.standing()
    assert standing is not None
    assert standing.requests == {}


def test_the_log_says_which_group_and_how_many_of_whom(bench: Any, board: Any) -> None:
    scene = scene_of(bench)
    scene.sim.gate.management.approve(board.approve(asked(scene), board.dealt.shares[:3]))
    (told,) = answers(scene)
    assert (told["by"], told["kind"], told["threshold"]) == ("board-1", "threshold", 3)
    assert tuple(told["members"]) == BOARD


def test_any_three_of_the_five_make_a_token_that_the_gate_takes(bench: Any, board: Any) -> None:
    scene = scene_of(bench)
    for shares in combinations(board.dealt.shares, 3):
        item = scene.sim.gate.management.approve(board.approve(asked(scene), shares))
        assert item.approver.id == "board-1"
    assert len(answers(scene)) == 1  # the same answer, under ten signatures
    assert reasons(scene) == []


def test_two_stolen_shares_do_not(bench: Any, board: Any) -> None:
    scene = scene_of(bench)
    stolen = board.dealt.shares[:2]
    with pytest.raises(RefusedError, match="at least 3 members"):
        board.approve(asked(scene), stolen)
    # the thief drops that check: he says that two are enough, and signs with his own program
    group = board.dealt.group
    lowered = msgspec.structs.replace(group, threshold=2, commitment=group.commitment[:2])
    own = tuple(msgspec.structs.replace(share, group=lowered) for share in stolen)
    approval = asked(scene)
    session, ready = prepared(own, unb64(digest_of(Tag.APPROVAL, approval)))
    parts = [signing.sign(session, share, nonces) for share, nonces in ready]
    forged = session.commitment + curve.total(curve.scalar(part.share) for part in parts)

    class Forger(msgspec.Struct):
        def endorse(self, message: bytes) -> tuple[Endorsed, ...]:
            return ((board.chain, forged),)

    with pytest.raises(AuthenticityError) as caught:
        scene.sim.gate.management.approve(sign_object(approval, Tag.APPROVAL, Forger()))
    assert caught.value.reason is Reason.SIGNATURE_INVALID
    assert answers(scene) == []
    assert reasons(scene) == ["APPROVAL_REQUIRED"]
    assert scene.sim.robot.state.region == "dock"


def test_a_groups_approval_for_one_room_does_not_open_another(bench: Any, board: Any) -> None:
    scene = scene_of(bench)
    scene.sim.gate.management.approve(board.approve(asked(scene), board.dealt.shares[:3]))
    scene.plan = to(PLANT)
    assert reasons(scene) == ["APPROVAL_REQUIRED"]
    assert scene.sim.robot.state.region == "dock"


def test_the_issuer_who_is_a_member_counts_once_less(bench: Any, mixed: Any) -> None:
    scene = scene_of(bench, needed=4)
    # the issuer took no part in the signature; that he could have is enough
    scene.sim.gate.management.approve(mixed.approve(asked(scene), mixed.dealt.shares[2:]))
    assert reasons(scene) == ["APPROVAL_REQUIRED"]
    fewer = scene_of(bench, needed=3)
    fewer.sim.gate.management.approve(mixed.approve(asked(fewer), mixed.dealt.shares[2:]))
    assert reasons(fewer) == []


@pytest.mark.parametrize(("needed", "expected"), [(5, []), (6, ["APPROVAL_REQUIRED"])])
def test_two_groups_that_share_members_count_each_person_once(
    bench: Any, board: Any, mixed: Any, needed: int, expected: list[str]
) -> None:
    """The issuer, three of the board, who may be the other group's too, and a supervisor."""
    from authguard_r.keys.signer import folder_signer

    scene = scene_of(bench, needed=needed)
    approval = asked(scene)
    scene.sim.gate.management.approve(board.approve(approval, board.dealt.shares[:3]))
    scene.sim.gate.management.approve(mixed.approve(approval, mixed.dealt.shares[:3]))
    signer = folder_signer(bench.folder, "supervisor-1")
    scene.sim.gate.management.approve(sign_object(approval, Tag.APPROVAL, signer))
    assert len(answers(scene)) == 3
    assert reasons(scene) == expected


def test_a_group_can_deny(bench: Any, board: Any) -> None:
    scene = scene_of(bench)
    denial = board.approve(asked(scene, ApprovalVerdict.DENY), board.dealt.shares[:3])
    scene.sim.gate.management.approve(denial)
    assert reasons(scene) == ["APPROVAL_DENIED"]
    assert scene.sim.robot.state.region == "dock"


def test_a_group_answers_only_for_what_its_certificate_names(bench: Any) -> None:
    for name, scope in {
        "other-robot": ("--robot", "lifter-1", "--every-region"),
        "other-room": ("--every-robot", "--region", "dock", "--region", "plant-room"),
    }.items():
        group = certified(bench, name, BOARD, *scope)
        scene = scene_of(bench)
        scene.sim.gate.management.approve(group.approve(asked(scene), group.dealt.shares[:3]))
        assert reasons(scene) == ["APPROVAL_REQUIRED"]


def test_a_group_issues_no_mission_and_gives_no_order(bench: Any, tmp_path: Path) -> None:
    made = deal(PrincipalId("board-9"), tuple(map(PrincipalId, BOARD)), threshold=3)
    file = tmp_path / "group.json"
    file.write_bytes(written(made.group))
    options = ["--trust", str(bench.folder), "--group", str(file), "--role", "operator"]
    scope = ("--every-robot", "--every-region")
    assert call(["advanced", "frost", "certify", *options, *scope, "--yes"]) == 4
    assert not (bench.folder / "keys" / "board-9.cert.pem").exists()


PLAN = b'{"tool": "navigate_to", "arguments": {"destination": "Isolation Room", "speed": 0.8}}'


def test_a_group_answers_at_a_gate_that_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ballot from the gate, files between the members, the token to the gate: by commands alone."""
    trust = tmp_path / "trust"
    shutil.copytree(scenarios.trust_folder(), trust)  # the same root: the gate knows the authority

    def done(*words: object) -> dict[str, Any]:
        capsys.readouterr()
        assert call([*map(str, words), "--json"]) == 0
        said: dict[str, Any] = json.loads(capsys.readouterr().out)
        return said

    members = [word for name in BOARD for word in ("--member", name)]
    done(
        "advanced",
        "frost",
        "deal",
        "--group",
        "board-1",
        "--threshold",
        3,
        *members,
        "--out",
        tmp_path,
    )
    group, cert = tmp_path / "group.json", trust / "keys" / "board-1.cert.pem"
    every = ("--role", "supervisor", "--every-robot", "--every-region")
    done("advanced", "frost", "certify", "--trust", trust, "--group", group, *every, "--yes")
    row = {
        "source": "dock",
        "destination": "isolation-room",
        "regions": ["dock", "isolation-room", "public-corridor"],
    }
    draft = with_grant(scenarios.draft(), "go-to-pharmacy", rows=[row], until=[])
    policy = {**draft["risk_policy"], "tau_2": 31, "t": 4}
    with RunningGate(simulate=True, refusals=0) as gate:
        gate.activate(
            gate.token(gate.mission(grants=draft["grants"], risk_policy=policy, limits={}))
        )
        planner = gate.client(ClientRole.PLANNER)
        until(
            lambda: planner.propose(PLAN)["steps"][-1]["reasons"] == ["APPROVAL_REQUIRED"],
            "the request",
        )
        at, ballot = ("--gate", gate.socket, "--trust", trust), tmp_path / "ballot.json"
        assert done("advanced", "frost", "ballot", 1, *at, "--out", ballot)["required"] == 4
        signers = [w for n in BOARD[:3] for w in ("--commitment", tmp_path / f"{n}.commitment")]
        own = {
            name: ("--share", tmp_path / f"{name}.share.json", "--nonces", tmp_path / name)
            for name in BOARD[:3]
        }
        for name, words in own.items():
            done("advanced", "frost", "commit", *words, "--out", tmp_path / f"{name}.commitment")
        for name, words in own.items():
            more = ("--ballot", ballot, *signers, "--out", tmp_path / f"{name}.part", "--yes")
            done("advanced", "frost", "share", *words, *more)
        parts = [word for name in own for word in ("--part", tmp_path / f"{name}.part")]
        told = ("--group", group, "--cert", cert, "--ballot", ballot, *signers, *parts)
        done("advanced", "frost", "aggregate", *told, "--out", tmp_path / "a.token")
        said = done("advanced", "frost", "submit", tmp_path / "a.token", *at)
        assert (said["approver"], said["counts"]) == ("board-1", True)
        assert planner.propose(PLAN)["steps"][-1]["reasons"] == []
