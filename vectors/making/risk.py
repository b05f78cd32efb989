# SPDX-License-Identifier: Apache-2.0
"""Risk: rho in its parts, the tier and Req of each policy, and the strictest of several.

What is expected is written here by hand, from docs/spec/approval.md; the digests of scope and
situation are the oracle's.
"""

from __future__ import annotations

from typing import Any

from authguard_reference.approval import scope_of, situation_of
from fixtures import decision_cases, scenarios
from making.answers import MISSION, action, state
from making.risk_policies import organization_vectors

Json = dict[str, Any]

PARTS = ("type", "regions", "object", "privacy", "parameters", "states")
NEAR: Json = {
    "guard": {
        "variable": "human_distance_mm",
        "comparison": "lt",
        "value": 1_000,
        "max_age_ms": 1_000,
    },
    "weight": 30,
}
#: The hospital's policy, which also weighs speed and people who are near.
POLICY: Json = {
    **decision_cases.plain(scenarios.mission().risk_policy),
    "parameters": [
        {"parameter": "force_mn", "full_scale": 40_000, "weight": 10},
        {"parameter": "speed_mm_s", "full_scale": 1_000, "weight": 8},
    ],
    "states": [NEAR],
}
#: From the dock to the pharmacy at 500 mm/s: rho = 5 + 5 + 0 + 0 + 4 + 0 = 14.
WAY = (5, 5, 0, 0, 4, 0)


def facts() -> Json:
    """Return the hospital's facts, with places and things of other tags and classes."""
    plain: Json = decision_cases.plain_facts(scenarios.facts())
    more = {"lobby": [], "laboratory": ["hazardous", "restricted"], "attic": ["unheard-of"]}
    for name, tags in more.items():
        plain["regions"][name] = {**plain["regions"]["dock"], "tags": tags}
    plain["objects"]["stool"] = "furniture"
    return plain


def move(*, to: str = "pharmacy", speed: int | None = 500, **changes: Any) -> Json:
    """Return a way from the dock."""
    return action(to, params={} if speed is None else {"speed_mm_s": speed}, **changes)


def pick(item: str, force: int = 20_000) -> Json:
    """Return a grip at the pharmacy."""
    params = {"force_mn": force}
    return {
        "type": "pick",
        "tool": "gripper",
        "object": item,
        "source": "pharmacy",
        "params": params,
    }


def single(kind: str, **changes: Any) -> Json:
    """Return an action without object or place."""
    return {"type": kind, "tool": "base", **changes}


def reading(**changes: Any) -> Json:
    """Return a state whose distance to people was read otherwise; None for no such reading."""
    found: Json = state()
    readings = found["snapshot"]["readings"]
    if changes.pop("gone", False):
        del readings["human_distance_mm"]
    else:
        readings["human_distance_mm"] |= changes
    return found


def of_robot(rid: str) -> Json:
    """Return a state that speaks of another robot."""
    found = state()
    found["snapshot"]["robot"] = rid
    return found


def risk_vectors() -> Json:
    """Actions in states under one policy, under policies at their thresholds, and under several."""
    vectors = [
        vector(name, [POLICY], done, [parts])
        for name, (done, parts) in {**places(), **things(), **parameters()}.items()
    ]
    vectors += [
        vector(name, [POLICY], move(), [(*WAY[:5], weight)], at)
        for name, (at, weight) in states().items()
    ]
    vectors += [*factors(), *thresholds(), *several()]
    policies, states_ = Named(), Named()
    for one in vectors:
        name = one["name"]
        one["policies"] = [policies.name(p, f"{name}: {n}") for n, p in enumerate(one["policies"])]
        one["state"] = states_.name(one["state"], name)
    return {
        "facts": facts(),
        "mission": decision_cases.plain(MISSION),
        "now": decision_cases.plain(scenarios.NOW),
        "policies": policies.values,
        "states": states_.values,
        "vectors": vectors,
        **organization_vectors(POLICY),
    }


class Named:
    """Values under the names of the vectors that first speak of them."""

    def __init__(self) -> None:
        self.values: dict[str, Any] = {}

    def name(self, value: Any, name: str) -> str:
        """Return the name of a value; the given one when it is new."""
        known = next((n for n, v in self.values.items() if v == value), None)
        if known is None:
            self.values[name] = value
        return known or name


def vector(
    name: str,
    policies: list[Json],
    done: Json,
    parts: list[tuple[int, ...]],
    at: Json | str | None = "",
) -> Json:
    """Return a vector; the first policy is the mission's, the others are an organization's."""
    seen = state() if at == "" else at
    each, strictest = [], (0, 0, 0)
    for policy, own in zip(policies, parts, strict=True):
        rho = sum(own)
        tier = 1 if rho < policy["tau_1"] else 2 if rho < policy["tau_2"] else 3
        required = policy["t"] if tier == 3 else tier
        summed = {"rho": rho, "tier": tier, "required": required}
        each.append({"parts": dict(zip(PARTS, own, strict=True)), **summed})
        strictest = max(strictest, (required, tier, rho))
    required, tier, rho = strictest
    expect: Json = {"each": each, "required": required, "tier": tier, "rho": rho}
    if required > 1:
        plain, now = decision_cases.plain(MISSION), decision_cases.plain(scenarios.NOW)
        seen_by: Json = {"state": seen, "facts": facts(), "now": now}
        grant = plain["actions"][0]
        expect["scope"] = scope_of(done)
        expect["situation"] = situation_of(plain, grant, tier, **seen_by)
    return {"name": name, "policies": policies, "action": done, "state": seen, "expect": expect}


def places() -> dict[str, tuple[Json, tuple[int, ...]]]:
    """The heaviest tag of all regions that are named."""
    return {
        "a way through staff's regions": (move(), WAY),
        "to a restricted region": (move(to="isolation-room"), (5, 30, 0, 0, 4, 0)),
        "from a restricted region": (move(source="isolation-room"), (5, 30, 0, 0, 4, 0)),
        "past a private region": (move(route=["public-corridor", "office-1"]), (5, 40, 0, 0, 4, 0)),
        "between regions of weight 0": (
            move(source="station-101", to="station-102"),
            (5, 0, 0, 0, 4, 0),
        ),
        "to a region of two tags: the heavier one": (move(to="laboratory"), (5, 60, 0, 0, 4, 0)),
        "to a region whose tag is not listed": (move(to="attic"), (5, 60, 0, 0, 4, 0)),
        "to a region that the site does not know": (move(to="nowhere"), (5, 60, 0, 0, 4, 0)),
        "between regions without tags": (move(source="lobby", to="lobby"), (5, 0, 0, 0, 4, 0)),
        "without any region": (single("wait"), (2, 0, 0, 0, 0, 0)),
    }


def things() -> dict[str, tuple[Json, tuple[int, ...]]]:
    """Classes of objects, types, and what the types mean for privacy."""
    return {
        "a thing of a listed class": (pick("package-p1"), (5, 5, 5, 0, 5, 0)),
        "a thing of a hazardous class": (pick("sharps-bin"), (5, 5, 50, 0, 5, 0)),
        "a thing of a class that is not listed": (pick("stool"), (5, 5, 60, 0, 5, 0)),
        "a thing that the site does not know": (pick("unheard-of"), (5, 5, 60, 0, 5, 0)),
        "a type of weight 0": (single("announce"), (0, 0, 0, 0, 0, 0)),
        "a type that is not listed": (single("set_pose"), (60, 0, 0, 0, 0, 0)),
        "a type with a privacy impact of 2": (single("take_photo"), (60, 0, 0, 30, 0, 0)),
        "a type with a privacy impact of 3": (single("record_video"), (60, 0, 0, 45, 0, 0)),
        "a type that the vocabulary does not know": (single("fly"), (60, 0, 0, 45, 0, 0)),
    }


def parameters() -> dict[str, tuple[Json, tuple[int, ...]]]:
    """Shares of the full scale, rounded up; backwards is as fast."""
    speeds = {500: 4, 501: 5, 625: 5, 626: 6, 1: 1, 0: 0, -1: 1, -500: 4, 1_000: 8, 2_500: 20}
    found = {
        f"a speed of {n}": (move(speed=n), (5, 5, 0, 0, share, 0)) for n, share in speeds.items()
    }
    force = pick("package-p1", 20_001)
    both = {**move(), "params": {"speed_mm_s": 1, "force_mn": 1}}
    return {
        **found,
        "a share of the force rounded up": (force, (5, 5, 5, 0, 6, 0)),
        "each parameter rounded up by itself": (both, (5, 5, 0, 0, 2, 0)),
        "a parameter that is not there": (move(speed=None), (5, 5, 0, 0, 0, 0)),
        "a parameter that has no weight": (
            {**move(), "params": {"speed_mm_s": 500, "duration_ms": 9_000}},
            WAY,
        ),
    }


def states() -> dict[str, tuple[Json | None, int]]:
    """A state counts unless it is attested that it is not so."""
    return {
        "somebody is near": (reading(value=999), 30),
        "nobody is near, by a millimeter": (reading(value=1_000), 0),
        "no reading": (reading(gone=True), 30),
        "no state": (None, 30),
        "a reading in its last millisecond": (reading(age_ms=1_000), 0),
        "a reading that is stale": (reading(age_ms=1_001), 30),
        "a reading of the time to come": ({**state(), "arrived_mono_ms": 10_001}, 30),
        "a reading of a camera": (reading(label="camera"), 30),
        "a state of another robot": (of_robot("lifter-1"), 30),
        "a reading that is no number: its guard is false": (reading(value="far"), 0),
        "a reading that is a truth value: its guard is false": (reading(value=True), 0),
    }


def factors() -> list[Json]:
    """Policies whose own numbers are at an end."""
    none = {**POLICY, "privacy": 0}
    light = {**POLICY, "otherwise": 0}
    twice = {**POLICY, "states": [NEAR, {**NEAR, "weight": 1}]}
    empty = {k: v for k, v in POLICY.items() if k not in {"parameters", "states"}}
    bare = {**empty, "types": {}, "region_tags": {}, "object_classes": {}}
    video = single("record_video")
    return [
        vector("a policy without privacy", [none], video, [(60, 0, 0, 0, 0, 0)]),
        vector("what is not listed weighs nothing", [light], video, [(0, 0, 0, 45, 0, 0)]),
        vector("two states at once", [twice], move(), [(*WAY[:5], 31)], None),
        vector(
            "a policy without parameters and states", [empty], move(), [(5, 5, 0, 0, 0, 0)], None
        ),
        vector("a policy that lists nothing", [bare], pick("package-p1"), [(60, 60, 60, 0, 0, 0)]),
    ]


def thresholds() -> list[Json]:
    """A rho of 14 at both thresholds, one below and one above."""
    taus = [(13, 14), (14, 14), (14, 15), (15, 15), (13, 15), (14, 60), (15, 60), (0, 0), (0, 15)]
    found = [
        vector(
            f"rho 14 under {one} and {two}", [{**POLICY, "tau_1": one, "tau_2": two}], move(), [WAY]
        )
        for one, two in taus
    ]
    zero = {**POLICY, "tau_1": 0, "tau_2": 1}
    calm = (0, 0, 0, 0, 0, 0)
    found.append(vector("rho 0 under 0 and 1", [zero], single("announce"), [calm]))
    for t in (2, 64):
        high = {**POLICY, "tau_1": 14, "tau_2": 14, "t": t}
        found.append(vector(f"the third tier of t = {t}", [high], move(), [WAY]))
    return found


def several() -> list[Json]:
    """The mission's policy and an organization's: the largest (Req, tier, rho) counts."""
    second = {**POLICY, "tau_1": 14}
    third = {**POLICY, "tau_1": 14, "tau_2": 14}
    of_two = {**third, "t": 2}
    fast = {**second, "parameters": [{"parameter": "speed_mm_s", "full_scale": 1, "weight": 1}]}
    heavy = (5, 5, 0, 0, 500, 0)
    cases_: list[tuple[str, list[Json], list[tuple[int, ...]]]] = [
        ("the organization's is stricter", [POLICY, second], [WAY, WAY]),
        ("the mission's is stricter", [second, POLICY], [WAY, WAY]),
        ("the organization's third tier over the mission's second", [second, third], [WAY, WAY]),
        ("a third tier of two over a second tier", [second, of_two], [WAY, WAY]),
        ("more people over a higher tier", [of_two, {**third, "t": 4}], [WAY, WAY]),
        ("more people over a greater rho", [third, {**fast, "tau_2": 600}], [WAY, heavy]),
        ("a greater rho of the same tier", [second, {**fast, "tau_2": 600}], [WAY, heavy]),
        ("a greater rho that needs nobody", [POLICY, {**fast, "tau_1": 600, "tau_2": 600}], [WAY, heavy]),
        ("two organizations' policies", [POLICY, second, third], [WAY, WAY, WAY]),
    ]  # fmt: skip
    return [vector(name, policies, move(), parts) for name, policies, parts in cases_]
