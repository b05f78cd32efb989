# SPDX-License-Identifier: Apache-2.0
"""Sixteen self-checks before any number is trusted, in the paper's order.

Signature, replay, robot binding, trusted state, provenance, approval signatures, audit integrity.
Each tries the real thing and reports what came back. Source: section "Controlled Validation".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import msgspec

from authguard_r.audit.record import LogRow, Terminal
from authguard_r.audit.verify import verify_rows
from authguard_r.core.encoding import Tag
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.identifiers import VariableId
from authguard_r.core.provenance import Label
from authguard_r.core.quantities import Now
from authguard_r.core.token import open_token, sign_object, verify_mission
from authguard_r.enforcement.inputs import ISSUER_ROLES
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.keys.signer import folder_signer
from authguard_r.server.wiring import sign_terminal
from authguard_r.sim.robot import snapshot_of
from authguard_r.store.memory import MemoryStore
from missionpair import suite
from missionpair.bench import LIFTER, Bench, BenchScene, approve, calls, order, propose

GO = calls(("navigate_to", {"destination": "Pharmacy", "speed": 0.8}))


@dataclass(frozen=True)
class SelfCheck:
    """One named check: its group in the paper's list, and what must hold."""

    group: str
    name: str
    holds: Callable[[Bench], bool]


def _verifies(bench: Bench, token: bytes) -> str:
    """Return `ok`, or the reason why a token does not verify."""
    now = Now(bench.start_ms, 0)
    trust = bench.simulation().gate.trust
    try:
        verify_mission(token, verifier=trust, now=now, roles=ISSUER_ROLES)
    except AuthGuardError as error:
        return str(error.reason)
    return "ok"


def _reasons(scene: BenchScene) -> tuple[str, ...]:
    """Return why the scene's plan is refused; empty when it is carried out."""
    report = propose(scene)[-1]
    if report.judged is not None:
        return tuple(str(reason) for reason in report.judged.decision.reasons)
    return () if report.refusal is None else (str(report.refusal.reason),)


def authentic(bench: Bench) -> bool:
    """The operator's signature over a mission verifies."""
    return _verifies(bench, bench.sign(bench.mission(bench.draft()))) == "ok"


def altered(bench: Bench) -> bool:
    """A mission that was changed after signing does not verify."""
    token = bytearray(bench.sign(bench.mission(bench.draft())))
    middle = token.index(b'"payload":"') + 200
    token[middle] = ord("A") if token[middle] != ord("A") else ord("B")
    return _verifies(bench, bytes(token)) != "ok"


def wrong_role(bench: Bench) -> bool:
    """A supervisor's signature does not make a mission."""
    mission = bench.mission(bench.draft(issuer="supervisor-1"))
    return _verifies(bench, bench.sign(mission, "supervisor-1")) == "ROLE_DENIED"


def wrong_tag(bench: Bench) -> bool:
    """A signature made for another kind of object does not make a mission."""
    mission = bench.mission(bench.draft())
    token = sign_object(mission, Tag.SELECTION, folder_signer(bench.folder, "operator-1"))
    relabeled = token.replace(Tag.SELECTION.encode(), Tag.MISSION.encode())
    return _verifies(bench, relabeled) == "SIGNATURE_INVALID"


def completed(bench: Bench) -> bool:
    """A completed mission authorizes nothing, and cannot be activated again."""
    scene = suite.replay(bench)
    refused = _reasons(scene)
    try:
        scene.sim.gate.management.activate(bench.sign(scene.mission))
    except AuthGuardError as error:
        return refused == ("MISSION_COMPLETED",) and str(error.reason) == "MISSION_COMPLETED"
    return False


def revoked(bench: Bench) -> bool:
    """After a revocation the next action is refused."""
    scene = suite.at_dock(bench, bench.draft(), GO)
    order(bench, scene, Verb.REVOKE)
    return _reasons(scene) == ("NO_ACTIVE_MISSION",)


def used_once(bench: Bench) -> bool:
    """A one-time grant is used up by its success."""
    draft = suite.with_grant(bench.draft(), "look-out", repeat=1, starts=1)
    scene = suite.at_dock(bench, draft, calls(("scan", {})))
    first = _reasons(scene)
    return first == () and _reasons(scene) == ("REPEAT_EXHAUSTED", "STARTS_EXHAUSTED")


def other_robot(bench: Bench) -> bool:
    """A mission for one robot is refused by another."""
    scene = BenchScene(
        sim=bench.simulation(rid=LIFTER), mission=bench.mission(bench.draft()), plan=GO
    )
    try:
        scene.sim.gate.management.activate(bench.sign(scene.mission))
    except AuthGuardError as error:
        return str(error.reason) == "ROBOT_MISMATCH"
    return False


def other_profile(bench: Bench) -> bool:
    """A mission for this robot with another capability profile is refused."""
    mission = bench.mission(bench.draft())
    wrong = msgspec.structs.replace(mission, profile=mission.site)
    scene = BenchScene(sim=bench.simulation(), mission=wrong, plan=GO)
    try:
        scene.sim.gate.management.activate(bench.sign(wrong))
    except AuthGuardError as error:
        return str(error.reason) == "PROFILE_MISMATCH"
    return False


def state_absent(bench: Bench) -> bool:
    """Without attested state nothing that needs it is accepted."""
    scene = suite.at_dock(bench, bench.draft(), calls(("scan", {})))
    scene.sim.robot.latest = lambda: None  # type: ignore[method-assign]
    return _reasons(scene) == ("STATE_MISSING",)


def state_stale(bench: Bench) -> bool:
    """State that grew too old is not state."""
    scene = suite.at_dock(bench, bench.draft(), calls(("scan", {})))
    propose(scene)
    held = scene.sim.robot.latest()
    scene.sim.robot.latest = lambda: held  # type: ignore[method-assign]
    scene.sim.gate.enforcer.inputs.refresh()  # its age counts from when the gate takes it in
    scene.sim.robot.pause(5_000)
    return _reasons(scene) == ("STATE_STALE",)


def state_from_a_camera(bench: Bench) -> bool:
    """A value that a camera read satisfies no guard, even when an estimator signs it."""
    scene = suite.at_dock(bench, bench.draft(), calls(("scan", {})))
    robot = scene.sim.robot
    seen = snapshot_of(robot.state, robot=robot.rid, epoch=1, seq=999)
    name = VariableId("battery_permille")
    camera = msgspec.structs.replace(seen.readings[name], label=Label.CAMERA)
    seen = msgspec.structs.replace(seen, readings={**seen.readings, name: camera})
    token = sign_object(seen, Tag.STATE, folder_signer(bench.folder, f"estimator-{robot.rid}"))
    robot.latest = lambda: token  # type: ignore[method-assign]
    return _reasons(scene) == ("STATE_UNTRUSTED",)


def unsigned_choice(bench: Bench) -> bool:
    """A sign may not choose among signed rows; the operator's signature may."""
    return _reasons(suite.provenance_destination(bench)) == ("PROVENANCE_DENIED",) and not _reasons(
        suite.a_signed_choice(bench)
    )


def too_few_approvals(bench: Bench) -> bool:
    """T - 1 principals are not enough, t are."""
    scene = suite.restricted(bench)
    first = _reasons(scene)
    approve(bench, scene, "supervisor-1")
    second = _reasons(scene)
    approve(bench, scene, "supervisor-2")
    return first == second == ("APPROVAL_REQUIRED",) and not _reasons(scene)


def approval_for_another_room(bench: Bench) -> bool:
    """An approval that is bound to another action approves nothing here."""
    scene = suite.restricted(bench)
    propose(scene)
    approve(bench, scene, "supervisor-1", "supervisor-2", scope=scene.digest)
    return _reasons(scene) == ("APPROVAL_REQUIRED",)


def log_tampering(bench: Bench) -> bool:
    """A changed, a reordered and a shortened log are each found."""
    scene = suite.at_dock(bench, bench.draft(), GO)
    propose(scene)
    gate = scene.sim.gate
    anchor = sign_terminal(gate, scene.sim.signer)
    terminal, _, _ = open_token(
        anchor,
        Terminal,
        tag=Tag.CHECKPOINT,
        roles=frozenset({"gate"}),
        verifier=gate.trust,
        now=Now(bench.start_ms, 0),
    )
    rows = _rows(scene)
    changed = list(rows)
    changed[1] = LogRow(
        1, rows[1].record.replace(b"accept", b"reject"), rows[1].sealed, rows[1].link
    )
    changed[1] = (
        changed[1] if changed[1] != rows[1] else LogRow(1, rows[0].record, b"{}", rows[1].link)
    )
    swapped = [rows[1], rows[0], *rows[2:]]
    found = [
        verify_rows(log, terminal=terminal).whole for log in (rows, changed, swapped, rows[:-1])
    ]
    return found == [True, False, False, False]


def _rows(scene: BenchScene) -> list[LogRow]:
    store = scene.sim.gate.ledger.store
    if not isinstance(store, MemoryStore):
        raise TypeError("the self-checks keep their log in memory")
    return list(store.rows())


SELF_CHECKS: tuple[SelfCheck, ...] = (
    SelfCheck("signature", "an authentic mission verifies", authentic),
    SelfCheck("signature", "an altered mission does not", altered),
    SelfCheck("signature", "another role's signature does not", wrong_role),
    SelfCheck("signature", "another kind's signature does not", wrong_tag),
    SelfCheck("replay", "a completed mission is over", completed),
    SelfCheck("replay", "a revoked mission is over", revoked),
    SelfCheck("replay", "a one-time grant is used up", used_once),
    SelfCheck("robot binding", "another robot refuses", other_robot),
    SelfCheck("robot binding", "another profile refuses", other_profile),
    SelfCheck("trusted state", "absent state is refused", state_absent),
    SelfCheck("trusted state", "stale state is refused", state_stale),
    SelfCheck("trusted state", "camera state is refused", state_from_a_camera),
    SelfCheck("provenance", "only a signature chooses", unsigned_choice),
    SelfCheck("approval signatures", "t - 1 approvals are too few", too_few_approvals),
    SelfCheck(
        "approval signatures", "another action's approval is void", approval_for_another_room
    ),
    SelfCheck("audit integrity", "tampering is found", log_tampering),
)
