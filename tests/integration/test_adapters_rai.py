# SPDX-License-Identifier: Apache-2.0
"""The real RAI behind a gate: its agent and tools, its connector, rclpy, and a robot that listens.

RAI and rclpy are heavy, so they have an environment of their own, which `.ci/run` makes;
`AUTHGUARD_RAI` names its folder. tests/programs/without_ros_packages.py stands in for
packages that PyPI has no wheels of.
Source: lessons L1, L16; docs/spec/adapters.md
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from authguard_r.wire.messages import Mode
from fixtures import scenarios
from fixtures.gate_process import RunningGate, environment, until
from fixtures.guarded_tools import SCOPE
from fixtures.json_lines import whole_lines
from fixtures.packaged_robots import asked_in, gate_of, run_in

ENVIRONMENT = os.environ.get("AUTHGUARD_RAI", "")
pytestmark = pytest.mark.skipif(
    not ENVIRONMENT, reason="AUTHGUARD_RAI names no environment (.ci/run makes one)"
)
PYTHON = Path(ENVIRONMENT) / "bin" / "python"
TESTS = scenarios.ROOT / "tests"
ABSENT = TESTS / "programs" / "without_ros_packages.py"
FOLDER = scenarios.ROOT / "examples" / "adapters"
BINDING = FOLDER / "rai.yaml"
SLOWLY: dict[str, Any] = {
    "id": "leave-dock",
    "type": "drive",
    "tool": "base",
    "rows": [{"source": "dock", "regions": ["dock"]}],
    "limits": {
        "linear_mm_s": ["0 m/s", "0.3 m/s"],
        "lateral_mm_s": ["0 m/s", "0 m/s"],
        "turn_urad_s": ["0 rad/s", "0.5 rad/s"],
        "duration_ms": ["0.5 s", "0.5 s"],
    },
}
#: What arrives of the example's script without a gate.
SLOW, FAST = ({"topic": "/cmd_vel", "x": x, "turn": 0.0} for x in (0.2, 2.0))


@pytest.fixture
def gate(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[RunningGate]:
    more: dict[str, Any] = {"mode": getattr(request, "param", Mode.ENFORCE)}
    with gate_of(tmp_path, BINDING, tools={"drive": ["base"]}, grants=[SLOWLY], **more) as made:
        yield made


@pytest.fixture
def ros() -> dict[str, str]:
    """Return the variables of a ROS that is this test's own."""
    domain = str(os.getpid() % 101 + 1)
    return {"ROS_DOMAIN_ID": domain, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


@pytest.fixture
def arrived(tmp_path: Path, ros: dict[str, str]) -> Iterator[Path]:
    """Let a robot listen; yield the file of what arrives."""
    file = tmp_path / "arrived.jsonl"
    file.touch()
    words = [PYTHON, TESTS / "programs" / "ros_robot.py", file]
    env = {**environment(measured=False), **ros}
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=env) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            yield file
        finally:
            process.terminate()
            try:
                process.wait(5)
            except subprocess.TimeoutExpired:  # rclpy does not always let its process end
                process.kill()


def lines(file: Path) -> list[dict[str, Any]]:
    return whole_lines(file.read_bytes())


def options(gate: RunningGate) -> list[object]:
    given = {"robot": gate.rid, "run": gate.run, "trust": gate.trust, "site": gate.site}
    return [word for name, value in given.items() for word in (f"--{name}", value)]


def test_a_granted_twist_reaches_the_robot_and_no_hijack_does(
    gate: RunningGate, arrived: Path, ros: dict[str, str]
) -> None:
    done = run_in(PYTHON, ABSENT, FOLDER / "rai_courier.py", *options(gate), variables=ros)
    assert done.returncode == 0, done.stderr
    until(lambda: lines(arrived), "the arrival")
    told = done.stdout.splitlines()
    assert lines(arrived) == [SLOW]
    assert told[0] == "Message published successfully"
    # state of after the first motion may be on its way when the next call is refused
    reasons = [line for line in told if line.startswith("refused: ")]
    assert [line.replace(", STATE_BEFORE_MOTION", "") for line in reasons] == [
        "refused: PARAMETER_OUT_OF_BOUNDS",
        "refused: STATE_WRITING_REFUSED",
        f"refused: {SCOPE}, APPROVAL_REQUIRED",
    ]


@pytest.mark.parametrize("gate", [Mode.SHADOW], indirect=True)
def test_in_shadow_mode_they_reach_the_robot_and_the_gate_says_what_it_would_refuse(
    gate: RunningGate, arrived: Path, ros: dict[str, str]
) -> None:
    words = (FOLDER / "rai_courier.py", *options(gate), "--shadow")
    done = run_in(PYTHON, ABSENT, *words, variables=ros)
    assert done.returncode == 0, done.stderr
    # RAI's publisher keeps one message: FAST may replace SLOW before the robot reads it
    until(lambda: {"service": "/unlock"} in lines(arrived), f"unlocking, after {done.stdout}")
    until(lambda: FAST in lines(arrived), f"the fast motion, after {done.stdout}")
    for reason in ("PARAMETER_OUT_OF_BOUNDS", "STATE_WRITING_REFUSED", SCOPE):
        until(lambda reason=reason: gate.refusals(reason), "the gate's own answer")


UNGUARDED = """
import rai_courier as m
connector = m.ROS2Connector()
m.wait_for_ros2_topics(connector, ["/cmd_vel"])
tools = {tool.name: tool for tool in m.every_tool(connector)}
for call in m.SCRIPT[:3]:
    tools[call["name"]].invoke(call["args"])
    m.sent(connector)
connector.shutdown()
"""


def test_the_same_calls_without_a_gate_reach_the_robot(
    tmp_path: Path, arrived: Path, ros: dict[str, str]
) -> None:
    """The comparison can fail: RAI itself holds none of them back."""
    program = tmp_path / "unguarded.py"
    program.write_text(f"import sys\nsys.path.insert(0, {str(FOLDER)!r})\n{UNGUARDED}")
    done = run_in(PYTHON, ABSENT, program, variables=ros)
    assert done.returncode == 0, done.stderr
    reached = until(lambda: len(found := lines(arrived)) > 2 and found, "the arrivals")
    assert all(line in reached for line in (SLOW, FAST, {"service": "/unlock"}))


def test_l1_every_tool_of_rai_is_guarded_or_refused_and_its_agent_has_no_other(
    gate: RunningGate, ros: dict[str, str]
) -> None:
    """All 24 of this version's ROS 2 tool kits; another version has to be looked at anew."""
    words = [ABSENT, TESTS / "programs" / "list_robot_tools.py", "rai_courier", *options(gate)]
    told = asked_in(PYTHON, *words, "--binding", BINDING, variables=ros)
    assert len(told["guarded"]) + len(told["refused"]) == 24
    assert set(told["refused"].values()) == {"TOOL_UNKNOWN"}
    assert told["given"] == told["guarded"]
    # command lines of any kind are nobody's
    assert {f"ros2_{of}" for of in ("action", "service", "node", "param", "topic")} <= set(
        told["refused"]
    )
