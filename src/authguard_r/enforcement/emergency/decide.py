# SPDX-License-Identifier: Apache-2.0
"""Whether a capability may be used now, and whether it may go on: pure, total, without effects.

The vocabulary is the authorization gate's own: the same reasons, the same findings. Nothing of a
call but the name of the capability and who called is read.
Spec page: docs/spec/emergency.md#decision
"""

from __future__ import annotations

from msgspec import Struct

from authguard_r.core.action import Action
from authguard_r.core.checks.guards import guard_finding
from authguard_r.core.checks.place import place_findings
from authguard_r.core.facts import SiteFacts
from authguard_r.core.finding import Finding, Findings, in_paper_order
from authguard_r.core.identifiers import Digest, GrantId, MissionId
from authguard_r.core.lease import Bound, Lease, bound_findings, time_findings
from authguard_r.core.quantities import Now, to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.core.state import AttestedState
from authguard_r.enforcement.emergency.opened import OpenedPolicy
from authguard_r.enforcement.emergency.policy import (
    HOUR_MS,
    MOST_PER_HOUR,
    Caller,
    Capability,
    Missing,
)

#: Stands in a lease and a record where a mission's id would.
NO_MISSION = MissionId("emergency")
#: What of each missing part is said.
_LACKS: dict[Missing, tuple[str, Reason]] = {
    Missing.MISSION: ("mission", Reason.NO_ACTIVE_MISSION),
    Missing.STORE: ("store", Reason.STORE_UNAVAILABLE),
    Missing.CLOCK: ("now", Reason.CLOCK_BEHIND),
}


class EmergencyScene(Struct, frozen=True, kw_only=True):
    """Everything that a call is held against; nothing of it comes from the caller.

    Args:
        state: what an estimator attested, None when nothing was.
        facts: the signed site and the gate's identity.
        now: trusted time; while the clock is behind, the latest that it can have been.
        uses: when this caller used the capability before, on the monotonic clock.
        tries: when a use of this caller's ended `not_started` and was given back.
        lacks: what is missing.
        stopped: an operator's stop stands.
        stands: the robot stands, so the monitored values have to be within their bounds already.
    """

    state: AttestedState | None
    facts: SiteFacts
    now: Now
    uses: tuple[int, ...] = ()
    tries: tuple[int, ...] = ()
    lacks: frozenset[Missing] = frozenset()
    stopped: bool = False
    stands: bool = False


class EmergencyDecision(Struct, frozen=True, kw_only=True):
    """The answer to one call.

    Args:
        capability: the one that was named; None when the policy has none of that name.
        findings: why it may not be used; empty when it may.
    """

    capability: Capability | None
    findings: Findings = ()

    def __bool__(self) -> bool:
        raise TypeError("a decision has no truth value; read `.accepted`")

    @property
    def accepted(self) -> bool:
        """True when it may be used now, as far as the policy says."""
        return self.capability is not None and not self.findings


def decide_emergency(
    opened: OpenedPolicy, name: str, caller: Caller, scene: EmergencyScene
) -> EmergencyDecision:
    """Return whether a caller may use a capability now; what is not known is not so.

    Args:
        opened: the policy.
        name: the capability, from anyone.
        caller: who called, as the gate knows it.
        scene: what the call is held against.
    """
    capability = named(opened, name)
    found = [*_binding(opened, scene.facts), *_in_time(opened, scene.now)]
    if capability is None:
        known = ", ".join(c.id for c in opened.policy.capabilities)
        found.append(Finding("capability", Reason.ACTION_OUT_OF_SCOPE, f"one of {known}", name))
        return EmergencyDecision(capability=None, findings=in_paper_order(tuple(found)))
    if caller not in capability.callers:
        wanted = f"one of {', '.join(capability.callers)}"
        found.append(Finding("caller", Reason.ROLE_DENIED, wanted, caller))
    found += _able(capability, scene)
    found += _missing(capability, scene)
    found += _uses(capability, caller, scene)
    found += state_findings(capability, scene.state, facts=scene.facts, now=scene.now)
    if scene.stands:
        found += _monitored(capability, scene.state, facts=scene.facts, now=scene.now)
    return EmergencyDecision(capability=capability, findings=in_paper_order(tuple(found)))


def named(opened: OpenedPolicy, name: str) -> Capability | None:
    """Return the capability of exactly this name."""
    return next((c for c in opened.policy.capabilities if c.id == name), None)


def state_findings(
    capability: Capability, state: AttestedState | None, *, facts: SiteFacts, now: Now
) -> Findings:
    """Return what attested state says against a capability: its guards and its place."""
    rid = facts.robot.rid
    held = [guard_finding(guard, state, rid, now) for guard in capability.guards]
    found = [finding for finding in held if finding is not None]
    if capability.regions:
        found += place_findings(
            state,
            capability.regions,
            reason=Reason.OUTSIDE_REGIONS,
            rid=rid,
            now=now,
            max_age_ms=capability.place_max_age_ms,
        )
    return tuple(found)


def action_of(capability: Capability, state: AttestedState | None, facts: SiteFacts) -> Action:
    """Return what is carried out; the source is where attested state says that the robot is."""
    kind = facts.vocabulary[capability.type]
    place = () if state is None else tuple(state.place)
    return Action(
        type=capability.type,
        tool=capability.tool,
        source=place[0] if "source" in kind.fields and len(place) == 1 else None,
        destination=capability.destination,
        params=capability.params,
    )


def permit_emergency(
    opened: OpenedPolicy, capability: Capability, *, facts: SiteFacts, now: Now, ticket: Digest
) -> Lease:
    """Return the lease of a capability that was accepted; no mission stands behind it."""
    return Lease(
        mid=NO_MISSION,
        version=opened.policy.version,
        digest=opened.digest,
        grant=GrantId(capability.id),
        ticket=ticket,
        until_utc_ms=opened.expiry_ms,
        until_mono_ms=now.mono_ms + capability.max_ms,
        regions=capability.regions,
        bounds=_bounds(capability, facts),
        guards=capability.guards,
        max_age_ms=capability.place_max_age_ms,
    )


def still_emergency(
    capability: Capability,
    lease: Lease,
    state: AttestedState | None,
    *,
    facts: SiteFacts,
    now: Now,
    lacks: frozenset[Missing],
) -> Findings:
    """Return why the robot may not go on, empty while it may (as `core.lease.still`)."""
    found = [*state_findings(capability, state, facts=facts, now=now), *time_findings(lease, now)]
    found += _missing(capability, EmergencyScene(state=state, facts=facts, now=now, lacks=lacks))
    found += _monitored(capability, state, facts=facts, now=now)
    return in_paper_order(tuple(found))


def _bounds(capability: Capability, facts: SiteFacts) -> tuple[Bound, ...]:
    kind = facts.vocabulary.get(capability.type)
    kinds = {} if kind is None else kind.params
    monitored = {name: kinds[name].monitored_by for name in capability.params if name in kinds}
    return tuple([Bound(v, capability.params[n]) for n, v in monitored.items() if v is not None])


def _monitored(
    capability: Capability, state: AttestedState | None, *, facts: SiteFacts, now: Now
) -> Findings:
    """The monitored values keep to what the capability says."""
    rid, most_ms = facts.robot.rid, capability.place_max_age_ms
    found = [
        bound_findings(bound, state, rid=rid, now=now, max_age_ms=most_ms)
        for bound in _bounds(capability, facts)
    ]
    return tuple(finding for findings in found for finding in findings)


def _binding(opened: OpenedPolicy, facts: SiteFacts) -> Findings:
    """The policy is of this robot, this profile and this site."""
    policy = opened.policy
    held = (
        ("robot", Reason.ROBOT_MISMATCH, facts.robot.rid, policy.robot),
        ("profile", Reason.PROFILE_MISMATCH, facts.robot.profile, policy.profile),
        ("site", Reason.SITE_MISMATCH, facts.digest, policy.site),
    )
    return tuple(
        Finding(f"policy.{field}", reason, wanted, got)
        for field, reason, wanted, got in held
        if wanted != got
    )


def _in_time(opened: OpenedPolicy, now: Now) -> Findings:
    got = to_timestamp(now.utc_ms)
    if now.utc_ms > opened.expiry_ms:
        return (Finding("now", Reason.EXPIRED, f"at most {opened.policy.expiry}", got),)
    if now.utc_ms < opened.not_before_ms:
        return (Finding("now", Reason.NOT_YET_VALID, f"from {opened.policy.not_before}", got),)
    return ()


def _able(capability: Capability, scene: EmergencyScene) -> Findings:
    """The robot can do it at all."""
    tools = scene.facts.robot.tools.get(capability.type, frozenset[str]())
    if capability.type in scene.facts.vocabulary and capability.tool in tools:
        return ()
    wanted = f"one of {', '.join(sorted(tools)) or 'none'}"
    return (Finding("tool", Reason.CAPABILITY_EXCEEDED, wanted, capability.tool),)


def _missing(capability: Capability, scene: EmergencyScene) -> Findings:
    """Return which needs of the capability are missing, and the operator's stop if one stands."""
    found = [
        Finding(_LACKS[part][0], _LACKS[part][1], f"the {part}", "missing")
        for part in sorted(scene.lacks)
        if part not in capability.without
    ]
    if scene.stopped and not capability.after_stop:
        found.append(Finding("stop", Reason.STOPPED, "no operator's stop", "one that stands"))
    return tuple(found)


def _uses(capability: Capability, caller: Caller, scene: EmergencyScene) -> Findings:
    """This caller did not use it too often, nor begin it in vain too often.

    A use that a clock of before calls later counts, too.
    """
    since_ms = scene.now.mono_ms - HOUR_MS
    uses = len([at for at in scene.uses if at > since_ms])
    tries = uses + len([at for at in scene.tries if at > since_ms])
    for what, most, got in (("uses", capability.per_hour, uses), ("tries", MOST_PER_HOUR, tries)):
        if got >= most:
            rate = f"under {most} {what} of caller `{caller}` in an hour"
            return (Finding("capability.per_hour", Reason.RATE_EXCEEDED, rate, str(got)),)
    return ()
