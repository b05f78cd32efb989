# SPDX-License-Identifier: Apache-2.0
"""A mission's scope as rules over a finite trace: never this, and this not before that.

What an action may be is said with `G`, what has to come first with `W`, what is over with `WX G`.
No rule refuses what the mission authorizes: where two grants give the same action, neither grant's
order binds it. Spec page: docs/spec/defenses.md#temporal
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from msgspec import Struct

from authguard_r.core.mission import Grant, Mission
from authguard_r.safety import Rule
from authguard_r.site.model import Site

#: Names in one rule: each region of a route doubles what a rule has to tell apart.
_MOST_NAMES, _MOST_REGIONS = 12, 6


class Shape(Struct, frozen=True):
    """What a rule can see of an action: its kind, its thing, where it ends."""

    type: str
    object: str | None
    destination: str | None

    def meets(self, other: Shape) -> bool:
        """True when one action can be of both."""
        same = self.type == other.type
        return same and all(
            mine is None or theirs is None or mine == theirs
            for mine, theirs in (
                (self.object, other.object),
                (self.destination, other.destination),
            )
        )

    def __str__(self) -> str:
        parts = [f"type = {self.type}"]
        parts += [f"object = {self.object}"] if self.object is not None else []
        parts += [f"destination = {self.destination}"] if self.destination is not None else []
        return f"({' & '.join(parts)})"


def rules(mission: Mission, site: Site) -> tuple[Rule, ...]:
    """Return the rules that say a mission's scope, as far as they can.

    Args:
        mission: the one in force.
        site: whose words there are to be outside of it.
    """
    made = (*_kinds(mission, site), *_fields(mission, site), *_limits(mission), *_order(mission))
    return tuple(Rule(id=f"rule-{number}", formula=text) for number, text in enumerate(made))


def _kinds(mission: Mission, site: Site) -> Iterator[str]:
    """Never a kind of action that no grant has."""
    granted = {grant.type for grant in mission.actions}
    for some in _some(sorted(set(site.vocabulary) - granted), _MOST_NAMES):
        yield f"G !({_any('type', some)})"


def _fields(mission: Mission, site: Site) -> Iterator[str]:
    """Never a thing, a start or an end that no grant of that kind has; never such a region."""
    for kind, grants in _by_type(mission).items():
        rows = [row for grant in grants for row in grant.alternatives]
        things, places = set[str](site.objects), set[str](site.regions)
        for field, words, ceiling in (
            ("object", things, mission.objects),
            ("source", places, mission.regions),
            ("destination", places, mission.regions),
        ):
            granted = {getattr(row, field) for row in rows}
            if None in granted:
                continue  # a rule would refuse the action that names none: it is unknown which
            for some in _some(sorted(words - granted.intersection(ceiling)), _MOST_NAMES):
                yield f"G (type = {kind} -> !({_any(field, some)}))"
        touched = {region for row in rows for region in row.regions}
        touched.intersection_update(mission.regions)
        for some in _some(sorted(places - touched), _MOST_REGIONS):
            told = " | ".join(f"route contains {region}" for region in some)
            yield f"G (type = {kind} -> !({told}))"


def _limits(mission: Mission) -> Iterator[str]:
    """Never a value that no grant of that kind of action allows, or the mission as a whole."""
    ceilings = {limit.parameter: limit for limit in mission.limits}
    for kind, grants in _by_type(mission).items():
        names = sorted({limit.parameter for grant in grants for limit in grant.limits})
        for name in names:
            bounds = [
                (limit.low, limit.high)
                for grant in grants
                for limit in grant.limits
                if limit.parameter == name
            ]
            if len(bounds) < len(grants):
                continue  # a grant of that kind takes no such value
            low, high = min(low for low, _ in bounds), max(high for _, high in bounds)
            if name in ceilings:
                low, high = max(low, ceilings[name].low), min(high, ceilings[name].high)
            value = f"params.{name}"
            yield f"G (type = {kind} -> {value} >= {low} & {value} <= {high})"


def _order(mission: Mission) -> Iterator[str]:
    """Not before what has to succeed first; not after what ends it."""
    grants = {grant.id: grant for grant in mission.actions}
    for grant in mission.actions:
        own = _own_shapes(grant, mission)
        for shape in own:
            for before in grant.after:
                yield f"!{shape} W {_one_of(_shapes(grants[before]))}"
            for end in grant.until:
                for over in _own_shapes(grants[end], mission):
                    yield f"G (!{over} | WX G !{shape})"


def _own_shapes(grant: Grant, mission: Mission) -> list[Shape]:
    """Return what this grant alone gives: what another gives too is not bound by its order."""
    rest = (other for other in mission.actions if other.id != grant.id)
    others = [shape for other in rest for shape in _shapes(other)]
    return [shape for shape in _shapes(grant) if not any(map(shape.meets, others))]


def _shapes(grant: Grant) -> list[Shape]:
    found = (Shape(grant.type, row.object, row.destination) for row in grant.alternatives)
    return list(dict.fromkeys(found))


def _by_type(mission: Mission) -> dict[str, list[Grant]]:
    found: dict[str, list[Grant]] = {}
    for grant in mission.actions:
        found.setdefault(grant.type, []).append(grant)
    return found


def _one_of(shapes: list[Shape]) -> str:
    return str(shapes[0]) if len(shapes) == 1 else f"({' | '.join(map(str, shapes))})"


def _any(field: str, names: Iterable[str]) -> str:
    return " | ".join(f"{field} = {name}" for name in names)


def _some(names: list[str], most: int) -> Iterator[list[str]]:
    for begin in range(0, len(names), most):
        yield names[begin : begin + most]
