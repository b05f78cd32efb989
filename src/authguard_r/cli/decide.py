# SPDX-License-Identifier: Apache-2.0
"""`authguard decide`: one what-if decision; nothing is consumed, recorded or executed."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from msgspec import Struct, to_builtins
from msgspec.structs import replace

from authguard_r.approvals.organization import VerifiedPolicy
from authguard_r.audit.deviation import Weights
from authguard_r.authoring.compile.sources import given_weights
from authguard_r.cli.inputs import (
    JsonFlag,
    NowOption,
    RiskPolicyOption,
    SiteOption,
    TokenOption,
    TrustOption,
    WeightOption,
    gate_facts,
    load_site,
    read_action,
    read_context,
    read_input,
    read_mission,
    read_risk_policy,
    read_state,
    text_of,
    wall_now,
)
from authguard_r.cli.out import decision_lines, risk_policy_json, verdict_code
from authguard_r.core.encoding import decode
from authguard_r.core.errors import AuthGuardError, MalformedError
from authguard_r.core.facts import SiteFacts
from authguard_r.core.lifecycle import Event
from authguard_r.core.ports import SafetyGate
from authguard_r.core.quantities import Now
from authguard_r.core.standing import Standing, advance, issue
from authguard_r.core.state import AttestedState
from authguard_r.core.token import VerifiedMission
from authguard_r.enforcement.evaluation import evaluate
from authguard_r.enforcement.json_views import decision_json
from authguard_r.enforcement.report import Judged
from authguard_r.keys.trust import Trust, read_trust
from authguard_r.normalize.bind import site_spellings
from authguard_r.normalize.parse import read_json
from authguard_r.provenance.context import ContextLedger
from authguard_r.safety import EnvelopeGate, default_config
from authguard_r.store.sqlite import read_held
from authguard_r.wire.output import emit


class _Question(Struct, frozen=True, kw_only=True):
    """Everything about a what-if that stays the same from line to line."""

    verified: VerifiedMission
    facts: SiteFacts
    risk: VerifiedPolicy | None
    trust: Trust
    standing: Standing | None
    safety: SafetyGate
    ledger: ContextLedger
    weights: Weights


def decide_command(
    token: TokenOption,
    trust: TrustOption,
    site: SiteOption,
    state: Annotated[
        Path | None,
        typer.Option("--state", help="A snapshot, signed or plain; `-`: standard input."),
    ] = None,
    action: Annotated[Path | None, typer.Option("--action", help="An action (JSON).")] = None,
    now: NowOption = None,
    store: Annotated[
        Path | None, typer.Option("--store", help="Use the mission's standing in this store.")
    ] = None,
    context: Annotated[
        Path | None, typer.Option("--context", help="What the planner saw (JSON Lines).")
    ] = None,
    robot: Annotated[
        str | None,
        typer.Option("--robot", help="The robot, if the trust folder has several gates."),
    ] = None,
    risk_policy: RiskPolicyOption = None,
    weight: WeightOption = None,
    jsonl: Annotated[
        bool,
        typer.Option(
            "--jsonl", help='One {"id", "action", "state"?, "now"?} a line in, one answer out.'
        ),
    ] = False,
    as_json: JsonFlag = False,
) -> int:
    """Decide one action in one state as a dry run: nothing is consumed, recorded or moved."""
    at = wall_now(now)
    anchor = read_trust(trust)
    model = load_site(site, anchor, at)
    risk = read_risk_policy(risk_policy, anchor, at)
    facts = gate_facts(trust, anchor, model, now=at, robot=robot)
    demands = () if risk is None else (risk.policy.policy,)
    verified = read_mission(token, anchor, at)
    question = _Question(
        verified=verified,
        facts=replace(facts, risk=demands),
        risk=risk,
        trust=anchor,
        standing=_standing(verified, store),
        safety=EnvelopeGate(default_config(model, facts.robot.rid)),
        ledger=read_context(context, site_spellings(model), channels=model.channels),
        weights=given_weights(weight or (), where="--weight"),
    )
    default = None if state is None else read_input(state)
    if jsonl:
        return _stream(question, default, at)
    if action is None:
        raise typer.BadParameter("expected an action, or --jsonl", param_hint="--action")
    plain = read_json(text_of(read_input(action), "action"), where="action")
    judged = _decide(question, plain, default, at)
    lines = [*decision_lines(judged), *_counted(risk)]
    emit(_answer(question, judged), lines, as_json=as_json)
    return verdict_code(judged.decision)


def _standing(verified: VerifiedMission, store: Path | None) -> Standing | None:
    """Return the store's entry; without a store, a mission that was just activated."""
    if store is None:
        return advance(issue(verified), Event.ACTIVATE)
    held = read_held(store, "standing", verified.mission.mid)
    return None if held is None else decode(held, Standing, where="store.standing")


def _decide(question: _Question, plain: Any, state: bytes | None, now: Now) -> Judged:
    attested: AttestedState | None = None
    if state is not None:
        attested = read_state(state, facts=question.facts, trust=question.trust, now=now)
    judged = evaluate(
        question.verified,
        read_action(plain),
        state=attested,
        facts=question.facts,
        now=now,
        standing=question.standing,
        safety=question.safety,
        base=question.ledger.base(),
    )
    return replace(judged, weights=question.weights or judged.weights)


def _answer(question: _Question, judged: Judged) -> dict[str, Any]:
    influences = question.ledger.influences(judged.action)
    answer = decision_json(judged, authoritative=False)
    return {
        **answer,
        "influenced_by": [to_builtins(item) for item in influences],
        "risk_policy": risk_policy_json(question.risk),
    }


def _counted(risk: VerifiedPolicy | None) -> list[str]:
    """Return which organization's policy counted beside the mission's, for people."""
    if risk is None:
        return []
    own = risk.policy
    return [f"  decided with the risk policy of {own.organization}, version {own.version}"]


def _stream(question: _Question, default: bytes | None, now: Now) -> int:
    """Answer line by line; a bad line gets an error answer and the stream goes on."""
    for line in sys.stdin.buffer:
        if not line.strip():
            continue
        request: Any = None
        try:
            request = read_json(line.decode("utf-8", "surrogateescape"), where="line")
            if not isinstance(request, dict) or "action" not in request:
                raise MalformedError('expected {"id": ..., "action": ...}', where="line")
            given = request.get("state")
            state = default if given is None else json.dumps(given, default=str).encode()
            at = wall_now(request["now"]) if request.get("now") is not None else now
            judged = _decide(question, request["action"], state, at)
            answer = _answer(question, judged)
        except AuthGuardError as error:
            found = {"code": str(error.reason), "message": error.message, "where": error.where}
            answer = {"error": found}
        except (typer.BadParameter, UnicodeError, TypeError) as error:
            answer = {"error": {"code": "MALFORMED", "message": str(error), "where": "line"}}
        key = request.get("id") if isinstance(request, dict) else None
        shown = key if key is None or isinstance(key, str | int) else str(key)
        sys.stdout.write(json.dumps({"id": shown, **answer}) + "\n")
        sys.stdout.flush()
    return 0
