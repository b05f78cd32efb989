# SPDX-License-Identifier: Apache-2.0
"""How risky an action is in a state, and how many principals must approve it.

The score reads the canonical action and the signed site, so a planner cannot lower it by naming
things differently. A type that is not listed weighs `otherwise`; a condition that cannot be
attested counts as risky. Source: `eq:threshold`, section "Risk-Adaptive Approval". Spec page:
docs/spec/approval.md
"""

from __future__ import annotations

from enum import IntEnum

from authguard_r.core.action import Action
from authguard_r.core.checks.guards import guard_finding
from authguard_r.core.facts import SiteFacts
from authguard_r.core.identifiers import MAX_INTEGER
from authguard_r.core.mission import RiskPolicy
from authguard_r.core.quantities import Now
from authguard_r.core.state import AttestedState


class Tier(IntEnum):
    """The three lines of `eq:threshold`."""

    ORDINARY = 1
    ELEVATED = 2
    HIGH = 3


def rho(
    action: Action, policy: RiskPolicy, *, state: AttestedState | None, facts: SiteFacts, now: Now
) -> int:
    """Return how risky the action is here: 0 for not at all.

    It ends where the integers of the encoding do; no threshold lies beyond.
    """
    score = policy.types.get(action.type, policy.otherwise)
    score += _region_weight(action, policy, facts)
    if action.object is not None:
        score += policy.object_classes.get(facts.objects.get(action.object, ""), policy.otherwise)
    kind = facts.vocabulary.get(action.type)
    score += policy.privacy * (kind.privacy if kind is not None else 3)
    for risk in policy.parameters:
        # backwards is as fast
        score += -(-risk.weight * abs(action.params.get(risk.parameter, 0)) // risk.full_scale)
    for condition in policy.states:
        # counted unless attested state shows that the condition is false
        finding = guard_finding(condition.guard, state, facts.robot.rid, now)
        if finding is None or finding.reason.startswith("STATE_"):
            score += condition.weight
    return min(score, MAX_INTEGER)


def tier_of(policy: RiskPolicy, score: int) -> Tier:
    """Return the line of `eq:threshold` that the score falls on."""
    if score < policy.tau_1:
        return Tier.ORDINARY
    return Tier.ELEVATED if score < policy.tau_2 else Tier.HIGH


def required(policy: RiskPolicy, tier: Tier) -> int:
    """Return Req(a, s): how many principals must stand behind the action, the issuer included.

    One on the first line, two on the second: the numbers of the lines.
    """
    return policy.t if tier is Tier.HIGH else int(tier)


def _region_weight(action: Action, policy: RiskPolicy, facts: SiteFacts) -> int:
    """Return the weight of the heaviest tag of any region involved; no tag is the empty one."""
    heaviest = 0
    for region in action.places:
        known = facts.regions.get(region)
        for tag in ("",) if known is None else known.tags:
            heaviest = max(heaviest, policy.region_tags.get(tag, policy.otherwise))
    return heaviest
