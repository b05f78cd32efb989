# SPDX-License-Identifier: Apache-2.0
"""What people answer to approval requests: kept, recorded once, and a denial closes its request.

Spec page: docs/spec/approval.md#answers
"""

from __future__ import annotations

from authguard_r.approvals import approver_json
from authguard_r.approvals.requests import find_asked, is_asked, why_not
from authguard_r.core.approval import ApprovalVerdict, VerifiedApproval
from authguard_r.core.encoding import encode_fast
from authguard_r.core.errors import AuthenticityError, RefusedError
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import deny_request
from authguard_r.enforcement.management.parts import ManagementParts, entry, refuse
from authguard_r.enforcement.management.preapproval import withdraw_denied
from authguard_r.enforcement.report import refusal_entry
from authguard_r.store.transactions import Ledger, Transaction, read_held

#: Where the store holds who has answered a request that is over, under mission and counter.
LATE = "late-answers"


def take_answer(
    act: Transaction, token: bytes, why: str, ledger: Ledger, *, parts: ManagementParts
) -> VerifiedApproval:
    """Keep an answer; what repeats one that is in the log already leaves no further record.

    A denial that fits closes its request in the same commit: a later revocation of the denier
    changes nothing. An answer before its question adds nothing to the store, an answer afterwards
    leaves one mark; neither is a consent.

    Args:
        act: the act.
        token: the signed answer.
        why: the approver's words, sealed.
        ledger: opens what this gate sealed.
        parts: what the acts need.

    Raises:
        AuthGuardError: malformed or not authentic, or its signer has said this too often.
    """
    item = parts.inputs.verify_answer(act, token)
    said, standing = item.approval, act.standing(item.approval.mid)
    if is_asked(act, said):
        is_new = parts.inputs.keep_answer(act, item, token)
    elif standing is not None and said.counter <= standing.counter:
        is_new = _mark_late(act, item)
    else:
        fault = refuse(Reason.APPROVAL_TIMEOUT, "there never was such a request", "approval")
        dedup_key = ("management", str(fault.reason), fault.where)
        act.refuse(refusal_entry(fault, act.now.utc_ms), dedup_key=dedup_key)
        return item
    worth, closes = _effect(act, item, ledger, parts)
    if not (is_new or closes):
        return item
    opened: dict[str, object] = {
        "verb": "answer",
        **approver_json(item.approver),
        "verdict": said.verdict,
        "counter": said.counter,
    }
    opened |= {"why_not": worth} if worth else {}
    opened |= {"closes": True} if closes else {}
    sealed: dict[str, object] = {"token": token.decode("ascii").strip()}
    sealed |= {"why": why} if why else {}
    act.record(entry(act, said.mid, opened, sealed))
    return item


def _mark_late(act: Transaction, item: VerifiedApproval) -> bool:
    """Mark an answer to a request that is over; False: it was marked before."""
    said = item.approval
    key, mark = f"{said.mid}:{said.counter}", f"{item.approver.id}:{said.verdict}"
    held = act.get(LATE, key)
    marks = read_held(held, tuple[str, ...], LATE) if held else ()
    if mark in marks:
        return False
    act.put(LATE, key, encode_fast((*marks, mark)))
    return True


def _effect(
    act: Transaction, item: VerifiedApproval, ledger: Ledger, parts: ManagementParts
) -> tuple[str, bool]:
    """Return why an answer has no effect, empty when it has, and whether it closed its request."""
    inputs, facts = parts.inputs, parts.facts
    try:
        asked = find_asked(
            act, item.approval, mission=inputs.mission, facts=facts, opened=ledger.opened
        )
    except (AuthenticityError, RefusedError) as error:  # nothing is decided by this mission now
        return str(error.reason), False
    worth = why_not(asked, item, act.now)
    if (
        asked is None
        or worth
        or asked.request.denied
        or item.approval.verdict is ApprovalVerdict.APPROVE
    ):
        return worth, False
    denied = deny_request(asked.standing, asked.grant.id)
    act.hold(withdraw_denied(act, denied, asked.grant.id, parts=parts))
    return worth, True
