# SPDX-License-Identifier: Apache-2.0
"""The symbolic world: delta with bottom, doors, batteries, and time (`eq:transition`)."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from authguard_r.core.action import Action
from authguard_r.core.errors import ControllerError
from authguard_r.sim.robot import Faults
from authguard_r.sim.world import delta, duration_ms, path_length_mm, plan_path
from fixtures import scenarios
from fixtures.cases import case

SITE = scenarios.site()


def does(kind: str, **fields: Any) -> Action:
    return Action(type=kind, tool="x", **fields)


def test_a_way_keeps_to_the_middle_of_the_corridor() -> None:
    path = plan_path(
        SITE, scenarios.world("pharmacy"), scenarios.navigate("pharmacy", "station-103")
    )
    assert path is not None
    assert path[0] == (4_000, 5_000)
    assert path[-1] == (29_000, 5_000)
    assert (4_000, 1_500) in path
    assert (29_000, 1_500) in path
    assert path_length_mm(path) >= 25_000


def test_the_route_is_passed_in_order() -> None:
    action = scenarios.navigate("pharmacy", "station-101", route=("staff-corridor",))
    path = plan_path(SITE, scenarios.world("pharmacy"), action)
    assert path is not None
    assert (4_000, 9_000) in path
    assert (13_000, 9_000) in path


def test_what_cannot_be_done_from_here_is_bottom() -> None:
    for action in [
        does("navigate"),
        scenarios.navigate("dock", "moon"),
        scenarios.navigate("dock", "pharmacy", route=("moon",)),
        scenarios.navigate("dock", "pharmacy", speed=0),
        does("pick", object="package-p1"),
        does("pick"),
        does("place", object="package-p1", destination="dock"),
        does("dance"),
    ]:
        with case(action):
            assert delta(SITE, scenarios.world("dock"), action) is None


def test_a_closed_door_is_no_way() -> None:
    world = scenarios.world("dock")
    go = scenarios.navigate("dock", "isolation-room")
    assert delta(SITE, world, go) is not None
    shut = msgspec.structs.replace(world, doors={"isolation_door_open": False})
    assert delta(SITE, shut, go) is None
    assert duration_ms(SITE, shut, go) is None


def test_an_empty_battery_moves_nothing() -> None:
    flat = msgspec.structs.replace(scenarios.world("dock"), battery_permille=1)
    assert delta(SITE, flat, scenarios.navigate("dock", "pharmacy")) is None


def test_things_are_where_they_were_put() -> None:
    state = scenarios.world("pharmacy")
    held = delta(SITE, state, does("pick", object="package-p1"))
    assert held is not None
    assert (held.holding, "package-p1" in held.places) == ("package-p1", False)
    assert delta(SITE, held, does("pick", object="package-p2")) is None
    put = delta(SITE, held, does("place", object="package-p1", destination="pharmacy"))
    assert put is not None
    assert (put.holding, put.places["package-p1"]) == (None, "pharmacy")


def test_a_recording_is_counted() -> None:
    after = delta(SITE, scenarios.world("dock"), does("record_video", params={"max_bytes": 9}))
    assert after is not None
    assert (after.recorded_bytes, after.recordings) == (9, ("dock",))


def test_time_passes_only_when_somebody_pauses() -> None:
    robot = scenarios.simulation().robot
    handle = robot.dispatch(does("wait", params={"duration_ms": 1_000}), None)
    assert handle.outcome() is None
    robot.pause(999)
    assert handle.outcome() is None
    robot.pause(1)
    assert str(handle.outcome()) == "succeeded"
    assert handle.used().wait_ms == 1_000
    assert robot.mono_ms() == 1_000


def test_one_action_at_a_time_and_a_stop_ends_it() -> None:
    robot = scenarios.simulation().robot
    handle = robot.dispatch(scenarios.navigate("dock", "pharmacy"), None)
    with pytest.raises(ControllerError):
        robot.dispatch(scenarios.navigate("dock", "pharmacy"), None)
    robot.pause(3_000)
    assert robot.state.speed_mm_s == 500
    robot.stop()
    assert str(handle.outcome()) == "aborted"
    assert robot.state.speed_mm_s == 0
    here = (robot.state.x_mm, robot.state.y_mm)
    robot.pause(3_000)
    assert (robot.state.x_mm, robot.state.y_mm) == here


def test_what_cannot_be_begun_is_refused_by_the_controller() -> None:
    robot = scenarios.simulation().robot
    with pytest.raises(ControllerError):
        robot.dispatch(scenarios.navigate("dock", "moon"), None)


def test_an_estimator_that_dies_says_nothing_new() -> None:
    robot = scenarios.simulation(faults=Faults(estimator_dies_ms=200)).robot
    robot.pause(150)
    last = robot.latest()
    robot.pause(1_000)
    assert robot.latest() == last
