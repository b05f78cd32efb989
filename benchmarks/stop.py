# SPDX-License-Identifier: Apache-2.0
"""How long a stop takes, from another process and back: request, `HALT`, `STOOD`, reply.

The robot stands at once, so that what is measured is the lane and not a brake. Once with nobody
else there, once while four processes ask for stops as fast as they are answered: more than the
two cores of the machine can carry, so every process waits for its turn on a core as well.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from time import perf_counter_ns, time_ns

from authguard_r.access.gate_config import Peer, default_config
from authguard_r.authoring.keys.setup import demo_members, init_folder
from authguard_r.core.encoding import Tag
from authguard_r.core.identifiers import RobotId
from authguard_r.core.token import sign_object
from authguard_r.estop.connection import start_stop_process
from authguard_r.estop.files import EStopFiles
from authguard_r.estop.run_folder import SOCKET
from authguard_r.keys.signer import folder_signer
from authguard_r.sim.example import bundled_hospital
from authguard_r.site.source import read_site
from authguard_r.wire.frames import FrameReader, frame
from authguard_r.wire.messages import PROTOCOL, ClientRole, Kind, Mode
from measure import Timing, percentile

FLOODS = 4
_ROLES = tuple(sorted(role for role in ClientRole if role is not ClientRole.GATE))


def stops(blocks: int = 5, calls: int = 400) -> dict[str, Timing]:
    """Return the round trip of a stop, idle and under a flood.

    Args:
        blocks: rounds of each; they take turns.
        calls: stops in a round.
    """
    idle: list[list[int]] = []
    flooded: list[list[int]] = []
    with TemporaryDirectory(prefix="stop-", dir="/tmp") as name, ExitStack() as stack:
        run = stack.enter_context(_lane(Path(name)))
        stack.enter_context(_script("obey", run))
        line = _join(run, ClientRole.OPERATOR, "measured")
        stack.callback(line.close)
        for _ in range(blocks):
            idle.append(_round(line, calls))
            with ExitStack() as flood:
                for _ in range(FLOODS):
                    flood.enter_context(_script("flood", run))
                _round(line, calls // 10)
                flooded.append(_round(line, calls))
    return {"stop, idle": _timing(idle), f"stop, {FLOODS} floods": _timing(flooded)}


def obey(run: Path) -> None:
    """Stand whenever told to, for ever: the controller."""
    line, reader, count = _join(run, ClientRole.CONTROLLER, "robot"), _reader(), 0
    print("ready", flush=True)
    while data := line.recv(1 << 16):
        for item in reader.feed(data):
            count += 1
            line.sendall(frame(Kind.STOOD, item.id, {"stops": count}))


def flood(run: Path) -> None:
    """Ask for stops as fast as they are answered, sixteen ahead, for ever."""
    line, reader = _join(run, ClientRole.PLANNER, "flood"), _reader()
    line.sendall(frame(Kind.STOP, 1, {}) * 16)
    print("ready", flush=True)
    while data := line.recv(1 << 16):
        line.sendall(frame(Kind.STOP, 1, {}) * len(reader.feed(data)))


@contextmanager
def _lane(folder: Path) -> Iterator[Path]:
    site = read_site(bundled_hospital() / "site.yaml")
    rid = RobotId(next(iter(site.robots)))
    trust, run = folder / "trust", folder / "run"
    run.mkdir()
    init_folder(trust, demo_members(site, (rid,)), now=_today())
    config = default_config(rid, (Peer(uid=os.geteuid(), roles=_ROLES),), Mode.ENFORCE)
    token = folder / "gate.token"
    token.write_bytes(sign_object(config, Tag.GATE, folder_signer(trust, "site-authority-1")))
    files = EStopFiles(
        run=run,
        robot=rid,
        trust=trust,
        key=trust / "keys" / f"gate-{rid}.key.pem",
        cert=trust / "keys" / f"gate-{rid}.cert.pem",
        config=token,
    )
    process = start_stop_process(files)
    assert process is not None
    try:
        yield run
    finally:
        process.terminate()
        process.wait()


@contextmanager
def _script(name: str, run: Path) -> Iterator[None]:
    child = subprocess.Popen([sys.executable, __file__, name, str(run)], stdout=subprocess.PIPE)
    assert child.stdout is not None
    try:
        assert child.stdout.readline() == b"ready\n"
        yield
    finally:
        child.kill()
        child.wait()
        child.stdout.close()


def _join(run: Path, role: ClientRole, client: str) -> socket.socket:
    line = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    line.connect(str(run / SOCKET))
    line.sendall(frame(Kind.HELLO, 0, {"protocol": PROTOCOL, "role": role, "client": client}))
    (welcome,) = _reader().feed(line.recv(1 << 16))
    assert welcome.kind is Kind.WELCOME
    return line


def _round(line: socket.socket, calls: int) -> list[int]:
    samples: list[int] = []
    for number in range(calls):
        time.sleep(0.002)  # offered at its own rate, not as fast as it is answered
        asked = frame(Kind.STOP, number, {"why": "measured"})
        start = perf_counter_ns()
        line.sendall(asked)
        (got,) = _reader().feed(line.recv(1 << 16))
        samples.append(perf_counter_ns() - start)
        assert json.loads(got.body)["stopped"] is True, got.body
    return samples


def _reader() -> FrameReader:
    return FrameReader(lambda kind: 1 << 16)


def _timing(blocks: list[list[int]]) -> Timing:
    medians = tuple(float(median(block)) for block in blocks)
    every = [sample for block in blocks for sample in block]
    return Timing(
        p50=float(median(medians)),
        p95=percentile(every, 95),
        p99=percentile(every, 99),
        samples=len(every),
        medians=medians,
    )


def _today() -> datetime:
    return datetime.fromtimestamp(time_ns() / 1e9, UTC)


if __name__ == "__main__":
    if len(sys.argv) > 2:
        {"obey": obey, "flood": flood}[sys.argv[1]](Path(sys.argv[2]))
    for what, timing in stops().items():
        print(f"{what}: p50 {timing.p50 / 1e6:.3f} ms, p95 {timing.p95 / 1e6:.3f} ms, ", end="")
        print(f"p99 {timing.p99 / 1e6:.3f} ms ({timing.samples} samples)")
