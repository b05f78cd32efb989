# SPDX-License-Identifier: Apache-2.0
"""A form in a planner's client only asks: what counts is what approvers have signed.

Real gate, real client of the protocol in both eras; the person behind the form is a callback.
Source: lesson L5; docs/spec/mcp.md#approvals
"""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mcp_types as types
import pytest
from mcp import Client, StdioServerParameters, stdio_client

from authguard_r.core.approval import ApprovalVerdict
from authguard_r.integrations.mcp import asking as gateway_asking
from authguard_r.integrations.mcp.process import Gateway, GatewaySetup
from authguard_r.keys.signer import folder_signer
from authguard_r.keys.trust import read_trust
from authguard_r.wire.messages import ClientRole
from fixtures import approvals, scenarios
from fixtures.gate_process import RunningGate, authguard, environment
from fixtures.shared_gate import SharedGate

ERAS = ("legacy", "auto")
SERVER = scenarios.ROOT / "tests" / "programs" / "courier_mcp_server.py"
CALL = ("navigate_to", {"destination": "Isolation Room", "speed": 0.8})
#: What a person does when the form is shown, and what is answered there.
Person = Callable[[], str]


class AskingSetup:
    """A gate whose mission asks a second person before the isolation room."""

    def __init__(self, gate: RunningGate, calls: Path, name: str) -> None:
        self.gate, self.calls, self.name = gate, calls, name
        self.shown: list[str] = []

    def reached(self) -> int:
        return len(self.calls.read_text().splitlines())

    def approve(self) -> str:
        """Sign every open request as the supervisor, at a console of her own."""
        with self.gate.client(ClientRole.OPERATOR, "console") as console:
            for question in console.approvals():
                key = folder_signer(scenarios.trust_folder(), "supervisor-1")
                console.answer(question, ApprovalVerdict.APPROVE, key)
        return "accept"

    def ask(
        self, era: str, person: Person | None, *calls: Any, key: str = "", process: bool = False
    ) -> list[types.CallToolResult]:
        """Return what a client is answered whose person does so; the gateway may be a process."""

        async def shown(_context: Any, params: Any) -> types.ElicitResult:
            self.shown.append(params.message)
            assert person is not None
            said = await asyncio.to_thread(person)
            return types.ElicitResult(action=said, content={})  # type: ignore[arg-type]

        async def talk(end: Any) -> list[types.CallToolResult]:
            form = None if person is None else shown
            async with Client(end, mode=era, elicitation_callback=form) as client:
                meta = {"authguard-r/key": key} if key else None
                return [await client.call_tool(*call, meta=meta) for call in calls or (CALL,)]

        async def talk_here() -> list[types.CallToolResult]:
            async with Gateway(self._setup()).running() as front:
                return await talk(front.server)

        return asyncio.run(talk(self._started()) if process else talk_here())

    def _setup(self) -> GatewaySetup:
        gate = self.gate
        return GatewaySetup(
            robot=gate.rid,
            run=gate.run,
            site=scenarios.site(),
            binding=scenarios.binding(),
            trust=lambda: read_trust(gate.trust),
            client=self.name,
            server=(sys.executable, str(SERVER), str(self.calls)),
        )

    def _started(self) -> Any:
        gate = self.gate
        words = ["mcp", "--robot", gate.rid, "--gate", gate.run, "--site", gate.site]
        words += ["--binding", gate.binding, "--trust", gate.trust, "--client", self.name]
        command, *words = authguard(*words, "--", sys.executable, SERVER, self.calls)
        env = environment(measured=False)
        return stdio_client(StdioServerParameters(command=command, args=words, env=env))


@pytest.fixture(scope="module")
def shared() -> Iterator[SharedGate]:
    with SharedGate() as made:
        yield made


@pytest.fixture
def house(shared: SharedGate, tmp_path: Path) -> Iterator[AskingSetup]:
    calls = tmp_path / "calls.jsonl"
    calls.touch()
    with shared.one_test() as gate:
        gate.activate(gate.token(approvals.at_gate(gate)))
        yield AskingSetup(gate, calls, shared.name)


def outcome(answer: types.CallToolResult) -> Any:
    return (answer.structured_content or {}).get("authguard-r", {}).get("outcome")


@pytest.mark.parametrize("era", ERAS)
def test_a_person_is_asked_and_signed_approvals_let_the_call_through(
    house: AskingSetup, era: str
) -> None:
    (answer,) = house.ask(era, house.approve, process=True)
    assert not answer.is_error
    (message,) = house.shown
    assert "needs 2 approvals" in message
    assert "accepting approves nothing" in message
    assert house.reached() == 1


@pytest.mark.parametrize("era", ERAS)
@pytest.mark.parametrize("said", ["accept", "decline"])
def test_l5_a_yes_without_a_signature_moves_nothing(
    house: AskingSetup, era: str, said: str
) -> None:
    (answer,) = house.ask(era, lambda: said)
    assert answer.is_error
    assert len(house.shown) == 1  # and is not asked for ever
    assert house.reached() == 0


@pytest.mark.parametrize("era", ERAS)
def test_a_client_that_shows_no_forms_is_told(house: AskingSetup, era: str) -> None:
    (answer,) = house.ask(era, None)
    assert answer.is_error
    assert outcome(answer) == "request_approval"
    assert house.reached() == 0


@pytest.mark.parametrize("era", ERAS)
def test_what_is_refused_outright_is_nothing_to_ask_a_person(house: AskingSetup, era: str) -> None:
    (answer,) = house.ask(era, house.approve, ("navigate_to", {"destination": "Office 1"}))
    assert outcome(answer) == "reject"
    assert house.shown == []


def test_a_person_who_does_not_answer_is_not_waited_for_for_ever(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Session:
        """A client's end that never answers."""

        async def elicit_form(self, *words: Any, **more: Any) -> None:
            await asyncio.sleep(3_600)

    class Context:
        session = Session()
        request_id = 1

    monkeypatch.setattr(gateway_asking, "PERSON_S", 0.05)
    assert not asyncio.run(gateway_asking.asked_to_go_on(Context(), "navigate_to", 2))


@pytest.mark.parametrize("era", ERAS)
def test_a_call_that_has_a_name_is_proposed_anew_once_it_was_approved(
    house: AskingSetup, era: str
) -> None:
    """The name stands for what became of it first; what a person was asked for is another."""
    (answer,) = house.ask(era, house.approve, CALL, key="go-1")
    assert not answer.is_error
    assert json.loads(house.calls.read_text())["tool"] == "navigate_to"
