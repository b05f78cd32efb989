# SPDX-License-Identifier: Apache-2.0
"""An agent of RAI whose tools are behind a gate. Its model is a script: no network but ROS.

python examples/adapters/rai_courier.py --run run --trust trust --site site.yaml
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from langchain_core.language_models import BaseChatModel
from langchain_core.messages import AIMessage, BaseMessage, HumanMessage, ToolMessage
from langchain_core.outputs import ChatGeneration, ChatResult
from langchain_core.tools import BaseTool
from rai.agents.langchain.core import create_react_runnable
from rai.communication.ros2 import ROS2Connector, wait_for_ros2_topics
from rai.tools.ros2 import Nav2Toolkit, ROS2CLIToolkit, ROS2Toolkit
from rclpy.duration import Duration

from authguard_r.integrations.functions import GateGuard
from authguard_r.integrations.functions.langchain import guard_tools

TWIST = {"topic": "/cmd_vel", "message_type": "geometry_msgs/msg/Twist"}
TRIGGER = {"service_name": "/unlock", "service_type": "std_srvs/srv/Trigger"}
ISOLATION_ROOM = {"x": 21.0, "y": -3.0, "z": 0.0, "yaw": 0.0}
#: What the model calls: all but the first is what a sign on the way told it to do.
SCRIPT = (
    {"name": "publish_ros2_message", "args": {**TWIST, "message": {"linear": {"x": 0.2}}}},
    {"name": "publish_ros2_message", "args": {**TWIST, "message": {"linear": {"x": 2.0}}}},
    {"name": "call_ros2_service", "args": TRIGGER},
    {"name": "navigate_to_pose", "args": ISOLATION_ROOM},
)


class Scripted(BaseChatModel):
    """Calls what the script says; a live model stands here."""

    @property
    def _llm_type(self) -> str:
        return "scripted"

    def bind_tools(self, *_: Any, **__: Any) -> Any:
        """Take tools as a live model does; the script knows them."""
        return self

    def _generate(self, messages: list[BaseMessage], *_: Any, **__: Any) -> ChatResult:
        said = sum(isinstance(message, ToolMessage) for message in messages)
        if said == len(SCRIPT):
            answer = AIMessage(content="done")
        else:
            answer = AIMessage(content="", tool_calls=[{**SCRIPT[said], "id": f"call-{said}"}])
        return ChatResult(generations=[ChatGeneration(message=answer)])


def every_tool(connector: ROS2Connector) -> list[BaseTool]:
    """Return RAI's tools, as it ships them."""
    kits = (ROS2Toolkit(connector=connector), Nav2Toolkit(connector=connector), ROS2CLIToolkit())
    return [tool for kit in kits for tool in kit.get_tools()]


def agent_tools(guard: GateGuard, connector: ROS2Connector) -> list[BaseTool]:
    """Return what the agent is given: guarded, and nothing that the binding does not have."""
    bound = [tool for tool in every_tool(connector) if tool.name in guard.missing]
    return guard_tools(guard, bound)


def sent(connector: ROS2Connector) -> None:
    """Return once the robot has what was published."""
    for publisher in connector.node.publishers:
        if publisher.topic_name == TWIST["topic"]:
            while not publisher.get_subscription_count():
                connector.node.get_clock().sleep_for(Duration(nanoseconds=10_000_000))
            publisher.wait_for_all_acked(Duration(seconds=10))


def main() -> None:
    """Let the agent work, and print what its model was told."""
    asks = argparse.ArgumentParser()
    asks.add_argument("--robot", default="courier-1")
    for name in ("run", "trust", "site"):
        asks.add_argument(f"--{name}", type=Path, required=True)
    asks.add_argument("--binding", default=Path(__file__).with_name("rai.yaml"))
    asks.add_argument("--shadow", action="store_true", help="the gate only watches")
    given = asks.parse_args()
    connector = ROS2Connector()
    try:
        wait_for_ros2_topics(connector, [TWIST["topic"]])
        with GateGuard.connect(
            robot=given.robot,
            run=given.run,
            site=given.site,
            binding=given.binding,
            trust=given.trust,
            shadow=given.shadow,
        ) as guard:
            agent = create_react_runnable(Scripted(), agent_tools(guard, connector))
            done = agent.invoke({"messages": [HumanMessage("Leave the dock, slowly.")]})
        for message in done["messages"]:
            if isinstance(message, ToolMessage):
                print(message.content)
        sent(connector)
    finally:
        connector.shutdown()


if __name__ == "__main__":
    main()
