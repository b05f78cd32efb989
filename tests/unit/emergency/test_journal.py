# SPDX-License-Identifier: Apache-2.0
"""A bounded file that a torn write, a full disk and a kill take nothing from that was answered.

It may lie where others can write: what they write there is counted and never believed.
"""

from __future__ import annotations

import os
from hashlib import sha256
from pathlib import Path

import msgspec
import pytest

from authguard_r.core.errors import EnvironmentFault
from authguard_r.enforcement.emergency.journal import (
    COUNTERS,
    SLOT,
    SLOTS,
    EmergencyJournal,
    Journaled,
    _Lost,
)
from fixtures import emergency_files
from fixtures.emergency_files import record

KEY, OTHER = b"k" * 32, b"o" * 32


def opened(path: Path) -> EmergencyJournal:
    return EmergencyJournal(path, key=KEY)


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
    journal.after(7, 3)
    assert journal.lost == 3
    assert journal.next_n == 8
    with pytest.raises(RuntimeError, match="expected record 8"):
        journal.append(record(1), heard=7)
    journal.close()


def test_a_file_that_is_none_is_refused_and_the_fault_says_what_to_do(tmp_path: Path) -> None:
    advice = "move it away, or name another file with --emergency-journal"
    (tmp_path / "link").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(EnvironmentFault, match=advice):
        opened(tmp_path / "link")
    with pytest.raises(EnvironmentFault, match=advice):
        opened(tmp_path / "no" / "folder")
    os.mkfifo(tmp_path / "fifo")
    with pytest.raises(EnvironmentFault, match=f"own user; {advice}"):
        opened(tmp_path / "fifo")


# what others wrote


def strange(path: Path, heard: int = 0, lost: int = 0) -> int:
    """Return how many slots a gate that starts finds not authentic; none of them is a record."""
    again = opened(path)
    again.after(heard, lost)
    assert (again.pending(0), again.lost) == ((), lost)
    count = again.strange(heard)
    again.close()
    return count


def written(path: Path, *records: Journaled, key: bytes = KEY) -> bytes:
    """Return the file that a gate with a key left behind."""
    journal = EmergencyJournal(path, key=key)
    for one in records:
        journal.append(one, heard=0)
    journal.close()
    return path.read_bytes()


def test_what_another_key_wrote_is_counted_and_never_believed(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    written(path, record(1), record(2), key=OTHER)
    assert strange(path) == 2
    assert strange(path, heard=1) == 1
    assert strange(path, heard=2) == 0  # the key was renewed, and the log had all of it


def test_entries_with_a_digest_that_anybody_can_make_are_counted_and_never_believed(
    tmp_path: Path,
) -> None:
    """So the format before this one wrote them; four of them entered a log once."""
    path = tmp_path / "journal"
    written(path)
    emergency_files.forge(path, *(record(n) for n in range(1, 5)))
    assert strange(path) == 4
    assert strange(path, heard=3) == 1


def test_a_slot_is_worth_nothing_in_another_place(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    data = written(path, record(1))
    first = data[(COUNTERS + 1) * SLOT :][:SLOT]
    path.write_bytes(bytes(len(data)))
    emergency_files.put(path, COUNTERS + 9, first)
    assert strange(path) == 1


def test_a_count_that_is_not_authentic_is_none(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    written(path)
    body = msgspec.json.encode({"lost": 1_000})
    for place in range(COUNTERS):
        emergency_files.put(path, place, emergency_files.slot_of(body, place))
    assert strange(path) == COUNTERS
    assert strange(path, lost=1_000) == 0  # as the format before this one left it


def test_a_record_in_the_place_of_a_count_is_none(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    journal = opened(path)
    emergency_files.put(path, COUNTERS, journal._sealed(_Lost(lost=3), COUNTERS))
    emergency_files.put(path, 0, journal._sealed(record(64), 0))
    journal.close()
    assert strange(path) == 2


@pytest.mark.parametrize(
    "body", [b"", b"[" * 4_000, b'{"n":' + b"9" * 4_000 + b"}", b'{"n":"', b"\xff", b'{"x":1}']
)
def test_whatever_lies_in_a_slot_blocks_nothing(tmp_path: Path, body: bytes) -> None:
    path = tmp_path / "journal"
    written(path)
    emergency_files.put(path, COUNTERS + 9, emergency_files.slot_of(body, COUNTERS + 9))
    nested = b'{"x":' + b"[" * 4_000
    emergency_files.put(path, COUNTERS + 8, emergency_files.slot_of(nested, COUNTERS + 8))
    assert strange(path) == 2


def test_half_a_slot_in_the_place_that_is_written_next_is_a_power_cuts(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    written(path)
    emergency_files.put(path, COUNTERS + 6, bytes(range(1, 41)))
    emergency_files.put(path, 1, bytes(range(1, 41)))
    assert strange(path, heard=5) == 0
    assert strange(path, heard=6) == 1
    assert strange(path, heard=5, lost=1) == 1


def test_an_older_copy_of_a_slot_has_a_number_that_the_log_has(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    before = written(path, record(1), record(2))
    path.unlink()
    written(path)
    path.write_bytes(before)
    again = opened(path)
    again.after(2, 0)
    assert (again.pending(2), again.next_n, again.strange(2)) == ((), 3, 0)
    again.close()


def test_an_older_copy_of_a_count_counts_nothing_twice(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    journal = opened(path)
    for n in range(1, SLOTS + 1):
        journal.append(record(n), heard=0)
    journal.append(record(SLOTS + 1), heard=0)
    journal.close()
    counted = path.read_bytes()
    path.unlink()
    fresh = opened(path)
    fresh.after(SLOTS, 1)  # what the log has
    assert fresh.lost == 1
    fresh.close()
    path.write_bytes(counted)
    again = opened(path)
    again.after(SLOTS, 1)
    assert again.lost == 1
    again.close()


@pytest.mark.parametrize("more", [1, -1, SLOT - 1, 10 * SLOT])
def test_a_file_that_was_cut_or_made_longer_is_used_and_said(tmp_path: Path, more: int) -> None:
    path = tmp_path / "journal"
    data = written(path, record(1))
    size = len(data) + more
    path.write_bytes((data + bytes(max(more, 0)))[:size])
    again = opened(path)
    assert again.odd_size == size
    assert [r.n for r in again.pending(0)] == [1]
    assert again.append(record(2), heard=0)
    again.close()
    assert path.stat().st_size == len(data)
    again = opened(path)
    assert (again.odd_size, len(again.pending(0))) == (None, 2)
    again.close()


def test_slots_look_as_the_specification_says(tmp_path: Path) -> None:
    path = tmp_path / "journal"
    data = written(path, record(1))
    slot = data[(COUNTERS + 1) * SLOT :][:SLOT]
    body = msgspec.json.encode(record(1))
    assert slot[32:] == (len(body).to_bytes(4) + body).ljust(SLOT - 32, b"\0")
    place = (COUNTERS + 1).to_bytes(4)
    message = b"authguard-r/emergency-journal/2\0" + place + slot[32:]
    inner = sha256(bytes(b ^ 0x36 for b in KEY.ljust(64, b"\0")) + message).digest()
    assert slot[:32] == sha256(bytes(b ^ 0x5C for b in KEY.ljust(64, b"\0")) + inner).digest()


def test_a_disk_that_takes_nothing_is_said(tmp_path: Path) -> None:
    journal = opened(tmp_path / "journal")
    os.close(journal._file)
    with pytest.raises(EnvironmentFault):
        journal.append(record(1), heard=0)
    journal._file = -1
    assert journal.pending(0) == ()


def test_a_record_that_is_too_long_is_a_fault_of_ours(tmp_path: Path) -> None:
    journal = opened(tmp_path / "journal")
    with pytest.raises(RuntimeError, match="does not fit"):
        journal.append(record(1, by="u" * SLOT), heard=0)
    journal.close()
