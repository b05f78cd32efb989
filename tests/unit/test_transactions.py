# SPDX-License-Identifier: Apache-2.0
"""A wall clock that was set back costs as long as it was set back by, and trusted time nothing."""

from __future__ import annotations

import os
import random

import msgspec

from authguard_r.core.errors import ClockError
from authguard_r.store.memory import MemoryStore
from authguard_r.store.transactions import Ledger, Transaction
from authguard_r.wire.gate_limits import LIMITS
from fixtures import scenarios
from fixtures.cases import case

TICK_MS = 100
MINUTE_MS = 60_000


class Clock:
    """Integers that a test winds; the wall clock may be wrong, the other one never is."""

    def __init__(self) -> None:
        self.ms = 0
        self.wrong_ms = 0

    def wall_ms(self) -> int:
        return scenarios.START_MS + self.ms + self.wrong_ms

    def mono_ms(self) -> int:
        return self.ms

    def pause(self, duration_ms: int) -> None:
        self.ms += duration_ms


class Bench:
    """A ledger that commits something whenever the test says so."""

    def __init__(self) -> None:
        self.clock = Clock()
        self.store = MemoryStore()
        self.ledger = self.start()
        self.times: list[int] = []

    def start(self) -> Ledger:
        return Ledger(self.store, self.clock, robot=scenarios.RID, salts=os.urandom, genesis={})

    def commit(self) -> bool:
        """Commit something; False when the clock was behind."""

        def job(act):  # type: ignore[no-untyped-def]
            act.put("test", "test", b"")
            return act.now.utc_ms

        try:
            self.times.append(self.ledger.run(job))
        except ClockError:
            return False
        return True

    def refused(self, duration_ms: int) -> list[int]:
        """Let time pass, committing in every tick; return when it was refused."""
        begun, found = self.clock.ms, []
        while self.clock.ms < begun + duration_ms:
            self.clock.pause(TICK_MS)
            if not self.commit():
                found.append(self.clock.ms - begun)
        assert self.times == sorted(self.times)
        return found


def test_a_clock_set_back_by_five_seconds_refuses_for_less_and_never_again() -> None:
    bench = Bench()
    assert bench.refused(10_000) == []
    bench.clock.wrong_ms = -5_000
    refused = bench.refused(10 * MINUTE_MS)
    # until it has caught up with what was committed, less the skew
    assert refused == list(range(TICK_MS, 5_000 - LIMITS.skew_ms, TICK_MS))
    assert bench.times[-1] <= bench.clock.wall_ms() + LIMITS.skew_ms  # nor was that time added


def test_a_clock_set_back_while_nobody_asks_heals_as_soon() -> None:
    bench = Bench()
    assert bench.commit()
    bench.clock.wrong_ms = -5_000
    bench.clock.pause(MINUTE_MS)  # the other clock has counted it, and this one has caught up
    refused = bench.refused(10 * MINUTE_MS)
    assert all(at <= 5_000 for at in refused)
    assert bench.times[-1] <= bench.clock.wall_ms() + LIMITS.skew_ms


def test_a_step_within_the_skew_refuses_nothing_and_time_goes_on() -> None:
    bench = Bench()
    assert bench.commit()
    bench.clock.wrong_ms = -LIMITS.skew_ms
    assert bench.refused(MINUTE_MS) == []
    assert bench.times[-1] == scenarios.START_MS + bench.clock.ms


def test_a_clock_that_is_set_right_again_is_taken_at_its_word() -> None:
    bench = Bench()
    assert bench.commit()
    bench.clock.wrong_ms = -3_600_000
    assert len(bench.refused(1_000)) == 10
    bench.clock.wrong_ms = 0
    assert bench.refused(MINUTE_MS) == []
    assert bench.times[-1] == bench.clock.wall_ms()


def test_a_restart_does_not_forget_what_was_committed() -> None:
    bench = Bench()
    assert bench.refused(1_000) == []
    bench.clock.wrong_ms = -5_000
    bench.ledger = bench.start()
    refused = bench.refused(MINUTE_MS)
    assert refused
    assert max(refused) < 5_000 - LIMITS.skew_ms


def test_time_never_runs_backwards_however_the_wall_clock_jumps() -> None:
    for seed in range(20):
        with case(seed):
            chance = random.Random(seed)
            bench = Bench()
            for _ in range(30):
                bench.clock.wrong_ms += chance.randint(-8_000, 4_000)
                if chance.random() < 0.3:
                    bench.clock.pause(chance.randint(0, 20_000))
                bench.refused(chance.randint(100, 6_000))
            bench.clock.pause(max(0, bench.times[-1] - bench.clock.wall_ms()))
            assert bench.refused(MINUTE_MS) == []


def test_a_thread_that_comes_back_late_turns_neither_time_nor_standing_back() -> None:
    sim = scenarios.simulation()
    sim.gate.management.activate(scenarios.token())
    ledger, acts = sim.gate.ledger, []
    mid = scenarios.mission().mid

    def job(act: Transaction) -> None:
        standing = act.standing(mid)
        assert standing is not None
        act.hold(msgspec.structs.replace(standing, actions=standing.actions + 1))
        acts.append(act)

    for _ in range(2):
        ledger.run(job)
        sim.robot.pause(TICK_MS)
    latest, now = ledger.standing(mid), ledger.now()
    ledger._remember(acts[0])  # committed first, and told of last
    assert ledger.standing(mid) == latest
    assert ledger.now() == now
