# SPDX-License-Identifier: Apache-2.0
"""`authguard normalize`: planner output to actions, or a refusal with its place."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

from authguard_r.access.files import read_binding
from authguard_r.cli.free_text import ChatProtocol, free_text_reader
from authguard_r.cli.inputs import (
    BindingOption,
    JsonFlag,
    NowOption,
    SiteOption,
    load_site,
    read_context,
    read_mission,
    wall_now,
)
from authguard_r.cli.model_server import (
    ApiKeyEnvOption,
    BaseUrlOption,
    ModelOption,
    OptionalTimeoutOption,
)
from authguard_r.core.action import Action, ActionMeta
from authguard_r.core.encoding import Tag, digest
from authguard_r.core.errors import AuthGuardError, ClarificationError, MalformedError
from authguard_r.core.identifiers import Digest
from authguard_r.core.provenance import Label
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.token import VerifiedMission
from authguard_r.enforcement.json_views import action_json
from authguard_r.keys.files import PRIVATE, write_whole
from authguard_r.keys.trust import read_trust
from authguard_r.normalize import Binder, Dialect, Plan, read_plan
from authguard_r.normalize.parse import read_json
from authguard_r.provenance.context import ContextLedger
from authguard_r.provenance.labels import label_fields
from authguard_r.wire.output import emit

_TokenOption = Annotated[
    Path | None, typer.Option("--token", help="The mission, for provenance labels.")
]
_TrustOption = Annotated[
    Path | None, typer.Option("--trust", help="The trust folder: the token is verified.")
]
_DialectOption = Annotated[Dialect, typer.Option("--dialect", help="The format of the plan.")]
_ContextOption = Annotated[
    Path | None, typer.Option("--context", help="What the planner saw (JSON Lines).")
]
_FreeTextOption = Annotated[
    ChatProtocol | None,
    typer.Option("--free-text", help="Translate free text to calls with a language model."),
]
_PlanOutOption = Annotated[
    Path | None, typer.Option("--plan-out", help="File for the checked plan.")
]
_JsonlOption = Annotated[
    bool, typer.Option("--jsonl", help='One {"id", "raw"} a line in, one answer a line out.')
]


def normalize_command(
    site: SiteOption,
    binding: BindingOption,
    token: _TokenOption = None,
    trust: _TrustOption = None,
    dialect: _DialectOption = (Dialect.AUTO),
    context: _ContextOption = None,
    free_text: _FreeTextOption = None,
    base_url: BaseUrlOption = None,
    model: ModelOption = None,
    api_key_env: ApiKeyEnvOption = None,
    timeout: OptionalTimeoutOption = None,
    plan_out: _PlanOutOption = None,
    now: NowOption = None,
    jsonl: _JsonlOption = False,
    as_json: JsonFlag = False,
) -> int:
    """Read planner output from standard input; print its actions, or why it is refused."""
    reader = free_text_reader(free_text, base_url, model, api_key_env, timeout)
    if reader is not None and jsonl:
        raise typer.BadParameter("`--free-text` cannot be used with `--jsonl`")
    if reader is None and plan_out is not None:
        raise typer.BadParameter("--plan-out needs --free-text openai or --free-text anthropic")
    place = load_site(site, trust, wall_now(now))
    bound = read_binding(binding, place)
    binder = Binder(place, bound)
    verified = _mission(token, trust, now)
    ledger = read_context(context, binder.spellings(), channels=place.channels)
    if jsonl:
        return _stream(binder, verified, ledger, dialect)
    data = sys.stdin.buffer.read()
    if reader is None:
        answer, code = _answer(data, binder, verified, ledger, dialect)
    else:

        def read() -> Plan:
            made = reader.read(data, bound, place, dialect)
            if plan_out is not None:
                write_whole(plan_out, made.reply.encode("utf-8"), mode=PRIVATE)
            return made.plan

        # without the mission's rows no label is above the context's: a model chose every value
        answer, code = _shown(read, verified, None, ledger)
        parsed = {"parsed_by": reader.name, "text_evidence": digest(Tag.RAW, data)}
        answer = {**answer, **parsed}
    emit(answer, [json.dumps(answer, indent=2)], as_json=as_json)
    return code


def _mission(token: Path | None, trust: Path | None, now: str | None) -> VerifiedMission | None:
    if token is None:
        return None
    if trust is None:
        from authguard_r.core.encoding import decode, unb64
        from authguard_r.core.mission import Mission
        from authguard_r.core.principals import Principal, Scope
        from authguard_r.core.token import index_mission, read_token

        # labels of a preview need the mission's rows, not its authority
        opened = read_token(token.read_bytes())
        payload = unb64(opened.payload, where="token.payload")
        mission = decode(payload, Mission, where="mission")
        nowhere = Scope(robots=frozenset(), regions=frozenset())
        nobody = Principal(id=mission.issuer, role="operator", scope=nowhere, usable_until_ms=0)
        return index_mission(mission, digest(opened.kind, payload), nobody)
    return read_mission(token, read_trust(trust), wall_now(now))


def _stream(
    binder: Binder, verified: VerifiedMission | None, ledger: ContextLedger, dialect: Dialect
) -> int:
    """Answer line by line; a bad line gets an error answer and the stream goes on."""
    for line in sys.stdin.buffer:
        if not line.strip():
            continue
        request: Any = None
        try:
            request = read_json(line.decode("utf-8", "surrogateescape"), where="line")
            if not isinstance(request, dict) or not isinstance(request.get("raw"), str):
                raise MalformedError('expected {"id": ..., "raw": ...}', where="line")
            raw = request["raw"].encode("utf-8", "surrogateescape")
            answer, _ = _answer(raw, binder, verified, ledger, dialect)
        except (AuthGuardError, UnicodeError) as error:
            reason = error.reason if isinstance(error, AuthGuardError) else "MALFORMED"
            answer = {"error": {"code": str(reason), "message": str(error), "where": "line"}}
        key = request.get("id") if isinstance(request, dict) else None
        sys.stdout.write(json.dumps({"id": _plain(key), **answer}) + "\n")
        sys.stdout.flush()
    return 0


def _plain(value: Any) -> Any:
    """Return an id as it can be printed: text, integers and truth values as they are."""
    return value if value is None or isinstance(value, str | int) else str(value)


def _answer(
    data: bytes,
    binder: Binder,
    verified: VerifiedMission | None,
    ledger: ContextLedger,
    dialect: Dialect,
) -> tuple[dict[str, Any], int]:
    return _shown(
        lambda: read_plan(data, binder=binder, dialect=dialect), verified, verified, ledger
    )


def _shown(
    read: Callable[[], Plan],
    verified: VerifiedMission | None,
    rows: VerifiedMission | None,
    ledger: ContextLedger,
) -> tuple[dict[str, Any], int]:
    """Return the plan or why there is none, and the exit code.

    Args:
        read: reads the plan.
        verified: the mission that the actions are for.
        rows: the mission whose rows may settle a label; None: none does.
        ledger: what the planner saw.
    """
    try:
        plan = read()
    except ClarificationError as error:
        asked = {
            "field": error.field,
            "question": error.question,
            "candidates": list(error.candidates),
        }
        return {"clarification": asked}, 3
    except MalformedError as error:
        refusal = {"reason": str(error.reason), "where": error.where, "message": error.message}
        return {"refusal": refusal}, 4
    actions = [
        _labelled(step.action, verified, rows, ledger.base(), plan.evidence) for step in plan.steps
    ]
    return {
        "actions": [action_json(action) for action in actions],
        "dialect": str(plan.dialect),
        **({"around": plan.steps[0].around} if plan.steps[0].around else {}),
        "evidence": plan.evidence,
        "influenced_by": [
            msgspec.to_builtins(item) for action in actions for item in ledger.influences(action)
        ],
    }, 0


def _labelled(
    action: Action,
    verified: VerifiedMission | None,
    rows: VerifiedMission | None,
    base: Label,
    evidence: Digest,
) -> Action:
    """Set what a planner may not say of itself: labels, and who, when, from what."""
    labels = label_fields(action, rows, None, base=base)
    meta = ActionMeta(
        planner="planner",
        timestamp=to_timestamp(wall_now(None).utc_ms),
        evidence=evidence,
        mission=None if verified is None else verified.mission.mid,
        mission_version=0 if verified is None else verified.mission.version,
    )
    return msgspec.structs.replace(action, provenance=labels, meta=meta)
