# SPDX-License-Identifier: Apache-2.0
"""Trials that were run before their turn to be written came: a file for each pair.

The log is in order, and pairs that run at once are not. What a pair has finished lies here until
the pairs before it are through, so memory holds none of it. A file is a line that says of which
campaign it is, a line for each trial, and a last one where the pair came to its end.
Spec page: docs/spec/campaign-log.md#writing
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import BinaryIO, Self

import msgspec
from msgspec import Struct

from authguard_r.core.encoding import b64
from missionpair.attackers import AttackerError
from missionpair.briefing import PlannerError
from missionpair.campaign.log import LogError
from missionpair.campaign.worker import TrialResult
from missionpair.records import Campaign, Trial

_END = b"end\n"


class _StoredTrial(Struct):
    """One trial as it stands in the file; `failure`: its attacker's or not, text, code, place."""

    trial: Trial
    failure: tuple[bool, str, str, str] | None = None


_ENCODER = msgspec.json.Encoder()
_DECODER = msgspec.json.Decoder(_StoredTrial)


class Ahead:
    """The folder of those files.

    Args:
        folder: made when something is to be kept; files of another campaign in it are left alone.
        campaign: what is run.
    """

    def __init__(self, folder: Path, campaign: Campaign) -> None:
        self._folder = folder
        bare = msgspec.structs.replace(campaign, qualified=())
        self._head = b64(sha256(msgspec.json.encode(bare, order="sorted")).digest()).encode()
        self._trials = campaign.trials // max(1, campaign.pairs)

    def path(self, number: int) -> Path:
        """Return where a pair's trials lie."""
        return self._folder / f"{number}.jsonl"

    def begin(self, number: int) -> BinaryIO:
        """Return a pair's file, empty but for its first line, to `keep` trials in.

        Raises:
            LogError: it cannot be written.
        """
        try:
            self._folder.mkdir(mode=0o700, exist_ok=True)
            file = self.path(number).open("wb", buffering=0)
            file.write(self._head + b"\n")
        except OSError as error:
            raise _failed(error, self._folder) from error
        return file

    def kept(self, number: int) -> tuple[TrialResult, ...]:
        """Return what an earlier run has finished of a pair: all of it, answered, or nothing."""
        try:
            head, *lines = self.path(number).read_bytes().splitlines(keepends=True) or [b""]
            if head != self._head + b"\n" or lines[-1:] != [_END]:
                return ()
            found = [_DECODER.decode(line) for line in lines[:-1]]
        except (OSError, msgspec.DecodeError):
            return ()
        first = number * self._trials
        if [one.trial.n for one in found] != list(range(first, first + self._trials)):
            return ()
        is_answered = all(one.failure is None for one in found)
        return tuple(map(_ran, found)) if is_answered else ()

    def remove(self) -> None:
        """Remove what is of this campaign, and the folder when nothing else is in it."""
        for path in self._folder.glob("*.jsonl"):
            with suppress(OSError), path.open("rb") as file:
                if file.read(len(self._head)) == self._head:
                    path.unlink()
        with suppress(OSError):
            self._folder.rmdir()


def keep(file: BinaryIO, ran: TrialResult) -> None:
    """Write one trial; it is whole, or the next run does without it.

    Raises:
        LogError: the disk is full or gone.
    """
    why, failure = ran.failure, None
    if why is not None:
        failure = (isinstance(why, AttackerError), why.message, why.code, why.where)
    _write(file, _ENCODER.encode(_StoredTrial(ran.trial, failure)) + b"\n")


def end(file: BinaryIO) -> None:
    """Write that the pair came to its end.

    Raises:
        LogError: as `keep`.
    """
    _write(file, _END)


class Tail:
    """Reads a pair's file while it is written.

    Args:
        path: the file; it may not be there yet.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: BinaryIO | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._file is not None:
            self._file.close()

    def read(self) -> Iterator[TrialResult]:
        """Yield every trial that came since.

        Raises:
            LogError: the disk is gone.
        """
        try:
            if self._file is None:
                with suppress(FileNotFoundError):
                    self._file = self._path.open("rb")
            while self._file is not None:
                at = self._file.tell()
                line = self._file.readline()
                if not line.endswith(b"\n"):
                    self._file.seek(at)
                    return
                if line != _END and at:
                    yield _ran(_DECODER.decode(line))
        except OSError as error:
            raise _failed(error, self._path) from error


def _ran(kept: _StoredTrial) -> TrialResult:
    if kept.failure is None:
        return TrialResult(kept.trial)
    is_attacker, message, code, where = kept.failure
    error = AttackerError if is_attacker else PlannerError
    return TrialResult(kept.trial, error(message, code=code, where=where))


def _write(file: BinaryIO, data: bytes) -> None:
    try:
        while data:
            data = data[os.write(file.fileno(), data) :]
    except OSError as error:
        raise _failed(error, Path(file.name)) from error


def _failed(error: OSError, path: Path) -> LogError:
    text = f"cannot be written: {error.strerror}; the log has every finished trial; run again"
    return LogError(text, where=str(path), is_here=True)
