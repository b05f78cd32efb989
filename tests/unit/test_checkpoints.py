# SPDX-License-Identifier: Apache-2.0
"""Checkpoints of a store's log: the tree grows beside it, and what does not fit stops the gate."""

from __future__ import annotations

import random
from typing import Any

import msgspec
import pytest

from authguard_r.anchoring.checkpoint_scheduler import CheckpointPolicy
from authguard_r.anchoring.checkpoints import (
    CHECKPOINT,
    FRONTIER,
    LEVELS,
    NEWEST,
    TREE,
    Checkpoints,
    StoredNodes,
)
from authguard_r.anchoring.evidence import Discrepancy
from authguard_r.audit.checkpoint import Checkpoint, read_checkpoint
from authguard_r.audit.note import Note, NoteSignature, read_note
from authguard_r.audit.record import Entry
from authguard_r.audit.tree import (
    consistency_proof,
    leaf_hash,
    root_of,
    verify_consistency,
)
from authguard_r.core.errors import EnvironmentFault, StoreError
from authguard_r.core.ports import Turn
from authguard_r.core.principals import Endorsed
from authguard_r.core.reasons import Reason
from authguard_r.keys.notes import require_all
from authguard_r.keys.signer import folder_signer
from authguard_r.operations.simulation import Simulation
from authguard_r.store.memory import MemoryStore
from fixtures import scenarios
from fixtures.inclusion import inclusion_proof, verify_inclusion
from fixtures.memory_tree import MemoryTree
from fixtures.restarting_gate import copied
from fixtures.small_witness import ORIGIN, begin, log_keys

GO = scenarios.navigate("dock", "pharmacy")


def grown(store: MemoryStore, count: int) -> MemoryStore:
    """Append so many rows with any links: a tree does not look at records."""

    def job(turn: Turn) -> None:
        for _ in range(count):
            turn.append(b"", b"", random.randbytes(32))

    store.run(job)
    return store


class Log:
    """Checkpoints over rows that mean nothing."""

    def __init__(self) -> None:
        self.sim = begin(MemoryStore(), CheckpointPolicy())
        self.store = self.sim.gate.ledger.store
        self.made = self.again()

    def again(self) -> Checkpoints:
        own = folder_signer(scenarios.trust_folder(), f"gate-{scenarios.RID}")
        return Checkpoints(self.sim.gate.ledger, robot=scenarios.RID, signer=own)

    @property
    def tree(self) -> MemoryTree:
        made = MemoryTree()
        for row in self.store.rows():  # type: ignore[attr-defined]
            made.append(leaf_hash(row.link))
        return made

    def said(self) -> Checkpoint:
        note = self.made.held()
        assert note is not None
        return require_all(note, log_keys(), where="")

    def put(self, kind: str, key: str, value: bytes) -> None:
        self.store.run(lambda turn: turn.put(kind, key, value))


@pytest.fixture
def log() -> Log:
    return Log()


@pytest.mark.parametrize("sizes", [(1, 255, 256, 257), (700, 2_048), (5, 1_024, 1_029)])
def test_the_newest_note_has_the_size_root_and_link_of_the_log(
    log: Log, sizes: tuple[int, ...]
) -> None:
    for size in sizes:
        grown(log.store, size - len(log.store.rows()))  # type: ignore[attr-defined, arg-type]
        log.made.make()
        said, rows = log.said(), log.store.rows()  # type: ignore[attr-defined]
        assert (said.origin, said.size, said.chain) == (ORIGIN, size, rows[-1].link)
        assert said.root == root_of(log.tree, size)
        assert log.made.size == size
        assert log.again().fits()


def test_every_proof_out_of_the_store_is_the_trees(log: Log) -> None:
    grown(log.store, 1_500)  # type: ignore[arg-type]
    log.made.make()
    tree, size = log.tree, 1_501
    for old in (1, 2, 255, 256, 257, 511, 1_024, 1_500, size):
        proof = log.made.proof(old, size)
        assert proof == consistency_proof(tree, old, size)
        assert verify_consistency(old, size, root_of(tree, old), root_of(tree, size), proof)
        held = log.store.read(
            lambda turn, old=old: inclusion_proof(StoredNodes(turn), old - 1, size)
        )
        leaf = tree.node(0, old - 1)
        assert verify_inclusion(leaf, old - 1, size, held, root_of(tree, size))


def test_roots_of_each_level_are_held_and_those_between_come_out_of_them(log: Log) -> None:
    """65,536 records end a subtree of level 16, which is made of 256 of level 8."""
    grown(log.store, (1 << 16) - 1)  # type: ignore[arg-type]
    log.made.make()
    tree = log.tree
    for level, index in ((8, 0), (8, 255), (16, 0)):
        held = log.store.read(lambda turn, at=f"{level}.{index}": turn.get(TREE, at))
        assert held == tree.node(level, index)
    for level, index in ((9, 3), (15, 1), (3, 77)):
        assert log.store.read(lambda t, at=(level, index): StoredNodes(t).node(*at)) == (
            tree.node(level, index)
        )
    assert LEVELS == (8, 16, 24, 32)


def test_a_page_at_a_time_and_a_crash_between_pages_loses_nothing(log: Log) -> None:
    grown(log.store, 2_500)  # type: ignore[arg-type]
    assert not log.made.step()
    assert log.made.held() is None
    after = log.again()  # the gate dies here
    assert after.fits()
    assert not after.step()
    assert after.step()
    assert after.step()
    log.made = after
    assert log.said().root == root_of(log.tree, 2_501)


def test_what_has_a_checkpoint_is_not_signed_again(log: Log) -> None:
    log.made.make()
    note = log.made.held()
    log.made.make()
    assert log.made.held() == note


def test_the_next_start_signs_anew_and_keeps_what_witnesses_said(log: Log) -> None:
    """The key may be another one by now; a cosignature of the same text is as good as before."""
    log.made.make()
    note = log.made.held()
    assert note is not None
    other = NoteSignature("witness", b"abcd", b"signature")
    log.made.keep(Note(note.text, (*note.signatures, other)), witnessed=False)
    again = log.again()
    again.make()
    held = again.held()
    assert held is not None
    assert held.signatures[-1] == other
    assert [one.name for one in held.signatures] == [ORIGIN, "witness"]


def test_cosignatures_that_come_late_are_not_held_as_the_newest(log: Log) -> None:
    log.made.make()
    old = log.made.held()
    assert old is not None
    grown(log.store, 1)  # type: ignore[arg-type]
    log.made.make()
    log.made.keep(old, witnessed=False)
    assert log.made.newest == log.made.held() != old
    assert log.made.held("witnessed") is None
    log.made.keep(old, witnessed=True)
    assert log.made.held("witnessed") == old
    assert log.again().held() != old


def test_without_a_key_nothing_is_made() -> None:
    log = Log()
    none = Checkpoints(log.sim.gate.ledger, robot=scenarios.RID, signer=None)
    none.make()
    assert none.held() is None
    none.keep(Note("x\n", (NoteSignature("a", b"abcd", b"s"),)), witnessed=False)
    assert none.held() is None


def bad_note(log: Log, **changes: Any) -> bytes:
    note = log.made.held()
    assert note is not None
    said = msgspec.structs.replace(read_checkpoint(note.text, where=""), **changes)
    return Note(said.text(), note.signatures).encode()


@pytest.mark.parametrize(
    "changes",
    [
        {"origin": "authguard-r/lifter-1/audit"},
        {"size": 301},
        {"size": 0},
        {"size": 299},
        {"root": bytes(32)},
        {"chain": bytes(32)},
        {"chain": None},
    ],
)
def test_a_newest_checkpoint_of_another_log_is_found(log: Log, changes: dict[str, Any]) -> None:
    grown(log.store, 299)  # type: ignore[arg-type]
    log.made.make()
    assert log.again().fits()
    log.put(CHECKPOINT, NEWEST, bad_note(log, **changes))
    assert not log.again().fits()


@pytest.mark.parametrize(
    ("key", "value"),
    [
        (FRONTIER, b'{"peaks":[],"size":0} '),
        (FRONTIER, b'{"peaks":[],"size":300}'),
        (FRONTIER, b'{"peaks":["AA"],"size":256}'),
        (FRONTIER, b'{"peaks":["+"],"size":256}'),
        (FRONTIER, b'{"peaks":["AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA"],"size":256}'),
        (FRONTIER, b'{"peaks":["AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA"],"size":512}'),
        (FRONTIER, b""),
        ("8.0", bytes(32)),
        ("8.0", b""),
    ],
)
def test_a_tree_that_is_not_the_logs_is_found(log: Log, key: str, value: bytes) -> None:
    grown(log.store, 299)  # type: ignore[arg-type]
    log.made.make()
    log.put(TREE, key, value)
    assert not log.again().fits()


def test_a_log_that_was_cut_off_behind_its_checkpoint_is_found(log: Log) -> None:
    grown(log.store, 299)  # type: ignore[arg-type]
    log.made.make()
    log.store._rows.pop()  # type: ignore[attr-defined]
    assert not log.again().fits()


def test_a_proof_of_what_the_store_does_not_hold_is_refused(log: Log) -> None:
    log.made.make()
    with pytest.raises(StoreError) as fault:
        log.made.proof(1, 3)
    assert fault.value.reason is Reason.STORE_CORRUPT


def test_an_accepted_log_gets_a_tree_of_its_own(log: Log) -> None:
    grown(log.store, 299)  # type: ignore[arg-type]
    log.made.make()
    log.put(TREE, "8.0", bytes(32))
    log.made.restart()
    assert log.made.held() is None
    log.made.make()
    assert log.again().fits()
    assert log.said().root == root_of(log.tree, 300)


# in a gate


def changed_store() -> MemoryStore:
    """Return a store whose log ended with a mission, and whose last record was changed since."""
    sim = begin(MemoryStore(), CheckpointPolicy())
    sim.gate.management.activate(scenarios.token(scenarios.mission()))
    store = copied_at_end(sim)
    rows = store._rows
    rows[-1] = msgspec.structs.replace(rows[-1], link=bytes(32))
    return store


def copied_at_end(sim: Simulation) -> MemoryStore:
    sim.gate.anchor.end()
    store = sim.gate.ledger.store
    assert isinstance(store, MemoryStore)
    made = copied(store)
    sim.gate.close()
    return made


def test_a_gate_on_a_log_that_is_not_its_checkpoints_decides_nothing() -> None:
    sim = begin(changed_store(), CheckpointPolicy())
    assert sim.gate.anchor.why is Discrepancy.CHECKPOINT_DIFFERS
    assert scenarios.propose(sim, GO).refusal.reason is Reason.ROLLED_BACK
    shown = sim.gate.anchor.shown()
    assert (shown["state"], shown["by"], shown["counted"]) == ("put_back", "store", None)
    assert sim.gate.anchor.tick() == ()
    alerts = [r for r in told(sim) if r["what"] == "the store was rolled back"]
    assert [alert["why"] for alert in alerts] == ["checkpoint_differs"]
    assert "number" not in alerts[0]


def told(sim: Simulation) -> list[dict[str, Any]]:
    rows = sim.gate.ledger.peek(lambda turn: turn.rows(0, 1_000))
    opened = [msgspec.json.decode(record)["open"] for _, record, _, _ in rows]
    return [one for one in opened if "what" in one]


def test_a_clean_end_covers_the_whole_log() -> None:
    sim = begin(MemoryStore(), CheckpointPolicy())
    sim.gate.management.activate(scenarios.token(scenarios.mission()))
    store = copied_at_end(sim)
    data = store._held[CHECKPOINT, NEWEST]
    said = read_checkpoint(read_note(data, where="").text, where="")
    assert said.size == len(store._rows)
    assert begin(store, CheckpointPolicy()).gate.anchor.why is None


def test_what_cannot_be_undone_is_in_a_checkpoint_before_it_is_dispatched(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sim = begin(MemoryStore(), CheckpointPolicy())
    made = scenarios.mission()
    grants = tuple(msgspec.structs.replace(grant, irreversible=True) for grant in made.actions)
    made = msgspec.structs.replace(made, actions=grants)
    sim.gate.management.activate(scenarios.token(made))
    seen: list[tuple[object, int]] = []
    dispatch = sim.robot.dispatch

    def looked(action: Any, lease: Any) -> Any:
        size = sim.gate.ledger.peek(lambda turn: turn.head())[0]
        seen.append((sim.gate.anchor.shown()["checkpoint"], size))
        return dispatch(action, lease)

    monkeypatch.setattr(sim.robot, "dispatch", looked)
    assert scenarios.propose(sim, GO).outcome == "succeeded"
    assert seen == [(seen[0][1], seen[0][1])]


class Token:
    """The gate's key on a token that somebody may unplug."""

    def __init__(self) -> None:
        self.key = folder_signer(scenarios.trust_folder(), f"gate-{scenarios.RID}")
        self.here = True

    @property
    def chain(self) -> tuple[bytes, ...]:
        return self.key.chain

    def endorse(self, message: bytes) -> tuple[Endorsed, ...]:
        if not self.here:
            raise EnvironmentFault("it is not plugged in", reason=Reason.KEY_INVALID)
        return self.key.endorse(message)


def test_a_checkpoint_that_cannot_be_held_starts_nothing_that_has_no_undo() -> None:
    token = Token()
    sim = begin(MemoryStore(), CheckpointPolicy(), signer=token)
    made = scenarios.mission()
    grants = tuple(msgspec.structs.replace(grant, irreversible=True) for grant in made.actions)
    sim.gate.management.activate(scenarios.token(msgspec.structs.replace(made, actions=grants)))
    token.here = False
    assert sim.gate.anchor.tick() == ()
    report = scenarios.propose(sim, GO)
    assert report.outcome == "not_started"
    assert [finding.reason for finding in report.reasons] == [Reason.KEY_INVALID]
    assert sim.robot.trace == []
    sim.gate.close()  # an end without a last checkpoint is one all the same


def test_a_checkpoint_is_made_for_records_for_time_and_at_a_missions_end() -> None:
    sim = begin(MemoryStore(), CheckpointPolicy(records=4, every_ms=60_000))
    anchor, ledger = sim.gate.anchor, sim.gate.ledger

    def size() -> int:
        return ledger.peek(lambda turn: turn.head())[0]

    def covered() -> bool:
        anchor.tick()
        return anchor.shown()["checkpoint"] == size()

    def note(count: int) -> None:
        for _ in range(count):
            ledger.note(
                lambda at: Entry(kind="alert", time_ms=at, decision="alert", mid="-", open={})
            )

    assert covered()  # the first as soon as there is time
    note(3)
    assert not covered()
    note(1)
    assert covered()
    note(1)
    assert not covered()
    sim.robot.pause(60_000)
    assert covered()
    made = scenarios.mission()
    sim.gate.management.activate(scenarios.token(made))
    assert not covered()
    sim.gate.ledger.run(
        lambda act: act.hold(
            msgspec.structs.replace(act.standing(made.mid), status="completed")  # type: ignore[type-var]
        )
    )
    assert covered()
    assert covered()
