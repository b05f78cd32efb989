# SPDX-License-Identifier: Apache-2.0
"""What a user of ROS 2 builds and starts: `ros2/` with colcon, the installed scripts, the units.

Built in a folder of its own, as `colcon build` does in a workspace. Source: issue 9, "Launch and
packaging". How-to: docs/howto/ros-nav2.md
"""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import pytest
import yaml

pytest.importorskip("rclpy", reason="needs ROS 2 (tests/ros/make.sh makes an environment)")
pytest.importorskip("nav2_msgs", reason="needs nav2_msgs (tests/ros/build_interfaces.sh)")

from geometry_msgs.msg import PoseStamped
from nav2_msgs.action import NavigateToPose
from std_srvs.srv import SetBool

from authguard_r.integrations.ros.keystore import make_keystore
from authguard_r.integrations.ros.map import read_map
from fixtures.gate_process import RunningGate, environment, until
from fixtures.packaged_robots import gate_of
from fixtures.ros_processes import map_of
from fixtures.scenarios import ROOT
from ros.graph import PATIENCE_S, Arm, Goal, Graph
from ros.hospital import BUDGETS, GO, ISOLATION, PHARMACY

EXAMPLE = ROOT / "examples" / "ros"
SCRIPTS = ("gate_node", "actuator", "deadman", "estimator")
GRANTS = (
    GO,
    {"id": "shine", "type": "lamp", "tool": "lamp", "rows": [{}], "limits": {"lamp_no": [1, 1]}},
)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build every package of `ros2/` in a fresh folder; return what was installed."""
    folder = tmp_path_factory.mktemp("workspace")
    home = Path(sys.prefix)
    words = ["--log-base", "log", "build", "--base-paths", ROOT / "ros2"]
    words += ["--cmake-args", f"-DPython3_EXECUTABLE={sys.executable}", "-DBUILD_TESTING=OFF"]
    variables = {
        **os.environ,
        "AMENT_PREFIX_PATH": str(home),
        "CMAKE_PREFIX_PATH": str(home),
        "COLCON_HOME": str(folder / "home"),
        "PATH": f"{home / 'bin'}{os.pathsep}{os.environ['PATH']}",
    }
    done = subprocess.run(
        [home / "bin" / "colcon", *words],
        cwd=folder,
        env=variables,
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout[-4_000:] + done.stderr[-4_000:]
    packages = {path.parent.name for path in (ROOT / "ros2").glob("*/package.xml")}
    assert "authguard_ros" in packages
    assert {path.name for path in (folder / "install").iterdir() if path.is_dir()} == packages
    return folder / "install"


def installed(built: Path, name: str) -> list[str]:
    """Return what starts an installed script in a shell that has sourced the workspace."""
    script = built / "authguard_ros" / "lib" / "authguard_ros" / name
    return ["bash", "-c", 'source "$0" && exec "$@"', str(built / "local_setup.bash"), str(script)]


@contextmanager
def started(*words: object) -> Iterator[subprocess.Popen[str]]:
    """Yield a process, and end it."""
    process = subprocess.Popen(
        list(map(str, words)),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment(measured=True),
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def said(*words: object) -> tuple[int, str, str]:
    """Return the exit code of a process that ends by itself, and what it said."""
    with started(*words) as process:
        out, err = process.communicate(timeout=PATIENCE_S)
        return process.returncode, out, err


def pending(pid: int) -> int:
    """Return the signals that a process was sent and has not taken."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    told = dict(line.split(":", 1) for line in lines)
    return int(told["SigPnd"], 16) | int(told["ShdPnd"], 16)


def is_ready(process: subprocess.Popen[str]) -> bool:
    assert process.stdout is not None
    return process.stdout.readline() == "ready\n"


@pytest.fixture
def stopping_map(tmp_path: Path) -> Path:
    """A map with a stream that is relayed."""
    path = tmp_path / "map.yaml"
    path.write_text(yaml.safe_dump(map_of(1 + os.getpid() % 90)))
    return path


def words_of(name: str, ros_map: Path) -> list[object]:
    """Return the words of a script, with files that are never read where security is missing."""
    if name == "gate_node":
        files = ("run", "site", "trust", "binding")
        return ["--map", ros_map, *(w for n in files for w in (f"--{n}", f"no-{n}"))]
    return [ros_map] if name == "deadman" else [ros_map, "move", "/base/cmd_vel"]


#: What ROS 2 takes for no security and says nothing of, for a script each: what is wrong there is
#: one function's, and `tests/unit/ros/test_security.py` gives it every wrong word.
OPEN = {
    "gate_node": ({"ROS_SECURITY_ENABLE": "True"}, "expected exactly `true`, got `True`"),
    "actuator": ({"ROS_SECURITY_ENABLE": None}, "expected exactly `true`, got nothing"),
    "deadman": (
        {"ROS_SECURITY_STRATEGY": "enforce"},
        "expected exactly `Enforce`, got `enforce`",
    ),
}


@pytest.mark.parametrize("name", OPEN)
def test_an_installed_script_refuses_without_security(
    name: str,
    built: Path,
    stopping_map: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    change, message = OPEN[name]
    secured: dict[str, str | None] = {
        "ROS_SECURITY_ENABLE": "true",
        "ROS_SECURITY_STRATEGY": "Enforce",
        "ROS_SECURITY_KEYSTORE": str(tmp_path / "keystore"),
        "ROS_DOMAIN_ID": str(yaml.safe_load(stopping_map.read_text())["domain"]),
    }
    for variable, value in {**secured, **change}.items():
        if value is None:
            monkeypatch.delenv(variable, raising=False)
        else:
            monkeypatch.setenv(variable, value)
    code, out, err = said(*installed(built, name), *words_of(name, stopping_map))
    assert (code != 0, out) == (True, "")
    assert message in err
    assert "Traceback" not in err


def test_the_dead_man_outlives_what_a_terminal_tells_everybody(
    built: Path, stopping_map: Path
) -> None:
    with started(*installed(built, "deadman"), stopping_map, "--demo") as process:
        assert is_ready(process)
        process.send_signal(signal.SIGINT)
        sent = 1 << (signal.SIGINT - 1)
        until(lambda: pending(process.pid) & sent, "a signal that it does not take")
        process.terminate()
        assert process.wait(PATIENCE_S) == 0


def test_the_relay_ends_with_the_terminal(built: Path, stopping_map: Path) -> None:
    words = words_of("actuator", stopping_map)
    with started(*installed(built, "actuator"), *words, "--demo") as process:
        assert is_ready(process)
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 0


@pytest.mark.parametrize("name", SCRIPTS)
def test_what_is_not_installed_is_named(name: str, built: Path) -> None:
    (own,) = (built / "authguard_ros" / "lib").glob("python3*/site-packages")
    script = built / "authguard_ros" / "lib" / "authguard_ros" / name
    # -S: a Python without the packages of its environment
    code, out, err = said("env", f"PYTHONPATH={own}", sys.executable, "-S", script)
    assert (code, out) == (2, "")
    assert "No module named 'authguard_r'" in err
    assert "pip install 'authguard-r[ros]'" in err
    assert "Traceback" not in err


def secured(folder: Path, ros_map: Path) -> dict[str, str]:
    """Return the variables of processes that are in their enclaves."""
    ros = read_map(ros_map)
    make_keystore(ros, folder / "keystore")
    return {
        "ROS_SECURITY_ENABLE": "true",
        "ROS_SECURITY_STRATEGY": "Enforce",
        "ROS_SECURITY_KEYSTORE": str(folder / "keystore"),
        "ROS_DOMAIN_ID": str(ros.domain),
    }


@pytest.mark.parametrize("name", ["actuator", "deadman"])
def test_a_middleware_without_security_makes_no_node_and_says_so(
    name: str, built: Path, stopping_map: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The wheels have none: in its own sound enclave a process ends, and is not a plain one."""
    for variable, value in secured(tmp_path, stopping_map).items():
        monkeypatch.setenv(variable, value)
    code, out, err = said(*installed(built, name), *words_of(name, stopping_map))
    assert (code, "ready" in out) == (2, False)
    assert "ROS 2 makes no node in `/" in err
    assert "security libraries" in err
    assert "Traceback" not in err


def test_without_a_folder_for_logs_there_is_no_node_and_it_says_so(
    built: Path, stopping_map: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("ROS_LOG_DIR", raising=False)
    monkeypatch.setenv("ROS_HOME", "/dev/null")
    code, out, err = said(*installed(built, "deadman"), stopping_map, "--demo")
    assert (code, out) == (2, "")
    assert "log directory" in err
    assert "Traceback" not in err


def test_the_gates_node_in_its_enclave_is_no_plain_one_either(
    gate: RunningGate,
    built: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ros_map = EXAMPLE / "map.yaml"
    for variable, value in secured(tmp_path, ros_map).items():
        monkeypatch.setenv(variable, value)
    words = ["--map", ros_map, "--gate", gate.run, "--site", gate.site, "--trust", gate.trust]
    words += ["--binding", gate.binding]
    code, out, err = said(*installed(built, "gate_node"), *words)
    assert (code, "ready" in out) == (1, False)
    assert "ROS 2 makes no node in `/authguard/gate`" in err
    assert "Traceback" not in err


@pytest.fixture(scope="module")
def gate() -> Iterator[RunningGate]:
    folder = Path(mkdtemp(prefix="ag-ros-", dir="/tmp"))
    tools = {"drive": ["base"], "lamp": ["lamp"]}
    with gate_of(
        folder,
        EXAMPLE / "binding.yaml",
        tools=tools,
        grants=GRANTS,
        profile={"brake_mm_s2": 1000, "reaction_ms": 200},
        changes={"budgets": BUDGETS},
        fold_ms=0,
    ) as made:
        yield made


class Courier:
    """The example's robot: Nav2's action, and a lamp."""

    def __init__(self, graph: Graph) -> None:
        self.arm = Arm(graph.robot, NavigateToPose, "/navigate_to_pose")
        self.lit: list[bool] = []
        graph.robot.node.create_service(
            SetBool, "/light", self._light, callback_group=graph.robot.group
        )

    def _light(self, asked: Any, answer: Any) -> Any:
        self.lit.append(asked.data)
        answer.success = True
        return answer


def example_map(folder: Path) -> Path:
    """Return the example's map in the domain that a graph of a test puts its own for."""
    path = folder / "example.yaml"
    path.write_text((EXAMPLE / "map.yaml").read_text().replace("domain: 42", "domain: 1"))
    return path


def to(at: tuple[float, float]) -> NavigateToPose.Goal:
    made = PoseStamped()
    made.header.frame_id = "main"
    made.pose.position.x, made.pose.position.y = at
    return NavigateToPose.Goal(pose=made)


def test_the_installed_node_holds_the_examples_robot_to_its_mission(
    fresh: Graph, gate: RunningGate, built: Path, tmp_path: Path
) -> None:
    courier = Courier(fresh)
    fresh.start(example_map(tmp_path), installed(built, "gate_node"))
    planner = fresh.planner()
    client = planner.client(NavigateToPose, "/llm/navigate_to_pose")
    assert not Goal(planner, client, to(ISOLATION)).accepted
    assert courier.arm.goals == []
    until(lambda: gate.refusals("DESTINATION_OUT_OF_SCOPE"), "the refusal's record")
    goal = Goal(planner, client, to(PHARMACY))
    assert goal.accepted
    assert len(courier.arm.goals) == 1
    courier.arm.end.set()
    goal.result()
    lit = planner.call(SetBool, "/llm/light", SetBool.Request(data=True)).result(PATIENCE_S)
    dark = planner.call(SetBool, "/llm/light", SetBool.Request(data=False)).result(PATIENCE_S)
    assert (lit.success, dark.success, courier.lit) == (True, False, [True])
    assert fresh.terminate() == 0


def start_of(name: str) -> list[str]:
    """Return what a unit starts."""
    text = (ROOT / "deploy" / "systemd" / f"authguard-ros-{name}@.service").read_text()
    (line,) = [line for line in text.splitlines() if line.startswith("ExecStart=")]
    return shlex.split(line.removeprefix("ExecStart="))


def test_what_the_gates_unit_starts_is_a_node_that_serves(fresh: Graph, tmp_path: Path) -> None:
    python, *words = start_of("gate")
    assert python == "/opt/authguard-ros/bin/python"
    assert words[2::2] == ["--map", "--gate", "--site", "--binding", "--trust"]
    Courier(fresh)
    fresh.start(example_map(tmp_path), [sys.executable, *words[:2]])


@pytest.mark.parametrize("name", ["deadman", "actuator"])
def test_what_a_unit_starts_is_ready(name: str, stopping_map: Path) -> None:
    put = {
        "/opt/authguard-ros/bin/python": sys.executable,
        "/etc/authguard-r/%i/ros-map.yaml": str(stopping_map),
        "${AUTHGUARD_STREAM}": "move",
        "${AUTHGUARD_BASE_TOPIC}": "/base/cmd_vel",
    }
    words = [put.get(word, word) for word in start_of(name)]
    assert not any("%" in word or "$" in word for word in words)
    with started(*words, "--demo") as process:
        assert is_ready(process)
        process.terminate()
        assert process.wait(PATIENCE_S) == 0


def test_the_installed_dead_man_cancels_what_a_killed_node_left(
    fresh: Graph, built: Path, tmp_path: Path
) -> None:
    """Ctrl-C has been said to everybody, and the node is killed under a goal."""
    courier = Courier(fresh)
    fresh.start(example_map(tmp_path), installed(built, "gate_node"))
    log = tmp_path / "deadman.err"
    words = [*installed(built, "deadman"), str(tmp_path / "map.yaml"), "--demo"]
    with log.open("w") as errors:
        deadman = subprocess.Popen(words, stderr=errors, env=environment(measured=True))
    try:
        until(lambda: '"armed"' in log.read_text(), "an armed dead-man")
        planner = fresh.planner()
        client = planner.client(NavigateToPose, "/llm/navigate_to_pose")
        assert Goal(planner, client, to(PHARMACY)).accepted
        deadman.send_signal(signal.SIGINT)
        fresh.kill()
        until(lambda: courier.arm.canceled, "a goal that is canceled")
        deadman.terminate()
        assert deadman.wait(PATIENCE_S) == 0
    finally:
        deadman.kill()
        deadman.wait()
