# SPDX-License-Identifier: Apache-2.0
"""What a planner asks of a robot's ROS graph is decided first, and told as it was.

Real nodes, a real gate, and the node between them as a process. Source: issue 9, "Mediation".
Spec page: docs/spec/ros.md
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from tempfile import mkdtemp

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 (.ci/run makes an environment)")

from action_msgs.msg import GoalStatus
from test_msgs.action import Fibonacci

from gates import RunningGate, until
from robots import gate_of
from ros.graph import HERE, Arm, Goal, Graph, graph_of

IN_DOCK = {"source": "dock", "regions": ["dock"]}
GRANTS = (
    {
        "id": "wave",
        "type": "gesture",
        "tool": "arm",
        "rows": [IN_DOCK],
        "limits": {"gesture_no": [1, 20]},
    },
)
TOOLS = {"gesture": ["arm"], "lamp": ["lamps"], "drive": ["base"]}
BRAKES = {"brake_mm_s2": 1000, "reaction_ms": 20}


@pytest.fixture(scope="module")
def gate() -> Iterator[RunningGate]:
    folder = Path(mkdtemp(prefix="ag-ros-", dir="/tmp"))
    with gate_of(
        folder, HERE / "binding.yaml", tools=TOOLS, grants=GRANTS, profile=BRAKES
    ) as made:
        yield made


@pytest.fixture
def graph(tmp_path: Path, gate: RunningGate) -> Iterator[Graph]:
    gate.mark()
    with graph_of(tmp_path, gate) as made:
        yield made


def test_an_allowed_goal_is_the_robots_own_from_its_answer_to_its_result(graph: Graph) -> None:
    arm = Arm(graph.robot, Fibonacci, "/fibonacci")
    arm.feedback = [Fibonacci.Feedback(sequence=[0]), Fibonacci.Feedback(sequence=[0, 1])]
    arm.result = Fibonacci.Result(sequence=[0, 1, 1])
    graph.start()
    planner = graph.planner()
    goal = Goal(planner, planner.client(Fibonacci, "/llm/fibonacci"), Fibonacci.Goal(order=3))
    assert goal.accepted
    assert [one.order for one in arm.goals] == [3]
    until(lambda: len(goal.feedback) == 2, "both feedbacks")
    assert goal.feedback == arm.feedback
    arm.end.set()
    said = goal.result()
    assert said.status == GoalStatus.STATUS_SUCCEEDED
    assert said.result == arm.result
