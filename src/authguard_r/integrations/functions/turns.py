# SPDX-License-Identifier: Apache-2.0
"""A call whose release comes before its work is begun: first asked for, then done by another hand.

For frameworks that ask an approver and run the tool themselves. The work is done inside the
release: the gate hears that it has ended when it has. Nothing begins without a release, and a
release whose work does not begin is given up. Spec page: docs/spec/adapters.md#turns
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

from authguard_r.core.errors import MalformedError
from authguard_r.integrations.functions.guard import GateGuard
from authguard_r.integrations.functions.outcomes import NotDone
from authguard_r.integrations.functions.texts import BESIDE, left_out, words_in

#: Does a tool's work with what was released.
Work = Callable[[dict[str, Any]], Awaitable[Any]]
#: A framework begins what it approved within this, in seconds.
BEGIN_S = 10.0


class CallTurn:
    """One call, from its proposal to its end; made in the loop that does its work.

    Args:
        guard: where it is proposed.
        tool: a tool that `register` has registered.
        arguments: as they were written; untrusted.
        waits: the work is begun by `done`; else as soon as it is released.
    """

    def __init__(
        self, guard: GateGuard, tool: str, arguments: dict[str, Any], *, waits: bool
    ) -> None:
        loop = asyncio.get_running_loop()
        self.raised: Exception | None = None
        self._nulls = left_out(arguments, guard.decided(tool))
        asked = {name: value for name, value in arguments.items() if name not in self._nulls}
        self._released: asyncio.Future[dict[str, Any]] = loop.create_future()
        self._begun, self._given_up = asyncio.Event(), False
        if not waits:
            self._begun.set()
        self._asked = loop.create_task(guard.acall(tool, asked, beside={BESIDE: self}))
        # no warning is needed for the end of a call without a waiting caller
        self._asked.add_done_callback(lambda asked: asked.cancelled() or asked.exception())

    async def released(self) -> dict[str, Any]:
        """Return the arguments that the gate released; the work has not begun.

        Raises:
            NotDone: nothing was released.
            AuthGuardError: nothing was decided.
        """
        await asyncio.wait((self._asked, self._released), return_when=asyncio.FIRST_COMPLETED)
        if not self._released.done():
            await self._asked  # raises: it has ended without a release
        return self._released.result()

    async def done(self) -> Any:
        """Let the work begin, and return what came of it.

        Raises:
            NotDone: it was refused, or did not succeed.
            AuthGuardError: nothing was decided.
            Exception: what the tool raised.
        """
        self._begun.set()
        try:
            return await self._asked
        except NotDone as error:
            if self.raised is None or error.__cause__ is not self.raised:
                raise
        raise self.raised

    def give_up(self) -> None:
        """Let the work never begin: another call came than the one that was released."""
        self._given_up = True
        self._begun.set()

    async def work(self, do: Work, arguments: dict[str, Any], name: str) -> Any:
        """Do the work of a release, once it may begin.

        Raises:
            MalformedError: it was given up, or not begun in time; nothing was done.
            Exception: what the tool raises.
        """
        arguments = {**self._nulls, **arguments}
        self._released.set_result(arguments)
        try:
            async with asyncio.timeout(BEGIN_S):
                await self._begun.wait()
        except TimeoutError as error:
            raise MalformedError("expected the approved call, none came", where=name) from error
        if self._given_up:
            raise MalformedError("expected the approved call, got another", where=name)
        try:
            return await do(arguments)
        except Exception as error:
            self.raised = error
            raise


def register(guard: GateGuard, name: str, do: Work) -> None:
    """Let work be what a tool does, for calls that are turns.

    Raises:
        MalformedError: the binding has no such tool, or it has a function already.
    """

    async def released(*, authguard_beside: CallTurn | None = None, **arguments: Any) -> Any:
        if authguard_beside is None:
            raise MalformedError("expected a call of the agent's", where=name)
        return await authguard_beside.work(do, arguments, name)

    guard.register(name, None, coroutine=released, words=words_in)
