# SPDX-License-Identifier: Apache-2.0
"""Commits, counts, crashes and stores that are put back, in any order.

Never is a store accepted that is behind, or beside, the last note that was kept; never is one
refused whose gate merely died, wherever it died.
"""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import settings
from hypothesis.stateful import Bundle, RuleBasedStateMachine, invariant, rule
from hypothesis.strategies import sampled_from

from authguard_r.anchoring.anchor import StoreAnchor, read_counter
from authguard_r.audit.record import Entry
from authguard_r.core.errors import EnvironmentFault, RefusedError
from authguard_r.core.reasons import Reason
from authguard_r.keys.signer import folder_signer
from authguard_r.keys.trust import read_trust
from authguard_r.store.memory import MemoryStore
from authguard_r.store.transactions import Ledger, Transaction
from fixtures import scenarios


class Died(BaseException):
    """The gate was killed."""


class Outside:
    """A counter that outlives gates, and in whose writes they may die or fail."""

    def __init__(self) -> None:
        self.note: bytes | None = None
        self.next = "works"

    def read(self) -> bytes | None:
        return self.note

    def write(self, note: bytes) -> None:
        then, self.next = self.next, "works"
        if then == "fails":
            raise EnvironmentFault("read-only", reason=Reason.STORE_UNAVAILABLE)
        if then == "dies before":
            raise Died
        self.note = note
        if then == "dies after":
            raise Died


class Clock:
    """Time that passes with every look."""

    def __init__(self) -> None:
        self._ms = scenarios.START_MS

    def wall_ms(self) -> int:
        self._ms += 1
        return self._ms

    def mono_ms(self) -> int:
        return self._ms

    def pause(self, duration_ms: int) -> None:
        self._ms += duration_ms


def copied(store: MemoryStore) -> MemoryStore:
    """Return a snapshot of everything that is on disk."""
    made = MemoryStore()
    made._held, made._rows = dict(store._held), list(store._rows)
    return made


class Rollbacks(RuleBasedStateMachine):
    """One robot, its store, its counter, and somebody who may replace the one but not the other."""

    snapshots: Bundle[MemoryStore] = Bundle("snapshots")

    def __init__(self) -> None:
        super().__init__()
        self.clock, self.outside = Clock(), Outside()
        self.trust = read_trust(scenarios.trust_folder())
        self.signer = folder_signer(scenarios.trust_folder(), "gate-courier-1")
        self.store = MemoryStore()
        #: the links of the log when the last note was kept; None before any
        self.counted: tuple[bytes, ...] | None = None
        self.start()

    def start(self) -> None:
        """Start a gate over whatever lies there; it may die in its first count."""
        reading = read_counter(self.outside, verifier=self.trust)
        ledger = Ledger(
            self.store,
            self.clock,
            robot=scenarios.RID,
            salts=scenarios.random_bytes,
            genesis={},
            inputs={"site": "here"},
            since_ms=reading.time_ms,
        )
        anchor = StoreAnchor(
            ledger, robot=scenarios.RID, counter=self.outside, signer=self.signer, reading=reading
        )
        self.ledger, self.anchor = ledger, anchor
        fits = self.counted is None or self.links()[: len(self.counted)] == self.counted
        assert (anchor.why is None) is fits, anchor.why
        self.doing(anchor.begin)

    def links(self) -> tuple[bytes, ...]:
        return tuple(row.link for row in self.store.rows())

    def doing(self, act: Any) -> None:
        """Do what may write a note; learn whether it was kept, and start anew if it died."""
        before, links = self.outside.note, self.links
        try:
            act()
        except Died:
            self.learn(before, links())
            self.start()
        except (EnvironmentFault, RefusedError):
            self.learn(before, links())
        else:
            self.learn(before, links())

    def learn(self, before: bytes | None, links: tuple[bytes, ...]) -> None:
        if self.outside.note == before:
            return
        size = read_counter(self.outside, verifier=self.trust).counted.size  # type: ignore[union-attr]
        self.counted = links[:size]

    def commit(self, number: int = 0) -> None:
        def job(act: Transaction) -> None:
            entry = Entry(kind="alert", time_ms=act.now.utc_ms, decision="x", open={"n": number})
            act.record(entry)

        self.ledger.run(job)

    @rule()
    def commits(self) -> None:
        self.commit()

    @rule(then=sampled_from(["works", "works", "fails", "dies before", "dies after"]))
    def releases_what_cannot_be_undone(self, then: str) -> None:
        self.outside.next = then

        def release() -> None:
            self.anchor.require()
            self.anchor.ready(irreversible=True)
            self.commit()
            if not self.anchor.covered(irreversible=True):
                # it is dispatched now: no store without it may ever be accepted again
                now = read_counter(self.outside, verifier=self.trust).counted
                assert now is not None
                assert now.size == len(self.links())

        self.doing(release)
        self.outside.next = "works"

    @rule(then=sampled_from(["works", "fails", "dies before", "dies after"]))
    def starts_again(self, then: str) -> None:
        self.outside.next = then
        self.start()
        self.outside.next = "works"

    @rule()
    def ends_cleanly_and_starts(self) -> None:
        self.doing(self.anchor.count)
        self.start()

    @rule(target=snapshots)
    def is_copied(self) -> MemoryStore:
        return copied(self.store)

    @rule(snapshot=snapshots)
    def is_put_back(self, snapshot: MemoryStore) -> None:
        self.store = copied(snapshot)
        self.start()

    @rule(snapshot=snapshots, more=sampled_from([1, 2, 5]))
    def went_on_elsewhere(self, snapshot: MemoryStore, more: int) -> None:
        self.store = copied(snapshot)
        here = self.ledger
        self.ledger = Ledger(
            self.store, self.clock, robot=scenarios.RID, salts=scenarios.random_bytes, genesis={}
        )
        for number in range(more):
            self.commit(number)
        self.ledger = here
        self.start()

    @rule()
    def is_deleted(self) -> None:
        self.store = MemoryStore()
        self.start()

    @rule(then=sampled_from(["works", "fails", "dies before", "dies after"]))
    def a_person_accepts(self, then: str) -> None:
        if self.anchor.why is None:
            return
        self.commit()  # the order's own record
        self.outside.next = then
        self.doing(self.anchor.accepted)
        self.outside.next = "works"

    @invariant()
    def what_was_put_back_refuses(self) -> None:
        if self.anchor.why is not None:
            before = self.outside.note
            for act in (self.anchor.require, self.anchor.count):
                with pytest.raises(RefusedError) as refused:
                    act()
                assert refused.value.reason is Reason.ROLLED_BACK
            assert self.outside.note == before


Rollbacks.TestCase.settings = settings(max_examples=60, stateful_step_count=30)
TestRollbacks = Rollbacks.TestCase
