# SPDX-License-Identifier: Apache-2.0
"""Where a hole may stand, what its values are, and what filling makes of it."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

import authguard_reference.templates as oracle
from authguard_r.core.encoding import decode, encode, encode_fast
from authguard_r.core.errors import MalformedError, RefusedError
from authguard_r.core.mission import Mission, Rate
from authguard_r.core.reasons import Reason
from authguard_r.enforcement.templates import (
    Hole,
    HoleKind,
    Instance,
    Template,
    combinations,
    expand,
    filled,
    require_sound,
)
from authguard_r.enforcement.templates.expansion import require_fill
from authguard_r.enforcement.templates.template import PLACES, holes_in, rule_of
from fixtures import templates
from fixtures.cases import case
from fixtures.templates import SET, edited, template

SPEED = Hole(kind=HoleKind.INTEGER, values=(300, 800))
HOLE = {"hole": "station"}


def with_speed(*changes: Any) -> Template:
    return edited(*changes, holes={**template().holes, "speed": SPEED})


def place_of_fault(value: Template) -> str:
    with pytest.raises(MalformedError) as error:
        require_sound(value)
    assert error.value.reason is Reason.SCHEMA_INVALID
    return error.value.where


def test_the_shipped_template_is_sound_and_every_combination_is_a_mission() -> None:
    require_sound(template())
    fills = list(combinations(template()))
    assert len(fills) == 6
    assert len({encode(filled(template(), fill)) for fill in fills}) == 6
    assert {rule_of(path) for path, _ in holes_in(template())} <= set(PLACES)


def test_a_template_has_one_spelling() -> None:
    data = encode(template())
    assert decode(data, Template) == template()
    assert encode_fast(template()) == data


def test_a_template_without_holes_is_one_mission_many_times() -> None:
    fill = next(combinations(template()))
    plain = msgspec.json.decode(encode(filled(template(), fill)))
    mission = {k: v for k, v in plain.items() if k not in {"mid", "version", "nonce"}}
    mission = {k: v for k, v in mission.items() if k not in {"not_before", "expiry"}}
    fixed = SET(template(), mission=mission, holes={})
    require_sound(fixed)
    assert list(combinations(fixed)) == [{}]
    assert filled(fixed, {}) == filled(template(), fill)


NO_PLACE: dict[str, tuple[Any, ...]] = {
    "the issuer": ("issuer",),
    "the robot": ("rid",),
    "the profile": ("profile",),
    "the site": ("site",),
    "the schema": ("schema",),
    "what follows a refusal": ("on_refusal",),
    "the age of the place": ("place_max_age_ms",),
    "a budget": ("budgets", "actions"),
    "a rate": ("budgets", "rate", "count"),
    "a threshold": ("risk_policy", "tau_1"),
    "who approves": ("risk_policy", "roles", 0),
    "a weight": ("risk_policy", "types", "navigate"),
    "a grant's name": ("actions", 0, "id"),
    "a grant's type": ("actions", 0, "type"),
    "a grant's tool": ("actions", 0, "tool"),
    "who chooses": ("actions", 0, "chooser"),
    "how often": ("actions", 0, "repeat"),
    "how many starts": ("actions", 0, "starts"),
    "how long": ("actions", 0, "max_ms"),
    "whether it can be undone": ("actions", 0, "irreversible"),
    "a right to data": ("actions", 0, "data", "record"),
    "an order": ("actions", 1, "after", 0),
    "a parameter": ("actions", 0, "limits", 0, "parameter"),
    "a guard's variable": ("guards", 0, "variable"),
    "a guard's comparison": ("guards", 0, "comparison"),
    "a guard's age": ("guards", 0, "max_age_ms"),
    "a whole row": ("actions", 0, "alternatives", 0),
    "all rows": ("actions", 0, "alternatives"),
    "a whole grant": ("actions", 0),
    "all grants": ("actions",),
    "a whole limit": ("limits", 0),
    "a whole guard": ("actions", 1, "done_when", 0),
    "all regions of a row": ("actions", 0, "alternatives", 0, "regions"),
    "the task as a whole": ("task",),
}


def test_a_hole_stands_for_no_part_of_a_mission_s_shape() -> None:
    for what, path in NO_PLACE.items():
        with case(what):
            change = (path[:-1], [HOLE]) if path[-2:] == ("after", 0) else (path, HOLE)
            bad = edited(change)
            place = "mission" + "".join(f"[{s}]" if isinstance(s, int) else f".{s}" for s in path)
            assert place_of_fault(bad) == place


def test_a_mission_that_is_a_hole_altogether_is_refused() -> None:
    assert place_of_fault(SET(template(), mission=dict(HOLE))) == "mission"


WRONG_KIND: dict[str, tuple[tuple[Any, ...], str]] = {
    "an object for a place": (("actions", 0, "alternatives", 0, "source"), "package"),
    "a place for an object": (("actions", 1, "alternatives", 0, "object"), "station"),
    "a place for a bound": (("limits", 0, "high"), "station"),
    "a number for a place": (("regions", 0), "speed"),
    "an object for a region of a row": (("actions", 0, "alternatives", 0, "regions", 0), "package"),
}


@pytest.mark.parametrize("what", WRONG_KIND)
def test_a_hole_of_another_kind_does_not_fit(what: str) -> None:
    path, name = WRONG_KIND[what]
    bad = with_speed((path, {"hole": name}), (("guards", 0, "value"), {"hole": "speed"}))
    place = "mission" + "".join(f"[{s}]" if isinstance(s, int) else f".{s}" for s in path)
    assert place_of_fault(bad) == place


def test_numbers_stand_where_bounds_do() -> None:
    good = with_speed(
        (("limits", 0, "high"), {"hole": "speed"}),
        (("actions", 0, "limits", 0, "high"), {"hole": "speed"}),
        (("guards", 0, "value"), {"hole": "speed"}),
    )
    require_sound(good)
    fill = {"package": "package-p1", "station": "station-101", "speed": 300}
    made = filled(good, fill)  # type: ignore[arg-type]
    assert made.limits[0].high == made.actions[0].limits[0].high == made.guards[0].value == 300


UNSOUND: dict[str, tuple[Template, str]] = {
    "an unknown hole": (edited((("regions", 0), {"hole": "nowhere"})), "mission.regions[0]"),
    "a hole that stands nowhere": (
        edited(holes={**template().holes, "speed": SPEED}),
        "holes.speed",
    ),
    "numbers that are names": (
        edited(holes={**template().holes, "station": Hole(kind=HoleKind.REGION, values=(1,))}),
        "holes.station.values",
    ),
    "names that are numbers": (
        edited(holes={**template().holes, "station": Hole(kind=HoleKind.INTEGER, values=("a",))}),
        "holes.station.values",
    ),
    "values out of order": (
        edited(
            holes={**template().holes, "station": Hole(kind=HoleKind.REGION, values=("b", "a"))}
        ),
        "holes.station.values",
    ),
    "a value twice": (
        edited(
            holes={**template().holes, "station": Hole(kind=HoleKind.REGION, values=("a", "a"))}
        ),
        "holes.station.values",
    ),
    "too many combinations": (
        edited(
            holes={
                name: Hole(kind=hole.kind, values=tuple(f"v{n:03}" for n in range(65)))
                for name, hole in template().holes.items()
            }
        ),
        "holes",
    ),
    "too many in a window": (edited(rate=Rate(count=1_001, per_ms=1)), "rate.count"),
    "an end that is no instant": (edited(not_after="2026-02-30T00:00:00Z"), "not_after"),
    "a name of its own": (edited((("mid",), "deliver.1")), "mission.mid"),
    "a version of its own": (edited((("version",), 1)), "mission.version"),
    "a nonce of its own": (edited((("nonce",), "A" * 22)), "mission.nonce"),
    "a beginning": (edited((("not_before",), "2026-01-01T00:00:00Z")), "mission.not_before"),
    "an end": (edited((("expiry",), "2026-01-01T00:00:00Z")), "mission.expiry"),
    "a version before": (edited((("supersedes",), "A" * 43)), "mission.supersedes"),
    "a float": (edited((("budgets", "actions"), 1.0)), "mission.budgets.actions"),
    "a null": (
        edited((("actions", 0, "alternatives", 0, "object"), None)),
        "mission.actions[0].alternatives[0].object",
    ),
    "a number in the task": (edited((("task",), ["go", 1])), "mission.task[1]"),
    "a list in the task": (edited((("task",), ["go", []])), "mission.task[1]"),
}


def test_an_unsound_template_is_refused_with_its_place() -> None:
    for what, (bad, where) in UNSOUND.items():
        with case(what):
            assert place_of_fault(bad) == where


def test_a_template_too_deep_to_be_a_mission_is_refused() -> None:
    deep: Any = 1
    for _ in range(200):
        deep = [deep]
    assert place_of_fault(edited((("task",), deep))).startswith("mission.task[0]")
    assert place_of_fault(edited((("closing",), deep))).startswith("mission.closing[0][0]")


@pytest.mark.parametrize("name", ["", "Deliver", "a.b", "a" * 41, "-a"])
def test_a_template_s_name_leaves_room_for_its_missions(name: str) -> None:
    with pytest.raises(MalformedError):
        decode(encode(SET(template(), template=name)), Template)


@pytest.mark.parametrize(
    ("field", "value"), [("for_ms", 0), ("for_ms", 31_622_400_001), ("instances", 0)]
)
def test_a_template_says_how_often_and_how_long(field: str, value: int) -> None:
    with pytest.raises(MalformedError):
        decode(encode(SET(template(), **{field: value})), Template)


@pytest.mark.parametrize("value", [True, None, 1.5, ["package-p1"], {"hole": "package"}])
def test_an_instance_s_value_is_a_name_or_an_integer(value: Any) -> None:
    plain = {**msgspec.to_builtins(templates.instance()), "fill": {"package": value}}
    with pytest.raises(MalformedError):
        decode(msgspec.json.Encoder(order="sorted").encode(plain), Instance)


NO_MISSION: dict[str, tuple[Template, str]] = {
    "a field that no mission has": (edited((("zone",), 1)), "template.mission"),
    "a word of another type": (
        edited((("budgets", "actions"), "many")),
        "template.mission.budgets.actions",
    ),
    "a grant that waits for itself": (edited((("actions", 1, "after"), ["pick"])), "actions[1].id"),
}


@pytest.mark.parametrize("what", NO_MISSION)
def test_a_combination_that_is_no_mission_is_refused_with_its_place(what: str) -> None:
    bad, where = NO_MISSION[what]
    with pytest.raises(MalformedError) as error:
        filled(bad, next(combinations(bad)))
    assert (error.value.reason, error.value.where) == (Reason.SCHEMA_INVALID, where)


def test_a_value_that_repeats_another_region_makes_no_mission() -> None:
    """The signer would be shown one region fewer; a set has no repeats, whatever fills it."""
    station = Hole(kind=HoleKind.REGION, values=("public-corridor", "station-101"))
    bad = edited(holes={**template().holes, "station": station})
    require_sound(bad)
    with pytest.raises(MalformedError) as error:
        filled(bad, {"package": "package-p1", "station": "public-corridor"})  # type: ignore[dict-item]
    assert error.value.reason is Reason.SCHEMA_INVALID


def test_sets_are_sorted_after_filling_and_nothing_else_is() -> None:
    station = Hole(kind=HoleKind.REGION, values=("aaa", "zzz"))
    value = edited(holes={**template().holes, "station": station})
    for name in station.values:
        made = filled(value, {"package": "package-p1", "station": name})  # type: ignore[dict-item]
        assert list(made.regions) == sorted(made.regions)
        assert [g.id for g in made.actions] == [g["id"] for g in value.mission["actions"]]


def test_a_hole_s_name_in_another_field_is_no_hole() -> None:
    """`{"hole": 5}` is an action type called `hole` with a weight, and stays one."""
    value = edited((("risk_policy", "types"), {"hole": 5}))
    require_sound(value)
    made = filled(value, next(combinations(value)))
    assert made.risk_policy.types == {"hole": 5}


@pytest.mark.parametrize("fill", [{}, {"package": "package-p1", "station": "dock"}])
def test_values_that_are_not_offered_are_refused(fill: Any) -> None:
    with pytest.raises(RefusedError):
        require_fill(template(), fill)


def test_the_oracle_fills_the_same() -> None:
    plain = msgspec.json.decode(encode(template()))
    assert oracle.fills(plain) == list(combinations(template()))
    for fill in oracle.fills(plain):
        said = msgspec.json.decode(encode(templates.instance(fill=fill)))
        made = expand(
            template(),
            fill,
            mid=said["mid"],
            nonce=said["nonce"],
            not_before=said["not_before"],
            expiry=said["expiry"],
        )
        again = msgspec.convert(oracle.expand(plain, said), Mission)
        assert encode(again) == encode(made)
        assert oracle.covers(plain, templates.digest(), said, 1_500_000)
        assert not oracle.covers(plain, "A" * 43, said, 1_500_000)
