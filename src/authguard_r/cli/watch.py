# SPDX-License-Identifier: Apache-2.0
"""`authguard watch`: what happens at a gate, as it happens."""

from __future__ import annotations

import asyncio
import json
import sys
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import typer

from authguard_r.authoring.compile.request import headlines
from authguard_r.cli.gateway import (
    CLIENT,
    GATE_SOCKET,
    GateOption,
    ProofOption,
    ReadingRole,
    RoleOption,
    socket_in,
)
from authguard_r.cli.inputs import JsonFlag
from authguard_r.cli.status_lines import has_requests, status_lines
from authguard_r.client import AsyncGateClient
from authguard_r.core.quantities import to_timestamp
from authguard_r.keys.trust import read_trust
from authguard_r.wire.messages import ClientRole
from authguard_r.wire.output import emit, printed

#: The last event of a gate that ends by itself; one that is killed says nothing.
ENDED = "end"
#: Events that tell no person anything, unless they look for them.
_NOISE = frozenset({"client"})
#: How many events the live view keeps, and how often it asks for the status, in seconds.
_SHOWN, _EVERY_S = 15, 1.0


def watch_command(
    gate: GateOption = None,
    role: RoleOption = ReadingRole.OPERATOR,
    trust: ProofOption = None,
    verbose: Annotated[
        bool, typer.Option("--verbose", help="Show clients that connect and leave, too.")
    ] = False,
    jsonl: Annotated[bool, typer.Option("--jsonl", help="One JSON object for each event.")] = False,
    count: Annotated[
        int | None, typer.Option("--count", help="End after this number of events.", min=1)
    ] = None,
    as_json: JsonFlag = False,
) -> int:
    """Show decisions, requests and alerts at a gate until you interrupt it.

    At a terminal this is a live view, else one line for each event. With --json all events are
    printed at the end, as one object. JSON output has every event.
    """
    seen: list[dict[str, Any]] = []
    hidden = frozenset[str]() if verbose or jsonl or as_json else _NOISE
    is_live = sys.stdout.isatty() and not (jsonl or as_json)
    take = seen.append if as_json else _print_json if jsonl else _print_line
    path = socket_in(gate, GATE_SOCKET)
    with suppress(KeyboardInterrupt):
        asyncio.run(_watch(path, role, trust, count, None if is_live else take, hidden))
    if as_json:
        emit({"events": seen}, (), as_json=True)
    return 0


async def _watch(
    path: Path,
    role: ReadingRole,
    trust: Path | None,
    count: int | None,
    take: Callable[[dict[str, Any]], None] | None,
    hidden: frozenset[str],
) -> None:
    verifier = None if trust is None else read_trust(trust)
    async with await AsyncGateClient.connect(
        path, role=ClientRole(role), client=CLIENT, verifier=verifier, allow_shadow=True
    ) as client:
        if take is None:
            await _live(client, count, hidden)
        else:
            await _follow(client, count, take, hidden)


async def _follow(
    client: AsyncGateClient,
    count: int | None,
    take: Callable[[dict[str, Any]], None],
    hidden: frozenset[str],
) -> None:
    left = count
    async for event in await client.watch():
        if event.get("event") in hidden:
            continue
        take(event)
        left = None if left is None else left - 1
        if left == 0 or event.get("event") == ENDED:
            return


async def _live(client: AsyncGateClient, count: int | None, hidden: frozenset[str]) -> None:
    """Draw status and last events over each other, as fast as they come."""
    from rich.live import Live
    from rich.text import Text

    events: deque[str] = deque(maxlen=_SHOWN)
    status, requests = await client.status(), list[str]()
    with Live(Text(""), auto_refresh=False) as view:

        def draw() -> None:
            view.update(Text(printed("\n".join(picture(status, events, requests)))), refresh=True)

        def take(event: dict[str, Any]) -> None:
            events.append(event_line(event))
            draw()

        requests = await _requests(client, status)
        draw()
        following = asyncio.ensure_future(_follow(client, count, take, hidden))
        try:
            while not following.done():
                await asyncio.wait({following}, timeout=_EVERY_S)
                if not following.done():
                    status = await client.status()
                    requests = await _requests(client, status)
                    draw()
            await following
        finally:
            following.cancel()


async def _requests(client: AsyncGateClient, status: dict[str, Any]) -> list[str]:
    """Return the open approval requests, a line each."""
    return headlines(await client.approvals()) if has_requests(status) else []


def picture(
    status: dict[str, Any], events: Iterable[str], requests: Iterable[str] = ()
) -> list[str]:
    """Return the live view: how things stand, then what happened last."""
    return [*status_lines(status, requests), "", *events]


def event_line(event: dict[str, Any]) -> str:
    """Return an event for people, on one line."""
    at = event.get("time_ms")
    when = to_timestamp(at) if isinstance(at, int) and 0 <= at < _LAST_MS else "-"
    name = str(event.get("event"))
    told = _WORDS.get(name, _rest)(event)
    told = f"{told}: the gate has ended" if name == ENDED else told
    return f"{when} {name:10} {told}".rstrip()


#: The last instant that a timestamp can say: the end of the year 9999.
_LAST_MS = 253_402_300_800_000


def _report(event: dict[str, Any]) -> str:
    """Return the report of a step: who proposed what, the verdict, why, and how it ended."""
    action = event.get("action")
    named = action if isinstance(action, dict) else {}
    parts = [event.get("client"), event.get("outcome")]
    parts += [named.get(field) for field in ("type", "object", "destination")]
    execution = event.get("execution")
    ended = execution.get("outcome") if isinstance(execution, dict) else None
    parts += [f"-> {ended}"] if ended else []
    reasons = event.get("reasons")
    parts += [", ".join(map(str, reasons))] if isinstance(reasons, list) else []
    return " ".join(str(part) for part in parts if part)


def _request(event: dict[str, Any]) -> str:
    """Return what happened to an approval request, and who did it."""
    said = f"request {event.get('counter')} of mission {event.get('mid')}: {event.get('what')}"
    parts = [said]
    parts += [f"by {event['by']}"] if event.get("by") else []
    parts += [f"needs {event['required']} people"] if event.get("required") else []
    parts += [f"does not count: {event['why_not']}"] if event.get("why_not") else []
    return ", ".join(parts)


def _management(event: dict[str, Any]) -> str:
    """Return an order, who handed it in, and how its mission stands after it."""
    said = f"{event.get('act')} by {event.get('by')}"
    if "status" not in event:
        return said
    return f"{said}: mission {event.get('mid')} version {event.get('version')} is {event['status']}"


def _rest(event: dict[str, Any]) -> str:
    return " ".join(
        f"{name}={value}" for name, value in event.items() if name not in {"event", "time_ms"}
    )


#: Events that have words of their own.
_WORDS: dict[str, Callable[[dict[str, Any]], str]] = {
    "approval": _request,
    "decision": _report,
    "management": _management,
    "outcome": _report,
}


def _print_json(event: dict[str, Any]) -> None:
    _print(json.dumps(event))


def _print_line(event: dict[str, Any]) -> None:
    _print(printed(event_line(event)))


def _print(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()
