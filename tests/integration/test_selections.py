# SPDX-License-Identifier: Apache-2.0
"""Signed selections: several rows are signed, and only the chooser's word picks one of them.

One attack at a time against a real gate; after each the registry is as it was, the robot has not
moved, and one record says why.
"""

from __future__ import annotations

import json
from typing import Any

import msgspec
import pytest

from authguard_r.approvals import Selection
from authguard_r.audit.record import read_record, read_sealed
from authguard_r.core.encoding import Tag, b64, digest_of
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.mission import Mission
from authguard_r.core.standing import Outcome
from authguard_r.core.token import sign_object
from authguard_r.enforcement.signed_orders import Command, Verb
from fixtures import scenarios

ROWS = [
    {"source": "dock", "destination": goal, "regions": ["dock", goal, "public-corridor"]}
    for goal in ("pharmacy", "station-103")
]
FIRST, OTHER = (scenarios.navigate("dock", row["destination"]) for row in ROWS)
FAR = scenarios.START_MS + 3_600_000


def mission(chooser: str = "operator", **changes: Any) -> Mission:
    """Return the story's mission with two rows to drive to, and one chooser."""
    grants = scenarios.draft()["grants"]
    drive = {**grants[0], "rows": ROWS, "chooser": chooser, "repeat": 2, "starts": 4}
    return scenarios.mission(grants=[{**drive, **changes}, *grants[1:]])


def gate(signed: Mission, **kwargs: Any) -> Any:
    sim = scenarios.simulation(**kwargs)
    sim.gate.management.activate(scenarios.token(signed))
    return sim


def choice(signed: Mission, row: int = 1, *, by: str = "operator-1", **changes: Any) -> bytes:
    """Return a signed choice of one row of the first grant."""
    fields: dict[str, Any] = {
        "mid": signed.mid,
        "version": signed.version,
        "mission": digest_of(Tag.MISSION, signed),
        "grant": "go-to-pharmacy",
        "row": row,
        "nonce": b64(f"{by}-{row}".encode()),
        "expires_ms": FAR,
        "issued_ms": scenarios.START_MS,
    }
    value = Selection(**{**fields, **changes})
    return sign_object(value, Tag.SELECTION, scenarios.folder_signer(scenarios.trust_folder(), by))


def reasons(sim: Any, action: Any) -> list[str]:
    return [str(reason) for reason in scenarios.propose(sim, action).judged.decision.reasons]


def last(sim: Any) -> Any:
    return read_record(sim.gate.ledger.store.rows()[-1].record, where="")


def refused(sim: Any, data: bytes, reason: str) -> None:
    """Assert that the selection changes nothing and that one record says why."""
    before, size = sim.gate.management.standing("deliver-p1"), len(sim.gate.ledger.store.rows())
    with pytest.raises(AuthGuardError) as caught:
        sim.gate.management.select(data)
    assert str(caught.value.reason) == reason
    assert sim.gate.management.standing("deliver-p1") == before
    assert len(sim.gate.ledger.store.rows()) == size + 1
    record = last(sim)
    assert (record.kind, record.open["reasons"]) == ("refusal", [reason])
    assert sim.robot.trace == []


# what a selection does


@pytest.mark.parametrize(
    ("chooser", "by"), [("operator", "operator-1"), ("supervisor", "supervisor-2")]
)
def test_a_choice_is_denied_before_and_accepted_after_the_chooser_signed_it(
    chooser: str, by: str
) -> None:
    signed = mission(chooser)
    sim = gate(signed)
    for action in (FIRST, OTHER):
        assert reasons(sim, action) == ["PROVENANCE_DENIED"]
    assert sim.robot.trace == []
    sim.gate.management.select(choice(signed, 1, by=by))
    assert reasons(sim, FIRST) == ["DESTINATION_OUT_OF_SCOPE"]
    report = scenarios.propose(sim, OTHER)
    assert report.outcome is Outcome.SUCCEEDED
    assert report.judged.action.provenance["destination"] == chooser
    assert [done.action.destination for done in sim.robot.trace] == ["station-103"]


def test_each_row_can_be_the_one() -> None:
    for row, (chosen, other) in enumerate([(FIRST, OTHER), (OTHER, FIRST)]):
        signed = mission()
        sim = gate(signed)
        sim.gate.management.select(choice(signed, row))
        assert reasons(sim, other) == ["DESTINATION_OUT_OF_SCOPE"]
        assert scenarios.propose(sim, chosen).outcome is Outcome.SUCCEEDED


def test_the_last_choice_counts_and_an_old_one_cannot_come_again() -> None:
    signed = mission()
    sim = gate(signed)
    first = choice(signed, 0)
    second = choice(signed, 1, issued_ms=scenarios.START_MS + 1)
    sim.gate.management.select(first)
    sim.gate.management.select(second)
    refused(sim, first, "EXPIRED")
    refused(sim, choice(signed, 0, nonce="BBBB", issued_ms=scenarios.START_MS + 1), "ORDER_TOO_OLD")
    assert sim.gate.management.standing("deliver-p1").selected == {"go-to-pharmacy": 1}
    assert reasons(sim, FIRST) == ["DESTINATION_OUT_OF_SCOPE"]


def test_the_record_holds_the_signed_choice_itself() -> None:
    """Whoever reads the log can check the chooser's signature again."""
    signed = mission()
    sim = gate(signed)
    data = choice(signed)
    sim.gate.management.select(data)
    row = sim.gate.ledger.store.rows()[-1]
    assert read_record(row.record, where="").open == {
        "verb": "select",
        "by": "operator-1",
        "grant": "go-to-pharmacy",
        "row": 1,
    }
    assert read_sealed(row.sealed, where="")["token"].value == data.decode().strip()


def test_a_choice_widens_nothing_else() -> None:
    signed = mission()
    sim = gate(signed)
    sim.gate.management.select(choice(signed))
    assert reasons(sim, scenarios.navigate("dock", "office-1")) != []
    assert "PARAMETER_OUT_OF_BOUNDS" in reasons(
        sim, scenarios.navigate("dock", "station-103", speed=900)
    )
    assert sim.robot.trace == []


# who may choose


@pytest.mark.parametrize(
    ("chooser", "by"),
    [
        ("operator", "operator-2"),
        ("operator", "supervisor-1"),
        ("operator", "safety-officer-1"),
        ("supervisor", "operator-1"),
        ("supervisor", "safety-officer-1"),
        ("trusted_sensor", "operator-1"),
        ("trusted_sensor", "supervisor-1"),
        ("planner", "operator-1"),
    ],
)
def test_nobody_but_the_chooser_chooses(chooser: str, by: str) -> None:
    signed = mission(chooser)
    refused(gate(signed), choice(signed, by=by), "ROLE_DENIED")


@pytest.mark.parametrize(
    "by", ["site-authority-1", "witness-1", "gate-courier-1", "estimator-courier-1"]
)
def test_a_role_that_answers_nothing_chooses_nothing(by: str) -> None:
    signed = mission("supervisor")
    refused(gate(signed), choice(signed, by=by), "ROLE_DENIED")


# what is no selection of this mission


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"mid": "another"}, "MISSION_UNKNOWN"),
        ({"mission": "A" * 43}, "MISSION_UNKNOWN"),
        ({"version": 2}, "MISSION_UNKNOWN"),
        ({"expires_ms": scenarios.START_MS - 1}, "EXPIRED"),
        ({"expires_ms": 0}, "EXPIRED"),
        ({"grant": "nothing"}, "SCHEMA_INVALID"),
        ({"row": 2}, "SCHEMA_INVALID"),
        ({"row": 10**9}, "SCHEMA_INVALID"),
    ],
)
def test_a_choice_of_something_else_changes_nothing(changes: dict[str, Any], reason: str) -> None:
    signed = mission()
    refused(gate(signed), choice(signed, **changes), reason)


def test_a_choice_for_another_robot_s_mission_changes_nothing() -> None:
    theirs = msgspec.structs.replace(mission(), rid=scenarios.OTHER)
    refused(gate(mission()), choice(theirs), "MISSION_UNKNOWN")


def test_a_choice_without_any_mission_here_changes_nothing() -> None:
    sim = scenarios.simulation()
    refused(sim, choice(mission()), "MISSION_UNKNOWN")


def test_a_choice_runs_out_while_it_waits() -> None:
    signed = mission()
    sim = gate(signed)
    data = choice(signed, expires_ms=scenarios.START_MS + 1_000)
    sim.robot.pause(1_100)
    refused(sim, data, "EXPIRED")


def tampered(data: bytes) -> dict[str, tuple[bytes, str]]:
    """Return what an attacker makes of an authentic choice of row 1, and why each is refused."""
    token = json.loads(data)
    payload = token["payload"]
    signed = mission()
    row_0 = json.loads(choice(signed, 0, by="supervisor-1"))
    own_words = {**token, "payload": row_0["payload"]}
    command = Command(
        verb=Verb.SUSPEND,
        mid=signed.mid,
        version=1,
        mission=digest_of(Tag.MISSION, signed),
        nonce="AA",
        expires_ms=FAR,
    )
    signer = scenarios.folder_signer(scenarios.trust_folder(), "operator-1")
    return {
        "another payload under the signature": (_written(own_words), "SIGNATURE_INVALID"),
        "cut": (data[:-12], "MALFORMED"),
        "empty": (b"", "MALFORMED"),
        "payload alone": (payload.encode(), "MALFORMED"),
        "another kind": (sign_object(command, Tag.COMMAND, signer), "WRONG_KIND"),
        "a mission": (scenarios.token(signed), "WRONG_KIND"),
        "other fields": (sign_object(command, Tag.SELECTION, signer), "MALFORMED"),
    }


def _written(token: dict[str, Any]) -> bytes:
    return json.dumps(token, sort_keys=True, separators=(",", ":")).encode()


@pytest.mark.parametrize("kind", sorted(tampered(choice(mission()))))
def test_a_tampered_choice_changes_nothing(kind: str) -> None:
    signed = mission()
    data, reason = tampered(choice(signed))[kind]
    sim = gate(signed)
    refused(sim, data, reason)
    assert reasons(sim, OTHER) == ["PROVENANCE_DENIED"]


def test_every_changed_byte_of_a_choice_is_noticed() -> None:
    signed = mission()
    sim = gate(signed)
    data = choice(signed).strip()
    for place in range(0, len(data), 7):
        changed = bytearray(data)
        changed[place] ^= 1
        with pytest.raises(AuthGuardError):
            sim.gate.management.select(bytes(changed))
    assert sim.gate.management.standing("deliver-p1").selected == {}
    assert sim.gate.management.select(data).selected == {"go-to-pharmacy": 1}


# when it ends


def second(signed: Mission, **changes: Any) -> Mission:
    base = {"version": 2, "supersedes": digest_of(Tag.MISSION, signed), "nonce": "B" * 22}
    return msgspec.structs.replace(signed, **{**base, **changes})


def test_a_choice_ends_with_its_version() -> None:
    signed = mission()
    sim = gate(signed)
    sim.gate.management.select(choice(signed))
    update = second(signed)
    assert sim.gate.management.activate(scenarios.token(update)).selected == {}
    for action in (FIRST, OTHER):
        assert reasons(sim, action) == ["PROVENANCE_DENIED"]
    refused(sim, choice(signed, nonce="BBBB"), "MISSION_UNKNOWN")
    sim.gate.management.select(choice(update, nonce="CCCC", issued_ms=scenarios.START_MS + 1))
    assert scenarios.propose(sim, OTHER).outcome is Outcome.SUCCEEDED


@pytest.mark.parametrize(
    ("verb", "reason"), [(Verb.REVOKE, "REVOKED"), (Verb.COMPLETE, "MISSION_COMPLETED")]
)
def test_a_mission_that_ended_takes_no_choice(verb: Verb, reason: str) -> None:
    signed = mission()
    sim = gate(signed)
    order = Command(
        verb=verb,
        mid=signed.mid,
        version=1,
        mission=digest_of(Tag.MISSION, signed),
        nonce="AA",
        expires_ms=FAR,
    )
    signer = scenarios.folder_signer(scenarios.trust_folder(), "operator-1")
    sim.gate.management.command(sign_object(order, Tag.COMMAND, signer))
    refused(sim, choice(signed), reason)


# attested state as the chooser


SENSED = [
    {
        "source": "dock",
        "destination": "pharmacy",
        "regions": ["dock", "pharmacy", "public-corridor"],
    },
    {
        "source": "pharmacy",
        "destination": "dock",
        "regions": ["dock", "pharmacy", "public-corridor"],
    },
]


@pytest.mark.parametrize(("at", "to"), [("dock", "pharmacy"), ("pharmacy", "dock")])
def test_the_attested_place_settles_a_sensor_s_choice(at: str, to: str) -> None:
    signed = mission("trusted_sensor", rows=SENSED, until=[])
    sim = gate(signed, start=scenarios.world(at))
    report = scenarios.propose(sim, scenarios.navigate(at, to))
    assert report.outcome is Outcome.SUCCEEDED
    assert report.judged.action.provenance["destination"] == "trusted_sensor"


@pytest.mark.parametrize(("at", "claimed"), [("dock", "pharmacy"), ("pharmacy", "dock")])
def test_a_place_that_the_planner_claims_settles_nothing(at: str, claimed: str) -> None:
    """The attack: the planner says that it stands elsewhere to be given the other row."""
    sim = gate(mission("trusted_sensor", rows=SENSED, until=[]), start=scenarios.world(at))
    other = {"dock": "pharmacy", "pharmacy": "dock"}[claimed]
    assert "SOURCE_NOT_ATTESTED" in reasons(sim, scenarios.navigate(claimed, other))
    assert sim.robot.trace == []


def test_a_sensor_does_not_choose_between_two_goals_from_one_place() -> None:
    sim = gate(mission("trusted_sensor"))
    for action in (FIRST, OTHER):
        assert reasons(sim, action) == ["PROVENANCE_DENIED"]
    assert sim.robot.trace == []


def test_a_planner_that_may_choose_needs_no_selection() -> None:
    """The signer said so: each of the signed rows, and no other."""
    for action in (FIRST, OTHER):
        sim = gate(mission("planner"))
        assert scenarios.propose(sim, action).outcome is Outcome.SUCCEEDED
    assert "DESTINATION_OUT_OF_SCOPE" in reasons(
        gate(mission("planner")), scenarios.navigate("dock", "station-102")
    )
