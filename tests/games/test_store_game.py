# SPDX-License-Identifier: Apache-2.0
"""The gate's side of the log game: a store that is not the one that was left never serves.

The adversary writes the store while no gate runs: an older copy, none, one that went on elsewhere,
one whose log was chained anew or cut; the gate's own checkpoint beside it goes back as well, or is
gone. Some witnesses lie for him: they have forgotten, and sign what they are shown. One that does
not is enough.

Source: section "Audit-Tampering Game"; docs/spec/rollback.md#witnesses
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from itertools import combinations, product

import pytest
from msgspec import Struct

from authguard_r.anchoring.checkpoint_scheduler import CheckpointPolicy
from authguard_r.core.reasons import Reason
from authguard_r.operations.simulation import Simulation
from authguard_r.store.memory import MemoryStore
from fixtures import scenarios
from fixtures.amount import amount
from fixtures.gate_process import until
from fixtures.restarting_gate import copied
from fixtures.small_logs import edited, rechained, root_of
from fixtures.small_witness import SmallWitness, begin, policy

NAMES = ("one", "two", "three")
HOUR_MS = 3_600_000


class Life(Struct):
    """What a gate left: the store at the end, copies from before, and who has seen it.

    Args:
        witnesses: as they were when it ended, `seen` each.
        copies: of the store, the oldest first; the last is what was left.
        seen: size and root that each knows.
    """

    witnesses: tuple[SmallWitness, ...]
    copies: list[MemoryStore]
    seen: list[tuple[int, bytes]]

    @property
    def left(self) -> MemoryStore:
        return copied(self.copies[-1])

    def again(self, liars: tuple[int, ...] = ()) -> None:
        """Let every witness know what it knew, and those who lie nothing."""
        for number, witness in enumerate(self.witnesses):
            witness.size, witness.root = self.seen[number]
            if number in liars:
                witness.forget()


@pytest.fixture(scope="module")
def life() -> Iterator[Life]:
    with ExitStack() as stack:
        witnesses = tuple(stack.enter_context(SmallWitness(name)) for name in NAMES)
        sim = begin(MemoryStore(), policy(*witnesses, quorum=2))
        copies = [left_by(sim)]
        sim.gate.management.activate(scenarios.token())
        for number in range(6):
            copies.append(left_by(sim))
            goal = "pharmacy" if number == 2 else "station-103"
            scenarios.propose(sim, scenarios.navigate(sim.robot.state.region, goal))
            sim.gate.enforcer.stop(by="person", is_planner=False)
        sim.gate.ledger.flush(everything=True)
        sim.gate.anchor.end()
        copies.append(left_by(sim))
        sim.gate.close()
        size = len(copies[-1]._rows)
        until(lambda: all(one.size == size for one in witnesses), "all to have seen the end")
        yield Life(witnesses, copies, [(one.size, one.root) for one in witnesses])


def left_by(sim: Simulation) -> MemoryStore:
    store = sim.gate.ledger.store
    assert isinstance(store, MemoryStore)
    return copied(store)


def forgetful(store: MemoryStore) -> MemoryStore:
    """Return the store without what it holds of checkpoints: nothing binds that."""
    for key in [key for key in store._held if key[0] in {"tree", "checkpoint"}]:
        del store._held[key]
    return store


def rolled_back(life: Life, at: int) -> MemoryStore:
    return copied(life.copies[at])


def rolled_back_bare(life: Life, at: int) -> MemoryStore:
    return forgetful(rolled_back(life, at))


def deleted(life: Life, at: int) -> MemoryStore:
    return MemoryStore()


def forked(life: Life, at: int) -> MemoryStore:
    """An older copy went on under a gate that asks nobody, until it was as long and longer."""
    size = len(life.left._rows)
    sim = begin(rolled_back(life, at), CheckpointPolicy(), at_ms=scenarios.START_MS + HOUR_MS)
    while len(sim.gate.ledger.store._rows) < size + at:  # type: ignore[attr-defined]
        sim.gate.enforcer.stop(by="person", is_planner=False)
    store = left_by(sim)
    sim.gate.close()
    return store


def chained_anew(life: Life, at: int) -> MemoryStore:
    """The log says something else from a record on; registry and all are as they were."""
    store = life.left
    changed = edited(store._rows[at], mid="m-other")
    store._rows = rechained([*store._rows[:at], changed, *store._rows[at + 1 :]], at)
    return forgetful(store)


def cut(life: Life, at: int) -> MemoryStore:
    """The end of the log alone is gone."""
    store = life.left
    store._rows = store._rows[: at + 1]
    return forgetful(store)


ATTACKS: tuple[Callable[[Life, int], MemoryStore], ...] = (
    *(rolled_back, rolled_back_bare, deleted, forked, chained_anew, cut),
)
#: Every set of witnesses that leaves one who does not lie.
LIARS = [found for count in range(len(NAMES)) for found in combinations(range(len(NAMES)), count)]


def serves(store: MemoryStore, notary: CheckpointPolicy) -> bool:
    """Return whether a gate on this store goes on; where it does not, nothing moves."""
    sim = begin(store, notary, at_ms=scenarios.START_MS + 2 * HOUR_MS)
    try:
        why = sim.gate.anchor.why
        report = scenarios.propose(sim, scenarios.navigate("dock", "pharmacy"))
        refused = report.refusal is not None and report.refusal.reason is Reason.ROLLED_BACK
        assert refused is (why is not None)
        assert not refused or sim.robot.trace == []
        return why is None
    finally:
        sim.gate.close()


def asked(life: Life) -> CheckpointPolicy:
    return policy(*life.witnesses, quorum=2)


@pytest.mark.complete
@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: attack.__name__)
def test_no_store_that_was_put_there_serves_while_one_witness_does_not_lie(
    attack: Callable[[Life, int], MemoryStore], life: Life
) -> None:
    for at in range(len(life.copies) - 1):
        for liars in LIARS:
            life.again(liars)
            assert not serves(attack(life, at), asked(life)), (at, liars)


@pytest.mark.parametrize("attack", ATTACKS, ids=lambda attack: attack.__name__)
def test_where_nobody_is_asked_or_everybody_lies_it_does(
    attack: Callable[[Life, int], MemoryStore], life: Life
) -> None:
    """The control: it is the witness that finds it."""
    for at in range(len(life.copies) - 1):
        assert serves(attack(life, at), CheckpointPolicy()), at
        life.again((0, 1, 2))
        assert serves(attack(life, at), asked(life)), at


def test_a_log_that_was_cut_does_not_fit_the_checkpoint_beside_it(life: Life) -> None:
    """Without a witness, too: what the adversary leaves lying is held against him."""
    store = life.left
    store._rows = store._rows[:-1]
    assert not serves(store, CheckpointPolicy())


def test_what_was_left_serves_whoever_lies(life: Life) -> None:
    """No false alarm; and of all copies it is the only one that nothing is missing from."""
    for liars in LIARS:
        life.again(liars)
        assert serves(life.left, asked(life))


def test_an_older_copy_serves_exactly_if_no_honest_witness_had_seen_more(life: Life) -> None:
    """Undetectable by design: what was recorded after the last checkpoint that anybody saw."""
    sizes = [len(copy._rows) for copy in life.copies]
    assert len(set(sizes)) > 5
    for seen, at in product(range(0, len(sizes), amount(2, 1)), range(len(sizes))):
        life.again((0, 1, 2))
        life.witnesses[0].size = sizes[seen]
        life.witnesses[0].root = root_of(life.copies[seen]._rows)
        serving = serves(copied(life.copies[at]), asked(life))
        assert serving is (sizes[at] >= sizes[seen]), (seen, at)
