# SPDX-License-Identifier: Apache-2.0
"""The execution of a plan: through the product, or past it into the world.

Everything that the world carried out is judged by the oracle, in the state in which it was done. A
gate that lets everything through lives here and nowhere in the product.
Source: section "Controlled Validation", `eq:execute`, `eq:uasr`
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter_ns

from msgspec import Struct
from msgspec.structs import replace

from authguard_r.core.action import Action
from authguard_r.core.decision import Verdict
from authguard_r.core.errors import MalformedError
from authguard_r.core.facts import SiteFacts
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.safety import SafetyDecision
from authguard_r.core.standing import Outcome, Standing
from authguard_r.core.state import AttestedState
from authguard_r.enforcement.report import Report
from authguard_r.normalize import Plan, Step
from authguard_r.sim.robot import Executed
from authguard_r.sim.world import DURATION
from missionpair.bench import PLANNER, approve
from missionpair.judging import NONE, JudgedEffect, Walk, proved
from missionpair.stage import Stage

#: Who a plan that no defense stopped was `by`: it went through, or came to nothing by itself.
NO_DEFENSE = frozenset({"", "normalizer", "world"})
#: What a planner sees of its plan. A real gate can tell more: codes and fields (`disclosure`).
EXECUTED, REFUSED = "executed", "rejected"


class ExecutionTimes(Struct, frozen=True, kw_only=True):
    """How long the parts took, microseconds; `safety` is the second gate's, in nothing else."""

    normalize: int = 0
    decide: int = 0
    safety: int = 0
    world: int = 0
    judging: int = 0
    defense: int = 0


class ExecutedPlan(Struct, frozen=True, kw_only=True):
    """The result of one plan.

    Args:
        planned: its steps; 0 of what the normalizer refused.
        effects: what the world carried out, in order.
        completed: all of it.
        by: which part refused: `normalizer`, `authorization`, `safety`, a defense's name; `world`
            where physics did; empty when none did.
        reasons: the refusal's codes.
        prompts: how often a person was asked.
        stalled_ms: simulated time in which the robot waited.
        spent: how long it took.
    """

    planned: int = 0
    effects: tuple[JudgedEffect, ...] = ()
    completed: bool = False
    by: str = ""
    reasons: tuple[str, ...] = ()
    prompts: int = 0
    stalled_ms: int = 0
    spent: ExecutionTimes = ExecutionTimes()

    @property
    def told(self) -> str:
        """What the planner sees."""
        return EXECUTED if self.completed else REFUSED


class Denied(Struct, frozen=True, kw_only=True):
    """Why a defense lets an action not through."""

    by: str
    reasons: tuple[str, ...]


#: Says why an action may not be done, or None when it may.
Permits = Callable[[Action, Walk], Denied | None]


class Everything:
    """A safety gate that calls everything safe, to see what the mission gate does alone."""

    def recall(self, memory: bytes) -> Everything:  # noqa: ARG002 - it remembers nothing
        """Return the same gate."""
        return self

    def assess(
        self,
        action: Action,  # noqa: ARG002
        state: AttestedState | None,  # noqa: ARG002
        facts: SiteFacts,  # noqa: ARG002
        now: Now,  # noqa: ARG002
    ) -> SafetyDecision:
        """Return that it is safe."""
        return SafetyDecision(safe=True)


def unread(error: MalformedError, took_us: int) -> ExecutedPlan:
    """Return the result of bytes that the normalizer refuses: nothing runs."""
    return ExecutedPlan(
        by="normalizer",
        reasons=(str(error.reason),),
        spent=ExecutionTimes(normalize=took_us, defense=took_us),
    )


def past_the_gate(stage: Stage, raw: bytes, permits: Permits) -> ExecutedPlan:
    """Drive the world itself with a plan, where the product's gate has no part.

    The gate's registry stands still; the oracle goes along with what it would have said.
    """
    begun = perf_counter_ns()
    try:
        plan = stage.read(raw)
    except MalformedError as error:
        return unread(error, _us(begun))
    normalized = _us(begun)
    walk, effects, waited, in_world, judging = Walk.of(stage), [], 0, 0, 0
    denied: Denied | None = None
    for step in plan.steps:
        action = walk.completed(step)
        denied = permits(action, walk)
        if denied is not None:
            break
        at = perf_counter_ns()
        judged = _agreed(stage, proved(walk, action))
        judging += _us(at)
        at, before = perf_counter_ns(), walk.now.mono_ms
        if not walk.go_on(action, grant=judged.grant if judged.authorized else ""):
            denied = Denied(by="world", reasons=("NOT_EXECUTABLE",))
            break
        effects.append(judged)
        waited += walk.now.mono_ms - before if _waits(walk, action) else 0
        in_world += _us(at)
    stage.walk = walk
    whole = _us(begun)
    return ExecutedPlan(
        planned=len(plan.steps),
        effects=tuple(effects),
        completed=denied is None,
        by="" if denied is None else denied.by,
        reasons=() if denied is None else denied.reasons,
        stalled_ms=waited,
        spent=ExecutionTimes(
            normalize=normalized,
            world=in_world,
            judging=judging,
            defense=whole - in_world - judging,
        ),
    )


def _agreed(stage: Stage, effect: JudgedEffect) -> JudgedEffect:
    """Return an effect with the agreement of those who stand by to approve it (benign runs).

    Where no gate asks them, what they would have signed is against no one's will.
    """
    if stage.approvers and effect.reasons == (str(Reason.APPROVAL_REQUIRED),):
        return replace(effect, authorized=True, reasons=(), deviation=NONE)
    return effect


def through_the_gate(stage: Stage, raw: bytes) -> ExecutedPlan:
    """Send a plan through the whole product, step by step until one is refused.

    Where approval is asked for, the scenario's approvers answer, and the step comes once more.
    """
    begun = perf_counter_ns()
    try:
        plan = stage.read(raw)
    except MalformedError as error:
        return unread(error, _us(begun))
    normalized = _us(begun)
    road = _Execution(stage, plan)
    for step in plan.steps:
        if not road.take(step):
            break
    whole = _us(begun)
    by, reasons = road.refusal
    return ExecutedPlan(
        planned=len(plan.steps),
        effects=tuple(road.effects),
        completed=road.succeeded == len(plan.steps),
        by=by,
        reasons=reasons,
        prompts=road.prompts,
        stalled_ms=road.waited_ms,
        spent=ExecutionTimes(
            normalize=normalized,
            decide=road.decide_us,
            safety=road.safety_us,
            world=whole - normalized - road.decide_us - road.safety_us - road.judging_us,
            judging=road.judging_us,
            defense=normalized + road.decide_us + road.safety_us,
        ),
    )


class _Execution:
    """A plan on its way through the gate."""

    def __init__(self, stage: Stage, plan: Plan) -> None:
        self.stage = stage
        self.plan = plan
        self.effects: list[JudgedEffect] = []
        self.succeeded = self.prompts = self.waited_ms = 0
        self.decide_us = self.safety_us = self.judging_us = 0
        self.refusal: tuple[str, tuple[str, ...]] = ("", ())

    def take(self, step: Step) -> bool:
        """Propose one step; True when it succeeded, and the next one may come."""
        report = self._propose(step)
        if _asks(report) and self.stage.approvers:
            self.prompts += 1
            approve(self.stage.bench, self.stage.scene, *self.stage.approvers)
            report = self._propose(step)
        elif _asks(report):
            self.prompts += 1
        if report.outcome is Outcome.SUCCEEDED:
            self.succeeded += 1
            return True
        self.refusal = _refusal(report)
        return False

    def _propose(self, step: Step) -> Report:
        stage, robot = self.stage, self.stage.sim.robot
        began = len(robot.trace)
        # what the oracle judges is the registry as it was before: read while nothing has changed
        before, took = stage.standing(), stage.safety_took[0]
        at = perf_counter_ns()
        report = stage.sim.gate.enforcer.propose(
            step, planner=PLANNER, evidence=self.plan.evidence, context=stage.context()
        )
        safety_us = (stage.safety_took[0] - took) // 1_000
        self.safety_us += safety_us
        self.decide_us += _us(at) - safety_us if len(robot.trace) == began else 0
        for executed in robot.trace[began:]:
            self._done(executed, before)
        return report

    def _done(self, executed: Executed, before: Standing | None) -> None:
        """Judge what the world carried out, in the state and at the time in which it began."""
        ledger, robot = self.stage.sim.gate.ledger, self.stage.sim.robot
        mono_ms = ledger.mono_ms() - (robot.wall_ms() - executed.utc_ms)
        at = perf_counter_ns()
        walk = Walk.at(self.stage, executed.before, Now(executed.utc_ms, mono_ms), before)
        self.effects.append(proved(walk, executed.action))
        self.judging_us += _us(at)
        if _waits(walk, executed.action) and executed.outcome is Outcome.SUCCEEDED:
            self.waited_ms += executed.action.params.get(DURATION, 0)


def _asks(report: Report) -> bool:
    judged = report.judged
    return judged is not None and judged.decision.verdict is Verdict.REQUEST_APPROVAL


def _refusal(report: Report) -> tuple[str, tuple[str, ...]]:
    """Return who refused, and with which codes."""
    if report.judged is None:
        reason = Reason.INTERNAL_FAULT if report.refusal is None else report.refusal.reason
        return "authorization", (str(reason),)
    decision, safety = report.judged.decision, report.judged.safety
    if decision.verdict is not Verdict.ACCEPT:
        return "authorization", tuple(str(reason) for reason in decision.reasons)
    if safety is not None and not safety.safe:
        return "safety", tuple(str(finding.hazard) for finding in safety.findings)
    return "world", (str(report.outcome).upper(),)


def _waits(walk: Walk, action: Action) -> bool:
    kind = walk.facts.vocabulary.get(action.type)
    return kind is not None and kind.waits


def _us(since_ns: int) -> int:
    return (perf_counter_ns() - since_ns) // 1_000
