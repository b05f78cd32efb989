# SPDX-License-Identifier: Apache-2.0
"""When a mission is valid: said in full, or asked; a time of day alone is never completed."""

from __future__ import annotations

import re

from authguard_r.authoring.drafting.asking import DraftDialog
from authguard_r.authoring.drafting.clauses import Sentence
from authguard_r.authoring.drafting.measures import (
    Daytime,
    QuantityDimension,
    instants,
    read_measure_text,
)
from authguard_r.authoring.drafting.tokens import tokenize
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Timestamp
from authguard_r.core.quantities import to_ms, to_timestamp
from authguard_r.core.reasons import Reason

_INSTANT = re.compile(r"\A[0-9]{4}(-[0-9]{2}){2}T([0-9]{2}:){2}[0-9]{2}Z\Z")


def window_of(sentence: Sentence, asking: DraftDialog, *, now_ms: int) -> dict[str, str] | None:
    """Return the draft's window, or None once it is asked for.

    Args:
        sentence: what was said.
        asking: questions and answers.
        now_ms: the instant of drafting, milliseconds since 1970; a window begins there unless the
            sentence says another begin.

    Raises:
        MalformedError: an answer that is no instant and no duration.
    """
    begin = sentence.begin or str(to_timestamp(now_ms))
    said = sentence.begin is not None or sentence.start is not None
    if sentence.start is not None:
        begin = _instant(sentence.start, "window.not_before", asking, now_ms) or ""
    end = _end(sentence, asking, now_ms)
    if not begin or end is None:
        return None
    relative = not _INSTANT.match(end)
    if not said:
        asking.assume("window.not_before", "now", "compiling" if relative else "drafting")
    if relative:
        if not said:
            return {"for": end}
        return {"not_before": begin, "expiry": _later(begin, end)}
    if _ms(end, "window.expiry") <= _ms(begin, "window.not_before"):
        question = f"`{end}` is not after `{begin}`: until when is the mission valid?"
        end = _require_instant(asking.ask("window.end", question), "window.end")
        if end is None:
            return None
    return {"not_before": begin, "expiry": end}


def _end(sentence: Sentence, asking: DraftDialog, now_ms: int) -> str | None:
    """Return the end as an instant or as a duration."""
    if not sentence.delay:
        if sentence.length is not None:
            return _duration(sentence.length.text, "window")
        if sentence.expiry is not None:
            _ms(sentence.expiry, "window.expiry")
            return sentence.expiry
        if sentence.deadline is not None:
            return _instant(sentence.deadline, "window.expiry", asking, now_ms)
    answer = asking.answer("window.expiry") or asking.answer("window.for")
    if answer is None:
        question = "How long, or until which instant, is the mission valid (such as `25 min`)?"
        unclear = f"`{sentence.delay}` may be the begin or the end. " if sentence.delay else ""
        answer = asking.ask("window", unclear + question)
    if answer is None:
        return None
    return answer if _INSTANT.match(answer) else _duration(answer, "window")


def _instant(time: Daytime, field: str, asking: DraftDialog, now_ms: int) -> str | None:
    """Return the instant that a time of day means, or None once it is asked which one."""
    options = instants(time, now_ms=now_ms)
    if time.utc and time.day is not None and len(options) == 1:
        return options[0]
    if not options:
        answer = asking.ask(field, "That time is over: which instant is meant (RFC 3339, UTC)?")
        return _require_instant(answer, field)
    return asking.ask(field, "A time needs its date and zone: which instant is meant?", options)


def _require_instant(answer: str | None, field: str) -> str | None:
    if answer is not None:
        _ms(answer, field)
    return answer


def _ms(text: str, where: str) -> int:
    if not _INSTANT.match(text):
        raise MalformedError(
            f"expected an instant such as 2026-01-31T14:30:00Z, got `{text}`",
            where=where,
            reason=Reason.VALUE_INVALID,
        )
    return to_ms(Timestamp(text), where=where)


def _duration(text: str, where: str) -> str:
    found = read_measure_text(text, tokenize(text))
    if (
        found is None
        or found.dimension is not QuantityDimension.TIME
        or found.amount.denominator != 1
        or found.amount <= 0
    ):
        raise MalformedError(
            f"expected a duration such as `25 min` or an instant, got `{text}`",
            where=where,
            reason=Reason.VALUE_INVALID,
        )
    return found.text


def _later(begin: str, length: str) -> str:
    found = read_measure_text(length, tokenize(length))
    amount = 0 if found is None else int(found.amount)
    return str(to_timestamp(_ms(begin, "window.not_before") + amount))
