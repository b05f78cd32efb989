# SPDX-License-Identifier: Apache-2.0
"""Going on with a store that was put back: a person's signed act, and what it takes away.

What the lost part of the log has used up is unknown. So an older signature alone does not
count: the mission waits for a new one, the gate cancels requests and choices, and a mission that is
not here is not taken in again. Spec page: docs/spec/rollback.md#recovery
"""

from __future__ import annotations

from msgspec import Struct
from msgspec.structs import replace

from authguard_r.anchoring.anchor import Discrepancy
from authguard_r.core.encoding import Tag, b64
from authguard_r.core.identifiers import Count, Digest, MissionId
from authguard_r.core.lifecycle import TERMINAL, Event, Status
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Standing, advance
from authguard_r.core.token import VerifiedMission, open_token
from authguard_r.enforcement.inputs import ISSUER_ROLES
from authguard_r.enforcement.management.parts import (
    ManagementParts,
    accepted_ms,
    entry,
    hold_acceptance,
    refuse,
)
from authguard_r.enforcement.management.repetition import require_fresh
from authguard_r.enforcement.signed_orders import Command, Verb
from authguard_r.store.transactions import Transaction

#: Requests are numbered on from so much later: no answer to a lost one fits a new one.
_LEAP = 1 << 32


class AcceptedStore(Struct, frozen=True, kw_only=True):
    """The result of an order to go on with a store.

    Args:
        store: L_0.
        size: number of its records, with the one of the order.
        mission: the one that was active in it, None without one.
        status: how that one stands now.
    """

    store: Digest
    size: Count
    mission: MissionId | None = None
    status: Status | None = None


def accept_store(act: Transaction, token: bytes, *, parts: ManagementParts) -> AcceptedStore:
    """Carry out a signed order to go on with this store, once; its counter comes after."""
    command, _, signer = open_token(
        token, Command, tag=Tag.COMMAND, roles=ISSUER_ROLES, verifier=parts.verifier, now=act.now
    )
    if command.verb is not Verb.ACCEPT_STORE or command.accepts is None:
        raise refuse(Reason.TRANSITION_REFUSED, f"no {command.verb} of a store", "command.verb")
    require_fresh(act, command)
    rid, anchor, claim = parts.facts.robot.rid, parts.inputs.anchor, command.accepts
    if str(command.mid) != rid:
        raise refuse(Reason.ROBOT_MISMATCH, f"expected an order about `{rid}`", "command.mid")
    if not signer.scope.covers(rid):
        raise refuse(Reason.SIGNER_OUT_OF_SCOPE, f"`{signer.id}` has no say about this robot")
    if anchor.why is None:
        text = "nothing to accept: the store agrees with the marks outside of it"
        raise refuse(Reason.TRANSITION_REFUSED, text, "store")
    if anchor.why is Discrepancy.COUNTER_UNREADABLE:
        text = "the counter has to be readable first: look at `--counter` and its mount, restart"
        raise refuse(Reason.TRANSITION_REFUSED, text, "store")
    row = act.rows(claim.size - 1, 1)
    fits = anchor.fits(store=claim.store, size=claim.size, number=claim.number)
    if not fits or not row or b64(row[0][3]) != claim.head:
        text = "it is another store or counter that was signed for, or one from before this start"
        raise refuse(Reason.ROLLED_BACK, text, "command.accepts")
    standing = _put_to_rest(act, parts)
    act.put("command", command.nonce, b"1")
    hold_acceptance(act)
    opened: dict[str, object] = {
        "verb": command.verb,
        "by": signer.id,
        "role": signer.role,
        "why": anchor.why,
        "status": "-" if standing is None else standing.status,
    }
    act.record(entry(act, "-" if standing is None else standing.mid, opened, {"command": command}))
    return AcceptedStore(
        store=claim.store,
        size=act.head()[0],
        mission=None if standing is None else standing.mid,
        status=None if standing is None else standing.status,
    )


def _put_to_rest(act: Transaction, parts: ManagementParts) -> Standing | None:
    """Suspend what is active, and drop what was asked, chosen and pre-approved; end what closes."""
    mid = act.active()
    standing = None if mid is None else act.standing(mid)
    if standing is None or standing.status in TERMINAL:
        return None
    after = advance(standing, Event.SUSPEND) or standing
    if after.status is Status.CLOSING:
        after = advance(after, Event.REVOKE) or after
    parts.inputs.preapprovals.clear(act, after.mid)
    after = replace(after, requests={}, selected={}, preapproved={}, counter=after.counter + _LEAP)
    act.hold(after)
    if after.status in TERMINAL:
        act.make_active(None)
        parts.inputs.forget()
    return after


def require_later(act: Transaction, verified: VerifiedMission) -> None:
    """Refuse a mission that the lost part of the log may have used up already.

    Raises:
        RefusedError: it was to begin before the store was accepted (`ROLLED_BACK`).
    """
    since_ms = accepted_ms(act)
    if verified.not_before_ms < since_ms:  # whole seconds: one of the same second is refused too
        text = (
            f"the store was accepted at {to_timestamp(since_ms)}, and missions that begin in this "
            "second or before may have run: compile and sign the mission again"
        )
        raise refuse(Reason.ROLLED_BACK, text, "mission.not_before")
