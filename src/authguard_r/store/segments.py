# SPDX-License-Identifier: Apache-2.0
"""The sealed segments of a store's log: its oldest records, each file whole by itself.

The store holds which there are, where each begins and ends, and the links that it joins with. A
file is untrusted: one that is missing, that is another log's or that does not join is named with
its records before a row of it is read. The hash chain verifies what a record says. Spec page:
docs/spec/store.md#segments
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Protocol

import apsw
from msgspec import Struct

from authguard_r.audit.checkpoint import read_checkpoint
from authguard_r.audit.note import read_note
from authguard_r.audit.record import read_record
from authguard_r.core.encoding import b64, decode, unb64
from authguard_r.core.errors import MalformedError, StoreError
from authguard_r.core.identifiers import Count, Digest, Positive
from authguard_r.core.reasons import Reason
from authguard_r.store.cells import Cells, blob, cells, first_row, held_value, store_error
from authguard_r.store.folder import Folder
from authguard_r.store.untrusted import ReadMeter, hold, in_order
from authguard_r.wire.gate_limits import LIMITS

#: Kind of what a store holds about its segments: each by its name, and where they end.
SEGMENT, MARK = "segment", "mark"
#: Kind of what stays beside records, by number, while values are still to go from a segment.
FORGET = "forget"
#: Where a segment's own checkpoint lies in it.
CHECKPOINT, SEALED = "checkpoint", "sealed"
#: Marks a file as a segment ("AGS1") and says which layout it has.
SEGMENT_ID, SEGMENT_FORMAT = 0x41475331, 1
#: The end of a name that is not given yet.
PART = ".part"


class Segment(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The records from `first` to before `end`, in a file of their own.

    Args:
        first: number of its first record.
        end: number of the first record after it.
        before: L_{first-1}, base64url.
        head: L_{end-1}.
    """

    first: Count
    end: Positive
    before: Digest
    head: Digest

    @property
    def name(self) -> str:
        """Return the file's name."""
        return name_of(self.first)

    @property
    def said(self) -> str:
        """Return how it is named in a fault."""
        return f"the segment `{self.name}` with records {self.first} to {self.end - 1}"


class SegmentClaims(Struct, frozen=True):
    """What a segment's file says of itself; the checkpoint's signature is not checked here."""

    segment: Segment
    note: bytes


class Writing(Protocol):
    """A segment while it is written."""

    @property
    def at(self) -> int:
        """The first record that is not in it yet."""
        ...

    def forget(self, left: dict[int, bytes]) -> None:
        """Let sealed values of rows that are in it already go."""


class Segments:
    """The segments of one store; used in the writer's turn, or by its one reader.

    Args:
        folder: where they lie.
        index: which there are, in order (`read_index`).
        vfs: name of an SQLite file system, for tests that cut the power.
        strange: the files are untrusted (`store.untrusted`).
    """

    def __init__(
        self,
        folder: Folder,
        index: tuple[Segment, ...],
        *,
        vfs: str | None = None,
        strange: bool = False,
    ) -> None:
        self.folder = folder
        self.vfs = vfs
        self._strange = strange
        self._meters: dict[str, ReadMeter] = {}
        self._open: dict[str, apsw.Connection] = {}
        #: One that is being written, and one that has its name and no mark yet.
        self.writing: Writing | None = None
        self.unmarked: Segment | None = None
        self.index = index

    @property
    def end(self) -> int:
        """The first record that is in no segment."""
        return self.index[-1].end if self.index else 0

    @property
    def reach(self) -> int:
        """The first record that is in no file of the folder, finished or not."""
        ends = [self.end]
        ends += [] if self.writing is None else [self.writing.at]
        ends += [] if self.unmarked is None else [self.unmarked.end]
        return max(ends)

    def add(self, segment: Segment) -> None:
        """Take in one that was marked."""
        self.index = (*self.index, segment)

    def require(self) -> None:
        """Look at every segment: it is there, it is this log's, and it joins.

        Raises:
            StoreError: one is not; its file and its records are named.
        """
        for segment in self.index:
            self._connection(segment)

    def rows(self, first: int, end: int) -> list[Cells]:
        """Return rows of sealed segments.

        Args:
            first: of the first row.
            end: before which to end; not above `self.end`.

        Raises:
            StoreError: a segment is missing, another one's, damaged, or does not join.
        """
        found: list[Cells] = []
        at = bisect_right(self.index, first, key=lambda segment: segment.end)
        for segment in self.index[at:]:
            if segment.first >= end:
                break
            found += self._cells(segment, max(first, segment.first), min(end, segment.end))
        return found

    def forget(self, left: dict[int, bytes]) -> None:
        """Leave no sealed value but these beside these rows, in no file of the folder.

        Done twice it does the same, so that nothing is lost by doing it again after a crash.

        Raises:
            StoreError: a file could not be written; all others were.
        """
        if self.writing is not None:
            self.writing.forget(left)
        left_over = self.unmarked
        named = left_over is not None and self.folder.has(left_over.name)
        faults: list[StoreError] = []
        for segment in (*self.index, *((left_over,) if left_over and named else ())):
            here = {seq: beside for seq, beside in left.items() if seq in _numbers(segment)}
            try:
                if here:
                    self._let_go(segment, here)
            except StoreError as error:
                faults.append(error)  # the others go all the same
        if faults:
            raise faults[0]

    def settle(self, link_of: Callable[[int], bytes | None]) -> None:
        """Remove what a crash left: unfinished files, and one whose rows are all in the store.

        A file of another log in the place of the next one is left where it is.

        Args:
            link_of: returns the link of a row that the store itself has.

        Raises:
            StoreError: the folder cannot be written.
        """
        for stale in self.folder.names():
            if stale.endswith(PART):
                self.folder.remove(stale)
        name = name_of(self.end)
        with suppress(StoreError):
            if self.folder.has(name):
                left = find(self.folder, name, vfs=self.vfs).segment
                if link_of(left.end - 1) == unb64(left.head, where=name):
                    self.folder.remove(name)

    def close(self) -> None:
        """Let go of the files."""
        for connection in self._open.values():
            connection.close()
        self._open.clear()

    def _cells(self, segment: Segment, first: int, end: int) -> list[Cells]:
        try:
            found = cells(self._connection(segment), first, end)
        except apsw.Error as error:
            raise _damaged(self.folder, segment, str(error)) from error
        if [row[0] for row in found] != list(range(first, end)):
            raise _damaged(self.folder, segment, "records are missing")
        if self._strange:
            place = Path(self.folder.place(segment.name))
            # a row that a move has not taken away yet is compared with its copy: twice, at most
            meter = self._meters.setdefault(segment.name, ReadMeter(place, times=2))
            meter.took(*(cell for row in found for cell in row[1:]))
        return found

    def _connection(self, segment: Segment) -> apsw.Connection:
        """Return the open file of a segment; it was looked at when it was opened."""
        known = self._open.get(segment.name)
        if known is not None:
            return known
        if not self.folder.has(segment.name):
            raise _fault(self.folder, segment, "is missing")
        connection = _opened(self.folder, segment.name, segment.said, vfs=self.vfs)
        try:
            if self._strange:
                hold(connection, Path(self.folder.place(segment.name)))
            found = _found(connection, segment.name)
        except (apsw.Error, UnicodeDecodeError, MalformedError, StoreError) as error:
            connection.close()
            raise _damaged(self.folder, segment, str(error)) from error
        if found.segment != segment:
            connection.close()
            raise _fault(self.folder, segment, "is not the one that was sealed, or does not join")
        while len(self._open) >= LIMITS.open_segments:
            self._open.pop(next(iter(self._open))).close()
        self._open[segment.name] = connection
        return connection

    def _let_go(self, segment: Segment, left: dict[int, bytes]) -> None:
        if not self.folder.has(segment.name):
            raise _fault(self.folder, segment, "is missing")
        connection = _opened(self.folder, segment.name, segment.said, vfs=self.vfs, write=True)
        try:
            # EXTRA: a journal that is back after a power cut would bring the values back
            connection.execute("PRAGMA synchronous = EXTRA; PRAGMA secure_delete = ON")
            connection.execute("BEGIN IMMEDIATE")
            connection.executemany(
                "UPDATE audit SET sealed = ? WHERE seq = ?",
                [(beside, seq) for seq, beside in left.items()],
            )
            connection.execute("COMMIT")
        except apsw.Error as error:
            raise store_error(error, where=self.folder.place(segment.name)) from error
        finally:
            connection.close()


def name_of(first: int) -> str:
    """Return the name of the segment that begins with a record."""
    return f"{first:012d}.db"


def read_index(connection: apsw.Connection, folder: Folder) -> tuple[Segment, ...]:
    """Return which segments a store holds to be there, in order.

    Raises:
        StoreError: they do not follow on each other, or their mark is another one.
    """
    query = "SELECT key, value FROM held WHERE kind = ? AND key GLOB '[0-9]*' ORDER BY key"
    place = folder.place("")
    try:
        held: list[tuple[str, Segment]] = []
        meter = ReadMeter(Path(connection.filename))
        for key, value in connection.execute(query, (SEGMENT,)):
            meter.took(blob(value))
            held.append((key, decode(blob(value), Segment, where=f"held.segment.{key}")))
        mark = int(held_value(connection, SEGMENT, MARK) or b"0")
    except (MalformedError, ValueError) as error:
        raise StoreError(str(error), where=place, reason=Reason.STORE_CORRUPT) from error
    index = tuple(segment for _, segment in held)
    starts = [0, *(segment.end for segment in index)]
    joins = all(one.head == two.before for one, two in pairwise(index))
    named = all(key == segment.name for key, segment in held)
    if [*(segment.first for segment in index), mark] != starts or not joins or not named:
        text = "the segments that the store knows of do not follow on each other"
        raise StoreError(text, where=place, reason=Reason.STORE_CORRUPT)
    return index


def read_forgets(connection: apsw.Connection) -> dict[int, bytes]:
    """Return what stays beside records in segments that sealed values are still to go from."""
    query = "SELECT key, value FROM held WHERE kind = ?"
    found: dict[int, bytes] = {}
    meter = ReadMeter(Path(connection.filename))
    for key, value in connection.execute(query, (FORGET,)):
        seq, left = str(key), blob(value)
        meter.took(left)
        if seq.isdecimal():
            found[int(seq)] = left
    return found


def find(folder: Folder, name: str, *, vfs: str | None = None) -> SegmentClaims:
    """Return what a file of the folder says of itself.

    Raises:
        StoreError: it is no segment, or its checkpoint is not its own.
    """
    connection = _opened(folder, name, "the segment", vfs=vfs)
    try:
        if vfs is None:  # untrusted
            hold(connection, Path(folder.place(name)))
        return _found(connection, name)
    except (apsw.Error, UnicodeDecodeError, MalformedError, StoreError) as error:
        raise StoreError(
            f"no whole segment: {error}", where=folder.place(name), reason=Reason.STORE_CORRUPT
        ) from error
    finally:
        connection.close()


def links(folder: Folder, name: str) -> list[bytes]:
    """Return the links of all records of a file that `find` took for a segment.

    Raises:
        StoreError: it cannot be read.
    """
    connection = _opened(folder, name, "the segment")
    place = Path(folder.place(name))
    try:
        hold(connection, place)
        rows = connection.execute("SELECT seq, link FROM audit ORDER BY seq")
        plain = ((seq, b"", b"", blob(link)) for seq, link in rows)
        return [link for _, _, _, link in in_order(plain, place)]
    except (apsw.Error, UnicodeDecodeError) as error:
        raise store_error(error, where=folder.place(name)) from error
    finally:
        connection.close()


def _opened(
    folder: Folder, name: str, said: str, *, vfs: str | None = None, write: bool = False
) -> apsw.Connection:
    """Return a connection to a file, after what a crash in a write left was undone."""
    torn = folder.has(f"{name}-journal")
    flags = apsw.SQLITE_OPEN_READWRITE if write or torn else apsw.SQLITE_OPEN_READONLY
    try:
        connection = apsw.Connection(folder.place(name), flags=flags, vfs=vfs)
        connection.set_busy_timeout(0)
    except apsw.Error as error:
        fault = store_error(error, where=folder.place(name))
        text = f"{said} cannot be opened: {fault.message}"
        raise StoreError(text, where=fault.where, reason=fault.reason) from error
    return connection


def _found(connection: apsw.Connection, name: str) -> SegmentClaims:
    """Return what a file says of itself.

    Raises:
        MalformedError: it is no segment, not this one, or its checkpoint is not its own.
    """
    application = connection.execute("PRAGMA application_id").get
    version = connection.execute("PRAGMA user_version").get
    if (application, version) != (SEGMENT_ID, SEGMENT_FORMAT):
        raise MalformedError(f"expected a segment of format {SEGMENT_FORMAT}")
    note = held_value(connection, CHECKPOINT, SEALED) or b""
    said = read_checkpoint(read_note(note, where=CHECKPOINT).text, where=CHECKPOINT)
    query = "SELECT seq, record FROM audit ORDER BY seq LIMIT 1"
    begin = first_row(connection, query, ())
    last = first_row(connection, "SELECT seq, link FROM audit ORDER BY seq DESC LIMIT 1", ())
    if begin is None or name_of(begin[0]) != name:
        raise MalformedError("expected the record that it is named after")
    if (last[0], last[1]) != (said.size - 1, said.chain):
        raise MalformedError("expected its last record to be its checkpoint's")
    before = read_record(blob(begin[1]), where=f"record {begin[0]}").link.prev
    head = Digest(b64(blob(last[1])))
    return SegmentClaims(Segment(first=begin[0], end=said.size, before=before, head=head), note)


def _numbers(segment: Segment) -> range:
    return range(segment.first, segment.end)


def _fault(folder: Folder, segment: Segment, text: str) -> StoreError:
    where = folder.place(segment.name)
    return StoreError(f"{segment.said} {text}", where=where, reason=Reason.STORE_CORRUPT)


def _damaged(folder: Folder, segment: Segment, why: str) -> StoreError:
    return _fault(folder, segment, f"is damaged: {why}")
