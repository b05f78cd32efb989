# SPDX-License-Identifier: Apache-2.0
"""One proposal from its bytes to its answer, without I/O: an event goes in, effects come out.

    read -> WAITING -> turn -> DECIDING -> begun -> RUNNING -> ended -> WAITING ... -> OVER

`Plans` carries the effects out, in their order, and reports what came of each as the next event.
Nothing here decides whether an action is authorized: the effect `Decide` asks the enforcer.
Spec page: docs/spec/gate-protocol.md#propose
"""

from __future__ import annotations

from enum import StrEnum
from typing import Any

from msgspec import Struct

from authguard_r.core.errors import AuthGuardError
from authguard_r.core.identifiers import Digest
from authguard_r.core.mission import OnRefusal
from authguard_r.core.standing import Outcome
from authguard_r.enforcement.json_views import told_json
from authguard_r.enforcement.leases import Running
from authguard_r.enforcement.report import Report
from authguard_r.normalize import Plan, Step
from authguard_r.server.fair_queue import ServedClient
from authguard_r.server.proposals import CommitRecorder, Numbers, ProposalAnswer, ProposalRecord
from authguard_r.wire.disclosure import Disclosure
from authguard_r.wire.messages import Propose, Result


class ProposalStage(StrEnum):
    """Where a proposal is on its way."""

    READING = "reading"
    WAITING = "waiting"
    DECIDING = "deciding"
    RUNNING = "running"
    OVER = "over"


class RefusePlan(Struct, frozen=True):
    """Record a plan that could not be read; then `Proposal.refused`."""

    error: AuthGuardError


class NextTurn(Struct, frozen=True):
    """Let the next step wait for its client's turn; then `Proposal.turn`."""


class AwaitState(Struct, frozen=True):
    """Let a step wait while newer state may make it acceptable; then `Proposal.due`."""

    step: Step


class Decide(Struct, frozen=True):
    """Ask the enforcer to decide a step and begin it; then `Proposal.begun`."""

    step: Step
    before: ProposalRecord


class WatchAction(Struct, frozen=True):
    """Watch an action until it ends; then `Proposal.ended`."""

    running: Running
    recorder: CommitRecorder


class AwaitNotes(Struct, frozen=True):
    """Let a report wait until every result of its action is noted; then `Proposal.go_on`."""

    report: Report


class TellDecision(Struct, frozen=True):
    """Send the decision of a step that was begun to the planner."""

    step: int
    report: Report


class TellResult(Struct, frozen=True):
    """Send what an action brought to light to the planner."""

    step: int
    result: Result


class CountDecision(Struct, frozen=True):
    """Count and publish a decision."""

    report: Report


class CountOutcome(Struct, frozen=True):
    """Count and publish how a released action ended."""

    report: Report


class Forget(Struct, frozen=True):
    """Let the proposal's key go: nothing of it is under way any more."""


class StopRobot(Struct, frozen=True):
    """Stop the robot, as the mission says for a refusal."""


class SendAnswer(Struct, frozen=True):
    """Remember the answer and send it to the planner."""

    answer: ProposalAnswer


Effect = (
    RefusePlan
    | NextTurn
    | AwaitState
    | Decide
    | WatchAction
    | AwaitNotes
    | TellDecision
    | TellResult
    | CountDecision
    | CountOutcome
    | Forget
    | StopRobot
    | SendAnswer
)
Effects = tuple[Effect, ...]


class Proposal:
    """One proposal on its way.

        proposal = Proposal(client, number, asked, evidence, disclosure=..., shadow=False)
        effects = proposal.read(plan)            # (AwaitState(step),)
        effects = proposal.due()                 # (Decide(step, ...),)
        effects = proposal.begun(running, ...)   # (WatchAction(...), TellDecision(...), ...)
        effects = proposal.ended(keeper, report) # (CountOutcome(...), NextTurn()) or the answer

    Args:
        client: who is answered; another connection of the same client may take its place.
        number: the request's number.
        asked: the request.
        evidence: digest of the planner's exact bytes.
        disclosure: how much the planner sees.
        shadow: every step is judged, also after a refused one: nothing is released.
    """

    def __init__(
        self,
        client: ServedClient,
        number: int,
        asked: Propose,
        evidence: Digest,
        *,
        disclosure: Disclosure,
        shadow: bool,
    ) -> None:
        self.client = client
        self.number = number
        self.asked = asked
        self.evidence = evidence
        self.stage = ProposalStage.READING
        self._disclosure = disclosure
        self._shadow = shadow
        self._steps: tuple[Step, ...] = ()
        self._reports: list[Report] = []
        self._numbers: tuple[Numbers, ...] = ()
        self._told: list[dict[str, Any]] = []
        self._noting = 0  # results that are still searched for names

    def read(self, plan: Plan | AuthGuardError | None) -> Effects:
        """Take the plan, or why it could not be read; None: its planner was gone by then."""
        if plan is None:
            return self._leave()
        if isinstance(plan, AuthGuardError):
            return (RefusePlan(plan),)
        self._steps = plan.steps
        return self.turn()

    def refused(self, report: Report) -> Effects:
        """Take the record of a plan that could not be read."""
        self._add(report)
        return (*self._finish(), CountDecision(report))

    def turn(self) -> Effects:
        """Go on: the next step's turn has come."""
        self.stage = ProposalStage.WAITING
        return self._leave() if self.client.gone else (AwaitState(self._next),)

    def due(self) -> Effects:
        """Go on: the next step waits for no newer state."""
        if self.client.gone:
            return self._leave()
        self.stage = ProposalStage.DECIDING
        before = ProposalRecord(
            evidence=self.evidence, planned=len(self._steps), steps=self._numbers
        )
        return (Decide(self._next, before),)

    def begun(self, begun: Report | Running, recorder: CommitRecorder) -> Effects:
        """Take the decision: a final report, or the action while it runs."""
        if isinstance(begun, Running):
            self.stage = ProposalStage.RUNNING
            step, report = len(self._reports), begun.report
            return (WatchAction(begun, recorder), TellDecision(step, report), CountDecision(report))
        if begun.outcome is not None:
            return (CountDecision(begun), *self.ended(recorder, begun))
        return (*self.go_on(begun), CountDecision(begun))

    def ended(self, recorder: CommitRecorder, report: Report) -> Effects:
        """Take the final report of a released step."""
        self._numbers += recorder.numbers
        return (CountOutcome(report), *self.go_on(report))

    def go_on(self, report: Report) -> Effects:
        """Go on to the next step or to the answer; results that are not noted yet come first."""
        if self._noting:
            return (AwaitNotes(report),)
        self._add(report)
        left = len(self._reports) < len(self._steps)
        goes_on = self._shadow or report.outcome is Outcome.SUCCEEDED
        if left and goes_on and not self.client.gone:
            self.stage = ProposalStage.WAITING
            return (NextTurn(),)
        return self._finish()

    def noting(self) -> None:
        """Take note that a result is being searched for names."""
        self._noting += 1

    def noted(self, result: Result) -> Effects:
        """Go on: everything in a result was noted, so the planner may see it."""
        self._noting -= 1
        return (TellResult(len(self._reports), result),)

    @property
    def _next(self) -> Step:
        return self._steps[len(self._reports)]

    def _add(self, report: Report) -> None:
        self._reports.append(report)
        self._told.append(told_json(report, self._disclosure))

    def _leave(self) -> Effects:
        """End a plan whose planner is gone; one that was not begun may come again."""
        if self._reports:
            return self._finish()
        self.stage = ProposalStage.OVER
        return (Forget(),)

    def _finish(self) -> Effects:
        """Do what the mission says for a refusal, and answer.

        Asking a person is the console's part; the robot holds meanwhile.
        """
        self.stage = ProposalStage.OVER
        last, then = self._reports[-1], None
        if last.outcome is not Outcome.SUCCEEDED:
            judged = last.judged
            then = OnRefusal.HOLD if judged is None else judged.verified.mission.on_refusal
        answer = ProposalAnswer(
            evidence=self.evidence,
            planned=len(self._steps),
            steps=tuple(self._told),
            on_refusal=None if then is None else str(then),
        )
        brakes = (StopRobot(),) if then is OnRefusal.STOP else ()
        return (Forget(), *brakes, SendAnswer(answer))
