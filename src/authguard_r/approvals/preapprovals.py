# SPDX-License-Identifier: Apache-2.0
"""Pre-approvals: the store keeps one of each signer for each grant.

Spec page: docs/spec/approval.md#pre-approval
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from typing import Protocol

from msgspec import Struct

from authguard_r.approvals import open_preapproval
from authguard_r.core.approval import VerifiedApproval, VerifiedPreApproval
from authguard_r.core.decision import Decision
from authguard_r.core.encoding import decode, encode_fast
from authguard_r.core.errors import AuthenticityError, MalformedError, RefusedError, StoreError
from authguard_r.core.identifiers import Digest, GrantId, MissionId
from authguard_r.core.principals import Verifier
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Standing

#: Where the store holds them, by mission; the most of one mission version.
KIND, MOST_KEPT = "preapprovals", 64
#: A verified pre-approval and the token that it came in.
StoredPreApproval = tuple[VerifiedPreApproval, str]


class VerifiedApprovals(Struct, frozen=True, kw_only=True):
    """What people said: verified, and as the tokens that it came in.

    Args:
        approvals: answers to open requests.
        tokens: theirs.
        preapprovals: pre-approvals.
        preapproval_tokens: the token of each pre-approval, by its digest.
    """

    approvals: tuple[VerifiedApproval, ...] = ()
    tokens: tuple[str, ...] = ()
    preapprovals: tuple[VerifiedPreApproval, ...] = ()
    preapproval_tokens: dict[Digest, str] = {}

    def used_by(self, decision: Decision) -> tuple[str, ...]:
        """Return the tokens of every answer, and of the pre-approval that a decision rests on."""
        used = decision.preapproved
        return self.tokens if used is None else (*self.tokens, self.preapproval_tokens[used])


class Values(Protocol):
    """What a turn of the store holds, as far as it is needed here."""

    def get(self, kind: str, key: str) -> bytes | None:
        """Return a value."""
        ...

    def put(self, kind: str, key: str, value: bytes) -> None:
        """Hold a value."""
        ...


class PreApprovalStore:
    """Keeps pre-approvals, and verifies each once until revocation lists change.

    Args:
        verifier: certificates and signatures.
    """

    def __init__(self, verifier: Verifier) -> None:
        self._verifier = verifier
        self._verified: dict[str, VerifiedPreApproval] = {}

    def forget(self) -> None:
        """Verify everything anew: who may sign what has changed."""
        self._verified.clear()

    def keep(
        self, turn: Values, item: VerifiedPreApproval, token: str, now: Now
    ) -> tuple[Digest, ...]:
        """Keep a pre-approval in the place of its signer's last one; return digests of all kept.

        One of no uses is not kept: it withdraws the last one.

        Raises:
            RefusedError: so many are kept already (`BUSY`).
        """
        said, mine = item.preapproval, (item.approver.id, item.preapproval.grant)
        others = [
            (one, text)
            for one, text in self._held(turn, said.mid, now)
            if (one.approver.id, one.preapproval.grant) != mine
            and one.preapproval.mission == said.mission
        ]
        if len(others) >= MOST_KEPT:
            text = f"{MOST_KEPT} pre-approvals exist already: withdraw one (`--uses 0`)"
            raise RefusedError(text, reason=Reason.BUSY, where="preapproval")
        if said.uses:
            others.append((item, token))
        turn.put(KIND, said.mid, encode_fast([text for _, text in others]))
        return tuple(one.digest for one, _ in others)

    def drop(self, turn: Values, mid: MissionId, grant: GrantId, now: Now) -> tuple[Digest, ...]:
        """Drop every pre-approval of a grant; return digests of the others."""
        others = [one for one in self._held(turn, mid, now) if one[0].preapproval.grant != grant]
        turn.put(KIND, mid, encode_fast([text for _, text in others]))
        return tuple(one.digest for one, _ in others)

    def clear(self, turn: Values, mid: MissionId) -> None:
        """Drop every pre-approval of a mission."""
        if turn.get(KIND, mid):
            turn.put(KIND, mid, b"")

    def kept(self, turn: Values, standing: Standing, now: Now) -> tuple[StoredPreApproval, ...]:
        """Return the pre-approvals of a mission that are authentic now."""
        return tuple(self._held(turn, standing.mid, now)) if standing.preapproved else ()

    def _held(self, turn: Values, mid: MissionId, now: Now) -> Iterator[StoredPreApproval]:
        held = turn.get(KIND, mid)
        try:
            tokens = decode(held, tuple[str, ...], where=f"store.{KIND}") if held else ()
        except MalformedError as error:
            raise StoreError(
                error.message, where=error.where, reason=Reason.STORE_CORRUPT
            ) from error
        for token in tokens:
            with suppress(MalformedError, AuthenticityError):
                if token not in self._verified:
                    opened = open_preapproval(
                        token.encode("utf-8"), verifier=self._verifier, now=now
                    )
                    self._verified[token] = opened
                yield self._verified[token], token
