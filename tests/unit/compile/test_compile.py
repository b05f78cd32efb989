# SPDX-License-Identifier: Apache-2.0
"""The compiler adds nothing: what is absent is asked for, what is unknown is refused."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from authguard_r.authoring.compile.answers import apply, compile_plain
from authguard_r.authoring.compile.build import compile_draft
from authguard_r.authoring.compile.card import compare, review
from authguard_r.authoring.compile.change import smallest_change, to_draft
from authguard_r.authoring.compile.draft import Draft
from authguard_r.authoring.compile.units import to_integer
from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.errors import AuthGuardError, ClarificationError, MalformedError
from authguard_r.core.identifiers import ActionType, ParameterId
from authguard_r.core.mission import DataRights, Limit
from authguard_r.core.reasons import Reason
from authguard_r.site.formatting import limit, quantity, unit_of
from authguard_r.site.model import Site
from authguard_r.site.source import convert
from fixtures import scenarios
from fixtures.cases import case

SET = msgspec.structs.replace


def changed(number: int, **changes: Any) -> dict[str, Any]:
    """Return the draft with one grant changed; a value of None takes the field away."""
    draft = scenarios.draft()
    grant = {**draft["grants"][number], **changes}
    grants = list(draft["grants"])
    grants[number] = {k: v for k, v in grant.items() if v is not None}
    return {**draft, "grants": grants}


def build(draft: dict[str, Any]) -> Any:
    return compile_draft(
        convert(draft, Draft, where="draft"), scenarios.site(), now=scenarios.NOW, nonce="A" * 22
    )


def test_what_is_absent_is_asked_for() -> None:
    for draft, field in [
        (changed(1, rows=None), "grants[1].rows[0].object"),
        (changed(1, repeat=None), "grants[1].repeat"),
        (changed(1, starts=None), "grants[1].starts"),
        (changed(1, max=None), "grants[1].max"),
        (changed(1, irreversible=None), "grants[1].irreversible"),
        ({k: v for k, v in scenarios.draft().items() if k != "budgets"}, "budgets.actions"),
        ({k: v for k, v in scenarios.draft().items() if k != "risk_policy"}, "risk_policy.privacy"),
        (scenarios.draft(budgets={"actions": 1, "rate": {}}), "budgets.rate.count"),
        (scenarios.draft(closing={"grants": ["go-home"]}), "closing.for"),
    ]:
        with case(draft, field):
            with pytest.raises(ClarificationError) as asked:
                build(draft)
            assert asked.value.field == field
            assert asked.value.question.endswith("?")


VIDEO = {
    "type": "record_video",
    "tool": "camera",
    "rows": [{"source": "pharmacy", "regions": ["pharmacy"]}],
    "limits": {"duration_ms": ["1 s", "30 s"], "max_bytes": [1, 1_000]},
    "guards": [],
    "done_when": [],
}


@pytest.mark.parametrize("given", [{}, {"record": True}])
def test_recording_storing_and_transmitting_are_each_asked_about(given: dict[str, bool]) -> None:
    with pytest.raises(ClarificationError) as asked:
        build(changed(1, **VIDEO, data=given))
    right = "store" if given else "record"
    assert asked.value.field == f"grants[1].data.{right}"
    assert asked.value.candidates == ("true", "false")


def test_rights_that_were_given_are_on_the_card() -> None:
    mission = build(changed(1, **VIDEO, data={"record": True, "store": False}))
    assert mission.actions[1].data == DataRights(record=True)
    card = review(mission, scenarios.site())
    assert any("MAY record sensor data" in line for line in card)
    assert any("[PRIVACY]" in line for line in card)


@pytest.mark.parametrize(
    ("rows", "where"),
    [
        ([{"object": "package-p1", "source": "moon", "regions": []}], "rows[0].source"),
        (
            [{"object": "package-p1", "source": "dock", "destination": "dock", "regions": []}],
            "rows[0].destination",
        ),
        (
            [{"object": "package-p1", "source": "dock", "regions": ["dock", "moon"]}],
            "rows[0].regions[1]",
        ),
    ],
)
def test_words_that_the_site_does_not_have_are_refused(rows: list[Any], where: str) -> None:
    with pytest.raises(MalformedError) as refused:
        build(changed(1, rows=rows))
    assert refused.value.where.endswith(where)


def test_ceilings_may_be_wider_or_narrower_but_not_unknown() -> None:
    assert build(scenarios.draft(objects=[])).objects == ()
    assert build(scenarios.draft(regions=["dock"])).regions == ("dock",)
    with pytest.raises(MalformedError, match="NAME_UNKNOWN"):
        build(scenarios.draft(objects=["nothing"]))


@pytest.mark.parametrize(
    ("value", "unit", "number"),
    [
        ("0.8 m/s", "mm/s", 800),
        ("2.88 km/h", "mm/s", 800),
        ("1/3 min", "ms", 20_000),
        (7, "ms", 7),
        ("20 N", "mN", 20_000),
        ("90 min", "s", 5_400),
    ],
)
def test_quantities_are_exact(value: Any, unit: str, number: int) -> None:
    assert to_integer(value, unit, where="x") == number


def test_what_is_no_such_quantity_is_refused() -> None:
    for value, unit in [
        ("0.8 kg", "mm/s"),
        ("0.8 parsnips", "mm/s"),
        ("much m/s", "mm/s"),
        ("1/0 m/s", "mm/s"),
        ("0.0001 m/s", "mm/s"),
        ("1e300 m", "mm"),
        (2**60, "ms"),
        ("0.8 ((", "mm/s"),
    ]:
        with case(value, unit), pytest.raises(AuthGuardError):
            to_integer(value, unit, where="x")


@pytest.mark.parametrize(
    ("value", "mend"), [("22 degC", "295.15 K"), ("22 °C", "295.15 K"), ("-40 degF", "233.15 K")]
)
def test_a_unit_with_another_zero_is_refused_with_the_point_that_it_may_mean(
    value: str, mend: str
) -> None:
    with pytest.raises(MalformedError, match="counts from zero") as caught:
        to_integer(value, "millikelvin", where="x")
    assert f"`{mend}`" in caught.value.message
    again = to_integer(mend, "millikelvin", where="x")
    assert mend == quantity(again, "millikelvin")


def test_what_two_types_measure_differently_is_read_in_each_grant_s_own_unit() -> None:
    site = two_units()
    low, high = "0 m/s", "0.5 m/s"
    draft = without_totals()
    for number in (0, 2):  # `creep` and `navigate`
        draft = apply(draft, {f"grants[{number}].limits": {"speed_mm_s": [low, high]}})
    draft = apply(draft, {"grants[2].type": "creep"})
    mission = compile_plain(draft, site, now=scenarios.NOW, nonce="A" * 22)
    assert [mission.actions[n].limits[0].high for n in (0, 2)] == [500, 50]
    lines = [line for line in review(mission, site) if line.startswith("    speed_mm_s from 0 ")]
    assert lines == [
        "    speed_mm_s from 0 m/s to 0.5 m/s",
        "    speed_mm_s from 0 cm/s to 50 cm/s",
    ]
    changed = SET(
        mission, actions=(*mission.actions[:2], raised(mission.actions[2]), *mission.actions[3:])
    )
    assert any("at most 51 cm/s" in line for line in compare(mission, changed, site))


def raised(grant: Any) -> Any:
    return SET(grant, limits=(SET(grant.limits[0], high=51),))


def without_totals() -> dict[str, Any]:
    """Return the shipped draft without bounds and scales that hold for every type."""
    plain = scenarios.draft()
    return {**plain, "limits": {}, "risk_policy": {**plain["risk_policy"], "parameters": []}}


def two_units() -> Site:
    """Return a site whose types disagree; `site check` refuses it, an older signature may not."""
    site = scenarios.site()
    model = site.vocabulary[ActionType("navigate")]
    speed = ParameterId("speed_mm_s")
    creep = SET(model, params={speed: SET(model.params[speed], unit="cm/s")})
    # first, so that whoever takes the first type that has the parameter takes the wrong one
    return SET(site, vocabulary={ActionType("creep"): creep, **site.vocabulary})


@pytest.mark.parametrize(
    ("change", "where"),
    [
        ({"limits": {"speed_mm_s": ["0 m/s", "1 m/s"]}}, "limits.speed_mm_s"),
        ({}, "risk_policy.parameters[0].parameter"),
    ],
)
def test_bounds_of_the_whole_mission_on_what_types_measure_differently_are_refused(
    change: dict[str, Any], where: str
) -> None:
    draft = {**without_totals(), **change}
    risk = {"parameter": "speed_mm_s", "full_scale": "1 m/s", "weight": 5}
    draft["risk_policy"] = {**draft["risk_policy"], "parameters": [risk]}
    with pytest.raises(MalformedError, match=r"expected one unit .*, got cm/s, mm/s") as caught:
        compile_plain(draft, two_units(), now=scenarios.NOW, nonce="A" * 22)
    assert caught.value.where.endswith(where)


def test_a_bound_on_what_types_measure_differently_is_shown_as_it_is_signed() -> None:
    speed = ParameterId("speed_mm_s")
    assert unit_of(speed, scenarios.site()) == "mm/s"
    assert unit_of(speed, two_units(), ActionType("creep")) == "cm/s"
    assert unit_of(speed, two_units(), ActionType("navigate")) == "mm/s"
    assert unit_of(ParameterId("nothing_mm"), two_units(), ActionType("creep")) == "count"
    assert unit_of(ParameterId("force_mn"), two_units(), ActionType("creep")) == "mN"
    shown = limit(Limit(parameter=speed, low=0, high=800), two_units())
    assert shown == "speed_mm_s from 0 in each type's own unit to 800 in each type's own unit"


def test_limits_wait_for_the_type_that_gives_them_their_unit() -> None:
    draft = apply(without_totals(), {"grants[0].limits": {"speed_mm_s": ["0 m/s", "0.5"]}})
    with pytest.raises(ClarificationError) as caught:
        compile_plain(
            {**draft, "grants": [{**draft["grants"][0], "type": None}]},
            two_units(),
            now=scenarios.NOW,
            nonce="A" * 22,
        )
    asked = {e.field for e in (caught.value, *caught.value.others)}
    assert "grants[0].type" in asked
    assert not any("limits" in field for field in asked)


def test_a_draft_made_of_a_mission_compiles_to_that_mission() -> None:
    for mission in (scenarios.mission(), SET(scenarios.mission(), closing=None)):
        assert build(to_draft(mission)) == mission


def test_an_irreversible_grant_and_a_robot_of_another_site_are_shown() -> None:
    mission = build(changed(1, irreversible=True))
    assert any("IRREVERSIBLE" in line for line in review(mission, scenarios.site()))
    foreign = SET(mission, rid="stranger")
    assert any(
        "Robot stranger is not in this site" in line for line in review(foreign, scenarios.site())
    )
    odd = SET(mission, actions=(SET(mission.actions[0], type="dance"), *mission.actions[1:]))
    assert review(odd, scenarios.site())


def test_a_comparison_shows_what_is_added_first() -> None:
    old, new = scenarios.mission(), scenarios.mission("mission-v2.yaml", supersedes="A" * 43)
    lines = compare(old, new, scenarios.site())
    kinds = [line.split()[0] for line in lines]
    assert kinds == sorted(kinds, key=["ADDS", "changes", "removes"].index)
    assert {"ADDS", "changes", "removes"} == set(kinds)
    assert compare(old, old, scenarios.site()) == ("changes no permission",)


def test_what_no_signature_can_mend_has_no_change() -> None:
    mission = scenarios.mission()
    fields = {
        "grant": mission.actions[0].id,
        "digest": digest_of(Tag.MISSION, mission),
        "nonce": "B" * 22,
        "expiry": mission.expiry,
    }
    action = scenarios.navigate("dock", "pharmacy")
    for reasons in ((), (Reason.STATE_STALE,), (Reason.DESTINATION_OUT_OF_SCOPE, Reason.REVOKED)):
        assert smallest_change(mission, action, reasons=reasons, **fields) is None


def test_an_expired_mission_is_extended_and_a_parameter_gets_its_bounds() -> None:
    mission = scenarios.mission()
    action = scenarios.navigate(
        "dock", "pharmacy", speed=1_000, params={"speed_mm_s": 1_000, "x_mm": 3}
    )
    reasons = (Reason.EXPIRED, Reason.PARAMETER_OUT_OF_BOUNDS, Reason.PARAMETER_NOT_ALLOWED)
    new = smallest_change(
        mission,
        action,
        reasons=reasons,
        grant=mission.actions[0].id,
        digest=digest_of(Tag.MISSION, mission),
        nonce="B" * 22,
        expiry="2099-01-01T00:00:00Z",
    )
    assert new is not None
    assert new.expiry == "2099-01-01T00:00:00Z"
    limits = {x.parameter: (x.low, x.high) for x in new.actions[0].limits}
    assert limits == {"speed_mm_s": (50, 1_000), "x_mm": (3, 3)}
    assert new.limits[0].high == 1_000


def test_a_task_that_utf8_cannot_spell_and_an_instant_of_another_form_are_refused() -> None:
    with pytest.raises(MalformedError) as refused:
        build(scenarios.draft(task="Bring \ud800."))
    assert refused.value.where == "task"
    for instant in ("2030-01-01T14:30", "2030-01-01T14:30:00+02:00", "2030-02-30T14:30:00Z"):
        window = {"not_before": instant, "expiry": "2031-01-01T00:00:00Z"}
        with pytest.raises(MalformedError):
            build(scenarios.draft(window=window))
