# SPDX-License-Identifier: Apache-2.0
"""The shipped bindings: sound, true to their page, reached from the dialects, shown by commands."""

from __future__ import annotations

import json
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest

from authguard_r.authoring.binding.samples import Sampler, probe_site
from authguard_r.cli.app import program
from authguard_r.core.errors import AuthGuardError, EnvironmentFault, MalformedError
from authguard_r.normalize.bind import Binder
from authguard_r.normalize.binding import Binding, ways
from authguard_r.normalize.dialects import Call, Dialect, read_plan
from authguard_r.normalize.dialects.verbs import STEP_VERBS
from authguard_r.normalize.interface import read_interface, shipped_interface
from authguard_r.normalize.rebuild import Rebuilder
from authguard_r.normalize.shipped import binding_source, shipped_names
from authguard_r.site.source import convert
from authguard_r.site.words import standard_words
from fixtures import scenarios
from fixtures.cases import case


def test_a_shipped_name_is_compared_exactly_and_else_is_a_path(tmp_path: Path) -> None:
    assert binding_source("nav2") != binding_source("moveit")
    for name in ("Nav2", "nav2 ", "nav2.yaml", "../bindings/nav2", ""):
        with pytest.raises(EnvironmentFault):
            binding_source(name)
    file = tmp_path / "mine.yaml"
    file.write_text("tools: {}\n")
    assert binding_source(str(file)) == {"tools": {}}


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    code = program().commands["binding"](args=list(words), standalone_mode=False)
    assert isinstance(code, int)
    return code, capsys.readouterr().out


def test_the_command_checks_a_shipped_binding_and_a_file(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    code, out = run(capsys, "check", "bfcl-vehicle", "--json")
    told = json.loads(out)
    assert code == 0
    assert (told["binding"], told["tools"], told["unmapped"]) == ("bfcl-vehicle", 22, [])
    assert (told["interface"], told["unproven"]) == (22, [])
    assert told["faults"] == []
    assert told["groups"] == {"brake by car": ["tools.pressBrakePedal", "tools.releaseBrakePedal"]}
    assert set(told["fields"]) == {"mapped", "fixed", "refused", "noted"}
    hospital = str(scenarios.HOSPITAL / "binding.yaml")
    code, out = run(capsys, "check", hospital, "--site", str(scenarios.HOSPITAL / "site.yaml"))
    assert (code, out.splitlines()[0][:23]) == (0, "courier-tools: 9 tools,")
    code, out = run(capsys, "check", hospital, "--json")
    assert (code, json.loads(out)["interface"], json.loads(out)["unmapped"]) == (0, None, None)
    text = (scenarios.HOSPITAL / "binding.yaml").read_text()
    bad = tmp_path / "bad.yaml"
    bad.write_text(text.replace("to: object", "to: subject"))
    code, out = run(capsys, "check", str(bad))
    assert code == 4
    assert "tools.pick_up.subject: expected a field of `pick`" in out


def test_the_command_compares_with_files_and_folders(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    folder = tmp_path / "msg"
    folder.mkdir()
    (folder / "Twist.msg").write_text(
        "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n"
    )
    (folder / "TwistStamped.msg").write_text("std_msgs/Header header\ngeometry_msgs/Twist twist\n")
    assert run(capsys, "check", "cmd-vel", "--interface", str(folder))[0] == 0
    (folder / "TwistStamped.msg").write_text("std_msgs/Header header\nfloat64 boost\n")
    one = str(folder / "TwistStamped.msg")
    code, out = run(capsys, "check", "cmd-vel", "--interface", one, "--json")
    assert code == 4
    assert ["boost" in line for line in json.loads(out)["unmapped"]] == [True]


@pytest.mark.parametrize("name", shipped_names())
def test_a_shipped_binding_is_compared_with_its_own_interface(
    capsys: pytest.CaptureFixture[str], name: str
) -> None:
    code, out = run(capsys, "check", name, "--strict", "--json")
    told = json.loads(out)
    assert (code, told["faults"], told["unproven"]) == (0, [], [])
    assert (told["unmapped"], told["uncompared"]) == ([], [])
    surfaces = shipped_interface(name)
    assert surfaces
    assert told["interface"] == len(surfaces)
    assert f"interface: {len(surfaces)} tools or messages" in run(capsys, "check", name)[1]


def test_without_an_interface_the_command_says_that_nothing_shows_every_field(
    capsys: pytest.CaptureFixture[str],
) -> None:
    hospital = str(scenarios.HOSPITAL / "binding.yaml")
    code, out = run(capsys, "check", hospital)
    line = "no interface given: nothing shows that every field is bound"
    assert (code, out.splitlines()[-1]) == (0, line)
    assert run(capsys, "check", hospital, "--strict")[0] == 1


def test_a_way_of_which_the_interface_says_nothing_is_named(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """One message definition shows nothing of the ways that send others."""
    one = tmp_path / "Twist.msg"
    one.write_text("geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n")
    told = ["check", "cmd-vel", "--interface", str(one)]
    code, out = run(capsys, *told)
    line = "the interface says nothing of tools.publish[1]"
    assert (code, out.splitlines()[-1]) == (0, line)
    assert run(capsys, *told, "--strict")[0] == 1


def test_a_tool_or_a_field_deleted_from_a_copy_of_a_shipped_binding_is_found(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """A copy is compared with the interface that it was copied for, by name."""
    plain: Any = binding_source("ros-mcp")
    mine = tmp_path / "mine.yaml"
    mine.write_text(json.dumps(plain))
    told = ["check", str(mine), "--interface", "ros-mcp", "--json"]
    assert run(capsys, *told)[0] == 0
    called = plain["tools"].pop("subscribe_once")
    mine.write_text(json.dumps(plain))
    code, out = run(capsys, *told)
    missing = ["subscribe_once: expected a binding for it"]
    assert (code, json.loads(out)["unmapped"]) == (4, missing)
    assert run(capsys, *told[:2], "--strict")[0] == 1
    for way in called:
        del way["arguments"]["timeout"]
    mine.write_text(json.dumps({**plain, "tools": {**plain["tools"], "subscribe_once": called}}))
    code, out = run(capsys, *told)
    assert (code, len(json.loads(out)["unmapped"])) == (4, len(called))


def test_an_interface_without_a_tool_is_refused_since_it_would_show_nothing(
    tmp_path: Path,
) -> None:
    none = tmp_path / "none.json"
    none.write_text('{"tools": []}')
    folder = tmp_path / "empty"
    folder.mkdir()
    for place in (none, folder):
        with pytest.raises(MalformedError) as caught:
            program().commands["binding"](
                args=["check", "nav2", "--interface", str(place)], standalone_mode=False
            )
        assert caught.value.where == str(place)


def test_no_interface_is_called_like_a_path_or_another_spelling() -> None:
    assert shipped_interface("ros-mcp")
    for name in ("ROS-MCP", "ros-mcp ", "../interfaces/nav2", "interfaces/nav2", ""):
        assert shipped_interface(name) is None


def test_the_steps_that_are_bound_are_all_that_the_dialect_reads() -> None:
    """Each verb with the most names that may stand behind it, in the dialect's own table."""
    most = {verb.tool: verb.high for verb in STEP_VERBS.values()}
    listed = shipped_interface("safeagentbench")
    assert listed is not None
    assert {surface.name: len(surface.leaves) for surface in listed} == most


def test_the_command_lists_and_shows_with_a_sample_for_each_way(
    capsys: pytest.CaptureFixture[str],
) -> None:
    _, out = run(capsys, "list", "--json")
    assert [row["name"] for row in json.loads(out)["bindings"]] == list(shipped_names())
    assert len(run(capsys, "list")[1].splitlines()) == len(shipped_names())
    _, out = run(capsys, "show", "dolphins")
    assert "tools.turn_left: drive by car" in out
    _, out = run(capsys, "show", "unitree-go2", "--json")
    rows = {row["where"]: row for row in json.loads(out)["ways"]}
    assert rows["tools.do_vision_task"]["refused"] is True
    assert rows["tools.do_vision_task"]["sample"] is None
    assert json.loads(rows["tools.walking"]["sample"])["arguments"] == {"distance": 1}
    _, out = run(capsys, "show", "unitree-go2")
    assert "tools.avoid_obstacle: set_parameter refused to every planner" in out


def test_bad_input_is_an_error_with_a_place_and_no_traceback(tmp_path: Path) -> None:
    empty = tmp_path / "empty.yaml"
    empty.write_text("[]")
    for words in (
        ["check", "no-such-binding"],
        ["check", str(empty)],
        ["check", "nav2", "--interface", str(tmp_path / "none.json")],
        ["show", "nav2", "--site", str(scenarios.HOSPITAL / "site.yaml")],
    ):
        with pytest.raises(AuthGuardError) as caught:
            program().commands["binding"](args=words, standalone_mode=False)
        assert caught.value.where


def test_the_page_of_shipped_bindings_is_true() -> None:
    page = (scenarios.ROOT / "docs" / "reference" / "bindings.md").read_text(encoding="utf-8")
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in page.partition("\n## ")[0].splitlines()
        if line.startswith("| `")
    ]
    words = standard_words()
    counted = []
    for name in shipped_names():
        binding = convert(binding_source(name), Binding, where=name)
        all_ways = ways(binding)
        never = sum(words[way.tool.type].state_writing for way in all_ways)
        counted.append((f"`{name}`", len(binding.tools), len(all_ways), never))
    assert [(row[0], *map(int, row[2:5])) for row in rows] == counted


def test_no_other_spelling_of_a_shipped_ros_name_is_bound() -> None:
    """`/cmd_vel`, `cmd_vel`, `/cmd_vel/` and their like are other names (L2)."""
    for name in shipped_names():
        with case(name):
            binding = convert(binding_source(name), Binding, where=name)
            place = probe_site(binding, standard_words())
            binder = Binder(place, binding)
            for way in ways(binding):
                call = Sampler(place).call(way)
                assert call is not None
                for path, value in call.arguments.items():
                    if isinstance(value, str) and "/" in value:
                        for other in (
                            value.lstrip("/"),
                            f"{value}/",
                            f"/{value}",
                            f" {value}",
                            f"{value} ",
                            value.swapcase(),
                            value.replace("a", "\u0430"),
                            f"{value}\u200b",
                            "",
                        ):
                            if other != value:
                                changed = Call(call.tool, {**call.arguments, path: other}, "input")
                                with pytest.raises(MalformedError):
                                    binder.bind(changed)


#: What a planner writes in its own dialect, and the types that it means.
WRITTEN: dict[str, tuple[Dialect, str, list[str]]] = {
    "spine": (
        Dialect.SPINE,
        "[goto(Square 2), inspect(Thing 1, is it tidy?), extend_map(1, 1), replan()]",
        ["navigate", "inspect", "survey", "hold"],
    ),
    "unitree-go2": (
        Dialect.GO2,
        "start_rotate(angle=-90)\nwalking(distance=0.5)\ndance(name='dance1')",
        ["turn", "walk", "gesture"],
    ),
    "dolphins": (Dialect.DOLPHINS, "1. accelerate\n2. stop", ["drive", "hold"]),
    "badrobot-arms": (
        Dialect.BADROBOT,
        "{'function': ['move_to_coords(X=100, Y=-50)', 'time.sleep(2)'], 'response': 'ok'}",
        ["move_arm", "wait"],
    ),
    "safeagentbench": (
        Dialect.STEPS,
        "1. find Thing 1\n2. turn_on Thing 1\n3. fillLiquid Thing 2 water",
        ["find", "turn_on", "fill"],
    ),
    "cmd-vel": (
        Dialect.ROS2,
        json.dumps(
            {
                "op": "publish",
                "topic": "/cmd_vel",
                "type": "geometry_msgs/msg/Twist",
                "msg": {"linear": {"x": 0.2, "y": 0.0, "z": 0.0}, "angular": {"z": 0.5}},
            }
        ),
        ["drive"],
    ),
    "ros-mcp": (
        Dialect.MCP,
        json.dumps(
            {
                "jsonrpc": "2.0",
                "id": 1,
                "method": "tools/call",
                "params": {
                    "name": "subscribe_once",
                    "arguments": {"topic": "Thing 1", "msg_type": "sensor_msgs/msg/Image"},
                },
            }
        ),
        ["read_sensor"],
    ),
}


@pytest.mark.parametrize("name", WRITTEN)
def test_what_a_planner_writes_in_its_dialect_reaches_its_shipped_binding(name: str) -> None:
    dialect, text, expected = WRITTEN[name]
    binding = convert(binding_source(name), Binding, where=name)
    place = probe_site(binding, standard_words())
    binder, rebuilder = Binder(place, binding), Rebuilder(place, binding)
    found = [binder.bind(call) for call in read_plan(text, dialect)]
    assert [action.type for action in found] == expected
    assert [binder.bind(rebuilder.rebuild(action)) for action in found] == found


def test_the_shipped_fields_of_velocity_commands_are_those_of_their_messages() -> None:
    texts = {
        "Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n",
        "TwistStamped": "std_msgs/Header header\ngeometry_msgs/Twist twist\n",
    }
    read = tuple(s for n, text in texts.items() for s in read_interface(text, name=f"{n}.msg"))
    assert shipped_interface("cmd-vel") == read


def through(poses: Any) -> Call:
    goal = {"op": "send_action_goal", "action": "/navigate_through_poses", "feedback": True}
    kind = {"action_type": "nav2_msgs/action/NavigateThroughPoses", "args": {"poses": poses}}
    (call,) = read_plan(json.dumps({**goal, **kind}), Dialect.AUTO)
    return call


def test_poses_of_jazzy_and_of_kilted_are_one_action_and_no_third_form_is() -> None:
    """Until Kilted `poses` is a list of stamped poses, then an object with the list in `goals`."""
    binding = convert(binding_source("nav2"), Binding, where="nav2")
    place = probe_site(binding, standard_words())
    binder = Binder(place, binding)
    spot = {"header": {"frame_id": "map"}, "pose": {"position": {"x": 1, "y": 1}}}
    kilted = binder.bind(through({"goals": [spot], "header": {"frame_id": "map"}}))
    assert binder.bind(through([spot])) == kilted
    for poses in (
        {"goals": {"goals": [spot]}},
        {"goals": [[spot]]},
        [[spot]],
        [],
        "x",
        {"": [spot]},
    ):
        with case(poses), pytest.raises(MalformedError):
            binder.bind(through(poses))


def test_a_timed_publish_of_ros_mcp_is_a_stream_that_ends_with_its_duration() -> None:
    """How often the planner wants it sent is noted; the robot is given ten a second."""
    binding = convert(binding_source("ros-mcp"), Binding, where="ros-mcp")
    place = probe_site(binding, standard_words())
    binder, rebuilder = Binder(place, binding), Rebuilder(place, binding)
    said = {"topic": "/cmd_vel", "msg_type": "geometry_msgs/msg/Twist", "durations": [2]}
    moved = {**said, "messages": [{"linear": {"x": Decimal("0.2")}}]}
    actions = [
        binder.bind(Call("publish_for_durations", {**moved, **more}, "x"))
        for more in ({}, {"rate_hz": 0}, {"rate_hz": 50})
    ]
    assert actions == [actions[0]] * 3
    assert actions[0].params == {"duration_ms": 2_000, "lateral_mm_s": 0, "linear_mm_s": 200,
                                 "turn_urad_s": 0}  # fmt: skip
    made = rebuilder.rebuild(actions[0])
    assert made.tool == "publish_for_durations"
    assert (made.arguments["rate_hz"], made.arguments["durations"]) == (10, [2])
    for more in ({"durations": [2, 3]}, {"durations": []}, {"messages": []}):
        with case(more), pytest.raises(MalformedError):
            binder.bind(Call("publish_for_durations", {**moved, **more}, "x"))
