# SPDX-License-Identifier: Apache-2.0
"""The symbolic robot and its estimator as processes: what they obey, and how they end.

Real processes, sockets and keys. The gate is scripted, so that it can do what no gate would.
"""

from __future__ import annotations

import json
import signal
import socket
import stat
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec
import pytest

from authguard_r.authoring.keys.setup import demo_members, init_folder
from authguard_r.core.encoding import Tag
from authguard_r.core.identifiers import RobotId
from authguard_r.core.quantities import Now
from authguard_r.core.state import Snapshot
from authguard_r.core.token import open_token
from authguard_r.keys.signer import folder_signer
from authguard_r.keys.trust import read_trust
from authguard_r.wire.frames import frame, read_body
from authguard_r.wire.messages import (
    Attest,
    ClientRole,
    Dispatch,
    Fault,
    Halt,
    Hello,
    Kind,
    Mode,
    Renew,
)
from fixtures import commands, scenarios
from fixtures.gate_process import authguard, environment
from fixtures.json_lines import whole_lines
from integration import scripted_gate
from integration.scripted_gate import (
    PATIENCE,
    Answer,
    Peer,
    ScriptedGate,
    Sensors,
    gate_at,
    navigate,
    proved,
    ticket,
    welcome,
)

GATE_KEY = f"gate-{scenarios.RID}"
#: Of the robot in these tests: it stands 1,000 ms after a stop at 1,000 mm/s.
BRAKE_MM_S2 = 1_000


class RobotSetup:
    """A run folder, a site whose robot can brake, and the processes that a test started."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.run = folder / "run"
        self.run.mkdir()
        self.trust = scenarios.trust_folder()
        self.processes: list[subprocess.Popen[str]] = []
        self.listeners: list[Sensors] = []
        text = (scenarios.HOSPITAL / "site.yaml").read_text(encoding="utf-8")
        line = "      max_payload_g: 5000\n"
        assert text.count(line) == 1
        more = f"{line}      brake_mm_s2: {BRAKE_MM_S2}\n      reaction_ms: 100\n"
        (folder / "site.yaml").write_text(text.replace(line, more), encoding="utf-8")

    def start(self, *words: object, measured: bool = False) -> subprocess.Popen[str]:
        number = len(self.processes)
        with (self.folder / f"{number}.err").open("w") as errors:
            process = subprocess.Popen(
                [str(word) for word in words],
                stdout=subprocess.PIPE,
                stderr=errors,
                text=True,
                cwd=scenarios.ROOT,
                env=environment(measured=measured),
            )
        self.processes.append(process)
        return process

    def robot_words(self, *options: object) -> list[object]:
        """Return the robot's command, without the program."""
        words = ["robot", "--site", self.folder / "site.yaml", "--robot", scenarios.RID]
        return [*words, "--gate", self.run, "--trust", self.trust, "--json", *options]

    def robot(self, *options: object) -> subprocess.Popen[str]:
        return self.start(*authguard(*self.robot_words(*options)))

    def estimator_words(self, *options: object) -> list[object]:
        """Return the estimator's command, without the program."""
        name = self.trust / "keys" / f"estimator-{scenarios.RID}"
        key = ("--key", f"{name}.key.pem", "--cert", f"{name}.cert.pem")
        words = ["estimator", "--robot", scenarios.RID, "--gate", self.run, "--trust", self.trust]
        return [*words, "--json", *key, *options]

    def estimator(self, *options: object) -> subprocess.Popen[str]:
        return self.start(*authguard(*self.estimator_words(*options)))

    def driving_gate(self, renew_within_ms: int) -> subprocess.Popen[str]:
        """Start a gate, as a process of its own, that drives the robot and renews for ever."""
        keys = self.trust / "keys"
        files = (keys / f"{GATE_KEY}.key.pem", keys / f"{GATE_KEY}.cert.pem")
        program = Path(scripted_gate.__file__ or "")
        words = (program, self.run / "gate.sock", *files, renew_within_ms)
        return self.start(sys.executable, *words, measured=True)

    def said(self, process: subprocess.Popen[str], first: int = 0) -> list[dict[str, str]]:
        """Return what a process has logged, from a line on."""
        number = self.processes.index(process)
        return whole_lines((self.folder / f"{number}.err").read_bytes())[first:]

    def sensors(self) -> Sensors:
        self.listeners.append(Sensors(self.run / "sensors.sock"))
        return self.listeners[-1]

    def deafen(self) -> None:
        """Let go of the sensors."""
        for listener in self.listeners:
            listener.close()
        self.listeners.clear()

    def end(self) -> None:
        self.deafen()
        for process in self.processes:
            process.terminate()  # it says what it ran through
            try:
                process.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            if process.stdout is not None:
                process.stdout.close()


@contextmanager
def new_house() -> Iterator[RobotSetup]:
    with TemporaryDirectory(prefix="ag-") as folder:
        it = RobotSetup(Path(folder))
        try:
            yield it
        finally:
            it.end()


@pytest.fixture
def house() -> Iterator[RobotSetup]:
    with new_house() as it:
        yield it


class Still:
    """A robot that nothing in these tests may move: one process for all of them."""

    def __init__(self, house: RobotSetup) -> None:
        self.house = house
        self.process = house.robot()
        self._first = 0

    def alone(self) -> None:
        """Wait until nobody listens for it any more, and forget what it has said so far."""
        lines = wait_for(self._alone)
        self._first = len(lines)

    def _alone(self) -> list[dict[str, str]]:
        lines = self.house.said(self.process)
        last = {line["channel"]: line["event"] for line in lines}
        is_alone = {last.get(name) for name in ("gate.sock", "stop.sock")} == {"unreachable"}
        return lines if is_alone else []

    def said(self) -> list[dict[str, str]]:
        """Return what it has said since."""
        return self.house.said(self.process, self._first)


@pytest.fixture(scope="module")
def standing() -> Iterator[Still]:
    with new_house() as house:
        yield Still(house)


@pytest.fixture
def still(standing: Still) -> Iterator[Still]:
    standing.alone()
    yield standing
    standing.house.deafen()
    assert standing.process.poll() is None


@pytest.fixture
def gate(house: RobotSetup) -> Iterator[ScriptedGate]:
    with gate_at(house.run / "gate.sock", true_answer()) as it:
        yield it


def true_answer() -> Answer:
    return proved(folder_signer(scenarios.trust_folder(), GATE_KEY), scenarios.RID)


def ready(process: subprocess.Popen[str]) -> dict[str, Any]:
    assert process.stdout is not None
    said: dict[str, Any] = json.loads(process.stdout.readline())
    return said


def place(seen: Snapshot) -> tuple[int, int]:
    assert seen.pose is not None
    return (seen.pose.x_mm, seen.pose.y_mm)


def speed(seen: Snapshot) -> int:
    value = seen.readings["speed_mm_s"].value
    assert type(value) is int
    return value


def wait_for(done: Callable[[], Any]) -> Any:
    begun = time.monotonic()
    while not (found := done()):
        assert time.monotonic() - begun < PATIENCE
        time.sleep(0.02)
    return found


def drive(house: RobotSetup, gate: ScriptedGate, sensors: Sensors) -> Peer:
    """Set the robot in motion and return its connection."""
    peer = gate.accept()
    assert peer.stood() == 0
    peer.dispatch()
    assert peer.begun().ticket == ticket()
    peer.until(lambda: speed(sensors.next()) == 1_000, renewing=1)
    return peer


@pytest.mark.smoke
def test_the_gate_of_this_robot_moves_it_to_where_it_was_sent(
    house: RobotSetup, gate: ScriptedGate
) -> None:
    robot = house.robot("--speed-up", "20")
    sensors = house.sensors()
    start = place(sensors.next())
    peer = gate.accept()
    assert ready(robot) == {"ready": True, "robot": scenarios.RID, "role": "controller"}
    peer.dispatch()
    ended = peer.ended(renewing=1)
    assert (str(ended.outcome), ended.why) == ("succeeded", "")
    assert ended.used.motion_ms > 0
    seen = sensors.until(lambda s: speed(s) == 0 and place(s) != start)
    assert place(seen) == scenarios.site().regions["pharmacy"].approach


def other_trust(house: RobotSetup) -> Path:
    """Return a trust folder of somebody else, with a gate of the same name."""
    folder = house.folder / "theirs"
    now = datetime.fromtimestamp(scenarios.START_MS / 1000, UTC)
    init_folder(folder, demo_members(scenarios.site(), (scenarios.RID,)), now=now)
    return folder


def replayed(house: RobotSetup) -> Answer:
    """Return the answer of one who has seen the true gate prove itself to this robot before."""
    seen: list[str] = []
    with gate_at(house.run / "stop.sock", true_answer()) as lane:
        true = lane.answer
        lane.answer = lambda hello: kept(true(hello), seen)
        lane.accept().close()
    return lambda hello: welcome(hello, scenarios.RID, seen[0])


def kept(answered: Any, seen: list[str]) -> Any:
    seen.append(answered.proof)
    return answered


def answer_by(
    name: str, robot: RobotId = scenarios.RID, **changes: Any
) -> Callable[[RobotSetup], Answer]:
    return lambda _: proved(folder_signer(scenarios.trust_folder(), name), robot, **changes)


IMPOSTORS: dict[str, Callable[[RobotSetup], Answer]] = {
    "a gate of another house": lambda house: proved(
        folder_signer(other_trust(house), GATE_KEY), scenarios.RID
    ),
    "another robot's gate": answer_by(f"gate-{scenarios.OTHER}"),
    "another robot's gate that says so": answer_by(f"gate-{scenarios.OTHER}", scenarios.OTHER),
    "an operator": answer_by("operator-1"),
    "this robot's estimator": answer_by(f"estimator-{scenarios.RID}"),
    "a proof for another role": answer_by(GATE_KEY, role=ClientRole.PLANNER),
    "a proof seen before": replayed,
    "no proof": lambda _: lambda hello: welcome(hello, scenarios.RID, None),
    "no welcome": lambda _: lambda _hello: None,
}


@pytest.mark.parametrize("who", IMPOSTORS)
def test_a_hijacker_that_listens_moves_nothing_and_stops_nothing(still: Still, who: str) -> None:
    house = still.house
    answer = IMPOSTORS[who](house)
    with (
        gate_at(house.run / "gate.sock", answer) as false_gate,
        gate_at(house.run / "stop.sock", answer) as false_lane,
    ):
        sensors = house.sensors()
        start = place(sensors.next())
        for _ in range(3):  # it tries again, and nobody is believed the third time either
            for server in (false_gate, false_lane):
                peer = server.accept()
                peer.dispatch(life=1)  # nobody tells it which start of the robot this is
                peer.send(Kind.RENEW, Renew(ticket=ticket()))
                peer.halt()
                peer.until(lambda it=peer: it.is_over)  # type: ignore[misc]
                assert peer.frames == []
                peer.close()
            for _ in range(5):
                seen = sensors.next()
                assert (place(seen), speed(seen)) == (start, 0)
    wanted = {"refused"} if who != "no welcome" else {"refused", "no proof in time"}
    told = [line for line in still.said() if line["event"] in wanted]
    assert {line["channel"] for line in told} == {"gate.sock", "stop.sock"}
    assert all(line.get("code") for line in told if line["event"] == "refused")


def in_shadow(answer: Answer) -> Answer:
    """Return the same server in shadow mode."""

    def answered(hello: Hello) -> Any:
        said = answer(hello)
        assert said is not None
        return msgspec.structs.replace(said, mode=Mode.SHADOW)

    return answered


def test_a_gate_in_shadow_mode_moves_nothing_and_its_stop_lane_stops_all_the_same(
    still: Still,
) -> None:
    house, answer = still.house, in_shadow(true_answer())
    with (
        gate_at(house.run / "gate.sock", answer) as gate,
        gate_at(house.run / "stop.sock", answer) as lane,
    ):
        sensors = house.sensors()
        start = place(sensors.next())
        for _ in range(2):
            peer = gate.accept()
            peer.dispatch(life=1)
            peer.until(lambda it=peer: it.is_over)  # type: ignore[misc]
            assert peer.frames == []
        stopper = lane.accept()
        stopper.halt(5)
        (told,) = stopper.until(lambda: stopper.frames)
        assert (told.kind, told.id) == (Kind.STOOD, 5)
        assert place(sensors.next()) == start
    refused = [line for line in still.said() if line["event"] == "refused"]
    assert {line["channel"] for line in refused} == {"gate.sock"}


def test_a_server_that_says_nothing_is_let_go(still: Still) -> None:
    with gate_at(still.house.run / "gate.sock", lambda _hello: None) as silent:
        peer = silent.accept()
        peer.until(lambda: peer.is_over)
        silent.accept()
    assert any(line["event"] == "no proof in time" for line in still.said())


def test_after_every_impostor_the_true_gate_is_obeyed_and_counts_no_stop(house: RobotSetup) -> None:
    path = house.run / "gate.sock"
    with gate_at(path, IMPOSTORS["no proof"](house)) as false_gate:
        house.robot()
        peer = false_gate.accept()
        peer.halt()
        peer.until(lambda: peer.is_over)
    sensors = house.sensors()
    with gate_at(path, true_answer()) as gate:
        drive(house, gate, sensors)


def test_a_hijacker_that_connects_is_let_go_and_moves_nothing(still: Still) -> None:
    house = still.house
    sensors = house.sensors()
    start = place(sensors.next())
    order = Dispatch(
        ticket=ticket(), action=navigate(), max_ms=9_000, renew_within_ms=9_000, life=1, stops=0
    )
    for message in (frame(Kind.DISPATCH, 0, order), frame(Kind.HALT, 0, Halt()), b"\0" * 100_000):
        with socket.socket(socket.AF_UNIX) as link:
            link.settimeout(PATIENCE)
            link.connect(str(house.run / "sensors.sock"))
            try:
                link.sendall(message)
                while link.recv(1 << 16):
                    pass
            except OSError:
                pass  # let go in the middle
        seen = sensors.next()
        assert (place(seen), speed(seen)) == (start, 0)


def test_the_sensors_socket_is_for_user_and_group(still: Still) -> None:
    still.house.sensors().next()
    mode = (still.house.run / "sensors.sock").stat().st_mode
    assert (stat.S_ISSOCK(mode), stat.S_IMODE(mode)) == (True, 0o660)


def test_a_listener_that_never_reads_holds_nobody_up(still: Still) -> None:
    deaf = still.house.sensors()
    sensors = still.house.sensors()
    for _ in range(40):
        sensors.next()
    assert deaf.next() is not None


def report(figure: str, value_ms: float) -> None:
    """Say what was measured; the test holds it to a generous bound only."""
    sys.stdout.write(f"{figure}: {value_ms:.0f} ms\n")


def test_a_gate_that_is_killed_in_mid_motion_leaves_a_robot_that_stands(house: RobotSetup) -> None:
    house.robot()
    sensors = house.sensors()
    gate = house.driving_gate(renew_within_ms=2_000)
    sensors.until(lambda s: speed(s) == 1_000)
    gate.kill()
    killed = time.monotonic()
    speeds = [1_000]
    sensors.until(lambda s: speeds.append(speed(s)) or speed(s) == 0)  # type: ignore[func-returns-value]
    report("kill -9 of the gate until the robot stood", (time.monotonic() - killed) * 1_000)
    assert any(0 < value < 1_000 for value in speeds)  # it braked, it did not jump
    here = place(sensors.next())
    with gate_at(house.run / "gate.sock", true_answer()) as following:
        peer = following.accept()
        ended = peer.ended()
        assert (ended.ticket, str(ended.outcome), ended.why) == (
            ticket(),
            "aborted",
            "RENEWAL_LOST",
        )
        assert peer.stood() == 1
        peer.dispatch(2, stops=0)
        assert peer.ended().why == "STOPPED"
    for _ in range(5):
        assert place(sensors.next()) == here


@pytest.mark.smoke
def test_a_gate_that_falls_silent_leaves_a_robot_that_stands(house: RobotSetup) -> None:
    house.robot()
    sensors = house.sensors()
    gate = house.driving_gate(renew_within_ms=2_000)
    sensors.until(lambda s: speed(s) == 1_000)
    gate.send_signal(signal.SIGSTOP)  # the connection stays
    silent = time.monotonic()
    sensors.until(lambda s: speed(s) == 0)
    report("silence of the gate until the robot stood", (time.monotonic() - silent) * 1_000)
    here = place(sensors.next())
    gate.send_signal(signal.SIGCONT)  # it goes on renewing what is over
    for _ in range(10):
        seen = sensors.next()
        assert (place(seen), speed(seen)) == (here, 0)


def test_the_stop_lane_stops_what_the_gate_renews(house: RobotSetup, gate: ScriptedGate) -> None:
    with gate_at(house.run / "stop.sock", true_answer()) as lane:
        house.robot()
        sensors = house.sensors()
        stopper = lane.accept()
        peer = drive(house, gate, sensors)
        stopper.dispatch(3, life=peer.life)  # nothing but a stop comes from there
        stopper.halt(5)
        told = time.monotonic()
        ended = peer.ended(renewing=1)
        assert (str(ended.outcome), ended.why) == ("aborted", "STOPPED")
        assert peer.stood() == 1
        (answer,) = stopper.until(lambda: stopper.frames)
        report("HALT until STOOD, at 1 m/s and 1 m/s2", (time.monotonic() - told) * 1_000)
        assert (answer.kind, answer.id) == (Kind.STOOD, 5)
        here = place(sensors.until(lambda s: speed(s) == 0))
        peer.dispatch(2, stops=0)
        assert peer.ended().why == "STOPPED"
        assert place(sensors.next()) == here
        peer.dispatch(3, stops=1)
        assert peer.begun().ticket == ticket(3)


def test_a_controller_that_ignores_stops_keeps_moving(
    house: RobotSetup, gate: ScriptedGate
) -> None:
    house.robot("--ignore-halt")
    sensors = house.sensors()
    peer = drive(house, gate, sensors)
    here = place(sensors.next())
    peer.halt()
    seen = sensors.until(lambda s: abs(place(s)[0] - here[0]) + abs(place(s)[1] - here[1]) > 1_500)
    assert speed(seen) == 1_000
    peer.poll()
    assert peer.frames == []


def test_a_drifting_robot_goes_elsewhere(house: RobotSetup, gate: ScriptedGate) -> None:
    house.robot("--drift-to", "office-1", "--speed-up", "50", "--fault", "overspeed=1200")
    sensors = house.sensors()
    peer = gate.accept()
    peer.dispatch()
    peer.ended(renewing=1)
    goal = scenarios.site().regions["office-1"].approach
    sensors.until(lambda s: place(s) == goal)


def test_a_message_that_is_none_costs_the_gate_its_connection(
    house: RobotSetup, gate: ScriptedGate
) -> None:
    robot = house.robot()
    sensors = house.sensors()
    peer = drive(house, gate, sensors)
    peer.send(Kind.FORWARD, {"ticket": 1})
    peer.until(lambda: peer.is_over)
    sensors.until(lambda s: speed(s) == 0)
    again = gate.accept()
    assert again.ended().why == "RENEWAL_LOST"
    assert any(line.get("code") == "MALFORMED" for line in house.said(robot))


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_robot_that_is_told_to_end_ends_cleanly(
    house: RobotSetup, number: signal.Signals
) -> None:
    robot = house.robot()
    house.sensors().next()
    robot.send_signal(number)
    assert robot.wait(PATIENCE) == 0
    assert list(house.run.iterdir()) == []


def test_a_second_process_of_the_robot_is_refused_and_a_dead_one_is_replaced(
    house: RobotSetup,
) -> None:
    first = house.robot()
    house.sensors().next()
    second = house.robot()
    out, _ = second.communicate(timeout=PATIENCE)
    assert second.returncode == 5
    assert "running already" in json.loads(out)["error"]["message"]
    first.kill()
    first.wait()
    assert (house.run / "sensors.sock").exists()
    house.robot()
    wait_for(lambda: answers(house.run / "sensors.sock"))


def answers(path: Path) -> bool:
    with socket.socket(socket.AF_UNIX) as link:
        try:
            link.connect(str(path))
        except OSError:
            return False
    return True


@pytest.mark.parametrize(
    ("options", "code", "told"),
    [
        (("--gate", "nowhere"), 5, "nowhere"),
        (("--trust", "nowhere"), 5, "root.pem"),
        (("--site", "nowhere.yaml"), 5, "nowhere.yaml"),
        (("--robot", "nobody"), 2, "nobody"),
        (("--at", "moon"), 2, "moon"),
        (("--holding", "moon"), 2, "moon"),
        (("--drift-to", "moon"), 2, "moon"),
        (("--fault", "late"), 2, "late"),
        (("--fault", "refuses=1"), 2, "refuses=1"),
        (("--fault", "gremlins"), 2, "gremlins"),
        (("--speed-up", "0"), 2, "speed"),
    ],
)
def test_a_robot_that_cannot_be_says_why(
    house: RobotSetup, options: tuple[str, str], code: int, told: str
) -> None:
    done = commands.ended(*house.robot_words(*options))
    error = json.loads(done.out)["error"]
    assert (done.code, told in error["message"] + error["where"]) == (code, True), error


def attested(peer: Peer) -> Snapshot:
    """Return the next snapshot that the estimator sent, opened as the gate would."""
    item = peer.next(Kind.SNAPSHOT)
    snapshot, _, signer = open_token(
        read_body(item.body, Attest).token,
        Snapshot,
        tag=Tag.STATE,
        roles=frozenset({"estimator"}),
        verifier=read_trust(scenarios.trust_folder()),
        now=Now(time.time_ns() // 1_000_000, 0),
    )
    assert signer.id == f"estimator-{scenarios.RID}"
    peer.send(Kind.REPLY, {}, item.id)
    return snapshot


def speed_age(snapshot: Snapshot) -> int:
    return snapshot.readings["speed_mm_s"].age_ms


def test_the_estimator_attests_what_the_sensors_say_and_never_makes_it_younger(
    house: RobotSetup, gate: ScriptedGate
) -> None:
    estimator = house.estimator()
    peer = gate.accept()
    first = house.robot("--at", "pharmacy")  # it takes the gate's other connection
    gate.accept()
    got = [attested(peer) for _ in range(5)]
    assert ready(estimator) == {"ready": True, "robot": scenarios.RID, "role": "estimator"}
    assert place(got[-1]) == scenarios.site().regions["pharmacy"].approach
    assert {snapshot.epoch for snapshot in got} == {got[0].epoch}
    assert [snapshot.seq for snapshot in got] == [1, 2, 3, 4, 5]
    first.kill()
    first.wait()
    killed = time.monotonic()
    old = attested(peer)
    while speed_age(old) < 1_000:
        assert time.monotonic() - killed < PATIENCE
        old = attested(peer)
    assert old.pose is not None
    assert old.pose.age_ms >= 1_000
    house.robot("--at", "dock")
    fresh = attested(peer)
    while place(fresh) == place(old):
        assert time.monotonic() - killed < PATIENCE
        fresh = attested(peer)
    assert speed_age(fresh) < speed_age(old)
    estimator.terminate()
    assert estimator.wait(PATIENCE) == 0


def test_one_snapshot_is_on_its_way_and_a_refusal_is_logged(
    house: RobotSetup, gate: ScriptedGate
) -> None:
    house.robot()
    gate.accept()
    estimator = house.estimator("--rate", "100")
    peer = gate.accept()
    item = peer.next(Kind.SNAPSHOT)
    peer.poll(0.5)
    assert peer.frames == []
    fault = Fault(code="STATE_STALE", message="older than the one before", where="state.seq")
    peer.send(Kind.ERROR, fault, item.id)
    assert attested(peer).seq == 2
    assert any(line.get("code") == "STATE_STALE" for line in house.said(estimator))


@pytest.mark.smoke
@pytest.mark.parametrize("who", ["no proof", "another robot's gate", "an operator"])
def test_an_impostor_gets_no_snapshot(house: RobotSetup, who: str) -> None:
    with gate_at(house.run / "gate.sock", IMPOSTORS[who](house)) as false_gate:
        estimator = house.estimator()
        house.robot()
        seen: list[Hello] = []
        answer = false_gate.answer
        false_gate.answer = lambda hello: seen.append(hello) or answer(hello)  # type: ignore[func-returns-value]
        while [hello.role for hello in seen].count(ClientRole.ESTIMATOR) < 3:
            peer = false_gate.accept()
            peer.until(lambda it=peer: it.is_over)  # type: ignore[misc]
            assert peer.frames == []
            peer.close()
    assert any(line["event"] == "refused" for line in house.said(estimator))


def test_a_gate_that_answers_no_snapshot_is_called_again(
    house: RobotSetup, gate: ScriptedGate
) -> None:
    house.estimator()
    peer = gate.accept()
    house.robot()
    gate.accept()
    peer.next(Kind.SNAPSHOT)
    peer.until(lambda: peer.is_over)
    assert attested(gate.accept()).seq == 2


@pytest.mark.parametrize(
    ("options", "code", "told"),
    [
        (("--gate", "nowhere"), 5, "nowhere"),
        (("--trust", "nowhere"), 5, "root.pem"),
        (("--key", "nowhere.pem"), 5, "nowhere.pem"),
        (("--robot", scenarios.OTHER), 4, "cert.pem"),
        (("--robot", "No Robot"), 2, "identifier"),
        (("--rate", "0"), 2, "rate"),
    ],
)
def test_an_estimator_that_cannot_be_says_why(
    house: RobotSetup, options: tuple[str, str], code: int, told: str
) -> None:
    done = commands.ended(*house.estimator_words(*options))
    error = json.loads(done.out)["error"]
    assert (done.code, told in error["message"] + error["where"]) == (code, True), error
