# SPDX-License-Identifier: Apache-2.0
"""Safe repairs: the whole action that the safety gate offers in the place of an unsafe one, or none.

What is expected is written here by hand, from docs/spec/safety.md.
"""

from __future__ import annotations

from typing import Any

from authguard_r.safety import default_config
from fixtures import decision_cases, scenarios
from making.answers import action, state

Json = dict[str, Any]
#: A vector: configuration, state and action, the hazards that are found, and the repair.
Case = tuple[str, str, Json, list[str], Json | None]

HALL, PLANT = "public-corridor", "plant-room"
FAR, NEAR = "nobody near", "somebody near"
PLAIN = "the plant room is kept out"

#: More regions, in the hospital's millimeters. The dock is [34000, 38000] x [0, 3000].
MORE: Json = {
    "wing": {"points": [[38_000, 1_000], [42_000, 1_000], [42_000, 2_000], [38_000, 2_000]]},
    "shed": {"points": [[38_000, 2_999], [42_000, 2_999], [42_000, 6_000], [38_000, 6_000]]},
    "corner": {"points": [[38_000, 3_000], [42_000, 3_000], [42_000, 6_000], [38_000, 6_000]]},
    "tip": {"points": [[38_000, 1_500], [42_000, 0], [42_000, 3_000]]},
    "gap": {"points": [[38_001, 1_000], [42_000, 1_000], [42_000, 2_000], [38_001, 2_000]]},
    "inside": {"points": [[35_000, 1_000], [36_000, 1_000], [36_000, 2_000], [35_000, 2_000]]},
    "across": {"points": [[37_000, 1_000], [42_000, 1_000], [42_000, 2_000], [37_000, 2_000]]},
}
MORE["upstairs"] = {**MORE["wing"], "floor": 2}
MORE["elsewhere"] = {**MORE["wing"], "map": "annex"}


def repair_vectors() -> Json:
    """Actions in states under configurations, with their hazards and the repair or null."""
    cases = {**speeds(), **routes(), **walls(), **others(), **rules()}
    return {
        "facts": facts(),
        "now": decision_cases.plain(scenarios.NOW),
        "configurations": configurations(),
        "states": states(),
        "vectors": [
            {
                "name": name,
                "configuration": configuration,
                "state": at,
                "action": asked,
                "expect": {"hazards": hazards, "repair": repair},
            }
            for name, (configuration, at, asked, hazards, repair) in cases.items()
        ],
    }


def facts() -> Json:
    """Return the hospital's facts, with more regions beside the dock."""
    plain: Json = decision_cases.plain_facts(scenarios.facts())
    plain["regions"] |= {
        name: {**plain["regions"]["dock"], "tags": [], **model} for name, model in MORE.items()
    }
    return plain


def configurations() -> Json:
    """Return the envelopes by name: at most 1,500 mm/s, 300 mm/s at 1,200 mm or less."""
    base: Json = decision_cases.plain(default_config(scenarios.site(), scenarios.RID))
    base |= {"max_speed_mm_s": 1_500, "human_speed_mm_s": 300, "human_distance_mm": 1_200}
    base |= {"keep_out": [PLANT], "max_age_ms": 1_000}

    def rule(formula: str) -> Json:
        return {**base, "rules": [{"id": "only-rule", "formula": formula}]}

    still = {"type": "navigate", "variable": "holding", "equals": "package-p1"}
    return {
        PLAIN: base,
        "two regions are kept out": {**base, "keep_out": ["office-1", PLANT]},
        "no region is kept out": {**base, "keep_out": []},
        "faster near people": {**base, "human_speed_mm_s": 2_000},
        "a pace for what carries no speed": {**base, "paced": {"navigate": 2_000}},
        "navigate only with the package": {**base, "executable": [still]},
        "another profile": {**base, "profile": "A" * 43},
        "by way of the plant room": rule("G (type = navigate -> route contains plant-room)"),
        "not slower than 400": rule("G (type = navigate -> params.speed_mm_s >= 400)"),
        "not faster than 400": rule("G (type = navigate -> params.speed_mm_s <= 400)"),
        "not faster than 200": rule("G (type = navigate -> params.speed_mm_s <= 200)"),
    }


def states() -> Json:
    """Return the states by name: somebody is at a distance that the name says, or it is unknown."""
    blind, old, foreign = state(), state(), state()
    del blind["snapshot"]["readings"]["human_distance_mm"]
    old["snapshot"]["readings"]["human_distance_mm"]["age_ms"] = 1_001
    foreign["snapshot"]["robot"] = "lifter-1"
    return {
        FAR: state(human_distance_mm=5_000),
        NEAR: state(human_distance_mm=500),
        "somebody at 1,200 mm": state(human_distance_mm=1_200),
        "somebody at 1,201 mm": state(human_distance_mm=1_201),
        "no distance": blind,
        "a distance of 1,001 ms ago": old,
        "a distance of another robot": foreign,
        "no state": None,
    }


def way(
    *route: str, source: str | None = "dock", to: str | None = "pharmacy", speed: int = 500
) -> Json:
    """Return a way from the dock to the pharmacy, unless told otherwise."""
    made = action("pharmacy", params={"speed_mm_s": speed})
    ends = {"source": source, "destination": to, "route": [*route] or None}
    return {k: v for k, v in {**made, **ends}.items() if v is not None}


def speeds() -> dict[str, Case]:
    """The largest allowed speed takes the place of a greater one."""
    paceless = {**way(), "params": {}}
    return {
        "as fast as allowed": (PLAIN, FAR, way(speed=1_500), [], None),
        "too fast by 1 mm/s": (PLAIN, FAR, way(speed=1_501), ["SPEED"], way(speed=1_500)),
        "too fast": (PLAIN, FAR, way(speed=2_000), ["SPEED"], way(speed=1_500)),
        "too fast near somebody": (PLAIN, NEAR, way(), ["HUMAN_PROXIMITY"], way(speed=300)),
        "slow near somebody": (PLAIN, NEAR, way(speed=300), [], None),
        "at the distance itself": (
            PLAIN,
            "somebody at 1,200 mm",
            way(speed=301),
            ["HUMAN_PROXIMITY"],
            way(speed=300),
        ),
        "beyond the distance": (PLAIN, "somebody at 1,201 mm", way(speed=301), [], None),
        "too fast for both: the lower speed": (
            PLAIN,
            NEAR,
            way(speed=2_000),
            ["SPEED", "HUMAN_PROXIMITY"],
            way(speed=300),
        ),
        "too fast for both, the lower is of no person": (
            "faster near people",
            NEAR,
            way(speed=2_500),
            ["SPEED", "HUMAN_PROXIMITY"],
            way(speed=1_500),
        ),
        "too fast by a route that is left as it is": (
            PLAIN,
            FAR,
            way(HALL, "office-2", HALL, speed=2_000),
            ["SPEED"],
            way(HALL, "office-2", HALL, speed=1_500),
        ),
        "too fast by a route whose stops do not touch": (
            PLAIN,
            FAR,
            way("staff-corridor", "office-1", speed=2_000),
            ["SPEED"],
            way("staff-corridor", "office-1", speed=1_500),
        ),
        "too fast without source and destination": (
            PLAIN,
            FAR,
            way(source=None, to=None, speed=2_000),
            ["SPEED"],
            way(source=None, to=None, speed=1_500),
        ),
        "too fast backwards": (PLAIN, FAR, way(speed=-2_000), ["SPEED"], None),
        "too fast backwards near somebody": (
            PLAIN,
            NEAR,
            way(speed=-301),
            ["HUMAN_PROXIMITY"],
            None,
        ),
        "without a speed": (PLAIN, FAR, paceless, ["SPEED"], None),
        "a pace that is too fast": (
            "a pace for what carries no speed",
            FAR,
            paceless,
            ["SPEED"],
            None,
        ),
    }


def routes() -> dict[str, Case]:
    """Keep-out regions are left out of the route, and out of nothing else."""
    by, hall = (HALL, PLANT, HALL), way(HALL, HALL)
    two = "two regions are kept out"
    return {
        "one keep-out region": (PLAIN, FAR, way(*by), ["KEEP_OUT"], hall),
        "the first stop": (PLAIN, FAR, way(PLANT, HALL), ["KEEP_OUT"], way(HALL)),
        "the last stop": (PLAIN, FAR, way(HALL, PLANT), ["KEEP_OUT"], way(HALL)),
        "the same one twice": (
            PLAIN,
            FAR,
            way(PLANT, HALL, PLANT),
            ["KEEP_OUT", "KEEP_OUT"],
            way(HALL),
        ),
        "two of them": (
            two,
            FAR,
            way(HALL, PLANT, "office-1", HALL, "office-2", HALL),
            ["KEEP_OUT", "KEEP_OUT"],
            way(HALL, HALL, "office-2", HALL),
        ),
        "no region is kept out: the route stays": (
            "no region is kept out",
            FAR,
            way(*by),
            [],
            None,
        ),
        "the source is kept out: no rule is about it": (
            PLAIN,
            FAR,
            way(HALL, source=PLANT),
            [],
            None,
        ),
        "the source is kept out and on the route": (
            PLAIN,
            FAR,
            way(PLANT, HALL, source=PLANT),
            ["KEEP_OUT"],
            way(HALL, source=PLANT),
        ),
        "a keep-out region and too fast": (
            PLAIN,
            FAR,
            way(*by, speed=2_000),
            ["SPEED", "KEEP_OUT"],
            way(HALL, HALL, speed=1_500),
        ),
        "a keep-out region and too fast near somebody": (
            PLAIN,
            NEAR,
            way(*by, speed=2_000),
            ["SPEED", "KEEP_OUT", "HUMAN_PROXIMITY"],
            way(HALL, HALL, speed=300),
        ),
        "a keep-out region and too fast backwards": (
            PLAIN,
            FAR,
            way(*by, speed=-2_000),
            ["SPEED", "KEEP_OUT"],
            None,
        ),
        "a keep-out region backwards": (
            PLAIN,
            FAR,
            way(*by, speed=-500),
            ["KEEP_OUT"],
            way(HALL, HALL, speed=-500),
        ),
        "a keep-out destination": (PLAIN, FAR, way(HALL, to=PLANT), ["KEEP_OUT"], None),
        "a keep-out destination and route": (
            PLAIN,
            FAR,
            way(*by, to=PLANT),
            ["KEEP_OUT", "KEEP_OUT"],
            None,
        ),
        "a keep-out destination and too fast": (
            PLAIN,
            FAR,
            way(HALL, to=PLANT, speed=2_000),
            ["SPEED", "KEEP_OUT"],
            None,
        ),
        "nothing left of the route": (PLAIN, FAR, way(PLANT), ["KEEP_OUT"], None),
        "nothing left between regions that touch": (
            PLAIN,
            FAR,
            way(PLANT, source=HALL),
            ["KEEP_OUT"],
            None,
        ),
        "nothing left of two regions": (
            two,
            FAR,
            way("office-1", PLANT),
            ["KEEP_OUT", "KEEP_OUT"],
            None,
        ),
        "no source": (PLAIN, FAR, way(*by, source=None), ["KEEP_OUT"], None),
        "no destination": (PLAIN, FAR, way(*by, to=None), ["KEEP_OUT"], None),
    }


def walls() -> dict[str, Case]:
    """Each stop is the next one, or shares a stretch of an edge with it."""
    apart: dict[str, Json] = {
        "the source and the first stop are apart": way(PLANT, "staff-corridor"),
        "two stops are apart": way(HALL, PLANT, "staff-corridor"),
        "the last stop and the destination are apart": way(HALL, PLANT, to="staff-corridor"),
        "two stops are apart where nothing was left out": way(
            HALL, "staff-corridor", HALL, PLANT, HALL
        ),
        "a region that the site does not know": way(HALL, PLANT, "nowhere", HALL),
        "only a corner touches": way(PLANT, "dock", source=HALL, to="corner"),
        "only a tip touches": way(PLANT, "dock", source=HALL, to="tip"),
        "a gap of 1 mm": way(PLANT, "dock", source=HALL, to="gap"),
        "one lies within the other": way(PLANT, "dock", source=HALL, to="inside"),
        "their outlines only cross": way(PLANT, "dock", source=HALL, to="across"),
        "another floor": way(PLANT, "dock", source=HALL, to="upstairs"),
        "another map": way(PLANT, "dock", source=HALL, to="elsewhere"),
    }
    joined: dict[str, tuple[Json, Json]] = {
        "a part of an edge touches": (
            way(PLANT, "dock", source=HALL, to="wing"),
            way("dock", source=HALL, to="wing"),
        ),
        "1 mm of an edge touches": (
            way(PLANT, "dock", source=HALL, to="shed"),
            way("dock", source=HALL, to="shed"),
        ),
        "each stop is the next one": (
            way("dock", PLANT, "dock", to="dock"),
            way("dock", "dock", to="dock"),
        ),
        "through the pharmacy to the corridor behind": (
            way(HALL, PLANT, HALL, "pharmacy", to="staff-corridor"),
            way(HALL, HALL, "pharmacy", to="staff-corridor"),
        ),
    }
    return {
        **{name: (PLAIN, FAR, asked, ["KEEP_OUT"], None) for name, asked in apart.items()},
        **{n: (PLAIN, FAR, asked, ["KEEP_OUT"], left) for n, (asked, left) in joined.items()},
    }


def others() -> dict[str, Case]:
    """Another hazard beside speed and route, and there is no repair."""
    fast, by = way(speed=2_000), way(HALL, PLANT, HALL)
    lifted = {**fast, "object": "piano"}
    grip = {
        "type": "pick",
        "tool": "gripper",
        "object": "package-p1",
        "source": "pharmacy",
        "params": {"force_mn": 40_001},
    }
    unknown = ["SPEED", "STATE_UNKNOWN"]
    return {
        "too fast, and no distance": (PLAIN, "no distance", fast, unknown, None),
        "too fast, and an old distance": (
            PLAIN,
            "a distance of 1,001 ms ago",
            fast,
            unknown,
            None,
        ),
        "too fast, and another robot's distance": (
            PLAIN,
            "a distance of another robot",
            fast,
            unknown,
            None,
        ),
        "too fast, and no state": (PLAIN, "no state", fast, unknown, None),
        "a keep-out region, and no distance": (
            PLAIN,
            "no distance",
            by,
            ["KEEP_OUT", "STATE_UNKNOWN"],
            None,
        ),
        "too fast, with a thing of unknown mass": (PLAIN, FAR, lifted, ["SPEED", "PAYLOAD"], None),
        "too fast, and not executable": (
            "navigate only with the package",
            FAR,
            fast,
            ["SPEED", "NOT_EXECUTABLE"],
            None,
        ),
        "a keep-out region, and not executable": (
            "navigate only with the package",
            FAR,
            by,
            ["KEEP_OUT", "NOT_EXECUTABLE"],
            None,
        ),
        "too much force": (PLAIN, FAR, grip, ["FORCE"], None),
        "a type that the site does not know": (
            PLAIN,
            FAR,
            {**fast, "type": "fly"},
            ["STATE_UNKNOWN"],
            None,
        ),
        "another profile than the configuration's": (
            "another profile",
            FAR,
            fast,
            ["STATE_UNKNOWN"],
            None,
        ),
    }


def rules() -> dict[str, Case]:
    """A rule that would call the repair unsafe withdraws it; one that the repair satisfies does not."""
    by = way(HALL, PLANT, HALL)
    return {
        "a rule wants the region that is left out": (
            "by way of the plant room",
            FAR,
            by,
            ["KEEP_OUT"],
            None,
        ),
        "a rule wants the speed that is lowered": (
            "not slower than 400",
            NEAR,
            way(),
            ["HUMAN_PROXIMITY"],
            None,
        ),
        "a rule that the lower speed satisfies": (
            "not faster than 400",
            NEAR,
            way(),
            ["HUMAN_PROXIMITY", "RULE"],
            way(speed=300),
        ),
        "a rule that the lower speed breaks, too": (
            "not faster than 200",
            NEAR,
            way(),
            ["HUMAN_PROXIMITY", "RULE"],
            None,
        ),
        "only a rule is broken": ("not faster than 400", FAR, way(), ["RULE"], None),
    }
