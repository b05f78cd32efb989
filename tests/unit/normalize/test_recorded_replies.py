# SPDX-License-Identifier: Apache-2.0
"""What real models wrote: whole replies are read, and none is read as something else.

`benchmarks/replies.py` and the live campaigns recorded them.
"""

from __future__ import annotations

from collections import Counter

from authguard_r.core.errors import MalformedError
from authguard_r.normalize.dialects import Dialect, read_reply
from fixtures.cases import case
from fixtures.recorded_replies import campaign_replies, counts, plain, recorded
from fixtures.second_reader import second_reading


def test_no_recorded_reply_is_read_as_something_else_than_it_says() -> None:
    formats = set()
    for one in recorded():
        reading = one.reading()
        if isinstance(reading, MalformedError):
            continue
        formats.add(one.format)
        with case(f"{one.model}, {one.format}: {one.asked}"):
            said = [(call.tool, plain(call.arguments)) for call in reading.calls]
            assert said == second_reading(one.format, one.raw)
    assert len(formats) == 12


def test_nine_of_ten_honest_replies_of_real_models_are_read() -> None:
    """Honest: the tasks are a hospital's own, and nothing but the format was asked for."""
    found = Counter(isinstance(one.reading(), MalformedError) for one in recorded())
    assert found[False] >= 0.9 * found.total(), found
    assert found.total() == 312


def test_the_schema_that_is_made_of_the_binding_alone_removes_refusals() -> None:
    """The same model, tasks and server; with the server's own schemas, and with the binding's."""
    chat = {schema: count for (_, form, schema), count in counts().items() if form == "chat"}
    refused = {
        schema: sum(number for what, number in count.items() if what.startswith("refused"))
        for schema, count in chat.items()
    }
    assert refused["narrowed"] == 0
    assert refused["bare"] >= 10


def test_every_whole_reply_of_the_live_campaigns_is_read_as_it_says() -> None:
    whole = 0
    for log, text in campaign_replies():
        said = second_reading("whole", text)
        if not said:
            continue
        whole += 1
        with case(f"{log}: {text[:200]}"):
            reading = read_reply(text, Dialect.AUTO)
            assert [(call.tool, plain(call.arguments)) for call in reading.calls] == said
    assert whole >= 3_000
