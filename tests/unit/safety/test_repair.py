# SPDX-License-Identifier: Apache-2.0
"""A repair is the action, slower or by a shorter route: safe by the same gates, nothing else."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise
from random import Random
from typing import Any

import msgspec
import pytest

from authguard_r.core.action import Action
from authguard_r.core.geometry import polygon
from authguard_r.core.safety import SafetyDecision
from authguard_r.core.state import AttestedState
from authguard_r.safety import EnvelopeGate, Rule, SafetyConfig, default_config, gate_of
from authguard_r.safety.repair import is_narrower, touch
from authguard_r.sim.robot import snapshot_of
from fixtures import scenarios
from fixtures.amount import amount

CONFIG = default_config(scenarios.site(), scenarios.RID)
THROUGH = ("public-corridor", "plant-room", "public-corridor")


def near(distance_mm: int) -> AttestedState:
    world = msgspec.structs.replace(scenarios.world(), human_distance_mm=distance_mm)
    return scenarios.attested(snapshot_of(world, robot=scenarios.RID, epoch=1, seq=1))


def go(*route: str, to: str = "pharmacy", **changes: Any) -> Action:
    return scenarios.navigate("dock", to, route=route, **changes)


def assess(
    action: Action, config: SafetyConfig = CONFIG, distance_mm: int = 5_000
) -> SafetyDecision:
    gate = gate_of(config).recall(b"")
    return gate.assess(action, near(distance_mm), scenarios.facts(), scenarios.NOW)


def repaired(action: Action, **changes: Any) -> Action | None:
    distance_mm = changes.pop("distance_mm", 5_000)
    return assess(action, msgspec.structs.replace(CONFIG, **changes), distance_mm).repair


def test_a_keep_out_region_is_left_out_of_the_route_and_nothing_else_changes() -> None:
    action = go(*THROUGH)
    shorter = ("public-corridor", "public-corridor")
    assert repaired(action) == msgspec.structs.replace(action, route=shorter)


def test_every_keep_out_region_is_left_out() -> None:
    action = go("public-corridor", "plant-room", "office-1", "public-corridor", "plant-room")
    found = repaired(action, keep_out=("office-1", "plant-room"))
    assert found is not None
    assert found.route == ("public-corridor", "public-corridor")


def test_a_shorter_route_and_a_lower_speed_go_together() -> None:
    action = go(*THROUGH, speed=2_000)
    changes = {"route": ("public-corridor",) * 2, "params": {"speed_mm_s": 300}}
    assert repaired(action, distance_mm=500) == msgspec.structs.replace(action, **changes)


@pytest.mark.parametrize(
    "action",
    [
        go("public-corridor", to="plant-room"),
        go(*THROUGH, to="plant-room"),
    ],
    ids=["destination", "destination and route"],
)
def test_a_keep_out_destination_is_not_repaired(action: Action) -> None:
    assert repaired(action) is None


@pytest.mark.parametrize(
    ("route", "to"),
    [
        (("plant-room", "staff-corridor"), "pharmacy"),  # the dock and the corridor are apart
        (("public-corridor", "plant-room"), "staff-corridor"),
        (("public-corridor", "plant-room", "no-such-region"), "pharmacy"),
    ],
    ids=["its begin", "its end", "an unknown region"],
)
def test_a_route_that_falls_apart_is_not_repaired(route: tuple[str, ...], to: str) -> None:
    assert repaired(go(*route, to=to)) is None


def test_a_route_is_not_emptied_for_an_empty_one_leaves_the_way_open() -> None:
    assert repaired(go("plant-room", to="public-corridor")) is None


def test_without_a_known_source_nobody_knows_whether_the_route_holds_together() -> None:
    assert repaired(msgspec.structs.replace(go(*THROUGH), source=None)) is None


def test_a_hazard_besides_speed_and_route_is_not_repaired() -> None:
    state = scenarios.state()
    blind = scenarios.attested(msgspec.structs.replace(state.snapshot, readings={}))
    decision = EnvelopeGate(CONFIG).assess(go(*THROUGH), blind, scenarios.facts(), scenarios.NOW)
    assert [str(finding.hazard) for finding in decision.findings] == ["KEEP_OUT", "STATE_UNKNOWN"]
    assert decision.repair is None


def test_a_repair_raises_no_number_and_adds_no_speed() -> None:
    assert repaired(go(speed=-2_000)) is None  # backwards: the largest allowed speed is greater
    assert repaired(go(params={})) is None


def test_a_signed_rule_that_the_shorter_route_breaks_withdraws_the_repair() -> None:
    rule = Rule(id="by-there", formula="G (type = navigate -> route contains plant-room)")
    assert repaired(go(*THROUGH)) is not None
    assert repaired(go(*THROUGH), rules=(rule,)) is None


SQUARE = ((0, 0), (10, 0), (10, 10), (0, 10))


@pytest.mark.parametrize(
    ("points", "expected"),
    [
        (((10, 0), (20, 0), (20, 10), (10, 10)), True),
        (((10, 4), (20, 4), (20, 6), (10, 6)), True),
        (((10, 9), (20, 9), (20, 30), (10, 30)), True),
        (((10, 10), (20, 10), (20, 20), (10, 20)), False),
        (((10, 5), (20, 0), (20, 10)), False),
        (((11, 0), (20, 0), (20, 10), (11, 10)), False),
        (((4, 4), (6, 4), (6, 6), (4, 6)), False),
    ],
    ids=["a whole wall", "inside a wall", "a part", "a corner", "a tip", "apart", "inside"],
)
def test_regions_touch_along_a_wall(points: tuple[tuple[int, int], ...], expected: bool) -> None:
    one, other = polygon("main", 1, SQUARE), polygon("main", 1, points)
    assert touch(one, other) is touch(other, one) is expected
    assert not touch(one, polygon("main", 2, points))
    assert not touch(one, polygon("annex", 1, points))


def test_what_is_more_than_narrower_is_no_repair() -> None:
    action = go(*THROUGH, speed=800)
    replace = msgspec.structs.replace
    for narrower in (action, repaired(action), replace(action, params={"speed_mm_s": 1})):
        assert narrower is not None
        assert is_narrower(narrower, action)
    for change in (
        {"route": ()},
        {"route": (*THROUGH, "dock")},
        {"route": ("plant-room", "public-corridor", "public-corridor")},
        {"params": {"speed_mm_s": 801}},
        {"params": {}},
        {"params": {"speed_mm_s": 800, "force_mn": 0}},
        {"destination": "dock"},
        {"source": "pharmacy"},
        {"object": "package-p1"},
        {"tool": "gripper"},
        {"type": "walk"},
    ):
        assert not is_narrower(replace(action, **change), action), change


@pytest.mark.parametrize(
    ("name", "asked", "offered", "expected"),
    [
        ("speed_mm_s", 500, 499, True),
        ("speed_mm_s", 500, 0, True),
        ("speed_mm_s", 500, -1, False),
        ("speed_mm_s", 500, -5_000, False),
        ("speed_mm_s", -500, -499, True),
        ("speed_mm_s", -500, 0, True),
        ("speed_mm_s", -500, -501, False),
        ("speed_mm_s", -500, 1, False),
        ("speed_mm_s", 0, -1, False),
        ("speed_mm_s", 0, 1, False),
        ("linear_mm_s", 500, 499, True),
        ("lateral_mm_s", -500, -501, False),
        ("force_mn", 500, 499, False),
        ("height_mm", 500, 499, False),
        ("angular_mrad_s", 500, 499, False),
    ],
)
def test_only_a_bounded_speed_changes_and_only_toward_zero(
    name: str, asked: int, offered: int, expected: bool
) -> None:
    action = go(*THROUGH, params={name: asked, "wait_ms": 10})
    changed = msgspec.structs.replace(action, params={name: offered, "wait_ms": 10})
    assert is_narrower(action, action)
    assert is_narrower(changed, action) is expected


WALLS = {
    frozenset((one, other))
    for one, other in (
        *(("public-corridor", f"station-10{n}") for n in (1, 2, 3)),
        *(("staff-corridor", f"station-10{n}") for n in (1, 2, 3)),
        *(("public-corridor", room) for room in ("office-1", "office-2", "isolation-room")),
        *(("public-corridor", room) for room in ("plant-room", "pharmacy", "dock")),
        ("staff-corridor", "pharmacy"),
    )
}


def random_case(dice: Random) -> tuple[Action, SafetyConfig, int]:
    regions = sorted(scenarios.site().regions)
    corridors = ["public-corridor", "staff-corridor"] * 4
    action = scenarios.navigate(
        *(dice.choice(regions) for _ in range(2)),
        route=tuple(dice.choice([*regions, *corridors]) for _ in range(dice.randint(0, 4))),
        params=dice.choice([{}, *[{"speed_mm_s": dice.randint(-2_000, 2_500)}] * 9]),
    )
    rules = (Rule(id="slow", formula="G params.speed_mm_s <= 900"),) if dice.random() < 0.2 else ()
    config = msgspec.structs.replace(
        CONFIG,
        keep_out=tuple(sorted(dice.sample(regions, dice.randint(0, 4)))),
        max_speed_mm_s=dice.randint(1, 2_000),
        human_speed_mm_s=dice.randint(1, 600),
        rules=rules,
    )
    return action, config, dice.choice([500, 5_000])


def require_narrower(repair: Action, action: Action, config: SafetyConfig) -> None:
    """Require the law of a repair, worked out by other means than the gate's."""
    changed = {
        field
        for field in Action.__struct_fields__
        if getattr(repair, field) != getattr(action, field)
    }
    assert changed
    assert changed <= {"route", "params"}
    assert repair.params.keys() == action.params.keys()
    if "params" in changed:
        assert 0 <= repair.params["speed_mm_s"] < action.params["speed_mm_s"]
    assert not Counter(repair.route) - Counter(action.route)
    if "route" in changed:
        assert list(repair.route) == [r for r in action.route if r not in config.keep_out] != []
        for legs in pairwise((repair.source, *repair.route, repair.destination)):
            assert len(set(legs)) == 1 or frozenset(legs) in WALLS


def test_a_repair_is_safe_by_the_same_gates_and_only_narrower() -> None:
    seen: Counter[str] = Counter()
    dice = Random("repairs")
    for _ in range(amount(4_000, 20_000)):
        action, config, distance_mm = random_case(dice)
        decision = assess(action, config, distance_mm)
        repair = decision.repair
        if repair is None:
            seen["none"] += not decision.safe
            continue
        assert not decision.safe
        assert assess(repair, config, distance_mm).safe
        require_narrower(repair, action, config)
        shorter, slower = repair.route != action.route, repair.params != action.params
        seen[f"shorter {shorter}, slower {slower}"] += 1
    assert set(seen) == {
        "none",
        "shorter True, slower True",
        "shorter True, slower False",
        "shorter False, slower True",
    }
    assert min(seen.values()) > 10, seen
