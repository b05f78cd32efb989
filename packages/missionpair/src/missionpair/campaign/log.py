# SPDX-License-Identifier: Apache-2.0
"""The campaign's log: one JSON line for each trial, each bound to all before it.

A line is `{"link", "record", "timing"?}`. The link is a hash over the link before and the record's
exact bytes; timing lies outside of it, so that two runs of one deterministic campaign have the same
records and links. A writer holds a lock; a line is whole, or it is not there. Spec page:
docs/spec/campaign-log.md
"""

from __future__ import annotations

import fcntl
import gzip
import os
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import lru_cache, partial
from hashlib import file_digest, sha256
from pathlib import Path
from time import monotonic
from types import TracebackType
from typing import Any, NamedTuple, Self

import msgspec
from msgspec import Raw, Struct

from authguard_r.core.encoding import b64
from missionpair.records import SCHEMA, Campaign, End, Line, Timing, Trial

_ENCODER = msgspec.json.Encoder(order="sorted")
_LINE = msgspec.json.Decoder(Line)
_NO_TIME = Timing()
#: Longest line that is read; a trial with every round full is far shorter.
MAX_LINE = 8 * 1024 * 1024
#: What waits to be written at most, in bytes and in seconds.
_MOST_WAITING, _LONGEST_S = 64 * 1024, 0.5


class LogError(Exception):
    """A campaign log that cannot be read, continued or written.

    Args:
        where: the file, with the line from 1 where there is one.
        message: what is wrong, and what to do.
        is_here: the machine is at fault, and not the log.
    """

    def __init__(self, message: str, *, where: str, is_here: bool = False) -> None:
        super().__init__(f"{where}: {message}")
        self.where = where
        self.message = message
        self.is_here = is_here

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how another process makes it again."""
        return partial(LogError, where=self.where, is_here=self.is_here), (self.message,)


class _LogLine(Struct, frozen=True, forbid_unknown_fields=True):
    """One line as it stands in the file."""

    link: str
    record: Raw
    timing: Timing | None = None


_WRITTEN = msgspec.json.Decoder(_LogLine)


class LogWriter:
    """Appends trials to a log; continues one that was cut off by a kill.

    What a killed run had finished in its last half second, and trials whose plan was not judged
    under every defense, are run again; the log has every trial once, in order.

    Args:
        path: the file; a new one is begun, an old one goes on if it is of the same campaign.
        campaign: what is run.

    Raises:
        LogError: another run writes it, it is of another campaign, it was changed, or it is
            something else altogether; nothing was written.
    """

    def __init__(self, path: Path, campaign: Campaign) -> None:
        if path.suffix == ".gz":
            raise LogError("a log is written unpacked: name a file without `.gz`", where=str(path))
        self._path = path
        #: The first line; of a log that goes on, the one that is there.
        self.campaign = campaign
        self._file = _locked(path)
        self._waiting = bytearray()
        self._written_s = monotonic()
        try:
            self.done, self._link, self._end, self.is_whole = self._taken_up(campaign)
            if self._end == 0:
                self._require_ours(campaign)
            os.ftruncate(self._file, self._end)
        except BaseException:
            os.close(self._file)
            raise
        if self._end == 0:
            self._append(campaign, None)
            self._write()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def add(self, trial: Trial) -> None:
        """Append one trial; its number is the next one.

        Raises:
            LogError: the disk is full or gone; every trial before stays.
        """
        if trial.n != self.done:
            raise RuntimeError(f"trial {trial.n} came where {self.done} is next")
        self._append(msgspec.structs.replace(trial, timing=_NO_TIME), trial.timing)
        self.done += 1
        if len(self._waiting) >= _MOST_WAITING or monotonic() - self._written_s >= _LONGEST_S:
            self._write()

    def end(self) -> None:
        """Say that the log is whole.

        Raises:
            LogError: as `add`.
        """
        if not self.is_whole:
            self._append(End(trials=self.done), None)
            self.is_whole = True
        self._write()

    def close(self) -> None:
        """Let go of the file, with everything on disk.

        Raises:
            LogError: as `add`.
        """
        try:
            self._write()
            os.fsync(self._file)
        except OSError as error:
            raise self._failed(error) from error
        finally:
            os.close(self._file)

    def forget(self) -> None:
        """Let go of the file in a process that was forked from the one that writes.

        Both would hold its lock, and the one that is left behind would keep the next run out.
        """
        os.close(self._file)

    def _require_ours(self, campaign: Campaign) -> None:
        """Refuse to write over anything but the beginning of this campaign's own first line.

        Raises:
            LogError: something else is there.
        """
        there = os.pread(self._file, MAX_LINE, 0)
        data = _ENCODER.encode(campaign)
        if not (b'{"link":"%b","record":%b}\n' % (_linked("", data).encode(), data)).startswith(
            there
        ):
            text = "is no campaign's log, and would be written over: name another file"
            raise LogError(text, where=str(self._path))

    def _append(self, record: Line, timing: Timing | None) -> None:
        data = _ENCODER.encode(record)
        self._link = _linked(self._link, data)
        self._waiting += b'{"link":"%b","record":%b' % (self._link.encode(), data)
        if timing is not None:
            self._waiting += b',"timing":%b' % _ENCODER.encode(timing)
        self._waiting += b"}\n"

    def _write(self) -> None:
        """Put what waits into the file; whole lines, or none of them."""
        data = bytes(self._waiting)
        self._waiting.clear()
        try:
            at = self._end
            while data:
                wrote = os.pwrite(self._file, data, at)
                data, at = data[wrote:], at + wrote
        except OSError as error:
            with suppress(OSError):
                os.ftruncate(self._file, self._end)
            raise self._failed(error) from error
        self._end, self._written_s = at, monotonic()

    def _failed(self, error: OSError) -> LogError:
        text = f"cannot be written: {error.strerror}; the log has every finished trial; run again"
        return LogError(text, where=str(self._path), is_here=True)

    def _taken_up(self, campaign: Campaign) -> tuple[int, str, int, bool]:
        """Return the trials that are kept, the last link, where it ends, and if it is whole.

        The trials of one plan, one for each defense, are kept together or not at all: a planner
        that is asked again could answer otherwise.
        """
        link, end, trials, whole = "", 0, 0, False
        kept, together = (0, "", 0), len(campaign.defenses)
        for number, data in enumerate(_lines(self._path, is_cut_allowed=True), 1):
            link, record, _ = _opened(data, link, where=f"{self._path}:{number}")
            if number == 1:
                self.campaign = _same(record, campaign, where=f"{self._path}:1")
            trials += isinstance(record, Trial)
            whole = isinstance(record, End)
            end += len(data)
            if whole or trials % together == 0:
                kept = trials, link, end
        return *kept, whole


def read_log(path: Path, *, is_partial_allowed: bool = False) -> tuple[Campaign, Iterator[Trial]]:
    """Return what was run, and its trials one after the other.

    Args:
        path: the file.
        is_partial_allowed: take a log of a campaign that has not come to its end.

    Raises:
        LogError: no log, a cut one or a changed one; also while the trials are read.
    """
    lines = enumerate(_lines(path, is_cut_allowed=is_partial_allowed), 1)
    number, data = next(lines, (1, b""))
    link, record, _ = _opened(data, "", where=f"{path}:{number}")
    if not isinstance(record, Campaign):
        raise LogError("is no campaign's first line", where=f"{path}:1")
    if record.schema != SCHEMA:
        raise LogError(f"is `{record.schema}`, this reads `{SCHEMA}`", where=f"{path}:1")
    return record, _trials(path, lines, link, is_partial_allowed=is_partial_allowed)


class WholeLog(NamedTuple):
    """A log in memory, for those who answer from it; its digest is of the file, base64url."""

    campaign: Campaign
    trials: tuple[Trial, ...]
    digest: str


def whole_log(path: Path) -> WholeLog:
    """Return a log that came to its end; read once while its file stays the same.

    Raises:
        LogError: as `read_log`.
    """
    return _whole_log(path, file_stamp(path))


@lru_cache(maxsize=2)
def _whole_log(path: Path, stamp: object) -> WholeLog:  # noqa: ARG001 - another file, another log
    campaign, trials = read_log(path)
    found = tuple(trials)
    with path.open("rb") as file:
        return WholeLog(campaign, found, b64(file_digest(file, "sha256").digest()))


def file_stamp(path: Path) -> object:
    """Return a value that differs after the file changes; None if there is no file."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_ino, found.st_size, found.st_mtime_ns


def has_trials(path: Path) -> bool:
    """True when a log has a trial; whether it is whole and whose it is, its writer asks.

    Raises:
        LogError: it is there and cannot be read.
    """
    if not path.is_file():
        return False
    return sum(1 for _ in zip(_lines(path, is_cut_allowed=True), range(2), strict=False)) == 2


def _trials(
    path: Path, lines: Iterator[tuple[int, bytes]], link: str, *, is_partial_allowed: bool
) -> Iterator[Trial]:
    count, ended, number = 0, False, 1
    for number, data in lines:
        where = f"{path}:{number}"
        if ended:
            raise LogError("comes after the last line", where=where)
        link, record, timing = _opened(data, link, where=where)
        if isinstance(record, Trial):
            if record.n != count:
                raise LogError(f"is trial {record.n} where {count} is next", where=where)
            count += 1
            yield record if timing is None else msgspec.structs.replace(record, timing=timing)
        elif isinstance(record, End) and record.trials == count:
            ended = True
        else:
            raise LogError("says other than the lines before it", where=where)
    if not ended and not is_partial_allowed:
        text = "has no last line: it was cut, or its campaign has not come to its end"
        raise LogError(
            f"{text} (run it again to continue; `report --partial` reads it as it is)",
            where=str(path),
        )


def _lines(path: Path, *, is_cut_allowed: bool) -> Iterator[bytes]:
    """Yield whole lines; the rest of a cut line is dropped. `.gz` is unpacked on the way."""
    opened: Callable[..., Any] = gzip.open if path.suffix == ".gz" else open
    try:
        with opened(path, "rb") as file:
            while line := file.readline(MAX_LINE + 1):
                if line.endswith(b"\n"):
                    yield line
                    continue
                if len(line) > MAX_LINE:
                    raise LogError(f"has a line of more than {MAX_LINE} bytes", where=str(path))
                if not is_cut_allowed:
                    raise LogError(
                        "ends in the middle of a line: it was cut (run it again to continue)",
                        where=str(path),
                    )
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise LogError(f"is no whole gzip file: {error}", where=str(path)) from error
    except OSError as error:
        raise LogError(
            f"cannot be read: {error.strerror}", where=str(path), is_here=True
        ) from error


def _opened(data: bytes, link: str, *, where: str) -> tuple[str, Line, Timing | None]:
    try:
        written = _WRITTEN.decode(data)
        record = _LINE.decode(written.record)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise LogError(f"is no line of a campaign's log: {error}", where=where) from error
    expected = _linked(link, bytes(written.record))
    if written.link != expected:
        text = "does not follow from the lines before it: it, or one before it, was changed"
        raise LogError(text, where=where)
    return expected, record, written.timing


def _linked(link: str, record: bytes) -> str:
    return b64(sha256(b"missionpair/log/2\0%b\0%b" % (link.encode(), record)).digest())


def _same(found: Line, wanted: Campaign, *, where: str) -> Campaign:
    """Return the first line that is there; what baselines were held to is not asked again."""
    if not isinstance(found, Campaign):
        raise LogError("is no campaign's first line", where=where)
    differ = [
        name
        for name in wanted.__struct_fields__
        if name != "qualified" and getattr(found, name) != getattr(wanted, name)
    ]
    if differ:
        text = f"is of another campaign ({', '.join(differ)}): give each a log of its own"
        raise LogError(text, where=where)
    return found


def _locked(path: Path) -> int:
    """Return the file, opened for one writer."""
    try:
        if path.exists() and not path.is_file():
            raise LogError("is no file that a log can be written to", where=str(path), is_here=True)
        if not path.parent.is_dir():
            text = f"cannot be written: there is no folder `{path.parent}`, create it"
            raise LogError(text, where=str(path), is_here=True)
        file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
    except OSError as error:
        raise LogError(
            f"cannot be written: {error.strerror}", where=str(path), is_here=True
        ) from error
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(file)
        raise LogError("another run writes it", where=str(path), is_here=True) from error
    return file
