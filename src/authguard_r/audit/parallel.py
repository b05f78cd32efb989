# SPDX-License-Identifier: Apache-2.0
"""A long log is verified by several processes, a piece at a time each.

One process reads the rows, once and in order, as `verify_rows` does; it hands pieces of them to
others, verifies some itself, and joins each when its turn comes. Each worker finds the faults of a
log by itself: at the first piece that does not join, it continues with the rows that it kept. So
the answer equals that of `verify_rows`, and a piece without an answer is not verified.

Spec page: docs/spec/audit-record.md#verification
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from bisect import bisect_right
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from multiprocessing.connection import Connection, wait
from types import TracebackType
from typing import Self

import msgspec
from msgspec import Struct

from authguard_r.audit.record import LogRow, Terminal
from authguard_r.audit.verify import (
    Anchor,
    LogVerifier,
    Piece,
    Verification,
    verify_piece,
    verify_rows,
)
from authguard_r.core.errors import AuthGuardError, EnvironmentFault
from authguard_r.core.reasons import Reason

#: Records that are verified before a second process helps: starting a process takes as long.
ALONE = 10_000
#: Most processes that are started without being asked for.
MOST_JOBS = 8
#: Records of a piece for another process, and of one's own, after which the others are looked at.
_ROWS, _OWN_ROWS = 2_048, 128
#: A piece that has so many bytes gets no further row; of all that wait to be joined.
_BYTES, _KEPT_BYTES = 1 << 21, 1 << 24
_MAIN = "from authguard_r.audit.parallel import serve; serve(0)"


class _PieceTask(Struct, frozen=True):
    """What a process is asked: `verify_piece`."""

    first: int
    with_tree: bool
    rows: list[LogRow]


class _Given(Struct):
    """A piece that waits to be joined, with its rows."""

    asked: _PieceTask
    bytes: int
    piece: Piece | None = None
    is_answered: bool = False


_ANSWER = msgspec.msgpack.Decoder(Piece | None)


def usable_jobs() -> int:
    """Return how many processes are worth it here: the processors that may be used, at most 8."""
    allowed = getattr(os, "sched_getaffinity", None)  # Linux has it
    return 1 if allowed is None else min(len(allowed(0)), MOST_JOBS)


def verify_in_pieces(
    rows: Iterable[LogRow],
    *,
    jobs: int,
    terminal: Terminal | None = None,
    anchors: Sequence[Anchor] = (),
    alone: int = ALONE,
) -> Verification:
    """Return what `verify_rows` does of the same, sooner; memory is that of some pieces.

    Args:
        rows: as there; what reading them raises is raised when everything before it holds.
        jobs: processes, this one counted.
        terminal: as there.
        anchors: as there.
        alone: a log is verified here up to so many records.

    Raises:
        EnvironmentFault: another process ended before it answered: nothing is known of the log.
    """
    if jobs <= 1:
        return verify_rows(rows, terminal=terminal, anchors=anchors)
    verifier = LogVerifier(terminal=terminal, anchors=anchors)
    with _Helpers(jobs - 1) as helpers:
        return _Verification(_Reading(rows, verifier.cuts), verifier, helpers, alone).run()


class _Reading:
    """The rows of a log as they are read, in pieces.

    Args:
        rows: in order.
        cuts: sizes at which a piece ends, in order.
    """

    def __init__(self, rows: Iterable[LogRow], cuts: tuple[int, ...]) -> None:
        self._rows = iter(rows)
        self._cuts = cuts
        self._error: Exception | None = None
        self.size = 0

    def piece(self, most: int) -> _Given | None:
        """Return the next rows, at most so many; None when there are no more to be read."""
        first, found, size = self.size, [], 0
        next_cut = bisect_right(self._cuts, first)
        with_tree = next_cut < len(self._cuts)
        if with_tree:
            most = min(most, self._cuts[next_cut] - first)
        try:
            for row in islice(self._rows, most):
                found.append(row)
                size += len(row.record) + len(row.sealed)
                if size >= _BYTES:
                    break
        except (AuthGuardError, OSError) as error:
            self._error = error  # what was read before it may have a fault, which comes first
        self.size += len(found)
        return _Given(_PieceTask(first, with_tree, found), size) if found else None

    def rest(self) -> Iterator[LogRow]:
        """Yield what was not read yet, and raise what reading raised."""
        yield from self._rows
        if self._error is not None:
            raise self._error


class _Verification:
    """One log on its way through the processes."""

    def __init__(
        self, reading: _Reading, verifier: LogVerifier, helpers: _Helpers, alone: int
    ) -> None:
        self._reading = reading
        self._verifier = verifier
        self._helpers = helpers
        self._alone = alone
        self._given: deque[_Given] = deque()
        self._bytes = 0

    def run(self) -> Verification:
        """Return what was found."""
        while self._join():
            if self._reading.size >= self._alone:
                self._helpers.start()
                self._hand_out()
            own = self._next(_OWN_ROWS)
            if own is not None:
                _verify(own)
            elif not self._given:
                return self._verifier.finish(self._reading.rest())
            elif not self._given[0].is_answered:
                self._helpers.answers(wait_for=True)
        return self._verifier.finish(self._left())

    def _hand_out(self) -> None:
        for helper in self._helpers.answers():
            given = self._next(_ROWS)
            if given is None:
                return
            if not helper.ask(given):
                _verify(given)

    def _next(self, most: int) -> _Given | None:
        """Return the next piece, unless there are none, or too many wait."""
        if self._bytes >= _KEPT_BYTES:
            return None
        given = self._reading.piece(most)
        if given is not None:
            self._given.append(given)
            self._bytes += given.bytes
        return given

    def _join(self) -> bool:
        """Join what was answered, in order; False at one that does not join, which is kept."""
        while self._given and self._given[0].is_answered:
            piece = self._given[0].piece
            if piece is None or not self._verifier.join(piece):
                return False
            self._bytes -= self._given.popleft().bytes
        return True

    def _left(self) -> Iterator[LogRow]:
        """Yield every row that was not joined."""
        for given in self._given:
            yield from given.asked.rows
        yield from self._reading.rest()


class _Helper:
    """A process that verifies pieces, one at a time, until its line is closed.

    It gets the rows and nothing else, and is in a session of its own: an interrupt is ours.

    Raises:
        OSError: no process, or no files, to be had.
    """

    def __init__(self) -> None:
        self._given: _Given | None = None
        #: True once it listens and has nothing to do.
        self.is_free = False
        ours, theirs = socket.socketpair()
        with ours, theirs:
            self.process = subprocess.Popen(  # noqa: S603 - our own program, no shell
                [sys.executable, "-P", "-c", _MAIN],
                stdin=theirs.fileno(),
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
            self.line = Connection(ours.detach())

    def ask(self, given: _Given) -> bool:
        """Send it a piece; False when the piece cannot be sent."""
        try:
            data = msgspec.msgpack.encode(given.asked)
        except OverflowError:  # a number that no log has
            return False
        self._given, self.is_free = given, False
        try:
            self.line.send_bytes(data)
        except OSError as error:
            raise self._ended() from error
        return True

    def answer(self) -> None:
        """Take in what it says: that it listens, or its answer.

        Raises:
            EnvironmentFault: it has ended, or says something else.
        """
        try:
            said = self.line.recv_bytes()
            if self._given is not None:
                self._given.piece = _ANSWER.decode(said)
                self._given.is_answered = True
        except (EOFError, OSError, msgspec.DecodeError) as error:
            raise self._ended() from error
        self._given, self.is_free = None, True

    def close(self) -> None:
        """End the process."""
        self.line.close()
        self.process.kill()
        self.process.wait()

    def _ended(self) -> EnvironmentFault:
        self.process.kill()
        code, where = self.process.wait(), "the log"
        if self._given is not None:
            first, count = self._given.asked.first, len(self._given.asked.rows)
            where = f"records {first} to {first + count - 1}"
        return EnvironmentFault(
            f"not verified: a process that helped ended (code {code}); out of memory, or killed?",
            reason=Reason.INTERNAL_FAULT,
            where=where,
        )


class _Helpers:
    """The other processes, started together and ended together.

    Args:
        count: how many at most.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._all: list[_Helper] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for helper in self._all:
            helper.close()

    def start(self) -> None:
        """Start them, once; where no more are to be had there are fewer."""
        wanted, self._count = self._count, 0
        for _ in range(wanted):
            try:
                self._all.append(_Helper())
            except OSError:
                return

    def answers(self, *, wait_for: bool = False) -> list[_Helper]:
        """Take in the answers that are there, or wait for one; return who is free.

        Raises:
            EnvironmentFault: one has ended.
        """
        lines = {helper.line: helper for helper in self._all}
        for line in wait(lines, None if wait_for else 0):
            lines[line].answer()  # type: ignore[index]
        return [helper for helper in self._all if helper.is_free]


def serve(descriptor: int) -> None:
    """Verify pieces for another process until it is gone.

    Args:
        descriptor: of the socket to it.
    """
    with Connection(descriptor) as line:
        try:
            line.send_bytes(b"")
            while True:
                asked = msgspec.msgpack.decode(line.recv_bytes(), type=_PieceTask)
                piece = verify_piece(asked.rows, asked.first, with_tree=asked.with_tree)
                line.send_bytes(msgspec.msgpack.encode(piece))
        except (EOFError, OSError):
            return


def _verify(given: _Given) -> None:
    asked = given.asked
    given.piece = verify_piece(asked.rows, asked.first, with_tree=asked.with_tree)
    given.is_answered = True
