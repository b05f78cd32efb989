# SPDX-License-Identifier: Apache-2.0
"""What every act of management is made of: its parts, its record, its refusal.

Spec page: docs/spec/standing.md#commands
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import msgspec
from msgspec import Struct

from authguard_r.anchoring.sealing.policy import SealingPolicy
from authguard_r.approvals import Selection
from authguard_r.audit.record import Entry
from authguard_r.core.encoding import encode_fast
from authguard_r.core.errors import AuthGuardError, EnvironmentFault, RefusedError
from authguard_r.core.facts import SiteFacts
from authguard_r.core.identifiers import MissionId
from authguard_r.core.lifecycle import REFUSAL
from authguard_r.core.principals import Verifier
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Standing
from authguard_r.enforcement.inputs import InputVerifier
from authguard_r.enforcement.report import refusal_entry
from authguard_r.enforcement.signed_orders import Command
from authguard_r.store.transactions import STOP, Ledger, Transaction, stop_stands
from authguard_r.wire.gate_limits import LIMITS

T = TypeVar("T")
#: Where the store holds when it was accepted last, trusted time in milliseconds.
_KIND, _ACCEPTED = "counter", "accepted"


class ManagementParts(Struct, frozen=True, kw_only=True):
    """What the acts need of their gate.

    Args:
        inputs: verifies missions, templates and approvals.
        verifier: verifies commands and selections.
        facts: the signed site and the gate's identity.
        sealing: what of the log is sealed, and how long it is kept.
    """

    inputs: InputVerifier
    verifier: Verifier
    facts: SiteFacts
    sealing: SealingPolicy = SealingPolicy()


def attempt(ledger: Ledger, job: Callable[[Transaction], T]) -> T:
    """Carry an order out, or leave one record of why not; the world's faults leave none."""
    try:
        return ledger.run(job, essential=True)
    except EnvironmentFault:
        raise
    except AuthGuardError as error:
        refused, dedup_key = error, ("management", str(error.reason), error.where)
        ledger.refuse(lambda at: refusal_entry(refused, at), dedup_key=dedup_key)
        raise


def entry(
    act: Transaction, mid: str, opened: dict[str, object], sealed: dict[str, object] | None = None
) -> Entry:
    """Return the record of an act; its verb is the decision."""
    plain = msgspec.json.decode(encode_fast(opened))
    return Entry(
        kind="management",
        time_ms=act.now.utc_ms,
        decision=str(opened["verb"]),
        mid=mid,
        open=plain,
        sealed=sealed or {},
    )


def go_on(act: Transaction) -> None:
    """Clear the operator's stop: a signed order resumes the mission."""
    if stop_stands(act):
        act.put(*STOP, b"")


def hold_acceptance(act: Transaction) -> None:
    """Record that a person accepted this restored store now."""
    act.put(_KIND, _ACCEPTED, str(act.now.utc_ms).encode("ascii"))


def accepted_ms(act: Transaction) -> int:
    """Return when this store was accepted last, 0 for never."""
    held = act.get(_KIND, _ACCEPTED)
    return 0 if held is None else int(held)


def require_signed_since(
    act: Transaction, issued_ms: int, *, where: str = "command.issued_ms"
) -> None:
    """Refuse an order that may have been carried out in a part of the log that is lost.

    Args:
        act: the act, which knows when the store was accepted.
        issued_ms: when its signer says that it was signed; 0 when it is not given.
        where: the place of that.

    Raises:
        RefusedError: not after the store was accepted (`ROLLED_BACK`).
    """
    since_ms = accepted_ms(act)
    if 0 < since_ms >= issued_ms:
        text = f"signed before this store was accepted, {to_timestamp(since_ms)}: sign it again"
        raise refuse(Reason.ROLLED_BACK, text, where)


def require_timely(
    act: Transaction, order: Command | Selection, where: str, *, is_narrowing: bool = False
) -> None:
    """Refuse an order that ran out, was carried out before, or is good for too long.

    Args:
        act: the act.
        order: with its times.
        where: what it is called.
        is_narrowing: it is taken although its signer's clock is ahead.

    Raises:
        RefusedError: with the reason.
    """
    now_ms = act.now.utc_ms
    if now_ms > order.expires_ms or act.get("command", order.nonce) is not None:
        raise refuse(Reason.EXPIRED, f"the {where} ran out or was carried out already")
    if order.expires_ms > min(now_ms, order.issued_ms or now_ms) + LIMITS.order_valid_ms:
        text = f"good until {to_timestamp(order.expires_ms)}: an order is good for a day at most"
        raise refuse(Reason.VALUE_OUT_OF_RANGE, text, f"{where}.expires_ms")
    if order.issued_ms > now_ms + LIMITS.skew_ms and not is_narrowing:
        text = f"signed at {to_timestamp(order.issued_ms)}, and here it is {to_timestamp(now_ms)}"
        raise refuse(Reason.NOT_YET_VALID, text, f"{where}.issued_ms")


def halted_ms(act: Transaction, mid: MissionId) -> int:
    """Return when the mission was suspended last, or an operator stopped the robot; 0: never."""
    return max(int(act.get(*key) or 0) for key in (STOP, ("suspended", mid)))


def hold_suspended(act: Transaction, mid: MissionId, issued_ms: int, *, again: bool) -> None:
    """Hold that a mission is suspended since an order was signed.

    Args:
        act: the act.
        mid: the mission.
        issued_ms: when its signer says that it was signed; 0 when it is not given.
        again: it was suspended already; what was held counts if it is later.
    """
    before_ms = int(act.get("suspended", mid) or 0) if again else 0
    since_ms = max(before_ms, min(issued_ms or act.now.utc_ms, act.now.utc_ms))
    act.put("suspended", mid, str(since_ms).encode("ascii"))


def require_newest(act: Transaction, key: str, issued_ms: int, *, over_ms: int = 0) -> None:
    """Refuse an order that was signed before what it would undo, and hold that it came.

    Args:
        act: the act.
        key: what the order is about: only the newest of one object counts.
        issued_ms: when its signer says that it was signed; 0 when it is not given.
        over_ms: when what it would undo happened here.

    Raises:
        RefusedError: it is not the newest (`ORDER_TOO_OLD`).
    """
    newest_ms = max(int(act.get("order", key) or 0), over_ms)
    if issued_ms <= newest_ms:
        when = f"{newest_ms - issued_ms} ms" if issued_ms else "at an unknown time, maybe"
        text = f"signed {when} before the act that it undoes, {to_timestamp(newest_ms)}: sign again"
        raise refuse(Reason.ORDER_TOO_OLD, text, f"{key.rpartition('/')[2]}.issued_ms")
    # a narrowing by a clock that runs far ahead prevents no later order
    held_ms = issued_ms if issued_ms <= act.now.utc_ms + LIMITS.skew_ms else act.now.utc_ms
    act.put("order", key, str(held_ms).encode("ascii"))


def replayed(known: Standing) -> AuthGuardError:
    """Return why a version that is here is not taken in again."""
    reason = REFUSAL.get(known.status, Reason.TRANSITION_REFUSED)
    return refuse(reason, f"`{known.mid}` version {known.version} is here and {known.status}")


def refuse(reason: Reason, message: str, where: str = "mission") -> AuthGuardError:
    """Return the refusal of an authentic order."""
    return RefusedError(message, reason=reason, where=where)
