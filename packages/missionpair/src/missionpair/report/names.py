# SPDX-License-Identifier: Apache-2.0
"""Names for people and for files; the writer of a log chose the names in it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator

from authguard_r.core.errors import shown
from missionpair.measures import MeasuredCampaign
from missionpair.records import Campaign, NamedPart
from missionpair.report.published import Live, match
from missionpair.report.table import Cell, LatexName
from missionpair.words import Access, Category

#: The paper's six rows in its order, and after them the others in ours.
CATEGORIES: dict[str, str] = {
    Category.GOAL: "Goal substitution",
    Category.CAPABILITY: "Capability escalation",
    Category.OBJECT: "Object substitution",
    Category.PROVENANCE: "Provenance confusion",
    Category.AREA: "Area expansion",
    Category.PARAMETER: "Parameter escalation",
    Category.CROSS_ROBOT: "Cross-robot reuse",
    Category.AVAILABILITY: "Availability manipulation",
    Category.REPLAY: "Replay",
    Category.APPROVAL: "Threshold-approval bypass",
}
LIVE_ROWS = tuple(CATEGORIES)[:6]
#: The paper's live experiments: the suite, trials of each row, an attacker's rounds, the defense.
LIVE, EACH, ROUNDS, BOTH = "live", 10, 3, "both"
ATTACKS = {"fixed": "Fixed template", "adaptive": "Adaptive"}
SYSTEMS = {
    "none": "No defense",
    "safety": "Safety-only pilot baseline",
    "mission": "AuthGuard-R alone",
    "both": "AuthGuard-R + safety gate",
}
#: The same in the heads of narrow columns.
SHORT = {**SYSTEMS, "safety": "Safety-only", "both": "Dual gate"}
#: What stands behind a planner, and the planners that answer what a model answered before.
SIMULATED, RECORDED, LIVE_MODEL = "simulated", "recorded", "live"
_RECORDS = frozenset({"recorded", "replay"})
#: Defenses whose refusals are the paper's "Blocked by AuthGuard-R".
GATES = ("both", "mission")


def category(name: str) -> str:
    """Return a category's name, as the paper has it where it does."""
    return CATEGORIES.get(name, printable(name))


def attack(attacker: NamedPart) -> str:
    """Return an attack method's name, as the paper has it where it does."""
    name = attack_method(attacker)
    return _marked(ATTACKS.get(name, printable(name)), simulated=attacker.simulated)


def attack_method(attacker: NamedPart) -> str:
    """Return an attacker's name; of a replay that of who wrote its texts."""
    replayed = attacker.parameters.get("attacker")
    name = replayed.get("name") if isinstance(replayed, dict) else None
    return name if isinstance(name, str) else attacker.name


def planner(named: NamedPart) -> Cell:
    """Return a planner's name: the paper's for its two models, else its own with its model."""
    found = match(named)
    if found is not None and standing(named) != RECORDED:
        return LatexName(found.name, found.tex)
    model, replayed = named.parameters.get("model"), named.parameters.get("planner")
    name = named.name
    if isinstance(model, str) and name == RECORDED:
        name = model
    elif isinstance(model, str) and model not in name:
        name = f"{name} ({model})"
    elif isinstance(replayed, dict) and isinstance(replayed.get("name"), str):
        name = f"{name} of {replayed['name']}"
    name = printable(name)
    if standing(named) == RECORDED:
        return f"{name} (recorded)"
    return _marked(name, simulated=named.simulated)


def standing(named: NamedPart) -> str:
    """Return what stands behind a planner: `SIMULATED`, `RECORDED` or `LIVE`."""
    if named.simulated:
        return SIMULATED
    return RECORDED if named.name in _RECORDS else LIVE_MODEL


def defense(campaign: Campaign, name: str) -> str:
    """Return a defense's own name, marked where it stands for something that was not run."""
    those = {named.name for named in campaign.defenses if named.simulated}
    return _marked(printable(name), simulated=name in those)


def simulated(measured: Iterable[MeasuredCampaign]) -> str:
    """Return which parts of campaigns are simulated, for the mark that a table has."""
    return ", ".join(dict.fromkeys(part for one in measured for part in _parts(one.campaign, None)))


def simulated_parts(campaign: Campaign, name: str) -> str:
    """Return which parts of a campaign are simulated under one of its defenses."""
    return ", ".join(_parts(campaign, name))


def live(measured: MeasuredCampaign, name: str) -> Live | None:
    """Return the paper's experiment that a campaign repeats; None when it repeats none.

    Args:
        measured: the campaign.
        name: the defense that is looked at.
    """
    campaign = measured.campaign
    is_live = standing(campaign.planner) == LIVE_MODEL and not campaign.attacker.simulated
    is_real = is_live and is_papers_setup(measured, name)
    found = match(campaign.planner) if is_real else None
    return found.attacks.get(campaign.attacker.name) if found is not None else None


def is_papers_setup(measured: MeasuredCampaign, name: str) -> bool:
    """True when a campaign is set up as the paper's live experiments are, and ran to its end.

    The whole suite `live` against both gates, seen from a black box, with the paper's rounds and
    one answer in each; every trial was answered. Figures of anything else answer another question
    than the paper's, and stand neither under its label nor beside its figures.

    Args:
        measured: the campaign.
        name: the defense that is looked at.
    """
    campaign = measured.campaign
    setup = (campaign.suite, campaign.access, campaign.rounds, campaign.turns, name)
    return (
        setup == (LIVE, Access.BLACK, ROUNDS, 1, BOTH)
        and campaign.pairs == len(LIVE_ROWS) * EACH
        and measured.complete
        and not any(measured.flow(defense).errors for defense in measured.defenses)
    )


def slug(*words: str) -> str:
    """Return a name for a file, made of lower-case letters, digits and hyphens alone."""
    return re.sub(r"[^a-z0-9]+", "-", " ".join(words).lower()).strip("-")[:80] or "x"


def printable(name: str) -> str:
    """Return a name out of a log as it can be shown: short, and without control characters."""
    return shown(name)[:120]


def _parts(campaign: Campaign, only: str | None) -> Iterator[str]:
    """Yield each simulated part; of the defenses all, or one."""
    defenses = (named for named in campaign.defenses if only in {None, named.name})
    for what, those in (
        ("planner", (campaign.planner,)),
        ("attacker", (campaign.attacker,)),
        ("defense", defenses),
    ):
        yield from (f"{what} {printable(named.name)}" for named in those if named.simulated)


def _marked(name: str, *, simulated: bool) -> str:
    return f"{name} (simulated)" if simulated else name
