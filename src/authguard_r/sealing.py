# SPDX-License-Identifier: Apache-2.0
"""Who may read which fields of a gate's log: keys for each mission, told to readers in the log.

The keys of a mission's boxes are made when its first record is written and live in this process
alone: whoever takes the robot has its log and cannot read it. A record of kind `sealing` has them
wrapped for the readers whom the signed gate configuration names, so that a log by itself is all
that a reader needs. Another start makes other keys.

Spec page: docs/spec/sealed-fields.md
"""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Callable
from typing import Annotated

import msgspec
from msgspec import Meta, Struct

from authguard_r.audit.boxes import (
    SEALING,
    WRAP,
    Cover,
    DataClass,
    append_covered,
    opened,
)
from authguard_r.audit.record import Entry, Record, append, read_record, read_sealed
from authguard_r.audit.verify import Row
from authguard_r.core.encoding import b64, decode, encode, unb64
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Base64Url, Count, Digest, Identifier, RobotId
from authguard_r.core.ports import Turn
from authguard_r.core.reasons import Reason
from authguard_r.keys.readers import ReaderKey, ReaderPublic, read_public

#: Where the store holds which records tell the keys of a mission.
_HELD = "sealing"
#: Missions whose keys are in memory at a time; more than one only around a change of missions.
_MOST_COVERS = 4
_KEY = 32


class Reader(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One key that may read some classes of sealed fields.

    Args:
        role: who has the key: a word of the organization's; grants nothing else.
        classes: what it opens, sorted and unique.
        key: the public key, base64url (`authguard audit reader` prints it).
    """

    role: Identifier
    classes: Annotated[tuple[DataClass, ...], Meta(min_length=1)]
    key: Base64Url


class Retention(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How long the sealed fields of a class are kept after their mission's expiry.

    Args:
        data: the class.
        least_ms: they are not destroyed before, whoever orders it.
        most_ms: the gate destroys them then by itself; 0: it never does.
    """

    data: DataClass
    least_ms: Count = 0
    most_ms: Count = 0


class Kept(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which records tell the keys of a mission.

    Args:
        first: number of the first of them.
        newest: number of the last; each names the one before it.
    """

    first: Count
    newest: Count


class Wrapped(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The key of one class, for one reader.

    Args:
        reader: digest of the reader's public key.
        role: the reader's.
        text: what HPKE made of it, base64url.
    """

    reader: Digest
    role: Identifier
    text: Base64Url


class _For(Struct, frozen=True, kw_only=True):
    """What a wrapped key is bound to: it is of no other mission, class, log or start."""

    robot: RobotId
    mid: str
    keys: int
    data: DataClass
    reader: Digest
    v: int = 1


def require_readers(readers: tuple[Reader, ...], *, where: str) -> tuple[ReaderPublic, ...]:
    """Return the keys of readers who have to have one each, and classes sorted and unique.

    Raises:
        MalformedError: one has no key that holds, or two have the same.
    """
    keys = tuple(
        read_public(reader.key, where=f"{where}[{number}].key")
        for number, reader in enumerate(readers)
    )
    for number, reader in enumerate(readers):
        if sorted(set(reader.classes)) != list(reader.classes):
            raise MalformedError(
                "expected classes sorted, each once",
                where=f"{where}[{number}].classes",
                reason=Reason.SCHEMA_INVALID,
            )
    if len({key.raw for key in keys}) != len(keys):
        raise MalformedError(
            "expected a key of its own for each reader", where=where, reason=Reason.SCHEMA_INVALID
        )
    return keys


def require_retention(
    rules: tuple[Retention, ...], readers: tuple[Reader, ...], *, where: str
) -> None:
    """Refuse rules about what is not sealed, two about one class, or one that contradicts itself.

    Raises:
        MalformedError: with the rule.
    """
    sealed = {one for reader in readers for one in reader.classes}
    names = [rule.data for rule in rules]
    for number, rule in enumerate(rules):
        if rule.data not in sealed or 0 < rule.most_ms < rule.least_ms:
            raise MalformedError(
                "expected a class that a reader may read, and `most_ms` not below `least_ms`",
                where=f"{where}[{number}]",
                reason=Reason.SCHEMA_INVALID,
            )
    if sorted(set(names)) != names:
        raise MalformedError(
            "expected classes sorted, each once", where=where, reason=Reason.SCHEMA_INVALID
        )


class Sealer:
    """Seals what a gate writes into its log.

    Args:
        robot: whose log it is.
        readers: who may read; what no reader may read is not sealed.
        random: returns that many fresh random bytes.
    """

    def __init__(
        self,
        robot: RobotId,
        readers: tuple[Reader, ...],
        *,
        random: Callable[[int], bytes] = os.urandom,
    ) -> None:
        self._robot = robot
        self._random = random
        self._readers = tuple(zip(readers, require_readers(readers, where="readers"), strict=True))
        self._classes = tuple(sorted({one for reader in readers for one in reader.classes}))
        self._covers: OrderedDict[str, tuple[bytes, Cover]] = OrderedDict()

    def append(self, turn: Turn, entry: Entry, *, salts: Callable[[int], bytes]) -> int:
        """Append the entry to the log in this turn, sealed, behind the keys when those are new."""
        cover = self._cover(turn, entry, salts)
        return append_covered(turn, entry, cover, salts=salts)

    def opened(self, row: Row) -> Row:
        """Return a row as it would be had nothing been sealed, as far as this start's keys go.

        Raises:
            MalformedError: it is not what was sealed.
        """
        covers = {cover.keys: cover for _, cover in self._covers.values()}
        return opened(
            row,
            robot=self._robot,
            key_of=lambda seq, data: covers[seq].classes.get(data) if seq in covers else None,
        )

    def forget(self, mid: str) -> None:
        """Forget a mission's keys: what comes next has others."""
        self._covers.pop(mid, None)

    def _cover(self, turn: Turn, entry: Entry, salts: Callable[[int], bytes]) -> Cover:
        held = turn.get(_HELD, entry.mid)
        known = self._covers.get(entry.mid)
        if known is not None and known[0] == held:  # else its record was not committed
            return known[1]
        seq = turn.head()[0]
        classes = {one: self._random(_KEY) for one in self._classes}
        cover = Cover(robot=self._robot, keys=seq, classes=classes)
        before = None if not held else decode(held, Kept, where="store.sealing")
        self._tell(turn, entry, cover, before, salts)
        kept = encode(Kept(first=seq if before is None else before.first, newest=seq))
        turn.put(_HELD, entry.mid, kept)
        self._covers[entry.mid] = (kept, cover)
        self._covers.move_to_end(entry.mid)
        while len(self._covers) > _MOST_COVERS:
            self._covers.popitem(last=False)
        return cover

    def _tell(
        self,
        turn: Turn,
        entry: Entry,
        cover: Cover,
        before: Kept | None,
        salts: Callable[[int], bytes],
    ) -> None:
        """Record the keys, wrapped for everybody who may have them."""
        wraps: dict[str, list[Wrapped]] = {}
        for reader, public in self._readers:
            for data in reader.classes:
                bound = _For(
                    robot=self._robot,
                    mid=entry.mid,
                    keys=cover.keys,
                    data=data,
                    reader=public.name,
                )
                text = b64(public.wrap(cover.classes[data], encode(bound)))
                wrapped = Wrapped(reader=public.name, role=reader.role, text=text)
                wraps.setdefault(WRAP + data, []).append(wrapped)
        told = Entry(
            kind=SEALING,
            time_ms=entry.time_ms,
            decision=SEALING,
            mid=entry.mid,
            open={
                "classes": list(self._classes),
                "roles": sorted({reader.role for reader, _ in self._readers}),
                "before": -1 if before is None else before.newest,
            },
            sealed=wraps,
        )
        append(turn, told, salts=salts(16 * len(wraps)))


class KeyRing:
    """What one reader can open of a log that is read from its beginning on.

    Args:
        key: the reader's.
    """

    def __init__(self, key: ReaderKey) -> None:
        self._key = key
        self._robot = RobotId("")
        self._found: dict[tuple[int, DataClass], bytes] = {}
        #: Records with keys for this reader.
        self.records = 0

    def opened(self, row: Row) -> Row:
        """Return the row as it would be had nothing been sealed, as far as this key goes.

        Raises:
            MalformedError: it is no record, or not what was sealed.
            AuthenticityError: what was wrapped for this key does not open.
        """
        if row.seq == 0 or WRAP.encode() in row.sealed:
            self._learn(row)
        return opened(row, robot=self._robot, key_of=self._of)

    def _of(self, keys: int, data: DataClass) -> bytes | None:
        return self._found.get((keys, data))

    def _learn(self, row: Row) -> None:
        where = f"record {row.seq}"
        record = read_record(row.record, where=where)
        if row.seq == 0:
            self._robot = RobotId(str(record.open.get("robot")))
        if record.kind == SEALING:
            found = dict(_unwrapped(row, record, self._robot, self._key))
            self._found |= found
            self.records += bool(found)


def _unwrapped(
    row: Row, record: Record, robot: RobotId, key: ReaderKey
) -> list[tuple[tuple[int, DataClass], bytes]]:
    found: list[tuple[tuple[int, DataClass], bytes]] = []
    for name, one in read_sealed(row.sealed, where=f"record {row.seq}").items():
        where = f"record {row.seq}: {name}"
        try:
            data = DataClass(name.removeprefix(WRAP))
            wraps = msgspec.convert(one.value, list[Wrapped])
        except (msgspec.ValidationError, ValueError) as error:
            raise MalformedError(f"expected wrapped keys: {error}", where=where) from error
        for wrapped in wraps:
            if wrapped.reader == key.public.name:
                bound = _For(
                    robot=robot, mid=record.link.mid, keys=row.seq, data=data, reader=wrapped.reader
                )
                secret = key.unwrap(unb64(wrapped.text, where=where), encode(bound), where=where)
                found.append(((row.seq, data), secret))
    return found
