# SPDX-License-Identifier: Apache-2.0
"""A bounded file that a torn write, a full disk and a kill take nothing from that was answered."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.errors import EnvironmentFault
from authguard_r.emergency import journal as module
from authguard_r.emergency.journal import COUNTERS, SLOT, SLOTS, EmergencyJournal, Journaled
from fixtures import scenarios


def record(n: int, **changes: Any) -> Journaled:
    plain = {
        "n": n,
        "robot": scenarios.RID,
        "decision": "accept",
        "at_ms": 1,
        "mono_ms": n,
        "policy": digest_of(Tag.EMERGENCY_POLICY, "policy"),
        "capability": "go-safe",
        "caller": "planner",
        "by": "u1000.planner",
        "ticket": digest_of(Tag.ACTION, n),
        "state": "-",
        "reasons": (),
        "lacked": ("mission",),
    }
    return msgspec.convert({**plain, **changes}, Journaled)


def opened(path: Path) -> EmergencyJournal:
    return EmergencyJournal(path, robot=scenarios.RID)


def test_what_was_answered_is_there_after_a_restart(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    journal = opened(path)
    assert (journal.append(record(1), heard=0), journal.append(record(2), heard=0)) == (True, True)
    journal.close()
    journal.close()
    again = opened(path)
    assert again.pending(0) == (record(1), record(2))
    assert again.pending(1) == (record(2),)
    assert again.next_n == 3
    assert path.stat().st_mode & 0o777 == 0o600
    again.close()


def test_the_file_has_its_whole_size_from_its_first_day(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    journal = opened(path)
    size = (COUNTERS + SLOTS) * SLOT
    assert path.stat().st_size == size
    assert path.stat().st_blocks * 512 >= size  # no hole: a full disk does not matter
    for n in range(1, SLOTS + 10):
        journal.append(record(n), heard=n - 1)
    assert path.stat().st_size == size
    journal.close()


def test_what_does_not_fit_is_counted(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    journal = opened(path)
    for n in range(1, SLOTS + 1):
        assert journal.append(record(n), heard=0)
    for _ in range(3):
        assert not journal.append(record(SLOTS + 1), heard=0)
    journal.close()
    again = opened(path)
    assert (again.lost, len(again.pending(0))) == (3, SLOTS)
    assert again.append(record(SLOTS + 1), heard=1)  # the first made room
    assert [r.n for r in again.pending(1)] == list(range(2, SLOTS + 2))
    again.close()


def test_a_write_that_is_torn_at_any_byte_loses_that_record_alone(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    journal = opened(path)
    journal.append(record(1), heard=0)
    journal.append(record(2), heard=0)
    before = path.read_bytes()
    journal.append(record(3), heard=0)
    after = path.read_bytes()
    journal.close()
    slot = (COUNTERS + 3) * SLOT
    assert before[:slot] == after[:slot]
    written = len(after[slot : slot + SLOT].rstrip(b"\0"))
    for cut in range(written + 1):
        path.write_bytes(before[:slot] + after[slot : slot + cut] + before[slot + cut :])
        again = opened(path)
        whole = cut >= written
        assert [r.n for r in again.pending(0)] == [1, 2, *([3] if whole else [])]
        assert again.next_n == (4 if whole else 3)
        again.close()


def test_a_slot_that_was_used_again_and_torn_loses_nothing_that_waits(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    journal = opened(path)
    for n in range(1, SLOTS + 1):
        journal.append(record(n), heard=0)
    before = path.read_bytes()
    journal.append(record(SLOTS + 1), heard=5)
    after = path.read_bytes()
    journal.close()
    at = (COUNTERS + (SLOTS + 1) % SLOTS) * SLOT
    path.write_bytes(before[:at] + after[at : at + 40] + before[at + 40 :])
    again = opened(path)
    assert [r.n for r in again.pending(5)] == list(range(6, SLOTS + 1))
    again.close()


def test_a_torn_count_leaves_the_one_before(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    journal = opened(path)
    for n in range(1, SLOTS + 1):
        journal.append(record(n), heard=0)
    journal.append(record(SLOTS + 1), heard=0)
    journal.append(record(SLOTS + 1), heard=0)
    journal.close()
    data = bytearray(path.read_bytes())
    data[0] ^= 1  # the second count lies in the first slot
    path.write_bytes(bytes(data))
    again = opened(path)
    assert again.lost == 1
    again.close()


def test_numbers_go_on_after_what_the_log_has(tmp_path: Path) -> None:
    journal = opened(tmp_path / "journal")
    journal.after(7)
    assert journal.next_n == 8
    with pytest.raises(RuntimeError, match="expected record 8"):
        journal.append(record(1), heard=7)
    journal.close()


def test_another_robots_journal_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    journal = opened(path)
    journal.append(record(1), heard=0)
    journal.close()
    with pytest.raises(EnvironmentFault, match="expected the journal of"):
        EmergencyJournal(path, robot=scenarios.OTHER)


def test_a_file_that_is_none_is_refused(tmp_path: Path) -> None:
    (tmp_path / "large").write_bytes(bytes((COUNTERS + SLOTS) * SLOT + 1))
    with pytest.raises(EnvironmentFault, match="at most"):
        opened(tmp_path / "large")
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(EnvironmentFault):
        opened(tmp_path / "link")
    with pytest.raises(EnvironmentFault):
        opened(tmp_path / "no" / "folder")
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(EnvironmentFault, match="own user"):
        opened(tmp_path / "fifo")


def test_a_slot_that_holds_something_else_is_no_record(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    journal = opened(path)
    journal.close()
    data = bytearray(path.read_bytes())
    at = COUNTERS * SLOT
    data[at : at + SLOT] = module._sealed(msgspec.convert({"lost": 3}, module._Lost), COUNTERS)
    path.write_bytes(bytes(data))
    again = opened(path)
    assert again.pending(0) == ()
    again.close()


def test_a_disk_that_takes_nothing_is_said(tmp_path: Path) -> None:
    journal = opened(tmp_path / "journal")
    os.close(journal._file)
    with pytest.raises(EnvironmentFault):
        journal.append(record(1), heard=0)
    journal._file = -1
    assert journal.pending(0) == ()


def test_a_record_that_is_too_long_is_a_fault_of_ours() -> None:
    with pytest.raises(RuntimeError, match="does not fit"):
        module._sealed(record(1, by="u" * SLOT), COUNTERS)
