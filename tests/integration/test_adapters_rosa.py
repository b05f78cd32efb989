# SPDX-License-Identifier: Apache-2.0
"""The real ROSA behind a gate: its agent, its tools, and the `ros2` that they would run.

ROSA is of another LangChain than ours, so it has an environment of its own, which `.ci/run` makes;
`AUTHGUARD_ROSA` names its folder. `ros2` is a program that writes down what it was asked: what is
not there has not reached the robot. Source: lessons L1, L16; docs/spec/adapters.md
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from authguard_r.normalize.shipped import binding_source
from authguard_r.wire.messages import Mode
from fixtures import scenarios
from fixtures.gate_process import RunningGate, until
from fixtures.packaged_robots import asked_in, gate_of, run_in

ENVIRONMENT = os.environ.get("AUTHGUARD_ROSA", "")
pytestmark = pytest.mark.skipif(
    not ENVIRONMENT, reason="AUTHGUARD_ROSA names no environment (.ci/run makes one)"
)
PYTHON = Path(ENVIRONMENT) / "bin" / "python"
EXAMPLE = scenarios.ROOT / "examples" / "adapters" / "rosa_courier.py"
GRANTS = (
    {"id": "list", "type": "read_metadata", "tool": "ros2_node_list", "rows": [{}]},
    {"id": "ask", "type": "describe", "tool": "ros2_node_info", "rows": [{"object": "lidar"}]},
)
#: What the example's script would have ROS do; the fourth came by its shell.
EVERYTHING = [
    "node list",
    "param set /base max_speed 9",
    "node info /lidar",
    "topic pub /cmd_vel",
    "node info /lidar",
]
ROS2 = """#!/bin/sh
echo "$*" >> "$ARRIVED"
echo /lidar
"""


@pytest.fixture
def gate(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[RunningGate]:
    tools = {"read_metadata": ["ros2_node_list"], "describe": ["ros2_node_info"]}
    more: dict[str, Any] = {"mode": getattr(request, "param", Mode.ENFORCE)}
    with gate_of(
        tmp_path, "rosa", tools=tools, objects={"lidar": ["/lidar"]}, grants=GRANTS, **more
    ) as made:
        yield made


@pytest.fixture
def robot(tmp_path: Path) -> dict[str, str]:
    """Return the variables of a process whose `ros2` leaves what it was asked in a file."""
    program, arrived = tmp_path / "bin" / "ros2", tmp_path / "arrived"
    program.parent.mkdir()
    program.write_text(ROS2)
    program.chmod(0o755)
    arrived.touch()
    return {"PATH": f"{program.parent}:{os.environ['PATH']}", "ARRIVED": str(arrived)}


def options(gate: RunningGate) -> list[object]:
    given = {"robot": gate.rid, "run": gate.run, "trust": gate.trust, "site": gate.site}
    return [word for name, value in given.items() for word in (f"--{name}", value)]


def test_what_is_granted_reaches_ros_and_neither_a_hijack_nor_a_shell_does(
    gate: RunningGate, robot: dict[str, str]
) -> None:
    done = run_in(PYTHON, EXAMPLE, *options(gate), variables=robot)
    assert done.returncode == 0, done.stderr
    # the third call of the script would have run a second command in ROSA's shell
    assert Path(robot["ARRIVED"]).read_text().splitlines() == ["node list", "node info /lidar"]
    told = done.stdout.splitlines()
    assert "/lidar" in told[0]
    assert "/lidar" in told[-1]
    reasons = [line for line in told if line.startswith("refused: ")]
    assert reasons == ["refused: STATE_WRITING_REFUSED", "refused: NAME_UNKNOWN"]


@pytest.mark.parametrize("gate", [Mode.SHADOW], indirect=True)
def test_in_shadow_mode_all_of_them_reach_ros_and_the_gate_says_what_it_would_refuse(
    gate: RunningGate, robot: dict[str, str]
) -> None:
    done = run_in(PYTHON, EXAMPLE, *options(gate), "--shadow", variables=robot)
    assert done.returncode == 0, done.stderr
    assert Path(robot["ARRIVED"]).read_text().splitlines() == EVERYTHING
    for reason in ("STATE_WRITING_REFUSED", "NAME_UNKNOWN"):
        until(lambda reason=reason: gate.refusals(reason), "the gate's own answer")


def test_the_same_calls_without_a_gate_all_reach_ros(robot: dict[str, str]) -> None:
    """The comparison can fail: ROSA itself holds none of them back."""
    calls = "[t.invoke(c['args']) for c in m.SCRIPT for t in tools if t.name == c['name']]"
    words = f"""
import sys; sys.path.insert(0, {str(EXAMPLE.parent)!r})
import rosa_courier as m
tools = m.ROSATools(ros_version=2).get_tools()
{calls}"""
    done = run_in(PYTHON, "-c", words, variables=robot)
    assert done.returncode == 0, done.stderr
    assert Path(robot["ARRIVED"]).read_text().splitlines() == EVERYTHING


def test_l1_every_tool_of_rosa_is_guarded_or_refused_and_its_agent_has_no_other(
    gate: RunningGate,
) -> None:
    """All 47 of this version; another version has to be looked at anew."""
    words = [
        scenarios.ROOT / "tests" / "programs" / "list_robot_tools.py",
        "rosa_courier",
        *options(gate),
    ]
    told = asked_in(PYTHON, *words, "--binding", "rosa")
    assert len(told["guarded"]) + len(told["refused"]) == 47
    assert set(told["guarded"]) <= set(binding_source("rosa")["tools"])
    assert not set(told["refused"]) & set(binding_source("rosa")["tools"])
    assert set(told["refused"].values()) == {"TOOL_UNKNOWN"}
    assert told["given"] == told["guarded"]
