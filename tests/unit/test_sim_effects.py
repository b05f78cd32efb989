# SPDX-License-Identifier: Apache-2.0
"""The standard words in the symbolic world: each does what its name says, or is bottom."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from authguard_r.core.action import Action
from authguard_r.core.identifiers import ActionType
from authguard_r.sim.state import WorldState
from authguard_r.sim.world import FULL_TURN_URAD, delta, duration_ms, plan_path
from authguard_r.site.words import standard_words
from fixtures import scenarios
from fixtures.cases import case

SITE = scenarios.site()
WORDS = standard_words()


def does(kind: str, **fields: Any) -> Action:
    return Action(type=ActionType(kind), tool="x", **fields)


def after(state: WorldState, *actions: Action) -> WorldState:
    for action in actions:
        done = delta(SITE, state, action)
        assert done is not None, action
        state = done
    return state


def at_hand(**changes: Any) -> WorldState:
    """Return a world with the robot in the pharmacy and both packages there."""
    return msgspec.structs.replace(scenarios.world("pharmacy"), **changes)


def sample(kind: str) -> Action:
    """Return an action of a standard type with everything that it has."""
    model = WORDS[ActionType(kind)]
    values: dict[str, Any] = {"object": "package-p1", "source": "pharmacy"}
    values["destination"] = "pharmacy" if kind == "place" else "station-101"
    fields = {name: values[name] for name in model.fields if name in values}
    params = {name: max(p.low, 1) for name, p in model.params.items()}
    return does(kind, **fields, params=params)


def test_every_word_that_can_be_granted_can_be_carried_out_somewhere() -> None:
    for kind in [k for k, m in WORDS.items() if not m.state_writing]:
        with case(kind):
            holding = kind in {"place", "drop", "throw", "pour", "put_in"}
            item = "package-p2" if kind == "put_in" else "package-p1"
            state = scenarios.world("pharmacy", item if holding else None)
            state = msgspec.structs.replace(state, things={"package-p1": ("filled-1",)})
            action = sample(kind)
            assert duration_ms(SITE, state, action) is not None
            assert delta(SITE, state, action) is not None


@pytest.mark.parametrize("kind", [k for k, m in WORDS.items() if m.state_writing])
def test_what_writes_belief_is_bottom_in_the_world(kind: str) -> None:
    assert delta(SITE, scenarios.world("pharmacy"), sample(kind)) is None


@pytest.mark.parametrize(
    ("kind", "condition", "undone_by"),
    [
        ("open", "open", "close"),
        ("turn_on", "on", "turn_off"),
        ("dirty", "dirty", "clean"),
        ("slice", "sliced", None),
        ("break", "broken", None),
        ("cook", "cooked", None),
        ("use_up", "used-up", None),
    ],
)
def test_a_condition_begins_and_ends(kind: str, condition: str, undone_by: str | None) -> None:
    state = after(at_hand(), does(kind, object="package-p1"))
    assert state.things == {"package-p1": (condition,)}
    if undone_by is not None:
        assert after(state, does(undone_by, object="package-p1")).things == {}


def test_a_thing_in_another_room_is_out_of_reach() -> None:
    for kind in ("open", "turn_on", "slice", "find", "fill"):
        assert delta(SITE, scenarios.world("dock"), does(kind, object="package-p1")) is None


def test_a_topic_is_read_from_anywhere_and_recorded() -> None:
    action = does("read_sensor", object="package-p1", params={"max_bytes": 7})
    state = after(scenarios.world("dock"), action)
    assert (state.recorded_bytes, state.recordings) == (7, ("dock",))


def test_what_is_put_in_lies_where_the_robot_is_and_inside_the_other_thing() -> None:
    state = after(at_hand(), does("pick", object="package-p1"), does("put_in", object="package-p2"))
    assert state.holding is None
    assert state.places["package-p1"] == "pharmacy"
    assert state.inside == {"package-p1": "package-p2"}
    taken = after(state, does("pick", object="package-p1"), does("drop"))
    assert taken.inside == {}


def test_nothing_can_be_put_into_itself_or_let_go_by_an_empty_hand() -> None:
    holding = after(at_hand(), does("pick", object="package-p1"))
    assert delta(SITE, holding, does("put_in", object="package-p1")) is None
    for kind in ("drop", "throw", "pour"):
        assert delta(SITE, at_hand(), does(kind)) is None


def test_what_is_thrown_is_thrown() -> None:
    state = after(at_hand(), does("pick", object="package-p1"), does("throw"))
    assert state.things == {"package-p1": ("thrown",)}


def test_a_vessel_is_filled_poured_and_emptied_once() -> None:
    fill = does("fill", object="package-p1", params={"liquid_no": 3})
    full = after(at_hand(), fill)
    assert full.things == {"package-p1": ("filled-3",)}
    refilled = after(full, does("fill", object="package-p1", params={"liquid_no": 4}))
    assert refilled.things == {"package-p1": ("filled-4",)}
    held = after(full, does("pick", object="package-p1"))
    poured = after(held, does("pour"))
    assert poured.things == {}
    assert delta(SITE, poured, does("pour")) is None
    assert after(full, does("empty", object="package-p1")).things == {}
    assert delta(SITE, at_hand(), does("empty", object="package-p1")) is None


def test_settings_keep_the_last_value() -> None:
    state = after(
        at_hand(),
        does("gait", params={"gait_no": 1}),
        does("gait", params={"gait_no": 2}),
        does("lamp", params={"lamp_no": 5}),
    )
    assert state.settings == {"gait.gait_no": 2, "lamp.lamp_no": 5}


def test_a_walk_goes_straight_along_the_heading_and_not_through_the_outer_wall() -> None:
    state = scenarios.world("pharmacy")
    ahead = after(state, does("walk", params={"distance_mm": 1_000}))
    assert (ahead.x_mm, ahead.y_mm) == (state.x_mm + 1_000, state.y_mm)
    turned = after(state, does("turn", params={"angle_urad": FULL_TURN_URAD // 4}))
    up = after(turned, does("walk", params={"distance_mm": 1_000}))
    assert (up.x_mm, up.y_mm) == (state.x_mm, state.y_mm + 1_000)
    assert delta(SITE, state, does("walk", params={"distance_mm": -90_000})) is None


def test_a_drive_takes_its_time_and_turns_on_the_way() -> None:
    params = {"linear_mm_s": 500, "lateral_mm_s": 0, "turn_urad_s": 1_000, "duration_ms": 2_000}
    action = does("drive", params=params)
    state = scenarios.world("pharmacy")
    assert duration_ms(SITE, state, action) == 2_000
    path = plan_path(SITE, state, action)
    assert path is not None
    assert path[-1] == (state.x_mm + 1_000, state.y_mm)
    assert after(state, action).heading_urad == 2_000


def test_a_survey_drives_there_and_records() -> None:
    action = does("survey", destination="station-101", params={"max_bytes": 9})
    state = after(scenarios.world("pharmacy"), action)
    assert (state.region, state.recorded_bytes) == ("station-101", 9)


def test_conditions_are_attested_once_they_hold() -> None:
    from authguard_r.sim.robot import snapshot_of

    state = after(at_hand(), does("open", object="package-p1"))
    readings = snapshot_of(state, robot=scenarios.RID, epoch=1, seq=1).readings
    assert readings["package-p1.open"].value is True
    assert "package-p2.open" not in readings
