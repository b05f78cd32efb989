# SPDX-License-Identifier: Apache-2.0
"""The acts that give, narrow, settle or end authority; each is one record.

Activation needs the signed mission itself. Everything else is a command signed by somebody who may
give it: narrowing (suspend, revoke) by the issuer or any safety officer, widening and settling
(resume, resolve, complete) by the issuer. Source: section "Mission Compilation and Clarification"
(updates), `alg:authguard` (the registry R). Spec page: docs/spec/standing.md#commands
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import msgspec

from authguard_r.approvals import open_selection
from authguard_r.audit.record import Entry
from authguard_r.commands import EVENTS, NARROWING, Command, Verb
from authguard_r.compile.confirmation import signed_inputs
from authguard_r.core.approval import VerifiedApproval
from authguard_r.core.checks.guards import guard_finding
from authguard_r.core.checks.mission import binding_findings
from authguard_r.core.encoding import Tag, encode_fast
from authguard_r.core.errors import AuthGuardError, EnvironmentFault, RefusedError
from authguard_r.core.facts import SiteFacts
from authguard_r.core.identifiers import Digest, MissionId, PrincipalId
from authguard_r.core.lifecycle import REFUSAL, TERMINAL, Event, Status
from authguard_r.core.mission import Grant
from authguard_r.core.ports import Verifier
from authguard_r.core.provenance import Chooser
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import (
    Outcome,
    Spend,
    Standing,
    advance,
    carry_over,
    finish,
    issue,
    select,
    settle,
)
from authguard_r.core.token import Principal, VerifiedMission, open_token
from authguard_r.intake import ISSUER_ROLES, Intake
from authguard_r.ledger import Act, Ledger
from authguard_r.report import refusal_entry

T = TypeVar("T")


class Management:
    """The operator's side of one robot's gate.

    Args:
        ledger: store and trusted time.
        intake: verifies missions and approvals.
        verifier: verifies commands and selections.
        facts: the signed site and the gate's identity.
    """

    def __init__(
        self, ledger: Ledger, intake: Intake, *, verifier: Verifier, facts: SiteFacts
    ) -> None:
        self._ledger = ledger
        self._intake = intake
        self._verifier = verifier
        self._facts = facts

    def activate(self, token: bytes, *, confirmation: bytes | None = None) -> Standing:
        """Take in a mission, or the next version of the active one, and make it active.

        Args:
            token: the signed mission.
            confirmation: the record of its signing; goes into the log, sealed, when it is of
                this mission. It grants nothing.

        Raises:
            MalformedError: not a mission token, or not schema-valid.
            AuthenticityError: certificate or signature does not hold.
            AuthGuardError: with the reason that speaks against it; nothing was changed.
        """
        return self._do(lambda act: self._activate(act, token, confirmation))

    def command(self, token: bytes) -> Standing:
        """Carry out a signed command once.

        Raises:
            AuthGuardError: malformed, not authentic, not allowed, or not possible now.
        """
        return self._do(lambda act: self._command(act, token))

    def select(self, token: bytes) -> Standing:
        """Take in a signed choice of one row.

        Raises:
            AuthGuardError: malformed, not authentic, or not the chooser's to make.
        """
        return self._do(lambda act: self._select(act, token))

    def approve(self, token: bytes) -> VerifiedApproval:
        """Keep a signed answer to an approval request; whether it fits is decided at use.

        Raises:
            AuthGuardError: malformed or not authentic.
        """

        def job(act: Act) -> VerifiedApproval:
            item = self._intake.take_approval(act, token)
            opened = {
                "verb": "answer",
                "by": item.approver.id,
                "role": item.approver.role,
                "kind": "individual",
                "verdict": item.approval.verdict,
                "counter": item.approval.counter,
            }
            act.record(_entry(act, item.approval.mid, opened))
            return item

        return self._do(job)

    def standing(self, mid: MissionId) -> Standing | None:
        """Return a mission's standing as it is held."""
        return self._ledger.run(lambda act: act.standing(mid))

    def recover(self) -> tuple[Digest, ...]:
        """After an unclean stop: settle what attested state settles, suspend for the rest.

        A release without an outcome may have happened or not. `done_when`, attested, says that it
        succeeded; else the mission waits, suspended, for a signed `resolve`. A mission that is
        closing goes on closing: what is in flight counts as used.

        Returns:
            Tickets that only a person can settle.
        """
        self._intake.refresh()
        return self._ledger.run(self._recover)

    def _do(self, job: Callable[[Act], T]) -> T:
        """Carry an order out, or leave one record of why not; the world's faults leave none."""
        try:
            return self._ledger.run(job)
        except EnvironmentFault:
            raise
        except AuthGuardError as error:
            refused = error
            self._ledger.note(lambda at: refusal_entry(refused, at))
            raise

    def _activate(self, act: Act, token: bytes, confirmation: bytes | None) -> Standing:
        verified = self._intake.verify_mission(token, act)
        self._require_usable(verified, act)
        mission = verified.mission
        current = act.active()
        old = self._lapsed(act, act.standing(current) if current is not None else None)
        if old is not None and old.status not in TERMINAL and current != mission.mid:
            raise _refuse(Reason.TRANSITION_REFUSED, f"`{current}` is active on this robot")
        known = act.standing(mission.mid)
        if known is None:
            standing = self._first(verified)
        elif known.digest == verified.digest:
            raise _replayed(known)
        else:
            standing = self._update(act, known, verified)
        active = advance(standing, Event.ACTIVATE)
        if active is None:  # pragma: no cover - issued missions can be activated
            raise _refuse(Reason.TRANSITION_REFUSED, f"the mission is {standing.status}")
        act.keep_token(verified.digest, token)
        act.hold(active)
        act.make_active(mission.mid)
        opened = {
            "verb": "activate",
            "by": mission.issuer,
            "version": mission.version,
            "mission": verified.digest,
            "supersedes": mission.supersedes or "-",
        }
        act.record(_entry(act, mission.mid, opened, signed_inputs(token, confirmation, mission)))
        return active

    def _lapsed(self, act: Act, standing: Standing | None) -> Standing | None:
        """Return the standing after what time alone has ended: its validity, or its closing."""
        if standing is None or standing.status in TERMINAL:
            return standing
        verified = self._intake.mission(act, standing.digest)
        ended: Standing | None = None
        if act.now.utc_ms > verified.expiry_ms:
            ended = advance(standing, Event.EXPIRE)
        elif standing.status is Status.CLOSING and act.now.utc_ms > standing.closes_ms:
            ended = advance(standing, Event.COMPLETE)
        if ended is None:
            return standing
        act.hold(ended)
        act.record(_entry(act, ended.mid, {"verb": "lapse", "status": ended.status}))
        return ended

    def _require_usable(self, verified: VerifiedMission, act: Act) -> None:
        """Refuse what could never be carried out here: robot, profile, site, time."""
        mission = verified.mission
        for finding in binding_findings(mission, self._facts):
            text = f"expected `{finding.got}`, got `{finding.expected}`"
            raise _refuse(finding.reason, text, finding.field)
        if act.now.utc_ms > verified.expiry_ms:
            raise _refuse(Reason.EXPIRED, f"it ended at {mission.expiry}", "mission.expiry")

    @staticmethod
    def _first(verified: VerifiedMission) -> Standing:
        if verified.mission.version != 1:
            raise _refuse(
                Reason.MISSION_UNKNOWN,
                f"version {verified.mission.version} supersedes one that is not here",
                "mission.supersedes",
            )
        return issue(verified)

    def _update(self, act: Act, known: Standing, verified: VerifiedMission) -> Standing:
        """Supersede the version before; only its issuer or a safety officer may."""
        mission = verified.mission
        if mission.version <= known.version:
            raise _replayed(known)
        if mission.supersedes != known.digest or mission.version != known.version + 1:
            raise _refuse(
                Reason.SUPERSEDED,
                f"expected the version after {known.version}, superseding its digest",
                "mission.supersedes",
            )
        before = self._intake.mission(act, known.digest)
        if verified.issuer.id != before.mission.issuer and verified.issuer.role != "safety_officer":
            raise _refuse(
                Reason.ROLE_DENIED, "only its issuer or a safety officer supersedes a mission"
            )
        if advance(known, Event.SUPERSEDE) is None:
            raise _refuse(Reason.TRANSITION_REFUSED, f"the mission is {known.status}")
        carried = carry_over(known, before.mission, verified)
        if carried is None:
            raise _refuse(
                Reason.TRANSITION_REFUSED,
                "a grant that stays keeps its rows and allows the starts already used",
                "mission.actions",
            )
        return carried

    def _command(self, act: Act, token: bytes) -> Standing:
        command, _, signer = open_token(
            token,
            Command,
            tag=Tag.COMMAND,
            roles=ISSUER_ROLES,
            verifier=self._verifier,
            now=act.now,
        )
        standing, verified = self._require_current(act, command, signer)
        after = self._carried_out(act, command, standing, verified)
        if after is None:
            raise _refuse(
                Reason.TRANSITION_REFUSED, f"the mission is {standing.status}: no {command.verb}"
            )
        act.hold(after)
        act.put("command", command.nonce, b"1")
        if after.status in TERMINAL:
            act.make_active(None)
            self._intake.forget()
        opened = {
            "verb": command.verb,
            "by": signer.id,
            "role": signer.role,
            "version": command.version,
            "status": after.status,
        }
        act.record(_entry(act, command.mid, opened, {"command": command}))
        return after

    def _require_current(
        self, act: Act, command: Command, signer: Principal
    ) -> tuple[Standing, VerifiedMission]:
        if act.now.utc_ms > command.expires_ms or act.get("command", command.nonce) is not None:
            raise _refuse(Reason.EXPIRED, "the command ran out or was carried out already")
        standing = act.standing(command.mid)
        if standing is None or standing.digest != command.mission:
            raise _refuse(Reason.MISSION_UNKNOWN, "no such mission version is here")
        verified = self._intake.mission(act, standing.digest)
        mine = signer.id == verified.mission.issuer
        if not mine and not (command.verb in NARROWING and signer.role == "safety_officer"):
            raise _refuse(Reason.ROLE_DENIED, f"`{signer.id}` may not {command.verb} this mission")
        return standing, verified

    @staticmethod
    def _carried_out(
        act: Act, command: Command, standing: Standing, verified: VerifiedMission
    ) -> Standing | None:
        if command.verb is Verb.RESUME and standing.open:
            return None  # what nobody knows is resolved first
        if command.verb is not Verb.RESOLVE:
            after = advance(standing, EVENTS[command.verb])
            return None if after is None else finish(after, verified.mission, act.now)
        if command.ticket is None or command.outcome in {None, Outcome.UNKNOWN}:
            return None
        if all(release.ticket != command.ticket for release in standing.open):
            return None
        after = settle(
            standing,
            verified.mission,
            ticket=command.ticket,
            outcome=Outcome(command.outcome),
            used=_reserved(standing, command.ticket),
        )
        return finish(after, verified.mission, act.now)

    def _select(self, act: Act, token: bytes) -> Standing:
        selection, signer = open_selection(token, verifier=self._verifier, now=act.now)
        standing = act.standing(selection.mid)
        named = (selection.mission, selection.version)
        if standing is None or (standing.digest, standing.version) != named:
            raise _refuse(Reason.MISSION_UNKNOWN, "no such mission version is here")
        if standing.status in TERMINAL:
            raise _replayed(standing)
        if act.now.utc_ms > selection.expires_ms or act.get("command", selection.nonce) is not None:
            raise _refuse(Reason.EXPIRED, "the selection ran out or was taken in already")
        verified = self._intake.mission(act, standing.digest)
        grant = next((g for g in verified.mission.actions if g.id == selection.grant), None)
        if grant is None or selection.row >= len(grant.alternatives):
            raise _refuse(Reason.SCHEMA_INVALID, "the mission has no such row", "selection.row")
        if not _may_choose(grant, signer, verified.mission.issuer):
            raise _refuse(Reason.ROLE_DENIED, f"the choice is the {grant.chooser}'s")
        chosen = select(standing, grant.id, selection.row)
        act.hold(chosen)
        act.put("command", selection.nonce, b"1")
        opened = {"verb": "select", "by": signer.id, "grant": grant.id, "row": selection.row}
        sealed: dict[str, object] = {"token": token.decode("ascii").strip()}
        act.record(_entry(act, selection.mid, opened, sealed))
        return chosen

    def _recover(self, act: Act) -> tuple[Digest, ...]:
        mid = act.active()
        standing = act.standing(mid) if mid is not None else None
        if standing is None or not standing.open:
            return ()
        verified = self._intake.mission(act, standing.digest)
        for release in standing.open:
            grant = next((g for g in verified.mission.actions if g.id == release.grant), None)
            if grant is not None and self._is_done(grant, act):
                standing = settle(
                    standing,
                    verified.mission,
                    ticket=release.ticket,
                    outcome=Outcome.SUCCEEDED,
                    used=release.reserved,
                )
        if standing.open:
            standing = advance(standing, Event.SUSPEND) or standing
        standing = finish(standing, verified.mission, act.now)
        act.hold(standing)
        opened = {"verb": "recover", "status": standing.status, "unknown": len(standing.open)}
        act.record(_entry(act, standing.mid, opened))
        return tuple(release.ticket for release in standing.open)

    def _is_done(self, grant: Grant, act: Act) -> bool:
        rid, state = self._facts.robot.rid, self._intake.state
        return bool(grant.done_when) and all(
            guard_finding(guard, state, rid, act.now) is None for guard in grant.done_when
        )


def _may_choose(grant: Grant, signer: Principal, issuer: PrincipalId) -> bool:
    if grant.chooser is Chooser.OPERATOR:
        return signer.id == issuer
    return grant.chooser is Chooser.SUPERVISOR and signer.role == "supervisor"


def _reserved(standing: Standing, ticket: Digest) -> Spend:
    """Nobody knows what it used, so all of it counts as used."""
    return next((r.reserved for r in standing.open if r.ticket == ticket), Spend())


def _entry(
    act: Act, mid: str, opened: dict[str, object], sealed: dict[str, object] | None = None
) -> Entry:
    plain = msgspec.json.decode(encode_fast(opened))
    return Entry(
        kind="management",
        time_ms=act.now.utc_ms,
        decision=str(opened["verb"]),
        mid=mid,
        open=plain,
        sealed=sealed or {},
    )


def _replayed(known: Standing) -> AuthGuardError:
    reason = REFUSAL.get(known.status, Reason.TRANSITION_REFUSED)
    return _refuse(reason, f"`{known.mid}` version {known.version} is here and {known.status}")


def _refuse(reason: Reason, message: str, where: str = "mission") -> AuthGuardError:
    return RefusedError(message, reason=reason, where=where)
