# SPDX-License-Identifier: Apache-2.0
"""Python environments of their own, for packages that do not fit into `.venv`.

Each one lies in `.environments/NAME` and is made again when its recipe changes. A variable
`AUTHGUARD_NAME` that is set already names another folder, which is used as it is.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

from runner.groups import ROOT, GroupError

PLACE = ROOT / ".environments"
BIN = Path(sys.executable).parent
COVERAGE = "coverage==7.17.3"
RCLPY = ("ros-kilted-rclpy==9.1.2", "ros-rmw-fastrtps-cpp==9.3.3")
#: What `uv pip install` gets, call by call; a later call may replace what an earlier one pinned.
RECIPES: dict[str, tuple[tuple[str, ...], ...]] = {
    # ros-mcp pins other versions than we do
    "ros-mcp": (("ros-mcp==3.1.2",),),
    # Inspect is heavy, and in no lock file
    "inspect": (("--editable", ".", "--editable", "packages/missionpair[inspect,llm]", COVERAGE),),
    # fonts, a recognizer of speech with its model, and what counts wrong words
    "perception": (
        ("--editable", ".", "--editable", "packages/missionpair[perception]", COVERAGE),
    ),
    # Ray is heavy, and in no lock file
    "ray": (("--editable", ".", "--editable", "packages/missionpair[ray]", COVERAGE),),
    # ROSA needs LangChain 0.3 and rclpy, and pins a PyYAML that is too old for us
    "rosa": (("jpl-rosa==1.0.10", *RCLPY), ("--editable", ".", COVERAGE)),
    # RAI is heavy, and needs rclpy
    "rai": (
        (
            *("--editable", ".", COVERAGE, "rai-core==2.12.1", "langchain-core==1.7.2", *RCLPY),
            *("ros-geometry-msgs==5.5.1", "ros-nav-msgs==5.5.1", "ros-sensor-msgs==5.5.1"),
            *("ros-std-msgs==5.5.1", "ros-std-srvs==5.5.1"),
        ),
    ),
}
#: Environments that a script makes, with the files that its result depends on.
SCRIPTS = {
    # the wheels of ROS 2 carry no DDS with security
    "dds": ("tests/dds/make.sh",),
    # the wheels of ROS 2 restart every Python of their environment
    "ros": ("tests/ros/make.sh", "tests/ros/build_interfaces.sh", "tests/ros/interfaces", "ros2"),
}


def variable(name: str) -> str:
    """Return the variable that names the folder of an environment."""
    return f"AUTHGUARD_{name.replace('-', '_').upper()}"


def is_made(name: str) -> bool:
    """Say whether an environment is there: made by its recipe, or named by its variable."""
    stamp = PLACE / name / "made"
    return variable(name) in os.environ or (stamp.is_file() and stamp.read_text() == _digest(name))


def ready(name: str) -> Path:
    """Return the folder of an environment, made if it is not there, and set its variable.

    Raises:
        GroupError: it cannot be made; what its installer printed stands in the message.
    """
    if variable(name) in os.environ:
        return Path(os.environ[variable(name)])
    folder = PLACE / name
    if not is_made(name):
        print(f"making the environment `{name}` in {folder.relative_to(ROOT)} ...", flush=True)
        shutil.rmtree(folder, ignore_errors=True)
        folder.parent.mkdir(exist_ok=True)
        _make(name, folder)
        (folder / "made").write_text(_digest(name))
    os.environ[variable(name)] = str(folder)
    return folder


def require_programs(programs: dict[str, str]) -> None:
    """Require that every program is on the path.

    Raises:
        GroupError: some are not; the message names the Debian packages that have them.
    """
    absent = {name: package for name, package in programs.items() if shutil.which(name) is None}
    if absent:
        packages = " ".join(sorted(set(absent.values())))
        raise GroupError(f"{', '.join(absent)} not found; install: apt-get install {packages}")


def _make(name: str, folder: Path) -> None:
    if name in SCRIPTS:
        _do(name, ["sh", SCRIPTS[name][0], str(folder)])
        return
    uv = [str(BIN / "uv")]
    _do(name, [*uv, "venv", "--quiet", "--python", sys.executable, str(folder)])
    for packages in RECIPES[name]:
        python = ["--quiet", "--python", str(folder / "bin" / "python")]
        _do(name, [*uv, "pip", "install", *python, *packages])


def _do(name: str, command: list[str]) -> None:
    env = {**os.environ, "UV_COMPILE_BYTECODE": "1"}
    done = subprocess.run(
        command, cwd=ROOT, env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False
    )
    if done.returncode != 0:
        said = done.stdout.decode(errors="replace")[-4_000:]
        raise GroupError(f"the environment `{name}` cannot be made:\n{said}")


def _digest(name: str) -> str:
    """Return what an environment depends on: its recipe, our packages' metadata, its files."""
    found = hashlib.sha256(repr((RECIPES.get(name), sys.version_info[:2], str(ROOT))).encode())
    metadata = (ROOT / "pyproject.toml", ROOT / "packages" / "missionpair" / "pyproject.toml")
    for place in (*metadata, *(ROOT / item for item in SCRIPTS.get(name, ()))):
        for file in sorted(place.rglob("*")) or [place]:
            if file.is_file() and not _is_left_over(file):
                found.update(file.read_bytes())
    return found.hexdigest()


def _is_left_over(file: Path) -> bool:
    """Say whether a run left the file there: compiled code, or what a process has covered."""
    return "__pycache__" in file.parts or file.name.startswith(".coverage")
