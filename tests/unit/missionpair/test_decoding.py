# SPDX-License-Identifier: Apache-2.0
"""A model is held to the form of a plan and to no content: every plan of a suite can be written.

How-to: docs/howto/missionpair-models.md#answers
"""

from __future__ import annotations

import json
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from jsonschema.exceptions import ValidationError

from fixtures.suites import loaded
from missionpair import attackers, defenses, planners
from missionpair.briefing import Briefing
from missionpair.campaign.setting import Setting
from missionpair.campaign.showing import briefing_of
from missionpair.campaign.trial import PairRun
from missionpair.pair import Pair, Scenario, plan_bytes
from missionpair.planners._examples import EXAMPLES, examples
from missionpair.planners._schema import plan_schema
from missionpair.registry import OptionError, make
from missionpair.score import DEFAULT
from missionpair.servers import SERVERS
from missionpair.stage import Stage, Yard
from missionpair.suites import load
from missionpair.words import Access, TrialKind

LIVE, _ = load("live")


def staged(yard: Yard, pair: Pair, scenario: Scenario) -> Stage:
    return yard.stage(pair, LIVE.layouts[pair.layout], scenario)


def shown(stage: Stage) -> Briefing:
    return briefing_of(stage, turns=(), usual=())


@pytest.mark.parametrize("number", range(0, 60, 6))
def test_a_model_can_write_the_task_and_the_attack_and_nothing_but_a_plan(
    yard: Yard, number: int
) -> None:
    pair = LIVE.pairs[number]
    tools = shown(staged(yard, pair, pair.attack)).tools
    whole = Draft202012Validator(plan_schema(tools))
    one = Draft202012Validator(plan_schema(tools, most=1))
    for scenario in (pair.benign, pair.attack):
        plan = json.loads(plan_bytes(scenario.plan))
        whole.validate(plan)
        for step in plan["plan"]:
            one.validate({"plan": [step]})
    whole.validate({"plan": []})
    step = plan["plan"][0]
    for wrong in (
        {},
        {"plan": [step], "note": "and more"},
        {"plan": [{**step, "tool": "read_sign"}]},
        {"plan": [{"tool": "navigate_to", "arguments": {"destination": "Nowhere"}}]},
        {"plan": [{"tool": "navigate_to", "arguments": {}}]},
        {"plan": [{"tool": "scan", "arguments": {"reason": "x" * 81}}]},
    ):
        with pytest.raises(ValidationError):
            whole.validate(wrong)
    with pytest.raises(ValidationError):
        one.validate({"plan": [step, step]})


def propose(mode: str, **options: str) -> Any:
    with SERVERS["openai"]("resistant") as server:
        given = {"model": "scripted-x", "base_url": server.base_url, "mode": mode, **options}
        spec = "openai:" + ",".join(f"{name}={value}" for name, value in given.items())
        pair = LIVE.pairs[0]
        with Yard() as yard:
            briefing = shown(staged(yard, pair, pair.benign))
        planner = planners.make(spec)
        planner.propose(briefing, seed=1)
        (body,) = [json.loads(body) for *_, body in server.seen]
    return body, briefing, planner


@pytest.mark.parametrize(("mode", "most"), [("json", None), ("step", 1)])
def test_the_schema_is_asked_of_the_server_and_published(mode: str, most: int | None) -> None:
    body, briefing, planner = propose(mode, decoding="schema")
    form = body["response_format"]
    assert form["type"] == "json_schema"
    assert form["json_schema"]["schema"] == plan_schema(briefing.tools, most=most)
    assert (planner.parameters["decoding"], planner.parameters["mode"]) == ("schema", mode)
    body, _, planner = propose(mode)
    assert "response_format" not in body
    assert planner.parameters["decoding"] == "free"


@pytest.mark.parametrize(
    ("spec", "says"),
    [
        ("openai:model=m,base_url=http://127.0.0.1:9,decoding=schema", "a schema needs"),
        ("anthropic:model=m,base_url=http://127.0.0.1:9,mode=json,decoding=schema", "needs"),
        ("openai:model=m,base_url=http://127.0.0.1:9,mode=json,decoding=gbnf", "`free` or"),
    ],
)
def test_a_schema_where_none_can_be_held_to_is_refused(spec: str, says: str) -> None:
    with pytest.raises(OptionError, match=says):
        make(planners, spec)


# what a model is told


def test_examples_are_of_another_building_and_in_the_tools_that_are_offered(yard: Yard) -> None:
    suite, _ = loaded("live")
    briefing = shown(staged(yard, suite.pairs[0], suite.pairs[0].benign))
    text = "".join(examples(briefing.tools, one_by_one=False))
    assert text.count("Example:") == len(EXAMPLES)
    assert not [name for name in (*briefing.places, *briefing.things) if f'"{name}"' in text]
    without = tuple(tool for tool in briefing.tools if tool.name != "put_down")
    assert not list(examples(without, one_by_one=True))


def test_a_planner_is_told_the_way_back_where_its_mission_ends_at_home(yard: Yard) -> None:
    """Without it the mission could not be done: nothing else says that it ends there."""
    told = 0
    for pair in LIVE.pairs:
        goes_back = pair.benign.plan[-1].tool == "navigate_to"
        task = shown(staged(yard, pair, pair.benign)).task
        assert task.endswith(", then return to Charging Dock.") == goes_back
        assert task.removesuffix(", then return to Charging Dock.") == (
            pair.task.removesuffix(".") if goes_back else pair.task
        )
        told += goes_back
    assert 0 < told < len(LIVE.pairs)


def asked(yard: Yard, temperature: str) -> int:
    """Return how often a model is asked in the control arm of three rounds, two defenses."""
    pair = LIVE.pairs[0]
    with SERVERS["openai"]("resistant") as server:
        where = f"model=scripted-x,base_url={server.base_url},temperature={temperature}"
        setting = Setting(
            planner=planners.make(f"openai:{where}"),
            attacker=attackers.make("fixed"),
            access=Access.BLACK,
            defenses=tuple(defenses.make(name) for name in ("none", "both")),
            rounds=3,
            turns=1,
            seed=0,
            seeds=1,
            kinds=(TrialKind.CONTROL,),
            weights=DEFAULT,
        )
        run = PairRun(setting, yard, pair, LIVE.layouts[pair.layout], first=0)
        assert [len(trial.rounds) for trial in run.trials()] == [3, 3]
        return len(server.seen)


def test_a_model_without_dice_is_asked_the_same_question_once(yard: Yard) -> None:
    assert (asked(yard, "0"), asked(yard, "1")) == (1, 3)
