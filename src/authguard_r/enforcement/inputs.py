# SPDX-License-Identifier: Apache-2.0
"""What may enter the gate: state, missions and approvals, each held to its signer first.

Authority inputs come from here and from nowhere else: a request carries no state, no time, no
standing and no mission (L4). Spec page: docs/spec/enforcement.md#intake
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from typing import Protocol

from msgspec.structs import replace

from authguard_r.anchoring.anchor import StoreAnchor
from authguard_r.approvals import open_approval, open_preapproval
from authguard_r.approvals.preapprovals import PreApprovalStore, VerifiedApprovals
from authguard_r.audit.record import Entry
from authguard_r.core.approval import ApprovalVerdict, VerifiedApproval, VerifiedPreApproval
from authguard_r.core.encoding import Tag, encode_fast, unb64
from authguard_r.core.errors import (
    AuthenticityError,
    AuthGuardError,
    MalformedError,
    RefusedError,
    StoreError,
)
from authguard_r.core.facts import SiteFacts
from authguard_r.core.identifiers import Digest, MissionId, RobotId
from authguard_r.core.ports import StateSource
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Standing
from authguard_r.core.state import AttestedState, Snapshot, attest
from authguard_r.core.token import VerifiedMission, open_token, read_token, verify_mission
from authguard_r.enforcement.templates import (
    Delegations,
    HeldMission,
    InstancePair,
    Instantiated,
    KeptTemplate,
    VerifiedTemplate,
    claimed_template,
    held_mission,
    instantiate,
    is_pair,
    open_template,
)
from authguard_r.store.issued_missions import issued
from authguard_r.store.transactions import Ledger, Transaction, read_held
from authguard_r.wire.gate_limits import LIMITS

ISSUER_ROLES = frozenset({"operator", "safety_officer"})
ESTIMATOR_ROLES = frozenset({"estimator"})


class Identities(Delegations, Protocol):
    """A verifier that can also say whose estimator a certificate is, and whose key is whose."""

    def bearer(self, chain: tuple[bytes, ...]) -> tuple[str, bytes]:
        """Return whose name a chain's leaf has, and its public key; whether it holds, others say.

        Raises:
            AuthenticityError: its certificate cannot be verified.
        """
        ...

    def attested_robot(self, chain: tuple[bytes, ...], now: Now) -> RobotId:
        """Return the one robot that the chain's leaf may speak of.

        Raises:
            AuthenticityError: the chain does not hold at `now`, or is not an estimator's.
        """
        ...


class InputVerifier:
    """The gate's side of every channel that authority or state comes through.

    Args:
        ledger: for trusted time and what is held.
        verifier: certificates and signatures, and what a certificate is bound to.
        source: the estimator's channel.
        facts: the signed site and the gate's identity.
        anchor: whether the store is the one that was counted outside of it.
    """

    def __init__(
        self,
        ledger: Ledger,
        verifier: Identities,
        *,
        source: StateSource,
        facts: SiteFacts,
        anchor: StoreAnchor,
    ) -> None:
        self.anchor = anchor
        self._ledger = ledger
        self._verifier = verifier
        self._source = source
        self._facts = facts
        self._verified: dict[Digest, VerifiedMission] = {}
        #: Pre-approvals of missions.
        self.preapprovals = PreApprovalStore(verifier)
        self._state: AttestedState | None = None
        self._seen: bytes | None = None
        self._held: bytes | None = None
        #: Take state in while the clock is behind, too: something may be done without one.
        self.outlasts_clock = False
        #: Why the last snapshot was not taken in; None when it was.
        self.fault: AuthGuardError | None = None
        ledger.when_fenced(source.fence)

    @property
    def newest(self) -> AttestedState | None:
        """The newest attested state that was taken in, for what runs already."""
        return self._state

    @property
    def state(self) -> AttestedState | None:
        """The same for a decision: nothing in it counts that is from before the last motion."""
        return None if self._state is None else replace(self._state, fence=self._ledger.fence)

    def refresh(self) -> AttestedState | None:
        """Take in the newest snapshot and return `state`; a bad one is recorded, and the last ages.

        Not inside a turn: what it records is an act of its own.
        """
        data = self._source.latest()
        if data is None or data == self._seen:
            return self.state
        try:
            state = self._attest(data)
        except (MalformedError, AuthenticityError) as error:
            self._seen, self.fault = data, error
            fault = error
            self._ledger.refuse(
                lambda at: Entry(
                    kind="intake",
                    time_ms=at,
                    decision="refused",
                    open={"what": "state", "reasons": [fault.reason]},
                    sealed={"where": fault.where, "message": fault.message},
                ),
                dedup_key=("estimator", fault.reason, fault.where),
            )
        else:
            self._seen, self._state, self.fault = data, state, None
            self._held = data
        return self.state

    def doubt(self, now: Now) -> None:
        """Verify again what was verified before: who may sign what has changed.

        Missions are verified anew when they are next asked for. The state is, now: where its
        estimator was revoked there is none until another one attests it.
        """
        self.forget()
        try:
            if self._held is not None:
                self._open_snapshot(self._held, now)
        except AuthenticityError as error:
            self._state, self._held, self.fault = None, None, error

    def active_mission(self, act: Transaction) -> VerifiedMission:
        """Return the one active mission, verified once and kept by the digest of its bytes.

        Raises:
            RefusedError: no mission is active (`NO_ACTIVE_MISSION`; `MISSION_NOT_ACTIVE` when one
                is issued), or the store was rolled back (`ROLLED_BACK`).
            StoreError: its token is gone.
            AuthenticityError: its certificates do not hold any more.
        """
        self.anchor.require()
        mid = act.active()
        standing = act.standing(mid) if mid is not None else None
        if standing is None:
            text, reason = "no mission is active on this robot", Reason.NO_ACTIVE_MISSION
            if issued(act):
                text += ", only issued: `authguard mission activate TOKEN` makes one active"
                reason = Reason.MISSION_NOT_ACTIVE
            raise RefusedError(text, where="mission", reason=reason)
        return self.mission(act, standing.digest)

    def mission(self, act: Transaction, digest: Digest) -> VerifiedMission:
        """Return the mission version with this digest from the gate's own keeping.

        Raises:
            StoreError: its token is gone, or is of another mission.
            RefusedError: it was made of a template that was withdrawn.
            AuthenticityError: a certificate does not hold any more.
        """
        known = self._verified.get(digest)
        return self._verify_held(act, digest) if known is None else known

    def _verify_held(self, act: Transaction, digest: Digest) -> VerifiedMission:
        held = _token(act, digest)
        verified = self._verify_pair(held, act) if is_pair(held) else self.verify_mission(held, act)
        if verified.digest != digest:
            raise _corrupt(f"expected the token of `{digest}`, got `{verified.digest}`'s")
        return verified

    def held(self, act: Transaction, digest: Digest) -> HeldMission:
        """Return a mission version as it was verified once, to end, settle or show it by.

        Its certificates may have ended since; that prevents no person from ending what they began.
        Nothing that widens goes by it.

        Raises:
            StoreError: its token is gone, or is of another mission.
        """
        return held_mission(_token(act, digest), digest)

    def lost(self, act: Transaction, digest: Digest) -> Reason | None:
        """Return why no valid signature stands behind a mission now; None: one does.

        Asked anew; an earlier answer does not count.

        Raises:
            StoreError: its token is gone, or is of another mission.
        """
        try:
            self._verify_held(act, digest)
        except (AuthenticityError, RefusedError) as error:
            return error.reason
        return None

    def kept(self, digest: Digest) -> VerifiedMission | None:
        """Return a mission version that was verified before, to be shown; it gives no authority."""
        return self._verified.get(digest)

    def verify_mission(self, token: bytes, act: Transaction) -> VerifiedMission:
        """Return the mission in a token, at the act's time, and keep it.

        Raises:
            MalformedError: not a mission token, or not schema-valid.
            AuthenticityError: certificate or signature does not hold.
        """
        verified = verify_mission(token, verifier=self._verifier, now=act.now, roles=ISSUER_ROLES)
        return self._keep(verified)

    def verify_template(self, token: bytes, act: Transaction) -> VerifiedTemplate:
        """Return the template in a token, at the act's time.

        Raises:
            MalformedError: not a template token, or not sound.
            AuthenticityError: certificate or signature does not hold.
        """
        return open_template(token, verifier=self._verifier, now=act.now, roles=ISSUER_ROLES)

    def kept_template(self, act: Transaction, digest: Digest) -> KeptTemplate | None:
        """Return what is kept of a template, None when it was never taken in."""
        held = act.get("template", digest)
        return None if held is None else read_held(held, KeptTemplate, "template")

    def verify_instance(self, token: bytes, act: Transaction) -> tuple[Instantiated, KeptTemplate]:
        """Return the mission in an instance token, at the act's time, and its template as kept.

        Its template is verified anew: an operator whose certificate was revoked issues nothing.

        Raises:
            MalformedError: not an instance token, or its combination is not schema-valid.
            AuthenticityError: a certificate or signature does not hold, or is for another template.
            RefusedError: the template is not here or withdrawn, or does not cover what it says.
        """
        kept = self._require_template(act, claimed_template(token))
        template = self.verify_template(kept.token.encode("ascii"), act)
        made = instantiate(token, template, verifier=self._verifier, now=act.now)
        self._keep(made.mission)
        return made, kept

    def _verify_pair(self, held: bytes, act: Transaction) -> VerifiedMission:
        """Return a mission that a template was filled with, from both its tokens."""
        pair = read_held(held, InstancePair, "token")
        template = self.verify_template(pair.template.encode("utf-8"), act)
        self._require_template(act, template.digest)
        token = pair.instance.encode("utf-8")
        return self._keep(
            instantiate(token, template, verifier=self._verifier, now=act.now).mission
        )

    def _require_template(self, act: Transaction, digest: Digest) -> KeptTemplate:
        kept = self.kept_template(act, digest)
        if kept is None or kept.withdrawn:
            gone = kept is not None
            raise RefusedError(
                "the template was withdrawn" if gone else "no such template is here",
                where="template",
                reason=Reason.REVOKED if gone else Reason.MISSION_UNKNOWN,
            )
        return kept

    def _keep(self, verified: VerifiedMission) -> VerifiedMission:
        """Keep a verified mission in memory and forget the oldest, so that memory is bounded."""
        if len(self._verified) >= LIMITS.kept_missions:
            self._verified.clear()
        self._verified[verified.digest] = verified
        return verified

    def forget(self) -> None:
        """Drop every kept mission: after a revocation the next action verifies anew."""
        self._verified.clear()
        self.preapprovals.forget()

    def verify_answer(self, act: Transaction, token: bytes) -> VerifiedApproval:
        """Return the answer in a token, at the act's time.

        Raises:
            MalformedError: not an approval token.
            AuthenticityError: certificate or signature does not hold.
        """
        return open_approval(token, verifier=self._verifier, now=act.now)

    def keep_answer(self, act: Transaction, verified: VerifiedApproval, token: bytes) -> bool:
        """Keep an answer to an open request until that is used or dies; False: it was kept before.

        Raises:
            RefusedError: its signer has given this answer so often already (`BUSY`), or has signed
                under another name (`ISSUER_MISMATCH`).
        """
        key = f"{verified.approval.mid}:{verified.approval.counter}"
        held = act.get("approvals", key)
        tokens = read_held(held, tuple[str, ...], "approvals") if held else ()
        if verified.approval.verdict is ApprovalVerdict.APPROVE:
            self._require_one_name(token, (*_issuing(act, verified.approval.mid), *tokens))
        same = [
            kept.approval
            for kept, _ in self._authentic(act, tokens)
            if (kept.approver.id, kept.approval.verdict)
            == (verified.approver.id, verified.approval.verdict)
        ]
        if verified.approval in same:  # one answer has many signatures, and counts once
            return False
        if len(same) >= LIMITS.kept_answers:
            text = f"`{verified.approver.id}` has said this often enough"
            raise RefusedError(text, reason=Reason.BUSY, where="approval")
        act.put("approvals", key, encode_fast((*tokens, token.decode("ascii").strip())))
        return True

    def _require_one_name(self, token: bytes, others: tuple[str, ...]) -> None:
        """Require that an approver has signed no other answer under another name.

        People are counted by names; an authority that gave one key two names gave one person two
        voices. A denial is accepted from every person.
        """
        mine = set(self._bearers(token.decode("ascii")))
        keys = {key for _, key in mine}
        for name, key in (bearer for other in others for bearer in self._bearers(other)):
            if key in keys and (name, key) not in mine:
                raise RefusedError(
                    f"the key that approves is `{name}`'s, who has signed already",
                    reason=Reason.ISSUER_MISMATCH,
                    where="approval",
                )

    def _bearers(self, token: str) -> Iterator[tuple[str, bytes]]:
        """Yield whose names and keys are behind a token that was verified."""
        for endorsement in read_token(token.encode("ascii")).endorsements:
            chain = tuple(unb64(der, where="token.endorsements") for der in endorsement.chain)
            yield self._verifier.bearer(chain)

    def answers(self, act: Transaction, standing: Standing | None) -> VerifiedApprovals:
        """Return every kept answer to an open request, and pre-approval, that is authentic now."""
        found: list[tuple[VerifiedApproval, str]] = []
        for request in () if standing is None else standing.requests.values():
            held = act.get("approvals", f"{standing.mid}:{request.counter}") if standing else None
            tokens = read_held(held, tuple[str, ...], "approvals") if held else ()
            found += self._authentic(act, tokens)
        stored = () if standing is None else self.preapprovals.kept(act, standing, act.now)
        return VerifiedApprovals(
            approvals=tuple(one for one, _ in found),
            tokens=tuple(token for _, token in found),
            preapprovals=tuple(one for one, _ in stored),
            preapproval_tokens={one.digest: token for one, token in stored},
        )

    def verify_preapproval(self, act: Transaction, token: bytes) -> VerifiedPreApproval:
        """Return the pre-approval in a token at the transaction's time; its signer is no issuer.

        Raises:
            MalformedError: not a pre-approval token.
            AuthenticityError: certificate or signature does not hold.
            RefusedError: its key has issued the mission under another name (`ISSUER_MISMATCH`).
        """
        item = open_preapproval(token, verifier=self._verifier, now=act.now)
        self._require_one_name(token, _issuing(act, item.preapproval.mid))
        return item

    def _authentic(
        self, act: Transaction, tokens: tuple[str, ...]
    ) -> Iterator[tuple[VerifiedApproval, str]]:
        """Yield the kept answers that hold now: an approver revoked since then does not count."""
        for token in tokens:
            with suppress(MalformedError, AuthenticityError):
                data = token.encode("ascii")
                yield open_approval(data, verifier=self._verifier, now=act.now), token

    def _attest(self, data: bytes) -> AttestedState:
        now = self._ledger.latest() if self.outlasts_clock else self._ledger.now()
        snapshot = self._open_snapshot(data, now)
        self._require_own(data, snapshot, now)
        if snapshot.epoch > now.utc_ms + LIMITS.skew_ms:
            # before it counts: the largest epoch there is would be the last one ever taken in
            raise AuthenticityError(
                f"expected an epoch up to {now.utc_ms + LIMITS.skew_ms}, got {snapshot.epoch}",
                reason=Reason.VALUE_OUT_OF_RANGE,
                where="state.epoch",
            )
        last = self._ledger.snapshot
        if (snapshot.epoch, snapshot.seq) <= last:
            raise AuthenticityError(
                f"expected a snapshot after epoch {last[0]}, seq {last[1]}",
                reason=Reason.STATE_REPLAYED,
                where="state.seq",
            )
        self._ledger.snapshot = (snapshot.epoch, snapshot.seq)
        return attest(snapshot, self._facts, arrived_mono_ms=now.mono_ms)

    def _open_snapshot(self, data: bytes, now: Now) -> Snapshot:
        opened, _, _ = open_token(
            data, Snapshot, tag=Tag.STATE, roles=ESTIMATOR_ROLES, verifier=self._verifier, now=now
        )
        return opened

    def _require_own(self, data: bytes, snapshot: Snapshot, now: Now) -> None:
        """Refuse another robot's state, and another robot's estimator, before they count at all.

        Raises:
            AuthenticityError: it is of another robot, or by an estimator that is not this one's.
        """
        own = self._facts.robot.rid
        chains = [endorsement.chain for endorsement in read_token(data).endorsements]
        whose = {
            self._verifier.attested_robot(tuple(unb64(der) for der in chain), now)
            for chain in chains
        }
        if whose | {snapshot.robot} != {own}:
            raise AuthenticityError(
                f"expected the state of `{own}` by its own estimator",
                reason=Reason.STATE_FOREIGN,
                where="state.robot",
            )


def _token(act: Transaction, digest: Digest) -> bytes:
    """Return a mission version as it was taken in: a token, or a template's and its instance's."""
    held = act.token(digest)
    if held is None and act.get("token", digest) is not None:
        text = "the mission is over, and the store no longer has its token"
        raise RefusedError(text, reason=Reason.TRANSITION_REFUSED, where="mission")
    if held is None:
        raise _corrupt("the mission's token is gone")
    return held


def _issuing(act: Transaction, mid: MissionId) -> tuple[str, ...]:
    """Return every token that the authority of a mission's version in force comes from."""
    standing = act.standing(mid)
    return () if standing is None else _parts(_token(act, standing.digest))


def _parts(held: bytes) -> tuple[str, ...]:
    if not is_pair(held):
        return (held.decode("ascii"),)
    pair = read_held(held, InstancePair, "token")
    return pair.template, pair.instance


def _corrupt(message: str) -> StoreError:
    return StoreError(message, where="mission", reason=Reason.STORE_CORRUPT)
