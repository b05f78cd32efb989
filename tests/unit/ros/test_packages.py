# SPDX-License-Identifier: Apache-2.0
"""What lies in `ros2/`: a package that names all it needs, a launch file that starts what it has.

`launch` has no wheel, so its file is read here and run only where there is one; the scripts are
built and started in tests/ros/test_packages.py.
"""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree as ET

import pytest

from fixtures.scenarios import ROOT

PACKAGE = ROOT / "ros2" / "authguard_ros"
LAUNCH = PACKAGE / "launch" / "guarded.launch.py"
NODES = ROOT / "src" / "authguard_r" / "integrations" / "ros" / "nodes"
#: What pip installs with `authguard-r[ros]`; the rest comes with ROS.
WITH_PIP = {"authguard_r", "msgspec"}


def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


def imported(path: Path) -> set[str]:
    """Return the packages that a module imports."""
    found = set()
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.add(node.module.partition(".")[0])
    return found - set(sys.stdlib_module_names)


def constants() -> dict[str, object]:
    """Return what the launch file holds constant."""
    found: dict[str, object] = {}
    for node in tree_of(LAUNCH).body:
        if isinstance(node, ast.Assign):
            (target,) = node.targets
            names = target.elts if isinstance(target, ast.Tuple) else [target]
            values = ast.literal_eval(node.value)
            values = values if isinstance(target, ast.Tuple) else [values]
            found |= dict(zip(map(ast.unparse, names), values, strict=True))
    return found


def calls(name: str) -> list[ast.Call]:
    """Return the launch file's calls of a function."""
    return [
        node
        for node in ast.walk(tree_of(LAUNCH))
        if isinstance(node, ast.Call) and ast.unparse(node.func) == name
    ]


def scripts() -> dict[str, str]:
    """Return the scripts that setup.py installs, with what each calls."""
    made = [
        ast.unparse(node).replace("{NAME}", "authguard_ros").strip("f'\"")
        for node in ast.walk(tree_of(PACKAGE / "setup.py"))
        if isinstance(node, ast.JoinedStr) and " = " in ast.unparse(node)
    ]
    return dict(line.split(" = ") for line in made)


def lives() -> ModuleType:
    spec = spec_from_file_location("lives", PACKAGE / "authguard_ros" / "lives.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_package_names_everything_that_our_nodes_import() -> None:
    root = ET.parse(PACKAGE / "package.xml").getroot()
    named = {element.text for element in root.iter("exec_depend")}
    needed = set[str]().union(*(imported(path) for path in NODES.glob("*.py"))) - WITH_PIP
    assert {"rclpy", "geometry_msgs"} <= needed
    assert needed <= named
    assert {"launch", "launch_ros"} <= imported(LAUNCH) - {"authguard_ros"} <= named
    assert root.attrib["format"] == "3"
    assert root.findtext("license") == "Apache-2.0"
    assert root.findtext("export/build_type") == "ament_python"


def test_every_package_has_the_projects_version() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    version = project["project"]["version"]
    told = [ET.parse(path).getroot() for path in (ROOT / "ros2").glob("*/package.xml")]
    assert {root.findtext("version") for root in told} == {version}
    assert f'version="{version}"' in (PACKAGE / "setup.py").read_text(encoding="utf-8")
    assert "ros2" in project["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]


def test_every_script_is_a_function_of_the_package() -> None:
    functions = {
        node.name
        for node in tree_of(PACKAGE / "authguard_ros" / "processes.py").body
        if isinstance(node, ast.FunctionDef)
    }
    found = scripts()
    assert found.keys() == {"gate_node", "actuator", "deadman", "estimator"}
    assert {call.removeprefix("authguard_ros.processes:") for call in found.values()} <= functions


def test_the_launch_file_starts_scripts_that_there_are_with_the_words_of_the_node() -> None:
    compile(LAUNCH.read_text(encoding="utf-8"), str(LAUNCH), "exec")
    made = sorted(calls("_process"), key=lambda call: call.lineno)
    started = [ast.literal_eval(call.args[0]) for call in made]
    assert started == ["deadman", "actuator", "estimator", "gate_node"]
    assert set(started) <= scripts().keys()
    source = (NODES / "node.py").read_text(encoding="utf-8")
    required = constants()["REQUIRED"]
    assert isinstance(required, dict)
    assert required.keys() == {"map", "gate", "site", "binding", "trust"}
    asked = set(
        re.findall(
            r'add_argument\(\s*"--(\w+)", (?:"--run", dest="run", )?(?:type=Path, )?required=True',
            source,
        )
    )
    assert asked == required.keys()
    source = (NODES / "estimator.py").read_text(encoding="utf-8")
    (names,) = re.findall(r"for name in \((.*)\):\n +asks.add_argument\(f\"--\{name\}\"", source)
    given = constants()["ATTESTS"]
    assert isinstance(given, tuple)
    assert {"gate", *ast.literal_eval(f"({names},)")} == {*given, "key", "cert"}
    # no words of ROS, which `launch_ros` would add
    assert calls("Node") == calls("LifecycleNode") == []


def test_everything_is_started_again_and_only_the_node_ends_it_all() -> None:
    (process,) = calls("ExecuteProcess")
    held = {keyword.arg: ast.unparse(keyword.value) for keyword in process.keywords}
    assert (held["respawn"], held["respawn_delay"]) == ("True", "AGAIN_S")
    ends = {
        ast.literal_eval(call.args[0]): [keyword.arg for keyword in call.keywords]
        for call in calls("_process")
    }
    own = {"deadman": ["sigterm_timeout"], "gate_node": ["on_exit"]}
    assert ends == {"actuator": [], "estimator": [], **own}
    assert len(calls("Shutdown")) == 1
    # the node is killed after twice its time; the dead-man goes on for longer
    found = constants()
    assert float(str(found["DEADMAN_S"])) > 2 * float(str(found["NODE_S"])) + 1


def test_nothing_of_the_launch_is_a_bench_unless_somebody_says_so() -> None:
    optional = constants()["OPTIONAL"]
    assert isinstance(optional, dict)
    assert optional["demo"][0] == "false"
    others = ("stream", "base_topic", "estimator_key", "estimator_cert")
    assert {optional[name][0] for name in others} == {""}


def test_a_process_that_ends_too_often_is_not_held_up() -> None:
    found = lives().Lives(3, 10.0)
    assert [found.end(now) for now in (0.0, 5.0, 10.0)] == [False, False, True]
    slow = lives().Lives(3, 10.0)
    # each third end is one second too late, until one is not
    assert [slow.end(now) for now in (0.0, 5.0, 11.0, 16.0, 22.0, 23.0)] == [False] * 5 + [True]


@pytest.mark.skipif(find_spec("launch_ros") is None, reason="needs launch_ros: it has no wheel")
def test_launch_understands_the_file(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(PACKAGE)
    spec = spec_from_file_location("guarded", LAUNCH)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    arguments = module.generate_launch_description().get_launch_arguments()
    needed = {one.name for one in arguments if one.default_value is None}
    assert needed == {"map", "gate", "site", "binding", "trust"}
