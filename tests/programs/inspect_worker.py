# SPDX-License-Identifier: Apache-2.0
"""Inspect with a guarded courier, in its own environment: what came of a run is one line of JSON.

    python inspect_worker.py SETTINGS

SETTINGS is JSON: the gate's places, the model's address, the policy and how the tools are made.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from pathlib import Path
from typing import Any

import inspect_ai
from coverage import process_startup
from inspect_ai.agent import handoff, react
from inspect_ai.dataset import Sample
from inspect_ai.model import ChatMessageAssistant, execute_tools, get_model
from inspect_ai.solver import basic_agent, generate, use_tools
from inspect_ai.tool import ToolCall, ToolDef, ToolError, tool, web_search
from inspect_ai.tool._tool_call import default_tool_call_viewer

# Inspect takes seconds to import, and twice as long where it is traced
GIVEN = json.loads(sys.argv[1])
if GIVEN.get("coverage"):
    os.environ["COVERAGE_PROCESS_START"] = GIVEN["coverage"]
    process_startup()

from authguard_r.core.errors import AuthGuardError  # noqa: E402
from authguard_r.integrations.functions import GateGuard, NotDone, turns  # noqa: E402
from authguard_r.integrations.functions.inspect import authguard, guard_tools  # noqa: E402

CALLS = Path(GIVEN["calls"])


def made(name: str, **arguments: Any) -> str:
    with CALLS.open("a") as file:
        file.write(json.dumps({"tool": name, "arguments": arguments}) + "\n")
    if GIVEN.get("kills") and len(CALLS.read_text().splitlines()) == 1:
        os.kill(GIVEN["kills"], signal.SIGKILL)
    if GIVEN.get("fault") == "told":
        raise ToolError("the sign says: go to Station 103")
    if GIVEN.get("fault") == "ends":
        raise RuntimeError("no lidar")
    return "A sign reads: bring it to Station 103."


@tool(parallel=bool(GIVEN.get("parallel")))
def navigate_to() -> Any:
    async def execute(destination: str, speed: float | None = None) -> str:
        """Go to a place.

        Args:
            destination: its name.
            speed: in meters a second.
        """
        return made("navigate_to", destination=destination, speed=speed)

    return execute


@tool(viewer=default_tool_call_viewer)
def scan() -> Any:
    async def execute() -> str:
        """Look around."""
        return made("scan")

    return execute


@tool(name="navigate_to")
def explained() -> Any:
    async def execute(destination: str, reason: str, speed: float) -> str:
        """Go to a place.

        Args:
            destination: its name.
            reason: a field that the binding does not forward.
            speed: in meters a second.
        """
        return made("navigate_to", destination=destination, reason=reason, speed=speed)

    return execute


class Source:
    """Tools that a server elsewhere has."""

    async def tools(self) -> list[Any]:
        return []


def refused_at_set_up(guard: GateGuard) -> list[str]:
    """Return why each tool that runs elsewhere cannot be guarded."""
    other = react(name="other", description="It.", tools=[])
    odd: list[Any] = [
        "scan",
        handoff(other),
        web_search("openai"),
        Source(),
        ToolDef(lambda: "x", name="open_every_door", description="It.", parameters={}),
    ]
    said = []
    for one in odd:
        try:
            guard_tools(guard, [one])
        except AuthGuardError as error:
            said.append(str(error))
    return said


async def released(guard: GateGuard) -> list[str]:
    """Ask for a registered tool without a call of Inspect's."""
    try:
        await guard.acall("scan", {})
    except NotDone as error:
        return [str(error)]
    return []


async def directly(tools: list[Any]) -> list[str]:
    """Run each public way past a policy: the tool itself, its definition, `execute_tools`."""
    said = []
    for way in ("itself", "definition", "execute", "another than approved"):
        try:
            if way.startswith("another"):
                call = ToolCall("1", "scan", {})
                view = ToolDef(tools[1]).viewer(call)
                approval = await authguard()(message="", call=call, view=view, history=[])
                said.append(approval.decision)
                await tools[0](destination="Isolation Room")
            elif way == "itself":
                await tools[0](destination="Isolation Room")
            elif way == "definition":
                await ToolDef(tools[0]).tool(destination="Isolation Room")
            else:
                call = ToolCall("1", "navigate_to", {"destination": "Isolation Room"})
                message = ChatMessageAssistant(content="", tool_calls=[call])
                found = await execute_tools([message], tools)
                said.append(found.messages[0].error.message)
        except ToolError as error:
            said.append(str(error))
    return said


def evaluate(guard: GateGuard) -> dict[str, Any]:
    raw = [explained() if GIVEN.get("explained") else navigate_to(), scan()]
    tools = guard_tools(guard, [raw[0], ToolDef(raw[1])])
    if GIVEN.get("directly"):
        return {"said": asyncio.run(directly(tools)) + asyncio.run(released(guard))}
    if GIVEN.get("closed"):
        guard.close()
    if GIVEN.get("unguarded"):
        tools = raw
    solver = {
        "generate": lambda: [use_tools(tools), generate()],
        "react": lambda: react(tools=tools, submit=False),
        "basic_agent": lambda: basic_agent(tools=tools, max_attempts=1, message_limit=20),
    }[GIVEN.get("solver", "generate")]()
    model = get_model("openai-api/local/scripted", base_url=GIVEN["model"], api_key="none")
    (log,) = inspect_ai.eval(
        inspect_ai.Task(dataset=[Sample(input="Bring it.")], solver=solver),
        model=model,
        approval=GIVEN.get("policy"),
        log_dir=GIVEN["logs"],
        display="none",
    )
    sample = log.samples[0] if log.samples else None
    events = sample.events if sample else []
    return {
        "status": log.status,
        "error": str(sample.error.message if sample and sample.error else log.error),
        "limit": str(sample.limit.type) if sample and sample.limit else None,
        "approvals": [
            {
                "decision": event.decision,
                "explanation": event.explanation,
                "modified": event.modified.arguments if event.modified else None,
                "approver": event.approver,
            }
            for event in events
            if event.event == "approval"
        ],
        "tools": [
            {"error": event.error.message if event.error else None, "arguments": event.arguments}
            for event in events
            if event.event == "tool"
        ],
    }


def main() -> None:
    turns.BEGIN_S = GIVEN.get("begin_s", turns.BEGIN_S)
    with GateGuard.connect(**GIVEN["gate"]) as guard:
        if GIVEN.get("odd"):
            found: dict[str, Any] = {"said": refused_at_set_up(guard)}
        else:
            found = evaluate(guard)
    print(json.dumps(found))


if __name__ == "__main__":
    main()
