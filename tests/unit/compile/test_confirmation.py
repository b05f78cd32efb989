# SPDX-License-Identifier: Apache-2.0
"""The confirmation is of one mission, in one spelling, and grants nothing."""

from __future__ import annotations

import json
from typing import Any

import msgspec
import pytest

from authguard_r.audit.record import read_record, read_sealed
from authguard_r.authoring.compile.card import card_digest, review
from authguard_r.core.encoding import Tag, digest_of, encode, encode_fast
from authguard_r.core.errors import AuthGuardError, MalformedError, RefusedError
from authguard_r.enforcement.confirmation import (
    Confirmation,
    ConfirmationMode,
    LintCode,
    confirm,
    confirmation_bytes,
    read_confirmation,
)
from fixtures import scenarios
from fixtures.cases import case

SET = msgspec.structs.replace


def confirmed(**changes: Any) -> Confirmation:
    mission = scenarios.mission()
    said = confirm(
        mission,
        card=card_digest(review(mission, scenarios.site())),
        how=ConfirmationMode.INTERACTIVE,
        accepted=(LintCode.NEVER_ASKS, LintCode.BEYOND_PROFILE),
        now=scenarios.NOW,
    )
    return SET(said, **changes)


def test_a_confirmation_says_what_was_asked_shown_accepted_by_whom_and_when() -> None:
    said = confirmed()
    mission = scenarios.mission()
    assert json.loads(confirmation_bytes(said)) == {
        "schema": "authguard-r/confirmation/1",
        "mission": digest_of(Tag.MISSION, mission),
        "mid": "deliver-p1",
        "version": 1,
        "request": mission.task,
        "by": "operator-1",
        "at_ms": scenarios.START_MS,
        "how": "interactive",
        "shown": True,
        "card": card_digest(review(mission, scenarios.site())),
        "accepted": ["BEYOND_PROFILE", "NEVER_ASKS"],
    }
    assert read_confirmation(confirmation_bytes(said), mission=mission) == said


@pytest.mark.parametrize(
    "changes",
    [
        {"mission": "A" * 43},
        {"mid": "another"},
        {"version": 2},
        {"request": "Carry everything everywhere."},
        {"by": "operator-2"},
        {"shown": False},
        {"card": None},
    ],
)
def test_a_confirmation_that_is_not_this_signing_s_is_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(RefusedError, match="META_MISMATCH"):
        read_confirmation(confirmation_bytes(confirmed(**changes)), mission=scenarios.mission())


def test_what_is_no_confirmation_is_malformed() -> None:
    for data in [
        b"",
        b"{}",
        b"null",
        b"\xff" * 99,
        b"[" * 9_999,
        encode({**msgspec.to_builtins(confirmed()), "schema": "authguard-r/confirmation/2"}),
        encode({**msgspec.to_builtins(confirmed()), "more": 1}),
        encode({**msgspec.to_builtins(confirmed()), "how": "asleep"}),
        encode({**msgspec.to_builtins(confirmed()), "accepted": ["ANYTHING"]}),
        encode({**msgspec.to_builtins(confirmed()), "accepted": []}),
        encode_fast({**msgspec.to_builtins(confirmed()), "card": None}),
        encode({k: v for k, v in msgspec.to_builtins(confirmed()).items() if k != "shown"}),
        encode(confirmed(accepted=(LintCode.NEVER_ASKS, LintCode.BEYOND_PROFILE))),
        encode(confirmed(accepted=(LintCode.NEVER_ASKS, LintCode.NEVER_ASKS))),
        json.dumps(msgspec.to_builtins(confirmed())).encode(),
    ]:
        with case(data), pytest.raises(MalformedError):
            read_confirmation(data, mission=scenarios.mission())


def activation(sim: Any) -> dict[str, Any]:
    """Return what the last management record seals."""
    rows = sim.gate.ledger.store.rows()
    found = [row for row in rows if read_record(row.record, where="").kind == "management"]
    sealed = read_sealed(found[-1].sealed, where="")
    return {name: item.value for name, item in sealed.items()}


def test_an_activation_seals_the_confirmation_beside_the_token() -> None:
    sim = scenarios.simulation()
    sim.gate.management.activate(scenarios.token(), confirmation=confirmation_bytes(confirmed()))
    sealed = activation(sim)
    assert set(sealed) == {"token", "confirmation"}
    assert sealed["confirmation"] == json.loads(confirmation_bytes(confirmed()))


def test_an_activation_without_one_says_so_in_the_record() -> None:
    sim = scenarios.simulation()
    sim.gate.management.activate(scenarios.token())
    sealed = activation(sim)
    assert set(sealed) == {"token", "confirmation"}
    assert sealed["confirmation"] == "none"


@pytest.mark.parametrize("data", [b"junk", confirmation_bytes(confirmed(mission="A" * 43))])
def test_a_confirmation_that_does_not_fit_activates_nothing(data: bytes) -> None:
    sim = scenarios.simulation()
    with pytest.raises(AuthGuardError):
        sim.gate.management.activate(scenarios.token(), confirmation=data)
    assert sim.gate.management.standing("deliver-p1") is None
    assert sim.gate.ledger.run(lambda act: act.active()) is None
    kinds = [read_record(row.record, where="").kind for row in sim.gate.ledger.store.rows()]
    assert kinds == ["genesis", "refusal"]
    assert sim.gate.management.activate(scenarios.token()).status == "active"
