# SPDX-License-Identifier: Apache-2.0
"""Source sets, weights and retention in a draft: each bad word is refused by its place."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from authguard_r.authoring.compile.build import compile_draft
from authguard_r.authoring.compile.card import compare, review
from authguard_r.authoring.compile.change import to_draft
from authguard_r.authoring.compile.draft import Draft
from authguard_r.authoring.compile.findings import Severity
from authguard_r.authoring.compile.lint import lint
from authguard_r.authoring.compile.sources import given_weights
from authguard_r.core.errors import AuthGuardError, ClarificationError, MalformedError
from authguard_r.core.mission import SCHEMA, DataClass, Mission, ProtectedField, require_schema
from authguard_r.core.provenance import Label, SourceField
from authguard_r.core.reasons import Reason
from authguard_r.enforcement.confirmation import LintCode
from authguard_r.site.check import faults
from authguard_r.site.model import Site
from authguard_r.site.source import convert, parse_site
from fixtures import scenarios
from fixtures.cases import case

SET = msgspec.structs.replace
NEWER: dict[str, Any] = {
    "sources": {"route": ["operator", "model"], "recording": ["supervisor"]},
    "retention": {"evidence": "30 d", "person": 86_400_000},
}


def build(site: Site | None = None, **changes: Any) -> Mission:
    draft = convert(scenarios.draft(**changes), Draft, where="draft")
    return compile_draft(draft, site or scenarios.site(), now=scenarios.NOW, nonce="A" * 22)


def weighed(**weights: Any) -> dict[str, Any]:
    """Return the draft's risk policy with weights of fields."""
    return {"risk_policy": {**scenarios.draft()["risk_policy"], "field_weights": weights}}


def allowing(**sources: tuple[Label, ...]) -> Site:
    """Return the hospital's site with source sets."""
    named = {SourceField(field): labels for field, labels in sources.items()}
    return SET(scenarios.site(), sources=named)


def test_what_a_draft_says_is_signed_sorted_and_in_whole_units() -> None:
    mission = build(**NEWER, **weighed(destination=6))
    assert mission.schema == SCHEMA
    assert mission.sources == {
        SourceField.ROUTE: (Label.MODEL, Label.OPERATOR),
        SourceField.RECORDING: (Label.SUPERVISOR,),
    }
    assert mission.retention == {DataClass.EVIDENCE: 30 * 86_400_000, DataClass.PERSON: 86_400_000}
    assert mission.risk_policy.field_weights == {ProtectedField.DESTINATION: 6}


def test_a_draft_that_says_nothing_of_them_signs_nothing_of_them() -> None:
    mission = build()
    assert (mission.sources, mission.retention) == ({}, {})
    assert b"sources" not in msgspec.json.encode(mission)


BAD: dict[str, tuple[dict[str, Any], Reason, str, str]] = {
    "a field that there is not": (
        {"sources": {"goal": ["operator"]}},
        Reason.NAME_UNKNOWN,
        "sources.goal",
        "destination",
    ),
    "a label that there is not": (
        {"sources": {"route": ["operator", "sign"]}},
        Reason.NAME_UNKNOWN,
        "sources.route[1]",
        "camera",
    ),
    "nobody at all": (
        {"sources": {"route": []}},
        Reason.SCHEMA_INVALID,
        "sources.route",
        "at least one of audio",
    ),
    "a model that permits recording": (
        {"sources": {"recording": ["model"]}},
        Reason.SCHEMA_INVALID,
        "sources.recording",
        "`recording` can be set by operator or supervisor only, got `model`",
    ),
    "a class that there is not": (
        {"retention": {"video": "1 d"}},
        Reason.NAME_UNKNOWN,
        "retention.video",
        "evidence",
    ),
    "kept for no time": (
        {"retention": {"evidence": 0}},
        Reason.SCHEMA_INVALID,
        "retention.evidence",
        "above zero",
    ),
    "a weight of zero": (
        weighed(destination=0),
        Reason.VALUE_INVALID,
        "risk_policy.field_weights.destination",
        "above zero",
    ),
    "a negative weight": (
        weighed(destination=-1),
        Reason.VALUE_INVALID,
        "risk_policy.field_weights.destination",
        "above zero",
    ),
    "a weight that is no number": (
        weighed(destination="much"),
        Reason.VALUE_INVALID,
        "risk_policy.field_weights.destination",
        "`much`",
    ),
    "a weight that is no whole number": (
        weighed(destination=1.5),
        Reason.VALUE_INVALID,
        "risk_policy.field_weights.destination",
        "`1.5`",
    ),
    "a weight beyond the encoding": (
        weighed(destination=1 << 60),
        Reason.VALUE_INVALID,
        "risk_policy.field_weights.destination",
        "above zero",
    ),
    "a weight of no protected field": (
        weighed(goal=1),
        Reason.NAME_UNKNOWN,
        "risk_policy.field_weights",
        "destination",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_word_is_refused_by_its_place_with_what_is_allowed(name: str) -> None:
    changes, reason, where, told = BAD[name]
    with pytest.raises(MalformedError) as error:
        build(**changes)
    assert (error.value.reason, error.value.where) == (reason, where)
    assert told in error.value.message


def test_a_time_without_a_unit_is_asked_about() -> None:
    with pytest.raises(ClarificationError) as asked:
        build(retention={"evidence": 1.5})
    assert asked.value.field == "retention.evidence"


def test_a_set_wider_than_the_sites_is_refused_when_it_is_compiled() -> None:
    site = allowing(route=(Label.MODEL, Label.OPERATOR))
    assert build(site, sources={"route": ["model"]}).sources[SourceField.ROUTE] == (Label.MODEL,)
    with pytest.raises(MalformedError) as error:
        build(site, sources={"route": ["model", "camera"]})
    assert (error.value.reason, error.value.where) == (Reason.PROVENANCE_DENIED, "sources.route")
    assert "model, operator" in error.value.message


def test_the_first_language_has_none_of_them() -> None:
    mission = build(**NEWER, **weighed(destination=6))
    first = SET(build(), schema="authguard-r/mission/1")
    require_schema(first)
    for name, value in (
        ("sources", {"sources": mission.sources}),
        ("retention", {"retention": mission.retention}),
        ("risk_policy.field_weights", {"risk_policy": mission.risk_policy}),
    ):
        with case(name):
            with pytest.raises(MalformedError) as error:
                require_schema(SET(first, **value))
            assert (error.value.reason, error.value.where) == (Reason.SCHEMA_INVALID, name)
            assert "authguard mission compile" in error.value.message


def test_the_card_and_the_difference_show_them() -> None:
    plain, mission = build(), build(**NEWER, **weighed(destination=6))
    card = "\n".join(review(mission, scenarios.site()))
    assert "By this mission, route may be set by model, operator only" in card
    narrow = allowing(tool=(Label.MODEL,))
    assert "By the site, tool may be set by model only" in "\n".join(review(plain, narrow))
    assert "evidence fields are destroyed 720 h after the mission expires" in card
    assert "destination 6" in card
    shown = "\n".join(map(str, compare(plain, mission, scenarios.site())))
    assert "route may be set by camera" in shown
    assert "recording may be set by operator" in shown
    assert "weight of destination in the deviation: 6" in shown
    assert "sealed evidence fields are stored for 720 h" in shown


def test_a_mission_is_a_draft_again_word_for_word() -> None:
    mission = build(**NEWER, **weighed(destination=6, object=2))
    draft = convert(to_draft(mission), Draft, where="draft")
    again = compile_draft(draft, scenarios.site(), now=scenarios.NOW, nonce=mission.nonce)
    assert again == mission


def test_a_site_has_sorted_sets_within_the_papers_bounds() -> None:
    assert not faults(allowing(route=(Label.MODEL, Label.OPERATOR)))
    for field, labels in (
        ("route", (Label.OPERATOR, Label.MODEL)),
        ("position", (Label.CAMERA,)),
        ("state", (Label.MEMORY, Label.TRUSTED_SENSOR)),
        ("approval_threshold", (Label.MODEL,)),
    ):
        with case(field):
            assert [fault.where for fault in faults(allowing(**{field: labels}))] == [
                f"sources.{field}"
            ]


@pytest.mark.parametrize(
    ("texts", "where"),
    [
        (["goal=1"], "--weight"),
        (["destination"], "--weight"),
        (["destination=1", "destination=2"], "--weight"),
        (["destination=0"], "--weight.destination"),
        (["destination=-1"], "--weight.destination"),
        (["destination=1.5"], "--weight.destination"),
        (["destination=" + "9" * 5_000], "--weight.destination"),
        (["destination=٣"], "--weight.destination"),
        (["=1"], "--weight"),
    ],
)
def test_a_bad_weight_on_the_command_line_is_refused(texts: list[str], where: str) -> None:
    with pytest.raises(AuthGuardError) as error:
        given_weights(texts, where="--weight")
    assert error.value.where == where


def test_weights_on_the_command_line_are_whole_numbers_by_field() -> None:
    found = given_weights(["destination=5", "object=2"], where="--weight")
    assert found == {ProtectedField.DESTINATION: 5, ProtectedField.OBJECT: 2}


def test_a_site_that_people_write_is_refused_by_the_place_of_the_word() -> None:
    text = (scenarios.HOSPITAL / "site.yaml").read_text(encoding="utf-8")
    for said, where, told in (
        ("{goal: [operator]}", "site:sources.goal", "destination"),
        ("{route: [nobody]}", "site:sources.route[0]", "camera"),
        ("{route: []}", "site:sources.route", "at least one of"),
        ("{position: [camera]}", "site:sources.position", "trusted_sensor only"),
        ("[route]", "site:sources", "{field: [label, ...]}"),
    ):
        with case(said):
            with pytest.raises(MalformedError) as error:
                parse_site(f"{text}\nsources: {said}\n", where="site")
            assert error.value.where == where
            assert told in error.value.message


def test_the_lint_names_a_set_that_no_planner_can_satisfy() -> None:
    mission = build(sources={"type": ["operator"]})
    (finding,) = [f for f in lint(mission, scenarios.site()) if f.where == "sources.type"]
    assert (finding.code, finding.severity) == (LintCode.NEVER_MATCHES, Severity.ERROR)
    assert "the mission's" in finding.mend
    site = allowing(tool=(Label.SUPERVISOR,))
    (finding,) = [f for f in lint(build(site), site) if f.where == "sources.tool"]
    assert "the site's" in finding.mend
