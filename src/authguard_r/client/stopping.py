# SPDX-License-Identifier: Apache-2.0
"""One stop, sent to the stop process and to the gate at once, until it is confirmed.

Either of them can hang or be gone. The log has the stop once, for both receive its name. Spec page:
docs/spec/gate-protocol.md#a-stop-at-the-gate
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Awaitable, Callable, Mapping, Sequence
from enum import StrEnum
from functools import partial
from math import inf
from pathlib import Path
from time import monotonic

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from authguard_r.client.handshake import GateVerifier, Handshake
from authguard_r.client.line import SessionLine
from authguard_r.client.session import ClientSession, answer_of, unreachable
from authguard_r.client.start import begin, fresh, late, unanswered
from authguard_r.core.errors import (
    AuthenticityError,
    AuthGuardError,
    EnvironmentFault,
    MalformedError,
)
from authguard_r.core.identifiers import Identifier, RobotId
from authguard_r.core.reasons import Reason
from authguard_r.wire.messages import MAX_WHY, ClientRole, Kind, Stop, Stopped
from authguard_r.wire.sockets import reach

#: A part that cannot be reached is tried again after this long, in seconds.
AGAIN_S = 0.1
#: How often a waiting caller hears which process does not answer, in seconds.
TELL_S = 1.0
#: A part that did not confirm the stop is asked again after this long, in seconds.
REPEAT_S = 0.5
#: A part answers within a second; one that has not answered after this long hangs, in seconds.
SILENT_S = 1.5
#: A folder without sockets for so long has no gate, and a gate without a controller for so long has
#: no robot, in seconds.
GONE_S = 5.0
#: How long a controller may take to confirm that the robot stands, in seconds. The stop process
#: sends it again until it answers, also when the caller has left.
TOLD_S = 10.0
#: A socket without a listener belongs to a process that died: how long its restart may take.
DEAD_S = 30.0


class StopPath(StrEnum):
    """Who carries out a stop; the value is its socket in the run folder."""

    LANE = "stop.sock"
    GATE = "gate.sock"

    @property
    def words(self) -> str:
        """What a person calls it."""
        return "the stop process" if self is StopPath.LANE else "the gate"


class StopReply(Struct, kw_only=True):
    """What one part said.

    Args:
        answer: the state of the stop, as it said last; None: it has not answered.
        role: what the client was there.
        why: why it has not answered; empty: it is connected, and silent.
        is_gone: no process listens at its socket.
        is_dead: a process did before: the socket is there.
        is_shut: this user cannot reach it, or the path can be no socket's.
        is_over: it is not tried again.
        asked_s: when it was asked what it has not answered yet, on the monotonic clock.
    """

    answer: Stopped | None = None
    role: ClientRole | None = None
    why: str = ""
    is_gone: bool = False
    is_dead: bool = False
    is_shut: bool = False
    is_over: bool = False
    asked_s: float | None = None

    @property
    def has_stopped(self) -> bool:
        """True when it said that the robot stands."""
        return self.answer is not None and self.answer.stopped

    @property
    def has_told(self) -> bool:
        """True when it passed the stop to a controller."""
        return self.answer is not None and self.answer.controller

    @property
    def hangs(self) -> bool:
        """True when it serves, and has not answered what it was asked last."""
        if self.is_over or self.is_gone:
            return False
        is_late = self.asked_s is not None and monotonic() - self.asked_s >= SILENT_S
        return self.answer is None or is_late

    @property
    def state(self) -> tuple[bool, ...]:
        """Whether it has answered, has passed the stop to a controller, hangs, and is gone."""
        return self.answer is not None, self.has_told, self.hangs, self.is_gone


#: What each part said so far.
Answers = dict[StopPath, StopReply]
#: Sends a stop over a connection that is there, and returns the answer to it.
Ask = Callable[[Stop], Awaitable[Stopped]]


class StopEverywhere:
    """One stop on its way; `stop` is what each part receives.

    Args:
        run: the run folder.
        roles: what to be there; the first that this user may be.
        why: for the log; decides nothing. What is too long for a stop is left out.
        client: the name in the log; the role's when absent.
        verifier: with one, only the answer of a part that proves the gate's key counts.
        robot: whose gate it must be; None takes any.
        own: connections that are there already; one that fails is done without.
    """

    def __init__(
        self,
        run: Path,
        *,
        roles: Sequence[ClientRole] = (ClientRole.OPERATOR,),
        why: str = "",
        client: str | None = None,
        verifier: GateVerifier | None = None,
        robot: RobotId | None = None,
        own: Mapping[StopPath, Ask] | None = None,
    ) -> None:
        self._run = run
        self._roles = roles
        self._client = client
        self._verifier = verifier
        self._robot = robot
        self._own = dict(own or {})
        plain = why.encode("utf-8", "replace").decode("utf-8")
        self.stop = Stop(why=plain[:MAX_WHY], key=fresh())
        self.answers: Answers = {part: StopReply() for part in StopPath}
        self._refused: AuthGuardError | None = None
        self._began_s = monotonic()

    async def confirmed(
        self, tell: Callable[[Answers], object] = lambda _: None, *, within_ms: int | None = None
    ) -> StopReply:
        """Return the best answer: a part's that says that the robot stands, or else any.

        It asks on until the robot stands. It gives up when a controller received it and does not
        confirm it within `TOLD_S`, or when none is connected for `GONE_S`. A caller that gives up
        before cancels it; `answers` says how far it came.

        Args:
            tell: called once a second until the stop is confirmed.
            within_ms: gives up after so long; None: never.

        Raises:
            EnvironmentFault: no process serves in the folder, or no answer came in time.
            AuthenticityError: no role is this user's.
        """
        self._began_s = since_s = told_s = monotonic()
        end_s = inf if within_ms is None else since_s + within_ms / 1_000
        tries = [asyncio.ensure_future(self._try(part)) for part in StopPath]
        try:
            while not self._is_over(monotonic() - since_s) and monotonic() < end_s:
                before = self._state()
                waits = [item for item in tries if not item.done()]
                await asyncio.wait(waits, timeout=AGAIN_S, return_when=asyncio.FIRST_COMPLETED)
                since_s = since_s if self._state() == before else monotonic()
                if monotonic() - told_s >= TELL_S:
                    told_s = monotonic()
                    tell(self.answers)
        finally:
            for item in tries:
                item.cancel()
            await asyncio.gather(*tries, return_exceptions=True)
        return self._best(late(within_ms) if monotonic() >= end_s else None)

    def _state(self) -> tuple[object, ...]:
        return tuple(one.state for one in self.answers.values())

    def _is_over(self, unchanged_s: float) -> bool:
        """Return True when the robot stands, or when no confirmation came in time."""
        parts = self.answers.values()
        if any(one.has_stopped for one in parts) or all(one.is_over for one in parts):
            return True
        if any(one.has_told and not one.is_gone for one in parts):
            return unchanged_s >= TOLD_S
        if any(one.hangs for one in parts):
            return False  # what it was sent, it may carry out yet
        if any(one.is_over for one in parts) and all(one.answer is None for one in parts):
            return True  # one refuses this user, and the other does not serve
        limit_s = DEAD_S if any(one.is_dead for one in parts) else GONE_S
        return unchanged_s >= limit_s

    def _best(self, why: AuthGuardError | None) -> StopReply:
        answered = [one for one in self.answers.values() if one.answer is not None]
        if answered:
            return max(answered, key=lambda one: (one.has_stopped, one.has_told))
        raise self._refused or why or unreachable(self.answers[StopPath.GATE].why, str(self._run))

    async def _try(self, part: StopPath) -> None:
        """Send it to one part, again and again, until that confirms it or refuses the client."""
        reached, roles = self.answers[part], list(self._roles)
        own, is_again = self._own.get(part), False
        while roles and not reached.has_stopped:
            reached.asked_s = monotonic()
            try:
                ask = partial(self._once, self._run / part, roles[0], reached)
                answer = await (ask() if own is None else own(self.stop))
                reached.answer = self._whole(answer) if is_again else answer
                reached.role, reached.why, reached.asked_s = roles[0], "", None
                is_again = True
                await asyncio.sleep(0 if reached.has_stopped else REPEAT_S)
            except AuthGuardError as error:
                reached.asked_s, is_again = None, True
                reached.why = error.message
                is_passing = own is not None or isinstance(error, EnvironmentFault)
                if reached.is_shut or not is_passing:
                    self._refused = error
                    roles = roles[1:] if error.reason is Reason.ROLE_DENIED else []
                own = None
                await asyncio.sleep(AGAIN_S if is_passing else 0)
        if not roles and self._is_denied:
            self._refused = self._nobody(part)
        reached.is_over = True

    def _whole(self, answer: Stopped) -> Stopped:
        """Return the answer to a later try, with the time since the first one began."""
        return replace(answer, after_ms=round((monotonic() - self._began_s) * 1_000))

    @property
    def _is_denied(self) -> bool:
        return self._refused is not None and self._refused.reason is Reason.ROLE_DENIED

    def _nobody(self, part: StopPath) -> AuthenticityError:
        return AuthenticityError(
            f"this user may not connect as {', '.join(f'`{role}`' for role in self._roles)} here",
            reason=Reason.ROLE_DENIED,
            where=str(self._run / part),
        )

    async def _once(self, path: Path, role: ClientRole, reached: StopReply) -> Stopped:
        """Connect, say hello and stop in one breath, and wait for the answer however long it takes.

        Raises:
            AuthGuardError: the connection failed, or the part is not the one that was meant.
        """
        name = self._client if self._client is not None else str(role)
        handshake = Handshake(
            role=role,
            client=Identifier(name),
            verifier=self._verifier,
            robot=self._robot,
            allow_shadow=True,  # a stop counts for every driver of the robot
        )
        session = begin(handshake)
        try:
            wire = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        except OSError as error:  # no file is left: one may be soon
            raise unanswered(error, path) from error
        with wire:
            line = SessionLine(session, wire)
            try:
                await reach(wire, path)
                await asyncio.get_running_loop().create_unix_connection(lambda: line, sock=wire)
            except (OSError, ValueError) as error:
                reached.is_dead = isinstance(error, ConnectionRefusedError)
                reached.is_gone = reached.is_dead or isinstance(error, FileNotFoundError)
                reached.is_shut = not reached.is_gone and not isinstance(error, BlockingIOError)
                raise unanswered(error, path) from error
            reached.is_gone, reached.is_dead, reached.why = False, False, ""
            try:
                sent = session.request(Kind.STOP, self.stop)
                await line.write(session.hello() + sent.data)
                while (item := session.take(sent.number)) is None:
                    await line.changed()
                return stopped_of(answer_of(item))
            finally:
                line.hang_up()


def stop_of(path: Path, session: ClientSession, ask: Ask, why: str) -> StopEverywhere:
    """Return a stop over a connection that is there and by the other part of its gate.

    Args:
        path: the socket that it leads to.
        session: of the connection; it has been welcomed.
        ask: sends the stop over it.
        why: for the log; decides nothing.
    """
    handshake, welcome = session.handshake, session.welcome
    return StopEverywhere(
        path.parent,
        roles=(handshake.role,),
        why=why,
        client=handshake.client,
        verifier=handshake.verifier,
        robot=None if welcome is None else welcome.robot,
        own={StopPath.LANE if path.name == StopPath.LANE else StopPath.GATE: ask},
    )


def stopped_of(answer: object) -> Stopped:
    """Return the state of a stop, as a part answered.

    Raises:
        MalformedError: it is no such answer.
    """
    try:
        return msgspec.convert(answer, Stopped)
    except msgspec.ValidationError as error:
        raise MalformedError(str(error), where="stopped") from error


async def stop_robot(
    run: Path,
    *,
    roles: Sequence[ClientRole] = (ClientRole.OPERATOR,),
    why: str = "",
    client: str | None = None,
    verifier: GateVerifier | None = None,
    robot: RobotId | None = None,
    within_ms: int | None = None,
) -> Stopped:
    """Brake and hold, by the stop process and the gate at once.

    Arguments and errors as those of `StopEverywhere` and `StopEverywhere.confirmed`.

    Returns:
        Whether a controller was there and said that the robot stands, and after how long.
    """
    stop = StopEverywhere(run, roles=roles, why=why, client=client, verifier=verifier, robot=robot)
    answer = (await stop.confirmed(within_ms=within_ms)).answer
    if answer is None:  # pragma: no cover - without an answer it raised
        raise RuntimeError("a stop ended without an answer")
    return answer
