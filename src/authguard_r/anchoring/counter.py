# SPDX-License-Identifier: Apache-2.0
"""The outside counter: a signed note of how far the log had come, kept where the store is not.

A store that was put back has a log that is complete in itself; only something outside of it knows
that there were more records. Spec page: docs/spec/rollback.md#the-counter
"""

from __future__ import annotations

import os
import stat
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from msgspec import Struct

from authguard_r.core.encoding import Tag, decode, unb64
from authguard_r.core.errors import AuthenticityError, EnvironmentFault
from authguard_r.core.identifiers import Count, Digest, Positive, RobotId
from authguard_r.core.principals import Signer, Verifier
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.token import open_token, read_token, sign_object

#: Who writes counters.
GATE_ROLES = frozenset({"gate"})
#: Longest note, in bytes: a hybrid signature with its certificates, and room.
MAX_BYTES = 1 << 16


class Counter(Protocol):
    """A place that keeps one note: a file on another mount, a TPM's NV index, a remote service.

    It need not be able to count by itself. What it must do is what a store cannot: not come back
    with an older note when the store is put back.
    """

    def read(self) -> bytes | None:
        """Return the note, None when there never was one.

        Raises:
            EnvironmentFault: it cannot be read, so it is unknown whether there is one.
        """
        ...

    def write(self, note: bytes) -> None:
        """Keep this note in the place of the last; it survives a power cut once this returns.

        A crash in the middle leaves the one or the other, never a part.

        Raises:
            EnvironmentFault: it may not have been kept.
        """
        ...


class CounterNote(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How far a robot's log had come when the note was written.

    Args:
        robot: whose log it is.
        store: L_0, the link of the log's first record: which store this is. The record seals
            something under a random salt, so no two stores begin alike.
        number: one more with every note.
        size: number of records.
        head: L_{size-1}.
        time_ms: trusted time, or the wall clock where that was later.
    """

    robot: RobotId
    store: Digest
    number: Positive
    size: Positive
    head: Digest
    time_ms: Count


def seal(counted: CounterNote, signer: Signer) -> bytes:
    """Return the note, signed by the gate's own key."""
    return sign_object(counted, Tag.CHECKPOINT, signer)


def open_note(note: bytes, *, verifier: Verifier) -> CounterNote:
    """Return what a note says, held to the gate that wrote it.

    Certificates are judged at the note's own time: it says what was, and a gate that was off for
    long still has to know its store. One that was revoked since is refused all the same.

    Raises:
        MalformedError: it is no note.
        AuthenticityError: it was not signed by the gate of the robot that it names.
    """
    claimed = decode(
        unb64(read_token(note).payload, where="token.payload"), CounterNote, where="note"
    )
    at = Now(claimed.time_ms, 0)
    counted, _, signer = open_token(
        note, CounterNote, tag=Tag.CHECKPOINT, roles=GATE_ROLES, verifier=verifier, now=at
    )
    if not signer.scope.covers(counted.robot):
        raise AuthenticityError(
            f"expected the note of `{counted.robot}` by its own gate, got `{signer.id}`'s",
            reason=Reason.ROBOT_MISMATCH,
            where="counter.robot",
        )
    return counted


class FileCounter:
    """A counter in a file (`Counter`); on a mount of its own, or it comes back with the store.

    Args:
        path: its folder must exist: a mount that is missing is not a counter that is new.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._beside = path.with_name(f"{path.name}.new")

    @property
    def files(self) -> tuple[Path, Path]:
        """Everything that is written: the note, and the next one until it takes its place."""
        return self.path, self._beside

    def read(self) -> bytes | None:
        """Return the note (`Counter`)."""
        if not self.path.parent.is_dir():
            raise self._fault("read", "its folder is not there: is it mounted?")
        try:
            # never waits for a writer of a pipe that was put here
            file = os.open(self.path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
        except FileNotFoundError:
            return None
        except OSError as error:
            raise self._fault("read", error.strerror or "unknown") from error
        try:
            if not stat.S_ISREG(os.fstat(file).st_mode):
                raise self._fault("read", "it is no file")
            return os.pread(file, MAX_BYTES, 0)
        except OSError as error:
            raise self._fault("read", error.strerror or "unknown") from error
        finally:
            os.close(file)

    def write(self, note: bytes) -> None:
        """Keep the note (`Counter`): written beside, synced, put in place, and the folder synced.

        What a crash leaves beside is never read.
        """
        try:
            with suppress(FileNotFoundError):
                self._beside.unlink()
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC | os.O_NOFOLLOW
            self._put(os.open(self._beside, flags, 0o600), note)
            self._beside.replace(self.path)
            self._put(os.open(self.path.parent, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC), b"")
        except OSError as error:
            raise self._fault("written", error.strerror or "unknown") from error

    def _put(self, file: int, data: bytes) -> None:
        """Write everything to disk and close the file."""
        try:
            while data:
                data = data[os.write(file, data) :]
            os.fsync(file)
        finally:
            os.close(file)

    def _fault(self, done: str, why: str) -> EnvironmentFault:
        return EnvironmentFault(
            f"the counter cannot be {done}: {why}",
            reason=Reason.STORE_UNAVAILABLE,
            where=str(self.path),
        )
