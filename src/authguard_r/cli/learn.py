# SPDX-License-Identifier: Apache-2.0
"""`authguard learn`: from the log of a shadow run to proposals that a person goes through."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

from authguard_r.access.files import read_binding
from authguard_r.audit.record import LogRow
from authguard_r.auditor.export_format import exported_rows
from authguard_r.authoring.onboarding.evidence import ShadowEvidence, Unused, gather
from authguard_r.authoring.onboarding.pages import LearnedProposals, propose, ranked, row_line
from authguard_r.cli.inputs import JsonFlag, SiteOption, load_site
from authguard_r.cli.log_reading import strange
from authguard_r.cli.logs import open_log
from authguard_r.cli.signing_key import PassphraseFile
from authguard_r.cli.unsealing import ReaderOption, unsealer_of
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.reasons import Reason
from authguard_r.wire.output import emit

_SQLITE = b"SQLite format 3\x00"
#: How many reasons for leaving records out are printed; `--json` has every one.
_SHOWN = 10
WARNING = (
    "WARNING other people may have made the planner do some of this; nothing of it is trusted, "
    "signed or in force"
)


def learn_command(
    log: Annotated[
        Path, typer.Argument(metavar="LOG", help="A gate's store, or its log as JSON Lines.")
    ],
    site: SiteOption,
    out: Annotated[Path, typer.Option("--out", help="The folder for the proposals.")],
    binding: Annotated[
        Path | None,
        typer.Option(
            "--binding",
            help="The planner's tools, if some are bound already.",
        ),
    ] = None,
    trust: Annotated[
        Path | None,
        typer.Option("--trust", help="The trust folder: the site's signature is verified."),
    ] = None,
    reader: ReaderOption = None,
    passphrase_file: PassphraseFile = None,
    as_json: JsonFlag = False,
) -> int:
    """Propose a binding and a mission from the log of a shadow run. A person signs them, or not."""
    opening = unsealer_of(reader, passphrase_file)
    model = load_site(site, trust)
    bound = None if binding is None else read_binding(binding, model)
    with _rows(log) as rows:
        evidence = gather(rows, model, opened=opening.opened)
    proposals = propose(evidence, model, bound)
    _write(out, proposals.files)
    emit(_payload(evidence, proposals, out), _lines(evidence, proposals, out), as_json=as_json)
    return 0


@contextmanager
def _rows(path: Path) -> Iterator[Iterable[LogRow]]:
    """Yield the rows of an exported log, or of a store, read from the gate that holds it."""
    if path.is_file():
        with path.open("rb") as file:
            is_store = file.read(len(_SQLITE)) == _SQLITE
        if not is_store:
            yield exported_rows(path)
            return
    with strange(), open_log(path) as held:
        yield held.rows


def _write(folder: Path, files: dict[str, str]) -> None:
    """Write the proposals; nothing that is there already is touched.

    Raises:
        EnvironmentFault: one of the files is there; none was written.
    """
    for name in files:
        if (folder / name).exists() or (folder / name).is_symlink():
            raise EnvironmentFault(
                f"`{folder / name}` is there already, and a proposal takes nothing's place",
                reason=Reason.FILE_UNAVAILABLE,
                where="--out",
            )
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        with (folder / name).open("x", encoding="utf-8") as file:
            file.write(text)


def _used(evidence: ShadowEvidence, proposals: LearnedProposals) -> int:
    lost = {item.seq for item in proposals.unused}
    seqs = {item.seq for item in evidence.proposed} | {plan.seq for plan in evidence.plans}
    return len(seqs - lost)


def _payload(evidence: ShadowEvidence, proposals: LearnedProposals, out: Path) -> dict[str, Any]:
    return {
        "log": msgspec.to_builtins(evidence.log),
        "robot": evidence.robot,
        "used": _used(evidence, proposals),
        "actions": len(evidence.proposed),
        "plans": proposals.plans,
        "calls": proposals.calls,
        "unused": [{"seq": item.seq, "why": item.why} for item in proposals.unused],
        "files": [str(out / name) for name in proposals.files],
        "rows": [
            {"grant": grant.id, "influenced": bool(row.influences), **msgspec.to_builtins(row)}
            for grant, row in ranked(proposals.learned)
        ],
        "tools": [
            {
                "tool": meaning.key[0],
                "reaches": None if meaning.key[1] is None else meaning.key[1][1],
                "type": meaning.plain["type"],
                "understood": meaning.understood,
                "unknown": meaning.unknown,
            }
            for meaning in proposals.meanings
            if not meaning.kept
        ],
        "questions": [{"field": f, "question": q} for f, q in proposals.questions],
    }


def _lines(evidence: ShadowEvidence, proposals: LearnedProposals, out: Path) -> Iterator[str]:
    yield f"log: whole, {evidence.log.size} records, {evidence.log.anchored}"
    read = f"{len(evidence.proposed)} actions, {proposals.plans} plans of {proposals.calls} calls"
    yield f"used {_used(evidence, proposals)} records: {read}"
    yield from _left_out(proposals.unused)
    understood = sum(meaning.understood for meaning in proposals.meanings)
    rows = ranked(proposals.learned)
    told = {
        "binding": f"{len(proposals.meanings)} ways, {understood} with a meaning, the rest refused",
        "mission": f"{len(proposals.learned.grants)} grants, {len(rows)} rows, "
        f"{len(proposals.questions)} open questions",
        "site": "names that the site does not know, as comments",
    }
    for name in proposals.files:
        yield f"{out / name}: {told[name.partition('.')[0]]}"
    if not proposals.files:
        yield "nothing to propose"
        return
    yield WARNING
    for grant, row in rows:
        yield f"  {grant.type} by {grant.tool}: {row_line(row)}"


def _left_out(unused: tuple[Unused, ...]) -> Iterator[str]:
    """Yield what was not learned from: the reasons, each with its records."""
    reasons: dict[str, list[int]] = {}
    for item in unused:
        reasons.setdefault(item.why, []).append(item.seq)
    for why, seqs in list(reasons.items())[:_SHOWN]:
        first = ", ".join(map(str, seqs[:5])) + (", ..." if len(seqs) > 5 else "")
        yield f"left out {len(seqs)} (record {first}): {why}"
    if len(reasons) > _SHOWN:
        yield f"left out for {len(reasons) - _SHOWN} more reasons: `--json`"
