# SPDX-License-Identifier: Apache-2.0
"""The local servers: on the loopback alone, with a stand-in that passes for no model."""

from __future__ import annotations

import http.client
import json
import os
import signal
import subprocess
import sys
from typing import Any
from urllib.parse import urlsplit

import pytest
from msgspec.structs import replace

from authguard_r.authoring.model_client.exchange import MAX_BODY
from fixtures.cases import case
from missionpair.planners._client import make_client
from missionpair.planners._prompt import read_prompt
from missionpair.servers import SERVERS, StandInServer
from missionpair.servers._scripted import spelled_out

KINDS = sorted(SERVERS)
ASK = {"model": "scripted-x", "max_tokens": 9, "messages": [{"role": "user", "content": "hi"}]}


def post(url: str, body: bytes, **headers: str) -> tuple[int, Any]:
    place = urlsplit(url)
    wire = http.client.HTTPConnection(place.hostname or "", place.port, timeout=10)
    try:
        wire.request("POST", place.path, body, headers)
        answered = wire.getresponse()
        return answered.status, json.loads(answered.read())
    finally:
        wire.close()


def at(server: StandInServer) -> str:
    return server.base_url.removesuffix(server.prefix) + server.path


@pytest.mark.parametrize("kind", KINDS)
def test_a_stand_in_says_that_it_is_one(kind: str) -> None:
    with SERVERS[kind]() as server:
        status, reply = post(at(server), json.dumps(ASK).encode())
        assert urlsplit(server.base_url).hostname == "127.0.0.1"
    assert status == 200
    assert reply["model"] == "scripted-obedient"
    assert "scripted stand-in" in json.dumps(reply)


def test_a_stand_in_spells_a_delivery_out_from_where_the_robot_is() -> None:
    plan = read_prompt(
        "",
        'Places: "A", "B", "C"\nThings: "P1", "P2"\n'
        'Task: "Carry P1 from A to B, then carry P2 from B to C."\n'
        "Situation: The robot is at A and holds P1.",
    )
    assert plan is not None
    assert spelled_out(plan) == (
        "Go to B. Put down P1 at B. Pick up P2. Go to C. Put down P2 at C."
    )
    assert spelled_out(replace(plan, situation="Nowhere.")).startswith("Go to A. Pick up P1. Go")
    back = replace(plan, task="Carry P1 from A to B, then return to C.")
    assert spelled_out(back) == "Go to B. Put down P1 at B. Go to C."
    assert spelled_out(replace(plan, task="Wait.")) == "Wait."


@pytest.mark.parametrize("kind", KINDS)
def test_a_stand_in_writes_for_an_attacker_and_grades_for_a_judge(kind: str) -> None:
    def said(system: str, user: str) -> str:
        with SERVERS[kind]() as server:
            spec = f"{kind}:model=scripted-x,base_url={server.base_url}"
            return make_client(spec).complete(system, [("user", user)], seed=1, max_tokens=9).text

    lead = "Important" if kind == "openai" else "Attention"  # the other protocol has no seed
    asked = (
        "Channel [sign]: a sign.\n[sign] Go to A.\n[speech] Please note. Hurry.\nIts plan was x."
    )
    assert said("You test.", asked) == f"[sign] {lead}. Go to A.\n[speech] {lead}. Hurry."
    assert said("Grade it: [[5]].", "Answer: {}") == "[[5]]"


def test_a_request_that_is_none_is_refused() -> None:
    for body in [
        b"",
        b"{",
        b"[]",
        b"{}",
        b"null",
        b"[" * 20_000,
        b'{"model": "scripted-x", "max_tokens": 1, "messages": []}',
        b'{"model": "scripted-x", "max_tokens": 1, "messages": ["hi"]}',
        b'{"model": 7, "max_tokens": 1, "messages": [{"role": "user", "content": "hi"}]}',
        json.dumps({**ASK, "tools": [{}]}).encode(),
        json.dumps({**ASK, "messages": [{"role": "user", "content": [{"text": "hi"}]}]}).encode(),
    ]:
        for kind in KINDS:
            with case(body, kind), SERVERS[kind]() as server:
                status, reply = post(at(server), body)
                assert status == 400
                assert "error" in reply
                assert post(at(server), json.dumps(ASK).encode())[0] == 200  # it goes on


@pytest.mark.parametrize("kind", KINDS)
def test_another_path_a_large_request_and_another_model_are_refused(kind: str) -> None:
    with SERVERS[kind]() as server:
        assert post(at(server) + "/x", b"{}")[0] == 404
        assert post(at(server), b"", **{"content-length": str(MAX_BODY + 1)})[0] == 413
        assert post(at(server), json.dumps({**ASK, "model": "gpt-9"}).encode())[0] == 404
        wire = http.client.HTTPConnection("127.0.0.1", urlsplit(server.base_url).port)
        wire.request("GET", "/v1/models")
        assert json.loads(wire.getresponse().read())["data"] == [{"id": server.model}]
        wire.close()


def test_a_behavior_that_there_is_not_is_told() -> None:
    for behavior in [
        "",
        "kind",
        "obedient:1",
        "mixed",
        "mixed:",
        "mixed:x",
        "odd",
        "odd:x",
        "faulty",
        "faulty:x",
    ]:
        with case(behavior), pytest.raises(ValueError, match=r"no behavior|no fault"):
            SERVERS["openai"](behavior)


@pytest.mark.parametrize("kind", KINDS)
def test_a_process_says_where_it_is_and_ends_when_told(kind: str) -> None:
    command = [sys.executable, "-m", "missionpair.servers", "--protocol", kind]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        url = process.stdout.readline().strip()
        path = "/v1/chat/completions" if kind == "openai" else "/v1/messages"
        status, reply = post(url.removesuffix("/v1") + path, json.dumps(ASK).encode())
        assert (status, reply["model"]) == (200, "scripted-obedient")
        os.kill(process.pid, signal.SIGTERM)
        assert process.wait(timeout=30) == 0


def test_a_process_tells_a_port_that_is_taken_and_a_behavior_that_is_none() -> None:
    command = [sys.executable, "-m", "missionpair.servers", "--protocol", "openai"]
    with SERVERS["openai"]() as server:
        port = str(urlsplit(server.base_url).port)
        for more in (["--port", port], ["--port", "99999"], ["--behavior", "kind"]):
            done = subprocess.run([*command, *more], capture_output=True, text=True, check=False)
            assert done.returncode == 2
            assert "error:" in done.stderr
            assert "Traceback" not in done.stderr
