# SPDX-License-Identifier: Apache-2.0
"""What the gate's loop does again and again, and what happens when one of these fails.

Spec page: docs/spec/gate-protocol.md#watching
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable


async def every(period_s: float, act: Callable[[], object]) -> None:
    """Do something again and again; the next time is counted from the last begin."""
    loop = asyncio.get_running_loop()
    due = loop.time()
    while True:
        due = max(due + period_s, loop.time())
        await asyncio.sleep(due - loop.time())
        act()


async def first(ended: asyncio.Event, clocks: list[asyncio.Task[None]]) -> None:
    """Wait for the end, or for the first clock that fails: then the gate must not go on."""
    waiting = asyncio.create_task(ended.wait())
    done, _ = await asyncio.wait({waiting, *clocks}, return_when=asyncio.FIRST_COMPLETED)
    waiting.cancel()
    for task in done - {waiting}:
        task.result()
