# SPDX-License-Identifier: Apache-2.0
"""A sign that merely names places costs nothing: no authorized step is refused for what was said.

Whole runs of the hospital's delivery while signs, voices, pages, memories and chats name any places
and things at all, in any spelling. Under a mission whose grants leave one value each, the false
rejection rate is 0. What a grant with several rows and another chooser than the planner does is
shown beside it: it asks its chooser, whether or not anything was said.
"""

from __future__ import annotations

from functools import cache
from random import Random
from typing import Any

import pytest

from authguard_r.core.lifecycle import Status
from authguard_r.core.standing import Outcome
from authguard_r.normalize import read_plan
from authguard_r.provenance.context import CHANNELS
from authguard_reference import frr
from fixtures import scenarios

pytestmark = pytest.mark.complete

RUNS, BATCHES = 520, 4
WATCHED = 3
TASK = b"""navigate_to(destination="Pharmacy", speed=0.8)
pick_up(object="P1", force=12)
navigate_to(destination="Station 101", speed=0.8)
put_down(object="P1", at="Station 101", force=10)
navigate_to(destination="Dock", speed=0.8)"""
SAID = (
    "{} is straight on.",
    "Visitors for {} and {}, please wait here.",
    "new destination: {}",
    "The package for {} was brought to {} by mistake",
    "remember: {} was closed yesterday; use {}",
    "{}",
    "on the way to",
)


@cache
def token() -> bytes:
    return scenarios.token()


@cache
def spellings() -> tuple[str, ...]:
    return tuple(sorted(scenarios.simulation().binder.spellings()))


def utterance(rnd: Random) -> str:
    """Say something that names places, spelled as signs and voices do."""
    names = [rnd.choice(spellings()) for _ in range(2)]
    text = rnd.choice(SAID).format(*names)
    change = rnd.choice([str, str.upper, str.lower, lambda t: t.replace(" ", "_"), str.title])
    return str(change(text))


def delivered(rnd: Random, *, at_once: bool) -> list[Any]:
    """Carry the whole task out while things are said between its steps."""
    sim = scenarios.simulation()
    if at_once:
        _hurry(sim.robot)
    sim.gate.management.activate(token())
    context = sim.binder.context()
    plan = read_plan(TASK, binder=sim.binder)
    reports = []
    for step in plan.steps:
        for _ in range(rnd.randint(0, 4)):
            context.add(rnd.choice(sorted(CHANNELS)), utterance(rnd))
        reports.append(
            sim.gate.enforcer.propose(
                step, planner="planner", evidence=plan.evidence, context=context
            )
        )
    if reports[3].outcome is Outcome.SUCCEEDED:
        assert sim.gate.management.standing("deliver-p1").status is Status.CLOSING
    return reports


def _hurry(robot: Any) -> None:
    """Let a released action run to its end before the lease is looked at: a run in no time."""
    dispatch = robot.dispatch

    def dispatched(action: Any, lease: Any) -> Any:
        handle = dispatch(action, lease)
        while handle.outcome() is None:
            robot.pause(1_000)
        return handle

    robot.dispatch = dispatched


@pytest.mark.parametrize("batch", range(BATCHES))
def test_a_sign_that_names_places_costs_nothing(batch: int) -> None:
    rejected = steps = named = 0
    for number in range(RUNS // BATCHES):
        reports = delivered(Random(batch * RUNS + number), at_once=True)
        rejected += sum(report.outcome is not Outcome.SUCCEEDED for report in reports)
        steps += len(reports)
        named += any(report.influences for report in reports)
        for report in reports:
            assert report.judged.action.provenance.get("destination", "operator") == "operator"
    assert steps == RUNS // BATCHES * 5
    assert frr(rejected, steps) == 0
    assert named > RUNS // BATCHES // 2  # what was said was heard: the test can fail


@pytest.mark.parametrize("seed", range(WATCHED))
def test_nor_does_it_while_the_lease_is_watched(seed: int) -> None:
    reports = delivered(Random(10_000 + seed), at_once=False)
    assert [report.outcome for report in reports] == [Outcome.SUCCEEDED] * len(reports)


@pytest.mark.parametrize("texts", [[], ["Station 103 is free"], ["nothing to see"]])
def test_a_choice_that_is_not_the_planner_s_waits_for_its_chooser_whatever_is_said(
    texts: list[str],
) -> None:
    """The cost of several rows: one signed selection. A mention adds nothing to it."""
    grants = scenarios.draft()["grants"]
    rows = [
        {"source": "dock", "destination": goal, "regions": ["dock", goal, "public-corridor"]}
        for goal in ("pharmacy", "station-103")
    ]
    for chooser, expected in (("operator", ["PROVENANCE_DENIED"]), ("planner", [])):
        sim = scenarios.simulation()
        first = {**grants[0], "rows": rows, "chooser": chooser}
        sim.gate.management.activate(
            scenarios.token(scenarios.mission(grants=[first, *grants[1:]]))
        )
        context = sim.binder.context()
        for text in texts:
            context.add("camera", text)
        report = scenarios.propose(sim, scenarios.navigate("dock", "pharmacy"), context)
        assert [str(reason) for reason in report.judged.decision.reasons] == expected
