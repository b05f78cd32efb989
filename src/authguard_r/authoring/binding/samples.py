# SPDX-License-Identifier: Apache-2.0
"""Valid sample calls of a binding, made from nothing but the binding and a site.

`binding check` mutates them; tests and authors read them to see what a call looks like.
Spec page: docs/spec/binding.md#checking
"""

from __future__ import annotations

from fractions import Fraction
from math import ceil
from typing import Any

from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import (
    ActionType,
    Identifier,
    ObjectId,
    ParameterId,
    RegionId,
)
from authguard_r.normalize.binding import (
    POSE,
    REGION,
    Argument,
    ArgumentUse,
    Binding,
    ToolBinding,
    ToolWay,
)
from authguard_r.normalize.dialects import Call
from authguard_r.normalize.places import Places
from authguard_r.normalize.quantity import COORDINATE, scale, unscale
from authguard_r.normalize.rebuild import nested
from authguard_r.site.model import ActionModel, ObjectModel, Parameter, Region, Site

#: The place of every sample, which has no author.
WHERE = "sample"


def probe_site(binding: Binding, vocabulary: dict[ActionType, ActionModel]) -> Site:
    """Return a small site for the binding: three squares, two things, the given words."""
    regions = {
        RegionId(f"square-{number}"): Region(
            map="map",
            floor=0,
            points=((x, 0), (x + 2000, 0), (x + 2000, 2000), (x, 2000)),
            approach=(x + 1000, 1000),
            tags=("public",),
            names=(f"Square {number}",),
        )
        for number, x in enumerate((0, 3000, 6000), 1)
    }
    objects = {
        ObjectId(f"thing-{number}"): ObjectModel(
            kind="thing", home=RegionId("square-1"), mass_g=100, names=(f"Thing {number}",)
        )
        for number in (1, 2)
    }
    return Site(
        schema="authguard-r/site/1",
        id=binding.site or Identifier("probe"),
        version=1,
        regions=regions,
        objects=objects,
        robots={},
        vocabulary=vocabulary,
    )


class Sampler:
    """Makes valid calls, and other values for each of their arguments.

    Args:
        site: the site whose names and positions the calls use.
    """

    def __init__(self, site: Site) -> None:
        self._site = site
        self._objects = [(model.names or (item,))[0] for item, model in site.objects.items()]
        self._regions = [(model.names or (item,))[0] for item, model in site.regions.items()]
        places = Places(site)
        self._spots = [m for r, m in site.regions.items() if _alone(places, r, m)]

    def call(self, way: ToolWay) -> Call | None:
        """Return a valid call of a way; None when the site has nothing that it could name.

        Every mapped and fixed argument is given; what is noted or refused is left out.
        """
        flat: dict[str, Any] = dict(way.tool.when)
        for path, argument in way.tool.arguments.items():
            if argument.use is ArgumentUse.FIXED:
                flat[path] = argument.constant()
            elif argument.use is ArgumentUse.MAPPED:
                found = self.values(way.tool, argument)
                if not found:
                    return None
                flat[path] = found[0]
        return Call(way.name, nested(flat), WHERE)

    def values(self, tool: ToolBinding, argument: Argument) -> list[Any]:
        """Return up to two values that a mapped argument can have."""
        if argument.each:
            return self._lists(argument)
        if argument.values:
            return list(argument.values)[:2]
        if argument.to == "object":
            return list(self._objects[:2])
        if argument.to == "route":
            return [self._regions[:1], self._regions[:2]]
        if argument.to in {"source", "destination"}:
            return list(self._regions[:2])
        if argument.to in POSE:
            return [_coordinate(argument, spot) for spot in self._spots[:2]]
        name = ParameterId(argument.to.removeprefix("params."))
        return _amounts(argument, self._site.vocabulary[tool.type].params[name])

    def _lists(self, argument: Argument) -> list[Any]:
        """Return a list of one place and a list of two."""
        named = any(one.to == REGION for one in argument.each.values())
        places: list[Any] = list(self._regions if named else self._spots)[:2]
        items = [self._item(argument.each, place) for place in places]
        return [items[:1], items] if items else []

    @staticmethod
    def _item(each: dict[str, Argument], place: Any) -> Any:
        flat: dict[str, Any] = {
            path: one.constant() for path, one in each.items() if one.use is ArgumentUse.FIXED
        }
        for path, one in each.items():
            if one.use is ArgumentUse.MAPPED:
                flat[path] = place if one.to == REGION else _coordinate(one, place)
        return nested(flat)


def _alone(places: Places, region: RegionId, model: Region) -> bool:
    """True when a region's own halting place is a position that means this region."""
    try:
        return places.region_at(model.approach, model.map, where=WHERE) == region
    except MalformedError:
        return False


def _coordinate(argument: Argument, spot: Region) -> Any:
    if argument.to == POSE[2]:
        return spot.map
    return unscale(spot.approach[POSE.index(argument.to)], argument, COORDINATE)


def _amounts(argument: Argument, parameter: Parameter) -> list[Any]:
    """Return up to two numbers that mean different values of a parameter."""
    per_unit = Fraction(argument.per_unit)
    first = ceil((parameter.low - argument.offset) / per_unit)
    found: dict[int, Any] = {}
    for number in (first + 1, first, 2, 1):
        try:
            value = scale(number, parameter, per_unit=per_unit, where=WHERE, offset=argument.offset)
        except MalformedError:
            continue
        found.setdefault(value, number)
    ends = {end: unscale(end, argument, parameter) for end in (parameter.low, parameter.high)}
    found = {**{value: number for value, number in ends.items() if number is not None}, **found}
    return list(found.values())[::-1][:2]
