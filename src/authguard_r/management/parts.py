# SPDX-License-Identifier: Apache-2.0
"""What every act of management is made of: its parts, its record, its refusal.

Spec page: docs/spec/standing.md#commands
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import msgspec
from msgspec import Struct

from authguard_r.audit.record import Entry
from authguard_r.core.encoding import encode_fast
from authguard_r.core.errors import AuthGuardError, EnvironmentFault, RefusedError
from authguard_r.core.facts import SiteFacts
from authguard_r.core.lifecycle import REFUSAL
from authguard_r.core.ports import Verifier
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Standing
from authguard_r.intake import Intake
from authguard_r.ledger import STOP, Act, Ledger, stop_stands
from authguard_r.report import refusal_entry
from authguard_r.sealing import Retention

T = TypeVar("T")
#: Where the store holds when it was accepted last, trusted time in milliseconds.
_KIND, _ACCEPTED = "counter", "accepted"


class Parts(Struct, frozen=True, kw_only=True):
    """What the acts need of their gate.

    Args:
        intake: verifies missions, templates and approvals.
        verifier: verifies commands and selections.
        facts: the signed site and the gate's identity.
        retention: how long sealed fields are kept.
    """

    intake: Intake
    verifier: Verifier
    facts: SiteFacts
    retention: tuple[Retention, ...] = ()


def attempt(ledger: Ledger, job: Callable[[Act], T]) -> T:
    """Carry an order out, or leave one record of why not; the world's faults leave none."""
    try:
        return ledger.run(job, essential=True)
    except EnvironmentFault:
        raise
    except AuthGuardError as error:
        refused, fold = error, ("management", str(error.reason), error.where)
        ledger.refuse(lambda at: refusal_entry(refused, at), fold=fold)
        raise


def entry(
    act: Act, mid: str, opened: dict[str, object], sealed: dict[str, object] | None = None
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


def go_on(act: Act) -> None:
    """Let no operator's stop stand any more: a signed order made a mission active."""
    if stop_stands(act):
        act.put(*STOP[:2], b"")


def hold_acceptance(act: Act) -> None:
    """Hold that this store was accepted now, after it had been put back."""
    act.put(_KIND, _ACCEPTED, str(act.now.utc_ms).encode("ascii"))


def accepted_ms(act: Act) -> int:
    """Return when this store was accepted last, 0 for never."""
    held = act.get(_KIND, _ACCEPTED)
    return 0 if held is None else int(held)


def require_signed_since(act: Act, issued_ms: int) -> None:
    """Refuse an order that may have been carried out in a part of the log that is lost.

    Args:
        act: the act, which knows when the store was accepted.
        issued_ms: when its signer says that it was signed; 0 where he did not say.

    Raises:
        RefusedError: not after the store was accepted (`ROLLED_BACK`).
    """
    since_ms = accepted_ms(act)
    if 0 < since_ms >= issued_ms:
        text = f"signed before this store was accepted, {to_timestamp(since_ms)}: sign it anew"
        raise refuse(Reason.ROLLED_BACK, text, "command.issued_ms")


def replayed(known: Standing) -> AuthGuardError:
    """Return why a version that is here is not taken in again."""
    reason = REFUSAL.get(known.status, Reason.TRANSITION_REFUSED)
    return refuse(reason, f"`{known.mid}` version {known.version} is here and {known.status}")


def refuse(reason: Reason, message: str, where: str = "mission") -> AuthGuardError:
    """Return the refusal of an authentic order."""
    return RefusedError(message, reason=reason, where=where)
