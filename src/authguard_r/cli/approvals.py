# SPDX-License-Identifier: Apache-2.0
"""`authguard approvals`: what people are asked while a robot works, and their answers.

How-to: docs/howto/approvals.md
"""

from __future__ import annotations

import json
import sys
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

from authguard_r.authoring.compile.request import action_line, brief, card
from authguard_r.cli.ask import confirm_shown
from authguard_r.cli.gateway import GateOption, ProofOption, ReadingRole, RoleOption, connected
from authguard_r.cli.inputs import JsonFlag, load_site
from authguard_r.cli.signing_key import CertOption, KeyOption, PassphraseFile, open_signer
from authguard_r.cli.watch import ENDED, event_line
from authguard_r.client import GateClient
from authguard_r.client.approvals import ShownRequest, shown
from authguard_r.core.approval import ApprovalVerdict
from authguard_r.core.errors import AuthGuardError
from authguard_r.keys.signer import FileSigner
from authguard_r.site.model import Site
from authguard_r.wire.approval_request import Question
from authguard_r.wire.output import emit, printed

CounterArgument = Annotated[int, typer.Argument(help="The request's number.", min=1)]
SiteChoice = Annotated[
    Path | None,
    typer.Option("--site", envvar="AUTHGUARD_SITE", help="The site model, for units and marks."),
]
YesFlag = Annotated[bool, typer.Option("--yes", help="Do not ask (for scripts).")]


def list_command(
    gate: GateOption = None,
    role: RoleOption = ReadingRole.OPERATOR,
    trust: ProofOption = None,
    site: SiteChoice = None,
    as_json: JsonFlag = False,
) -> int:
    """List the open requests of the active mission; exit 3 while a request is open."""
    model = None if site is None else load_site(site)
    with connected(gate, role, trust) as client:
        questions = client.approvals()
    lines = [line for question in questions for line in _brief(question, model)]
    payload = {"requests": [_payload(question) for question in questions]}
    emit(payload, lines or ["no open request"], as_json=as_json)
    return 3 if questions else 0


def show_command(
    counter: CounterArgument,
    gate: GateOption = None,
    role: RoleOption = ReadingRole.OPERATOR,
    trust: ProofOption = None,
    site: SiteChoice = None,
    as_json: JsonFlag = False,
) -> int:
    """Show one request in full, decoded from the bytes that an answer signs."""
    model = None if site is None else load_site(site)
    with connected(gate, role, trust) as client:
        question = client.approval(counter)
    lines = card(question, shown(question), model)
    emit({**_payload(question), "card": lines}, lines, as_json=as_json)
    return 0


def approve_command(
    counter: CounterArgument,
    key: KeyOption,
    cert: CertOption = None,
    passphrase_file: PassphraseFile = None,
    gate: GateOption = None,
    trust: ProofOption = None,
    site: SiteChoice = None,
    yes: YesFlag = False,
    as_json: JsonFlag = False,
) -> int:
    """Show a request, ask, sign an approval and send it; exit 1 when it does not count."""
    return _answer(
        counter,
        ApprovalVerdict.APPROVE,
        open_signer(key, cert, passphrase_file),
        gate,
        trust,
        site,
        why="",
        yes=yes,
        as_json=as_json,
    )


def deny_command(
    counter: CounterArgument,
    key: KeyOption,
    reason: Annotated[
        str, typer.Option("--reason", help="Why, for the log; planners do not see it.")
    ],
    cert: CertOption = None,
    passphrase_file: PassphraseFile = None,
    gate: GateOption = None,
    trust: ProofOption = None,
    site: SiteChoice = None,
    yes: YesFlag = False,
    as_json: JsonFlag = False,
) -> int:
    """Show a request, ask, sign a denial and send it; a denial outweighs every approval."""
    if not reason.strip():
        raise typer.BadParameter("say why", param_hint="--reason")
    return _answer(
        counter,
        ApprovalVerdict.DENY,
        open_signer(key, cert, passphrase_file),
        gate,
        trust,
        site,
        why=reason,
        yes=yes,
        as_json=as_json,
    )


def watch_command(
    gate: GateOption = None,
    role: RoleOption = ReadingRole.OPERATOR,
    trust: ProofOption = None,
    jsonl: Annotated[bool, typer.Option("--jsonl", help="One JSON object for each event.")] = False,
    count: Annotated[
        int | None, typer.Option("--count", help="End after this number of events.", min=1)
    ] = None,
    as_json: JsonFlag = False,
) -> int:
    """Show requests and answers as they happen, until you interrupt it.

    With --json all events are printed at the end, as one object.
    """
    seen: list[dict[str, Any]] = []
    with suppress(KeyboardInterrupt), connected(gate, role, trust) as client:
        for event in client.watch():
            if event.get("event") not in {"approval", ENDED}:
                continue
            seen.append(event)
            if not as_json:
                _say(event, jsonl=jsonl)
            if len(seen) == count or event.get("event") == ENDED:
                break
    if as_json:
        emit({"events": seen}, (), as_json=True)
    return 0


def _answer(
    counter: int,
    verdict: ApprovalVerdict,
    signer: FileSigner,
    gate: Path | None,
    trust: Path | None,
    site: Path | None,
    *,
    why: str,
    yes: bool,
    as_json: bool,
) -> int:
    model = None if site is None else load_site(site)
    with connected(gate, ReadingRole.OPERATOR, trust) as client:
        question = client.approval(counter)
        lines = card(question, shown(question), model)
        if not yes:
            confirm_shown(lines, f"{str(verdict).capitalize()} exactly this?", as_json=as_json)
        told = client.answer(question, verdict, signer, why=why)
        left = _left(client, counter)
    worth = told.get("why_not")
    said = f"request {counter}: {told.get('approver')} {_SAID[verdict]}"
    behind = None if left is None else left.behind
    in_vain = verdict is ApprovalVerdict.APPROVE and left is not None and left.denied
    if in_vain:
        result = [f"{said}, but another approver denied: the request is closed"]
    elif worth:
        result = [f"{said}, but it does not count: {worth}"]
    elif left is not None and verdict is ApprovalVerdict.APPROVE:
        result = [said, f"{behind} of {left.required} people are behind it"]
    else:
        result = [said]
    counts = not worth and not in_vain
    denied = None if left is None else left.denied
    payload = {**told, "counts": counts, "behind": behind, "denied": denied}
    emit(payload, [*(lines if yes else []), *result], as_json=as_json)
    return 0 if counts else 1


_SAID = {ApprovalVerdict.APPROVE: "approves", ApprovalVerdict.DENY: "denies"}


def _left(client: GateClient, counter: int) -> Question | None:
    """Return the request as it stands after the answer; None when it is open no more."""
    with suppress(AuthGuardError):
        return client.approval(counter)
    return None


def _brief(question: Question, site: Site | None) -> list[str]:
    """Return a request for the list; one whose bytes do not fit is named, and what is wrong."""
    try:
        return brief(question, shown(question), site)
    except AuthGuardError as error:
        return [f"{question.counter:4}  CANNOT BE SHOWN: {error.message}"]


def _payload(question: Question) -> dict[str, Any]:
    """Return a request as JSON, with the effect out of its bytes; null when they do not fit."""
    opened: ShownRequest | None = None
    with suppress(AuthGuardError):
        opened = shown(question)
    plain: dict[str, Any] = msgspec.to_builtins(question)
    return {
        **plain,
        "tier": None if opened is None else opened.situation.tier,
        "action": None if opened is None else msgspec.to_builtins(opened.scope),
        "words": None if opened is None else action_line(opened.scope),
    }


def _say(event: dict[str, Any], *, jsonl: bool) -> None:
    sys.stdout.write((json.dumps(event) if jsonl else printed(event_line(event))) + "\n")
    sys.stdout.flush()
