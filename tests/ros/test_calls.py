# SPDX-License-Identifier: Apache-2.0
"""Map, binding and site have to fit each other before anything is served."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from authguard_r.core.errors import MalformedError
from authguard_r.normalize.binding import Binding, load_binding
from authguard_r.normalize.dialects import Call
from authguard_r.normalize.shipped import binding_source
from authguard_r.ros.calls import body_of, bound, call_of, item_of
from authguard_r.ros.map import RosMap, parse_map
from authguard_r.site.model import Site
from authguard_r.site.source import parse_site

HERE = Path(__file__).resolve().parent
MAP = (HERE / "map.yaml").read_text()
SITE = """
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


@pytest.fixture(scope="module")
def site() -> Site:
    return parse_site(SITE, where="site")


@pytest.fixture(scope="module")
def binding(site: Site) -> Binding:
    plain = yaml.safe_load((HERE / "binding.yaml").read_text())
    return load_binding(plain, site=site, where="binding")


def changed(**mediated: Any) -> RosMap:
    plain = yaml.safe_load(MAP)
    plain["mediated"] |= mediated
    return parse_map(yaml.safe_dump(plain), where="map")


def test_each_mediated_thing_is_found_again_in_its_own_call(site: Site, binding: Binding) -> None:
    ros = parse_map(MAP, where="map")
    spoken = bound(binding, ros, site)
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


def test_l16_what_no_way_of_the_binding_means_is_not_mediated(site: Site, binding: Binding) -> None:
    for change in ({"private": "/other"}, {"type": "std_msgs/msg/Int8"}):
        lamp = {**yaml.safe_load(MAP)["mediated"]["lamp"], **change}
        with pytest.raises(MalformedError, match="a way of the binding"):
            bound(binding, changed(lamp=lamp), site)


def test_velocities_are_a_stream_and_nothing_else_is(site: Site, binding: Binding) -> None:
    items = yaml.safe_load(MAP)["mediated"]
    with pytest.raises(MalformedError, match="expected a stream"):
        bound(binding, changed(wheels={**items["wheels"], "kind": "message"}), site)
    with pytest.raises(MalformedError, match="velocities for a time"):
        bound(binding, changed(lamp={**items["lamp"], "kind": "stream"}), site)


def test_only_what_is_mediated_is_rebuilt(site: Site) -> None:
    """Of nine goals of Nav2 the robot has one: no other way carries an action to it."""
    binding = load_binding(binding_source("nav2"), site=site, where="nav2")
    goal = {
        "kind": "action",
        "type": "nav2_msgs/action/FollowWaypoints",
        "public": "/llm/follow_waypoints",
        "private": "/follow_waypoints",
        "by": "/robot",
    }
    plain = {**yaml.safe_load(MAP), "mediated": {"waypoints": goal}}
    spoken = bound(binding, parse_map(yaml.safe_dump(plain), where="map"), site)
    assert list(spoken.tools) == ["send_action_goal"]
    (way,) = spoken.tools["send_action_goal"]  # type: ignore[misc]
    assert way.message == "nav2_msgs/action/FollowWaypoints"
