# SPDX-License-Identifier: Apache-2.0
"""A capability is used when everything holds, and exactly as far as its policy says."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from authguard_r.core.facts import SiteFacts
from authguard_r.core.identifiers import VariableId
from authguard_r.core.provenance import Label
from authguard_r.core.quantities import Now
from authguard_r.core.state import AttestedState, Reading, attest
from authguard_r.enforcement.emergency.decide import (
    EmergencyScene,
    action_of,
    decide_emergency,
    permit_emergency,
    still_emergency,
)
from authguard_r.enforcement.emergency.opened import OpenedPolicy
from authguard_r.enforcement.emergency.policy import HOUR_MS, MOST_PER_HOUR, Caller, Missing
from authguard_r.sim.robot import snapshot_of
from authguard_r.site.model import facts_of, profile_digest
from fixtures import emergency_policies, scenarios
from fixtures.cases import case

FACTS: SiteFacts = facts_of(
    emergency_policies.site(),
    rid=scenarios.RID,
    profile=profile_digest(emergency_policies.site().robots[scenarios.RID].profile),
)
OPENED: OpenedPolicy = emergency_policies.opened()
TICKET = OPENED.digest


def state(at: str = "station-103", **changes: Any) -> AttestedState:
    world = msgspec.structs.replace(scenarios.world(at), **changes)
    snapshot = snapshot_of(world, robot=scenarios.RID, epoch=1, seq=1)
    return attest(snapshot, FACTS, arrived_mono_ms=scenarios.NOW.mono_ms)


def scene(**changes: Any) -> EmergencyScene:
    return EmergencyScene(**{"state": state(), "facts": FACTS, "now": scenarios.NOW, **changes})


def why(name: str = "go-safe", caller: Caller = Caller.PLANNER, **changes: Any) -> list[str]:
    opened = changes.pop("opened", OPENED)
    return [f.reason for f in decide_emergency(opened, name, caller, scene(**changes)).findings]


def policy_of(**changes: Any) -> OpenedPolicy:
    return emergency_policies.opened(
        emergency_policies.policy({**emergency_policies.GO_SAFE, **changes})
    )


def test_when_everything_holds_it_is_accepted() -> None:
    decision = decide_emergency(OPENED, "go-safe", Caller.PLANNER, scene())
    assert decision.accepted
    with pytest.raises(TypeError):
        bool(decision)


def test_one_thing_that_does_not_hold_refuses_it() -> None:
    for changes, reason in [
        ({"name": "fly"}, "ACTION_OUT_OF_SCOPE"),
        ({"caller": Caller.GATE}, "ROLE_DENIED"),
        ({"state": None}, "STATE_MISSING"),
        ({"state": state(battery_permille=1_001)}, "GUARD_FALSE"),
        ({"state": state("office-1")}, "OUTSIDE_REGIONS"),
        ({"uses": (1, 2, 3)}, "RATE_EXCEEDED"),
        ({"tries": tuple(range(MOST_PER_HOUR))}, "RATE_EXCEEDED"),
        ({"uses": (1,), "tries": tuple(range(MOST_PER_HOUR - 1))}, "RATE_EXCEEDED"),
        ({"stands": True, "state": state(speed_mm_s=301)}, "BOUND_EXCEEDED"),
        ({"stopped": True}, "STOPPED"),
        ({"now": Now(OPENED.expiry_ms + 1, scenarios.NOW.mono_ms)}, "EXPIRED"),
        ({"now": Now(OPENED.not_before_ms - 1, scenarios.NOW.mono_ms)}, "NOT_YET_VALID"),
    ]:
        with case(changes, reason):
            assert reason in why(**changes)
            assert why() == []


@pytest.mark.parametrize(
    ("facts", "reason"),
    [
        (
            {"robot": msgspec.structs.replace(FACTS.robot, rid=scenarios.OTHER)},
            "ROBOT_MISMATCH",
        ),
        ({"robot": msgspec.structs.replace(FACTS.robot, profile=TICKET)}, "PROFILE_MISMATCH"),
        ({"digest": TICKET}, "SITE_MISMATCH"),
        ({"robot": msgspec.structs.replace(FACTS.robot, tools={})}, "CAPABILITY_EXCEEDED"),
    ],
)
def test_another_robot_profile_or_site_refuses_it(facts: dict[str, Any], reason: str) -> None:
    assert reason in why(facts=msgspec.structs.replace(FACTS, **facts))


def test_it_works_without_exactly_what_it_says() -> None:
    codes = {
        Missing.CLOCK: "CLOCK_BEHIND",
        Missing.MISSION: "NO_ACTIVE_MISSION",
        Missing.STORE: "STORE_UNAVAILABLE",
    }
    for without in ((), (Missing.CLOCK,), (Missing.MISSION, Missing.STORE), tuple(Missing)):
        opened = policy_of(without=sorted(str(part) for part in without))
        for part, code in codes.items():
            expected = [] if part in without else [code]
            assert why(opened=opened, lacks=frozenset({part})) == expected


def test_after_a_stop_only_what_says_so() -> None:
    assert why(opened=policy_of(after_stop=True), stopped=True) == []


def test_uses_are_counted_for_an_hour() -> None:
    mono = HOUR_MS + 10
    uses = (9, 10, 11, mono)
    fresh = attest(state().snapshot, FACTS, arrived_mono_ms=mono)
    now = Now(scenarios.NOW.utc_ms, mono)
    assert why(uses=uses, now=now, state=fresh) == []  # two of them are an hour old
    assert why(uses=(*uses, mono), now=now, state=fresh) == ["RATE_EXCEEDED"]


@given(
    age_ms=st.integers(0, 3_000),
    reading_age_ms=st.integers(0, 3_000),
    label=st.sampled_from(list(Label)),
    value=st.one_of(st.integers(-5, 2_000), st.booleans(), st.just("full")),
    present=st.booleans(),
    robot=st.sampled_from([scenarios.RID, scenarios.OTHER]),
)
def test_nothing_is_accepted_whose_guards_are_not_attested_fresh(
    age_ms: int, reading_age_ms: int, label: Label, value: Any, present: bool, robot: str
) -> None:
    snapshot = snapshot_of(scenarios.world("station-103"), robot=robot, epoch=1, seq=1)
    battery = VariableId("battery_permille")
    readings = {k: v for k, v in snapshot.readings.items() if k != battery}
    if present:
        readings[battery] = Reading(value=value, label=label, age_ms=reading_age_ms)
    attested = attest(
        msgspec.structs.replace(snapshot, readings=readings),
        FACTS,
        arrived_mono_ms=scenarios.NOW.mono_ms - age_ms,
    )
    accepted = decide_emergency(OPENED, "go-safe", Caller.PLANNER, scene(state=attested)).accepted
    holds = (
        present
        and robot == scenarios.RID
        and label is Label.TRUSTED_SENSOR
        and age_ms + reading_age_ms <= 500
        and type(value) is int
        and value <= 1_000
    )
    assert accepted is holds


@given(
    lacks=st.frozensets(st.sampled_from(list(Missing))),
    stopped=st.booleans(),
    uses=st.lists(st.integers(0, scenarios.NOW.mono_ms), max_size=4).map(tuple),
    caller=st.sampled_from(list(Caller)),
)
def test_taking_something_away_never_lets_more_through(
    lacks: frozenset[Missing], stopped: bool, uses: tuple[int, ...], caller: Caller
) -> None:
    opened = policy_of(without=["mission"])
    less = decide_emergency(
        opened, "go-safe", caller, scene(lacks=lacks, stopped=stopped, uses=uses)
    )
    more = decide_emergency(opened, "go-safe", caller, scene())
    assert more.accepted or not less.accepted


def test_the_action_is_the_capabilitys_own() -> None:
    capability = OPENED.policy.capabilities[0]
    action = action_of(capability, state(), FACTS)
    assert (action.type, action.destination, action.source) == ("navigate", "dock", "station-103")
    assert action.params == {"speed_mm_s": 300}
    assert action_of(capability, None, FACTS).source is None


def test_while_it_runs_the_same_is_asked_again() -> None:
    capability = OPENED.policy.capabilities[0]
    lease = permit_emergency(OPENED, capability, facts=FACTS, now=scenarios.NOW, ticket=TICKET)

    def found(
        seen: AttestedState | None = None,
        now: Now = scenarios.NOW,
        lacks: frozenset[Missing] = frozenset(),
    ) -> list[str]:
        at = state() if seen is None else seen
        findings = still_emergency(capability, lease, at, facts=FACTS, now=now, lacks=lacks)
        return [finding.reason for finding in findings]

    assert found() == []
    assert found(state(speed_mm_s=301)) == ["BOUND_EXCEEDED"]
    assert found(state(battery_permille=1_001)) == ["GUARD_FALSE"]
    assert found(state("office-1")) == ["OUTSIDE_REGIONS"]
    late = Now(OPENED.expiry_ms + 1, scenarios.NOW.mono_ms + 120_001)
    assert {"EXPIRED", "LEASE_ENDED", "STATE_STALE"} <= set(found(now=late))
    needy = policy_of(without=[]).policy.capabilities[0]
    findings = still_emergency(
        needy, lease, state(), facts=FACTS, now=scenarios.NOW, lacks=frozenset({Missing.CLOCK})
    )
    assert [finding.reason for finding in findings] == ["CLOCK_BEHIND"]
