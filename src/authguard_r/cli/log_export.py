# SPDX-License-Identifier: Apache-2.0
"""`authguard audit export`: the log as a file that anyone can verify, or as a table.

Spec page: docs/spec/audit-record.md#export
"""

from __future__ import annotations

import csv
import io
import os
import sys
from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from authguard_r.audit.record import BOX, LogRow, read_record, read_sealed
from authguard_r.audit.sealed_envelopes import act_of
from authguard_r.auditor.export_format import note_line, row_line
from authguard_r.cli.audit import StoreArgument
from authguard_r.cli.inputs import JsonFlag
from authguard_r.cli.log_reading import reading
from authguard_r.cli.logs import ReadableLog
from authguard_r.cli.signing_key import PassphraseFile
from authguard_r.cli.unsealing import LogUnsealer, ReaderOption, unsealer_of
from authguard_r.core.encoding import b64, encode_fast
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.wire.output import emit

#: With one of these at its beginning a cell is a formula to some spreadsheet; four are full-width.
_FORMULA = (*"=+-@|%\t\r\n", *"\uff1d\uff0b\uff0d\uff20")
COLUMNS = (
    *("seq", "time", "kind", "decision", "mission", "version", "who", "reasons", "grant"),
    *("action", "object", "source", "destination", "ticket", "open", "sealed", "link"),
    "closed",
)
#: What a cell may be named in a record's open part: the first that is there.
_WHO = ("client", "by", "caller", "planner")


class Format(StrEnum):
    """What is written."""

    JSONL = "jsonl"
    CSV = "csv"


def export_command(
    store: StoreArgument,
    form: Annotated[
        Format,
        typer.Option("--format", help="`jsonl` for `audit verify`, or `csv` for a table."),
    ] = Format.JSONL,
    out: Annotated[
        Path | None, typer.Option("--out", help="A new file (default: standard output).")
    ] = None,
    reader: ReaderOption = None,
    passphrase_file: PassphraseFile = None,
    as_json: JsonFlag = False,
) -> int:
    """Write a log as JSON Lines with its newest checkpoint at the end, or as CSV.

    JSON Lines have every byte that is chained and signed: this file and one public key are enough
    to verify it. CSV is for reading and cannot be verified. The export verifies nothing.
    """
    if out is None and as_json:
        raise typer.BadParameter("expected --out together with --json", param_hint="--out")
    if reader is not None and form is Format.JSONL:
        text = "JSON Lines are written as they are stored, and read with the key: --format csv"
        raise typer.BadParameter(text, param_hint="--reader")
    opening = unsealer_of(reader, passphrase_file)
    with reading(store, opening if form is Format.CSV else None) as log:
        count = _write(log, form, out, opening)
    if out is not None:
        emit({"file": str(out), "lines": count}, [f"{out}: {count} lines"], as_json=as_json)
    return 0


def _write(log: ReadableLog, form: Format, out: Path | None, opening: LogUnsealer) -> int:
    lines = _json_lines(log) if form is Format.JSONL else _csv_lines(log.rows, opening)
    if out is None:
        return _put(lines, sys.stdout.buffer)
    if out.exists() or out.is_symlink():
        raise EnvironmentFault(
            f"`{out}` is there already", reason=Reason.FILE_UNAVAILABLE, where="--out"
        )
    # a log is not for every user of the machine
    handle = os.open(out, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    with os.fdopen(handle, "wb") as file:
        count = _put(lines, file)
        file.flush()
        os.fsync(file.fileno())
    return count


def _put(lines: Iterator[bytes], file: io.BufferedIOBase | Any) -> int:
    count = 0
    for count, line in enumerate(lines, 1):  # noqa: B007 - the last number is the answer
        file.write(line)
    file.flush()
    return count


def _json_lines(log: ReadableLog) -> Iterator[bytes]:
    for row in log.rows:
        yield row_line(row)
    if log.notes:
        yield note_line(log.notes[0])


def _csv_lines(rows: Iterator[LogRow], opening: LogUnsealer) -> Iterator[bytes]:
    yield _line(COLUMNS)
    for row in rows:
        cells = _cells(row, opening)
        yield _line([cell(cells.get(name)) for name in COLUMNS])


def _line(cells: Any) -> bytes:
    text = io.StringIO()
    csv.writer(text, quoting=csv.QUOTE_ALL).writerow(cells)
    return text.getvalue().encode()


def cell(value: Any) -> str:
    """Return a cell that every spreadsheet reads as text: a log cannot contain formulas."""
    if value is None:
        return ""
    text = value if isinstance(value, str) else encode_fast(value).decode()
    shown = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
    return f"'{shown}" if text.startswith(_FORMULA) and text != "-" else shown


def _cells(row: LogRow, opening: LogUnsealer) -> dict[str, Any]:
    where = f"record {row.seq}"
    record = read_record(row.record, where=where)
    values = {name: item.value for name, item in read_sealed(row.sealed, where=where).items()}
    opened, link = record.open, record.link
    reasons = opened.get("reasons")
    return {
        "seq": row.seq,
        "time": to_timestamp(link.time_ms),
        "kind": record.kind,
        "decision": link.decision,
        "mission": link.mid,
        "version": opened.get("version"),
        "who": next((opened[name] for name in _WHO if name in opened), None),
        "reasons": " ".join(map(str, reasons)) if isinstance(reasons, list) else reasons,
        "grant": opened.get("grant"),
        **_moved(act_of(values) or {}),
        "ticket": opened.get("ticket"),
        "open": opened,
        "sealed": {name: one for name, one in values.items() if not name.startswith(BOX)},
        "link": b64(row.link),
        "closed": opening.closed(record, values).words(),
    }


def _moved(action: dict[str, Any]) -> dict[str, Any]:
    return {
        "action": action.get("type"),
        **{name: action.get(name) for name in ("object", "source", "destination")},
    }
