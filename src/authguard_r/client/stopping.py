# SPDX-License-Identifier: Apache-2.0
"""One stop, sent to the stop process and to the gate at once, until somebody confirms it.

Either of them can hang or be gone. The log has the stop once, for both are told its name.
Spec page: docs/spec/gate-protocol.md#a-stop-at-the-gate
"""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable, Sequence
from enum import StrEnum
from pathlib import Path

import msgspec
from msgspec import Struct

from authguard_r.client.greeting import GateVerifier, Greeting
from authguard_r.client.line import Line
from authguard_r.client.session import answer_of, unreachable
from authguard_r.client.start import begin, fresh, reach, unanswered
from authguard_r.core.errors import (
    AuthenticityError,
    AuthGuardError,
    EnvironmentFault,
    MalformedError,
)
from authguard_r.core.identifiers import Identifier, RobotId
from authguard_r.core.reasons import Reason
from authguard_r.wire.messages import ClientRole, Kind, Stop, Stopped

#: A part that cannot be reached is tried again after this long, in seconds.
AGAIN_S = 0.1
#: Whoever waits is told this often what does not answer, in seconds.
TELL_S = 1.0
#: A part that hangs is waited for so long after the other one has answered, in seconds.
PATIENCE_S = 2.0
#: A folder without sockets for so long has no gate, in seconds.
GONE_S = 5.0
#: Sockets at which nobody listens are of processes that died: that long their start may take.
DEAD_S = 30.0


class Part(StrEnum):
    """Who carries out a stop; the value is its socket in the run folder."""

    LANE = "stop.sock"
    GATE = "gate.sock"

    @property
    def words(self) -> str:
        """What a person calls it."""
        return "the stop process" if self is Part.LANE else "the gate"


class Reached(Struct, kw_only=True):
    """What one part said.

    Args:
        answer: what became of the stop; None: it has not answered.
        role: what the client was there.
        why: why it has not answered; empty: it is connected, and silent.
        is_gone: nobody serves at its socket.
        is_dead: somebody did: the socket is there.
        is_shut: this user cannot reach it, or the path can be no socket's.
        is_over: it is not tried again.
    """

    answer: Stopped | None = None
    role: ClientRole | None = None
    why: str = ""
    is_gone: bool = False
    is_dead: bool = False
    is_shut: bool = False
    is_over: bool = False


#: What each part said so far.
Answers = dict[Part, Reached]


class StopEverywhere:
    """One stop on its way.

    Args:
        run: the run folder.
        roles: what to be there; the first that this user may be.
        why: for the log; decides nothing.
        client: the name in the log; the role's when absent.
        verifier: with one, only the answer of a part that proves the gate's key counts.
        robot: whose gate it must be; None takes any.
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
    ) -> None:
        self._run = run
        self._roles = roles
        self._client = client
        self._verifier = verifier
        self._robot = robot
        self._why = why
        self._begin()

    async def confirmed(self, tell: Callable[[Answers], object] = lambda _: None) -> Reached:
        """Return the best answer: a part's that says that the robot stands, or else any.

        It tries on until the robot stands, or every part that serves has answered. A caller that
        gives up cancels it; `answers` says how far it came.

        Args:
            tell: called once a second while there is no answer.

        Raises:
            EnvironmentFault: nobody serves in the folder.
            AuthenticityError: no role is this user's.
        """
        self._begin()
        loop = asyncio.get_running_loop()
        tries = [asyncio.ensure_future(self._try(part)) for part in Part]
        since_s = told_s = loop.time()  # nobody served, or one has answered
        try:
            while not self._is_over(loop.time() - since_s):
                before = self._state()
                waits = [item for item in tries if not item.done()]
                await asyncio.wait(waits, timeout=AGAIN_S, return_when=asyncio.FIRST_COMPLETED)
                since_s = since_s if self._state() == before else loop.time()
                if loop.time() - told_s >= TELL_S:
                    told_s = loop.time()
                    tell(self.answers)
        finally:
            for item in tries:
                item.cancel()
            await asyncio.gather(*tries, return_exceptions=True)
        return self._best()

    def _begin(self) -> None:
        """Be another stop than the last one."""
        self._stop = Stop(why=self._why, key=fresh())
        self._refused: AuthGuardError | None = None
        self.answers: Answers = {part: Reached() for part in Part}

    def _state(self) -> tuple[object, ...]:
        return tuple((one.answer, one.is_gone) for one in self.answers.values())

    def _is_over(self, unchanged_s: float) -> bool:
        """Return True when nothing better will come, or nothing has come for long enough."""
        parts = self.answers.values()
        answers = [one.answer for one in parts if one.answer is not None]
        if any(answer.stopped for answer in answers) or all(one.is_over for one in parts):
            return True
        if not all(one.is_over or one.is_gone for one in parts):
            return bool(answers) and unchanged_s >= PATIENCE_S  # the other one hangs
        limit_s = DEAD_S if any(one.is_dead for one in parts) else GONE_S
        return any(one.is_over for one in parts) or unchanged_s >= limit_s

    def _best(self) -> Reached:
        answered = [one for one in self.answers.values() if one.answer is not None]
        if answered:
            return max(answered, key=lambda one: one.answer is not None and one.answer.stopped)
        if self._refused is not None:
            raise self._refused
        raise unreachable(self.answers[Part.GATE].why, str(self._run))

    async def _try(self, part: Part) -> None:
        """Send it to one part, again and again, until that has answered or refuses the client."""
        reached, roles = self.answers[part], list(self._roles)
        while reached.answer is None and roles:
            try:
                reached.answer = await self._once(self._run / part, roles[0], reached)
                reached.role = roles[0]
            except EnvironmentFault as error:
                reached.why = error.message
                if reached.is_shut:
                    self._refused, roles = error, []
                await asyncio.sleep(AGAIN_S)
            except AuthGuardError as error:
                reached.why, self._refused = error.message, error
                roles = roles[1:] if error.reason is Reason.ROLE_DENIED else []
        if not roles and self._is_denied:
            self._refused = self._nobody(part)
        reached.is_over = True

    @property
    def _is_denied(self) -> bool:
        return self._refused is not None and self._refused.reason is Reason.ROLE_DENIED

    def _nobody(self, part: Part) -> AuthenticityError:
        return AuthenticityError(
            f"this user may be none of {', '.join(f'`{role}`' for role in self._roles)} here",
            reason=Reason.ROLE_DENIED,
            where=str(self._run / part),
        )

    async def _once(self, path: Path, role: ClientRole, reached: Reached) -> Stopped:
        """Connect, say hello and stop in one breath, and wait for the answer however long it takes.

        Raises:
            AuthGuardError: the connection failed, or the part is not the one that was meant.
        """
        name = self._client if self._client is not None else str(role)
        greeting = Greeting(
            role=role,
            client=Identifier(name),
            verifier=self._verifier,
            robot=self._robot,
            allow_shadow=True,  # a stop counts, whoever drives the robot
        )
        session = begin(greeting)
        try:
            wire = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        except OSError as error:  # no file is left: one may be soon
            raise unanswered(error, path) from error
        with wire:
            line = Line(session, wire)
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
                sent = session.request(Kind.STOP, self._stop)
                await line.write(session.hello() + sent.data)
                while (item := session.take(sent.number)) is None:
                    await line.changed()
                return msgspec.convert(answer_of(item), Stopped)
            except msgspec.ValidationError as error:
                raise MalformedError(str(error), where="stopped") from error
            finally:
                line.hang_up()


async def stop_robot(
    run: Path,
    *,
    roles: Sequence[ClientRole] = (ClientRole.OPERATOR,),
    why: str = "",
    client: str | None = None,
    verifier: GateVerifier | None = None,
    robot: RobotId | None = None,
) -> Stopped:
    """Brake and hold, by the stop process and the gate at once; arguments as `StopEverywhere`'s.

    Returns:
        Whether a controller was there and said that the robot stands, and after how long.

    Raises:
        EnvironmentFault: nobody serves in the folder.
        AuthenticityError: no role is this user's.
    """
    stop = StopEverywhere(run, roles=roles, why=why, client=client, verifier=verifier, robot=robot)
    answer = (await stop.confirmed()).answer
    if answer is None:  # pragma: no cover - without an answer it raised
        raise RuntimeError("a stop ended without an answer")
    return answer
