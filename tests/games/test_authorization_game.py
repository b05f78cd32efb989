# SPDX-License-Identifier: Apache-2.0
"""Game^auth: an adversary with a signing oracle, the planner and every input channel.

It wins when the gate accepts under a mission that was never signed, or an action outside the
policy of one that was. A certificate helps only in a role that may sign what is signed.
Source: section "Authorization-Bypass Game", theorem "Authorization soundness".
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from random import Random
from typing import Any

import msgspec
import pytest

from authguard_r.approvals import Selection
from authguard_r.audit.record import read_record
from authguard_r.core.approval import Approval, ApprovalVerdict
from authguard_r.core.encoding import Tag, b64, decode, digest_of, unb64
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.mission import Mission
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Outcome
from authguard_r.core.token import Token, VerifiedMission, sign_object, verify_mission
from authguard_r.enforcement.inputs import ISSUER_ROLES
from authguard_r.enforcement.signed_orders import Command, Verb
from authguard_r.keys.certificate import Role
from authguard_r.keys.signer import FileSigner
from authguard_r.keys.trust import Trust, read_trust
from authguard_r.operations.simulation import Simulation
from fixtures import approvals, scenarios, templates
from fixtures.amount import amount
from fixtures.decision_cases import accepted_case, agree_accepts, broken_case

ROUNDS = amount(120, 400)
GO = scenarios.navigate("dock", "pharmacy")


@cache
def trust() -> Trust:
    return read_trust(scenarios.trust_folder())


def open_mission(token: bytes) -> VerifiedMission:
    now = Now(scenarios.START_MS, 0)
    return verify_mission(token, verifier=trust(), now=now, roles=ISSUER_ROLES)


def accepts(token: bytes) -> bool:
    """Say whether the gate takes the token for a signed mission."""
    try:
        open_mission(token)
    except AuthGuardError:
        return False
    return True


def queried() -> list[bytes]:
    """Return tokens for missions of the adversary's choice: its signing queries."""
    speeds = [["0.05 m/s", f"0.{n} m/s"] for n in (2, 4, 6)]
    return [scenarios.token(scenarios.mission(limits={"speed_mm_s": s})) for s in speeds]


def forged(rnd: Random, signed: list[bytes]) -> bytes:
    """Return something new made of what was signed: never one of the queries itself."""
    one, other = (decode(t.rstrip(b"\n"), Token) for t in rnd.sample(signed, 2))
    mission = decode(unb64(one.payload), Mission)
    trick = rnd.randrange(6)
    if trick == 0:  # another mission under an old signature
        return msgspec.json.encode(
            msgspec.structs.replace(one, payload=other.payload), order="sorted"
        )
    if trick == 1:  # one widened field
        changed = msgspec.structs.replace(mission, expiry="2099-01-01T00:00:00Z")
        payload = b64(msgspec.json.encode(changed, order="sorted"))
        return msgspec.json.encode(msgspec.structs.replace(one, payload=payload), order="sorted")
    if trick == 2:  # a bit of the payload
        raw = bytearray(unb64(one.payload))
        raw[rnd.randrange(len(raw))] ^= 1 << rnd.randrange(8)
        return msgspec.json.encode(
            msgspec.structs.replace(one, payload=b64(bytes(raw))), order="sorted"
        )
    if trick == 3:  # a bit of the signature or of a certificate
        token = bytearray(msgspec.json.encode(one, order="sorted"))
        token[rnd.randrange(len(token))] ^= 1 << rnd.randrange(7)
        return bytes(token)
    if trick == 4:  # another kind of signed object
        return msgspec.json.encode(msgspec.structs.replace(one, kind=Tag.SITE), order="sorted")
    spaced = msgspec.json.encode(one, order="sorted")  # a second spelling of the same thing
    return spaced.replace(b'":', b'": ', 1)


def test_no_mission_is_accepted_that_was_never_signed() -> None:
    rnd, signed = Random(1), queried()
    assert all(accepts(token) for token in signed)
    known = {token.rstrip(b"\n") for token in signed}
    for _ in range(ROUNDS):
        attempt = forged(rnd, signed)
        assert attempt in known or not accepts(attempt)


# certified principals who sign what their role may not sign


@cache
def principal(role: Role, name: str = "") -> FileSigner:
    """Return the key of a certified principal who is confined to no robot and no region."""
    return approvals.key_of(scenarios.trust_folder(), name or f"{role}-x", role)


def mission_by(name: str) -> Mission:
    return scenarios.mission(issuer=name)


def snapshot(sim: Simulation) -> Any:
    """Return what an estimator would sign next."""
    seen = sim.gate.enforcer.inputs.newest
    assert seen is not None
    return msgspec.structs.replace(seen.snapshot, seq=seen.snapshot.seq + 1)


def about_the_mission(**fields: Any) -> dict[str, Any]:
    signed = scenarios.mission()
    same = {"mid": signed.mid, "version": 1, "mission": digest_of(Tag.MISSION, signed)}
    return {**same, **fields}


def answer(_: Simulation) -> Approval:
    fields = {
        "rid": scenarios.RID,
        "grant": "go-to-pharmacy",
        "scope": b64(bytes(32)),
        "situation": b64(bytes(32)),
        "counter": 1,
        "expires_ms": scenarios.START_MS + 60_000,
        "verdict": ApprovalVerdict.APPROVE,
    }
    return Approval(**about_the_mission(**fields))


def selection(_: Simulation) -> Selection:
    fields = {"grant": "go-to-pharmacy", "row": 0, "nonce": b64(bytes(16))}
    return Selection(**about_the_mission(**fields, expires_ms=scenarios.START_MS + 60_000))


def command(verb: Verb) -> Callable[[Simulation], Command]:
    fields = {"verb": verb, "nonce": b64(bytes(16)), "expires_ms": scenarios.START_MS + 60_000}
    return lambda _: Command(**about_the_mission(**fields))


def sensed(sim: Simulation, token: bytes) -> None:
    """Hand a snapshot in on the estimator's channel; raise why the gate does not take it in."""
    sim.robot.latest = lambda: token  # type: ignore[method-assign]
    sim.gate.enforcer.inputs.refresh()
    if sim.gate.enforcer.inputs.fault is not None:
        raise sim.gate.enforcer.inputs.fault


PEOPLE = {Role.OPERATOR, Role.SUPERVISOR, Role.SAFETY_OFFICER}
ISSUERS = {Role.OPERATOR, Role.SAFETY_OFFICER}
#: What a gate takes in: under which tag, what it says, which roles may sign it, who is handed it.
SIGNED: dict[str, tuple[Tag, Callable[[Simulation], Any], set[Role], Callable[..., Any]]] = {
    "mission": (
        Tag.MISSION,
        lambda _: scenarios.mission(mission="another"),
        ISSUERS,
        lambda sim, token: sim.gate.management.activate(token),
    ),
    "template": (
        Tag.TEMPLATE,
        lambda _: templates.template(),
        ISSUERS,
        lambda sim, token: sim.gate.management.template(token),
    ),
    **{
        f"command: {verb}": (
            Tag.COMMAND,
            command(verb),
            {Role.SITE_AUTHORITY} if verb is Verb.SHRED else ISSUERS,
            {
                Verb.SHRED: lambda sim, token: sim.gate.management.shred(token),
                Verb.ACCEPT_STORE: lambda sim, token: sim.gate.management.accept_store(token),
            }.get(verb, lambda sim, token: sim.gate.management.command(token)),
        )
        for verb in Verb
    },
    "selection": (
        Tag.SELECTION,
        selection,
        PEOPLE,
        lambda sim, token: sim.gate.management.select(token),
    ),
    "approval": (
        Tag.APPROVAL,
        answer,
        PEOPLE,
        lambda sim, token: sim.gate.management.approve(token),
    ),
    "state": (Tag.STATE, snapshot, {Role.ESTIMATOR}, sensed),
}


@pytest.mark.parametrize("role", Role)
def test_a_mission_is_accepted_exactly_from_the_roles_that_may_issue_one(role: Role) -> None:
    """Whoever signs names himself as the issuer, and his certificate confines him to nothing."""
    name = f"{role}-x"
    token = sign_object(mission_by(name), Tag.MISSION, principal(role))
    sim = scenarios.simulation()
    if role in ISSUERS:
        assert accepts(token)
        assert sim.gate.management.activate(token).status == "active"
        assert scenarios.propose(sim, GO).outcome is Outcome.SUCCEEDED
        return
    with pytest.raises(AuthGuardError) as caught:
        open_mission(token)
    assert caught.value.reason is Reason.ROLE_DENIED
    with pytest.raises(AuthGuardError) as caught:
        sim.gate.management.activate(token)
    assert caught.value.reason is Reason.ROLE_DENIED
    assert sim.gate.management.standing(scenarios.mission().mid) is None
    refused = scenarios.propose(sim, GO).refusal
    assert refused.reason is Reason.NO_ACTIVE_MISSION
    assert sim.robot.trace == []


@pytest.mark.parametrize("kind", SIGNED)
def test_nothing_is_taken_in_that_a_role_may_not_sign(kind: str) -> None:
    tag, said, roles, hand_in = SIGNED[kind]
    sim = scenarios.simulation()
    standing = sim.gate.management.activate(scenarios.token())
    sim.gate.enforcer.inputs.refresh()
    state = sim.gate.enforcer.inputs.newest
    rows = sim.gate.ledger.store.rows  # type: ignore[attr-defined]
    before, denied = len(rows()), [role for role in Role if role not in roles]
    for role in denied:
        with pytest.raises(AuthGuardError) as caught:
            hand_in(sim, sign_object(said(sim), tag, principal(role)))
        assert caught.value.reason is Reason.ROLE_DENIED
        assert sim.gate.management.standing("deliver-p1") == standing
        assert sim.gate.enforcer.inputs.newest is state
    told = [read_record(row.record, where="").open["reasons"] for row in rows()[before:]]
    assert told == [["ROLE_DENIED"]] * len(denied)
    assert sim.robot.trace == []


def test_no_issuer_signs_in_the_name_of_another() -> None:
    own = principal(Role.OPERATOR, "operator-9")
    for name in ("operator-1", "operator-8", "safety-officer-1"):
        token = sign_object(mission_by(name), Tag.MISSION, own)
        with pytest.raises(AuthGuardError) as caught:
            open_mission(token)
        assert caught.value.reason is Reason.ISSUER_MISMATCH
    assert accepts(sign_object(mission_by("operator-9"), Tag.MISSION, own))


@pytest.mark.parametrize("changes", [1, 2, 3])
def test_no_action_outside_the_policy_of_a_signed_mission_is_accepted(changes: int) -> None:
    accepted = 0
    for seed in range(ROUNDS):
        ours, theirs = agree_accepts(broken_case(Random(seed), changes))
        assert not (ours and not theirs)
        accepted += ours
    assert accepted < ROUNDS


def test_every_action_inside_the_policy_is_accepted() -> None:
    assert all(agree_accepts(accepted_case(Random(seed))) == (True, True) for seed in range(ROUNDS))
