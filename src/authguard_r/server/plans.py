# SPDX-License-Identifier: Apache-2.0
"""Every planner's proposal: read, then carried out as `Proposal` says, step by step.

Nothing here decides: the enforcer decides each step when its turn comes.
Spec page: docs/spec/gate-protocol.md#propose
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any, Protocol

from authguard_r.core.encoding import Tag, b64, digest
from authguard_r.core.errors import AuthGuardError, EnvironmentFault, MalformedError
from authguard_r.core.identifiers import Identifier
from authguard_r.core.reasons import Reason
from authguard_r.enforcement.enforcer import Enforcer
from authguard_r.enforcement.json_views import decision_json, told_json
from authguard_r.enforcement.leases import require_judged
from authguard_r.enforcement.report import Report
from authguard_r.normalize import Binder, Dialect, Plan, read_plan
from authguard_r.server.contexts import PlannerContexts
from authguard_r.server.fair_queue import ServedClient
from authguard_r.server.lease_registry import LeaseRegistry
from authguard_r.server.plan_reader import PlanReader, Taken
from authguard_r.server.proposal import (
    AwaitNotes,
    AwaitState,
    CountDecision,
    CountOutcome,
    Decide,
    Effect,
    Effects,
    Forget,
    NextTurn,
    Proposal,
    RefusePlan,
    SendAnswer,
    StopRobot,
    TellDecision,
    TellResult,
    WatchAction,
)
from authguard_r.server.proposals import (
    CommitRecorder,
    ProposalAnswer,
    ProposalRegistry,
    require_same_plan,
)
from authguard_r.server.what_if import WhatIf
from authguard_r.wire.disclosure import Disclosure
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import Evaluate, Fault, Propose, Result

_HANDED_OVER = Fault(
    code=Reason.BUSY,
    message="another connection of this client asked for the answer",
    where="proposal.key",
)


class Later(Protocol):
    """Lets something of a client wait for its turn."""

    def __call__(
        self, client: ServedClient, act: Callable[[], None], *, first: bool = False
    ) -> None:
        """Put it behind what waits of the client, or `first`, before all of that."""
        ...


def parts_of(text: str) -> list[str]:
    """Return a text in parts that are each searched in one turn; of an empty one, itself."""
    size = LIMITS.part_characters
    return [text[at : at + size] for at in range(0, len(text), size)] or [""]


class Plans:
    """Every proposal that is not answered yet.

    Args:
        enforcer: decides and begins each step.
        binder: the planner's tools.
        reader: reads long plans in a process of its own.
        contexts: what each planner has seen.
        leases: watches what was released.
        proposals: what is recorded of earlier proposals.
        foresight: asks both gates without any effect, and lets a step wait for newer state.
        disclosure: how much a planner sees.
        shadow: every step is judged, also after a refused one: nothing is released.
        later: lets a client's next step wait for its turn.
        answered: called with a client whose proposal was answered.
        decided: called with the report of every decision; one that released has no outcome yet.
        ended: called with the report of everything that was released, once it has one.
    """

    def __init__(
        self,
        enforcer: Enforcer,
        binder: Binder,
        *,
        reader: PlanReader,
        contexts: PlannerContexts,
        leases: LeaseRegistry,
        proposals: ProposalRegistry,
        foresight: WhatIf,
        disclosure: Disclosure,
        shadow: bool,
        later: Later,
        decided: Callable[[ServedClient, Report], None],
        ended: Callable[[ServedClient, Report], None],
        answered: Callable[[ServedClient], None],
    ) -> None:
        self._enforcer = enforcer
        self._binder = binder
        self._reader = reader
        self.contexts = contexts
        self._leases = leases
        self._proposals = proposals
        self._foresight = foresight
        self._disclosure = disclosure
        self._shadow = shadow
        self._later = later
        self._decided = decided
        self._ended = ended
        self._answered = answered
        self._open: dict[tuple[Identifier, str], Proposal] = {}

    def propose(self, client: ServedClient, number: int, asked: Propose) -> None:
        """Begin a plan, or answer a repeat from what is recorded.

        Raises:
            RefusedError: another plan came under this key.
            AuthGuardError: what is recorded cannot be read.
        """
        evidence = digest(Tag.RAW, asked.plan)
        going = self._open.get((client.name, asked.key))
        if going is not None:
            require_same_plan(going.evidence, evidence)
            self._hand_over(going, client, number)
            return
        known = self._proposals.recall(client.name, asked.key, evidence)
        if known is not None:
            self._answer(client, number, known, repeated=True)
            return
        dialect = _dialect(asked.dialect)
        proposal = Proposal(
            client, number, asked, evidence, disclosure=self._disclosure, shadow=self._shadow
        )
        self._open[client.name, asked.key] = proposal
        try:
            self._read_plan(
                client,
                asked.plan,
                dialect,
                lambda plan: self._carry_out(proposal, proposal.read(plan)),
                wanted=lambda: not proposal.client.gone,  # another connection may have taken over
            )
        except BaseException:  # after any exception the key is free again
            self._open.pop((client.name, asked.key), None)
            raise

    def evaluate(
        self,
        client: ServedClient,
        asked: Evaluate,
        answer: Callable[[list[dict[str, Any]] | AuthGuardError], None],
    ) -> None:
        """Answer what both gates would say of each step; nothing is recorded or released.

        Args:
            client: who asks.
            asked: the plan.
            answer: called once, with the decisions or with the error.

        Raises:
            MalformedError: no such dialect.
        """

        def read(plan: Plan | AuthGuardError | None) -> None:
            try:
                if plan is None:
                    return
                if isinstance(plan, AuthGuardError):
                    raise plan
                judged = map(self._foresight.judge, plan.steps)
                answer([decision_json(one, authoritative=False) for one in judged])
            except AuthGuardError as error:
                answer(error)

        dialect = _dialect(asked.dialect)
        self._read_plan(client, asked.plan, dialect, read, wanted=lambda: not client.gone)

    def _hand_over(self, proposal: Proposal, client: ServedClient, number: int) -> None:
        """Give the answer to a client that came back, and let the connection before go on."""
        proposal.client.error(proposal.number, _HANDED_OVER)
        self._answered(proposal.client)
        proposal.client, proposal.number = client, number

    def _read_plan(
        self,
        client: ServedClient,
        data: bytes,
        dialect: Dialect,
        taken: Taken,
        *,
        wanted: Callable[[], bool],
    ) -> None:
        """Read a plan: a short one here, a long one in a process of its own.

        Raises:
            EnvironmentFault: too many long ones wait already.
        """
        if len(data) > LIMITS.short_plan_bytes:
            self._reader.read(data, dialect, taken, uid=client.uid, wanted=wanted)
            return
        try:
            plan: Plan | AuthGuardError = read_plan(data, binder=self._binder, dialect=dialect)
        except AuthGuardError as error:
            plan = error
        taken(plan)

    # effects

    def _carry_out(self, proposal: Proposal, effects: Effects) -> None:
        """Carry out effects in their order; each event that follows has its own effects."""
        for effect in effects:
            self._do(proposal, effect)

    def _do(  # noqa: C901, PLR0912 - one case for each effect
        self, proposal: Proposal, effect: Effect
    ) -> None:
        client = proposal.client
        match effect:
            case RefusePlan(error):
                self._refuse_plan(proposal, error)
            case NextTurn():
                self._later(client, lambda: self._carry_out(proposal, proposal.turn()))
            case AwaitState():
                self._await_state(proposal, effect, None)
            case Decide():
                self._decide(proposal, effect)
            case WatchAction():
                self._watch(proposal, effect)
            case AwaitNotes(report):
                self._later(client, lambda: self._carry_out(proposal, proposal.go_on(report)))
            case TellDecision(step, report):
                ticket, told = require_judged(report).ticket, told_json(report, self._disclosure)
                client.event(proposal.number, {"step": step, "ticket": ticket, **told})
            case TellResult(step, result):
                event = {"step": step, "ticket": result.ticket, "result": result.content}
                client.event(proposal.number, event)
            case CountDecision(report):
                self._decided(client, report)
            case CountOutcome(report):
                self._ended(client, report)
            case Forget():
                self._open.pop((client.name, proposal.asked.key), None)
            case StopRobot():
                self._enforcer.stop(by=Identifier("gate"), is_planner=False)
            case SendAnswer(answer):
                self._proposals.remember(client.name, proposal.asked.key, answer)
                self._answer(client, proposal.number, answer, repeated=False)

    def _refuse_plan(self, proposal: Proposal, error: AuthGuardError) -> None:
        asked = proposal.asked
        inputs = {"plan": b64(asked.plan), "dialect": asked.dialect} if self._shadow else {}
        refused = self._enforcer.refuse_plan(error, planner=proposal.client.name, inputs=inputs)
        self._carry_out(proposal, proposal.refused(refused))

    def _await_state(self, proposal: Proposal, effect: AwaitState, until_ms: int | None) -> None:
        """Let a step wait for newer state, until then at most; decide it when none is awaited."""

        def again(until_ms: int) -> None:
            self._later(proposal.client, lambda: self._await_state(proposal, effect, until_ms))

        if proposal.client.gone or not self._foresight.holds(effect.step, until_ms, again):
            self._carry_out(proposal, proposal.due())

    def _decide(self, proposal: Proposal, effect: Decide) -> None:
        client, asked = proposal.client, proposal.asked
        recorder = CommitRecorder(client.name, asked.key, effect.before)
        begun = self._enforcer.submit(
            effect.step,
            planner=client.name,
            evidence=proposal.evidence,
            context=self.contexts.of(client),
            on_commit=recorder,
            inputs={"action": effect.step.action} if self._shadow else {},
            repair=asked.repair,
        )
        self._carry_out(proposal, proposal.begun(begun, recorder))

    def _watch(self, proposal: Proposal, effect: WatchAction) -> None:
        running, recorder = effect.running, effect.recorder
        self._leases.add(
            proposal.client.name,
            running,
            lambda report: self._carry_out(proposal, proposal.ended(recorder, report)),
            gone=lambda: proposal.client.gone,
            told=partial(self._note, proposal, self._binder.result_channel(running.action)),
        )

    def _note(self, proposal: Proposal, channel: str, result: Result) -> None:
        """Note an action's result, one part in each turn, before its planner receives it."""
        parts = [part for text in result.texts or ("",) for part in parts_of(text)]
        proposal.noting()

        def note() -> None:
            if parts:
                with suppress(EnvironmentFault):  # then it counts as anything
                    self.contexts.observe(proposal.client, channel, parts.pop(0))
                self._later(proposal.client, note, first=True)
            else:
                self._carry_out(proposal, proposal.noted(result))

        note()

    def _answer(
        self, client: ServedClient, number: int, known: ProposalAnswer, *, repeated: bool
    ) -> None:
        client.reply(
            number,
            {
                "steps": known.steps,
                "planned": known.planned,
                "on_refusal": known.on_refusal,
                "repeated": repeated,
                "shadow": self._shadow,
            },
        )
        self._answered(client)


def _dialect(name: str) -> Dialect:
    try:
        return Dialect(name)
    except ValueError as error:
        raise MalformedError(
            f"expected one of {', '.join(sorted(Dialect))}", where="proposal.dialect"
        ) from error
