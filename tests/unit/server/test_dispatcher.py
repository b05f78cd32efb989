# SPDX-License-Identifier: Apache-2.0
"""What each request does when it is its turn: signed words count, everything else is answered."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from authguard_r.approvals import Selection
from authguard_r.core.approval import Approval, ApprovalVerdict
from authguard_r.core.encoding import Tag, b64, digest_of, encode_fast
from authguard_r.core.token import sign_object
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.server.queries import GateQueries
from authguard_r.sim.robot import snapshot_of
from authguard_r.wire.frames import Frame, raw_frame
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import (
    Attest,
    Begun,
    ClientRole,
    Close,
    Kind,
    Mode,
    Observe,
    Order,
    OrderKind,
    Propose,
    Sample,
    Stood,
)
from fixtures import scenarios, templates
from unit.server.demo_site import FORBIDDEN, GO, SCAN, DemoGate, Guest, Refused, reasons

TICKET = "A" * 43


def order(house: DemoGate, act: OrderKind, token: bytes) -> dict[str, Any]:
    operator = house.enter(ClientRole.OPERATOR)
    answer = operator.ask(Kind.ORDER, Order(act=act, token=token))
    operator.leave()
    return answer


@pytest.mark.parametrize(
    ("role", "kind"),
    [
        (ClientRole.PLANNER, Kind.PROPOSE),
        (ClientRole.PLANNER, Kind.OBSERVE),
        (ClientRole.PLANNER, Kind.SAMPLE),
        (ClientRole.ESTIMATOR, Kind.SNAPSHOT),
        (ClientRole.OPERATOR, Kind.ORDER),
        (ClientRole.AUDITOR, Kind.STATUS),
        (ClientRole.AUDITOR, Kind.RECORDS),
    ],
)
def test_a_body_that_is_none_is_answered_and_recorded_and_the_client_stays(
    role: ClientRole, kind: Kind
) -> None:
    with DemoGate(robot=False, estimator=False) as house:
        client = house.enter(role)
        for number in (1, 2):
            house.send(client, raw_frame(kind, number, b'{"authority":"all"}'))
            with pytest.raises(Refused) as refused:
                client.answer(number)
            assert refused.value.code == "MALFORMED"
        house.advance(200)
        (record,) = house.log("refusal")
        assert record.open["client"].endswith(f".{role}")
        assert house.service.queries.counted["refused"] == 2


def test_a_fault_of_ours_is_an_answer_and_everybody_is_served_on() -> None:
    with DemoGate() as house:
        operator, other = house.enter(ClientRole.OPERATOR), house.enter(ClientRole.AUDITOR)
        house.gate.ledger.store._rows.append(None)  # a world that no code of ours expects
        with pytest.raises(Refused) as refused:
            operator.ask(Kind.RECORDS, {"first": 0})
        assert refused.value.code == "INTERNAL_FAULT"
        house.gate.ledger.store._rows.pop()
        assert other.ask(Kind.METRICS)["open_leases"] == 0
        assert operator.ask(Kind.STATUS)["robot"] == scenarios.RID


# state


def test_a_snapshot_is_taken_in_once_and_its_replay_leaves_the_last_in_force() -> None:
    with DemoGate(robot=False) as house:
        assert house.estimator is not None
        taken = house.gate.enforcer.inputs.newest
        house.advance(200)
        newest = house.gate.enforcer.inputs.newest
        assert newest is not None
        assert newest is not taken
        for _ in range(2):  # the very same again is a replay, too
            with pytest.raises(Refused) as again:
                house.estimator.ask(Kind.SNAPSHOT, Attest(token=house._said or b""))
            assert again.value.code == "STATE_REPLAYED"
            assert house.gate.enforcer.inputs.newest is newest
        old = snapshot_of(house.robot.state, robot=scenarios.RID, epoch=1, seq=0)
        signed = sign_object(old, Tag.STATE, house.signer(f"estimator-{scenarios.RID}"))
        for token, code in (
            (signed, "STATE_REPLAYED"),
            (signed[:-9], "MALFORMED"),
            (b"", "MALFORMED"),
            (b"", "STATE_REPLAYED"),
        ):
            with pytest.raises(Refused) as refused:
                house.estimator.ask(Kind.SNAPSHOT, Attest(token=token))
            assert refused.value.code == code
        assert house.gate.enforcer.inputs.newest is newest
        assert [r.open["reasons"] for r in house.log("intake")] == [
            ["STATE_REPLAYED"],
            ["MALFORMED"],  # and its repeat is counted
        ]


def test_a_snapshot_before_any_other_that_is_forged_gives_no_state() -> None:
    with DemoGate(robot=False, estimator=False) as house:
        estimator = house.enter(ClientRole.ESTIMATOR)
        with pytest.raises(Refused):
            estimator.ask(Kind.SNAPSHOT, Attest(token=b"{}"))
        assert house.gate.enforcer.inputs.state is None


# management


def test_every_order_is_the_signature_of_its_token_not_the_role_that_hands_it_in() -> None:
    with DemoGate(robot=False) as house:
        operator = house.enter(ClientRole.OPERATOR)
        forged = sign_object(scenarios.mission(), Tag.MISSION, house.signer("supervisor-1"))
        with pytest.raises(Refused) as refused:
            operator.ask(Kind.ORDER, Order(act=OrderKind.ACTIVATE, token=forged))
        assert (refused.value.code, refused.value.family) == ("ROLE_DENIED", "authenticity")
        assert house.standing is None
        house.activate()
        assert house.standing.status == "active"


def test_a_command_ends_what_runs_at_once() -> None:
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        number = house.begin(planner, GO)
        house.advance(500)
        answer = order(house, OrderKind.COMMAND, house.order(Verb.REVOKE))
        assert answer["standing"]["status"] == "revoked"
        house.pump()
        (step,) = house.rest(planner, number)["steps"]
        assert (step["execution"]["outcome"], reasons(step)) == ("aborted", ["REVOKED"])


def test_a_choice_is_handed_in() -> None:
    with DemoGate(robot=False) as house:
        mission = house.activate()
        value = Selection(
            mid=mission.mid,
            version=1,
            mission=digest_of(Tag.MISSION, mission),
            grant="pick-p1",
            row=0,
            nonce=b64(bytes(16)),
            expires_ms=scenarios.START_MS + 10**6,
            issued_ms=house.clock.wall_ms(),
        )
        token = sign_object(value, Tag.SELECTION, house.signer("operator-1"))
        assert "standing" in order(house, OrderKind.SELECT, token)
        with pytest.raises(Refused, match="EXPIRED"):
            order(house, OrderKind.SELECT, token)


def test_an_approval_is_kept_and_says_which_question_it_answers() -> None:
    with DemoGate(robot=False) as house:
        mission = house.activate()
        told: list[dict[str, Any]] = []
        watcher = house.enter(ClientRole.AUDITOR)
        number = watcher.say(Kind.WATCH, {})
        fields = {
            "mid": mission.mid,
            "version": 1,
            "mission": digest_of(Tag.MISSION, mission),
            "grant": "go-to-pharmacy",
            "counter": 1,
            "scope": TICKET,
            "situation": TICKET,
            "verdict": ApprovalVerdict.APPROVE,
            "expires_ms": scenarios.START_MS + 60_000,
            "rid": scenarios.RID,
        }
        known = {f.name for f in msgspec.structs.fields(Approval)}
        value = Approval(**{k: v for k, v in fields.items() if k in known})
        token = sign_object(value, Tag.APPROVAL, house.signer("supervisor-1"))
        answer = order(house, OrderKind.APPROVE, token)
        said = {"counter": 1, "approver": "supervisor-1", "verdict": "approve"}
        assert answer == {**said, "why_not": "APPROVAL_TIMEOUT"}  # nobody was asked
        told = watcher.bodies(Kind.EVENT, number)
        assert [e["act"] for e in told if e["event"] == "management"] == ["approve"]


def test_a_template_is_taken_in_and_withdrawn_with_the_mission_that_it_made() -> None:
    with DemoGate(robot=False, trust=templates.one_folder()) as house:
        kept = order(house, OrderKind.TEMPLATE, templates.signed())["standing"]
        assert (kept["used"], kept["withdrawn"]) == (0, False)
        made = order(house, OrderKind.ACTIVATE, templates.token())["standing"]
        assert made["status"] == "active"
        auditor = house.enter(ClientRole.AUDITOR)
        assert auditor.ask(Kind.STATUS)["mission"]["mid"] == made["mid"]
        gone = order(house, OrderKind.TEMPLATE, templates.withdrawal())["standing"]
        assert gone["withdrawn"] is True
        assert auditor.ask(Kind.STATUS)["mission"] is None
        with pytest.raises(Refused):
            order(house, OrderKind.TEMPLATE, templates.signed())


def test_an_order_that_is_refused_looks_at_what_runs_all_the_same() -> None:
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        number = house.begin(planner, GO)
        house.clock.ms += 10_000  # nobody attested anything for as long
        with pytest.raises(Refused):
            order(house, OrderKind.COMMAND, b"junk")
        house.pump()
        assert reasons(house.rest(planner, number)["steps"][0])[0] == "STATE_STALE"


# streams and controllers where there are none


def test_nothing_streams_and_nobody_is_obeyed_where_there_is_no_controller() -> None:
    with DemoGate(mode=Mode.SHADOW) as house:
        planner = house.enter(ClientRole.PLANNER)
        for kind, body in (
            (Kind.SAMPLE, Sample(ticket=TICKET, params={})),
            (Kind.CLOSE, Close(ticket=TICKET)),
        ):
            with pytest.raises(Refused) as refused:
                planner.ask(kind, body)
            assert refused.value.code == "LEASE_ENDED"
        ignored = house.enter(ClientRole.CONTROLLER)
        ignored.say(Kind.STOOD, Stood(stops=7))
        ignored.say(Kind.BEGUN, Begun(ticket=TICKET))
        assert ignored.bodies(Kind.ERROR) == []
        ignored.leave()
        house.activate()
        assert house.propose(planner, SCAN)["steps"][0]["outcome"] == "accept"


# what a watcher is told


def test_who_watches_is_told_of_decisions_outcomes_stops_orders_and_clients() -> None:
    with DemoGate() as house:
        planner, auditor = house.enter(ClientRole.PLANNER), house.enter(ClientRole.AUDITOR)
        number = auditor.say(Kind.WATCH, {})
        house.activate()
        house.propose(planner, SCAN)
        house.propose(planner, FORBIDDEN)
        house.stop(ClientRole.AUDITOR, 1)
        house.stop(ClientRole.AUDITOR, 1)  # the lane says it again after a crash
        planner.leave()
        told = auditor.bodies(Kind.EVENT, number)
        kinds = [event["event"] for event in told]
        for kind in ("management", "decision", "outcome", "client"):
            assert kind in kinds
        assert kinds.count("stop") == 1
        assert told[-1] == {**told[-1], "event": "client", "role": "planner", "here": False}
        assert all(event["time_ms"] >= scenarios.START_MS for event in told)


def test_a_view_knows_of_the_mission_after_each_order() -> None:
    with DemoGate(robot=False) as house:
        view: GateQueries = house.service.queries
        assert view.mission.runs is False
        house.activate()
        assert view.mission.runs is True
        order(house, OrderKind.COMMAND, house.order(Verb.SUSPEND))
        assert view.mission.runs is False


# what a planner was shown, in parts


def turns(house: DemoGate, guest: Guest, *asked: tuple[Kind, object]) -> int:
    """Let the gate serve requests that came together; return how many turns that took."""
    client, service, count = house.client(guest), house.service, 0

    def serve() -> None:
        nonlocal count
        for number, (kind, body) in enumerate(asked, 101):
            service._queue.came(client, Frame(kind, number, encode_fast(body)))
        while service._queue:
            service._turn()
            count += 1

    house.do(serve)
    return count


@pytest.mark.parametrize(
    ("length", "parts"),
    [
        (0, 1),
        (1, 1),
        (LIMITS.part_characters, 1),
        (LIMITS.part_characters + 1, 2),
        (20 * LIMITS.part_characters, 20),
    ],
)
def test_a_text_is_looked_through_in_parts_and_answered_once(length: int, parts: int) -> None:
    with DemoGate(robot=False, estimator=False) as house:
        planner = house.enter(ClientRole.PLANNER)
        seen = Observe(channel="user", text="x" * length)
        assert turns(house, planner, (Kind.OBSERVE, seen)) == parts
        assert planner.bodies(Kind.REPLY) == [{}]


def test_what_a_planner_asked_since_waits_until_its_text_was_looked_through() -> None:
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        text = "x" * (5 * LIMITS.part_characters - 8) + " Office 1 "  # over a border, at the end
        seen = Observe(channel="user", text=text)
        asked = Propose(key="k", plan=FORBIDDEN)
        turns(house, planner, (Kind.OBSERVE, seen), (Kind.PROPOSE, asked))
        planner.pull()
        answers = [item.id for item in planner.got if item.kind is Kind.REPLY]
        assert answers == [101, 102]
        (record,) = house.log("decision")
        named = {item["value"] for item in house.sealed(record.link.seq)["influences"]}
        assert "office-1" in named


def test_others_have_their_turns_between_the_parts_of_a_long_text() -> None:
    with DemoGate(robot=False, estimator=False) as house:
        planner, auditor = house.enter(ClientRole.PLANNER), house.enter(ClientRole.AUDITOR)
        service, long = (
            house.service,
            Observe(channel="user", text="x" * (30 * LIMITS.part_characters)),
        )
        served: list[int] = []

        def serve() -> None:
            service._queue.came(house.client(planner), Frame(Kind.OBSERVE, 101, encode_fast(long)))
            service._turn()
            service._queue.came(house.client(auditor), Frame(Kind.STATUS, 102, b"{}"))
            while service._queue:
                service._turn()
                served.append(len(house.client(auditor).waiting))

        house.do(serve)
        assert served.index(0) <= 1  # of some thirty
        assert len(served) > 25
        assert len(auditor.bodies(Kind.REPLY)) == 1


def test_who_hangs_up_while_its_text_is_looked_through_has_been_shown_all_of_it() -> None:
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        client = house.client(planner)
        seen = Observe(channel="user", text="x" * (5 * LIMITS.part_characters) + " Office 1 ")

        def go() -> None:
            house.service._queue.came(client, Frame(Kind.OBSERVE, 101, encode_fast(seen)))
            house.service._turn()
            planner.line.close()

        house.do(go)
        house.settle()
        house.activate()
        house.propose(house.enter(ClientRole.PLANNER), FORBIDDEN)
        (record,) = house.log("decision")
        named = {item["value"] for item in house.sealed(record.link.seq)["influences"]}
        assert "office-1" in named
