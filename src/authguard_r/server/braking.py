# SPDX-License-Identifier: Apache-2.0
"""Stops that come to the gate itself: it brakes at once, and answers when the robot stands.

A client sends a stop to the stop process and to the gate, so that one of them that hangs costs
nothing. Spec page: docs/spec/gate-protocol.md#a-stop-at-the-gate
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from functools import partial

from msgspec import Struct

from authguard_r.core.errors import AuthGuardError
from authguard_r.core.identifiers import Identifier
from authguard_r.core.ports import Controller
from authguard_r.server.fair_queue import ServedClient
from authguard_r.server.lease_registry import LeaseRegistry
from authguard_r.server.remote_controller import RemoteController
from authguard_r.server.stop_recorder import StopRecorder
from authguard_r.server.wiring import Gate
from authguard_r.wire.faults import to_fault
from authguard_r.wire.frames import Frame, read_body
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import ClientRole, Mode, Stop, Stopped

#: A user in a role.
_Who = tuple[int, ClientRole]


def brakes_of(
    gate: Gate,
    remote: RemoteController | None,
    mode: Mode,
    *,
    recorder: StopRecorder,
    leases: LeaseRegistry,
) -> Braking:
    """Return who carries out the stops that come to a gate itself."""
    here = remote is None and mode is Mode.ENFORCE
    return Braking(
        gate.watch.controller,
        remote,
        recorder=recorder,
        stands=(lambda: not leases) if here else None,
        mono_ms=gate.ledger.mono_ms,
    )


class _PendingBrake(Struct):
    """A stop that is under way, or whose record waits.

    Args:
        client: who asked first.
        stop: as it was asked for.
        asked: whose requests are answered with it.
        begun_ms: when it came, on the gate's monotonic clock.
        halt: the `HALT` whose answer confirms it; None when no controller received it.
        stood_ms: after how long the robot stood.
        due_ms: when it is written down; None while it is under way.
        more: stops that were folded into its record.
    """

    client: ServedClient
    stop: Stop
    asked: list[tuple[ServedClient, int]]
    begun_ms: int
    halt: int | None
    stood_ms: int | None = None
    due_ms: int | None = None
    more: int = 0


class Braking:
    """Carries out stops of the gate's own clients, one of each user and role at a time.

    Args:
        controller: brakes.
        remote: the same, where it is connected over a socket; None: a robot in this process, or
            a gate that moves nothing.
        recorder: writes stops down.
        stands: True while nothing moves, of a robot in this process; None when it is unknown.
        mono_ms: the gate's monotonic clock.
    """

    def __init__(
        self,
        controller: Controller,
        remote: RemoteController | None,
        *,
        recorder: StopRecorder,
        stands: Callable[[], bool] | None,
        mono_ms: Callable[[], int],
    ) -> None:
        self._controller = controller
        self._remote = remote
        self._recorder = recorder
        self._stands = stands
        self._mono_ms = mono_ms
        self._waiting: dict[_Who, _PendingBrake] = {}
        self._written: dict[_Who, _PendingBrake] = {}

    def came(
        self,
        client: ServedClient,
        item: Frame,
        refused: Callable[[Identifier, AuthGuardError], None],
    ) -> None:
        """Brake now; what else there is to do comes with the loop's next turn.

        Args:
            client: whose stop it is.
            item: the message.
            refused: records a message that is not valid.
        """
        try:
            self._stop(client, item.id, read_body(item.body, Stop))
        except AuthGuardError as error:
            refused(client.name, error)
            client.error(item.id, to_fault(error))

    def look(self) -> None:
        """Answer every stop that is over, and write down what is due."""
        now_ms = self._mono_ms()
        for who, waiting in tuple(self._waiting.items()):
            after_ms = now_ms - waiting.begun_ms
            stands = self._is_confirmed(waiting.halt)
            if stands or after_ms >= LIMITS.stop_answer_ms or not self._is_there:
                del self._waiting[who]
                waiting.stood_ms = after_ms if stands else None
                said = Stopped(stopped=stands, controller=self._is_there, after_ms=after_ms)
                for client, number in waiting.asked:
                    client.reply(number, said)
                self._keep(who, waiting, now_ms)
        for who, waiting in tuple(self._written.items()):
            if waiting.due_ms is not None and now_ms >= waiting.due_ms:
                self._write(waiting)
                del self._written[who]
            elif waiting.due_ms is None and now_ms - waiting.begun_ms >= LIMITS.stop_fold_ms:
                del self._written[who]

    def end(self) -> None:
        """Write down what waits: the gate ends."""
        for waiting in (*self._waiting.values(), *self._written.values()):
            if waiting.asked:
                self._write(waiting)
        self._waiting.clear()
        self._written.clear()

    def _stop(self, client: ServedClient, number: int, stop: Stop) -> None:
        who, loop = (client.uid, client.role), asyncio.get_running_loop()
        known = self._waiting.get(who)
        if known is not None:
            known.more += not _is_same(known.stop, stop)
            known.asked += [(client, number)] if len(known.asked) < LIMITS.joined_stops else []
            loop.call_soon(partial(self._recorder.begun, client.role))
            return
        self._controller.stop()
        told = None if self._remote is None or not self._remote.connected else self._remote.halts
        asked, now_ms = [(client, number)], self._mono_ms()
        self._waiting[who] = _PendingBrake(client, stop, asked, begun_ms=now_ms, halt=told)
        # not here: the caller that brought the bytes may be in the middle of another step
        loop.call_soon(partial(self._hold, client))

    def _hold(self, client: ServedClient) -> None:
        self._recorder.begun(client.role)
        self.look()

    def _keep(self, who: _Who, waiting: _PendingBrake, now_ms: int) -> None:
        """Write a stop down: now, or later with those that follow.

        The stop process may confirm what was not confirmed here: its message comes within a second.
        """
        before = self._written.get(who)
        if before is None and waiting.stood_ms is not None:
            self._write(waiting)
            self._written[who] = _PendingBrake(waiting.client, waiting.stop, [], now_ms, None)
        elif before is None or before.due_ms is None:
            later_ms = (
                LIMITS.stop_fold_ms if waiting.stood_ms is not None else LIMITS.stop_answer_ms
            )
            waiting.due_ms = now_ms + later_ms
            self._written[who] = waiting
        elif before.stood_ms is None and _is_same(before.stop, waiting.stop):
            before.more += waiting.more
            before.stood_ms = None if waiting.stood_ms is None else now_ms - before.begun_ms
        else:
            before.more += 1 + waiting.more
            if before.stood_ms is not None and waiting.stood_ms is not None:
                before.stood_ms = max(before.stood_ms, waiting.stood_ms)
            else:
                before.stood_ms = None

    def _write(self, waiting: _PendingBrake) -> None:
        self._recorder.taken(waiting.client, waiting.stop, waiting.stood_ms, waiting.more)

    @property
    def _is_there(self) -> bool:
        return self._stands is not None if self._remote is None else self._remote.connected

    def _is_confirmed(self, halt: int | None) -> bool:
        if self._remote is not None:
            told = halt is not None and self._remote.connected
            return told and halt is not None and self._remote.has_stood(halt)
        return self._stands is not None and self._stands()


def _is_same(one: Stop, other: Stop) -> bool:
    """Return True of one stop that was asked for again."""
    return bool(one.key) and one.key == other.key
