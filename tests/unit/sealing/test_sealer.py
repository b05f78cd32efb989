# SPDX-License-Identifier: Apache-2.0
"""Keys of each mission and start, told in the log to readers alone, and never used uncommitted.

Source: docs/spec/sealed-fields.md#keys
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from authguard_r.anchoring.sealing import sealer as sealing
from authguard_r.anchoring.sealing.key_ring import KeyRing
from authguard_r.anchoring.sealing.policy import SealingPolicy
from authguard_r.anchoring.sealing.sealer import Sealer
from authguard_r.anchoring.sealing.stored_policy import HELD, hold_policy, newest_keys, policy_of
from authguard_r.audit.record import BOX, WRAP, Entry, LogRow, Sealed, append, read_sealed
from authguard_r.audit.sealed_envelopes import SEALING
from authguard_r.audit.verify import verify_rows
from authguard_r.core.encoding import encode_fast
from authguard_r.core.errors import AuthenticityError, MalformedError, StoreError
from authguard_r.core.mission import DataClass
from authguard_r.core.ports import Turn
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.store.memory import MemoryStore
from authguard_r.store.sqlite import open_store
from authguard_r.store.transactions import Transaction
from fixtures import scenarios, sealed_logs
from fixtures.limits import bounded

SCAN = scenarios.navigate("dock", "pharmacy")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "robot.db"


def tellings(rows: list[LogRow]) -> list[LogRow]:
    return [row for row in rows if sealed_logs.told(row).kind == SEALING]


def here(turn: Turn, *mids: str) -> None:
    """Let missions be known: only these have keys of their own."""
    for mid in mids:
        turn.put("standing", mid, b"{}")


def note(mid: str = "m-1", **more: Any) -> Entry:
    return Entry(
        kind="stop", time_ms=1, decision="stop", open={}, mid=mid, sealed={"why": mid}, **more
    )


def test_a_reader_of_everything_reads_the_log_as_it_happened(path: Path) -> None:
    with sealed_logs.sealing(path, sealed_logs.policy()) as sim:
        mission = sealed_logs.active(sim)
        report = scenarios.propose(sim, SCAN)
    rows = sealed_logs.rows_of(path)
    found = sealed_logs.opened(rows)
    decision = next(row for row in found if sealed_logs.told(row).kind == "decision")
    assert sealed_logs.values(decision)["action"]["destination"] == "pharmacy"
    assert sealed_logs.told(decision).link.action == report.judged.action_digest
    activation = next(row for row in found if sealed_logs.told(row).link.decision == "activate")
    assert sealed_logs.told(activation).open["by"] == "operator-1"
    said = b"".join(row.record + row.sealed for row in rows[1:])
    for word in (b"pharmacy", b"operator-1", mission.issuer.encode(), b"speed_mm_s"):
        assert word not in said


@pytest.mark.parametrize("role", ["auditor", "pq-auditor"])
def test_both_kinds_of_key_read(path: Path, role: str) -> None:
    with sealed_logs.sealing(path, sealed_logs.policy(sealed_logs.reader(role))) as sim:
        sealed_logs.active(sim)
    assert b"operator-1" in b"".join(
        r.record for r in sealed_logs.opened(sealed_logs.rows_of(path), role)
    )


def test_each_mission_and_each_start_has_keys_of_its_own(path: Path) -> None:
    with sealed_logs.sealing(path, sealed_logs.policy()) as sim:
        first = sealed_logs.active(sim)
        sim.gate.management.command(sealed_logs.command(sim, Verb.REVOKE, first))
        sealed_logs.active(sim, mission="second")
    with sealed_logs.sealing(path) as sim:  # the store knows what the last gate sealed
        scenarios.propose(sim, SCAN)
    rows = sealed_logs.rows_of(path)
    told = [
        (sealed_logs.told(row).link.mid, sealed_logs.told(row).open["before"])
        for row in tellings(rows)
    ]
    assert [mid for mid, _ in told].count("second") == 2
    assert next(before for mid, before in told if mid == "second") == -1
    numbers = {row.seq for row in tellings(rows)}
    assert all(before == -1 or before in numbers for _, before in told)
    assert b"pharmacy" in b"".join(row.sealed for row in sealed_logs.opened(rows))


def test_a_gate_opens_what_it_sealed_since_its_start_and_nothing_before(path: Path) -> None:
    with sealed_logs.sealing(path, sealed_logs.policy()) as sim:
        sealed_logs.active(sim)
        scenarios.propose(sim, SCAN)
        last = sim.gate.ledger.peek(lambda turn: turn.rows(turn.head()[0] - 1, 1))[0]
        assert BOX.encode() not in sim.gate.ledger.opened(last).sealed
    with sealed_logs.sealing(path) as sim:
        assert BOX.encode() in sim.gate.ledger.opened(last).sealed


def test_what_was_not_committed_was_told_to_nobody_and_seals_nothing(path: Path) -> None:
    store = open_store(path)
    sealer = Sealer(scenarios.RID, sealed_logs.policy())

    def fails(turn: Turn) -> None:
        sealer.append(turn, note(), salts=scenarios.random_bytes)
        raise ZeroDivisionError

    genesis = Entry(kind="genesis", time_ms=1, decision="genesis", open={"robot": scenarios.RID})
    store.run(lambda turn: append(turn, genesis, salts=b""))
    store.run(lambda turn: here(turn, "m-1"))
    with pytest.raises(ZeroDivisionError):
        store.run(fails)
    store.run(lambda turn: sealer.append(turn, note(), salts=scenarios.random_bytes))
    store.close()
    rows = sealed_logs.rows_of(path)
    assert [sealed_logs.told(row).kind for row in rows] == ["genesis", SEALING, "stop"]
    assert sealed_logs.values(sealed_logs.opened(rows)[2]) == {"why": "m-1"}


def test_few_keys_are_in_memory_and_a_mission_that_comes_back_has_new_ones(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bounded(monkeypatch, sealing, covers=4)
    store, sealer = MemoryStore(), Sealer(scenarios.RID, sealed_logs.policy())
    store.run(lambda turn: here(turn, *"abcdef"))
    for mid in ("a", "b", "c", "d", "a", "e", "f", "b"):
        store.run(lambda turn, m=mid: sealer.append(turn, note(m), salts=scenarios.random_bytes))
    rows = store.rows()
    assert verify_rows(rows).whole
    told = [sealed_logs.told(row) for row in rows if sealed_logs.told(row).kind == SEALING]
    assert [record.link.mid for record in told] == ["a", "b", "c", "d", "e", "f", "b"]
    assert told[-1].open["before"] == 2
    assert store.read(lambda turn: newest_keys(turn, "b")) == len(rows) - 2
    assert store.read(lambda turn: newest_keys(turn, "never")) is None


def test_what_is_of_no_mission_that_was_ever_here_is_sealed_under_the_keys_of_none() -> None:
    """A template's record, an answer to a mission that nobody knows: no missions' names."""
    store, sealer = MemoryStore(), Sealer(scenarios.RID, sealed_logs.policy())
    for mid in ("template-1", "-", "no-mission"):
        store.run(lambda turn, m=mid: sealer.append(turn, note(m), salts=scenarios.random_bytes))
    told = [sealed_logs.told(row) for row in store.rows() if sealed_logs.told(row).kind == SEALING]
    assert [record.link.mid for record in told] == ["-"]
    assert sealed_logs.values(sealer.opened(store.rows()[-1])) == {"why": "no-mission"}


def test_keys_of_a_turn_that_was_dropped_are_nobody_elses() -> None:
    """Another mission's keys were told under the number that the first one's would have had."""
    store, sealer = MemoryStore(), Sealer(scenarios.RID, sealed_logs.policy())
    store.run(lambda turn: here(turn, "a", "b"))

    def fails(turn: Turn) -> None:
        sealer.append(turn, note("a"), salts=scenarios.random_bytes)
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        store.run(fails)
    store.run(lambda turn: sealer.append(turn, note("b"), salts=scenarios.random_bytes))
    sealer.forget("b")
    row = store.rows()[-1]
    assert sealer.opened(row) == row  # closed, and nothing is wrong with it


def test_a_store_that_holds_nonsense_of_keys_is_corrupt() -> None:
    store, sealer = MemoryStore(), Sealer(scenarios.RID, sealed_logs.policy())
    store.run(lambda turn: here(turn, "m-1"))
    store.run(lambda turn: turn.put(HELD, "m-1", b"[]"))
    with pytest.raises(StoreError) as refused:
        store.run(lambda turn: sealer.append(turn, note(), salts=scenarios.random_bytes))
    assert refused.value.where == "store.sealing"


def test_a_box_of_this_start_that_was_changed_is_the_stores_fault(path: Path) -> None:
    with sealed_logs.sealing(path, sealed_logs.policy()) as sim:
        sealed_logs.active(sim)
        seq, record, beside, link = sim.gate.ledger.peek(lambda turn: turn.rows(2, 1))[0]
        with pytest.raises(StoreError) as refused:
            sim.gate.ledger.opened((seq, record, beside.replace(b'"text":"', b'"text":"A'), link))
        assert refused.value.reason == "STORE_CORRUPT"


# what is sealed


def test_without_readers_nothing_is_sealed_and_a_store_is_as_ever(path: Path) -> None:
    with sealed_logs.sealing(path) as sim:
        sealed_logs.active(sim)
    assert BOX.encode() not in b"".join(row.sealed for row in sealed_logs.rows_of(path))


def test_only_classes_that_somebody_may_read_are_sealed(path: Path) -> None:
    only = sealed_logs.policy(sealed_logs.reader("porter", DataClass.REGION))
    with sealed_logs.sealing(path, only) as sim:
        sealed_logs.active(sim)
        scenarios.propose(sim, SCAN)
    rows = sealed_logs.rows_of(path)
    said = b"".join(row.record + row.sealed for row in rows[1:])
    assert (b"pharmacy" in said, b"operator-1" in said, b"speed_mm_s" in said) == (
        False,
        True,
        True,
    )
    assert {sealed_logs.told(row).open["classes"][0] for row in tellings(rows)} == {"region"}


def test_a_gate_whose_configuration_says_so_seals_no_more(path: Path) -> None:
    with sealed_logs.sealing(path, sealed_logs.policy()):
        pass
    with sealed_logs.sealing(path, SealingPolicy()) as sim:
        sealed_logs.active(sim)
    assert b"operator-1" in b"".join(row.record for row in sealed_logs.rows_of(path))


def test_a_new_store_without_a_policy_holds_none() -> None:
    store = MemoryStore()
    for given in (None, SealingPolicy()):
        hold_policy(store, given)
        assert policy_of(store, given) == SealingPolicy()
    assert store.read(lambda turn: turn.get("sealing-policy", "newest")) is None
    hold_policy(store, sealed_logs.policy())
    hold_policy(store, None)
    assert policy_of(store, None) == sealed_logs.policy()
    assert policy_of(store, SealingPolicy()) == SealingPolicy()
    store.run(lambda turn: turn.put("sealing-policy", "newest", b"?"))
    with pytest.raises(StoreError):
        policy_of(store, None)


def test_offline_acts_on_a_store_are_sealed_as_its_gate_did(path: Path) -> None:
    with sealed_logs.sealing(path, sealed_logs.policy()):
        pass
    with sealed_logs.sealing(path) as sim:  # as `mission activate --store` does
        mission = sealed_logs.active(sim)
        sim.gate.ledger.run(lambda act: _recorded(act, mission.mid))
    assert b"a word" not in b"".join(row.record + row.sealed for row in sealed_logs.rows_of(path))


def _recorded(act: Transaction, mid: str) -> int:
    return act.record(note(mid, state="a word"))


# somebody else's log


@pytest.fixture
def rows(path: Path) -> list[LogRow]:
    with sealed_logs.sealing(
        path, sealed_logs.policy(sealed_logs.reader("auditor"), sealed_logs.reader("other"))
    ) as sim:
        sealed_logs.active(sim)
        scenarios.propose(sim, SCAN)
    return sealed_logs.rows_of(path)


def changed(rows: list[LogRow], value: Any, name: str = "wrap.region") -> list[LogRow]:
    """Return the log with something else in the place of the wrapped keys of a class."""
    found = tellings(rows)[0]
    items = read_sealed(found.sealed, where="")
    items[name] = Sealed(salt=items["wrap.region"].salt, value=value)
    row = replace(found, sealed=encode_fast(items))
    return [row if one is found else one for one in rows]


def test_a_key_for_which_nothing_was_wrapped_opens_nothing(rows: list[LogRow]) -> None:
    ring = KeyRing(sealed_logs.key_of("stranger"))
    assert [ring.opened(row) for row in rows] == rows
    assert ring.records == 0


def test_wrapped_keys_of_one_reader_open_for_no_other(rows: list[LogRow]) -> None:
    wraps = sealed_logs.values(tellings(rows)[0])[WRAP + "region"]
    mine, other = sealed_logs.key_of("auditor").public.name, sealed_logs.key_of("other").public.name
    by = {wrap["reader"]: wrap for wrap in wraps}
    swapped = [{**by[other], "reader": mine}]
    with pytest.raises(AuthenticityError) as refused:
        sealed_logs.opened(changed(rows, swapped))
    assert refused.value.where.endswith("wrap.region")
    # nor those of another class
    wraps = sealed_logs.values(tellings(rows)[0])[WRAP + "object"]
    with pytest.raises(AuthenticityError):
        sealed_logs.opened(changed(rows, wraps))


@pytest.mark.parametrize(
    ("value", "name"),
    [("text", "wrap.region"), ([{"reader": "x"}], "wrap.region"), ([], "wrap.nonsense")],
)
def test_what_are_no_wrapped_keys_is_refused(rows: list[LogRow], value: Any, name: str) -> None:
    with pytest.raises(MalformedError) as refused:
        sealed_logs.opened(changed(rows, value, name))
    assert "expected wrapped keys" in refused.value.message
