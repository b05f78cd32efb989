# SPDX-License-Identifier: Apache-2.0
"""What the signer of a template was shown: every form of every line, and the record of it."""

from __future__ import annotations

import pytest

from authguard_r.audit.record import read_sealed
from authguard_r.authoring.compile.card import card_digest, review
from authguard_r.authoring.compile.lint import LintCode, errors
from authguard_r.authoring.templates.card import (
    every_mission,
    lint_template,
    require_known,
    review_template,
)
from authguard_r.core.errors import AuthGuardError, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.enforcement.confirmation import ConfirmationMode
from authguard_r.enforcement.templates import Hole, HoleKind
from authguard_r.enforcement.templates.confirmation import confirm_template, confirmation_bytes
from authguard_r.operations.simulation import Simulation
from fixtures import scenarios, templates
from fixtures.templates import edited, template

SITE = scenarios.site()


def test_every_line_of_every_mission_s_card_is_on_the_template_s_card() -> None:
    missions = every_mission(template())
    card = review_template(template(), missions, SITE)
    shown = {line[4 if line.startswith("  | ") else 2 :] for line in card}
    for mission in missions:
        assert set(review(mission, SITE)) <= shown


def test_the_card_names_each_hole_with_all_its_values_and_places() -> None:
    card = "\n".join(review_template(template(), every_mission(template()), SITE))
    assert "hole package (object, 2 values): package-p1, package-p2" in card
    assert "hole station (region, 3 values): station-101, station-102, station-103" in card
    assert "mission.actions[2].alternatives[0].destination" in card
    assert "for at most 50 missions" in card
    assert "Every one of its 6 combinations" in card


def test_two_templates_that_differ_have_two_cards() -> None:
    cards = {
        tuple(review_template(value, every_mission(value), SITE))
        for value in (
            template(),
            edited(instances=51),
            edited(for_ms=1_499_000),
            edited(not_after="2099-01-01T00:00:00Z"),
            edited(template="other"),
            edited((("actions", 0, "starts"), 2)),
        )
    }
    assert len(cards) == 6


def test_the_lint_looks_at_every_combination() -> None:
    found = lint_template(every_mission(template()), SITE)
    assert errors(found) == ()
    hazard = Hole(kind=HoleKind.REGION, values=("plant-room", "station-101"))
    wide = edited((("task",), "Deliver."), holes={**template().holes, "station": hazard})
    widened = lint_template(every_mission(wide), SITE)
    assert any("plant-room" in finding.message for finding in widened)


def test_a_combination_that_is_no_mission_is_named_before_anything_is_signed() -> None:
    corridor = Hole(kind=HoleKind.REGION, values=("public-corridor", "station-101"))
    bad = edited(holes={**template().holes, "station": corridor})
    with pytest.raises(MalformedError) as error:
        every_mission(bad)
    assert error.value.reason is Reason.SCHEMA_INVALID
    assert "with package=package-p1, station=public-corridor" in error.value.message


@pytest.mark.parametrize(("hole", "kind"), [("package", "object"), ("station", "region")])
def test_a_value_that_the_site_does_not_have_is_named(hole: str, kind: str) -> None:
    require_known(template(), SITE)
    values = Hole(kind=HoleKind(kind), values=("nothing",))
    with pytest.raises(MalformedError) as error:
        require_known(edited(holes={**template().holes, hole: values}), SITE)
    assert (error.value.reason, error.value.where) == (Reason.NAME_UNKNOWN, f"holes.{hole}.values")


def test_numbers_are_not_looked_up() -> None:
    speed = Hole(kind=HoleKind.INTEGER, values=(1, 2))
    require_known(edited(holes={**template().holes, "speed": speed}), SITE)


def said(how: ConfirmationMode = ConfirmationMode.INTERACTIVE) -> bytes:
    card = card_digest(tuple(review_template(template(), every_mission(template()), SITE)))
    accepted = (LintCode.UNGUARDED_RETURN,)
    record = confirm_template(template(), card=card, how=how, accepted=accepted, now=scenarios.NOW)
    return confirmation_bytes(record)


def sealed(sim: Simulation) -> dict[str, object]:
    row = sim.gate.ledger.store.rows()[-1]  # type: ignore[attr-defined]
    return {name: item.value for name, item in read_sealed(row.sealed, where="").items()}


def test_the_confirmation_goes_into_the_log_with_the_template() -> None:
    sim = templates.simulation()
    sim.gate.management.template(templates.signed(), confirmation=said())
    record = sealed(sim)
    assert set(record) == {"token", "confirmation"}
    assert record["confirmation"]["how"] == "interactive"  # type: ignore[index]
    assert record["confirmation"]["accepted"] == ["UNGUARDED_RETURN"]  # type: ignore[index]


def test_without_a_confirmation_the_log_says_so() -> None:
    sim = templates.admitted()
    assert sealed(sim)["confirmation"] == "none"
    assert sealed(sim)["token"] == templates.signed().decode().strip()


OTHER = confirm_template(
    edited(instances=51), card=None, how=ConfirmationMode.SCRIPT, accepted=(), now=scenarios.NOW
)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"junk", "MALFORMED"),
        (b"{}", "MALFORMED"),
        (confirmation_bytes(OTHER), "META_MISMATCH"),
        (confirmation_bytes(OTHER).replace(b'"shown":false', b'"shown":true'), "META_MISMATCH"),
    ],
)
def test_a_confirmation_of_something_else_takes_nothing_in(data: bytes, reason: str) -> None:
    sim = templates.simulation()
    with pytest.raises(AuthGuardError) as error:
        sim.gate.management.template(templates.signed(), confirmation=data)
    assert str(error.value.reason) == reason
    with pytest.raises(AuthGuardError) as error:
        sim.gate.management.activate(templates.token())
    assert error.value.reason is Reason.MISSION_UNKNOWN
