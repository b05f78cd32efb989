# SPDX-License-Identifier: Apache-2.0
"""A planner's plan from its bytes to its answer: read whole, then step by step.

Nothing here decides: each step goes down the enforcer's road when its turn comes.
Spec page: docs/spec/gate-protocol.md#propose
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any

from authguard_r.core.encoding import Tag, b64, digest
from authguard_r.core.errors import AuthGuardError, EnvironmentFault, MalformedError
from authguard_r.core.identifiers import Identifier
from authguard_r.core.mission import OnRefusal
from authguard_r.core.provenance import TRUST
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Outcome
from authguard_r.enforcement.enforcer import Enforcer
from authguard_r.enforcement.json_views import decision_json, told_json
from authguard_r.enforcement.leases import Running, require_judged
from authguard_r.enforcement.report import Report
from authguard_r.normalize import Binder, Dialect, Plan, normalize
from authguard_r.provenance.context import ContextLedger
from authguard_r.server.fair_queue import ServedClient
from authguard_r.server.lease_registry import LeaseRegistry
from authguard_r.server.plan_reader import PlanReader, Taken
from authguard_r.server.plan_run import Later, ServedPlan
from authguard_r.server.proposals import (
    Keeper,
    ProposalAnswer,
    ProposalRecord,
    ProposalRegistry,
    require_same_plan,
)
from authguard_r.server.what_if import WhatIf
from authguard_r.wire.disclosure import Disclosure
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import Evaluate, Fault, Propose, Result

#: Characters of an observed text that are looked through in one turn.
_HANDED_OVER = Fault(
    code=Reason.BUSY,
    message="another connection of this client asked for the answer",
    where="proposal.key",
)


def parts_of(text: str) -> list[str]:
    """Return a text in parts that are each looked through in a turn; of an empty one, itself."""
    return [
        text[at : at + LIMITS.part_characters] for at in range(0, len(text), LIMITS.part_characters)
    ] or [""]


class Plans:
    """Every plan that is not answered yet.

    Args:
        enforcer: the road.
        binder: the planner's tools.
        reader: reads long plans.
        motions: watches what was released.
        proposals: what is recorded.
        channels: the site's own channels.
        foresight: asks both gates without any effect, and lets a step wait for newer state.
        disclosure: how much a planner is told.
        shadow: every step is judged, whatever became of the one before: nothing is released.
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
        motions: LeaseRegistry,
        proposals: ProposalRegistry,
        channels: dict[str, str],
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
        self._motions = motions
        self._proposals = proposals
        self._channels = channels
        self.foresight = foresight
        self._disclosure = disclosure
        self._shadow = shadow
        self._later = later
        self._decided = decided
        self._ended = ended
        self._answered = answered
        self._open: dict[tuple[Identifier, str], ServedPlan] = {}
        self._contexts: dict[Identifier, ContextLedger] = {}
        # who told of an input that could not be noted, however often it connects anew; a whole
        # user, `u1001.`, in the place of more of its names than are kept
        self._unheard: set[str] = set()
        self._nothing = self._empty()  # what a planner saw that nobody told of
        self._anything = self._empty()
        self._anything.add(str(TRUST[-1]), "")

    def observe(self, client: ServedClient, channel: str, text: str) -> None:
        """Note something that the client's planner was shown.

        Raises:
            MalformedError: a channel that nobody gave a label, or too long a text.
            EnvironmentFault: nothing can be noted for one more planner.
        """
        known = self._contexts.get(client.name)
        if known is not None:
            known.add(channel, text)
            return
        owner = f"u{client.uid}."
        theirs = sum(name.startswith(owner) for name in self._contexts)
        if theirs >= LIMITS.contexts_of_user or len(self._contexts) >= LIMITS.contexts:
            self._could_not_note(client)  # nobody's inputs are forgotten for another's
            raise EnvironmentFault(
                "too many planners were shown something", reason=Reason.BUSY, where="observe"
            )
        fresh = self._empty()
        fresh.add(channel, text)
        self._contexts[client.name] = fresh

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
        run = ServedPlan(client, number, asked, evidence)
        self._open[client.name, asked.key] = run
        try:
            self._read_plan(
                client,
                asked.plan,
                dialect,
                partial(self._read, run),
                wanted=lambda: not run.client.gone,  # another connection may have taken it over
            )
        except BaseException:  # whatever it was: the key is free again
            self._open.pop((client.name, asked.key), None)
            raise

    def _hand_over(self, run: ServedPlan, client: ServedClient, number: int) -> None:
        """Give the answer to a client that came back, and let the connection before go on."""
        run.client.error(run.number, _HANDED_OVER)
        self._answered(run.client)
        run.client, run.number = client, number

    def _read(self, run: ServedPlan, plan: Plan | AuthGuardError | None) -> None:
        """Go on with a plan that was read, or record that it could not be."""
        if plan is None:
            self._leave(run)
            return
        if isinstance(plan, Plan):
            run.steps = plan.steps
            self._step(run)
            return
        asked = run.asked
        inputs = {"plan": b64(asked.plan), "dialect": asked.dialect} if self._shadow else {}
        refused = self._enforcer.refuse_plan(plan, planner=run.client.name, inputs=inputs)
        run.add(refused, self._disclosure)
        self._finish(run)
        self._decided(run.client, refused)

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
            answer: called once, with the decisions or with why there are none.

        Raises:
            MalformedError: no such dialect.
        """

        def read(plan: Plan | AuthGuardError | None) -> None:
            try:
                if plan is None:
                    return
                if isinstance(plan, AuthGuardError):
                    raise plan
                judged = map(self.foresight.judge, plan.steps)
                answer([decision_json(one, authoritative=False) for one in judged])
            except AuthGuardError as error:
                answer(error)

        dialect = _dialect(asked.dialect)
        self._read_plan(client, asked.plan, dialect, read, wanted=lambda: not client.gone)

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
            plan: Plan | AuthGuardError = normalize(data, binder=self._binder, dialect=dialect)
        except AuthGuardError as error:
            plan = error
        taken(plan)

    def _step(self, run: ServedPlan) -> None:
        """Decide the next step; it waits while newer state may make it acceptable."""
        self._step_by(None, run)

    def _step_by(self, until_ms: int | None, run: ServedPlan) -> None:
        """Decide the next step, or let it wait, until then at most."""
        step = run.steps[len(run.reports)]

        def go_on(until_ms: int) -> None:
            self._later(run.client, partial(self._step_by, until_ms, run))

        if run.client.gone or not self.foresight.holds(step, until_ms, go_on):
            self._decide(run)

    def _decide(self, run: ServedPlan) -> None:
        """Decide the next step; what is released is watched until it ends."""
        client = run.client
        if client.gone:  # it went while its plan was read, or its next step waited
            self._leave(run)
            return
        step = run.steps[len(run.reports)]
        before = ProposalRecord(evidence=run.evidence, planned=len(run.steps), steps=run.numbers)
        keeper = Keeper(client.name, run.asked.key, before)
        begun = self._enforcer.submit(
            step,
            planner=client.name,
            evidence=run.evidence,
            context=self._context(client),
            keep=keeper,
            inputs={"action": step.action} if self._shadow else {},
            repair=run.asked.repair,
        )
        if isinstance(begun, Running):
            ended = partial(self._moved, run, keeper)
            told = partial(self._brought, run, self._binder.result_channel(step.action))
            self._motions.add(client.name, begun, ended, gone=lambda: run.client.gone, told=told)
            self._tell(run, begun.report)
            self._decided(client, begun.report)
        elif begun.outcome is not None:
            self._decided(client, begun)
            self._moved(run, keeper, begun)
        else:  # the planner waits for its answer, those who count do not
            self._go_on(run, begun)
            self._decided(client, begun)

    def _moved(self, run: ServedPlan, keeper: Keeper, report: Report) -> None:
        """Go on after a released step has ended, or was not begun after all."""
        run.numbers += keeper.numbers
        self._ended(run.client, report)
        self._go_on(run, report)

    def _brought(self, run: ServedPlan, channel: str, result: Result) -> None:
        """Tell the planner what its action brought to light, once all of it is noted."""
        parts = [part for text in result.texts or ("",) for part in parts_of(text)]
        run.noting += 1

        def note() -> None:
            if parts:
                with suppress(EnvironmentFault):  # then it may have been anything, and counts so
                    self.observe(run.client, channel, parts.pop(0))
                self._later(run.client, note, first=True)
                return
            run.noting -= 1
            told = {"step": len(run.reports), "ticket": result.ticket, "result": result.content}
            run.client.event(run.number, told)

        note()

    def _go_on(self, run: ServedPlan, report: Report) -> None:
        if run.noting:  # what it brought to light is told first
            self._later(run.client, lambda: self._go_on(run, report))
            return
        run.add(report, self._disclosure)
        left = len(run.reports) < len(run.steps)
        goes_on = self._shadow or report.outcome is Outcome.SUCCEEDED
        if left and goes_on and not run.client.gone:
            self._later(run.client, lambda: self._step(run))
        else:
            self._finish(run)

    def _leave(self, run: ServedPlan) -> None:
        """End a plan whose planner is gone; one that was not begun may come again."""
        if run.reports:
            self._finish(run)
        else:
            del self._open[run.client.name, run.asked.key]

    def _finish(self, run: ServedPlan) -> None:
        """Do what the mission says is done after a refusal, and answer."""
        self._open.pop((run.client.name, run.asked.key), None)
        last = run.reports[-1]
        then = None if last.outcome is Outcome.SUCCEEDED else self._after_refusal(last)
        answered = run.answered(then)
        self._proposals.remember(run.client.name, run.asked.key, answered)
        self._answer(run.client, run.number, answered, repeated=False)

    def _after_refusal(self, report: Report) -> str:
        """Hold, or brake too; asking a person is the console's part, and the robot holds."""
        judged = report.judged
        wanted = OnRefusal.HOLD if judged is None else judged.verified.mission.on_refusal
        if wanted is OnRefusal.STOP:
            self._enforcer.stop(by="gate", is_planner=False)
        return str(wanted)

    def _tell(self, run: ServedPlan, report: Report) -> None:
        step = told_json(report, self._disclosure)
        ticket = require_judged(report).ticket
        run.client.event(run.number, {"step": len(run.reports), "ticket": ticket, **step})

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

    def _context(self, client: ServedClient) -> ContextLedger:
        """Return what the client's planner saw; what could not be noted may have been anything."""
        unheard = not self._unheard.isdisjoint((client.name, f"u{client.uid}."))
        unknown = self._anything if unheard else self._nothing
        return self._contexts.get(client.name, unknown)

    def _could_not_note(self, client: ServedClient) -> None:
        owner = f"u{client.uid}."
        theirs = sum(name.startswith(owner) for name in self._unheard)
        self._unheard.add(client.name if theirs < LIMITS.contexts_of_user else owner)

    def _empty(self) -> ContextLedger:
        return ContextLedger(self._binder.spellings(), channels=self._channels)


def _dialect(name: str) -> Dialect:
    try:
        return Dialect(name)
    except ValueError as error:
        raise MalformedError(
            f"expected one of {', '.join(sorted(Dialect))}", where="proposal.dialect"
        ) from error
