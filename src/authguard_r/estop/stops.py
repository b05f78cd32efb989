# SPDX-License-Identifier: Apache-2.0
"""Which stops are under way, who received them, and who has confirmed that the robot stands.

Stops that come while one is under way join the next round of `HALT`, sent as soon as this one is
answered: a robot that stood and moved again in between has never answered them. No input or output
happens here. Spec page: docs/spec/gate-protocol.md#stop-lane
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

from msgspec import Struct

from authguard_r.wire.messages import Stood
from authguard_r.wire.stop_limits import LIMITS

A = TypeVar("A")


class ControllerConnection:
    """One controller's connection, as far as stops go.

    Args:
        send: sends it the `HALT` with this number.
        is_clear: false while an earlier message has not left yet.
    """

    def __init__(self, send: Callable[[int], None], is_clear: Callable[[], bool]) -> None:
        self._send = send
        self._is_clear = is_clear
        self._told_ms = 0
        self.told = 0
        self.stood = 0
        self.said: Stood | None = None
        self.is_gone = False

    @property
    def is_answering(self) -> bool:
        """True while a `HALT` is not answered."""
        return self.stood < self.told

    def tell(self, number: int, now_ms: int) -> None:
        """Send a `HALT`."""
        self.told, self._told_ms = number, now_ms
        self._send(number)

    def remind(self, now_ms: int) -> None:
        """Send it again once it is due; a controller that does not read gets no heap of them."""
        if (
            self.is_answering
            and now_ms - self._told_ms >= LIMITS.halt_again_ms
            and self._is_clear()
        ):
            self.tell(self.told, now_ms)

    def hear(self, number: int, said: Stood) -> bool:
        """Take in that the robot stands; false when that answers another `HALT`, or none."""
        if number != self.told or not self.is_answering:
            return False
        self.stood, self.said = number, said
        return True


class PendingStop(Struct, Generic[A], frozen=True, kw_only=True):
    """One stop that is under way.

    Args:
        asked: what the caller wants back with the answer.
        begun_ms: when it came.
        needs: number of the `HALT` whose answer confirms it; it was sent after the stop came.
        brakes: every controller that was connected.
    """

    asked: A
    begun_ms: int
    needs: int
    brakes: tuple[ControllerConnection, ...]

    def is_confirmed(self) -> bool:
        """True when every controller has said that the robot stands."""
        return bool(self.brakes) and all(brake.stood >= self.needs for brake in self.brakes)

    def is_over(self, now_ms: int) -> bool:
        """True when no controller is left to confirm it, or it has waited long enough."""
        if now_ms - self.begun_ms >= LIMITS.stop_answer_ms:
            return True
        return all(brake.is_gone or brake.stood >= self.needs for brake in self.brakes)


class Settled(Struct, Generic[A], frozen=True, kw_only=True):
    """The state of one stop.

    Args:
        asked: as given.
        controller: a controller was connected.
        stopped: every one of them says that the robot stands.
        after_ms: how long it took.
        said: the first controller's own word, when it stands.
    """

    asked: A
    controller: bool
    stopped: bool
    after_ms: int
    said: Stood | None


class Stops(Generic[A]):
    """Every stop that is under way and every controller that is connected.

    `begun` counts the stops that came, `over` those that are settled, in the same order.
    """

    def __init__(self) -> None:
        self._wanted = 0
        self._brakes: list[ControllerConnection] = []
        self._waiting: deque[PendingStop[A]] = deque()
        self._is_owed = False
        self.begun = 0
        self.over = 0

    @property
    def is_under_way(self) -> bool:
        """True while a stop waits, or a controller has not answered."""
        return bool(self._waiting) or any(brake.is_answering for brake in self._brakes)

    @property
    def is_waiting(self) -> bool:
        """True while a client waits for an answer."""
        return bool(self._waiting)

    def join(self, brake: ControllerConnection, now_ms: int) -> None:
        """Accept a controller; it first hears of a stop that is not confirmed."""
        self._brakes.append(brake)
        if self._is_owed or self._waiting:
            brake.tell(self._wanted, now_ms)

    def leave(self, brake: ControllerConnection) -> None:
        """Let a controller go."""
        brake.is_gone = True
        self._brakes.remove(brake)

    def stop(self, asked: A, now_ms: int) -> None:
        """Send `HALT` at once, or after the answer that is awaited."""
        self.begun += 1
        if self._wanted == 0 or any(b.told >= self._wanted for b in self._brakes):
            self._wanted += 1  # what was sent before this stop came does not answer it
        brakes = tuple(self._brakes)
        for brake in brakes:
            if not brake.is_answering:
                brake.tell(self._wanted, now_ms)
        self._waiting.append(
            PendingStop(asked=asked, begun_ms=now_ms, needs=self._wanted, brakes=brakes)
        )

    def stood(self, brake: ControllerConnection, number: int, *, said: Stood, now_ms: int) -> None:
        """Take in a controller's answer, and send it what was asked for meanwhile."""
        if not brake.hear(number, said):
            return
        if brake.stood >= self._wanted:
            self._is_owed = False
        else:
            brake.tell(self._wanted, now_ms)

    def remind(self, now_ms: int) -> None:
        """Repeat every `HALT` that is due."""
        for brake in self._brakes:
            brake.remind(now_ms)

    def settled(self, now_ms: int) -> list[Settled[A]]:
        """Return the stops that are over now, in the order in which they came."""
        over: list[Settled[A]] = []
        while self._waiting and self._waiting[0].is_over(now_ms):
            over.append(self._settle(self._waiting.popleft(), now_ms))
        return over

    def _settle(self, waiting: PendingStop[A], now_ms: int) -> Settled[A]:
        self.over += 1
        stopped = waiting.is_confirmed()
        self._is_owed = self._is_owed or not stopped
        return Settled(
            asked=waiting.asked,
            controller=bool(waiting.brakes),
            stopped=stopped,
            after_ms=now_ms - waiting.begun_ms,
            said=waiting.brakes[0].said if stopped else None,
        )
