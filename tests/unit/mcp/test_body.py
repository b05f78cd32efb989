# SPDX-License-Identifier: Apache-2.0
"""A robot behind a tools' server, as its controller holds it: what is said first, counts."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Awaitable, Callable
from contextlib import suppress

import pytest
from msgspec.structs import replace

from authguard_r.client.link import ProcessLog
from authguard_r.core.errors import ControllerError
from authguard_r.core.standing import Outcome
from authguard_r.integrations.mcp import upstream as upstreams
from authguard_r.integrations.mcp.upstream import Upstream
from authguard_r.integrations.tools.body import ToolBody, ToolDrivers, ToolGoal
from authguard_r.normalize import Binder
from authguard_r.normalize.rebuild import Rebuilder
from fixtures import scenarios

ODD = scenarios.ROOT / "tests" / "programs" / "misbehaving_mcp_server.py"


def connected(kind: str, work: Callable[[Upstream, list[bool]], Awaitable[None]]) -> None:
    """Run `work` with an odd server that is there; the list has each of its comings and goings."""

    async def talk() -> None:
        seen: list[bool] = []
        server = Upstream(
            (sys.executable, str(ODD), kind),
            pins=None,
            environment={},
            log=ProcessLog(),
            changed=lambda: seen.append(server.ready),
        )
        staying = asyncio.ensure_future(server.stay())
        try:
            async with asyncio.timeout(30):
                await until(lambda: server.ready)
                await work(server, seen)
        finally:
            staying.cancel()
            with suppress(asyncio.CancelledError):
                await staying

    asyncio.run(talk())


async def until(holds: Callable[[], bool]) -> None:
    while not holds():  # the caller's timeout ends it
        await asyncio.sleep(0.01)


def test_how_a_call_ended_is_said_once() -> None:
    handle = ToolGoal(scenarios.site().vocabulary["navigate"])
    handle.end(Outcome.UNKNOWN)
    handle.end(Outcome.SUCCEEDED)
    assert handle.outcome() is Outcome.UNKNOWN


def test_what_no_tool_carries_is_not_begun() -> None:
    async def work(server: Upstream, _seen: list[bool]) -> None:
        site, binding = scenarios.site(), scenarios.binding()
        means = ToolDrivers(
            site=site, binder=Binder(site, binding), rebuilder=Rebuilder(site, binding)
        )
        body = ToolBody(scenarios.RID, server, means, lambda: None, ProcessLog())
        wrong = replace(scenarios.navigate("dock", "pharmacy"), tool="no_such_tool")
        with pytest.raises(ControllerError):
            body.begin(wrong, scenarios.TICKET)
        body.brake()  # nothing was ever begun
        assert body.stands

    connected("no-ping", work)


def test_a_brake_after_the_end_stops_nothing_a_second_time() -> None:
    async def work(server: Upstream, _seen: list[bool]) -> None:
        site, binding = scenarios.site(), scenarios.binding()
        means = ToolDrivers(
            site=site, binder=Binder(site, binding), rebuilder=Rebuilder(site, binding)
        )
        body = ToolBody(scenarios.RID, server, means, lambda: None, ProcessLog())
        handle = body.begin(scenarios.navigate("dock", "pharmacy"), scenarios.TICKET)
        await until(lambda: handle.outcome() is not None)
        ended = handle.outcome()
        body.brake()
        assert (handle.outcome(), body.stands) == (ended, True)

    connected("noise", work)


def test_a_server_that_answers_no_ping_is_let_go(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(upstreams, "PING_S", 0.2)
    monkeypatch.setattr(upstreams, "LOOK_S", 0.1)

    async def work(_server: Upstream, seen: list[bool]) -> None:
        await until(lambda: seen[:2] == [True, False])

    connected("silent", work)
