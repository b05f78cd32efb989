# SPDX-License-Identifier: Apache-2.0
"""A proposal asks for effects in one order, whatever comes in between; it does none of them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import msgspec
import pytest

from authguard_r.core.encoding import Tag, digest
from authguard_r.core.errors import AuthGuardError, MalformedError
from authguard_r.core.mission import OnRefusal
from authguard_r.enforcement.leases import Running
from authguard_r.normalize import Binder, Plan, read_plan
from authguard_r.server.proposal import (
    AwaitNotes,
    AwaitState,
    CountDecision,
    CountOutcome,
    Decide,
    Effects,
    Forget,
    NextTurn,
    Proposal,
    ProposalStage,
    RefusePlan,
    SendAnswer,
    StopRobot,
    TellDecision,
    TellResult,
    WatchAction,
)
from authguard_r.server.proposals import CommitRecorder
from authguard_r.wire.disclosure import Disclosure
from authguard_r.wire.messages import ClientRole, Propose, Result
from fixtures import scenarios
from unit.server.demo_site import FORBIDDEN, GO, SCAN, DemoGate, Guest


class Way:
    """One proposal of a real client of a real gate; the test carries its effects out."""

    def __init__(
        self, house: DemoGate, planner: Guest, data: bytes, *, shadow: bool = False
    ) -> None:
        self.house = house
        self.data = data
        self.client = house.client(planner)
        self.recorder: CommitRecorder | None = None
        asked = Propose(key="k", plan=data)
        self.proposal = Proposal(
            self.client,
            7,
            asked,
            digest(Tag.RAW, data),
            disclosure=Disclosure.FULL,
            shadow=shadow,
        )

    def plan(self) -> Plan:
        return read_plan(self.data, binder=Binder(self.house.site, self.house.binding))

    def decide(self, effects: Effects) -> Any:
        """Decide the one step that the effects ask for, as `Plans` does."""
        (effect,) = effects
        assert isinstance(effect, Decide)
        plans = self.house.service._dispatcher._plans
        self.recorder = CommitRecorder(self.client.name, "k", effect.before)
        return self.house.do(
            lambda: self.house.gate.enforcer.submit(
                effect.step,
                planner=self.client.name,
                evidence=self.proposal.evidence,
                context=plans.contexts.of(self.client),
                on_commit=self.recorder,
            )
        )

    def ended(self, running: Running) -> Any:
        """Let a running step come to its end."""
        reports: list[Any] = []
        self.house.service.leases.add(self.client.name, running, reports.append, gone=lambda: False)
        while not reports:
            self.house.advance(200)
        return reports[0]


def kinds(effects: Effects) -> list[type]:
    return [type(effect) for effect in effects]


@pytest.fixture
def house() -> Iterator[DemoGate]:
    with DemoGate(mission=scenarios.mission()) as made:
        made.activate()
        yield made


def test_a_step_is_awaited_decided_watched_and_counted_in_this_order(house: DemoGate) -> None:
    way = Way(house, house.enter(ClientRole.PLANNER), GO + b"\n" + FORBIDDEN)
    proposal = way.proposal
    assert proposal.stage is ProposalStage.READING
    assert kinds(proposal.read(way.plan())) == [AwaitState]
    assert proposal.stage is ProposalStage.WAITING
    running = way.decide(proposal.due())
    assert proposal.stage is ProposalStage.DECIDING
    assert way.recorder is not None
    assert kinds(proposal.begun(running, way.recorder)) == [
        WatchAction,
        TellDecision,
        CountDecision,
    ]
    assert proposal.stage is ProposalStage.RUNNING
    assert kinds(proposal.ended(way.recorder, way.ended(running))) == [CountOutcome, NextTurn]
    assert kinds(proposal.turn()) == [AwaitState]
    refused = way.decide(proposal.due())
    effects = proposal.begun(refused, way.recorder)
    assert kinds(effects) == [Forget, SendAnswer, CountDecision]  # the planner waits, counts do not
    assert proposal.stage is ProposalStage.OVER
    answer = effects[1].answer  # type: ignore[union-attr]
    assert (len(answer.steps), answer.planned, answer.on_refusal) == (2, 2, "hold")


def test_a_plan_that_cannot_be_read_is_recorded_before_it_is_answered(house: DemoGate) -> None:
    way = Way(house, house.enter(ClientRole.PLANNER), b"no plan")
    error: AuthGuardError = MalformedError("no plan", where="input")
    (effect,) = way.proposal.read(error)
    assert isinstance(effect, RefusePlan)
    report = house.gate.enforcer.refuse_plan(effect.error, planner=way.client.name)
    assert kinds(way.proposal.refused(report)) == [Forget, SendAnswer, CountDecision]


def test_a_planner_that_hung_up_begins_nothing_and_its_key_is_free(house: DemoGate) -> None:
    planner = house.enter(ClientRole.PLANNER)
    way = Way(house, planner, GO)
    planner.line.close()
    house.settle()
    assert kinds(way.proposal.read(way.plan())) == [Forget]
    assert way.proposal.stage is ProposalStage.OVER


def test_a_planner_that_hung_up_between_two_steps_still_has_its_answer_kept(
    house: DemoGate,
) -> None:
    planner = house.enter(ClientRole.PLANNER)
    way = Way(house, planner, GO + b"\n" + SCAN)
    way.proposal.read(way.plan())
    running = way.decide(way.proposal.due())
    assert way.recorder is not None
    way.proposal.begun(running, way.recorder)
    report = way.ended(running)
    assert kinds(way.proposal.ended(way.recorder, report)) == [CountOutcome, NextTurn]
    planner.line.close()
    house.settle()
    effects = way.proposal.turn()
    assert kinds(effects) == [Forget, SendAnswer]
    assert len(effects[1].answer.steps) == 1  # type: ignore[union-attr]


def test_a_result_is_told_before_the_answer_that_waits_for_it(house: DemoGate) -> None:
    way = Way(house, house.enter(ClientRole.PLANNER), GO)
    way.proposal.read(way.plan())
    running = way.decide(way.proposal.due())
    assert way.recorder is not None
    way.proposal.begun(running, way.recorder)
    way.proposal.noting()
    report = way.ended(running)
    effects = way.proposal.ended(way.recorder, report)
    assert kinds(effects) == [CountOutcome, AwaitNotes]
    assert kinds(way.proposal.go_on(report)) == [AwaitNotes]
    result = Result(ticket=running.lease.ticket, content="a sign", texts=("a sign",))
    assert kinds(way.proposal.noted(result)) == [TellResult]
    assert kinds(way.proposal.go_on(report)) == [Forget, SendAnswer]


def test_the_robot_is_stopped_before_the_answer_where_the_mission_says_so() -> None:
    mission = msgspec.structs.replace(scenarios.mission(), on_refusal=OnRefusal.STOP)
    with DemoGate(mission=mission) as house:
        house.activate()
        way = Way(house, house.enter(ClientRole.PLANNER), FORBIDDEN)
        way.proposal.read(way.plan())
        refused = way.decide(way.proposal.due())
        assert way.recorder is not None
        effects = way.proposal.begun(refused, way.recorder)
        assert kinds(effects) == [Forget, StopRobot, SendAnswer, CountDecision]


def test_a_shadow_run_judges_every_step_whatever_became_of_the_one_before(house: DemoGate) -> None:
    way = Way(house, house.enter(ClientRole.PLANNER), FORBIDDEN + b"\n" + GO, shadow=True)
    way.proposal.read(way.plan())
    refused = way.decide(way.proposal.due())
    assert way.recorder is not None
    assert kinds(way.proposal.begun(refused, way.recorder)) == [NextTurn, CountDecision]


def test_a_planner_that_hung_up_while_its_step_waited_begins_nothing(house: DemoGate) -> None:
    planner = house.enter(ClientRole.PLANNER)
    way = Way(house, planner, GO)
    assert kinds(way.proposal.read(way.plan())) == [AwaitState]
    planner.line.close()
    house.settle()
    assert kinds(way.proposal.due()) == [Forget]
