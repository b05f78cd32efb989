# SPDX-License-Identifier: Apache-2.0
"""A store whose oldest records lie in segments is one log, and loses nothing on the way there."""

from __future__ import annotations

import errno
import itertools
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import apsw
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from authguard_r.audit.record import LogRow, read_sealed
from authguard_r.audit.verify import verify_rows
from authguard_r.core.errors import StoreError
from authguard_r.core.identifiers import RobotId
from authguard_r.core.ports import Turn
from authguard_r.core.reasons import Reason
from authguard_r.store.memory import MemoryStore
from authguard_r.store.segment_mover import Mover
from authguard_r.store.segments import name_of
from authguard_r.store.sqlite import SqliteStore, open_store, read_held, read_rows
from fixtures.segmented_stores import SECRET, copying, fill, note, rotate


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "store.db"


@pytest.fixture
def store(path: Path) -> Iterator[SqliteStore]:
    made = open_store(path)
    fill(made, 40)
    yield made
    made.close()


def segment(path: Path, first: int) -> Path:
    return path.with_name(f"{path.name}.segments") / name_of(first)


def every(store: SqliteStore) -> tuple[Any, ...]:
    return store.read(lambda turn: turn.rows(0, 1_000))


def in_store(store: SqliteStore) -> list[int]:
    return [seq for (seq,) in store._connection.execute("SELECT seq FROM audit ORDER BY seq")]


def forget(store: SqliteStore, *numbers: int) -> None:
    store.run(lambda turn: [turn.forget(number, {"here"}) for number in numbers])


def told(path: Path) -> list[int]:
    """Return whose secrets are anywhere in the files of a store."""
    files = [file.read_bytes() for file in path.parent.rglob("*") if file.is_file()]
    data = b"".join(files)
    return [seq for seq in range(200) if f'"{SECRET}{seq}"'.encode() in data]


# one log


def test_a_log_over_segments_and_store_is_the_log_that_it_was(
    store: SqliteStore, path: Path
) -> None:
    before = every(store)
    head = store.read(lambda turn: turn.head())
    rotate(store, 16)
    rotate(store, 30)
    assert in_store(store) == list(range(30, 40))
    assert every(store) == before
    assert store.read(lambda turn: turn.head()) == head
    for first, count in itertools.product((0, 15, 16, 29, 30, 39, 40), (0, 1, 2, 20, 2**80)):
        expected = before[first : first + count]
        assert store.read(lambda turn, at=(first, count): turn.rows(*at)) == expected
    store.close()
    assert tuple(read_rows(path)) == tuple(LogRow(*row) for row in before)
    assert verify_rows(read_rows(path)).whole


def test_a_rotated_store_goes_on_and_is_opened_again(store: SqliteStore, path: Path) -> None:
    rotate(store, 30)
    fill(store, 5)
    before = every(store)
    store.close()
    again = open_store(path)
    assert again.read(lambda turn: turn.head())[0] == 45
    fill(again, 1)
    assert every(again)[:-1] == before
    rotate(again, 41)
    assert every(again)[:-1] == before
    again.close()
    assert verify_rows(read_rows(path)).size == 46


def test_segments_and_their_folder_are_their_owners_alone(store: SqliteStore, path: Path) -> None:
    rotate(store, 30)
    folder = segment(path, 0).parent
    assert oct(folder.stat().st_mode & 0o777) == "0o700"
    assert [oct(file.stat().st_mode & 0o777) for file in folder.iterdir()] == ["0o600"]


def test_more_segments_than_are_kept_open_are_all_read(store: SqliteStore) -> None:
    before = every(store)
    for end in range(4, 40, 4):
        rotate(store, end)
    for _ in range(2):
        assert every(store) == before
    assert store.read(lambda turn: [turn.rows(seq, 1)[0] for seq in range(40)]) == list(before)


def test_a_program_of_before_refuses_a_store_with_segments(store: SqliteStore, path: Path) -> None:
    assert store._connection.execute("PRAGMA user_version").get == 1
    rotate(store, 30)
    assert store._connection.execute("PRAGMA user_version").get == 2


def test_the_freed_pages_are_used_again(store: SqliteStore) -> None:
    def pages() -> int:
        return int(store._connection.execute("PRAGMA page_count").get)

    fill(store, 1_000)
    rotate(store, 1_000)
    most = pages()
    for number in range(1, 4):
        fill(store, 1_000)
        rotate(store, 1_000 * (number + 1))
        assert pages() < most * 1.2


@pytest.mark.parametrize(
    "statement",
    [
        "DELETE FROM audit WHERE seq = 16",
        "DELETE FROM audit",
        "UPDATE audit SET record = x'00' WHERE seq = 3",
        "INSERT OR REPLACE INTO audit VALUES (3, x'00', x'00', x'00')",
    ],
)
def test_only_rows_that_a_segment_has_are_deleted(
    store: SqliteStore, path: Path, statement: str
) -> None:
    rotate(store, 16, clear=False)
    before = every(store)
    store.close()
    connection = apsw.Connection(str(path))
    with pytest.raises(apsw.ConstraintError, match="append-only"):
        connection.execute(statement)
    connection.execute("DELETE FROM audit WHERE seq = 3")
    connection.close()
    assert tuple(read_rows(path)) == tuple(LogRow(*row) for row in before)


@pytest.mark.parametrize(
    "statement",
    [
        "DELETE FROM audit WHERE seq = 1",
        "UPDATE audit SET link = x'00' WHERE seq = 1",
        "UPDATE audit SET sealed = CAST('{\"new\":{}}' AS BLOB) WHERE seq = 1",
        "INSERT INTO audit VALUES (16, x'00', x'00', x'00')",
    ],
)
def test_a_segment_stays_as_it_is(store: SqliteStore, path: Path, statement: str) -> None:
    rotate(store, 16)
    connection = apsw.Connection(str(segment(path, 0)))
    with pytest.raises(apsw.ConstraintError, match=r"append-only|is sealed"):
        connection.execute(statement)
    connection.close()


# a segment that is not what it was


def refused(path: Path, words: str, *, first: int, last: int) -> None:
    """Reading the log and opening the store both name the file and its records."""
    for use in (lambda: open_store(path), lambda: list(read_rows(path))):
        with pytest.raises(StoreError, match=words) as told:
            use()
        assert told.value.reason is Reason.STORE_CORRUPT
        assert told.value.where == str(segment(path, first))
        assert f"with records {first} to {last}" in told.value.message


@pytest.fixture
def rotated(store: SqliteStore, path: Path) -> Path:
    """A store with the segments 0 to 15 and 16 to 29."""
    rotate(store, 16)
    rotate(store, 30)
    store.close()
    return path


def test_a_missing_segment_is_named_with_its_records(rotated: Path) -> None:
    segment(rotated, 16).unlink()
    refused(rotated, "is missing", first=16, last=29)


def test_a_link_to_a_segment_is_none(rotated: Path, tmp_path: Path) -> None:
    segment(rotated, 0).rename(tmp_path / "elsewhere.db")
    segment(rotated, 0).symlink_to(tmp_path / "elsewhere.db")
    refused(rotated, "is missing", first=0, last=15)


def test_a_segment_of_another_log_is_named(rotated: Path, tmp_path: Path) -> None:
    other = open_store(tmp_path / "other.db")
    fill(other, 40, secret="another")
    rotate(other, 16)
    other.close()
    shutil.copy(segment(tmp_path / "other.db", 0), segment(rotated, 0))
    refused(rotated, "is not the one", first=0, last=15)


def test_a_segment_in_the_place_of_another_is_named(rotated: Path) -> None:
    shutil.copy(segment(rotated, 0), segment(rotated, 16))
    refused(rotated, "named after", first=16, last=29)


@pytest.mark.parametrize("data", [b"", b"no database at all, and longer than a header " * 99])
def test_a_file_that_is_no_segment_is_named(rotated: Path, data: bytes) -> None:
    segment(rotated, 16).write_bytes(data)
    refused(rotated, "is damaged", first=16, last=29)


def changed(path: Path, statement: str) -> None:
    connection = apsw.Connection(str(path))
    for name in ("audit_no_delete", "audit_only_forgets"):
        connection.execute(f"DROP TRIGGER {name}")
    connection.execute(statement)
    connection.close()


@pytest.mark.parametrize(
    "statement",
    [
        "DELETE FROM audit WHERE seq = 29",
        "DELETE FROM audit WHERE seq = 16",
        "DELETE FROM audit",
        "UPDATE audit SET link = x'00' WHERE seq = 29",
        "DELETE FROM held",
        "UPDATE held SET value = x'00'",
        "PRAGMA user_version = 2",
        "PRAGMA application_id = 7",
        "DROP TABLE audit",
    ],
)
def test_a_segment_whose_ends_were_changed_is_named(rotated: Path, statement: str) -> None:
    changed(segment(rotated, 16), statement)
    refused(rotated, "is damaged", first=16, last=29)


def test_a_segment_of_text_that_is_none_is_named(rotated: Path) -> None:
    changed(
        segment(rotated, 16),
        "DROP TABLE audit; CREATE TABLE audit (seq INTEGER PRIMARY KEY, record, sealed, link); "
        "INSERT INTO audit VALUES (16, CAST(x'ff' AS TEXT), 0, 0)",
    )
    refused(rotated, "is damaged", first=16, last=29)


def test_rows_that_are_gone_from_the_middle_of_a_segment_are_named(rotated: Path) -> None:
    changed(segment(rotated, 16), "DELETE FROM audit WHERE seq = 20")
    store = open_store(rotated)  # its ends are as they were
    with pytest.raises(StoreError, match="records 16 to 29 is damaged: records are missing"):
        every(store)
    assert len(store.read(lambda turn: turn.rows(0, 20))) == 20
    store.close()
    with pytest.raises(StoreError, match="records are missing"):
        list(read_rows(rotated))


def test_a_record_that_was_changed_in_a_segment_is_the_chains_to_find(rotated: Path) -> None:
    changed(segment(rotated, 16), "UPDATE audit SET record = x'00' WHERE seq = 20")
    found = verify_rows(read_rows(rotated))
    assert (found.whole, found.where) == (False, "record 20")


def test_a_damaged_cell_in_a_segment_is_a_fault_of_the_store(rotated: Path) -> None:
    changed(
        segment(rotated, 16),
        "ALTER TABLE audit RENAME TO old; "
        "CREATE TABLE audit (seq INTEGER PRIMARY KEY, record, sealed, link); "
        "INSERT INTO audit SELECT * FROM old; UPDATE audit SET sealed = 7 WHERE seq = 20",
    )
    with pytest.raises(StoreError, match=r"is damaged: .*the file is no store"):
        list(read_rows(rotated))  # whoever may have made it


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE held SET value = CAST('16' AS BLOB) WHERE key = 'mark'",
        "UPDATE held SET value = CAST('many' AS BLOB) WHERE key = 'mark'",
        "DELETE FROM held WHERE kind = 'segment' AND key = 'mark'",
        "DELETE FROM held WHERE kind = 'segment' AND key = '000000000016.db'",
        "DELETE FROM held WHERE kind = 'segment' AND key = '000000000000.db'",
        "UPDATE held SET value = x'00' WHERE key = '000000000000.db'",
        "UPDATE held SET key = '000000000017.db' WHERE key = '000000000016.db'",
        "UPDATE held SET value = (SELECT value FROM held WHERE kind = 'segment' LIMIT 1)",
    ],
)
def test_a_store_that_knows_of_no_whole_row_of_segments_is_refused(
    rotated: Path, statement: str
) -> None:
    connection = apsw.Connection(str(rotated))
    connection.execute(statement)
    connection.close()
    for use in (lambda: open_store(rotated), lambda: list(read_rows(rotated))):
        with pytest.raises(StoreError) as told:
            use()
        assert told.value.reason is Reason.STORE_CORRUPT


# values that go


@pytest.mark.parametrize("clear", [True, False])
def test_values_go_from_segments_too_and_from_every_file(
    store: SqliteStore, path: Path, clear: bool
) -> None:
    rotate(store, 16)
    rotate(store, 30, clear=clear)
    forget(store, 3, 20, 29, 35)
    left = [seq for seq in range(40) if seq not in {3, 20, 29, 35}]
    assert told(path) == left
    for seq, _, sealed, _ in every(store):
        assert set(read_sealed(sealed, where="")) == {"there", *(["here"] if seq in left else [])}
    for number in left:
        forget(store, number)
    assert told(path) == []
    store.close()
    assert verify_rows(read_rows(path)).whole


def test_values_go_from_a_segment_that_is_being_written(store: SqliteStore, path: Path) -> None:
    mover = Mover(store)
    *steps, seal = copying(mover, store, 30)
    for step in steps[:3]:
        step()
    forget(store, 2, 25, 35)  # copied already, not yet, and not to be
    assert told(path) == [seq for seq in range(40) if seq not in {2, 25, 35}]
    for step in (*steps[3:], seal):
        step()
    while mover.clears:
        mover.clear(100)
    assert told(path) == [seq for seq in range(40) if seq not in {2, 25, 35}]
    store.close()
    assert verify_rows(read_rows(path)).whole


def test_a_job_that_fails_lets_nothing_go_from_a_segment(store: SqliteStore) -> None:
    rotate(store, 30)
    before = every(store)

    def fails(turn: Turn) -> None:
        turn.forget(3, {"here"})
        assert b"secret" not in turn.rows(3, 1)[0][2]
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        store.run(fails)
    assert every(store) == before


def held_back(path: Path) -> apsw.Connection:
    """Return a reader that keeps everybody from writing into a segment."""
    reader = apsw.Connection(str(segment(path, 0)), flags=apsw.SQLITE_OPEN_READONLY)
    reader.execute("BEGIN; SELECT * FROM audit").fetchone()
    return reader


def test_what_a_reader_of_a_segment_holds_up_goes_with_a_later_commit(
    store: SqliteStore, path: Path
) -> None:
    rotate(store, 30)
    reader = held_back(path)
    forget(store, 3)
    assert 3 in told(path)
    assert b"secret" not in store.read(lambda turn: turn.rows(3, 1)[0][2])
    forget(store, 4)  # another waits beside it
    reader.close()
    fill(store, 1)
    assert not {3, 4} & set(told(path))
    assert store._connection.execute("SELECT count(*) FROM held WHERE kind = 'forget'").get == 0


def test_a_segment_that_cannot_be_written_keeps_nothing_in_another(
    store: SqliteStore, path: Path
) -> None:
    rotate(store, 16)
    rotate(store, 30)
    reader = held_back(path)
    forget(store, 3, 20, 35)
    assert {3, 20, 35} & set(told(path)) == {3}
    reader.close()


def test_what_was_to_go_when_the_gate_died_is_read_no_more_and_goes_at_the_start(
    store: SqliteStore, path: Path
) -> None:
    rotate(store, 30)
    reader = held_back(path)
    forget(store, 3)
    store.close()
    assert b"secret" not in list(read_rows(path))[3].sealed
    reader.close()
    assert 3 in told(path)
    open_store(path).close()
    assert 3 not in told(path)
    assert verify_rows(read_rows(path)).whole


def test_a_number_that_is_none_is_nothing_to_forget(rotated: Path) -> None:
    connection = apsw.Connection(str(rotated))
    connection.execute("INSERT INTO held VALUES ('forget', 'me', x'00')")
    connection.close()
    assert len(list(read_rows(rotated))) == 40


def test_a_segment_that_is_gone_keeps_what_was_to_go_waiting(
    store: SqliteStore, path: Path
) -> None:
    rotate(store, 30)
    every(store)  # it is open
    segment(path, 0).unlink()
    forget(store, 3)
    assert store._connection.execute("SELECT count(*) FROM held WHERE kind = 'forget'").get == 1


# what a crash leaves


def copy(path: Path, to: Path) -> Path:
    """Return a copy of a store as it is on disk now: what a kill would leave."""
    to.mkdir()
    for file in path.parent.iterdir():
        if file.name.startswith(path.name):
            (shutil.copytree if file.is_dir() else shutil.copy)(file, to / file.name)
    return to / path.name


def test_a_kill_at_any_step_of_a_rotation_leaves_the_whole_log(
    store: SqliteStore, path: Path, tmp_path: Path
) -> None:
    before = every(store)
    mover = Mover(store)

    def clear() -> None:
        mover.clear(7)

    steps: list[Callable[[], object]] = [*copying(mover, store, 16), *[clear] * 3]
    for number, step in enumerate(steps):
        step()
        left = copy(path, tmp_path / str(number))
        again = open_store(left)
        assert every(again) == before
        assert not list(left.parent.rglob("*.part"))
        if not again.segments.end:
            rotate(again, 16)
        rotate(again, 24)
        assert in_store(again) == list(range(24, 40))
        assert every(again) == before
        again.close()
        assert verify_rows(read_rows(left)).whole
    assert not mover.clears


def test_a_segment_that_was_never_marked_is_made_again(
    store: SqliteStore, path: Path, tmp_path: Path
) -> None:
    left = copy(path, tmp_path / "before")
    rotate(store, 16)
    segment(left, 0).parent.mkdir()
    shutil.copy(segment(path, 0), segment(left, 0))  # it had its name, and the power went
    again = open_store(left)
    assert not segment(left, 0).exists()
    rotate(again, 20)
    again.close()
    assert verify_rows(read_rows(left)).size == 40


def test_a_file_of_another_log_is_not_removed_and_nothing_goes_in_its_place(
    store: SqliteStore, path: Path, tmp_path: Path
) -> None:
    other = open_store(tmp_path / "other.db")
    fill(other, 40, secret="another")
    rotate(other, 16)
    other.close()
    segment(path, 0).parent.mkdir()
    shutil.copy(segment(tmp_path / "other.db", 0), segment(path, 0))
    store.close()
    again = open_store(path)
    with pytest.raises(StoreError, match="not this log's") as told:
        rotate(again, 16)
    assert told.value.where == str(segment(path, 0))
    assert len(every(again)) == 40
    again.close()
    segment(path, 0).write_bytes(b"no segment")
    open_store(path).close()
    assert segment(path, 0).exists()


def test_a_write_that_a_kill_tore_in_a_segment_is_undone_by_whoever_reads_it_next(
    store: SqliteStore, path: Path, tmp_path: Path
) -> None:
    fill(store, 200, secret="long " * 400)
    rotate(store, 230)
    before = every(store)
    torn = apsw.Connection(str(segment(path, 0)))
    torn.execute("PRAGMA cache_size = 1; BEGIN IMMEDIATE")
    torn.execute("UPDATE audit SET sealed = CAST('{}' AS BLOB)")
    for name, use in (("read", None), ("opened", open_store)):
        left = copy(path, tmp_path / name)
        assert Path(f"{segment(left, 0)}-journal").stat().st_size > 512
        if use is not None:
            use(left).close()
        assert tuple(read_rows(left)) == tuple(LogRow(*row) for row in before)
        assert not Path(f"{segment(left, 0)}-journal").exists()
    torn.close()


# what goes wrong on the way


class Broken:
    """A connection of a store that fails at some statements."""

    def __init__(self, connection: apsw.Connection, word: str, fault: apsw.Error) -> None:
        self._connection, self._word, self._fault = connection, word, fault

    def __getattr__(self, name: str) -> Any:
        return getattr(self._connection, name)

    def execute(self, statement: str, *values: Any) -> Any:
        if self._word in statement:
            raise self._fault
        return self._connection.execute(statement, *values)


@pytest.mark.parametrize("word", ["INSERT INTO held", "user_version"])
def test_a_full_disk_at_the_mark_leaves_the_store_as_it_was(
    store: SqliteStore, path: Path, monkeypatch: pytest.MonkeyPatch, word: str
) -> None:
    before = every(store)
    mover = Mover(store)
    *steps, seal = copying(mover, store, 16)
    for step in steps:
        step()
    broken = Broken(store._connection, word, apsw.FullError("no room"))
    with monkeypatch.context() as patch:
        patch.setattr(store, "_connection", broken)
        with pytest.raises(StoreError, match="the disk is full"):
            seal()
    mover.abandon()
    assert not segment(path, 0).exists()
    assert every(store) == before
    rotate(store, 16)
    assert every(store) == before


def test_after_a_mark_that_nobody_knows_of_the_next_start_decides(
    store: SqliteStore, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = every(store)
    mover = Mover(store)
    *steps, seal = copying(mover, store, 16)
    for step in steps:
        step()
    broken = Broken(store._connection, "user_version", apsw.IOError("no answer"))
    with monkeypatch.context() as patch:
        patch.setattr(store, "_connection", broken)
        with pytest.raises(StoreError, match="no answer"):
            seal()
    mover.abandon()
    assert segment(path, 0).exists()  # it may be marked on the disk
    forget(store, 3)
    assert 3 not in told(path)
    with pytest.raises(StoreError, match="no answer"):
        mover.begin(16)
    segment(path, 0).unlink()
    forget(store, 4)  # what is not there has nothing to forget
    assert every(store)[5:] == before[5:]
    store.close()
    again = open_store(path)
    rotate(again, 16)
    assert every(again)[5:] == before[5:]
    again.close()


def test_nothing_is_sealed_while_values_are_still_to_go(store: SqliteStore, path: Path) -> None:
    rotate(store, 16)
    mover = Mover(store)
    *steps, seal = copying(mover, store, 24)
    for step in steps:
        step()
    reader = held_back(path)
    forget(store, 3)
    with pytest.raises(StoreError, match="still to go"):
        seal()
    mover.abandon()
    reader.close()
    fill(store, 1)
    rotate(store, 24)
    assert 3 not in told(path)


def test_a_segment_is_begun_before_it_is_copied_or_sealed(store: SqliteStore) -> None:
    mover = Mover(store)
    mover.abandon()
    with pytest.raises(RuntimeError):
        mover.copy(1, lambda _turn, _rows: None)
    with pytest.raises(RuntimeError):
        mover.seal(b"", head=b"")


def test_no_segment_is_begun_where_there_is_no_room_for_it(
    store: SqliteStore, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store.segments.folder, "free_bytes", lambda: 100)
    with pytest.raises(StoreError) as told:
        Mover(store).begin(16)
    assert told.value.reason is Reason.STORE_FULL
    assert not segment(path, 0).parent.exists()


def test_a_disk_that_is_short_stops_the_copying_and_has_its_place_back(
    store: SqliteStore, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mover = Mover(store)
    begin, page, *_ = copying(mover, store, 16)
    begin()
    page()
    monkeypatch.setattr(store, "restore", lambda: False)
    with pytest.raises(StoreError, match="above the reserve") as told:
        page()
    assert told.value.reason is Reason.STORE_FULL
    mover.abandon()
    assert list(segment(path, 0).parent.iterdir()) == []
    fill(store, 1)


@pytest.mark.parametrize("gone", [True, False])
def test_a_store_without_its_reserve_moves_nothing(path: Path, gone: bool) -> None:
    store = open_store(path, reserve_bytes=4_096)
    fill(store, 20)
    if gone:
        assert store._reserve.let_go()
        with pytest.raises(StoreError) as told:
            store.upkeep(lambda _connection: None)
        assert told.value.reason is Reason.STORE_FULL
    else:
        rotate(store, 16)
    assert len(every(store)) == 20
    store.close()


def test_a_page_that_cannot_be_written_is_a_fault_of_the_file(
    store: SqliteStore, path: Path
) -> None:
    mover = Mover(store)
    fill(store, 1, secret="long " * 9_999)
    begin, *pages, _ = copying(mover, store, 41)
    begin()
    assert mover._writer is not None
    mover._writer._connection.execute("PRAGMA max_page_count = 9")

    def copies() -> None:
        for page in pages:
            page()

    with pytest.raises(StoreError) as told:
        copies()
    assert told.value.reason is Reason.STORE_FULL
    assert told.value.where == f"{segment(path, 0)}.part"
    mover.abandon()
    assert len(every(store)) == 41


@pytest.mark.parametrize(
    ("number", "reason"),
    [
        (errno.ENOSPC, Reason.STORE_FULL),
        (errno.EROFS, Reason.STORE_READ_ONLY),
        (errno.EIO, Reason.STORE_UNAVAILABLE),
        (None, Reason.STORE_UNAVAILABLE),
    ],
)
def test_what_the_file_system_says_is_a_fault_of_the_store(
    store: SqliteStore, monkeypatch: pytest.MonkeyPatch, number: int | None, reason: Reason
) -> None:
    def fails(*_: Any, **__: Any) -> None:
        raise OSError(*(() if number is None else (number, "no")))

    mover = Mover(store)
    steps = copying(mover, store, 16)[:-1]
    with monkeypatch.context() as patch:
        patch.setattr(Path, "mkdir", fails)
        with pytest.raises(StoreError) as told:
            steps[0]()
        assert told.value.reason is reason
    for step in steps:
        step()
    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", fails)
        mover.abandon()
    assert len(every(store)) == 40


def test_a_part_that_cannot_be_opened_is_a_fault_of_the_file(
    store: SqliteStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store.segments.folder, "place", lambda _name: "/nowhere/at.all")
    with pytest.raises(StoreError, match="unable to open"):
        Mover(store).begin(16)


def test_a_segment_that_goes_while_it_is_opened_is_named(
    store: SqliteStore, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rotate(store, 16)
    segment(path, 0).unlink()
    monkeypatch.setattr(store.segments.folder, "has", lambda name: name.endswith(".db"))
    with pytest.raises(StoreError, match="with records 0 to 15 cannot be opened") as told:
        every(store)
    assert told.value.where == str(segment(path, 0))


def test_a_write_ahead_log_that_cannot_be_emptied_now_is_emptied_later(
    store: SqliteStore, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = Broken(store._connection, "wal_checkpoint", apsw.BusyError("not now"))
    with monkeypatch.context() as patch:
        patch.setattr(store, "_connection", broken)
        forget(store, 3)
    assert 3 in told(path)  # in the log of before
    fill(store, 1)
    assert 3 not in told(path)


def test_work_that_fails_between_the_turns_is_undone(store: SqliteStore) -> None:
    def fails(connection: apsw.Connection) -> None:
        connection.execute("INSERT INTO held VALUES ('a', 'b', x'00')")
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        store.upkeep(fails)
    assert store.read(lambda turn: turn.get("a", "b")) is None
    store.close()
    with pytest.raises(StoreError, match="closed"):
        store.upkeep(fails)


# the law


@st.composite
def works(draw: st.DrawFn) -> list[tuple[str, int]]:
    """What is done to a store: records appended, moved, cleared, values let go of, a restart."""
    kinds = st.sampled_from(("append", "rotate", "unclear", "forget", "restart"))
    return draw(st.lists(st.tuples(kinds, st.integers(0, 30)), max_size=12))


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(work=works())
def test_whatever_is_moved_the_log_is_that_of_a_store_that_never_moves_any(
    work: list[tuple[str, int]], tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("law") / "store.db"
    store, plain = open_store(path), MemoryStore()
    size, gone = 0, set[int]()
    for kind, number in work:
        if kind == "append":
            fill(store, number)
            fill(plain, number)
            size += number
        elif kind == "forget":
            for one in (store, plain):
                forget(one, number, number + 1)
            gone |= {number, number + 1} & set(range(size))
        elif kind == "restart":
            store.close()
            store = open_store(path)
        elif store.segments.end < number < size:
            rotate(store, number, clear=kind == "rotate")
        assert every(store) == plain.read(lambda turn: turn.rows(0, 1_000))
        assert not gone & set(told(path))
    store.close()
    assert tuple(read_rows(path)) == plain.rows()
    assert verify_rows(read_rows(path)).whole
    assert read_held(path, "log", "robot") is None


def test_a_checkpoint_of_another_robot_changes_nothing_for_the_store(path: Path) -> None:
    """Whose key signed it, `audit segments` says: a store knows of links alone."""
    store = open_store(path)
    fill(store, 9)
    mover = Mover(store)
    mover.begin(8)
    assert mover.copies
    assert mover.copy(8, lambda _turn, _rows: None)
    links = [row[3] for row in store.read(lambda turn: turn.rows(0, 8))]
    made = mover.seal(note(links, RobotId("another")), head=links[-1])
    assert (made.first, made.end, mover.mark) == (0, 8, 8)
    store.close()


@pytest.mark.parametrize("seq", [-1, 0, 3])
def test_a_record_that_was_put_beside_the_segments_is_found(rotated: Path, seq: int) -> None:
    """Also in the place of one that a move has taken away: nothing is hidden by a mark."""
    connection = apsw.Connection(str(rotated))
    connection.execute("DROP TRIGGER audit_no_gap")
    connection.execute("INSERT INTO audit VALUES (?, x'7b7d', x'7b7d', x'00')", (seq,))
    connection.close()
    with pytest.raises(StoreError) as refused:
        tuple(read_rows(rotated))
    assert (refused.value.where, refused.value.reason) == (f"record {seq}", "STORE_CORRUPT")


def test_a_record_before_the_first_is_seen_where_nothing_was_moved(path: Path) -> None:
    open_store(path).close()
    connection = apsw.Connection(str(path))
    connection.execute("DROP TRIGGER audit_no_gap")
    connection.execute("INSERT INTO audit VALUES (-1, x'7b7d', x'7b7d', x'00')")
    connection.close()
    assert [row.seq for row in read_rows(path)] == [-1]
