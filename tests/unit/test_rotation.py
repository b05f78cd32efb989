# SPDX-License-Identifier: Apache-2.0
"""The oldest records move once a checkpoint covers them, and every proof is as before."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from authguard_r.anchoring.anchor import AnchorNotice
from authguard_r.anchoring.checkpoints import CHECKPOINT, TREE, WITNESSED, Checkpoints
from authguard_r.anchoring.rotation import STUCK, Rotation, RotationPolicy
from authguard_r.audit.checkpoint import Checkpoint
from authguard_r.audit.note import Note, read_note
from authguard_r.audit.tree import verify_consistency
from authguard_r.audit.verify import verify_rows
from authguard_r.core.errors import StoreError
from authguard_r.core.reasons import Reason
from authguard_r.keys.notes import require_all
from authguard_r.keys.signer import folder_signer
from authguard_r.operations.simulation import Simulation
from authguard_r.store.folder import Folder
from authguard_r.store.segments import find
from authguard_r.store.sqlite import SqliteStore, read_rows
from authguard_r.wire.gate_limits import LIMITS
from fixtures import scenarios
from fixtures.segmented_stores import fill
from fixtures.small_witness import log_keys

#: Records of a test's segment: three blocks, of which a fourth part stays.
LEAST = 1_024


class Rotated:
    """A gate's store on disk, its checkpoints, and what moves its records."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.sim: Simulation = scenarios.simulation(store=path)
        self.signer = folder_signer(scenarios.trust_folder(), f"gate-{scenarios.RID}")
        ledger = self.sim.gate.ledger
        assert isinstance(ledger.store, SqliteStore)
        self.store = ledger.store
        self.checkpoints = Checkpoints(ledger, robot=scenarios.RID, signer=self.signer)
        self.rotation = self.rotating()

    def rotating(self, records: int = LEAST, *, witnessed: bool = False) -> Rotation:
        policy = RotationPolicy(records=records, witnessed=witnessed)
        ledger, robot = self.sim.gate.ledger, scenarios.RID
        return Rotation(ledger, self.store, robot=robot, signer=self.signer, policy=policy)

    def grow(self, size: int) -> None:
        """Let the log have so many records, all of them under a checkpoint."""
        fill(self.store, size - self.store.read(lambda turn: turn.head())[0])
        self.checkpoints.make()

    def turn(self, rotation: Rotation | None = None) -> list[AnchorNotice]:
        """Tick until nothing moves any more; return what was told."""
        moving, told = rotation or self.rotation, list[AnchorNotice]()
        for _ in range(40):
            told += moving.tick()
        return told

    def said(self, note: Note) -> Checkpoint:
        """Return what a note of the gate's says."""
        return require_all(note, log_keys(), where="")

    def proof(self, old: int) -> tuple[bytes, ...]:
        return self.checkpoints.proof(old, self.checkpoints.size)

    @property
    def ends(self) -> list[int]:
        return [segment.end for segment in self.store.segments.index]

    def in_store(self) -> int:
        return int(self.store._connection.execute("SELECT count(*) FROM audit").get)


@pytest.fixture
def log(tmp_path: Path) -> Iterator[Rotated]:
    made = Rotated(tmp_path / "robot.db")
    yield made
    made.sim.gate.close()


def test_nothing_moves_before_there_are_enough_records(log: Rotated) -> None:
    log.grow(LEAST - 1)
    assert log.turn() == []
    assert (log.ends, log.in_store()) == ([], LEAST - 1)


def test_the_oldest_move_and_the_newest_stay(log: Rotated) -> None:
    log.grow(LEAST)
    before = log.store.read(lambda turn: turn.rows(0, LEAST))
    assert log.turn() == []
    assert (log.ends, log.in_store()) == (
        [3 * LIMITS.rotation_block],
        LEAST - 3 * LIMITS.rotation_block,
    )
    assert log.store.read(lambda turn: turn.rows(0, LEAST)) == before


def test_a_long_log_moves_in_segments_of_that_size(log: Rotated) -> None:
    log.grow(3 * LEAST + 100)
    log.turn()
    assert log.ends == [LEAST, 2 * LEAST, 3 * LEAST - LIMITS.rotation_block]
    log.sim.gate.close()
    assert verify_rows(read_rows(log.path)).whole


def test_the_checkpoint_of_a_segment_is_the_gates_and_of_all_records_up_to_its_end(
    log: Rotated,
) -> None:
    log.grow(2 * LEAST + 300)
    log.turn()
    newest = log.checkpoints.held()
    assert newest is not None
    rows, whole = log.store.read(lambda turn: turn.rows(0, 3 * LEAST)), log.said(newest)
    for segment in log.store.segments.index:
        found = find(Folder(log.path), segment.name)
        said = log.said(read_note(found.note, where=""))
        assert (said.size, said.chain) == (segment.end, rows[segment.end - 1][3])
        proof = log.proof(said.size)
        assert verify_consistency(said.size, whole.size, said.root, whole.root, proof)
    assert log.ends


def test_what_no_checkpoint_covers_stays(log: Rotated) -> None:
    log.grow(400)
    fill(log.store, LEAST)
    log.turn()
    assert log.ends == [LIMITS.rotation_block]


def test_without_any_checkpoint_nothing_moves(log: Rotated) -> None:
    fill(log.store, LEAST)
    assert log.turn() == []
    assert log.ends == []


def test_with_witnesses_only_what_they_cosigned_moves(log: Rotated) -> None:
    log.grow(2 * LIMITS.rotation_block)
    witnessed = log.checkpoints.held()
    assert witnessed is not None
    log.grow(LEAST)
    rotation = log.rotating(witnessed=True)
    assert log.turn(rotation) == []
    assert log.ends == []
    held = witnessed.encode()
    log.store.run(lambda turn: turn.put(CHECKPOINT, WITNESSED, held))
    log.turn(rotation)
    assert log.ends == [2 * LIMITS.rotation_block]


def test_a_gate_that_never_rotates_ends_what_another_began(log: Rotated) -> None:
    log.grow(LEAST)
    while not log.ends:
        log.rotation.tick()
    assert log.in_store() == LEAST
    never = log.rotating(0)
    log.turn(never)
    assert log.in_store() == LEAST - 3 * LIMITS.rotation_block
    log.grow(3 * LEAST)
    log.turn(never)
    assert log.ends == [3 * LIMITS.rotation_block]


def test_every_proof_from_a_size_of_before_still_comes(log: Rotated) -> None:
    log.grow(2 * LEAST)
    proofs = {old: log.proof(old) for old in (1, 255, 256, 257, 700, 1_024, 1_793, 2_048)}
    log.turn()
    assert log.ends == [LEAST, 2 * LEAST - LIMITS.rotation_block]
    assert {old: log.proof(old) for old in proofs} == proofs
    assert log.checkpoints.fits()


def test_what_goes_wrong_is_told_once_tried_again_and_over_when_it_works(
    log: Rotated, monkeypatch: pytest.MonkeyPatch
) -> None:
    log.grow(LEAST)
    with monkeypatch.context() as patch:
        patch.setattr(log.store, "restore", lambda: False)
        first = log.rotation.tick()
        assert [(told.what, told.details["reason"], told.over) for told in first] == [
            (STUCK, str(Reason.STORE_FULL), False)
        ]
        assert log.turn() == []
        log.sim.robot.pause(LIMITS.rotation_again_ms)
        assert log.turn() == []  # it was told of
    assert log.ends == []
    log.sim.robot.pause(LIMITS.rotation_again_ms)
    assert log.turn() == [AnchorNotice(STUCK, {}, over=True)]
    assert log.ends == [3 * LIMITS.rotation_block]


def test_it_works_again_once_nothing_is_left_to_do(
    log: Rotated, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is sealed stays in the store while it cannot be deleted there."""
    log.grow(LEAST)
    while not log.ends:
        assert log.rotation.tick() == ()
    with monkeypatch.context() as patch:
        patch.setattr(log.store, "_closed", True)
        (told,) = log.rotation.tick()
        assert (told.what, told.over) == (STUCK, False)
    log.sim.robot.pause(LIMITS.rotation_again_ms)
    assert log.turn() == [AnchorNotice(STUCK, {}, over=True)]
    assert log.in_store() == LEAST - 3 * LIMITS.rotation_block


def test_a_disk_that_fills_on_the_way_has_its_place_back(
    log: Rotated, monkeypatch: pytest.MonkeyPatch
) -> None:
    log.grow(LEAST)
    log.rotation.tick()
    log.rotation.tick()
    folder = log.path.with_name("robot.db.segments")
    assert [file.name for file in folder.iterdir()] == ["000000000000.db.part"]
    monkeypatch.setattr(log.store, "restore", lambda: False)
    assert len(log.rotation.tick()) == 1
    assert list(folder.iterdir()) == []
    fill(log.store, 1)


def test_a_part_that_cannot_be_removed_is_left_to_the_next_start(
    log: Rotated, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(_name: str) -> None:
        raise StoreError("no")

    log.grow(LEAST)
    log.rotation.tick()
    with monkeypatch.context() as patch:
        patch.setattr(log.store, "restore", lambda: False)
        patch.setattr(log.store.segments.folder, "remove", fails)
        assert len(log.rotation.tick()) == 1
    log.sim.gate.close()
    again = Rotated(log.path)
    assert list(log.path.with_name("robot.db.segments").iterdir()) == []
    again.turn()
    assert again.ends == [3 * LIMITS.rotation_block]
    again.sim.gate.close()


def test_records_that_are_not_those_of_the_tree_do_not_move(log: Rotated) -> None:
    log.grow(LEAST)
    log.store.run(lambda turn: turn.put(TREE, "8.1", bytes(32)))
    (told,) = log.turn()
    assert told.details["reason"] == str(Reason.STORE_CORRUPT)
    assert "records 256 to 511" in str(told.details["why"])
    assert log.ends == []
