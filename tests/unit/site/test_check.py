# SPDX-License-Identifier: Apache-2.0
"""Every fault of a site model alone, with its place; and the shipped site has none."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec
import pytest

import worlds
from authguard_r.site.check import Fault, faults
from authguard_r.site.model import (
    ActionModel,
    Door,
    ObjectModel,
    Parameter,
    Region,
    Robot,
    Rounding,
    Site,
)

replace = msgspec.structs.replace


def site(**changes: Any) -> Site:
    return replace(worlds.site(), **changes)


def region(name: str, **changes: Any) -> Site:
    """Return the site with one region changed, or added in the likeness of the dock."""
    regions = worlds.site().regions
    return site(regions={**regions, name: replace(regions.get(name, regions["dock"]), **changes)})


def added(name: str, **changes: Any) -> Site:
    return region(name, **{"names": (), **changes})


def thing(name: str, **changes: Any) -> Site:
    objects = worlds.site().objects
    bare = ObjectModel(kind="medicine", home="pharmacy", mass_g=1)
    return site(objects={**objects, name: replace(objects.get(name, bare), **changes)})


def robot(name: str, *, tools: dict[str, tuple[str, ...]] | None = None, **changes: Any) -> Site:
    robots = worlds.site().robots
    base: Robot = robots.get(name, robots["courier-1"])
    if tools is not None:
        changes["profile"] = replace(base.profile, tools={**base.profile.tools, **tools})
    return site(robots={**robots, name: replace(base, **changes)})


def kind(name: str, **changes: Any) -> Site:
    vocabulary = worlds.site().vocabulary
    base = vocabulary.get(name, ActionModel(fields=()))
    return site(vocabulary={**vocabulary, name: replace(base, **changes)})


def speed(**changes: Any) -> Site:
    params = worlds.site().vocabulary["navigate"].params
    return kind("navigate", params={"speed_mm_s": replace(params["speed_mm_s"], **changes)})


def doors(*more: Door) -> Site:
    return site(doors=(*worlds.site().doors, *more))


NEW = len(worlds.site().doors)
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


@pytest.mark.parametrize(("make", "where", "expected"), BROKEN.values(), ids=BROKEN)
def test_a_site_with_one_fault_has_that_fault_and_no_other(
    make: Callable[[], Site], where: str, expected: str
) -> None:
    found = faults(make())
    assert [fault.where for fault in found] == [where]
    assert expected in found[0].message


#: As near to a fault as a sound site can be.
SOUND: dict[str, Callable[[], Site]] = {
    "the shipped site": worlds.site,
    "an id that differs by a letter": lambda: added("office-1a"),
    "a twin of another kind": lambda: thing("dock", names=()),
    "one spelling for a region and an object": lambda: thing("sharps-bin", names=("Corridor",)),
    "a name that repeats its own id": lambda: region("dock", names=("dock",)),
    "a name in another case": lambda: region("dock", names=("corridor",)),
    "approach on the edge": lambda: region("dock", approach=(34000, 1500)),
    "corners the other way round": lambda: region(
        "dock", points=worlds.site().regions["dock"].points[::-1]
    ),
    "two tags": lambda: region("dock", tags=("public", "staff")),
    "a range of one value": lambda: speed(low=8, high=8),
    "recording with max_bytes": lambda: kind("listen", records=True, params={"max_bytes": BYTES}),
    "storing what is recorded": lambda: kind(
        "listen", records=True, stores=True, transmits=True, params={"max_bytes": BYTES}
    ),
    "two tools": lambda: robot("lifter-1", tools={"pick": ("arm", "gripper")}),
    "the same room on another floor": lambda: added("dock-2", floor=2),
    "no doors": lambda: site(doors=()),
    "no objects and no robots": lambda: site(objects={}, robots={}),
}


@pytest.mark.parametrize("make", SOUND.values(), ids=SOUND)
def test_a_site_that_just_keeps_the_rule_has_no_fault(make: Callable[[], Site]) -> None:
    assert faults(make()) == ()


def test_every_fault_is_named_in_the_order_of_the_model_s_parts() -> None:
    """So that an author mends them in one round."""
    broken = site(
        regions={
            **worlds.site().regions,
            "office_1": Region(
                map="main",
                floor=1,
                points=((0, 0), (1, 0), (0, 1)),
                approach=(9, 9),
                tags=(),
                names=("Office 1",),
            ),
        },
        doors=(Door(between=("cellar", "attic"), at=(0, 0)),),
        objects={"box": ObjectModel(kind="x", home="cellar", mass_g=0)},
        vocabulary={},
        robots={"lifter-1": replace(worlds.site().robots["lifter-1"], home="cellar")},
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
    assert Fault("a", "b") == Fault(where="a", message="b")
    assert faults(worlds.site()) == ()
