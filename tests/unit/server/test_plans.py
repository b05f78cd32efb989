# SPDX-License-Identifier: Apache-2.0
"""A plan is decided step by step, once, for whoever still wants it."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.core.encoding import b64
from authguard_r.core.identifiers import Identifier
from authguard_r.core.mission import OnRefusal
from authguard_r.core.provenance import TRUST, Label
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.integrations.tools.planner import CallOutcome
from authguard_r.server import sessions
from authguard_r.server.fair_queue import ServedClient
from authguard_r.store.sqlite import open_store
from authguard_r.wire.disclosure import Disclosure
from authguard_r.wire.frames import raw_frame
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import (
    ClientRole,
    Evaluate,
    Kind,
    Mode,
    Observe,
    Order,
    OrderKind,
    Propose,
)
from fixtures import scenarios
from fixtures.cases import case
from fixtures.limits import bounded
from unit.server.demo_site import (
    FORBIDDEN,
    GO,
    PATIENCE_S,
    SCAN,
    UNREADABLE,
    DemoGate,
    Guest,
    Refused,
)

COLLECT = (scenarios.HOSPITAL / "replies" / "01-collect.json").read_bytes()
LONG = b"\n" * 20_000


def planner(house: DemoGate, name: str | None = None) -> Guest:
    return house.enter(ClientRole.PLANNER, name)


def decided(house: DemoGate) -> list[str]:
    return [record.link.decision for record in house.log("decision")]


def test_each_step_is_decided_in_its_turn_and_the_answer_names_all() -> None:
    with DemoGate() as house:
        client = planner(house)
        house.activate()
        number = house.begin(client, COLLECT)
        assert decided(house) == ["accept"]
        answer = house.rest(client, number)
        assert [step["execution"]["outcome"] for step in answer["steps"]] == ["succeeded"] * 2
        assert (answer["planned"], answer["on_refusal"], answer["repeated"]) == (2, None, False)
        told = client.bodies(Kind.EVENT, number)
        assert [event["step"] for event in told] == [0, 1]
        assert decided(house) == ["accept", "accept"]
        assert house.robot.state.holding == "package-p1"


def test_a_refused_step_ends_its_plan() -> None:
    with DemoGate() as house:
        client = planner(house)
        house.activate()
        answer = house.propose(client, FORBIDDEN + b"\n" + SCAN)
        assert (len(answer["steps"]), answer["planned"]) == (1, 2)
        assert answer["on_refusal"] == "hold"
        assert decided(house) == ["reject"]
        assert house.log("stop") == []


def test_a_step_that_was_released_and_did_not_succeed_ends_its_plan() -> None:
    with DemoGate() as house:
        client = planner(house)
        house.activate()
        number = house.begin(client, COLLECT)
        house.advance(500)
        house.stop(ClientRole.OPERATOR, 1)
        answer = house.rest(client, number)
        assert [step["execution"]["outcome"] for step in answer["steps"]] == ["aborted"]
        assert decided(house) == ["accept"]


def test_a_second_proposal_while_one_runs_is_busy_and_unread() -> None:
    with DemoGate() as house:
        client = planner(house)
        house.activate()
        number = house.begin(client, GO)
        house.send(client, raw_frame(Kind.PROPOSE, 77, b"{ this is no JSON"))
        with pytest.raises(Refused) as refused:
            client.answer(77)
        assert refused.value.code == "BUSY"
        assert house.service.queries.counted["shed"] == 1
        assert house.rest(client, number)["steps"][0]["executed"]
        assert house.propose(client, SCAN)["steps"][0]["executed"]  # free again


def test_a_repeat_in_flight_is_answered_on_the_new_connection() -> None:
    with DemoGate() as house:
        first = planner(house)
        house.activate()
        number = house.begin(first, GO, "walk")
        second = planner(house)
        again = house.begin(second, GO, "walk")
        answer = house.rest(second, again)
        assert answer["steps"][0]["execution"]["outcome"] == "succeeded"
        assert decided(house) == ["accept"]
        with pytest.raises(Refused) as refused:
            first.answer(number)
        assert (refused.value.code, refused.value.where) == ("BUSY", "proposal.key")
        assert house.propose(first, SCAN)["steps"][0]["executed"]  # and it may go on


def test_a_planner_that_lost_its_connection_gets_the_answer_when_it_is_back() -> None:
    with DemoGate() as house:
        first = planner(house)
        house.activate()
        house.begin(first, COLLECT, "fetch")
        first.leave()
        second = planner(house)
        answer = house.rest(second, house.begin(second, COLLECT, "fetch"))
        assert [step["execution"]["outcome"] for step in answer["steps"]] == ["succeeded"] * 2
        assert decided(house) == ["accept", "accept"]


def test_a_key_in_flight_is_one_plan_and_no_other() -> None:
    with DemoGate() as house:
        first, second = planner(house), planner(house)
        house.activate()
        number = house.begin(first, GO, "walk")
        with pytest.raises(Refused) as refused:
            second.ask(Kind.PROPOSE, Propose(key="walk", plan=SCAN))
        assert refused.value.code == "KEY_REUSED"
        assert house.rest(first, number)["steps"][0]["executed"]
        assert decided(house) == ["accept"]


def test_a_key_whose_plan_is_still_being_read_is_one_plan_and_no_other() -> None:
    with DemoGate() as house:
        first, second = planner(house), planner(house)
        house.activate()
        number = house.begin(first, SCAN + LONG, "look")
        with pytest.raises(Refused) as refused:
            second.ask(Kind.PROPOSE, Propose(key="look", plan=SCAN))
        assert refused.value.code == "KEY_REUSED"
        house.until(lambda: house.log("decision"))
        assert house.rest(first, number)["steps"][0]["executed"]
        assert decided(house) == ["accept"]


def test_a_key_that_was_used_is_one_plan_and_nothing_is_decided_twice() -> None:
    with DemoGate() as house:
        client = planner(house)
        house.activate()
        first = house.propose(client, SCAN, "look")
        again = house.propose(client, SCAN, "look")
        assert again == {**first, "repeated": True}
        with pytest.raises(Refused) as refused:
            client.ask(Kind.PROPOSE, Propose(key="look", plan=GO))
        assert refused.value.code == "KEY_REUSED"
        assert decided(house) == ["accept"]
        assert house.propose(planner(house, "other"), SCAN, "look")["repeated"] is False


def test_after_a_restart_a_repeat_is_answered_and_nothing_is_released(tmp_path: Path) -> None:
    with DemoGate(store=open_store(tmp_path / "robot.db")) as house:
        client = planner(house)
        house.activate()
        first = house.propose(client, SCAN, "look")
        refused = house.propose(client, FORBIDDEN, "leave")
        clock = house.clock
    with DemoGate(store=open_store(tmp_path / "robot.db"), clock=clock) as house:
        client = planner(house)
        again = house.propose(client, SCAN, "look")
        assert again["repeated"] is True
        assert again["steps"][0]["seq"] == first["steps"][0]["seq"]
        assert again["steps"][0]["execution"] == first["steps"][0]["execution"]
        # what was only refused had no effect: it may be decided again
        assert house.propose(client, FORBIDDEN, "leave")["repeated"] is False
        assert refused["steps"][0]["reasons"]
        assert decided(house).count("accept") == 1


def test_a_planner_that_disconnects_gets_no_further_step_begun() -> None:
    with DemoGate() as house:
        client = planner(house)
        house.activate()
        house.begin(client, COLLECT, "fetch")
        house.advance(500)
        client.leave()
        house.advance(20_000)
        assert [r.link.decision for r in house.log("outcome")] == ["succeeded"]
        assert decided(house) == ["accept"]
        assert house.robot.state.holding is None
        again = house.propose(planner(house), COLLECT, "fetch")
        assert (len(again["steps"]), again["planned"], again["repeated"]) == (1, 2, True)


def test_a_planner_that_goes_while_its_next_step_waits_gets_it_not_begun(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    bounded(monkeypatch, sessions, read_s=PATIENCE_S)
    with DemoGate(mode=Mode.SHADOW) as house:
        client = planner(house)
        house.activate()
        house.begin(client, SCAN + b"\n" + SCAN, "twice")
        house.do(
            house.client(client).line.pause_writing
        )  # its answers wait, and so does its next step
        house.look()
        assert decided(house) == ["accept"]
        client.leave()
        assert decided(house) == ["accept"]
        again = house.propose(planner(house), SCAN + b"\n" + SCAN, "twice")
        assert (len(again["steps"]), again["repeated"]) == (1, True)


def test_a_planner_that_goes_while_its_plan_is_read_gets_nothing_begun() -> None:
    with DemoGate() as house:
        client = planner(house)
        house.activate()
        house.begin(client, SCAN + LONG, "look")
        client.leave()
        house.until(lambda: not house.service._dispatcher._plans._open)
        assert decided(house) == []
        # nothing was decided under the key, so it can come again
        back = planner(house)
        number = house.begin(back, SCAN + LONG, "look")
        house.until(lambda: house.log("decision"))
        assert house.rest(back, number)["repeated"] is False
        assert decided(house) == ["accept"]


def test_the_next_step_of_a_plan_waits_its_turn_behind_another_client() -> None:
    with DemoGate(mode=Mode.SHADOW) as house:
        one, two = planner(house, "one"), planner(house, "two")
        house.activate()
        house.begin(one, b"\n".join([SCAN] * 3))
        house.begin(two, b"\n".join([SCAN] * 3))
        house.advance(1_000)
        who = [house.sealed(r.link.seq)["action"]["meta"]["planner"] for r in house.log("decision")]
        assert [name.split(".")[1] for name in who] == ["one", "two"] * 3


def test_shadow_releases_nothing_judges_every_step_and_marks_every_record() -> None:
    with DemoGate(mode=Mode.SHADOW) as house:
        client = planner(house)
        house.activate()
        here = house.place
        answer = house.propose(client, b"\n".join([FORBIDDEN, SCAN, GO, UNREADABLE.split()[0]]))
        assert answer["shadow"] is True
        answer = house.propose(client, b"\n".join([FORBIDDEN, SCAN, GO]))
        assert [step["outcome"] for step in answer["steps"]] == ["reject", "accept", "accept"]
        assert answer["planned"] == 3
        house.advance(5_000)
        assert house.place == here
        assert house.robot.trace == []
        assert all(record.open["mode"] == "shadow" for record in house.log())


@pytest.mark.parametrize("mode", Mode)
def test_a_plan_that_cannot_be_read_is_kept_sealed_in_shadow_alone(mode: Mode) -> None:
    with DemoGate(mode=mode) as house:
        client = planner(house)
        house.activate()
        answer = house.propose(client, UNREADABLE, dialect="python")
        assert answer["steps"][0]["reasons"] == ["MALFORMED"]
        (record,) = [r for r in house.log("refusal") if r.open["client"].endswith("planner")]
        values = house.sealed(record.link.seq)
        kept = {"plan": b64(UNREADABLE), "dialect": "python"}
        assert kept.items() <= values.items() if mode is Mode.SHADOW else "plan" not in values
        assert "plan" not in record.open


@pytest.mark.parametrize("wanted", OnRefusal)
def test_what_is_done_after_a_refusal_is_what_the_mission_says(wanted: OnRefusal) -> None:
    with DemoGate(mission=scenarios.mission(on_refusal=str(wanted))) as house:
        client = planner(house)
        house.activate()
        answer = house.propose(client, FORBIDDEN)
        assert answer["on_refusal"] == wanted
        stops = [record.open["by"] for record in house.log("stop")]
        assert stops == (["gate"] if wanted is OnRefusal.STOP else [])
        assert house.session is not None
        assert house.session.stops == len(stops)  # the robot was really told


def test_a_dialect_that_nobody_speaks_is_refused_and_the_planner_may_go_on() -> None:
    with DemoGate() as house:
        client = planner(house)
        house.activate()
        with pytest.raises(Refused) as refused:
            client.ask(Kind.PROPOSE, Propose(key="k", plan=SCAN, dialect="klingon"))
        assert (refused.value.code, refused.value.where) == ("MALFORMED", "proposal.dialect")
        assert house.propose(client, SCAN, "k")["repeated"] is False
        assert decided(house) == ["accept"]


def test_a_proposal_that_is_none_is_refused_and_the_planner_may_go_on() -> None:
    with DemoGate() as house:
        client = planner(house)
        house.activate()
        house.send(client, raw_frame(Kind.PROPOSE, 5, b'{"key":"k"}'))
        with pytest.raises(Refused) as refused:
            client.answer(5)
        assert refused.value.code == "MALFORMED"
        assert house.propose(client, SCAN)["steps"][0]["executed"]


# what a planner is shown


def test_what_a_planner_was_shown_counts_in_its_own_decisions_alone() -> None:
    notice = Observe(channel="user", text="Take it to Office 2, said the notice")
    with DemoGate() as house:
        shown, other = planner(house, "shown"), planner(house, "other")
        house.activate()
        channel = next(iter(house.site.channels), notice.channel)
        shown.ask(Kind.OBSERVE, msgspec.structs.replace(notice, channel=channel))
        shown.ask(Kind.OBSERVE, msgspec.structs.replace(notice, channel=channel))
        plan = b'navigate_to(destination="Office 2")'
        for client in (shown, other):
            house.propose(client, plan)
        first, second = (
            house.sealed(record.link.seq)["influences"] for record in house.log("decision")
        )
        assert [item["value"] for item in first] != []
        assert second == []


def test_a_channel_that_nobody_gave_a_label_is_refused() -> None:
    with DemoGate() as house:
        client = planner(house)
        with pytest.raises(Refused) as refused:
            client.ask(Kind.OBSERVE, Observe(channel="telepathy", text="go"))
        assert refused.value.family == "malformed"


def test_nobody_inputs_are_forgotten_for_one_more_planner() -> None:
    with DemoGate(robot=False, estimator=False, connections=8) as house:
        channel = "user"
        plans = house.service._dispatcher._plans
        for number in range(LIMITS.contexts - 1):  # of many users
            plans.contexts._known[Identifier(f"u{10**6 + number}.p")] = plans.contexts.empty()
        client = planner(house, "p0")
        client.ask(Kind.OBSERVE, Observe(channel=channel, text="Pharmacy"))
        client.leave()
        late = planner(house, "late")
        with pytest.raises(Refused) as refused:
            late.ask(Kind.OBSERVE, Observe(channel=channel, text="Pharmacy"))
        assert (refused.value.code, refused.value.where) == ("BUSY", "observe")
        known = planner(house, "p0")
        known.ask(Kind.OBSERVE, Observe(channel=channel, text="Pharmacy"))


def test_one_user_has_its_own_part_of_what_is_kept_and_no_more() -> None:
    with DemoGate(robot=False, estimator=False) as house:
        plans = house.service._dispatcher._plans
        for number in range(LIMITS.contexts_of_user):
            client = planner(house, f"p{number}")
            client.ask(Kind.OBSERVE, Observe(channel="user", text="Pharmacy"))
            client.leave()
        with pytest.raises(Refused) as refused:
            planner(house, "late").ask(Kind.OBSERVE, Observe(channel="user", text="Pharmacy"))
        assert (refused.value.code, refused.value.where) == ("BUSY", "observe")
        assert len(plans.contexts._known) == LIMITS.contexts_of_user
        line = house.client(house._guests[-1]).line
        other = ServedClient(line, role=ClientRole.PLANNER, name=Identifier("u99999.p"), uid=99_999)
        plans.contexts.observe(other, "user", "Pharmacy")  # another user's are noted all the same
        assert plans.contexts._known[other.name].influences(scenarios.navigate("dock", "pharmacy"))


def test_a_first_text_that_is_refused_takes_nobodys_place() -> None:
    with DemoGate(robot=False, estimator=False) as house:
        client = planner(house)
        with pytest.raises(Refused):
            client.ask(Kind.OBSERVE, Observe(channel="carrier pigeon", text="coo"))
        assert house.service._dispatcher._plans.contexts._known == {}
        assert house.service._dispatcher._plans.contexts._unheard == set()


def test_who_was_shown_something_that_could_not_be_noted_may_have_seen_anything() -> None:
    with DemoGate() as house:
        plans = house.service._dispatcher._plans
        uid = os.geteuid()
        for number in range(LIMITS.contexts_of_user):
            plans.contexts._known[Identifier(f"u{uid}.p{number}")] = plans.contexts.empty()
        unheard, silent = planner(house, "unheard"), planner(house, "silent")
        with pytest.raises(Refused):
            unheard.ask(Kind.OBSERVE, Observe(channel="user", text="Pharmacy"))
        house.activate()
        for client in (unheard, silent):
            house.propose(client, FORBIDDEN)
        labels = [record.open["labels"]["destination"] for record in house.log("decision")]
        assert labels == [TRUST[-1], Label.MODEL]


def test_who_connects_anew_is_not_forgotten_to_have_seen_anything() -> None:
    with DemoGate() as house:
        plans = house.service._dispatcher._plans
        uid = os.geteuid()
        for number in range(LIMITS.contexts_of_user):
            plans.contexts._known[Identifier(f"u{uid}.p{number}")] = plans.contexts.empty()
        house.activate()
        for _ in range(2):
            unheard = planner(house, "unheard")
            with suppress(Refused):
                unheard.ask(Kind.OBSERVE, Observe(channel="user", text="Pharmacy"))
            unheard.leave()
        house.propose(planner(house, "unheard"), FORBIDDEN)
        (label,) = [record.open["labels"]["destination"] for record in house.log("decision")]
        assert label == TRUST[-1]
        assert plans.contexts._unheard == {f"u{uid}.unheard"}


def test_more_names_than_are_kept_of_those_who_were_not_heard_are_their_whole_user() -> None:
    with DemoGate() as house:
        plans = house.service._dispatcher._plans
        uid = os.geteuid()
        plans.contexts._unheard.update(
            f"u{uid}.p{number}" for number in range(LIMITS.contexts_of_user)
        )
        for number in range(LIMITS.contexts_of_user):
            plans.contexts._known[Identifier(f"u{uid}.q{number}")] = plans.contexts.empty()
        house.activate()
        for name in ("one", "two"):
            late = planner(house, name)
            with pytest.raises(Refused):
                late.ask(Kind.OBSERVE, Observe(channel="user", text="Pharmacy"))
            late.leave()
        assert len(plans.contexts._unheard) == LIMITS.contexts_of_user + 1
        house.propose(planner(house, "silent"), FORBIDDEN)
        (label,) = [record.open["labels"]["destination"] for record in house.log("decision")]
        assert label == TRUST[-1]


# long plans, and who waits for them


def test_a_third_long_plan_of_one_user_is_busy_and_its_key_free_again() -> None:
    with DemoGate() as house:
        house.activate()
        clients = [planner(house, name) for name in "abc"]
        numbers = [house.begin(client, FORBIDDEN + LONG, "k") for client in clients[:2]]
        with pytest.raises(Refused) as refused:
            clients[2].ask(Kind.PROPOSE, Propose(key="k", plan=SCAN + LONG))
        assert (refused.value.code, refused.value.where) == ("BUSY", "proposal")
        for client, number in zip(clients, numbers, strict=False):
            house.until(lambda it=client, n=number: it.answer(n))  # type: ignore[misc]
        number = house.begin(clients[2], SCAN + LONG, "k")
        house.until(lambda: "accept" in decided(house))
        answer = house.rest(clients[2], number)
        assert answer["repeated"] is False
        assert answer["steps"][0]["execution"]["outcome"] == "succeeded"


def test_a_long_plan_whose_planner_hung_up_is_not_read_when_its_turn_comes() -> None:
    with DemoGate() as house:
        house.activate()
        stays, goes = planner(house, "stays"), planner(house, "goes")
        number = house.begin(stays, FORBIDDEN + LONG)
        house.begin(goes, SCAN + LONG)
        goes.leave()
        house.until(lambda: stays.answer(number))
        house.until(lambda: not house.service._dispatcher._plans._open)
        assert decided(house) == ["reject"]


@pytest.mark.parametrize("returns", ["before its turn", "after its turn"])
def test_a_planner_that_comes_back_while_its_long_plan_waits_gets_that_plans_answer(
    returns: str,
) -> None:
    with DemoGate() as house:
        house.activate()
        stays, goes = planner(house, "stays"), planner(house, "llm")
        number = house.begin(stays, FORBIDDEN + LONG)
        house.begin(goes, SCAN + LONG, "look")
        goes.leave()
        if returns == "after its turn":
            house.until(lambda: stays.answer(number))
            house.until(lambda: not house.service._dispatcher._plans._open)
        back = planner(house, "llm")
        again = house.begin(back, SCAN + LONG, "look")
        house.until(lambda: len(house.log("decision")) == 2)
        (step,) = house.rest(back, again)["steps"]
        assert (step["outcome"], step["executed"]) == ("accept", True)
        assert decided(house) == ["reject", "accept"]
        assert house.log("refusal") == []


def test_a_long_what_if_is_read_elsewhere_and_says_what_a_short_one_says() -> None:
    with DemoGate() as house:
        house.activate()
        operator = house.enter(ClientRole.OPERATOR)
        short = operator.ask(Kind.EVALUATE, Evaluate(plan=GO))
        number = operator.say(Kind.EVALUATE, Evaluate(plan=GO + LONG))
        assert operator.answer(number) is None
        assert house.reader._process is not None
        long = house.until(lambda: operator.answer(number))
        assert [step["outcome"] for step in long["steps"]] == ["accept"]
        assert short["steps"][0]["outcome"] == long["steps"][0]["outcome"]
        wrong = operator.say(Kind.EVALUATE, Evaluate(plan=UNREADABLE + LONG))

        def refused() -> bool:
            with suppress(Refused):
                return operator.answer(wrong) is not None
            return True

        house.until(refused)
        with pytest.raises(Refused) as fault:
            operator.answer(wrong)
        assert fault.value.family == "malformed"


# what-ifs


def test_a_what_if_answers_and_leaves_no_trace() -> None:
    with DemoGate() as house:
        operator = house.enter(ClientRole.OPERATOR)
        with pytest.raises(Refused) as refused:
            operator.ask(Kind.EVALUATE, Evaluate(plan=GO))
        assert refused.value.code == "NO_ACTIVE_MISSION"
        house.activate()
        before = (len(house.log()), house.standing)
        steps = operator.ask(Kind.EVALUATE, Evaluate(plan=GO + b"\n" + FORBIDDEN))["steps"]
        assert [step["outcome"] for step in steps] == ["accept", "reject"]
        assert all(step["authoritative"] is False for step in steps)
        for asked in (Evaluate(plan=UNREADABLE), Evaluate(plan=GO, dialect="klingon")):
            with pytest.raises(Refused) as refused:
                operator.ask(Kind.EVALUATE, asked)
            assert refused.value.family == "malformed"
        house.advance(1_000)
        kinds = [record.kind for record in house.log()][before[0] :]
        assert set(kinds) <= {"refusal"}  # what could not be read, and nothing else
        assert house.standing == before[1]
        assert house.robot.trace == []


# disclosure


@pytest.mark.parametrize("level", Disclosure)
def test_a_planner_is_told_what_the_configuration_says(level: Disclosure) -> None:
    with DemoGate(disclosure=level) as house:
        client = planner(house)
        house.activate()
        (step,) = house.propose(client, FORBIDDEN)["steps"]
        assert "DESTINATION_OUT_OF_SCOPE" in step["reasons"]
        if level is Disclosure.CODES:
            assert "findings" not in step
        else:
            keys = {"field", "reason", "step"}
            keys |= {"expected", "got"} if level is Disclosure.FULL else set()
            assert all(set(finding) == keys for finding in step["findings"])
        assert ("action" in step) is (level is Disclosure.FULL)


@pytest.mark.parametrize("level", Disclosure)
def test_what_could_not_be_read_is_told_as_a_finding_where_the_configuration_shows_it(
    level: Disclosure,
) -> None:
    text = b'{"tool": "navigate_to", "arguments": {"destination": "Dock", "speed": "fast"}}'
    with DemoGate(disclosure=level) as house:
        house.activate()
        (step,) = house.propose(planner(house), text)["steps"]
    assert (step["reasons"], step["retryable"]) == (["VALUE_INVALID"], False)
    place = {"field": "input.speed", "reason": "VALUE_INVALID", "step": 0}
    shown = {**place, "expected": "expected a number", "got": ""}
    wanted = {Disclosure.CODES: None, Disclosure.FIELDS: [place], Disclosure.FULL: [shown]}
    assert step.get("findings") == wanted[level]
    said = CallOutcome(step=step).refusal.splitlines()
    assert said == [
        "refused: VALUE_INVALID",
        *([] if level is Disclosure.CODES else ["input.speed: expected a number"]),
        "the same call will not pass later",
    ]


@pytest.mark.parametrize("level", Disclosure)
def test_why_the_safety_gate_does_not_agree_is_told_as_far_as_the_configuration_shows_it(
    level: Disclosure,
) -> None:
    with DemoGate(disclosure=level) as house:
        house.activate()
        house.robot.state = msgspec.structs.replace(house.robot.state, human_distance_mm=500)
        house.advance(500)
        (step,) = house.propose(planner(house), GO)["steps"]
    assert (step["outcome"], step["reasons"], step["released"]) == ("accept", [], False)
    outcome = CallOutcome(step=step)
    lines = outcome.refusal.splitlines()
    assert lines[0] == "refused by the safety gate: HUMAN_PROXIMITY"
    assert lines[-1] == "the same call may pass later"
    if level is Disclosure.FULL:
        assert lines[1] == "params.speed_mm_s: at most 300, got 800"
        return
    assert step["safety"] == {"safe": False, "hazards": ["HUMAN_PROXIMITY"]}
    assert len(lines) == 2
    assert outcome.verdict["safety"] == step["safety"]


def test_what_stood_around_the_calls_is_in_the_record_of_each_step() -> None:
    call = json.dumps({"name": "scan", "arguments": {}})
    for text, around in [
        (f"I look.\n<tool_call>{call}</tool_call>", "hermes, 7 characters before it"),
        (f"```json\n{call}\n```\nDone.", "fence, 5 characters after it"),
        (call, None),
    ]:
        with case(text), DemoGate() as house:
            house.activate()
            house.propose(planner(house), text.encode())
            (decision,) = (record for record in house.log() if record.kind == "decision")
            assert decision.open.get("around") == around


# two at once


def test_eight_requests_wait_and_no_more_are_read(monkeypatch: pytest.MonkeyPatch) -> None:
    bounded(monkeypatch, sessions, read_s=PATIENCE_S)
    with DemoGate() as house:
        client = planner(house)
        house.activate()
        line = house.client(client)
        house.do(line.line.pause_writing)
        for number in range(LIMITS.waiting_requests + 2):
            house.send(
                client, raw_frame(Kind.OBSERVE, number + 1, b'{"channel":"user","text":"x"}')
            )
        assert (line.paused, len(line.waiting) >= LIMITS.waiting_requests) == (True, True)
        house.do(line.line.resume_writing)
        assert len(client.bodies(Kind.REPLY)) == LIMITS.waiting_requests + 2
        assert line.paused is False


def test_a_suspended_mission_refuses_until_it_is_resumed() -> None:
    with DemoGate() as house:
        client, operator = planner(house), house.enter(ClientRole.OPERATOR)
        house.activate()
        house.stop(ClientRole.OPERATOR, 1)
        refused = house.propose(client, SCAN)
        assert refused["steps"][0]["reasons"] == ["MISSION_SUSPENDED"]
        said: dict[str, Any] = operator.ask(
            Kind.ORDER, Order(act=OrderKind.COMMAND, token=house.order(Verb.RESUME))
        )
        assert said["standing"]["status"] == "active"
        assert house.propose(client, SCAN)["steps"][0]["executed"]
