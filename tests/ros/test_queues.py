# SPDX-License-Identifier: Apache-2.0
"""What planners send waits in queues of fixed length, whoever floods them (L19).

Source: docs/spec/ros.md#threads
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 (tests/ros/make.sh makes an environment)")

import rclpy
from rclpy.context import Context
from rclpy.node import Node

from authguard_r.integrations.ros.nodes.inbox import ThreadInbox
from authguard_r.integrations.ros.nodes.loop import MOST_WAITING, Spinner
from ros.graph import next_domain


@asynccontextmanager
async def spinning() -> AsyncIterator[Spinner]:
    """Yield a node's thread."""
    context = Context()
    rclpy.init(args=[], context=context, domain_id=next_domain())
    node = Node("gate", context=context, start_parameter_services=False, enable_rosout=False)
    failed: list[BaseException] = []
    spinner = Spinner(node, failed.append)
    spinner.start()
    try:
        yield spinner
    finally:
        await spinner.close()
        node.destroy_node()
        context.try_shutdown()
    assert failed == []


def test_of_more_than_may_wait_each_is_told_so_at_once_and_the_rest_are_served() -> None:
    async def flood() -> None:
        async with spinning() as spinner:
            goes_on = asyncio.Event()
            told: list[str] = []

            async def work() -> str:
                await goes_on.wait()
                return "done"

            def ask(count: int) -> None:
                for _ in range(count):
                    spinner.later(work, told.append, otherwise="lost", busy=lambda: "busy")

            async def all_told(count: int) -> None:
                async with asyncio.timeout(20):
                    while len(told) < count:
                        await asyncio.sleep(0.01)

            await spinner.do(ask, MOST_WAITING + 3)
            assert told == ["busy"] * 3
            goes_on.set()
            await all_told(MOST_WAITING + 3)
            assert told == ["busy"] * 3 + ["done"] * MOST_WAITING
            await spinner.do(ask, 1)  # there is room again
            await all_told(MOST_WAITING + 4)
            assert told[-1] == "done"

    asyncio.run(flood())


@pytest.mark.parametrize(
    ("is_newest", "kept", "shed"), [(True, [7, 8, 9], 0), (False, [0, 1, 2], 7)]
)
def test_a_queue_keeps_so_many_and_no_more(is_newest: bool, kept: list[int], shed: int) -> None:
    async def flood() -> None:
        async with spinning() as spinner:
            inbox: ThreadInbox[int] = ThreadInbox(spinner, 3, is_newest=is_newest)
            await spinner.do(lambda: [inbox.put(number) for number in range(10)])
            assert [await inbox.take() for _ in range(3)] == kept
            assert inbox.shed() == shed
            await spinner.do(inbox.put, 10)
            inbox.clear()
            with pytest.raises(TimeoutError):
                async with asyncio.timeout(0.2):
                    await inbox.take()

    asyncio.run(flood())
