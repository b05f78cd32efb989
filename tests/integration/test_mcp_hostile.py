# SPDX-License-Identifier: Apache-2.0
"""A tools' server and a planner's client that mean harm: a gateway's process goes on beside both.

Everything here is a process of its own, the gateway too: one that hangs must not hang its test.
Source: docs/spec/mcp.md
"""

from __future__ import annotations

import json
import subprocess
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx2
import pytest

from authguard_r.client import GateClient
from authguard_r.integrations.mcp.pins import pins_bytes, pins_of
from authguard_r.integrations.mcp.standard import MAX_MESSAGE
from authguard_r.wire.messages import ClientRole
from fixtures.gate_process import PATIENCE_S, environment, until
from fixtures.guarded_tools import often
from fixtures.shared_gate import SharedGate
from integration.test_mcp_gateway import HELLO, DemoGateway, Served, answers, odd, over_http
from programs import courier_mcp_server

#: What a gateway may need for a server that floods it, in KiB; a flood has twice as much.
ROOM_KIB = 32 << 10
ACCEPT = "application/json, text/event-stream"
BOTH = ("stdio", "http")
SCAN = {"name": "scan", "arguments": {}}


@pytest.fixture(scope="module")
def shared() -> Iterator[SharedGate]:
    with SharedGate() as made:
        yield made


@pytest.fixture
def house(shared: SharedGate, tmp_path: Path) -> Iterator[DemoGateway]:
    with shared.one_test() as gate:
        gate.activate(often(gate, count=100))
        yield DemoGateway(gate, tmp_path, shared.name)


def message(number: Any, method: str, params: Any = None) -> bytes:
    asked = {"jsonrpc": "2.0", "id": number, "method": method, "params": params or {}}
    return json.dumps(asked).encode()


def canceled(number: int) -> bytes:
    told = {"jsonrpc": "2.0", "method": "notifications/cancelled", "params": {"requestId": number}}
    return json.dumps(told).encode()


def verdict(answer: dict[str, Any]) -> dict[str, Any]:
    """Return what the gate said: beside an answer, or in the place of one."""
    result = answer["result"]
    beside: dict[str, Any] = result.get("_meta", {}).get("authguard-r", {})
    return beside or dict(result.get("structuredContent", {}).get("authguard-r", {}))


class Piped:
    """A client on a gateway's standard input and output; what comes is read as it comes.

    Args:
        words: the gateway's command.
    """

    def __init__(self, words: list[str]) -> None:
        self.told: list[dict[str, Any]] = []
        self.errors: list[str] = []
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(
            words, stdin=pipe, stdout=pipe, stderr=pipe, env=environment(measured=False)
        )
        self._readers = [threading.Thread(target=one) for one in (self._hear, self._note)]
        for reader in self._readers:
            reader.start()
        self.answer(message(0, "initialize", HELLO))

    def say(self, line: bytes) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(line + b"\n")
        self.process.stdin.flush()

    def answer(self, line: bytes) -> dict[str, Any]:
        """Return what comes next, once this was said."""
        before = len(self.told)
        self.say(line)
        until(lambda: len(self.told) > before, "an answer")
        return self.told[before]

    def to(self, number: Any) -> dict[str, Any]:
        """Return the answer to a request."""
        found: dict[str, Any] = until(
            lambda: next((one for one in self.told if one.get("id") == number), None),
            f"the answer to {number}",
        )
        return found

    def events(self) -> list[str]:
        """Return what the log said of the tools' server."""
        lines = [json.loads(line) for line in self.errors if line.startswith('{"event"')]
        return [line["event"] for line in lines if line["channel"] == "upstream"]

    def leave(self) -> int:
        """Close the input, as a client that ends; return the gateway's exit code."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        return self.process.wait(PATIENCE_S)

    def end(self) -> None:
        with self.process, suppress(OSError):
            try:
                self.leave()
            finally:
                self.process.kill()
                for reader in self._readers:
                    reader.join()

    def _hear(self) -> None:
        assert self.process.stdout is not None
        self.told.extend(map(json.loads, self.process.stdout))

    def _note(self) -> None:
        assert self.process.stderr is not None
        self.errors.extend(line.decode() for line in self.process.stderr)


@contextmanager
def piped(
    house: DemoGateway, *faults: str, server: tuple[str, ...] = (), **more: Any
) -> Iterator[Piped]:
    """Yield a client of a gateway; another server than the courier's may be behind it."""
    words = house.words(*faults, **more)
    client = Piped([*words[: words.index("--") + 1], *server] if server else words)
    try:
        yield client
    finally:
        client.end()


class Session:
    """A session over HTTP, request by request.

    Args:
        url: the gateway's.
        token: is shown.
    """

    def __init__(self, url: str, token: str) -> None:
        self.place = url, token
        self._http = httpx2.Client(timeout=PATIENCE_S)
        self._shown = {"authorization": f"Bearer {token}", "accept": ACCEPT}
        self._shown["content-type"] = "application/json"
        begun = self.post(message(0, "initialize", HELLO))
        assert begun.status_code == 200
        self._shown["mcp-session-id"] = begun.headers["mcp-session-id"]

    def post(self, body: bytes) -> httpx2.Response:
        return self._http.post(self.place[0], content=body, headers=self._shown)

    def answer(self, body: bytes) -> dict[str, Any]:
        """Return the message that answers."""
        text = self.post(body).text
        parts = [part for part in text.splitlines() if part.startswith("data: {")]
        (line,) = parts or [text]
        found: dict[str, Any] = json.loads(line.removeprefix("data: "))
        return found

    def end(self) -> None:
        self._http.close()


@contextmanager
def sessions(house: DemoGateway, count: int, *faults: str) -> Iterator[list[Session]]:
    """Yield so many sessions of one gateway."""
    with over_http(house, *faults) as (url, token):
        until(lambda: answers(url), "the port")
        made = [Session(url, token) for _ in range(count)]
        yield made
        for session in made:
            session.end()


def peak_kib(pid: int) -> int:
    """Return the most memory that a process has held."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    (line,) = [line for line in lines if line.startswith("VmHWM:")]
    return int(line.split()[1])


# a server's patterns


@pytest.mark.smoke
def test_a_pattern_that_takes_hours_holds_neither_a_call_nor_a_stop(house: DemoGateway) -> None:
    """The server wrote the schema and the answer: held to it, the gateway would hear no stop."""
    with piped(house, "pattern") as client:
        answer = client.answer(message(1, "tools/call", SCAN))
        assert answer["result"]["structuredContent"] == {"note": courier_mcp_server.SLOW}
        assert verdict(answer)["execution"] == "succeeded"
        client.say(message(2, "tools/call", SCAN))
        until(lambda: len(house.calls()) > 1, "the call")
        with GateClient.connect(house.gate.stop_socket, role=ClientRole.OPERATOR) as lane:
            assert lane.stop("someone is in the way")["stopped"]
        assert verdict(client.to(2))["execution"] in {"succeeded", "aborted"}


def test_a_server_that_changes_the_schema_of_its_answers_is_not_used(
    house: DemoGateway, monkeypatch: pytest.MonkeyPatch
) -> None:
    pins = house.folder / "pins.json"
    monkeypatch.setattr(courier_mcp_server, "FAULTS", frozenset({"pattern"}))
    pins.write_bytes(pins_bytes(pins_of(map(courier_mcp_server.tool, courier_mcp_server.FIELDS))))
    with piped(house, "pattern", more=("--pins", str(pins))) as client:
        assert verdict(client.answer(message(1, "tools/call", SCAN)))["execution"] == "succeeded"
    words, errors = house.words("pattern-2", more=("--pins", str(pins))), house.folder / "errors"
    pipe = subprocess.PIPE  # nobody is answered before the server is in use
    with (
        errors.open("w") as said,
        subprocess.Popen(words, stdin=pipe, stdout=pipe, stderr=said) as process,
    ):
        try:
            until(lambda: '"event": "changed"' in errors.read_text(), "the sight of the change")
        finally:
            process.terminate()
    assert '"connected", "channel": "upstream"' not in errors.read_text()
    assert len(house.calls()) == 1


# answers without an end


def test_a_line_without_an_end_is_not_kept(house: DemoGateway) -> None:
    """64 MiB come: nobody knows what became of the call, and the server is started anew."""
    marker = house.folder / "flooded"
    with piped(house, server=(*odd("flood"), str(marker))) as client:
        before = peak_kib(client.process.pid)
        answer = client.answer(message(1, "tools/call", SCAN))
        assert verdict(answer)["execution"] == "unknown"
        until(lambda: client.events().count("connected") > 1, "its coming back")
        assert peak_kib(client.process.pid) - before < ROOM_KIB
        assert "cut" in client.events()
    assert marker.exists()


@pytest.mark.parametrize("fault", ["endless", "packed"])
def test_a_body_without_an_end_is_not_kept_and_a_packed_one_not_read(
    house: DemoGateway, fault: str
) -> None:
    """Packed, 64 MiB are as short as an answer may be."""
    served = Served(house.folder, fault)
    try:
        with piped(house, server=(served.url,)) as client:
            before = peak_kib(client.process.pid)
            answer = client.answer(message(1, "tools/call", SCAN))
            assert verdict(answer)["execution"] == "unknown"
            until(lambda: client.events().count("connected") > 1, "its coming back")
            assert peak_kib(client.process.pid) - before < ROOM_KIB
    finally:
        served.end()
    assert house.calls() == [{"tool": "scan"}]


@pytest.mark.parametrize(
    ("kind", "outcome"),
    [
        ("deep", "succeeded"),
        ("infinite", "succeeded"),
        ("deeper", "unknown"),
        ("surrogate", "unknown"),
        ("nothing", "unknown"),
    ],
)
def test_an_answer_that_is_odd_is_told_at_once(house: DemoGateway, kind: str, outcome: str) -> None:
    """Not when the lease is over: a fault on the way would leave the call without an end."""
    with piped(house, server=odd(kind)) as client:
        answer = client.answer(message(1, "tools/call", SCAN))
        assert verdict(answer)["execution"] == outcome


# calls that are canceled


@pytest.mark.smoke
def test_calls_after_a_canceled_one_wait_and_are_not_refused(house: DemoGateway) -> None:
    """Canceled, it still runs: the gate has not answered, and takes one proposal of a client."""
    numbers = range(1, 16)
    with piped(house, "waits") as client:
        for number in numbers:
            client.say(message(number, "tools/call", SCAN))
        until(house.calls, "the first call")
        client.say(canceled(1))
        assert client.answer(message(16, "ping"))["id"] == 16
        told = [one["id"] for one in client.told if "result" in one]
        assert told == [0, 16]
        (house.folder / "go").touch()
        found = [verdict(client.to(number)) for number in numbers[1:]]
    assert [one.get("execution") for one in found] == ["succeeded"] * 14
    assert len(house.calls()) == 15


def test_over_http_a_canceled_call_gets_nobody_refused(house: DemoGateway) -> None:
    """Neither its own session nor another: they are one planner to the gate."""
    calls = [message(number, "tools/call", SCAN) for number in range(1, 16)]
    with sessions(house, 2, "waits") as (one, other), ThreadPoolExecutor(20) as pool:
        first = pool.submit(one.post, calls[0])
        until(house.calls, "the first call")
        going = [pool.submit(one.answer, call) for call in calls[1:]]
        going += [pool.submit(other.answer, call) for call in calls[:3]]
        assert one.post(canceled(1)).status_code == 202
        assert other.answer(message(16, "ping"))["id"] == 16
        assert not any(answer.done() for answer in going)
        (house.folder / "go").touch()
        found = [verdict(answer.result(PATIENCE_S)) for answer in going]
        first.result(PATIENCE_S)
    assert [one.get("execution") for one in found] == ["succeeded"] * 17
    assert len(house.calls()) == 18


def test_a_client_that_leaves_with_calls_in_the_queue_leaves_no_doubt(house: DemoGateway) -> None:
    """What runs and moves nothing may end, and the gate hears how; what waits is never called."""
    with piped(house, "waits") as client:
        for number in range(1, 6):
            client.say(message(number, "tools/call", SCAN))
        until(house.calls, "the first call")
        assert client.process.stdin is not None
        client.process.stdin.close()
        threading.Timer(0.3, (house.folder / "go").touch).start()
        assert client.process.wait(PATIENCE_S) == 0
    operator = house.gate.client(ClientRole.OPERATOR)
    (outcome,) = [record for record in house.gate.news() if record.kind == "outcome"]
    assert outcome.reasons == []
    assert len(house.calls()) == 1
    with piped(house) as client:  # the gate has missed its controller by then
        assert operator.status()["mission"]["status"] == "active"
        assert verdict(client.answer(message(1, "tools/call", SCAN)))["execution"] == "succeeded"


# sessions


def test_a_burst_of_sessions_ends_the_idlest_and_keeps_none_out(house: DemoGateway) -> None:
    """Whoever has the token may begin as many as he likes: who asks goes on."""
    with sessions(house, 2) as (used, idle):
        url, token = used.place
        for _ in range(6):
            assert "tools" in used.answer(message(1, "tools/list"))["result"]
            with ThreadPoolExecutor(8) as pool:
                for made in pool.map(lambda _: Session(url, token), range(30)):
                    made.end()
        assert "tools" in used.answer(message(2, "tools/list"))["result"]
        assert idle.post(message(1, "tools/list")).status_code == 404
        assert not used.answer(message(3, "tools/call", SCAN))["result"].get("isError")


# what a client sends


def nested(depth: int) -> str:
    return "[" * depth + "]" * depth


def call_of(number: int, arguments: str, more: str = "") -> bytes:
    params = f'{{"name":"scan","arguments":{arguments}}}'
    head = f'{{"jsonrpc":"2.0","id":{number},"method":"tools/call"'
    return f'{head},"params":{params}{more}}}'.encode()


#: Each with the code of the protocol's error, or None for an answer that is a tool's error.
REQUESTS: dict[str, tuple[bytes, int | None]] = {
    "deep": (call_of(1, f'{{"a":{nested(40)}}}'), None),
    "deeper than is read": (call_of(1, f'{{"a":{nested(5_000)}}}'), -32700),
    "a surrogate": (call_of(1, '{"a":"\\ud800"}'), None),
    "a surrogate as a tool": (message(1, "tools/call", {"name": "\ud800"}), -32600),
    "a surrogate as id": (message("\ud800", "tools/call", SCAN), -32600),
    "a surrogate as method": (message(1, "\udfff"), -32600),
    "no text": (b'{"jsonrpc":"2.0","id":1,"method":"\xff\xfe"}', -32601),
    "no id": (message(None, "tools/call", SCAN), -32600),
    "a fraction as id": (message(1.5, "tools/call", SCAN), -32600),
    "a truth as id": (message(True, "tools/call", SCAN), -32600),
    "a list as id": (message([1], "tools/call", SCAN), -32600),
    "a batch": (b"[" + message(1, "ping") + b"," + message(2, "ping") + b"]", -32600),
    "an empty batch": (b"[]", -32600),
    "no JSON": (b"this is no JSON", -32700),
    "half of one": (message(1, "ping")[:-2], -32700),
    "a number": (b"5", -32600),
    "no message": (b"{}", -32600),
    "a list as params": (message(1, "tools/call", [1]), -32600),
    "a number as a tool": (message(1, "tools/call", {"name": 5}), -32602),
    "a number as arguments": (message(1, "tools/call", {"name": "scan", "arguments": 5}), -32602),
}


def require_answered(name: str, answer: dict[str, Any], wanted: int | None) -> None:
    if wanted is None:
        assert answer["result"]["isError"], name
        assert verdict(answer)["outcome"] == "reject", name
    else:
        assert answer["error"]["code"] == wanted, name


@pytest.mark.smoke
def test_whatever_a_client_sends_is_answered_over_a_pipe(house: DemoGateway) -> None:
    with piped(house) as client:
        for name, (sent, wanted) in REQUESTS.items():
            require_answered(name, client.answer(sent), wanted)
        assert client.answer(b"x" * (MAX_MESSAGE + 2))["error"]["code"] == -32700
        long = message(1, "tools/call", {**SCAN, "arguments": {"a": "x" * MAX_MESSAGE}})
        assert client.answer(long)["error"]["code"] == -32700
        assert verdict(client.answer(message(99, "tools/call", SCAN)))["execution"] == "succeeded"
    assert [call["tool"] for call in house.calls()] == ["scan"]


def test_whatever_a_client_sends_is_answered_over_http(house: DemoGateway) -> None:
    with sessions(house, 1) as (client,):
        for name, (sent, wanted) in REQUESTS.items():
            require_answered(name, client.answer(sent), wanted)
        assert client.post(b"x" * (MAX_MESSAGE + 2)).status_code == 413
        assert verdict(client.answer(message(99, "tools/call", SCAN)))["execution"] == "succeeded"
    assert [call["tool"] for call in house.calls()] == ["scan"]


@pytest.mark.parametrize("way", BOTH)
def test_no_depth_is_deep_enough_to_leave_a_call_without_an_answer(
    house: DemoGateway, way: str
) -> None:
    """What is just read may be just too deep to be written again."""
    depths = range(900, 1_010)
    with piped(house) if way == "stdio" else sessions(house, 1) as made:
        client = made if isinstance(made, Piped) else made[0]
        for depth in depths:
            answer = client.answer(call_of(depth, "{}", f',"more":{nested(depth)}'))
            assert "error" in answer or answer["result"]["isError"], depth
        assert verdict(client.answer(message(1, "tools/call", SCAN)))["execution"] == "succeeded"
