# SPDX-License-Identifier: Apache-2.0
"""What the socket costs: the gate's process asked from another one, beside the same work in here.

The gate has a symbolic robot in its own process, and this process is its planner. In between, this
process decides the same plans itself: the same mission, the same state, a store of the same kind
on the same disk, refusals that wait for a commit as the gate's do. And a bare insert.
"""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic, perf_counter_ns, time_ns

from authguard_r.access.gate_config import default_config as gate_defaults
from authguard_r.client import GateClient
from authguard_r.core.identifiers import Identifier
from authguard_r.core.standing import Outcome
from authguard_r.enforcement.report import Report
from authguard_r.keys.signer import folder_signer, gate_name
from authguard_r.keys.trust import read_trust
from authguard_r.normalize import Binder, read_plan
from authguard_r.safety import EnvelopeGate, default_config
from authguard_r.server.proposals import CommitRecorder, ProposalRecord
from authguard_r.server.wiring import LogSettings, assemble
from authguard_r.sim.robot import SymbolicRobot
from authguard_r.sim.world import initial_state
from authguard_r.store.refusals import RefusalPolicy
from authguard_r.store.sqlite import open_store
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import ClientRole, Kind, Mode
from durable import row_size
from echo import echoing
from line import ACCEPTED, REFUSED, Line
from measure import Effort, Subject, Timing, interleave, timed
from scene import scenarios
from serving import busy_mission, serving
from yardsticks import BareInsert

_PLANNER = Identifier("u0.bench")
_MID = "asked-often"


def latency(folder: Path, effort: Effort) -> dict[str, Timing]:
    """Time one proposal over the socket and in this process, in turns.

    `*.accept` ends with the decision: it is on disk and the robot was told. `*.settle` ends with
    the outcome on disk. `*.refuse` ends with the refusal. `client.accept` is `socket.accept`
    through the shipped client; `library.accept_held` also holds the answer for a repeat, as the
    gate does in the same commit. `socket.echo` is a process that answers the same bytes at once.
    """
    with (
        serving(folder, _MID, simulate=True) as gate,
        _twin(folder) as twin,
        echoing(gate.folder / "echo.sock"),
    ):
        line = Line(gate.socket, "bench")
        echo = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        echo.connect(str(gate.folder / "echo.sock"))
        asked = line.proposal(ACCEPTED)
        client = gate.client(ClientRole.PLANNER, "bench-client")
        bare = BareInsert(folder / "gate-bare.db", row_size(folder))
        subjects = [
            Subject("socket.accept", lambda: _asked(line, ACCEPTED, Kind.EVENT)),
            Subject("library.accept", twin.accept),
            Subject("socket.settle", lambda: _asked(line, ACCEPTED, Kind.REPLY)),
            Subject("library.settle", twin.settle),
            Subject("socket.refuse", lambda: _asked(line, REFUSED, Kind.REPLY)),
            Subject("library.refuse", twin.refuse),
            Subject("client.accept", lambda: _asked_by_client(client)),
            Subject("library.accept_held", twin.accept_held),
            Subject("socket.echo", timed(lambda: _echoed(echo, asked))),
            Subject("insert.bare.gate", timed(bare.insert)),
        ]
        try:
            return interleave(subjects, effort)
        finally:
            bare.close()
            echo.close()
            line.close()


def _asked(line: Line, plan: bytes, until: Kind) -> int:
    """Return nanoseconds from the proposal to the first answer of a kind; takes all of them."""
    data = line.proposal(plan)
    start = perf_counter_ns()
    line.socket.sendall(data)
    took = 0
    while True:
        kind, _, body = line.next()
        if kind == until:
            took = perf_counter_ns() - start
        if kind == Kind.REPLY:
            break
        if kind == Kind.ERROR:
            raise RuntimeError(f"the gate did not take a proposal: {body!r}")
    if (b'"succeeded"' in body) is not (plan is ACCEPTED):
        raise RuntimeError(f"not the answer that is measured: {body!r}")
    return took


def _echoed(echo: socket.socket, data: bytes) -> None:
    echo.sendall(data)
    left = len(data)
    while left:
        left -= len(echo.recv(left))


def _asked_by_client(client: GateClient) -> int:
    start = perf_counter_ns()
    told: list[int] = []
    client.propose(ACCEPTED, on_step=lambda _: told.append(perf_counter_ns()))
    return told[0] - start


class _Twin:
    """The gate's work in this process, as a library does it."""

    def __init__(self, path: Path) -> None:
        site, now_ms = scenarios.site(), time_ns() // 1_000_000
        signer = folder_signer(scenarios.trust_folder(), gate_name(scenarios.RID))
        self._robot = SymbolicRobot(
            site,
            scenarios.RID,
            initial_state(site, site.robots[scenarios.RID].home),
            estimator=folder_signer(scenarios.trust_folder(), f"estimator-{scenarios.RID}"),
            start_ms=now_ms,
            epoch=now_ms,
        )
        bounds = gate_defaults(scenarios.RID, (), Mode.ENFORCE)
        self._gate = assemble(
            trust=read_trust(scenarios.trust_folder()),
            chain=signer.chain,
            site=site,
            safety=EnvelopeGate(default_config(site, scenarios.RID)),
            controller=self._robot,
            source=self._robot,
            clock=self._robot,
            store=open_store(path, reserve_bytes=bounds.reserve_bytes),
            log=LogSettings(
                refusals=RefusalPolicy(delay_ms=LIMITS.refusal_delay_ms, fold_ms=bounds.fold_ms)
            ),
            demo=True,
            stand_within_ms=bounds.stand_within_ms,
        )
        self._binder = Binder(site, scenarios.binding())
        self._context = self._binder.context()
        self._flushed = monotonic()
        self._keys = 0
        self._gate.management.activate(busy_mission(_MID))

    def accept(self) -> int:
        """Return nanoseconds until the action is decided, on disk and begun."""
        return self._timed(ACCEPTED)[0]

    def accept_held(self) -> int:
        """Return them with the answer held for a repeat."""
        self._keys += 1
        return self._timed(ACCEPTED, key=f"key-{self._keys}")[0]

    def settle(self) -> int:
        """Return nanoseconds until its outcome is on disk too."""
        begun, ended = self._timed(ACCEPTED)
        return begun + ended

    def refuse(self) -> int:
        """Return nanoseconds until it is refused."""
        return self._timed(REFUSED)[0]

    def close(self) -> None:
        self._gate.close()

    def _timed(self, data: bytes, key: str | None = None) -> tuple[int, int]:
        """Return nanoseconds until the decision, and from there until the outcome."""
        self._flush()
        start = perf_counter_ns()
        plan = read_plan(data, binder=self._binder)
        hook = {}
        if key is not None:
            nothing = ProposalRecord(evidence=plan.evidence, planned=1, steps=())
            hook = {"on_commit": CommitRecorder(_PLANNER, key, nothing)}
        begun = self._gate.enforcer.submit(
            plan.steps[0], planner=_PLANNER, evidence=plan.evidence, context=self._context, **hook
        )
        decided = perf_counter_ns()
        if isinstance(begun, Report):
            _require(data is REFUSED, begun)
            return decided - start, 0
        self._robot.pause(LIMITS.watch_ms)
        report = begun.poll()
        settled = perf_counter_ns()
        _require(report is not None and report.outcome is Outcome.SUCCEEDED, report)
        return decided - start, settled - decided

    def _flush(self) -> None:
        """Write the refusals that wait, as often as the gate does and outside of what is timed."""
        if monotonic() - self._flushed > LIMITS.refusal_delay_ms / 1_000:
            self._gate.ledger.flush()
            self._flushed = monotonic()


def _require(holds: object, what: object) -> None:
    if not holds:
        raise RuntimeError(f"not the answer that is measured: {what}")


@contextmanager
def _twin(folder: Path) -> Iterator[_Twin]:
    twin = _Twin(folder / "twin.db")
    try:
        yield twin
    finally:
        twin.close()
