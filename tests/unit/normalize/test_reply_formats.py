# SPDX-License-Identifier: Apache-2.0
"""Every format of a planner's reply is read exactly; a near miss is refused in its place."""

from __future__ import annotations

import pytest

from authguard_r.core.errors import MalformedError
from authguard_r.normalize.dialects import Dialect, read_reply
from fixtures import scenarios
from fixtures.cases import case
from fixtures.reply_formats import READ, REFUSED
from fixtures.reply_page import reply_page


def test_at_least_forty_formats_are_read_as_they_are_meant() -> None:
    assert len({one.name for one in READ}) == len(READ) >= 40
    for one in READ:
        with case(one.name):
            reading = read_reply(one.text, Dialect.AUTO, one.form)
            assert tuple((call.tool, call.arguments) for call in reading.calls) == one.calls
            assert (reading.dialect, reading.around) == (one.dialect, one.around)


def test_a_named_dialect_reads_what_recognizing_reads() -> None:
    for one in (reply for reply in READ if not reply.around.startswith(("fence", "think"))):
        with case(one.name):
            named = read_reply(one.text, Dialect(one.dialect), one.form)
            assert named == read_reply(one.text, Dialect.AUTO, one.form)


def test_every_near_miss_is_refused_in_its_place() -> None:
    assert len({one.name for one in REFUSED}) == len(REFUSED) >= 40
    for one in REFUSED:
        with case(one.name), pytest.raises(MalformedError) as caught:
            read_reply(one.text, Dialect.AUTO, one.form)
        assert (caught.value.reason, caught.value.where) == (one.reason, one.where), one.name


def test_a_reply_that_is_cut_anywhere_never_means_another_call() -> None:
    """It is refused, or whole calls are missing at its end: no format can show those."""
    for one in READ:
        with case(one.name):
            for end in range(1, len(one.text)):
                try:
                    reading = read_reply(one.text[:end], Dialect.AUTO, one.form)
                except MalformedError:
                    continue
                read = tuple((call.tool, call.arguments) for call in reading.calls)
                assert read == one.calls[: len(read)] or one.dialect == "steps", (end, read)


def test_the_reference_page_lists_every_format() -> None:
    page = scenarios.ROOT / "docs" / "reference" / "replies.md"
    assert page.read_text(encoding="utf-8") == reply_page(), "run vectors/generate.py"
