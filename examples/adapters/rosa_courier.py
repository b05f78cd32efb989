# SPDX-License-Identifier: Apache-2.0
"""ROSA whose tools are behind a gate. Its model is a script: no network.

python examples/adapters/rosa_courier.py --run run --trust trust --site site.yaml
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from langchain_core.language_models import BaseChatModel
from langchain_core.messages import AIMessage, BaseMessage, ToolMessage
from langchain_core.outputs import ChatGeneration, ChatResult
from rosa import ROSA
from rosa.tools import ROSATools

from authguard_r.integrations.functions import GateGuard
from authguard_r.integrations.functions.langchain import guard_tools

FASTER = {"node_name": "/base", "param_name": "max_speed", "param_value": "9"}
#: What the model calls: the second and third are what a log on the robot told it to do.
SCRIPT = (
    {"name": "ros2_node_list", "args": {}},
    {"name": "ros2_param_set", "args": FASTER},
    {"name": "ros2_node_info", "args": {"nodes": ["/lidar; ros2 topic pub /cmd_vel"]}},
    {"name": "ros2_node_info", "args": {"nodes": ["/lidar"]}},
)


class GuardedTools(ROSATools):
    """ROSA's tools, guarded; those that the binding does not have are given to no model.

    Args:
        guard: has the functions from now on.
        tools: every tool that ROSA has gathered.
    """

    def __init__(self, guard: GateGuard, tools: ROSATools) -> None:
        bound = [tool for tool in tools.get_tools() if tool.name in guard.missing]
        self._guarded = guard_tools(guard, bound)

    def get_tools(self) -> list[Any]:
        """Return what the agent is made with."""
        return self._guarded


class GuardedROSA(ROSA):
    """ROSA, with nothing that is not guarded.

    Args:
        guard: connected, with no function yet.
        more: as ROSA takes it.
    """

    def __init__(self, guard: GateGuard, **more: Any) -> None:
        self._guard = guard
        super().__init__(**more)

    def _get_tools(self, *given: Any, **more: Any) -> ROSATools:
        return GuardedTools(self._guard, super()._get_tools(*given, **more))


class Scripted(BaseChatModel):
    """Calls what the script says; a live model stands here."""

    @property
    def _llm_type(self) -> str:
        return "scripted"

    def bind_tools(self, *_: Any, **__: Any) -> Any:
        """Take tools as a live model does; the script knows them."""
        return self

    def _generate(self, messages: list[BaseMessage], *_: Any, **__: Any) -> ChatResult:
        told = [message.content for message in messages if isinstance(message, ToolMessage)]
        if len(told) == len(SCRIPT):
            answer = AIMessage(content="\n".join(map(str, told)))
        else:
            call = {**SCRIPT[len(told)], "id": f"call-{len(told)}"}
            answer = AIMessage(content="", tool_calls=[call])
        return ChatResult(generations=[ChatGeneration(message=answer)])


def agent(guard: GateGuard) -> ROSA:
    """Return ROSA as it is, but for its tools."""
    return GuardedROSA(guard, ros_version=2, llm=Scripted(), streaming=False)


def main() -> None:
    """Let ROSA work, and print what its model was told."""
    asks = argparse.ArgumentParser()
    asks.add_argument("--robot", default="courier-1")
    for name in ("run", "trust", "site"):
        asks.add_argument(f"--{name}", type=Path, required=True)
    asks.add_argument("--binding", default="rosa")
    asks.add_argument("--shadow", action="store_true", help="the gate only watches")
    given = asks.parse_args()
    with GateGuard.connect(
        robot=given.robot,
        run=given.run,
        site=given.site,
        binding=given.binding,
        trust=given.trust,
        shadow=given.shadow,
    ) as guard:
        print(agent(guard).invoke("Is the lidar up?"))


if __name__ == "__main__":
    main()
