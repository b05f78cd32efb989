# SPDX-License-Identifier: Apache-2.0
"""A robot's processes under users of their own, as `deploy/` has them: none can do another's.

Root is needed to become several users. The root of trust is no demonstration, so the gate holds
itself to everything that it demands of a real robot.
"""

from __future__ import annotations

import json
import os
import select
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import pytest

from unit.server.deployed import (
    BODY,
    CLIENTS,
    ESTIMATOR,
    GATE,
    OPERATOR,
    PLANNER,
    ROBOT,
    STRANGER,
    User,
    lay_out,
)

pytestmark = pytest.mark.skipif(os.geteuid() != 0, reason="only root can be several users")

#: Loads everything as root, for the interpreter may lie where others may not read, what is loaded
#: late too; then becomes the user for good, and runs one command.
LAUNCH = """
import asyncio, contextlib, ctypes, importlib.readers, io, os, pkgutil, sys
from importlib import import_module
import authguard_r
from authguard_r.cli import call
for module in pkgutil.walk_packages(authguard_r.__path__, "authguard_r."):
    with contextlib.suppress(ImportError):  # of an extra that is not installed
        import_module(module.name)
for name in ("utf-16be", "ascii", "idna"):
    "x".encode(name)
with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
    call(["doctor"]), call(["doctor", "--trust", "none", "--site", "none"])
uid, gid, groups = int(sys.argv[1]), int(sys.argv[2]), [int(g) for g in sys.argv[3].split(",")]
os.umask(0o077); os.setgroups(groups); os.setresgid(gid, gid, gid); os.setresuid(uid, uid, uid)
sys.exit(call(sys.argv[4:]))
"""
PATIENCE_S = 60
#: Somebody whose witness serves on this machine.
WITNESS = User(71_007, 71_007, (71_007,))


@dataclass
class Machine:
    """One robot's folders, and the processes that were started on them."""

    folder: Path
    started: list[subprocess.Popen[str]] = field(default_factory=list)

    def start(self, user: User, *words: str) -> subprocess.Popen[str]:
        """Start a command as a user and return once it says that it is ready."""
        process = self._launch(user, *words, "--json")
        assert process.stdout is not None
        came, _, _ = select.select([process.stdout], [], [], PATIENCE_S)
        line = process.stdout.readline() if came else "{}"
        assert json.loads(line or "{}").get("ready") is True, self._said(line)
        return process

    def _said(self, line: str) -> str:
        """Return everything that was said so far; ends every process."""
        for process in self.started:
            process.kill()
        return line + "".join(process.communicate()[1] for process in self.started)

    def run(self, user: User, *words: str) -> tuple[int, str]:
        """Run a command as a user to its end and return its code and what it said."""
        process = self._launch(user, *words)
        out, err = process.communicate(timeout=PATIENCE_S)
        assert "Traceback" not in err
        return process.returncode, out + err

    def _launch(self, user: User, *words: str) -> subprocess.Popen[str]:
        groups = ",".join(map(str, user.groups))
        command = [sys.executable, "-c", LAUNCH, str(user.uid), str(user.gid), groups]
        process = subprocess.Popen(
            [*command, *words],
            cwd=self.folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self.started.append(process)
        return process

    def parts(self) -> list[str]:
        """Return the options of everything that a gate reads."""
        etc = self.folder / "etc"
        return [
            *("--robot", "courier-1", "--trust", f"{etc}/trust", "--config", f"{etc}/gate.token"),
            *("--key", f"{etc}/gate/gate.key.pem", "--cert", f"{etc}/gate/gate.cert.pem"),
            *("--gate", f"{self.folder}/run"),
        ]

    def gate(self, *, store: str = "store/robot.db") -> list[str]:
        """Return the gate's command, as its unit has it."""
        etc = self.folder / "etc"
        named = ["--site", f"{etc}/site.token", "--binding", f"{etc}/binding.yaml"]
        named += ["--safety", f"{etc}/safety.token", "--store", f"{self.folder}/{store}"]
        return ["gate", *self.parts(), *named]


@pytest.fixture
def machine() -> Iterator[Machine]:
    folder = Path(mkdtemp(prefix="authguard-users-", dir="/tmp"))
    folder.chmod(0o755)
    made = Machine(folder)
    lay_out(folder)
    yield made
    for process in made.started:
        process.kill()
    for process in made.started:
        process.communicate()
    shutil.rmtree(folder)


def test_a_robot_runs_under_users_of_their_own(machine: Machine) -> None:
    etc, run, body = machine.folder / "etc", machine.folder / "run", machine.folder / "body"
    lane = machine.start(GATE, "advanced", "stop-process", *machine.parts())
    gate = machine.start(GATE, *machine.gate())
    site = ["--site", f"{etc}/site.token"]
    common = ["--robot", "courier-1", "--trust", f"{etc}/trust", "--gate", str(body)]
    machine.start(ROBOT, "robot", *common, *site)
    own = ["--key", f"{etc}/estimator/estimator.key.pem"]
    own += ["--cert", f"{etc}/estimator/estimator.cert.pem"]
    machine.start(ESTIMATOR, "estimator", *common, *own)

    def status() -> Any:
        words = ["--gate", str(run / "gate.sock"), "--trust", f"{etc}/trust", "--json"]
        code, text = machine.run(OPERATOR, "status", *words)
        assert code == 0, text
        return json.loads(text)

    assert status()["robot"] == "courier-1"
    # whoever has no role here gets nothing, a planner gets no operator's answers
    for user in (PLANNER, STRANGER):
        code, text = machine.run(user, "status", "--gate", str(run / "gate.sock"))
        assert (code, "ROLE_DENIED" in text) == (4, True), text
    # a second gate of this robot is refused, wherever it keeps its sockets and its store
    other = machine.folder / "other"
    other.mkdir()
    os.chown(other, GATE.uid, GATE.gid)
    words = [w.replace(str(run), str(other)) for w in machine.gate(store="store/other.db")]
    code, text = machine.run(GATE, *words)
    assert (code, "running already" in text) == (5, True), text
    assert f"pid {gate.pid}" in text
    # killed, it leaves nothing in its own way; the stop lane went on
    gate.kill()
    gate.wait()
    assert lane.poll() is None
    machine.start(GATE, *machine.gate())
    assert status()["robot"] == "courier-1"


def test_the_planner_can_read_and_write_nothing_that_counts(machine: Machine) -> None:
    machine.start(GATE, "advanced", "stop-process", *machine.parts())
    machine.start(GATE, *machine.gate())
    etc, run = machine.folder / "etc", machine.folder / "run"
    tried = f"""
import os
os.setgroups({list(PLANNER.groups)}); os.setresgid(*[{PLANNER.gid}] * 3)
os.setresuid(*[{PLANNER.uid}] * 3)
def may(act):
    try:
        act()
    except OSError:
        return False
    return True
reads = ["{etc}/gate/gate.key.pem", "{etc}/estimator/estimator.key.pem"]
reads += ["{machine.folder}/store/robot.db"]
writes = ["{run}/x", "{run}/gate.lock", "{etc}/x", "{etc}/binding.yaml", "{etc}/trust/root.pem"]
print([p for p in reads if may(lambda: open(p))])
print([p for p in writes if may(lambda: open(p, "a"))])
print([n for n in ("gate.sock", "stop.sock") if may(lambda: os.unlink("{run}/" + n))])
print(os.listdir("{run}") != [])
"""
    done = subprocess.run(
        [sys.executable, "-IS", "-c", tried], capture_output=True, text=True, check=True, cwd="/"
    )
    assert done.stdout.splitlines() == ["[]", "[]", "[]", "True"]


def test_the_gate_cannot_touch_what_its_witness_keeps(machine: Machine) -> None:
    """Who holds the robot's store cannot make the witness forget, nor sign as it."""
    home = machine.folder / "witness"
    home.mkdir(mode=0o755)  # so that only the witness's own folder keeps others out
    os.chown(home, WITNESS.uid, WITNESS.gid)
    own = home / "own"
    assert machine.run(WITNESS, "witness", "init", str(own), "--name", "w1.example")[0] == 0
    serves = machine.start(WITNESS, "witness", "serve", str(own))
    names = sorted(str(path) for path in own.rglob("*") if path.is_file())
    assert any(private(Path(name)) for name in names)
    before = {name: Path(name).read_bytes() for name in names}
    tried = f"""
import os
os.setgroups({list(GATE.groups)}); os.setresgid(*[{GATE.gid}] * 3); os.setresuid(*[{GATE.uid}] * 3)
def may(act):
    try:
        act()
    except OSError:
        return False
    return True
names, own = {names!r}, {str(own)!r}
print([n for n in names if may(lambda: open(n, "rb"))])
print([n for n in (*names, own + "/x", own + "-x") if may(lambda: open(n, "ab"))])
print([n for n in names if may(lambda: os.unlink(n))])
print([how.__name__ for how in (os.rmdir, os.listdir) if may(lambda: how(own))])
print(may(lambda: os.rename(own, own + "-away")), may(lambda: os.kill({serves.pid}, 9)))
"""
    done = subprocess.run(
        [sys.executable, "-IS", "-c", tried], capture_output=True, text=True, check=True, cwd="/"
    )
    assert done.stdout.splitlines() == ["[]", "[]", "[]", "[]", "False False"]
    assert {name: Path(name).read_bytes() for name in names} == before
    assert serves.poll() is None
    # nor does it serve as that witness, or see what it knows
    for verb in ("serve", "show"):
        code, text = machine.run(GATE, "witness", verb, str(own))
        assert (code, "is not readable" in text) == (2, True), text


def private(path: Path) -> bool:
    return b"PRIVATE KEY" in path.read_bytes()


@pytest.mark.parametrize(
    ("name", "mode", "told"),
    [
        ("etc/gate/gate.key.pem", 0o640, "readable by others"),
        ("etc/binding.yaml", 0o666, "writable by others"),
        ("store", 0o777, "writable by others"),
    ],
)
def test_a_gate_does_not_start_with_what_is_unsafe(
    machine: Machine, name: str, mode: int, told: str
) -> None:
    (machine.folder / name).chmod(mode)
    code, text = machine.run(GATE, *machine.gate())
    assert code == 5, text
    assert "unsafe: " in text
    assert told in text
    assert not (machine.folder / "store" / "robot.db").exists()


def test_root_starts_no_gate_and_the_doctor_says_why(machine: Machine) -> None:
    root = User(uid=0, gid=0, groups=(0,))
    code, text = machine.run(root, *machine.gate())
    assert (code, "unsafe: " in text) == (5, True), text
    etc = machine.folder / "etc"
    words = ["doctor", *machine.parts()[2:], "--site", f"{etc}/site.token"]
    words += ["--binding", f"{etc}/binding.yaml", "--store", f"{machine.folder}/store/robot.db"]
    code, text = machine.run(root, *words)
    assert (code, "the gate runs as root" in text) == (5, True), text
    code, text = machine.run(GATE, *words)
    assert code == 0, text
    code, text = machine.run(root, *words, "--user", str(GATE.uid))
    assert code == 0, text


@pytest.mark.smoke
def test_the_groups_are_those_of_the_units() -> None:
    assert GATE.gid == CLIENTS
    assert BODY not in PLANNER.groups
    assert CLIENTS in PLANNER.groups
