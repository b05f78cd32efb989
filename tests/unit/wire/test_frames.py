# SPDX-License-Identifier: Apache-2.0
"""Frames: however a stream is split, the same frames come out, and nothing too long is held."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import suppress

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.wire.frames import HEADER_BYTES, Frame, FrameReader, frame, raw_frame, read_body
from authguard_r.wire.messages import Hello, Kind, Nothing, Records
from fixtures.cases import case

BOUND = 64
frames = st.lists(
    st.builds(Frame, st.sampled_from(Kind), st.integers(0, 0xFFFF_FFFF), st.binary(max_size=BOUND)),
    max_size=8,
)


def any_kind(_: int) -> int:
    return BOUND


def pieces(data: bytes, cuts: list[int]) -> Iterator[bytes]:
    """Split bytes at places that are drawn from the length."""
    places = sorted({cut % (len(data) + 1) for cut in cuts})
    for begin, end in zip([0, *places], [*places, len(data)], strict=True):
        yield data[begin:end]


@given(sent=frames, cuts=st.lists(st.integers(0, 10_000), max_size=12))
def test_any_split_of_any_stream_gives_the_same_frames(sent: list[Frame], cuts: list[int]) -> None:
    stream = b"".join(raw_frame(item.kind, item.id, item.body) for item in sent)
    reader = FrameReader(any_kind)
    assert [item for piece in pieces(stream, cuts) for item in reader.feed(piece)] == sent
    assert not reader.unfinished


@given(sent=frames)
def test_a_stream_byte_by_byte_gives_the_same_frames_and_says_when_one_is_open(
    sent: list[Frame],
) -> None:
    reader, got = FrameReader(any_kind), []
    for item in sent:
        data = raw_frame(item.kind, item.id, item.body)
        for at in range(len(data)):
            assert reader.unfinished is (at > 0)
            got += reader.feed(data[at : at + 1])
    assert got == sent


@given(sent=frames, cuts=st.lists(st.integers(0, 10_000), max_size=12))
def test_no_more_is_held_than_one_unfinished_frame(sent: list[Frame], cuts: list[int]) -> None:
    stream = b"".join(raw_frame(item.kind, item.id, item.body) for item in sent)
    reader = FrameReader(any_kind)
    for piece in pieces(stream, cuts):
        reader.feed(piece)
        assert len(reader._held) < HEADER_BYTES + BOUND


@given(kind=st.integers(0, 255), over=st.integers(1, 0xFFFF_FFFF - BOUND), number=st.integers(0, 9))
def test_the_header_alone_refuses_what_is_too_long(kind: int, over: int, number: int) -> None:
    reader = FrameReader(any_kind)
    with pytest.raises(MalformedError) as caught:
        reader.feed(struct.pack(">IBI", BOUND + over, kind, number))
    assert (caught.value.reason, caught.value.where) == (Reason.INPUT_TOO_LARGE, "frame.length")


@given(kind=st.integers(0, 255), length=st.integers(0, 0xFFFF_FFFF))
def test_the_header_alone_refuses_a_kind_that_may_not_come(kind: int, length: int) -> None:
    reader = FrameReader(lambda _: 0)
    with pytest.raises(MalformedError) as caught:
        reader.feed(struct.pack(">IBI", length, kind, 1))
    assert (caught.value.reason, caught.value.where) == (Reason.MALFORMED, "frame.kind")


def test_a_frame_exactly_at_its_bound_is_taken() -> None:
    assert len(FrameReader(any_kind).feed(raw_frame(Kind.STATUS, 1, bytes(BOUND)))) == 1


def test_bounds_that_change_count_for_the_next_frame_in_the_same_bytes() -> None:
    allowed = {Kind.HELLO}
    reader = FrameReader(lambda kind: BOUND if kind in allowed else 0)
    reader.put(frame(Kind.HELLO, 0, {}) + frame(Kind.STATUS, 1, {}))
    first = reader.next()
    assert first is not None
    assert first.kind is Kind.HELLO
    allowed.clear()
    allowed.add(Kind.STATUS)
    second = reader.next()
    assert second is not None
    assert second.kind is Kind.STATUS
    assert reader.next() is None


@given(body=st.binary(max_size=200))
def test_any_bytes_are_a_message_or_malformed(body: bytes) -> None:
    for kind in (Hello, Records, Nothing):
        with suppress(MalformedError):  # nothing else may leave it
            assert type(read_body(body, kind)) is kind


def test_what_is_not_exactly_the_message_is_refused() -> None:
    for body in [
        b"",
        b"[]",
        b"null",
        b'{"first":NaN}',
        b'{"first":1.0}',
        b'{"first":true}',
        b'{"first":"1"}',
        b'{"first":-1}',
        b'{"first":9007199254740992}',
        b'{"first":' + b"9" * 5_000 + b"}",
        b'{"first":1,"more":1}',
        b'{"count":1}',
        b'{"first":1} {}',
        b"\xef\xbb\xbf{}",
        b'{"first":' + b"[" * 100_000 + b"]" * 100_000 + b"}",
        b'{"first":' + b'{"a":' * 100_000 + b"}" * 100_000 + b"}",
    ]:
        with case(body), pytest.raises(MalformedError):
            read_body(body, Records)


def test_nesting_deeper_than_the_decoder_goes_is_refused() -> None:
    with pytest.raises(MalformedError):
        read_body(b"[" * 100_000 + b"]" * 100_000, dict)
    with pytest.raises(MalformedError):
        read_body(b'{"a":' * 100_000 + b"1" + b"}" * 100_000, dict)


def test_of_a_key_that_comes_twice_the_last_counts_and_both_are_held_to_the_kind() -> None:
    assert read_body(b'{"first":1,"first":2}', Records).first == 2
    with pytest.raises(MalformedError):
        read_body(b'{"first":"x","first":2}', Records)


def test_a_frame_is_its_header_and_its_message() -> None:
    data = frame(Kind.RECORDS, 7, Records(first=3))
    assert data[:HEADER_BYTES] == struct.pack(">IBI", len(data) - HEADER_BYTES, Kind.RECORDS, 7)
    assert msgspec.json.decode(data[HEADER_BYTES:]) == {"first": 3, "count": 100}
