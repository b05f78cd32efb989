# SPDX-License-Identifier: Apache-2.0
"""Around a decision: the complete action, the repair of an unsafe one, and the decision's record.

Nothing here decides. Spec page: docs/spec/enforcement.md
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec

from authguard_r.approvals import approver_json
from authguard_r.approvals.requests import OpenRequest, fits, note_request
from authguard_r.audit.record import Entry
from authguard_r.core.action import Action, ActionMeta
from authguard_r.core.decision import Verdict
from authguard_r.core.facts import SiteFacts
from authguard_r.core.identifiers import Digest, Identifier
from authguard_r.core.provenance import Label
from authguard_r.core.quantities import Now, to_timestamp
from authguard_r.core.standing import Standing
from authguard_r.core.state import AttestedState
from authguard_r.core.token import VerifiedMission
from authguard_r.enforcement.leases import require_judged
from authguard_r.enforcement.report import Judged, Report, decision_entry
from authguard_r.normalize import Step
from authguard_r.provenance.context import ContextLedger
from authguard_r.provenance.labels import label_fields
from authguard_r.safety.repair import is_narrower
from authguard_r.store.transactions import Transaction


def attested_source(step: Step, state: AttestedState | None) -> Action:
    """Return the step's action with the source that attested state settles, if it does."""
    if "source" not in step.attested or state is None or len(state.place) != 1:
        return step.action
    return msgspec.structs.replace(step.action, source=next(iter(state.place)))


def meta_of(
    verified: VerifiedMission, *, planner: Identifier, evidence: Digest, now: Now
) -> ActionMeta:
    """Return what the enforcer says about a proposal: who proposed it, when, under which version.

    Args:
        verified: the mission that it is held against.
        planner: the client, named by its channel.
        evidence: digest of the bytes that it wrote.
        now: the instant of the decision.
    """
    return ActionMeta(
        planner=planner,
        timestamp=to_timestamp(now.utc_ms),
        evidence=evidence,
        mission=verified.mission.mid,
        mission_version=verified.mission.version,
    )


def complete(
    step: Step,
    meta: ActionMeta,
    verified: VerifiedMission,
    standing: Standing | None,
    *,
    state: AttestedState | None,
    base: Label,
) -> Action:
    """Fill what attested state settles, label every privileged field, and say whose it is.

    Args:
        step: one bound step of a plan; untrusted.
        meta: set by the enforcer.
        verified: the mission.
        standing: the registry's entry.
        state: settles the source.
        base: the least trusted label of anything the planner could have seen.
    """
    action = attested_source(step, state)
    labels = label_fields(action, verified, standing, base=base)
    if "source" in step.attested and action.source is not None:
        labels["source"] = Label.TRUSTED_SENSOR
    return msgspec.structs.replace(action, provenance=labels, meta=meta)


def repaired_step(step: Step, judged: Judged) -> Step | None:
    """Return the repair of an authorized, unsafe action as a step to be decided like any other.

    Args:
        step: what was proposed.
        judged: both gates' answers to it.

    Returns:
        None when the authorization gate did not accept, when the safety gate offers no repair, and
        when what it offers is more than fewer regions on the route and lower speeds. Source:
        `fig:architecture`.
    """
    safety = judged.safety
    repair = None if safety is None else safety.repair
    if judged.decision.verdict is not Verdict.ACCEPT or judged.released or repair is None:
        return None
    if not is_narrower(repair, judged.action):
        return None
    action = msgspec.structs.replace(repair, provenance={}, meta=None)
    return Step(action=action, attested=step.attested)


def repaired_report(
    report: Report, step: Step, judge: Callable[[Step], Judged], context: ContextLedger
) -> Report:
    """Return the report of a step's repair, decided once; the step's own without a repair.

    A repair opens no approval request while its grant has one. A new request would replace that
    one, and the approvals that the refused step still needs would end with it. The repair is then
    refused with `APPROVAL_REQUIRED`.

    Args:
        report: both gates' answers to the step.
        step: what was proposed.
        judge: asks both gates; changes nothing.
        context: what the planner could have seen.
    """
    again = repaired_step(step, require_judged(report))
    if again is None:
        return report
    judged = judge(again)
    standing, match = judged.standing, judged.decision.match
    if standing is not None and match is not None and match.indexed.grant.id in standing.requests:
        judged = msgspec.structs.replace(judged, request=None)
    return Report(
        judged=judged,
        influences=context.influences(again.action),
        around=report.around,
        repairs=report,
    )


def record_of_decision(report: Report, facts: SiteFacts) -> Entry:
    """Return the record of a decision, with who was counted and what it repairs."""
    judged = require_judged(report)
    people = counted(judged, facts)
    return decision_entry(
        judged, report.influences, people, repairs=report.repairs, around=report.around
    )


def cause_of(report: Report) -> tuple[str, str]:
    """Return reason and field of the first finding: what repeats of a refusal have in common."""
    finding = next(iter(require_judged(report).decision.findings), None)
    return ("SAFETY", "") if finding is None else (finding.reason, finding.field)


def counted(judged: Judged, facts: SiteFacts) -> list[dict[str, Any]]:
    """Return who stands behind a decision: name, role and kind of each answer that counted."""
    standing, match = judged.standing, judged.decision.match
    request = (
        None if standing is None or match is None else standing.requests.get(match.indexed.grant.id)
    )
    if request is None or standing is None or match is None:
        return []
    asked = OpenRequest(
        verified=judged.verified,
        grant=match.indexed.grant,
        request=request,
        action=judged.action,
        standing=standing,
        facts=facts,
    )
    need = judged.decision.need
    if need is None or (need.scope, need.situation) != (request.scope, request.situation):
        return []  # another question is open: no answer was counted
    return [
        {**approver_json(item.approver), "verdict": str(item.approval.verdict)}
        for item in judged.answers
        if fits(asked, item, judged.now)
    ]


def record_decision(act: Transaction, judged: Judged, entry: Entry) -> int:
    """Record a decision that changed something; of a new request the number is held with it."""
    seq = act.record(entry)
    if judged.request is not None:
        note_request(act, judged.verified.mission.mid, judged.request.counter, seq)
    return seq
