# SPDX-License-Identifier: Apache-2.0
"""Taking a mission in and making it the active one: signed itself, or made of a template.

Spec page: docs/spec/standing.md#activation
"""

from __future__ import annotations

from msgspec import Struct

from authguard_r.compile.confirmation import signed_inputs
from authguard_r.compile.spoken import duration
from authguard_r.core.checks.mission import binding_findings
from authguard_r.core.checks.provenance import wider_sources
from authguard_r.core.encoding import Tag
from authguard_r.core.facts import SiteFacts
from authguard_r.core.lifecycle import TERMINAL, Event, Status
from authguard_r.core.mission import Mission
from authguard_r.core.provenance import MOST
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Standing, advance, carry_over, issue
from authguard_r.core.token import VerifiedMission, read_token
from authguard_r.ledger import Act, stop_stands
from authguard_r.management.parts import Parts, entry, refuse, replayed
from authguard_r.management.repetition import Used, use_instance
from authguard_r.management.rollback import require_later
from authguard_r.sealing import SealingPolicy
from authguard_r.sealing.kept import drop_last, hold_expiry, hold_retention

#: How a mission ends by itself, and why. A stale list is none of it: the next one may mend that.
_ENDS: dict[Reason, Event] = {
    Reason.EXPIRED: Event.EXPIRE,
    Reason.MISSION_COMPLETED: Event.COMPLETE,
    Reason.CERTIFICATE_EXPIRED: Event.EXPIRE,
    Reason.CERTIFICATE_REVOKED: Event.REVOKE,
    Reason.REVOKED: Event.REVOKE,
}


class _Offered(Struct, frozen=True, kw_only=True):
    """A verified mission with what is held to verify it again, and what its record says."""

    verified: VerifiedMission
    held: bytes
    used: Used | None = None


def activate(act: Act, token: bytes, confirmation: bytes | None, *, parts: Parts) -> Standing:
    """Take in a mission, an instance of a template, or the active mission's next version."""
    offered = _offered(act, token, confirmation, parts)
    verified, mission = offered.verified, offered.verified.mission
    _require_usable(verified, act, parts)
    current = act.active()
    old = lapsed(act, act.standing(current) if current is not None else None, parts)
    if old is not None and old.status not in TERMINAL and current != mission.mid:
        raise refuse(Reason.TRANSITION_REFUSED, f"`{current}` is active on this robot")
    known = act.standing(mission.mid)
    if known is None:
        standing = _first(verified)
    elif known.digest == verified.digest:
        raise replayed(known)
    else:
        standing = _update(act, known, verified, parts)
    active = advance(standing, Event.ACTIVATE)
    if active is None:  # pragma: no cover - issued missions can be activated
        raise refuse(Reason.TRANSITION_REFUSED, f"the mission is {standing.status}")
    act.keep_token(verified.digest, offered.held)
    hold_expiry(act, mission.mid, verified.expiry_ms)
    hold_retention(act, mission)
    if known is not None and act.seals:
        act.drop_token(known.digest)
    drop_last(act, mission.mid, verified.digest)
    if stop_stands(act) or (known is not None and known.status is Status.SUSPENDED):
        active = advance(active, Event.SUSPEND) or active  # only a `resume` lets it go on
    act.hold(active)
    act.make_active(mission.mid)
    opened: dict[str, object] = {
        "verb": "activate",
        "by": mission.issuer,
        "version": mission.version,
        "mission": verified.digest,
        "supersedes": mission.supersedes or "-",
        "status": active.status,
    }
    if offered.used is None:
        sealed = signed_inputs(token, confirmation, mission)
    else:  # it was the template that somebody confirmed, once for all its missions
        offered.used.hold(act)
        opened |= offered.used.opened()
        sealed = offered.used.sealed(token)
    act.record(entry(act, mission.mid, opened, sealed))
    return active


def _offered(act: Act, token: bytes, confirmation: bytes | None, parts: Parts) -> _Offered:
    if read_token(token).kind is not Tag.INSTANCE:
        return _Offered(verified=parts.intake.verify_mission(token, act), held=token)
    if confirmation is not None:
        text = "nobody confirms an instance: its template was confirmed"
        raise refuse(Reason.META_MISMATCH, text, "confirmation")
    used = use_instance(act, token, parts)
    return _Offered(verified=used.made.mission, held=used.pair(token), used=used)


def lapsed(act: Act, standing: Standing | None, parts: Parts) -> Standing | None:
    """Return the standing after what ended without an order: its time, or its signer's word."""
    if standing is None or standing.status in TERMINAL:
        return standing
    why = _over(act, standing, parts)
    event = None if why is None else _ENDS.get(why)
    ended = None if event is None else advance(standing, event)
    if ended is None:
        return standing
    act.hold(ended)
    opened: dict[str, object] = {"verb": "lapse", "status": ended.status, "reasons": [why]}
    act.record(entry(act, ended.mid, opened))
    return ended


def _over(act: Act, standing: Standing, parts: Parts) -> Reason | None:
    """Return why a mission authorizes nothing any more, or not now; None: nothing says so."""
    if act.now.utc_ms > parts.intake.held(act, standing.digest).expiry_ms:
        return Reason.EXPIRED
    if standing.status is Status.CLOSING and act.now.utc_ms > standing.closes_ms:
        return Reason.MISSION_COMPLETED
    return parts.intake.lost(act, standing.digest)


def require_bound(mission: Mission, facts: SiteFacts) -> None:
    """Refuse what was written for another robot, profile or site."""
    for finding in binding_findings(mission, facts):
        text = f"expected `{finding.got}`, got `{finding.expected}`"
        raise refuse(finding.reason, text, finding.field)


def require_sources(verified: VerifiedMission, facts: SiteFacts) -> None:
    """Refuse a mission that lets a field be set from a source that the site does not allow."""
    for field in wider_sources(verified.sources, facts.sources):
        allowed = ", ".join(sorted(facts.sources.get(field, MOST[field])))
        text = f"expected labels that the site allows: {allowed}"
        raise refuse(Reason.PROVENANCE_DENIED, text, f"mission.sources.{field}")


def require_retention_bounds(mission: Mission, sealing: SealingPolicy) -> None:
    """Refuse a mission whose retention lies outside the bounds of the gate's configuration."""
    for data, kept_ms in mission.retention.items():
        least_ms, most_ms = sealing.least_ms, sealing.most_ms.get(data, kept_ms)
        if data not in sealing.classes:
            known = ", ".join(sealing.classes) or "it seals none"
            text = f"expected a class that this gate seals ({known}): no reader may read `{data}`"
        elif not least_ms <= kept_ms <= most_ms:
            most = f" and at most {duration(most_ms)}" if data in sealing.most_ms else ""
            text = f"expected at least {duration(least_ms)}{most}, got {duration(kept_ms)}"
        else:
            continue
        text += "; change `retention` in the draft and compile it again"
        raise refuse(Reason.VALUE_OUT_OF_RANGE, text, f"mission.retention.{data}")


def _require_usable(verified: VerifiedMission, act: Act, parts: Parts) -> None:
    """Refuse what could never be carried out here: robot, profile, site, sources, times."""
    require_bound(verified.mission, parts.facts)
    require_sources(verified, parts.facts)
    require_retention_bounds(verified.mission, parts.sealing)
    if act.now.utc_ms > verified.expiry_ms:
        text = f"it ended at {verified.mission.expiry}"
        raise refuse(Reason.EXPIRED, text, "mission.expiry")
    require_later(act, verified)


def _first(verified: VerifiedMission) -> Standing:
    if verified.mission.version != 1:
        raise refuse(
            Reason.MISSION_UNKNOWN,
            f"version {verified.mission.version} supersedes one that is not here",
            "mission.supersedes",
        )
    return issue(verified)


def _update(act: Act, known: Standing, verified: VerifiedMission, parts: Parts) -> Standing:
    """Supersede the version before; only its issuer or a safety officer may."""
    mission = verified.mission
    if mission.version <= known.version:
        raise replayed(known)
    if mission.supersedes != known.digest or mission.version != known.version + 1:
        raise refuse(
            Reason.SUPERSEDED,
            f"expected the version after {known.version}, superseding its digest",
            "mission.supersedes",
        )
    before = parts.intake.mission(act, known.digest)
    if verified.issuer.id != before.mission.issuer and verified.issuer.role != "safety_officer":
        raise refuse(Reason.ROLE_DENIED, "only its issuer or a safety officer supersedes a mission")
    if advance(known, Event.SUPERSEDE) is None:
        raise refuse(Reason.TRANSITION_REFUSED, f"the mission is {known.status}")
    carried = carry_over(known, before.mission, verified)
    if carried is None:
        raise refuse(
            Reason.TRANSITION_REFUSED,
            "a grant that stays keeps its rows and allows the starts already used",
            "mission.actions",
        )
    return carried
