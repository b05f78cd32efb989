# SPDX-License-Identifier: Apache-2.0
"""The operator's card: what a mission grants, row by row, and what it does not.

Written from the very structure that is signed, never from the draft: two missions that differ
never have one card. Risks to privacy and bodies are marked. How-to: docs/howto/missions.md
"""

from __future__ import annotations

from collections.abc import Iterator

from msgspec import Struct

from authguard_r.authoring.compile.difference import compare
from authguard_r.authoring.compile.unlisted import unlisted
from authguard_r.authoring.compile.worst import facts_for, worst_risk
from authguard_r.core.encoding import Tag, digest
from authguard_r.core.facts import SiteFacts
from authguard_r.core.identifiers import Digest, Identifier, Positive
from authguard_r.core.mission import Grant, Mission, RiskPolicy
from authguard_r.core.quantities import to_ms
from authguard_r.core.risk import required, tier_of
from authguard_r.site import formatting
from authguard_r.site.durations import duration
from authguard_r.site.model import Site

RIGHTS = ("record", "store", "transmit")


class OrganizationDemand(Struct, frozen=True, kw_only=True):
    """What an organization demands beside the mission's own policy, and under which name.

    Args:
        organization: whose policy it is; the caller has checked that.
        version: of the policy.
        policy: its weights, thresholds and roles.
    """

    organization: Identifier
    version: Positive
    policy: RiskPolicy


def review(
    mission: Mission, site: Site, *, demand: OrganizationDemand | None = None
) -> tuple[str, ...]:
    """Return the card's lines; the same mission, site and demand give the same lines.

    Args:
        mission: what is signed.
        site: where it is to be carried out.
        demand: the organization's; None when it is unknown, and the card says that it may ask more.
    """
    return (
        *_head(mission, site),
        *_grants(mission, site, demand),
        *_totals(mission),
        *_approvals(mission, site),
        *_demanded(mission, demand),
        *_sources(mission, site),
        *_retention(mission),
        *_withheld(mission, site),
        *_bound(mission),
    )


def card_digest(lines: tuple[str, ...]) -> Digest:
    """Return the digest of a card's bytes: its lines in UTF-8, joined by newlines."""
    return digest(Tag.RAW, "\n".join(lines).encode("utf-8"))


def _head(mission: Mission, site: Site) -> Iterator[str]:
    length = to_ms(mission.expiry, where="expiry") - to_ms(mission.not_before, where="not_before")
    window = f"{mission.not_before} to {mission.expiry} ({duration(length)})"
    yield f"Mission {mission.mid}, version {mission.version}, for robot {mission.rid}"
    yield f"  {formatting.quoted(mission.task)}"
    yield f"  to be signed by {mission.issuer}; valid {window}"
    yield f"  only with a place read at most {duration(mission.place_max_age_ms)} ago"
    for guard in mission.guards:
        yield f"  only while {formatting.condition(guard)}"
    for item in mission.limits:
        yield f"  never outside {formatting.limit(item, site)}"
    yield f"  only with objects: {', '.join(mission.objects) or 'none'}"
    yield f"  only in regions: {', '.join(mission.regions) or 'none'}"


def _grants(mission: Mission, site: Site, demand: OrganizationDemand | None) -> Iterator[str]:
    yield "It grants:"
    facts = facts_for(mission, site)
    for grant in mission.actions:
        yield from _grant(grant, site)
        yield f"    {_asked(mission, grant, facts, demand)}"
        names, weight = unlisted(mission.risk_policy, site, grant), mission.risk_policy.otherwise
        if names:
            yield f"      its risk policy does not list {', '.join(names)}: each weighs {weight}"


def _grant(grant: Grant, site: Site) -> Iterator[str]:
    how = f"{formatting.times(grant.repeat)}, at most {grant.starts} start(s)"
    longest = f"up to {duration(grant.max_ms)} each"
    yield f"  {grant.id}: {grant.type} with {grant.tool}, {how}, {longest}{_marks(grant, site)}"
    for number, row in enumerate(grant.alternatives):
        yield f"    row {number}: {formatting.row(row, site)}"
    every = ": every row, also one that an attacker picks" * (grant.chooser == "planner")
    yield f"    chosen by: {grant.chooser}{every}"
    for item in grant.limits:
        yield f"    {formatting.limit(item, site, grant.type)}"
    for guard in grant.guards:
        yield f"    only while {formatting.condition(guard)}"
    if grant.after:
        yield f"    only after: {', '.join(grant.after)}"
    if grant.until:
        yield f"    only until: {', '.join(grant.until)}"
    for guard in grant.done_when:
        yield f"    counts as done when {formatting.condition(guard)}"
    if grant.completes:
        yield "    the mission is complete with it"
    rights = [right for right in RIGHTS if getattr(grant.data, right)]
    if rights:
        yield f"    MAY {', '.join(rights)} sensor data"


def _marks(grant: Grant, site: Site) -> str:
    """Mark what touches privacy, can hurt, moves a body, presses on one, or cannot be undone."""
    kind = site.vocabulary.get(grant.type)
    physical = 0 if kind is None else kind.physical
    held = (
        ("PRIVACY", kind is not None and kind.privacy > 0),
        (f"PHYSICAL {physical}", physical > 0),
        ("MOTION", kind is not None and kind.moves),
        ("FORCE", any(item.parameter.startswith("force_") for item in grant.limits)),
        ("IRREVERSIBLE", grant.irreversible),
    )
    marks = [name for name, holds in held if holds]
    return f"  [{', '.join(marks)}]" if marks else ""


def _asked(
    mission: Mission, grant: Grant, facts: SiteFacts | None, demand: OrganizationDemand | None
) -> str:
    """Say in words whom the riskiest action of the grant asks, by the stricter policy."""
    if facts is None:
        return "unknown: this site has no such robot"
    own = mission.risk_policy
    needs = [(*_need(mission, grant, facts, own), "the mission's own policy")]
    if demand is not None:
        theirs = f"the policy of {demand.organization}"
        needs.append((*_need(mission, grant, facts, demand.policy), theirs))
    count, _, risk, whose = max(needs)
    if count == 1:
        either = " by either policy" * (len(needs) > 1)
        return f"asks no second person: its risk is at most {risk}{either}"
    by = f", by {whose}" * (len(needs) > 1)
    return f"asks {count - 1} further person(s) at its riskiest ({risk}{by})"


def _need(
    mission: Mission, grant: Grant, facts: SiteFacts, policy: RiskPolicy
) -> tuple[int, int, int]:
    """Return how many people the riskiest action asks by a policy, from which tier and risk.

    What is greater is stricter, in the order in which the gate compares (`core.checks.approval`).
    """
    risk = max(worst_risk(mission, grant, r, facts, policy=policy) for r in grant.alternatives)
    tier = tier_of(policy, risk)
    return required(policy, tier), int(tier), risk


def _totals(mission: Mission) -> Iterator[str]:
    budgets, rate = mission.budgets, mission.budgets.rate
    yield (
        f"In all: {budgets.actions} actions, at most {rate.count} in "
        f"{duration(rate.per_ms)}; {duration(budgets.motion_ms)} in motion, "
        f"{duration(budgets.wait_ms)} waiting; "
        f"{formatting.quantity(budgets.recorded_bytes, 'byte')} recorded; "
        f"an alert after {budgets.planner_stops} stops by the planner"
    )
    yield f"After a refusal: {mission.on_refusal}"
    if mission.closing is not None:
        names, long = ", ".join(mission.closing.grants), duration(mission.closing.for_ms)
        yield f"Once complete, {names} may still be used for {long}"


def _approvals(mission: Mission, site: Site) -> Iterator[str]:
    policy = mission.risk_policy
    yield (
        f"Below risk {policy.tau_1} it asks no one; from {policy.tau_1} a second person, from "
        f"{policy.tau_2} {policy.t} people in all, the signer included"
    )
    yield (
        f"  of the roles {', '.join(policy.roles)}; a request lives "
        f"{duration(policy.valid_ms)}, at most {mission.budgets.prompts} request(s)"
    )
    yield f"  risk is the sum of: {'; '.join(_weights(policy, site))}"


def _demanded(mission: Mission, demand: OrganizationDemand | None) -> Iterator[str]:
    """Say what the organization's policy adds; without one, that it may ask for more."""
    if demand is None:
        yield "  an organization's risk policy may ask more people: review with --risk-policy"
        return
    own, policy = mission.risk_policy, demand.policy
    roles = ", ".join(role for role in own.roles if role in policy.roles)
    yield (
        f"The risk policy of {demand.organization}, version {demand.version}: "
        "each grant needs the approvals of the stricter one"
    )
    yield (
        f"  below its risk {policy.tau_1} it asks no one; from {policy.tau_1} a second person, "
        f"from {policy.tau_2} on {policy.t} people in all, the signer included"
    )
    yield (
        f"  of the roles that both name: {roles or 'none, so no one can answer'}; a request lives "
        f"{duration(min(own.valid_ms, policy.valid_ms))}"
    )


def _weights(policy: RiskPolicy, site: Site) -> Iterator[str]:
    for what, weights in (
        ("action", policy.types),
        ("region", policy.region_tags),
        ("object", policy.object_classes),
    ):
        listed = [f"{name} {weight}" for name, weight in sorted(weights.items())]
        yield f"{what} ({', '.join([*listed, f'any other {policy.otherwise}'])})"
    for item in policy.parameters:
        scale = formatting.quantity(item.full_scale, formatting.unit_of(item.parameter, site))
        yield f"{item.parameter} ({item.weight} at {scale})"
    for state in policy.states:
        yield f"{state.weight} unless it is attested that not: {formatting.condition(state.guard)}"
    yield f"each step of privacy {policy.privacy}"


def _sources(mission: Mission, site: Site) -> Iterator[str]:
    """Say which labels may set which field, where the site or the mission narrows it."""
    for whose, sources in (("the site", site.sources), ("this mission", mission.sources)):
        for field, labels in sorted(sources.items()):
            yield f"By {whose}, {field} may be set by {', '.join(labels)} only"
    weighed = sorted(mission.risk_policy.field_weights.items())
    if weighed:
        told = ", ".join(f"{field} {weight}" for field, weight in weighed)
        yield f"Deviation is measured with weights ({told}, any other 1); they authorize nothing"


def _retention(mission: Mission) -> Iterator[str]:
    for data, kept_ms in sorted(mission.retention.items()):
        kept = duration(kept_ms)
        yield f"Sealed {data} fields are destroyed {kept} after the mission expires"


def _withheld(mission: Mission, site: Site) -> Iterator[str]:
    granted = {grant.type for grant in mission.actions}
    tools = site.robots[mission.rid].profile.tools if mission.rid in site.robots else {}
    withheld = sorted(kind for kind in tools if kind not in granted)
    closed = sorted(region for region in site.regions if region not in mission.regions)
    handled = {row.object for grant in mission.actions for row in grant.alternatives}
    others = sorted(item for item in site.objects if item not in handled)
    kept = [r for r in RIGHTS if not any(getattr(grant.data, r) for grant in mission.actions)]
    if mission.rid not in site.robots:
        yield f"Robot {mission.rid} is not in this site: what it does NOT grant is unknown"
    elif withheld:
        yield f"It does NOT grant: {', '.join(withheld)}"
    else:
        yield "It grants every action type of this robot"
    yield f"It never enters: {', '.join(closed) or 'no region is closed'}"
    yield f"It never handles: {', '.join(others) or 'no object is left out'}"
    yield f"Withheld rights to sensor data: {', '.join(kept) or 'none'}"


def _bound(mission: Mission) -> Iterator[str]:
    yield f"Bound to site {mission.site}"
    yield f"  and to profile {mission.profile}; nonce {mission.nonce}"
    if mission.supersedes is not None:
        yield f"  takes the place of {mission.supersedes}"


__all__ = ["OrganizationDemand", "card_digest", "compare", "review"]
