# SPDX-License-Identifier: Apache-2.0
"""Random decisions: a case that is accepted, and one change for every reason to refuse it.

The base varies everything that must not matter (order of grants, other grants, limits, times,
ages, positions, what was used before); a change then breaks exactly one condition. Both the gate
and the oracle judge the result.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from random import Random
from typing import Any

import msgspec

import authguard_reference as oracle
import worlds
from authguard_r.cli.replay_words import plain, plain_facts
from authguard_r.core.action import Action, ActionMeta, scope_of
from authguard_r.core.approval import Approval, Verdict, VerifiedApproval
from authguard_r.core.checks.approval import Situation
from authguard_r.core.decide import decide
from authguard_r.core.decision import Decision
from authguard_r.core.encoding import Tag, b64, digest_of
from authguard_r.core.facts import SiteFacts
from authguard_r.core.lifecycle import Status
from authguard_r.core.mission import (
    Budgets,
    DataRights,
    Grant,
    Guard,
    Limit,
    Mission,
    Rate,
    RiskPolicy,
    Row,
)
from authguard_r.core.quantities import Now, to_timestamp
from authguard_r.core.standing import ApprovalRequest, OpenRelease, Spend, Standing, Use, issue
from authguard_r.core.state import AttestedState
from authguard_r.core.token import Principal, Scope, index_mission
from authguard_reference.approval import policies_of
from authguard_reference.risk import required_of, rho, tier_of

FACTS = worlds.facts()
BASE = worlds.mission()
DIGEST = b64(bytes(32))
OTHER_DIGEST = b64(bytes([1] * 32))
set_ = msgspec.structs.replace


@dataclass(frozen=True)
class Case:
    """Everything that one decision reads."""

    mission: Mission
    action: Action
    state: AttestedState | None
    now: Now
    standing: Standing | None
    approvals: tuple[VerifiedApproval, ...] = ()
    usable_until_ms: int = worlds.START_MS + 10**9
    facts: SiteFacts = FACTS

    @property
    def grant(self) -> Grant:
        """The grant that the base case matches."""
        return next(g for g in self.mission.actions if g.id == "wanted")


def decide_case(case: Case) -> Decision:
    """Return the gate's decision."""
    mission = case.mission
    issuer = Principal(
        id=mission.issuer,
        role="operator",
        scope=worlds.EVERYWHERE,
        usable_until_ms=case.usable_until_ms,
    )
    verified = index_mission(mission, digest_of(Tag.MISSION, mission), issuer)
    return decide(
        verified,
        case.action,
        state=case.state,
        facts=case.facts,
        now=case.now,
        standing=case.standing,
        approvals=case.approvals,
    )


def oracle_case(case: Case) -> dict[str, Any]:
    """Return the oracle's decision."""
    state = None
    if case.state is not None:
        state = {
            "snapshot": plain(case.state.snapshot),
            "arrived_mono_ms": case.state.arrived_mono_ms,
        }
    return oracle.decide(
        plain(case.mission),
        digest=digest_of(Tag.MISSION, case.mission),
        usable_until_ms=case.usable_until_ms,
        action=plain(case.action),
        state=state,
        facts=plain_facts(case.facts),
        now=plain(case.now),
        standing=None if case.standing is None else plain(case.standing),
        approvals=[plain(item) for item in case.approvals],
    )


# the base


def accepted_case(rnd: Random) -> Case:
    """Return a case that is accepted, whatever the dice say."""
    kind = rnd.choice(["navigate", "navigate", "pick", "place", "record_video", "wait", "approved"])
    at = {"pick": "pharmacy", "place": "station-101"}.get(kind, rnd.choice(["pharmacy", "dock"]))
    grant = _wanted(rnd, kind, at)
    mission = _mission(rnd, grant)
    now = Now(worlds.START_MS + rnd.randrange(0, 600_000), 50_000 + rnd.randrange(0, 9_000))
    action = _action(rnd, grant, mission, now)
    state = _state(rnd, at, kind, now)
    case = Case(mission, action, state, now, _standing(rnd, mission, grant, now))
    return approved(case) if kind == "approved" else case


def approved(case: Case, *, count: int = 2) -> Case:
    """Return the case with an open request and enough approvals that answer it."""
    assert case.standing is not None
    request = ApprovalRequest(
        counter=7,
        scope=digest_of(Tag.SCOPE, scope_of(case.action)),
        situation=_situation(case),
        required=count + 1,
        expires_ms=case.now.utc_ms + 5_000,
    )
    standing = set_(case.standing, requests={case.grant.id: request}, counter=7, prompts=1)
    answers = tuple(_answer(case, request, f"supervisor-{n}") for n in range(count))
    return scoped(replace(case, standing=standing, approvals=answers))


def _places(action: Action) -> set[str]:
    ends = {action.source, action.destination, *action.route}
    return {place for place in ends if place is not None}


def scoped(case: Case) -> Case:
    """Return the case with approvers who are confined, but not out of reach of the action.

    The dice are the case's own, so that what is drawn after it does not depend on this.
    """
    rnd = Random(case.now.utc_ms)
    robots = [None, {worlds.RID}, {worlds.RID, worlds.OTHER}]
    regions = [None, _places(case.action), {*_places(case.action), "plant-room"}]
    return _rescoped(
        case,
        tuple(Scope(robots=_few(rnd, robots), regions=_few(rnd, regions)) for _ in case.approvals),
    )


def everywhere(case: Case) -> Case:
    """Return the case with approvers who are confined to nothing."""
    return _rescoped(case, (worlds.EVERYWHERE,) * len(case.approvals))


def organized(rnd: Random) -> Case:
    """Return a case under an organization's policies too, answered by people and by groups.

    Nothing of it is made to fit: how many are needed, whose roles count, who is a member of which
    group and whether the issuer is among them are all left to the dice.
    """
    case = everywhere(accepted_case(rnd))
    while not case.approvals:
        case = everywhere(accepted_case(rnd))
    policies = tuple(_policy(rnd, case.mission.risk_policy) for _ in range(rnd.randrange(3)))
    case = replace(case, facts=set_(case.facts, risk=policies))
    need = oracle_case(case)["required"]
    assert case.standing is not None
    tier = rnd.choice([1, 2, 3]) if rnd.random() < 0.1 else _tier(case, need)
    guards = (True,) * (len(case.mission.guards) + len(case.grant.guards))
    situation = digest_of(Tag.SITUATION, Situation(guards=guards, tier=tier))
    request = set_(case.standing.requests[case.grant.id], situation=situation, required=need)
    standing = set_(case.standing, requests={case.grant.id: request})
    case = replace(case, standing=standing)
    people = [f"supervisor-{n}" for n in range(6)] + [case.mission.issuer]
    answers = tuple(_someone(case, request, rnd, people) for _ in range(rnd.randrange(6)))
    return replace(case, approvals=answers)


def _policy(rnd: Random, mission: RiskPolicy) -> RiskPolicy:
    tau = sorted(rnd.randrange(0, 60) for _ in range(2))
    roles = tuple(
        sorted(rnd.sample(["operator", "safety_officer", "supervisor"], rnd.randint(1, 3)))
    )
    return set_(
        mission,
        tau_1=tau[0],
        tau_2=tau[1],
        t=rnd.randint(2, 5),
        roles=roles,
        otherwise=rnd.randrange(20),
    )


def _tier(case: Case, need: int) -> int:
    """Return the tier of the policy that wants the most; by the oracle's own arithmetic."""
    facts, mission = plain_facts(case.facts), plain(case.mission)
    state = None
    if case.state is not None:
        snapshot = plain(case.state.snapshot)
        state = {"snapshot": snapshot, "arrived_mono_ms": case.state.arrived_mono_ms}
    tiers = []
    for policy in policies_of(mission, facts):
        tier = tier_of(policy, rho(policy, plain(case.action), state, facts, plain(case.now)))
        tiers += [tier] if required_of(policy, tier) == need else []
    return max(tiers)


def _someone(
    case: Case, request: ApprovalRequest, rnd: Random, people: list[str]
) -> VerifiedApproval:
    """Return the answer of one person, or of a group of some."""
    by = _answer(case, request, rnd.choice(people))
    role = rnd.choice(["supervisor", "supervisor", "safety_officer"])
    if rnd.random() < 0.5:
        return set_(by, approver=set_(by.approver, role=role))
    members = frozenset(rnd.sample(people, rnd.randint(2, len(people))))
    threshold = rnd.randint(1, len(members))
    board = set_(by.approver, id="board-1", role=role, threshold=threshold, members=members)
    return set_(by, approver=board)


def beyond_reach(case: Case, rnd: Random) -> Case:
    """Return the case with one approver who has no say about the robot or about one place."""
    places = sorted(_places(case.action))
    without = {*places, "plant-room"} - {rnd.choice(places)}
    lost = rnd.choice(
        [
            Scope(robots=frozenset(), regions=None),
            Scope(robots=frozenset({worlds.OTHER}), regions=frozenset(places)),
            Scope(robots=None, regions=frozenset()),
            Scope(robots=frozenset({worlds.RID}), regions=frozenset(without)),
        ]
    )
    held = [item.approver.scope for item in case.approvals]
    held[rnd.randrange(len(held))] = lost
    return _rescoped(case, tuple(held))


def _few(rnd: Random, choices: list[Any]) -> Any:
    chosen = rnd.choice(choices)
    return None if chosen is None else frozenset(chosen)


def _rescoped(case: Case, scopes: tuple[Scope, ...]) -> Case:
    answers = tuple(
        set_(item, approver=set_(item.approver, scope=scope))
        for item, scope in zip(case.approvals, scopes, strict=True)
    )
    return replace(case, approvals=answers)


def _situation(case: Case) -> str:
    need = oracle_case(case)
    guards = len(case.mission.guards) + len(case.grant.guards)
    tier = 1 if need["required"] == 1 else (2 if need["required"] == 2 else 3)
    return digest_of(Tag.SITUATION, Situation(guards=(True,) * guards, tier=tier))


def _answer(case: Case, request: ApprovalRequest, by: str, **changes: Any) -> VerifiedApproval:
    fields = {
        "mid": case.mission.mid,
        "version": case.mission.version,
        "mission": digest_of(Tag.MISSION, case.mission),
        "rid": worlds.RID,
        "grant": case.grant.id,
        "scope": request.scope,
        "situation": request.situation,
        "counter": request.counter,
        "expires_ms": request.expires_ms,
        "verdict": Verdict.APPROVE,
    }
    approver = Principal(
        id=by, role="supervisor", scope=worlds.EVERYWHERE, usable_until_ms=worlds.START_MS + 10**9
    )
    return VerifiedApproval(approval=Approval(**{**fields, **changes}), approver=approver)


def _wanted(rnd: Random, kind: str, at: str) -> Grant:
    params: dict[str, int] = {}
    rows: tuple[Row, ...]
    if kind in {"navigate", "approved"}:
        goal = "isolation-room" if kind == "approved" else rnd.choice(["station-101", "office-1"])
        rows = (Row(source=at, destination=goal, regions=_regions(at, goal, "public-corridor")),)
        if rnd.random() < 0.5:
            other = "station-102" if at != "station-102" else "dock"
            more = Row(source=other, destination=goal, regions=_regions(other, goal))
            rows = (more, *rows) if rnd.random() < 0.5 else (*rows, more)
        params = {"speed_mm_s": 800}
        tool, name = "base", "navigate"
    elif kind == "pick":
        rows = (Row(object="package-p1", source=at, regions=(at,)),)
        params, tool, name = {"force_mn": 20_000}, "gripper", "pick"
    elif kind == "place":
        rows = (Row(object="package-p1", source=at, destination=at, regions=(at,)),)
        params, tool, name = {"force_mn": 20_000}, "gripper", "place"
    elif kind == "record_video":
        rows = (Row(source=at, regions=(at,)),)
        params, tool, name = {"duration_ms": 30_000, "max_bytes": 5_000}, "camera", "record_video"
    else:
        rows = (Row(),) if rnd.random() < 0.5 else (Row(regions=(at,)),)
        params, tool, name = {"duration_ms": 5_000}, "base", "wait"
    fields: dict[str, Any] = {
        "id": "wanted",
        "type": name,
        "tool": tool,
        "alternatives": rows,
        "chooser": rnd.choice(["operator", "supervisor", "trusted_sensor", "planner"]),
        "repeat": rnd.randint(2, 5),
        "starts": rnd.randint(5, 9),
        "max_ms": rnd.randint(1_000, 60_000),
        "irreversible": rnd.random() < 0.3,
        "limits": tuple(
            Limit(parameter=p, low=rnd.randint(1, 100), high=high)
            for p, high in sorted(params.items())
        ),
        "guards": _guards(rnd, "holding" if kind == "place" else "speed_mm_s"),
        "after": ("before",) if rnd.random() < 0.5 else (),
        "until": ("end",) if rnd.random() < 0.5 else (),
    }
    fields["data"] = {}
    if name == "record_video":
        fields["data"] = {"record": True, "store": True}
    return msgspec.convert(plain(fields), Grant)


def _regions(*regions: str) -> tuple[str, ...]:
    return tuple(sorted(set(regions)))


def _guards(rnd: Random, variable: str) -> tuple[Guard, ...]:
    if rnd.random() < 0.3:
        return ()
    value: Any = "package-p1" if variable == "holding" else 2_000
    comparison = "eq" if variable == "holding" else rnd.choice(["le", "lt", "ne"])
    guard = Guard(variable=variable, comparison=comparison, value=value, max_age_ms=3_000)
    return (msgspec.convert(plain(guard), Guard),)


def _filler(rnd: Random, name: str, kind: str) -> Grant:
    return Grant(
        id=name,
        type=kind,
        tool={"navigate": "base", "scan_obstacles": "lidar", "announce": "speaker"}[kind],
        alternatives=(
            Row(source="office-2", destination="plant-room", regions=("office-2", "plant-room")),
        )
        if kind == "navigate"
        else (Row(),),
        chooser="operator",
        repeat=rnd.randint(1, 3),
        starts=rnd.randint(3, 5),
        max_ms=1_000,
        irreversible=False,
        data=DataRights(),
        limits=(Limit(parameter="other_mm", low=1, high=100),) if kind == "navigate" else (),
    )


def _mission(rnd: Random, wanted: Grant) -> Mission:
    names = [("before", "scan_obstacles"), ("end", "announce"), ("other", "navigate")]
    grants = [wanted, *(_filler(rnd, name, kind) for name, kind in names)]
    rnd.shuffle(grants)
    base = BASE
    objects = {row.object for row in wanted.alternatives} - {None} | {"package-p2"}
    regions = {region for row in wanted.alternatives for region in row.regions} | {"office-2"}
    budgets = Budgets(
        actions=rnd.randint(20, 40),
        rate=Rate(count=rnd.randint(4, 9), per_ms=rnd.randint(1_000, 9_000)),
        motion_ms=10**6,
        wait_ms=10**6,
        recorded_bytes=10**6,
        prompts=5,
        planner_stops=3,
    )
    return set_(
        base,
        actions=tuple(grants),
        objects=tuple(sorted(objects)),
        regions=tuple(sorted(regions)),
        limits=(Limit(parameter="speed_mm_s", low=1, high=900),),
        guards=base.guards if rnd.random() < 0.7 else (),
        budgets=budgets,
        closing=None,
        risk_policy=set_(
            base.risk_policy,
            privacy=5,
            types={**base.risk_policy.types, "record_video": 2},
            region_tags={**base.risk_policy.region_tags, "private": 10, "restricted": 60},
        ),
        expiry=to_timestamp(worlds.START_MS + 1_200_000),
    )


def _action(rnd: Random, grant: Grant, mission: Mission, now: Now) -> Action:
    row = next((r for r in grant.alternatives if r.source != "station-102"), grant.alternatives[0])
    params = {limit.parameter: rnd.randint(limit.low, limit.high) for limit in grant.limits}
    for limit in grant.limits:
        if rnd.random() < 0.2:
            params[limit.parameter] = rnd.choice([limit.low, limit.high])
    meta = ActionMeta(
        planner="planner",
        timestamp=to_timestamp(now.utc_ms),
        evidence=DIGEST,
        mission=mission.mid,
        mission_version=mission.version,
    )
    route = tuple(rnd.sample(row.regions, rnd.randint(0, 1))) if grant.type == "navigate" else ()
    return Action(
        type=grant.type,
        tool=grant.tool,
        object=row.object,
        source=row.source,
        destination=row.destination,
        route=route,
        params=params,
        meta=meta if rnd.random() < 0.8 else None,
    )


def _state(rnd: Random, at: str, kind: str, now: Now) -> AttestedState:
    snapshot = worlds.state(at, "package-p1" if kind == "place" else None).snapshot
    age = rnd.randint(0, 400)
    pose = snapshot.pose
    assert pose is not None
    pose = set_(
        pose,
        x_mm=pose.x_mm + rnd.randint(-500, 500),
        y_mm=pose.y_mm + rnd.randint(-500, 500),
        margin_mm=rnd.randint(0, 300),
        age_ms=rnd.randint(0, 300),
    )
    readings = {n: set_(r, age_ms=rnd.randint(0, 300)) for n, r in snapshot.readings.items()}
    snapshot = set_(snapshot, pose=pose, readings=readings, seq=rnd.randint(1, 99))
    return worlds.attested(snapshot, arrived_mono_ms=now.mono_ms - age)


def _standing(rnd: Random, mission: Mission, grant: Grant, now: Now) -> Standing:
    per_ms = mission.budgets.rate.per_ms
    uses = {
        "before": Use(starts=2, successes=1, last_success=5),
        "wanted": Use(starts=rnd.randint(1, grant.starts - 1), successes=rnd.randint(0, 1)),
    }
    uses["wanted"] = set_(uses["wanted"], last_success=rnd.randint(0, 4))
    recent = rnd.randint(0, mission.budgets.rate.count - 1)
    old = tuple(now.mono_ms - per_ms - rnd.randint(0, 99) for _ in range(rnd.randint(0, 2)))
    new = tuple(now.mono_ms - rnd.randint(0, per_ms - 1) for _ in range(recent))
    verified = worlds.verified(mission)
    return set_(
        issue(verified),
        status=Status.ACTIVE,
        uses=uses,
        order=5,
        actions=rnd.randint(0, 19),
        spent=Spend(motion_ms=rnd.randint(0, 9_000), recorded_bytes=rnd.randint(0, 9_000)),
        releases=(*old, *new),
    )


# the changes


def _with_grant(case: Case, **changes: Any) -> Case:
    actions = tuple(
        set_(grant, **changes) if grant.id == "wanted" else grant for grant in case.mission.actions
    )
    return _with_mission(case, actions=actions)


def _with_mission(case: Case, **changes: Any) -> Case:
    """Change the mission and re-sign everything that names its digest."""
    mission = set_(case.mission, **changes)
    hashed = digest_of(Tag.MISSION, mission)
    standing = None if case.standing is None else set_(case.standing, digest=hashed)
    answers = tuple(
        set_(item, approval=set_(item.approval, mission=hashed)) for item in case.approvals
    )
    return replace(case, mission=mission, standing=standing, approvals=answers)


def _with_action(case: Case, **changes: Any) -> Case:
    return replace(case, action=set_(case.action, **changes))


def _with_standing(case: Case, **changes: Any) -> Case:
    assert case.standing is not None
    return replace(case, standing=set_(case.standing, **changes))


def _with_snapshot(case: Case, **changes: Any) -> Case:
    assert case.state is not None
    snapshot = set_(case.state.snapshot, **changes)
    return replace(
        case, state=worlds.attested(snapshot, arrived_mono_ms=case.state.arrived_mono_ms)
    )


def _with_reading(case: Case, rnd: Random, **changes: Any) -> Case:
    """Put one guard on a reading and change that reading."""
    guard = msgspec.convert(
        {"variable": "battery_permille", "comparison": "ge", "value": 100, "max_age_ms": 2_000},
        Guard,
    )
    case = _with_mission(_with_grant(case, guards=()), guards=(guard,))
    assert case.state is not None
    readings = dict(case.state.snapshot.readings)
    readings["battery_permille"] = set_(readings["battery_permille"], **changes)
    del rnd
    return _resituated(_with_snapshot(case, readings=readings))


def _resituated(case: Case) -> Case:
    """Renew an open request after a change of guards, so that only the guard speaks."""
    return case


def _plain(rnd: Random, *kinds: str) -> Case:
    """Draw until the base is of one of the kinds."""
    while True:
        case = accepted_case(rnd)
        if case.approvals:
            continue
        if not kinds or case.action.type in kinds:
            return case


def _expired(rnd: Random) -> Case:
    case = _plain(rnd)
    late = worlds.START_MS + 1_200_000 + rnd.randint(1, 5_000)
    return replace(case, now=Now(late, case.now.mono_ms))


def _approval_base(rnd: Random) -> Case:
    while True:
        case = accepted_case(rnd)
        if case.approvals:
            return case


def _two_rows(rnd: Random) -> Case:
    """A grant whose rows differ in their destination, with a chooser who did not choose."""
    case = _plain(rnd, "navigate")
    row = next(r for r in case.grant.alternatives if r.source == case.action.source)
    other = Row(
        source=row.source,
        destination="station-103",
        regions=_regions("station-103", *row.regions),
    )
    regions = tuple(sorted({*case.mission.regions, "station-103"}))
    chooser = rnd.choice(["operator", "supervisor", "trusted_sensor"])
    case = _with_grant(case, alternatives=(row, other), chooser=chooser)
    return _with_mission(case, regions=regions)


def _status(status: Status) -> Callable[[Random], Case]:
    return lambda rnd: _with_standing(_plain(rnd), status=status)


def _closing(rnd: Random) -> Case:
    case = _plain(rnd)
    closing = {"grants": ("other",), "for_ms": 1_000}
    case = _with_mission(case, closing=msgspec.convert(closing, type(BASE.closing)))
    return _with_standing(case, status=Status.CLOSING, closes_ms=case.now.utc_ms + 1_000)


def _pose(case: Case, **changes: Any) -> Case:
    assert case.state is not None
    assert case.state.snapshot.pose is not None
    return _with_snapshot(case, pose=set_(case.state.snapshot.pose, **changes))


def _stay(rnd: Random) -> Case:
    """An action without a source whose row keeps the robot inside its regions."""
    case = _plain(rnd, "wait")
    return _with_grant(case, alternatives=(Row(regions=("dock", "pharmacy")),))


def _elsewhere(case: Case, region: str) -> Case:
    x, y = worlds.site().regions[region].approach
    return _pose(case, x_mm=x, y_mm=y)


#: For every reason that `decide` can give, a case that has it alone.
ALONE: dict[str, Callable[[Random], Case]] = {
    "CERTIFICATE_EXPIRED": lambda rnd: replace(
        _plain(rnd), usable_until_ms=worlds.START_MS - rnd.randint(1, 99)
    ),
    "NOT_YET_VALID": lambda rnd: (
        lambda c: replace(c, now=Now(worlds.START_MS - rnd.randint(1, 9_000), c.now.mono_ms))
    )(_plain(rnd)),
    "EXPIRED": _expired,
    "MISSION_UNKNOWN": lambda rnd: (
        replace(_plain(rnd), standing=None)
        if rnd.random() < 0.5
        else _with_standing(_plain(rnd), mid="another")
    ),
    "MISSION_NOT_ACTIVE": _status(Status.ISSUED),
    "MISSION_SUSPENDED": _status(Status.SUSPENDED),
    "MISSION_COMPLETED": _status(Status.COMPLETED),
    "REVOKED": _status(Status.REVOKED),
    "SUPERSEDED": lambda rnd: (
        _with_standing(_plain(rnd), version=2, digest=OTHER_DIGEST)
        if rnd.random() < 0.5
        else _with_standing(_plain(rnd), status=Status.SUPERSEDED)
    ),
    "ROBOT_MISMATCH": lambda rnd: _with_mission(_plain(rnd), rid="lifter-1"),
    "PROFILE_MISMATCH": lambda rnd: _with_mission(_plain(rnd), profile=OTHER_DIGEST),
    "SITE_MISMATCH": lambda rnd: _with_mission(_plain(rnd), site=OTHER_DIGEST),
    "META_MISMATCH": lambda rnd: _with_action(
        _plain(rnd),
        meta=ActionMeta(planner="p", timestamp=to_timestamp(0), evidence=DIGEST, mission="another")
        if rnd.random() < 0.5
        else ActionMeta(
            planner="p",
            timestamp=to_timestamp(0),
            evidence=DIGEST,
            mission="deliver-p1",
            mission_version=2,
        ),
    ),
    "CAPABILITY_EXCEEDED": lambda rnd: (
        lambda c: replace(
            c,
            facts=set_(
                c.facts,
                robot=set_(
                    c.facts.robot,
                    tools={k: v for k, v in c.facts.robot.tools.items() if k != c.action.type},
                ),
            ),
        )
    )(_plain(rnd)),
    "ACTION_OUT_OF_SCOPE": lambda rnd: _with_grant(_plain(rnd), type="another"),
    "TOOL_OUT_OF_SCOPE": lambda rnd: _with_grant(_plain(rnd), tool="wheels"),
    "OBJECT_OUT_OF_SCOPE": lambda rnd: _with_action(
        _plain(rnd, "pick", "place"), object="package-p2"
    ),
    "SOURCE_OUT_OF_SCOPE": lambda rnd: _elsewhere(
        _with_action(_plain(rnd, "pick"), source="office-2"), "office-2"
    ),
    "SOURCE_NOT_ATTESTED": lambda rnd: _elsewhere(
        _plain(rnd, "pick", "navigate", "record_video"), "station-103"
    ),
    "OUTSIDE_REGIONS": lambda rnd: _elsewhere(_stay(rnd), rnd.choice(["office-1", "station-102"])),
    "DESTINATION_OUT_OF_SCOPE": lambda rnd: _with_action(
        _plain(rnd, "navigate"), destination="office-2"
    ),
    "ROUTE_OUT_OF_SCOPE": lambda rnd: _with_action(_plain(rnd, "navigate"), route=("office-2",)),
    "PARAMETER_MISSING": lambda rnd: _with_action(_plain(rnd), params={}),
    "PARAMETER_NOT_ALLOWED": lambda rnd: (
        lambda c: _with_action(c, params={**c.action.params, "extra_mm": rnd.randint(-9, 9)})
    )(_plain(rnd)),
    "PARAMETER_OUT_OF_BOUNDS": lambda rnd: (
        lambda c: _with_action(
            c,
            params={
                **c.action.params,
                c.grant.limits[0].parameter: rnd.choice(
                    [c.grant.limits[0].low - 1, c.grant.limits[0].high + 1, -1, 10**9]
                ),
            },
        )
    )(_plain(rnd, "pick", "navigate", "wait")),
    "DATA_RIGHT_MISSING": lambda rnd: _with_grant(
        _plain(rnd, "record_video"),
        data=type(BASE.actions[0].data)(record=rnd.random() < 0.5),
    ),
    "ORDER_VIOLATED": lambda rnd: (
        lambda c: _with_standing(
            _with_grant(c, after=("before",)),
            uses={
                **c.standing.uses,
                "before": Use(starts=1, successes=1, last_success=1),
                "wanted": set_(c.standing.uses["wanted"], last_success=rnd.randint(1, 4)),
            },
        )
    )(_plain(rnd)),
    "GRANT_CLOSED": lambda rnd: (
        _closing(rnd)
        if rnd.random() < 0.5
        else (
            lambda c: _with_standing(
                _with_grant(c, until=("end",)),
                uses={**c.standing.uses, "end": Use(starts=1, successes=1, last_success=3)},
            )
        )(_plain(rnd))
    ),
    "REPEAT_EXHAUSTED": lambda rnd: (
        lambda c: (
            _with_standing(
                c,
                uses={
                    **c.standing.uses,
                    "wanted": set_(c.standing.uses["wanted"], successes=c.grant.repeat),
                },
            )
            if rnd.random() < 0.5
            else _with_standing(
                c,
                open=tuple(
                    OpenRelease(ticket=DIGEST, grant="wanted", reserved=Spend())
                    for _ in range(c.grant.repeat)
                ),
            )
        )
    )(_plain(rnd)),
    "STARTS_EXHAUSTED": lambda rnd: (
        lambda c: _with_standing(
            c,
            uses={
                **c.standing.uses,
                "wanted": set_(c.standing.uses["wanted"], starts=c.grant.starts),
            },
        )
    )(_plain(rnd)),
    "RATE_EXCEEDED": lambda rnd: (
        lambda c: _with_standing(
            c, releases=tuple(c.now.mono_ms - n for n in range(c.mission.budgets.rate.count))
        )
    )(_plain(rnd)),
    "BUDGET_EXCEEDED": lambda rnd: (
        lambda c: rnd.choice(
            [
                lambda: _with_standing(c, actions=c.mission.budgets.actions),
                lambda: _with_standing(
                    c, spent=Spend(motion_ms=10**6, wait_ms=10**6, recorded_bytes=10**6)
                ),
            ]
        )()
    )(_plain(rnd, "navigate", "wait", "record_video")),
    "STATE_FOREIGN": lambda rnd: _with_snapshot(_plain(rnd, "pick", "navigate"), robot="lifter-1"),
    "STATE_MISSING": lambda rnd: (
        replace(_plain(rnd, "pick", "navigate"), state=None)
        if rnd.random() < 0.5
        else _with_snapshot(_plain(rnd, "pick", "navigate"), pose=None)
    ),
    "STATE_UNTRUSTED": lambda rnd: (
        _pose(_plain(rnd, "pick", "navigate"), label=rnd.choice(["camera", "model", "operator"]))
        if rnd.random() < 0.5
        else _with_reading(_plain(rnd), rnd, label="camera")
    ),
    "STATE_STALE": lambda rnd: (
        _pose(_plain(rnd, "pick", "navigate"), age_ms=1_001)
        if rnd.random() < 0.5
        else _with_reading(_plain(rnd), rnd, age_ms=2_001)
    ),
    "GUARD_FALSE": lambda rnd: _with_reading(
        _plain(rnd), rnd, value=rnd.choice([99, 0, -5, True, "full"])
    ),
    "PROVENANCE_DENIED": _two_rows,
    "APPROVAL_DENIED": lambda rnd: (
        lambda c: replace(
            c,
            approvals=(
                *c.approvals,
                _answer(c, c.standing.requests["wanted"], "supervisor-9", verdict=Verdict.DENY),
            ),
        )
    )(_approval_base(rnd)),
    "APPROVAL_TIMEOUT": lambda rnd: (
        lambda c: _with_standing(
            c,
            requests={
                "wanted": set_(
                    c.standing.requests["wanted"], expires_ms=c.now.utc_ms - rnd.randint(1, 99)
                )
            },
        )
    )(_approval_base(rnd)),
    "APPROVAL_REQUIRED": lambda rnd: (
        lambda c: rnd.choice(
            [
                lambda: beyond_reach(c, rnd),
                lambda: replace(c, approvals=c.approvals[:1]),
                lambda: replace(c, approvals=()),
                lambda: replace(c, approvals=(c.approvals[0], c.approvals[0])),
                lambda: _with_standing(c, requests={}),
                lambda: replace(
                    c,
                    approvals=tuple(
                        set_(a, approval=set_(a.approval, counter=6)) for a in c.approvals
                    ),
                ),
                lambda: replace(
                    c,
                    approvals=tuple(
                        set_(a, approval=set_(a.approval, scope=OTHER_DIGEST)) for a in c.approvals
                    ),
                ),
                lambda: replace(
                    c,
                    approvals=tuple(
                        set_(a, approver=set_(a.approver, role="operator")) for a in c.approvals
                    ),
                ),
                lambda: replace(
                    c,
                    approvals=tuple(
                        set_(a, approver=set_(a.approver, id="operator-1")) for a in c.approvals
                    ),
                ),
                lambda: replace(
                    c,
                    approvals=tuple(
                        set_(a, approval=set_(a.approval, expires_ms=c.now.utc_ms - 1))
                        for a in c.approvals
                    ),
                ),
            ]
        )()
    )(_approval_base(rnd)),
}


def broken_case(rnd: Random, count: int) -> Case:
    """Return a base with several changes laid over each other, whatever comes of it."""
    case = accepted_case(rnd)
    for _ in range(count):
        other = ALONE[rnd.choice(sorted(ALONE))](rnd)
        part = rnd.choice(["action", "state", "now", "standing", "approvals", "facts", "mission"])
        case = replace(case, **{part: getattr(other, part)})
    return case


def agree_accepts(case: Case) -> tuple[bool, bool]:
    """Return whether the gate and whether the oracle accepts."""
    return str(decide_case(case).verdict) == "accept", oracle_case(case)["verdict"] == "accept"
