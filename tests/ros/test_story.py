# SPDX-License-Identifier: Apache-2.0
"""The story of the example runs as it stands, and its own judge finds what is not as it must be.

Source: issue 9, "A story that runs". How-to: docs/howto/ros-story.md
"""

from __future__ import annotations

import copy
import json
import subprocess
import sys
from collections.abc import Callable
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="needs ROS 2 (tests/ros/make.sh makes an environment)")
pytest.importorskip("nav2_msgs", reason="needs nav2_msgs (tests/ros/build_interfaces.sh)")

from fixtures.gate_process import environment, until
from fixtures.scenarios import ROOT

STORY = ROOT / "examples" / "ros" / "story.py"
#: Bound against hanging, in seconds; nothing is measured against it.
PATIENCE_S = 480.0
#: The contract: a robot that has to stand does so within.
STOP_MS = 1_000
Facts = dict[str, Any]


def _judge() -> Any:
    spec = spec_from_file_location("story", STORY)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


judge = _judge()


def processes_of(folder: Path) -> list[str]:
    """Return the command lines of whatever still runs with the story's files."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = path.read_bytes()
        except OSError:
            continue  # it has ended meanwhile
        if str(folder).encode() in words:
            found.append(words.replace(b"\0", b" ").decode())
    return found


def shared() -> set[str]:
    return {path.name for path in Path("/dev/shm").glob("*")}


def played(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, STORY, "--json", "--keep", folder, *words],
        capture_output=True,
        text=True,
        check=False,
        timeout=PATIENCE_S,
        env=environment(measured=True),
    )


@pytest.fixture
def short() -> Path:
    """Return a folder whose sockets have short names."""
    return Path(mkdtemp(prefix="ag-ros-", dir="/tmp")) / "kept"


@pytest.fixture(scope="module")
def facts() -> Facts:
    """What happened in one telling, which left nothing behind."""
    folder = Path(mkdtemp(prefix="ag-ros-", dir="/tmp")) / "kept"
    before = shared()
    done = played(folder)
    assert done.returncode == 0, done.stdout[-4_000:] + done.stderr[-4_000:]
    assert processes_of(folder) == []
    assert shared() <= before
    told: Facts = json.loads(done.stdout)
    return told


def test_the_signed_mission_is_driven(facts: Facts) -> None:
    drive = facts["drive"]
    assert (drive["accepted"], drive["status"]) == (True, "succeeded")
    assert (drive["place"], drive["light"], drive["gripped"]) == ("pharmacy", True, True)
    # where the binding has it go: the pharmacy's approach point
    assert drive["at"] == pytest.approx([4.0, 5.0], abs=0.02)


def test_a_hijacked_goal_is_refused_which_the_safety_gate_alone_would_let_pass(
    facts: Facts,
) -> None:
    hijack = facts["hijack"]
    assert hijack["because"] == hijack["sign"]
    assert (hijack["place"], hijack["accepted"]) == ("isolation room", False)
    assert hijack["reasons"][0] == "DESTINATION_OUT_OF_SCOPE"
    assert (hijack["goals_begun"], hijack["fastest_mm_s"]) == (0, 0)
    assert hijack["safety_alone"] == {"safe": True, "findings": []}


def test_the_same_goal_is_driven_once_the_operator_signed_for_it(facts: Facts) -> None:
    update = facts["update"]
    before = update["before"]
    assert before["place"] == update["place"] == "station 101"
    assert (before["accepted"], before["goals_begun"], before["fastest_mm_s"]) == (False, 0, 0)
    assert "DESTINATION_OUT_OF_SCOPE" in before["reasons"]
    assert (update["accepted"], update["status"]) == (True, "succeeded")
    assert update["at"] == pytest.approx([13.0, 5.0], abs=0.02)
    assert update["handed_over"] is True


def test_a_robot_that_slips_out_of_the_corridor_is_stopped(facts: Facts) -> None:
    drift = facts["drift"]
    assert (drift["status"], drift["reasons"]) == ("aborted", ["OUTSIDE_REGIONS"])
    assert 0 <= drift["brakes_ms"] <= drift["stands_ms"] <= STOP_MS


def test_a_robot_whose_gates_node_is_killed_stands_and_its_goal_is_canceled(facts: Facts) -> None:
    killed = facts["killed"]
    assert killed["base_told"] in {"deadline", "liveliness", "silence", "publisher_gone"}
    assert {"lost", "canceled"} <= {*killed["deadman"]}
    for name in ("base_told_ms", "brakes_ms", "stands_ms"):
        assert 0 <= killed[name] <= STOP_MS


def test_the_log_is_whole_and_anchored(facts: Facts) -> None:
    audit = facts["audit"]
    assert (audit["whole"], audit["anchored"]) == (True, "checkpoint")
    assert audit["anchored_size"] == audit["size"]
    assert facts["faults"] == []


def put(*path: str, value: object) -> Callable[[Facts], None]:
    def change(facts: Facts) -> None:
        *way, last = path
        for name in way:
            facts = facts[name]
        facts[last] = value

    return change


@pytest.mark.parametrize(
    ("change", "act"),
    [
        (put("drive", "status", value="aborted"), "drive"),
        (put("drive", "gripped", value=False), "drive"),
        (put("hijack", "because", value="its user"), "hijack"),
        # as it is without a gate: the goal reaches the robot
        (put("hijack", "accepted", value=True), "hijack"),
        (put("hijack", "goals_begun", value=1), "hijack"),
        (put("hijack", "fastest_mm_s", value=1), "hijack"),
        (put("hijack", "reasons", value=["UNSAFE"]), "hijack"),
        (put("hijack", "safety_alone", "safe", value=False), "hijack"),
        (put("update", "before", "accepted", value=True), "update"),
        (put("update", "before", "place", value="dock"), "update"),
        (put("update", "accepted", value=False), "update"),
        (put("update", "handed_over", value=False), "update"),
        (put("drift", "status", value="succeeded"), "drift"),
        (put("drift", "reasons", value=[]), "drift"),
        (put("drift", "stands_ms", value=STOP_MS + 1), "drift"),
        (put("drift", "brakes_ms", value=-1), "drift"),
        (put("killed", "stands_ms", value=STOP_MS + 1), "killed"),
        (put("killed", "base_told_ms", value=None), "killed"),
        (put("killed", "deadman", value=["lost"]), "killed"),
        (put("audit", "whole", value=False), "audit"),
        (put("audit", "anchored", value="unanchored"), "audit"),
        (put("audit", value=None), "audit"),
    ],
)
def test_a_story_that_is_not_as_it_must_be_is_found_out(
    facts: Facts, change: Callable[[Facts], None], act: str
) -> None:
    assert judge.faults(facts) == []
    doctored = copy.deepcopy(facts)
    change(doctored)
    found = judge.faults(doctored)
    assert found
    assert {fault.partition(":")[0] for fault in found} == {act}


def test_a_fault_is_exit_1_and_is_said(
    facts: Facts,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The whole way from facts as they are without a gate to what a shell sees."""
    monkeypatch.syspath_prepend(str(STORY.parent))
    doctored = copy.deepcopy(facts)
    doctored["hijack"] |= {"accepted": True, "goals_begun": 1, "status": "succeeded"}
    doctored["hijack"] |= {"took_s": 60.0, "at": [21.0, -3.0]}
    monkeypatch.setattr(judge, "played", lambda *_: doctored)
    monkeypatch.setattr(judge.signal, "signal", lambda *_: None)
    assert judge.main(["--keep", str(tmp_path / "kept")]) == 1
    said = capsys.readouterr()
    assert "`isolation room`: released" in said.out
    assert "NOT AS IT MUST BE: hijack: the goal is refused" in said.err


def test_what_is_not_installed_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(judge, "NEEDED", {"no_such_msgs": "ROS 2's package `no_such_msgs`"})
    assert judge.main([]) == 2
    assert capsys.readouterr().err.splitlines() == [
        "not installed:",
        "  `no_such_msgs`: ROS 2's package `no_such_msgs`",
    ]


def test_a_story_that_is_ended_in_the_middle_ends_what_it_started(short: Path) -> None:
    words = [sys.executable, STORY, "--json", "--keep", short]
    env = environment(measured=True)
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=env) as story:
        try:
            until((short / "node.err").exists, "the gate's node")
            assert processes_of(short)
            story.terminate()
            assert story.wait(PATIENCE_S) == 1
        finally:
            story.kill()
    assert processes_of(short) == []


def test_what_kept_a_process_from_starting_is_said(tmp_path: Path) -> None:
    """A folder so deep that no socket in it can have a name."""
    deep = tmp_path / ("deep" * 30)
    deep.mkdir()
    done = played(deep / "kept")
    assert (done.returncode, done.stdout) == (1, "")
    assert "`gate` ended: " in done.stderr
    assert "path too long" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_folder_that_is_there_already_is_left_as_it_is(tmp_path: Path) -> None:
    done = played(tmp_path)
    assert (done.returncode, done.stdout) == (1, "")
    assert "did not come to its end" in done.stderr
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []
