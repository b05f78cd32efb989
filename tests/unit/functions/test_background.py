# SPDX-License-Identifier: Apache-2.0
"""The thread in which a guard's ends live: whoever asks while it ends, is told."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator
from concurrent.futures import CancelledError
from contextlib import asynccontextmanager

import pytest

from authguard_r.core.errors import EnvironmentFault
from authguard_r.integrations.functions.background import Background


class Nothing:
    """Ends that are there at once."""

    @asynccontextmanager
    async def running(self, *, where: str) -> AsyncIterator[None]:
        yield


@pytest.mark.parametrize("round_", range(5))
def test_nobody_waits_for_a_thread_that_ends(round_: int) -> None:
    background = Background(Nothing())  # type: ignore[arg-type]
    background.start()
    told: list[str] = []

    async def work() -> str:
        await asyncio.sleep(0)
        return "done"

    def ask() -> None:
        while True:
            try:
                assert background.begin(work()).result(30) == "done"
            except (CancelledError, EnvironmentFault) as error:
                told.append(type(error).__name__)
                return

    askers = [threading.Thread(target=ask) for _ in range(4)]
    for asker in askers:
        asker.start()
    background.close()
    for asker in askers:
        asker.join(30)
    assert len(told) == 4
    with pytest.raises(EnvironmentFault, match="closed"):
        background.begin(work())
    background.close()  # a second time is none
