# SPDX-License-Identifier: Apache-2.0
"""What a witness knows, on disk before an answer is sent.

A file per log, replaced whole: a few hundred bytes, nothing but JSON, read by people while the
witness serves, and damage to one is damage to one log. A mark counts every change; it may lie on
another medium, and a witness whose files are older than the mark does not start.
Spec page: docs/spec/witness.md#state
"""

from __future__ import annotations

import os
from hashlib import sha256
from pathlib import Path
from typing import TypeVar

from msgspec import Struct

from authguard_r.audit.checkpoint import read_checkpoint
from authguard_r.audit.note import Note, read_key, read_note
from authguard_r.core.encoding import decode, encode
from authguard_r.core.errors import EnvironmentFault, MalformedError, RefusedError
from authguard_r.core.identifiers import Count, Positive
from authguard_r.core.reasons import Reason
from authguard_r.witness import files
from authguard_r.witness.rules import RequestFinding, WitnessedLog

T = TypeVar("T", bound=Struct)

IDENTITY, KEY, MARK = "witness.json", "witness.key.pem", "mark"
_LOGS, _EVIDENCE, _ACTS, _LOCK = "logs", "evidence", "acts.jsonl", "lock"
#: Requests that are kept of each finding, for each log; later ones are only written to the journal.
MOST_KEPT = 8
#: Longest list of what operators did, in bytes: thousands of acts.
_MOST_ACTS = 1 << 24
_RETIRE = "a witness that lost its record of signatures must not sign again: retire its key"


class Identity(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Whose folder it is.

    Args:
        format: of the files beside it.
        name: the witness's.
        key: its verifier key.
        mark: the mark's file, where that is not in the folder.
    """

    format: Positive
    name: str
    key: str
    mark: str = ""


class LogFile(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A log's file.

    Args:
        origin: the log's name.
        keys: its verifier keys; none once it was forgotten.
        number: how often this file was replaced.
        since: its number when the log was registered.
        note: the newest checkpoint that was cosigned, with the log's signatures and the witness's
            own; empty when none was.
        time_s: when, seconds since 1970.
    """

    origin: str
    keys: tuple[str, ...] = ()
    number: Positive
    since: Positive
    note: str = ""
    time_s: Count = 0


class Mark(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How often the files of all logs were replaced: no fewer changes than that were on disk."""

    key: str
    changes: Count


class RefusalEvidence(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A request that was refused although the log signed it.

    Args:
        origin: the log's name.
        finding: why it was refused.
        time_s: when, seconds since 1970.
        old: the size that it said was cosigned last.
        note: what the log signed.
        against: the newest checkpoint that was cosigned then; empty when none was.
    """

    origin: str
    finding: RequestFinding
    time_s: Count
    old: Count
    note: str
    against: str


class OperatorAct(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What an operator did: a log registered, its keys replaced, a log forgotten."""

    act: str
    origin: str
    time_s: Count
    keys: tuple[str, ...] = ()
    note: str = ""


class Sight(Struct, frozen=True, kw_only=True):
    """Everything in a folder, as it was read.

    Args:
        identity: whose it is.
        logs: by origin, forgotten ones too.
    """

    identity: Identity
    logs: dict[str, LogFile]

    @property
    def changes(self) -> int:
        """How often the files of all logs were replaced."""
        return sum(known.number for known in self.logs.values())


class Book:
    """A folder that this process holds; `open_book` makes it."""

    def __init__(self, folder: Path, lock: int, sight: Sight) -> None:
        self.folder = folder
        self.identity = sight.identity
        self._lock = lock
        self._known = sight.logs
        self._logs = {origin: read_log(known) for origin, known in sight.logs.items()}
        self._write_mark(sight.changes)

    @property
    def count(self) -> int:
        """How many logs are known."""
        return sum(bool(log.keys) for log in self._logs.values())

    def log(self, origin: str) -> WitnessedLog | None:
        """Return what the rules need to know of a log, None where it is unknown or forgotten."""
        log = self._logs.get(origin)
        return log if log is not None and log.keys else None

    def advance(self, origin: str, note: Note, time_s: int) -> None:
        """Take this note for the newest of its log; it is on disk, and marked, once this returns.

        Args:
            origin: a log's that is known.
            note: a checkpoint that follows from the last one, with all signatures that are kept.
            time_s: when it was cosigned.

        Raises:
            EnvironmentFault: it may not be on disk; what was known before is still known.
        """
        known, text = self._known[origin], note.encode().decode("utf-8")
        self._replace(_changed(known, keys=known.keys, note=text, time_s=time_s))

    def register(self, origin: str, keys: tuple[str, ...], time_s: int, *, again: bool) -> bool:
        """Know a log from now on; false when it was known with these very keys.

        Args:
            origin: the log's name.
            keys: its verifier keys.
            time_s: now.
            again: replace the keys of a log that is known; its newest checkpoint stays.

        Raises:
            RefusedError: it is known with other keys, and replacing them was not asked for.
            EnvironmentFault: it may not be on disk.
        """
        known = self._known.get(origin)
        if known is not None and known.keys == keys:
            return False
        has_keys = known is not None and bool(known.keys)
        if has_keys and not again:
            raise RefusedError(
                "the log is known with other keys; say so if they are to be replaced",
                reason=Reason.TRANSITION_REFUSED,
                where="--log",
            )
        act = "replace" if has_keys else "add"
        self._record(OperatorAct(act=act, origin=origin, time_s=time_s, keys=keys))
        if known is None:
            self._replace(LogFile(origin=origin, keys=keys, number=1, since=1))
        elif has_keys:
            self._replace(_changed(known, keys=keys, note=known.note, time_s=known.time_s))
        else:
            self._replace(_changed(known, keys=keys, since=known.number + 1))
        return True

    def forget(self, origin: str, time_s: int) -> LogFile:
        """Forget what was cosigned of a log, and its keys; return what was known.

        Raises:
            RefusedError: it is not known.
            EnvironmentFault: it may still be known.
        """
        known = self._known.get(origin)
        if known is None or not known.keys:
            raise RefusedError(
                "no such log is known here", reason=Reason.TRANSITION_REFUSED, where="ORIGIN"
            )
        act = OperatorAct(
            act="forget", origin=origin, time_s=time_s, keys=known.keys, note=known.note
        )
        self._record(act)
        self._replace(_changed(known))
        return known

    def keep(
        self, finding: RequestFinding, note: Note, *, origin: str, old: int, time_s: int
    ) -> bool:
        """Keep a request that was refused; false when it, or enough like it, are kept already.

        Raises:
            EnvironmentFault: it may not be kept.
        """
        known = self._known[origin]
        kept = RefusalEvidence(
            origin=origin,
            finding=finding,
            time_s=time_s,
            old=old,
            note=note.encode().decode("utf-8"),
            against=known.note,
        )
        for path in _places(self.folder, known, finding):
            found = _load(path, RefusalEvidence)
            if found is None:
                files.replace_file(path, encode(kept))
                return True
            if found.note == kept.note:
                return False
        return False

    def close(self) -> None:
        """Let go of the folder."""
        os.close(self._lock)

    def _replace(self, known: LogFile) -> None:
        """Write a log's file, then the mark; only then is it known."""
        log = read_log(known)
        before = self._known.get(known.origin)
        files.replace_file(_place(self.folder, known.origin), encode(known))
        others = sum(one.number for one in self._known.values() if one is not before)
        self._write_mark(others + known.number)
        self._known[known.origin], self._logs[known.origin] = known, log

    def _write_mark(self, changes: int) -> None:
        mark = Mark(key=self.identity.key, changes=changes)
        files.replace_file(mark_of(self.folder, self.identity), encode(mark))

    def _record(self, act: OperatorAct) -> None:
        """Say what will be done before it is done: nothing is done without that."""
        files.append_line(self.folder / _ACTS, encode(act))


def make_folder(folder: Path, identity: Identity, key: bytes) -> None:
    """Make a witness's folder, its identity last: without it there is no witness.

    Args:
        folder: absent, or empty.
        identity: whose it will be.
        key: its private key, PEM.

    Raises:
        EnvironmentFault: something is there already, or it cannot be written.
    """
    if folder.exists():
        files.require_own(folder, os.geteuid())
        if any(folder.iterdir()):
            raise _fault("expected a new or an empty folder", folder)
    else:
        files.make_folder(folder)
    mark = mark_of(folder, identity)
    if mark.exists() or mark.is_symlink():
        raise _fault("expected no file where the mark will be", mark)
    for name in (_LOGS, _EVIDENCE):
        files.make_folder(folder / name)
    files.replace_file(folder / KEY, key)
    files.replace_file(mark, encode(Mark(key=identity.key, changes=0)))
    files.replace_file(folder / IDENTITY, encode(identity))


def open_book(folder: Path) -> Book:
    """Return a witness's folder, held, whole, and not older than its mark.

    Raises:
        EnvironmentFault: others can read or write it, another process holds it, a file is missing
            or damaged, or it is older than it was (`ROLLED_BACK`); nothing was changed.
    """
    uid = os.geteuid()
    files.require_own(folder, uid)
    files.require_safe_above(folder, uid)
    for name in (IDENTITY, KEY, _LOGS, _EVIDENCE):
        files.require_own(folder / name, uid)
    lock = files.hold(folder / _LOCK)
    try:
        sight = read_folder(folder)
        for origin in sight.logs:
            files.require_own(_place(folder, origin), uid)
        return Book(folder, lock, sight)
    except BaseException:
        os.close(lock)
        raise


def read_folder(folder: Path) -> Sight:
    """Return what is in a folder, also while a witness serves it.

    Raises:
        EnvironmentFault: a file is missing or damaged, or older than it was (`ROLLED_BACK`).
    """
    identity = _require(folder / IDENTITY, Identity, "no witness here: `authguard witness init`")
    if identity.format != 1:
        raise _fault("written by a newer program", folder / IDENTITY, Reason.STORE_NEWER)
    place = mark_of(folder, identity)
    mark = _require(place, Mark, f"the mark is gone; {_RETIRE}", Reason.ROLLED_BACK)
    found = [_require(path, LogFile, "gone") for path in sorted((folder / _LOGS).glob("*.json"))]
    logs = {known.origin: known for known in found}
    paths = {_place(folder, origin) for origin in logs}
    if mark.key != identity.key or paths != set((folder / _LOGS).glob("*.json")):
        raise _fault("expected this witness's own files", folder, Reason.STORE_CORRUPT)
    sight = Sight(identity=identity, logs=logs)
    if sight.changes < mark.changes:
        raise _fault(
            f"{mark.changes} changes were marked, {sight.changes} are here; {_RETIRE}",
            folder / _LOGS,
            Reason.ROLLED_BACK,
        )
    return sight


def read_evidence(folder: Path) -> tuple[RefusalEvidence, ...]:
    """Return every request that was kept, also of logs that were forgotten.

    Raises:
        EnvironmentFault: one is damaged.
    """
    paths = sorted((folder / _EVIDENCE).glob("*.json"))
    found = [_require(path, RefusalEvidence, "gone") for path in paths]
    return tuple(sorted(found, key=lambda one: (one.origin, one.time_s, one.finding)))


def read_acts(folder: Path) -> tuple[OperatorAct, ...]:
    """Return what operators did, in order; a line that a crash cut is left out.

    Raises:
        EnvironmentFault: it cannot be read.
    """
    acts: list[OperatorAct] = []
    written = files.read_file(folder / _ACTS, most=_MOST_ACTS) or b""
    for line in written.split(b"\n"):
        try:
            acts.append(decode(line, OperatorAct, where=_ACTS))
        except MalformedError:
            continue
    return tuple(acts)


def read_log(known: LogFile) -> WitnessedLog:
    """Return what the rules need to know of a log; no keys for one that was forgotten.

    Raises:
        EnvironmentFault: it is not what was written.
    """
    where = f"log `{known.origin}`"
    try:
        keys = tuple(read_key(key, where=where) for key in known.keys)
        if not known.note:
            return WitnessedLog(origin=known.origin, keys=keys)
        newest = read_checkpoint(read_note(known.note.encode(), where=where).text, where=where)
    except MalformedError as error:
        raise _fault(error.message, Path(where), Reason.STORE_CORRUPT) from error
    return WitnessedLog(origin=known.origin, keys=keys, size=newest.size, root=newest.root)


def mark_of(folder: Path, identity: Identity) -> Path:
    """Return where the mark lies."""
    return Path(identity.mark) if identity.mark else folder / MARK


def _changed(
    known: LogFile,
    *,
    keys: tuple[str, ...] = (),
    since: int | None = None,
    note: str = "",
    time_s: int = 0,
) -> LogFile:
    """Return the log's next file; what is not named is empty in it."""
    return LogFile(
        origin=known.origin,
        keys=keys,
        number=known.number + 1,
        since=known.since if since is None else since,
        note=note,
        time_s=time_s,
    )


def _place(folder: Path, origin: str) -> Path:
    return folder / _LOGS / f"{_short(origin)}.json"


def _places(folder: Path, known: LogFile, finding: RequestFinding) -> list[Path]:
    """Return where requests of a finding are kept; a log that is registered anew has new places."""
    stem = f"{_short(known.origin)}-{known.since}-{finding}"
    return [folder / _EVIDENCE / f"{stem}-{number}.json" for number in range(MOST_KEPT)]


def _short(origin: str) -> str:
    return sha256(origin.encode()).hexdigest()[:32]


def _load(path: Path, kind: type[T]) -> T | None:
    """Return what is in a file, None where there is none.

    Raises:
        EnvironmentFault: it is not what was written.
    """
    data = files.read_file(path)
    if data is None:
        return None
    try:
        return decode(data, kind, where=path.name)
    except MalformedError as error:
        raise _fault(error.message, path, Reason.STORE_CORRUPT) from error


def _require(path: Path, kind: type[T], absent: str, reason: Reason = Reason.FILE_UNAVAILABLE) -> T:
    found = _load(path, kind)
    if found is None:
        raise _fault(absent, path, reason)
    return found


def _fault(message: str, path: Path, reason: Reason = Reason.FILE_UNAVAILABLE) -> EnvironmentFault:
    return EnvironmentFault(message, reason=reason, where=str(path))
