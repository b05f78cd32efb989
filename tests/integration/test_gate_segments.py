# SPDX-License-Identifier: Apache-2.0
"""A real gate moves its oldest records while it decides, is killed on the way, and loses none."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from authguard_r.anchoring.checkpoints import FRONTIER, NEWEST, TREE
from authguard_r.anchoring.rotation import STUCK
from authguard_r.audit.checkpoint import Checkpoint, read_checkpoint
from authguard_r.audit.note import read_note
from authguard_r.audit.record import LogRow
from authguard_r.audit.tree import Frontier, leaf_hash
from authguard_r.audit.verify import of_checkpoint, verify_rows
from authguard_r.cli import call
from authguard_r.client import GateClient
from authguard_r.keys.notes import require_all
from authguard_r.store.segments import SEGMENT
from authguard_r.store.sqlite import open_store, read_held, read_rows
from authguard_r.wire.messages import ClientRole
from fixtures.gate_process import RunningGate, until
from fixtures.segmented_stores import fill
from fixtures.small_witness import SmallWitness, log_keys
from integration.test_rollback import SCAN

LEAST = 1_024
#: Refused, and recorded each time.
NOWHERE = b"navigate(place=roof)"


def filled(gate: RunningGate, count: int) -> None:
    """Let the log of a gate that ended have so many more records."""
    store = open_store(gate.store)
    fill(store, count)
    store.close()


class Rotating(RunningGate):
    """A gate with the robot inside that moves its records early."""

    def __init__(self, **more: Any) -> None:
        super().__init__(
            simulate=True,
            segment_records=LEAST,
            checkpoint_records=64,
            fold_ms=0,
            refusals=0,
            **more,
        )

    @property
    def segments(self) -> list[Path]:
        """The segments' files, finished ones alone."""
        return sorted(self.store.with_name(f"{self.store.name}.segments").glob("*.db"))

    def step(self, planner: GateClient) -> None:
        """Propose something that is refused: one record."""
        planner.propose(NOWHERE)

    def status(self) -> dict[str, Any]:
        with self.client(ClientRole.AUDITOR, "looks") as auditor:
            return auditor.status()

    def grow(self, count: int) -> None:
        """Propose while records are being moved."""
        with self.client(ClientRole.PLANNER) as planner:
            for _ in range(count):
                self.step(planner)

    def newest(self) -> Checkpoint:
        """Return the checkpoint that the gate tells of, its signature verified."""
        note = read_note(self.status()["anchor"]["notes"][0].encode(), where="")
        return require_all(note, log_keys(), where="")


@pytest.fixture
def gate() -> Iterator[Rotating]:
    with Rotating() as running:
        running.stop_process("gate")
        filled(running, LEAST - 50)
        running.start_gate()
        yield running


def oldest(path: Path) -> int:
    """Return the number of the oldest record that the store itself has."""
    store = open_store(path)
    try:
        return int(store._connection.execute("SELECT min(seq) FROM audit").get)
    finally:
        store.close()


@pytest.mark.smoke
def test_a_gate_moves_its_oldest_records_while_it_decides(gate: Rotating) -> None:
    gate.activate()
    seen = [(told.seq, told.kind) for told in gate.records()]
    with gate.client(ClientRole.PLANNER) as planner:
        while not gate.segments:
            gate.step(planner)
    before = gate.newest()
    gate.grow(100)
    now = [(told.seq, told.kind) for told in gate.records()]
    assert now[: len(seen)] == seen
    gate.restart()
    gate.grow(10)
    gate.stop_process("gate")
    rows = tuple(read_rows(gate.store))
    assert verify_rows(rows, anchors=[of_checkpoint(before)]).whole
    assert int(read_held(gate.store, SEGMENT, "mark") or b"0") >= 3 * 256
    assert call(["audit", "segments", str(gate.store), "--log-key", log_keys()[0].text()]) == 0
    for _ in range(10):  # ten times a second the gate deletes some of what it moved
        if oldest(gate.store) > 0:
            break
        gate.start_gate()
        until(lambda: gate.status()["uptime_ms"] > 1_000, "a second of upkeep")
        gate.stop_process("gate")
    assert oldest(gate.store) > 0


def test_a_gate_that_is_killed_while_it_moves_records_has_them_all(gate: Rotating) -> None:
    known: tuple[LogRow, ...] = ()
    folder = gate.store.with_name(f"{gate.store.name}.segments")
    with gate.client(ClientRole.PLANNER) as planner:
        while not list(folder.glob("*")):  # a half of a segment is seen first, and not for long
            gate.step(planner)
    for awaited in ("*", "*.db", "*.db", "*.db"):
        until(lambda pattern=awaited: list(folder.glob(pattern)), "a segment")
        gate.kill9()
        rows = tuple(read_rows(gate.store))
        assert rows[: len(known)] == known
        assert verify_rows(rows).whole
        known = rows
        gate.start_gate()
        gate.grow(5)
    gate.stop_process("gate")
    assert verify_rows(read_rows(gate.store)).whole


def test_a_missing_segment_keeps_a_gate_from_starting_and_is_named(gate: Rotating) -> None:
    gate.grow(120)
    until(lambda: gate.segments, "a segment")
    gate.stop_process("gate")
    gate.segments[0].unlink()
    with pytest.raises(AssertionError, match=r"000000000000\.db"):
        gate.start_gate()


def test_a_checkpoint_of_before_is_the_beginning_of_the_log_after(gate: Rotating) -> None:
    """The proof that a witness asks for is made of links that lie in a segment now."""
    # else the newest few records wait a minute for a checkpoint, as long as this test has patience
    soon = {"checkpoint_ms": 100, "quorum": 1}
    gate.grow(120)
    gate.stop_process("gate")
    note = read_held(gate.store, "checkpoint", NEWEST)
    assert note is not None
    old = read_checkpoint(read_note(note, where="").text, where="")
    with SmallWitness("one") as witness:
        gate.configure(replace(gate.config, witnesses=(witness.place,), **soon))
        gate.start_gate()
        until(lambda: witness.size >= old.size, "a cosignature")
        gate.grow(20)
        until(lambda: gate.segments, "a segment")
        gate.grow(100)
        until(lambda: gate.status()["anchor"]["witness"]["unwitnessed"] == 0, "the cosignatures")
        size, root = witness.size, witness.root
    gate.stop_process("gate")
    links = [row.link for row in read_rows(gate.store)][:size]
    assert Frontier().grown(map(leaf_hash, links)).root() == root


def test_status_says_what_the_mission_wrote_and_goes_on_after_a_restart(gate: Rotating) -> None:
    assert gate.status()["log"]["mission"] is None
    gate.activate()
    for _ in range(2):
        with gate.client(ClientRole.PLANNER) as planner:
            for _ in range(20):
                planner.propose(SCAN)
        told = gate.status()
        said, mid = told["log"], told["mission"]["mid"]
        gate.stop_process("gate")
        known = list(read_rows(gate.store))[: said["mission"]["counted"]]
        mine = [row for row in known if f'"mid":"{mid}"'.encode() in row.record]
        assert said["mission"]["counted"] == said["size"]
        assert said["mission"]["records"] == len(mine) > 20
        size = sum(len(row.record) + len(row.sealed) + len(row.link) for row in mine)
        assert said["mission"]["bytes"] == size
        gate.start_gate()


def test_a_store_that_was_put_back_is_not_rotated(gate: Rotating) -> None:
    gate.stop_process("gate")
    filled(gate, 100)
    store = open_store(gate.store)
    store.run(lambda turn: turn.put(TREE, FRONTIER, b"another log's"))
    store.close()
    gate.start_gate()
    assert gate.status()["anchor"]["why"] == "checkpoint_differs"
    until(lambda: gate.status()["uptime_ms"] > 1_000, "ten looks")
    assert not gate.store.with_name(f"{gate.store.name}.segments").exists()


def test_a_folder_that_cannot_be_written_is_told_once_and_decisions_go_on(gate: Rotating) -> None:
    gate.stop_process("gate")
    folder = gate.store.with_name(f"{gate.store.name}.segments")
    folder.write_text("not a folder")
    gate.start_gate()
    gate.grow(120)

    def told() -> list[dict[str, Any]]:
        return [alert for alert in gate.status()["alerts"] if alert["what"] == STUCK]

    until(told, "the alert")
    gate.grow(20)
    assert len(told()) == 1
    assert [one.open.get("what") for one in gate.records()].count(STUCK) == 1
