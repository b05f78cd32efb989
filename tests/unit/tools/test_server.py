# SPDX-License-Identifier: Apache-2.0
"""What an answer has to say, and what a planner is told of a step."""

from __future__ import annotations

import msgspec
import pytest
from msgspec.structs import replace

from authguard_r.client.controller import ExecutionNews
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Digest
from authguard_r.integrations.tools.planner import CallOutcome
from authguard_r.integrations.tools.server import MAX_ANSWER, MAX_TEXT, ToolAnswer, fits
from authguard_r.normalize.expected import TEXT, AnswerMatch, Expected
from authguard_r.wire.messages import BOUND, Kind, Result
from fixtures.cases import case


def test_it_is_done_when_it_says_exactly_what_is_demanded() -> None:
    for structured, wanted, done in [
        ({}, {}, True),
        (None, {}, True),
        (None, {"ok": True}, False),
        ({"ok": True}, {"ok": True}, True),
        ({"ok": 1}, {"ok": True}, False),
        ({"ok": "true"}, {"ok": True}, False),
        ({"a": {"ok": True}}, {"a.ok": True}, True),
        ({"a": 1}, {"a.ok": True}, False),
    ]:
        with case(structured, wanted, done):
            assert (
                ToolAnswer(is_error=False, structured=structured).is_done(Expected(wanted)) is done
            )
            assert not ToolAnswer(is_error=True, structured=structured).is_done(Expected(wanted))


TEXTS = {
    "failed: not armed": False,
    "landed at home": True,
    "  landed, battery 41.5 %\n": True,
    "landed, battery 4.9 %": False,
    "landed, battery 41.5 % of 100": False,  # which of the numbers is meant, nobody says
    "not landed, battery 41.5 %": False,
    "landed but not armed": False,
    "landed, v1.2.3": False,
    "": False,
}


@pytest.mark.parametrize("text", TEXTS)
def test_l29_a_text_in_a_success_envelope_is_matched_and_never_assumed(text: str) -> None:
    """`succeeds` looks into the words, `fails` as well, and one failure is enough."""
    words, battery = AnswerMatch(starts_with="landed"), AnswerMatch(at_least="5.0", at_most=100)
    expected = Expected({TEXT: words}, {TEXT: AnswerMatch(contains="not armed")})
    answer = ToolAnswer(is_error=False, text=text)
    if "battery" in text or "v1" in text:
        assert answer.is_done(Expected({TEXT: battery})) is (TEXTS[text] or text.startswith("not"))
        expected = Expected({TEXT: replace(words, at_least=5)}, expected.fails)
    assert answer.is_done(expected) is TEXTS[text]
    assert not ToolAnswer(is_error=True, text=text).is_done(expected)


def test_l29_a_match_reads_fields_too_and_what_is_not_there_matches_nothing() -> None:
    for value, match, holds in [
        (5, AnswerMatch(at_least=5, at_most=5), True),
        (4.5, AnswerMatch(at_least=5), False),
        (4.5, AnswerMatch(at_least="4.5"), True),
        (float("nan"), AnswerMatch(at_most=5), False),
        (True, AnswerMatch(at_least=0), False),
        ("7", AnswerMatch(at_least=7), True),
        ("seven", AnswerMatch(at_least=7), False),
        (" done ", AnswerMatch(equals="done"), True),
        ("done?", AnswerMatch(equals="done"), False),
        (["done"], AnswerMatch(contains="done"), False),
        (None, AnswerMatch(contains="d"), False),
        (10**400, AnswerMatch(at_most=5), False),
    ]:
        with case(value, match):
            structured = {} if value is None else {"a": value}
            answer = ToolAnswer(is_error=False, structured=structured)
            assert answer.is_done(Expected({"a": match})) is holds
            assert answer.is_done(Expected({}, {"a": match})) is not holds


def test_what_is_too_long_does_not_pass() -> None:
    assert fits(ExecutionNews(b"x" * MAX_ANSWER, ("x" * 100_000,)))
    assert fits(ExecutionNews(b"x", ("x" * MAX_TEXT,)))
    assert not fits(ExecutionNews(b"x" * (MAX_ANSWER + 1), ()))
    assert not fits(ExecutionNews(b"", ("x" * MAX_TEXT, "x")))


@pytest.mark.parametrize("text", ["\x01" * 110_000, "\U0001f600" * 119_000])
def test_an_answer_that_no_frame_takes_does_not_pass(text: str) -> None:
    """A server could cut the robot's controller off with it."""
    content = msgspec.json.encode(text)  # control characters take six bytes each
    told = ExecutionNews(content, (text,))
    frame = msgspec.json.encode(Result(ticket=Digest("t" * 43), content=content, texts=(text,)))
    assert fits(told) is (len(frame) <= BOUND[Kind.RESULT])
    assert not fits(told)


def test_a_step_tells_its_last_result_and_its_ticket() -> None:
    step = {"outcome": "accept", "execution": {"outcome": "succeeded"}, "secret": 1}
    asked = CallOutcome(step=step, brought=({"ticket": "t"}, {"result": "eA==", "ticket": "t"}))
    assert (asked.execution, asked.ticket, asked.result()) == ("succeeded", "t", b"x")
    assert asked.verdict == {"outcome": "accept"}
    assert CallOutcome(step=step).ticket is None
    with pytest.raises(MalformedError):
        CallOutcome(step=step, brought=({"result": "!"},)).result()
