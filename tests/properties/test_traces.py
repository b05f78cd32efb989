# SPDX-License-Identifier: Apache-2.0
"""Whole traces: what was executed was authorized and safe where it was executed.

Theorem "Trace-level dual-gate soundness", corollaries "Plan-level non-escalation" and "Blocking
safety-compliant mission hijacking", theorem "Completeness of the authorization gate", and the
remark that the gates' order does not matter. The oracle judges every proposal, and keeps its own
standing beside ours.
"""

from __future__ import annotations

from random import Random
from typing import Any

import msgspec
import pytest

import authguard_reference as oracle
import worlds
from authguard_r.core.action import Action
from authguard_r.core.checks.grant import spend_of
from authguard_r.core.decide import decide
from authguard_r.core.decision import Verdict
from authguard_r.core.encoding import b64
from authguard_r.core.mission import Mission
from authguard_r.core.quantities import Now
from authguard_r.core.standing import Outcome, Spend, Standing, reserve, settle
from authguard_r.core.state import AttestedState, attest
from authguard_r.core.token import VerifiedMission
from authguard_r.safety import EnvelopeGate, default_config
from authguard_r.sim.robot import snapshot_of
from authguard_r.sim.state import WorldState
from authguard_r.sim.world import delta
from cases import plain, plain_facts

TRACES = 20_000
BATCHES = 4
FACTS = worlds.facts()
FACTS_PLAIN = plain_facts(FACTS)
SITE = worlds.site()
GATE = EnvelopeGate(default_config(SITE, worlds.RID))


def small_mission() -> Mission:
    """The hospital's mission, without what a trace of a few steps cannot reach."""
    base = worlds.mission()
    kept = tuple(g for g in base.actions if g.id not in {"look-out", "go-home"})
    return msgspec.structs.replace(base, actions=kept, closing=None)


MISSION = small_mission()
MISSION_PLAIN = plain(MISSION)
VERIFIED: VerifiedMission = worlds.verified(MISSION)
REGIONS = ["dock", "pharmacy", "public-corridor", "station-101", "station-103", "plant-room"]


def random_action(rnd: Random, world: WorldState) -> Action:
    """Propose something: often the next sensible thing, often not quite."""
    kind = rnd.choice(["navigate", "navigate", "pick", "place", "wait", "record_video"])
    source = world.region if rnd.random() < 0.9 else rnd.choice(REGIONS)
    thing = rnd.choice(["package-p1", "package-p1", "package-p2"])
    if kind == "navigate":
        goal = rnd.choice(["pharmacy", "station-101", rnd.choice(REGIONS)])
        speed = rnd.choice([50, 500, 800, 801, 1_500, 1_501])
        return worlds.navigate(source, goal, speed=speed)
    if kind in {"pick", "place"}:
        force = rnd.choice([1_000, 12_000, 20_000, 20_001, 40_001])
        goal = {"destination": source} if kind == "place" else {}
        return Action(
            type=kind,
            tool="gripper",
            object=thing,
            source=source,
            params={"force_mn": force},
            **goal,
        )
    if kind == "wait":
        return Action(type="wait", tool="base", params={"duration_ms": 1_000})
    params = {"duration_ms": 1_000, "max_bytes": 1_000}
    return Action(type=kind, tool="camera", source=source, params=params)


class Trace:
    """One run of the two gates over a world, with the oracle beside it."""

    def __init__(self, rnd: Random) -> None:
        at, holding = rnd.choice([("dock", None), ("pharmacy", None), ("pharmacy", "package-p1")])
        self.world = worlds.world(at, holding)
        self.now = worlds.NOW
        self.standing: Standing = worlds.active(VERIFIED)
        if holding:
            self.standing = self._as_if_picked()
        self.theirs: Any = plain(self.standing)
        self.executed: list[Action] = []
        self.seq = 0

    def _as_if_picked(self) -> Standing:
        grant = next(g for g in MISSION.actions if g.id == "pick-p1")
        taken = reserve(
            self.standing, grant, ticket=b64(bytes(32)), spend=Spend(), now=self.now, per_ms=1_000
        )
        return settle(
            taken, MISSION, ticket=b64(bytes(32)), outcome=Outcome.SUCCEEDED, used=Spend()
        )

    def state(self) -> AttestedState:
        self.seq += 1
        snapshot = snapshot_of(self.world, robot=worlds.RID, epoch=1, seq=self.seq)
        return attest(snapshot, FACTS, arrived_mono_ms=self.now.mono_ms)

    def step(self, action: Action, after_ms: int, *, safety_first: bool) -> None:
        """Decide one proposal both ways; execute it when both gates accept."""
        self.now = Now(self.now.utc_ms + after_ms, self.now.mono_ms + after_ms)
        state = self.state()
        safe = GATE.assess(action, state, FACTS, self.now).safe if safety_first else None
        decision = decide(
            VERIFIED, action, state=state, facts=FACTS, now=self.now, standing=self.standing
        )
        if safe is None:
            safe = GATE.assess(action, state, FACTS, self.now).safe
        theirs = oracle.decide(
            MISSION_PLAIN,
            digest=VERIFIED.digest,
            usable_until_ms=VERIFIED.issuer.usable_until_ms,
            action=plain(action),
            state={"snapshot": plain(state.snapshot), "arrived_mono_ms": state.arrived_mono_ms},
            facts=FACTS_PLAIN,
            now=plain(self.now),
            standing=self.theirs,
            approvals=[],
        )
        # soundness one way, completeness the other
        assert (decision.verdict is Verdict.ACCEPT) == (theirs["verdict"] == "accept")
        if decision.verdict is Verdict.ACCEPT and safe:
            self._execute(action, decision.match)

    def _execute(self, action: Action, match: Any) -> None:
        grant = match.indexed.grant
        spend = spend_of(FACTS.vocabulary[action.type], grant, action.params)
        ticket = b64(len(self.executed).to_bytes(32, "big"))
        per_ms = MISSION.budgets.rate.per_ms
        self.standing = reserve(
            self.standing, grant, ticket=ticket, spend=spend, now=self.now, per_ms=per_ms
        )
        self.theirs = oracle.release(
            self.theirs,
            grant.id,
            ticket=ticket,
            spend=plain(spend),
            now=plain(self.now),
            per_ms=per_ms,
        )
        after = delta(SITE, self.world, action)
        outcome = Outcome.FAILED if after is None else Outcome.SUCCEEDED
        self.world = self.world if after is None else after
        self.standing = settle(
            self.standing, MISSION, ticket=ticket, outcome=outcome, used=Spend(motion_ms=1)
        )
        self.theirs = oracle.settle(
            self.theirs, MISSION_PLAIN, ticket=ticket, outcome=str(outcome), used={"motion_ms": 1}
        )
        self.executed.append(action)


@pytest.mark.parametrize("batch", range(BATCHES))
def test_every_executed_action_was_authorized_and_safe_where_it_was_executed(batch: int) -> None:
    executed = refused = completed = 0
    for number in range(TRACES // BATCHES):
        seed = batch * TRACES + number
        one, other = Trace(Random(seed)), Trace(Random(seed))
        rnd = Random(seed + 1)
        steps = rnd.randint(1, 2)
        for _ in range(steps):
            action, after_ms = random_action(rnd, one.world), rnd.randint(0, 400_000)
            one.step(action, after_ms, safety_first=False)
            if number % 5 == 0:
                other.step(action, after_ms, safety_first=True)
        if number % 5 == 0:
            assert one.executed == other.executed
        assert plain(one.standing) == one.theirs
        executed += len(one.executed)
        refused += steps - len(one.executed)
        completed += oracle.is_complete(one.theirs, MISSION_PLAIN)
    assert executed > 400
    assert refused > 400
