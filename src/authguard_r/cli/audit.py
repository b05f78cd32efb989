# SPDX-License-Identifier: Apache-2.0
"""`authguard audit`: is the log whole, and what does it say?"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

from authguard_r.audit.record import Terminal, read_record, read_sealed
from authguard_r.audit.verify import Row, verify_rows
from authguard_r.cli.inputs import JsonFlag, wall_now
from authguard_r.cli.logs import open_log
from authguard_r.cli.out import emit
from authguard_r.core.encoding import Tag
from authguard_r.core.errors import EnvironmentFault, MalformedError, StoreError
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.core.token import open_token
from authguard_r.keys.trust import read_file, read_trust

app = typer.Typer(help="The audit log: verify and read it.", no_args_is_help=True)
#: How much of a digest a line shows; `--json` has all of it.
_SHORT = 12
StoreArgument = Annotated[Path, typer.Argument(help="The store's file.")]


@app.command("verify")
def verify(
    store: StoreArgument,
    checkpoint: Annotated[
        Path | None, typer.Option("--checkpoint", help="A signed terminal digest, kept elsewhere.")
    ] = None,
    trust: Annotated[
        Path | None, typer.Option("--trust", help="The trust folder; needed with --checkpoint.")
    ] = None,
    as_json: JsonFlag = False,
) -> int:
    """Say whether the log is whole and how it is anchored; tampered: 1, unreadable: 4.

    A gate that runs tells its log itself; only a checkpoint holds it to more than its own word.
    """
    terminal = _terminal(checkpoint, trust)
    try:
        with open_log(store) as log:
            found, gate = verify_rows(log.rows, terminal=terminal), log.gate
    except StoreError as error:
        if error.reason in {Reason.STORE_CORRUPT, Reason.STORE_NEWER} or not store.is_file():
            raise MalformedError(error.message, where=str(store), reason=error.reason) from error
        raise
    payload = {**msgspec.to_builtins(found), "told_by": None if gate is None else gate.pid}
    if found.whole:
        covers = f", {found.anchored_size} of {found.size} records" if found.anchored_size else ""
        lines = [f"whole: {found.size} records, head {found.head}"]
        lines += [f"anchored: {found.anchored}{covers}"]
        if not found.anchored_size:
            lines.append("  nothing outside says that no record is missing at the end")
        if gate is not None:
            lines.append(f"  told by the gate that runs (process {gate.pid}), not read from disk")
    else:
        lines = [f"NOT WHOLE at {found.where}: {found.fault}"]
    emit(payload, lines, as_json=as_json)
    return 0 if found.whole else 1


@app.command("show")
def show(
    store: StoreArgument,
    kind: Annotated[
        str | None, typer.Option("--kind", help="Only records of this kind (`decision` ...).")
    ] = None,
    refused: Annotated[
        bool, typer.Option("--refused", help="Only what was refused, aborted or not begun.")
    ] = False,
    as_json: JsonFlag = False,
) -> int:
    """Print the log as a timeline."""
    with open_log(store) as log:
        shown = list(_shown(log.rows, kind, refused=refused))
    lines = [line for _, line in shown] or ["no records"]
    emit({"records": [record for record, _ in shown]}, lines, as_json=as_json)
    return 0


def _shown(
    rows: Iterable[Row], kind: str | None, *, refused: bool
) -> Iterator[tuple[dict[str, Any], str]]:
    """Yield each record that is wanted, as data and as a line."""
    for row in rows:
        record = read_record(row.record, where=f"record {row.seq}")
        if kind is not None and record.kind != kind:
            continue
        if refused and not record.open.get("reasons"):
            continue
        sealed = read_sealed(row.sealed, where=f"record {row.seq}")
        values = {name: item.value for name, item in sealed.items()}
        told = {"seq": row.seq, **msgspec.to_builtins(record)}
        reasons = ", ".join(record.open.get("reasons", ()))
        what = _order(record.open, values) if record.kind == "management" else _what(values)
        yield (
            {**told, "values": msgspec.to_builtins(values)},
            f"{row.seq:5} {to_timestamp(record.link.time_ms)} {record.kind:11}"
            f"{record.link.decision:17} {record.link.mid:16} {what} {reasons}".rstrip(),
        )


def _order(said: dict[str, Any], values: dict[str, Any]) -> str:
    """Return what an order says: the version, what it takes the place of, the row that it picks."""
    parts = [str(said["grant"])] if "grant" in said else []
    parts += [f"{name} {said[name]}" for name in ("row", "version") if name in said]
    old = said.get("supersedes", "-")
    parts += [f"supersedes {str(old)[:_SHORT]}..."] if old != "-" else []
    parts += ["no confirmation"] if values.get("confirmation") == "none" else []
    return ", ".join(parts)


def _what(values: dict[str, Any]) -> str:
    action = values.get("action")
    if not isinstance(action, dict):
        return ""
    parts = [action.get("type"), action.get("object"), action.get("destination")]
    return " ".join(str(part) for part in parts if part)


def _terminal(checkpoint: Path | None, trust: Path | None) -> Terminal | None:
    if checkpoint is None:
        return None
    if trust is None:
        raise EnvironmentFault(
            "a checkpoint is worth only as much as the key that signed it; name --trust",
            reason=Reason.STORE_UNAVAILABLE,
            where="--trust",
        )
    terminal, _, _ = open_token(
        read_file(checkpoint),
        Terminal,
        tag=Tag.CHECKPOINT,
        roles=frozenset({"gate", "witness"}),
        verifier=read_trust(trust),
        now=wall_now(None),
    )
    return terminal
