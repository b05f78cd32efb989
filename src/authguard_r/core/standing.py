# SPDX-License-Identifier: Apache-2.0
"""What a mission has already used up: the registry R, as one immutable value.

Standing changes only through the functions here; a store holds it and never interprets it.
Source: `alg:authguard` steps 4 and 8, section "Replay Resistance". Spec page: docs/spec/standing.md
"""

from __future__ import annotations

from enum import StrEnum
from typing import TypeVar

import msgspec
from msgspec import Struct

from authguard_r.core.identifiers import Digest, GrantId, MissionId, RobotId
from authguard_r.core.lifecycle import TRANSITIONS, Event, Status
from authguard_r.core.mission import Grant, Mission
from authguard_r.core.quantities import Now
from authguard_r.core.token import VerifiedMission

T = TypeVar("T")


class Outcome(StrEnum):
    """How a released action ended. Only `not_started` gives a start back."""

    SUCCEEDED = "succeeded"
    FAILED = "failed"
    NOT_STARTED = "not_started"
    ABORTED = "aborted"
    UNKNOWN = "unknown"

    def __bool__(self) -> bool:
        raise TypeError("an outcome has no truth value; compare it with one of its members")


class Spend(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """What one lease may use at most, or what all have used."""

    motion_ms: int = 0
    wait_ms: int = 0
    recorded_bytes: int = 0


class Use(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """How far one grant is used.

    Args:
        starts: releases that count.
        successes: outcomes `succeeded`.
        last_success: place of the last one in the mission's order of successes, from 1.
    """

    starts: int = 0
    successes: int = 0
    last_success: int = 0


class OpenRelease(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A release whose outcome is not known yet, with what it holds reserved."""

    ticket: Digest
    grant: GrantId
    reserved: Spend


class ApprovalRequest(
    Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True
):
    """An open question to approvers; one for each grant.

    Args:
        counter: never used twice in a mission; an approval answers exactly one.
        scope: digest of the action's effect.
        situation: digest of the guards' truth and the risk tier when it was asked.
        required: principals needed in all, the issuer included.
        expires_ms: trusted time after which an answer is too late.
        denied: a person who may answer denied: closed for answers, even if that person is revoked
            later.
    """

    counter: int
    scope: Digest
    situation: Digest
    required: int
    expires_ms: int
    denied: bool = False


class Standing(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """Status, uses, order and budgets of one mission version.

    Args:
        mid: the mission.
        version: its version.
        digest: the digest of the signed bytes, so that two tokens of one name never mix.
        rid: the robot whose store holds this.
        status: where in its life the mission is.
        uses: by grant id; a grant that was never used is absent.
        order: number of successes so far: the clock of `after` and `until`.
        actions: releases so far.
        spent: budgets used and reserved.
        prompts: times a person was asked.
        planner_stops: stops asked for by the planner.
        releases: monotonic times of the releases inside the rate window.
        open: releases without an outcome.
        requests: open approval requests by grant.
        counter: the last request counter given out.
        selected: index of the row that an authenticated selection chose, by grant.
        closes_ms: trusted time at which `closing` ends.
        preapproved: releases that each pre-approval covers still, by its digest.
    """

    mid: MissionId
    version: int
    digest: Digest
    rid: RobotId
    status: Status
    uses: dict[GrantId, Use] = {}
    order: int = 0
    actions: int = 0
    spent: Spend = Spend()
    prompts: int = 0
    planner_stops: int = 0
    releases: tuple[int, ...] = ()
    open: tuple[OpenRelease, ...] = ()
    requests: dict[GrantId, ApprovalRequest] = {}
    counter: int = 0
    selected: dict[GrantId, int] = {}
    closes_ms: int = 0
    preapproved: dict[Digest, int] = {}


_UNUSED = Use()


def issue(verified: VerifiedMission) -> Standing:
    """Return the standing of a mission that was taken in and has done nothing."""
    mission = verified.mission
    return Standing(
        mid=mission.mid,
        version=mission.version,
        digest=verified.digest,
        rid=mission.rid,
        status=Status.ISSUED,
    )


def use_of(standing: Standing, grant: GrantId) -> Use:
    """Return how far the grant is used."""
    return standing.uses.get(grant, _UNUSED)


def in_flight(standing: Standing, grant: GrantId) -> int:
    """Return how many releases of the grant have no outcome yet."""
    return sum(1 for release in standing.open if release.grant == grant)


def advance(standing: Standing, event: Event) -> Standing | None:
    """Return the standing after a lifecycle event, or None when the table refuses it."""
    status = TRANSITIONS.get((standing.status, event))
    return None if status is None else _with(standing, status=status)


def reserve(
    standing: Standing,
    grant: Grant,
    *,
    ticket: Digest,
    spend: Spend,
    now: Now,
    per_ms: int,
    preapproved: Digest | None = None,
) -> Standing:
    """Return the standing after a release: the start is used, the lease's maximum reserved.

    Args:
        standing: before.
        grant: the grant that matched.
        ticket: digest of the released action.
        spend: the most that the lease can use.
        now: the instant of the decision.
        per_ms: the rate window; older releases are forgotten.
        preapproved: digest of the pre-approval that the decision rests on; None: on none.
    """
    use, left = use_of(standing, grant.id), standing.preapproved
    if preapproved is not None:
        left = {**left, preapproved: left.get(preapproved, 0) - 1}
    recent = tuple(at for at in standing.releases if at > now.mono_ms - per_ms)
    return _with(
        standing,
        uses={**standing.uses, grant.id: _with(use, starts=use.starts + 1)},
        actions=standing.actions + 1,
        spent=_add(standing.spent, spend),
        releases=(*recent, now.mono_ms),
        open=(*standing.open, OpenRelease(ticket=ticket, grant=grant.id, reserved=spend)),
        requests={g: r for g, r in standing.requests.items() if g != grant.id},
        preapproved=left,
    )


def settle(
    standing: Standing, mission: Mission, *, ticket: Digest, outcome: Outcome, used: Spend
) -> Standing:
    """Return the standing after an outcome; `unknown` changes nothing and stays open.

    Args:
        standing: before; a ticket that is not open leaves it as it is.
        mission: the mission that the release was made under.
        ticket: digest of the released action.
        outcome: its result.
        used: what it really used; it takes the place of what was reserved.
    """
    release = next((r for r in standing.open if r.ticket == ticket), None)
    if release is None or outcome is Outcome.UNKNOWN:
        return standing
    use, won = use_of(standing, release.grant), outcome is Outcome.SUCCEEDED
    grant = next((g for g in mission.actions if g.id == release.grant), None)
    back = outcome is Outcome.NOT_STARTED and grant is not None and not grant.irreversible
    order = standing.order + won
    last = order if won else use.last_success
    use = Use(starts=use.starts - back, successes=use.successes + won, last_success=last)
    return _with(
        standing,
        uses={**standing.uses, release.grant: use},
        order=order,
        actions=standing.actions - back,
        spent=_settle_spend(standing.spent, release.reserved, used),
        open=tuple(r for r in standing.open if r.ticket != ticket),
    )


def is_complete(standing: Standing, mission: Mission) -> bool:
    """True when every completing grant has all its successes and there is one."""
    completing = [grant for grant in mission.actions if grant.completes]
    return bool(completing) and all(
        use_of(standing, grant.id).successes >= grant.repeat for grant in completing
    )


def finish(standing: Standing, mission: Mission, now: Now) -> Standing:
    """Return the standing, completed (or closing) when it is active and all is done."""
    if standing.status is not Status.ACTIVE or not is_complete(standing, mission):
        return standing
    closing = advance(standing, Event.BEGIN_CLOSING)
    if mission.closing is not None and closing is not None:
        return _with(closing, closes_ms=now.utc_ms + mission.closing.for_ms)
    return advance(standing, Event.COMPLETE) or standing


def ask(standing: Standing, grant: GrantId, request: ApprovalRequest) -> Standing:
    """Return the standing with an approval request open; the grant's earlier one dies."""
    return _with(
        standing,
        requests={**standing.requests, grant: request},
        counter=request.counter,
        prompts=standing.prompts + 1,
    )


def deny_request(standing: Standing, grant: GrantId) -> Standing:
    """Return the standing with the grant's open request denied for ever."""
    denied = _with(standing.requests[grant], denied=True)
    return _with(standing, requests={**standing.requests, grant: denied})


def close_request(standing: Standing, grant: GrantId) -> Standing:
    """Return the standing without the grant's open request: its approvals are dead."""
    return _with(standing, requests={g: r for g, r in standing.requests.items() if g != grant})


def select(standing: Standing, grant: GrantId, row: int) -> Standing:
    """Return the standing after an authenticated selection of one signed row."""
    return _with(standing, selected={**standing.selected, grant: row})


def count_planner_stop(standing: Standing) -> Standing:
    """Return the standing after a stop that the planner asked for."""
    return _with(standing, planner_stops=standing.planner_stops + 1)


def carry_over(old: Standing, old_mission: Mission, new: VerifiedMission) -> Standing | None:
    """Return the standing of the next version, or None when it would forget what was used.

    A grant id that both versions have must keep its rows and allow at least the starts already
    used; its uses are carried. Open releases are carried too, so that their outcomes count.
    Approval requests and selections die with the version they were made for.
    """
    before = {grant.id: grant for grant in old_mission.actions}
    for grant in new.mission.actions:
        earlier = before.get(grant.id)
        if earlier is None:
            continue
        same = ("type", "tool", "alternatives")
        kept = all(getattr(grant, field) == getattr(earlier, field) for field in same)
        if not kept or grant.starts < use_of(old, grant.id).starts:
            return None
    fresh = issue(new)
    return _with(
        old,
        version=fresh.version,
        digest=fresh.digest,
        status=fresh.status,
        requests=fresh.requests,
        selected=fresh.selected,
        closes_ms=fresh.closes_ms,
        preapproved=fresh.preapproved,
    )


def _add(a: Spend, b: Spend) -> Spend:
    return Spend(
        motion_ms=a.motion_ms + b.motion_ms,
        wait_ms=a.wait_ms + b.wait_ms,
        recorded_bytes=a.recorded_bytes + b.recorded_bytes,
    )


def _settle_spend(total: Spend, reserved: Spend, used: Spend) -> Spend:
    return Spend(
        motion_ms=total.motion_ms - reserved.motion_ms + max(0, used.motion_ms),
        wait_ms=total.wait_ms - reserved.wait_ms + max(0, used.wait_ms),
        recorded_bytes=total.recorded_bytes - reserved.recorded_bytes + max(0, used.recorded_bytes),
    )


def _with(value: T, **changes: object) -> T:
    return msgspec.structs.replace(value, **changes)  # type: ignore[type-var]
