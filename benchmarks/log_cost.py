# SPDX-License-Identifier: Apache-2.0
"""What the log costs for one action: checkpoints, bytes, a witness's signature, a replay.

The witness is the product's own program in a process of its own, its files on the disk that is
measured. Checkpoints and witness are timed where the gate's loop does them, beside decisions.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import monotonic, perf_counter_ns, time
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import apsw

from authguard_r.anchoring.checkpoints import CHECKPOINT, TREE, Checkpoints
from authguard_r.anchoring.sealing.policy import Reader
from authguard_r.anchoring.witnesses import cosignature, exchange, request
from authguard_r.audit.checkpoint import origin_of
from authguard_r.audit.note import NoteKey, read_key
from authguard_r.audit.record import LogRow
from authguard_r.audit.sealed_envelopes import DataClass
from authguard_r.audit.verify import verify_rows
from authguard_r.cli.replay import LogReplay
from authguard_r.core.standing import Outcome
from authguard_r.keys.algorithms import Algorithm
from authguard_r.keys.notes import leaf_key, log_key
from authguard_r.keys.readers import new_reader
from authguard_r.keys.signer import folder_signer, gate_name
from authguard_r.keys.trust import read_trust
from authguard_r.normalize import read_plan
from authguard_r.store.sqlite import open_store, read_rows
from authguard_r.witness.server import PATH
from authguard_r.witness.service import make_witness, register
from durable import MID, row_size
from fixtures.witness_process import served
from log_figures import TRIGGERS
from log_growth import Writer
from measure import Effort, Subject, Timing, interleave, timed
from scene import PLANNER, bench, long_mission, scenarios
from yardsticks import BareInsert

_NAME = "benchmarks.example/witness"
#: The shipped delivery.
_TASK = b"""navigate_to(destination="Pharmacy", speed=0.8)
pick_up(object="P1", force=12)
navigate_to(destination="Station 101", speed=0.8)
put_down(object="P1", at="Station 101", force=10)
navigate_to(destination="Dock", speed=0.8)"""


class Efforts(NamedTuple):
    """How often, for each of the three that are timed.

    Args:
        checkpoint: checkpoints after each number of records.
        witness: exchanges with the witness.
        replay: replays of the whole short log.
        decisions: decisions in that log.
        sealed: records with sealed fields, and without.
    """

    checkpoint: Effort
    witness: Effort
    replay: Effort
    decisions: int
    sealed: Effort


def checkpoints(folder: Path, effort: Effort) -> dict[str, Timing]:
    """Time a checkpoint after so many records: tree, signature, commit; beside a bare insert."""
    writer = Writer(folder / "checkpoints.db")
    insert = BareInsert(folder / "checkpoints-bare.db", row_size(folder))
    subjects = [
        Subject(f"log.checkpoint.{count}", timed(writer.notary.make, before=_added(writer, count)))
        for count in TRIGGERS
    ]
    subjects.append(Subject("insert.bare.checkpoint", timed(insert.insert)))
    try:
        return interleave(subjects, effort)
    finally:
        insert.close()
        writer.close()


def witness(folder: Path, effort: Effort) -> dict[str, Timing]:
    """Time a witness: the request sent, its answer there, the cosignature held to its key.

    Nobody looks later at what came, and nothing waits for its turn: it is the exchange alone.
    """
    writer = Writer(folder / "witnessed.db")
    signer = folder_signer(scenarios.trust_folder(), gate_name(scenarios.RID))
    log = log_key(origin_of(scenarios.RID), leaf_key(signer.chain))
    place = folder / "witness"
    made = make_witness(place, name=_NAME, algorithm=Algorithm.ED25519, mark=None)
    register(place, (log.text(),), int(time()), again=False)
    insert = BareInsert(folder / "witness-bare.db", row_size(folder))
    try:
        with served(place) as found:
            asking = _Asking(
                writer,
                Checkpoints(writer.ledger, robot=scenarios.RID, signer=signer),
                url=str(found.ready["url"]).removesuffix(PATH),
                key=read_key(made.key, where="witness"),
            )
            subjects = [
                Subject("log.witness", asking.once),
                Subject("insert.bare.witness", timed(insert.insert)),
            ]
            return interleave(subjects, effort)
    finally:
        insert.close()
        writer.close()


def sealed(folder: Path, effort: Effort) -> tuple[dict[str, Timing], list[dict[str, Any]]]:
    """Time a decision's record in a commit of its own, its fields sealed and not; return its bytes.

    All classes are sealed, for one reader with a key of X25519; more readers cost a mission's first
    record more, and the others nothing.
    """
    reader = Reader(role="auditor", classes=tuple(DataClass), key=new_reader().public.text())
    writers = {"sealed": Writer(folder / "sealed.db", reader), "plain": Writer(folder / "plain.db")}
    try:
        subjects = [
            Subject(f"log.{name}", timed(writer.append)) for name, writer in writers.items()
        ]
        timings = interleave(subjects, effort)
    finally:
        for writer in writers.values():
            writer.close()
    told = []
    for name in writers:
        rows = [r for r in read_rows(folder / f"{name}.db") if b'"kind":"decision"' in r.record]
        told.append(_spread(f"one decision's record, {name}", rows, len(rows), 0))
    return timings, told


def replay(folder: Path, effort: Effort, decisions: int) -> dict[str, Timing]:
    """Time the oracle making every decision of a log again, and verifying the same rows.

    Both are for one decision, with the outcomes that lie between them.
    """
    path = folder / "replayed.db"
    held = bench(open_store(path))
    held.gate.management.activate(long_mission(MID))
    (step,), evidence = held.steps()
    for _ in range(decisions):
        held.take_in()
        held.propose(step, evidence)
    held.gate.close()
    rows = list(read_rows(path))

    def again() -> int:
        made = LogReplay(read_trust(scenarios.trust_folder()))
        start = perf_counter_ns()
        for row in rows:
            made.see(row)
        spent = perf_counter_ns() - start
        if made.agree != decisions or made.decisions != decisions:
            raise RuntimeError(f"expected {decisions} decisions that agree, got {made.agree}")
        return spent // decisions

    def verified() -> int:
        start = perf_counter_ns()
        verify_rows(rows)
        return (perf_counter_ns() - start) // decisions

    subjects = [Subject("log.replay", again), Subject("log.replay.verify", verified)]
    return interleave(subjects, effort)


def storage(folder: Path, grown: Path, size: int) -> list[dict[str, Any]]:
    """Return the bytes of records and of one mission, by where they lie.

    Args:
        folder: for the mission's store.
        grown: a store with many records, over which its tree is spread.
        size: how many.
    """
    path = folder / "mission.db"
    records, actions = _delivered(path)
    rows = []
    for kind in ("decision", "outcome"):
        some = [row for row in records if f'"kind":"{kind}"'.encode() in row.record]
        rows.append(_spread(f"one {kind}'s record, in the mean", some, len(some), 0))
    held = _held(path)
    mission = [row for row in records if row.seq]
    what = f"the shipped delivery: {actions} actions, {len(mission)} records"
    rows.append(_spread(what, mission, 1, held))
    rows.append(_spread("one action of it", mission, actions, held))
    tree = round(_held(grown) / size, 2)
    nothing = {"open": 0, "sealed": 0, "link": 0}
    rows.append({"what": f"the tree, for one record of {size}", **nothing, "tree": tree})
    return rows


class _Asking:
    """Asks a witness about one checkpoint after the other."""

    def __init__(self, writer: Writer, kept: Checkpoints, *, url: str, key: NoteKey) -> None:
        self._writer, self._kept = writer, kept
        self._url, self._key = urlsplit(url), key
        self._old = 0

    def once(self) -> int:
        """Show the next checkpoint; raise when it is not cosigned."""
        self._writer.add(2)
        self._kept.make()
        note, size = self._kept.newest, self._kept.size
        if note is None:
            raise RuntimeError("no checkpoint was made")
        body = request(self._old, self._kept.proof(self._old, size), note)
        start = perf_counter_ns()
        answer = exchange(self._url, body, monotonic() + 5.0)
        held = cosignature(answer, note, self._key)
        spent = perf_counter_ns() - start
        if held is None:
            raise RuntimeError(f"the witness did not cosign: {answer.status} {answer.body!r}")
        self._old = size
        return spent


def _added(writer: Writer, count: int) -> Callable[[], None]:
    def add() -> None:
        writer.notary.make()
        writer.add(count)

    return add


def _delivered(path: Path) -> tuple[list[LogRow], int]:
    """Carry out the shipped delivery; return the log and the number of actions."""
    sim = scenarios.simulation(store=path)
    try:
        sim.gate.management.activate(scenarios.token())
        plan = read_plan(_TASK, binder=sim.binder)
        context = sim.binder.context()
        for step in plan.steps:
            report = sim.gate.enforcer.propose(
                step, planner=PLANNER, evidence=plan.evidence, context=context
            )
            if report.outcome is not Outcome.SUCCEEDED:
                raise RuntimeError(f"expected the shipped delivery to be done, got {report}")
    finally:
        sim.gate.close()
    return list(read_rows(path)), len(plan.steps)


def _held(path: Path) -> int:
    """Return how many bytes a closed store holds for tree and checkpoints."""
    connection = apsw.Connection(str(path), flags=apsw.SQLITE_OPEN_READONLY)
    query = "SELECT coalesce(sum(length(key) + length(value)), 0) FROM held WHERE kind IN (?, ?)"
    try:
        return int(connection.execute(query, (TREE, CHECKPOINT)).get)
    finally:
        connection.close()


def _spread(what: str, rows: list[LogRow], over: int, tree: int) -> dict[str, Any]:
    """Return the bytes of rows by where they lie, divided by so many."""
    parts = {
        "open": sum(len(row.record) for row in rows),
        "sealed": sum(len(row.sealed) for row in rows),
        "link": sum(len(row.link) for row in rows),
        "tree": tree,
    }
    return {"what": what, **{name: round(size / over) for name, size in parts.items()}}
