# SPDX-License-Identifier: Apache-2.0
"""A LangGraph agent whose tools are behind a gate. Its model is a script: no network.

python examples/adapters/langgraph_courier.py --robot courier-1 --run run --trust trust --out f
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from langchain_core.messages import AIMessage, HumanMessage
from langchain_core.tools import BaseTool, tool
from langgraph.graph import END, START, MessagesState, StateGraph
from langgraph.prebuilt import ToolNode

from authguard_r.integrations.functions import GateGuard
from authguard_r.integrations.functions.langchain import guard_tools

HOSPITAL = Path(__file__).resolve().parent.parent / "hospital"
#: What the model calls: the second is what a sign on the way told it to do.
SCRIPT = (
    {"name": "scan", "args": {}},
    {"name": "navigate_to", "args": {"destination": "Isolation Room"}},
    {"name": "navigate_to", "args": {"destination": "Pharmacy"}},
)


def tools(out: Path) -> list[BaseTool]:
    """Return the courier's tools, as its vendor ships them."""

    @tool
    def navigate_to(destination: str, speed: float = 0.5) -> str:
        """Drive to a place, at most so fast (m/s)."""
        with out.open("a") as file:
            file.write(f"navigate_to {destination} {speed}\n")
        return f"arrived at {destination}"

    @tool
    def scan() -> str:
        """Look for obstacles."""
        with out.open("a") as file:
            file.write("scan\n")
        return "nothing in the way"

    return [navigate_to, scan]


def model(state: MessagesState) -> dict[str, Any]:
    """Say the next line of the script; a live model stands here with `bind_tools`."""
    said = sum(isinstance(message, AIMessage) for message in state["messages"])
    if said == len(SCRIPT):
        return {"messages": [AIMessage(content="done")]}
    call = {**SCRIPT[said], "id": f"call-{said}"}
    return {"messages": [AIMessage(content="", tool_calls=[call])]}


def agent(guarded: list[BaseTool]) -> Any:
    """Return the graph of model and tools."""
    graph = StateGraph(MessagesState)
    graph.add_node("model", model)
    graph.add_node("tools", ToolNode(guarded))
    graph.add_edge(START, "model")
    graph.add_conditional_edges(
        "model", lambda state: "tools" if state["messages"][-1].tool_calls else END
    )
    graph.add_edge("tools", "model")
    return graph.compile()


def main() -> None:
    """Let the agent work, and print what was said."""
    asks = argparse.ArgumentParser()
    asks.add_argument("--robot", default="courier-1")
    for name in ("run", "trust", "out"):
        asks.add_argument(f"--{name}", type=Path, required=True)
    asks.add_argument("--site", type=Path, default=HOSPITAL / "site.yaml")
    asks.add_argument("--binding", type=Path, default=HOSPITAL / "binding.yaml")
    given = asks.parse_args()
    with GateGuard.connect(
        robot=given.robot,
        run=given.run,
        site=given.site,
        binding=given.binding,
        trust=given.trust,
    ) as guard:
        graph = agent(guard_tools(guard, tools(given.out)))
        done = graph.invoke({"messages": [HumanMessage("Bring the package to station 101.")]})
    for message in done["messages"]:
        print(f"{message.type}: {message.content}")


if __name__ == "__main__":
    main()
