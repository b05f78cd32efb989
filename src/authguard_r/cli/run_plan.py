# SPDX-License-Identifier: Apache-2.0
"""One plan on the simulated robot: read whole, then each step through both gates."""

from __future__ import annotations

import os
from functools import partial
from typing import Any

import msgspec
import typer
from msgspec import Struct

from authguard_r.authoring.compile.card import compare
from authguard_r.authoring.compile.change import smallest_change, to_draft
from authguard_r.cli.run_approvals import (
    Approvers,
)
from authguard_r.core.encoding import b64
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.mission import OnRefusal
from authguard_r.core.quantities import Now, to_timestamp
from authguard_r.core.standing import Outcome
from authguard_r.enforcement.report import Report
from authguard_r.normalize import Dialect, read_plan
from authguard_r.operations.simulation import Simulation
from authguard_r.provenance.context import ContextLedger
from authguard_r.provenance.mentions import MentionMatch

PLANNER = "planner"


class ProposedChange(Struct, frozen=True, kw_only=True):
    """A next version that would allow what was refused: as a draft, and what it adds."""

    draft: dict[str, Any]
    adds: tuple[str, ...]


class PlanResult(Struct, frozen=True, kw_only=True):
    """The result of one plan.

    Args:
        reports: one for each step that was reached; one alone when the plan could not be read.
        steps: how many steps the plan had; 0 when it could not be read.
        alerts: what an operator should look at.
        change: the smallest signed change after a refusal, as a draft; for the operator only.
        then: what the enforcer did after a refusal.
    """

    reports: tuple[Report, ...]
    steps: int
    alerts: tuple[str, ...] = ()
    change: ProposedChange | None = None
    then: str | None = None


def run_plan(
    simulation: Simulation,
    plan: bytes,
    *,
    dialect: Dialect,
    context: ContextLedger,
    ask: bool,
    repair: bool = False,
    people: Approvers | None = None,
) -> PlanResult:
    """Read a plan whole, then decide and carry out each step when its turn comes.

    Args:
        simulation: the gate and its robot.
        plan: what the planner wrote.
        dialect: how to read it.
        context: what the planner could have seen.
        ask: a person is there to be asked after a refusal.
        repair: decide the repair of a step that only the safety gate refused, too.
        people: who may answer an approval request before the step is proposed once more.
    """
    enforcer = simulation.gate.enforcer
    try:
        read = read_plan(plan, binder=simulation.binder, dialect=dialect)
    except AuthGuardError as error:
        refused = enforcer.refuse_plan(error, planner=PLANNER)
        return PlanResult(reports=(refused,), steps=0, then="hold")
    propose = partial(enforcer.propose, planner=PLANNER, evidence=read.evidence, context=context)
    reports: list[Report] = []
    for step in read.steps:
        report = propose(step, repair=repair)
        if people is not None and people.answered(simulation, report):
            report = propose(step, repair=repair)
        reports.append(report)
        if report.outcome is not Outcome.SUCCEEDED:
            break
    ran, last = PlanResult(reports=tuple(reports), steps=len(read.steps)), reports[-1]
    if len(reports) == len(read.steps) and last.outcome is Outcome.SUCCEEDED:
        return ran
    then, change = _after_refusal(simulation, last, ask=ask), _change(simulation, last)
    return msgspec.structs.replace(ran, alerts=_alerts(last), change=change, then=then)


def _after_refusal(simulation: Simulation, report: Report, *, ask: bool) -> str:
    """Do what the mission prescribes after a refusal; hold when no person can be asked."""
    if report.judged is None:
        return OnRefusal.HOLD
    wanted = report.judged.verified.mission.on_refusal
    if wanted is OnRefusal.STOP:
        simulation.gate.enforcer.stop(by="gate", is_planner=False)
    if wanted is OnRefusal.ASK and ask:
        typer.confirm("The step was refused. Stay here?", default=True)
    return wanted


def _alerts(report: Report) -> tuple[str, ...]:
    if report.judged is None:
        return ("the plan's step was refused before a decision",)
    alerts = [f"refused: {reason}" for reason in report.judged.decision.reasons]
    alerts += [f"aborted: {finding.reason}" for finding in report.reasons]
    alerts += [
        f"influenced by {item.channel}: too long to be read, it may mention `{item.value}`"
        if item.how is MentionMatch.UNREAD
        else f"influenced by {item.channel}: it mentions `{item.value}`"
        for item in report.influences
    ]
    return tuple(alerts)


def _change(simulation: Simulation, report: Report) -> ProposedChange | None:
    """Return the smallest signed change that would allow the refused step, as a draft."""
    judged = report.judged
    if judged is None or judged.decision.match is None or report.outcome is not None:
        return None
    now = Now(simulation.robot.wall_ms() + 1_800_000, 0)
    amended = smallest_change(
        judged.verified.mission,
        judged.action,
        reasons=judged.decision.reasons,
        grant=judged.decision.match.indexed.grant.id,
        digest=judged.verified.digest,
        nonce=b64(os.urandom(16)),
        expiry=to_timestamp(now.utc_ms),
    )
    if amended is None:
        return None
    adds = compare(judged.verified.mission, amended, simulation.robot.site)
    return ProposedChange(draft=to_draft(amended), adds=adds)
