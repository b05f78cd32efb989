# SPDX-License-Identifier: Apache-2.0
"""The stop lane as a process, against clients that attack it: it goes on stopping the robot."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from authguard_r.access.gate_config import Peer as Named
from authguard_r.client.blocking import GateClient
from authguard_r.estop.files import EStopFiles
from authguard_r.estop.run_folder import EPOCH, FIRST_SPOOL, PID, SOCKET, SPOOL, is_served
from authguard_r.keys.trust import read_trust
from authguard_r.wire.frames import frame
from authguard_r.wire.messages import ClientRole, Kind
from authguard_r.wire.stop_limits import LIMITS
from fixtures import estop_fixtures, scenarios
from fixtures.json_lines import whole_lines

FLOODS, EACH, OWN = 4, 500, 40


@pytest.fixture
def files() -> EStopFiles:
    return estop_fixtures.files()


@pytest.fixture
def lane(files: EStopFiles) -> Iterator[Path]:
    """A lane that serves; yields its run folder."""
    with estop_fixtures.process(files):
        yield files.run


def planner(run: Path, name: str = "planner") -> estop_fixtures.Client:
    client = estop_fixtures.Client(run)
    client.hello(ClientRole.PLANNER, name)
    return client


def spooled(run: Path, name: str = SPOOL) -> list[dict[str, Any]]:
    return whole_lines((run / name).read_bytes())


def assert_stops(run: Path) -> None:
    """The lane still does what it is there for."""
    with estop_fixtures.standing_robot(run):
        client = planner(run, "witness")
        estop_fixtures.stops(client, "still there?")
        client.close()


@pytest.mark.smoke
def test_a_planner_s_stop_is_carried_out_and_recorded(lane: Path) -> None:
    with estop_fixtures.obedient_robot(lane) as robot:
        told = estop_fixtures.stops(planner(lane), "a person")
        stood = robot.stops
    line = estop_fixtures.until(lambda: spooled(lane), "the record")[-1]
    assert (line["by"], line["uid"]) == ("planner", os.geteuid())
    assert (line["role"], line["why"], line["stops"]) == ("planner", "a person", stood)
    assert line["stood_ms"] == told["after_ms"]


def test_the_project_s_own_client_stops_the_robot_and_holds_the_lane_to_its_key(
    lane: Path,
) -> None:
    trust = read_trust(scenarios.trust_folder())
    with (
        estop_fixtures.standing_robot(lane),
        GateClient.connect(
            lane / SOCKET, role=ClientRole.OPERATOR, verifier=trust, robot=scenarios.RID
        ) as client,
    ):
        client.stop("from the client")
    (line,) = estop_fixtures.until(lambda: spooled(lane, FIRST_SPOOL), "the record")
    assert (line["by"], line["why"]) == ("operator", "from the client")


def test_a_controller_that_never_stands_leaves_the_stop_unconfirmed(lane: Path) -> None:
    robot, client = estop_fixtures.Robot(lane), planner(lane)
    told = client.stop()
    assert (told["stopped"], told["controller"]) == (False, True)
    assert told["after_ms"] >= 1_000
    assert [robot.halted() for _ in range(5)] == [1] * 5


def test_a_controller_that_is_killed_confirms_nothing_and_its_successor_is_told(
    lane: Path,
) -> None:
    client = planner(lane)
    with estop_fixtures.standing_robot(lane) as pid:
        os.kill(pid, signal.SIGSTOP)
        client.say(Kind.STOP, {}, 1)
        os.kill(pid, signal.SIGKILL)
        assert client.told(Kind.REPLY)["stopped"] is False
    assert estop_fixtures.Robot(lane).halted() > 0


@pytest.mark.smoke
def test_a_forged_controller_is_refused_and_hears_nothing() -> None:
    files = estop_fixtures.files(
        estop_fixtures.config(Named(uid=os.geteuid(), roles=(ClientRole.PLANNER,)))
    )
    with estop_fixtures.process(files):
        forger = estop_fixtures.Client(files.run)
        said = {"protocol": "authguard-r/gate/1", "role": "controller", "client": "robot"}
        forger.say(Kind.HELLO, said)
        assert forger.dropped()["code"] == "ROLE_DENIED"
        told = planner(files.run).stop()
        assert told["controller"] is False


def test_another_user_s_process_may_not_be_the_gate_nor_what_it_was_not_named_for() -> None:
    if os.geteuid() != 0:
        pytest.skip("only root can become another user")
    files = estop_fixtures.files(
        estop_fixtures.config(Named(uid=4_242, roles=(ClientRole.PLANNER,)))
    )
    files.run.chmod(0o711)
    with estop_fixtures.process(files):
        (files.run / SOCKET).chmod(0o666)  # as an operator would by the folder's group
        for role, code in (("gate", "ROLE_DENIED"), ("controller", "ROLE_DENIED"), ("planner", "")):
            asked = {"protocol": "authguard-r/gate/1", "role": role, "client": "x"}
            assert _as_user(4_242, files.run, frame(Kind.HELLO, 0, asked)) == code
        assert _as_user(4_243, files.run, b"") == "ROLE_DENIED"


def _as_user(uid: int, run: Path, data: bytes) -> str:
    """Return the code that another user's process was ended with, empty when it was welcomed."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:  # pragma: no cover - another process
        try:
            os.setuid(uid)
            client = estop_fixtures.Client(run)
            if data:
                client.line.sendall(data)
            got = client.next()
            fault = {} if got is None else json.loads(got.body)
            os.write(writer, fault.get("code", "").encode())
        finally:
            os._exit(0)
    os.close(writer)
    os.waitpid(child, 0)
    told = os.read(reader, 100).decode()
    os.close(reader)
    return told


def test_a_thousand_connections_leave_room_for_those_that_are_there(lane: Path) -> None:
    client = planner(lane)
    with estop_fixtures.obedient_robot(lane):
        lines = estop_fixtures.many(lane, 1_000)
        estop_fixtures.until(lambda: estop_fixtures.open_of(lines) <= 62, "the end of the excess")
        estop_fixtures.stops(client)
    for line in lines:
        line.close()


def test_a_thousand_connections_that_say_nothing_are_ended(lane: Path) -> None:
    lines = estop_fixtures.many(lane, 1_000)
    estop_fixtures.until(lambda: estop_fixtures.open_of(lines) == 0, "the end of the silent ones")
    for line in lines:
        line.close()
    assert_stops(lane)


HELLO = frame(Kind.HELLO, 0, {"protocol": "authguard-r/gate/1", "role": "planner", "client": "p"})


BROKEN = (
    b"\0",
    HELLO[:20],
    HELLO + frame(Kind.STOP, 1, {"why": "half"})[:12],
    b"\xff\xff\xff\xff\x01\0\0\0\0",
    HELLO + b"\xff\xff\xff\xff\x60\0\0\0\0",
    os.urandom(5_000),
    b"GET / HTTP/1.1\r\n\r\n",
    HELLO * 3,
    b"\0\0\0\2\1\0\0\0\0[]",
    b"\0\0\0\4\1\0\0\0\0" + b"[" * 4,
)


def test_broken_input_ends_its_own_connection(lane: Path) -> None:
    client = planner(lane)
    wrong = [estop_fixtures.Client(lane) for _ in BROKEN]
    with estop_fixtures.obedient_robot(lane):
        for each, data in zip(wrong, BROKEN, strict=True):
            each.line.sendall(data)
            estop_fixtures.stops(client)
    for each, data in zip(wrong, BROKEN, strict=True):
        assert each.dropped().get("code"), data


def test_a_client_that_never_reads_is_dropped_and_the_others_are_served(lane: Path) -> None:
    deaf, client = planner(lane, "deaf"), planner(lane)
    deaf.line.settimeout(0)

    def is_dropped() -> bool:
        try:
            deaf.line.send(frame(Kind.STOP, 1, {}) * 50)
        except BlockingIOError:
            return False
        except OSError:
            return True
        client.stop()
        return False

    estop_fixtures.until(is_dropped, "the deaf client's end")
    assert_stops(lane)


def test_under_a_flood_from_four_processes_every_stop_is_answered_and_counted(
    lane: Path,
) -> None:
    with estop_fixtures.standing_robot(lane), ExitStack() as stack:
        floods = [
            stack.enter_context(
                estop_fixtures.script(f"flood(pathlib.Path({str(lane)!r}), 'flood-{n}', {EACH})")
            )
            for n in range(FLOODS)
        ]
        for child in floods:
            assert child.stdout is not None
            assert child.stdout.readline() == b"floods\n"
        client = planner(lane, "victim")
        for number in range(OWN):
            assert client.stop(str(number), number)["controller"] is True
        for child in floods:
            assert child.stdout is not None
            assert child.stdout.readline() == b"done\n", child.communicate()[1]
    expected = FLOODS * EACH + OWN
    estop_fixtures.until(lambda: counted(lane) == expected, "the record of all")
    lines = spooled(lane)
    assert [line["n"] for line in lines] == sorted(line["n"] for line in lines)
    assert len({line["epoch"] for line in lines}) == 1
    assert (
        len({line["n"] for line in lines}) == LIMITS.window + 1
    )  # the rest is folded: one user, one role


def counted(run: Path) -> int:
    """Return how many stops of roles that do not suspend the file tells of."""
    last = {line["n"]: 1 + line["more"] for line in spooled(run)}
    return sum(last.values())


CONNECTIONS = 8


def test_under_a_flood_from_eight_planners_an_operator_s_stop_is_told_to_a_slow_gate(
    lane: Path,
) -> None:
    """The gate hears one stop at a time, and waits for another after each."""
    with estop_fixtures.standing_robot(lane), ExitStack() as stack:
        gate, operator = estop_fixtures.Client(lane), estop_fixtures.Client(lane)
        gate.hello(ClientRole.GATE)
        operator.hello(ClientRole.OPERATOR, "anna")
        floods = [
            stack.enter_context(
                estop_fixtures.script(f"flood(pathlib.Path({str(lane)!r}), 'flood-{n}', 10**9)")
            )
            for n in range(CONNECTIONS)
        ]
        for child in floods:
            assert child.stdout is not None
            assert child.stdout.readline() == b"floods\n"
        estop_fixtures.until(lambda: counted(lane) > 10 * LIMITS.window, "the flood")
        told = operator.stop("mine")
        assert told["controller"] is True
        gate.say(Kind.SYNC, {}, 5)
        told_of = [gate.next() for _ in range(LIMITS.window + 1)]
        stops = [json.loads(item.body) for item in told_of if item is not None]
        assert [stop["role"] for stop in stops] == ["planner"] * LIMITS.window + ["operator"]
        assert (stops[-1]["by"], stops[-1]["why"]) == ("anna", "mine")
        answer = gate.next()
        assert answer is not None
        assert (answer.kind, answer.id) == (Kind.REPLY, 5)
        (line,) = estop_fixtures.until(lambda: spooled(lane, FIRST_SPOOL), "the operator's line")
        assert line["n"] == stops[-1]["n"]


def test_an_operator_s_stop_in_a_flood_outlives_a_killed_lane(files: EStopFiles) -> None:
    with estop_fixtures.process(files) as child:
        client, operator = planner(files.run), estop_fixtures.Client(files.run)
        operator.hello(ClientRole.OPERATOR, "anna")
        client.line.sendall(frame(Kind.STOP, 1, {}) * 300)
        operator.stop("mine")
        estop_fixtures.until(lambda: spooled(files.run, FIRST_SPOOL), "the operator's line")
        child.kill()
        child.wait()
    with estop_fixtures.process(files):
        gate = estop_fixtures.Client(files.run)
        gate.hello(ClientRole.GATE)
        first = gate.told(Kind.EVENT)
        assert (first["role"], first["by"], first["why"]) == ("operator", "anna", "mine")


def test_a_lane_that_is_killed_leaves_its_records_to_the_next_one(files: EStopFiles) -> None:
    with estop_fixtures.process(files) as child:
        client = planner(files.run)
        for number in range(3):
            client.stop(str(number))
        estop_fixtures.until(lambda: len(spooled(files.run)) == 3, "the records")
        child.kill()
        child.wait()
        assert client.next() is None
    with (files.run / SPOOL).open("ab") as file:
        file.write(b'{"epoch":1,"n":9')  # it died in the middle of a line
    assert (files.run / SOCKET).exists()
    with estop_fixtures.process(files):
        client = planner(files.run)
        client.stop("after")
        estop_fixtures.until(lambda: len(spooled(files.run)) == 4, "the next record")
        gate = estop_fixtures.Client(files.run)
        gate.hello(ClientRole.GATE)
        heard = [gate.told(Kind.EVENT) for _ in range(4)]
        assert [(stop["n"], stop["why"]) for stop in heard] == [
            (1, "0"),
            (2, "1"),
            (3, "2"),
            (4, "after"),
        ]
        assert heard[0]["epoch"] == heard[2]["epoch"] < heard[3]["epoch"]
        for n in (4, 2, 1, 3):
            gate.say(Kind.HEARD, {"n": n})
        estop_fixtures.until(lambda: not spooled(files.run), "the emptying")


@pytest.mark.smoke
def test_a_lane_outlives_the_gate_that_started_it_and_is_adopted_by_the_next(
    files: EStopFiles,
) -> None:
    words = json.dumps({name: str(getattr(files, name)) for name in files.__struct_fields__})
    call = f"start_and_wait({words!r})"
    lane = 0
    try:
        with estop_fixtures.script(call) as first:
            assert first.stdout is not None
            lane = int(first.stdout.readline())
            client, gate = planner(files.run), estop_fixtures.Client(files.run)
            gate.hello(ClientRole.GATE)
            client.stop("one")
            assert gate.told(Kind.EVENT)["why"] == "one"
            first.send_signal(signal.SIGKILL)
            first.wait()
            gate.line.shutdown(socket.SHUT_RDWR)  # the kernel does it to a gate that dies
            client.stop("two")
        with estop_fixtures.script(call) as second:
            assert second.stdout is not None
            assert second.stdout.readline() == b"0\n"
            gate = estop_fixtures.Client(files.run)
            gate.hello(ClientRole.GATE)
            assert [gate.told(Kind.EVENT)["why"] for _ in range(2)] == ["one", "two"]
        assert_stops(files.run)
    finally:
        if lane:
            os.kill(lane, signal.SIGKILL)


def test_a_second_lane_is_refused_with_its_reason(files: EStopFiles) -> None:
    with estop_fixtures.process(files):
        words = [
            sys.executable,
            "-c",
            "from authguard_r.cli import main; main()",
            "advanced",
            "stop-process",
        ]
        for name in ("run", "robot", "trust", "key", "cert", "config"):
            words += [f"--{'gate' if name == 'run' else name}", str(getattr(files, name))]
        second = subprocess.run([*words, "--json"], capture_output=True, check=False)
        assert second.returncode == 5
        error = json.loads(second.stdout)["error"]
        assert error["code"] == "SERVICE_UNAVAILABLE"
        assert "already" in error["message"]
        assert_stops(files.run)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_lane_that_is_asked_to_end_leaves_nothing_behind(
    files: EStopFiles, number: signal.Signals
) -> None:
    with estop_fixtures.process(files) as child:
        assert (files.run / PID).read_text() == f"{child.pid}\n"
        child.send_signal(number)
        assert child.wait(estop_fixtures.SOON_S) == 0
        assert not is_served(files.run / SOCKET)
        left = ["gate.token", FIRST_SPOOL, EPOCH, SPOOL]
        assert sorted(path.name for path in files.run.iterdir()) == left
