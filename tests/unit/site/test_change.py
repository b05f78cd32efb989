# SPDX-License-Identifier: Apache-2.0
"""A site's next version: what gives a word another meaning is told before what is merely new."""

from __future__ import annotations

from typing import Any

import msgspec

from authguard_r.authoring.site.change import ChangeEffect, SiteChange, changes, line_of
from authguard_r.core.provenance import Label
from authguard_r.site.model import (
    ActionModel,
    EmergencyPlaces,
    ObjectModel,
    Person,
    PersonRole,
    Profile,
    Site,
)
from fixtures import scenarios
from fixtures.cases import case

replace = msgspec.structs.replace
BASE = scenarios.site()


def region(name: str, **to: Any) -> Site:
    return replace(BASE, regions={**BASE.regions, name: replace(BASE.regions[name], **to)})


def kind(name: str, **to: Any) -> Site:
    return replace(BASE, vocabulary={**BASE.vocabulary, name: replace(BASE.vocabulary[name], **to)})


def speed(**to: Any) -> Site:
    params = BASE.vocabulary["navigate"].params
    return kind("navigate", params={"speed_mm_s": replace(params["speed_mm_s"], **to)})


def profile(**to: Any) -> Site:
    robot = BASE.robots["courier-1"]
    changed: Profile = replace(robot.profile, **to)
    return replace(BASE, robots={**BASE.robots, "courier-1": replace(robot, profile=changed)})


def channels(**labels: str) -> Site:
    return replace(BASE, channels={channel: Label(label) for channel, label in labels.items()})


def without(group: str, item: str) -> Site:
    return replace(BASE, **{group: {k: v for k, v in getattr(BASE, group).items() if k != item}})


TOOLS = BASE.robots["courier-1"].profile.tools
OPERATOR = Person(roles=(PersonRole.OPERATOR,))
BOTH = Person(roles=(PersonRole.OPERATOR, PersonRole.SUPERVISOR))
DOCK = BASE.regions["dock"]

#: The site before, the site after, and the one effect and place that is told.
ONE: dict[str, tuple[Site, Site, ChangeEffect, str]] = {
    "a wall moved": (
        BASE,
        region("dock", points=(*DOCK.points[:2], (38000, 2999), DOCK.points[3])),
        ChangeEffect.MEANING,
        "regions.dock.points",
    ),
    "a tag": (
        BASE,
        region("office-1", tags=("public",)),
        ChangeEffect.MEANING,
        "regions.office-1.tags",
    ),
    "a parent": (
        BASE,
        region("dock", within="pharmacy"),
        ChangeEffect.MEANING,
        "regions.dock.within",
    ),
    "a region more": (
        without("regions", "dock"),
        replace(BASE, regions={**without("regions", "dock").regions, "d": replace(DOCK, names=())}),
        ChangeEffect.ADDS,
        "regions.d",
    ),
    "an object's class": (
        BASE,
        replace(
            BASE,
            objects={
                **BASE.objects,
                "sharps-bin": replace(BASE.objects["sharps-bin"], kind="medicine"),
            },
        ),
        ChangeEffect.MEANING,
        "objects.sharps-bin.kind",
    ),
    "an object more": (
        BASE,
        replace(
            BASE, objects={**BASE.objects, "box": ObjectModel(kind="box", home="dock", mass_g=1)}
        ),
        ChangeEffect.ADDS,
        "objects.box",
    ),
    "a robot less": (BASE, without("robots", "lifter-1"), ChangeEffect.REMOVES, "robots.lifter-1"),
    "a range up": (
        BASE,
        speed(high=3001),
        ChangeEffect.WIDENS,
        "vocabulary.navigate.params.speed_mm_s.high",
    ),
    "a range down": (
        BASE,
        speed(high=2999),
        ChangeEffect.NARROWS,
        "vocabulary.navigate.params.speed_mm_s.high",
    ),
    "a range's lower end down": (
        BASE,
        speed(low=-1),
        ChangeEffect.WIDENS,
        "vocabulary.navigate.params.speed_mm_s.low",
    ),
    "a worse harm": (
        BASE,
        kind("navigate", physical=2),
        ChangeEffect.MEANING,
        "vocabulary.navigate.physical",
    ),
    "a lesser harm": (
        kind("navigate", physical=2),
        BASE,
        ChangeEffect.MEANING,
        "vocabulary.navigate.physical",
    ),
    "a channel more": (
        BASE,
        channels(pager="model"),
        ChangeEffect.ADDS,
        "channels.pager",
    ),
    "a channel less": (channels(pager="model"), BASE, ChangeEffect.REMOVES, "channels.pager"),
    "less trust in a shipped channel": (
        BASE,
        channels(tool="retrieval"),
        ChangeEffect.NARROWS,
        "channels.tool",
    ),
    "a shipped channel as it was": (
        channels(tool="retrieval"),
        BASE,
        ChangeEffect.WIDENS,
        "channels.tool",
    ),
    "more trust in a channel": (
        channels(pager="camera"),
        channels(pager="audio"),
        ChangeEffect.WIDENS,
        "channels.pager",
    ),
    "a shipped channel written out": (
        BASE,
        channels(tool="model"),
        ChangeEffect.ADDS,
        "channels.tool",
    ),
    "a unit": (
        BASE,
        speed(unit="m/s"),
        ChangeEffect.MEANING,
        "vocabulary.navigate.params.speed_mm_s.unit",
    ),
    "nobody looks at the real speed": (
        BASE,
        speed(monitored_by=None),
        ChangeEffect.WIDENS,
        "vocabulary.navigate.params.speed_mm_s.monitored_by",
    ),
    "somebody does": (
        speed(monitored_by=None),
        BASE,
        ChangeEffect.NARROWS,
        "vocabulary.navigate.params.speed_mm_s.monitored_by",
    ),
    "another variable": (
        BASE,
        speed(monitored_by="wheel_speed"),
        ChangeEffect.MEANING,
        "vocabulary.navigate.params.speed_mm_s.monitored_by",
    ),
    "a recording that is none any more": (
        BASE,
        kind("take_photo", records=False),
        ChangeEffect.WIDENS,
        "vocabulary.take_photo.records",
    ),
    "a belief that may be granted": (
        BASE,
        kind("set_pose", state_writing=False),
        ChangeEffect.WIDENS,
        "vocabulary.set_pose.state_writing",
    ),
    "a parameter less": (
        BASE,
        kind("wait", params={}),
        ChangeEffect.MEANING,
        "vocabulary.wait.params.duration_ms",
    ),
    "a type more": (
        BASE,
        replace(BASE, vocabulary={**BASE.vocabulary, "hum": ActionModel(fields=())}),
        ChangeEffect.ADDS,
        "vocabulary.hum",
    ),
    "a faster robot": (
        BASE,
        profile(max_speed_mm_s=1501),
        ChangeEffect.WIDENS,
        "robots.courier-1.profile.max_speed_mm_s",
    ),
    "brakes that nobody knew of": (
        BASE,
        profile(brake_mm_s2=500),
        ChangeEffect.MEANING,
        "robots.courier-1.profile.brake_mm_s2",
    ),
    "a tool for one type more": (
        BASE,
        profile(tools={**TOOLS, "hum": ("speaker",)}),
        ChangeEffect.WIDENS,
        "robots.courier-1.profile.tools.hum",
    ),
    "a tool less": (
        profile(tools={**TOOLS, "wait": ("arm", "base")}),
        BASE,
        ChangeEffect.NARROWS,
        "robots.courier-1.profile.tools.wait",
    ),
    "a type that the robot cannot do any more": (
        profile(tools={**TOOLS, "hum": ("speaker",)}),
        BASE,
        ChangeEffect.NARROWS,
        "robots.courier-1.profile.tools.hum",
    ),
    "a role more": (
        replace(BASE, people={"ann": OPERATOR}),
        replace(BASE, people={"ann": BOTH}),
        ChangeEffect.WIDENS,
        "people.ann.roles",
    ),
    "a person": (BASE, replace(BASE, people={"ann": OPERATOR}), ChangeEffect.ADDS, "people.ann"),
    "an emergency place": (
        BASE,
        replace(BASE, emergency=EmergencyPlaces(places={"dock": "charging"})),
        ChangeEffect.WIDENS,
        "emergency.places.dock",
    ),
    "its purpose": (
        replace(BASE, emergency=EmergencyPlaces(places={"dock": "charging"})),
        replace(BASE, emergency=EmergencyPlaces(places={"dock": "assembly"})),
        ChangeEffect.MEANING,
        "emergency.places.dock",
    ),
    "a baseline": (BASE, replace(BASE, baseline=("announce",)), ChangeEffect.WIDENS, "baseline"),
    "no baseline": (replace(BASE, baseline=("announce",)), BASE, ChangeEffect.NARROWS, "baseline"),
    "a door less": (BASE, replace(BASE, doors=BASE.doors[1:]), ChangeEffect.REMOVES, "doors"),
    "a door more": (replace(BASE, doors=BASE.doors[1:]), BASE, ChangeEffect.ADDS, "doors"),
    "the site's id": (BASE, replace(BASE, id="hall"), ChangeEffect.MEANING, "id"),
    "the version": (BASE, replace(BASE, version=2), ChangeEffect.COUNTS, "version"),
    "a name more": (
        BASE,
        region("dock", names=(*DOCK.names, "Garage")),
        ChangeEffect.ADDS,
        "regions named `Garage`",
    ),
    "a name less": (
        BASE,
        region("dock", names=DOCK.names[1:]),
        ChangeEffect.REMOVES,
        "regions named `Dock`",
    ),
}
#: A region more is one line among those of its names; it is told apart below.
del ONE["a region more"]


def test_one_change_is_told_once_with_what_it_does() -> None:
    for name, (old, new, effect, where) in ONE.items():
        with case(name):
            assert [(change.effect, change.where) for change in changes(old, new)] == [
                (effect, where)
            ]


def test_a_site_does_not_differ_from_itself() -> None:
    for name, (old, new, *_) in ONE.items():
        with case(name):
            assert changes(old, old) == changes(new, new) == ()


def test_the_attack_a_name_that_now_is_another_place_is_told_first() -> None:
    """A mission that says `Dock` was reviewed; the site that says where that is was swapped."""
    swapped = replace(
        BASE,
        version=2,
        regions={
            **BASE.regions,
            "dock": replace(DOCK, names=("Base",)),
            "office-1": replace(BASE.regions["office-1"], names=("Dock", "Office 1")),
            "annex": replace(DOCK, names=(), floor=2),
        },
    )
    found = changes(BASE, swapped)
    assert found[0] == SiteChange(
        effect=ChangeEffect.MEANING,
        group="names",
        where="regions named `Dock`",
        old="dock",
        new="office-1",
    )
    order = list(ChangeEffect)
    assert [order.index(c.effect) for c in found] == sorted(order.index(c.effect) for c in found)
    assert {c.where for c in found} >= {"regions.annex", "version"}


def test_a_line_says_what_was_and_what_is_in_ascii() -> None:
    lines = [line_of(change) for change in changes(BASE, region("dock", names=("D\u00f6ck",)))]
    assert lines[0] == "ADDS     regions named `D\\xf6ck`: new: dock"
    assert "REMOVES  regions named `Base`: gone: dock" in lines
    (line,) = (line_of(change) for change in changes(BASE, speed(high=9)))
    assert line == "NARROWS  vocabulary.navigate.params.speed_mm_s.high: 3000 -> 9"
