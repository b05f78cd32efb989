# SPDX-License-Identifier: Apache-2.0
"""Single checks of the decision, one condition at a time, each with its near miss."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from authguard_r.core.action import Action, ActionMeta
from authguard_r.core.checks import Case
from authguard_r.core.checks.grant import check_data_rights, check_type
from authguard_r.core.checks.mission import check_capability, check_ceilings, check_meta
from authguard_r.core.facts import RegionFacts, SiteFacts
from authguard_r.core.finding import Findings
from authguard_r.core.geometry import polygon
from authguard_r.core.mission import DataRights, Mission
from authguard_r.core.state import place_of
from authguard_r.core.token import IndexedGrant
from fixtures import scenarios

replace = msgspec.structs.replace
DRIVE = scenarios.navigate("dock", "pharmacy")


def case(
    action: Action = DRIVE, mission: Mission | None = None, facts: SiteFacts | None = None
) -> Case:
    verified, known = scenarios.verified(mission), facts or scenarios.facts()
    return Case(
        verified=verified,
        action=action,
        kind=known.vocabulary.get(action.type),
        state=scenarios.state(),
        facts=known,
        now=scenarios.NOW,
        standing=scenarios.active(verified),
        approvals=(),
    )


def grant_of(one: Case, name: str) -> IndexedGrant:
    return next(indexed for indexed in one.verified.grants if indexed.grant.id == name)


def told(findings: Findings) -> list[tuple[str, str]]:
    return [(str(finding.reason), finding.field) for finding in findings]


@pytest.mark.parametrize(("version", "reasons"), [(1, True), (2, False), (3, True)])
def test_a_proposal_counts_for_the_version_that_it_was_taken_in_under(
    version: int, *, reasons: bool
) -> None:
    mission = replace(scenarios.mission(), version=2)
    meta = ActionMeta(
        planner="planner",
        timestamp="2026-01-01T00:00:00Z",
        evidence=scenarios.TICKET,
        mission=mission.mid,
        mission_version=version,
    )
    found = told(check_meta(case(replace(DRIVE, meta=meta), mission)))
    assert found == ([("META_MISMATCH", "meta.mission")] if reasons else [])


@pytest.mark.parametrize("writes", [True, False])
def test_a_type_that_writes_what_the_robot_believes_exceeds_every_capability(
    *, writes: bool
) -> None:
    facts = scenarios.facts()
    kind = replace(facts.vocabulary["navigate"], state_writing=writes)
    changed = replace(facts, vocabulary={**facts.vocabulary, "navigate": kind})
    found = told(check_capability(case(facts=changed)))
    assert found == ([("CAPABILITY_EXCEEDED", "type")] if writes else [])


def test_each_region_of_a_route_lies_under_the_ceiling() -> None:
    route = ("public-corridor", "plant-room", "pharmacy")
    found = told(check_ceilings(case(replace(DRIVE, route=route))))
    assert found == [("ROUTE_OUT_OF_SCOPE", "route[1]")]


@pytest.mark.parametrize("kind", ["navigate_fast", "navigat", "n", "navigate.fast"])
def test_a_grant_is_for_its_type_and_no_prefix_or_extension(kind: str) -> None:
    one = case(replace(DRIVE, type=kind))
    assert told(check_type(one, grant_of(one, "go-to-pharmacy"))) == [
        ("ACTION_OUT_OF_SCOPE", "type")
    ]
    drives = case()
    assert check_type(drives, grant_of(drives, "go-to-pharmacy")) == ()


@pytest.mark.parametrize(
    ("right", "effect"), [("record", "records"), ("store", "stores"), ("transmit", "transmits")]
)
def test_recording_storing_and_transmitting_need_a_right_each(right: str, effect: str) -> None:
    facts = scenarios.facts()
    none: dict[str, Any] = {"records": False, "stores": False, "transmits": False}
    kind = replace(facts.vocabulary["navigate"], **{**none, effect: True})
    one = case(facts=replace(facts, vocabulary={**facts.vocabulary, "navigate": kind}))
    indexed = grant_of(one, "go-to-pharmacy")

    def found(**rights: bool) -> list[tuple[str, str]]:
        every = {"record": False, "store": False, "transmit": False, **rights}
        grant = replace(indexed.grant, data=DataRights(**every))
        return told(check_data_rights(one, IndexedGrant(grant, indexed.limits, indexed.rows)))

    others = {name: True for name in ("record", "store", "transmit") if name != right}
    assert found(**others) == [("DATA_RIGHT_MISSING", f"data.{right}")]
    assert found(**{right: True}) == []


def placed(regions: dict[str, RegionFacts], **changes: int) -> set[str]:
    snapshot = scenarios.state().snapshot
    assert snapshot.pose is not None
    pose = replace(snapshot.pose, x_mm=50, y_mm=50, margin_mm=5, **changes)
    facts = replace(scenarios.facts(), regions=regions)
    return set(place_of(replace(snapshot, pose=pose), facts))


def square(low: int, high: int, *around: str) -> RegionFacts:
    pose = scenarios.state().snapshot.pose
    assert pose is not None
    corners = ((low, low), (high, low), (high, high), (low, high))
    return RegionFacts(polygon(pose.map, pose.floor, corners), frozenset(), frozenset(around))


def test_the_same_coordinates_on_another_floor_are_another_place() -> None:
    pose = scenarios.state().snapshot.pose
    assert pose is not None
    regions = {"hall": square(0, 100)}
    assert placed(regions, floor=pose.floor) == {"hall"}
    assert placed(regions, floor=pose.floor + 1) == set()


def test_inside_a_region_within_another_one_only_the_inner_counts() -> None:
    assert placed({"hall": square(0, 100), "vault": square(40, 60, "hall")}) == {"vault"}
    # at the edge of the inner one, nobody can say that the robot is not beside it
    assert placed({"hall": square(0, 100), "vault": square(48, 60, "hall")}) == {"hall", "vault"}
