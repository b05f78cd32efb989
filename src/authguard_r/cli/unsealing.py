# SPDX-License-Identifier: Apache-2.0
"""Sealed fields for a reader of a log: opened as far as the reader's key allows.

A closed value stays beside its record, so that it can be named; a value that no key opens any more
is removed like a destroyed one. Spec page: docs/spec/sealed-fields.md#reading
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
import typer
from msgspec.structs import replace

from authguard_r.anchoring.sealing.key_ring import KeyRing
from authguard_r.anchoring.sealing.wraps import Wrapped
from authguard_r.audit.closed import Closed, closed_of
from authguard_r.audit.record import BOX, WRAP, LogRow, Record, Sealed, read_record, read_sealed
from authguard_r.audit.sealed_envelopes import SEALING, SealedEnvelope
from authguard_r.audit.verify import Verification
from authguard_r.cli.signing_key import passphrase_of
from authguard_r.core.encoding import encode_fast
from authguard_r.core.errors import AuthenticityError, MalformedError
from authguard_r.keys.readers import ReaderKey, read_reader

T = TypeVar("T")
ReaderOption = Annotated[
    Path | None,
    typer.Option(
        "--reader",
        metavar="KEYFILE",
        help="A reader's key: opens the fields that are sealed for it.",
    ),
]


class LogUnsealer:
    """The readable parts of a log, row by row from its beginning on.

    Args:
        key: the reader's; None for a reader without a key.
    """

    def __init__(self, key: ReaderKey | None = None) -> None:
        self.key = key
        self._ring = None if key is None else KeyRing(key)
        self._gone: set[tuple[int, str]] = set()
        self._lost: dict[str, set[str]] = {}
        #: The classes of which keys were wrapped for this reader, so far.
        self.has: set[str] = set()

    def rows(self, rows: Iterable[LogRow]) -> Iterator[LogRow]:
        """Yield each row as `opened` returns it."""
        return map(self.opened, rows)

    def opened(self, row: LogRow) -> LogRow:
        """Return a row as it would be had nothing been sealed, as far as the key goes.

        Raises:
            MalformedError: it is no record, or not what was sealed.
            AuthenticityError: what was wrapped for this key does not open.
        """
        told = row if self._ring is None else self._ring.opened(row)
        if WRAP.encode() in row.record:
            self._learn(row)
        return self._without_lost(told) if self._gone and BOX.encode() in told.sealed else told

    def closed(self, record: Record, values: Container[str]) -> Closed:
        """Return what of a record stays closed to this reader.

        Args:
            record: as it was opened.
            values: the names of what lies beside it then.
        """
        lost = self._lost.get(record.link.mid, frozenset[str]())
        return closed_of(record, values, has=self.has, lost=lost)

    def _learn(self, row: LogRow) -> None:
        """Note whose keys a record holds, and which were destroyed."""
        where = f"record {row.seq}"
        record, sealed = read_record(row.record, where=where), read_sealed(row.sealed, where=where)
        if record.kind != SEALING:
            return
        for name in filter(_is_wrap, record.committed):
            data = name.removeprefix(WRAP)
            if name not in sealed:
                self._gone.add((row.seq, data))
                self._lost.setdefault(record.link.mid, set()).add(data)
            elif self.key is not None:
                wraps = _converted(sealed[name], list[Wrapped], f"{where}: {name}")
                if any(wrapped.reader == self.key.public.name for wrapped in wraps):
                    self.has.add(data)

    def _without_lost(self, row: LogRow) -> LogRow:
        """Return the row without envelopes whose keys are destroyed."""
        where = f"record {row.seq}"
        left: dict[str, Sealed] = {}
        for name, one in read_sealed(row.sealed, where=where).items():
            if name.startswith(BOX):
                keys = _converted(one, SealedEnvelope, f"{where}: {name}").keys
                classes = name.removeprefix(BOX).split("+")
                if not self._gone.isdisjoint((keys, data) for data in classes):
                    continue
            left[name] = one
        return replace(row, sealed=encode_fast(left))


class EnvelopeCheck:
    """Holds every box that a key opens to what its record commits to, behind the verifier.

    Args:
        opening: of the reader.
    """

    def __init__(self, opening: LogUnsealer) -> None:
        self.opening = opening
        self.opened = 0
        self.closed = 0
        self._fault: tuple[str, str] | None = None

    @property
    def opens(self) -> bool:
        """True with a reader's key."""
        return self.opening.key is not None

    def rows(self, rows: Iterable[LogRow]) -> Iterator[LogRow]:
        """Yield the rows as they are stored; each is opened once the next one is asked for."""
        for row in rows:
            yield row
            if self._fault is None:
                self._take(row)

    def judged(self, found: Verification) -> Verification:
        """Return what was found of a log, with the first box that is not what it should be."""
        if self._fault is None or not found.whole:
            return found
        fault, where = self._fault
        return replace(found, whole=False, fault=fault, where=where)

    def plain(self) -> dict[str, Any]:
        """Return what the key opened, as data; nothing without one."""
        key = self.opening.key
        if key is None:
            return {}
        classes = sorted(self.opening.has)
        counts = {"opened": self.opened, "closed": self.closed}
        return {"reader": {"name": key.public.name, "classes": classes, **counts}}

    def lines(self, found: Verification) -> Iterator[str]:
        """Yield what the key opened of a whole log, for people."""
        if self.opening.key is None or not found.whole:
            return
        if not self.opening.has:
            yield f"  nothing in it was wrapped for the key {self.opening.key.public.name}"
            return
        fits = f"{self.opened} boxes opened, each value as it was committed to"
        yield f"  {', '.join(sorted(self.opening.has))}: {fits}; {self.closed} boxes stay closed"

    def _take(self, row: LogRow) -> None:
        try:
            told = self.opening.opened(row)
        except (AuthenticityError, MalformedError) as error:
            self._fault = error.message, str(error.where)
            return
        if BOX.encode() in row.sealed:
            committed = read_record(told.record, where="record").committed
            for name in _boxes(row):
                self.opened += name not in committed
            self.closed += len(_boxes(told))


def unsealer_of(reader: Path | None, passphrase_file: Path | None) -> LogUnsealer:
    """Return what a command opens a log with.

    Raises:
        EnvironmentFault: the key file cannot be read.
        MalformedError: it is sealed and damaged.
        AuthenticityError: the passphrase is wrong, or it holds no key of a reader.
    """
    if reader is not None:
        return LogUnsealer(read_reader(reader, passphrase_of(passphrase_file)))
    if passphrase_file is not None:
        raise typer.BadParameter("it opens no key without --reader", param_hint="--passphrase-file")
    return LogUnsealer()


def _is_wrap(name: str) -> bool:
    return name.startswith(WRAP)


def _boxes(row: LogRow) -> list[str]:
    """Return the names of the boxes beside a record."""
    return [n for n in read_sealed(row.sealed, where=f"record {row.seq}") if n.startswith(BOX)]


def _converted(one: Sealed, kind: type[T], where: str) -> T:
    try:
        return msgspec.convert(one.value, kind)
    except msgspec.ValidationError as error:
        raise MalformedError(f"not a record that a gate seals: {error}", where=where) from error
