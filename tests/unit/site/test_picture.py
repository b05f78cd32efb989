# SPDX-License-Identifier: Apache-2.0
"""The map that a person signs by: every text escaped, the same bytes for the same site."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import msgspec
from hypothesis import given, settings
from hypothesis import strategies as st

from authguard_r.authoring.site.picture import picture
from authguard_r.site.model import Region, Site
from fixtures import scenarios
from fixtures.amount import amount

replace = msgspec.structs.replace
SVG = "{http://www.w3.org/2000/svg}"


def drawn(site: Site) -> ET.Element:
    return ET.fromstring(picture(site))


def words(site: Site) -> list[str]:
    return [element.text or "" for element in drawn(site).iter(f"{SVG}text")]


def test_every_region_door_object_and_robot_of_the_hospital_is_on_the_map() -> None:
    site = scenarios.site()
    root, told = drawn(site), words(site)
    assert len(root.findall(f"{SVG}polygon")) == len(site.regions)
    titles = [element.text or "" for element in root.iter(f"{SVG}title")]
    for region, model in site.regions.items():
        assert model.names[0] in told
        assert any(title.startswith(f"{region}: ") for title in titles)
    assert {"package-p1", "sharps-bin", "robot courier-1", "robot lifter-1"} <= set(told)
    assert sum(" - " in title for title in titles) == len(site.doors)
    assert "isolation-room - public-corridor (isolation_door_open)" in titles
    assert {"main, floor 1", "5 m", "hazardous", "door with sensor"} <= set(told)


def test_the_same_site_gives_the_same_bytes_in_whatever_order_it_was_written() -> None:
    site = scenarios.site()
    turned = replace(site, regions=dict(reversed(site.regions.items())))
    assert picture(site) == picture(replace(site))
    assert sorted(picture(turned).splitlines()) == sorted(picture(site).splitlines())


def test_north_is_up_and_nothing_leaves_the_picture() -> None:
    root = drawn(scenarios.site())
    _, _, width, height = map(int, root.attrib["viewBox"].split())
    tops = {}
    for polygon in root.findall(f"{SVG}polygon"):
        corners = [tuple(map(int, c.split(","))) for c in polygon.attrib["points"].split()]
        assert all(0 <= x <= width and 0 <= y <= height for x, y in corners)
        tops[(polygon[0].text or "").partition(":")[0]] = min(y for _, y in corners)
    assert tops["staff-corridor"] < tops["public-corridor"] < tops["office-1"]


def test_each_floor_has_a_panel_of_its_own() -> None:
    site = scenarios.site()
    upper = replace(site.regions["dock"], floor=2, names=("Roof",))
    two = replace(site, regions={**site.regions, "roof": upper})
    told = words(two)
    assert {"main, floor 1", "main, floor 2", "Roof"} <= set(told)
    assert len(set(told)) > len(set(words(site)))


def test_a_name_cannot_draw_or_load_anything() -> None:
    """The attack: a name that is markup, in a picture that a browser opens."""
    name = '</text><script href="http://x/">alert(1)</script>&amp;'
    dock = replace(scenarios.site().regions["dock"], names=(name,))
    site = replace(scenarios.site(), regions={"dock": dock}, doors=())
    text = picture(site)
    assert "<script" not in text
    assert text.count("http") == 1 + 2 * name.count("http")  # the name space, and escaped text
    assert name in words(site)
    assert not list(drawn(site).iter(f"{SVG}script"))


@settings(max_examples=amount(25, 100))
@given(st.text(max_size=20), st.integers(1, 10**9))
def test_any_name_and_any_size_is_a_picture(name: str, side: int) -> None:
    region = Region(
        map="m",
        floor=0,
        points=((0, 0), (side, 0), (side, side), (0, side)),
        approach=(0, 0),
        tags=("t",),
        names=(name,),
    )
    site = replace(scenarios.site(), regions={"r": region}, doors=(), objects={}, robots={})
    assert drawn(site).tag == f"{SVG}svg"
    picture(site).encode()


def test_a_site_without_regions_has_a_legend_only() -> None:
    site = replace(scenarios.site(), regions={}, doors=(), objects={}, robots={})
    assert drawn(site).findall(f"{SVG}polygon") == []
