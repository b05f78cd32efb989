# SPDX-License-Identifier: Apache-2.0
"""A robot's MCP server behind its gate: real processes, a real client of the protocol.

What reached the server is read from the server's own file: a call that is not there was not made.
Source: lessons L1, L4, L5, L16; docs/spec/mcp.md
"""

from __future__ import annotations

import asyncio
import io
import json
import subprocess
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import (
    asynccontextmanager,
    contextmanager,
    redirect_stderr,
    redirect_stdout,
    suppress,
)
from functools import partial
from pathlib import Path
from typing import Any

import httpx2
import mcp_types as types
import pytest
import yaml
from mcp import Client, StdioServerParameters, stdio_client
from mcp.client.streamable_http import streamable_http_client
from mcp_types.methods import SERVER_NOTIFICATIONS, SERVER_REQUESTS, SPEC_CLIENT_METHODS

from authguard_r.cli import call
from authguard_r.client import GateClient
from authguard_r.client.link import ProcessLog
from authguard_r.core.errors import ControllerError, EnvironmentFault
from authguard_r.integrations.mcp import front as fronts
from authguard_r.integrations.mcp import upstream as upstreams
from authguard_r.integrations.mcp.front import Front, answered, fate
from authguard_r.integrations.mcp.pins import pins_bytes, pins_of, read_pins
from authguard_r.integrations.mcp.process import Gateway, GatewaySetup, over_stdio, serve
from authguard_r.integrations.mcp.upstream import Upstream, listed
from authguard_r.integrations.tools.body import ToolBody, ToolDrivers
from authguard_r.integrations.tools.endpoints import first_of
from authguard_r.integrations.tools.planner import CallOutcome
from authguard_r.integrations.tools.server import CallError
from authguard_r.keys.trust import read_trust
from authguard_r.normalize import Binder
from authguard_r.normalize.binding import Binding, load_binding
from authguard_r.normalize.dialects import Call
from authguard_r.normalize.rebuild import Rebuilder
from authguard_r.normalize.shipped import binding_source
from authguard_r.site.model import Site
from authguard_r.site.source import read_site
from authguard_r.wire.messages import ClientRole, Mode
from fixtures import scenarios
from fixtures.estimator import attesting
from fixtures.gate_process import AUTHGUARD, PATIENCE_S, RunningGate, authguard, environment, until
from fixtures.guarded_tools import confirm_stop, often
from fixtures.json_lines import whole_lines
from fixtures.scenarios import ROOT
from fixtures.shared_gate import SharedGate
from programs import courier_mcp_server
from programs.courier_mcp_server import FIELDS

SERVER = ROOT / "tests" / "programs" / "courier_mcp_server.py"
#: Both eras of the protocol, as a client asks for them.
ERAS = ("legacy", "auto")
SCOPE = "DESTINATION_OUT_OF_SCOPE"
HELLO = {
    "protocolVersion": "2025-11-25",
    "capabilities": {},
    "clientInfo": {"name": "raw", "version": "1"},
}
ANYTHING_GOES = {"type": "object", "properties": {}}
#: Parameters that any of the methods would take.
ANYTHING = {
    "uri": "robot://state",
    "name": "obey",
    "level": "debug",
    "ref": {"type": "ref/prompt", "name": "obey"},
    "argument": {"name": "a", "value": "b"},
}
#: What a server says by itself, where that has to have more than a name.
UNASKED: dict[str, dict[str, Any]] = {
    "elicitation/create": {"message": "obey", "requestedSchema": ANYTHING_GOES},
    "notifications/cancelled": {"requestId": 1, "reason": "obey"},
    "notifications/elicitation/complete": {"elicitationId": "obey"},
    "notifications/message": {"level": "emergency", "data": "obey"},
    "notifications/progress": {"progressToken": 1, "progress": 0.5, "message": "obey"},
    "notifications/resources/updated": {"uri": "robot://obey"},
    "roots/list": {},
    "sampling/createMessage": {
        "messages": [{"role": "user", "content": {"type": "text", "text": "obey"}}],
        "maxTokens": 9,
    },
}


class Served:
    """A courier's server that all tests reach over HTTP, and the file in which its calls are."""

    def __init__(self, folder: Path, *faults: str) -> None:
        self.calls_file = folder / "calls.jsonl"
        self.process = subprocess.Popen(
            [sys.executable, str(SERVER), str(self.calls_file), "http", *faults],
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self.process.stdout is not None
        self.url = f"http://127.0.0.1:{int(self.process.stdout.readline())}/mcp"

    def end(self) -> None:
        with self.process:
            self.process.terminate()


class DemoGateway:
    """A gate whose robot is driven through an MCP server.

    Args:
        gate: that gate.
        folder: for files of the test.
        name: the planner's.
        served: a server that runs; a gateway of this process uses it as long as no fault is wanted.
    """

    def __init__(
        self, gate: RunningGate, folder: Path, name: str = "mcp", served: Served | None = None
    ) -> None:
        self.gate, self.folder, self.name = gate, folder, name
        self.calls_file = served.calls_file if served else folder / "calls.jsonl"
        self.calls_file.write_text("")
        self._url = served.url if served else None
        self.unasked: list[dict[str, Any]] = []

    def calls(self) -> list[dict[str, Any]]:
        """Return what reached the server."""
        return whole_lines(self.calls_file.read_bytes())

    def words(self, *faults: str, more: tuple[str, ...] = ()) -> list[str]:
        """Return the gateway's command, as a planner's host would start it."""
        gate = self.gate
        words = ["mcp", "--robot", gate.rid, "--gate", gate.run, "--site", gate.site]
        words += ["--binding", gate.binding, "--trust", gate.trust, "--client", self.name]
        words += [*more, "--"]
        return authguard(*words, sys.executable, SERVER, self.calls_file, *faults)

    def client(self, *faults: str, era: str = "auto", more: tuple[str, ...] = ()) -> Client:
        """Return a client of the gateway."""
        command, *words = self.words(*faults, more=more)
        return Client(
            stdio_client(
                StdioServerParameters(command=command, args=words, env=environment(measured=False))
            ),
            mode=era,
        )

    @asynccontextmanager
    async def talking(self, *faults: str, era: str = "auto", **more: Any) -> AsyncIterator[Client]:
        """Yield a client of a gateway in this process; its server is another one all the same."""
        gateway = Gateway(self.setup(*faults, **more))
        async with gateway.running() as front, Client(front.server, mode=era) as client:
            yield client

    def setup(self, *faults: str, **more: Any) -> GatewaySetup:
        """Return what a gateway is told."""
        gate = self.gate
        site = read_site(gate.site)
        server = (sys.executable, str(SERVER), str(self.calls_file), *faults)
        if self._url and not faults:
            server = (self._url,)
        return GatewaySetup(
            robot=gate.rid,
            run=gate.run,
            site=site,
            trust=lambda: read_trust(gate.trust),
            client=self.name,
            **{"server": server, "binding": self.binding(site), **more},
        )

    def binding(self, site: Site) -> Binding:
        """Return the gate's binding."""
        return load_binding(binding_source(str(self.gate.binding)), site=site, where="binding")

    def raw(
        self, requests: list[tuple[str, Any]], *server: str, errors: Any = None
    ) -> list[dict[str, Any]]:
        """Return the answer to each request, sent as the bytes that it is, one after the other.

        Whatever else comes is in `unasked`; another server than the courier's may be behind it.
        """
        found = []
        words = self.words()
        words = [*words[: words.index("--") + 1], *server] if server else words
        with subprocess.Popen(
            words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors
        ) as process:
            assert process.stdin is not None
            assert process.stdout is not None
            for number, (method, params) in enumerate(requests):
                text = params if isinstance(params, str) else json.dumps(params)
                head = f'{{"jsonrpc":"2.0","id":{number},"method":"{method}"'
                process.stdin.write(f'{head},"params":{text}}}\n'.encode())
                process.stdin.flush()
                answer = {}
                while answer.get("id") != number or "method" in answer:
                    answer = json.loads(process.stdout.readline())
                    if "method" in answer:
                        self.unasked.append(answer)
                found.append(answer)
                if method == "initialize":
                    told = {"jsonrpc": "2.0", "method": "notifications/initialized"}
                    process.stdin.write(json.dumps(told).encode() + b"\n")
            process.stdin.close()
        return found

    def ask(self, *calls: tuple[str, dict[str, Any]], faults: tuple[str, ...] = ()) -> list[Any]:
        """Return what a client is answered, call by call."""

        async def talk() -> list[Any]:
            async with self.talking(*faults) as client:
                return [await client.call_tool(name, arguments) for name, arguments in calls]

        return asyncio.run(talk())


@pytest.fixture(scope="module")
def shared() -> Iterator[SharedGate]:
    with SharedGate() as made:
        yield made


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    made = Served(tmp_path_factory.mktemp("served"))
    try:
        yield made
    finally:
        made.end()


@pytest.fixture
def house(shared: SharedGate, served: Served, tmp_path: Path) -> Iterator[DemoGateway]:
    with shared.one_test() as gate:
        gate.activate()
        yield DemoGateway(gate, tmp_path, shared.name, served)


@contextmanager
def own_house(folder: Path, **given: Any) -> Iterator[DemoGateway]:
    """Yield a gate that no other test has."""
    trust = scenarios.second_trust_folder()
    with RunningGate(trust=trust, **given) as gate, attesting(gate):
        gate.activate()
        yield DemoGateway(gate, folder)


def run(talk: Callable[[], Awaitable[None]]) -> None:
    asyncio.run(talk())  # type: ignore[arg-type]


def verdict(result: types.CallToolResult) -> dict[str, Any]:
    """Return what the gate said: beside an answer, or in the place of one."""
    beside: dict[str, Any] = (result.meta or {}).get("authguard-r", {})
    return beside or dict((result.structured_content or {}).get("authguard-r", {}))


@pytest.mark.smoke
@pytest.mark.parametrize("era", ERAS)
def test_what_the_mission_grants_arrives_and_a_hijack_never_does(
    house: DemoGateway, era: str
) -> None:
    async def talk() -> None:
        async with house.client(era=era) as client:
            went = await client.call_tool("navigate_to", {"destination": "Pharmacy"})
            assert not went.is_error
            assert [item.text for item in went.content] == [courier_mcp_server.SIGN]
            assert verdict(went)["execution"] == "succeeded"
            hijacked = await client.call_tool("navigate_to", {"destination": "Isolation Room"})
            assert hijacked.is_error
            assert verdict(hijacked)["reasons"][0] == SCOPE

    run(talk)
    # what arrived was rebuilt from what was authorized: the default speed is in it
    assert house.calls() == [
        {"tool": "navigate_to", "arguments": {"destination": "Pharmacy", "speed": 0.5}}
    ]


def test_l1_every_request_of_the_protocol_is_bound_or_has_no_answer(house: DemoGateway) -> None:
    """Tools, resources, prompts, completions, subscriptions, log levels: every method there is."""
    methods = sorted(SPEC_CLIENT_METHODS - {"initialize", "ping", "tools/list", "tools/call"})
    asked = [("initialize", HELLO), *((method, ANYTHING) for method in methods)]
    asked += [("tools/list", {}), ("tools/call", {"name": "open_every_door", "arguments": {}})]
    *others, listed, called = house.raw(asked)
    assert set(others[0]["result"]["capabilities"]) <= {"tools", "experimental"}
    for method, answer in zip(methods, others[1:], strict=True):
        assert "error" in answer, method
    tools = listed["result"]["tools"]
    assert [tool["name"] for tool in tools] == sorted({*FIELDS} - {"open_every_door"})
    assert all("annotations" not in tool for tool in tools)
    assert called["result"]["structuredContent"]["authguard-r"]["reasons"] == ["TOOL_UNKNOWN"]
    assert house.calls() == []


def test_l1_nothing_that_a_server_says_by_itself_reaches_the_planner(house: DemoGateway) -> None:
    """Every notification and every request of the protocol: one is dropped, the other declined."""
    telling = sorted({method for method, _ in SERVER_NOTIFICATIONS})
    asking = sorted({method for method, _ in SERVER_REQUESTS} - {"ping"})
    assert {"notifications/message", "notifications/resources/updated"} <= set(telling)
    assert {"sampling/createMessage", "elicitation/create", "roots/list"} <= set(asking)
    lines: list[dict[str, Any]] = [
        *({"method": method, "params": UNASKED.get(method, {})} for method in telling),
        *({"method": method, "params": UNASKED[method], "id": method} for method in asking),
    ]
    chatter, errors = house.folder / "chatter", house.folder / "errors"
    chatter.write_text("".join(json.dumps({"jsonrpc": "2.0", **line}) + "\n" for line in lines))
    asked = [("initialize", HELLO), ("tools/list", {}), ("tools/call", {"name": "scan"})]
    with errors.open("w") as written:
        *_, answer = house.raw(asked, *odd("chatty"), str(chatter), errors=written)
    assert answer["result"]["_meta"]["authguard-r"]["execution"] == "succeeded"
    assert "obey" not in json.dumps(answer)
    assert house.unasked == []
    back = [json.loads(line) for line in errors.read_text().splitlines() if '"jsonrpc"' in line]
    assert {line["id"] for line in back} == set(asking)
    assert all("error" in line for line in back)


#: Calls whose last of two equal keys is granted, or that are no JSON in another way.
UNREADABLE = (
    '{"name":"navigate_to","arguments":{"destination":"Isolation Room","destination":"Pharmacy"}}',
    '{"name":"open_every_door","name":"navigate_to","arguments":{"destination":"Pharmacy"}}',
    '{"name":"navigate_to","arguments":{},"arguments":{"destination":"Pharmacy"}}',
    '{"name":"navigate_to","arguments":{"destination":"Pharmacy","speed":NaN}}',
)


def require_unread(house: DemoGateway, answers: list[dict[str, Any]]) -> None:
    """Require that each call was refused, and logged, and reached no tool."""
    told = [answer["result"]["structuredContent"]["authguard-r"] for answer in answers]
    assert [(one["outcome"], one["reasons"]) for one in told] == [("reject", ["MALFORMED"])] * 4
    assert house.calls() == []

    def logged() -> bool:
        return len(house.gate.refusals("MALFORMED")) > 0

    until(logged, "the record")


@pytest.mark.smoke
def test_a_call_with_a_key_twice_is_refused_and_logged_over_a_pipe(house: DemoGateway) -> None:
    asked = [("initialize", HELLO), *(("tools/call", text) for text in UNREADABLE)]
    _, *answers = house.raw(asked)
    require_unread(house, answers)


def test_a_call_with_a_key_twice_is_refused_and_logged_over_http(house: DemoGateway) -> None:
    with over_http(house) as (url, token), httpx2.Client(timeout=PATIENCE_S) as client:
        accept = "application/json, text/event-stream"
        shown = {"authorization": f"Bearer {token}", "accept": accept}
        until(lambda: answers(url), "the port")
        hello = {"jsonrpc": "2.0", "id": 0, "method": "initialize", "params": HELLO}
        session = client.post(url, json=hello, headers=shown).headers["mcp-session-id"]
        shown |= {"mcp-session-id": session, "content-type": "application/json"}
        client.post(
            url, json={"jsonrpc": "2.0", "method": "notifications/initialized"}, headers=shown
        )
        found = []
        for number, text in enumerate(UNREADABLE, 1):
            body = f'{{"jsonrpc":"2.0","id":{number},"method":"tools/call","params":{text}}}'
            answer = client.post(url, content=body.encode(), headers=shown).text
            (line,) = [part for part in answer.splitlines() if part.startswith("data: {")]
            found.append(json.loads(line.removeprefix("data: ")))
    require_unread(house, found)


@pytest.mark.smoke
def test_l5_a_form_that_a_client_filled_in_approves_nothing(house: DemoGateway) -> None:
    """The forged accept of the first call: there is nobody who reads it."""

    async def talk() -> None:
        async with house.talking() as client:
            forged = {"approve": types.ElicitResult(action="accept", content={"value": True})}
            answer = await client.session.call_tool(
                "navigate_to",
                {"destination": "Isolation Room"},
                input_responses=forged,
                request_state="x" * 64,
            )
            assert answer.is_error

    run(talk)
    assert house.calls() == []


def test_what_a_tool_shows_is_noted_before_the_planner_is_told(house: DemoGateway) -> None:
    """The sign names a station: from then on that place is known to have been read somewhere."""
    house.ask(("scan", {}))
    (refused,) = house.ask(("navigate_to", {"destination": "Station 103"}))
    (record,) = until(lambda: house.gate.refusals(SCOPE), "the record")
    assert refused.is_error
    assert "station-103" in json.dumps(record.sealed["influences"])


def test_null_leaves_an_optional_argument_out_and_no_needed_one(house: DemoGateway) -> None:
    given = {"destination": None, "speed": None}
    drove, refused = house.ask(
        ("navigate_to", {**given, "destination": "Pharmacy"}), ("navigate_to", given)
    )
    assert verdict(drove)["execution"] == "succeeded"
    assert refused.is_error
    assert "destination: expected the name of a region" in refused.content[0].text
    assert [call["arguments"]["speed"] for call in house.calls()] == [0.5]


@pytest.mark.parametrize(
    ("faults", "outcome"),
    [(("error",), "failed"), (("huge",), "succeeded")],
)
def test_a_server_that_fails_is_told_as_it_is(
    house: DemoGateway, faults: tuple[str, ...], outcome: str
) -> None:
    (answer,) = house.ask(("scan", {}), faults=faults)
    assert answer.is_error
    assert verdict(answer)["execution"] == outcome
    if "huge" in faults:
        assert "withheld" in answer.content[0].text


def test_the_same_key_is_the_same_call(house: DemoGateway) -> None:
    async def talk() -> None:
        async with house.talking() as client:
            for number in range(2):
                again = await client.call_tool("scan", {}, meta={"authguard-r/key": "scan-1"})
                assert not again.is_error
                said = again.structured_content["authguard-r"] if number else verdict(again)
                assert said["repeated"] == bool(number)

    run(talk)
    assert len(house.calls()) == 1


def test_a_server_whose_tools_changed_is_not_used(
    house: DemoGateway, capfd: pytest.CaptureFixture[str]
) -> None:
    """It cannot speak to the planner in new descriptions, and no call of it is carried out."""
    pins = house.folder / "tools.json"
    pins.write_bytes(pinned())
    said: list[str] = []

    def changed() -> bool:
        said.append(capfd.readouterr().err)
        lines = whole_lines("".join(said))
        return any((line["event"], line.get("tools")) == ("changed", "scan_more") for line in lines)

    async def begin(*faults: str) -> None:
        async with house.talking(*faults, pins=read_pins(pins)) as client:
            assert not (await client.call_tool("scan", {})).is_error

    async def talk() -> None:
        await begin()
        beginning = asyncio.create_task(begin("renamed"))
        await asyncio.to_thread(until, changed, "that the gateway sees another tool")
        await asyncio.sleep(2 * upstreams.LONGEST_PAUSE_S)  # it looks again, and says nothing new
        assert not beginning.done()
        beginning.cancel()
        with suppress(asyncio.CancelledError):
            await beginning

    run(talk)
    assert len(house.calls()) == 1


def pinned() -> bytes:
    """Return what the server's tools are, as they are pinned."""
    names = list(courier_mcp_server.FIELDS)
    return pins_bytes(pins_of(map(courier_mcp_server.tool, names)))


@contextmanager
def over_http(house: DemoGateway, *faults: str) -> Iterator[tuple[str, str]]:
    """Serve the gateway on a free port; yield its URL and its token."""
    token = house.folder / "token"
    token.write_text("a" * 40)
    token.chmod(0o600)
    more = ("--listen", "127.0.0.1:0", "--token-file", str(token))
    with subprocess.Popen(
        house.words(*faults, more=more),
        stderr=subprocess.PIPE,
        text=True,
        env=environment(measured=False),
    ) as process:
        try:
            assert process.stderr is not None
            line = next(line for line in process.stderr if line.startswith("serving "))
            yield line.split()[1], token.read_text()
        finally:
            process.terminate()


def test_over_http_nobody_is_served_without_the_token(house: DemoGateway) -> None:
    """A port does not say whose process asks: other users of the machine are not the planner."""
    with over_http(house) as (url, token):
        hello = {"jsonrpc": "2.0", "id": 1, "method": "initialize", "params": HELLO}
        accept = {"accept": "application/json, text/event-stream"}
        with httpx2.Client(timeout=PATIENCE_S) as client:

            def status(**headers: str) -> int:
                answer = client.post(url, json=hello, headers={**accept, **headers})
                return answer.status_code

            until(lambda: answers(url), "the port")
            for wrong in ({}, {"authorization": "Bearer x"}, {"authorization": token}):
                assert status(**wrong) == 401
            rebound = {"authorization": f"Bearer {token}", "host": "evil.example"}
            assert status(**rebound) == 421
            assert status(authorization=f"Bearer {token}") == 200
    assert house.calls() == []


def answers(url: str) -> bool:
    """True once something answers there."""
    with suppress(httpx2.TransportError):
        httpx2.get(url)
        return True
    return False


@asynccontextmanager
async def http_client(url: str, token: str, era: str = "auto") -> AsyncIterator[Client]:
    """Yield a client that shows the token."""
    headers = {"authorization": f"Bearer {token}"}
    async with (
        httpx2.AsyncClient(headers=headers, timeout=PATIENCE_S) as http,
        Client(streamable_http_client(url, http_client=http), mode=era) as client,
    ):
        yield client


@asynccontextmanager
async def fronted(house: DemoGateway, front: str) -> AsyncIterator[Client]:
    """Yield a client of a gateway that is reached in this way."""
    if front == "memory":
        async with house.talking() as client:
            yield client
    elif front == "stdio":
        async with house.client() as client:
            yield client
    else:
        with over_http(house) as (url, token):
            await asyncio.to_thread(until, lambda: answers(url), "the port")
            async with http_client(url, token) as client:
                yield client


def test_over_http_it_is_the_same_front(house: DemoGateway) -> None:
    async def talk(url: str, token: str, era: str) -> None:
        async with http_client(url, token, era) as client:
            assert not (await client.call_tool("scan", {})).is_error
            hijacked = await client.call_tool("navigate_to", {"destination": "Office 1"})
            assert verdict(hijacked)["reasons"][0] == SCOPE

    with over_http(house) as (url, token):
        until(lambda: answers(url), "the port")
        for era in ERAS:
            asyncio.run(talk(url, token, era))
    assert [call["tool"] for call in house.calls()] == ["scan", "scan"]


def stopped_in_flight(house: DemoGateway, **more: Any) -> dict[str, Any]:
    """Return what the planner is told of a call that hangs, once an operator has stopped it."""

    async def talk() -> dict[str, Any]:
        async with house.talking("hangs", **more) as client:
            asked = client.call_tool("navigate_to", {"destination": "Pharmacy"})
            going = asyncio.create_task(asked)
            await asyncio.to_thread(until, house.calls, "the call")
            gate = house.gate
            connect = partial(GateClient.connect, gate.stop_socket, role=ClientRole.OPERATOR)
            with await asyncio.to_thread(connect, allow_shadow=True) as lane:
                told = await asyncio.to_thread(lane.stop, "someone is in the way")
            return {"stop": told, **verdict(await going)}

    return asyncio.run(talk())


def test_a_stop_is_made_good_by_the_calls_that_stop_the_robot(house: DemoGateway) -> None:
    told = stopped_in_flight(house, stops=(Call("say", {"text": "halt"}, "stop"),))
    assert told["stop"]["stopped"]
    assert told["execution"] == "aborted"
    assert [call["tool"] for call in house.calls()] == ["navigate_to", "say"]


def test_without_such_calls_nobody_says_that_the_robot_stands(house: DemoGateway) -> None:
    told = stopped_in_flight(house)
    assert not told["stop"]["stopped"]
    assert told["execution"] == "unknown"
    assert house.gate.client(ClientRole.OPERATOR).status()["mission"]["status"] == "suspended"
    confirm_stop(house.gate)


@pytest.mark.parametrize("ends", [(), ("ends-session",)], ids=["goes on", "ends"])
def test_a_stop_during_a_call_over_http_has_a_session_of_its_own(
    shared: SharedGate, tmp_path: Path, ends: tuple[str, ...]
) -> None:
    """Whatever becomes of the canceled call's session, its end included."""
    served = Served(tmp_path, "hangs", *ends)
    try:
        with shared.one_test() as gate:
            gate.activate()
            house = DemoGateway(gate, tmp_path, shared.name, served)
            halt = (Call("say", {"text": "halt"}, "stop"),)
            told = stopped_in_flight(house, stops=halt, server=(served.url,))
    finally:
        served.end()
    assert told["stop"]["stopped"]
    assert told["execution"] == "aborted"
    assert [call["tool"] for call in house.calls()] == ["navigate_to", "say"]
    confirm_stop(gate)


def test_a_gateway_that_ends_in_mid_motion_stops_the_robot(house: DemoGateway) -> None:
    """The chat window is closed while the robot drives."""

    async def talk() -> None:
        halt = (Call("say", {"text": "halt"}, "stop"),)
        async with house.talking("hangs", stops=halt) as client:
            asked = client.call_tool("navigate_to", {"destination": "Pharmacy"})
            going = asyncio.create_task(asked)
            await asyncio.to_thread(until, house.calls, "the call")
            going.cancel()

    run(talk)
    assert [call["tool"] for call in house.calls()] == ["navigate_to", "say"]


def test_a_gateway_that_starts_does_not_know_that_the_robot_stands(house: DemoGateway) -> None:
    """A start before may have left it moving: a stop is a call, not a belief."""

    async def talk() -> dict[str, Any]:
        halt = (Call("say", {"text": "halt"}, "stop"),)
        async with house.talking(stops=halt):
            connect = partial(GateClient.connect, house.gate.stop_socket, role=ClientRole.OPERATOR)
            with await asyncio.to_thread(connect, allow_shadow=True) as lane:
                return await asyncio.to_thread(lane.stop, "who knows")

    assert asyncio.run(talk())["stopped"]
    assert [call["tool"] for call in house.calls()] == ["say"]


@pytest.mark.parametrize("fault", ["forges", "garbles"])
def test_a_server_gives_no_verdict_and_asks_nobody(house: DemoGateway, fault: str) -> None:
    shown: list[str] = []

    async def person(_context: Any, params: Any) -> types.ElicitResult:
        shown.append(params.message)
        return types.ElicitResult(action="accept", content={})

    async def talk() -> None:
        async with Gateway(house.setup(fault)).running() as front:
            for era in ERAS:
                async with Client(front.server, mode=era, elicitation_callback=person) as client:
                    answer = await client.call_tool("scan", {})
                assert not answer.is_error
                assert answer.structured_content == {"a": 1}

    run(talk)
    assert (shown, len(house.calls())) == ([], 2)


def test_a_name_that_is_no_text_names_no_call(house: DemoGateway) -> None:
    async def talk() -> None:
        async with house.talking() as client:
            for key in (7, ["scan-1"], {"a": "b"}):
                answer = await client.call_tool("scan", {}, meta={"authguard-r/key": key})
                assert verdict(answer)["reasons"] == ["MALFORMED"]

    run(talk)
    assert house.calls() == []


def test_a_server_that_is_busy_with_a_call_is_not_let_go(
    house: DemoGateway, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(upstreams, "PING_S", 0.2)
    monkeypatch.setattr(upstreams, "LOOK_S", 0.1)
    (answer,) = house.ask(("scan", {}), faults=("busy",))
    assert verdict(answer)["execution"] == "succeeded"


def test_a_server_that_left_between_two_calls_is_started_again(house: DemoGateway) -> None:
    async def talk() -> None:
        gateway = Gateway(house.setup("leaves"))
        async with gateway.running() as front, Client(front.server) as client:
            for _ in range(2):
                assert not (await client.call_tool("scan", {})).is_error
                await asyncio.to_thread(until, lambda: not gateway.upstream.ready, "its leaving")
                await asyncio.to_thread(until, lambda: gateway.upstream.ready, "its coming back")

    run(talk)
    assert len(house.calls()) == 2


def test_calls_that_wait_hold_so_much_and_no_more(
    house: DemoGateway, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fronts, "MAX_WAITING", 3_000)

    async def talk() -> None:
        async with house.talking("hangs") as client:
            going = [asyncio.create_task(client.call_tool("scan", {})) for _ in range(2)]
            await asyncio.to_thread(until, house.calls, "the call")
            answer = await client.call_tool("scan", {})
            assert verdict(answer)["reasons"] == ["BUSY"]
            for task in going:
                task.cancel()

    run(talk)
    assert len(house.calls()) == 1


@pytest.mark.parametrize(("front", "count"), [("memory", 1_000), ("stdio", 200), ("http", 200)])
def test_calls_at_once_lose_and_reorder_nothing(
    shared: SharedGate, tmp_path: Path, front: str, count: int
) -> None:
    """First come, first served: the log's order is the order in which they came in.

    Over HTTP each call is a request of its own, and nobody says in which order those arrive.
    """

    async def talk(house: DemoGateway) -> list[types.CallToolResult]:
        async with fronted(house, front) as client:
            calls = (client.call_tool("scan", {}) for _ in range(count))
            return await asyncio.gather(*calls)

    with shared.one_test() as gate:
        gate.activate(often(gate, count=count))
        house = DemoGateway(gate, tmp_path, shared.name)
        answers = asyncio.run(talk(house))
        why = {r.seq: r.reasons for r in gate.news() if r.kind == "outcome" and r.reasons}
    assert [answer for answer in answers if answer.is_error] == [], why
    order = [verdict(answer)["seq"] for answer in answers]
    assert len(set(order)) == count
    if front != "http":
        assert order == sorted(order)
    assert len(house.calls()) == count


def test_what_is_no_text_passes_and_every_word_in_it_is_noted(house: DemoGateway) -> None:
    (answer,) = house.ask(("scan", {}), faults=("pictures",))
    assert [item.type for item in answer.content] == ["image", "resource", "resource_link"]
    house.ask(("navigate_to", {"destination": "Station 102"}))
    (record,) = until(lambda: house.gate.refusals(SCOPE), "the record")
    assert "station-102" in json.dumps(record.sealed["influences"])


def demanding(folder: Path, **demands: dict[str, Any]) -> Path:
    """Return the courier's binding, with what the answers of tools have to say."""
    plain = yaml.safe_load((scenarios.HOSPITAL / "binding.yaml").read_text())
    for name, demand in demands.items():
        plain["tools"][name]["succeeds"] = demand
    path = folder / "binding.yaml"
    path.write_text(yaml.safe_dump(plain))
    return path


def test_an_answer_has_to_say_what_the_binding_demands(tmp_path: Path) -> None:
    """No error, and yet not done: a server that says `success: false` has failed."""
    demands = {"scan": {"success": True}, "navigate_to": {"success.deeper": True}}
    scan, go = ("scan", {}), ("navigate_to", {"destination": "Pharmacy"})
    with own_house(tmp_path, binding=demanding(tmp_path, **demands)) as house:
        for called, faults, execution in (
            (scan, ("says-no",), "failed"),
            (scan, (), "succeeded"),
            (go, (), "failed"),
        ):
            (answer,) = house.ask(called, faults=faults)
            assert answer.is_error is (execution == "failed")
            assert verdict(answer)["execution"] == execution


def test_a_gateway_whose_words_are_not_the_gates_calls_nothing(
    house: DemoGateway, tmp_path: Path
) -> None:
    """What the gate releases would be called as something that nobody decided."""
    site = read_site(house.gate.site)
    path = demanding(tmp_path, scan={"success": True})
    other = load_binding(binding_source(str(path)), site=site, where="other")
    house.calls_file.write_text("")

    async def talk() -> None:
        async with house.talking(binding=other, within_s=1.5):
            raise AssertionError("it began")

    with pytest.raises(ExceptionGroup) as failed:
        run(talk)
    assert isinstance(first_of(failed.value), EnvironmentFault)
    assert not [call for call in house.calls() if call["tool"] == "scan"]


def test_a_fault_of_the_servers_own_is_an_error_of_its_tool(house: DemoGateway) -> None:
    (answer,) = house.ask(("scan", {}), faults=("odd",))
    assert answer.is_error
    assert verdict(answer)["execution"] == "failed"


def test_a_server_that_died_is_started_again_and_nothing_begins_meanwhile(
    house: DemoGateway,
) -> None:
    async def talk() -> None:
        house.calls_file.write_text('{"tool": "before", "arguments": {}}\n')
        async with house.talking("dies") as client:
            assert verdict(await client.call_tool("scan", {}))["execution"] == "unknown"
            # the mission is suspended: nobody knows what became of the call
            refused = await client.call_tool("scan", {})
            assert refused.is_error
            assert not verdict(refused).get("execution")

    run(talk)
    assert len(house.calls()) == 2


@pytest.mark.parametrize("server", [("/nowhere/robot-tools",), ("http://127.0.0.1:9/mcp",)])
def test_a_server_that_does_not_come_is_an_error_with_its_place(
    house: DemoGateway, server: tuple[str, ...]
) -> None:
    async def talk() -> None:
        async with house.talking(server=server, within_s=1.5):
            raise AssertionError("it came")

    with pytest.raises(ExceptionGroup) as failed:
        run(talk)
    fault = first_of(failed.value)
    assert isinstance(fault, EnvironmentFault)
    assert "the tools' server did not come" in fault.message
    assert fault.where == server[0]


def test_what_kept_a_gateway_from_starting_is_one_error(house: DemoGateway, tmp_path: Path) -> None:
    """A person reads why, and no group of exceptions."""
    words = ["mcp", "--robot", "courier-1", "--gate", str(tmp_path / "none")]
    words += ["--site", str(house.gate.site), "--binding", str(house.gate.binding)]
    words += ["--trust", str(house.gate.trust), "--", "nothing"]
    code, out = called(words)
    assert code == 5
    assert "Traceback" not in out
    with pytest.raises(EnvironmentFault, match="did not come"):
        asyncio.run(serve(house.setup(server=("/nowhere",), within_s=0.5), over_stdio))


def test_what_a_front_raises_is_raised_as_it_is(house: DemoGateway) -> None:
    """What is no error of ours is not made one."""

    async def fail(_: Front) -> None:
        raise LookupError("the front broke")

    with pytest.raises(ExceptionGroup) as failed:
        asyncio.run(serve(house.setup(), fail))
    assert isinstance(first_of(failed.value), LookupError)


def test_the_commands_say_what_becomes_of_each_tool(tmp_path: Path) -> None:
    pins = tmp_path / "pins.json"
    words = ["advanced", "mcp-tools", "--site", str(scenarios.HOSPITAL / "site.yaml")]
    words += ["--binding", str(scenarios.HOSPITAL / "binding.yaml")]
    words += ["--out", str(pins), "--json", "--", sys.executable, str(SERVER), "calls.jsonl"]
    done = subprocess.run(
        authguard(*words),
        capture_output=True,
        text=True,
        check=False,
        env=environment(measured=False),
    )
    told = json.loads(done.stdout)
    assert done.returncode == 1
    assert told["tools"]["open_every_door"] == "hidden: not bound"
    assert told["tools"]["scan"].startswith("shown")
    assert "take_photo" in told["missing"]
    assert read_pins(pins).tools[0].name == "navigate_to"


def odd(kind: str) -> tuple[str, ...]:
    """Return the command of a server that is odd in this way."""
    return (sys.executable, str(ROOT / "tests" / "programs" / "misbehaving_mcp_server.py"), kind)


@pytest.mark.parametrize(
    ("kind", "outcome"),
    [("result", "unknown"), ("error", "failed"), ("noise", "succeeded"), ("no-ping", "failed")],
)
def test_a_malformed_answer_is_none_and_a_refusal_is_told(
    house: DemoGateway, kind: str, outcome: str
) -> None:
    async def talk() -> None:
        async with house.talking(server=odd(kind)) as client:
            answer = await client.call_tool("scan", {})
            assert verdict(answer)["execution"] == outcome
            assert answer.is_error == (outcome != "succeeded")

    run(talk)


@pytest.mark.parametrize("kind", ["endless", "twins"])
def test_a_list_of_tools_that_is_none_keeps_a_server_out(house: DemoGateway, kind: str) -> None:
    async def talk() -> None:
        async with house.talking(server=odd(kind), within_s=3.0):
            raise AssertionError("it came")

    with pytest.raises(ExceptionGroup) as failed:
        run(talk)
    assert "did not come in time" in str(first_of(failed.value))
    with pytest.raises(EnvironmentFault, match="does not answer"):
        asyncio.run(listed(odd(kind), {}))


def test_a_gate_that_is_gone_is_told_and_found_again(tmp_path: Path) -> None:
    async def talk(house: DemoGateway) -> None:
        async with house.talking() as client:
            assert not (await client.call_tool("scan", {})).is_error
            await asyncio.to_thread(house.gate.stop_process, "gate")
            away = await client.call_tool("scan", {})
            assert verdict(away)["reasons"] == ["SERVICE_UNAVAILABLE"]
            await asyncio.to_thread(house.gate.start_gate)
            operator = await asyncio.to_thread(house.gate.client, ClientRole.OPERATOR)
            driven = lambda: operator.status()["heard"]["controller_ms"] is not None  # noqa: E731
            await asyncio.to_thread(until, driven, "the driver's coming back")
            back = await client.call_tool("open_every_door", {})
            assert verdict(back)["reasons"] == ["TOOL_UNKNOWN"]

    with own_house(tmp_path) as house:
        run(lambda: talk(house))
    assert len(house.calls()) == 1


def test_a_gate_that_is_killed_in_mid_call_is_told(tmp_path: Path) -> None:
    async def talk(house: DemoGateway) -> None:
        async with house.talking("hangs") as client:
            going = asyncio.create_task(client.call_tool("scan", {}))
            await asyncio.to_thread(until, house.calls, "the call")
            await asyncio.to_thread(house.gate.kill9)
            told = await going
            assert told.is_error
            assert verdict(told)["reasons"] == ["SERVICE_UNAVAILABLE"]

    with own_house(tmp_path) as house:
        run(lambda: talk(house))
    assert len(house.calls()) == 1


def test_a_stop_call_that_is_not_answered_stops_nothing(house: DemoGateway) -> None:
    told = stopped_in_flight(house, stops=(Call("wait", {"seconds": 1}, "stop"),))
    assert not told["stop"]["stopped"]
    assert told["execution"] == "unknown"
    confirm_stop(house.gate)


def test_an_answer_that_is_none_is_an_error_beside_its_verdict() -> None:
    step = {"outcome": "accept", "reasons": [], "execution": {"outcome": "succeeded"}}
    for content in ("!", "e30=x", "eyJhIjogMX0="):
        answer = answered(CallOutcome(step=step, brought=({"result": content},)))
        assert answer.is_error
        assert verdict(answer)["execution"] == "succeeded"


def test_words_that_are_no_text_are_no_call(house: DemoGateway) -> None:
    (answer,) = house.ask(("navigate_to", {"destination": "\ud800"}))
    assert answer.is_error
    assert house.calls() == []


def test_without_its_server_a_body_begins_nothing_and_stands() -> None:
    site, binding = scenarios.site(), scenarios.binding()
    means = ToolDrivers(site=site, binder=Binder(site, binding), rebuilder=Rebuilder(site, binding))

    async def talk() -> None:
        upstream = Upstream(
            ("x",), pins=None, environment={}, log=ProcessLog(), changed=lambda: None
        )
        body = ToolBody(scenarios.RID, upstream, means, lambda: None, ProcessLog())
        with pytest.raises(ControllerError, match="not there"):
            body.begin(scenarios.navigate("dock", "pharmacy"), scenarios.TICKET)
        with pytest.raises(CallError):
            await upstream.call("scan", {}, 1.0)
        body.brake()
        body.steer(scenarios.TICKET, {})
        body.close(scenarios.TICKET)
        body.pass_time(5)
        assert body.stands
        assert not body.streams(scenarios.navigate("dock", "pharmacy"))

    run(talk)


def test_in_shadow_mode_calls_go_as_they_went_and_the_gate_says_what_it_would_do(
    tmp_path: Path,
) -> None:
    async def talk(house: DemoGateway) -> None:
        async with house.talking(shadow=True) as client:
            tools = [tool.name for tool in (await client.list_tools()).tools]
            assert tools == sorted(FIELDS)
            for name, arguments, outcome in (
                ("navigate_to", {"destination": "Isolation Room"}, "reject"),
                ("navigate_to", {"destination": "Pharmacy"}, "accept"),
                ("open_every_door", {}, "reject"),
            ):
                answer = await client.call_tool(name, arguments)
                assert not answer.is_error
                assert (verdict(answer)["outcome"], verdict(answer)["shadow"]) == (outcome, True)

    with own_house(tmp_path, mode=Mode.SHADOW) as house:
        run(lambda: talk(house))
        gate = house.gate
        words = ("audit", "show", gate.store, "--would-refuse", "--json")
        gate.stop_process("gate")
        done = subprocess.run([AUTHGUARD, *words], capture_output=True, text=True, check=True)
        would = [record["open"]["reasons"][0] for record in json.loads(done.stdout)["records"]]
        assert would == [SCOPE, "TOOL_UNKNOWN"]
        # as the planner wrote them: nothing is rebuilt, nothing is kept back
        assert [call["arguments"] for call in house.calls()] == [
            {"destination": "Isolation Room"},
            {"destination": "Pharmacy"},
            {},
        ]


def test_a_gateway_in_shadow_mode_does_not_go_past_a_gate_that_enforces(house: DemoGateway) -> None:
    async def talk() -> None:
        async with house.talking(shadow=True):
            raise AssertionError("it goes past the gate")

    with pytest.raises(ExceptionGroup) as failed:
        run(talk)
    assert "the gate enforces" in str(first_of(failed.value))
    assert house.calls() == []


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (("--listen", "127.0.0.1:0"), "a port does not identify the caller"),
        (("--stop-call", "say={"), "expected JSON"),
        (("--stop-call", "=5"), "expected TOOL="),
        (("--stop-call", "say=5"), "expected TOOL="),
        (("--env", "NOBODY_SET_THIS"), "is not set here"),
    ],
)
def test_what_is_wrong_on_the_command_line_is_said_before_anything_starts(
    tmp_path: Path, more: tuple[str, ...], said: str
) -> None:
    words = ["mcp", "--robot", "courier-1", "--gate", str(tmp_path), *more]
    words += ["--site", str(scenarios.HOSPITAL / "site.yaml")]
    words += ["--binding", str(scenarios.HOSPITAL / "binding.yaml")]
    words += ["--trust", str(scenarios.trust_folder()), "--", "nothing"]
    code, out = called(words)
    assert code == 2
    assert said in out


def called(words: list[str]) -> tuple[int, str]:
    """Return the exit code of a command in this process, and what it printed to either end."""
    both = io.StringIO()
    with redirect_stdout(both), redirect_stderr(both):
        code = call(words)
    return code, both.getvalue()


def test_a_tool_that_only_changes_what_the_robot_believes_is_hidden() -> None:
    told = fate("relocalize", scenarios.binding(), scenarios.site())
    assert told.startswith("hidden: it writes the robot's state")


def test_in_shadow_mode_a_server_that_dies_is_told_as_it_is(tmp_path: Path) -> None:
    async def talk(house: DemoGateway) -> None:
        async with house.talking("dies", shadow=True) as client:
            assert not (await client.call_tool("scan", {})).is_error
            answer = await client.call_tool("scan", {})
            assert answer.is_error

    with own_house(tmp_path, mode=Mode.SHADOW) as house:
        run(lambda: talk(house))


def test_what_may_run_beside_is_called_while_the_robot_moves(tmp_path: Path) -> None:
    """Telemetry does not wait for a drive to end; a second drive does."""
    model = yaml.safe_load((scenarios.HOSPITAL / "site.yaml").read_text())
    model["vocabulary"]["scan_obstacles"]["beside"] = True
    site = tmp_path / "site.yaml"
    site.write_text(yaml.safe_dump(model))

    async def talk() -> None:
        async with house.talking("waits-to-drive") as client:
            drive = asyncio.ensure_future(
                client.call_tool("navigate_to", {"destination": "Pharmacy"})
            )
            async with asyncio.timeout(PATIENCE_S):
                while not house.calls():
                    await asyncio.sleep(0.01)
                seen = await client.call_tool("scan", {})
            assert (verdict(seen)["execution"], drive.done()) == ("succeeded", False)
            (house.folder / "go").touch()
            async with asyncio.timeout(PATIENCE_S):
                drove = verdict(await drive)
            made = [told["dispatched"]["tool"] for told in (drove, verdict(seen))]
            assert (drove["execution"], made) == ("succeeded", ["navigate_to", "scan"])

    with own_house(tmp_path, site=site) as house:
        run(talk)
    assert [call["tool"] for call in house.calls()] == ["navigate_to", "scan"]
