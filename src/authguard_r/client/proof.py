# SPDX-License-Identifier: Apache-2.0
"""A conversation with one server: nothing it says counts before it has proved the gate's key.

No input or output happens here. Spec page: docs/spec/gate-protocol.md#proof
"""

from __future__ import annotations

from collections.abc import Callable

from msgspec import Struct

from authguard_r.client.handshake import Handshake, hello, require_welcome
from authguard_r.core.errors import MalformedError
from authguard_r.core.quantities import Now
from authguard_r.wire.faults import from_fault
from authguard_r.wire.frames import Frame, FrameReader, frame, read_body
from authguard_r.wire.messages import Fault, Kind, Welcome

#: Longest welcome or error, in bytes: a proof brings two certificates for each of two roots.
MAX_WELCOME = 1 << 16


class Proven(Struct, frozen=True):
    """A server that proved itself. Only `prove` makes one."""

    welcome: Welcome


def prove(item: Frame, handshake: Handshake, *, nonce: str, now: Now) -> Proven:
    """Return the proof in a server's first message.

    Raises:
        MalformedError: it is no welcome, or another hello's.
        AuthenticityError: the proof does not hold, or is another robot's.
        AuthGuardError: the server refused the hello; its own reason.
    """
    if handshake.verifier is None or handshake.robot is None:
        raise RuntimeError("a proof was asked for without a trust root to check it")
    if item.kind is Kind.ERROR:
        raise from_fault(read_body(item.body, Fault))
    if item.kind is not Kind.WELCOME:
        raise MalformedError("expected a welcome", where="frame.kind")
    welcome = read_body(item.body, Welcome)
    require_welcome(welcome, handshake, nonce=nonce, now=now)
    return Proven(welcome)


class Conversation:
    """The client's side of one connection, from the hello on.

    `proven` is None until the server has proved itself; until then no frame comes out.

    Args:
        handshake: who the client is and whose gate it must be.
        nonce: fresh random bytes, base64url.
        bounds: the longest body of each kind that may come after the welcome.
        now: reads the clock, for the gate's certificate.
    """

    def __init__(
        self,
        handshake: Handshake,
        *,
        nonce: str,
        bounds: dict[Kind, int],
        now: Callable[[], Now],
    ) -> None:
        self.proven: Proven | None = None
        self._handshake = handshake
        self._nonce = nonce
        self._bounds = {int(kind): most for kind, most in bounds.items()}
        self._now = now
        self._reader = FrameReader(self._bound)

    def hello(self) -> bytes:
        """Return the first message's bytes."""
        return frame(Kind.HELLO, 0, hello(self._handshake, self._nonce))

    def receive(self, data: bytes) -> list[Frame]:
        """Return what a proven server said.

        Raises:
            AuthGuardError: it has not proved itself, or sent what may not come.
        """
        frames = self._reader.feed(data)
        if self.proven is None and frames:
            self.proven = prove(frames.pop(0), self._handshake, nonce=self._nonce, now=self._now())
        return frames

    def _bound(self, kind: int) -> int:
        # what came with the welcome is held to its bound, and not looked at before the proof
        if self.proven is None and kind in {Kind.WELCOME, Kind.ERROR}:
            return MAX_WELCOME
        return self._bounds.get(kind, 0)
