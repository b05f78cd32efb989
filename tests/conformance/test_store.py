# SPDX-License-Identifier: Apache-2.0
"""One suite for every `core.ports.Store`, and what a file adds: durable before it answers."""

from __future__ import annotations

import itertools
import os
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import apsw
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from authguard_r.audit.record import Entry, LogRow, append, read_sealed
from authguard_r.audit.verify import verify_rows
from authguard_r.core.chain import GENESIS
from authguard_r.core.errors import RefusedError, StoreError
from authguard_r.core.ports import Turn
from authguard_r.core.reasons import Reason
from authguard_r.store.memory import MemoryStore
from authguard_r.store.sqlite import SqliteStore, _Ticket, open_store, read_held, read_rows
from authguard_r.wire.gate_limits import LIMITS

#: A thread that is not back by then never will be, seconds.
PATIENCE = 60
THREADS = 8
JOBS = 50


Cells = tuple[tuple[int, bytes, bytes, bytes], ...]


class Opened:
    """A store under test, and its log from outside once it is closed."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self.rows: tuple[LogRow, ...] = ()
        self.store = MemoryStore() if path is None else open_store(path)

    def close(self) -> tuple[LogRow, ...]:
        self.store.close()
        if isinstance(self.store, MemoryStore):
            self.rows = self.store.rows()
        else:
            assert self._path is not None
            self.rows = tuple(read_rows(self._path))
        return self.rows


@pytest.fixture(params=["memory", "sqlite"])
def opened(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Opened]:
    made = Opened(None if request.param == "memory" else tmp_path / "store.db")
    yield made
    made.store.close()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "store.db"


@pytest.fixture
def durable(path: Path) -> Iterator[SqliteStore]:
    store = open_store(path)
    yield store
    store.close()


def hold(key: str, value: bytes) -> Callable[[Turn], None]:
    return lambda turn: turn.put("held", key, value)


def held(store: MemoryStore | SqliteStore, key: str) -> bytes | None:
    return store.run(lambda turn: turn.get("held", key))


def head(store: MemoryStore | SqliteStore) -> tuple[int, bytes]:
    return store.run(lambda turn: turn.head())


def entry(note: object = 0) -> Entry:
    return Entry(kind="stop", time_ms=1, decision="stop", open={"note": note})


def record(turn: Turn, note: object = 0) -> int:
    return append(turn, entry(note), salts=b"")


def count(turn: Turn) -> int:
    """Add one to a counter, read and written in the same turn."""
    known = turn.get("held", "counter")
    after = int(known or b"0") + 1
    turn.put("held", "counter", str(after).encode())
    return after


def in_threads(*works: Callable[[], object]) -> None:
    """Run every piece of work in a thread of its own; what one raises is raised here."""
    faults: list[BaseException] = []

    def guarded(work: Callable[[], object]) -> None:
        try:
            work()
        except BaseException as error:  # noqa: BLE001 - raised again below
            faults.append(error)

    threads = [threading.Thread(target=guarded, args=(work,), daemon=True) for work in works]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE)
    assert not any(thread.is_alive() for thread in threads), "a job never came back"
    for fault in faults:
        raise fault


# every store


def test_a_new_store_holds_nothing_and_its_chain_starts_at_zero(opened: Opened) -> None:
    assert held(opened.store, "anything") is None
    assert head(opened.store) == (0, GENESIS)
    assert opened.close() == ()


def test_what_a_job_puts_is_seen_inside_the_turn_and_after(opened: Opened) -> None:
    def job(turn: Turn) -> bytes | None:
        turn.put("held", "a", b"1")
        return turn.get("held", "a")

    assert opened.store.run(job) == b"1"
    assert held(opened.store, "a") == b"1"


def test_the_last_value_put_is_the_one_held(opened: Opened) -> None:
    opened.store.run(hold("a", b"1"))

    def job(turn: Turn) -> tuple[bytes | None, bytes | None]:
        before = turn.get("held", "a")
        turn.put("held", "a", b"2")
        turn.put("held", "a", b"3")
        return before, turn.get("held", "a")

    assert opened.store.run(job) == (b"1", b"3")
    assert held(opened.store, "a") == b"3"


def test_more_values_than_a_store_remembers_are_all_held(opened: Opened) -> None:
    count = 200

    def put(turn: Turn) -> None:
        for number in range(count):
            turn.put("kind", str(number), b"%d" % number)

    opened.store.run(put)
    held = opened.store.run(lambda turn: [turn.get("kind", str(n)) for n in range(count + 1)])
    assert held == [*(b"%d" % number for number in range(count)), None]


def test_a_value_of_a_job_that_raised_is_read_from_the_store_again(opened: Opened) -> None:
    opened.store.run(lambda turn: turn.put("kind", "key", b"before"))

    def fails(turn: Turn) -> None:
        turn.put("kind", "key", b"after")
        assert turn.get("kind", "key") == b"after"
        raise RefusedError("no", reason=Reason.ROLE_DENIED)

    with pytest.raises(RefusedError):
        opened.store.run(fails)
    assert opened.store.run(lambda turn: turn.get("kind", "key")) == b"before"


def test_kinds_keep_their_keys_apart(opened: Opened) -> None:
    opened.store.run(lambda turn: [turn.put(kind, "key", kind.encode()) for kind in "ab"])
    assert opened.store.run(lambda turn: turn.get("a", "key")) == b"a"
    assert opened.store.run(lambda turn: turn.get("b", "key")) == b"b"
    assert opened.store.run(lambda turn: turn.get("key", "a")) is None


def test_an_empty_value_is_held_and_is_not_nothing(opened: Opened) -> None:
    opened.store.run(hold("empty", b""))
    assert held(opened.store, "empty") == b""


@pytest.mark.parametrize("result", [None, 0, False, (), b"", "text"])
def test_a_job_gets_its_own_result_back_whatever_it_is(opened: Opened, result: object) -> None:
    assert opened.store.run(lambda _turn: result) is result


def test_records_are_numbered_one_after_the_other_and_the_head_follows(opened: Opened) -> None:
    def job(turn: Turn) -> list[tuple[int, int]]:
        return [(record(turn), turn.head()[0]) for _ in range(3)]

    assert opened.store.run(job) == [(0, 1), (1, 2), (2, 3)]
    assert opened.store.run(job) == [(3, 4), (4, 5), (5, 6)]
    size, link = head(opened.store)
    rows = opened.close()
    assert (size, link) == (6, rows[-1].link)
    assert [row.seq for row in rows] == list(range(6))
    assert verify_rows(rows, terminal=None).whole


def test_the_head_inside_a_turn_is_the_link_just_appended(opened: Opened) -> None:
    def job(turn: Turn) -> tuple[int, bytes]:
        turn.append(b"record", b"{}", b"L" * 32)
        return turn.head()

    assert opened.store.run(job) == (1, b"L" * 32)


@pytest.mark.parametrize(
    "fault",
    [
        ValueError("a mistake"),
        RefusedError("no", reason=Reason.TRANSITION_REFUSED),
        StoreError("a store's own word", reason=Reason.STORE_CORRUPT),
        KeyboardInterrupt(),
    ],
    ids=lambda fault: type(fault).__name__,
)
def test_a_job_that_raises_undoes_everything_it_did_and_raises_it(
    opened: Opened, fault: BaseException
) -> None:
    opened.store.run(lambda turn: (turn.put("held", "a", b"old"), record(turn)))
    before = head(opened.store)

    def job(turn: Turn) -> None:
        turn.put("held", "a", b"new")
        turn.put("held", "b", b"new")
        record(turn)
        record(turn)
        raise fault

    with pytest.raises(type(fault)) as raised:
        opened.store.run(job)
    assert raised.value is fault
    assert head(opened.store) == before
    assert (held(opened.store, "a"), held(opened.store, "b")) == (b"old", None)
    assert opened.store.run(record) == 1  # the number that the undone record had
    rows = opened.close()
    assert len(rows) == 2
    assert verify_rows(rows, terminal=None).whole


def test_threads_lose_no_update_and_leave_one_whole_chain(opened: Opened) -> None:
    seen: list[tuple[int, int]] = []

    def work() -> None:
        seen.extend(
            [opened.store.run(lambda turn: (count(turn), record(turn))) for _ in range(JOBS)]
        )

    in_threads(*[work] * THREADS)
    total = THREADS * JOBS
    assert held(opened.store, "counter") == str(total).encode()
    assert sorted(seen) == [(n + 1, n) for n in range(total)]
    rows = opened.close()
    assert len(rows) == total
    assert verify_rows(rows, terminal=None).whole


def test_jobs_that_raise_in_one_thread_disturb_no_other(opened: Opened) -> None:
    raised: list[int] = []

    def good() -> None:
        for _ in range(JOBS):
            opened.store.run(lambda turn: (count(turn), record(turn, "good")))

    def bad() -> None:
        for number in range(JOBS):
            fault = LookupError(number)

            def job(turn: Turn, fault: LookupError = fault) -> None:
                count(turn)
                record(turn, "bad")
                raise fault

            with pytest.raises(LookupError) as caught:
                opened.store.run(job)
            assert caught.value is fault
            raised.append(number)

    in_threads(*[good] * (THREADS // 2), *[bad] * (THREADS // 2))
    kept = THREADS // 2 * JOBS
    assert len(raised) == kept
    assert held(opened.store, "counter") == str(kept).encode()
    rows = opened.close()
    assert len(rows) == kept
    assert all(b"good" in row.record for row in rows)
    assert verify_rows(rows, terminal=None).whole


def test_a_new_store_is_read_and_written_by_its_owner_alone(tmp_path: Path) -> None:
    path = tmp_path / "robot.db"
    store = open_store(path)
    store.run(lambda turn: turn.put("a", "b", b"c"))
    files = sorted(tmp_path.iterdir())
    assert [file.name for file in files] == ["robot.db", "robot.db-wal"]
    assert [oct(file.stat().st_mode & 0o777) for file in files] == ["0o600", "0o600"]
    store.close()
    path.chmod(0o640)  # who made it wider meant it
    open_store(path).close()
    assert path.stat().st_mode & 0o777 == 0o640


def test_a_closed_store_refuses_every_job_without_running_it(opened: Opened) -> None:
    opened.store.run(hold("a", b"1"))
    opened.store.close()
    ran: list[Turn] = []
    for _ in range(2):
        with pytest.raises(StoreError) as refused:
            opened.store.run(ran.append)
        assert refused.value.reason is Reason.STORE_UNAVAILABLE
        with pytest.raises(StoreError) as refused:
            opened.store.read(ran.append)
        assert refused.value.reason is Reason.STORE_UNAVAILABLE
    assert ran == []


def test_a_job_that_only_reads_sees_what_was_committed_and_leaves_nothing(opened: Opened) -> None:
    opened.store.run(lambda turn: (turn.put("kind", "key", b"kept"), record(turn)))

    def writes(turn: Turn) -> bytes | None:
        turn.put("kind", "key", b"lost")
        record(turn)
        return turn.get("kind", "key")

    assert opened.store.read(writes) == b"lost"
    assert opened.store.read(lambda turn: turn.get("kind", "key")) == b"kept"
    assert opened.store.read(lambda turn: (turn.head()[0], len(turn.rows(0, 9)))) == (1, 1)

    def fails(turn: Turn) -> None:
        writes(turn)
        raise RefusedError("no", reason=Reason.ROLE_DENIED)

    with pytest.raises(RefusedError):
        opened.store.read(fails)
    assert opened.store.run(lambda turn: (turn.get("kind", "key"), turn.head()[0])) == (b"kept", 1)


def test_a_store_that_cannot_be_read_says_so(durable: SqliteStore) -> None:
    def broken(turn: Turn) -> None:
        raise apsw.IOError("no such sector")

    with pytest.raises(StoreError, match="no such sector"):
        durable.read(broken)


def test_rows_are_read_in_the_turn_with_those_that_it_appends(opened: Opened) -> None:
    opened.store.run(lambda turn: [record(turn, n) for n in range(5)])

    def job(turn: Turn) -> Cells:
        record(turn, 5)
        return turn.rows(3, 10)

    rows = opened.store.run(job)
    assert [row[0] for row in rows] == [3, 4, 5]
    assert tuple(LogRow(*row) for row in opened.store.run(lambda turn: turn.rows(0, 100))) == (
        opened.close()
    )
    assert opened.rows[3:] == tuple(LogRow(*row) for row in rows)


@pytest.mark.parametrize(
    ("first", "count", "expected"),
    [
        (0, 0, []),
        (0, 1, [0]),
        (1, 2, [1, 2]),
        (2, 100, [2]),
        (3, 1, []),
        (0, 2**80, [0, 1, 2]),
        (2**80, 2**80, []),
        (-1, 2, [0]),
        (-5, 2, []),
        (1, -1, []),
    ],
)
def test_rows_that_are_not_there_are_not_invented(
    opened: Opened, first: int, count: int, expected: list[int]
) -> None:
    opened.store.run(lambda turn: [record(turn, n) for n in range(3)])
    assert [row[0] for row in opened.store.run(lambda turn: turn.rows(first, count))] == expected


def test_rows_of_a_job_that_raised_are_not_read(opened: Opened) -> None:
    opened.store.run(record)

    def fails(turn: Turn) -> None:
        record(turn)
        assert len(turn.rows(0, 10)) == 2
        raise LookupError

    with pytest.raises(LookupError):
        opened.store.run(fails)
    assert len(opened.store.run(lambda turn: turn.rows(0, 10))) == 1


def test_an_essential_job_is_a_job_like_any_other_while_there_is_room(opened: Opened) -> None:
    assert opened.store.restore()
    assert opened.store.run(record, essential=True) == 0
    with pytest.raises(LookupError):
        opened.store.run(lambda turn: [record(turn), {}["nothing"]], essential=True)
    assert opened.store.run(record) == 1
    assert opened.store.restore()


@st.composite
def jobs(draw: st.DrawFn) -> tuple[tuple[tuple[str, bytes | None], ...], bool]:
    """A job: values to put (None appends a record instead), and whether it raises in the end."""
    steps = st.tuples(st.sampled_from("abc"), st.none() | st.binary(max_size=8))
    return tuple(draw(st.lists(steps, max_size=6))), draw(st.booleans())


@settings(max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(work=st.lists(jobs(), max_size=8))
@pytest.mark.parametrize("kind", ["memory", "sqlite"])
def test_a_store_does_what_a_dictionary_and_a_list_do(
    kind: str, work: list[Any], tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = None if kind == "memory" else tmp_path_factory.mktemp("model") / "store.db"
    opened = Opened(path)
    values: dict[str, bytes] = {}
    records = 0
    for steps, fails in work:
        after, added = dict(values), 0

        def job(turn: Turn, steps: Any = steps, fails: bool = fails) -> None:
            for key, value in steps:
                if value is None:
                    record(turn)
                else:
                    turn.put("held", key, value)
            if fails:
                raise LookupError

        for key, value in steps:
            if value is None:
                added += 1
            else:
                after[key] = value
        if fails:
            with pytest.raises(LookupError):
                opened.store.run(job)
        else:
            opened.store.run(job)
            values, records = after, records + added
        assert {key: held(opened.store, key) for key in "abc"} == {
            key: values.get(key) for key in "abc"
        }
        assert head(opened.store)[0] == records
    rows = opened.close()
    assert len(rows) == records
    assert verify_rows(rows, terminal=None).whole


# what a file adds


def test_a_store_that_is_opened_again_has_everything(path: Path) -> None:
    first = open_store(path)
    first.run(lambda turn: (turn.put("held", "a", b"1"), record(turn), record(turn)))
    before = head(first)
    first.close()
    second = open_store(path)
    assert held(second, "a") == b"1"
    assert head(second) == before
    assert second.run(record) == 2
    second.close()
    assert read_held(path, "held", "a") == b"1"
    assert read_held(path, "held", "b") is None
    rows = tuple(read_rows(path))
    assert len(rows) == 3
    assert verify_rows(rows, terminal=None).whole


def test_a_store_keeps_its_index_to_itself_from_the_first_page_it_reads(path: Path) -> None:
    """No shared memory: nobody else may read along, and file systems without it will do."""
    for _ in range(2):
        store = open_store(path)
        store.run(record)
        assert sorted(file.name for file in path.parent.iterdir()) == ["store.db", "store.db-wal"]
        store.close()


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE audit SET record = x'00'",
        "UPDATE audit SET seq = seq + 10 WHERE seq = 1",
        "UPDATE audit SET link = x'00'",
        "UPDATE audit SET sealed = CAST('{\"note\":{}}' AS BLOB)",
        "UPDATE OR REPLACE audit SET seq = 0 WHERE seq = 1",
        "DELETE FROM audit",
        "DELETE FROM audit WHERE seq = 1",
        "INSERT INTO audit SELECT * FROM audit WHERE true ON CONFLICT DO UPDATE SET link = x'00'",
        "INSERT OR REPLACE INTO audit VALUES (1, x'00', x'00', x'00')",
        "INSERT INTO audit VALUES (7, x'00', x'00', x'00')",
        "INSERT INTO audit VALUES (-1, x'00', x'00', x'00')",
    ],
)
def test_the_log_is_append_only_even_to_one_who_has_the_file(path: Path, statement: str) -> None:
    store = open_store(path)
    store.run(lambda turn: [record(turn, n) for n in range(2)])
    store.close()
    before = tuple(read_rows(path))
    connection = apsw.Connection(str(path))
    with pytest.raises(apsw.ConstraintError, match="append-only"):
        connection.execute(statement)
    connection.close()
    assert tuple(read_rows(path)) == before


SECRETS = {"here": "a secret " + "that is told " * 4_000, "there": "what stays"}


def secret(turn: Turn) -> int:
    sealed = Entry(kind="stop", time_ms=1, decision="stop", open={}, sealed=SECRETS)
    return append(turn, sealed, salts=bytes(32))


def beside(store: MemoryStore | SqliteStore, seq: int) -> dict[str, Any]:
    rows = store.read(lambda turn: turn.rows(seq, 1))
    return {name: one.value for name, one in read_sealed(rows[0][2], where="").items()}


def test_values_go_and_the_chain_stays(opened: Opened) -> None:
    opened.store.run(secret)
    opened.store.run(record)

    def forgets(turn: Turn) -> tuple[bytes, ...]:
        turn.forget(0, {"here", "nowhere"})
        turn.forget(9, {"here"})  # there is no such record
        return turn.rows(0, 1)[0]

    assert b"secret" not in opened.store.run(forgets)[2]
    assert beside(opened.store, 0) == {"there": "what stays"}
    rows = opened.store.read(lambda turn: turn.rows(0, 2))
    found = verify_rows([LogRow(*row) for row in rows], terminal=None)
    assert (found.whole, found.size) == (True, 2)


def test_a_job_that_fails_lets_nothing_go(opened: Opened) -> None:
    opened.store.run(secret)

    def fails(turn: Turn) -> None:
        turn.forget(0, {"here"})
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        opened.store.run(fails)
    opened.store.read(lambda turn: turn.forget(0, {"here"}))
    assert beside(opened.store, 0) == SECRETS


def test_what_was_let_go_is_in_no_file_of_the_store(durable: SqliteStore, path: Path) -> None:
    def files() -> bytes:
        return b"".join(file.read_bytes() for file in path.parent.iterdir())

    durable.run(secret)
    assert b"a secret" in files()
    durable.run(lambda turn: turn.forget(0, {"here"}))
    assert b"told" not in files()
    assert b"what stays" in files()
    durable.run(record)
    assert count_of(path) == 2


def count_of(path: Path) -> int:
    """Return the records of a file that another connection of this process may hold."""
    copy = path.with_name("copy.db")
    for end in ("", "-wal"):
        copy.with_name(f"copy.db{end}").write_bytes(path.with_name(f"store.db{end}").read_bytes())
    return len(tuple(read_rows(copy)))


def test_a_store_of_before_is_given_the_rule_that_lets_values_go(path: Path) -> None:
    store = open_store(path)
    store.run(secret)
    store.close()
    connection = apsw.Connection(str(path))
    connection.execute(
        "DROP TRIGGER audit_only_forgets; CREATE TRIGGER audit_no_update BEFORE UPDATE ON audit "
        "BEGIN SELECT RAISE(ABORT, 'the audit log is append-only'); END"
    )
    connection.close()
    store = open_store(path)
    store.run(lambda turn: turn.forget(0, {"here"}))
    assert beside(store, 0) == {"there": "what stays"}
    store.close()


class Pass(apsw.VFSFile):
    """A file of the operating system whose syncs are told before they are done."""

    def __init__(self, vfs: Watched, name: Any, flags: list[int]) -> None:
        super().__init__("", name, flags)
        self._vfs = vfs
        self._is_wal = bool(flags[0] & apsw.SQLITE_OPEN_WAL)

    def xSync(self, flags: int) -> None:  # noqa: N802 - SQLite's word
        if self._is_wal:
            self._vfs.on_sync()
        super().xSync(flags)
        if self._is_wal:
            self._vfs.synced += 1


class Watched(apsw.VFS):
    """The operating system's file system, with a word before each sync of the log file."""

    def __init__(self, name: str) -> None:
        super().__init__(name, "")
        self.synced = 0
        self.on_sync: Callable[[], None] = lambda: None

    def xOpen(self, name: Any, flags: list[int]) -> Pass:  # noqa: N802 - SQLite's word
        return Pass(self, name, flags)


_NAMES = itertools.count()


@pytest.fixture
def vfs() -> Iterator[tuple[str, Watched]]:
    name = f"watched-{next(_NAMES)}"
    made = Watched(name)
    yield name, made
    made.unregister()


@pytest.fixture
def watched(path: Path, vfs: tuple[str, Watched]) -> Iterator[tuple[SqliteStore, Watched]]:
    store = open_store(path, vfs=vfs[0])
    yield store, vfs[1]
    vfs[1].on_sync = lambda: None
    store.close()


def queued(store: SqliteStore, size: int) -> None:
    """Return once that many jobs wait for the writer's turn."""
    alarm = threading.Event()
    timer = threading.Timer(PATIENCE, alarm.set)
    timer.start()
    while len(store._pending) < size and not alarm.is_set():
        os.sched_yield()
    timer.cancel()
    assert len(store._pending) == size


def test_every_result_is_on_disk_before_it_is_returned(
    watched: tuple[SqliteStore, Watched],
) -> None:
    store, vfs = watched
    for _ in range(5):
        synced_in_turn = store.run(lambda turn: (record(turn), vfs.synced)[1])
        assert vfs.synced > synced_in_turn


def test_nobody_is_answered_while_the_disk_still_writes(
    watched: tuple[SqliteStore, Watched],
) -> None:
    store, vfs = watched
    writing, go_on = threading.Event(), threading.Event()
    answers: list[int] = []

    def wait() -> None:
        writing.set()
        assert go_on.wait(PATIENCE)

    vfs.on_sync = wait

    def leader() -> None:
        answers.append(store.run(record))

    def main() -> None:
        assert writing.wait(PATIENCE)
        assert answers == []  # the job has run, the commit has not come back
        go_on.set()

    in_threads(leader, main)
    assert answers == [0]


def test_jobs_that_wait_together_are_committed_by_one_sync(
    watched: tuple[SqliteStore, Watched],
) -> None:
    store, vfs = watched
    inside, answers = threading.Event(), []
    syncs: list[int] = []

    def leader() -> None:
        def job(turn: Turn) -> int:
            inside.set()
            queued(store, THREADS)
            return record(turn)

        answers.append(store.run(job))

    def follower() -> None:
        assert inside.wait(PATIENCE)
        answers.append(store.run(lambda turn: (syncs.append(vfs.synced), record(turn))[1]))

    before = vfs.synced
    in_threads(leader, *[follower] * THREADS)
    assert sorted(answers) == list(range(THREADS + 1))
    assert syncs == [before + 1] * THREADS  # all in one transaction, after the leader's own
    assert vfs.synced == before + 2


def test_a_job_that_raises_leaves_the_others_of_its_batch_committed(
    durable: SqliteStore, path: Path
) -> None:
    inside = threading.Event()
    numbers: list[int] = []
    faults: list[int] = []

    def leader() -> None:
        durable.run(lambda _turn: (inside.set(), queued(durable, THREADS)))

    def good() -> None:
        assert inside.wait(PATIENCE)
        numbers.append(durable.run(lambda turn: (count(turn), record(turn))[1]))

    def bad() -> None:
        assert inside.wait(PATIENCE)
        with pytest.raises(ZeroDivisionError):
            durable.run(lambda turn: (count(turn), record(turn), 1 // 0))
        faults.append(1)

    in_threads(leader, *[good, bad] * (THREADS // 2))
    assert len(faults) == THREADS // 2
    assert sorted(numbers) == list(range(THREADS // 2))
    assert held(durable, "counter") == str(THREADS // 2).encode()
    durable.close()
    assert verify_rows(read_rows(path), terminal=None).size == THREADS // 2


def test_a_batch_that_cannot_be_committed_is_refused_to_everybody_in_it(
    watched: tuple[SqliteStore, Watched], path: Path
) -> None:
    store, vfs = watched
    store.run(lambda turn: (turn.put("held", "a", b"old"), record(turn)))
    before = head(store)
    inside = threading.Event()
    refused: list[Reason] = []
    broken = threading.Event()

    def on_sync() -> None:
        if broken.is_set():
            raise apsw.IOError("the disk is gone")

    vfs.on_sync = on_sync

    def leader() -> None:
        store.run(lambda _turn: (inside.set(), queued(store, THREADS)))

    def follower() -> None:
        assert inside.wait(PATIENCE)
        with pytest.raises(StoreError) as error:
            store.run(lambda turn: (broken.set(), turn.put("held", "a", b"new"), record(turn)))
        refused.append(error.value.reason)

    in_threads(leader, *[follower] * THREADS)
    assert refused == [Reason.STORE_UNAVAILABLE] * THREADS
    broken.clear()
    assert head(store) == before
    assert held(store, "a") == b"old"
    assert store.run(record) == 1
    store.close()
    assert verify_rows(read_rows(path), terminal=None).size == 2


def test_more_jobs_than_one_batch_takes_are_all_answered(durable: SqliteStore) -> None:
    waiting = 200
    inside = threading.Event()
    answers: list[int] = []

    def leader() -> None:
        durable.run(lambda _turn: (inside.set(), queued(durable, waiting)))

    def follower() -> None:
        assert inside.wait(PATIENCE)
        answers.append(durable.run(record))

    in_threads(leader, *[follower] * waiting)
    assert sorted(answers) == list(range(waiting))


def test_a_job_behind_a_full_batch_is_run_before_it_is_answered(durable: SqliteStore) -> None:
    # 64 threads that have queued their jobs and do not have the lock yet
    durable._pending.extend(_Ticket(record) for _ in range(LIMITS.batch))
    assert durable.run(record) == LIMITS.batch
    assert head(durable)[0] == LIMITS.batch + 1


def test_an_interrupt_at_the_commit_is_not_taken_for_a_commit(
    durable: SqliteStore, path: Path
) -> None:
    durable.run(lambda turn: (turn.put("held", "a", b"old"), record(turn)))
    before = head(durable)
    inside, armed = threading.Event(), threading.Event()
    raised: list[str] = []

    def interrupt() -> bool:
        if armed.is_set():
            armed.clear()
            raise KeyboardInterrupt
        return False

    def leader() -> None:
        durable.run(lambda _turn: (inside.set(), queued(durable, THREADS)))

    def follower() -> None:
        assert inside.wait(PATIENCE)
        try:
            durable.run(lambda turn: (armed.set(), turn.put("held", "a", b"new"), record(turn)))
        except BaseException as error:  # noqa: BLE001 - which one is the question
            raised.append(type(error).__name__)

    durable._connection.set_commit_hook(interrupt)
    in_threads(leader, *[follower] * THREADS)
    durable._connection.set_commit_hook(None)
    # whoever committed for the batch was interrupted; nobody else may take it for done
    assert sorted(raised) == ["KeyboardInterrupt", *["StoreError"] * (THREADS - 1)]
    assert head(durable) == before
    assert held(durable, "a") == b"old"
    assert durable.run(record) == 1
    durable.close()
    assert verify_rows(read_rows(path), terminal=None).whole


def test_an_interrupt_just_after_the_commit_leaves_a_store_that_goes_on(
    durable: SqliteStore, path: Path
) -> None:
    durable.run(record)

    def interrupt(*_: object) -> int:
        raise KeyboardInterrupt

    durable._connection.set_wal_hook(interrupt)  # called when the commit is in the file
    with pytest.raises(KeyboardInterrupt):
        durable.run(record)
    durable._connection.set_wal_hook(None)
    assert head(durable)[0] == 2
    assert durable.run(record) == 2
    durable.close()
    assert verify_rows(read_rows(path), terminal=None).size == 3


def test_a_job_that_only_reads_costs_no_sync(watched: tuple[SqliteStore, Watched]) -> None:
    store, vfs = watched
    store.run(record)
    before = vfs.synced
    for _ in range(3):
        store.run(lambda turn: (turn.get("held", "a"), turn.head(), turn.rows(0, 9)))
    assert vfs.synced == before


@pytest.mark.parametrize("cell", ["7", "CAST(x'ff91' AS TEXT)"])
def test_a_damaged_row_that_is_read_is_said_to_be_damaged(path: Path, cell: str) -> None:
    store = open_store(path)
    store.run(record)
    store.close()
    broken = apsw.Connection(str(path))
    broken.execute(
        "DROP TABLE audit; CREATE TABLE audit (seq INTEGER PRIMARY KEY, record, sealed, link)"
    )
    broken.execute(f"INSERT INTO audit VALUES (0, {cell}, x'00', x'00')")
    broken.close()
    store = open_store(path)
    with pytest.raises(StoreError) as refused:
        store.run(lambda turn: turn.rows(0, 1))
    assert refused.value.reason is Reason.STORE_CORRUPT
    assert held(store, "anything") is None  # the rest goes on
    store.close()


def test_when_the_reserve_makes_room_a_whole_batch_is_run_again(
    path: Path, vfs: tuple[str, Watched]
) -> None:
    """Essential jobs of it are on disk, others are refused, readers and mistakes stay their own."""
    name, disk = vfs
    store = open_store(path, vfs=name, reserve_bytes=1 << 16)
    store.run(record)
    ballast = path.with_name("store.db.reserve")

    def on_sync() -> None:
        if ballast.exists():
            raise apsw.FullError("no space left")

    disk.on_sync = on_sync
    runs: list[str] = []

    def job(what: str, work: Callable[[Turn], object]) -> Callable[[Turn], object]:
        return lambda turn: (runs.append(what), work(turn))[1]

    waiting = [
        _Ticket(job("release", record)),
        _Ticket(job("outcome", record), essential=True),
        _Ticket(job("reader", lambda turn: turn.head()[0])),
        _Ticket(job("mistake", lambda turn: (record(turn), {}["nothing"])), essential=True),
    ]
    store._pending.extend(waiting)
    assert store.run(job("stop", record), essential=True) == 2
    release, outcome, reader, mistake = waiting
    assert isinstance(release.error, StoreError)
    assert release.error.reason is Reason.STORE_FULL
    assert (outcome.finish(), reader.finish()) == (1, 2)
    assert isinstance(mistake.error, KeyError)
    assert runs == ["release", "outcome", "reader", "mistake", "stop"] * 2
    assert not ballast.exists()
    disk.on_sync = lambda: None
    assert store.restore()
    assert store.run(record) == 3
    store.close()
    assert verify_rows(read_rows(path), terminal=None).whole


def test_a_release_that_has_no_room_does_not_touch_the_reserve(
    path: Path, vfs: tuple[str, Watched]
) -> None:
    name, disk = vfs
    store = open_store(path, vfs=name, reserve_bytes=1 << 16)

    def full() -> None:
        raise apsw.FullError("no space left")

    disk.on_sync = full
    with pytest.raises(StoreError) as refused:
        store.run(record)
    assert refused.value.reason is Reason.STORE_FULL
    assert path.with_name("store.db.reserve").exists()
    disk.on_sync = lambda: None
    assert store.run(record) == 0
    store.close()
