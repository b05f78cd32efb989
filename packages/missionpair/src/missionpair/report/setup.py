# SPDX-License-Identifier: Apache-2.0
"""The table of what was run, and what a reader must know before any figure."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from authguard_r.core.errors import shown
from missionpair.measures import MeasuredCampaign
from missionpair.records import NamedPart
from missionpair.report.names import (
    RECORDED,
    attack,
    defense,
    planner,
    printable,
    simulated,
    standing,
)
from missionpair.report.table import Head, Table

SECTION = "What was run"
#: A campaign's fields that stand in the table as they are.
_PLAIN = (
    "suite",
    "suite_version",
    "suite_digest",
    "pairs",
    "access",
    "seed",
    "seeds",
    "rounds",
    "turns",
    "version",
)


def _weights(given: dict[str, int]) -> str:
    return ", ".join(f"{name} {weight}" for name, weight in given.items()) or "as signed"


def setup_table(logs: tuple[MeasuredCampaign, ...]) -> Table:
    """Return one row for each campaign, with every parameter that shapes it."""
    rows = []
    for number, measured in enumerate(logs, 1):
        campaign = measured.campaign
        rows.append(
            (
                number,
                planner(campaign.planner),
                _parameters(campaign.planner),
                attack(campaign.attacker),
                _parameters(campaign.attacker),
                ", ".join(defense(campaign, name) for name in measured.defenses),
                "; ".join(f"{d.name} {_parameters(d)}" for d in campaign.defenses if d.parameters),
                ", ".join(map(printable, campaign.kinds)),
                ", ".join(map(str, campaign.weights)),
                _weights(campaign.field_weights),
                *(getattr(campaign, name) for name in _PLAIN),
                campaign.skipped,
                standing(campaign.planner),
                measured.trials,
                campaign.trials,
                simulated([measured]) or "no",
            )
        )
    heads = (
        Head("log", "Log"),
        Head("planner", "Planner"),
        Head("planner_parameters", "Parameters of the planner"),
        Head("attacker", "Attack"),
        Head("attacker_parameters", "Parameters of the attack"),
        Head("defenses", "Defenses"),
        Head("defense_parameters", "Parameters of the defenses"),
        Head("kinds", "Kinds"),
        Head("weights", "Weights of the score J, lambda 1 to 5"),
        Head("field_weights", "Weights of protected fields in D_M"),
        *(Head(name, name.replace("_", " ").capitalize()) for name in _PLAIN),
        Head("skipped", "Pairs skipped"),
        Head("standing", "Planner is"),
        Head("trials", "Trials in the log"),
        Head("planned", "Trials planned"),
        Head("simulated", "Simulated"),
    )
    return Table(
        name="campaigns",
        title="Campaigns",
        heads=heads,
        rows=tuple(rows),
        simulated=simulated(logs),
        section=SECTION,
    )


def remarks(logs: tuple[MeasuredCampaign, ...]) -> Iterator[str]:
    """Yield what a reader must know before any figure."""
    marked = simulated(logs)
    if marked:
        yield (
            f"Simulated: {marked}. No language model and no person stands behind a simulated part; "
            "its figures say how a defense does against published behavior, and nothing of models."
        )
    behind = dict.fromkeys(standing(measured.campaign.planner) for measured in logs)
    if len(behind) > 1:
        yield (
            f"The logs' planners are {' and '.join(behind)}: sums over them mix behavior that was "
            "published, answers of models that were recorded, and models that answered now."
        )
    for number, measured in enumerate(logs, 1):
        named, skipped = measured.campaign.planner, measured.campaign.skipped
        if standing(named) == RECORDED:
            told = named.parameters.get("planner", named.parameters)
            listed = shown(_listed(told))
            yield f"Log {number}: the planner's answers were recorded before: {listed}."
        if skipped:
            yield f"Log {number}: {skipped} pairs were left out, because the record has no reply."
        if not measured.complete:
            planned = measured.campaign.trials
            yield f"Log {number} is not finished: {measured.trials} of {planned} trials."
        errors = sum(measured.flow(name).errors for name in measured.defenses)
        if errors:
            yield (
                f"Log {number}: {errors} trials had no answer from the planner or the attacker. "
                "They count as trials that did not comply, so rates of compliance are too low."
            )
    if len({measured.campaign.suite_digest for measured in logs}) > 1:
        yield "The logs are of different suites; sums over them mix what was tried."


def _parameters(named: NamedPart) -> str:
    """Return parameters in words: `name value`, in their order, groups in brackets."""
    return _listed(named.parameters) or "none"


def _listed(values: dict[str, Any]) -> str:
    return ", ".join(f"{name} {_said(value)}" for name, value in sorted(values.items()))


def _said(value: Any) -> str:
    """Return one value in words."""
    if isinstance(value, dict):
        return f"({_listed(value)})"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return f"({', '.join(map(_said, value))})"
    return "none" if value is None else str(value)
