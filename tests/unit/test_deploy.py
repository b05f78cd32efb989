# SPDX-License-Identifier: Apache-2.0
"""What is shipped for a robot: users apart, processes shut in, commands that exist, hashes held."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from fixtures.cases import case

pytestmark = pytest.mark.smoke

ROOT = Path(__file__).resolve().parents[2]
DEPLOY = ROOT / "deploy"
UNITS = sorted((DEPLOY / "systemd").glob("*.service"))
PROGRAM = "/opt/authguard-r/bin/authguard"
#: ROS 2 has its own Python; so have the processes on it.
ROS_PYTHON = "/opt/authguard-ros/bin/python"
ON_ROS = ("gate", "deadman", "actuator", "estimator")
#: Of them, who speaks to the gate.
SPEAKS = {"gate", "estimator"}
#: What every process is held by, whatever it is for.
HARDENING = {
    "NoNewPrivileges": "yes",
    "CapabilityBoundingSet": "",
    "AmbientCapabilities": "",
    "UMask": "0077",
    "ProtectSystem": "strict",
    "ProtectHome": "yes",
    "PrivateTmp": "yes",
    "PrivateDevices": "yes",
    "ProtectClock": "yes",
    "ProtectKernelModules": "yes",
    "ProtectKernelTunables": "yes",
    "ProtectControlGroups": "yes",
    "ProtectProc": "invisible",
    "RestrictAddressFamilies": "AF_UNIX",
    "RestrictNamespaces": "yes",
    "RestrictSUIDSGID": "yes",
    "LockPersonality": "yes",
    "MemoryDenyWriteExecute": "yes",
    "IPAddressDeny": "any",
    "LimitCORE": "0",
}
#: A witness answers over TCP on its own machine; nothing else has a network.
OVER_TCP = {"RestrictAddressFamilies": "AF_UNIX AF_INET AF_INET6"}
#: DDS speaks UDP, and asks the kernel for the machine's addresses.
OVER_DDS = {"RestrictAddressFamilies": "AF_UNIX AF_INET AF_INET6 AF_NETLINK"}
ANALYZE = ("systemd-analyze", "security", "--offline=yes", "--threshold=15", "--no-pager")
#: Becomes a process that can make no memory executable and gain no privilege, then runs a command.
SHUT_IN = """
import ctypes, resource, sys
libc = ctypes.CDLL(None)
shut = libc.prctl(65, 1, 0, 0, 0) == 0
assert libc.prctl(38, 1, 0, 0, 0) == 0
resource.setrlimit(resource.RLIMIT_NOFILE, (256, 256))
from authguard_r.cli import call
sys.exit(call(sys.argv[1:]) if shut else 77)
"""


def settings(unit: Path) -> dict[str, list[str]]:
    """Return every setting of a unit with all its values, in order."""
    found: dict[str, list[str]] = {}
    for line in unit.read_text(encoding="utf-8").splitlines():
        name, equals, value = line.partition("=")
        if equals and not line.startswith("#"):
            found.setdefault(name, []).append(value)
    return found


def unit(name: str) -> dict[str, list[str]]:
    (path,) = (DEPLOY / "systemd").glob(f"authguard-{name}[@.]*service")
    return settings(path)


def test_the_units_are_there() -> None:
    assert [path.name for path in UNITS] == [
        "authguard-estimator@.service",
        "authguard-gate@.service",
        "authguard-robot@.service",
        "authguard-ros-actuator@.service",
        "authguard-ros-deadman@.service",
        "authguard-ros-estimator@.service",
        "authguard-ros-gate@.service",
        "authguard-stop-lane@.service",
        "authguard-witness.service",
    ]


def test_every_process_is_shut_in_and_bounded() -> None:
    for path in UNITS:
        with case(path):
            found = settings(path)
            network = (
                OVER_TCP if "witness" in path.name else OVER_DDS if "-ros-" in path.name else {}
            )
            expected = {**HARDENING, **network}
            assert {name: found.get(name) for name in expected} == {
                n: [v] for n, v in expected.items()
            }
            assert found["SystemCallFilter"][0] == "@system-service"
            assert found["SystemCallFilter"][1].startswith("~@privileged")
            for bound in ("MemoryMax", "TasksMax", "LimitNOFILE"):
                assert re.fullmatch(r"[0-9]+M?", found[bound][0])
            assert found["User"][0] not in {"root", "0"}
            assert found["Restart"][0] in {"on-failure", "always"}


def test_users_are_apart_and_the_planners_runs_nothing_of_ours() -> None:
    users = {name: unit(name)["User"][0] for name in ("gate", "stop-lane", "robot", "estimator")}
    # nobody but the gate's own user may speak to the lane as the gate
    assert users["gate"] == users["stop-lane"]
    assert len(set(users.values())) == 3
    text = (DEPLOY / "sysusers.d" / "authguard-r.conf").read_text(encoding="utf-8")
    made = set(re.findall(r"^u (\S+)", text, re.MULTILINE))
    assert made == {*users.values(), "authguard-planner"}
    # each reaches the sockets by its group, and not by being somebody
    assert set(re.findall(r"^m (\S+) +authguard$", text, re.MULTILINE)) == made
    body = set(re.findall(r"^m (\S+) +authguard-body$", text, re.MULTILINE))
    assert body == {users["robot"], users["estimator"]}
    for name in ("robot", "estimator"):
        assert unit(name)["Group"] == ["authguard-body"]
        # the gate's folder is nobody else's to write
        assert "--gate /run/authguard-body/%i" in unit(name)["ExecStart"][0]


def test_a_witness_is_nobody_of_the_robots_and_answers_this_machine_alone() -> None:
    found = unit("witness")
    text = (DEPLOY / "sysusers.d" / "authguard-witness.conf").read_text(encoding="utf-8")
    made = re.findall(r"^(\S+) (\S+)", text.replace("#", "\n#"), re.MULTILINE)
    assert [name for kind, name in made if kind != "#"] == found["User"] == found["Group"]
    assert "SupplementaryGroups" not in found
    robots = (DEPLOY / "sysusers.d" / "authguard-r.conf").read_text(encoding="utf-8")
    assert found["User"][0] not in robots
    assert found["IPAddressAllow"] == ["localhost"]
    assert "--behind-tls" not in found["ExecStart"][0]
    assert found["StateDirectoryMode"] == ["0700"]
    assert set(found["InaccessiblePaths"]) == {"-/etc/authguard-r", "-/var/lib/authguard-r"}
    # what it does not start with, a restart does not mend
    assert found["RestartPreventExitStatus"] == ["5"]


def test_only_the_gate_and_its_lane_come_near_the_gates_key_and_only_the_gate_near_its_store() -> (
    None
):
    for name in ("estimator", "robot"):
        found = unit(name)
        assert "-/etc/authguard-r/%i/gate" in found["InaccessiblePaths"]
        assert "/gate/gate.key.pem" not in found["ExecStart"][0]
    for name in ("estimator", "robot", "stop-lane"):
        assert "-/var/lib/authguard-r" in unit(name)["InaccessiblePaths"]
        assert "StateDirectory" not in unit(name)
    assert unit("gate")["StateDirectoryMode"] == ["0700"]


def test_the_lane_outlives_the_gate_and_the_gates_lock_is_the_hosts() -> None:
    lane, gate = unit("stop-lane"), unit("gate")
    assert lane["Restart"] == ["always"]
    assert not {"PartOf", "BindsTo", "Requires"} & {*lane, *gate}
    assert gate["RuntimeDirectoryPreserve"] == lane["RuntimeDirectoryPreserve"] == ["yes"]
    assert lane["PrivateNetwork"] == ["yes"]
    assert "PrivateNetwork" not in gate  # an abstract name counts within one network namespace


def ros_unit(name: str) -> dict[str, list[str]]:
    return unit(f"ros-{name}")


def test_each_process_on_ros_is_a_user_of_its_own_and_two_alone_reach_the_gate() -> None:
    users = {name: ros_unit(name)["User"][0] for name in ON_ROS}
    text = (DEPLOY / "sysusers.d" / "authguard-ros.conf").read_text(encoding="utf-8")
    made = set(re.findall(r"^u (\S+)", text, re.MULTILINE))
    estimator = unit("estimator")["User"][0]  # who attests is who he was
    assert users["estimator"] == estimator
    assert made | {estimator} == {*users.values()}
    assert len({*users.values()}) == 4
    robots = (DEPLOY / "sysusers.d" / "authguard-r.conf").read_text(encoding="utf-8")
    assert not any(name in robots for name in made)
    # by its group, and nobody else
    assert re.findall(r"^m (\S+) +(\S+)$", text, re.MULTILINE) == [(users["gate"], "authguard")]
    for name in ON_ROS:
        found = ros_unit(name)
        assert found["Group"] == found["User"]
        assert found.get("SupplementaryGroups", []) == (["authguard"] if name in SPEAKS else [])
        assert "-/etc/authguard-r/%i/gate" in found["InaccessiblePaths"]
        assert "-/var/lib/authguard-r" in found["InaccessiblePaths"]
        assert ("-/run/authguard-r" in found["InaccessiblePaths"]) == (name not in SPEAKS)
        hidden = "-/etc/authguard-r/%i/estimator" in found["InaccessiblePaths"]
        assert hidden == (name != "estimator")
        assert found["IPAddressAllow"] == ["localhost"]


def test_the_robots_own_process_can_serve_its_sensors_where_the_estimator_looks() -> None:
    """The gate's run folder is the gate's to write: this one is the sensors' group's."""
    found = ros_unit("estimator")
    words = shlex.split(found["ExecStart"][0])
    folder = words[words.index("--gate") + 1]
    made, linked = (shlex.split(line.removeprefix("+")) for line in found["ExecStartPre"])
    assert made[1:] == ["-d", "-o", found["User"][0], "-g", "authguard-body", "-m", "2770", folder]
    assert linked[1:] == ["-sfn", "/run/authguard-r/%i/gate.sock", f"{folder}/gate.sock"]
    robots = (DEPLOY / "sysusers.d" / "authguard-r.conf").read_text(encoding="utf-8")
    assert (found["User"][0], "authguard-body") in re.findall(
        r"^m (\S+) +(\S+)$", robots, re.MULTILINE
    )
    assert "authguard-planner authguard-body" not in robots


def test_what_stops_a_robot_on_ros_outlives_the_gates_node() -> None:
    for name in ON_ROS:
        found = ros_unit(name)
        # whatever it ends of, it is started again, however often
        assert (found["Restart"], found["StartLimitIntervalSec"]) == (["always"], ["0"])
        assert not {"PartOf", "BindsTo", "Requires", "Requisite", "StopPropagatedFrom"} & {*found}
        assert "PropagatesStopTo" not in found
        # one signs the robot's state, or the gate shuts the older one out
        others = ["authguard-estimator@%i.service"] if name == "estimator" else []
        assert found.get("Conflicts", []) == others
    for name in ("deadman", "actuator"):
        assert not {"After", "Wants"} & {*ros_unit(name)}
    assert ros_unit("gate")["Wants"] == ["authguard-ros-deadman@%i.service"]


def test_the_processes_on_ros_start_with_security_exactly_as_they_want_it(tmp_path: Path) -> None:
    from authguard_r.integrations.ros.keystore import make_keystore
    from authguard_r.integrations.ros.map import read_map
    from authguard_r.integrations.ros.security import (
        KEYSTORE,
        OVERRIDE,
        PROFILES,
        security_faults,
    )

    for name in ON_ROS:
        assert ros_unit(name)["EnvironmentFile"] == ["/etc/authguard-r/%i/ros.env"]
        (log,) = ros_unit(name)["Environment"]
        # without a folder that it may write, ROS 2 makes no node
        (own,) = ros_unit(name)["RuntimeDirectory"]
        assert log == f"ROS_LOG_DIR=/run/{own}"
    lines = (DEPLOY / "ros" / "ros.env").read_text(encoding="utf-8").splitlines()
    told = dict(line.split("=", 1) for line in lines if line and not line.startswith("#"))
    ros = read_map(ROOT / "examples" / "ros" / "map.yaml")
    make_keystore(ros, tmp_path / "keystore")
    assert told[KEYSTORE] == "/etc/authguard-r/courier-1/keystore"
    assert OVERRIDE not in told
    told[KEYSTORE] = str(tmp_path / "keystore")
    # `LOCALHOST` adds shared memory whatever the profile says
    assert told["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "SYSTEM_DEFAULT"
    for profile in PROFILES:
        assert told[profile] == "/etc/authguard-r/courier-1/loopback.xml"
        told[profile] = str(DEPLOY / "ros" / "loopback.xml")
    ours = (ros.enclaves.gate, ros.enclaves.deadman, ros.enclaves.estimator)
    for enclave in (*ours, "/robot/base"):
        assert list(security_faults(ros, enclave, told)) == []
    assert [fault.where for fault in security_faults(ros, ros.enclaves.gate, {})]


@pytest.mark.parametrize("name", ON_ROS)
def test_a_unit_on_ros_starts_a_module_that_there_is(name: str) -> None:
    python, flag, module, *words = shlex.split(ros_unit(name)["ExecStart"][0])
    assert (python, flag) == (ROS_PYTHON, "-m")
    assert (ROOT / "src" / f"{module.replace('.', '/')}.py").is_file()
    assert "--demo" not in words


@pytest.mark.parametrize("path", [path for path in UNITS if "-ros-" not in path.name])
def test_every_unit_starts_a_command_that_there_is(path: Path) -> None:
    from authguard_r.cli.app import program

    words = shlex.split(settings(path)["ExecStart"][0])
    assert words[0] == PROGRAM
    command: Any = program()
    rest = words[1:]
    while hasattr(command, "commands"):
        command = command.commands[rest.pop(0)]
    known = {o: p for p in command.params for o in p.opts}
    given = [word for word in rest if word.startswith("--")]
    assert set(given) <= set(known)
    # nothing that it cannot start without is left out
    needed = {parameter.opts[0] for parameter in known.values() if parameter.required}
    assert {name for name in needed if name.startswith("--")} <= set(given)
    assert "--demo" not in given


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
@pytest.mark.parametrize("path", UNITS, ids=lambda path: path.name)
def test_systemd_understands_every_unit_and_finds_little_exposed(
    path: Path, tmp_path: Path
) -> None:
    for one in UNITS:
        text = one.read_text(encoding="utf-8")
        text = text.replace(PROGRAM, sys.executable).replace(ROS_PYTHON, sys.executable)
        (tmp_path / one.name).write_text(text, encoding="utf-8")
    named = str(tmp_path / path.name.replace("@", "@courier-1"))
    done = subprocess.run(
        ["systemd-analyze", "verify", named], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout + done.stderr) == (0, "")
    done = subprocess.run(
        [
            "systemd-analyze",
            "security",
            "--offline=yes",
            "--threshold=15",
            "--no-pager",
            str(tmp_path / path.name),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout


@pytest.mark.skipif(shutil.which("systemd-sysusers") is None, reason="needs systemd-sysusers")
@pytest.mark.skipif(os.geteuid() != 0, reason="folders are given to their users")
def test_systemd_makes_the_users_and_gives_them_their_folders(tmp_path: Path) -> None:
    (tmp_path / "etc" / "tmpfiles.d").mkdir(parents=True)
    for name in ("authguard-r.conf", "authguard-ros.conf"):
        made = DEPLOY / "sysusers.d" / name
        subprocess.run(["systemd-sysusers", f"--root={tmp_path}", str(made)], check=True)
    users = {}
    for line in (tmp_path / "etc" / "passwd").read_text(encoding="utf-8").splitlines():
        name, _, uid, gid, _, _, shell = line.split(":")
        users[name] = (int(uid), int(gid), shell)
    assert {shell for _, _, shell in users.values()} == {"/usr/sbin/nologin"}
    assert len({uid for uid, _, _ in users.values()}) == 7
    shutil.copy(DEPLOY / "tmpfiles.d" / "authguard-r.conf", tmp_path / "etc" / "tmpfiles.d")
    command = ["systemd-tmpfiles", "--create", f"--root={tmp_path}", "authguard-r.conf"]
    subprocess.run(command, check=True)
    found = (tmp_path / "var" / "lib" / "authguard-r").stat()
    assert (found.st_uid, found.st_mode & 0o777) == (users["authguard-gate"][0], 0o711)
    assert (tmp_path / "etc" / "authguard-r").stat().st_uid == 0


def test_the_program_runs_where_no_memory_becomes_executable(tmp_path: Path) -> None:
    for command in (["doctor"], ["demo"]):
        done = subprocess.run(
            [sys.executable, "-c", SHUT_IN, *command],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=300,
            check=False,
        )
        if done.returncode == 77:
            pytest.skip("this kernel cannot deny it")
        assert done.returncode == 0, done.stdout + done.stderr


def pinned(path: Path) -> dict[str, set[str]]:
    """Return every pinned release of a lock file with its hashes."""
    blocks = re.split(r"^(?=[a-z])", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
    found = {}
    for block in blocks:
        name = re.match(r"([a-z0-9._-]+==[^ ;\\]+)", block)
        if name is not None:
            found[name[1]] = set(re.findall(r"sha256:[0-9a-f]{64}", block))
    return found


def test_a_container_gets_what_was_tested_by_its_hashes_and_nothing_else() -> None:
    gate = pinned(DEPLOY / "container" / "requirements.lock")
    everything = pinned(ROOT / "requirements.lock")
    assert {name: everything.get(name) for name in gate} == gate
    assert all(gate.values())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    wanted = {re.split(r"[<>=]", line)[0] for line in project["project"]["dependencies"]}
    names = {release.partition("==")[0] for release in gate}
    assert wanted <= names
    assert not names & {"pytest", "openai", "anthropic", "uv", "pip"}


def test_a_container_runs_as_nobody_special_and_installs_by_hash() -> None:
    text = (DEPLOY / "container" / "Containerfile").read_text(encoding="utf-8")
    (base,) = re.findall(r"^FROM (.*)$", text, re.MULTILINE)
    assert re.fullmatch(r"python:3\.11-slim-bookworm@sha256:[0-9a-f]{64}", base)
    (user,) = re.findall(r"^USER (.*)$", text, re.MULTILINE)
    assert user == "990:990"
    assert text.index("USER") > text.rindex("RUN")
    script = (DEPLOY / "container" / "install.sh").read_text(encoding="utf-8")
    installs = [line for line in script.splitlines() if line.startswith("$pip")]
    assert len(installs) == 2
    assert all("--require-hashes" in line for line in installs)


@pytest.mark.parametrize("name", ["prepare.sh", "install.sh", "check.sh"])
def test_the_scripts_are_plain_shell(name: str) -> None:
    subprocess.run(["sh", "-n", str(DEPLOY / "container" / name)], check=True)


def test_a_source_release_has_it_all() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert "deploy" in project["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
