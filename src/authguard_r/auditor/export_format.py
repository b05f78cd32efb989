# SPDX-License-Identifier: Apache-2.0
"""An exported log: JSON Lines, one row a line, and the newest checkpoint as the last one.

Spec page: docs/spec/audit-record.md#export
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import msgspec
from msgspec import Struct

from authguard_r.audit.record import LogRow
from authguard_r.core.encoding import b64, encode_fast, unb64
from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.parse import read_json

#: Longest line, in bytes.
MAX_LINE = 1 << 21
_BEGINS = b"{"


class ExportedRow(Struct, frozen=True, forbid_unknown_fields=True, gc=False):
    """One line: a row, its bytes as text."""

    seq: int
    record: str
    sealed: str
    link: str


class ExportedNote(Struct, frozen=True, forbid_unknown_fields=True):
    """The last line, where there is a checkpoint: the signed note."""

    checkpoint: str


_ROW = msgspec.json.Decoder(ExportedRow)


def is_export(path: Path) -> bool:
    """Return whether a file begins as an exported log does; a store never does."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        return file.read(1) == _BEGINS


def row_line(row: LogRow) -> bytes:
    """Return the line of a row.

    Raises:
        MalformedError: its bytes are no text: no gate wrote them.
    """
    try:
        record, sealed = row.record.decode(), row.sealed.decode()
    except UnicodeDecodeError as error:
        raise MalformedError("expected UTF-8", where=f"record {row.seq}") from error
    return encode_fast(ExportedRow(row.seq, record, sealed, b64(row.link))) + b"\n"


def note_line(note: bytes) -> bytes:
    """Return the last line.

    Raises:
        MalformedError: the note is no text.
    """
    try:
        return encode_fast(ExportedNote(note.decode())) + b"\n"
    except UnicodeDecodeError as error:
        raise MalformedError("expected UTF-8", where="checkpoint") from error


def exported_rows(path: Path) -> Iterator[LogRow]:
    """Yield the rows of an exported log; the checkpoint is not one.

    Raises:
        MalformedError: a line that is no row, with its number, or lines behind the checkpoint.
    """
    with path.open("rb") as file:
        for number in range(1, 1 << 62):
            line, where = file.readline(MAX_LINE + 1), f"{path}:{number}"
            if not line:
                return
            if len(line) > MAX_LINE:
                message = f"expected a line of at most {MAX_LINE} bytes"
                raise MalformedError(message, where=where, reason=Reason.INPUT_TOO_LARGE)
            row = _row(line, where)
            if row is not None:
                yield row
            elif file.read(1):
                raise MalformedError("expected the checkpoint as the last line", where=where)


def exported_note(path: Path) -> bytes | None:
    """Return the note on the last line of an exported log, None when a row is there.

    Raises:
        MalformedError: neither is there.
    """
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - MAX_LINE - 1))
        last = file.read().removesuffix(b"\n").rpartition(b"\n")[2]
    said = _strict(last, f"{path}: last line")
    return said.checkpoint.encode() if isinstance(said, ExportedNote) else None


def _row(line: bytes, where: str) -> LogRow | None:
    """Return the row of a line, None for the checkpoint."""
    try:
        said = _ROW.decode(line)
        as_written = encode_fast(said) == line.removesuffix(b"\n")
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        as_written = False
    if not as_written:  # spelled in another way: perhaps with a field that is there twice
        strict = _strict(line, where)
        if isinstance(strict, ExportedNote):
            return None
        said = strict
    record, sealed = said.record.encode(), said.sealed.encode()
    return LogRow(said.seq, record, sealed, unb64(said.link, where=f"{where}: link"))


def _strict(line: bytes, where: str) -> ExportedRow | ExportedNote:
    """Return what a line says, however it is spelled; nothing is in it twice."""
    try:
        plain = read_json(line.decode("utf-8"), where=where)
        if isinstance(plain, dict) and "checkpoint" in plain:
            return msgspec.convert(plain, ExportedNote)
        return msgspec.convert(plain, ExportedRow)
    except (msgspec.ValidationError, UnicodeDecodeError) as error:
        message = 'expected {"seq": ..., "record": ..., "sealed": ..., "link": ...}'
        raise MalformedError(message, where=where) from error
