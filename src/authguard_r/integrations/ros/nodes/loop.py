# SPDX-License-Identifier: Apache-2.0
"""One thread that spins a node, beside the event loop that has the gate's ends.

What a node has is made on the thread; the event loop publishes, asks services, and looks who is
there, which `rclpy` takes from any thread. A callback that raises ends the thread, and with it the
node. Spec page: docs/spec/ros.md#threads
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager, suppress
from typing import Any, TypeVar

from rclpy.action import ActionClient, ActionServer
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

from authguard_r.client.link import ProcessLog
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.reasons import Reason

T = TypeVar("T")

#: Longest wait for the thread's end, in seconds.
CLOSE_S = 2.0
#: What failed beside the robot is begun again after so long, in seconds.
AGAIN_S = 1.0
#: What planners asked for and is not answered yet; of more each is answered at once, with no.
MOST_WAITING = 64


class Spinner:
    """The thread.

    Args:
        node: what it spins; nothing else does.
        failed: called in the event loop when the thread ended by itself.
    """

    def __init__(self, node: Any, failed: Callable[[BaseException], None]) -> None:
        self.node = node
        self._failed = failed
        self.loop = asyncio.get_running_loop()
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self._thread = threading.Thread(target=self._serve, name="ros", daemon=True)
        self._tasks: set[asyncio.Task[Any]] = set()
        self._begun = self._ended = 0  # each is counted by one thread alone
        self._is_closed = False

    def start(self) -> None:
        """Begin to spin."""
        self._thread.start()

    # from the event loop

    async def do(self, work: Callable[..., T], *args: Any) -> T:
        """Return what a function returns that is called on the thread."""
        found: asyncio.Future[T] = self.loop.create_future()

        def run() -> None:
            try:
                value = work(*args)
            except Exception as error:  # noqa: BLE001 - it is the caller's, who waits
                self.soon(_fail, found, error)
            else:
                self.soon(_fill, found, value)

        self._executor.create_task(run)
        return await found

    async def ask(self, begin: Callable[[], Any]) -> Any:
        """Return what the future of `rclpy` brings that a function returns: a service's answer.

        Canceled, it waits no more; what was asked was asked.
        """
        found: asyncio.Future[Any] = self.loop.create_future()

        def answered(future: Any) -> None:
            self.soon(_fill, found, future.result())

        begin().add_done_callback(answered)
        return await found

    def begin(self, work: Coroutine[Any, Any, T]) -> asyncio.Task[T]:
        """Begin work in the event loop, and keep it until it is done."""
        task = self.loop.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

    async def close(self) -> None:
        """End what was begun here, and the thread."""
        self._is_closed = True
        for task in tuple(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        self._executor.shutdown(timeout_sec=0)
        await asyncio.to_thread(self._thread.join, CLOSE_S)

    # from the thread

    def soon(self, call: Callable[..., object], *args: Any) -> None:
        """Call a function in the event loop; dropped once that is closed."""
        with suppress(RuntimeError):
            self.loop.call_soon_threadsafe(call, *args)

    def later(
        self,
        work: Callable[[], Coroutine[Any, Any, T]],
        done: Callable[[T], object],
        *,
        otherwise: T,
        busy: Callable[[], T],
    ) -> None:
        """Begin work in the event loop; the thread does not wait for it.

        No callback on the thread is a coroutine that waits: it would be looked at again each time
        that anything comes.

        Args:
            work: what is begun.
            done: is called once with what it brings: in the event loop, or here when that is full.
            otherwise: what it brings when it fails or is given up.
            busy: returns what it brings when `MOST_WAITING` are not done yet.
        """
        if self._begun - self._ended >= MOST_WAITING:
            done(busy())
            return
        self._begun += 1

        def ended(task: asyncio.Task[T]) -> None:
            self._ended += 1
            failed = task.cancelled() or task.exception() is not None
            done(otherwise if failed else task.result())

        def begin() -> None:
            self.begin(work()).add_done_callback(ended)

        self.soon(begin)

    def run(self, work: Callable[..., object], *args: Any) -> None:
        """Call a function, or carry out a coroutine that waits for nothing, on the thread."""
        self._executor.create_task(work, *args)

    def _serve(self) -> None:
        why: BaseException = RuntimeError("it was shut down")
        try:
            self._executor.spin()
        except ExternalShutdownException as error:
            why = error
        except BaseException as error:  # noqa: BLE001 - whatever it is, the node is over
            why = error
        if not self._is_closed:
            self.soon(self._failed, why)


@asynccontextmanager
async def spun(
    node: Any, *, reason: Reason = Reason.CONTROLLER_FAILED
) -> AsyncIterator[tuple[Spinner, asyncio.Future[None]]]:
    """Yield a node's thread, and a future that fails when that ends by itself; end both.

    Args:
        node: it is destroyed in the end.
        reason: of that failure.
    """
    failed: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def fail(why: BaseException) -> None:
        if not failed.done():
            failed.set_exception(
                EnvironmentFault(
                    f"the node has stopped spinning: {type(why).__name__}: {why}",
                    reason=reason,
                )
            )

    spinner = Spinner(node, fail)
    spinner.start()
    try:
        yield spinner, failed
    finally:
        if failed.done():
            failed.exception()  # the waiting caller has it, or leaves for another reason
        failed.cancel()
        await spinner.close()
        for waitable in tuple(node.waitables):
            if isinstance(waitable, ActionServer | ActionClient):
                waitable.destroy()  # `destroy_node` leaves it in the graph
        node.destroy_node()


async def raised(failed: asyncio.Future[None]) -> None:
    """Raise a future's error, for a caller that waits for a task: the future is not cancelled."""
    await asyncio.shield(failed)


async def kept(work: Callable[[], Coroutine[Any, Any, None]], log: ProcessLog) -> None:
    """Do work until this is canceled, again when it failed: it is beside what holds the robot."""
    while True:
        try:
            await work()
        except Exception as error:  # noqa: BLE001 - whatever it is, it is said and not silent
            log.say("failed", "beside", message=repr(error))
        await asyncio.sleep(AGAIN_S)


def _fill(found: asyncio.Future[T], value: T) -> None:
    if not found.done():
        found.set_result(value)


def _fail(found: asyncio.Future[Any], error: BaseException) -> None:
    if not found.done():
        found.set_exception(error)
