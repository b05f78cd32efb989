# SPDX-License-Identifier: Apache-2.0
"""On a DDS with security, with our keystore: of all processes the gate's alone reaches the base.

ROS 2's wheels have no DDS security, so these are processes of Debian's Cyclone DDS, on the topic,
the type and the files that ROS 2 would use; `.ci/run` makes them, `AUTHGUARD_DDS` names the folder.
They run in a network of their own, which nothing else is in.
Source: lessons L1, L7; docs/spec/ros-map.md#denial
"""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread

import pytest

from authguard_r.integrations.ros.keystore import KEY, make_keystore
from fixtures.gate_process import until
from fixtures.ros_keystores import example, home, resign
from fixtures.scenarios import ROOT

FOLDER = Path(os.environ.get("AUTHGUARD_DDS", "/nowhere"))
pytestmark = pytest.mark.skipif(
    not FOLDER.is_dir(), reason="AUTHGUARD_DDS names no folder (tests/dds/make.sh makes one)"
)
PEER = ROOT / "tests" / "dds" / "peer.py"
GATE, PLANNER, BASE = "/authguard/gate", "/llm/planner", "/robot/base"
DEADMAN, NAVIGATION = "/authguard/deadman", "/robot/navigation"
#: What else must not be written: as DDS calls it, by who hears it and who alone may say it.
ELSE = {
    "a goal": ("rq/navigate_to_pose/_action/send_goalRequest", NAVIGATION, GATE),
    "a call": ("rq/lightRequest", BASE, GATE),
    "an answer of the robot's": ("rr/lightReply", GATE, BASE),
    "a goal's feedback": ("rt/navigate_to_pose/_action/feedback", GATE, NAVIGATION),
    "the gate's life": ("rt/authguard/heartbeat", DEADMAN, GATE),
}
#: How long somebody who must not be heard tries, in seconds; the gate is heard within one.
TRIES_S = 3.0


class Peer:
    """A process that takes part, and what it says."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process
        self.said: list[str] = []
        self._reader = Thread(target=self._read, daemon=True)
        self._reader.start()
        until(lambda: self.said, "its first word")

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.said.append(line.strip())

    def end(self) -> None:
        """Let it end, and hear the last of it."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        try:
            self.process.wait(20)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait(20)
        self._reader.join(20)


class Net:
    """A network of its own, in which processes are started.

    Args:
        shell: a process inside it.
    """

    def __init__(self, shell: int) -> None:
        self._shell = shell

    @contextmanager
    def peer(self, role: str, *folders: Path, topic: str = "rt/cmd_vel") -> Iterator[Peer]:
        """Start a process that takes part."""
        words = [
            "nsenter",
            "--target",
            str(self._shell),
            "--net",
            "--user",
            "--preserve-credentials",
        ]
        words += [str(FOLDER / "venv" / "bin" / "python"), str(PEER), role]
        words += [topic, str(example().domain), *map(str, folders)]
        more = {
            "CYCLONEDDS_HOME": str(FOLDER / "home"),
            "LD_LIBRARY_PATH": str(FOLDER / "libraries"),
        }
        with subprocess.Popen(
            words,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env={**os.environ, **more},
        ) as process:
            made = Peer(process)
            try:
                yield made
            finally:
                made.end()


@pytest.fixture
def net() -> Iterator[Net]:
    words = ["unshare", "--user", "--map-root-user", "--net", "sh", "-c"]
    words += ["ip link set lo up && echo up && exec sleep 3600"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as shell:
        try:
            assert shell.stdout is not None
            assert shell.stdout.readline() == "up\n"
            yield Net(shell.pid)
        finally:
            shell.kill()


@pytest.fixture
def keystore(tmp_path: Path) -> Path:
    folder = tmp_path / "keystore"
    make_keystore(example(), folder)
    return folder


Rogue = Callable[[Path, Path], tuple[Path, ...]]


def planner(keystore: Path, _: Path) -> tuple[Path, ...]:
    return (home(keystore, PLANNER),)


def nobody(_keystore: Path, _: Path) -> tuple[Path, ...]:
    return ()


def another_authority(_keystore: Path, tmp_path: Path) -> tuple[Path, ...]:
    make_keystore(example(), tmp_path / "other")
    return (home(tmp_path / "other", GATE),)


def edited_permissions(keystore: Path, _: Path) -> tuple[Path, ...]:
    path = home(keystore, PLANNER) / "permissions.p7s"
    path.write_bytes(path.read_bytes().replace(b"rt/llm/cmd_vel", b"rt/cmd_vel"))
    return (home(keystore, PLANNER),)


def gates_permissions(keystore: Path, _: Path) -> tuple[Path, ...]:
    for name in ("permissions.p7s", "permissions.xml"):
        shutil.copy(home(keystore, GATE) / name, home(keystore, PLANNER) / name)
    return (home(keystore, PLANNER),)


def gates_certificate(keystore: Path, _: Path) -> tuple[Path, ...]:
    """Everything of the gate's that is not secret, with the planner's own key."""
    return (home(keystore, GATE), home(keystore, PLANNER))


def dead_man(keystore: Path, _: Path) -> tuple[Path, ...]:
    return (home(keystore, "/authguard/deadman"),)


@pytest.mark.parametrize(
    "rogue",
    [
        planner,
        nobody,
        another_authority,
        edited_permissions,
        gates_permissions,
        gates_certificate,
        dead_man,
    ],
)
def test_l1_nobody_but_the_gate_reaches_the_base(
    net: Net, keystore: Path, tmp_path: Path, rogue: Rogue
) -> None:
    with net.peer("hear", home(keystore, BASE)) as base:
        assert base.said == ["ready"]
        with net.peer("write", *rogue(keystore, tmp_path)) as other:
            time.sleep(TRIES_S)
            assert "matched" not in other.said
        with net.peer("write", home(keystore, GATE)) as gate:  # and it would have been heard
            until(lambda: f"heard {gate.process.pid}" in base.said, "the gate")
            assert "matched" in gate.said
    assert base.said == ["ready", f"heard {gate.process.pid}"]


@pytest.mark.parametrize(("topic", "hears", "says"), ELSE.values(), ids=ELSE)
def test_l1_a_planner_reaches_no_server_no_client_and_no_dead_man(
    net: Net, keystore: Path, topic: str, hears: str, says: str
) -> None:
    with net.peer("hear", home(keystore, hears), topic=topic) as heard:
        assert heard.said == ["ready"]
        with net.peer("write", home(keystore, PLANNER), topic=topic) as other:
            time.sleep(TRIES_S)
            assert "matched" not in other.said
        with net.peer("write", home(keystore, says), topic=topic) as own:
            until(lambda: f"heard {own.process.pid}" in heard.said, says)
    assert heard.said == ["ready", f"heard {own.process.pid}"]


def test_the_comparison_can_fail_whom_the_authority_lets_in_is_heard(
    net: Net, keystore: Path
) -> None:
    """The same planner, the same key: the signed documents alone stand between it and the base."""
    allowed = {"<topic>rt/llm/cmd_vel</topic>": "<topic>rt/cmd_vel</topic>"}
    resign(keystore, PLANNER, "permissions", allowed)
    assert (home(keystore, PLANNER) / KEY).exists()
    with (
        net.peer("hear", home(keystore, BASE)) as base,
        net.peer("write", home(keystore, PLANNER)) as other,
    ):
        until(lambda: f"heard {other.process.pid}" in base.said, "the planner")
