# SPDX-License-Identifier: Apache-2.0
"""`authguard doctor --ros` where ROS 2 is: the map's types are loaded, and its middleware known.

Source: issue 9, "Launch and packaging". How-to: docs/howto/ros-nav2.md
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 (tests/ros/make.sh makes an environment)")
pytest.importorskip("nav2_msgs", reason="needs nav2_msgs (tests/ros/build_interfaces.sh)")

from fixtures.gate_process import environment
from fixtures.scenarios import ROOT

EXAMPLE = ROOT / "examples" / "ros" / "map.yaml"


def advice(path: Path) -> dict[str, list[dict[str, str]]]:
    """Return what the doctor says, by its codes."""
    variables = environment(measured=True)
    variables.pop("RMW_IMPLEMENTATION", None)
    done = subprocess.run(
        [Path(sys.prefix) / "bin" / "authguard", "doctor", "--ros", path, "--json"],
        env=variables,
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 5, done.stderr  # nothing here is secured
    found: dict[str, list[dict[str, str]]] = {}
    for item in json.loads(done.stdout)["advice"]:
        found.setdefault(item["code"], []).append(item)
    return found


@pytest.mark.smoke
def test_types_that_are_installed_load_and_the_wheels_middleware_has_no_security() -> None:
    said = advice(EXAMPLE)
    (types,) = said["ROS_TYPE"]
    assert (types["level"], types["message"]) == ("ok", "all 5 of the map load")
    (middleware,) = said["ROS_RMW"]
    assert middleware["level"] == "unsafe"
    assert Path(middleware["place"]).name == "librmw_fastrtps_shared_cpp.so"


def test_a_type_that_is_not_installed_is_named_with_its_package(tmp_path: Path) -> None:
    path = tmp_path / "map.yaml"
    path.write_text(EXAMPLE.read_text().replace("std_srvs", "my_light", 1))
    (found,) = advice(path)["ROS_TYPE"]
    assert (found["level"], found["place"]) == ("unsafe", "mediated.light.type")
    assert found["mend"] == "apt install ros-$ROS_DISTRO-my-light"
