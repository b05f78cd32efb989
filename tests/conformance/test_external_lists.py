# SPDX-License-Identifier: Apache-2.0
"""Tool lists that nobody here wrote: each becomes a set-up in which nothing is left unrefused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from authguard_r.authoring.binding.check import check_binding
from authguard_r.authoring.onboarding.listing import Source
from authguard_r.authoring.onboarding.skeleton import Skeleton, make_skeleton
from authguard_r.core.identifiers import RobotId
from authguard_r.normalize.binding import Binding
from authguard_r.normalize.interface import read_interface
from authguard_r.site.source import convert, read_yaml

ROOT = Path(__file__).resolve().parent.parent.parent
EXTERNAL = ROOT.parent / "shared" / "external"

pytestmark = [
    pytest.mark.external,
    pytest.mark.skipif(not EXTERNAL.is_dir(), reason=f"no public test data at {EXTERNAL}"),
]


def made(text: str, source: Source) -> Skeleton:
    return make_skeleton(text, source=source, robot=RobotId("robot-1"), where="list")


@pytest.mark.parametrize(
    ("name", "source", "tools"),
    [
        ("ros_mcp/tools_list_ros-mcp-3.1.2.json", Source.MCP, 31),
        ("bfcl/vehicle_control.json", Source.OPENAI, 22),
    ],
)
def test_a_real_list_is_refused_whole_and_nothing_is_unmapped(
    name: str, source: Source, tools: int
) -> None:
    text = (EXTERNAL / name).read_text(encoding="utf-8")
    skeleton = made(text, source)
    report = skeleton.report
    assert (report.tools, report.unmapped, report.uncompared, report.faults) == (tools, (), (), ())
    assert report.fields["mapped"] == report.fields["noted"] == report.fields["fixed"] == 0
    binding = convert(read_yaml(skeleton.binding, where="b"), Binding, where="b")
    first = read_interface(text, name=name)
    assert check_binding(binding, skeleton.model, interface=first).faults == ()


def test_every_goal_and_request_of_a_navigation_stack_is_refused_field_by_field() -> None:
    files = sorted((EXTERNAL / "nav2_msgs").glob("*.*"))
    types = {
        f"nav2_msgs/{path.suffix[1:]}/{path.stem}": path.read_text(encoding="utf-8")
        for path in files
        if path.suffix in {".action", ".srv"}
    }
    graph = {
        "actions": {f"/{t.split('/')[2]}_a": t for t in types if "/action/" in t},
        "services": {f"/{t.split('/')[2]}_s": t for t in types if "/srv/" in t},
        "types": types,
    }
    skeleton = made(json.dumps(graph), Source.ROS)
    report = skeleton.report
    assert report.ways == len(types) == len(graph["actions"]) + len(graph["services"])
    assert (report.unmapped, report.faults) == ((), ())
    binding = convert(read_yaml(skeleton.binding, where="b"), Binding, where="b")
    for path in files:
        if path.suffix in {".action", ".srv"}:
            text = path.read_text(encoding="utf-8")
            surfaces = read_interface(text, name=path.name)
            found = check_binding(binding, skeleton.model, interface=surfaces)
            assert found.unmapped == ()
