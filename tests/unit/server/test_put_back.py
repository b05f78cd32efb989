# SPDX-License-Identifier: Apache-2.0
"""A gate's own parts on a store that was put back: order, answer, status, doctor."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from msgspec.structs import replace

from authguard_r.anchoring.counter import FileCounter
from authguard_r.anchoring.places import WitnessPlace
from authguard_r.client.session import done_of
from authguard_r.core.errors import ClockError, MalformedError, RefusedError
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.operations.checkup import GateSetup, checkup
from authguard_r.operations.checkup.advice import AdviceCode, Level
from authguard_r.operations.checkup.logbook import counter_advice, store_advice, witness_advice
from authguard_r.operations.simulation import simulate
from authguard_r.server.recovery import Recovery
from authguard_r.server.remediation import remedy_of
from authguard_r.store.sqlite import open_store
from authguard_r.wire.messages import OrderKind
from fixtures import scenarios
from fixtures.small_witness import SmallWitness, begin, policy
from unit.server.robots import config


def test_the_answer_to_an_order_is_taken_under_its_own_name() -> None:
    assert done_of(OrderKind.ACCEPT_STORE, {"accepted": {"size": 3}}) == {"size": 3}
    assert done_of(OrderKind.REVOCATIONS, {"revocations": {}}) == {}
    assert done_of(OrderKind.COMMAND, {"standing": {}}) == {}
    for said in ({}, {"standing": {}}, {"accepted": 3}):
        with pytest.raises(MalformedError, match="the result of the order"):
            done_of(OrderKind.ACCEPT_STORE, said)


def test_whoever_reads_the_refusal_is_told_what_to_do() -> None:
    assert "authguard recover" in remedy_of()[Reason.ROLLED_BACK]


def test_the_doctor_names_a_counter_that_is_missing_or_worth_little(tmp_path: Path) -> None:
    store = tmp_path / "robot.db"
    none = counter_advice(None, store)
    assert (none.level, none.code) == (Level.WARNING, AdviceCode.COUNTER)
    assert "--counter" in none.mend
    beside = counter_advice(tmp_path / "counter", store)
    assert (beside.level, beside.place) == (Level.WARNING, str(tmp_path / "counter"))
    away = counter_advice(tmp_path / "mount" / "counter", store)
    assert away.level is Level.UNSAFE
    elsewhere = Path("/dev/shm/counter")
    if elsewhere.parent.is_dir() and elsewhere.parent.stat().st_dev != tmp_path.stat().st_dev:
        assert counter_advice(elsewhere, store).level is Level.OK


def test_the_doctor_says_what_witnesses_are_worth(tmp_path: Path) -> None:
    key = SmallWitness("w", ()).named.text()
    here = WitnessPlace(url="http://127.0.0.1:1", key=key)
    away = WitnessPlace(url="https://witness.example", key=key)
    store = tmp_path / "robot.db"

    def levels(quorum: int, *places: WitnessPlace) -> list[Level]:
        held = config(witnesses=places, quorum=quorum)
        return [advice.level for advice in witness_advice(held)]

    assert levels(0) == []
    assert levels(1, away) == [Level.OK]
    assert levels(1, here) == [Level.WARNING, Level.OK]
    assert levels(1, away, here) == [Level.WARNING]
    assert levels(2, away, here) == [Level.WARNING, Level.OK]
    assert levels(2, away, away, here) == [Level.OK]
    setup = GateSetup(demo=False, uid=0, store=store, config=config(witnesses=(away,), quorum=1))
    (found,) = (a for a in checkup(setup, scenarios.NOW) if a.code is AdviceCode.COUNTER)
    assert found.level is Level.OK


def test_the_doctor_says_where_the_newest_checkpoint_is(tmp_path: Path) -> None:
    store = tmp_path / "robot.db"

    def said() -> tuple[Level, str]:
        found = {
            a.code: a for a in store_advice(store, scenarios.NOW, uid=os.geteuid(), deep=False)
        }
        return found[AdviceCode.ANCHOR].level, found[AdviceCode.ANCHOR].message

    with SmallWitness("w") as witness:
        opened = open_store(store)
        gate = begin(opened, policy()).gate
        gate.ledger.close()
        assert said()[1].startswith("unanchored")
        begin(open_store(store), policy()).gate.close()
        level, message = said()
        assert (level, "where the store is" in message) == (Level.WARNING, True)
        begin(open_store(store), policy(witness)).gate.close()
        level, message = said()
        assert (level, "cosigned" in message) == (Level.OK, True)


def test_the_doctor_looks_at_the_counter_together_with_the_store(tmp_path: Path) -> None:
    setup = GateSetup(demo=False, uid=0, store=tmp_path / "robot.db")
    now = Now(scenarios.START_MS, 0)
    assert AdviceCode.COUNTER in {advice.code for advice in checkup(setup, now)}
    without = replace(setup, store=None)
    assert AdviceCode.COUNTER not in {advice.code for advice in checkup(without, now)}


def test_what_comes_first_waits_for_the_clock_and_is_asked_again(tmp_path: Path) -> None:
    sim = simulate(
        scenarios.trust_folder(),
        scenarios.site(),
        scenarios.binding(),
        rid=scenarios.RID,
        start_ms=scenarios.START_MS,
        store=None,
        counter=FileCounter(tmp_path / "counter"),
    )
    asked: list[int] = []

    def first() -> None:
        asked.append(1)
        if len(asked) == 1:
            raise ClockError("behind")

    recovery = Recovery(sim.gate.management, first=first)
    recovery.begin()
    assert not recovery.unclean
    assert recovery.now()
    assert len(asked) == 2


def test_what_comes_first_and_is_refused_lets_no_gate_start() -> None:
    def first() -> None:
        raise RefusedError("older", reason=Reason.SUPERSEDED)

    with pytest.raises(RefusedError):
        Recovery(scenarios.simulation().gate.management, first=first).begin()
