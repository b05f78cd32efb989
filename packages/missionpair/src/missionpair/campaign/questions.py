# SPDX-License-Identifier: Apache-2.0
"""What a campaign of a suite's own texts asks a planner, for those who ask a model of their own.

How-to: docs/howto/missionpair-models.md#recorded
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from msgspec import Struct

from missionpair import attackers, defenses, registry, suites
from missionpair.briefing import Briefing, OfferedTool, Reply
from missionpair.campaign.setting import Setting
from missionpair.campaign.trial import PairRun
from missionpair.score import DEFAULT
from missionpair.stage import Yard
from missionpair.words import Access, TrialKind


class PlannerQuestion(Struct, frozen=True, kw_only=True):
    """One question; a log of answers names its `pair`, `kind`, `round` and `inputs` again.

    Args:
        pair: the pair's id.
        kind: of the trial.
        round: from 0; an attack's text grows stronger from round to round.
        inputs: what reached the robot, channel and text.
        rules: how a planner is to work.
        task: the operator's sentence.
        situation: where the robot is and what it holds.
        places: spellings of places that a plan may name.
        things: spellings of things that it may name.
        tools: what it may call, with the JSON schema of the arguments.
    """

    pair: str
    kind: str
    round: int
    inputs: tuple[tuple[str, str], ...]
    rules: str
    task: str
    situation: str
    places: tuple[str, ...]
    things: tuple[str, ...]
    tools: tuple[OfferedTool, ...]


class _AskedPlanner:
    """A planner that does nothing, and keeps what it was asked."""

    name, simulated = "asked", True

    def __init__(self) -> None:
        self.parameters: dict[str, Any] = {}
        self.questions: list[PlannerQuestion] = []

    def propose(self, briefing: Briefing, *, seed: int) -> Reply:  # noqa: ARG002 - no dice
        pair, kind, number = briefing.trial or ("", "", 0)
        self.questions.append(
            PlannerQuestion(
                pair=pair,
                kind=kind,
                round=number,
                inputs=tuple((str(item.channel), item.text) for item in briefing.inputs),
                rules=briefing.rules,
                task=briefing.task,
                situation=briefing.situation,
                places=briefing.places,
                things=briefing.things,
                tools=briefing.tools,
            )
        )
        return Reply(raw=b'{"plan": []}')


def questions(
    suite: str, kinds: tuple[TrialKind, ...], *, rounds: int
) -> Iterator[PlannerQuestion]:
    """Yield every question of a campaign with the attacker `fixed` and one answer a round.

    Args:
        suite: its name, or the path of its file.
        kinds: of trial.
        rounds: tries of each attack.

    Raises:
        SuiteError: no such suite, or a broken one.
    """
    found, _ = suites.load(suite)
    planner = _AskedPlanner()
    setting = Setting(
        planner=planner,
        attacker=registry.make(attackers, "fixed"),
        access=Access.BLACK,
        defenses=(registry.make(defenses, "none"),),
        rounds=rounds,
        turns=1,
        seed=0,
        seeds=1,
        kinds=kinds,
        weights=DEFAULT,
    )
    with Yard() as yard:
        for pair in found.pairs:
            for _ in PairRun(setting, yard, pair, found.layouts[pair.layout], first=0).trials():
                yield from planner.questions
                planner.questions.clear()
