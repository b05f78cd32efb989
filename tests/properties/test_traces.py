# SPDX-License-Identifier: Apache-2.0
"""Whole traces: what was executed was authorized and safe where it was executed.

Theorem "Trace-level dual-gate soundness", corollaries "Plan-level non-escalation" and "Blocking
safety-compliant mission hijacking", theorem "Completeness of the authorization gate", and the
remark that the gates' order does not matter. The traces run through the real enforcer; the oracle
judges every step at the state and the time at which it ran, and keeps its own standing beside.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import pytest

import authguard_reference as oracle
from authguard_r.core.decision import Verdict
from authguard_r.safety import default_config
from authguard_r.sim.robot import snapshot_of
from fixtures import scenarios
from fixtures.amount import amount
from fixtures.decision_cases import plain, plain_facts
from fixtures.traces import Look, Played, Trace, mission

Json = dict[str, Any]
BATCHES = 2
TRACES = amount(240, 2_000) // BATCHES
ORDERED = amount(30, 300)
FACTS = plain_facts(scenarios.facts())
CONFIG = plain(default_config(scenarios.site(), scenarios.RID))
VERIFIED = scenarios.verified(mission())
MISSION, DIGEST = plain(mission()), VERIFIED.digest
GRANTS = {grant["id"]: grant for grant in MISSION["actions"]}
#: What every batch has to contain, so that no law holds because nothing happened.
HAPPENS = (
    *("succeeded", "failed", "aborted", "not_started"),
    *("authorized, unsafe", "unauthorized, safe", "unauthorized, unsafe"),
    *("aborted: BOUND_EXCEEDED", "aborted: OUTSIDE_REGIONS", "aborted: STATE_STALE"),
    *("aborted: LEASE_ENDED", "aborted: GUARD_FALSE", "aborted: EXPIRED"),
    *("STATE_BEFORE_MOTION",),
    *("aborted: MISSION_SUSPENDED", "complete", "expired", "SPEED", "FORCE", "KEEP_OUT"),
)


class Judge:
    """The oracle beside one trace, with a standing of its own; every method asserts one law."""

    def __init__(self, seen: Counter[str]) -> None:
        self.standing: Json = plain(scenarios.active(VERIFIED))
        self.seen = seen
        self.executed: list[list[str]] = []

    def step(self, played: Played) -> None:
        look = played.looks[-1 if played.executed is None else played.first]
        reasons, dangers = self.judge(plain(played.proposal), look)
        may = reasons == [] and dangers == []
        self.require_both_gates(played, reasons, dangers)
        if played.executed is not None:
            self.require_the_very_action(played, look)
            self.executed.append(reasons)
        if may:
            self.follow(played, look)
        elif look.now["utc_ms"] > VERIFIED.expiry_ms:
            self._becomes("expire")
        assert _tidy(played.standing) == _tidy(self.standing)  # the registry counts the same
        self.seen[self.standing["status"]] += 1

    def judge(self, action: Json, look: Look) -> tuple[list[str], list[str]]:
        """Return why an action would not be authorized, and why it would not be safe."""
        decision = self.decide(action, look)
        dangers = oracle.hazards(CONFIG, action, look.state, FACTS, look.now)
        self.seen.update(dangers)
        self.seen.update({"STATE_BEFORE_MOTION"} & set(decision["reasons"]))
        return decision["reasons"], dangers

    def decide(self, action: Json, look: Look) -> Json:
        return oracle.decide(
            MISSION,
            digest=DIGEST,
            usable_until_ms=VERIFIED.issuer.usable_until_ms,
            action=action,
            state=look.state,
            facts=FACTS,
            now=look.now,
            standing=self.standing,
            approvals=[],
        )

    def require_both_gates(self, played: Played, reasons: list[str], dangers: list[str]) -> None:
        """Released exactly when authorized and safe: sound, complete, and hijacking is blocked."""
        authorized, safe = reasons == [], dangers == []
        assert played.report is not None
        judged = played.report.judged
        if judged is not None:
            assert (judged.decision.verdict is Verdict.ACCEPT) == authorized
            assert [str(reason) for reason in judged.decision.reasons] == reasons
        assert (judged is not None and judged.released) == (authorized and safe)
        begun = played.executed is not None
        if begun:  # eq:trace-auth, eq:trace-safe
            assert authorized
            assert safe
        else:  # what both accept is begun, unless the controller refuses
            assert not (authorized and safe) or played.report.outcome == "not_started"
        assert oracle.scmh(begun, safe, authorized) == 0
        if not (authorized and safe):
            told = "authorized" if authorized else "unauthorized"
            self.seen[f"{told}, {'safe' if safe else 'unsafe'}"] += 1

    def require_the_very_action(self, played: Played, look: Look) -> None:
        """The robot began what was proposed, at once, in the state that was attested."""
        executed = played.executed
        assert executed is not None
        own = plain(executed.action)
        assert {k: v for k, v in own.items() if k not in {"provenance", "meta"}} == plain(
            played.proposal
        )
        assert executed.utc_ms == look.now["utc_ms"]
        if not played.sees:
            return
        world = plain(snapshot_of(executed.before, robot=scenarios.RID, epoch=1, seq=1))
        assert look.state is not None
        assert _unfenced(look.state["snapshot"]) == _unfenced(world)
        there = {"snapshot": world, "arrived_mono_ms": look.now["mono_ms"]}
        assert self.judge(own, Look(look.now, there, ended=False, suspended=False)) == ([], [])

    def follow(self, played: Played, look: Look) -> None:
        """Release, hold the lease against every look while the robot moves, and settle."""
        report, decision = played.report, self.decide(plain(played.proposal), look)
        assert report is not None
        assert report.judged is not None
        grant = GRANTS[decision["grant"]]
        row = grant["alternatives"][decision["row"]]
        action, now, ticket = plain(played.proposal), look.now, report.judged.ticket
        lease = oracle.permit(MISSION, DIGEST, grant, row, action, facts=FACTS, now=now)
        self.standing = oracle.release(
            self.standing,
            grant["id"],
            ticket=ticket,
            spend=_most(grant, action),
            now=now,
            per_ms=MISSION["budgets"]["rate"]["per_ms"],
        )
        self.require_the_lease(played, lease)
        self.standing = oracle.settle(
            self.standing, MISSION, ticket=ticket, outcome=str(report.outcome), used=played.used
        )
        self.seen[str(report.outcome)] += 1
        if self.standing["status"] == "active" and oracle.is_complete(self.standing, MISSION):
            self._becomes("begin_closing")
            ended = played.looks[-1].now["utc_ms"]
            self.standing["closes_ms"] = ended + MISSION["closing"]["for_ms"]
            self.seen["complete"] += 1

    def require_the_lease(self, played: Played, lease: Json) -> None:
        """A robot moves exactly while the oracle says that it may, and is stopped at once."""
        report = played.report
        assert report is not None
        if played.lease is not None:
            given = plain(played.lease)
            assert {name: given[name] for name in lease} == lease
        reasons = list(dict.fromkeys(str(finding.reason) for finding in report.reasons))
        *earlier, last = played.looks[played.first :]
        assert [self.still(lease, look) for look in earlier] == [[]] * len(earlier)
        found = self.still(lease, last)
        if report.outcome == "aborted":
            assert found != []
            assert reasons == found
            self.seen.update(f"aborted: {reason}" for reason in found)
        elif played.executed is not None:
            assert last.ended or found == []
            assert reasons == []

    def still(self, lease: Json, look: Look) -> list[str]:
        if look.suspended and self.standing["status"] == "active":
            self._becomes("suspend")
        state = None if look.state is None else {**look.state, "fence": 0}  # ages alone count
        return oracle.still(lease, state, facts=FACTS, now=look.now, standing=self.standing)

    def _becomes(self, event: str) -> None:
        status = self.standing["status"]
        self.standing["status"] = oracle.TRANSITIONS[status].get(event, status)


def _unfenced(snapshot: Json) -> tuple[Json, Json]:
    """Return what was measured, pose and readings, without when."""
    pose = {**snapshot["pose"], "fence": 0}
    return pose, {name: {**value, "fence": 0} for name, value in snapshot["readings"].items()}


def _tidy(value: Any) -> Any:
    """Return plain data without what is zero or empty, which has two spellings."""
    if isinstance(value, list):
        return [_tidy(item) for item in value]
    if not isinstance(value, dict):
        return value
    tidied = {name: _tidy(item) for name, item in value.items()}
    return {name: item for name, item in tidied.items() if item not in ({}, [], 0)}


def _most(grant: Json, action: Json) -> Json:
    """Return the most that a release can use of each budget."""
    kind = FACTS["vocabulary"][action["type"]]
    return {
        "motion_ms": grant["max_ms"] if kind["moves"] else 0,
        "wait_ms": grant["max_ms"] if kind["waits"] else 0,
        "recorded_bytes": action["params"]["max_bytes"] if kind["records"] else 0,
    }


@pytest.mark.parametrize("batch", range(BATCHES))
def test_every_executed_action_was_authorized_and_safe_where_it_was_executed(batch: int) -> None:
    seen: Counter[str] = Counter()
    for number in range(TRACES):
        judge = Judge(seen)
        for played in Trace(f"{batch}, trace {number}").play():
            judge.step(played)
        if judge.executed:  # nothing that was executed goes beyond the mission, plan by plan
            assert oracle.plan_deviation(judge.executed, None) == (0, 0)
    assert [what for what in HAPPENS if not seen[what]] == []


def test_the_order_of_the_gates_does_not_matter() -> None:
    """Safety first: what it refuses is never handed in. The robot does the same, step by step."""
    moved = 0
    for number in range(ORDERED):
        one, other = (
            [played.executed for played in Trace(f"order {number}", safety_first=first).play()]
            for first in (False, True)
        )
        assert [_done(step) for step in one] == [_done(step) for step in other]
        moved += len([step for step in one if step is not None])
    assert moved > ORDERED


def _done(executed: Any) -> Json | None:
    if executed is None:
        return None
    action = {k: v for k, v in plain(executed.action).items() if k != "meta"}
    return {**plain(executed), "action": action}
