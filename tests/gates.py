# SPDX-License-Identifier: Apache-2.0
"""A gate as it runs: real processes on real sockets, started for a test and ended with it.

    with RunningGate(robot=True, estimator=True) as gate:
        gate.activate()
        gate.client(ClientRole.PLANNER).propose(b"scan()")

Nothing here is a mock. Everything that was started is ended by its number, whatever happened, and
`said` shows what the processes wrote to standard error.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import mkdtemp
from types import TracebackType
from typing import Any, Self

import msgspec
from coverage import Coverage

import worlds
from authguard_r.assembly import folder_signer
from authguard_r.audit.record import read_record, read_sealed
from authguard_r.client import GateClient
from authguard_r.commands import Command, Verb
from authguard_r.compile.build import compile_draft
from authguard_r.compile.draft import Draft
from authguard_r.core.encoding import Tag, b64
from authguard_r.core.identifiers import Digest, RobotId
from authguard_r.core.mission import Mission
from authguard_r.core.quantities import Now
from authguard_r.core.token import sign_object
from authguard_r.gate.config import GateConfig, Peer, default_config
from authguard_r.gate.lane.place import PID as LANE_PID
from authguard_r.keys.trust import read_trust
from authguard_r.site.source import convert, read_site, read_text, read_yaml
from authguard_r.store.sqlite import read_rows
from authguard_r.wire.frames import Frame, FrameReader, frame
from authguard_r.wire.messages import PROTOCOL, ClientRole, Kind, Mode

AUTHGUARD = Path(sys.executable).parent / "authguard"
#: Starts what it is given, measured.
MEASURED = (
    sys.executable,
    str(worlds.ROOT / "tests" / "measured.py"),
    str(worlds.ROOT / "pyproject.toml"),
)
#: Bound against hanging, in seconds; nothing is measured against it.
PATIENCE_S = 60.0
#: Every role that a configuration can give.
EVERY = tuple(sorted(role for role in ClientRole if role is not ClientRole.GATE))
_PAGE = 200


class Told(msgspec.Struct, frozen=True, kw_only=True):
    """One record of the log as a test reads it; `sealed` holds the values without their salts."""

    seq: int
    kind: str
    decision: str
    open: dict[str, Any]
    sealed: dict[str, Any]

    @property
    def reasons(self) -> list[str]:
        """What it was refused for; empty for a record of something else."""
        return list(self.open.get("reasons", ()))


def order(gate: RunningGate, mission: Mission, digest: str, verb: Verb, **more: Any) -> bytes:
    """Return an operator's signed order about a mission, good for a minute."""
    now_ms = time.time_ns() // 1_000_000
    command = Command(
        verb=verb,
        mid=mission.mid,
        version=mission.version,
        mission=Digest(digest),
        nonce=b64(worlds.random_bytes(16)),
        expires_ms=now_ms + 60_000,
        issued_ms=now_ms,
        **more,
    )
    return sign_object(command, Tag.COMMAND, folder_signer(gate.trust, "operator-1"))


def until(
    holds: Callable[[], Any],
    what: str = "it",
    *,
    seconds: float = PATIENCE_S,
    every_s: float = 0.01,
) -> Any:
    """Return the first true answer; fail when none comes."""
    end = time.monotonic() + seconds
    while not (answer := holds()):
        if time.monotonic() > end:
            raise AssertionError(f"{what} did not happen within {seconds:.0f} s")
        time.sleep(every_s)
    return answer


def environment(*, measured: bool) -> dict[str, str]:
    """Return the variables of a process; what a measured one runs through counts as covered."""
    env = {k: v for k, v in os.environ.items() if not k.startswith("COV")}
    if measured and Coverage.current() is not None:
        env |= {"COVERAGE_PROCESS_START": str(worlds.ROOT / "pyproject.toml")}
    return env


def authguard(*words: object, measured: bool = True) -> list[str]:
    """Return what starts a command of ours; what a measured one runs through counts as covered."""
    said = [str(word) for word in words]
    if not measured or Coverage.current() is None:
        return [str(AUTHGUARD), *said]
    return [*MEASURED, *said]


def module(name: str) -> list[str]:
    """Return what starts a module of ours, measured as the tests are."""
    if Coverage.current() is None:
        return [sys.executable, "-m", name]
    return [*MEASURED, name]


class RunningGate:
    """A gate, and what a test wants beside it; a context manager.

    Args:
        mode: `shadow` releases nothing.
        simulate: a symbolic robot inside the gate, in its own time; then no other process.
        robot: start the symbolic robot; words are options of `authguard robot`.
        estimator: start the estimator; words are options of `authguard estimator`.
        peers: who may be what; this user may be everything when absent.
        rid: which robot; two gates of one robot and one trust folder cannot run at once.
        trust: the trust folder; the test run's own when absent.
        files: most files that the gate may have open; the test run's own bound when absent.
        site: the site model; keys in `trust` have to fit its robots' profiles.
        binding: the planner's tools.
        bounds: fields of the configuration that are not as in a fresh set-up.
    """

    def __init__(
        self,
        *,
        mode: Mode = Mode.ENFORCE,
        simulate: bool = False,
        robot: bool | tuple[str, ...] = False,
        estimator: bool | tuple[str, ...] = False,
        peers: tuple[Peer, ...] | None = None,
        rid: RobotId = worlds.RID,
        trust: Path | None = None,
        files: int | None = None,
        site: Path = worlds.HOSPITAL / "site.yaml",
        binding: Path = worlds.HOSPITAL / "binding.yaml",
        **bounds: Any,
    ) -> None:
        self.rid = rid
        self.folder = Path(mkdtemp(prefix="ag-", dir="/tmp"))
        self.folder.chmod(0o755)  # other users of a test reach the socket, if its mode lets them
        self.run = self.folder / "run"
        self.run.mkdir(mode=0o755)
        self.store = self.folder / "robot.db"
        self.trust = trust or worlds.trust_folder()
        self.site, self.binding = site, binding
        self._simulate = simulate
        self._robot, self._estimator, self._files = robot, estimator, files
        self._started: dict[str, subprocess.Popen[bytes]] = {}
        self._lanes: set[int] = set()
        self._clients: list[GateClient] = []
        self._count = 0
        self._seen = 0
        #: where a test's own estimator says that the robot is
        self.move: Callable[[str], None] | None = None
        #: the mission that `robots.gate_of` made active, and its digest
        self.live: tuple[Mission, str] | None = None
        here = (Peer(uid=os.geteuid(), roles=EVERY),)
        fresh = default_config(rid, here if peers is None else peers, mode)
        self.configure(msgspec.structs.replace(fresh, **bounds))

    @property
    def socket(self) -> Path:
        """Where clients go."""
        return self.run / "gate.sock"

    @property
    def stop_socket(self) -> Path:
        """Where stops go."""
        return self.run / "stop.sock"

    @property
    def pid(self) -> int:
        """The gate's process."""
        return self._started["gate"].pid

    @property
    def lane_pid(self) -> int | None:
        """The stop lane's process, None when there is none."""
        try:
            return int((self.run / LANE_PID).read_text())
        except (OSError, ValueError):
            return None

    @property
    def alive(self) -> bool:
        """True while the gate runs."""
        return "gate" in self._started and self._started["gate"].poll() is None

    # start and end

    def __enter__(self) -> Self:
        try:
            return self.start()
        except BaseException:
            print(self.said(), file=sys.stderr)
            self.end()
            raise

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if error is not None:
            print(self.said(), file=sys.stderr)
        self.end()

    def start(self) -> Self:
        """Start everything that was asked for and wait until all of it is ready."""
        self.start_gate()
        if self._robot:
            self.start_robot(*(self._robot if isinstance(self._robot, tuple) else ()), wait=False)
        if self._estimator:
            words = self._estimator if isinstance(self._estimator, tuple) else ()
            self.start_estimator(*words, wait=False)
        for name in ("robot", "estimator"):
            if name in self._started:
                self.ready(name)
        return self

    def start_gate(self, *more: str) -> dict[str, Any]:
        """Start the gate; return its ready line."""
        words = ["--site", self.site, "--binding", self.binding, "--config", self._config]
        words += ["--store", self.store, "--run", self.run, "--robot", self.rid, "--demo"]
        words += ["--simulate"] if self._simulate else []
        process = self.launch("gate", "--trust", self.trust, *words, *more)
        if self._files is not None:
            resource.prlimit(process.pid, resource.RLIMIT_NOFILE, (self._files, self._files))
        told = self.ready("gate")
        if not self._simulate:
            lane = until(lambda: self.lane_pid, "the stop lane's start")
            self._lanes.add(lane)
        return told

    def start_robot(self, *more: str, wait: bool = True) -> None:
        """Start the symbolic robot; waits until it has taken a gate's proof."""
        words = ("--site", self.site, "--robot", self.rid, "--run", self.run, "--trust", self.trust)
        self.launch("robot", *words, *more)
        if wait:
            self.ready("robot")

    def start_estimator(self, *more: str, wait: bool = True) -> None:
        """Start the estimator; waits until the gate has taken a snapshot of it."""
        name = self.trust / "keys" / f"estimator-{self.rid}"
        words = ("--robot", self.rid, "--run", self.run, "--trust", self.trust)
        self.launch(
            "estimator", *words, "--key", f"{name}.key.pem", "--cert", f"{name}.cert.pem", *more
        )
        if wait:
            self.ready("estimator")

    def launch(self, name: str, *words: object) -> subprocess.Popen[bytes]:
        """Start one command of the program with `--json`; it is ended with the gate."""
        self._count += 1
        out, err = (self.folder / f"{self._count}-{name}.{end}" for end in ("out", "err"))
        said = authguard(name, *words, "--json", measured=name == "gate")
        env = environment(measured=False)
        with out.open("wb") as to, err.open("wb") as errors:
            process = subprocess.Popen(
                said, stdin=subprocess.DEVNULL, stdout=to, stderr=errors, env=env, cwd=worlds.ROOT
            )
        self._started[name] = process
        return process

    def ready(self, name: str) -> dict[str, Any]:
        """Return a process's first line, once it has said it."""

        def line() -> bytes | None:
            text = self._files_of(name, "out")[-1].read_bytes()
            if b"\n" not in text and self._started[name].poll() is not None:
                raise AssertionError(f"`authguard {name}` ended:\n{self.said()}")
            return text.split(b"\n")[0] if b"\n" in text else None

        told: dict[str, Any] = json.loads(until(line, f"the start of `{name}`"))
        if told.get("ready") is not True:
            raise AssertionError(f"`authguard {name}` is not ready: {told}")
        return told

    def stop_process(self, name: str, *, sign: signal.Signals = signal.SIGTERM) -> int:
        """End one process that was started here; return its exit code."""
        process = self._started[name]
        if process.poll() is None:
            process.send_signal(sign)
        return process.wait(PATIENCE_S)

    def kill9(self) -> None:
        """Kill the gate as a crash would; the stop lane lives on."""
        self.stop_process("gate", sign=signal.SIGKILL)

    def restart(self) -> dict[str, Any]:
        """End the gate if it runs, cleanly, and start it again; clients have to connect anew."""
        if self.alive:
            self.stop_process("gate")
        return self.start_gate()

    def end(self) -> None:
        """End everything that was started, by its number, and remove the folder."""
        for client in self._clients:
            client.close()
        self._clients.clear()
        for name in reversed(self._started):
            self._end_one(name)
        lane = self.lane_pid
        for pid in self._lanes | ({lane} if lane else set()):
            self._end_lane(pid)
        shutil.rmtree(self.folder, ignore_errors=True)

    def _end_one(self, name: str) -> None:
        try:
            self.stop_process(name)
        except subprocess.TimeoutExpired:
            self.stop_process(name, sign=signal.SIGKILL)

    def _end_lane(self, pid: int) -> None:
        """End a stop lane that outlived its gate; its number may be somebody else's by now."""
        with suppress(OSError):
            if str(self.run).encode() in Path(f"/proc/{pid}/cmdline").read_bytes():
                os.kill(pid, signal.SIGKILL)

    # what a test does

    def configure(self, config: GateConfig) -> None:
        """Sign another configuration; it counts from the next start."""
        self.config = config
        self._config = self.folder / "gate.token"
        signer = folder_signer(self.trust, "site-authority-1")
        self._config.write_bytes(sign_object(config, Tag.GATE, signer))

    def client(
        self, role: ClientRole, name: str | None = None, *, proof: bool = False, **more: Any
    ) -> GateClient:
        """Return a connected client; it is closed with the gate.

        Args:
            role: what it is here.
            name: its own name; the role's when absent.
            proof: demand that the gate proves its key.
            more: further arguments of `GateClient.connect`.
        """
        if proof:
            more |= {"verifier": read_trust(self.trust), "robot": self.rid}
        more.setdefault("timeout_ms", int(PATIENCE_S * 1_000))
        made = GateClient.connect(self.socket, role=role, client=name, **more)
        self._clients.append(made)
        return made

    def mission(self, name: str = "mission.yaml", **changes: Any) -> Mission:
        """Return the shipped mission as it is compiled now, with the draft's fields replaced."""
        now = Now(time.time_ns() // 1_000_000, 0)
        plain = worlds.draft(name) if not Path(name).is_absolute() else draft_at(Path(name))
        drafted = convert({**plain, **changes}, Draft, where=name)
        site = worlds.site() if self.site.parent == worlds.HOSPITAL else read_site(self.site)
        return compile_draft(drafted, site, now=now, nonce=b64(os.urandom(16)))

    def token(self, mission: Mission | None = None, *, by: str = "operator-1") -> bytes:
        """Return a mission signed by a principal of the trust folder."""
        value = self.mission() if mission is None else mission
        return sign_object(value, Tag.MISSION, folder_signer(self.trust, by))

    def activate(self, token: bytes | None = None) -> dict[str, Any]:
        """Activate a mission as an operator; return its standing."""
        with self.client(ClientRole.OPERATOR, "activates") as operator:
            return operator.activate(self.token() if token is None else token)

    def records(self, first: int = 0) -> list[Told]:
        """Return the log from a number on: by the socket, or from the file of an ended gate."""
        if not self.alive:
            rows = [(row.seq, row.record, row.sealed) for row in read_rows(self.store)]
            return [told(*row) for row in rows if row[0] >= first]
        found: list[Told] = []
        with self.client(ClientRole.AUDITOR, "reads") as auditor:
            while True:
                page = auditor.records(first, _PAGE)["records"]
                found += [
                    told(r["seq"], *(map(msgspec.json.encode, (r["record"], r["sealed"]))))
                    for r in page
                ]
                if not page:
                    return found
                first = page[-1]["seq"] + 1

    def mark(self) -> None:
        """Let `refusals` look only at what is recorded from now on."""
        with self.client(ClientRole.AUDITOR, "reads") as auditor:
            self._seen = auditor.status()["log"]["size"]

    def news(self) -> list[Told]:
        """Return what was recorded since `mark`."""
        return self.records(self._seen)

    def refusals(self, reason: str, client: str | None = None) -> list[Told]:
        """Return the refusals for a reason since `mark`, perhaps of one client alone."""
        return [
            record
            for record in self.news()
            if reason in record.reasons and client in {None, record.open.get("client")}
        ]

    def said(self) -> str:
        """Return what every process wrote to standard error, the newest last."""
        parts = []
        for path in sorted(self.folder.glob("*.err"), key=lambda p: int(p.name.split("-")[0])):
            text = path.read_text(errors="replace")
            parts += [f"--- {path.name}\n{text}"] if text else []
        return "".join(parts)

    def open_files(self) -> int:
        """Return how many files the gate has open."""
        return sum(1 for _ in Path(f"/proc/{self.pid}/fd").iterdir())

    def resident_kib(self) -> int:
        """Return the memory that the gate holds, in KiB."""
        return self._memory("VmRSS:")

    def peak_kib(self) -> int:
        """Return the most memory that the gate has held since `forget_peak`, in KiB."""
        return self._memory("VmHWM:")

    def forget_peak(self) -> None:
        """Let `peak_kib` begin anew."""
        Path(f"/proc/{self.pid}/clear_refs").write_text("5")

    def _memory(self, name: str) -> int:
        for line in Path(f"/proc/{self.pid}/status").read_text().splitlines():
            if line.startswith(name):
                return int(line.split()[1])
        raise AssertionError("the kernel does not say how much memory the gate holds")

    def _files_of(self, name: str, end: str) -> list[Path]:
        found = self.folder.glob(f"*-{name}.{end}")
        return sorted(found, key=lambda path: int(path.name.split("-")[0]))


class Line:
    """A connection that says exactly the bytes that a test wants.

    Args:
        path: the socket.
    """

    def __init__(self, path: Path) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.socket.settimeout(PATIENCE_S)
        try:
            self.socket.connect(str(path))
        except BaseException:
            self.socket.close()
            raise
        self._reader = FrameReader(lambda _: 1 << 23)
        self._frames: list[Frame] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def send(self, data: bytes) -> None:
        """Send bytes; a gate that has hung up already is no fault of the test."""
        with suppress(BrokenPipeError, ConnectionResetError):
            self.socket.sendall(data)

    def say(self, kind: Kind, body: object, number: int = 1) -> None:
        """Send one message."""
        self.send(frame(kind, number, body))

    def hello(self, role: ClientRole, name: str | None = None) -> Self:
        """Be welcomed."""
        said = {"protocol": PROTOCOL, "role": role, "client": name or str(role)}
        self.say(Kind.HELLO, said, 0)
        self.told(Kind.WELCOME)
        return self

    def next(self) -> Frame | None:
        """Return the next frame, None when the gate has closed the connection."""
        while not self._frames:
            try:
                data = self.socket.recv(1 << 16)
            except ConnectionResetError:
                return None
            if not data:
                return None
            self._frames += self._reader.feed(data)
        return self._frames.pop(0)

    def told(self, kind: Kind) -> dict[str, Any]:
        """Return what the next frame says, which has to be of this kind."""
        got = self.next()
        if got is None or got.kind is not kind:
            raise AssertionError(f"expected {kind.name}, got {got}")
        said: dict[str, Any] = json.loads(got.body)
        return said

    def dropped(self) -> dict[str, Any]:
        """Return why the gate ended this connection; empty when it did not say."""
        fault: dict[str, Any] = {}
        while (got := self.next()) is not None:
            fault = json.loads(got.body) if got.kind is Kind.ERROR else {}
        return fault

    def close(self) -> None:
        """Hang up."""
        self.socket.close()


def told(seq: int, record: bytes, sealed: bytes) -> Told:
    """Return a row of the log as a test reads it."""
    read = read_record(record, where=f"record {seq}")
    beside = read_sealed(sealed, where=f"record {seq}")
    return Told(
        seq=seq,
        kind=read.kind,
        decision=read.link.decision,
        open=read.open,
        sealed={name: item.value for name, item in beside.items()},
    )


def draft_at(path: Path) -> dict[str, Any]:
    """Return the draft in a file as plain data."""
    plain = read_yaml(read_text(path), where=path.name)
    assert isinstance(plain, dict)
    return plain


@contextmanager
def shown(gate: RunningGate) -> Iterator[RunningGate]:
    """Print what the gate's processes say meanwhile; pytest shows it when the test fails."""
    before = len(gate.said())
    try:
        yield gate
    finally:
        print(gate.said()[before:])
