# SPDX-License-Identifier: Apache-2.0
"""Shipped bindings against the interfaces that they are for, as those describe themselves.

Zero unmapped fields: every tool and every leaf field is bound, and nothing that is not there.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from authguard_r.authoring.binding.check import BindingReport, check_binding
from authguard_r.authoring.binding.samples import Sampler, probe_site
from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.bind import Binder
from authguard_r.normalize.binding import Binding, ways
from authguard_r.normalize.dialects import Call, Dialect, read_plan
from authguard_r.normalize.interface import Surface, read_interface, shipped_interface
from authguard_r.normalize.rebuild import Rebuilder
from authguard_r.normalize.shipped import binding_source
from authguard_r.site.model import Site
from authguard_r.site.source import convert
from authguard_r.site.words import standard_words

ROOT = Path(__file__).resolve().parent.parent.parent
EXTERNAL = ROOT.parent / "shared" / "external"

pytestmark = [
    pytest.mark.external,
    pytest.mark.skipif(not EXTERNAL.is_dir(), reason=f"no public test data at {EXTERNAL}"),
]

#: For each binding: the files of its interface, and how many tools or messages they describe.
INTERFACES: dict[str, tuple[str, int]] = {
    "ros-mcp": ("ros_mcp/tools_list_ros-mcp-3.1.2.json", 31),
    "rosa": ("rosa/tool_signatures.json", 62),
    "bfcl-vehicle": ("bfcl/vehicle_control.json", 22),
    "nav2": ("nav2_msgs/*.*", 39),
    "moveit": ("moveit_msgs/*.*", 5),
}


@cache
def shipped(name: str) -> tuple[Binding, Site]:
    binding = convert(binding_source(name), Binding, where=name)
    return binding, probe_site(binding, standard_words())


def described(name: str) -> tuple[Surface, ...]:
    """Return what the interface of a binding says of itself."""
    return tuple(
        surface
        for path in sorted(EXTERNAL.glob(INTERFACES[name][0]))
        for surface in read_interface(path.read_text(encoding="utf-8"), name=path.name)
    )


def listed(name: str) -> dict[str, Surface]:
    surfaces = shipped_interface(name)
    assert surfaces is not None
    return {surface.name: surface for surface in surfaces}


def compared(name: str) -> tuple[BindingReport, int]:
    binding, site = shipped(name)
    surfaces = described(name)
    return check_binding(binding, site, interface=surfaces), len(surfaces)


@pytest.mark.parametrize("name", INTERFACES)
def test_the_shipped_list_of_fields_is_what_the_interface_says(name: str) -> None:
    assert listed(name) == {surface.name: surface for surface in described(name)}


@pytest.mark.parametrize("name", INTERFACES)
def test_every_field_of_every_tool_is_mapped_fixed_refused_or_noted(name: str) -> None:
    found, count = compared(name)
    assert (found.unmapped, found.faults) == ((), ())
    assert count == INTERFACES[name][1]


@pytest.mark.parametrize("name", INTERFACES)
def test_a_binding_short_of_one_argument_is_found_out(name: str) -> None:
    """The comparison can fail: take any one bound field away and it does."""
    site = shipped(name)[1]
    plain: Any = binding_source(name)
    tool, way = next(
        (tool, way)
        for tool, found in sorted(plain["tools"].items())
        for way in (found if isinstance(found, list) else [found])
        if way.get("arguments") and ("message" in way or not isinstance(found, list))
    )
    body = f"{way['body']}." if "body" in way else ""
    del way["arguments"][next(a for a in way["arguments"] if a.startswith(body))]
    found = check_binding(convert(plain, Binding, where=name), site, interface=described(name))
    assert found.unmapped, tool


@pytest.mark.parametrize(
    ("name", "schema"), [("ros-mcp", "inputSchema"), ("bfcl-vehicle", "parameters")]
)
def test_every_dispatched_call_has_what_its_server_requires(name: str, schema: str) -> None:
    """What is rebuilt is a call that the server takes, not only one that we would."""
    text = (EXTERNAL / INTERFACES[name][0]).read_text(encoding="utf-8")
    described = (
        json.loads(text)["tools"] if name == "ros-mcp" else map(json.loads, text.splitlines())
    )
    required = {tool["name"]: set(tool[schema].get("required", ())) for tool in described}
    binding, site = shipped(name)
    binder, rebuilder = Binder(site, binding), Rebuilder(site, binding)
    seen = set()
    for way in ways(binding):
        if not site.vocabulary[way.tool.type].state_writing:
            call = Sampler(site).call(way)
            assert call is not None
            for tool in (None, way.name):
                dispatched = rebuilder.rebuild(binder.bind(call), tool=tool)
                assert required[dispatched.tool] <= dispatched.arguments.keys(), dispatched
                seen.add(dispatched.tool)
    assert len(seen) > 15


#: The calls of the robot-language-model interfaces and the binding that they are bound in.
CALL_FORMS = {
    "jackal_and_spine": "spine",
    "unitree_go2": "unitree-go2",
    "dolphins": "dolphins",
    "badrobot_arms": "badrobot-arms",
}


@pytest.mark.parametrize("group", CALL_FORMS)
def test_every_call_of_a_robot_s_language_model_interface_is_bound(group: str) -> None:
    """By position, with as many arguments as it has and not one more."""
    apis = json.loads((EXTERNAL / "robot_llm_apis" / "apis.json").read_text(encoding="utf-8"))
    calls = apis[group]["calls"]
    binding, site = shipped(CALL_FORMS[group])
    assert {name for name, _ in calls} == set(binding.tools)
    assert {name: surface.leaves for name, surface in listed(CALL_FORMS[group]).items()} == {
        name: tuple("1" if argument == "free text" else argument.split()[0] for argument in given)
        for name, given in calls
    }
    binder = Binder(site, binding)
    for name, arguments in calls:
        (way,) = [way for way in ways(binding) if way.name == name]
        named = [{path, *argument.also} for path, argument in way.tool.arguments.items()]
        for number in range(1, len(arguments) + 1):
            assert any(str(number) in names for names in named), name
        extra = {str(number): "x" for number in range(1, len(arguments) + 2)}
        with pytest.raises(MalformedError) as caught:
            binder.bind(Call(name, extra, "input"))
        assert caught.value.reason in {Reason.FIELD_UNKNOWN, Reason.STATE_WRITING_REFUSED}


def test_every_step_of_safeagentbench_is_a_bound_call_with_known_fields() -> None:
    """Each step's verb is bound and takes the names that stand behind it; the names are a site's.

    The steps that are none are those that the dialect itself refuses.
    """
    binding, site = shipped("safeagentbench")
    binder = Binder(site, binding)
    steps = {
        step
        for path in sorted((EXTERNAL / "safeagentbench").glob("*.jsonl"))
        for line in path.read_text(encoding="utf-8").splitlines()
        for step in json.loads(line).get("step") or []
    }
    assert len(steps) > 200
    strange, reasons = [], set()
    fields = {verb: set(surface.leaves) for verb, surface in listed("safeagentbench").items()}
    for step in sorted(steps):
        try:
            (call,) = read_plan(step, Dialect.STEPS)
        except MalformedError:
            strange.append(step)
            continue
        assert call.arguments.keys() <= fields[call.tool], step
        try:
            binder.bind(call)
        except MalformedError as error:
            reasons.add(error.reason)
    assert reasons <= {Reason.NAME_UNKNOWN}
    assert len(strange) <= 3, strange


def test_a_navigation_goal_with_another_behavior_tree_is_refused() -> None:
    """The pose is allowed while another field changes the behavior (L16)."""
    binding, site = shipped("ros-mcp")
    pose = {"header": {"frame_id": "map"}, "pose": {"position": {"x": 1, "y": 1}}}
    goal = {
        "action_name": "/navigate_to_pose",
        "action_type": "nav2_msgs/action/NavigateToPose",
        "goal": {"pose": pose, "behavior_tree": ""},
    }
    binder = Binder(site, binding)
    assert binder.bind(Call("send_action_goal", goal, "x")).destination == "square-1"
    absent = {**goal, "goal": {"pose": pose, "behavior_tree": None}}
    assert binder.bind(Call("send_action_goal", absent, "x")).destination == "square-1"
    for tree in ("/tmp/other.xml", " ", 0, False):
        other = {**goal, "goal": {"pose": pose, "behavior_tree": tree}}
        with pytest.raises(MalformedError) as caught:
            binder.bind(Call("send_action_goal", other, "x"))
        assert caught.value.where == "x.goal.behavior_tree"
