# SPDX-License-Identifier: Apache-2.0
"""A scene graph becomes squares and ways that never overlap, or is refused with its place."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from authguard_r.authoring.site.proposal import UNKNOWN_MASS_G, SiteProposal, to_yaml
from authguard_r.authoring.site.scene import MOST, import_scene
from authguard_r.core.errors import MalformedError
from authguard_r.site.check import faults, unreviewed
from authguard_r.site.places import adjacent
from authguard_r.site.source import parse_site
from fixtures.amount import amount
from fixtures.cases import case

ROOT = Path(__file__).resolve().parents[3]
PERCH = ROOT.parent / "shared" / "external" / "roboguard" / "perch_small.json"

GRAPH: dict[str, Any] = {
    "regions": [
        {"name": "Hall 1", "coords": [0, 0]},
        {"name": "Hall 2", "coords": [4.0, 1]},
        {"name": "yard", "coords": [0.25, -3.5]},
    ],
    "objects": [
        {"name": "lamp_1", "coords": [0.1, 0]},
        {"name": "lamp_2", "coords": [9, 9]},
    ],
    "object_connections": [["lamp_1", "Hall 1"]],
    "region_connections": [["Hall 1", "Hall 2"], ["yard", "Hall 1"]],
}


def imported(graph: Any, radius_mm: int = 500) -> SiteProposal:
    text = graph if isinstance(graph, str) else json.dumps(graph)
    return import_scene(text, site="scene", floor=3, radius_mm=radius_mm, where="g")


def refused(graph: Any, radius_mm: int = 500) -> MalformedError:
    with pytest.raises(MalformedError) as caught:
        imported(graph, radius_mm)
    return caught.value


def test_places_become_squares_and_connections_become_ways_with_a_door_at_each_end() -> None:
    site = imported(GRAPH).site
    assert list(site.regions) == ["hall-1", "hall-2", "yard", "way-1", "way-2"]
    hall = site.regions["hall-1"]
    assert hall.points == ((-500, -500), (500, -500), (500, 500), (-500, 500))
    assert (hall.names, hall.floor, hall.tags) == (("Hall 1",), 3, ("unreviewed",))
    assert site.regions["way-1"].points == ((500, -250), (3500, 750), (3500, 1250), (500, 250))
    assert [(d.between, d.at) for d in site.doors] == [
        (("hall-1", "way-1"), (500, 0)),
        (("hall-2", "way-1"), (3500, 1000)),
        (("yard", "way-2"), (250, -3000)),
        (("hall-1", "way-2"), (0, -500)),
    ]
    assert {pair.between for pair in adjacent(site)} == {
        ("hall-1", "way-1"),
        ("hall-2", "way-1"),
        ("hall-1", "way-2"),
        ("way-2", "yard"),
    }


def test_what_nobody_knows_is_not_made_up() -> None:
    proposal = imported({**GRAPH, "extra_safe_objects": [{"any": 1}], "current_location": "yard"})
    site = proposal.site
    assert set(site.objects) == {"lamp_1"}
    lamp = site.objects["lamp_1"]
    assert (lamp.kind, lamp.home, lamp.mass_g) == ("unreviewed", "hall-1", UNKNOWN_MASS_G)
    assert site.robots == site.vocabulary == {}
    assert len(unreviewed(site)) == len(site.regions) + 1
    told = "\n".join(proposal.missing)
    for word in ("lamp_2", "extra_safe_objects", "current_location", "robots", "vocabulary"):
        assert word in told
    assert "objects" not in "\n".join(imported({"regions": GRAPH["regions"]}).missing)


def test_the_file_that_is_written_reads_as_the_same_site_and_says_what_is_missing() -> None:
    proposal = imported(GRAPH)
    text = to_yaml(proposal, where="g")
    assert parse_site(text, where="x") == proposal.site
    assert all(f"#   {line}\n" in text for line in proposal.missing)


def test_a_connection_counts_once_whichever_way_round_it_is_written() -> None:
    both = [["Hall 1", "Hall 2"], ["Hall 2", "Hall 1"], ["Hall 1", "Hall 2"]]
    assert len(imported({**GRAPH, "region_connections": both}).site.doors) == 2


def test_neighbors_that_are_near_get_smaller_squares() -> None:
    near = [{"name": "a", "coords": [0, 0]}, {"name": "b", "coords": [0, 0.7]}]
    site = imported({"regions": near, "region_connections": [["a", "b"]]}).site
    assert site.regions["a"].points[0] == (-280, -280)
    assert faults(site) == ()


def test_ways_that_leave_by_one_side_fan_out() -> None:
    star = [{"name": "hub", "coords": [0, 0]}]
    star += [{"name": f"s{n + 4}", "coords": [6, n]} for n in (-4, -2, 0, 2, 4)]
    pairs = [["hub", node["name"]] for node in star[:0:-1]]
    site = imported({"regions": star, "region_connections": pairs}).site
    assert len(site.regions) == 6 + 5


#: The graph changed in one way, and where it is refused.
BROKEN: dict[str, tuple[Any, str]] = {
    "no JSON": ("{", "g"),
    "a list": ("[]", "g"),
    "not a number": ('{"regions": [{"name": "a", "coords": [NaN, 0]}]}', "g"),
    "a key twice": ('{"regions": [], "regions": []}', "g"),
    "deep nesting": ("[" * 100_000, "g"),
    "a huge integer": ('{"regions": ' + "9" * 5000 + "}", "g"),
    "an unknown field": ({**GRAPH, "walls": []}, "g"),
    "no regions": ({"objects": []}, "g"),
    "an unknown field of a node": (
        {"regions": [{"name": "a", "coords": [0, 0], "level": 1}]},
        "g:regions[0]",
    ),
    "a coordinate of three": ({"regions": [{"name": "a", "coords": [0, 0, 0]}]}, "g:regions[0]"),
    "a coordinate that is a word": (
        {"regions": [{"name": "a", "coords": [0, "1"]}]},
        "g:regions[0].coords[1]",
    ),
    "a coordinate that is a truth value": (
        {"regions": [{"name": "a", "coords": [True, 0]}]},
        "g:regions[0].coords[0]",
    ),
    "a coordinate beyond any site": (
        {"regions": [{"name": "a", "coords": [1e300, 0]}]},
        "g:regions[0].coords[0]",
    ),
    "an infinite coordinate": (
        '{"regions": [{"name": "a", "coords": [0, 1e999]}]}',
        "g:regions[0].coords[1]",
    ),
    "too many": ({"regions": [{"name": "a", "coords": [0, 0]}] * (MOST + 1)}, "g:regions"),
    "a name without letters": (
        {"regions": [{"name": "\u4e2d", "coords": [0, 0]}]},
        "g:regions[0].name",
    ),
    "a name too long": ({"regions": [{"name": "a" * 65, "coords": [0, 0]}]}, "g:regions[0].name"),
    "a name twice": (
        {**GRAPH, "regions": [*GRAPH["regions"], {"name": "yard", "coords": [9, 9]}]},
        "g:regions[3].name",
    ),
    "names that look alike": (
        {**GRAPH, "regions": [*GRAPH["regions"], {"name": "hall_1", "coords": [9, 9]}]},
        "g:regions[3].name",
    ),
    "a region named like a way": (
        {**GRAPH, "regions": [*GRAPH["regions"], {"name": "Way 1", "coords": [9, 9]}]},
        "g",
    ),
    "two regions in one place": (
        {**GRAPH, "regions": [*GRAPH["regions"], {"name": "b", "coords": [0.25, -3.5]}]},
        "g:regions[2].coords",
    ),
    "a connection to nowhere": (
        {**GRAPH, "region_connections": [["yard", "Hall 3"]]},
        "g:region_connections[0]",
    ),
    "a connection to itself": (
        {**GRAPH, "region_connections": [["yard", "yard"]]},
        "g:region_connections[0]",
    ),
    "an object's connection the wrong way round": (
        {**GRAPH, "object_connections": [["Hall 1", "lamp_1"]]},
        "g:object_connections[0]",
    ),
    "an object in no region of the graph": (
        {**GRAPH, "object_connections": [["lamp_1", "Hall 3"]]},
        "g:object_connections[0]",
    ),
    "an object in two regions": (
        {**GRAPH, "object_connections": [["lamp_1", "Hall 1"], ["lamp_1", "yard"]]},
        "g:object_connections[1]",
    ),
    "ways that cross": (
        {
            "regions": [
                {"name": name, "coords": at}
                for name, at in (("a", [0, 0]), ("b", [5, 5]), ("c", [5, 0]), ("d", [0, 5]))
            ],
            "region_connections": [["a", "b"], ["c", "d"]],
        },
        "g:regions.way-2.points",
    ),
    "a way through a third region": (
        {
            "regions": [{"name": f"r{n}", "coords": [3 * n, 0]} for n in range(3)],
            "region_connections": [["r0", "r2"]],
        },
        "g:regions.way-1.points",
    ),
}


def test_a_graph_with_one_fault_is_refused_in_its_place() -> None:
    for name, (graph, where) in BROKEN.items():
        with case(name):
            error = refused(graph)
            assert error.where.startswith(where)
            assert error.message.isascii()


def test_a_single_region_without_room_is_refused() -> None:
    error = refused({"regions": [{"name": "a", "coords": [0, 0]}]}, radius_mm=99)
    assert error.where == "g:regions[0].coords"


def test_more_ways_than_a_side_has_room_for_are_refused() -> None:
    hub = [{"name": "hub", "coords": [0, 0]}, {"name": "x", "coords": [0, -0.25]}]
    far = [{"name": f"f{n + 20}", "coords": [50, n]} for n in range(-12, 12)]
    pairs = [["hub", node["name"]] for node in far]
    error = refused({"regions": [*hub, *far], "region_connections": pairs})
    assert error.where.startswith("g:region_connections[")
    error = refused({"regions": [*hub, *far], "region_connections": [p[::-1] for p in pairs]})
    assert error.where.startswith("g:region_connections[")


@settings(max_examples=amount(25, 60))
@given(
    st.lists(st.tuples(st.integers(-9, 9), st.integers(-9, 9)), min_size=1, max_size=8),
    st.lists(st.tuples(st.integers(0, 7), st.integers(0, 7)), max_size=8),
)
def test_any_graph_is_a_sound_site_or_a_refusal_with_a_place(
    places: list[tuple[int, int]], pairs: list[tuple[int, int]]
) -> None:
    graph = {
        "regions": [{"name": f"r{n}", "coords": at} for n, at in enumerate(places)],
        "region_connections": [[f"r{a}", f"r{b}"] for a, b in pairs],
    }
    places_of_refusals: list[str] = []
    try:
        proposal = imported(graph)
    except MalformedError as error:
        places_of_refusals.append(error.where)
    else:
        assert parse_site(to_yaml(proposal, where="g"), where="x") == proposal.site
        assert faults(proposal.site) == ()
    assert all(where.startswith("g:") for where in places_of_refusals)


@pytest.mark.external
@pytest.mark.skipif(not PERCH.is_file(), reason=f"no public test data at {PERCH}")
def test_a_published_scene_graph_becomes_a_sound_site() -> None:
    proposal = imported(PERCH.read_text(encoding="utf-8"))
    site = proposal.site
    graph = json.loads(PERCH.read_text(encoding="utf-8"))
    names = {name for model in site.regions.values() for name in model.names}
    assert names == {node["name"] for node in graph["regions"]}
    assert len(site.doors) == 2 * len(graph["region_connections"])
    assert set(site.objects) == {item for item, _ in graph["object_connections"]}
    assert any("television_1" in line for line in proposal.missing)
    assert parse_site(to_yaml(proposal, where="g"), where="x") == site
