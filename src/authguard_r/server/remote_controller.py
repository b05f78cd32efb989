# SPDX-License-Identifier: Apache-2.0
"""The gate's end of the controller's connection, behind the core's port.

Only a peer whose user may be the controller gets here, and it obeys only who proves the gate's
key. Nothing waits: what the controller says arrives when it arrives, and what it fails to say in
time is a reason to stop. Implements `core.ports.Controller`.
Spec page: docs/spec/gate-protocol.md#controllers
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from msgspec import Struct
from msgspec.structs import replace

from authguard_r.core.action import Action
from authguard_r.core.errors import ControllerError, EnvironmentFault
from authguard_r.core.identifiers import Digest, ParameterId
from authguard_r.core.lease import Lease
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Outcome, Spend
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import (
    Begun,
    Close,
    Dispatch,
    Ended,
    Forward,
    Halt,
    Kind,
    Renew,
    Stood,
)

#: Sends one message to the controller, with a number that its answer carries back.
Send = Callable[[Kind, object, int], None]
#: The parameter that says how long a stream lasts, and how much later its controller stops it.
DURATION = ParameterId("duration_ms")
_VELOCITY = ("_mm_s", "_urad_s")


def is_stream(action: Action) -> bool:
    """True for a velocity for a time: what samples may change while it runs."""
    others = [name for name in action.params if name != DURATION]
    timed = DURATION in action.params
    return timed and bool(others) and all(name.endswith(_VELOCITY) for name in others)


def longest_ms(action: Action, lease: Lease, now_ms: int) -> int:
    """Return how long a controller may go on at most; a stream no longer than it was asked for."""
    left_ms = max(0, lease.until_mono_ms - now_ms)
    return (
        min(left_ms, action.params[DURATION] + LIMITS.stream_slack_ms)
        if is_stream(action)
        else left_ms
    )


class Unexplained(Struct, frozen=True):
    """A stop that the controller reports and that the stop process has not explained yet."""

    stops: int
    since_ms: int


class RemoteGoal:
    """One dispatched action, as far as the controller has reported (`core.ports.Flight`)."""

    def __init__(self, dispatched_ms: int) -> None:
        self.dispatched_ms = dispatched_ms
        self.begun = False
        self.is_left = False
        self._ended: Ended | None = None
        self._why = ""

    def outcome(self) -> Outcome | None:
        """Return how it ended; None while the controller has not said so."""
        return None if self._ended is None else self._ended.outcome

    def used(self) -> Spend:
        """Return what it used; nothing is known before its end."""
        return Spend() if self._ended is None else self._ended.used

    def why(self) -> str:
        """Return why it failed, or why its outcome cannot be known."""
        return self._why if self._ended is None else self._ended.why

    def end(self, message: Ended) -> None:
        """Take in how it ended; the first report counts."""
        self._ended = self._ended or message

    def doubt(self) -> None:
        """Say that the controller cannot be relied on for this action any more."""
        self._why = Reason.CONTROLLER_FAILED

    def leave(self) -> None:
        """Note that the connection that it was sent over has ended."""
        self.is_left = True
        self.doubt()


class RemoteController:
    """The one controller of the robot, connected or not.

    Args:
        mono_ms: the monotonic clock that leases are measured on.
        renew_within_ms: sent with each action; the controller's own watchdog.
        admit: called before each dispatch; raises `ControllerError` to refuse it.
        ask: asks the stop process whether the gate has heard of all its stops; calls its argument
            when that is so; returns False when there is no stop process to ask.
        can_stop: returns whether a stop would be carried out. While it would not, the gate
            releases nothing and renews no lease.
    """

    def __init__(
        self,
        mono_ms: Callable[[], int],
        *,
        renew_within_ms: int,
        admit: Callable[[Action, Lease], None] = lambda _action, _lease: None,
        ask: Callable[[Callable[[], None]], bool] = lambda _: False,
        can_stop: Callable[[], bool] = lambda: True,
    ) -> None:
        self._mono_ms = mono_ms
        self._admit = admit
        self._ask = ask
        self.can_stop = can_stop
        self._renew_within_ms = renew_within_ms
        self._send: Send | None = None
        self._flights: dict[Digest, RemoteGoal] = {}
        self._life = 0
        self._stops = 0
        self._halts = 0
        self._stood = 0
        self._halting = False
        self._unexplained: Unexplained | None = None

    def require_stop(self) -> None:
        """Require that a stop would be carried out (`running.Guarded`).

        Raises:
            EnvironmentFault: the stop process does not answer (`BUSY`).
        """
        if not self.can_stop():
            raise EnvironmentFault(
                "the stop process does not answer: nothing begins until it does",
                reason=Reason.BUSY,
                where="stop",
            )

    @property
    def connected(self) -> bool:
        """True while a controller is connected."""
        return self._send is not None

    def attach(self, send: Send) -> None:
        """Take a controller's connection.

        Raises:
            ControllerError: there is one already; the first keeps its place.
        """
        if self._send is not None:
            raise ControllerError("a controller is connected already")
        self._send, self._halting = send, False
        self._count_anew(0)  # until it says which start of its own it counts from

    @property
    def at_rest(self) -> bool:
        """True when the robot has said that it stands, and why it was stopped is known."""
        return self._send is None or (
            not self._halting and self._known_stops() >= 0 and self._unexplained is None
        )

    def detach(self) -> None:
        """Let a connection go that ended: what ran is in doubt from now on."""
        self._send = None
        for handle in self._flights.values():
            handle.leave()

    def dispatch(self, action: Action, lease: Lease) -> RemoteGoal:
        """Send a released action.

        Raises:
            ControllerError: no controller is connected.
        """
        if self._send is None:
            raise ControllerError("no controller is connected")
        self._admit(action, lease)
        handle = self._flights[lease.ticket] = RemoteGoal(self._mono_ms())
        self._send(
            Kind.DISPATCH,
            Dispatch(
                ticket=lease.ticket,
                # the effect alone: what differs between two proposals of it is not for an executor
                action=replace(action, provenance={}, meta=None),
                max_ms=longest_ms(action, lease, self._mono_ms()),
                renew_within_ms=self._renew_within_ms,
                life=self._life,
                stops=self._known_stops(),
            ),
            0,
        )
        return handle

    def stop(self) -> None:
        """Brake and hold; a controller that is gone stops by itself."""
        if self._send is not None:
            self._halts, self._halting = self._halts + 1, True
            self._send(Kind.HALT, Halt(), self._halts)

    def renew(self, ticket: Digest) -> None:
        """Say that the lease still holds; without a stop process none does."""
        if self._send is not None and self.can_stop():
            self._send(Kind.RENEW, Renew(ticket=ticket), 0)

    def forward(self, ticket: Digest, params: dict[str, int]) -> None:
        """Send a checked sample of a stream."""
        if self._send is not None:
            self._send(Kind.FORWARD, Forward(ticket=ticket, params=params), 0)

    def close(self, ticket: Digest) -> None:
        """Say that a stream is over."""
        if self._send is not None:
            self._send(Kind.CLOSE, Close(ticket=ticket), 0)

    def heard_of(self, life: int, stops: int) -> None:
        """Note that the gate knows of every stop up to this one and why it was.

        Args:
            life: the start of a controller that is counted from. Of another start, or of none that
                is known, a count says nothing: it could be larger than all that were since.
            stops: how many there were.
        """
        if life == self._life != 0:
            self._stops = max(self._stops, stops)

    @property
    def halts(self) -> int:
        """The number of the last `HALT`."""
        return self._halts

    def has_stood(self, halt: int) -> bool:
        """Return True when the controller has answered this `HALT`, or a later one."""
        return self._stood >= halt

    def hear(self, message: Begun | Ended | Stood, number: int = 0) -> None:
        """Take in what the controller says.

        A controller that comes back first reports how its last actions ended, and then that it
        stands. What it has not reported by then is `unknown`: it may be another start of it.

        Args:
            message: it.
            number: of the message that it answers; 0: none.
        """
        if isinstance(message, Stood):
            self._give_up_left()
            self._halting, self._stood = False, max(self._stood, number)
            if message.life != self._life:
                self._count_anew(message.life)
            if message.stops > self._stops:  # whose it was, the stop process says
                self._unexplained = Unexplained(message.stops, self._mono_ms())
                self._ask(partial(self._explained, self._unexplained))
            return
        handle = self._flights.get(message.ticket)
        if handle is None:
            return  # of an action that was settled already
        if isinstance(message, Begun):
            handle.begun = True
        else:
            handle.end(message)

    def _give_up_left(self) -> None:
        """End as `unknown` what was sent over an earlier connection and was not reported."""
        for ticket, handle in self._flights.items():
            if handle.is_left:
                why = Reason.CONTROLLER_FAILED
                handle.end(Ended(ticket=ticket, outcome=Outcome.UNKNOWN, why=why))

    def check(self) -> None:
        """Doubt every action whose begin was not confirmed in time."""
        late = self._mono_ms() - LIMITS.begin_within_ms
        for handle in self._flights.values():
            if not handle.begun and handle.dispatched_ms < late:
                handle.doubt()

    def _known_stops(self) -> int:
        """Return the last stop that the gate has heard of, and knows the reason of."""
        waiting = self._unexplained
        if waiting is None or self._mono_ms() - waiting.since_ms < LIMITS.explain_within_ms:
            return self._stops
        explained = partial(self._explained, waiting)
        if not self._ask(explained):  # it cannot have been stopped through a stop process
            explained()
        return self._stops

    def _explained(self, asked: Unexplained) -> None:
        """Count a stop as known: it has had its effect, whichever client asked for it.

        Only the one that the stop process was asked about: it may have stopped the robot again
        since, and another controller counts from its own start.
        """
        if self._unexplained is asked:
            self.heard_of(self._life, asked.stops)
            self._unexplained = None

    def _count_anew(self, life: int) -> None:
        """Forget the old count: another controller, or another start, counts from 0."""
        self._life, self._stops, self._unexplained = life, 0, None

    def forget(self, ticket: Digest) -> None:
        """Drop a settled action."""
        self._flights.pop(ticket, None)


class ShadowGoal:
    """An action that the robot carries out without the gate; assumed to succeed."""

    def outcome(self) -> Outcome:
        """Return what is assumed."""
        return Outcome.SUCCEEDED

    def used(self) -> Spend:
        """Return nothing: a shadow run measures nothing."""
        return Spend()


class ShadowController:
    """The controller of a gate in shadow mode, which releases nothing."""

    def dispatch(self, action: Action, lease: Lease) -> ShadowGoal:  # noqa: ARG002
        """Return the assumption."""
        return ShadowGoal()

    def stop(self) -> None:
        """Do nothing: this gate moves nothing."""
