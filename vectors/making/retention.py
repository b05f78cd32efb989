# SPDX-License-Identifier: Apache-2.0
"""Retention of one mission: times that a gate takes or refuses, and when each class is destroyed.

What is expected is written here by hand, from docs/spec/sealed-fields.md.
"""

from __future__ import annotations

from typing import Any

Json = dict[str, Any]
#: Configuration and the mission's times; then `ok`, or the class at which they are refused.
Bounded = tuple[str, Json, str]
#: Configuration at the activation, times of each version, configuration afterwards; then when the
#: classes are destroyed, in hours after the expiry: object, region, and what tells of both.
Timed = tuple[str, list[Json], str, tuple[float | None, float | None, float | None]]

HOUR_MS, DAY_MS = 3_600_000, 86_400_000
#: 2026-01-15T14:35:00Z
EXPIRY_MS = 1_768_487_700_000
FIRST, SECOND = "authguard-r/mission/1", "authguard-r/mission/2"
RULES, FREE, OPEN = "two rules", "no rule", "nothing is sealed"


def retention_vectors() -> Json:
    """Times that are taken or refused, times of destruction, and times of a signed order."""
    return {
        "configurations": configurations(),
        "expiry_ms": EXPIRY_MS,
        "taken": taken(),
        "times": times(),
        "orders": orders(),
    }


def rule(data: str, least_ms: int = 0, most_ms: int = 0) -> Json:
    """Return a rule of the gate's configuration."""
    return {"data": data, "least_ms": least_ms, "most_ms": most_ms}


def configurations() -> Json:
    """Return configurations by name: the classes of each reader, and the rules."""
    both = [["object", "region"]]

    def of(*rules: Json, readers: list[list[str]] = both) -> Json:
        return {"readers": readers, "retention": [*rules]}

    return {
        RULES: of(rule("object", least_ms=HOUR_MS), rule("region", most_ms=2 * HOUR_MS)),
        FREE: of(),
        OPEN: of(readers=[]),
        "two readers": of(readers=[["object"], ["person", "region"]]),
        "one time alone": of(rule("region", HOUR_MS, HOUR_MS)),
        "objects at least 5 h": of(rule("object", least_ms=5 * HOUR_MS)),
        "regions at most 1 h": of(rule("region", most_ms=HOUR_MS)),
        "regions at most 1 d": of(rule("region", 1, DAY_MS)),
        "at least 5 h, regions at most 6 h": of(
            rule("object", least_ms=5 * HOUR_MS), rule("region", most_ms=6 * HOUR_MS)
        ),
        "people alone, at least 4 h": of(
            rule("person", least_ms=4 * HOUR_MS), readers=[["person"]]
        ),
    }


def taken() -> list[Json]:
    """Missions under a configuration: `ok`, or the reason and the place."""
    cases: dict[str, Bounded] = {
        "no time": (RULES, {}, "ok"),
        "no time where nothing is sealed": (OPEN, {}, "ok"),
        "at the least": (RULES, {"object": HOUR_MS}, "ok"),
        "below the least": (RULES, {"object": HOUR_MS - 1}, "object"),
        "at the least of another class": (RULES, {"region": HOUR_MS}, "ok"),
        "below the least of another class": (RULES, {"region": HOUR_MS - 1}, "region"),
        "1 ms": (RULES, {"region": 1}, "region"),
        "at the most": (RULES, {"region": 2 * HOUR_MS}, "ok"),
        "above the most": (RULES, {"region": 2 * HOUR_MS + 1}, "region"),
        "a most of 0 is no bound": (RULES, {"object": 10_000 * DAY_MS}, "ok"),
        "both within": (RULES, {"object": DAY_MS, "region": 2 * HOUR_MS}, "ok"),
        "one of two above": (RULES, {"object": DAY_MS, "region": DAY_MS}, "region"),
        "one of two below": (RULES, {"object": 1, "region": HOUR_MS}, "object"),
        "a class that no reader may read": (RULES, {"person": DAY_MS}, "person"),
        "one of two that no reader may read": (
            RULES,
            {"evidence": DAY_MS, "region": HOUR_MS},
            "evidence",
        ),
        "nothing is sealed": (OPEN, {"region": DAY_MS}, "region"),
        "no rule, 1 ms": (FREE, {"region": 1}, "ok"),
        "a class of the second reader": ("two readers", {"person": 1}, "ok"),
        "a class of neither reader": ("two readers", {"parameter": 1}, "parameter"),
        "the one time": ("one time alone", {"region": HOUR_MS}, "ok"),
        "1 ms below the one time": ("one time alone", {"region": HOUR_MS - 1}, "region"),
        "1 ms above the one time": ("one time alone", {"region": HOUR_MS + 1}, "region"),
        "another class has no most": ("one time alone", {"object": HOUR_MS + 1}, "ok"),
    }
    found = []
    for name, (configuration, own, where) in cases.items():
        refusal = {"reason": "VALUE_OUT_OF_RANGE", "where": f"mission.retention.{where}"}
        expect = "ok" if where == "ok" else refusal
        vector = {"configuration": configuration, "schema": SECOND, "retention": own}
        found.append({"name": name, **vector, "expect": expect})
    first = {"configuration": RULES, "schema": FIRST}
    denied = {"reason": "SCHEMA_INVALID", "where": "retention"}
    return [
        *found,
        {"name": "the first language", **first, "retention": {}, "expect": "ok"},
        {"name": "a time in it", **first, "retention": {"region": HOUR_MS}, "expect": denied},
    ]


def own(**hours: float) -> Json:
    """Return times of a mission, from hours."""
    return {data: int(count * HOUR_MS) for data, count in hours.items()}


def times() -> list[Json]:
    """Missions with one version or more: when each class is destroyed, null: never by itself."""
    return [timed(name, *given) for name, given in {**alone(), **updated(), **changed()}.items()]


def alone() -> dict[str, Timed]:
    """One version under one configuration: its times take the place of `most_ms`."""
    return {
        "the gate's rule": (RULES, [{}], RULES, (None, 2, 2)),
        "below the gate's most": (RULES, [own(region=1.5)], RULES, (None, 1.5, 1.5)),
        "at the gate's most": (RULES, [own(region=2)], RULES, (None, 2, 2)),
        "another class": (RULES, [own(object=1)], RULES, (1, 2, 1)),
        "later than the other class": (RULES, [own(object=24)], RULES, (24, 2, 2)),
        "both": (RULES, [own(object=3, region=1)], RULES, (3, 1, 1)),
        "neither": (FREE, [{}], FREE, (None, None, None)),
        "a class without a rule": (FREE, [own(region=3)], FREE, (None, 3, 3)),
        "both without a rule": (FREE, [own(object=1, region=3)], FREE, (1, 3, 1)),
    }


def updated() -> dict[str, Timed]:
    """An update replaces every time of the version before."""
    return {
        "a later time": (FREE, [own(region=1), own(region=3)], FREE, (None, 3, 3)),
        "an earlier time": (FREE, [own(region=3), own(region=1)], FREE, (None, 1, 1)),
        "another class alone": (FREE, [own(region=1), own(object=24)], FREE, (24, None, 24)),
        "no time any more": (FREE, [own(region=1), {}], FREE, (None, None, None)),
        "no time any more: the rule": (RULES, [own(region=1), {}], RULES, (None, 2, 2)),
        "a time where there was none": (FREE, [{}, own(region=1)], FREE, (None, 1, 1)),
    }


def changed() -> dict[str, Timed]:
    """A changed configuration moves the times that are held into its bounds."""
    three, most = [own(region=3)], "regions at most 1 h"
    wide = "at least 5 h, regions at most 6 h"
    return {
        "a greater least": (FREE, three, "objects at least 5 h", (None, 5, 5)),
        "a lower most": (FREE, three, most, (None, 1, 1)),
        "between the new bounds": (FREE, three, "regions at most 1 d", (None, 3, 3)),
        "below both": (FREE, [own(object=1, region=1)], wide, (5, 5, 5)),
        "above the most of one": (FREE, [own(object=9, region=9)], wide, (9, 6, 6)),
        "the rules are gone": (RULES, [own(region=1.5)], FREE, (None, 1.5, 1.5)),
        "nothing is sealed any more": (FREE, three, OPEN, (None, 3, 3)),
        "neither class is sealed any more, and another has a least": (
            FREE,
            three,
            "people alone, at least 4 h",
            (None, 4, 4),
        ),
        "of two versions, the second one's": (
            FREE,
            [own(region=9), own(region=3)],
            "objects at least 5 h",
            (None, 5, 5),
        ),
        "a mission of before the rule": (FREE, [{}], most, (None, None, None)),
    }


def timed(
    name: str,
    began: str,
    versions: list[Json],
    then: str,
    hours: tuple[float | None, float | None, float | None],
) -> Json:
    """Return a vector; times are milliseconds of UTC."""
    ends = [None if count is None else EXPIRY_MS + int(count * HOUR_MS) for count in hours]
    expect = dict(zip(("object", "region", "object+region"), ends, strict=True))
    return {"name": name, "began": began, "versions": versions, "then": then, "expect": expect}


def orders() -> list[Json]:
    """A signed `shred` order obeys the configuration's `least_ms` and no time of a mission."""

    def order(name: str, configuration: str, own: Json, at_ms: int, expect: str) -> Json:
        at = {"retention": own, "at_ms": EXPIRY_MS + at_ms}
        return {"name": name, "configuration": configuration, **at, "expect": expect}

    late, wide = own(object=24, region=2), "at least 5 h, regions at most 6 h"
    return [
        order("before the least", RULES, {}, HOUR_MS - 1, "NOT_YET_VALID"),
        order("at the least", RULES, {}, HOUR_MS, "ok"),
        order("before the least, with times", RULES, late, HOUR_MS - 1, "NOT_YET_VALID"),
        order("at the least, before the mission's times", RULES, late, HOUR_MS, "ok"),
        order("before the longer least", wide, own(region=6), 5 * HOUR_MS - 1, "NOT_YET_VALID"),
        order("at the longer least", wide, own(region=6), 5 * HOUR_MS, "ok"),
    ]
