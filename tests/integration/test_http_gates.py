# SPDX-License-Identifier: Apache-2.0
"""Decision points whose gates come, go, carry out, ask people or only watch.

Source: docs/spec/http.md
"""

from __future__ import annotations

import asyncio
import os
import signal
import time
from collections.abc import Iterator
from typing import Any

import httpx2
import pytest

from authguard_r.cli import call
from authguard_r.core.mission import Mission
from authguard_r.integrations.http.reading import plan_of
from authguard_r.wire.messages import ClientRole, Mode
from fixtures import scenarios
from fixtures.decision_point import (
    BEARER,
    EVALUATION,
    EVALUATIONS,
    GRANTED,
    HIJACKED,
    Served,
    question,
    serving,
    starts,
)
from fixtures.gate_process import PATIENCE_S, RunningGate, until
from fixtures.shared_gate import SharedGate

SCOPE = "DESTINATION_OUT_OF_SCOPE"
SCAN = {"tool": "scan", "arguments": {}}
INTO_ISOLATION = {
    "source": "dock",
    "destination": "isolation-room",
    "regions": ["dock", "isolation-room", "public-corridor"],
}
ELSEWHERE = question("navigate_to", scenarios.OTHER, destination="Pharmacy")


@pytest.fixture(scope="module")
def shared() -> Iterator[SharedGate]:
    with SharedGate(simulate=True) as made:
        yield made


def own_gate(**given: Any) -> RunningGate:
    """Return a gate that no other test has; it may run beside the shared one."""
    return RunningGate(trust=scenarios.second_trust_folder(), **given)


def test_a_gate_that_is_away_is_no_permit_and_comes_back() -> None:
    with own_gate(simulate=True) as gate:
        gate.activate()
        with serving(gate) as served:
            until(lambda: served.post(EVALUATION, GRANTED).json()["decision"], "the mission")
            os.kill(gate.pid, signal.SIGSTOP)  # it hangs
            assert served.post(EVALUATION, GRANTED).status_code == 503
            os.kill(gate.pid, signal.SIGCONT)
            until(lambda: served.post(EVALUATION, GRANTED).status_code == 200, "the gate again")
            gate.kill9()
            answer = served.post(EVALUATION, GRANTED)
            assert (answer.status_code, answer.headers["retry-after"]) == (503, "1")
            assert answer.json()["code"] == "SERVICE_UNAVAILABLE"
            several = {"evaluations": [GRANTED, ELSEWHERE]}
            first, second = served.post(EVALUATIONS, several).json()["evaluations"]
            assert (first["decision"], first["context"]["error"]["status"]) == (False, 503)
            assert second["context"]["reasons"] == ["ROBOT_MISMATCH"]
            assert served.post(EVALUATIONS, GRANTED).status_code == 503
            assert served.get("/v1/status").status_code == 503
            for path in gate.folder.glob("robot.db*"):
                path.unlink()
            gate.start_gate()
            gate.activate()
            until(lambda: served.post(EVALUATION, GRANTED).json()["decision"], "the gate again")


def test_without_a_mission_nothing_is_permitted() -> None:
    with own_gate(simulate=True) as gate, serving(gate) as served:
        said = served.post(EVALUATION, GRANTED).json()
        assert (said["decision"], said["context"]["reasons"]) == (False, ["NO_ACTIVE_MISSION"])
        assert served.get("/v1/mission").json()["mission"] is None


def test_a_simulated_robot_is_where_it_is_while_nobody_proposes(shared: SharedGate) -> None:
    """A what-if takes in the newest state, as a decision does."""
    with shared.one_test() as gate:
        gate.activate()
        with serving(gate) as served:
            until(lambda: served.post(EVALUATION, GRANTED).json()["decision"], "the mission")
            time.sleep(1.5)  # a position is too old after a second
            assert served.post(EVALUATION, GRANTED).json()["decision"] is True


def test_a_server_may_be_there_before_its_gate() -> None:
    with own_gate(simulate=True) as gate:
        gate.stop_process("gate")
        with serving(gate) as served:
            assert served.post(EVALUATION, GRANTED).status_code == 503
            gate.start_gate()
            answer = until(lambda: served.post(EVALUATION, GRANTED), "an answer")
            until(lambda: served.post(EVALUATION, GRANTED).status_code == 200, "the gate")
            assert answer.status_code in {200, 503}


def propose(served: Served, body: Any, *keys: str) -> httpx2.Response:
    headers = [("idempotency-key", key) for key in keys]
    with served.client() as client:
        return client.post("/v1/proposals", json=body, headers=headers)


def test_what_is_carried_out_counts_and_is_carried_out_once(shared: SharedGate) -> None:
    with shared.one_test() as gate:
        gate.activate()
        with serving(gate, "--propose") as served:
            until(lambda: served.post(EVALUATION, GRANTED).json()["decision"], "the mission")
            told = [propose(served, SCAN, "scan-1").json() for _ in range(2)]
            assert [answer["repeated"] for answer in told] == [False, True]
            for answer in told:
                assert answer["decision"] is answer["executed"] is True
                assert answer["execution"]["outcome"] == "succeeded"
                assert answer["context"]["authoritative"] is answer["context"]["consumes"] is True
            assert sum(starts(gate)) == 1
            other = {"tool": "navigate_to", "arguments": {"destination": "Isolation Room"}}
            reused = propose(served, other, "scan-1")
            assert (reused.status_code, reused.json()["code"]) == (409, "KEY_REUSED")
            refused = propose(served, other, "go-1").json()
            assert (refused["decision"], refused["context"]["consumes"]) == (False, False)
            assert refused["context"]["reasons"][0] == SCOPE
            unknown = propose(served, {"tool": "open_every_door"}, "door-1").json()
            assert unknown["context"]["reasons"] == ["TOOL_UNKNOWN"]
            for keys in ((), ("a", "b"), ("no spaces",), ("x" * 65,), ("",)):
                answer = propose(served, SCAN, *keys)
                assert (answer.status_code, answer.json()["where"]) == (400, "idempotency-key")
            assert sum(starts(gate)) == 1
            assert "/v1/proposals" in served.get("/openapi.json").json()["paths"]


def test_a_second_proposal_is_not_kept_waiting() -> None:
    """Whoever gave up waiting would have it carried out all the same."""
    with own_gate(robot=True, estimator=True) as gate:
        gate.activate()
        with serving(gate, "--propose") as served:
            until(lambda: served.post(EVALUATION, GRANTED).json()["decision"], "the mission")
            go = {"tool": "navigate_to", "arguments": {"destination": "Pharmacy"}}

            async def talk() -> tuple[httpx2.Response, httpx2.Response]:
                async with httpx2.AsyncClient(
                    base_url=served.url, headers=BEARER, timeout=PATIENCE_S
                ) as client:
                    first = asyncio.ensure_future(
                        client.post("/v1/proposals", json=go, headers={"idempotency-key": "a"})
                    )
                    while not (await client.get("/v1/status")).json()["leases"]:
                        await asyncio.sleep(0.02)
                    second = await client.post(
                        "/v1/proposals", json=SCAN, headers={"idempotency-key": "b"}
                    )
                    with gate.client(ClientRole.OPERATOR, "stops"):
                        stopping = asyncio.to_thread(call, ["stop", "--gate", str(gate.run)])
                        assert await stopping == 0
                    return await first, second

            first, second = asyncio.run(talk())
            assert (second.status_code, second.json()["code"]) == (503, "BUSY")
            assert first.json()["decision"] is True
            assert first.json()["execution"]["outcome"] == "aborted"
            assert sum(starts(gate)) == 1


def asks(gate: RunningGate) -> Mission:
    """Return the shipped mission with a way into the isolation room, which asks a second person."""
    grants = [
        {**grant, "rows": [INTO_ISOLATION], "repeat": 5, "starts": 5, "until": []}
        if grant["id"] == "go-to-pharmacy"
        else grant
        for grant in scenarios.draft()["grants"]
    ]
    return gate.mission(grants=grants, limits={})


def test_open_approval_requests_are_shown_and_cannot_be_answered_here(shared: SharedGate) -> None:
    with shared.one_test() as gate:
        gate.activate(gate.token(asks(gate)))
        planner = gate.client(ClientRole.PLANNER, shared.name)
        with serving(gate) as served:
            wanted = question("navigate_to", destination="Isolation Room", speed=0.8)

            def said() -> Any:
                return served.post(EVALUATION, wanted).json()["context"]

            until(lambda: said()["outcome"] == "request_approval", "the mission's first second")
            answer = served.post(EVALUATION, wanted).json()
            assert (answer["decision"], answer["context"]["required_approvals"]) == (False, 2)
            assert answer["context"]["retryable"] is True
            assert served.get("/v1/approvals").json() == []  # a question asks nobody
            plan = plan_of("navigate_to", wanted["action"]["properties"])
            assert (
                planner.propose(plan, dialect="json")["steps"][-1]["outcome"] == "request_approval"
            )
            (open_one,) = served.get("/v1/approvals").json()
            one = served.get(f"/v1/approvals/{open_one['counter']}").json()
            assert (one["grant"], one["scope"]) == (open_one["grant"], open_one["scope"])
            assert served.post(f"/v1/approvals/{open_one['counter']}", {}).status_code == 405


def test_in_shadow_mode_everything_goes_on_and_is_noted(capsys: Any) -> None:
    with own_gate(mode=Mode.SHADOW, simulate=True) as gate:
        gate.activate()
        with serving(gate, "--shadow") as served:
            would = lambda: served.post(EVALUATION, question("scan")).json()["context"]["would"]  # noqa: E731
            until(would, "the mission's first second")
            answer = served.post(EVALUATION, HIJACKED).json()
            assert answer["decision"] is True
            said = answer["context"]
            assert (said["shadow"], said["would"], said["authoritative"]) == (True, False, False)
            assert said["reasons"][0] == SCOPE
            unknown = served.post(EVALUATION, question("open_every_door")).json()
            assert (unknown["decision"], unknown["context"]["would"]) == (True, False)
            # another robot's call is noted nowhere, so nothing goes past this gate
            assert served.post(EVALUATION, ELSEWHERE).json()["decision"] is False
            gate.stop_process("gate")
            assert served.post(EVALUATION, GRANTED).status_code == 503
        capsys.readouterr()
        assert call(["audit", "show", str(gate.store), "--would-refuse", "--json"]) == 0
        assert SCOPE in capsys.readouterr().out
