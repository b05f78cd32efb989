# SPDX-License-Identifier: Apache-2.0
"""What an emergency leaves behind while the store cannot be written: a bounded file of records.

The file has its whole size from its first day, so a full disk does not matter to it. A record is
one slot, written whole and synced before the call returns; a slot that was torn is no record. A
slot is used again only once the log has what was in it. Spec page: docs/spec/emergency.md#journal
"""

from __future__ import annotations

import os
import stat
from hashlib import sha256
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
_MAGIC = b"authguard-r/emergency-journal/1\0"
_SUM = 32
_LENGTH = 4
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


class EmergencyJournal:
    """The file, held open by one gate.

    Args:
        path: made when it is not there; its owner alone may read it.
        robot: whose emergencies it keeps; another's file is refused.

    Raises:
        EnvironmentFault: it cannot be made whole, or is somebody else's.
    """

    def __init__(self, path: Path, *, robot: RobotId) -> None:
        self.path = path
        self._robot = robot
        self._file = -1
        self._known: dict[int, Journaled] = {}
        self.lost = 0
        self._last = 0
        try:
            self._file = os.open(path, _OPEN, 0o600)
            self._require_own()
            self._make_whole()
            self._read()
        except OSError as error:
            self.close()
            raise self._fault(error.strerror or str(error)) from error
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

    def after(self, heard: int) -> None:
        """Number on after a record that the log has, whatever became of the file that had it."""
        self._last = max(self._last, heard)

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
            raise self._fault("expected a file of the gate's own user")
        os.fchmod(self._file, 0o600)

    def _make_whole(self) -> None:
        """Take every block that the file will ever need, now."""
        size = (COUNTERS + SLOTS) * SLOT
        if os.fstat(self._file).st_size > size:
            raise self._fault(f"expected at most {size} bytes")
        os.posix_fallocate(self._file, 0, size)
        os.fsync(self._file)
        folder = os.open(self.path.absolute().parent, os.O_RDONLY | os.O_CLOEXEC)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def _read(self) -> None:
        """Take in every whole slot; what is torn was never answered for."""
        slots = [os.pread(self._file, SLOT, number * SLOT) for number in range(COUNTERS + SLOTS)]
        counts = [_opened(slot, number, _Lost) for number, slot in enumerate(slots[:COUNTERS])]
        self.lost = max((count.lost for count in counts if count is not None), default=0)
        for place, slot in enumerate(slots[COUNTERS:]):
            record = _opened(slot, COUNTERS + place, Journaled)
            if record is None:
                continue
            if record.robot != self._robot:
                raise self._fault(f"expected the journal of `{self._robot}`")
            self._known[record.n] = record
        self._last = max(self._known, default=0)

    def _write(self, number: int, value: Struct) -> None:
        try:
            data = _sealed(value, number)
            written = os.pwrite(self._file, data, number * SLOT)
            if written != len(data):  # pragma: no cover - the blocks are its own
                raise self._fault("the disk took half of a record")
            os.fsync(self._file)
        except OSError as error:
            raise self._fault(error.strerror or str(error)) from error

    def _fault(self, why: str) -> EnvironmentFault:
        return EnvironmentFault(why, reason=Reason.STORE_UNAVAILABLE, where=str(self.path))


def _sealed(value: Struct, number: int) -> bytes:
    """Return a slot: digest of place and content, length, content, zeros to the end."""
    data = msgspec.json.encode(value)
    if _SUM + _LENGTH + len(data) > SLOT:
        raise RuntimeError(f"a record of {len(data)} bytes does not fit a slot")
    whole = (len(data).to_bytes(_LENGTH) + data).ljust(SLOT - _SUM, b"\0")
    return _digest(whole, number) + whole


def _opened(slot: bytes, number: int, kind: type[T]) -> T | None:
    """Return what a slot holds; None when it was never written, or torn."""
    whole = slot[_SUM:]
    if len(slot) != SLOT or slot[:_SUM] != _digest(whole, number):
        return None
    length = int.from_bytes(whole[:_LENGTH])
    try:
        return msgspec.json.decode(whole[_LENGTH : _LENGTH + length], type=kind)
    except (msgspec.DecodeError, UnicodeDecodeError):
        return None


def _digest(whole: bytes, number: int) -> bytes:
    return sha256(_MAGIC + number.to_bytes(_LENGTH) + whole).digest()
