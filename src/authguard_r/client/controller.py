# SPDX-License-Identifier: Apache-2.0
"""What a controller does with each message, and with silence; the same for every kind of robot.

It begins an action only when a gate that proved its key says so, and ends it by itself when that
gate falls silent. No input, no output and no clock: the caller brings frames and time. Spec page:
docs/spec/gate-protocol.md#controllers
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import Protocol, runtime_checkable

from msgspec import Struct
from msgspec.structs import replace

from authguard_r.client.proof import Proven
from authguard_r.core.action import Action
from authguard_r.core.errors import ControllerError, MalformedError
from authguard_r.core.identifiers import Digest, RobotId
from authguard_r.core.ports import GoalHandle
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Outcome
from authguard_r.wire.frames import Frame, read_body
from authguard_r.wire.messages import (
    Begun,
    Close,
    Dispatch,
    Ended,
    Forward,
    Halt,
    Kind,
    Renew,
    Result,
    Stood,
)

#: The world moves in steps of at most this long, in milliseconds.
STEP_MS = 20
#: A stream without a sample for this long has velocity zero.
SAMPLE_MS = 200
#: Why a controller ended an action whose gate fell silent.
RENEWAL_LOST = "RENEWAL_LOST"
#: A gate that comes back gets so many of the actions that ended; they are not begun again.
KEPT = 16


@runtime_checkable
class ReportingHandle(Protocol):
    """A flight that has something to tell the planner when it has ended."""

    def told(self) -> ExecutionNews | None:
        """Return it; None: nothing."""
        ...


class ExecutionNews(Struct, frozen=True):
    """What an action brought to light.

    Args:
        content: what the planner sees.
        texts: every word of it that a model could read.
    """

    content: bytes
    texts: tuple[str, ...]


class Body(Protocol):
    """What moves, as its controller knows it.

    `obeys` is False of a body that carries out no stop, and `late_ms` is how much later it answers:
    injected faults.
    """

    rid: RobotId
    #: what a sample may name
    sampled: frozenset[str]

    @property
    def obeys(self) -> bool:
        """Carries out stops."""
        ...

    @property
    def late_ms(self) -> int:
        """Answers that much later."""
        ...

    @property
    def stands(self) -> bool:
        """True when no motion is known, apart from that of its actions."""
        ...

    def has_room(self, action: Action) -> bool:
        """Return True if it can begin this action beside those that run."""
        ...

    def begin(self, action: Action, ticket: Digest) -> GoalHandle:
        """Begin an action.

        Args:
            action: as it was released.
            ticket: names the release.

        Raises:
            ControllerError: it cannot be begun, and nothing has moved.
        """
        ...

    def streams(self, action: Action) -> bool:
        """Return True for an action that samples may steer while it runs."""
        ...

    def steer(self, ticket: Digest, params: Mapping[str, int]) -> None:
        """Go on with this sample of a stream; what it does not name is zero."""
        ...

    def close(self, ticket: Digest) -> None:
        """End a stream as it was to end: brake; it has succeeded once the robot stands."""
        ...

    def brake(self) -> None:
        """Brake and hold; running actions are aborted once it stands, unless they ended before."""
        ...

    def pass_time(self, ms: int) -> None:
        """Take note that so many milliseconds passed."""
        ...


class MessageSource(StrEnum):
    """Where a message came from."""

    GATE = "gate"
    STOP = "stop"


class OutgoingMessage(Struct, frozen=True):
    """A message on its way to a server."""

    channel: MessageSource
    kind: Kind
    id: int
    body: Begun | Ended | Stood | Result


class _Run(Struct, frozen=True, kw_only=True):
    """An action that runs, until the robot stands after it.

    Args:
        order: as it was dispatched.
        handle: what the body makes of it.
        begun_ms: when it began.
        renewed_ms: when the gate was last heard of it.
        sampled_ms: when the last sample came; None before the first.
        why: why it does not go as it should.
    """

    order: Dispatch
    handle: GoalHandle
    begun_ms: int
    renewed_ms: int
    sampled_ms: int | None = None
    why: str = ""


class _Late(Struct, frozen=True):
    """A message that goes out at a time."""

    due_ms: int
    sent: OutgoingMessage


class ControllerSession:
    """The controller of one robot; every method returns what is to be sent.

    A stop is for the whole robot: every running action ends with it. `stops` counts the stops that
    were carried out since this start, of all callers.

    Args:
        body: what moves.
        life: a number of this start, and of no other; above 0.
        now_ms: the monotonic clock at the start.
    """

    def __init__(self, body: Body, *, life: int, now_ms: int) -> None:
        self.body = body
        self.life = life
        self.stops = 0
        self._now_ms = now_ms
        self._proven: set[MessageSource] = set()
        self._runs: dict[Digest, _Run] = {}
        self._ended: dict[Digest, Ended] = {}  # the last of them, in order
        self._is_stopping = False
        self._halts: dict[
            tuple[MessageSource, int], None
        ] = {}  # in order; a repeat is the same one
        self._late: list[_Late] = []
        self._acts: dict[Kind, Callable[[MessageSource, Frame], None]] = {
            Kind.DISPATCH: self._dispatch,
            Kind.RENEW: self._renew,
            Kind.HALT: self._halt,
            Kind.FORWARD: self._forward,
            Kind.CLOSE: self._close,
        }

    @property
    def stands(self) -> bool:
        """True when no action runs and nothing brakes."""
        return not self._runs and not self._is_stopping

    def hears(self, channel: MessageSource) -> bool:
        """Return True while a server that proved itself is connected there."""
        return channel in self._proven

    def opened(
        self, channel: MessageSource, proven: Proven, now_ms: int
    ) -> tuple[OutgoingMessage, ...]:
        """Listen to a server from now on.

        A gate hears at once how the last actions ended, known to it or not, and how many stops
        there were, if the robot stands.

        Args:
            channel: which connection.
            proven: its proof, which only `proof.prove` makes.
            now_ms: the monotonic clock.
        """
        if proven.welcome.robot != self.body.rid:
            raise RuntimeError("a proof for another robot was let through")
        self._advance(now_ms)
        self._proven.add(channel)
        if channel is MessageSource.GATE:
            for ended in self._ended.values():
                self._say(channel, Kind.ENDED, ended)
            if self.stands:
                self._say(channel, Kind.STOOD, self._stood())
        return self._take()

    def closed(self, channel: MessageSource, now_ms: int) -> tuple[OutgoingMessage, ...]:
        """Note that a connection is lost; without its gate the robot does not go on."""
        self._advance(now_ms)
        self._proven.discard(channel)
        self._halts = {asked: None for asked in self._halts if asked[0] is not channel}
        if channel is MessageSource.GATE and self._runs and not self._is_stopping:
            self._stop(RENEWAL_LOST)
        return self._take()

    def handle(
        self, channel: MessageSource, frame: Frame, now_ms: int
    ) -> tuple[OutgoingMessage, ...]:
        """Obey one message, if it is of a kind that this connection may send.

        Args:
            channel: where it came from; what has not proven itself is not heard.
            frame: the message.
            now_ms: the monotonic clock.

        Raises:
            MalformedError: it is not what its kind says; nothing was done.
        """
        if channel in self._proven and (channel is MessageSource.GATE or frame.kind is Kind.HALT):
            act = self._acts.get(frame.kind)
            if act is not None:
                self._advance(now_ms)  # the silence before a message is judged before the message
                act(channel, frame)
        return self._take()

    def tick(self, now_ms: int) -> tuple[OutgoingMessage, ...]:
        """Advance the world to now; stop actions whose lease was not renewed."""
        self._advance(now_ms)
        self._settle()  # what ended in this very millisecond, too
        return self._take()

    # messages

    def _dispatch(self, channel: MessageSource, frame: Frame) -> None:
        order = read_body(frame.body, Dispatch)
        if order.ticket in self._ended:
            self._say(channel, Kind.ENDED, self._ended[order.ticket], frame.id)  # never twice
            return
        if order.ticket in self._runs:
            self._say(channel, Kind.BEGUN, Begun(ticket=order.ticket), frame.id)
            return
        why = self._begin(order)
        if why:
            ended = Ended(ticket=order.ticket, outcome=Outcome.NOT_STARTED, why=why)
            self._say(channel, Kind.ENDED, ended, frame.id)
            return
        self._say(channel, Kind.BEGUN, Begun(ticket=order.ticket), frame.id)
        self._settle()  # what takes no time is over already

    def _begin(self, order: Dispatch) -> str:
        """Begin the action; return why it was not begun, empty when it was."""
        is_of_now = order.life == self.life and order.stops >= self.stops
        if self._is_stopping or not is_of_now:
            return Reason.STOPPED
        if self._runs and not self.body.has_room(order.action):
            return Reason.BUSY
        try:
            handle = self.body.begin(order.action, order.ticket)
        except ControllerError:
            return Reason.CONTROLLER_FAILED
        now = self._now_ms
        self._runs[order.ticket] = _Run(order=order, handle=handle, begun_ms=now, renewed_ms=now)
        return ""

    def _renew(self, _channel: MessageSource, frame: Frame) -> None:
        ticket = read_body(frame.body, Renew).ticket
        if ticket in self._runs:
            self._runs[ticket] = replace(self._runs[ticket], renewed_ms=self._now_ms)

    def _forward(self, _channel: MessageSource, frame: Frame) -> None:
        sample = read_body(frame.body, Forward)
        if not sample.params.keys() <= self.body.sampled:
            raise MalformedError("expected a velocity", where="forward.params")
        run = self._runs.get(sample.ticket)
        if run is not None and not self._is_stopping and self.body.streams(run.order.action):
            self.body.steer(sample.ticket, sample.params)
            self._runs[sample.ticket] = replace(run, sampled_ms=self._now_ms)

    def _close(self, _channel: MessageSource, frame: Frame) -> None:
        ticket = read_body(frame.body, Close).ticket
        run = self._runs.get(ticket)
        if run is not None and self.body.streams(run.order.action):
            self.body.close(ticket)
            self._settle()

    def _halt(self, channel: MessageSource, frame: Frame) -> None:
        read_body(frame.body, Halt)
        if self.body.obeys:
            self._halts[channel, frame.id] = None
            self._stop(Reason.STOPPED)

    # time

    def _advance(self, now_ms: int) -> None:
        """Move the world to now, step by step, and judge the silence in each."""
        while self._now_ms < now_ms:
            step = min(STEP_MS, now_ms - self._now_ms)
            self._now_ms += step
            self.body.pass_time(step)
            self._settle()
            self._guard()

    def _guard(self) -> None:
        """Stop what was not renewed or lasts too long; a stream without samples stands."""
        if self._is_stopping:
            return
        for ticket, run in tuple(self._runs.items()):
            why = self._over(run)
            if why:
                self._stop(why, ticket)
                return
            if run.sampled_ms is not None and self._now_ms - run.sampled_ms >= SAMPLE_MS:
                self.body.steer(ticket, {})

    def _over(self, run: _Run) -> str:
        """Return why an action may not go on; empty while it may."""
        if self._now_ms - run.renewed_ms >= run.order.renew_within_ms:
            return RENEWAL_LOST
        is_long = self._now_ms - run.begun_ms >= run.order.max_ms
        return Reason.LEASE_ENDED if is_long else ""

    def _stop(self, why: str, ticket: Digest | None = None) -> None:
        """Brake and hold; a stop that comes while one is carried out joins it.

        Args:
            why: there is a stop.
            ticket: the action that it is for; what runs beside is stopped with it. None: all.
        """
        if self._is_stopping or not self.body.obeys:
            return
        self.stops += 1
        self._is_stopping = True
        for one, run in self._runs.items():
            its = why if ticket in {None, one} else Reason.STOPPED
            self._runs[one] = replace(run, why=its)
        self.body.brake()
        self._settle()

    def _settle(self) -> None:
        """Tell how actions ended, then that the robot stands."""
        for ticket, run in tuple(self._runs.items()):
            outcome = run.handle.outcome()
            if outcome is not None:
                del self._runs[ticket]
                self._tell_ended(run, _ended(run, outcome))
        if self._is_stopping and not self._runs and self.body.stands:
            self._is_stopping = False
            self._tell_stood()

    def _tell_ended(self, run: _Run, ended: Ended) -> None:
        """Tell what an action brought to light, and how it ended."""
        self._ended[ended.ticket] = ended
        if len(self._ended) > KEPT:
            del self._ended[next(iter(self._ended))]
        told = run.handle.told() if isinstance(run.handle, ReportingHandle) else None
        if told is not None:
            result = Result(ticket=ended.ticket, content=told.content, texts=told.texts)
            self._say(MessageSource.GATE, Kind.RESULT, result)
        self._say(MessageSource.GATE, Kind.ENDED, ended)

    def _tell_stood(self) -> None:
        """Answer every `HALT`, and tell the gate of a stop that it did not ask for."""
        asked = tuple(self._halts)
        if not any(channel is MessageSource.GATE for channel, _ in asked):
            asked = (*asked, (MessageSource.GATE, 0))
        for channel, number in asked:
            self._say(channel, Kind.STOOD, self._stood(), number)
        self._halts = {}

    def _stood(self) -> Stood:
        return Stood(stops=self.stops, life=self.life)

    # messages out

    def _say(
        self,
        channel: MessageSource,
        kind: Kind,
        body: Begun | Ended | Stood | Result,
        number: int = 0,
    ) -> None:
        if channel in self._proven:
            due = self._now_ms + self.body.late_ms
            self._late.append(_Late(due, OutgoingMessage(channel, kind, number, body)))

    def _take(self) -> tuple[OutgoingMessage, ...]:
        """Return what is due, in order, for the servers that are still there."""
        due = [late.sent for late in self._late if late.due_ms <= self._now_ms]
        self._late = [late for late in self._late if late.due_ms > self._now_ms]
        return tuple(sent for sent in due if sent.channel in self._proven)


def _ended(run: _Run, outcome: Outcome) -> Ended:
    """Return how an action ended, with a code unless it succeeded."""
    why = run.why
    if outcome is Outcome.SUCCEEDED:
        why = ""
    elif not why:
        why = Reason.CONTROLLER_FAILED
    return Ended(ticket=run.order.ticket, outcome=outcome, used=run.handle.used(), why=why)
