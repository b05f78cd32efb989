# SPDX-License-Identifier: Apache-2.0
"""The real ros-mcp behind the gateway: what the mission grants arrives, a hijack never does.

ros-mcp pins other versions of what we use, so it has an environment of its own, which `.ci/run`
makes; `AUTHGUARD_ROS_MCP` names its folder. Source: lessons L1, L16; docs/spec/mcp.md
"""

from __future__ import annotations

import asyncio
import fcntl
import json
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path
from tempfile import gettempdir
from typing import Any

import mcp_types as types
import pytest
import yaml
from mcp import Client, StdioServerParameters, stdio_client

from authguard_r.normalize.shipped import binding_source
from fixtures import scenarios
from fixtures.estimator import attesting
from fixtures.gate_process import AUTHGUARD, RunningGate
from fixtures.json_lines import whole_lines

ENVIRONMENT = os.environ.get("AUTHGUARD_ROS_MCP", "")
pytestmark = pytest.mark.skipif(
    not ENVIRONMENT,
    reason="AUTHGUARD_ROS_MCP names no environment (.ci/run makes one)",
)
BIN = Path(ENVIRONMENT) / "bin"
NAVIGATE = "nav2_msgs/action/NavigateToPose"
SERVER = ("ros-mcp", "--transport", "stdio")


@pytest.fixture
def arrived(tmp_path: Path) -> Iterator[Path]:
    """Serve a rosbridge where ros-mcp looks for one; yield the file of what arrives.

    Its port is always the same one: tests that run side by side wait for each other.
    """
    file = tmp_path / "arrived.jsonl"
    file.touch()
    words = [BIN / "python", scenarios.ROOT / "tests" / "programs" / "rosbridge_server.py", file]
    with (Path(gettempdir()) / "authguard-rosbridge.lock").open("w") as turn:
        fcntl.flock(turn, fcntl.LOCK_EX)
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
            try:
                assert process.stdout is not None
                assert process.stdout.readline() == "9090\n"
                yield file
            finally:
                process.terminate()


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """The hospital, in the standard words that the shipped binding speaks."""
    plain = yaml.safe_load((scenarios.HOSPITAL / "site.yaml").read_text())
    del plain["vocabulary"]
    path = tmp_path / "site.yaml"
    path.write_text(yaml.safe_dump({**plain, "words": "standard"}))
    return path


@pytest.fixture
def gate(site: Path) -> Iterator[RunningGate]:
    """A gate of the hospital's robot, whose tools are ros-mcp's."""
    made = RunningGate(site=site, binding=Path("ros-mcp"))
    with made, attesting(made):
        made.activate()
        yield made


def goal(x: float, y: float, **more: Any) -> dict[str, Any]:
    position = {"position": {"x": x, "y": y, "z": 0}, "orientation": {"w": 1}}
    pose = {"header": {"frame_id": "main"}, "pose": position}
    named = {"action_name": "/navigate_to_pose", "action_type": NAVIGATE}
    return {**named, "goal": {"pose": pose, **more}}


def asked(
    gate: RunningGate, *calls: tuple[str, dict[str, Any]]
) -> tuple[list[str], list[types.CallToolResult]]:
    """Return the tools that a client is shown, and what it is answered to each call."""
    words = ["mcp", "--robot", gate.rid, "--gate", gate.run, "--site", gate.site]
    words += ["--binding", "ros-mcp", "--trust", gate.trust, "--", BIN / SERVER[0], *SERVER[1:]]
    server = StdioServerParameters(command=str(AUTHGUARD), args=[str(word) for word in words])

    async def talk() -> tuple[list[str], list[types.CallToolResult]]:
        async with Client(stdio_client(server)) as client:
            tools = [tool.name for tool in (await client.list_tools()).tools]
            return tools, [await client.call_tool(*call) for call in calls]

    return asyncio.run(talk())


def moved(arrived: Path) -> list[dict[str, Any]]:
    """Return what reached the robot but for questions about itself."""
    lines = whole_lines(arrived.read_bytes())
    return [line for line in lines if not line.get("service", "").startswith("/rosapi/")]


def test_a_granted_goal_arrives_and_a_hijacked_one_never_reaches_the_socket(
    gate: RunningGate, arrived: Path
) -> None:
    twist = {
        "topic": "/cmd_vel",
        "msg_type": "geometry_msgs/msg/Twist",
        "msg": {"linear": {"x": 1}},
    }
    hijacks = [
        ("send_action_goal", goal(21.0, -3.0)),  # the isolation room
        ("send_action_goal", goal(4.0, 5.0, behavior_tree="/tmp/evil.xml")),
        ("publish_once", twist),
        ("connect_to_robot", {"ip": "192.0.2.7"}),
        ("set_parameter", {"name": "/controller:max_speed", "value": "9"}),
        ("call_service", {"service_name": "/x", "service_type": "std_srvs/srv/Trigger"}),
        ("view_saved_image", {"image_path": "/etc/passwd"}),
    ]
    tools, (went, *refused) = asked(gate, ("send_action_goal", goal(4.0, 5.0)), *hijacks)
    assert not went.is_error
    assert went.structured_content["success"] is True
    assert all(answer.is_error for answer in refused)
    (reached,) = moved(arrived)
    # rebuilt: the halting place of the region, and nothing of the planner's own
    assert reached["args"]["pose"]["pose"]["position"] == {"x": 4, "y": 5, "z": 0}
    assert reached["args"]["behavior_tree"] == ""
    hidden = {"connect_to_robot", "set_parameter", "call_service", "view_saved_image"}
    assert not hidden & set(tools)


def test_l1_every_tool_of_the_server_is_bound_and_no_more_is_there(
    site: Path, arrived: Path
) -> None:
    """All 31 of this version; another version has to be looked at anew."""
    words = ["advanced", "mcp-tools", "--binding", "ros-mcp", "--json", "--site", str(site), "--"]
    words += [str(BIN / SERVER[0]), *SERVER[1:]]
    done = subprocess.run([AUTHGUARD, *words], capture_output=True, text=True, check=False)
    told = json.loads(done.stdout)
    assert (done.returncode, told["missing"], len(told["tools"])) == (0, [], 31)
    assert set(told["tools"]) == set(binding_source("ros-mcp")["tools"])
    assert moved(arrived) == []
