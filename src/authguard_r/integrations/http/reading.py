# SPDX-License-Identifier: Apache-2.0
"""Requests, read strictly: what has two readings, or none, is refused with its place.

Spec page: docs/spec/http.md#bodies
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, TypeVar

import msgspec
from msgspec import UNSET, UnsetType

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.integrations.http.messages import ActionMessage, Evaluation, Evaluations, Part
from authguard_r.normalize.parse import read_json, read_text

T = TypeVar("T")
P = TypeVar("P")

#: Numbers stay the decimals that they were written as.
_ENCODER = msgspec.json.Encoder(decimal_format="number")
_PLACE = re.compile(r"\A(.*) - at `\$\.?(.*)`\Z", re.DOTALL)
_WHOLE = re.compile(r"\A[0-9]{1,16}\Z")


def read_body(data: bytes, kind: type[T]) -> T:
    """Return the one object that a body spells.

    Raises:
        MalformedError: it spells none of this kind, or is too long (`INPUT_TOO_LARGE`).
    """
    return _as(read_json(read_text(data), where="body"), kind, where="body")


def read_words(words: Sequence[tuple[str, str]], kind: type[T]) -> T:
    """Return the parameters of a query or a path, every one of which is a number.

    Raises:
        MalformedError: one that is not known, comes twice, or is no such number.
    """
    found: dict[str, Any] = {}
    for name, value in words:
        if name in found:
            raise MalformedError("expected it once", where=name)
        found[name] = int(value) if _WHOLE.match(value) else value
    return _as(found, kind, where="parameters")


def questions_of(asked: Evaluations) -> tuple[Evaluation, ...]:
    """Return the questions of a batch, each with what it leaves to the whole request.

    Raises:
        MalformedError: neither has what every question needs.
    """
    return tuple(
        _whole(part, asked, f"evaluations[{number}]")
        for number, part in enumerate(asked.evaluations)
    )


def single_of(asked: Evaluations) -> Evaluation:
    """Return the question of a batch without `evaluations`: the request itself.

    Raises:
        MalformedError: it has not what a question needs.
    """
    return _whole(Part(), asked, "body")


def plan_of(tool: str, arguments: dict[str, Any]) -> bytes:
    """Return a call as a plan of one step in the dialect `json`, its numbers as they were spelled.

    Raises:
        MalformedError: it cannot be written as JSON.
    """
    return _ENCODER.encode({"plan": [{"tool": tool, "arguments": arguments}]})


def call_of(action: ActionMessage) -> bytes:
    """Return an action of the Authorization API as a plan of one step."""
    return plan_of(action.name, {} if action.properties is UNSET else action.properties)


def _whole(part: Part, asked: Evaluations, where: str) -> Evaluation:
    def own(name: str, first: P | UnsetType, second: P | UnsetType) -> P:
        found = second if isinstance(first, UnsetType) else first
        if isinstance(found, UnsetType):
            raise MalformedError(
                "expected it here or in the whole request", where=f"{where}.{name}"
            )
        return found

    return Evaluation(
        subject=own("subject", part.subject, asked.subject),
        action=own("action", part.action, asked.action),
        resource=own("resource", part.resource, asked.resource),
    )


def _as(plain: Any, kind: type[T], *, where: str) -> T:
    try:
        return msgspec.convert(plain, kind)
    except msgspec.ValidationError as error:
        found = _PLACE.match(str(error))
        message, place = found.groups() if found else (str(error), "")
        raise MalformedError(
            message[:1].lower() + message[1:],
            where=f"{where}.{place}" if place else where,
            reason=Reason.MALFORMED,
        ) from error
