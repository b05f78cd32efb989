# SPDX-License-Identifier: Apache-2.0
"""What each mission wrote is counted once, whatever happens to store, tree and gate."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import pytest

from authguard_r.anchoring import growth
from authguard_r.anchoring.checkpoints import Checkpoints
from authguard_r.anchoring.growth import COUNTED, KIND, Growth, GrowthCount, mission_of
from authguard_r.audit.record import NONE, Entry, append
from authguard_r.core.errors import StoreError
from authguard_r.core.ports import Store, Turn
from authguard_r.core.reasons import Reason
from authguard_r.keys.signer import folder_signer
from authguard_r.operations.simulation import Simulation
from authguard_r.store.memory import MemoryStore
from authguard_r.wire.gate_limits import LIMITS
from fixtures import scenarios


def wrote(store: Store, mid: str, count: int) -> None:
    """Append records of a mission; each spells another mission's name in its open part."""
    opened = {"note": '"link":{"mid":"another"', "mid": "another"}
    entry = Entry(kind="stop", time_ms=1, decision="stop", open=opened, mid=mid)
    store.run(lambda turn: [append(turn, entry, salts=b"") for _ in range(count)] and None)


def read(store: Store) -> dict[str, Growth]:
    """Return what each mission wrote, by reading everything."""
    records, size = defaultdict[str, int](int), defaultdict[str, int](int)
    for _, record, sealed, link in store.read(lambda turn: turn.rows(0, 1 << 30)):
        records[mission_of(record)] += 1
        size[mission_of(record)] += len(record) + len(sealed) + len(link)
    return {mid: Growth(records=records[mid], bytes=size[mid]) for mid in records}


def test_each_record_is_counted_once_and_for_its_own_mission() -> None:
    store = MemoryStore()
    for mid, count in (("a", 3), ("b", 5), (NONE, 2), ("a", LIMITS.growth_page)):
        wrote(store, mid, count)
        store.run(growth.count)
    for _ in range(3):
        store.run(growth.count)
    every = read(store)
    assert every.keys() == {"a", "b", NONE}
    assert every["a"].records == LIMITS.growth_page + 3
    for mid, found in every.items():
        told = store.read(lambda turn, of=mid: growth.counted(turn, of))
        assert told == GrowthCount(growth=found, upto=LIMITS.growth_page + 10)


def test_what_came_since_is_counted_by_whoever_asks_a_page_at_most() -> None:
    store = MemoryStore()
    wrote(store, "a", 4)
    store.run(growth.count)
    wrote(store, "a", LIMITS.growth_page + 1)
    told = store.read(lambda turn: growth.counted(turn, "a"))
    assert (told.growth.records, told.upto) == (
        LIMITS.growth_page + 4,
        LIMITS.growth_page + 4,
    )
    assert store.read(lambda turn: growth.counted(turn, "b")).growth == Growth()


def test_a_mission_counts_on_after_a_restart_and_after_a_tree_begins_anew(tmp_path: Path) -> None:
    for _ in range(2):
        sim: Simulation = scenarios.simulation(store=tmp_path / "robot.db")
        ledger = sim.gate.ledger
        signer = folder_signer(scenarios.trust_folder(), f"gate-{scenarios.RID}")
        checkpoints = Checkpoints(ledger, robot=scenarios.RID, signer=signer)
        wrote(ledger.store, "a", 300)
        checkpoints.make()
        checkpoints.restart()
        checkpoints.make()
        expected = read(ledger.store)["a"]
        assert ledger.peek(lambda turn: growth.counted(turn, "a")).growth == expected
        sim.gate.close()


@pytest.mark.parametrize("data", [b"", b"no record", b'"link":{', b'"link":{"mid":"a'])
def test_bytes_that_are_no_record_are_of_no_mission(data: bytes) -> None:
    assert mission_of(data) == NONE


@pytest.mark.parametrize(("key", "value"), [(COUNTED, b"many"), ("a", b'{"records":"many"}')])
def test_a_count_that_is_none_is_a_damaged_store(key: str, value: bytes) -> None:
    store = MemoryStore()
    wrote(store, "a", 1)

    def damage(turn: Turn) -> None:
        turn.put(KIND, key, value)

    store.run(damage)
    with pytest.raises(StoreError) as told:
        store.run(growth.count)
    assert told.value.reason is Reason.STORE_CORRUPT
