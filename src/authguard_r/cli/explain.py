# SPDX-License-Identifier: Apache-2.0
"""`authguard explain`: the newest request or refusal, or one record, in words."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from authguard_r.cli.gateway import (
    GateOption,
    ProofOption,
    ReadingRole,
    RoleOption,
    connected,
)
from authguard_r.cli.inputs import JsonFlag
from authguard_r.cli.log_explain import DraftOption, explained, write_change
from authguard_r.cli.log_reading import strange
from authguard_r.cli.status_lines import has_requests
from authguard_r.wire.output import emit

if TYPE_CHECKING:  # loaded when a gate is asked
    from authguard_r.client import GateClient


def explain_command(
    seq: Annotated[
        int | None,
        typer.Argument(
            help="The record's number (default: the newest open request or refused proposal).",
            min=0,
        ),
    ] = None,
    refusal: Annotated[
        bool, typer.Option("--refusal", help="The last refusal, also while a request is open.")
    ] = False,
    gate: GateOption = None,
    role: RoleOption = ReadingRole.OPERATOR,
    trust: ProofOption = None,
    store: Annotated[
        Path | None, typer.Option("--store", help="Read a store that no gate has open.")
    ] = None,
    draft: DraftOption = None,
    as_json: JsonFlag = False,
) -> int:
    """Explain the newest request or refusal, or a record: why, what to do, what would allow it."""
    if store is not None:
        if gate is not None:
            raise typer.BadParameter("not together with --gate", param_hint="--store")
        from authguard_r.store.sqlite import read_rows

        with strange():
            told = explained(read_rows(store), seq)
    else:
        with connected(gate, role, trust) as client:
            asks = seq is None and not refusal
            told = (_newest_request(client) if asks else None) or client.explain(seq)
    lines = [str(line) for line in told.get("text") or []]
    if draft is not None:
        lines.append(write_change(draft, told))
    emit(told, lines, as_json=as_json)
    return 0


def _newest_request(client: GateClient) -> dict[str, Any] | None:
    """Return the newest open approval request in words; None: a later proposal was refused."""
    from authguard_r.authoring.compile.request import card
    from authguard_r.client.approvals import shown

    status = client.status()
    open_ = [q for q in client.approvals() if not q.denied] if has_requests(status) else []
    if not open_:
        return None
    newest = max(open_, key=lambda question: question.asked_ms)
    age_ms = newest.expires_ms - newest.left_ms - newest.asked_ms
    if (status.get("last_refusal") or {"ago_ms": age_ms})["ago_ms"] < age_ms:
        return None
    number = newest.counter
    mend = f"authguard approvals approve {number}, or authguard approvals deny {number}"
    text = [*card(newest, shown(newest)), f"  to do: {mend}"]
    return {"kind": "approval_request", "counter": number, "mends": [mend], "text": text}
