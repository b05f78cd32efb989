# SPDX-License-Identifier: Apache-2.0
"""A robot has one gate: a second process gets a refusal, a dead one leaves nothing behind."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from cryptography import x509

from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.identifiers import RobotId
from authguard_r.core.reasons import Reason
from authguard_r.server.robot_lock import LOCK_FILE, hold_robot, root_fingerprint
from fixtures import scenarios

#: Holds a lock, says so, and keeps it until it is killed.
HOLDER = """
import sys
from pathlib import Path
from authguard_r.server.robot_lock import hold_robot
lock = hold_robot(sys.argv[1], sys.argv[2], run=Path(sys.argv[3]))
print("held", flush=True)
for line in sys.stdin:
    lock.answer()
"""
#: Becomes another user and listens at the names.
SQUATTER = """
import os, socket, sys
os.setgid(int(sys.argv[1])); os.setuid(int(sys.argv[1]))
held = []
for name in sys.argv[2:]:
    held.append(socket.socket(socket.AF_UNIX))
    held[-1].bind("\\0" + name)
    held[-1].listen(1)
print("held", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def rid() -> RobotId:
    """A robot of this test's own: the name is the machine's, and tests run side by side."""
    return RobotId(f"robot-{os.getpid()}-{os.urandom(4).hex()}")


@pytest.fixture
def holders() -> Iterator[list[subprocess.Popen[str]]]:
    started: list[subprocess.Popen[str]] = []
    yield started
    for process in started:
        process.kill()
        process.communicate()


def hold_elsewhere(rid: str, mark: str, run: Path) -> subprocess.Popen[str]:
    run.mkdir(exist_ok=True)
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, rid, mark, str(run)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    return process


def squat(uid: int, *names: str) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-IS", "-c", SQUATTER, str(uid), *names],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd="/",
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "held\n"
    return process


def say(process: subprocess.Popen[str], word: str) -> None:
    assert process.stdin is not None
    process.stdin.write(f"{word}\n")
    process.stdin.flush()


def names_of(rid: RobotId) -> list[bytes]:
    """Return the names that a robot's gates have, as anybody can read them."""
    lines = Path("/proc/self/net/unix").read_bytes().splitlines()
    last = [line.split()[-1] for line in lines if f"@authguard-r/{rid}/".encode() in line]
    return [b"\0" + name[1:] for name in last]


def fill(name: bytes) -> list[socket.socket]:
    """Connect until the queue is full."""
    asking: list[socket.socket] = []
    while True:
        asking.append(socket.socket(socket.AF_UNIX))
        asking[-1].settimeout(0)
        try:
            asking[-1].connect(name)
        except BlockingIOError:
            return asking


def folder(tmp_path: Path, name: str) -> Path:
    made = tmp_path / name
    made.mkdir()
    return made


def test_a_second_gate_of_one_robot_is_refused_whatever_its_run_folder(
    tmp_path: Path, rid: RobotId, holders: list[subprocess.Popen[str]]
) -> None:
    holders.append(hold_elsewhere(rid, "a" * 16, tmp_path / "one"))
    other = folder(tmp_path, "other")
    with pytest.raises(EnvironmentFault) as refused:
        hold_robot(rid, "a" * 16, run=other)
    assert refused.value.reason is Reason.SERVICE_UNAVAILABLE
    assert f"(pid {holders[0].pid}, user {os.geteuid()})" in refused.value.message
    assert refused.value.where == rid
    assert list(other.iterdir()) == []


def test_a_killed_gate_frees_its_robot_and_its_folder(
    tmp_path: Path, rid: RobotId, holders: list[subprocess.Popen[str]]
) -> None:
    run = tmp_path / "run"
    holders.append(hold_elsewhere(rid, "a" * 16, run))
    holders[0].send_signal(signal.SIGKILL)
    holders[0].wait()
    lock = hold_robot(rid, "a" * 16, run=run)
    assert (run / LOCK_FILE).read_text() == f"{os.getpid()}\n"
    lock.release()


def test_another_robot_and_another_root_are_other_locks(tmp_path: Path, rid: RobotId) -> None:
    locks = [
        hold_robot(rid, "a" * 16, run=folder(tmp_path, "1")),
        hold_robot(rid, "b" * 16, run=folder(tmp_path, "2")),
        hold_robot(RobotId(f"{rid}x"), "a" * 16, run=folder(tmp_path, "3")),
    ]
    for lock in locks:
        lock.release()


def test_one_run_folder_serves_one_gate_and_a_refused_one_holds_nothing(
    tmp_path: Path, rid: RobotId
) -> None:
    run, other = folder(tmp_path, "run"), RobotId(f"{rid}x")
    lock = hold_robot(rid, "a" * 16, run=run)
    with pytest.raises(EnvironmentFault) as refused:
        hold_robot(other, "a" * 16, run=run)
    assert f"(pid {os.getpid()})" in refused.value.message
    assert refused.value.where == str(run / LOCK_FILE)
    # the robot that was refused here can be held elsewhere: its name was given back
    hold_robot(other, "a" * 16, run=folder(tmp_path, "free")).release()
    lock.release()
    lock.release()
    hold_robot(rid, "a" * 16, run=run).release()


def test_a_lock_goes_to_no_child(tmp_path: Path, rid: RobotId) -> None:
    run = folder(tmp_path, "run")
    lock = hold_robot(rid, "a" * 16, run=run)
    child = subprocess.Popen(["sleep", "60"], close_fds=False)
    try:
        lock.release()
        hold_robot(rid, "a" * 16, run=run).release()
    finally:
        child.kill()
        child.wait()


def test_a_link_in_the_place_of_the_lock_is_not_followed(tmp_path: Path, rid: RobotId) -> None:
    run, victim = folder(tmp_path, "run"), tmp_path / "victim"
    victim.write_text("keep")
    (run / LOCK_FILE).symlink_to(victim)
    with pytest.raises(EnvironmentFault):
        hold_robot(rid, "a" * 16, run=run)
    assert victim.read_text() == "keep"


def test_a_folder_that_is_not_there_is_said(tmp_path: Path, rid: RobotId) -> None:
    with pytest.raises(EnvironmentFault) as refused:
        hold_robot(rid, "a" * 16, run=tmp_path / "none")
    assert refused.value.where == str(tmp_path / "none" / LOCK_FILE)


def test_a_name_that_the_kernel_refuses_is_said(tmp_path: Path) -> None:
    with pytest.raises(EnvironmentFault) as refused:
        hold_robot(RobotId("r" * 64), "f" * 64, run=tmp_path)
    assert "cannot be taken" in refused.value.message


def test_many_refused_gates_do_not_take_the_lock_away(tmp_path: Path, rid: RobotId) -> None:
    lock = hold_robot(rid, "a" * 16, run=folder(tmp_path, "run"))
    other, told = folder(tmp_path, "other"), []
    for n in range(300):
        if n % 100 == 99:
            lock.answer()  # as a gate does once a second
        with pytest.raises(EnvironmentFault) as refused:
            hold_robot(rid, "a" * 16, run=other)
        told.append(refused.value.message)
    assert all(f"pid {os.getpid()}" in message for message in told)
    lock.release()


def test_a_gate_whose_queue_is_full_is_asked_until_it_answers(
    tmp_path: Path, rid: RobotId, holders: list[subprocess.Popen[str]]
) -> None:
    holders.append(hold_elsewhere(rid, "a" * 16, tmp_path / "one"))
    asking = fill(names_of(rid)[0])
    with ThreadPoolExecutor(1) as beside:  # it answers while the second one asks
        answered = beside.submit(say, holders[0], "answer")
        with pytest.raises(EnvironmentFault, match=f"pid {holders[0].pid}"):
            hold_robot(rid, "a" * 16, run=folder(tmp_path, "other"))
        answered.result()
    for one in asking:
        one.close()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
@pytest.mark.parametrize("queue", ["free", "full"])
def test_no_other_user_can_keep_a_gate_from_starting_by_taking_its_names(
    tmp_path: Path, rid: RobotId, holders: list[subprocess.Popen[str]], queue: str
) -> None:
    mark = "a" * 16
    plain = f"authguard-r/{rid}/{mark}"  # what a gate of long ago had, and names like ours
    holders.append(squat(54_321, plain, f"{plain}/", f"{plain}/AAAAAAAA"))
    asking = fill(f"\0{plain}/AAAAAAAA".encode()) if queue == "full" else []
    lock = hold_robot(rid, mark, run=folder(tmp_path, "run"))
    with pytest.raises(EnvironmentFault, match=f"pid {os.getpid()}"):  # and is held all the same
        hold_robot(rid, mark, run=folder(tmp_path, "other"))
    lock.release()
    for one in asking:
        one.close()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_a_name_that_another_user_saw_is_of_no_use_to_keep_the_next_gate_away(
    tmp_path: Path, rid: RobotId, holders: list[subprocess.Popen[str]]
) -> None:
    lock = hold_robot(rid, "a" * 16, run=folder(tmp_path, "run"))
    seen = names_of(rid)[0].decode()[1:]
    lock.release()
    holders.append(squat(54_321, seen))
    hold_robot(rid, "a" * 16, run=tmp_path / "run").release()


def test_lines_that_a_name_writes_into_the_kernels_list_keep_nobody_away(
    tmp_path: Path, rid: RobotId
) -> None:
    """A name may hold a line's end, and so make a line of its own, or half of one."""
    mark = "a" * 16
    line = f"0: 00000002 00000000 00010000 0001 01 7 @authguard-r/{rid}/{mark}/"
    with socket.socket(socket.AF_UNIX) as one, socket.socket(socket.AF_UNIX) as two:
        one.bind(f"\0\n{line}"[:107])
        one.listen(1)
        two.bind(f"\0authguard-r/{rid}/{mark}/\0x")
        two.listen(1)
        hold_robot(rid, mark, run=folder(tmp_path, "run")).release()


def test_a_name_that_nobody_listens_at_keeps_nobody_away(tmp_path: Path, rid: RobotId) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as silent:
        silent.bind(f"\0authguard-r/{rid}/{'a' * 16}/AAAAAAAA")
        hold_robot(rid, "a" * 16, run=folder(tmp_path, "run")).release()


def test_a_second_gate_with_the_same_key_is_refused_under_any_name(
    tmp_path: Path, rid: RobotId
) -> None:
    """As in another network namespace, where the first one's name cannot be seen."""
    key = tmp_path / "gate.key.pem"
    key.write_text("a key")
    lock = hold_robot(rid, "a" * 16, run=folder(tmp_path, "1"), key=key)
    other = folder(tmp_path, "2")
    with pytest.raises(EnvironmentFault, match="this key is running") as refused:
        hold_robot(RobotId(f"{rid}x"), "b" * 16, run=other, key=key)
    assert refused.value.where == str(key)
    hold_robot(RobotId(f"{rid}x"), "b" * 16, run=other).release()  # nothing else was held
    lock.release()
    hold_robot(rid, "a" * 16, run=other, key=key).release()


def test_a_key_that_is_not_there_is_said(tmp_path: Path, rid: RobotId) -> None:
    run, key = folder(tmp_path, "run"), tmp_path / "none"
    with pytest.raises(EnvironmentFault, match="cannot be taken") as refused:
        hold_robot(rid, "a" * 16, run=run, key=key)
    assert refused.value.where == str(key)
    hold_robot(rid, "a" * 16, run=run).release()


def test_whoever_fills_the_queue_is_answered_by_the_queue_and_no_more(
    tmp_path: Path, rid: RobotId
) -> None:
    lock = hold_robot(rid, "a" * 16, run=folder(tmp_path, "run"))
    name = names_of(rid)[0]
    asking = fill(name)
    lock.answer()  # as many as waited, not those who come meanwhile
    asking += fill(name)
    assert len(asking) > 128
    for one in asking:
        one.close()
    lock.release()


def test_the_fingerprint_is_the_roots() -> None:
    root = x509.load_pem_x509_certificate((scenarios.trust_folder() / "root.pem").read_bytes())
    found = root_fingerprint(root)
    assert len(found) == 16
    assert found == root_fingerprint(root)


@pytest.mark.parametrize("beside", ["store", "key"])
def test_a_frozen_gate_whose_queue_is_full_holds_its_robot_by_files(
    tmp_path: Path, rid: RobotId, holders: list[subprocess.Popen[str]], beside: str
) -> None:
    """Nobody answers at its name, and a second gate has other files: it would be a second one."""
    place = folder(tmp_path, "place")
    first, second = place / "first", place / "second"
    for path in (first, second):
        path.write_text("its own")
    lock = hold_robot(rid, "a" * 16, run=folder(tmp_path, "run"), **{beside: first})
    asking = fill(names_of(rid)[0])
    with pytest.raises(EnvironmentFault, match=f"running already .pid {os.getpid()}"):
        hold_robot(rid, "a" * 16, run=folder(tmp_path, "other"), **{beside: second})
    for one in asking:
        one.close()
    hold_robot(RobotId(f"{rid}x"), "a" * 16, run=tmp_path / "other", **{beside: second}).release()
    lock.release()
    hold_robot(rid, "a" * 16, run=tmp_path / "other", **{beside: second}).release()


def test_a_key_in_a_folder_of_root_s_is_held_by_its_own_file(
    tmp_path: Path, rid: RobotId, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its user can put no second key there."""
    monkeypatch.setattr(os, "access", lambda *_: False)  # the tests may run as root
    place = folder(tmp_path, "place")
    (place / "key").write_text("its own")
    hold_robot(rid, "a" * 16, run=folder(tmp_path, "run"), key=place / "key").release()
    assert list(place.iterdir()) == [place / "key"]
