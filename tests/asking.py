# SPDX-License-Identifier: Apache-2.0
"""Missions that ask people, in the shipped hospital, and who answers; for tests of approvals.

scene = asking.scene(bench, to="isolation-room")
asking.outcome(scene)                      # ["APPROVAL_REQUIRED"]
asking.questions(scene).told(None).requests
"""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec

import worlds
from authguard_r.approvals import answer
from authguard_r.assembly import folder_signer
from authguard_r.core.approval import Approval, Verdict
from authguard_r.core.encoding import Tag
from authguard_r.core.mission import Mission
from authguard_r.core.standing import ApprovalRequest
from authguard_r.core.token import sign_object
from authguard_r.gate.questions import OpenQuestions
from authguard_r.keys.algorithms import Algorithm, PrivateKey, generate
from authguard_r.keys.certificate import Role, build_leaf
from authguard_r.keys.setup import read_authority
from authguard_r.keys.signer import FileSigner
from gates import RunningGate
from missionpair.bench import Bench, Scene, calls, propose
from missionpair.suite import at_dock, wide, with_grant

#: How the planner's tools call the regions of these tests.
SPOKEN = {
    "isolation-room": "Isolation Room",
    "office-1": "Office 1",
    "plant-room": "Plant Room",
    "pharmacy": "Pharmacy",
}


def draft(bench: Bench, *to: str, **risk: Any) -> dict[str, Any]:
    """Return the hospital's draft with ways from the dock to these regions; risk as changed."""
    rows = [
        {
            "source": "dock",
            "destination": place,
            "regions": ["dock", "public-corridor", place],
        }
        for place in to
    ]
    plain = with_grant(
        wide(bench), "go-to-pharmacy", rows=rows, repeat=5, starts=5, until=[], chooser="planner"
    )
    return {**plain, "risk_policy": {**plain["risk_policy"], **risk}}


def plan(to: str, speed: float = 0.8) -> bytes:
    """Return a plan of one motion."""
    return calls(("navigate_to", {"destination": SPOKEN[to], "speed": speed}))


def scene(bench: Bench, *to: str, **risk: Any) -> Scene:
    """Return a scene at the dock whose plan goes to the first of the regions."""
    return at_dock(bench, draft(bench, *to, **risk), plan(to[0]))


def outcome(at: Scene) -> list[str]:
    """Propose the plan; return the reasons of its last step, none when it was released."""
    report = propose(at)[-1]
    if report.refusal is not None:
        return [str(report.refusal.reason)]
    return [str(reason) for reason in report.judged.decision.reasons]  # type: ignore[union-attr]


def requests(at: Scene) -> dict[Any, ApprovalRequest]:
    """Return the open requests."""
    standing = at.standing()
    assert standing is not None
    return standing.requests


def approval(at: Scene, *, verdict: Verdict = Verdict.APPROVE, **changes: Any) -> Approval:
    """Return what an approver would sign for the one open request, with something changed."""
    ((grant, request),) = requests(at).items()
    verified = at.sim.gate.ledger.run(at.sim.gate.enforcer.intake.active_mission)
    made = answer(verified, grant, request, rid=at.sim.robot.rid, verdict=verdict)
    return msgspec.structs.replace(made, **changes)


def signed(
    bench: Bench, value: Approval, by: str | FileSigner, *, tag: Tag = Tag.APPROVAL
) -> bytes:
    """Return the token of an answer."""
    signer = folder_signer(bench.folder, by) if isinstance(by, str) else by
    return sign_object(value, tag, signer)


def hand_in(bench: Bench, at: Scene, *by: str | FileSigner, **changes: Any) -> None:
    """Hand in one answer of each, all alike."""
    for who in by:
        at.sim.gate.management.approve(signed(bench, approval(at, **changes), who))


def questions(at: Scene, told: list[dict[str, Any]] | None = None) -> OpenQuestions:
    """Return the open requests as the gate's process tells them."""
    return OpenQuestions(at.sim.gate, [].append if told is None else told.append)


def records(at: Scene, kind: str) -> list[Any]:
    """Return the open part of every record of a kind."""
    rows = at.sim.gate.ledger.peek(lambda turn: turn.rows(0, 10_000))
    read = [msgspec.json.decode(row[1]) for row in rows]
    return [record for record in read if record["kind"] == kind]


def key_of(
    folder: Path,
    name: str,
    role: Role,
    *,
    robots: tuple[str, ...] | None = None,
    regions: tuple[str, ...] | None = None,
    threshold: int = 1,
    members: tuple[str, ...] = (),
    days: int = 365,
    key: PrivateKey | None = None,
) -> FileSigner:
    """Return a key under a folder's authority of people, a fresh one: a person's, or a group's."""
    authority = read_authority(folder, "people")
    key = key or generate(Algorithm.ED25519)
    leaf = build_leaf(
        key.public_key(),
        principal=name,
        role=role,
        issuer=authority.certificate,
        key=authority.key,
        now=datetime.fromtimestamp(worlds.START_MS / 1000, UTC),
        days=days,
        robots=robots,
        regions=regions,
        threshold=threshold,
        members=members,
    )
    from cryptography.hazmat.primitives.serialization import Encoding

    chain = (leaf.public_bytes(Encoding.DER), authority.certificate.public_bytes(Encoding.DER))
    return FileSigner(key, chain)


def at_gate(gate: RunningGate, **risk: Any) -> Mission:
    """Return the shipped mission with a way into the isolation room, which asks a second person."""
    plain = worlds.draft()
    row = {
        "source": "dock",
        "destination": "isolation-room",
        "regions": ["dock", "isolation-room", "public-corridor"],
    }
    grants = [
        {**g, "rows": [row], "repeat": 5, "starts": 5, "until": []}
        if g["id"] == "go-to-pharmacy"
        else g
        for g in plain["grants"]
    ]
    policy = {**plain["risk_policy"], **risk}
    return gate.mission(grants=grants, risk_policy=policy, limits={})
