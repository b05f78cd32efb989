# SPDX-License-Identifier: Apache-2.0
"""What stands before every request: faults are said, and what is too much is refused."""

from __future__ import annotations

import asyncio
import json
import socket
from pathlib import Path
from typing import Any

import pytest

from authguard_r.client.link import ProcessLog
from authguard_r.client.reconnecting import GatePlace
from authguard_r.core.identifiers import Identifier
from authguard_r.integrations.http import gate_connection
from authguard_r.integrations.http.app import _as
from authguard_r.integrations.http.clients import Authenticator
from authguard_r.integrations.http.edge import Edge
from authguard_r.integrations.http.gate_connection import AwayError, GateLink
from authguard_r.integrations.http.messages import StatusMessage
from authguard_r.integrations.http_listener.access import listening
from authguard_r.keys.trust import read_trust
from authguard_r.wire.json_log import Lines
from authguard_r.wire.messages import ClientRole
from fixtures import scenarios

TOKEN = b"t" * 40
SCOPE = {
    "type": "http",
    "method": "GET",
    "raw_path": b"/v1/status",
    "query_string": b"",
    "headers": [(b"authorization", b"Bearer " + TOKEN)],
}


def answered(app: Any) -> list[dict[str, Any]]:
    """Return what is sent of an application's answer."""
    sent: list[dict[str, Any]] = []

    async def send(message: Any) -> None:
        sent.append(message)

    asyncio.run(Edge(app, Authenticator(TOKEN, None), None, Lines(2))(dict(SCOPE), None, send))  # type: ignore[arg-type]
    return sent


async def broken(scope: Any, receive: Any, send: Any) -> None:
    raise ZeroDivisionError("the planner's own words")


async def begun(scope: Any, receive: Any, send: Any) -> None:
    await send({"type": "http.response.start", "status": 200, "headers": []})
    raise ZeroDivisionError


def test_a_fault_of_ours_is_said_without_what_it_holds(capfd: Any) -> None:
    start, body = answered(broken)
    assert start["status"] == 500
    assert json.loads(body["body"])["code"] == "INTERNAL_FAULT"
    assert b"words" not in body["body"]
    line = json.loads(capfd.readouterr().err)
    assert (line["status"], line["code"]) == (500, "INTERNAL_FAULT")


def test_an_answer_that_has_begun_is_not_begun_again(capfd: Any) -> None:
    assert [message["type"] for message in answered(begun)] == ["http.response.start"]
    line = json.loads(capfd.readouterr().err)
    assert (line["status"], line["code"]) == (200, "INTERNAL_FAULT")


def test_what_the_gate_says_in_another_shape_is_no_answer() -> None:
    with pytest.raises(AwayError) as away:
        _as({"robot": "courier-1"}, StatusMessage)
    assert away.value.fault.reason == "INTERNAL_FAULT"


def test_nobody_waits_for_a_turn_for_ever(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gate_connection, "WAIT_S", 0.01)
    monkeypatch.setattr(gate_connection, "AT_ONCE", 0)
    where = GatePlace(
        robot=scenarios.RID,
        run=tmp_path,
        trust=lambda: read_trust(scenarios.trust_folder()),
        client=Identifier("http"),
    )
    with pytest.raises(AwayError) as away:
        asyncio.run(
            GateLink(where, ClientRole.OPERATOR, ProcessLog()).ask(lambda gate: gate.status())
        )
    assert away.value.fault.reason == "BUSY"


def test_answers_are_not_held_back_for_a_fuller_packet() -> None:
    """asyncio turns Nagle's algorithm off for sockets that say that they are of TCP, no others."""
    with listening("127.0.0.1:0") as made, socket.create_connection(made.getsockname()):
        taken, _ = made.accept()
        with taken:
            assert taken.proto == socket.IPPROTO_TCP
