# SPDX-License-Identifier: Apache-2.0
"""A thread with an event loop in which both ends of a guard live."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Coroutine
from concurrent.futures import Future
from typing import Any

from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.reasons import Reason
from authguard_r.integrations.tools.endpoints import Ends, first_of


class Background:
    """The thread.

    Args:
        ends: what lives in it.
    """

    def __init__(self, ends: Ends) -> None:
        self._ends = ends
        self._loop = asyncio.new_event_loop()
        self._over = asyncio.Event()
        self._started: Future[None] = Future()
        self._door = threading.Lock()
        self._is_closed = False
        self._begun: set[Future[Any]] = set()
        self._thread = threading.Thread(target=self._serve, name="authguard", daemon=True)

    def start(self) -> None:
        """Return once the gate has come.

        Raises:
            AuthGuardError: it did not.
        """
        self._thread.start()
        self._started.result()

    def begin(self, work: Coroutine[Any, Any, Any]) -> Future[Any]:
        """Begin work there, in the order in which this is called.

        Raises:
            EnvironmentFault: the thread has ended.
        """
        with self._door:
            if self._is_closed:
                work.close()
                raise EnvironmentFault("the guard is closed", reason=Reason.CONTROLLER_FAILED)
            begun = asyncio.run_coroutine_threadsafe(work, self._loop)
            self._begun.add(begun)
        begun.add_done_callback(self._begun.discard)
        return begun

    def close(self) -> None:
        """End the thread, and wait for that unless it is this one."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._over.set)
            self._thread.join()

    def _serve(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            try:
                runner.run(self._live())
            except BaseException as error:
                if self._started.done():
                    raise
                self._started.set_exception(first_of(error))
            finally:
                self._shut()
                runner.run(_let_begin())

    def _shut(self) -> None:
        """Begin nothing more, and let no caller wait for what was begun too late."""
        with self._door:
            self._is_closed = True
            left = tuple(self._begun)
        for begun in left:
            begun.cancel()

    async def _live(self) -> None:
        async with self._ends.running(where="this process"):
            self._started.set_result(None)
            await self._over.wait()


async def _let_begin() -> None:
    """Let what was canceled before it began take note of that."""
    await asyncio.sleep(0)
    left = asyncio.all_tasks() - {asyncio.current_task()}
    await asyncio.gather(*left, return_exceptions=True)
