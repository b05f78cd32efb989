# SPDX-License-Identifier: Apache-2.0
"""A record in words: for people, from the record alone, and never a guess about a damaged one."""

from __future__ import annotations

import re
from typing import Any

import msgspec
import pytest

from authguard_r.audit.record import Record, Sealed, read_record, read_sealed
from authguard_r.cli.app import program
from authguard_r.core.errors import MalformedError
from authguard_r.core.mission import Mission
from authguard_r.core.reasons import Reason
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.server.explanation import explanation
from authguard_r.server.remediation import remedies, remedies_of, remedy_of
from authguard_r.wire.messages import ClientRole, Explain, Kind, Observe, Order, OrderKind
from fixtures import scenarios
from unit.server.demo_site import FORBIDDEN, GO, SCAN, UNREADABLE, DemoGate, Guest, Refused
from unit.server.test_emergencies import EmergencyGate

#: Too fast: one bound, which a signature can raise.
MENDS, EMERGENCY_MENDS = remedy_of(), remedy_of(emergency=True)
FAST = b'navigate_to(destination="Pharmacy", speed=1.2)'


def explained(house: DemoGate, seq: int | None = None) -> dict[str, Any]:
    auditor: Guest = house.enter(ClientRole.AUDITOR)
    return auditor.ask(Kind.EXPLAIN, Explain(seq=seq))


def test_a_refused_decision_says_what_who_why_and_what_would_allow_it() -> None:
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        house.propose(planner, FAST)
        told = explained(house)
        assert (told["kind"], told["decision"]) == ("decision", "reject")
        assert told["who"].endswith(".planner")
        assert told["what"] == "navigate source dock destination pharmacy speed_mm_s=1200"
        assert told["why"][0].startswith("PARAMETER_OUT_OF_BOUNDS at params.speed_mm_s: expected")
        assert told["smallest_change"]["version"] == 2
        assert "signed next version" in told["text"][-1]
        assert told["mends"] == [MENDS[Reason.PARAMETER_OUT_OF_BOUNDS]]
        assert f"  to do: {told['mends'][0]}" in told["text"]
        assert told["influenced_by"] == []


def test_a_change_that_no_signature_can_mend_is_not_proposed_nor_one_for_what_was_accepted() -> (
    None
):
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        house.propose(planner, GO)
        house.propose(planner, GO)  # from the pharmacy: no longer there to be gone to
        assert explained(house)["smallest_change"] is None
        accepted = next(r for r in house.log("decision") if r.link.decision == "accept")
        told = explained(house, accepted.link.seq)
        assert (told["why"], told["smallest_change"]) == ([], None)
        outcome = house.log("outcome")[0]
        assert explained(house, outcome.link.seq)["what"] == f"release {outcome.open['ticket']}"


def test_what_the_planner_was_shown_is_named_when_it_mentioned_what_was_refused() -> None:
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        planner.ask(Kind.OBSERVE, Observe(channel="user", text="Take it to Office 1"))
        house.propose(planner, FORBIDDEN)
        told = explained(house)
        assert told["influenced_by"]
        assert any(line.startswith("  influenced by user: `") for line in told["text"])


def test_a_refusal_without_a_decision_is_explained_by_its_message() -> None:
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        house.propose(planner, UNREADABLE)
        told = explained(house)
        assert (told["kind"], told["what"]) == ("refusal", "MALFORMED")
        assert told["why"][0].startswith("MALFORMED: ")
        assert told["who"].endswith(".planner")


def test_a_stop_and_an_order_say_who_gave_them() -> None:
    with DemoGate() as house:
        house.activate()
        house.stop(ClientRole.AUDITOR, 1)
        (stop,) = house.log("stop")
        assert explained(house, stop.link.seq)["who"] == "u5.auditor"
        _, order = house.log("management")
        told = explained(house, order.link.seq)
        assert (told["what"], told["who"]) == ("mission deliver-p1 version 1", "operator-1")
        assert "management activate: mission deliver-p1 version 1 (by " in told["text"][0]
        assert ": stop (by u5.auditor)" in explained(house, stop.link.seq)["text"][0]
        assert explained(house, 0)["who"] == "-"


def test_the_safety_gates_word_is_told_beside_the_other() -> None:
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        near = msgspec.structs.replace(house.robot.state, human_distance_mm=500)
        house.robot.state = near
        house.advance(500)
        house.propose(planner, GO)
        seq = house.log("decision")[0].link.seq
        assert explained(house, seq)["why"] == ["safety gate: HUMAN_PROXIMITY"]


def test_every_reason_says_what_to_do_with_commands_that_there_are() -> None:
    assert MENDS.keys() == set(Reason)
    assert sum(len(remedy.reasons) for remedy in remedies().answers) == len(
        MENDS
    )  # none stands twice
    tree = program()
    for mend in {*MENDS.values(), *EMERGENCY_MENDS.values()}:
        for words in re.findall(r"authguard ([a-z]+(?: [a-z]+)?)", mend):
            node: Any = tree
            for word in words.split():
                node = getattr(node, "commands", {}).get(word)
                assert node is not None, mend
                if not hasattr(node, "commands"):
                    break
    assert remedies_of(["no such reason", Reason.BUSY, "BUSY", None]) == [MENDS[Reason.BUSY]]


def test_a_refusal_without_a_decision_says_where_and_what_to_do() -> None:
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        house.propose(planner, b'navigate_to(destination="Nowhere", speed=0.5)')
        told = explained(house)
        assert told["why"][0].startswith("NAME_UNKNOWN: ")
        assert told["why"][0].endswith("destination)")
        assert told["mends"] == [MENDS[Reason.NAME_UNKNOWN]]


def test_a_refused_emergency_is_the_last_refusal_and_has_advice_of_its_own() -> None:
    with EmergencyGate() as house:
        house.call(house.enter(ClientRole.PLANNER), "call-help")
        told = explained(house)
        assert (told["kind"], told["what"]) == ("refusal", "emergency call-help")
        assert told["who"].endswith(".planner")
        assert told["why"][0].startswith("GUARD_FALSE at ")
        assert told["mends"] == [EMERGENCY_MENDS[Reason.GUARD_FALSE]]
        assert told["mends"] != [MENDS[Reason.GUARD_FALSE]]
        assert ": emergency call-help (by " in told["text"][0]
        assert explained(house, told["seq"]) == told


def test_a_record_that_is_not_there_is_refused() -> None:
    with DemoGate(robot=False) as house:
        for seq in (None, 10**6):
            with pytest.raises(Refused) as refused:
                explained(house, seq)
            assert (refused.value.code, refused.value.where) == ("VALUE_OUT_OF_RANGE", "seq")


def test_a_mission_that_is_gone_leaves_a_record_explained_without_a_change() -> None:
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        house.propose(planner, FAST)
        seq = next(r for r in house.log("decision")).link.seq
        operator = house.enter(ClientRole.OPERATOR)
        operator.ask(Kind.ORDER, Order(act=OrderKind.COMMAND, token=house.order(Verb.REVOKE)))
        house.gate.enforcer.inputs.forget()
        held = house.gate.ledger.store._held  # type: ignore[attr-defined]
        for key in [key for key in held if key[0] == "token"]:
            del held[key]
        assert explained(house, seq)["smallest_change"] is None


def test_the_last_refusal_is_the_planners_whatever_others_asked_wrongly_meanwhile() -> None:
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        house.propose(planner, FAST)
        operator = house.enter(ClientRole.OPERATOR)
        for act in (OrderKind.ACTIVATE, OrderKind.COMMAND):
            with pytest.raises(Refused):
                operator.ask(Kind.ORDER, Order(act=act, token=b"nonsense"))
        assert house.log("refusal")
        assert explained(house)["kind"] == "decision"
        house.propose(planner, UNREADABLE)
        told = explained(house)
        assert (told["kind"], told["what"]) == ("refusal", "MALFORMED")


def test_a_question_without_an_answer_is_no_refusal_in_the_log() -> None:
    with DemoGate() as house:
        house.activate()
        before = len(house.log())
        with pytest.raises(Refused):
            explained(house, 10**6)
        house.gate.ledger.flush()
        assert len(house.log()) == before


def test_what_the_safety_gate_refused_is_the_last_refusal_too() -> None:
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        near = msgspec.structs.replace(house.robot.state, human_distance_mm=500)
        house.robot.state = near
        house.advance(500)
        house.propose(planner, GO)
        assert explained(house)["why"] == ["safety gate: HUMAN_PROXIMITY"]


# damage


@pytest.fixture(scope="module")
def refused() -> tuple[Record, dict[str, Sealed], Mission]:
    """One refused decision as it lies in a log."""
    sim = scenarios.simulation()
    sim.gate.management.activate(scenarios.token())
    scenarios.propose(sim, scenarios.navigate("dock", "pharmacy", speed=1_200))
    row = sim.gate.ledger.store.rows()[-1]
    record = read_record(row.record, where="")
    return record, read_sealed(row.sealed, where=""), scenarios.mission()


def test_values_that_were_destroyed_are_not_told(
    refused: tuple[Record, dict[str, Sealed], Mission],
) -> None:
    record, _, _ = refused
    told = explanation(7, record, {}, mission=None)
    assert (told["who"], told["what"], told["why"]) == ("-", "decision", [])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("findings", [{}]),
        ("findings", 5),
        ("findings", ["x"]),
        ("action", {"params": 5}),
        ("action", {"type": 5, "params": {"a": "b"}}),
        ("action", None),
        ("influences", [1]),
    ],
)
def test_a_damaged_value_is_said_to_be_damaged(
    refused: tuple[Record, dict[str, Sealed], Mission], name: str, value: object
) -> None:
    record, sealed, mission = refused
    damaged = {**sealed, name: Sealed(salt="", value=value)}
    with pytest.raises(MalformedError) as fault:
        explanation(7, record, damaged, mission=mission)
    assert fault.value.where == "record 7"


@pytest.mark.parametrize("changes", [{"grant": "no-such"}, {"reasons": ["NO_SUCH"]}])
def test_a_damaged_record_is_said_to_be_damaged(
    refused: tuple[Record, dict[str, Sealed], Mission], changes: dict[str, Any]
) -> None:
    record, sealed, mission = refused
    damaged = msgspec.structs.replace(record, open={**record.open, **changes})
    with pytest.raises(MalformedError):
        explanation(7, damaged, sealed, mission=mission)


def test_a_log_that_is_damaged_is_answered_and_the_gate_serves_on() -> None:
    with DemoGate(robot=False) as house:
        house.activate()
        rows = house.gate.ledger.store._rows  # type: ignore[attr-defined]
        rows[0] = (
            msgspec.structs.replace(rows[0], record=b'{"kind":')
            if isinstance(rows[0], msgspec.Struct)
            else rows[0]._replace(record=b'{"kind":')
        )
        with pytest.raises(Refused) as refused_:
            explained(house, 0)
        assert refused_.value.family == "malformed"
        assert explained(house, 1)["kind"] == "management"


def test_a_planner_is_never_told_of_a_change() -> None:
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        answer = house.propose(planner, FAST + b"\n" + SCAN)
        assert "smallest_change" not in msgspec.json.encode(answer).decode()
