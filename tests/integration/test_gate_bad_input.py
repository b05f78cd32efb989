# SPDX-License-Identifier: Apache-2.0
"""Whatever a client sends, it is answered or dropped alone: the rest are served, the log says why.

The gate is the program itself. Beside every attack somebody behaves well, and has to be answered
each time; after all of them nothing is left of the attackers but their records.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from itertools import count
from pathlib import Path
from random import Random
from typing import Any, Self

import pytest

from authguard_r.access.gate_config import Peer
from authguard_r.core.encoding import Tag, b64, encode_fast, unb64
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.identifiers import RobotId
from authguard_r.core.state import Snapshot
from authguard_r.core.token import sign_object
from authguard_r.keys.signer import folder_signer
from authguard_r.sim.robot import snapshot_of
from authguard_r.wire.frames import frame, raw_frame
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import BOUND, PROTOCOL, Attest, ClientRole, Kind
from fixtures import frame_streams, scenarios
from fixtures.gate_process import EVERY, Line, RunningGate, Told, shown, until

PLAN = b'{"tool": "scan", "arguments": {}}'
#: A user of this machine that the configuration does not name.
STRANGER = 12_345
SEQ = count(1)
GROWTH_KIB = 50 * 1_024
ROLES = tuple(role for role in EVERY if role is not ClientRole.CONTROLLER)


class Beside:
    """Somebody who behaves well while others do not; `check` asks once more and counts."""

    def __init__(self, gate: RunningGate) -> None:
        self._robot = gate.rid
        self._planner = gate.client(ClientRole.PLANNER, "well-behaved")
        self._auditor = gate.client(ClientRole.AUDITOR, "well-behaved")
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._ask)
        self._lock = threading.Lock()
        self._wrong: list[Exception] = []
        self.rounds = 0

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        for client in (self._planner, self._auditor):
            client.close()

    def check(self) -> None:
        """Require that everything was answered so far, and that one more round is."""
        self.round()
        assert not self._wrong, self._wrong

    def round(self) -> None:
        """Ask what a planner and an auditor ask."""
        with self._lock:
            self._planner.observe("camera", f"round {self.rounds}")
            answer = self._planner.propose(PLAN, timeout_ms=60_000)
            assert len(answer["steps"]) == 1, answer
            assert self._auditor.status()["robot"] == self._robot
            self.rounds += 1

    def _ask(self) -> None:
        while not self._over.wait(0.05):
            try:
                self.round()
            except (AuthGuardError, AssertionError) as error:
                self._wrong.append(error)
                return


@pytest.fixture(scope="module")
def gate() -> Iterator[RunningGate]:
    peers = (Peer(uid=os.geteuid(), roles=ROLES),)
    with RunningGate(peers=peers, refusals=0, fold_ms=0) as running:
        with running.client(ClientRole.PLANNER, "first") as first:
            first.propose(PLAN, timeout_ms=60_000)  # whatever is loaded at the first use is loaded
        yield running


@pytest.fixture
def beside(gate: RunningGate) -> Iterator[Beside]:
    """Somebody well-behaved, who is served through the whole test, and no leak after it."""
    files = gate.open_files()
    gate.mark()
    with shown(gate), Beside(gate) as well:
        yield well
        well.check()
    until(lambda: gate.open_files() <= files, "that every connection is let go of")


def recorded(gate: RunningGate, reason: str, client: str, **sealed: str) -> Told:
    """Return the refusal that the log has of a client, once it is there."""

    def found() -> list[Told]:
        return [
            record
            for record in gate.refusals(reason, client)
            if sealed.items() <= record.sealed.items()
        ]

    return until(found, f"a record of {reason} of {client} {sealed}")[-1]  # type: ignore[no-any-return]


def uid(name: str = "") -> str:
    return f"u{os.geteuid()}.{name}" if name else f"u{os.geteuid()}"


def hello(name: str, **changes: Any) -> dict[str, Any]:
    return {"protocol": PROTOCOL, "role": "planner", "client": name, **changes}


# half messages


@pytest.mark.parametrize("length", [1, 8, 9, 20], ids=["header", "header-1", "no-body", "body"])
def test_half_a_message_and_then_silence_for_ever_is_recorded(
    gate: RunningGate, beside: Beside, length: int
) -> None:
    name = f"half-{length}"
    with Line(gate.socket).hello(ClientRole.PLANNER, name) as line:
        line.send(frame(Kind.OBSERVE, 1, {"channel": "camera", "text": "x"})[:length])
    why = recorded(gate, "MALFORMED", uid(name))
    assert why.sealed["where"] == "frame"


def test_a_message_that_trickles_in_is_ended_and_so_is_a_hello(
    gate: RunningGate, beside: Beside
) -> None:
    with Line(gate.socket) as opening, Line(gate.socket) as later:
        later.hello(ClientRole.PLANNER, "trickle")
        whole = frame(Kind.OBSERVE, 1, {"channel": "camera", "text": "x" * 4_000})
        begun, ended = time.monotonic(), [0.0, 0.0]
        for at in range(len(whole)):
            for number, line in enumerate((opening, later)):
                if not ended[number]:
                    line.send(
                        (frame(Kind.HELLO, 0, hello("trickle-h")) * 9)[at : at + 1]
                        if number == 0
                        else whole[at : at + 1]
                    )
                    ended[number] = is_hung_up(line)
            if all(ended):
                break
            assert time.monotonic() - begun < 120, ended
            time.sleep(0.1)
        assert all(ended)
        assert opening.dropped()["where"] == "hello"
        assert later.dropped()["where"] == "frame"
    assert recorded(gate, "MALFORMED", uid(), where="hello")
    assert recorded(gate, "MALFORMED", uid("trickle"), where="frame")


def is_hung_up(line: Line) -> float:
    """Return when the gate was seen to have answered; 0 while it waits. Nothing else answers."""
    line.socket.setblocking(False)
    try:
        line.socket.recv(1, socket.MSG_PEEK)
    except BlockingIOError:
        return 0.0
    except ConnectionResetError:
        pass
    finally:
        line.socket.settimeout(60)
    return time.monotonic()


def test_who_says_nothing_at_all_is_let_go(gate: RunningGate, beside: Beside) -> None:
    with Line(gate.socket) as line:
        assert line.dropped() == {
            "code": "MALFORMED",
            "message": "no hello in time",
            "where": "hello",
            "family": "malformed",
        }


# too much


@pytest.mark.smoke
def test_a_message_above_its_bound_is_refused_before_its_body_comes(
    gate: RunningGate, beside: Beside
) -> None:
    gate.forget_peak()
    before = gate.resident_kib()
    for kind, role in ((Kind.PROPOSE, "planner"), (Kind.ORDER, "operator")):
        with Line(gate.socket).hello(ClientRole(role), f"huge-{role}") as line:
            line.send(struct.pack(">IBI", BOUND[kind] + 1, kind, 1))
            fault = line.dropped()
            assert (fault["code"], fault["where"]) == ("INPUT_TOO_LARGE", "frame.length")
        recorded(gate, "INPUT_TOO_LARGE", uid(f"huge-{role}"), where="frame.length")
    with Line(gate.socket) as line:
        line.send(struct.pack(">IBI", 0xFFFF_FFFF, Kind.HELLO, 0) + bytes(1 << 16))
        assert line.dropped().get("code", "INPUT_TOO_LARGE") == "INPUT_TOO_LARGE"
    recorded(gate, "INPUT_TOO_LARGE", uid(), where="frame.length")
    assert gate.peak_kib() - before < GROWTH_KIB


def test_a_message_exactly_at_its_bound_is_read(gate: RunningGate, beside: Beside) -> None:
    with Line(gate.socket).hello(ClientRole.OPERATOR, "exact") as line:
        body = b'{"act":"activate","token":"'
        body += b"A" * ((BOUND[Kind.ORDER] - len(body) - 2) // 4 * 4) + b'"}'
        line.send(raw_frame(Kind.ORDER, 7, body.ljust(BOUND[Kind.ORDER])))
        got = line.next()
        assert got is not None
        assert (got.kind, got.id) == (Kind.ERROR, 7)  # it is no token, and was read as far as that
        line.say(Kind.STATUS, {}, 8)
        line.told(Kind.REPLY)


@pytest.mark.parametrize("version", ["", "authguard-r/gate/2", "authguard-r/gate/1 ", "HTTP/1.1"])
def test_another_version_is_refused(gate: RunningGate, beside: Beside, version: str) -> None:
    with Line(gate.socket) as line:
        line.say(Kind.HELLO, hello("versions", protocol=version), 0)
        fault = line.dropped()
    assert (fault["code"], fault["where"]) == ("MALFORMED", "hello.protocol")
    recorded(gate, "MALFORMED", uid(), where="hello.protocol", message=fault["message"])


def test_what_a_role_may_not_send_ends_the_connection(gate: RunningGate, beside: Beside) -> None:
    with Line(gate.socket).hello(ClientRole.PLANNER, "orders") as line:
        line.say(Kind.ORDER, {"act": "activate", "token": ""})
        assert line.dropped()["where"] == "frame.kind"
    recorded(gate, "MALFORMED", uid("orders"), where="frame.kind")


def test_a_body_that_is_no_message_is_answered_and_the_connection_goes_on(
    gate: RunningGate, beside: Beside
) -> None:
    bad = [b"", b"[]", b"\xff", b'{"first":NaN}', b'{"first":1e9}', b"[" * 4_000, b'{"x":1}']
    with Line(gate.socket).hello(ClientRole.AUDITOR, "bodies") as line:
        for number, body in enumerate(bad, 1):
            line.send(raw_frame(Kind.RECORDS, number, body))
            got = line.next()
            assert got is not None
            assert (got.kind, got.id) == (Kind.ERROR, number), body
        line.say(Kind.RECORDS, {"first": 0, "count": 1}, 99)
        assert len(line.told(Kind.REPLY)["records"]) == 1
    until(lambda: len(gate.refusals("MALFORMED", uid("bodies"))) == len(bad), "a record of each")


def test_every_published_stream_and_hello_is_answered_by_the_process_as_published(
    gate: RunningGate, beside: Beside
) -> None:
    for vector in frame_streams.hellos():
        with Line(gate.socket) as line:
            line.send(bytes.fromhex(vector["hex"]))
            if "kind" in vector["expect"]:
                line.told(Kind(vector["expect"]["kind"]))
            else:
                fault = line.dropped()
                assert fault["code"] == vector["expect"]["error"], vector["name"]
                assert fault["where"] == vector["expect"]["where"], vector["name"]
    for number, vector in enumerate(frame_streams.streams()):
        role, expect = vector["role"], vector["expect"]
        if "error" not in expect or role not in {None, *ROLES}:
            continue
        with Line(gate.socket) as line:
            if role is not None:
                line.hello(role, f"vector-{number}")
            for chunk in vector["chunks"]:
                line.send(bytes.fromhex(chunk))
            fault = line.dropped()
            assert fault["code"] == expect["error"], vector["name"]
            assert fault["where"] == expect["where"], vector["name"]


# who never reads


def test_who_never_reads_its_answers_is_dropped_and_they_are_not_even_made(
    gate: RunningGate, beside: Beside
) -> None:
    with gate.client(ClientRole.AUDITOR, "size") as auditor:
        while auditor.status()["log"]["size"] < 900:
            beside.round()
        page = len(str(auditor.records(0, 900)))
    gate.forget_peak()
    before = gate.resident_kib()
    asked = 450  # in the 16 KiB that are read at once
    assert asked * page > 4 * GROWTH_KIB * 1_024
    with Line(gate.socket).hello(ClientRole.AUDITOR, "deaf") as line:
        line.send(ask(asked))
        recorded(gate, "BUSY", uid("deaf"), message="it does not read")
        assert gate.peak_kib() - before < GROWTH_KIB


def ask(times: int) -> bytes:
    """Return that many short questions with long answers, which fit into one reading."""
    body = b'{"first":0,"count":900}'
    return b"".join(raw_frame(Kind.RECORDS, number, body) for number in range(times))


def test_who_watches_and_never_reads_is_dropped_alone(gate: RunningGate, beside: Beside) -> None:
    with ExitStack() as held:
        deaf = held.enter_context(Line(gate.socket).hello(ClientRole.AUDITOR, "deaf-watch"))
        deaf.say(Kind.WATCH, {})
        reader = held.enter_context(gate.client(ClientRole.AUDITOR, "reads-on"))
        events = reader.watch(idle_ms=60_000)
        planner = held.enter_context(gate.client(ClientRole.PLANNER, "flood"))
        marks = iter(range(1_000_000))

        def is_dropped() -> bool:
            for _ in range(100):
                planner.propose(PLAN, timeout_ms=60_000)
            mark = f"mark-{next(marks)}"
            with gate.client(ClientRole.AUDITOR, mark):
                while next(events).get("client") != uid(mark):
                    pass  # who reads is told everything, all the time
            return all(c["client"] != uid("deaf-watch") for c in reader.status()["clients"])

        until(is_dropped, "that the one who never reads is dropped", seconds=240)
    recorded(gate, "BUSY", uid("deaf-watch"), message="it does not read")


# many


@contextmanager
def files_here(count: int) -> Iterator[None]:
    """Let this process hold that many files."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(count, hard), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def crowd(gate: RunningGate, count: int, held: ExitStack) -> list[Line]:
    """Return that many connections, each of which has said hello."""
    lines = []
    for number in range(count):
        line = held.enter_context(Line(gate.socket))
        line.say(Kind.HELLO, hello(f"crowd-{number}"), 0)
        lines.append(line)
    return lines


def taken(lines: list[Line]) -> list[Line]:
    """Return those that were welcomed; the others were told why not, or cut off."""
    welcomed = []
    for line in lines:
        got = line.next()
        if got is not None and got.kind is Kind.WELCOME:
            welcomed.append(line)
        elif got is not None:
            assert b'"BUSY"' in got.body
    return welcomed


@pytest.mark.parametrize(
    ("connections", "files", "least", "most"),
    [(1_200, None, 1_000, 1_000), (64, None, 50, 62), (1_200, 200, 80, 120)],
    ids=["all-taken", "too-many-of-one-user", "too-few-files"],
)
def test_a_thousand_connections_leave_the_one_beside_served_and_nothing_behind(
    connections: int, files: int | None, least: int, most: int
) -> None:
    peers = (Peer(uid=os.geteuid(), roles=ROLES),)
    bounds = {"connections": connections, "refusals": 0}
    with (
        files_here(4_096),
        RunningGate(rid=scenarios.OTHER, peers=peers, files=files, **bounds) as gate,
    ):
        with Beside(gate) as beside:
            beside.round()
            before, memory = gate.open_files(), gate.resident_kib()
            with ExitStack() as held:
                welcomed = taken(crowd(gate, 1_000, held))
                beside.check()
                assert least <= len(welcomed) <= most
                for line in welcomed:
                    line.say(Kind.OBSERVE, {"channel": "camera", "text": "x"})
                # 256 planners are kept apart; the others are told that there is no room
                answers = [got.kind for line in welcomed if (got := line.next()) is not None]
                assert len(answers) == len(welcomed)
            until(lambda: gate.open_files() <= before, "that every file is let go of")
            beside.check()
            assert gate.resident_kib() - memory <= GROWTH_KIB
        with gate.client(ClientRole.AUDITOR, "last") as auditor:
            here = until(lambda: living(auditor, 1), "that only the living are shown")
            assert [client["client"] for client in here] == [uid("last")]
        if len(welcomed) < 1_000:
            refused = [*gate.refusals("BUSY", uid()), *gate.refusals("BUSY", "*")]
            assert refused
            assert gate.stop_process("gate") == 0
            counted = [r for r in gate.refusals("BUSY", uid()) if r.kind == "refusal"]
            assert sum(r.open.get("repeats", 1) for r in counted) == 1_000 - len(welcomed)
        assert "Traceback" not in gate.said()


def living(auditor: Any, count: int) -> list[dict[str, Any]] | None:
    clients: list[dict[str, Any]] = auditor.status()["clients"]
    return clients if len(clients) == count else None


# killed


CHILD = """
import pathlib, socket, sys, time
sock = socket.socket(socket.AF_UNIX)
sock.connect(sys.argv[1])
sock.sendall(pathlib.Path(sys.argv[2]).read_bytes())
sock.recv(1)
pathlib.Path(sys.argv[3]).touch()
time.sleep(600)
"""


@pytest.mark.smoke
@pytest.mark.parametrize("is_whole", [False, True], ids=["half-a-request", "a-whole-request"])
def test_a_client_killed_in_mid_request_is_forgotten(
    gate: RunningGate, beside: Beside, tmp_path: Path, *, is_whole: bool
) -> None:
    name = f"killed-{'whole' if is_whole else 'half'}"
    asked = frame(Kind.PROPOSE, 1, {"key": name, "plan": "c2NhbigpCg==", "dialect": "auto"})
    said = frame(Kind.HELLO, 0, hello(name)) + (asked if is_whole else asked[:-4])
    (tmp_path / "said").write_bytes(said)
    child = subprocess.Popen(
        [sys.executable, "-c", CHILD, gate.socket, tmp_path / "said", tmp_path / "connected"]
    )
    try:
        until((tmp_path / "connected").exists, "the child's hello")
        if is_whole:  # the gate does not decide a plan whose planner left before its turn
            until(lambda: any(r.open.get("client") == uid(name) for r in gate.news()), "a decision")
    finally:
        child.send_signal(signal.SIGKILL)
        child.wait()
    auditor = gate.client(ClientRole.AUDITOR, "looks")
    until(lambda: not any(c["client"] == uid(name) for c in auditor.status()["clients"]))
    auditor.close()
    if is_whole:  # it was decided, and is told to whoever asks again
        with gate.client(ClientRole.PLANNER, name) as again:
            answer = again.propose(b"scan()\n", key=name)
        assert answer["repeated"] is True
    else:
        recorded(gate, "MALFORMED", uid(name), where="frame")


# who somebody is


FORGER = """
import os, socket, sys
os.setgroups([])
os.setgid(int(sys.argv[2]))
os.setuid(int(sys.argv[2]))
sock = socket.socket(socket.AF_UNIX)
sock.connect(sys.argv[1])
sock.sendall(bytes.fromhex(sys.argv[3]))
data = b""
while piece := sock.recv(65536):
    data += piece
sys.stdout.write(data[9:].decode())
"""


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can be somebody else")
@pytest.mark.parametrize("role", sorted(ClientRole))
def test_another_user_may_be_nothing_whatever_it_says(
    gate: RunningGate, beside: Beside, role: str
) -> None:
    gate.socket.chmod(0o666)  # the folder let it in: the configuration does not
    said = frame(Kind.HELLO, 0, hello(uid("operator").replace(".", "-"), role=role))
    words = [sys.executable, "-c", FORGER, gate.socket, str(STRANGER), said.hex()]
    try:
        child = subprocess.run(words, capture_output=True, check=True, timeout=120)
    finally:
        gate.socket.chmod(0o660)
    assert b'"ROLE_DENIED"' in child.stdout
    record = recorded(gate, "ROLE_DENIED", f"u{STRANGER}", where="peer")
    assert str(STRANGER) in record.sealed["message"]


@pytest.mark.smoke
@pytest.mark.parametrize("role", [ClientRole.CONTROLLER, ClientRole.GATE])
def test_a_role_that_the_configuration_does_not_give_is_refused(
    gate: RunningGate, beside: Beside, role: ClientRole
) -> None:
    with Line(gate.socket) as line:
        line.say(Kind.HELLO, hello("forged", role=role), 0)
        fault = line.dropped()
    assert (fault["code"], fault["where"]) == ("ROLE_DENIED", "peer")
    recorded(gate, "ROLE_DENIED", uid(), where="peer", message=fault["message"])


# state that is not


def signed(epoch: int, seq: int, *, by: str = "", robot: RobotId = scenarios.RID) -> bytes:
    """Return a snapshot signed by somebody, by default by this robot's estimator."""
    seen: Snapshot = snapshot_of(scenarios.world(), robot=robot, epoch=epoch, seq=seq)
    signer = folder_signer(scenarios.trust_folder(), by or f"estimator-{scenarios.RID}")
    return sign_object(seen, Tag.STATE, signer)


def test_a_snapshot_that_is_not_the_next_leaves_the_last_in_force(
    gate: RunningGate, beside: Beside
) -> None:
    good = signed(5, 5)
    bad = {
        "replayed": (good, "STATE_REPLAYED"),
        "reordered": (signed(5, 4), "STATE_REPLAYED"),
        "of an old epoch": (signed(4, 9), "STATE_REPLAYED"),
        "by an operator": (signed(6, 3, by="operator-1"), "ROLE_DENIED"),
        "not signed": (b"{}", "MALFORMED"),
        "changed": (changed(good), "SIGNATURE_INVALID"),
    }
    with Line(gate.socket).hello(ClientRole.ESTIMATOR, "state") as line:
        line.say(Kind.SNAPSHOT, Attest(token=good), 1)
        assert line.told(Kind.REPLY) == {"epoch": 5, "seq": 5}
        for number, (name, (token, reason)) in enumerate(bad.items(), 2):
            gate.mark()
            line.say(Kind.SNAPSHOT, Attest(token=token), number)
            line.told(Kind.ERROR)
            expected = 1 if name == "replayed" else 2  # the very same bytes are not read again
            news = until(partial(state_refusals, gate, expected), f"the records of one {name}")
            assert any(record.open.get("client") == uid("state") for record in news)
            assert any(reason in record.reasons for record in news), (name, news)
        line.say(Kind.SNAPSHOT, Attest(token=signed(5, 6)), 99)
        assert line.told(Kind.REPLY) == {"epoch": 5, "seq": 6}


@pytest.mark.smoke
@pytest.mark.parametrize(
    ("robot", "by"),
    [
        (scenarios.OTHER, scenarios.OTHER),
        (scenarios.OTHER, scenarios.RID),
        (scenarios.RID, scenarios.OTHER),
    ],
    ids=["another robot's", "of another robot", "by another robot's estimator"],
)
def test_a_foreign_snapshot_leaves_the_last_in_force(
    gate: RunningGate, beside: Beside, robot: RobotId, by: RobotId
) -> None:
    with Line(gate.socket).hello(ClientRole.ESTIMATOR, "foreign") as line:
        line.say(Kind.SNAPSHOT, Attest(token=signed(9, 9, robot=robot, by=f"estimator-{by}")), 1)
        line.told(Kind.ERROR)
        line.say(Kind.SNAPSHOT, Attest(token=signed(7, next(SEQ))), 2)
        line.told(Kind.REPLY)


def changed(token: bytes) -> bytes:
    """Return a canonical token whose payload is not what was signed."""
    plain = json.loads(token)
    payload = unb64(plain["payload"], where="payload").replace(b'"seq":5', b'"seq":7')
    return encode_fast({**plain, "payload": b64(payload)})


def state_refusals(gate: RunningGate, count: int) -> list[Told]:
    """Return what the log says of a snapshot once it says all of it: whose it was, and why not."""
    ours = [r for r in gate.news() if r.kind == "intake" or r.open.get("client") == uid("state")]
    return ours if len(ours) == count else []


# turns


def test_proposals_beside_one_that_is_being_decided_are_shed_unread_and_in_order(
    gate: RunningGate, beside: Beside
) -> None:
    with Line(gate.socket).hello(ClientRole.PLANNER, "hasty") as line:
        first = frame(Kind.PROPOSE, 1, {"key": "hasty-1", "plan": "c2NhbigpCg=="})
        line.send(first + b"".join(raw_frame(Kind.PROPOSE, n, b"\xff") for n in range(2, 42)))
        got = [item for _ in range(41) if (item := line.next()) is not None]
        told = [(item.kind, item.id) for item in got]
        # a few are shed; then the client is not read until its own is answered, and so on
        assert told[: LIMITS.shed_proposals + 1] == [
            *((Kind.ERROR, n) for n in range(2, LIMITS.shed_proposals + 2)),
            (Kind.REPLY, 1),
        ]
        assert sorted(number for _, number in told) == list(range(1, 42))
        assert all(b'"BUSY"' in item.body for item in got[: LIMITS.shed_proposals])
        line.say(Kind.PROPOSE, {"key": "hasty-2", "plan": "c2NhbigpCg=="}, 50)
        line.told(Kind.REPLY)
    until(lambda: gate.refusals("BUSY", uid("hasty")), "a record of the row")


# noise


def noise(dice: Random) -> bytes:
    """Return bytes that are nothing, a little, or nearly a message."""
    good = frame(dice.choice(list(Kind)), dice.randrange(3), hello("noise"))
    kind = dice.randrange(4)
    if kind == 0:
        return dice.randbytes(dice.randrange(1, 3_000))
    if kind == 1:
        return good[: dice.randrange(len(good))]
    changed = bytearray(good)
    for _ in range(dice.randrange(1, 8)):
        changed[dice.randrange(len(changed) if kind == 2 else 9)] = dice.randrange(256)
    return bytes(changed)


def test_noise_from_hundreds_of_connections_ends_them_and_nobody_else(
    gate: RunningGate, beside: Beside
) -> None:
    dice = Random(os.environ.get("AUTHGUARD_SEED", "20260115"))
    roles = [role for role in ROLES if role is not ClientRole.ESTIMATOR]
    memory = gate.resident_kib()
    for number in range(600):
        with Line(gate.socket) as line:
            if number % 2:
                line.hello(dice.choice(roles), f"noise-{number}")
            for _ in range(dice.randrange(1, 4)):
                line.send(noise(dice))
            line.socket.shutdown(socket.SHUT_WR)
            while line.next() is not None:
                pass
    beside.check()
    assert gate.resident_kib() - memory <= GROWTH_KIB


def test_after_all_of_it_only_the_living_are_there(gate: RunningGate) -> None:
    with gate.client(ClientRole.AUDITOR, "last") as auditor:
        here = until(lambda: living(auditor, 1), "that only the living are shown")
        assert [client["client"] for client in here] == [uid("last")]
    assert gate.alive
    assert "Traceback" not in gate.said()
