# SPDX-License-Identifier: Apache-2.0
"""The tools that a planner is offered say what its binding takes, and nothing of a mission."""

from __future__ import annotations

import json
from typing import Any

from authguard_r.authoring.binding.samples import Sampler, probe_site
from authguard_r.core.identifiers import RobotId
from authguard_r.normalize.binding import Binding, load_binding, ways_of
from authguard_r.normalize.shipped import binding_source, shipped_names
from authguard_r.sim.example import bundled_hospital
from authguard_r.site.model import Site
from authguard_r.site.source import convert, read_site, read_text, read_yaml
from authguard_r.site.words import standard_words
from fixtures.cases import case
from missionpair.planners._tools import places_of, things_of, tools_of


def hospital() -> tuple[Site, Binding]:
    site = read_site(bundled_hospital() / "site.yaml")
    plain = read_yaml(read_text(bundled_hospital() / "binding.yaml"), where="binding")
    return site, load_binding(plain, site=site, where="binding")


def offered(**options: Any) -> dict[str, dict[str, Any]]:
    site, binding = hospital()
    return {tool.name: tool.parameters for tool in tools_of(site, binding, **options)}


def test_each_argument_is_offered_with_its_unit_and_its_words() -> None:
    tools = offered()
    go = tools["navigate_to"]
    assert list(go["properties"]) == ["destination", "via", "speed", "reason"]
    assert go["required"] == ["destination"]
    assert go["additionalProperties"] is False
    assert go["properties"]["speed"] == {"type": "number", "description": "in m/s"}
    assert "Station 101" in go["properties"]["destination"]["enum"]
    assert "P1" in tools["pick_up"]["properties"]["object"]["enum"]
    assert tools["wait"]["properties"]["seconds"]["description"] == "in s"


def test_what_no_planner_may_use_is_not_offered() -> None:
    tools = offered()
    assert "relocalize" not in tools  # changes what the robot believes
    assert "behavior_tree" not in json.dumps(tools)  # refused by the binding


def test_ids_are_not_shown_where_there_are_names() -> None:
    site, _ = hospital()
    assert not {*places_of(site), *things_of(site)} & {*site.regions, *site.objects}
    assert "station-101" not in json.dumps(offered())


def test_names_can_be_left_out() -> None:
    assert "enum" not in json.dumps(offered(in_words=False))


def test_a_robot_is_offered_what_it_can_do() -> None:
    site, _ = hospital()
    for robot, model in site.robots.items():
        tools = offered(robot=RobotId(robot))
        assert ("pick_up" in tools) == ("pick" in model.profile.tools)


def test_every_sample_call_of_a_shipped_binding_fits_what_is_offered() -> None:
    """A model that keeps to the schema makes calls that the binding can read."""
    for name in shipped_names():
        with case(name):
            loose = convert(binding_source(name), Binding, where=name)
            site = probe_site(loose, standard_words())
            binding = load_binding(binding_source(name), site=site, where=name)
            tools = {tool.name: tool for tool in tools_of(site, binding)}
            sampler, tried = Sampler(site), 0
            for tool in binding.tools:
                for way in ways_of(binding, tool):
                    call = sampler.call(way)
                    if call is None or site.vocabulary[way.tool.type].state_writing:
                        continue
                    tried += 1
                    assert _fits(call.arguments, tools[tool].parameters), (tool, call.arguments)
            assert tried or not tools


def _fits(value: Any, schema: dict[str, Any]) -> bool:
    """The few words of JSON schema that are used."""
    if "anyOf" in schema:
        return any(_fits(value, one) for one in schema["anyOf"])
    if "enum" in schema:
        return any(value == one or str(value) == str(one) for one in schema["enum"])
    match schema.get("type"):
        case "object":
            return (
                isinstance(value, dict)
                and set(schema["required"]) <= set(value) <= set(schema["properties"])
                and all(_fits(value[k], schema["properties"][k]) for k in value)
            )
        case "array" if "items" in schema:
            return isinstance(value, list) and all(_fits(one, schema["items"]) for one in value)
        case "array":
            return isinstance(value, list) and all(
                _fits(one, below) for one, below in zip(value, schema["prefixItems"], strict=True)
            )
        case "string":
            return isinstance(value, str)
    return not isinstance(value, str | bool | list | dict)
