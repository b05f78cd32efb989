# SPDX-License-Identifier: Apache-2.0
"""A proposed binding maps what leaves one answer, and refuses the rest with what was seen."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from authguard_r.authoring.binding.samples import probe_site
from authguard_r.authoring.onboarding.calls import MAX_WORDS
from authguard_r.authoring.onboarding.evidence import gather
from authguard_r.authoring.onboarding.listing import MAX_FIELDS, MAX_TOOLS
from authguard_r.authoring.onboarding.pages import BINDING, MISSION, SITE, LearnedProposals, propose
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Identifier
from authguard_r.normalize import Binder, Dialect, read_plan
from authguard_r.normalize.binding import ArgumentUse, Binding, binding_faults, same, ways
from authguard_r.site.model import Site
from authguard_r.site.source import convert, read_yaml
from authguard_r.site.words import standard_words
from fixtures import scenarios
from fixtures import shadow_logs as logs
from fixtures.amount import amount
from fixtures.cases import case

EMPTY = Binding(schema="authguard-r/binding/1", id=Identifier("empty"), tools={})
#: Squares 1 to 3, things 1 and 2, the standard words, no robot that says what it can do.
WORDS = probe_site(EMPTY, standard_words())


def learned(
    *plans: str | bytes, site: Site = WORDS, binding: Binding | None = None
) -> LearnedProposals:
    entries = [logs.refused(plan) for plan in plans]
    found = gather(logs.in_memory(*entries, first=logs.genesis(site)), site)
    return propose(found, site, binding)


def bound(proposals: LearnedProposals, site: Site = WORDS) -> Binding:
    """Return the proposed binding, which is sound."""
    found = convert(read_yaml(proposals.files[BINDING], where="b"), Binding, where="b")
    assert list(binding_faults(found, site)) == []
    return found


def uses(proposals: LearnedProposals, tool: str) -> tuple[str, dict[str, Any]]:
    """Return the type of a tool's one way, and its arguments as they are written."""
    plain = read_yaml(proposals.files[BINDING], where="b")
    assert isinstance(plain, dict)
    return plain["tools"][tool]["type"], plain["tools"][tool].get("arguments", {})


def test_places_and_amounts_with_a_unit_in_the_name_are_mapped() -> None:
    found = learned(
        logs.call("go", room="Square 1", speed_m_s=0.5, mode="fast", why="a"),
        logs.call("go", room="square-2", speed_m_s=1, mode="fast", why="b"),
    )
    kind, arguments = uses(found, "go")
    assert kind == "navigate"
    assert arguments == {
        "room": {"use": "mapped", "to": "destination"},
        "speed_m_s": {"use": "mapped", "to": "params.speed_mm_s", "per_unit": "1000"},
        "mode": {"use": "fixed", "value": "fast"},
        "why": {"use": "refused"},
    }
    (way,) = ways(bound(found))
    assert (way.tool.tool, way.tool.attested) == ("go", ("source",))
    assert "from 0.5 to 1" in found.files[BINDING]


def test_a_type_is_proposed_where_one_alone_fits() -> None:
    for name, arguments, kind in [
        ("take", {"thing": "Thing 1", "force_n": 12}, "pick"),
        ("put", {"thing": "Thing 1", "at": "Square 1", "force_n": 12}, "place"),
        ("pause", {"duration_ms": 500}, "wait"),
        ("wait_seconds", {"seconds": 2}, "wait"),
        ("dock_at", {"room": "Square 1"}, "dock"),
        ("turnOn", {"thing": "Thing 1"}, "turn_on"),
        ("announce", {}, "announce"),
        ("drive", {"linear_m_s": 1, "lateral_m_s": 0, "turn_rad_s": 1, "duration_s": 1}, "drive"),
        # nothing says which of several types
        ("visit", {"room": "Square 1"}, "unheld"),
        ("do_it", {}, "unheld"),
        # no unit in the name, no place, no thing
        ("go", {"room": "Square 1", "speed": 1}, "unheld"),
        ("go", {"room": "Room 9", "speed_m_s": 1}, "unheld"),
        ("go", {"room": ["Square 1"], "speed_m_s": 1}, "unheld"),
        ("go", {"room": "Square 1", "other": "Square 2", "speed_m_s": 1}, "unheld"),
        ("go", {"room": "Square 1", "speed_m_s": 1, "height_m": 1}, "unheld"),
        ("go", {"room": "Square 1", "speed_m_s": "1"}, "unheld"),
        ("go", {"room": "Square 1", "speed_m_s": None}, "unheld"),
    ]:
        with case(name, arguments, kind):
            found = learned(logs.call(name, **arguments))
            assert uses(found, name)[0] == kind
            bound(found)
            if kind == "unheld":
                assert all(use == {"use": "refused"} for use in uses(found, name)[1].values())


def test_a_start_is_mapped_as_a_start_and_one_call_makes_no_constant() -> None:
    found = learned(
        logs.call("go", **{"from": "Square 1", "to": "Square 2", "speed_mm_s": 9, "x": 1})
    )
    kind, arguments = uses(found, "go")
    assert (kind, arguments["from"]) == ("navigate", {"use": "mapped", "to": "source"})
    assert arguments["speed_mm_s"] == {"use": "mapped", "to": "params.speed_mm_s"}
    assert arguments["x"] == {"use": "refused"}


def test_constants_are_held_as_what_they_were() -> None:
    values = {"a": True, "b": 3, "c": 0.25, "d": "x # y", "e": 1.0}
    found = learned(*[logs.call("wait", duration_s=n, **values) for n in (1, 2)])
    _, arguments = uses(found, "wait")
    assert {name: arguments[name] for name in values} == {
        "a": {"use": "fixed", "value": True},
        "b": {"use": "fixed", "value": 3},
        "c": {"use": "fixed", "decimal": "0.25"},
        "d": {"use": "fixed", "value": "x # y"},
        "e": {"use": "fixed", "value": 1},
    }
    bound(found)
    for strange in (2**60, 1e-30, "x" * 500, None, [], {}):
        found = learned(*[logs.call("wait", duration_s=n, odd=strange) for n in (1, 2)])
        assert uses(found, "wait")[1]["odd"] == {"use": "refused"}


def test_a_field_that_was_not_always_there_is_no_constant_and_may_be_left_out() -> None:
    found = learned(
        logs.call("walk", distance_m=1, speed_m_s=1, mode=1),
        logs.call("walk", distance_m=2),
        logs.call("walk", distance_m=2),
    )
    _, arguments = uses(found, "walk")
    assert arguments["speed_m_s"]["optional"] is True
    assert arguments["mode"] == {"use": "refused"}


def test_what_was_now_a_value_and_now_an_object_is_refused_whole() -> None:
    found = learned(
        logs.call("go", a=1, b={"c": 2}), logs.call("go", a={"b": {"c": 1}}, b={"c": 3})
    )
    assert uses(found, "go")[1] == {"a": {"use": "refused"}, "b.c": {"use": "refused"}}


def test_ros_calls_are_told_apart_by_what_they_reach() -> None:
    def publish(topic: str, **message: Any) -> str:
        return json.dumps({"op": "publish", "topic": topic, "msg": message})

    found = learned(
        publish("/cmd_vel", linear={"x": 0.5}),
        publish("/other", data=1),
        json.dumps({"op": "send_action_goal", "action": "/a", "action_type": "t", "args": {}}),
        publish("/caf\u00e9", data=1),
    )
    plain = read_yaml(found.files[BINDING], where="b")
    assert [way["when"] for way in plain["tools"]["publish"]] == [
        {"topic": "/cmd_vel"},
        {"topic": "/other"},
    ]
    assert plain["tools"]["send_action_goal"][0]["when"] == {"action": "/a"}
    assert [(item.seq, "ASCII" in item.why) for item in found.unused] == [(4, True)]
    bound(found)


def test_names_that_the_site_does_not_know_are_comments_and_nobodys_geometry() -> None:
    found = learned(
        logs.call("go", room="Room 7\n", speed_m_s=1),
        logs.call("go", room="Room 7", speed_m_s=1),
        logs.call("go", room="\u30ed\u30dc", speed_m_s=1),
    )
    text = found.files[SITE]
    assert all(line.startswith("#") for line in text.splitlines())
    assert read_yaml(text, where="s") is None
    assert '"Room 7" (1 x)' in text
    assert "points: ?" in text
    assert text.isascii()
    assert not found.files.keys() & {MISSION}


def test_the_robots_own_types_and_tools_come_first() -> None:
    found = learned(
        logs.call("go", room="Dock", speed_m_s=1), logs.call("hush", x=1), site=scenarios.site()
    )
    (way,) = ways(bound(found, scenarios.site()))
    assert (way.tool.type, way.tool.tool) == ("navigate", "base")
    # this site has no type for what is refused: the other tool is told of, and not bound
    assert '#   "hush":' in found.files[BINDING]
    none = learned(logs.call("hush", x=1), site=scenarios.site())
    assert bound(none, scenarios.site()).tools == {}


def test_a_binding_that_reads_the_plans_makes_actions_and_leaves_what_it_does_not_read() -> None:
    found = learned(
        logs.call("navigate_to", destination="Dock"),
        logs.call("take_photo"),
        logs.call("navigate_to", destination="Cellar"),
        logs.call("fly"),
        logs.call("relocalize", place="Dock"),
        site=scenarios.site(),
        binding=scenarios.binding(),
    )
    assert [(g.type, g.starts) for g in found.learned.grants] == [
        ("navigate", 1),
        ("take_photo", 1),
    ]
    left = {meaning.key[0] for meaning in found.meanings if not meaning.about.endswith("already")}
    assert left == {"navigate_to", "fly", "relocalize"}
    tools = bound(found, scenarios.site()).tools
    assert {name: tools[name] for name in scenarios.binding().tools} == scenarios.binding().tools
    assert {"grants[0].rows[0].source", "grants[1].rows[0].source"} < {
        f for f, _ in found.questions
    }


def skeleton(**tools: object) -> Binding:
    plain = {"schema": "authguard-r/binding/1", "id": "tools", "tools": tools}
    return convert(json.loads(json.dumps(plain)), Binding, where="skeleton")


def test_what_is_learned_goes_into_the_skeleton_and_takes_nothing_from_it() -> None:
    refused = {"use": "refused"}
    base = skeleton(
        go={
            "type": "unheld",
            "tool": "unheld",
            "arguments": {"room": refused, "speed_m_s": refused, "tilt": refused, "a.b": refused},
        },
        sleep={"type": "unheld", "tool": "unheld", "arguments": {"why": refused}},
    )
    plan = json.dumps({"tool": "go", "arguments": {"room": "Square 1", "speed_m_s": 1, "a": 1}})
    found = learned(plan, logs.call("hop", x="y"), binding=base)
    assert uses(found, "go") == (
        "navigate",
        {
            "room": {"use": "mapped", "to": "destination"},
            "speed_m_s": {"use": "mapped", "to": "params.speed_mm_s", "per_unit": "1000"},
            "a": refused,
            "tilt": refused,
        },
    )
    assert list(bound(found).tools) == ["go", "sleep", "hop"]
    text = found.files[BINDING]
    assert '"tilt": {use: "refused"}  # never set in this run' in text
    assert "# never called in this run" in text


def test_what_a_person_bound_is_kept_as_it_is_whatever_was_called() -> None:
    base = skeleton(
        lamp=[
            {"type": "lamp", "tool": "lamp", "when": {"on": n == 1}, "fixed": {"params.lamp_no": n}}
            for n in (0, 1)
        ],
        publish=[
            {
                "type": "unheld",
                "tool": "unheld",
                "when": {"topic": "/go"},
                "message": "std_msgs/msg/String",
                "body": "msg",
                "arguments": {"type": {"use": "refused"}, "msg.data": {"use": "refused"}},
            }
        ],
    )
    published = {"topic": "/go", "msg": {"data": "Square 1", "speed_m_s": 1}}
    calls = (logs.call("lamp", on=True, glow=3), logs.call("publish", **published))
    found = learned(*calls, binding=base)
    tools = bound(found).tools
    assert tools["lamp"] == base.tools["lamp"]
    assert "calls of it could not be read with it" in found.files[BINDING]
    (way,) = ways(
        Binding(schema="authguard-r/binding/1", id=EMPTY.id, tools={"p": tools["publish"]})
    )
    assert (way.tool.type, way.tool.message, way.tool.body) == (
        "navigate",
        "std_msgs/msg/String",
        "msg",
    )
    assert set(way.tool.arguments) == {"type", "msg.data", "msg.speed_m_s"}


def test_a_type_that_lacks_a_number_is_named_with_what_it_lacks() -> None:
    found = learned(logs.call("put_down", thing="Thing 1", room="Square 1"))
    assert uses(found, "put_down")[0] == "unheld"
    assert "place if params.force_mn were fixed" in found.files[BINDING]


HOSTILE = st.text(max_size=12) | st.sampled_from(
    ["#", "\n", "}\ntools: {}", '"', "'", "\\", "\u2028", "*a", "&a", "? x", "- x", "Square 1"]
)
ARGUMENTS = st.dictionaries(
    st.sampled_from(["room", "speed_m_s", "thing", "x", "y", "a.b", "x\n", "#", "1"]),
    st.recursive(
        st.none() | st.booleans() | st.integers(-9, 9) | st.floats(-9, 9).map(lambda f: round(f, 2))
        | HOSTILE,
        lambda inner: st.lists(inner, max_size=2) | st.dictionaries(HOSTILE, inner, max_size=2),
        max_leaves=4,
    ),
    max_size=4,
)  # fmt: skip
CALLS = st.lists(
    st.tuples(st.sampled_from(["go", "take", "wait", "go\n", "publish", "#"]), ARGUMENTS),
    min_size=1,
    max_size=6,
)


def leaves(node: Any, prefix: str = "") -> dict[str, Any]:
    if not isinstance(node, dict) or not node:
        return {prefix: node}
    return {
        path: value
        for name, below in node.items()
        for path, value in leaves(below, f"{prefix}.{name}" if prefix else name).items()
    }


@settings(max_examples=amount(50, 250), suppress_health_check=list(HealthCheck))
@given(CALLS)
def test_whatever_a_planner_wrote_nothing_is_proposed_that_did_not_occur(
    calls: list[tuple[str, dict[str, Any]]],
) -> None:
    found = learned(*[logs.call(name, **arguments) for name, arguments in calls])
    for text in found.files.values():
        assert text.isascii()
        assert text.startswith("# PROPOSED")
    if BINDING not in found.files:
        return
    binding = bound(found)
    seen = {name: [a for n, a in calls if n == name] for name, _ in calls}
    for way in ways(binding):
        assert way.name in seen
        flat = [leaves(arguments) for arguments in seen[way.name]]
        for path, argument in way.tool.arguments.items():
            assert any(f"{name}.".startswith(f"{path}.") for each in flat for name in each)
            values = [each[path] for each in flat if path in each]
            if argument.use is ArgumentUse.FIXED:
                assert values
                assert all(same(value, argument.constant()) for value in values)
    binder = Binder(WORDS, binding)
    for name, arguments in calls:
        plan = logs.call(name, **{**arguments, "never_seen": 1})
        with pytest.raises(MalformedError):
            read_plan(plan.encode(), binder=binder, dialect=Dialect.JSON)


@settings(max_examples=amount(40, 200))
@given(st.binary(max_size=60) | st.text(max_size=60).map(str.encode))
def test_whatever_bytes_a_planner_wrote_are_read_or_left_out_with_a_reason(data: bytes) -> None:
    found = learned(data)
    assert found.plans + len(found.unused) >= 1
    assert all(item.seq == 1 and item.why for item in found.unused)


def test_a_flood_of_tools_fields_and_words_is_bounded() -> None:
    plans = [
        json.dumps([{"tool": f"t{n}", "arguments": {}} for n in range(at, at + 250)])
        for at in range(0, MAX_TOOLS + 250, 250)
    ]
    found = learned(*plans)
    assert len(found.meanings) == MAX_TOOLS
    assert any("more than" in item.why for item in found.unused)
    wide = [logs.call("t", **{f"f{n}": 1 for n in range(at, at + 300)}) for at in (0, 300)]
    found = learned(*wide)
    assert len(found.meanings[0].notes) == 300 <= MAX_FIELDS
    assert len(found.unused) == 1
    broad = [logs.call(f"t{n}x", **{f"f{m}": 1 for m in range(400)}) for n in range(5)]
    found = learned(*broad)
    assert (len(found.meanings), [item.seq for item in found.unused]) == (3, [4, 5])
    words = json.dumps([{"tool": "t", "arguments": {"w": f"w{n}"}} for n in range(MAX_WORDS * 2)])
    assert learned(words).files[SITE].count("(1 x)") == MAX_WORDS
    assert "too many or too long" in learned(words).meanings[0].notes["w"]
