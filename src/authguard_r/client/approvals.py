# SPDX-License-Identifier: Apache-2.0
"""Open approval requests as a client reads them, and the answers that people sign.

A person signs what was shown (L20): the display is made from the bytes whose digests the answer
binds, and bytes with another digest are refused before anything is shown. Spec page:
docs/spec/gate-protocol.md#approvals
"""

from __future__ import annotations

from typing import Any

import msgspec
from msgspec import Struct

from authguard_r.core.action import ActionScope
from authguard_r.core.approval import Approval, ApprovalVerdict
from authguard_r.core.checks.approval import Situation
from authguard_r.core.encoding import Tag, decode, digest
from authguard_r.core.errors import AuthenticityError, MalformedError, RefusedError
from authguard_r.core.principals import Signer
from authguard_r.core.reasons import Reason
from authguard_r.core.token import sign_object
from authguard_r.wire.approval_request import Question, Questions
from authguard_r.wire.messages import Approvals, Order, OrderKind


class ShownRequest(Struct, frozen=True, kw_only=True):
    """What an answer binds, decoded from the very bytes. Made by `shown` only.

    Args:
        scope: the effect: type, tool, thing, places, parameters.
        situation: which conditions held, and the line of `eq:threshold`.
    """

    scope: ActionScope
    situation: Situation


def asking(counter: int | None = None) -> Approvals:
    """Return the request for one open request, or for all."""
    return Approvals(counter=counter)


def read_questions(said: dict[str, Any]) -> Questions:
    """Return the open requests in a gate's answer.

    Raises:
        MalformedError: they are not valid.
    """
    try:
        return msgspec.convert(said, Questions)
    except (msgspec.ValidationError, RecursionError) as error:
        raise MalformedError(str(error), where="approvals") from error


def the_one(said: Questions, counter: int) -> Question:
    """Return the one request in a gate's answer, which was asked for by its number.

    Raises:
        MalformedError: the answer is about others.
    """
    if [question.counter for question in said.requests] != [counter]:
        raise MalformedError(f"expected request {counter} alone", where="approvals.requests")
    return said.requests[0]


def shown(question: Question) -> ShownRequest:
    """Return what the request's digests are of, once they are of these bytes.

    Raises:
        RefusedError: the values were destroyed: a person could not know what they sign.
        AuthenticityError: the bytes are not those of the digests.
        MalformedError: the bytes spell nothing that can be shown.
    """
    scope, situation = question.scope_bytes, question.situation_bytes
    if scope is None or situation is None:
        raise RefusedError(
            "the request's values were destroyed, so it cannot be shown; wait until it expires",
            reason=Reason.STORE_CORRUPT,
            where=f"request {question.counter}",
        )
    for tag, data, expected in (
        (Tag.SCOPE, scope, question.scope),
        (Tag.SITUATION, situation, question.situation),
    ):
        if digest(tag, data) != expected:
            raise AuthenticityError(
                f"expected the bytes of `{expected}`: the text differs from the bytes to sign",
                reason=Reason.SIGNATURE_INVALID,
                where=f"request {question.counter}",
            )
    opened = decode(situation, Situation, where="situation")
    if opened.guards != tuple(truth.held for truth in question.guards):
        raise AuthenticityError(
            "expected the conditions of the situation",
            reason=Reason.SIGNATURE_INVALID,
            where=f"request {question.counter}",
        )
    return ShownRequest(scope=decode(scope, ActionScope, where="scope"), situation=opened)


def signed_answer(
    question: Question, verdict: ApprovalVerdict, signer: Signer, *, why: str = ""
) -> Order:
    """Return the order that hands in a signed answer to a request.

    Args:
        question: the request as it was shown.
        verdict: approve or deny; a denial gives a reason.
        signer: the approver's key.
        why: for the log; no planner hears of it.

    Raises:
        RefusedError: a denial without a reason, or nothing can be shown.
        AuthGuardError: as `shown`.
    """
    if verdict is ApprovalVerdict.DENY and not why.strip():
        raise RefusedError(
            "a denial needs a reason, for the next person and for the log",
            reason=Reason.FIELD_MISSING,
            where="why",
        )
    shown(question)
    approval = Approval(
        mid=question.mid,
        version=question.version,
        mission=question.mission,
        rid=question.rid,
        grant=question.grant,
        scope=question.scope,
        situation=question.situation,
        counter=question.counter,
        expires_ms=question.expires_ms,
        verdict=verdict,
    )
    return Order(act=OrderKind.APPROVE, token=sign_object(approval, Tag.APPROVAL, signer), why=why)
