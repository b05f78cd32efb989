# SPDX-License-Identifier: Apache-2.0
"""Labels are worked out from the mission and the channels, never read from a proposal."""

from __future__ import annotations

import msgspec
import pytest

from authguard_r.core.action import Action
from authguard_r.core.mission import Row
from authguard_r.core.provenance import Chooser, Label
from authguard_r.core.standing import Standing
from authguard_r.core.token import VerifiedMission
from authguard_r.provenance.labels import label_fields
from fixtures import scenarios
from fixtures.cases import case

replace = msgspec.structs.replace
PLACE = Action(
    type="place",
    tool="gripper",
    object="package-p1",
    source="station-101",
    destination="station-101",
    route=("public-corridor",),
)
PICK = Action(type="pick", tool="gripper", object="package-p1", source="pharmacy")


def picking(*objects: str) -> VerifiedMission:
    """Return the story's mission with one row to pick each of these up."""
    mission = scenarios.mission()
    rows = tuple(Row(object=item, source="pharmacy", regions=("pharmacy",)) for item in objects)
    actions = list(mission.actions)
    actions[1] = replace(actions[1], alternatives=rows)
    return scenarios.verified(replace(mission, actions=tuple(actions)))


def selecting(verified: VerifiedMission, row: int) -> Standing:
    return replace(scenarios.active(verified), selected={"pick-p1": row})


def test_without_a_mission_every_field_has_the_label_of_what_could_be_seen() -> None:
    for base in Label:
        with case(base):
            assert label_fields(PLACE, None, None, base=base) == {
                "type": base,
                "tool": base,
                "object": base,
                "source": base,
                "destination": base,
                "route": base,
            }


def test_a_field_that_an_action_does_not_have_has_no_label() -> None:
    bare = Action(type="scan_obstacles", tool="lidar")
    labels = label_fields(bare, scenarios.verified(), None, base=Label.CAMERA)
    assert labels == {"type": Label.CAMERA, "tool": Label.CAMERA}


def test_the_only_value_that_the_mission_leaves_is_the_operator_s() -> None:
    """Whoever repeats it, the operator chose it; way and source are never a choice of theirs."""
    assert label_fields(PLACE, scenarios.verified(), None, base=Label.CAMERA) == {
        "type": Label.CAMERA,
        "tool": Label.CAMERA,
        "object": Label.OPERATOR,
        "source": Label.CAMERA,
        "destination": Label.OPERATOR,
        "route": Label.CAMERA,
    }


@pytest.mark.parametrize(
    ("field", "value"), [("object", "package-p2"), ("destination", "station-103")]
)
def test_another_value_than_the_only_one_is_not(field: str, value: str) -> None:
    action = replace(PLACE, **{field: value})
    assert (
        label_fields(action, scenarios.verified(), None, base=Label.CAMERA)[field] is Label.CAMERA
    )


def test_a_value_among_several_is_nobody_s_choice() -> None:
    verified = picking("package-p1", "package-p2")
    assert label_fields(PICK, verified, None, base=Label.AUDIO)["object"] is Label.AUDIO
    alone = picking("package-p1")
    assert label_fields(PICK, alone, None, base=Label.AUDIO)["object"] is Label.OPERATOR


def test_a_selection_makes_its_value_the_operator_s_and_the_other_one_still_nobody_s() -> None:
    verified = picking("package-p1", "package-p2")
    second = replace(PICK, object="package-p2")
    for row, chosen, other in ((0, PICK, second), (1, second, PICK)):
        standing = selecting(verified, row)
        labels = label_fields(chosen, verified, standing, base=Label.MEMORY)
        assert labels["object"] is Label.OPERATOR
        labels = label_fields(other, verified, standing, base=Label.MEMORY)
        assert labels["object"] is Label.MEMORY


@pytest.mark.parametrize("row", [2, -1, 99])
def test_a_selection_of_a_row_that_is_not_there_chooses_nothing(row: int) -> None:
    verified = picking("package-p1", "package-p2")
    labels = label_fields(PICK, verified, selecting(verified, row), base=Label.MEMORY)
    assert labels["object"] is Label.MEMORY


def test_an_action_type_that_the_mission_does_not_grant_leaves_no_value() -> None:
    action = replace(PICK, type="record_video")
    labels = label_fields(action, scenarios.verified(), None, base=Label.RETRIEVAL)
    assert set(labels.values()) == {Label.RETRIEVAL}


def test_a_label_that_a_proposal_brings_along_is_not_read() -> None:
    """The attack: `provenance: {object: operator}` in the planner's own output (L4)."""
    for action in (PICK, replace(PLACE, object="package-p2", destination="station-103")):
        forged = replace(
            action, provenance=dict.fromkeys(("object", "destination"), Label.OPERATOR)
        )
        for verified in (None, scenarios.verified()):
            assert label_fields(forged, verified, None, base=Label.CAMERA) == label_fields(
                action, verified, None, base=Label.CAMERA
            )


def going(chooser: str, *rows: Row) -> VerifiedMission:
    """Return the story's mission with these rows to drive to the pharmacy and no other drive."""
    mission = scenarios.mission()
    grant = replace(mission.actions[0], alternatives=rows, chooser=Chooser(chooser))
    others = tuple(g for g in mission.actions if g.type != "navigate")
    closing = None
    return scenarios.verified(replace(mission, actions=(grant, *others), closing=closing))


def row(source: str, destination: str) -> Row:
    return Row(source=source, destination=destination, regions=(source, destination))


@pytest.mark.parametrize(
    ("chooser", "label"), [("operator", Label.OPERATOR), ("supervisor", Label.SUPERVISOR)]
)
def test_what_a_selection_settles_is_its_chooser_s(chooser: str, label: Label) -> None:
    verified = going(chooser, row("dock", "pharmacy"), row("dock", "station-103"))
    standing = replace(scenarios.active(verified), selected={"go-to-pharmacy": 1})
    action = scenarios.navigate("dock", "station-103")
    labels = label_fields(action, verified, standing, base=Label.CAMERA)
    assert labels["destination"] is label
    labels = label_fields(action, verified, scenarios.active(verified), base=Label.CAMERA)
    assert labels["destination"] is Label.CAMERA


def test_what_only_the_place_of_the_robot_settles_is_the_sensor_s() -> None:
    verified = going("trusted_sensor", row("dock", "pharmacy"), row("pharmacy", "dock"))
    labels = label_fields(scenarios.navigate("dock", "pharmacy"), verified, None, base=Label.CAMERA)
    assert labels["destination"] is Label.TRUSTED_SENSOR
    labels = label_fields(scenarios.navigate("dock", "dock"), verified, None, base=Label.CAMERA)
    assert labels["destination"] is Label.CAMERA


def test_of_two_grants_that_leave_one_value_the_less_trusted_word_counts() -> None:
    signed = going("operator", row("dock", "pharmacy"))
    sensed = going("trusted_sensor", row("dock", "pharmacy"), row("pharmacy", "dock"))
    both = (replace(sensed.mission.actions[0], id="other"), *signed.mission.actions)
    verified = scenarios.verified(replace(signed.mission, actions=both))
    labels = label_fields(scenarios.navigate("dock", "pharmacy"), verified, None, base=Label.CAMERA)
    assert labels["destination"] is Label.TRUSTED_SENSOR


def test_a_planner_that_chooses_among_grants_chooses_no_value() -> None:
    """The story has three drives to three places; each place is the operator's own word."""
    for source, goal in (
        ("dock", "pharmacy"),
        ("pharmacy", "station-101"),
        ("station-101", "dock"),
    ):
        labels = label_fields(
            scenarios.navigate(source, goal), scenarios.verified(), None, base=Label.CAMERA
        )
        assert labels["destination"] is Label.OPERATOR
    for goal in ("station-103", "office-1"):
        labels = label_fields(
            scenarios.navigate("dock", goal), scenarios.verified(), None, base=Label.CAMERA
        )
        assert labels["destination"] is Label.CAMERA


def test_a_value_that_another_grant_leaves_open_is_nobody_s_choice() -> None:
    signed = going("operator", row("dock", "pharmacy"))
    wide = going("operator", row("dock", "pharmacy"), row("dock", "station-103"))
    both = (*signed.mission.actions, replace(wide.mission.actions[0], id="other"))
    verified = scenarios.verified(replace(signed.mission, actions=both))
    labels = label_fields(scenarios.navigate("dock", "pharmacy"), verified, None, base=Label.CAMERA)
    assert labels["destination"] is Label.CAMERA
