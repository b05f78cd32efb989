# SPDX-License-Identifier: Apache-2.0
"""A pose that may lie in two regions passes only where both are allowed.

Nobody can say that the robot is not in the other one. The law holds for the check itself, for a
decision with a source, for a decision without one, and for the lease while the robot moves.
"""

from __future__ import annotations

from functools import cache
from itertools import combinations

import msgspec
import pytest

from authguard_r.core.action import Action
from authguard_r.core.checks.place import place_findings
from authguard_r.core.decide import decide
from authguard_r.core.identifiers import RegionId
from authguard_r.core.lease import permit, still
from authguard_r.core.mission import Row
from authguard_r.core.reasons import Reason
from authguard_r.core.state import AttestedState
from authguard_r.core.token import VerifiedMission
from fixtures import scenarios

replace = msgspec.structs.replace
#: Poses, and every region that each may lie in: a wall is at x = 34,000, another at y = 3,000.
POSES: dict[tuple[int, int, int], set[str]] = {
    (36_000, 1_500, 150): {"dock"},
    (34_151, 1_500, 150): {"dock"},
    (34_150, 1_500, 150): {"dock", "public-corridor"},
    (34_000, 1_500, 0): {"dock", "public-corridor"},
    (33_900, 1_500, 150): {"dock", "public-corridor"},
    (13_000, 2_950, 100): {"public-corridor", "station-101"},
    (8_100, 2_950, 150): {"public-corridor", "pharmacy"},
    (9_000, 3_100, 1_050): {"public-corridor", "pharmacy", "station-101"},
    (38_100, 1_500, 150): {"dock"},
    (38_100, 1_500, 99): set(),
}
REGIONS = ("dock", "pharmacy", "public-corridor", "station-101")
ALLOWED = [frozenset(some) for n in range(1, 5) for some in combinations(REGIONS, n)]
posed = pytest.mark.parametrize("pose", POSES, ids=str)


def state_at(pose: tuple[int, int, int]) -> AttestedState:
    x_mm, y_mm, margin_mm = pose
    snapshot = scenarios.state().snapshot
    assert snapshot.pose is not None
    moved = replace(snapshot.pose, x_mm=x_mm, y_mm=y_mm, margin_mm=margin_mm)
    return scenarios.attested(replace(snapshot, pose=moved))


@cache
def story() -> VerifiedMission:
    return scenarios.verified()


@cache
def looking(allowed: frozenset[str]) -> VerifiedMission:
    """Return the story's mission with one grant: to look around while inside these regions."""
    mission = story().mission
    grants = tuple(
        replace(grant, alternatives=(Row(regions=tuple(sorted(allowed))),))
        for grant in mission.actions
        if grant.id == "look-out"
    )
    return scenarios.verified(replace(mission, actions=grants))


def decided(verified: VerifiedMission, action: Action, state: AttestedState) -> list[str]:
    return [
        str(reason)
        for reason in decide(
            verified,
            action,
            state=state,
            facts=scenarios.facts(),
            now=scenarios.NOW,
            standing=scenarios.active(verified),
        ).reasons
    ]


LOOK = Action(type="scan_obstacles", tool="lidar")


@posed
def test_the_check_passes_exactly_where_every_possible_region_is_allowed(
    pose: tuple[int, int, int],
) -> None:
    state, place = state_at(pose), POSES[pose]
    assert state.place == place
    for allowed in ALLOWED:
        found = place_findings(
            state,
            tuple(RegionId(region) for region in sorted(allowed)),
            reason=Reason.OUTSIDE_REGIONS,
            rid=scenarios.RID,
            now=scenarios.NOW,
            max_age_ms=1_000,
        )
        assert (not found) == (place != set() and place <= allowed), allowed
        assert {str(finding.reason) for finding in found} <= {"OUTSIDE_REGIONS"}


@posed
def test_an_action_that_stays_in_regions_is_accepted_only_inside_them(
    pose: tuple[int, int, int],
) -> None:
    place = POSES[pose]
    for allowed in ALLOWED:
        expected = [] if place != set() and place <= allowed else ["OUTSIDE_REGIONS"]
        assert decided(looking(allowed), LOOK, state_at(pose)) == expected, allowed


@posed
def test_a_source_is_attested_only_by_a_pose_that_lies_in_no_other_region(
    pose: tuple[int, int, int],
) -> None:
    """The row's regions hold the neighbor too, and that does not help."""
    action = scenarios.navigate("dock", "pharmacy")
    expected = [] if POSES[pose] == {"dock"} else ["SOURCE_NOT_ATTESTED"]
    assert decided(story(), action, state_at(pose)) == expected


@posed
def test_the_lease_of_a_moving_robot_ends_where_one_possible_region_is_not_allowed(
    pose: tuple[int, int, int],
) -> None:
    place = POSES[pose]
    for allowed in ALLOWED:
        verified = looking(allowed)
        grant = verified.mission.actions[0]
        lease = permit(
            verified,
            LOOK,
            grant=grant,
            row=grant.alternatives[0],
            facts=scenarios.facts(),
            now=scenarios.NOW,
            ticket=scenarios.TICKET,
        )
        found = still(
            lease,
            state_at(pose),
            facts=scenarios.facts(),
            now=scenarios.NOW,
            standing=scenarios.active(verified),
        )
        expected = [] if place != set() and place <= allowed else ["OUTSIDE_REGIONS"]
        assert [str(finding.reason) for finding in found] == expected, allowed
