# SPDX-License-Identifier: Apache-2.0
"""Every fault of a site model alone, with its place; and the shipped site has none."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec
import pytest

from authguard_r.core.provenance import Label
from authguard_r.site import places
from authguard_r.site.check import SiteFault, faults
from authguard_r.site.model import (
    ActionModel,
    Door,
    EmergencyPlaces,
    ObjectModel,
    Parameter,
    Person,
    Region,
    Robot,
    Rounding,
    Site,
    site_digest,
)
from authguard_r.site.model import PersonRole as Role
from authguard_r.site.names import MOST_CHARACTERS, MOST_NAMES
from authguard_r.site.places import MOST_DEPTH, MOST_DOORS, MOST_OVERLAPS, MOST_PAIRS, MOST_REGIONS
from fixtures import scenarios
from fixtures.cases import case
from fixtures.time_bounds import at_most

replace = msgspec.structs.replace


def site(**changes: Any) -> Site:
    return replace(scenarios.site(), **changes)


def region(name: str, **changes: Any) -> Site:
    """Return the site with one region changed, or added in the likeness of the dock."""
    regions = scenarios.site().regions
    return site(regions={**regions, name: replace(regions.get(name, regions["dock"]), **changes)})


def added(name: str, **changes: Any) -> Site:
    """Return the site with one region more, alone on its floor."""
    return region(name, **{"names": (), "floor": 9, **changes})


def thing(name: str, **changes: Any) -> Site:
    objects = scenarios.site().objects
    bare = ObjectModel(kind="medicine", home="pharmacy", mass_g=1)
    return site(objects={**objects, name: replace(objects.get(name, bare), **changes)})


def robot(name: str, *, tools: dict[str, tuple[str, ...]] | None = None, **changes: Any) -> Site:
    robots = scenarios.site().robots
    base: Robot = robots.get(name, robots["courier-1"])
    if tools is not None:
        changes["profile"] = replace(base.profile, tools={**base.profile.tools, **tools})
    return site(robots={**robots, name: replace(base, **changes)})


def kind(name: str, **changes: Any) -> Site:
    vocabulary = scenarios.site().vocabulary
    base = vocabulary.get(name, ActionModel(fields=()))
    return site(vocabulary={**vocabulary, name: replace(base, **changes)})


def speed(**changes: Any) -> Site:
    params = scenarios.site().vocabulary["navigate"].params
    return kind("navigate", params={"speed_mm_s": replace(params["speed_mm_s"], **changes)})


def parameter(name: str, unit: str) -> Site:
    """Return the site with a type of one parameter."""
    return kind("hum", params={name: replace(BYTES, unit=unit)})


def doors(*more: Door) -> Site:
    return site(doors=(*scenarios.site().doors, *more))


def person(*names: str) -> Person:
    return Person(roles=(Role.OPERATOR,), names=names)


def square(x: int, y: int, side: int = 2000) -> Any:
    return ((x, y), (x + side, y), (x + side, y + side), (x, y + side))


NEW = len(scenarios.site().doors)
BYTES = Parameter(unit="byte", low=1, high=9, rounding=Rounding.COUNT, required=True)

#: One entry for each rule: the site with one fault, its place, and what the message expects.
BROKEN: dict[str, tuple[Callable[[], Site], str, str]] = {
    "region twin, underscore": (lambda: added("plant_room"), "regions.plant_room", "`plant-room`"),
    "region twin, no mark": (
        lambda: added("station101"),
        "regions.station101",
        "`station-101`",
    ),
    "region twin, dot": (lambda: added("office.1"), "regions.office.1", "`office-1`"),
    "region twin, colon": (lambda: added("office:1"), "regions.office:1", "`office-1`"),
    "object twin": (lambda: thing("package_p1"), "objects.package_p1", "`package-p1`"),
    "robot twin": (lambda: robot("courier.1"), "robots.courier.1", "`courier-1`"),
    "type twin": (lambda: kind("take-photo"), "vocabulary.take-photo", "`take_photo`"),
    "a region's name is another's": (
        lambda: region("office-1", names=("Office 1", "Corridor")),
        "regions.office-1.names",
        "`Corridor` of `public-corridor`",
    ),
    "a region's name is another's id": (
        lambda: region("staff-corridor", names=("dock",)),
        "regions.dock.names",
        "`dock` of `staff-corridor`",
    ),
    "an object's name is another's": (
        lambda: thing("sharps-bin", names=("P1",)),
        "objects.sharps-bin.names",
        "`P1` of `package-p1`",
    ),
    "a unit that is not the name's": (
        lambda: parameter("speed_mm_s", "cm/s"),
        "vocabulary.hum.params.speed_mm_s.unit",
        "expected `mm/s`, as the name ends in `mm_s`, got `cm/s`",
    ),
    "a unit of another power of ten": (
        lambda: parameter("speed_mm_s", "m/s"),
        "vocabulary.hum.params.speed_mm_s.unit",
        "`mm/s`",
    ),
    "a unit of another dimension": (
        lambda: parameter("force_mn", "mm"),
        "vocabulary.hum.params.force_mn.unit",
        "`mN`",
    ),
    "a unit that nobody knows": (
        lambda: parameter("speed", "furlong/h"),
        "vocabulary.hum.params.speed.unit",
        "a name that ends in its unit",
    ),
    "a known unit that the name does not say": (
        lambda: parameter("speed", "mm/s"),
        "vocabulary.hum.params.speed.unit",
        "a name that ends in its unit",
    ),
    "an ending within a word": (
        lambda: parameter("programs", "ms"),
        "vocabulary.hum.params.programs.unit",
        "a name that ends in its unit",
    ),
    "a channel that is nobody's name": (
        lambda: site(channels={"lidar.text": Label.CAMERA}),
        "channels.lidar.text",
        "a-z, 0-9 and `_`",
    ),
    "a channel of text that claims authority": (
        lambda: site(channels={"intercom": Label.OPERATOR}),
        "channels.intercom",
        "expected model, memory, retrieval, audio, camera, got `operator`",
    ),
    "a shipped channel that is trusted more": (
        lambda: site(channels={"camera": Label.MODEL}),
        "channels.camera",
        "expected camera, got `model`",
    ),
    "corners on a line": (
        lambda: added("dock-2", points=((34000, 0), (36000, 0), (38000, 0))),
        "regions.dock-2.points",
        "enclose an area",
    ),
    "corners on one point": (
        lambda: added("dock-2", points=((36000, 1500),) * 3),
        "regions.dock-2.points",
        "enclose an area",
    ),
    "approach outside": (
        lambda: region("plant-room", approach=(25999, -3000)),
        "regions.plant-room.approach",
        "inside",
    ),
    "a region's name in another case": (
        lambda: region("dock", names=("corridor",)),
        "regions.dock.names",
        "cannot be taken for `Corridor` of `public-corridor`",
    ),
    "an empty name": (lambda: region("dock", names=("",)), "regions.dock.names[0]", "not empty"),
    "a blank name": (
        lambda: region("dock", names=("Dock", "\u2003 ")),
        "regions.dock.names[1]",
        "not empty",
    ),
    "a padded name": (
        lambda: thing("sharps-bin", names=("Sharps Bin ",)),
        "objects.sharps-bin.names[0]",
        "no space around `Sharps Bin `",
    ),
    "a name that turns the line round": (
        lambda: region("dock", names=("Dock\u202etac",)),
        "regions.dock.names[0]",
        "printable characters, got `Dock\\u202etac`",
    ),
    "a name twice": (
        lambda: region("dock", names=("Dock", "Dock")),
        "regions.dock.names[1]",
        "each name once",
    ),
    "a person's name is another's": (
        lambda: site(people={"ann": person("Ann Lee"), "ben": person("ANN LEE")}),
        "people.ben.names",
        "`Ann Lee` of `ann`",
    ),
    "people twins": (
        lambda: site(people={"ann-1": person(), "ann.l": person()}),
        "people.ann.l",
        "`ann-1`",
    ),
    "a person without a role": (
        lambda: site(people={"ann": Person(roles=())}),
        "people.ann.roles",
        "at least one",
    ),
    "roles not sorted": (
        lambda: site(people={"ann": Person(roles=(Role.SUPERVISOR, Role.OPERATOR))}),
        "people.ann.roles",
        "sorted",
    ),
    "an unknown parent": (
        lambda: added("nook", within="cellar"),
        "regions.nook.within",
        "`cellar`",
    ),
    "its own parent": (
        lambda: added("nook", within="nook"),
        "regions.nook.within",
        "within itself",
    ),
    "a parent on another floor": (
        lambda: added("nook", within="dock"),
        "regions.nook.within",
        "the floor of `dock`",
    ),
    "a child that looks out of its parent": (
        lambda: added(
            "nook", within="dock", floor=1, points=square(36001, 0), approach=(37000, 1000)
        ),
        "regions.nook.within",
        "inside `dock`",
    ),
    "two regions that overlap by a millimeter": (
        lambda: added("nook", floor=1, points=square(37999, 0), approach=(38500, 1000)),
        "regions.nook.points",
        "no area in common with `dock`",
    ),
    "one region twice": (
        lambda: added("nook", floor=1),
        "regions.nook.points",
        "no area in common with `dock`",
    ),
    "a region within a region that does not say so": (
        lambda: added("nook", floor=1, points=square(35000, 500)),
        "regions.nook.points",
        "or `within`",
    ),
    "a door from a region to itself": (
        lambda: doors(Door(between=("dock", "dock"), at=(34000, 1500))),
        f"doors[{NEW}].between",
        "`dock` twice",
    ),
    "a door between maps": (
        lambda: replace(
            added("nook", map="annex"),
            doors=(*scenarios.site().doors, Door(between=("dock", "nook"), at=(36000, 1500))),
        ),
        f"doors[{NEW}].between",
        "one map",
    ),
    "a door in the middle of parent and child": (
        lambda: replace(
            added("nook", floor=1, points=square(35000, 500), within="dock"),
            doors=(*scenarios.site().doors, Door(between=("dock", "nook"), at=(35500, 1000))),
        ),
        f"doors[{NEW}].at",
        "the edge of `dock` or `nook`",
    ),
    "an emergency place that is none": (
        lambda: site(emergency=EmergencyPlaces(places={"cellar": "charging"})),
        "emergency.places.cellar",
        "region of this site",
    ),
    "a baseline not sorted": (
        lambda: replace(kind("a", moves=False), baseline=("announce", "a")),
        "baseline",
        "sorted set",
    ),
    "a baseline of a type twice": (
        lambda: site(baseline=("announce", "announce")),
        "baseline",
        "sorted set",
    ),
    "a baseline of an unknown type": (
        lambda: site(baseline=("read_minds",)),
        "baseline[0]",
        "`read_minds`",
    ),
    "a baseline that moves": (
        lambda: replace(kind("roll", moves=True), baseline=("roll",)),
        "baseline[0]",
        "`roll`",
    ),
    "a baseline with a field": (
        lambda: replace(kind("look", fields=("object",)), baseline=("look",)),
        "baseline[0]",
        "`look`",
    ),
    "a baseline with a parameter": (
        lambda: replace(kind("look", params={"max_bytes": BYTES}), baseline=("look",)),
        "baseline[0]",
        "`look`",
    ),
    "no tags": (lambda: region("dock", tags=()), "regions.dock.tags", "at least one"),
    "tags not sorted": (
        lambda: region("dock", tags=("staff", "public")),
        "regions.dock.tags",
        "sorted",
    ),
    "a tag twice": (lambda: region("dock", tags=("staff", "staff")), "regions.dock.tags", "sorted"),
    "door to an unknown region": (
        lambda: doors(Door(between=("dock", "cellar"), at=(34000, 1500))),
        f"doors[{NEW}].between",
        "`cellar`",
    ),
    "door from an unknown region": (
        lambda: doors(Door(between=("cellar", "dock"), at=(34000, 1500))),
        f"doors[{NEW}].between",
        "`cellar`",
    ),
    "door away from one side": (
        lambda: doors(Door(between=("dock", "public-corridor"), at=(33999, 1500))),
        f"doors[{NEW}].at",
        "`dock`",
    ),
    "an object's home": (
        lambda: thing("sharps-bin", home="cellar"),
        "objects.sharps-bin.home",
        "`cellar`",
    ),
    "fields not sorted": (
        lambda: kind("pick", fields=("source", "object")),
        "vocabulary.pick.fields",
        "sorted",
    ),
    "a field twice": (
        lambda: kind("pick", fields=("object", "object", "source")),
        "vocabulary.pick.fields",
        "sorted",
    ),
    "an empty range": (
        lambda: speed(low=9, high=8),
        "vocabulary.navigate.params.speed_mm_s.high",
        "`low`",
    ),
    "recording without max_bytes": (
        lambda: kind("listen", records=True),
        "vocabulary.listen.params",
        "`max_bytes`",
    ),
    "storing without recording": (
        lambda: kind("keep", stores=True),
        "vocabulary.keep.records",
        "true",
    ),
    "transmitting without recording": (
        lambda: kind("send", transmits=True),
        "vocabulary.send.records",
        "true",
    ),
    "a robot's home": (
        lambda: robot("lifter-1", home="cellar"),
        "robots.lifter-1.home",
        "`cellar`",
    ),
    "a profile's unknown type": (
        lambda: robot("lifter-1", tools={"fly": ("rotor",)}),
        "robots.lifter-1.profile.tools.fly",
        "vocabulary",
    ),
    "a profile's tools not sorted": (
        lambda: robot("lifter-1", tools={"pick": ("gripper", "arm")}),
        "robots.lifter-1.profile.tools.pick",
        "sorted",
    ),
    "a profile's tool twice": (
        lambda: robot("lifter-1", tools={"pick": ("arm", "arm")}),
        "robots.lifter-1.profile.tools.pick",
        "sorted",
    ),
    "a profile's type without tools": (
        lambda: robot("lifter-1", tools={"pick": ()}),
        "robots.lifter-1.profile.tools.pick",
        "at least one",
    ),
}


def test_a_site_with_one_fault_has_that_fault_and_no_other() -> None:
    for name, (make, where, expected) in BROKEN.items():
        with case(name):
            found = faults(make())
            assert [fault.where for fault in found] == [where]
            assert expected in found[0].message


#: As near to a fault as a sound site can be.
SOUND: dict[str, Callable[[], Site]] = {
    "the shipped site": scenarios.site,
    "an id that differs by a letter": lambda: added("office-1a"),
    "a twin of another kind": lambda: thing("dock", names=()),
    "one spelling for a region and an object": lambda: thing("sharps-bin", names=("Corridor",)),
    "a name that repeats its own id": lambda: region("dock", names=("dock",)),
    "one thing in two cases": lambda: region("dock", names=("Dock", "DOCK", "dock")),
    "approach on the edge": lambda: region("dock", approach=(34000, 1500)),
    "corners the other way round": lambda: region(
        "dock", points=scenarios.site().regions["dock"].points[::-1]
    ),
    "two tags": lambda: region("dock", tags=("public", "staff")),
    "a range of one value": lambda: speed(low=8, high=8),
    "recording with max_bytes": lambda: kind("listen", records=True, params={"max_bytes": BYTES}),
    "storing what is recorded": lambda: kind(
        "listen", records=True, stores=True, transmits=True, params={"max_bytes": BYTES}
    ),
    "two tools": lambda: robot("lifter-1", tools={"pick": ("arm", "gripper")}),
    "the same room on another floor": lambda: added("dock-2", floor=2),
    "a child along its parent's edge": lambda: added(
        "nook", floor=1, points=square(34000, 0), approach=(35000, 1000), within="dock"
    ),
    "a child of a child": lambda: site(
        regions={
            **scenarios.site().regions,
            "nook": Region(
                map="main",
                floor=1,
                points=square(34000, 0),
                approach=(35000, 1000),
                tags=("staff",),
                within="dock",
            ),
            "niche": Region(
                map="main",
                floor=1,
                points=square(34000, 0, 500),
                approach=(34200, 200),
                tags=("staff",),
                within="nook",
            ),
        }
    ),
    "a door on a child's edge": lambda: replace(
        added("nook", floor=1, points=square(35000, 500), approach=(36000, 1000), within="dock"),
        doors=(*scenarios.site().doors, Door(between=("dock", "nook"), at=(35000, 1000))),
    ),
    "a lift": lambda: replace(
        added("dock-2", floor=2),
        doors=(*scenarios.site().doors, Door(between=("dock", "dock-2"), at=(36000, 1500))),
    ),
    "two regions that share a wall": lambda: added(
        "nook", floor=1, points=square(38000, 0), approach=(39000, 1000)
    ),
    "people": lambda: site(people={"ann": person("Ann"), "ben": person("Ben")}),
    "an emergency place": lambda: site(emergency=EmergencyPlaces(places={"dock": "charging"})),
    "a baseline": lambda: site(baseline=("announce", "scan_obstacles")),
    "no doors": lambda: site(doors=()),
    "no objects and no robots": lambda: site(objects={}, robots={}),
}


def test_a_site_that_just_keeps_the_rule_has_no_fault() -> None:
    for name, make in SOUND.items():
        with case(name):
            assert faults(make()) == ()


def test_every_fault_is_named_in_the_order_of_the_model_s_parts() -> None:
    """So that an author mends them in one round."""
    broken = site(
        regions={
            **scenarios.site().regions,
            "office_1": Region(
                map="main",
                floor=9,
                points=((0, 0), (1, 0), (0, 1)),
                approach=(9, 9),
                tags=(),
                names=("Office 1",),
            ),
        },
        doors=(Door(between=("cellar", "attic"), at=(0, 0)),),
        objects={"box": ObjectModel(kind="x", home="cellar", mass_g=0)},
        vocabulary={},
        robots={"lifter-1": replace(scenarios.site().robots["lifter-1"], home="cellar")},
    )
    assert [fault.where for fault in faults(broken)] == [
        "regions.office_1",
        "regions.office_1.names",
        "regions.office_1.approach",
        "regions.office_1.tags",
        "doors[0].between",
        "doors[0].between",
        "objects.box.home",
        "robots.lifter-1.home",
        "robots.lifter-1.profile.tools.navigate",
        "robots.lifter-1.profile.tools.pick",
        "robots.lifter-1.profile.tools.place",
        "robots.lifter-1.profile.tools.wait",
    ]


def test_a_fault_is_a_value() -> None:
    assert SiteFault("a", "b") == SiteFault(where="a", message="b")
    assert faults(scenarios.site()) == ()


def test_a_site_s_own_channels_and_less_trust_in_a_shipped_one_are_sound() -> None:
    added = {"intranet": Label.RETRIEVAL, "pager": Label.MODEL, "tool": Label.RETRIEVAL}
    assert faults(site(channels=added)) == ()
    assert site_digest(site(channels={})) == site_digest(scenarios.site())
    assert site_digest(site(channels=added)) != site_digest(scenarios.site())


def test_regions_all_on_one_spot_are_refused_without_looking_at_every_pair() -> None:
    """The attack: a small file that keeps the checker busy for minutes."""
    base = replace(scenarios.site().regions["dock"], names=(), floor=9)
    many = {f"r{chr(97 + n // 20)}{chr(97 + n % 20)}": base for n in range(300)}
    found = faults(site(regions={**scenarios.site().regions, **many}))
    overlaps = [fault for fault in found if "no area in common" in fault.message]
    assert len(overlaps) == MOST_OVERLAPS
    told = [fault for fault in overlaps if "further overlaps are not looked for" in fault.message]
    assert told == overlaps[-1:]


# -- what a hostile file may cost ------------------------------------------------------------------


def lettered(number: int) -> str:
    """Return a short id that looks like no other of a few thousand."""
    letters = "bcdefghkmp"
    return "".join(letters[int(digit)] for digit in f"{number:04}")


def drawn(*points: tuple[int, int], within: str | None = None) -> Region:
    """Return a region on the fly; where its approach lies does not matter here."""
    return Region(
        map="main", floor=9, points=points, approach=points[0], tags=("staff",), within=within
    )


def only(regions: dict[str, Region], **changes: Any) -> Site:
    bare = {"objects": {}, "robots": {}, "people": {}, "doors": (), "emergency": None}
    return site(regions=regions, **{**bare, **changes})


def nested(count: int) -> dict[str, Region]:
    """Return squares, each within the last."""
    return {
        lettered(n): drawn(
            (n, n),
            (20_000 - n, n),
            (20_000 - n, 20_000 - n),
            (n, 20_000 - n),
            within=lettered(n - 1) if n else None,
        )
        for n in range(count)
    }


def zigzag(low: int, high: int, within: str | None = None) -> Region:
    """Return a band of 256 corners that runs up and down: its box says little of it."""
    line = [(step * 1_000, step % 2 * 100_000) for step in range(128)]
    below = [(x, y + low) for x, y in line]
    return drawn(*below, *((x, y + high) for x, y in reversed(line)), within=within)


def timed(model: Site) -> tuple[SiteFault, ...]:
    """Return the faults, found in time: what hung for minutes takes a few seconds."""
    with at_most(10):
        return faults(model)


def test_regions_may_lie_sixteen_deep_and_not_deeper() -> None:
    assert faults(only(nested(MOST_DEPTH + 1))) == ()
    place = f"regions.{lettered(MOST_DEPTH + 1)}.within"
    deep = SiteFault(place, f"expected at most {MOST_DEPTH} regions around a region")
    assert faults(only(nested(MOST_DEPTH + 2))) == (deep,)


def test_a_chain_of_nested_regions_is_refused_at_once() -> None:
    """The attack: 800 squares, each `within` the last, kept the checker busy for minutes."""
    (told,) = timed(only(nested(800)))
    assert told.where == f"regions.{lettered(MOST_DEPTH + 1)}.within"


def test_more_regions_or_doors_than_anyone_draws_are_refused_and_not_looked_at(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    square = drawn((0, 0), (9, 0), (9, 9), (0, 9))
    many = {lettered(n): square for n in range(MOST_REGIONS + 1)}
    assert [fault.where for fault in timed(only(many))] == ["regions"]
    monkeypatch.setattr(places, "MOST_REGIONS", 3)  # and once more, small
    assert [f.where for f in faults(only(dict(list(many.items())[:4])))] == ["regions"]
    monkeypatch.undo()
    lost = Door(between=("cellar", "attic"), at=(0, 0))
    most = faults(doors(*[lost] * (MOST_DOORS - len(scenarios.site().doors))))
    assert len(most) == 2 * (MOST_DOORS - len(scenarios.site().doors))
    more = faults(doors(*[lost] * MOST_DOORS))
    assert [fault.where for fault in more] == ["doors"]


def test_many_thin_regions_whose_boxes_all_meet_are_refused_and_not_compared(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The attack: no two have an area in common, and every pair must be looked at."""
    strips = {
        lettered(n): drawn(
            (n * 10, 0), (n * 10 + 9, 0), (n * 10 + 100_009, 100_000), (n * 10 + 100_000, 100_000)
        )
        for n in range(1_900)
    }
    (told,) = timed(only(strips))
    assert told == SiteFault(
        "regions", f"expected at most {MOST_PAIRS} pairs of regions that are close"
    )
    few = dict(list(strips.items())[:30])
    assert faults(only(few)) == ()
    monkeypatch.setattr(places, "MOST_PAIRS", 100)
    assert [fault.where for fault in faults(only(few))] == ["regions"]


@pytest.mark.complete
@pytest.mark.parametrize("within", [None, "bbbb"])
def test_intricate_regions_close_together_are_refused_before_they_cost_minutes(
    within: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The attack: a megabyte of outlines that run beside each other, or inside one."""
    bands = {lettered(n): zigzag(n * 10, n * 10 + 5, within) for n in range(1, 125)}
    around = {"bbbb": zigzag(0, 10_000_000)} if within else {}
    found = timed(only({**around, **bands}))
    few = only({**around, **dict(list(bands.items())[:3])})
    assert faults(few) == ()
    monkeypatch.setattr(places, "MOST_EFFORT", 1_000)
    for refused in (found, faults(few)):
        assert refused
        assert all("not compared further" in fault.message for fault in refused)


def test_a_thousand_rooms_side_by_side_are_sound() -> None:
    """The near miss: what a large building has is far from any of these limits."""
    rooms = {
        lettered(n): drawn(
            *((n % 40 * 10 + x, n // 40 * 10 + y) for x, y in ((0, 0), (10, 0), (10, 10), (0, 10)))
        )
        for n in range(1_000)
    }
    assert timed(only(rooms)) == ()


def test_a_name_has_at_most_two_hundred_characters_and_a_thing_sixty_four_names() -> None:
    """The attack: one name of 60,000 characters cost gigabytes where mentions are searched."""
    assert faults(region("dock", names=("x" * MOST_CHARACTERS,))) == ()
    found = faults(region("dock", names=("Bay", "x" * (MOST_CHARACTERS + 1))))
    message = f"expected at most {MOST_CHARACTERS} characters, got {MOST_CHARACTERS + 1}"
    assert found == (SiteFault("regions.dock.names[1]", message),)
    names = tuple(f"bay {lettered(n)}" for n in range(MOST_NAMES + 1))
    assert faults(thing("sharps-bin", names=names[1:])) == ()
    message = f"expected at most {MOST_NAMES} names, got {MOST_NAMES + 1}"
    found = faults(thing("sharps-bin", names=names))
    assert found == (SiteFault("objects.sharps-bin.names", message),)


def test_one_parameter_name_in_two_units_cannot_be_sound() -> None:
    """The attack: a card that reads a limit in the unit of another type's parameter."""
    vocabulary = {
        **scenarios.site().vocabulary,
        "drive-on": ActionModel(fields=(), params={"amount": replace(BYTES, unit="mm/s")}),
        "press-on": ActionModel(fields=(), params={"amount": replace(BYTES, unit="cm/s")}),
    }
    found = [fault.where for fault in faults(site(vocabulary=vocabulary))]
    assert found == [
        "vocabulary.drive-on.params.amount.unit",
        "vocabulary.press-on.params.amount.unit",
    ]
    for unit in ("mm/s", "cm/s", "m/s", "", "MM/S"):
        told = faults(site(vocabulary={**vocabulary, **_of("amount_mm_s", "mm/s", unit)}))
        places = [fault.where for fault in told]
        wrong = [] if unit == "mm/s" else ["vocabulary.press-on.params.amount_mm_s.unit"]
        assert places == wrong


def _of(name: str, first: str, second: str) -> dict[str, ActionModel]:
    units = {"drive-on": first, "press-on": second}
    return {
        kind: ActionModel(fields=(), params={name: replace(BYTES, unit=unit)})
        for kind, unit in units.items()
    }
