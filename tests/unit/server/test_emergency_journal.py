# SPDX-License-Identifier: Apache-2.0
"""The emergency journal of a whole gate, on a disk that somebody else can write.

Spec page: docs/spec/emergency.md#authentic-entries
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from authguard_r.enforcement.emergency.policy import Caller
from authguard_r.keys.signer import gate_name
from authguard_r.server.emergencies import STRANGE
from authguard_r.server.emergency_wiring import open_journal
from authguard_r.store.memory import MemoryStore
from authguard_r.wire.messages import ClientRole, Kind
from fixtures import emergency_policies, scenarios
from fixtures.emergency_files import forge, record
from unit.server.demo_site import HandClock
from unit.server.test_emergencies import Disk, EmergencyGate, _Kept, planner

OFTEN = {**emergency_policies.GO_SAFE, "per_hour": 60}


def begins(path: Path, **more: Any) -> tuple[list[tuple[str, str]], list[dict[str, Any]]]:
    """Return what the log says of emergencies, and its alerts, after a gate has started."""
    with EmergencyGate(OFTEN, journal=path, **more) as house:
        shown = house.enter(ClientRole.AUDITOR).ask(Kind.STATUS)["alerts"]
        assert [alert for alert in shown if alert["what"] == STRANGE] == house.alerts[-1:]
        assert house.call(planner(house), "go-safe")["execution"]["outcome"] == "succeeded"
        assert house.told[-2:] == [("accept", "go-safe"), ("succeeded", "go-safe")]
        return house.told[:-2], house.alerts


def pending(path: Path, store: Disk, clock: HandClock) -> bytes:
    """Let an emergency go into the journal, kill the gate, and return the file."""
    with EmergencyGate(OFTEN, at="station-103", journal=path, store=store, clock=clock) as house:
        store.dead = True
        assert house.call(planner(house), "go-safe")["execution"]["outcome"] == "succeeded"
        house.crashes = True
    store.dead = False
    return path.read_bytes()


@pytest.fixture
def disk() -> Disk:
    made = Disk()
    made.close = lambda: None  # type: ignore[method-assign] - it outlives its gate
    return made


def test_forged_entries_do_not_enter_the_log_and_people_are_told(tmp_path: Path) -> None:
    path, store, clock = tmp_path / "journal", _Kept(MemoryStore()), HandClock()
    begins(path, store=store, clock=clock)
    four = [record(n, caller="operator", by="u1000.nurse") for n in range(1, 5)]
    forge(path, *four)
    told, alerts = begins(path, store=store, clock=clock)
    assert len(told) == 2  # of the gate before
    assert alerts == [{"what": STRANGE, "entries": 4}]


def test_an_entry_of_another_robot_does_not_keep_the_gate_from_starting(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    begins(path)
    forge(path, record(1, robot=scenarios.OTHER))
    assert begins(path) == ([], [{"what": STRANGE, "entries": 1}])


def test_what_another_store_of_the_same_gate_left_is_not_believed(
    tmp_path: Path, disk: Disk
) -> None:
    path = tmp_path / "journal"
    pending(path, disk, HandClock())
    assert begins(path) == ([], [{"what": STRANGE, "entries": 2}])


def test_what_another_key_of_the_same_robot_left_is_not_believed(tmp_path: Path) -> None:
    with EmergencyGate() as house:
        ledger = house.gate.ledger
        journal = open_journal(tmp_path / "journal", ledger, house.signer("operator-1"))
        journal.append(record(1), heard=0)
        journal.close()
        again = open_journal(tmp_path / "journal", ledger, house.signer(gate_name(scenarios.RID)))
        assert (again.pending(0), again.strange(0)) == ((), 1)
        again.close()


def test_authentic_entries_come_into_the_log_and_nobody_is_told(tmp_path: Path, disk: Disk) -> None:
    path, clock = tmp_path / "journal", HandClock()
    pending(path, disk, clock)
    told, alerts = begins(path, store=disk, clock=clock)
    assert (told, alerts) == ([("accept", "go-safe"), ("succeeded", "go-safe")], [])


def test_a_file_that_is_put_back_brings_nothing_into_the_log_twice(
    tmp_path: Path, disk: Disk
) -> None:
    path, clock = tmp_path / "journal", HandClock()
    old = pending(path, disk, clock)
    told, _ = begins(path, store=disk, clock=clock)
    assert len(told) == 2
    path.write_bytes(old)
    told, alerts = begins(path, store=disk, clock=clock)
    assert (len(told), alerts) == (4, [])  # and what the gate in between did
    path.unlink()
    begins(path, store=disk, clock=clock)
    path.write_bytes(old)
    with EmergencyGate(OFTEN, journal=path, store=disk, clock=clock) as house:
        assert len(house.told) == 8
        assert len(house.road.log.uses(Caller.PLANNER, "go-safe")) == 4


def test_a_longer_file_is_cut_and_people_are_told(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    begins(path)
    with path.open("ab") as file:
        file.write(b"x")
    assert begins(path) == ([], [{"what": STRANGE, "entries": 0, "size": 66 * 4_096 + 1}])
    assert begins(path) == ([], [])


def test_a_replaced_file_blocks_nothing(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    path.write_bytes(b"\xa5" * (66 * 4_096))
    _, (alert,) = begins(path)
    assert alert["entries"] == 64  # one slot of each kind may be torn
