# SPDX-License-Identifier: Apache-2.0
"""Decisions: for every reason a case that has it alone, and a near miss that is accepted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from random import Random
from typing import Any

from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.quantities import Now
from fixtures import decision_cases, scenarios
from fixtures.decision_cases import ALONE, Case, plain
from making.sources import PREAPPROVALS, SOURCES, answered, deviations

Json = dict[str, Any]


def at_the_end(rnd: Random) -> Case:
    """Exactly t = expiry."""
    case = decision_cases._plain(rnd)
    return replace(case, now=Now(scenarios.START_MS + 1_200_000, case.now.mono_ms))


def at_the_beginning(rnd: Random) -> Case:
    """Exactly t = not_before."""
    case = decision_cases._plain(rnd)
    return replace(case, now=Now(scenarios.START_MS, case.now.mono_ms))


def at_the_bound(rnd: Random) -> Case:
    """Exactly the largest value of each limit."""
    case = decision_cases._plain(rnd, "pick", "wait")
    params = {limit.parameter: limit.high for limit in case.grant.limits}
    return decision_cases._with_action(case, params=params)


def last_in_window(rnd: Random) -> Case:
    """One release fewer than the rate allows."""
    case = decision_cases._plain(rnd)
    count = case.mission.budgets.rate.count - 1
    return decision_cases._with_standing(
        case, releases=tuple(case.now.mono_ms - n for n in range(count))
    )


def last_start(rnd: Random) -> Case:
    """One start fewer than allowed."""
    case = decision_cases._plain(rnd)
    assert case.standing is not None
    use = decision_cases.set_(case.standing.uses["wanted"], starts=case.grant.starts - 1)
    return decision_cases._with_standing(case, uses={**case.standing.uses, "wanted": use})


def last_success(rnd: Random) -> Case:
    """One success fewer than allowed."""
    case = decision_cases._plain(rnd)
    assert case.standing is not None
    use = decision_cases.set_(case.standing.uses["wanted"], successes=case.grant.repeat - 1)
    return decision_cases._with_standing(case, uses={**case.standing.uses, "wanted": use})


def last_of_budget(rnd: Random) -> Case:
    """The last action of the budget."""
    case = decision_cases._plain(rnd)
    return decision_cases._with_standing(case, actions=case.mission.budgets.actions - 1)


def just_fresh(rnd: Random) -> Case:
    """A pose exactly as old as allowed."""
    case = decision_cases._plain(rnd, "pick", "navigate")
    assert case.state is not None
    arrived = case.now.mono_ms - case.state.arrived_mono_ms
    return decision_cases._pose(case, age_ms=case.mission.place_max_age_ms - arrived)


def just_charged(rnd: Random) -> Case:
    """A guard at exactly its value."""
    return decision_cases._with_reading(decision_cases._plain(rnd), rnd, value=100)


def last_moment_of_certificate(rnd: Random) -> Case:
    """The certificate's last millisecond."""
    case = decision_cases._plain(rnd)
    return replace(case, usable_until_ms=case.now.utc_ms)


def last_moment_of_request(rnd: Random) -> Case:
    """The approval request's last millisecond."""
    case = decision_cases._approval_base(rnd)
    assert case.standing is not None
    request = decision_cases.set_(case.standing.requests["wanted"], expires_ms=case.now.utc_ms)
    return decision_cases._with_standing(case, requests={"wanted": request})


NEAR: dict[str, Callable[[Random], Case]] = {
    "EXPIRED": at_the_end,
    "NOT_YET_VALID": at_the_beginning,
    "PARAMETER_OUT_OF_BOUNDS": at_the_bound,
    "RATE_EXCEEDED": last_in_window,
    "STARTS_EXHAUSTED": last_start,
    "REPEAT_EXHAUSTED": last_success,
    "BUDGET_EXCEEDED": last_of_budget,
    "STATE_STALE": just_fresh,
    "GUARD_FALSE": just_charged,
    "CERTIFICATE_EXPIRED": last_moment_of_certificate,
    "APPROVAL_TIMEOUT": last_moment_of_request,
    "APPROVAL_REQUIRED": decision_cases._approval_base,
    "APPROVAL_DENIED": decision_cases._approval_base,
}


def confined(rnd: Random, without: str | None = None, **lost: Any) -> Case:
    """Both approvers reach this robot and the action's places only; the first one lacks one."""
    case = decision_cases._approval_base(rnd)
    places = decision_cases._places(case.action)
    held = decision_cases.Scope(robots=frozenset({scenarios.RID}), regions=frozenset(places))
    gone = {getattr(case.action, without)} if without else set()
    first = decision_cases.set_(held, **{"regions": frozenset(places - gone), **lost})
    return decision_cases._rescoped(case, (first, held))


#: Approvers whose certificates confine them: to what the action needs, or to less.
SCOPES: dict[str, Callable[[Random], Case]] = {
    "approvers who reach the robot and the action's places": confined,
    "an approver without the destination": lambda rnd: confined(rnd, "destination"),
    "an approver without the source": lambda rnd: confined(rnd, "source"),
    "an approver without the robot": lambda rnd: confined(rnd, robots=frozenset({scenarios.OTHER})),
    "an approver without any region": lambda rnd: confined(rnd, regions=frozenset()),
}


def gate_vectors() -> Json:
    """For every reason: a case that has it alone, and a near miss that is accepted."""
    vectors: list[Json] = []
    for reason in sorted(ALONE):
        vectors.append(gate_vector(reason, "alone", ALONE[reason]))
        vectors.append(gate_vector(reason, "near miss", NEAR.get(reason, decision_cases._plain)))
    for name, build in SCOPES.items():
        lost = name.startswith("an approver without")
        kind, reason = ("alone" if lost else "near miss"), "APPROVAL_REQUIRED"
        vectors.append({**gate_vector(reason, kind, build, confined=True), "note": name})
    for reason, cases in (("PROVENANCE_DENIED", SOURCES), ("APPROVAL_REQUIRED", PREAPPROVALS)):
        for name, (build, accepted) in cases.items():
            kind = "near miss" if accepted else "alone"
            vectors.append({**gate_vector(reason, kind, build, confined=True), "note": name})
    vectors.append(
        {
            **gate_vector("APPROVAL_DENIED", "alone", answered, confined=True),
            "note": "a denial outweighs what the same person approved in advance",
        }
    )
    facts = decision_cases.plain_facts(decision_cases.FACTS)
    return {"facts": facts, "vectors": vectors, "deviations": deviations()}


def gate_vector(
    reason: str, kind: str, build: Callable[[Random], Case], *, confined: bool = False
) -> Json:
    """Return the first case from the seed on that is what its kind says."""
    wanted = [reason] if kind == "alone" else []
    for seed in range(1_000):
        case = build(Random(seed))
        case = case if confined else decision_cases.everywhere(case)
        decision = decision_cases.decide_case(case)
        if [str(r) for r in decision.reasons] == wanted:
            return {
                "reason": reason,
                "kind": kind,
                "input": gate_input(case),
                "expect": {
                    "verdict": str(decision.verdict),
                    "reasons": wanted,
                    "grant": None if decision.match is None else decision.match.indexed.grant.id,
                    "required": None if decision.need is None else decision.need.required,
                    "risk": None if decision.need is None else decision.need.risk,
                    "preapproved": decision.preapproved,
                },
            }
    raise SystemExit(f"no {kind} for {reason}")


def gate_input(case: Case) -> Json:
    """Return the inputs of a decision as plain data; facts only where they differ."""
    given: Json = {
        "mission": plain(case.mission),
        "digest": digest_of(Tag.MISSION, case.mission),
        "usable_until_ms": case.usable_until_ms,
        "action": plain(case.action),
        "state": decision_cases.plain_state(case.state),
        "now": plain(case.now),
        "standing": None if case.standing is None else plain(case.standing),
        "approvals": [plain(item) for item in case.approvals],
    }
    if case.preapprovals:
        given["preapprovals"] = [plain(item) for item in case.preapprovals]
    if case.issuer_role != "operator":
        given["issuer"] = {"id": case.mission.issuer, "role": case.issuer_role}
    if case.facts is not decision_cases.FACTS:
        given["facts"] = decision_cases.plain_facts(case.facts)
    return given
