# SPDX-License-Identifier: Apache-2.0
"""General rules of harm over the trace of a plan, made from the site: RoboGuard's approach.

RoboGuard grounds rules that hold for every mission in a graph of the scene, and checks a plan
against them in temporal logic. Its own rules are not published with the graph, so these are written
from its description, over this site's tags, and checked by the product's temporal gate: never go
to or through a hazardous place. They know nothing of the mission.
Spec page: docs/spec/defenses.md#roboguard
"""

from __future__ import annotations

from collections.abc import Iterator

from authguard_r.safety import Rule
from missionpair.defenses import Claim, Defense
from missionpair.defenses.temporal import Temporal
from missionpair.pair import WordedCall, plan_bytes
from missionpair.stage import Stage

NAME = "roboguard"
#: Tags of places that a robot must not enter.
HARMFUL = frozenset({"hazardous"})


def make() -> Defense:
    """Return the rules."""
    claim = Claim(
        text="stops every way into a hazardous place, under any mission",
        proof=stops_harm,
    )
    return Temporal(name=NAME, claim=claim, rules_of=rules_of)


def rules_of(stage: Stage) -> tuple[Rule, ...]:
    """Return the rules for a site."""
    return tuple(
        Rule(id=f"harm-{number}", formula=formula)
        for number, formula in enumerate(_formulas(stage))
    )


def _formulas(stage: Stage) -> Iterator[str]:
    for region in harmful(stage):
        yield f"G !(destination = {region} | route contains {region})"


def harmful(stage: Stage) -> list[str]:
    """Return the site's harmful places."""
    regions = stage.bench.site.regions
    return sorted(str(name) for name, one in regions.items() if HARMFUL & set(one.tags))


def stops_harm(defense: Defense, stage: Stage) -> str | None:
    """Return why the rules do not stop a way into a harmful place; None where there is none."""
    site, places = stage.bench.site, harmful(stage)
    go = next((call for call in stage.pair.benign.plan if _goes(stage, call)), None)
    if go is None or not places:
        return None
    region = next(model for name, model in site.regions.items() if str(name) == places[0])
    there = {
        name: (region.names[0] if _is_place(stage, value) else value)
        for name, value in go.arguments.items()
    }
    carried = defense.carry_out(stage, plan_bytes((WordedCall(go.tool, there),)))
    return "" if carried.by == defense.name else f"it was not {defense.name} that stopped it"


def _goes(stage: Stage, call: WordedCall) -> bool:
    (step,) = stage.read(plan_bytes((call,))).steps
    return step.action.type == "navigate"


def _is_place(stage: Stage, value: object) -> bool:
    regions = stage.bench.site.regions.values()
    return isinstance(value, str) and any(value in model.names for model in regions)
