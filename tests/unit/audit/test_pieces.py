# SPDX-License-Identifier: Apache-2.0
"""Several processes say of a log what one says, word for word; and one that died says nothing.

Most helpers here are threads that speak through the same sockets, so that many can be tried.
Source: docs/spec/audit-record.md#verification
"""

from __future__ import annotations

import os
import signal
import socket
import threading
from collections.abc import Callable, Iterable, Iterator
from multiprocessing.connection import Connection
from random import Random
from typing import Any

import msgspec
import pytest

from authguard_r.audit import parallel
from authguard_r.audit.record import LogRow, Terminal
from authguard_r.audit.tree import leaf_hash
from authguard_r.audit.verify import (
    Anchor,
    LogVerifier,
    Piece,
    Verification,
    of_checkpoint,
    verify_piece,
    verify_rows,
)
from authguard_r.core.encoding import b64
from authguard_r.core.errors import AuthGuardError, EnvironmentFault, MalformedError
from authguard_r.core.identifiers import Digest
from authguard_r.core.reasons import Reason
from fixtures.small_logs import ROBOT, checkpoint_of, edited, entry, log_of, rechained
from fixtures.tampering import changed_rows

SIZE = 300
ROWS = log_of(SIZE)
ROUNDS = 400
set_ = msgspec.structs.replace
#: Kept before anything is put in its place.
REAL = parallel._Helper
Started = list[parallel._Helper]


class Threaded(REAL):
    """A helper that is a thread: the same line, and the same words on it."""

    def __init__(self) -> None:
        self._given = None
        self.is_free = False
        ours, theirs = socket.socketpair()
        self.line = Connection(ours.detach())
        self.thread = threading.Thread(target=parallel.serve, args=(theirs.detach(),))
        self.thread.start()

    def close(self) -> None:
        self.line.close()
        self.thread.join()


@pytest.fixture
def threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "_Helper", Threaded)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    def make(rows: int = 16, own: int = 4, most: int = 1 << 21, kept: int = 1 << 24) -> None:
        monkeypatch.setattr(parallel, "_ROWS", rows)
        monkeypatch.setattr(parallel, "_OWN_ROWS", own)
        monkeypatch.setattr(parallel, "_BYTES", most)
        monkeypatch.setattr(parallel, "_KEPT_BYTES", kept)

    make()
    return make


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> Started:
    """Every real process that was started."""
    found: Started = []

    class Seen(REAL):
        def __init__(self) -> None:
            super().__init__()
            found.append(self)

    monkeypatch.setattr(parallel, "_Helper", Seen)
    return found


def checkpoint(size: int, rows: list[LogRow] = ROWS, *, witnessed: bool = False) -> Anchor:
    return of_checkpoint(checkpoint_of(rows[:size]), witnessed=witnessed)


def alike(rows: list[LogRow], *anchors: Anchor, jobs: int = 2, alone: int = 0) -> Verification:
    found = parallel.verify_in_pieces(iter(rows), jobs=jobs, anchors=anchors, alone=alone)
    assert found == verify_rows(rows, anchors=anchors)
    return found


# a piece


def test_a_piece_holds_what_the_log_needs_of_its_rows_and_nothing_of_those_before() -> None:
    made = verify_piece(ROWS[5:12], 5, with_tree=True)
    assert made is not None
    assert (made.first, made.prev, made.size) == (5, b64(ROWS[4].link), 12)
    assert made.link == ROWS[11].link
    assert [level for level, _ in made.subtrees] == [0, 1, 2]
    plain = verify_piece(ROWS[5:12], 5, with_tree=False)
    assert plain == set_(made, subtrees=())


def test_rows_that_are_no_piece_are_none() -> None:
    for rows, first in (
        (ROWS[5:9], 4),
        ([ROWS[5], ROWS[7]], 5),
        ([edited(ROWS[5], open={}), ROWS[6]], 5),
        ([ROWS[5], edited(ROWS[6], time_ms=1)], 5),
        ([set_(ROWS[5], record=b"{")], 5),
    ):
        assert verify_piece(rows, first, with_tree=True) is None


def test_pieces_of_every_length_at_every_place_have_the_root_of_their_log() -> None:
    for cut in range(1, 70):
        for end in (cut + 1, cut + 6, 64, 70, 130):
            if end <= cut:
                continue
            verifier = LogVerifier(anchors=(checkpoint(end),))
            for first, last in ((0, cut), (cut, end)):
                piece = verify_piece(ROWS[first:last], first, with_tree=True)
                assert piece is not None
                assert verifier.join(piece)
            assert verifier.finish(()) == verify_rows(ROWS[:end], anchors=(checkpoint(end),))


def test_a_piece_that_does_not_follow_is_not_joined() -> None:
    other = log_of(20, lambda n: set_(entry(n), time_ms=n))
    for rows, first in ((other[8:16], 8), (ROWS[9:16], 9), (ROWS[7:16], 7)):
        verifier = LogVerifier()
        assert verifier.join(piece_of(ROWS[:8], 0))
        assert not verifier.join(piece_of(rows, first))
        # and nothing of it was taken in
        assert verifier.finish(ROWS[8:]).size == SIZE


def test_a_first_piece_has_to_begin_where_a_log_does() -> None:
    assert not LogVerifier().join(piece_of(ROWS[1:9], 1))
    forged = set_(piece_of(ROWS[:9], 0), prev=b64(bytes(31) + b"\1"))
    assert not LogVerifier().join(forged)


def test_a_piece_never_passes_a_size_at_which_something_is_known() -> None:
    verifier = LogVerifier(anchors=(checkpoint(5),))
    assert verifier.cuts == (5,)
    assert not verifier.join(piece_of(ROWS[:9], 0))
    assert verifier.finish(ROWS[:9]).anchored_size == 5


def test_after_a_checkpoint_that_does_not_fit_nothing_is_joined() -> None:
    lying = set_(checkpoint(5), head=bytes(32))
    verifier = LogVerifier(anchors=(lying, checkpoint(9)))
    assert not verifier.join(piece_of(ROWS[:5], 0))
    assert not verifier.join(piece_of(ROWS[5:9], 5))
    assert verifier.finish(ROWS) == verify_rows(ROWS, anchors=(lying, checkpoint(9)))
    nothing = Anchor(by="checkpoint", size=0, root=bytes(32))
    verifier = LogVerifier(anchors=(nothing,))
    assert not verifier.join(piece_of(ROWS[:5], 0))
    assert verifier.finish(ROWS) == verify_rows(ROWS, anchors=(nothing,))


def test_a_root_over_pieces_whose_subtrees_nobody_made_does_not_fit() -> None:
    verifier = LogVerifier(anchors=(checkpoint(9),))
    piece = verify_piece(ROWS[:9], 0, with_tree=False)
    assert piece is not None
    assert not verifier.join(piece)
    assert "signed root" in verifier.finish(()).fault


def piece_of(rows: list[LogRow], first: int) -> Piece:
    made = verify_piece(rows, first, with_tree=True)
    assert made is not None
    return made


# together


@pytest.mark.usefixtures("threads", "small")
def test_a_whole_log_is_told_alike_with_every_kind_of_anchor() -> None:
    terminal = Terminal(log=ROBOT, size=77, head=Digest(b64(ROWS[76].link)), time_ms=1)
    for jobs in (1, 2, 3, 5):
        assert alike(ROWS, jobs=jobs).whole
        assert alike([], jobs=jobs).size == 0
        several = (checkpoint(0), checkpoint(7), checkpoint(64), checkpoint(65), checkpoint(SIZE))
        assert alike(ROWS, *several, jobs=jobs).anchored_size == SIZE
        assert alike(ROWS, checkpoint(64), checkpoint(64, witnessed=True), jobs=jobs).whole
        assert not alike(ROWS, checkpoint(64), _beyond(), jobs=jobs).whole
        found = parallel.verify_in_pieces(ROWS, jobs=jobs, terminal=terminal, alone=0)
        assert found == verify_rows(ROWS, terminal=terminal)
    every = tuple(map(checkpoint, range(SIZE + 1)))
    assert len(alike(ROWS, *every).anchors) == SIZE + 1


def _beyond() -> Anchor:
    return Anchor(by="checkpoint", size=SIZE + 9, head=bytes(32), root=bytes(32))


@pytest.mark.usefixtures("threads")
def test_random_logs_in_random_pieces_are_told_alike(small: Callable[..., None]) -> None:
    whole = 0
    for number in range(ROUNDS):
        rnd = Random(f"pieces {number}")
        small(rnd.randrange(1, 40), rnd.randrange(1, 12), rnd.choice((1, 9_000, 1 << 21)))
        genuine = ROWS[: rnd.randrange(1, SIZE)]
        rows, done = changed_rows(rnd, list(genuine), least=0)
        sizes = [rnd.randrange(len(genuine) + 1) for _ in range(rnd.randrange(4))]
        known = [checkpoint(size, genuine) for size in sizes]
        if known and rnd.random() < 0.2:
            known[0] = set_(known[0], **{rnd.choice(("head", "root")): bytes(32)})
        if rnd.random() < 0.2:
            known = [set_(one, root=None) for one in known]
        found = parallel.verify_in_pieces(
            iter(rows), jobs=rnd.randrange(2, 4), anchors=known, alone=rnd.choice((0, 0, 50))
        )
        assert found == verify_rows(rows, anchors=known), (number, done)
        whole += found.whole
    assert ROUNDS // 10 < whole < ROUNDS - ROUNDS // 10


@pytest.mark.usefixtures("threads", "small")
def test_the_first_fault_is_told_wherever_the_others_are() -> None:
    for first in (0, 3, 15, 16, 17, 150, SIZE - 1):
        for second in (first, min(first + 1, SIZE - 1), SIZE - 1):
            rows = list(ROWS)
            rows[second] = edited(rows[second], open={"later": 1})
            rows[first] = edited(rows[first], time_ms=1)
            assert alike(rows).where == f"record {first}"
            assert alike(rows, checkpoint(SIZE), jobs=3).where == f"record {first}"


@pytest.mark.usefixtures("small")
def test_pieces_that_nobody_vouches_for_are_verified_to_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(parallel, "verify_piece", lambda *_, **__: None)
    monkeypatch.setattr(parallel, "_Helper", Threaded)
    assert alike(ROWS, checkpoint(150), checkpoint(SIZE)).whole
    assert not alike(ROWS[:200], checkpoint(150), checkpoint(SIZE)).whole
    assert alike([*ROWS[:200], edited(ROWS[200], open={})]).where == "record 200"


@pytest.mark.usefixtures("threads", "small")
def test_a_log_chained_anew_is_told_by_the_records_between_two_checkpoints() -> None:
    rows = rechained([*ROWS[:150], edited(ROWS[150], open={"x": 1}), *ROWS[151:]], 150)
    assert alike(rows).whole
    known = tuple(map(checkpoint, (40, 149, 200, SIZE)))
    assert alike(rows, *known).where == "records 149 to 199"


@pytest.mark.usefixtures("threads", "small")
def test_a_number_that_no_log_has_is_told_alike() -> None:
    for number in (1 << 70, -(1 << 70), 1 << 63, -1, 4):
        for at in (0, 99, SIZE - 1):
            rows = [set_(row, seq=number) if row.seq == at else row for row in ROWS]
            assert alike(rows).where == f"record {at}"


@pytest.mark.usefixtures("threads", "small")
def test_what_reading_raises_comes_after_a_fault_before_it_and_before_one_after_it() -> None:
    def read(rows: list[LogRow], fails_at: int, error: Exception) -> Iterator[LogRow]:
        for number, row in enumerate(rows):
            if number == fails_at:
                raise error
            yield row

    bad = [*ROWS[:120], edited(ROWS[120], open={}), *ROWS[121:]]
    for error in (MalformedError("no row", where="line 7"), OSError("the disk is gone")):
        for fails_at in (0, 16, 119, 121, 250):
            told = outcome(lambda n=fails_at, e=error: verify_rows(read(bad, n, e)))
            found = outcome(
                lambda n=fails_at, e=error: parallel.verify_in_pieces(
                    read(bad, n, e), jobs=3, alone=0
                )
            )
            assert found == told
            assert (found == (type(error), str(error))) is (fails_at <= 120)


def outcome(verify: Callable[[], Verification]) -> Any:
    try:
        return verify()
    except (AuthGuardError, OSError) as error:
        return type(error), str(error)


@pytest.mark.usefixtures("threads")
def test_no_more_than_some_pieces_are_kept_however_long_the_log_is(
    small: Callable[..., None],
) -> None:
    each = max(len(row.record) + len(row.sealed) for row in ROWS)
    small(8, 2, kept=each * 20)
    most = 0
    joined: list[int] = []

    def passing() -> Iterator[LogRow]:
        nonlocal most
        for row in ROWS:
            most = max(most, row.seq - (joined[-1] if joined else 0))
            yield row

    real = LogVerifier.join

    def join(self: LogVerifier, piece: Piece) -> bool:
        joined.append(piece.size)
        return real(self, piece)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(LogVerifier, "join", join)
        assert parallel.verify_in_pieces(passing(), jobs=3, alone=0).whole
    least = min(len(row.record) + len(row.sealed) for row in ROWS)
    assert 8 <= most <= 20 * each // least + 8
    assert joined[-1] == SIZE


def test_a_helper_answers_what_it_is_asked_until_its_line_is_closed() -> None:
    ours, theirs = socket.socketpair()
    line, got = Connection(ours.detach()), []

    def other() -> None:
        got.append(line.recv_bytes())
        for asked in (
            parallel._PieceTask(3, True, ROWS[3:9]),
            parallel._PieceTask(4, True, ROWS[3:9]),
        ):
            line.send_bytes(msgspec.msgpack.encode(asked))
            got.append(line.recv_bytes())
        line.close()

    thread = threading.Thread(target=other)
    thread.start()
    parallel.serve(theirs.detach())
    thread.join()
    assert got[0] == b""
    assert parallel._ANSWER.decode(got[1]) == verify_piece(ROWS[3:9], 3, with_tree=True)
    assert parallel._ANSWER.decode(got[2]) is None


def test_as_many_processes_as_processors_may_be_used_and_one_where_nobody_says(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for allowed, jobs in ((1, 1), (2, 2), (8, 8), (200, parallel.MOST_JOBS)):
        monkeypatch.setattr(
            os, "sched_getaffinity", lambda _, n=allowed: set(range(n)), raising=False
        )
        assert parallel.usable_jobs() == jobs
    monkeypatch.delattr(os, "sched_getaffinity")
    assert parallel.usable_jobs() == 1


# real processes


def test_processes_tell_what_one_tells(started: Started, small: Callable[..., None]) -> None:
    rows = log_of(3_000)
    bad = [*rows[:2_700], edited(rows[2_700], open={}), *rows[2_701:]]
    known = (checkpoint(1_111, rows), checkpoint(3_000, rows))
    for given in (rows, bad):
        made = helped(started, given)
        found = parallel.verify_in_pieces(made, jobs=2, anchors=known, alone=64)
        assert found == verify_rows(given, anchors=known)
    assert len(started) == 2
    assert all(helper.process.returncode is not None for helper in started)


def helped(started: Started, rows: list[LogRow]) -> Iterator[LogRow]:
    """Yield rows; from the middle on when the newest process listens, so that it has its part."""
    for row in rows:
        if row.seq == len(rows) // 2:
            wait_for(started[-1])
        yield row


def wait_for(helper: parallel._Helper) -> None:
    """Return once it has said that it listens."""
    assert helper.is_free or helper._given is not None or helper.line.poll(60)


def test_a_short_log_starts_no_process(started: Started) -> None:
    assert parallel.verify_in_pieces(ROWS, jobs=8).whole
    assert parallel.verify_in_pieces(ROWS, jobs=1, alone=0).whole
    assert started == []


def test_where_no_process_is_to_be_had_the_log_is_verified_without(
    monkeypatch: pytest.MonkeyPatch, small: Callable[..., None]
) -> None:
    def none(*_: Any, **__: Any) -> None:
        raise BlockingIOError("no more processes")

    monkeypatch.setattr("subprocess.Popen", none)
    assert alike(ROWS, checkpoint(SIZE), jobs=4).whole


def test_a_process_that_is_killed_is_an_error_and_never_a_whole_log(
    started: Started, small: Callable[..., None]
) -> None:
    """While it starts, when it listens, and with a piece that nobody else verified."""
    for kill in (killed_at_once, killed_when_it_listens, killed_at_work):
        with pytest.raises(EnvironmentFault, match="code -9") as failed:
            parallel.verify_in_pieces(kill(started), jobs=2, alone=64)
        assert failed.value.reason is Reason.INTERNAL_FAULT
        assert failed.value.where.startswith(
            "records " if kill is killed_at_work else ("the log", "records ")
        )
    assert len(started) == 3
    assert all(helper.process.returncode is not None for helper in started)


def killed_at_once(started: Started) -> Iterator[LogRow]:
    yield from ROWS[:100]
    killed(started[-1])
    yield from ROWS[100:]


def killed_when_it_listens(started: Started) -> Iterator[LogRow]:
    yield from ROWS[:100]
    wait_for(started[-1])
    killed(started[-1])
    yield from ROWS[100:]


def killed_at_work(started: Started) -> Iterator[LogRow]:
    """It is stopped before it can answer what it is asked."""
    yield from ROWS[:100]
    helper = started[-1]
    wait_for(helper)
    os.kill(helper.process.pid, signal.SIGSTOP)
    for row in ROWS[100:]:
        if helper._given is not None and not helper._given.is_answered:
            killed(helper)
        yield row


def killed(helper: parallel._Helper) -> None:
    """It is dead, and left for whoever started it."""
    os.kill(helper.process.pid, signal.SIGKILL)
    os.waitid(os.P_PID, helper.process.pid, os.WEXITED | os.WNOWAIT)


def test_a_helper_that_died_before_it_is_asked_or_answers_otherwise_names_the_records(
    small: Callable[..., None],
) -> None:
    given = parallel._Given(parallel._PieceTask(8, False, ROWS[8:16]), 1)
    dead = REAL()
    os.kill(dead.process.pid, signal.SIGKILL)
    dead.process.wait()
    with pytest.raises(EnvironmentFault) as failed:
        dead.ask(given)
    assert failed.value.where == "records 8 to 15"
    dead.close()
    other = REAL()
    other.answer()
    other.line.close()
    ours, theirs = socket.socketpair()
    other.line, liar = Connection(ours.detach()), Connection(theirs.detach())
    assert other.ask(given)
    liar.send_bytes(b"\xc1 whole")
    with pytest.raises(EnvironmentFault) as failed:
        other.answer()
    assert failed.value.where == "records 8 to 15"
    assert not given.is_answered
    other.close()
    liar.close()


def test_an_interrupt_ends_every_process(started: Started, small: Callable[..., None]) -> None:
    def interrupted() -> Iterable[LogRow]:
        yield from ROWS[:200]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        parallel.verify_in_pieces(interrupted(), jobs=4, alone=0)
    assert len(started) == 3
    assert all(helper.process.returncode is not None for helper in started)


def test_a_helper_hears_no_interrupt_of_ours_and_ends_when_we_are_gone(
    started: Started,
) -> None:
    helper = parallel._Helper()
    helper.answer()
    assert os.getsid(helper.process.pid) == helper.process.pid
    helper.line.close()
    assert helper.process.wait() == 0


def test_one_record_is_a_piece() -> None:
    single = verify_piece(ROWS[:1], 0, with_tree=True)
    assert single is not None
    assert single.subtrees == ((0, leaf_hash(ROWS[0].link)),)


# whoever is free, and when


def test_a_helper_that_is_free_when_nothing_is_left_is_given_nothing(threads: None) -> None:
    reading = parallel._Reading(iter(()), ())
    with parallel._Helpers(1) as helpers:
        helpers.start()
        (helper,) = helpers.answers(wait_for=True)
        course = parallel._Verification(reading, LogVerifier(), helpers, 0)
        course._hand_out()
        assert helper.is_free
        assert course.run() == verify_rows(())


def test_a_number_that_cannot_be_sent_leaves_a_helper_free(threads: None) -> None:
    row = set_(ROWS[0], seq=1 << 70)
    with parallel._Helpers(1) as helpers:
        helpers.start()
        (helper,) = helpers.answers(wait_for=True)
        given = parallel._Given(parallel._PieceTask(0, False, [row]), 0)
        assert (helper.ask(given), helper.is_free, given.is_answered) == (False, True, False)
