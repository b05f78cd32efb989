# SPDX-License-Identifier: Apache-2.0
"""The lint: sentence and mission pairs, each with exactly the findings that a reader would have.

Each pair is the hospital's mission with a small edit (tests/fixtures/lint). `draft` edits what a
person writes, `signed` what only a mission file can hold, `site` the site beneath both.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.authoring.compile.answers import apply, compile_plain
from authguard_r.authoring.compile.card import review
from authguard_r.authoring.compile.lint import (
    LintCode,
    Measures,
    Severity,
    errors,
    finding_lines,
    lint,
    lint_alone,
)
from authguard_r.authoring.compile.worst import facts_for, worst_risk
from authguard_r.core.action import Action
from authguard_r.core.identifiers import ParameterId, RegionId
from authguard_r.core.mission import (
    Comparison,
    Guard,
    Limit,
    Mission,
    ParameterRisk,
    require_schema,
)
from authguard_r.core.quantities import Now
from authguard_r.core.risk import rho
from authguard_r.site.model import Site
from authguard_r.site.source import convert, read_text, read_yaml
from fixtures import scenarios
from fixtures.cases import case

FOLDER = Path(__file__).resolve().parents[2] / "fixtures" / "lint"
PAIRS = sorted(path.stem for path in FOLDER.glob("*.yaml"))
#: The shipped mission with the one guard that the lint asks for.
GUARDED = {"grants[5].guards": [{"variable": "holding", "eq": "nothing", "max_age": "1 s"}]}
SET = msgspec.structs.replace


@cache
def pair(name: str) -> dict[str, Any]:
    plain = read_yaml(read_text(FOLDER / f"{name}.yaml"), where=name)
    assert isinstance(plain, dict)
    assert set(plain) <= {"shows", "task", "site", "draft", "signed", "findings", "near_miss"}
    return plain


def merged(old: Any, new: Any) -> Any:
    if not isinstance(old, Mapping) or not isinstance(new, Mapping) or "kind" in new:
        return new
    return {**old, **{key: merged(old.get(key), value) for key, value in new.items()}}


def world(plain: dict[str, Any]) -> tuple[Mission, Site]:
    source = read_yaml(read_text(scenarios.HOSPITAL / "site.yaml"), where="site")
    site = convert(merged(source, plain.get("site", {})), Site, where="site")
    task = plain.get("task", scenarios.draft()["task"])
    own = plain.get("draft", {})
    edits = {**({} if "grants" in own else GUARDED), "task": task, **own}
    draft = apply(scenarios.draft(), edits)
    mission = compile_plain(draft, site, now=scenarios.NOW, nonce="A" * 22)
    signed = apply(msgspec.json.decode(msgspec.json.encode(mission)), plain.get("signed", {}))
    mission = convert(signed, Mission, where="mission")
    require_schema(mission)
    return mission, site


@cache
def world_of(name: str) -> tuple[Mission, Site]:
    return world(pair(name))


def test_a_pair_has_exactly_its_findings() -> None:
    for name in PAIRS:
        with case(name):
            plain = pair(name)
            found = lint(*world_of(name))
            told = [[str(f.code), f.where, str(f.severity)] for f in found]
            assert sorted(told) == sorted(plain["findings"])
            assert plain.get("near_miss") not in {f.code for f in found}
            assert all(f.message and f.mend for f in found)


def test_every_code_has_a_pair_with_it_and_a_near_miss_without() -> None:
    assert len(PAIRS) >= 30
    assert {code for name in PAIRS for code, _, _ in pair(name)["findings"]} == set(LintCode)
    assert {pair(name).get("near_miss") for name in PAIRS} - {None} == set(LintCode)


def test_the_shipped_missions_have_no_error() -> None:
    for name in ("mission.yaml", "mission-v2.yaml"):
        mission = scenarios.mission(name, **({"supersedes": "A" * 43} if "v2" in name else {}))
        assert errors(lint(mission, scenarios.site())) == ()


def test_errors_come_first_and_each_line_has_its_mend() -> None:
    found = lint(*world_of("18-filming-for-a-week"))
    assert [f.severity for f in found] == [Severity.ERROR, *[Severity.WARNING] * 2]
    assert errors(found) == (LintCode.RETENTION_OPEN,)
    lines = finding_lines(found)
    assert lines[0].startswith("ERROR   RETENTION_OPEN at actions[6].data.store: `film` keeps")
    assert lines[1].strip().startswith("to do in the draft at grants[6].data.store: ")
    assert len(lines) == 6


def test_a_site_may_draw_its_lines_elsewhere() -> None:
    mission, site = world_of("25-a-whole-day-for-ten-minutes")
    assert lint(mission, site, Measures(window_factor=1_000)) == ()
    mission, site = world_of("17-filming-as-asked")
    assert errors(lint(mission, site, Measures(retention_ms=1))) == (LintCode.RETENTION_OPEN,)
    mission, site = world_of("41-a-stream-that-goes-on")
    assert lint(mission, site, Measures(stream_ms=10_000)) == ()
    mission, site = world_of("01-going-home-with-empty-hands")
    assert errors(lint(mission, site, Measures(forceful_percent=50))) == (LintCode.NEVER_ASKS,)


def guard(comparison: str, value: Any) -> Guard:
    return Guard(variable="x", comparison=Comparison(comparison), value=value, max_age_ms=1)


def test_guards_that_contradict_each_other_are_seen() -> None:
    for guards, can_hold in [
        ([("ge", 3), ("le", 3)], True),
        ([("gt", 3), ("le", 3)], False),
        ([("gt", 3), ("lt", 5)], True),
        ([("gt", 3), ("lt", 4)], False),
        ([("eq", 3), ("eq", 3), ("ne", 4), ("lt", 4), ("le", 3), ("gt", 2), ("ge", 3)], True),
        ([("eq", 3), ("eq", 4)], False),
        ([("eq", 3), ("ne", 3)], False),
        ([("eq", True), ("eq", 1)], False),
        ([("eq", "a"), ("ge", "a")], False),
        ([("eq", True), ("ge", True)], False),
        ([("eq", "a"), ("ne", "b")], True),
        ([("ne", "a"), ("ne", "b")], True),
        ([("ge", "a")], False),
        ([("ge", True)], False),
    ]:
        with case(guards, can_hold):
            mission, site = world({"findings": []})
            first = SET(mission.actions[0], guards=tuple(guard(*g) for g in guards))
            found = lint(SET(mission, actions=(first, *mission.actions[1:])), site)
            assert (LintCode.NEVER_MATCHES in errors(found)) is not can_hold


PLACELESS = {
    "02-going-home-at-any-time": {("UNGUARDED_RETURN", "actions[5].guards", "error")},
    "04-waiting-at-any-time": {("UNGUARDED_RETURN", "actions[6].guards", "error")},
    "05-waiting-at-a-closed-door": set(),
    "27-waits-for-itself": {
        ("NEVER_MATCHES", "actions[2].after", "error"),
        ("NEVER_MATCHES", "actions[3].after", "error"),
    },
    "28-closed-before-it-opens": {("NEVER_MATCHES", "actions[2].until", "error")},
    "33-battery-both-low-and-high": {("NEVER_MATCHES", "actions[5].guards", "error")},
    "57-a-mission-that-is-the-way-home-at-any-time": set(),  # nobody knows where home is
    "60-a-guard-that-every-battery-fulfils": {("UNGUARDED_RETURN", "actions[5].guards", "error")},
}


# what a sentence forbids, and which way a parameter goes

THROUGH_PLANT = {
    "grants[2].rows[0].regions": ["pharmacy", "plant-room", "public-corridor", "station-101"]
}
DELIVER = "Carry medicine package P1 from Pharmacy Desk A to Nurse Station 101"


def sensitive(task: str) -> list[str]:
    """Return how the way through the plant room is judged under a task."""
    mission, site = world({"task": task, "draft": THROUGH_PLANT})
    return [str(f.severity) for f in lint(mission, site) if f.code is LintCode.THROUGH_SENSITIVE]


def test_the_attack_a_denial_that_names_a_region_opens_no_way_through_it() -> None:
    for denial in [
        ". Never go through Plant Room.",
        ". Never go through Office 1, Office 2, or the Plant Room!",
        ". The Plant Room must not be entered",
        ". The Plant Room is off-limits",
        ". The Plant Room isn't yours; nor is Office 1",
        ". Don\u2019t enter the Plant Room?",
        ". DO NOT ENTER: Plant Room",
        ". DO_NOT_ENTER Plant_Room",
        ". Keep out  of the Plant Room",
        " without touching the Plant Room",
        ", avoiding the Plant Room",
        # what is left out is a gap: the words around it make no name together
        ". Look at the Plant. Never stop. Room",
    ]:
        with case(denial):
            assert sensitive(DELIVER + denial) == ["error"]


@pytest.mark.parametrize(
    "asked",
    [
        " by way of the Plant Room.",
        ". Go through the PLANT ROOM. Never stop.",
        ". Do not wait! Take the Plant Room",
    ],
)
def test_a_region_that_the_task_asks_for_is_still_shown(asked: str) -> None:
    assert sensitive(DELIVER + asked) == ["warning"]


def test_the_end_of_a_row_is_no_way_through_whatever_the_task_denies() -> None:
    plain = pair("24-to-an-office")
    mission, site = world({**plain, "task": f"{DELIVER}. Never enter Office 1."})
    assert LintCode.THROUGH_SENSITIVE not in {f.code for f in lint(mission, site)}


def bounded(low: int, high: int, parameter: str, grant: int) -> tuple[Mission, Site]:
    """Return the shipped mission with one grant's bounds, nobody asked below what full scale is."""
    mission, site = world({})
    one = Limit(parameter=ParameterId(parameter), low=low, high=high)
    own = [*mission.actions]
    own[grant] = SET(own[grant], limits=(one,))
    return SET(mission, actions=tuple(own)), site


@pytest.mark.parametrize(("low", "high"), [(-1_000, 0), (0, 1_000), (-1_000, 10), (-10, 1_000)])
def test_backwards_is_as_risky_as_forwards(low: int, high: int) -> None:
    mission, site = bounded(low, high, "speed_mm_s", 2)
    mission = SET(
        mission,
        risk_policy=SET(
            mission.risk_policy,
            parameters=(
                ParameterRisk(parameter=ParameterId("speed_mm_s"), full_scale=1_000, weight=50),
            ),
        ),
    )
    facts = facts_for(mission, site)
    assert facts is not None
    grant = mission.actions[2]
    row = grant.alternatives[0]

    def risk_at(speed: int) -> int:
        action = Action(
            type=grant.type,
            tool=grant.tool,
            source=row.source,
            destination=row.destination,
            route=row.regions,
            params={ParameterId("speed_mm_s"): speed},
        )
        return rho(action, mission.risk_policy, state=None, facts=facts, now=Now(0, 0))

    worst = worst_risk(mission, grant, row, facts)
    assert worst == max(risk_at(low), risk_at(high)) == risk_at(0) + 50
    assert any(
        line.endswith(f"its risk is at most {worst}") or f"({worst})" in line
        for line in review(mission, site)
    )


@pytest.mark.parametrize(("low", "high"), [(-40_000, 0), (0, 40_000)])
def test_pressing_hard_backwards_with_a_threshold_that_never_asks_is_seen(
    low: int, high: int
) -> None:
    mission, site = bounded(low, high, "force_mn", 1)
    policy = SET(mission.risk_policy, tau_1=10_000, tau_2=10_000)
    found = [
        f for f in lint(SET(mission, risk_policy=policy), site) if f.code is LintCode.NEVER_ASKS
    ]
    assert [f"`{mission.actions[1].id}`" in f.message for f in found] == [True]


def test_some_errors_are_seen_without_the_site() -> None:
    for name, expected in PLACELESS.items():
        with case(name):
            mission, _ = world_of(name)
            found = {(str(f.code), f.where, str(f.severity)) for f in lint_alone(mission)}
            assert found == expected


@pytest.mark.complete
def test_without_the_site_no_error_is_seen_that_is_not_one_with_it() -> None:
    for name in PAIRS:
        mission, site = world_of(name)
        if LintCode.SITE_DIFFERS not in (known := errors(lint(mission, site))):
            assert set(errors(lint_alone(mission))) <= set(known), name


def test_what_the_site_does_not_know_is_said_and_nothing_breaks() -> None:
    mission, site = world({"findings": []})
    first = mission.actions[1]
    row = SET(first.alternatives[0], object="ghost", source="moon", regions=("moon",))
    limit = SET(first.limits[0], parameter="mood_no")
    odd = (
        SET(first, type="dance", alternatives=(row,)),
        SET(first, alternatives=(SET(row, destination=RegionId("moon")),)),
        SET(first, limits=(limit, *first.limits)),
    )
    for grant in odd:
        changed = SET(mission, actions=(mission.actions[0], grant, *mission.actions[2:]))
        assert LintCode.NEVER_MATCHES in errors(lint(changed, site))


def test_the_page_of_lint_codes_is_the_enumeration() -> None:
    page = (scenarios.ROOT / "docs" / "spec" / "lint.md").read_text(encoding="utf-8")
    table = page.partition("## Findings")[2]
    rows = [line.strip("|").split("|") for line in table.splitlines() if line.startswith("| `")]
    told = {row[0].strip().strip("`"): row[1].strip() for row in rows}
    assert list(told) == [str(code) for code in LintCode]
    assert all(cell.strip() for row in rows for cell in row)
    seen: dict[str, set[str]] = {}
    for name in PAIRS:
        for code, _, severity in pair(name)["findings"]:
            seen.setdefault(code, set()).add(severity)
    for code, severities in seen.items():
        assert set(told[code].split(" or ")) == severities, code
