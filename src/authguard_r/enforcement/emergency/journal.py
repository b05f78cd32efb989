# SPDX-License-Identifier: Apache-2.0
"""What an emergency leaves behind while the store cannot be written: a bounded file of records.

The file has its whole size from its first day, so a full disk does not matter to it. A record is
one slot, written whole and synced before the call returns; a slot that was torn is no record. A
slot is used again only once the log has what was in it.

The file may lie on a disk that others can write. So each slot is authenticated under a key that
only this gate has for this store, and a slot that is not authentic is counted and never used. Spec
page: docs/spec/emergency.md#journal
"""

from __future__ import annotations

import hmac
import os
import stat
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

import msgspec
from msgspec import Struct

from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.identifiers import Count, Digest, Identifier, Positive, RobotId
from authguard_r.core.reasons import Reason

#: Bytes of one slot, a file system's block: a record is never in two of them.
SLOT = 4_096
#: Records that are kept; what comes beyond is counted.
SLOTS = 64
#: Two slots in front hold the count of what did not fit, by turns: one of them is always whole.
COUNTERS = 2
#: What the key of a journal is made for, and what each slot is authenticated as.
MAGIC = b"authguard-r/emergency-journal/2\0"
_SIZE = (COUNTERS + SLOTS) * SLOT
_MAC = 32
_LENGTH = 4
_ADVICE = "move it away, or name another file with --emergency-journal"
T = TypeVar("T")
_OPEN = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW


class Journaled(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One step of an emergency, without what may be sensitive.

    Args:
        n: grows from record to record, over restarts.
        robot: whose emergency it was.
        decision: `accept`, or an outcome.
        at_ms: the latest that the time can have been, milliseconds since 1970.
        mono_ms: the gate's monotonic clock.
        policy: digest of the policy.
        capability: which.
        caller: what called.
        by: who called, named by the channel.
        ticket: the release.
        state: digest of the attested state, `-` without one.
        reasons: why it ended as it did.
        lacked: what was missing.
    """

    n: Positive
    robot: RobotId
    decision: Identifier
    at_ms: Count
    mono_ms: Count
    policy: Digest
    capability: Identifier
    caller: Identifier
    by: str
    ticket: Digest
    state: str
    reasons: tuple[str, ...]
    lacked: tuple[str, ...]


class _Lost(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How many records did not fit since the file was made."""

    lost: Count


class _Claim(Struct, frozen=True):
    """What a slot that is not authentic says of its number, to tell what the log has already."""

    n: int | None = None
    lost: int | None = None


class EmergencyJournal:
    """The file, held open by one gate.

    Args:
        path: made when it is not there; its owner alone may read it.
        key: secret of this gate for this store; what another key wrote is not authentic.

    Raises:
        EnvironmentFault: it cannot be made whole, or is not a file of the gate's own user.
    """

    def __init__(self, path: Path, *, key: bytes) -> None:
        self.path = path
        self._key = key
        self._file = -1
        self._known: dict[int, Journaled] = {}
        self._strange: dict[int, int | None] = {}
        #: The file's size when it was opened, when this class never leaves such a size behind.
        self.odd_size: int | None = None
        self.lost = 0
        self._last = 0
        try:
            self._file = os.open(path, _OPEN, 0o600)
            self._require_own()
            self._make_whole()
            self._read()
        except OSError as error:
            self.close()
            raise self._fault(f"{error.strerror or error}; {_ADVICE}") from error
        except BaseException:
            self.close()
            raise

    @property
    def next_n(self) -> int:
        """The number of the next record."""
        return self._last + 1

    def pending(self, heard: int) -> tuple[Journaled, ...]:
        """Return the records after the one that the log has, in order."""
        return tuple(self._known[n] for n in sorted(self._known) if n > heard)

    def after(self, heard: int, lost: int) -> None:
        """Number and count on after what the log has, even if the file that had it is lost."""
        self._last = max(self._last, heard)
        self.lost = max(self.lost, lost)

    def strange(self, heard: int) -> int:
        """Return how many slots hold something that is not authentic.

        A slot whose number the log has already is not counted: a former key or the format before
        wrote it, or it changes nothing. Nor is half a slot in the place that is written next: a
        power cut leaves that.

        Args:
            heard: the last record that the log has; `after` was called with it.
        """
        torn = {COUNTERS + self.next_n % SLOTS, (self.lost + 1) % COUNTERS}
        return sum(
            place not in torn if n is None else n > (self.lost if place < COUNTERS else heard)
            for place, n in self._strange.items()
        )

    def append(self, record: Journaled, *, heard: int) -> bool:
        """Keep a record on disk; False when there is no room, and then it was counted there.

        Args:
            record: numbered `next_n`.
            heard: the last record that the log has; older ones make room.

        Raises:
            EnvironmentFault: the disk took neither the record nor the count.
        """
        if record.n != self.next_n:
            raise RuntimeError(f"expected record {self.next_n}, got {record.n}")
        if len(self.pending(heard)) >= SLOTS:
            self._count(self.lost + 1)
            return False
        self._write(COUNTERS + record.n % SLOTS, record)
        self._known = {n: known for n, known in self._known.items() if n > heard}
        self._known[record.n] = record
        self._last = record.n
        return True

    def close(self) -> None:
        """Let go of the file; a second call does nothing."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1

    def _count(self, lost: int) -> None:
        self._write(lost % COUNTERS, _Lost(lost=lost))
        self.lost = lost

    def _require_own(self) -> None:
        """Refuse what another user could have written."""
        info = os.fstat(self._file)
        if not stat.S_ISREG(info.st_mode) or info.st_uid != os.geteuid():
            raise self._fault(f"expected a regular file of the gate's own user; {_ADVICE}")
        os.fchmod(self._file, 0o600)

    def _make_whole(self) -> None:
        """Take every block that the file will ever need, now; what is beyond is cut off."""
        size = os.fstat(self._file).st_size
        self.odd_size = None if size in {0, _SIZE} else size
        os.ftruncate(self._file, min(size, _SIZE))
        os.posix_fallocate(self._file, 0, _SIZE)
        os.fsync(self._file)
        folder = os.open(self.path.absolute().parent, os.O_RDONLY | os.O_CLOEXEC)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def _read(self) -> None:
        """Take in every authentic slot; what is torn was never answered for."""
        for place in range(COUNTERS + SLOTS):
            slot = os.pread(self._file, SLOT, place * SLOT)
            value = self._opened(slot, place, _Lost if place < COUNTERS else Journaled)
            if isinstance(value, Journaled):
                self._known[value.n] = value
            elif isinstance(value, _Lost):
                self.lost = max(self.lost, value.lost)
            elif any(slot):
                self._strange[place] = _number_in(slot)
        self._last = max(self._known, default=0)

    def _write(self, number: int, value: Struct) -> None:
        try:
            data = self._sealed(value, number)
            written = os.pwrite(self._file, data, number * SLOT)
            if written != len(data):  # pragma: no cover - the blocks are its own
                raise self._fault("the disk took half of a record")
            os.fsync(self._file)
        except OSError as error:
            raise self._fault(error.strerror or str(error)) from error

    def _fault(self, why: str) -> EnvironmentFault:
        return EnvironmentFault(why, reason=Reason.STORE_UNAVAILABLE, where=str(self.path))

    def _sealed(self, value: Struct, place: int) -> bytes:
        """Return a slot: MAC of place and content, length, content, zeros to the end."""
        data = msgspec.json.encode(value)
        if _MAC + _LENGTH + len(data) > SLOT:
            raise RuntimeError(f"a record of {len(data)} bytes does not fit a slot")
        rest = (len(data).to_bytes(_LENGTH) + data).ljust(SLOT - _MAC, b"\0")
        return self._mac(rest, place) + rest

    def _opened(self, slot: bytes, place: int, kind: type[T]) -> T | None:
        """Return what a slot holds; None when this gate did not write it there, or it was torn."""
        if not hmac.compare_digest(slot[:_MAC], self._mac(slot[_MAC:], place)):
            return None
        with suppress(msgspec.DecodeError, UnicodeDecodeError):
            return msgspec.json.decode(_content(slot), type=kind)
        return None

    def _mac(self, rest: bytes, place: int) -> bytes:
        return hmac.digest(self._key, MAGIC + place.to_bytes(_LENGTH) + rest, "sha256")


def _content(slot: bytes) -> bytes:
    begin = _MAC + _LENGTH
    return slot[begin : begin + int.from_bytes(slot[_MAC:begin])]


def _number_in(slot: bytes) -> int | None:
    """Return the number that a slot claims, of this format or the one before; None for none."""
    with suppress(msgspec.DecodeError, ValueError, RecursionError):
        claim = msgspec.json.decode(_content(slot), type=_Claim)
        return claim.lost if claim.n is None else claim.n
    return None
