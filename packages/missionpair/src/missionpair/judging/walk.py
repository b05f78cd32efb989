# SPDX-License-Identifier: Apache-2.0
"""A plan on its way through the world, judged step by step by the reference oracle.

Source: `eq:scmh`, `eq:action-deviation`. Spec page: docs/spec/measures.md#judge
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, Self, cast

from msgspec import Struct
from msgspec.structs import replace

import authguard_reference as oracle
from authguard_r.core.action import Action
from authguard_r.core.facts import SiteFacts
from authguard_r.core.quantities import Now
from authguard_r.core.standing import Standing
from authguard_r.core.state import AttestedState, Snapshot, attest
from authguard_r.normalize import Step
from authguard_r.sim.sight import snapshot_of
from authguard_r.sim.state import WorldState
from authguard_r.sim.world import delta, duration_ms
from missionpair.judging.reference import Json, Reference, action_of, plain, state_of
from missionpair.stage import Stage

NONE = Fraction(0)


class JudgedEffect(Struct, frozen=True, kw_only=True):
    """One action, and what the oracle says of it in the state in which it comes.

    Args:
        action: what is done.
        authorized: the oracle's verdict.
        reasons: the oracle's, when it is not.
        deviation: its D_M.
        hazards: the oracle's hazard classes; none of a safe action.
        grant: what the action is released under, where it is authorized.
    """

    action: Action
    authorized: bool
    reasons: tuple[str, ...] = ()
    deviation: Fraction = NONE
    hazards: tuple[str, ...] = ()
    grant: str = ""

    @property
    def safe(self) -> bool:
        """The safety model accepts it."""
        return not self.hazards


@dataclass
class Walk:
    """Where a plan has come to: the world, the time, and what the registry says there.

    Args:
        stage: the situation that it began in.
        state: the world now.
        now: the time now.
        standing: the registry's entry as plain data, were every step before it released and
            settled; None where the gate's store has none.
        approvals: authentic answers to what is asked in it, as plain data.
    """

    stage: Stage
    state: WorldState
    now: Now
    standing: Json | None
    approvals: list[Json]
    _snapshot: Snapshot | None = field(default=None, repr=False)
    _attested: AttestedState | None = field(default=None, repr=False)

    @classmethod
    def of(cls, stage: Stage) -> Walk:
        """Return a walk of its own that begins where the stage is, or where plans brought it."""
        if stage.walk is not None:
            return copy(cast("Walk", stage.walk))
        robot = stage.sim.robot
        now = Now(robot.wall_ms(), stage.sim.gate.ledger.mono_ms())
        return cls.at(stage, robot.state, now, stage.standing())

    @classmethod
    def at(cls, stage: Stage, state: WorldState, now: Now, standing: Standing | None) -> Self:
        """Return a walk that begins in a state, at a time, with an entry of the gate's registry."""
        approvals: list[Json] = []
        if standing is not None and standing.requests:
            gate = stage.sim.gate
            given = gate.ledger.run(lambda act: gate.enforcer.inputs.answers(act, standing))
            approvals = [plain(item) for item in given.approvals]
        entry = None if standing is None else plain(standing)
        return cls(stage, state, now, entry, approvals)

    @property
    def facts(self) -> SiteFacts:
        """The site, and whose gate it is."""
        return self.stage.sim.gate.facts

    @property
    def reference(self) -> Reference:
        """The oracle, with the mission in force."""
        return reference_of(self.stage)

    @property
    def snapshot(self) -> Snapshot:
        """What an estimator sees here and now."""
        if self._snapshot is None:
            rid = self.stage.sim.robot.rid
            self._snapshot = snapshot_of(self.state, robot=rid, epoch=1, seq=1)
        return self._snapshot

    def attested(self) -> AttestedState:
        """Return the same as the gate's own types have it: for defenses, and for no judgment."""
        if self._attested is None:
            self._attested = attest(self.snapshot, self.facts, arrived_mono_ms=self.now.mono_ms)
        return self._attested

    def completed(self, step: Step) -> Action:
        """Return the step's action with what attested state fills in."""
        if "source" not in step.attested:
            return step.action
        return replace(step.action, source=self.state.region)

    def go_on(self, action: Action, *, grant: str = "") -> bool:
        """Carry the action out; False, and nothing moves, when it cannot be.

        Args:
            action: what is done.
            grant: what it is released under; without one it counts for nothing in the registry.
        """
        site = self.stage.sim.robot.site
        after = delta(site, self.state, action)
        if after is None:
            return False
        took = duration_ms(site, self.state, action) or 0
        if grant and self.standing is not None:
            recorded = after.recorded_bytes - self.state.recorded_bytes
            self.standing = self.reference.done(
                self.standing,
                grant,
                action_of(action),
                now=self.now,
                took_ms=took,
                recorded=recorded,
            )
        self.now = Now(self.now.utc_ms + took, self.now.mono_ms + took)
        self.state, self._snapshot, self._attested = after, None, None
        return True


def proved(walk: Walk, action: Action) -> JudgedEffect:
    """Return what the oracle says of an action in the world and the registry as they are."""
    plain_action, state = action_of(action), state_of(walk.snapshot, walk.now)
    verdict: dict[str, Any] = walk.reference.decide(
        plain_action,
        state=state,
        now=walk.now,
        standing=walk.standing,
        approvals=walk.approvals,
    )
    reasons = list(verdict["reasons"])
    weights = {str(field): weight for field, weight in walk.stage.field_weights.items()}
    return JudgedEffect(
        action=action,
        authorized=verdict["verdict"] == "accept",
        reasons=tuple(reasons),
        deviation=oracle.action_deviation(reasons, weights) if reasons else NONE,
        hazards=walk.reference.hazards(plain_action, state=state, now=walk.now),
        grant=verdict["grant"] or "",
    )


def reference_of(stage: Stage) -> Reference:
    """Return the oracle with the stage's mission in force; made anew when that changes."""
    held = stage.reference
    if held is None or held[0] is not stage.scene.mission:
        scene = stage.scene
        made = Reference(
            stage.bench, stage.sim.gate.facts, scene.mission, scene.digest, scene.usable_until_ms
        )
        held = stage.reference = (scene.mission, made)
    return cast("Reference", held[1])
