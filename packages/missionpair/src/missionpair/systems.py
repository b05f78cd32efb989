# SPDX-License-Identifier: Apache-2.0
"""Three systems for the same trials: no defense, safety alone, both gates.

The first two drive the world's transition function directly; a gate that accepts everything lives
here and nowhere in the product. What was executed is judged by the oracle, never by our own
checks. Source: section "Controlled Validation".
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import msgspec

import authguard_reference as oracle
from authguard_r.core.action import Action
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.quantities import Now
from authguard_r.core.standing import Outcome, Standing
from authguard_r.core.state import attest
from authguard_r.normalize import Step, read_plan
from authguard_r.safety import EnvelopeGate, default_config
from authguard_r.sim.robot import snapshot_of
from authguard_r.sim.state import WorldState
from authguard_r.sim.world import delta
from missionpair.bench import BenchScene, propose
from missionpair.judging import plain, plain_facts


class System(StrEnum):
    """What stands between the planner and the robot."""

    NONE = "No defense"
    SAFETY = "Safety-only pilot baseline"
    BOTH = "AuthGuard-R + safety gate"


@dataclass(frozen=True)
class Effect:
    """One action that the world carried out.

    Args:
        action: what was done.
        authorized: what the oracle says of it, at the state in which it was done.
        reasons: the oracle's reasons when it is not.
    """

    action: Action
    authorized: bool
    reasons: tuple[str, ...]


@dataclass
class SystemResult:
    """What one system did in one trial.

    Args:
        effects: what was executed, in order.
        executable: X(P, s0): the whole plan could be carried out.
        safe: SA(P): the safety gate accepts every action of it.
        completed: the whole plan was carried out.
        reasons: why the system refused, empty when it did not.
        deviations: D_M of each judged action.
    """

    effects: list[Effect] = field(default_factory=list)
    executable: bool = True
    safe: bool = True
    completed: bool = False
    reasons: tuple[str, ...] = ()

    @property
    def unauthorized(self) -> bool:
        """True when an unauthorized action was executed (counts into N_U)."""
        return any(not effect.authorized for effect in self.effects)

    @property
    def hijacked(self) -> int:
        """SCMH of what was executed: executable, safe, and not authorized."""
        if not self.effects:
            return 0
        return oracle.scmh(self.executable, self.safe, not self.unauthorized)


def run_trial(scene: BenchScene, system: System) -> SystemResult:
    """Run the scene's plan under one system and judge every effect."""
    if system is System.BOTH:
        return _both(scene)
    return _direct(scene, with_safety=system is System.SAFETY)


def _direct(scene: BenchScene, *, with_safety: bool) -> SystemResult:
    """Drive delta without the authorization gate."""
    gate = EnvelopeGate(default_config(scene.sim.robot.site, scene.sim.robot.rid))
    steps = read_plan(scene.plan, binder=scene.sim.binder).steps
    state, result = scene.sim.robot.state, SystemResult()
    now = Now(scene.sim.robot.wall_ms(), scene.sim.gate.ledger.mono_ms())
    for step in steps:
        action = _completed(step, state)
        attested = attest(
            _snapshot(scene, state), scene.sim.gate.facts, arrived_mono_ms=now.mono_ms
        )
        safety = gate.assess(action, attested, scene.sim.gate.facts, now)
        result.safe = result.safe and safety.safe
        if with_safety and not safety.safe:
            result.reasons = tuple(str(f.hazard) for f in safety.findings)
            return result
        after = delta(scene.sim.robot.site, state, action)
        if after is None:
            result.executable = False
            return result
        result.effects.append(_judge(scene, action, state, now, scene.standing()))
        state = after
    result.completed = True
    return result


def _both(scene: BenchScene) -> SystemResult:
    """Send the plan through the whole product."""
    result = _attempt(scene)
    if not result.completed and scene.between is not None and not result.effects:
        scene.between(scene)
        result = _attempt(scene)
    return result


def _attempt(scene: BenchScene) -> SystemResult:
    robot, result = scene.sim.robot, SystemResult()
    begun, before = len(robot.trace), scene.standing()
    try:
        reports = propose(scene)
    except AuthGuardError as error:
        result.reasons = (str(error.reason),)
        return result
    planned = len(read_plan(scene.plan, binder=scene.sim.binder).steps)
    for executed in robot.trace[begun:]:
        now = Now(executed.utc_ms, scene.sim.gate.ledger.mono_ms())
        result.effects.append(_judge(scene, executed.action, executed.before, now, before))
        before = scene.standing()
    result.completed = len(reports) == planned and all(
        report.outcome is Outcome.SUCCEEDED for report in reports
    )
    last = reports[-1]
    if last.judged is not None:
        result.reasons = tuple(str(reason) for reason in last.judged.decision.reasons)
    elif last.refusal is not None:
        result.reasons = (str(last.refusal.reason),)
    return result


def _completed(step: Step, state: WorldState) -> Action:
    """Fill the source from the world, as a system without a gate would."""
    if "source" not in step.attested:
        return step.action
    return msgspec.structs.replace(step.action, source=state.region)


def _snapshot(scene: BenchScene, state: WorldState) -> Any:
    return snapshot_of(state, robot=scene.sim.robot.rid, epoch=1, seq=1)


def _judge(
    scene: BenchScene, action: Action, state: WorldState, now: Now, standing: Standing | None
) -> Effect:
    """Ask the oracle whether this very action was authorized in this very state."""
    approvals = []
    if standing is not None and standing.requests:
        answered = scene.sim.gate.ledger.run(
            lambda act: scene.sim.gate.enforcer.inputs.answers(act, standing)
        )
        approvals = [plain(item) for item in answered.approvals]
    verdict = oracle.decide(
        plain(scene.mission),
        digest=scene.digest,
        usable_until_ms=scene.usable_until_ms,
        action=plain(msgspec.structs.replace(action, provenance={}, meta=None)),
        state={"snapshot": plain(_snapshot(scene, state)), "arrived_mono_ms": now.mono_ms},
        facts=plain_facts(scene.sim.gate.facts),
        now=plain(now),
        standing=None if standing is None else plain(standing),
        approvals=approvals,
    )
    return Effect(action, verdict["verdict"] == "accept", tuple(verdict["reasons"]))
