# SPDX-License-Identifier: Apache-2.0
"""Everything refused: no call of any listed tool becomes an action, whatever its arguments."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from authguard_r.authoring.binding.check import check_binding
from authguard_r.authoring.onboarding.listing import MAX_TOOLS, Source
from authguard_r.authoring.onboarding.skeleton import Skeleton, make_skeleton
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import RobotId
from authguard_r.core.reasons import Reason
from authguard_r.normalize import Binder, Dialect, read_plan
from authguard_r.normalize.binding import ArgumentUse, Binding, ways
from authguard_r.normalize.interface import listed_interface, read_interface
from authguard_r.site.check import faults, unreviewed
from authguard_r.site.names import skeleton as look
from authguard_r.site.source import convert, parse_site, read_yaml
from fixtures.amount import amount
from fixtures.time_bounds import at_most

NAMES = st.from_regex(r"\A[a-z][a-z0-9_]{0,8}\Z")
KINDS = st.sampled_from(["string", "number", "integer", "boolean", "array", "object", "null"])
SCHEMAS = st.recursive(
    st.fixed_dictionaries({"type": KINDS}),
    lambda inner: (
        st.fixed_dictionaries(
            {"type": st.just("object"), "properties": st.dictionaries(NAMES, inner, max_size=4)}
        )
        | st.fixed_dictionaries({"type": st.just("array"), "items": inner})
    ),
    max_leaves=8,
)
TOOLS = st.dictionaries(NAMES, st.dictionaries(NAMES, SCHEMAS, max_size=4), min_size=1, max_size=4)
VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-5, 5) | st.sampled_from(["home", "/cmd_vel", ""]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(NAMES, inner, max_size=3),
    max_leaves=6,
)
GRAPH = json.dumps(
    {
        "topics": {"/cmd_vel": "geometry_msgs/msg/Twist", "/other": ["a/msg/B", "a/msg/C"]},
        "services": {"/reset": "std_srvs/srv/Empty", "/b/set": "b/srv/Set", "/c/set": "c/srv/Set"},
        "actions": {"/go": "nav2_msgs/action/NavigateToPose"},
        "types": {
            "std_srvs/srv/Empty": "---\n",
            "b/srv/Set": "bool on\n---\n",
            "c/srv/Set": "int8 value\n---\n",
        },
    }
)


def skeleton(text: str, source: Source) -> Skeleton:
    return make_skeleton(text, source=source, robot=RobotId("robot-1"), where="list")


def binding_of(made: Skeleton) -> Binding:
    return convert(read_yaml(made.binding, where="b"), Binding, where="b")


def listing(tools: dict[str, Any]) -> str:
    return json.dumps(
        {
            "tools": [
                {"name": name, "inputSchema": {"type": "object", "properties": fields}}
                for name, fields in tools.items()
            ]
        }
    )


def apart(tools: dict[str, Any]) -> bool:
    """True when no two names could be taken for each other."""
    return len({look(name) for name in tools}) == len(tools)


def binder_of(made: Skeleton) -> Binder:
    return Binder(parse_site(made.site, where="s"), binding_of(made))


def refusal(binder: Binder, plan: Any, dialect: Dialect) -> Reason:
    """Return why a plan is refused; that it is not is the failure of the test."""
    with pytest.raises(MalformedError) as caught:
        read_plan(json.dumps(plan).encode(), binder=binder, dialect=dialect)
    return caught.value.reason


@pytest.mark.complete
@settings(max_examples=amount(30, 150))
@given(TOOLS, st.data())
def test_whatever_one_calls_with_whatever_arguments_is_refused(
    tools: dict[str, Any], data: st.DataObject
) -> None:
    assume(apart(tools))
    made = skeleton(listing(tools), Source.MCP)
    fields = data.draw(
        st.dictionaries(st.sampled_from([*(f for t in tools.values() for f in t), "x"]), VALUES)
    )
    name, binder = data.draw(st.sampled_from(sorted(tools))), binder_of(made)
    assert refusal(binder, {"tool": name, "arguments": fields}, Dialect.JSON) is (
        Reason.STATE_WRITING_REFUSED
    )
    call = {"jsonrpc": "2.0", "id": 1, "method": "tools/call"}
    call["params"] = {"name": name, "arguments": fields}
    assert refusal(binder, call, Dialect.MCP) is Reason.STATE_WRITING_REFUSED


#: Of the graph, made once: bindings and binders do not change.
OF_GRAPH = binder_of(skeleton(GRAPH, Source.ROS))


@pytest.mark.complete
@settings(max_examples=amount(30, 150))
@given(
    st.sampled_from(["/cmd_vel", "/other", "/reset", "/b/set", "/go", "/unknown"]),
    st.dictionaries(NAMES, VALUES),
)
def test_whatever_is_published_called_or_sent_is_refused(name: str, body: dict[str, Any]) -> None:
    for plan in (
        {"op": "publish", "topic": name, "msg": body},
        {"op": "publish", "topic": name, "type": "a/msg/B", "msg": body},
        {"op": "call_service", "service": name, "args": body},
        {"op": "call_service", "service": name},
        {"op": "send_action_goal", "action": name, "action_type": "a/action/B", "args": body},
    ):
        assert refusal(OF_GRAPH, plan, Dialect.ROS2) in {
            Reason.STATE_WRITING_REFUSED,
            Reason.TOOL_UNKNOWN,
        }


@pytest.mark.complete
@settings(max_examples=amount(25, 100))
@given(TOOLS)
def test_the_check_finds_nothing_unmapped_by_our_list_and_by_the_first_one(
    tools: dict[str, Any],
) -> None:
    assume(apart(tools))
    text = listing(tools)
    made = skeleton(text, Source.MCP)
    found, site = binding_of(made), parse_site(made.site, where="s")
    ours = listed_interface(read_yaml(made.interface, where="i"), where="i")
    for surfaces in (ours, read_interface(text, name="tools.json")):
        report = check_binding(found, site, interface=surfaces)
        assert report.unmapped == ()
        assert not [fault for fault in report.faults if "that exists" not in fault.message]
    assert made.report.faults == ()
    assert {a.use for way in ways(found) for a in way.tool.arguments.values()} <= {
        ArgumentUse.REFUSED
    }
    assert made.report.fields["mapped"] == made.report.fields["noted"] == 0


def test_a_graph_is_bound_reachable_by_reachable_and_compared_with_its_messages() -> None:
    made = skeleton(GRAPH, Source.ROS)
    report = made.report
    assert (report.tools, report.ways, report.unmapped, report.uncompared) == (3, 6, (), ())
    shown = listed_interface(read_yaml(made.interface, where="i"), where="i")
    assert [s.name for s in shown if s.message] == ["Twist"]  # two types are called `Set`


def test_the_site_is_sound_cannot_be_signed_and_has_a_robot_that_can_do_nothing() -> None:
    made = skeleton(listing({"go": {}}), Source.MCP)
    assert faults(made.model) == ()
    assert unreviewed(made.model) == ("regions.home.tags",)
    profile = made.model.robots[RobotId("robot-1")].profile
    assert profile.tools == {}
    assert profile.max_speed_mm_s == profile.max_force_mn == profile.max_payload_g == 0


@pytest.mark.parametrize("robot", ["true", "1", "1.5", "null", "a:b"])
def test_a_robot_may_be_called_what_yaml_would_take_for_something_else(robot: str) -> None:
    made = make_skeleton(
        listing({"null": {"true": {}}}), source=Source.MCP, robot=RobotId(robot), where="l"
    )
    assert list(made.model.robots) == [robot]
    assert list(binding_of(made).tools) == ["null"]


def test_the_longest_list_is_made_in_a_bounded_time_and_one_that_no_file_holds_is_refused() -> None:
    tools = {f"tool_{n}x": {"room": {"type": "string"}} for n in range(MAX_TOOLS)}
    with at_most(60):
        assert skeleton(listing(tools), Source.MCP).report.tools == MAX_TOOLS
    fields = {f"field_{n}": {"type": "string"} for n in range(90)}
    with at_most(60), pytest.raises(MalformedError) as caught:
        skeleton(listing({f"tool_{n}x": fields for n in range(300)}), Source.MCP)
    assert caught.value.reason is Reason.INPUT_TOO_LARGE
