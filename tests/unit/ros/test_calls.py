# SPDX-License-Identifier: Apache-2.0
"""A map, a binding and a site that do not fit each other are never served.

Spec page: docs/spec/ros.md#calls
"""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal
from typing import Any

import pytest
import yaml

from authguard_r.access.files import read_binding
from authguard_r.core.errors import MalformedError
from authguard_r.integrations.ros.calls import (
    body_of,
    bound,
    call_of,
    fitted,
    item_of,
    spelled,
)
from authguard_r.integrations.ros.map import RosMap, parse_map
from authguard_r.normalize.bind import Binder
from authguard_r.normalize.binding import Binding, load_binding
from authguard_r.normalize.dialects import Call
from authguard_r.normalize.rebuild import Rebuilder
from authguard_r.normalize.shipped import binding_source
from authguard_r.site.model import Site
from authguard_r.site.source import parse_site, read_site
from fixtures.ros_keystores import example, map_of, plain_map
from fixtures.scenarios import ROOT

HERE = ROOT / "examples" / "ros"
#: Each kind of thing that a map can mediate.
KINDS = ROOT / "tests" / "ros"
MAP = (KINDS / "map.yaml").read_text()
YARD = """
schema: authguard-r/site/1
id: yard
version: 1
words: standard
regions:
  lane:
    {map: main, floor: 0, points: [[0, 0], [9, 0], [9, 9], [0, 9]], approach: [4, 4], tags: [],
     names: []}
doors: []
objects: {}
robots: {}
"""

#: The middle of the yard, in meters.
MIDDLE = Decimal("0.004")


@pytest.fixture(scope="module")
def site() -> Site:
    return read_site(HERE / "site.yaml")


@pytest.fixture(scope="module")
def binding(site: Site) -> Binding:
    return read_binding(str(HERE / "binding.yaml"), site)


@pytest.fixture(scope="module")
def yard() -> Site:
    return parse_site(YARD, where="site")


@pytest.fixture(scope="module")
def kinds(yard: Site) -> Binding:
    plain = yaml.safe_load((KINDS / "binding.yaml").read_text())
    return load_binding(plain, site=yard, where="binding")


def brakeless() -> Site:
    """Return the example's site with a robot of which nobody knows how it brakes."""
    plain = yaml.safe_load((HERE / "site.yaml").read_text())
    for name in ("brake_mm_s2", "reaction_ms"):
        del plain["robots"]["courier-1"]["profile"][name]
    return parse_site(yaml.safe_dump(plain), where="site")


def test_the_examples_robot_is_served_whole(site: Site, binding: Binding) -> None:
    spoken = fitted(binding, example(), site)
    assert spoken.tools.keys() == {"send_action_goal", "publish", "call_service"}


def test_another_robots_map_is_served_by_no_gate_of_the_site(site: Site, binding: Binding) -> None:
    with pytest.raises(MalformedError, match="a robot of the site") as caught:
        fitted(binding, map_of({**plain_map(), "robot": "courier-9"}), site)
    assert caught.value.where == "map.robot"


def test_a_robot_that_nobody_knows_to_stand_has_no_streams(binding: Binding) -> None:
    with pytest.raises(MalformedError, match="how it brakes") as caught:
        fitted(binding, example(), brakeless())
    assert caught.value.where == "mediated.drive"
    still = plain_map()
    del still["mediated"]["drive"]
    assert "publish" not in fitted(binding, map_of(still), brakeless()).tools


def test_a_name_that_is_no_way_of_the_binding_is_not_served(site: Site, binding: Binding) -> None:
    plain = plain_map()
    plain["mediated"]["light"]["private"] = "/lamp"
    with pytest.raises(MalformedError, match="a way of the binding") as caught:
        fitted(binding, map_of(plain), site)
    assert caught.value.where == "mediated.light"


def changed(**mediated: Any) -> RosMap:
    plain = yaml.safe_load(MAP)
    plain["mediated"] |= mediated
    return parse_map(yaml.safe_dump(plain), where="map")


def test_each_mediated_thing_is_found_again_in_its_own_call(yard: Site, kinds: Binding) -> None:
    ros = parse_map(MAP, where="map")
    spoken = bound(kinds, ros, yard)
    assert {name: len(ways) for name, ways in spoken.tools.items()} == {  # type: ignore[arg-type]
        "send_action_goal": 2,
        "call_service": 4,
        "publish": 2,
    }
    for key, item in ros.mediated.items():
        assert item_of(call_of(item, {"x": 1}), ros) == key


def test_a_message_without_a_field_has_no_body() -> None:
    item = parse_map(MAP, where="map").mediated["lamp"]
    for plain in ({}, {"data": 1}):
        assert body_of(item, call_of(item, plain).arguments) == plain
    with pytest.raises(MalformedError, match="something that the map mediates"):
        item_of(Call("publish", {"topic": "/other"}, "ros"), parse_map(MAP, where="map"))


def test_l16_what_no_way_of_the_binding_means_is_not_mediated(yard: Site, kinds: Binding) -> None:
    for change in ({"private": "/other"}, {"type": "std_msgs/msg/Int8"}):
        lamp = {**yaml.safe_load(MAP)["mediated"]["lamp"], **change}
        with pytest.raises(MalformedError, match="a way of the binding"):
            bound(kinds, changed(lamp=lamp), yard)


def test_velocities_are_a_stream_and_nothing_else_is(yard: Site, kinds: Binding) -> None:
    items = yaml.safe_load(MAP)["mediated"]
    with pytest.raises(MalformedError, match="expected a stream"):
        bound(kinds, changed(wheels={**items["wheels"], "kind": "message"}), yard)
    with pytest.raises(MalformedError, match="velocities and a duration"):
        bound(kinds, changed(lamp={**items["lamp"], "kind": "stream"}), yard)


@pytest.mark.parametrize(
    ("paths", "made"),
    [
        ({"poses.goals", "behavior_tree"}, lambda stops: {"goals": stops}),
        ({"poses", "behavior_tree"}, lambda stops: stops),
        (set(), lambda stops: {"goals": stops}),
    ],
    ids=["kilted", "jazzy", "neither"],
)
def test_a_robot_is_given_the_field_that_its_distribution_of_ros_has(
    yard: Site, paths: set[str], made: Callable[[Any], Any]
) -> None:
    goal = {
        "kind": "action",
        "type": "nav2_msgs/action/NavigateThroughPoses",
        "public": "/llm/navigate_through_poses",
        "private": "/navigate_through_poses",
        "by": "/robot",
    }
    plain = {**yaml.safe_load(MAP), "mediated": {"through": goal}}
    ros = parse_map(yaml.safe_dump(plain), where="map")
    fit = bound(load_binding(binding_source("nav2"), site=yard, where="nav2"), ros, yard)
    spoken = spelled(fit, ros, lambda key, path: key == "through" and path in paths)
    spot = {"header": {"frame_id": "main"}, "pose": {"position": {"x": MIDDLE, "y": MIDDLE}}}
    binder, rebuilder = Binder(yard, spoken), Rebuilder(yard, spoken)
    (item,) = ros.mediated.values()
    for given in ([spot], {"goals": [spot]}):  # both are read, whatever the robot is given
        call = call_of(item, {"poses": given})
        rebuilt = body_of(item, rebuilder.rebuild(binder.bind(call)).arguments)
        (stop,) = (
            rebuilt["poses"] if isinstance(rebuilt["poses"], list) else rebuilt["poses"]["goals"]
        )
        assert rebuilt["poses"] == made([stop])
        assert stop["pose"]["position"]["x"] == MIDDLE
    assert Binder(yard, fit).bind(call) == binder.bind(call)


def test_only_what_is_mediated_is_rebuilt(yard: Site) -> None:
    """Of nine goals of Nav2 the robot has one: no other way carries an action to it."""
    binding = load_binding(binding_source("nav2"), site=yard, where="nav2")
    goal = {
        "kind": "action",
        "type": "nav2_msgs/action/FollowWaypoints",
        "public": "/llm/follow_waypoints",
        "private": "/follow_waypoints",
        "by": "/robot",
    }
    plain = {**yaml.safe_load(MAP), "mediated": {"waypoints": goal}}
    spoken = bound(binding, parse_map(yaml.safe_dump(plain), where="map"), yard)
    assert list(spoken.tools) == ["send_action_goal"]
    (way,) = spoken.tools["send_action_goal"]  # type: ignore[misc]
    assert way.message == "nav2_msgs/action/FollowWaypoints"
