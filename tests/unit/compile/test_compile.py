# SPDX-License-Identifier: Apache-2.0
"""The compiler adds nothing: what is absent is asked for, what is unknown is refused."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

import worlds
from authguard_r.compile.build import compile_draft
from authguard_r.compile.card import compare, review
from authguard_r.compile.change import smallest_change, to_draft
from authguard_r.compile.draft import Draft
from authguard_r.compile.units import to_integer
from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.errors import AuthGuardError, ClarificationError, MalformedError
from authguard_r.core.mission import DataRights
from authguard_r.core.reasons import Reason
from authguard_r.site.source import convert

SET = msgspec.structs.replace


def changed(number: int, **changes: Any) -> dict[str, Any]:
    """Return the draft with one grant changed; a value of None takes the field away."""
    draft = worlds.draft()
    grant = {**draft["grants"][number], **changes}
    grants = list(draft["grants"])
    grants[number] = {k: v for k, v in grant.items() if v is not None}
    return {**draft, "grants": grants}


def build(draft: dict[str, Any]) -> Any:
    return compile_draft(
        convert(draft, Draft, where="draft"), worlds.site(), now=worlds.NOW, nonce="A" * 22
    )


@pytest.mark.parametrize(
    ("draft", "field"),
    [
        (changed(1, rows=None), "grants[1].rows[0].object"),
        (changed(1, repeat=None), "grants[1].repeat"),
        (changed(1, starts=None), "grants[1].starts"),
        (changed(1, max=None), "grants[1].max"),
        (changed(1, irreversible=None), "grants[1].irreversible"),
        ({k: v for k, v in worlds.draft().items() if k != "budgets"}, "budgets.actions"),
        ({k: v for k, v in worlds.draft().items() if k != "risk_policy"}, "risk_policy.privacy"),
        (worlds.draft(budgets={"actions": 1, "rate": {}}), "budgets.rate.count"),
        (worlds.draft(closing={"grants": ["go-home"]}), "closing.for"),
    ],
)
def test_what_is_absent_is_asked_for(draft: dict[str, Any], field: str) -> None:
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
    card = review(mission, worlds.site())
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
    assert build(worlds.draft(objects=[])).objects == ()
    assert build(worlds.draft(regions=["dock"])).regions == ("dock",)
    with pytest.raises(MalformedError, match="NAME_UNKNOWN"):
        build(worlds.draft(objects=["nothing"]))


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


@pytest.mark.parametrize(
    ("value", "unit"),
    [
        ("0.8 kg", "mm/s"),
        ("0.8 parsnips", "mm/s"),
        ("much m/s", "mm/s"),
        ("1/0 m/s", "mm/s"),
        ("0.0001 m/s", "mm/s"),
        ("1e300 m", "mm"),
        (2**60, "ms"),
        ("0.8 ((", "mm/s"),
    ],
)
def test_what_is_no_such_quantity_is_refused(value: Any, unit: str) -> None:
    with pytest.raises(AuthGuardError):
        to_integer(value, unit, where="x")


def test_a_draft_made_of_a_mission_compiles_to_that_mission() -> None:
    for mission in (worlds.mission(), SET(worlds.mission(), closing=None)):
        assert build(to_draft(mission)) == mission


def test_an_irreversible_grant_and_a_robot_of_another_site_are_shown() -> None:
    mission = build(changed(1, irreversible=True))
    assert any("IRREVERSIBLE" in line for line in review(mission, worlds.site()))
    foreign = SET(mission, rid="stranger")
    assert any("nothing that this robot can do" in line for line in review(foreign, worlds.site()))
    odd = SET(mission, actions=(SET(mission.actions[0], type="dance"), *mission.actions[1:]))
    assert review(odd, worlds.site())


def test_a_comparison_shows_what_is_added_first() -> None:
    old, new = worlds.mission(), worlds.mission("mission-v2.yaml", supersedes="A" * 43)
    lines = compare(old, new, worlds.site())
    kinds = [line.split()[0] for line in lines]
    assert kinds == sorted(kinds, key=["ADDS", "changes", "removes"].index)
    assert {"ADDS", "changes", "removes"} == set(kinds)
    assert compare(old, old, worlds.site()) == ("changes no permission",)


def test_what_no_signature_can_mend_has_no_change() -> None:
    mission = worlds.mission()
    fields = {
        "grant": mission.actions[0].id,
        "digest": digest_of(Tag.MISSION, mission),
        "nonce": "B" * 22,
        "expiry": mission.expiry,
    }
    action = worlds.navigate("dock", "pharmacy")
    for reasons in ((), (Reason.STATE_STALE,), (Reason.DESTINATION_OUT_OF_SCOPE, Reason.REVOKED)):
        assert smallest_change(mission, action, reasons=reasons, **fields) is None


def test_an_expired_mission_is_extended_and_a_parameter_gets_its_bounds() -> None:
    mission = worlds.mission()
    action = worlds.navigate(
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
        build(worlds.draft(task="Bring \ud800."))
    assert refused.value.where == "task"
    for instant in ("2030-01-01T14:30", "2030-01-01T14:30:00+02:00", "2030-02-30T14:30:00Z"):
        window = {"not_before": instant, "expiry": "2031-01-01T00:00:00Z"}
        with pytest.raises(MalformedError):
            build(worlds.draft(window=window))
