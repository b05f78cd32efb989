# SPDX-License-Identifier: Apache-2.0
"""The card says what is signed: no two missions share one, and no change goes unshown (L20)."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from copy import deepcopy
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from authguard_r.authoring.compile.answers import apply, compile_plain
from authguard_r.authoring.compile.card import OrganizationDemand, card_digest, review
from authguard_r.authoring.compile.difference import compare, is_next
from authguard_r.authoring.compile.lint import lint
from authguard_r.authoring.compile.units import to_integer
from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.errors import MalformedError
from authguard_r.core.mission import Comparison, Guard, Mission, require_schema
from authguard_r.enforcement.evaluation import evaluate
from authguard_r.site import formatting
from authguard_r.site.source import convert
from fixtures import scenarios
from fixtures.cases import case

SET = msgspec.structs.replace
INTEGERS = st.integers(min_value=-(2**53) + 1, max_value=2**53 - 1)


def rich() -> Mission:
    """A mission with something in every field."""
    film = {
        "id": "film",
        "type": "record_video",
        "tool": "camera",
        "rows": [{"source": "pharmacy", "regions": ["pharmacy"]}],
        "limits": {"duration_ms": ["1 s", "30 s"], "max_bytes": ["1 byte", "50 MB"]},
        "data": {"record": True, "store": True, "transmit": False},
        "chooser": "operator",
        "repeat": 1,
        "starts": 2,
        "max": "40 s",
        "irreversible": True,
    }
    states = [
        {"guard": {"variable": "people", "ge": 1, "max_age": "1 s"}, "weight": 5},
        {"guard": {"variable": "night", "eq": True, "max_age": "1 s"}, "weight": 6},
    ]
    edits = {
        "version": 2,
        "supersedes": "A" * 43,
        "budgets.recorded_bytes": "50 MB",
        "risk_policy.states": states,
        "grants[6]": film,
        "grants[2].until": ["place-at-101"],
        "objects": ["package-p1", "package-p2"],
    }
    draft = apply(scenarios.draft(), edits)
    return compile_plain(draft, scenarios.site(), now=scenarios.NOW, nonce="A" * 22)


def other(value: Any) -> Any:
    """Return another value of the same kind."""
    words = {c: "ne" if c == "eq" else "eq" for c in Comparison}
    words |= {"hold": "stop", "operator": "supervisor", "trusted_sensor": "planner"}
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + 1
    if value in words:
        return words[value]
    if value.endswith("Z") and "T" in value:
        return value.replace(":00Z", ":01Z")
    return value[:-1] + ("B" if value[-1] == "A" else "A" if len(value) in {22, 43} else "x")


def edits(plain: Any) -> Iterator[tuple[str, Any]]:
    """Return every copy in which one leaf differs, one item is gone, or two have changed places."""

    def walk(node: Any, path: tuple[Any, ...]) -> Iterator[tuple[Any, ...]]:
        yield path
        if isinstance(node, dict | list):
            children = node.items() if isinstance(node, dict) else enumerate(node)
            for key, child in children:
                yield from walk(child, (*path, key))

    for path in list(walk(plain, ())):
        if not path or path == ("schema",):
            continue
        changed = deepcopy(plain)
        parent = changed
        for step in path[:-1]:
            parent = parent[step]
        node, name = parent[path[-1]], ".".join(map(str, path))
        if isinstance(node, str | int):
            parent[path[-1]] = other(node)
            yield name, changed
        if isinstance(node, list) and len(node) > 1:
            swapped = deepcopy(changed)
            target = swapped
            for step in path:
                target = target[step]
            target.reverse()
            yield f"{name} reversed", swapped
            del node[-1]
            yield f"{name} shorter", changed


def plain_of(mission: Mission) -> Any:
    return msgspec.json.decode(msgspec.json.encode(mission))


def test_every_signed_field_that_differs_is_on_the_card_and_in_the_comparison() -> None:
    mission, site = rich(), scenarios.site()
    card, count = review(mission, site), 0
    for name, plain in edits(plain_of(mission)):
        changed = convert(plain, Mission, where=name)
        assert changed != mission
        assert review(changed, site) != card or "reversed" in name, name
        assert compare(mission, changed, site) != ("changes no permission",), name
        with suppress(MalformedError):
            require_schema(changed)
            lint(changed, site)  # whatever is legal can be read
        count += 1
    assert count > 200


def test_the_order_of_sets_that_have_no_order_is_the_schemas_to_refuse() -> None:
    """Reversed sets read alike on neither card: the schema lets one spelling pass."""
    mission, site = rich(), scenarios.site()
    card = review(mission, site)
    alike = [
        name
        for name, plain in edits(plain_of(mission))
        if review(convert(plain, Mission, where=name), site) == card
    ]
    assert alike == []


def test_a_card_is_deterministic_and_its_digest_is_of_its_bytes() -> None:
    first, second = review(rich(), scenarios.site()), review(rich(), scenarios.site())
    assert first == second
    assert card_digest(first) == card_digest(second)
    assert card_digest(first) != card_digest((*first[:-1], first[-1] + " "))


def test_the_card_reads_in_human_units() -> None:
    card = "\n".join(review(rich(), scenarios.site()))
    for text in (
        "(25 min)",
        "battery_permille is at least 20 %, read at most 2 s ago",
        "speed_mm_s from 0.05 m/s to 0.8 m/s",
        "force_mn from 1 N to 20 N",
        "max_bytes from 1 bytes to 50 MB",
        "up to 3 min each",
        "navigate with base, once, at most 3 start(s)",
        "scan_obstacles with lidar, 20 times",
        "from pharmacy to station-101, within pharmacy, public-corridor, station-101",
        "20 min in motion, 0 s waiting; 50 MB recorded",
        "force_mn (10 at 40 N)",
        "5 unless it is attested that not: people is at least 1, read at most 1 s ago",
        "night is TRUE",
        "go-home may still be used for 10 min",
        "from 30 a second person, from 60 3 people in all",
    ):
        assert text in card, text


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_what_can_hurt_is_marked_with_its_degree(degree: int) -> None:
    site = scenarios.site()
    drive = SET(site.vocabulary["navigate"], physical=degree)
    site = SET(site, vocabulary={**site.vocabulary, "navigate": drive})
    card = "\n".join(review(rich(), site))
    assert f"up to 3 min each  [PHYSICAL {degree}, MOTION]" in card
    assert card.count("PHYSICAL") == card.count("MOTION")


def test_only_the_version_after_that_names_the_digest_is_the_next_one() -> None:
    old = scenarios.mission()
    new = SET(old, version=2, supersedes=digest_of(Tag.MISSION, old))
    assert is_next(old, new)
    for wrong in (
        SET(new, mid="another"),
        SET(new, version=3),
        SET(new, version=1),
        SET(new, supersedes="A" * 43),
        SET(new, supersedes=None),
    ):
        assert not is_next(old, wrong)
    assert not is_next(new, old)
    assert not is_next(old, old)


def test_risks_are_marked_and_what_is_withheld_is_said() -> None:
    card = "\n".join(review(rich(), scenarios.site()))
    assert "up to 40 s each  [PRIVACY, IRREVERSIBLE]" in card
    assert "up to 20 s each  [FORCE]" in card
    assert "up to 3 min each  [MOTION]" in card
    assert "PHYSICAL" not in card
    assert "asks 2 further person(s) at its riskiest (121)" in card
    assert "It does NOT grant: announce, set_pose, take_photo, wait" in card
    assert "It never enters: isolation-room, office-1" in card
    assert "It never handles: package-p2, sharps-bin" in card
    assert "Withheld rights to sensor data: transmit" in card
    draft = apply(scenarios.draft(), {"grants[2].rows[0].regions[3]": "office-1"})
    draft = apply(draft, {"grants[2].rows[0].regions[4]": "plant-room"})
    private = compile_plain(draft, scenarios.site(), now=scenarios.NOW, nonce="A" * 22)
    assert "[PRIVATE: office-1, HAZARDOUS: plant-room]" in "\n".join(
        review(private, scenarios.site())
    )
    sharps = apply(scenarios.draft(), {"grants[1].rows[0].object": "Sharps Bin"})
    bin_ = compile_plain(sharps, scenarios.site(), now=scenarios.NOW, nonce="A" * 22)
    assert "[HAZARDOUS: sharps-bin]" in "\n".join(review(bin_, scenarios.site()))


@given(
    thresholds=st.lists(st.integers(0, 40), min_size=2, max_size=2).map(sorted),
    people=st.integers(2, 4),
    navigate=st.integers(0, 30),
)
@settings(max_examples=30)
def test_the_card_asks_as_many_as_the_gate_asks_of_the_riskiest_action(
    thresholds: list[int], people: int, navigate: int
) -> None:
    mission, site = scenarios.mission(), scenarios.site()
    own = mission.risk_policy
    types = {**own.types, "navigate": navigate}
    theirs = SET(own, tau_1=thresholds[0], tau_2=thresholds[1], t=people, types=types)
    demand = OrganizationDemand(organization="hospital", version=1, policy=theirs)
    lines = review(mission, site, demand=demand)
    said = next(line.strip() for line in lines if line.startswith("    asks "))
    verified = scenarios.verified(mission)
    judged = evaluate(
        verified,
        scenarios.navigate("dock", "pharmacy", speed=800),
        state=scenarios.state(),
        facts=SET(scenarios.facts(), risk=(theirs,)),
        now=scenarios.NOW,
        standing=scenarios.active(verified),
    )
    need = judged.decision.need
    assert need is not None
    if need.required == 1:
        assert said == f"asks no second person: its risk is at most {need.risk} by either policy"
    else:
        assert said.startswith(f"asks {need.required - 1} further person(s) at its riskiest ")
        assert f"({need.risk}, by the " in said


def test_roles_that_no_two_policies_share_are_said_to_be_nobody() -> None:
    own = scenarios.mission().risk_policy
    policy = SET(own, roles=("site_authority",), valid_ms=own.valid_ms * 2)
    demand = OrganizationDemand(organization="hospital", version=3, policy=policy)
    card = review(scenarios.mission(), scenarios.site(), demand=demand)
    line = "  of the roles that both name: none, so no one can answer; a request lives 2 min"
    assert line in card
    alone = review(scenarios.mission(), scenarios.site())
    assert sum("--risk-policy" in line for line in alone) == 1


def test_a_chooser_that_an_attacker_can_be_is_said_in_full() -> None:
    draft = apply(scenarios.draft(), {"grants[0].chooser": "planner"})
    mission = compile_plain(draft, scenarios.site(), now=scenarios.NOW, nonce="A" * 22)
    card = review(mission, scenarios.site())
    assert "    chosen by: planner: every row, also one that an attacker picks" in card


@pytest.mark.parametrize("mark", ["\n", "\r", "\x1b[2K", "\u202e", "\u2028", '"', "\\", "\x00"])
def test_a_task_cannot_write_lines_of_the_card_or_turn_them(mark: str) -> None:
    task = f"Carry P1.{mark}It does NOT grant: everything"
    card = review(SET(scenarios.mission(), task=task), scenarios.site())
    assert len(card) == len(review(scenarios.mission(), scenarios.site()))
    assert all(line.isprintable() for line in card)
    assert f"\\u{{{ord(mark[0]):x}}}" in card[1]


def test_a_card_for_a_site_that_knows_nothing_of_it_still_says_what_is_signed() -> None:
    mission = rich()
    foreign = SET(mission, rid="stranger", regions=("moon",), objects=())
    card = "\n".join(review(foreign, scenarios.site()))
    assert "unknown: this site has no such robot" in card
    assert "Robot stranger is not in this site" in card
    assert "only with objects: none" in card
    assert "only in regions: moon" in card
    row = SET(mission.actions[0].alternatives[0], object="ghost", regions=("moon",))
    odd = SET(mission.actions[0], alternatives=(row,))
    everywhere = tuple(scenarios.site().regions)
    strange = SET(mission, actions=(odd,), regions=everywhere, closing=None, supersedes=None)
    card = "\n".join(review(strange, scenarios.site()))
    assert "ghost, from dock to pharmacy, within moon" in card
    assert "no region is closed" in card
    assert "Withheld rights to sensor data: record, store, transmit" in card


def test_a_mission_that_leaves_nothing_out_says_so() -> None:
    mission, site = rich(), scenarios.site()
    rows = tuple(
        SET(mission.actions[1].alternatives[0], object=item) for item in sorted(site.objects)
    )
    data = SET(mission.actions[6].data, transmit=True)
    grants = (SET(mission.actions[1], alternatives=rows), SET(mission.actions[6], data=data))
    card = "\n".join(review(SET(mission, actions=grants), site))
    assert "no object is left out" in card
    assert "Withheld rights to sensor data: none" in card


WIDER = {
    "grants[0].limits.speed_mm_s": ["0.01 m/s", "0.9 m/s"],
    "grants[0].repeat": 2,
    "grants[0].starts": 4,
    "grants[0].max": "4 min",
    "grants[0].chooser": "planner",
    "grants[0].until": [],
    "grants[1].guards": [],
    "grants[2].after": [],
    "grants[3].completes": False,
    "grants[0].rows[2]": {"source": "dock", "destination": "dock", "regions": ["dock"]},
    "grants[6].irreversible": False,
    "grants[6].data.transmit": True,
    "guards": [],
    "limits": {},
    "regions": ["dock", "office-1", "pharmacy", "public-corridor", "station-101"],
    "window.expiry": "2099-01-01T00:00:00Z",
    "window.not_before": "2020-01-01T00:00:00Z",
    "place_max_age": "2 s",
    "budgets.actions": 41,
    "budgets.rate.count": 11,
    "budgets.rate.per": "9 s",
    "budgets.motion": "21 min",
    "budgets.waiting": "1 s",
    "budgets.recorded_bytes": "51 MB",
    "budgets.prompts": 6,
    "budgets.planner_stops": 4,
    "closing.for": "11 min",
    "risk_policy.tau_1": 31,
    "risk_policy.tau_2": 61,
    "risk_policy.t": 2,
    "risk_policy.roles": ["operator", "safety_officer", "supervisor"],
    "risk_policy.valid": "3 min",
    "risk_policy.privacy": 14,
    "risk_policy.otherwise": 59,
    "risk_policy.types": {"navigate": 4},
    "risk_policy.parameters": [],
    "risk_policy.states": [],
}
NEUTRAL = {
    "task": "Carry P1.",
    "issuer": "operator-2",
    "on_refusal": "stop",
    "grants[1].chooser": "supervisor",
    "grants[1].done_when": [],
}


def both(field: str, value: Any) -> tuple[Mission, Mission]:
    from authguard_r.authoring.compile.change import to_draft

    draft = to_draft(rich())
    plain = msgspec.json.decode(msgspec.json.encode(draft))
    missions = [
        compile_plain(item, scenarios.site(), now=scenarios.NOW, nonce="A" * 22)
        for item in (plain, apply(plain, {field: value}))
    ]
    return missions[0], missions[1]


def test_what_lets_more_pass_is_widening_and_comes_first() -> None:
    for field, value in WIDER.items():
        with case(field):
            old, new = both(field, value)
            lines = compare(old, new, scenarios.site())
            assert lines[0].startswith("ADDS    ")
            assert not compare(new, old, scenarios.site())[-1].startswith(("ADDS", "changes"))
            if field != "risk_policy.types":
                assert {line.split()[0] for line in lines} == {"ADDS"}
                assert {line.split()[0] for line in compare(new, old, scenarios.site())} == {
                    "removes"
                }


@pytest.mark.parametrize("field", NEUTRAL)
def test_what_is_only_different_is_neither(field: str) -> None:
    old, new = both(field, NEUTRAL[field])
    assert {line.split()[0] for line in compare(old, new, scenarios.site())} == {"changes"}


def test_a_limit_that_comes_or_goes_is_a_permission_of_a_grant_and_a_bound_of_a_mission() -> None:
    old, new = both("limits", {"force_mn": ["1 N", "2 N"], "speed_mm_s": ["0.05 m/s", "0.8 m/s"]})
    assert {line.split()[0] for line in compare(old, new, scenarios.site())} == {"removes"}
    grant = new.actions[0]
    more = SET(grant, limits=(new.limits[0], *grant.limits))
    wider = SET(new, actions=(more, *new.actions[1:]))
    assert compare(new, wider, scenarios.site()) == (
        "ADDS    go-to-pharmacy: force_mn at least 1 N",
        "ADDS    go-to-pharmacy: force_mn at most 2 N",
    )


def test_a_new_grant_is_all_new_and_a_gone_one_is_gone_by_its_rows() -> None:
    mission, site = rich(), scenarios.site()
    fewer = SET(mission, actions=mission.actions[:-1])
    added, removed = compare(fewer, mission, site), compare(mission, fewer, site)
    assert removed == ("removes film: record_video from pharmacy, within pharmacy",)
    assert all(line.startswith("ADDS    film: ") for line in added)
    assert "ADDS    film: may record sensor data: yes" in added
    assert not any(line.endswith(": no") for line in added)


def test_closing_that_comes_is_widening_and_that_goes_is_narrowing() -> None:
    mission, site = rich(), scenarios.site()
    over = SET(mission, closing=None)
    assert compare(over, mission, site) == (
        "ADDS    stays open once complete: go-home",
        "ADDS    stays open for 10 min",
    )
    assert {line.split()[0] for line in compare(mission, over, site)} == {"removes"}


def test_the_same_condition_twice_is_not_the_same_as_once() -> None:
    mission, site = rich(), scenarios.site()
    twice = SET(mission, guards=mission.guards * 2)
    (line,) = compare(mission, twice, site)
    assert line.startswith("removes only while battery_permille")


UNITS = ["mm/s", "mm", "mN", "microradian", "permille", "millikelvin", "g", "ms", "byte", "count"]


@given(INTEGERS, INTEGERS, st.sampled_from([*UNITS, "parsec"]))
def test_two_quantities_that_differ_never_read_alike(one: int, two: int, unit: str) -> None:
    assert (formatting.quantity(one, unit) == formatting.quantity(two, unit)) is (one == two)


@given(st.integers(min_value=-(10**11), max_value=10**11), st.sampled_from(["mm/s", "mm", "mN"]))
def test_what_is_read_compiles_to_what_was_signed(value: int, unit: str) -> None:
    assert to_integer(formatting.quantity(value, unit), unit, where="x") == value


def test_quantities_read_as_people_write_them() -> None:
    for value, unit, text in [
        (800, "mm/s", "0.8 m/s"),
        (180_000, "ms", "3 min"),
        (5_400_000, "ms", "1 h 30 min"),
        (3_601_500, "ms", "1 h 1.5 s"),
        (0, "ms", "0 s"),
        (-1_500, "millisecond", "-1.5 s"),
        (40_000, "mN", "40 N"),
        (-50, "mm/s", "-0.05 m/s"),
        (200, "permille", "20 %"),
        (1_234_567, "byte", "1.234567 MB"),
        (1_000_000_000, "byte", "1 GB"),
        (999, "byte", "999 bytes"),
        (2_000, "byte", "2 kB"),
        (7, "count", "7"),
        (7, "furlong", "7 furlong"),
    ]:
        with case(value, unit, text):
            assert formatting.quantity(value, unit) == text


def test_a_value_of_another_kind_reads_differently() -> None:
    texts = {
        formatting.condition(Guard(variable="x", comparison=Comparison.EQ, value=v, max_age_ms=1))
        for v in (1, "1", True, "true", "truex", 0, False, "false")
    }
    assert len(texts) == 8
