# SPDX-License-Identifier: Apache-2.0
"""What an answer has to say, and what a planner is told of a step."""

from __future__ import annotations

import msgspec
import pytest

from authguard_r.client.controller import Told
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Digest
from authguard_r.tools.planner import Asked
from authguard_r.tools.server import MAX_ANSWER, MAX_TEXT, Answer, fits
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
            assert Answer(is_error=False, structured=structured).is_done(wanted) is done
            assert not Answer(is_error=True, structured=structured).is_done(wanted)


def test_what_is_too_long_does_not_pass() -> None:
    assert fits(Told(b"x" * MAX_ANSWER, ("x" * 100_000,)))
    assert fits(Told(b"x", ("x" * MAX_TEXT,)))
    assert not fits(Told(b"x" * (MAX_ANSWER + 1), ()))
    assert not fits(Told(b"", ("x" * MAX_TEXT, "x")))


@pytest.mark.parametrize("text", ["\x01" * 110_000, "\U0001f600" * 119_000])
def test_an_answer_that_no_frame_takes_does_not_pass(text: str) -> None:
    """A server could cut the robot's controller off with it."""
    content = msgspec.json.encode(text)  # control characters take six bytes each
    told = Told(content, (text,))
    frame = msgspec.json.encode(Result(ticket=Digest("t" * 43), content=content, texts=(text,)))
    assert fits(told) is (len(frame) <= BOUND[Kind.RESULT])
    assert not fits(told)


def test_a_step_tells_its_last_result_and_its_ticket() -> None:
    step = {"outcome": "accept", "execution": {"outcome": "succeeded"}, "secret": 1}
    asked = Asked(step=step, brought=({"ticket": "t"}, {"result": "eA==", "ticket": "t"}))
    assert (asked.execution, asked.ticket, asked.result()) == ("succeeded", "t", b"x")
    assert asked.verdict == {"outcome": "accept"}
    assert Asked(step=step).ticket is None
    with pytest.raises(MalformedError):
        Asked(step=step, brought=({"result": "!"},)).result()
