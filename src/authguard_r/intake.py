# SPDX-License-Identifier: Apache-2.0
"""What may enter the gate: state, missions and approvals, each held to its signer first.

Authority inputs come from here and from nowhere else: a request carries no state, no time, no
standing and no mission (L4). Spec page: docs/spec/enforcement.md#intake
"""

from __future__ import annotations

from msgspec import Struct

from authguard_r.approvals import open_approval
from authguard_r.audit.record import Entry
from authguard_r.core.approval import VerifiedApproval
from authguard_r.core.encoding import Tag, encode_fast
from authguard_r.core.errors import (
    AuthenticityError,
    MalformedError,
    RefusedError,
    StoreError,
)
from authguard_r.core.facts import SiteFacts
from authguard_r.core.identifiers import Digest
from authguard_r.core.ports import StateSource, Verifier
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Standing
from authguard_r.core.state import AttestedState, Snapshot, attest
from authguard_r.core.token import VerifiedMission, open_token, verify_mission
from authguard_r.ledger import Act, Ledger, read_held

ISSUER_ROLES = frozenset({"operator", "safety_officer"})
ESTIMATOR_ROLES = frozenset({"estimator"})


class Answered(Struct, frozen=True):
    """Answers to open requests: verified, and as the tokens that they came in."""

    approvals: tuple[VerifiedApproval, ...] = ()
    tokens: tuple[str, ...] = ()


class Intake:
    """The gate's side of every channel that authority or state comes through.

    Args:
        ledger: for trusted time and what is held.
        verifier: certificates and signatures.
        source: the estimator's channel.
        facts: the signed site and the gate's identity.
    """

    def __init__(
        self, ledger: Ledger, verifier: Verifier, *, source: StateSource, facts: SiteFacts
    ) -> None:
        self._ledger = ledger
        self._verifier = verifier
        self._source = source
        self._facts = facts
        self._verified: dict[Digest, VerifiedMission] = {}
        self._state: AttestedState | None = None
        self._seen: bytes | None = None

    @property
    def state(self) -> AttestedState | None:
        """The newest attested state that was taken in."""
        return self._state

    def refresh(self) -> AttestedState | None:
        """Take in the newest snapshot; a bad one is recorded and leaves the last, which ages.

        Not inside a turn: what it records is an act of its own.
        """
        data = self._source.latest()
        if data is None or data == self._seen:
            return self._state
        try:
            self._state = self._attest(data)
            self._seen = data
        except (MalformedError, AuthenticityError) as error:
            self._seen = data
            fault = error
            self._ledger.note(
                lambda at: Entry(
                    kind="intake",
                    time_ms=at,
                    decision="refused",
                    open={"what": "state", "reasons": [fault.reason]},
                    sealed={"where": fault.where, "message": fault.message},
                )
            )
        return self._state

    def active_mission(self, act: Act) -> VerifiedMission:
        """Return the one active mission, verified once and kept by the digest of its bytes.

        Raises:
            RefusedError: no mission is active (`NO_ACTIVE_MISSION`).
            StoreError: its token is gone.
            AuthenticityError: its certificates do not hold any more.
        """
        mid = act.active()
        standing = act.standing(mid) if mid is not None else None
        if standing is None:
            raise RefusedError(
                "no mission is active on this robot",
                where="mission",
                reason=Reason.NO_ACTIVE_MISSION,
            )
        return self.mission(act, standing.digest)

    def mission(self, act: Act, digest: Digest) -> VerifiedMission:
        """Return the mission version with this digest from the gate's own keeping."""
        known = self._verified.get(digest)
        if known is not None:
            return known
        token = act.token(digest)
        if token is None:
            raise StoreError(
                "the mission's token is gone", where="mission", reason=Reason.STORE_CORRUPT
            )
        return self.verify_mission(token, act)

    def verify_mission(self, token: bytes, act: Act) -> VerifiedMission:
        """Return the mission in a token, at the act's time, and keep it.

        Raises:
            MalformedError: not a mission token, or not schema-valid.
            AuthenticityError: certificate or signature does not hold.
        """
        verified = verify_mission(token, verifier=self._verifier, now=act.now, roles=ISSUER_ROLES)
        self._verified[verified.digest] = verified
        return verified

    def forget(self) -> None:
        """Drop every kept mission: after a revocation the next action verifies anew."""
        self._verified.clear()

    def take_approval(self, act: Act, token: bytes) -> VerifiedApproval:
        """Keep an authentic answer until its request is used or dies.

        Raises:
            MalformedError: not an approval token.
            AuthenticityError: certificate or signature does not hold.
        """
        verified = open_approval(token, verifier=self._verifier, now=act.now)
        key = f"{verified.approval.mid}:{verified.approval.counter}"
        held = act.get("approvals", key)
        tokens = () if held is None else read_held(held, tuple[str, ...], "approvals")
        text = token.decode("ascii").strip()
        if text not in tokens:
            act.put("approvals", key, encode_fast((*tokens, text)))
        return verified

    def answers(self, act: Act, standing: Standing | None) -> Answered:
        """Return every kept answer to an open request that is still authentic now."""
        approvals: list[VerifiedApproval] = []
        tokens: list[str] = []
        for request in () if standing is None else standing.requests.values():
            held = act.get("approvals", f"{standing.mid}:{request.counter}") if standing else None
            for token in () if held is None else read_held(held, tuple[str, ...], "approvals"):
                try:
                    data = token.encode("ascii")
                    approvals.append(open_approval(data, verifier=self._verifier, now=act.now))
                except (MalformedError, AuthenticityError):
                    continue  # an approver revoked since then does not count
                tokens.append(token)
        return Answered(tuple(approvals), tuple(tokens))

    def _attest(self, data: bytes) -> AttestedState:
        now = self._ledger.now()
        snapshot, _, _ = open_token(
            data,
            Snapshot,
            tag=Tag.STATE,
            roles=ESTIMATOR_ROLES,
            verifier=self._verifier,
            now=now,
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
