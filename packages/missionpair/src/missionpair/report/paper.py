# SPDX-License-Identifier: Apache-2.0
"""The paper's tables, in its shapes, from what was measured; its own figures stand beside.

Source: `tab:pilot-live-llm`, `tab:pilot-adaptive-haiku`, `tab:pilot-qwen-fixed`,
`tab:pilot-qwen-adaptive`, `tab:pilot-crossmodel`, `tab:pilot-results`, `tab:pilot-category`
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from missionpair.measures import Dimension, MeasuredCampaign, Proportion, Tally
from missionpair.report.names import (
    CATEGORIES,
    GATES,
    LIVE_ROWS,
    SHORT,
    SIMULATED,
    SYSTEMS,
    attack,
    attack_method,
    category,
    is_papers_setup,
    live,
    planner,
    printable,
    simulated,
    simulated_parts,
    slug,
    standing,
)
from missionpair.report.published import Live, published
from missionpair.report.runs import DefenseRun, runs
from missionpair.report.table import Cell, Head, Row, ShareForm, Table, text
from missionpair.words import Access

SECTION = "The paper's tables"
#: The suite of `tab:pilot-results` and `tab:pilot-category`.
HAND = "hand"
_CONDITIONAL = (
    "Complied: the planner proposed what the attack asks for, and the robot could have done it, of "
    "all trials. Blocked: of those that complied, nothing unauthorized was executed."
)

_CROSS = (
    Head("planner", "Target planner"),
    Head("attacker", "Attack method"),
    Head("complied", "Planner complied", ShareForm.PERCENT),
    Head("blocked", "Blocked", ShareForm.COUNT),
)
_CROSS_PUBLISHED = (
    Head("published_complied", "Published: complied", ShareForm.PERCENT, published=True),
    Head("published_blocked", "Published: blocked", ShareForm.COUNT, published=True),
)


def paper_tables(logs: tuple[MeasuredCampaign, ...]) -> Iterator[Table]:
    """Yield every table that the paper has a shape for."""
    attacked = [run for run in runs(logs) if run.measured.tally(run.defense).n]
    chosen = [run for run in attacked if run.defense == gate_of(run.measured)]
    for run in attacked:
        yield live_table(run, main=run in chosen)
    planned = [run for run in chosen if run.measured.campaign.suite != HAND]
    if planned:
        yield crossmodel_table(planned)
    for number, measured in enumerate(logs, 1):
        yield results_table(number, measured)
        if any(measured.tally(name).n for name in measured.defenses):
            yield category_table(number, measured)


def gate_of(measured: MeasuredCampaign) -> str:
    """Return the defense that a one-line summary is of: both gates, the mission gate, the last."""
    return next((name for name in GATES if name in measured.defenses), measured.defenses[-1])


def live_table(run: DefenseRun, *, main: bool) -> Table:
    """Return compliance and blocking by category, as `tab:pilot-live-llm` has it."""
    campaign, found = run.measured.campaign, live(run.measured, run.defense)
    is_beside = is_papers_setup(run.measured, run.defense)
    beside = (
        [found] if found else _same_attack(attack_method(campaign.attacker)) if is_beside else []
    )
    rows = run.measured.by(Dimension.CATEGORY, run.defense)
    pooled = run.measured.tally(run.defense)
    gate = "AuthGuard-R" if run.defense in GATES else printable(run.defense)
    heads = [
        Head("category", "Category"),
        Head("complied", "Planner complied", foot=ShareForm.POOLED),
        Head("blocked", f"Blocked by {gate}", ShareForm.COUNT),
    ]
    for one in beside:
        heads += _published_heads(one, whole=one is found)
    names = dict.fromkeys([*LIVE_ROWS, *(name for name in CATEGORIES if name in rows), *rows])
    name = slug(found.label if found else f"live {campaign.planner.name} {campaign.attacker.name}")
    if not main:
        name += f"-{slug(run.defense)}"
    who, how = text(planner(campaign.planner), heads[0]), attack(campaign.attacker)
    return Table(
        name=name,
        title=f"{how} attacks against {who}, defense {printable(run.defense)}",
        caption=found.caption if found else "",
        label=f"tab:{name.removeprefix('tab-')}",
        heads=tuple(heads),
        rows=tuple(
            (category(row), *_live_cells(rows.get(row, Tally())), *_printed(row, beside, found))
            for row in names
        ),
        foot=((f"Pooled ({pooled.n} trials)", *_live_cells(pooled), *_pooled(beside, found)),),
        notes=(_CONDITIONAL, "A pair that changes several things stands in the row of the first."),
        simulated=simulated([run.measured]),
        front=main,
        section=SECTION,
    )


def crossmodel_table(chosen: list[DefenseRun]) -> Table:
    """Return one row for each planner and attack, and their sums: `tab:pilot-crossmodel`.

    What models answered now, what they answered before, and what stands for something that was not
    run are summed apart. The paper's label and caption stand over its own experiments alone.
    """
    known = [live(run.measured, run.defense) for run in chosen]
    beside = any(known)
    rows: list[Row] = []
    sums: dict[str, tuple[Proportion, Proportion, list[Live]]] = {}
    for run, found in zip(chosen, known, strict=True):
        tally = run.measured.tally(run.defense)
        named = run.measured.campaign.planner
        parts = simulated_parts(run.measured.campaign, run.defense)
        kind = SIMULATED if parts else standing(named)
        total, blocked, those = sums.get(kind, (Proportion(0, 0), Proportion(0, 0), []))
        those = [*those, found] if found else those
        sums[kind] = (total + tally.compliance, blocked + tally.blocking, those)
        printed = _summed([found] if found else []) if beside else ()
        rows.append((planner(named), _attack(run), tally.compliance, tally.blocking, *printed))
    foot = tuple(
        (f"All {kind} trials", None, total, blocked, *(_summed(those) if beside else ()))
        for kind, (total, blocked, those) in sums.items()
    )
    told = published().crossmodel
    is_papers = all(known)
    under = ", ".join(f"log {run.number} {printable(run.defense)}" for run in chosen)
    return Table(
        name=slug(told.label) if is_papers else "crossmodel",
        title="Cross-model summary",
        caption=told.caption if is_papers else "",
        label=told.label if is_papers else "tab:crossmodel",
        heads=_CROSS + (_CROSS_PUBLISHED if beside else ()),
        rows=tuple(rows),
        foot=foot,
        notes=(_CONDITIONAL, f"Defense: {under}.", "Published sums are of the rows shown."),
        simulated=simulated(run.measured for run in chosen),
        front=True,
        section=SECTION,
    )


def is_papers_suite(measured: MeasuredCampaign) -> bool:
    """True when a campaign is the paper's own suite, whole: each of its attacks was run."""
    campaign = measured.campaign
    wanted = {
        row: max(n for _, n in those.values()) for row, those in published().category.rows.items()
    }
    return (
        campaign.suite == HAND
        and measured.complete
        and not campaign.skipped
        and all(
            measured.by(Dimension.CATEGORY, defense).get(row, Tally()).n >= attempts
            for defense in measured.defenses
            for row, attempts in wanted.items()
        )
    )


def results_table(number: int, measured: MeasuredCampaign) -> Table:
    """Return UASR, SCMHR, BTCR, FRR and SU for each defense: `tab:pilot-results`."""
    hand = is_papers_suite(measured)
    told = published().results
    names = ("uasr", "scmhr", "btcr", "frr", "su")
    arrows = ("downarrow", "downarrow", "uparrow", "downarrow", "uparrow")
    heads = [Head("system", "System")]
    heads += [
        Head(name, name.upper(), tex=f"{name.upper()} $\\{arrow}$")
        for name, arrow in zip(names, arrows, strict=True)
    ]
    if hand:
        heads += [
            Head(f"published_{name}", f"Published: {name.upper()}", published=True)
            for name in names
        ]
    rows = []
    for defense in measured.defenses:
        scores, known = measured.scores(defense), told.of(defense)
        row: list[Cell] = [SYSTEMS.get(defense, printable(defense))]
        row += [getattr(scores, name) for name in names]
        if hand:
            row += [known.get(name) for name in names]
        rows.append(tuple(row))
    return Table(
        name=slug(told.label) if hand else f"results-{number}",
        title=f"Security and utility, log {number}",
        caption=told.caption if hand else "",
        label=told.label if hand else f"tab:results-{number}",
        heads=tuple(heads),
        rows=tuple(rows),
        notes=(
            "UASR, SCMHR: of attack trials. BTCR, FRR: of benign runs. SU: of UASR and BTCR.",
            "Counts and intervals are in the table of rates.",
        ),
        simulated=simulated([measured]),
        front=hand or len(measured.defenses) > 1,
        section=SECTION,
    )


def _defense_head(name: str, heads: Sequence[Head]) -> Head:
    """Return the column of a defense; of two that look alike in a log, the later has a number."""
    key, title = slug(name), SHORT.get(name, printable(name))
    taken = {head.key for head in heads} | {head.name for head in heads}
    number = 2
    while {key, title} & taken:
        key, title = f"{slug(name)}-{number}", f"{printable(name)} ({number})"
        number += 1
    return Head(key, title, ShareForm.COUNT)


def category_table(number: int, measured: MeasuredCampaign) -> Table:
    """Return unauthorized executions over attempts by category: `tab:pilot-category`."""
    hand = is_papers_suite(measured)
    told = published().category
    by = {name: measured.by(Dimension.CATEGORY, name) for name in measured.defenses}
    found = dict.fromkeys(row for rows in by.values() for row in rows)
    order = [*(told.rows if hand else ()), *CATEGORIES, *found]
    beside = [name for name in measured.defenses if hand and name in told.rows["goal"]]
    heads = [Head("category", "Category")]
    for name in measured.defenses:
        heads.append(_defense_head(name, heads))
    heads += [
        Head(
            f"published_{slug(name)}", f"Published: {SHORT[name]}", ShareForm.COUNT, published=True
        )
        for name in beside
    ]
    return Table(
        name=slug(told.label) if hand else f"categories-{number}",
        title=f"Unauthorized executions over attempts, log {number}",
        caption=told.caption if hand else "",
        label=told.label if hand else f"tab:categories-{number}",
        heads=tuple(heads),
        rows=tuple(
            (
                category(row),
                *(by[name].get(row, Tally()).uasr for name in measured.defenses),
                *(told.of(row, name) for name in beside),
            )
            for row in dict.fromkeys(order)
            if row in found
        ),
        simulated=simulated([measured]),
        section=SECTION,
    )


def _summed(found: list[Live]) -> tuple[Proportion, Proportion]:
    """Return what the paper's tables add up to: complied, and blocked of those."""
    complied, trials, blocked = (sum(one.pooled[n] for one in found) for n in range(3))
    return Proportion(complied, trials), Proportion(blocked, complied)


def _live_cells(tally: Tally) -> tuple[Proportion, Proportion]:
    return (tally.compliance, tally.blocking)


def _same_attack(attacker: str) -> list[Live]:
    """Return the paper's experiments with the same attack, for a planner that it has not."""
    return [t.attacks[attacker] for t in published().planners if attacker in t.attacks]


def _published_heads(one: Live, *, whole: bool) -> list[Head]:
    owner = next(t for t in published().planners if one in t.attacks.values())
    if not whole:
        key, name = f"published_{owner.known_by}", f"Published: {owner.name}"
        tex = f"Published: {owner.tex}"
        return [Head(key, name, foot=ShareForm.POOLED, tex=tex, published=True)]
    return [
        Head("published_complied", "Published: complied", foot=ShareForm.POOLED, published=True),
        Head("published_blocked", "Published: blocked", ShareForm.COUNT, published=True),
    ]


def _printed(row: str, beside: list[Live], found: Live | None) -> Iterator[Proportion | None]:
    for one in beside:
        yield one.compliance(row)
        if one is found:
            yield one.blocking(row)


def _pooled(beside: list[Live], found: Live | None) -> Iterator[Proportion]:
    for one in beside:
        complied, trials, blocked = one.pooled
        yield Proportion(complied, trials)
        if one is found:
            yield Proportion(blocked, complied)


def _attack(run: DefenseRun) -> str:
    campaign = run.measured.campaign
    how = attack(campaign.attacker)
    return how if campaign.access == Access.BLACK else f"{how}, {campaign.access} box"
