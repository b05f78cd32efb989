# SPDX-License-Identifier: Apache-2.0
"""Taking a mission in, and making it the active one: signed itself, or made of a template.

Spec page: docs/spec/standing.md#activation
"""

from __future__ import annotations

from contextlib import suppress

from msgspec import Struct

from authguard_r.anchoring.sealing.policy import SealingPolicy
from authguard_r.anchoring.sealing.stored_policy import drop_last, hold_expiry, hold_retention
from authguard_r.core.checks.mission import binding_findings
from authguard_r.core.checks.provenance import wider_sources
from authguard_r.core.encoding import Tag
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.facts import SiteFacts
from authguard_r.core.identifiers import MissionId
from authguard_r.core.lifecycle import REFUSAL, TERMINAL, Event, Status
from authguard_r.core.mission import Mission
from authguard_r.core.provenance import WIDEST
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Standing, advance, carry_over, issue
from authguard_r.core.token import VerifiedMission, read_token
from authguard_r.enforcement.confirmation import signed_inputs
from authguard_r.enforcement.management.parts import ManagementParts, entry, refuse, replayed
from authguard_r.enforcement.management.repetition import Used, use_instance
from authguard_r.enforcement.management.rollback import require_later
from authguard_r.site.durations import duration
from authguard_r.store.issued_missions import (
    hold_issued,
    issued,
    registered,
    require_readable,
    take_issued,
)
from authguard_r.store.transactions import Transaction, stop_stands
from authguard_r.wire.gate_limits import LIMITS

#: How a mission ends by itself, and why. A stale list is not part of it: the next one may end that.
_ENDS: dict[Reason, Event] = {
    Reason.EXPIRED: Event.EXPIRE,
    Reason.MISSION_COMPLETED: Event.COMPLETE,
    Reason.CERTIFICATE_EXPIRED: Event.EXPIRE,
    Reason.CERTIFICATE_REVOKED: Event.REVOKE,
    Reason.REVOKED: Event.REVOKE,
    Reason.SUPERSEDED: Event.SUPERSEDE,
}


class _Offered(Struct, frozen=True, kw_only=True):
    """A verified mission with what is held to verify it again, and what its record says."""

    verified: VerifiedMission
    held: bytes
    token: bytes
    confirmation: bytes | None
    used: Used | None = None

    def sealed(self) -> dict[str, object]:
        """Return what a record seals; of an instance, the template was confirmed, once for all."""
        if self.used is not None:
            return self.used.sealed(self.token)
        return signed_inputs(self.token, self.confirmation, self.verified.mission)


def hand_in(
    act: Transaction, token: bytes, confirmation: bytes | None, *, parts: ManagementParts
) -> Standing:
    """Take in a mission, an instance of a template, or a mission's next version; activate nothing.

    The standing of a version before it stays as it is. What is handed in waits with the status
    `issued` and authorizes nothing.
    """
    require_readable(act)
    offered = _offered(act, token, confirmation, parts)
    verified, mid = offered.verified, offered.verified.mission.mid
    _require_usable(verified, act, parts)
    known = lapsed(act, act.standing(mid), parts)
    here = registered(act, mid, verified.digest)
    if here is not None:
        raise replayed(here)
    if known is None:
        _first(verified)
    else:
        _update(act, known, verified, parts)  # it could supersede that version now
    if len(issued(act)) >= LIMITS.issued_missions:
        text = (
            f"{LIMITS.issued_missions} missions are issued already, listed by `authguard status`: "
            "`authguard mission revoke TOKEN` ends one"
        )
        raise refuse(Reason.BUSY, text)
    standing = issue(verified)
    act.keep_token(verified.digest, offered.held)
    if known is None:
        hold_expiry(act, mid, verified.expiry_ms)
        hold_retention(act, verified.mission)
    hold_issued(act, standing)
    _record(act, "issue", offered, standing, offered.sealed())
    return standing


def activate(
    act: Transaction, token: bytes, confirmation: bytes | None, *, parts: ManagementParts
) -> Standing:
    """Make a mission active that is issued, or take it in first: the same kinds as `hand_in`."""
    require_readable(act)
    offered = _offered(act, token, confirmation, parts)
    verified, mission = offered.verified, offered.verified.mission
    _require_usable(verified, act, parts)
    current = act.active()
    old = lapsed(act, act.standing(current) if current is not None else None, parts)
    if old is not None and old.status not in TERMINAL and current != mission.mid:
        text = f"`{current}` is active on this robot: complete or revoke it first"
        raise refuse(Reason.TRANSITION_REFUSED, text)
    known = act.standing(mission.mid)
    standing = _issued(act, offered, known, parts)
    active = advance(standing, Event.ACTIVATE)
    if active is None:  # pragma: no cover - issued missions can be activated
        raise refuse(Reason.TRANSITION_REFUSED, f"the mission is {standing.status}")
    act.keep_token(verified.digest, offered.held)
    hold_expiry(act, mission.mid, verified.expiry_ms)
    hold_retention(act, mission)
    if known is not None and known.digest != verified.digest and act.seals:
        act.drop_token(known.digest)
    drop_last(act, mission.mid, verified.digest)
    if stop_stands(act) or (known is not None and known.status is Status.SUSPENDED):
        active = advance(active, Event.SUSPEND) or active  # only a `resume` lets it go on
    take_issued(act, active)
    act.make_active(mission.mid)
    _record(act, "activate", offered, active, offered.sealed())
    end_issued(act, parts, mid=mission.mid)
    return active


def _issued(
    act: Transaction, offered: _Offered, known: Standing | None, parts: ManagementParts
) -> Standing:
    """Return the standing that is activated; a mission that was not handed in is, now."""
    verified = offered.verified
    here = registered(act, verified.mission.mid, verified.digest)
    if here is not None and here.status is not Status.ISSUED:
        raise replayed(here)
    if here is not None and known is not None and here.digest == known.digest:
        return here
    if known is None:
        standing = _first(verified)
        act.hold(standing)
    else:
        standing = _update(act, known, verified, parts)
    if here is None:  # the record behind this one, in the same commit, seals the token
        _record(act, "issue", offered, standing, {})
    return standing


def _record(
    act: Transaction, verb: str, offered: _Offered, standing: Standing, sealed: dict[str, object]
) -> None:
    mission = offered.verified.mission
    opened: dict[str, object] = {
        "verb": verb,
        "by": mission.issuer,
        "version": mission.version,
        "mission": offered.verified.digest,
        "supersedes": mission.supersedes or "-",
        "status": standing.status,
    }
    if offered.used is not None:
        offered.used.hold(act)
        opened |= offered.used.opened()
    act.record(entry(act, mission.mid, opened, sealed))


def _offered(
    act: Transaction, token: bytes, confirmation: bytes | None, parts: ManagementParts
) -> _Offered:
    if read_token(token).kind is not Tag.INSTANCE:
        verified = parts.inputs.verify_mission(token, act)
        return _Offered(verified=verified, held=token, token=token, confirmation=confirmation)
    if confirmation is not None:
        text = "an instance needs no confirmation: its template was confirmed"
        raise refuse(Reason.META_MISMATCH, text, "confirmation")
    used = use_instance(act, token, parts)
    made = used.made.mission
    return _Offered(verified=made, held=used.pair(token), token=token, confirmation=None, used=used)


def end_issued(act: Transaction, parts: ManagementParts, *, mid: MissionId | None = None) -> None:
    """End every issued mission version that ended without an order, with one `lapse` record each.

    A damaged entry stays as it is; it keeps no other from its end.

    Args:
        act: the act.
        parts: of the gate.
        mid: of this mission alone; None: of every mission.
    """
    for standing in issued(act):
        why = None
        if mid in {None, standing.mid}:
            with suppress(AuthGuardError):  # one damaged token keeps no other from its end
                why = _over(act, standing, parts)
        _lapse(act, standing, why)


def lapsed(act: Transaction, standing: Standing | None, parts: ManagementParts) -> Standing | None:
    """Return the standing after an end without an order: expiry, or a revoked signer."""
    if standing is None or standing.status in TERMINAL:
        return standing
    return _lapse(act, standing, _over(act, standing, parts))


def _lapse(act: Transaction, standing: Standing, why: Reason | None) -> Standing:
    is_issued = standing.status is Status.ISSUED
    event = None if why is None else _ENDS.get(why)
    if is_issued and event is Event.COMPLETE:
        event = Event.SUPERSEDE  # the version before it completed the mission
    ended = None if event is None else advance(standing, event)
    if ended is None:
        return standing
    opened: dict[str, object] = {"verb": "lapse", "status": ended.status, "reasons": [why]}
    if is_issued:
        hold_issued(act, ended)
        opened |= {"version": ended.version, "mission": ended.digest}
    else:
        act.hold(ended)
    act.record(entry(act, ended.mid, opened))
    return ended


def _over(act: Transaction, standing: Standing, parts: ManagementParts) -> Reason | None:
    """Return why a mission authorizes nothing any more, or not now; None: nothing says so."""
    known = act.standing(standing.mid)
    if known is not None and known.digest != standing.digest:  # issued beside it
        if known.version >= standing.version:
            return Reason.SUPERSEDED
        before = REFUSAL.get(known.status) if known.status in TERMINAL else _over(act, known, parts)
        if before in _ENDS:
            return before
    if act.now.utc_ms > parts.inputs.held(act, standing.digest).expiry_ms:
        return Reason.EXPIRED
    if standing.status is Status.CLOSING and act.now.utc_ms > standing.closes_ms:
        return Reason.MISSION_COMPLETED
    return parts.inputs.lost(act, standing.digest)


def require_bound(mission: Mission, facts: SiteFacts) -> None:
    """Refuse what was written for another robot, profile or site."""
    for finding in binding_findings(mission, facts):
        text = f"expected `{finding.got}`, got `{finding.expected}`"
        raise refuse(finding.reason, text, finding.field)


def require_sources(verified: VerifiedMission, facts: SiteFacts) -> None:
    """Refuse a mission that lets a field be set from a source that the site does not allow."""
    for field in wider_sources(verified.sources, facts.sources):
        allowed = ", ".join(sorted(facts.sources.get(field, WIDEST[field])))
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


def _require_usable(verified: VerifiedMission, act: Transaction, parts: ManagementParts) -> None:
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


def _update(
    act: Transaction, known: Standing, verified: VerifiedMission, parts: ManagementParts
) -> Standing:
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
    before = parts.inputs.mission(act, known.digest)
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
