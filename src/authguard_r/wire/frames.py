# SPDX-License-Identifier: Apache-2.0
"""Frames: a header of nine bytes that says how much follows, and the body.

The header alone decides whether a body is read, so that what is too long, unknown or too much is
refused before a byte of it is parsed. No input or output happens here.
Spec page: docs/spec/gate-protocol.md#frames
"""

from __future__ import annotations

from collections.abc import Callable
from struct import Struct as Layout
from typing import TypeVar

import msgspec
from msgspec import Struct

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.wire.messages import Kind

T = TypeVar("T")
#: length of the body, kind, id of the request; big-endian.
_HEADER = Layout(">IBI")
HEADER_BYTES = _HEADER.size
_ENCODER = msgspec.json.Encoder()
_DECODERS: dict[type, msgspec.json.Decoder[object]] = {}


class Frame(Struct, frozen=True):
    """One frame as it came; its body is not parsed yet.

    Args:
        kind: what the body is.
        id: the request's number, which its answers and events carry back; 0 answers nothing.
        body: JSON, at most as long as the kind may be.
    """

    kind: Kind
    id: int
    body: bytes


class FrameReader:
    """Cuts a stream of bytes into frames; holds at most one unfinished frame.

    Args:
        bound: the longest body of a kind, by its number; 0 for a kind that may not come.
    """

    def __init__(self, bound: Callable[[int], int]) -> None:
        self.bound = bound
        self._held = bytearray()
        self._at = 0

    def feed(self, data: bytes | memoryview) -> list[Frame]:
        """Return every frame that is whole now.

        Raises:
            MalformedError: a kind that may not come here, or a body that is too long. What came
                before it in the same bytes is lost with the connection.
        """
        self.put(data)
        frames: list[Frame] = []
        while (item := self.next()) is not None:
            frames.append(item)
        return frames

    def put(self, data: bytes | memoryview) -> None:
        """Take in bytes; `next` cuts them, under the bound that counts by then."""
        self._held += data

    def next(self) -> Frame | None:
        """Return the next frame that is whole, None when it is not whole yet.

        Raises:
            MalformedError: a kind that may not come here, or a body that is too long.
        """
        held, begin = self._held, self._at + HEADER_BYTES
        if len(held) >= begin:
            length, kind, number = _HEADER.unpack_from(held, self._at)
            self._require_bound(kind, length)
            if len(held) >= begin + length:
                self._at = begin + length
                return Frame(Kind(kind), number, bytes(held[begin : self._at]))
        del held[: self._at]
        self._at = 0
        return None

    @property
    def unfinished(self) -> bool:
        """True when a frame has begun and is not whole."""
        return len(self._held) > self._at

    def _require_bound(self, kind: int, length: int) -> None:
        most = self.bound(kind)
        if most == 0:
            raise MalformedError(f"kind {kind} may not come here", where="frame.kind")
        if length > most:
            raise MalformedError(
                f"expected a body of at most {most} bytes, got {length}",
                where="frame.length",
                reason=Reason.INPUT_TOO_LARGE,
            )


def frame(kind: Kind, number: int, body: object) -> bytes:
    """Return the bytes of one frame.

    Args:
        kind: what the body is.
        number: the request's number, 0 for what answers none.
        body: a message, or plain data that JSON can hold.
    """
    return raw_frame(kind, number, _ENCODER.encode(body))


def raw_frame(kind: Kind, number: int, body: bytes) -> bytes:
    """Return the bytes of one frame whose body is encoded already."""
    return _HEADER.pack(len(body), kind, number) + body


def read_body(body: bytes, kind: type[T]) -> T:
    """Return the message in a frame's body.

    Raises:
        MalformedError: not one JSON object of this kind, with the place.
    """
    decoder = _DECODERS.get(kind)
    if decoder is None:
        decoder = _DECODERS[kind] = msgspec.json.Decoder(kind)
    try:
        return decoder.decode(body)  # type: ignore[return-value]
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise MalformedError(str(error), where="body") from error
