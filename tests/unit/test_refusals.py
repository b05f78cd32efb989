# SPDX-License-Identifier: Apache-2.0
"""A flood of refusals costs memory for a number, not disk and not anybody's fsync.

And on a full disk what must be written is written: the reserve is for outcomes, stops, orders and
alerts, never for a release, least of all for a refusal.
"""

from __future__ import annotations

import itertools
import json
import os
import shutil
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path
from typing import Any

import apsw
import msgspec
import pytest

from authguard_r.audit.record import Entry, LogRow
from authguard_r.audit.verify import verify_rows
from authguard_r.core.encoding import Tag, b64, decode, encode_fast
from authguard_r.core.errors import ClockError, RefusedError, StoreError
from authguard_r.core.identifiers import RobotId
from authguard_r.core.reasons import Reason
from authguard_r.store.memory import MemoryStore
from authguard_r.store.refusals import RefusalPolicy, Refusals
from authguard_r.store.reserve import Reserve
from authguard_r.store.sqlite import SqliteStore, open_store, read_held, read_rows
from authguard_r.store.transactions import ClockWatermark, Ledger, Transaction
from authguard_r.wire.gate_limits import LIMITS

RID = RobotId("courier-1")
START_MS = 1_700_000_000_000
#: What a gate process uses.
GATE = RefusalPolicy(delay_ms=100, fold_ms=60_000)
MOST_OF_USER = GATE.most_of_user
FOLD = ("planner-1", Reason.PROVENANCE_DENIED, "action.object")
RESERVE = 1 << 20
MIB = 1 << 20
_NAMES = itertools.count()


class SetClock:
    """A clock that stands where it was put."""

    def __init__(self) -> None:
        self.ms = 0

    def wall_ms(self) -> int:
        return START_MS + self.ms

    def mono_ms(self) -> int:
        return self.ms

    def pause(self, duration_ms: int) -> None:
        self.ms += duration_ms


class CountingFile(apsw.VFSFile):
    """A file of the operating system whose syncs are counted, and that can be full."""

    def __init__(self, vfs: Disk, name: Any, flags: list[int]) -> None:
        super().__init__("", name, flags)
        self._vfs = vfs
        self._is_wal = bool(flags[0] & apsw.SQLITE_OPEN_WAL)

    def xWrite(self, data: bytes, offset: int) -> None:  # noqa: N802 - SQLite's word
        if self._is_wal and self._vfs.is_full():
            raise apsw.FullError("no space left")
        self._vfs.written += len(data)
        super().xWrite(data, offset)

    def xSync(self, flags: int) -> None:  # noqa: N802
        super().xSync(flags)
        self._vfs.synced += self._is_wal


class Disk(apsw.VFS):
    """The operating system's file system; `is_full` says whether the log takes writes."""

    def __init__(self) -> None:
        self.name = f"disk-{next(_NAMES)}"
        super().__init__(self.name, "")
        self.synced = 0
        self.written = 0
        self.is_full: Callable[[], bool] = lambda: False

    def xOpen(self, name: Any, flags: list[int]) -> CountingFile:  # noqa: N802
        return CountingFile(self, name, flags)


@pytest.fixture
def disk() -> Iterator[Disk]:
    made = Disk()
    yield made
    made.unregister()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "store.db"


@pytest.fixture
def clock() -> SetClock:
    return SetClock()


Make = Callable[..., Ledger]


@pytest.fixture
def make(path: Path, disk: Disk, clock: SetClock) -> Iterator[Make]:
    """Make a ledger on the counted disk, with the policy of a gate process."""
    opened: list[Ledger] = []

    def made(policy: RefusalPolicy = GATE, reserve_bytes: int = 0) -> Ledger:
        store = open_store(path, vfs=disk.name, reserve_bytes=reserve_bytes)
        opened.append(ledger_on(store, clock, policy))
        return opened[-1]

    yield made
    disk.is_full = lambda: False
    for ledger in opened:
        ledger.close()


def ledger_on(store: Any, clock: SetClock, policy: RefusalPolicy = GATE) -> Ledger:
    return Ledger(store, clock, robot=RID, salts=os.urandom, genesis={}, refusals=policy)


def refusal(time_ms: int, note: object = "no", kind: str = "decision") -> Entry:
    return Entry(
        kind=kind,
        time_ms=time_ms,
        decision="reject",
        open={"reasons": [FOLD[1]], "note": note},
        sealed={"action": {"object": "package-p2"}},
    )


def refuse(
    ledger: Ledger, note: object = "no", dedup_key: tuple[str, str, str] = FOLD
) -> int | None:
    """Refuse one proposal in an act, as the enforcer does."""
    return ledger.run(lambda act: act.refuse(refusal(act.now.utc_ms, note), dedup_key=dedup_key))


def accept(ledger: Ledger, **options: Any) -> int:
    """Hold something and record it, as a release does."""

    def job(act: Transaction) -> int:
        act.put("standing", "m", b"%d" % act.now.utc_ms)
        return act.record(entry_of("accept", act.now.utc_ms))

    return ledger.run(job, **options)


def entry_of(decision: str, time_ms: int) -> Entry:
    return Entry(kind="decision", time_ms=time_ms, decision=decision, open={})


def outcome(ledger: Ledger) -> int:
    def job(act: Transaction) -> int:
        made = Entry(kind="outcome", time_ms=act.now.utc_ms, decision="succeeded", open={})
        return act.record(made)

    return ledger.run(job, essential=True)


def rows_of(ledger: Ledger) -> tuple[LogRow, ...]:
    return tuple(LogRow(*row) for row in ledger.run(lambda act: act.rows(0, 1_000_000)))


def records(ledger: Ledger) -> list[dict[str, Any]]:
    rows = rows_of(ledger)
    assert verify_rows(rows, terminal=None).whole
    return [plain(row) for row in rows]


def plain(row: LogRow) -> dict[str, Any]:
    record = json.loads(row.record)
    sealed = {name: item["value"] for name, item in json.loads(row.sealed).items()}
    return {**record["link"], "kind": record["kind"], **record["open"], "sealed": sealed}


def decisions(ledger: Ledger) -> list[str]:
    return [record["decision"] for record in records(ledger)]


def notes(ledger: Ledger) -> list[object]:
    return [record["note"] for record in records(ledger) if "note" in record]


# an act that changes nothing


def test_a_turn_that_holds_and_records_nothing_writes_nothing(
    make: Make, disk: Disk, clock: SetClock
) -> None:
    ledger = make()
    accept(ledger)
    high = ledger.run(lambda act: act.get("clock", "high"))
    before = (disk.synced, disk.written)
    clock.pause(5_000)
    for _ in range(10):
        assert ledger.run(lambda act: act.head())[0] == 2
        assert ledger.run(lambda act: act.get("clock", "high")) == high
    assert (disk.synced, disk.written) == before


def test_the_time_of_an_act_that_wrote_nothing_does_not_come_again(
    make: Make, clock: SetClock
) -> None:
    ledger = make()
    clock.pause(60_000)
    ledger.run(lambda act: act.now)
    clock.pause(-LIMITS.skew_ms - 1)
    with pytest.raises(ClockError):
        ledger.now()


# one by one


@pytest.mark.parametrize("store", ["memory", "sqlite"])
def test_without_a_policy_each_refusal_is_a_record_with_its_number_at_once(
    store: str, path: Path, clock: SetClock
) -> None:
    made = MemoryStore() if store == "memory" else open_store(path)
    ledger = ledger_on(made, clock, RefusalPolicy())
    assert [refuse(ledger, n) for n in range(3)] == [1, 2, 3]
    assert ledger.refuse(lambda at: refusal(at, 3), dedup_key=FOLD) == 4
    assert notes(ledger) == [0, 1, 2, 3]
    ledger.flush()
    ledger.close()


def test_without_a_policy_a_refusal_is_on_disk_before_it_is_answered(
    make: Make, disk: Disk
) -> None:
    ledger = make(RefusalPolicy())
    for _ in range(3):
        before = disk.synced
        refuse(ledger)
        assert disk.synced == before + 1


def test_without_a_policy_a_refusal_that_cannot_be_recorded_says_so(make: Make, disk: Disk) -> None:
    ledger = make(RefusalPolicy())
    disk.is_full = lambda: True
    with pytest.raises(StoreError):
        refuse(ledger)
    with pytest.raises(StoreError):
        ledger.refuse(refusal, dedup_key=FOLD)
    disk.is_full = lambda: False
    assert refuse(ledger, "later") == 1
    assert notes(ledger) == ["later"]


def test_repeats_can_be_counted_while_nothing_waits(make: Make, clock: SetClock) -> None:
    ledger = make(RefusalPolicy(fold_ms=1_000))
    assert refuse(ledger, 0) == 1
    assert [refuse(ledger, n) for n in (1, 2)] == [None, None]
    other = ("planner-2", *FOLD[1:])
    assert ledger.refuse(lambda at: refusal(at, "other"), dedup_key=other) == 2
    assert ledger.refuse(lambda at: refusal(at, "again"), dedup_key=other) is None
    clock.pause(1_000)
    ledger.flush()
    assert notes(ledger) == [0, "other"]
    assert [record["repeats"] for record in records(ledger)[3:]] == [2, 1]


# waiting for somebody else's fsync


def test_a_refusal_that_waits_costs_no_fsync_and_is_written_by_the_flush(
    make: Make, disk: Disk, clock: SetClock
) -> None:
    ledger = make()
    before = (disk.synced, disk.written)
    assert refuse(ledger, "act") is None
    clock.pause(40)
    assert ledger.refuse(lambda at: refusal(at, "note"), dedup_key=("p", "r", "f")) is None
    assert (disk.synced, disk.written) == before
    clock.pause(40)
    ledger.flush()
    assert disk.synced == before[0] + 1
    ledger.flush()
    assert disk.synced == before[0] + 1
    assert [(record["note"], record["time_ms"]) for record in records(ledger)[1:]] == [
        ("act", START_MS),  # the time of the decision, not of the flush
        ("note", START_MS + 40),
    ]


def test_the_log_is_in_the_order_of_the_decisions(make: Make) -> None:
    ledger = make()
    for n in range(3):
        refuse(ledger, n, (f"client-{n}", "r", "f"))
    assert accept(ledger) == 4
    refuse(ledger, 3, ("client-3", "r", "f"))
    ledger.refuse(lambda at: refusal(at, 4), dedup_key=("client-4", "r", "f"))
    assert ledger.note(lambda at: entry_of("stop", at), essential=True) == 7
    expected = ["genesis", "reject", "reject", "reject", "accept", "reject", "reject", "stop"]
    assert decisions(ledger) == expected
    assert notes(ledger) == [0, 1, 2, 3, 4]
    times = [record["time_ms"] for record in records(ledger)]
    assert times == sorted(times)


def test_an_accept_in_front_of_which_a_thousand_refusals_wait_is_one_fsync(
    make: Make, disk: Disk
) -> None:
    ledger = make()
    for client, n in itertools.product(range(10), range(100)):
        refuse(ledger, n, (f"client-{client}", "r", f"f-{n}"))
    before = disk.synced
    assert accept(ledger) == 1_001
    assert disk.synced == before + 1
    assert len(notes(ledger)) == 1_000


def test_a_refusal_that_changes_something_is_recorded_with_the_change(
    make: Make, disk: Disk
) -> None:
    ledger = make()

    def job(act: Transaction) -> int | None:
        act.put("standing", "m", b"expired")
        return act.refuse(refusal(act.now.utc_ms, "changed"), dedup_key=FOLD)

    assert refuse(ledger, "before", ("planner-2", "r", "f")) is None
    assert [ledger.run(job), ledger.run(job)] == [2, 3]
    assert notes(ledger) == ["before", "changed", "changed"]
    assert refuse(ledger, "repeat") is None  # of one that is in the log already
    ledger.flush()
    assert notes(ledger) == ["before", "changed", "changed"]


def test_an_act_that_fails_loses_no_refusal_that_waited_and_leaves_none_of_its_own(
    make: Make,
) -> None:
    ledger = make()
    refuse(ledger, "waits")

    def job(act: Transaction) -> None:
        act.refuse(refusal(act.now.utc_ms, "undone"), dedup_key=("planner-2", "r", "f"))
        act.record(entry_of("accept", act.now.utc_ms))
        raise RefusedError("no", reason=Reason.ROLE_DENIED)

    with pytest.raises(RefusedError):
        ledger.run(job)
    assert decisions(ledger) == ["genesis"]
    ledger.flush()
    assert notes(ledger) == ["waits"]


def test_a_refusal_that_cannot_be_spelled_is_in_nobody_elses_way(make: Make) -> None:
    ledger = make()
    for dedup_key in (FOLD, FOLD):
        with pytest.raises(UnicodeEncodeError):
            refuse(ledger, "\ud800", dedup_key)
    refuse(ledger, "good")
    accept(ledger)
    assert decisions(ledger) == ["genesis", "reject", "accept"]


def test_a_mark_is_on_every_record_also_on_one_that_waited(clock: SetClock) -> None:
    marked = Ledger(
        MemoryStore(),
        clock,
        robot=RID,
        salts=os.urandom,
        genesis={},
        refusals=GATE,
        marks={"mode": "shadow"},
    )
    for n in range(2):
        refuse(marked, n)
    accept(marked)
    clock.pause(GATE.fold_ms)
    marked.flush()
    assert decisions(marked) == ["genesis", "reject", "accept", "counted"]
    assert {record["mode"] for record in records(marked)} == {"shadow"}


def test_a_flush_that_cannot_be_written_is_tried_again_in_the_same_order(
    make: Make, disk: Disk
) -> None:
    ledger = make()
    for n in range(5):
        refuse(ledger, n, (f"client-{n}", "r", "f"))
    disk.is_full = lambda: True
    for _ in range(2):
        with pytest.raises(StoreError):
            ledger.flush()
    with pytest.raises(StoreError):
        accept(ledger)
    refuse(ledger, 5, ("client-5", "r", "f"))  # nobody is told of a disk that he does not need
    disk.is_full = lambda: False
    ledger.flush()
    assert notes(ledger) == [0, 1, 2, 3, 4, 5]


def test_a_flush_keeps_time_and_snapshot_that_only_refusals_saw(
    make: Make, path: Path, clock: SetClock
) -> None:
    ledger = make()
    ledger.snapshot = (7, 9)
    clock.pause(60_000)
    refuse(ledger)
    ledger.flush()
    ledger.close()
    held = read_held(path, "clock", "high")
    assert held is not None
    assert decode(held, ClockWatermark) == ClockWatermark(
        utc_ms=START_MS + 60_000, mono_ms=60_000, snapshot=(7, 9)
    )


def test_a_flush_does_not_turn_the_committed_time_back(make: Make, clock: SetClock) -> None:
    ledger = make()
    clock.pause(1_000)
    accept(ledger)
    high = ledger.run(lambda act: act.get("clock", "high"))
    ledger.refuse(refusal, dedup_key=FOLD)
    ledger.flush()
    assert ledger.run(lambda act: act.get("clock", "high")) == high


# counting repeats


def test_a_hundred_thousand_repeats_are_two_records_and_two_fsyncs(
    make: Make, disk: Disk, clock: SetClock
) -> None:
    ledger = make()
    before = (disk.synced, disk.written)
    digest = sha256(Tag.RAW.prefix)
    for n in range(100_000):
        assert ledger.refuse(lambda at, n=n: refusal(at, n), dedup_key=FOLD) is None
        if n:
            digest.update(encode_fast(refusal(clock.wall_ms(), n)))
        if n % 10_000 == 0:
            clock.pause(100)
            ledger.flush()
    last_ms = clock.wall_ms()
    clock.pause(GATE.fold_ms)
    ledger.flush()
    assert disk.synced - before[0] == 2
    assert disk.written - before[1] < 100_000
    _, first, counted = records(ledger)
    assert first["note"] == 0
    assert (counted["kind"], counted["decision"]) == ("refusal", "counted")
    assert (counted["client"], counted["reasons"]) == (FOLD[0], [FOLD[1]])
    assert (counted["repeats"], counted["cause"]) == (99_999, "repeated")
    assert (counted["first_ms"], counted["last_ms"]) == (START_MS + 100, last_ms)
    # who kept the proposals can show that these very ones were refused
    assert counted["sealed"] == {"where": FOLD[2], "entries": b64(digest.digest())}


def test_a_window_ends_and_the_next_refusal_is_a_record_again(make: Make, clock: SetClock) -> None:
    ledger = make()
    for n in range(3):
        refuse(ledger, n)
    clock.pause(GATE.fold_ms - 1)
    ledger.flush()
    assert notes(ledger) == [0]
    refuse(ledger, 3)
    clock.pause(1)
    ledger.flush()
    refuse(ledger, 4)
    ledger.flush()
    clock.pause(GATE.fold_ms)
    ledger.flush()  # a window in which nothing came again leaves no record
    kept = records(ledger)[1:]
    assert [record.get("note", record.get("repeats")) for record in kept] == [0, 3, 4]


@pytest.mark.parametrize(
    "other",
    [
        ("planner-2", FOLD[1], FOLD[2]),
        (FOLD[0], Reason.ROLE_DENIED, FOLD[2]),
        (FOLD[0], FOLD[1], "action.source"),
    ],
    ids=["client", "reason", "place"],
)
def test_what_differs_in_client_reason_or_place_is_no_repeat(
    make: Make, other: tuple[str, str, str]
) -> None:
    ledger = make()
    refuse(ledger, "one")
    refuse(ledger, "other", other)
    ledger.flush()
    assert notes(ledger) == ["one", "other"]


def test_a_clean_stop_writes_what_waits_and_every_count(make: Make, path: Path) -> None:
    ledger = make()
    for client in range(LIMITS.ended_windows + 10):
        for n in range(3):
            refuse(ledger, n, (f"client-{client}", "r", "f"))
    ledger.close()
    kept = [plain(row) for row in read_rows(path)][1:]
    assert [record["repeats"] for record in kept if "repeats" in record] == [2] * (
        LIMITS.ended_windows + 10
    )
    assert len(kept) == 2 * (LIMITS.ended_windows + 10)
    assert verify_rows(read_rows(path), terminal=None).whole


def test_a_stop_that_cannot_write_still_lets_go_of_the_store(
    make: Make, disk: Disk, path: Path
) -> None:
    ledger = make()
    refuse(ledger)
    disk.is_full = lambda: True
    ledger.close()
    ledger.close()
    assert [plain(row)["kind"] for row in read_rows(path)] == ["genesis"]


def test_a_crash_loses_refusals_and_counts_since_the_flush_and_nothing_else(
    make: Make, path: Path, tmp_path: Path
) -> None:
    ledger = make()
    refuse(ledger, "flushed")
    ledger.flush()
    refuse(ledger, "counted only")
    refuse(ledger, "in front of the accept", ("planner-2", "r", "f"))
    accept(ledger)
    outcome(ledger)
    ledger.note(lambda at: entry_of("stop", at))
    refuse(ledger, "lost", ("planner-3", "r", "f"))
    cut = tmp_path / "cut"
    cut.mkdir()
    for file in (path, path.with_name("store.db-wal")):
        shutil.copy(file, cut)  # the plug is pulled here
    again = ledger_on(open_store(cut / "store.db"), SetClock())
    assert decisions(again) == ["genesis", "reject", "reject", "accept", "succeeded", "stop"]
    assert notes(again) == ["flushed", "in front of the accept"]
    assert again.run(lambda act: act.get("standing", "m")) is not None
    again.close()


# memory


def refusals(policy: RefusalPolicy = GATE, *, room: bool = True) -> Refusals:
    return Refusals(policy, restore=lambda: room, mono_ms=lambda: 0)


def test_a_client_that_is_refused_in_ever_new_ways_takes_nobody_elses_place(
    make: Make,
) -> None:
    ledger = make()
    for n in range(1_000):
        refuse(ledger, n, ("flooder", "r", f"place-{n}"))
    refuse(ledger, "quiet", ("quiet", "r", "f"))
    refuse(ledger, "star", ("flooder", "s", "f"))
    ledger.flush()
    assert notes(ledger) == [*range(LIMITS.windows_of_client), "quiet"]
    ledger.close()


def test_what_is_crowded_out_is_counted_in_its_clients_own_window(make: Make, path: Path) -> None:
    ledger = make()
    for n in range(1_000):
        refuse(ledger, n, ("flooder", f"r-{n % 2}", f"place-{n}"))
    ledger.close()
    crowd = plain(list(read_rows(path))[-1])
    assert (crowd["client"], crowd["cause"]) == ("flooder", "crowded")
    assert crowd["repeats"] == 1_000 - LIMITS.windows_of_client
    assert crowd["reasons"] == ["r-0", "r-1"]
    assert crowd["sealed"]["where"] == "*"


def test_windows_are_bounded_whoever_floods(make: Make) -> None:
    made = refusals()
    many = 3 * LIMITS.windows
    for n in range(many):
        made.take(refusal(n, n), (f"client-{n}", "r", "f"))
    assert len(made._windows) == LIMITS.windows + 1
    everybody = made._windows["*", "*", "*"]
    assert everybody.repeats == many - LIMITS.windows
    made.take(refusal(0, 0), ("client-0", "r", "f"))
    assert made._windows["client-0", "r", "f"].repeats == 1
    assert made.end_windows(0, everything=True)
    assert not made._windows
    assert not made._of_client


def test_one_user_with_many_names_takes_no_other_users_place(make: Make) -> None:
    made = refusals()
    for n in range(LIMITS.windows_of_client + 1):  # one name of his is crowded in its own right
        made.take(refusal(n, n), ("u7.first", "r", f"place-{n}"))
    many = 3 * MOST_OF_USER
    for n in range(many):
        made.take(refusal(n, n), (f"u7.w{n}", "r", "f"))
    theirs = [key for key in made._windows if key[0].partition(".")[0] == "u7"]
    assert len(theirs) == MOST_OF_USER + 1  # the one more counts what was crowded out
    crowd = made._windows["u7", "*", "*"]
    assert crowd.cause == "crowded"
    assert crowd.repeats == many + 1 + LIMITS.windows_of_client - MOST_OF_USER
    made.take(refusal(0, 0), ("u7.first", "r", "one more"))
    assert made._windows["u7.first", "*", "*"].repeats == 2  # its own, as long as there is one
    waiting = len(made._waiting)
    for name in ("u8.p", "u70.p"):
        made.take(refusal(0, name), (name, "r", "f"))
    assert len(made._waiting) == waiting + 2  # each a record of its own
    assert made.end_windows(0, everything=True)
    assert not made._windows
    assert not made._of_user


@pytest.mark.parametrize("users", [1, 2, 5])
def test_no_number_of_users_takes_away_the_share_of_another(users: int) -> None:
    policy = msgspec.structs.replace(GATE, users=users)
    made = Refusals(policy, restore=lambda: True, mono_ms=lambda: 0)
    for user, n in itertools.product(range(users), range(2 * LIMITS.windows)):
        made.take(refusal(n, n), (f"u{user}.w{n}", "r", "f"))
    made.take_waiting()
    for n in range(policy.most_of_user - users):
        made.take(refusal(n, n), (f"u99.w{n}", "r", "f"))
    assert len(made._waiting) == policy.most_of_user - users  # each a record of its own


def test_what_one_user_crowds_out_is_one_record_of_that_user(make: Make, path: Path) -> None:
    ledger = make()
    for n in range(1_000):
        refuse(ledger, n, (f"u7.w{n}", "r", "f"))
    refuse(ledger, "other", ("u8.p", "r", "f"))
    ledger.flush()
    assert notes(ledger) == [*range(MOST_OF_USER), "other"]
    ledger.close()
    crowd = plain(list(read_rows(path))[-1])
    assert (crowd["client"], crowd["cause"]) == ("u7", "crowded")
    assert crowd["repeats"] == 1_000 - MOST_OF_USER


def test_a_flush_ends_a_bounded_number_of_windows(make: Make, clock: SetClock) -> None:
    ledger = make()
    for client, n in itertools.product(range(LIMITS.ended_windows + 10), range(2)):
        refuse(ledger, n, (f"client-{client}", "r", "f"))
    ledger.flush()
    clock.pause(GATE.fold_ms)
    for expected in (LIMITS.ended_windows, LIMITS.ended_windows + 10):
        ledger.flush()
        assert decisions(ledger).count("counted") == expected


@pytest.mark.parametrize("fold_ms", [0, 60_000])
def test_more_than_may_wait_are_counted_even_when_they_are_the_first(fold_ms: int) -> None:
    made = refusals(RefusalPolicy(delay_ms=100, fold_ms=fold_ms))
    for n in range(LIMITS.waiting_refusals):
        client = f"client-{n // 100}"
        made.take(refusal(n, n), (client, "r", f"f-{n}"))
    made._windows.clear()
    for n in range(5):
        made.take(refusal(n, n), ("late", "r", f"f-{n}"))
    assert len(made._waiting) == LIMITS.waiting_refusals
    (window,) = made._windows.values()
    assert (window.repeats, window.cause) == (5, "crowded")


def test_a_place_of_any_length_is_one_that_is_cut() -> None:
    made = refusals()
    for n in range(3):
        made.take(refusal(n), ("client", "r", "x" * 10_000 + str(n)))
    assert len(made._waiting) == 1
    ((_, _, place),) = made._windows
    assert len(place) < 1_000


def test_what_is_given_back_waits_in_the_order_of_the_decisions() -> None:
    made = refusals()
    taken = []
    for n in range(4):
        made.take(refusal(n, n), (f"client-{n}", "r", "f"))
        if n % 2:
            taken.append(made.take_waiting())
    made.take(refusal(4, 4), ("client-4", "r", "f"))
    for part in taken:  # threads come back in any order
        made.give_back(part)
    assert [waiting.entry.open["note"] for waiting in made.take_waiting()] == [0, 1, 2, 3, 4]
    assert made.take_waiting() == []


def test_the_disk_is_asked_for_room_at_most_once_a_second() -> None:
    clock, asked = SetClock(), list[int]()

    def restore() -> bool:
        asked.append(clock.ms)
        return False

    made = Refusals(GATE, restore=restore, mono_ms=clock.mono_ms)
    for _ in range(61):
        made.may_write()
        clock.pause(50)
    assert asked == [0, 1_000, 2_000, 3_000]


# a full disk


class Full:
    """A store with a reserve on a disk that can be filled."""

    def __init__(self, folder: Path, disk: Disk | None) -> None:
        self.folder = folder
        self.path = folder / "store.db"
        self.ballast = folder / "store.db.reserve"
        self.filler = folder / "filler"
        self.disk = disk
        self.free: int | None = None
        self.clock = SetClock()

    def ledger(self, policy: RefusalPolicy = GATE) -> Ledger:
        vfs = None if self.disk is None else self.disk.name
        store = open_store(self.path, reserve_bytes=RESERVE, vfs=vfs)
        return ledger_on(store, self.clock, policy)

    def fill(self, left: int = 0) -> None:
        """Let somebody else take all of the disk but for that many bytes."""
        if self.disk is not None:
            self.free = left
            # what the ballast took is there for the log once it is gone
            self.disk.is_full = self.disk.is_full if left else self.ballast.exists
            return
        found = os.statvfs(self.folder)
        with self.filler.open("ab") as file:
            room = found.f_bavail * found.f_frsize - left
            os.posix_fallocate(file.fileno(), self.filler.stat().st_size, room)

    def fill_rest(self, ledger: Ledger) -> None:
        """Fill the disk, and the pages that the log has already."""
        self.fill()

        def until_full() -> None:
            for _ in range(100_000):
                accept(ledger)

        with pytest.raises(StoreError) as refused:
            until_full()
        assert refused.value.reason is Reason.STORE_FULL

    def mend(self) -> None:
        if self.disk is not None:
            self.free = None
            self.disk.is_full = lambda: False
        self.filler.unlink(missing_ok=True)
        self.clock.pause(1_000)


def mounted(folder: Path) -> str:
    """Mount a small file system in memory; return why not."""
    if not sys.platform.startswith("linux") or os.geteuid() != 0:
        return "only root may mount"
    command = ["mount", "-t", "tmpfs", "-o", "size=8m", "tmpfs", str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return "" if done.returncode == 0 else f"mount: {done.stderr.strip()}"


@pytest.fixture(params=["fault", "disk"])
def full(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Full]:
    """A disk that is really full, and everywhere else one that says so."""
    if request.param == "fault":
        disk = Disk()
        made = Full(tmp_path, disk)
        statvfs = os.statvfs

        def asked(folder: Any) -> Any:
            return statvfs(folder) if made.free is None else Free(made.free)

        monkeypatch.setattr(os, "statvfs", asked)
        yield made
        disk.is_full = lambda: False
        disk.unregister()
        return
    folder = tmp_path / "disk"
    folder.mkdir()
    why_not = mounted(folder)
    if why_not:
        pytest.skip(why_not)
    try:
        yield Full(folder, None)
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


class Free(msgspec.Struct):
    f_bavail: int
    f_frsize: int = 1


def test_an_outcome_is_written_on_a_full_disk_and_a_release_is_not(full: Full) -> None:
    ledger = full.ledger()
    accept(ledger)
    full.fill_rest(ledger)
    assert full.ballast.exists()  # a release does not get at it
    before = decisions(ledger)
    assert outcome(ledger) == len(before)
    assert not full.ballast.exists()
    with pytest.raises(StoreError) as refused:
        accept(ledger)  # although there is room now: it is not for him
    assert refused.value.reason is Reason.STORE_FULL
    ledger.note(lambda at: entry_of("stop", at), essential=True)
    accept(ledger, essential=True)
    assert decisions(ledger) == [*before, "succeeded", "stop", "accept"]
    # what only reads is nobody's burden
    assert ledger.run(lambda act: act.get("standing", "m")) is not None
    ledger.close()


def test_after_there_is_room_again_everything_goes_on(full: Full) -> None:
    ledger = full.ledger()
    full.fill_rest(ledger)
    outcome(ledger)
    full.mend()
    ledger.flush()
    assert full.ballast.stat().st_size == RESERVE
    size = len(decisions(ledger))
    assert accept(ledger) == size
    assert outcome(ledger) == size + 1
    assert full.ballast.exists()
    ledger.close()
    assert verify_rows(read_rows(full.path), terminal=None).whole


def test_refusals_are_the_first_to_go_and_one_record_says_how_many(full: Full) -> None:
    ledger = full.ledger()
    refuse(ledger, "before", ("planner-0", "r", "f"))
    full.fill_rest(ledger)
    outcome(ledger)
    full.clock.pause(1)
    before = len(decisions(ledger))
    for n in range(500):
        assert refuse(ledger, n, (f"planner-{n}", f"r-{n % 2}", "f")) is None
    ledger.flush()
    outcome(ledger)
    assert len(decisions(ledger)) == before + 1
    full.mend()
    ledger.flush()
    refuse(ledger, "after", ("planner-1", "r", "f"))
    ledger.flush()
    *_, counted, after = records(ledger)
    assert (counted["client"], counted["cause"], counted["repeats"]) == ("*", "no room", 500)
    assert counted["reasons"] == ["r-0", "r-1"]
    assert after["note"] == "after"
    ledger.close()
    assert verify_rows(read_rows(full.path), terminal=None).whole


def test_an_outcome_on_a_full_disk_leaves_the_refusals_that_waited_behind(full: Full) -> None:
    ledger = full.ledger()
    full.fill_rest(ledger)
    full.clock.pause(-1)  # the disk was asked just now, and still had room
    ledger.refusals._has_room, ledger.refusals._looked_ms = True, full.clock.ms
    for n in range(200):
        refuse(ledger, n, (f"planner-{n}", "r", "f"))
    before = decisions(ledger)
    assert outcome(ledger) == len(before)
    assert decisions(ledger) == [*before, "succeeded"]
    full.mend()
    ledger.flush()
    assert notes(ledger) == list(range(200))
    ledger.close()


def test_a_gate_that_starts_on_a_full_disk_takes_orders_and_releases_nothing(full: Full) -> None:
    ledger = full.ledger()
    full.fill_rest(ledger)
    outcome(ledger)
    ledger.close()
    full.fill(left=RESERVE // 4)  # closing the log gave something back
    again = full.ledger()
    with pytest.raises(StoreError):
        accept(again)
    outcome(again)
    full.mend()
    again.flush()  # nothing waits: room is asked for all the same
    accept(again)
    again.close()


def test_while_less_than_the_reserve_is_free_refusals_are_only_counted(full: Full) -> None:
    """Accepts go on: it is the refusals that stay below the mark."""
    ledger = full.ledger()
    accept(ledger)
    full.fill(left=RESERVE // 2)
    full.clock.pause(1_000)
    before = len(decisions(ledger))
    assert [refuse(ledger, n) for n in range(3)] == [None] * 3
    ledger.flush()
    accept(ledger)
    assert len(decisions(ledger)) == before + 1
    assert full.ballast.exists()
    full.mend()
    ledger.flush()
    assert records(ledger)[-1]["repeats"] == 3
    ledger.close()


def test_one_by_one_refusals_are_counted_too_while_there_is_no_room(full: Full) -> None:
    ledger = full.ledger(RefusalPolicy())
    full.fill_rest(ledger)
    outcome(ledger)
    assert refuse(ledger) is None
    assert ledger.refuse(refusal, dedup_key=FOLD) is None
    full.mend()
    ledger.flush()
    assert records(ledger)[-1]["repeats"] == 2
    assert refuse(ledger, "after") is not None
    ledger.close()


def test_an_outcome_that_has_no_room_even_so_is_not_taken_for_written(
    make: Make, disk: Disk, path: Path
) -> None:
    ledger = make(reserve_bytes=RESERVE)
    disk.is_full = lambda: True
    for _ in range(2):
        with pytest.raises(StoreError) as refused:
            outcome(ledger)
        assert refused.value.reason is Reason.STORE_FULL
    disk.is_full = lambda: False
    assert outcome(ledger) == 1


def test_without_a_reserve_a_full_disk_refuses_everything(make: Make, disk: Disk) -> None:
    ledger = make()
    disk.is_full = lambda: True
    with pytest.raises(StoreError):
        outcome(ledger)
    disk.is_full = lambda: False
    assert accept(ledger) == 1


# the ballast


def test_the_reserve_is_really_allocated_and_nobody_elses(path: Path) -> None:
    store = open_store(path, reserve_bytes=RESERVE)
    found = path.with_name("store.db.reserve").stat()
    assert found.st_size == RESERVE
    assert found.st_blocks * 512 >= RESERVE
    assert stat.S_IMODE(found.st_mode) == 0o600
    assert store.restore()
    store.close()
    assert path.with_name("store.db.reserve").exists()  # for the next start


def test_a_store_without_a_reserve_leaves_no_file(path: Path) -> None:
    store = open_store(path)
    assert store.restore()
    store.close()
    assert not path.with_name("store.db.reserve").exists()


def test_the_reserve_of_the_last_run_is_taken_over_without_free_room(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert not Reserve(path, RESERVE).is_gone
    monkeypatch.setattr(os, "statvfs", lambda _: Free(0))
    again = Reserve(path, RESERVE)
    assert not again.is_gone
    assert not again.restore()  # there is no room beside it


@pytest.mark.parametrize("left", ["hole", "half", "link", "folder"])
def test_what_only_looks_like_a_reserve_is_none(path: Path, left: str) -> None:
    ballast, target = path.with_name("store.db.reserve"), path.with_name("precious")
    target.write_bytes(b"precious")
    if left == "hole":
        ballast.touch()
        os.truncate(ballast, RESERVE)
    elif left == "half":
        ballast.write_bytes(bytes(RESERVE // 2))
    elif left == "link":
        ballast.symlink_to(target)
    else:
        ballast.mkdir()
    reserve = Reserve(path, RESERVE)
    assert target.read_bytes() == b"precious"
    if left == "folder":  # nobody can unlink it: there is no reserve, and nothing is released
        assert reserve.is_gone
        return
    assert not reserve.is_gone
    assert ballast.lstat().st_blocks * 512 >= RESERVE


def test_a_reserve_that_was_not_got_whole_leaves_nothing_behind(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(handle: int, offset: int, size: int) -> None:
        os.write(handle, b"part")
        raise OSError(28, "no space left")

    monkeypatch.setattr(os, "posix_fallocate", full)
    reserve = Reserve(path, RESERVE)
    assert reserve.is_gone
    assert not path.with_name("store.db.reserve").exists()
    monkeypatch.undo()
    assert reserve.restore()
    assert not reserve.is_gone


def test_a_store_that_somebody_else_holds_keeps_its_reserve(path: Path) -> None:
    held: SqliteStore = open_store(path, reserve_bytes=RESERVE)
    inode = path.with_name("store.db.reserve").stat().st_ino
    with pytest.raises(StoreError):
        open_store(path, reserve_bytes=2 * RESERVE)
    assert path.with_name("store.db.reserve").stat().st_ino == inode
    held.close()
