# SPDX-License-Identifier: Apache-2.0
"""The report of a proposal: as a value, and as the entry that the log keeps.

A record holds every input that replaying its decision needs; what may be sensitive is committed
to, what counts and codes lies open. Spec page: docs/spec/audit-record.md
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from fractions import Fraction
from typing import Any

import msgspec
from msgspec import Raw, Struct

from authguard_r.audit.deviation import Weights, deviation
from authguard_r.audit.record import NONE, Entry
from authguard_r.core.action import Action
from authguard_r.core.approval import VerifiedApproval
from authguard_r.core.decision import Decision, Verdict
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.finding import Findings
from authguard_r.core.identifiers import Digest, Identifier, MissionId
from authguard_r.core.lifecycle import Status
from authguard_r.core.mission import RiskPolicy
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.safety import Hazard, SafetyDecision
from authguard_r.core.standing import ApprovalRequest, Outcome, Spend, Standing
from authguard_r.core.state import AttestedState
from authguard_r.core.token import VerifiedMission
from authguard_r.provenance.context import Influence

#: What the log says of the second gate when the first refused.
NOT_EVALUATED = "not evaluated"
#: What the log calls a plan or a step that was refused before a decision.
PROPOSAL = "proposal"
#: What is said of weights that are not signed: each field weighs 1.
EQUAL = "equal"
#: What the second gate says for want of newer state.
_UNKNOWN = frozenset({Hazard.STATE_UNKNOWN, Hazard.NOT_EXECUTABLE})


class Judged(Struct, frozen=True, kw_only=True):
    """One proposal after both gates, before anything was dispatched.

    Args:
        action: complete: source attested, labels and meta set.
        action_digest: digest of all of it; equal digests mean equal dispatched bytes.
        decision: the authorization gate's.
        safety: the safety gate's; None when it was not evaluated.
        verified: the mission it was held against.
        standing: as it was read.
        state: as it was read.
        now: the instant of the decision.
        ticket: names this release; two equal actions have two tickets.
        request: a new approval request, when one is to be opened.
        approvals: tokens of the answers that were looked at.
        answers: the same, verified.
        weights: w_j that D_M is measured with; none: all are equal.
    """

    action: Action
    action_digest: Digest
    decision: Decision
    safety: SafetyDecision | None
    verified: VerifiedMission
    standing: Standing | None
    state: AttestedState | None
    now: Now
    ticket: Digest
    request: ApprovalRequest | None = None
    approvals: tuple[str, ...] = ()
    answers: tuple[VerifiedApproval, ...] = ()
    weights: Weights = {}

    @property
    def deviation(self) -> Fraction:
        """D_M of the action, 0 when the gate accepted it (`eq:action-deviation`)."""
        found = self.decision.reasons
        return deviation(found, self.weights) if found else Fraction(0)

    @property
    def released(self) -> bool:
        """True when both gates let it through (`eq:execute`)."""
        safe = self.safety is not None and self.safety.safe
        return self.decision.verdict is Verdict.ACCEPT and safe


class Refusal(Struct, frozen=True):
    """A refusal that has no decision: the code, the place and what was expected there."""

    reason: Reason
    where: str
    message: str


class Report(Struct, frozen=True, kw_only=True):
    """The report of one proposal, for the planner's client, the operator and the log.

    Args:
        judged: both gates' answers; None when an exception refused it first.
        refusal: set exactly when there is no decision.
        outcome: how the released action ended; None when nothing was released.
        reasons: why a released action was not begun or was aborted.
        influences: inputs that mentioned what the action carries.
        around: what stood around the plan's calls and was not looked at.
        seq: number of the decision's record, None when none could be written.
        outcome_recorded: False of a refusal that is at most counted, for want of room; and
            when the store failed after the robot had moved; the release
            then stays open until it is resolved.
        repairs: the refused report whose repair was decided here; None of a planner's own step.
    """

    judged: Judged | None
    refusal: Refusal | None = None
    outcome: Outcome | None = None
    reasons: Findings = ()
    influences: tuple[Influence, ...] = ()
    around: str = ""
    seq: int | None = None
    outcome_recorded: bool = True
    repairs: Report | None = None


def open_question(
    decision: Decision,
    verified: VerifiedMission,
    standing: Standing | None,
    now: Now,
    *,
    risk: tuple[RiskPolicy, ...] = (),
) -> ApprovalRequest | None:
    """Return a new approval request, unless this very question is open already.

    Args:
        decision: what asks.
        verified: the mission.
        standing: the registry's entry.
        now: the instant of the decision.
        risk: the organization's policies: the request lives as long as the shortest allows.
    """
    need, match = decision.need, decision.match
    if decision.verdict is not Verdict.REQUEST_APPROVAL or standing is None:
        return None
    if match is None or need is None or need.scope is None or need.situation is None:
        return None  # pragma: no cover - step 7 asked, so it said for what
    grant = match.indexed.grant.id
    open_now = standing.requests.get(grant)
    if open_now is not None and (open_now.scope, open_now.situation) == (
        need.scope,
        need.situation,
    ):
        return None
    return ApprovalRequest(
        counter=standing.counter + 1,
        scope=need.scope,
        situation=need.situation,
        required=need.required,
        expires_ms=now.utc_ms
        + min(policy.valid_ms for policy in (verified.mission.risk_policy, *risk)),
    )


def decision_entry(
    judged: Judged,
    influences: tuple[Influence, ...],
    counted: list[dict[str, Any]] | None = None,
    *,
    repairs: Report | None = None,
    around: str = "",
) -> Entry:
    """Return the record of one decision (e_i of `eq:log` and every input of a replay).

    Args:
        judged: the decision.
        influences: inputs that mentioned what the action carries.
        counted: who stands behind it (`counted`), when people were asked.
        repairs: the refused report whose repair this is; named by its number (-1 while it has
            none) and the digest of its action.
        around: what stood around the plan's calls and was not looked at.
    """
    decision, mission = judged.decision, judged.verified.mission
    share = judged.deviation
    state = judged.state
    return Entry(
        kind="decision",
        time_ms=judged.now.utc_ms,
        decision=decision.verdict,
        mid=mission.mid,
        action=judged.action_digest,
        state=NONE if state is None else state.digest,
        open={
            "version": mission.version,
            "mission": judged.verified.digest,
            "labels": judged.action.provenance,
            "reasons": list(decision.reasons),
            "safety": _safety_summary(judged.safety),
            "grant": NONE if decision.match is None else decision.match.indexed.grant.id,
            "required": 1 if decision.need is None else decision.need.required,
            "risk": 0 if decision.need is None else decision.need.risk,
            "deviation": [share.numerator, share.denominator],
            "weights": dict(judged.weights) or EQUAL,
            "ticket": judged.ticket if judged.released else NONE,
            **({} if judged.request is None else {"asks": judged.request.counter}),
            **({"approvers": counted} if counted else {}),
            **({"preapproved": decision.preapproved} if decision.preapproved else {}),
            **({} if repairs is None else _repaired(repairs)),
            **({"around": around} if around else {}),
        },
        sealed={
            "action": judged.action,
            "approvals": judged.approvals,
            "findings": decision.findings,
            "influences": influences,
            "now": judged.now,
            "standing": [] if judged.standing is None else [judged.standing],
            "state": [] if state is None else [_arrived(state)],
        },
    )


def _repaired(refused: Report) -> dict[str, Any]:
    digested = {} if refused.judged is None else {"repairs_action": refused.judged.action_digest}
    return {"repairs": -1 if refused.seq is None else refused.seq, **digested}


def _arrived(state: AttestedState) -> dict[str, object]:
    arrived = {"snapshot": Raw(state.data), "arrived_mono_ms": state.arrived_mono_ms}
    return {**arrived, "fence": state.fence}


def behind_of(state: AttestedState | None) -> set[str]:
    """Return the variables, and `pose`, whose values are from before the robot's last motion."""
    if state is None:
        return set()
    pose, readings = state.snapshot.pose, state.snapshot.readings
    behind = {str(name) for name, value in readings.items() if value.fence < state.fence}
    return behind | ({"pose"} if pose is not None and pose.fence < state.fence else set())


def lacks_state(safety: SafetyDecision | None) -> bool:
    """True when the second gate refused for want of state alone, so that newer state may help."""
    unsafe = () if safety is None or safety.safe else safety.findings
    return bool(unsafe) and {finding.hazard for finding in unsafe} <= _UNKNOWN


def outcome_entry(
    judged: Judged,
    outcome: Outcome,
    findings: Findings,
    *,
    used: Spend,
    now: Now,
    stood_ms: int | None = None,
) -> Entry:
    """Return the record of how a released action ended; `stood_ms` after the order to stop."""
    mission = judged.verified.mission
    stood = {} if stood_ms is None else {"stood_ms": stood_ms}
    return Entry(
        kind="outcome",
        time_ms=now.utc_ms,
        decision=outcome,
        mid=mission.mid,
        action=judged.action_digest,
        open={
            "version": mission.version,
            "ticket": judged.ticket,
            "reasons": list(dict.fromkeys(finding.reason for finding in findings)),
            "used": msgspec.to_builtins(used),
            **stood,
        },
        sealed={"findings": findings},
    )


def refusal_entry(error: AuthGuardError, time_ms: int, *, client: Identifier = NONE) -> Entry:
    """Return the record of a refusal that has no decision.

    Args:
        error: what refused it.
        time_ms: trusted time.
        client: who asked, named by the channel.
    """
    return Entry(
        kind="refusal",
        time_ms=time_ms,
        decision=Verdict.REJECT,
        open={"reasons": [error.reason], "safety": NOT_EVALUATED, "client": client},
        sealed={"where": error.where, "message": error.message},
    )


def refused_proposal(
    error: AuthGuardError, time_ms: int, *, client: Identifier, inputs: Mapping[str, Any]
) -> Entry:
    """Return the record of a planner's plan or step that was refused before a decision.

    Args:
        error: what refused it.
        time_ms: trusted time.
        client: who proposed, named by the channel.
        inputs: further values to seal.
    """
    entry = refusal_entry(error, time_ms, client=client)
    return msgspec.structs.replace(
        entry, open={**entry.open, "what": PROPOSAL}, sealed={**entry.sealed, **inputs}
    )


def stop_entry(
    by: Identifier, *, is_planner: bool, details: Mapping[str, Any], why: str
) -> Callable[[int], Entry]:
    """Return what makes the record of a stop, once there is a time for it.

    Args:
        by: who asked, named by the channel.
        is_planner: counted against the planner's budget of stops.
        details: what else lies open.
        why: the person who stopped may have written anything: sealed.
    """
    return lambda at: Entry(
        kind="stop",
        time_ms=at,
        decision="stop",
        open={"by": by, "planner": is_planner, **details},
        sealed={"why": why} if why else {},
    )


def suspension_entry(held: Standing, now: Now) -> Entry:
    """Return the record of a mission that an operator's stop suspended, or ended."""
    verb = "suspend" if held.status is Status.SUSPENDED else "complete"
    opened = {"verb": verb, "by": "stop", "status": held.status}
    return Entry(kind="management", time_ms=now.utc_ms, decision=verb, mid=held.mid, open=opened)


def alert_entry(what: str, mid: MissionId, now: Now) -> Entry:
    """Return the record of an alert; it changes no authority."""
    return Entry(kind="alert", time_ms=now.utc_ms, decision="alert", mid=mid, open={"what": what})


def _safety_summary(safety: SafetyDecision | None) -> Any:
    if safety is None:
        return NOT_EVALUATED
    return {"safe": safety.safe, "hazards": [finding.hazard for finding in safety.findings]}


def plan_deviation(actions: Iterable[tuple[Reason, ...]], weights: Weights) -> Fraction:
    """Return D_M(P), the largest deviation of a plan's actions: one violation is enough.

    Args:
        actions: the reason codes of each action.
        weights: w_j.

    Source: `eq:plan-deviation`
    """
    return max((deviation(reasons, weights) for reasons in actions), default=Fraction(0))


def average_deviation(actions: Collection[tuple[Reason, ...]], weights: Weights) -> Fraction:
    """Return the average that experiments report beside D_M(P)."""
    each = [deviation(reasons, weights) for reasons in actions]
    return sum(each, Fraction(0)) / max(len(each), 1)
