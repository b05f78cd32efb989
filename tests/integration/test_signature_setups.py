# SPDX-License-Identifier: Apache-2.0
"""Every kind of signed object, and a whole mission, under each algorithm and under two at once.

One set-up of each: the four algorithms alone, and a hybrid of an old and a new one. What a set-up
signs it takes; a hybrid takes no half of anything.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r import safety
from authguard_r.access.gate_config import Peer, default_config, open_gate_config
from authguard_r.approvals import Selection, open_approval, open_selection
from authguard_r.audit.record import Terminal, read_record
from authguard_r.audit.verify import verify_rows
from authguard_r.authoring.keys.setup import Member, demo_members, init_folder
from authguard_r.client.handshake import Handshake, require_welcome
from authguard_r.core.approval import Approval, ApprovalVerdict
from authguard_r.core.encoding import Tag, b64, digest_of, encode_fast, unb64
from authguard_r.core.errors import AuthenticityError, AuthGuardError
from authguard_r.core.mission import Mission
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Outcome
from authguard_r.core.state import Snapshot
from authguard_r.core.token import open_token, read_token, sign_object, verify_mission
from authguard_r.enforcement.inputs import ISSUER_ROLES
from authguard_r.enforcement.signed_orders import Command, Verb
from authguard_r.enforcement.templates import open_template
from authguard_r.enforcement.templates.instance import open_instance
from authguard_r.keys.algorithms import Algorithm, algorithm_of
from authguard_r.keys.certificate import Role
from authguard_r.keys.signer import FileSigner, folder_signer
from authguard_r.keys.trust import Trust, read_trust
from authguard_r.operations.simulation import Simulation, simulate
from authguard_r.server.wiring import sign_terminal
from authguard_r.sim.robot import snapshot_of
from authguard_r.site.signed import read_signed_site, sign_site
from authguard_r.wire.messages import PROTOCOL, ClientRole, Mode, Proof, Welcome
from fixtures import scenarios, templates
from missionpair.bench import Bench, BenchScene, approve, choose, order, propose
from missionpair.suite import restricted

pytestmark = pytest.mark.complete

SETUPS = {
    **{str(algorithm): (algorithm,) for algorithm in Algorithm},
    "hybrid": (Algorithm.ED25519, Algorithm.ML_DSA_65),
}
REPLIES = scenarios.HOSPITAL / "replies"
NONCE = b64(bytes(16))
LATER = scenarios.START_MS + 3_600_000
set_ = msgspec.structs.replace


@dataclass(frozen=True)
class Setup:
    """One trust set-up on disk."""

    folder: Path
    algorithms: tuple[Algorithm, ...]

    @cached_property
    def trust(self) -> Trust:
        return read_trust(self.folder)

    def signer(self, name: str) -> FileSigner:
        return folder_signer(self.folder, name)

    def bench(self) -> Bench:
        return Bench(self.folder, scenarios.site(), scenarios.binding(), scenarios.START_MS)

    def simulation(self, **kwargs: Any) -> Simulation:
        return simulate(
            self.folder,
            scenarios.site(),
            scenarios.binding(),
            rid=scenarios.RID,
            start_ms=scenarios.START_MS,
            **{"store": None, **kwargs},
        )


@pytest.fixture(scope="module", params=SETUPS)
def setup(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Setup:
    folder = tmp_path_factory.mktemp("setup") / "trust"
    template = templates.digest()
    scheduler = Member(
        id="scheduler-0", role=Role.SCHEDULER, robots=None, regions=None, template=template
    )
    members = (*demo_members(scenarios.site(), (scenarios.RID, scenarios.OTHER)), scheduler)
    begin = datetime.fromtimestamp(scenarios.START_MS / 1_000, UTC)
    init_folder(folder, members, now=begin, algorithms=SETUPS[request.param])
    return Setup(folder, SETUPS[request.param])


# every kind of object


def mission_of(by: str = "operator-1") -> Mission:
    return scenarios.mission(issuer=by)


def command(verb: Verb, mission: Mission, **changes: Any) -> Command:
    fields: dict[str, Any] = {
        "verb": verb,
        "mid": mission.mid,
        "version": mission.version,
        "mission": digest_of(Tag.MISSION, mission),
        "nonce": b64(verb.encode()),
        "expires_ms": LATER,
        "issued_ms": scenarios.START_MS,
    }
    return Command(**{**fields, **changes})


def selection(mission: Mission) -> Selection:
    return Selection(
        mid=mission.mid,
        version=mission.version,
        mission=digest_of(Tag.MISSION, mission),
        grant=mission.actions[0].id,
        row=0,
        nonce=NONCE,
        expires_ms=LATER,
        issued_ms=scenarios.START_MS,
    )


def approval(mission: Mission) -> Approval:
    return Approval(
        mid=mission.mid,
        version=mission.version,
        mission=digest_of(Tag.MISSION, mission),
        rid=mission.rid,
        grant=mission.actions[0].id,
        scope=b64(bytes(32)),
        situation=b64(bytes(32)),
        counter=1,
        expires_ms=LATER,
        verdict=ApprovalVerdict.APPROVE,
    )


def gate_config() -> Any:
    peers = (Peer(uid=1_000, roles=(ClientRole.PLANNER,)),)
    return default_config(scenarios.RID, peers, Mode.ENFORCE)


def terminal(setup: Setup) -> bytes:
    sim = setup.simulation()
    return sign_terminal(sim.gate, sim.signer)


def shaken(data: bytes, trust: Trust) -> None:
    """Take the proof as a client does who wants this robot's gate."""
    handshake = Handshake(
        role=ClientRole.PLANNER, client="planner", verifier=trust, robot=scenarios.RID
    )
    welcome = Welcome(
        protocol=PROTOCOL,
        robot=scenarios.RID,
        mode=Mode.ENFORCE,
        role=ClientRole.PLANNER,
        client="planner",
        proof=data.decode(),
    )
    require_welcome(welcome, handshake, nonce=NONCE, now=scenarios.NOW)


def opened(kind: type[Any], tag: Tag, role: str) -> Callable[[bytes, Trust], object]:
    return lambda data, trust: open_token(
        data, kind, tag=tag, roles=frozenset({role}), verifier=trust, now=scenarios.NOW
    )


Make, Open = Callable[[Setup], bytes], Callable[[bytes, Trust], object]


def signed(value: Callable[[], Any], tag: Tag, by: str) -> Make:
    return lambda setup: sign_object(value(), tag, setup.signer(by))


PROOF = Proof(robot=scenarios.RID, role=ClientRole.PLANNER, nonce=NONCE)
#: How each kind of object is signed and how its reader opens it.
KINDS: dict[str, tuple[Make, Open]] = {
    "mission": (
        signed(mission_of, Tag.MISSION, "operator-1"),
        lambda d, t: verify_mission(d, verifier=t, now=scenarios.NOW, roles=ISSUER_ROLES),
    ),
    "selection": (
        signed(lambda: selection(mission_of()), Tag.SELECTION, "operator-1"),
        lambda d, t: open_selection(d, verifier=t, now=scenarios.NOW),
    ),
    "approval": (
        signed(lambda: approval(mission_of()), Tag.APPROVAL, "supervisor-1"),
        lambda d, t: open_approval(d, verifier=t, now=scenarios.NOW),
    ),
    "command": (
        signed(lambda: command(Verb.REVOKE, mission_of()), Tag.COMMAND, "safety-officer-1"),
        opened(Command, Tag.COMMAND, "safety_officer"),
    ),
    "site": (
        lambda setup: sign_site(scenarios.site(), setup.signer("site-authority-1")),
        lambda d, t: read_signed_site(d, verifier=t, now=scenarios.NOW),
    ),
    "safety configuration": (
        signed(
            lambda: safety.default_config(scenarios.site(), scenarios.RID),
            Tag.SAFETY,
            "safety-officer-1",
        ),
        lambda d, t: safety.open_config(d, verifier=t, now=scenarios.NOW),
    ),
    "gate configuration": (
        signed(gate_config, Tag.GATE, "site-authority-1"),
        lambda d, t: open_gate_config(d, verifier=t, now=scenarios.NOW, robot=scenarios.RID),
    ),
    "snapshot": (
        signed(
            lambda: snapshot_of(scenarios.world(), robot=scenarios.RID, epoch=1, seq=1),
            Tag.STATE,
            "estimator-courier-1",
        ),
        opened(Snapshot, Tag.STATE, "estimator"),
    ),
    "handshake": (signed(lambda: PROOF, Tag.HANDSHAKE, "gate-courier-1"), shaken),
    "checkpoint": (terminal, opened(Terminal, Tag.CHECKPOINT, "gate")),
    "template": (
        signed(templates.template, Tag.TEMPLATE, "operator-1"),
        lambda d, t: open_template(d, verifier=t, now=scenarios.NOW, roles=ISSUER_ROLES),
    ),
    "instance": (
        lambda setup: templates.token(at=setup.folder),
        lambda d, t: open_instance(d, verifier=t, now=scenarios.NOW),
    ),
}


def halves(token: bytes) -> list[bytes]:
    """Return the token with each of its endorsements alone."""
    whole = read_token(token)
    return [encode_fast(set_(whole, endorsements=(half,))) for half in whole.endorsements]


def spoiled(token: bytes, number: int) -> bytes:
    """Return the token with one bit of one signature flipped."""
    whole = read_token(token)
    signature = bytearray(unb64(whole.endorsements[number].signature))
    signature[len(signature) // 2] ^= 1
    bad = set_(whole.endorsements[number], signature=b64(bytes(signature)))
    ends = (*whole.endorsements[:number], bad, *whole.endorsements[number + 1 :])
    return encode_fast(set_(whole, endorsements=ends))


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_object_is_taken_whole_and_no_other_way(setup: Setup, kind: str) -> None:
    make, take = KINDS[kind]
    token = make(setup)
    take(token, setup.trust)
    count = len(setup.algorithms)
    assert len(read_token(token).endorsements) == count
    for number in range(count):
        with pytest.raises(AuthenticityError) as caught:
            take(spoiled(token, number), setup.trust)
        assert (caught.value.reason, caught.value.where) == (Reason.SIGNATURE_INVALID, "signature")
    for half in halves(token) if count > 1 else ():
        with pytest.raises(AuthenticityError) as caught:
            take(half, setup.trust)
        assert (caught.value.reason, caught.value.where) == (
            Reason.SIGNATURE_MISSING,
            "token.endorsements",
        )


def test_every_key_of_a_set_up_is_of_its_algorithm(setup: Setup) -> None:
    for path in sorted((setup.folder / "keys").glob("*.cert.pem")):
        endorsements = setup.signer(path.name.removesuffix(".cert.pem")).endorse(b"go")
        kinds = tuple(
            algorithm_of(setup.trust.identify(chain, scenarios.NOW).key)
            for chain, _ in endorsements
        )
        assert kinds == setup.algorithms


# a whole gate


def run(sim: Simulation, mission: Mission, plan: bytes) -> list[Any]:
    return propose(BenchScene(sim=sim, mission=mission, plan=plan))


def last(sim: Simulation) -> Any:
    return read_record(sim.gate.ledger.store.rows()[-1].record, where="")


def test_the_hospital_s_story_is_played_to_its_end(setup: Setup) -> None:
    bench, sim = setup.bench(), setup.simulation()
    first = scenarios.mission()
    sim.gate.management.activate(bench.sign(first))
    collect = run(sim, first, (REPLIES / "01-collect.json").read_bytes())
    assert [report.outcome for report in collect] == [Outcome.SUCCEEDED] * 2
    hijacked = (REPLIES / "03-hijacked-by-notice.json").read_bytes()
    (refused,) = run(sim, first, hijacked)
    assert refused.outcome is None
    assert "DESTINATION_OUT_OF_SCOPE" in map(str, refused.judged.decision.reasons)
    assert sim.robot.state.region == "pharmacy"
    draft = scenarios.read_yaml((scenarios.HOSPITAL / "mission-v2.yaml").read_text(), where="v2")
    second = bench.mission({**draft, "supersedes": digest_of(Tag.MISSION, first)})
    sim.gate.management.activate(bench.sign(second))
    delivered = run(sim, second, hijacked)
    assert {report.outcome for report in delivered} == {Outcome.SUCCEEDED}
    assert sim.robot.state.places["package-p1"] == "station-103"
    home = run(sim, second, (REPLIES / "04-home.json").read_bytes())
    assert {report.outcome for report in home} == {Outcome.SUCCEEDED}
    anchor = sign_terminal(sim.gate, sim.signer)
    end, _, _ = open_token(
        anchor,
        Terminal,
        tag=Tag.CHECKPOINT,
        roles=frozenset({"gate"}),
        verifier=setup.trust,
        now=scenarios.NOW,
    )
    assert verify_rows(sim.gate.ledger.store.rows(), terminal=end).whole


def test_people_s_answers_orders_and_choices_reach_the_gate(setup: Setup) -> None:
    bench = setup.bench()
    scene = restricted(bench)
    assert propose(scene)[-1].outcome is None
    approve(bench, scene, "supervisor-1", "supervisor-2")
    assert propose(scene)[-1].outcome is Outcome.SUCCEEDED
    choose(bench, scene, "pick-p1", 0)
    assert scene.standing().selected == {"pick-p1": 0}
    order(bench, scene, Verb.SUSPEND, by="safety-officer-1")
    assert scene.standing().status == "suspended"


def test_a_scheduler_s_instance_becomes_the_active_mission(setup: Setup) -> None:
    sim = setup.simulation()
    token = sign_object(templates.template(), Tag.TEMPLATE, setup.signer("operator-1"))
    sim.gate.management.template(token)
    standing = sim.gate.management.activate(templates.token(at=setup.folder))
    assert standing.status == "active"
    assert (
        scenarios.propose(sim, scenarios.navigate("dock", "pharmacy")).outcome is Outcome.SUCCEEDED
    )


# no half


@pytest.fixture(scope="module")
def hybrid(tmp_path_factory: pytest.TempPathFactory) -> Setup:
    folder = tmp_path_factory.mktemp("hybrid") / "trust"
    begin = datetime.fromtimestamp(scenarios.START_MS / 1_000, UTC)
    members = demo_members(scenarios.site(), (scenarios.RID, scenarios.OTHER))
    init_folder(folder, members, now=begin, algorithms=SETUPS["hybrid"])
    return Setup(folder, SETUPS["hybrid"])


def refused(sim: Simulation, act: Callable[[], object]) -> None:
    """Assert that nothing changes and that one record says what is missing."""
    store = sim.gate.ledger.store
    size, before = len(store.rows()), sim.gate.management.standing("deliver-p1")
    with pytest.raises(AuthGuardError) as caught:
        act()
    assert caught.value.reason is Reason.SIGNATURE_MISSING
    assert caught.value.where == "token.endorsements"
    assert sim.gate.management.standing("deliver-p1") == before
    assert len(store.rows()) == size + 1
    assert last(sim).open["reasons"] == ["SIGNATURE_MISSING"]
    assert sim.robot.trace == []


@pytest.mark.parametrize("kept", [0, 1])
def test_a_hybrid_mission_stripped_of_either_signature_is_not_activated(
    hybrid: Setup, kept: int
) -> None:
    sim = hybrid.simulation()
    token = hybrid.bench().sign(scenarios.mission())
    refused(sim, lambda: sim.gate.management.activate(halves(token)[kept]))
    assert sim.gate.management.standing("deliver-p1") is None
    go = scenarios.navigate("dock", "pharmacy")
    assert scenarios.propose(sim, go).refusal.reason is Reason.NO_ACTIVE_MISSION
    assert sim.gate.management.activate(token).status == "active"
    assert scenarios.propose(sim, go).outcome is Outcome.SUCCEEDED


@pytest.mark.parametrize("kept", [0, 1])
def test_a_hybrid_order_or_choice_stripped_of_either_signature_changes_nothing(
    hybrid: Setup, kept: int
) -> None:
    sim, mission = hybrid.simulation(), scenarios.mission()
    sim.gate.management.activate(hybrid.bench().sign(mission))
    operator = hybrid.signer("operator-1")
    revoke = sign_object(command(Verb.REVOKE, mission), Tag.COMMAND, operator)
    refused(sim, lambda: sim.gate.management.command(halves(revoke)[kept]))
    chosen = set_(selection(mission), grant="pick-p1")
    choice = sign_object(chosen, Tag.SELECTION, operator)
    refused(sim, lambda: sim.gate.management.select(halves(choice)[kept]))
    assert sim.gate.management.select(choice).selected == {"pick-p1": 0}
    assert sim.gate.management.command(revoke).status == "revoked"


@pytest.mark.parametrize("kept", [0, 1])
def test_a_hybrid_approval_stripped_of_either_signature_does_not_count(
    hybrid: Setup, kept: int
) -> None:
    bench = hybrid.bench()
    scene = restricted(bench)
    propose(scene)
    verified = scene.sim.gate.ledger.run(scene.sim.gate.enforcer.inputs.active_mission)
    standing = scene.standing()
    assert standing is not None
    (request,) = standing.requests.values()
    approve(bench, scene, "supervisor-1")
    made = set_(
        approval(verified.mission),
        grant=next(iter(standing.requests)),
        scope=request.scope,
        situation=request.situation,
        counter=request.counter,
        expires_ms=request.expires_ms,
    )
    token = sign_object(made, Tag.APPROVAL, hybrid.signer("supervisor-2"))
    refused(scene.sim, lambda: scene.sim.gate.management.approve(halves(token)[kept]))
    assert propose(scene)[-1].outcome is None
    scene.sim.gate.management.approve(token)
    assert propose(scene)[-1].outcome is Outcome.SUCCEEDED


@pytest.mark.parametrize("kept", [0, 1])
def test_a_hybrid_snapshot_stripped_of_either_signature_is_not_taken_in(
    hybrid: Setup, kept: int
) -> None:
    sim = hybrid.simulation()
    whole = sim.robot.latest()
    assert whole is not None
    half = halves(whole)[kept]
    sim.robot.latest = lambda: half  # type: ignore[method-assign]
    assert sim.gate.enforcer.inputs.refresh() is None
    record = last(sim)
    assert (record.kind, record.open["reasons"]) == ("intake", ["SIGNATURE_MISSING"])
    sim.robot.latest = lambda: whole  # type: ignore[method-assign]
    assert sim.gate.enforcer.inputs.refresh() is not None


def test_a_proof_of_the_other_robot_s_gate_as_second_half_is_no_handshake(hybrid: Setup) -> None:
    """Who broke one algorithm takes another gate's certificate for it: they are two principals."""
    own, other = (
        read_token(sign_object(PROOF, Tag.HANDSHAKE, hybrid.signer(name)))
        for name in ("gate-courier-1", "gate-lifter-1")
    )
    mixed = set_(own, endorsements=(own.endorsements[0], other.endorsements[1]))
    with pytest.raises(AuthenticityError) as caught:
        shaken(encode_fast(mixed), hybrid.trust)
    assert caught.value.reason is Reason.ISSUER_MISMATCH
