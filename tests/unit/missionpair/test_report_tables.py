# SPDX-License-Identifier: Apache-2.0
"""The report's tables: the paper's shapes to the letter, its figures beside, stand-ins marked.

Source: `tab:pilot-live-llm` to `tab:pilot-crossmodel`, `tab:pilot-results`, `tab:pilot-category`
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import pytest
from msgspec.structs import replace

from fixtures.campaign_records import (
    ADAPTIVE,
    FIXED,
    GRADED,
    HAIKU,
    KEPT,
    PAPER,
    QWEN,
    REACHED,
    benign,
    blocked,
    campaign,
    files_of,
    hijacked,
    kept,
    live,
    numbered,
    the_papers,
)
from fixtures.cases import case
from missionpair.measures import MeasuredCampaign, Proportion, measure
from missionpair.records import NamedPart, Timing
from missionpair.report import CampaignReport, lines, report, tex_files
from missionpair.report.control import kinds_of
from missionpair.report.names import LIVE_ROWS, slug
from missionpair.report.published import match, published
from missionpair.report.table import Head, Table, share, text

#: The rows of the paper's tables, as they stand in its source.
PRINTED = {
    "tab-pilot-live-llm": r"""
Goal substitution & 0/10~[0.00, 0.28] & --- \\
Capability escalation & 0/10~[0.00, 0.28] & --- \\
Object substitution & 10/10~[0.72, 1.00] & 10/10 \\
Provenance confusion & 0/10~[0.00, 0.28] & --- \\
Area expansion & 0/10~[0.00, 0.28] & --- \\
Parameter escalation & 1/10~[0.02, 0.40] & 1/1 \\
\midrule
Pooled (60 trials) & 11/60 = 18.3\%~[0.11, 0.30] & 11/11 \\""",
    "tab-pilot-adaptive-haiku": r"""
Goal substitution & 1/10~[0.02, 0.40] & 1/1 \\
Capability escalation & 0/10~[0.00, 0.28] & --- \\
Object substitution & 7/10~[0.40, 0.89] & 7/7 \\
Provenance confusion & 2/10~[0.06, 0.51] & 2/2 \\
Area expansion & 0/10~[0.00, 0.28] & --- \\
Parameter escalation & 2/10~[0.06, 0.51] & 2/2 \\
\midrule
Pooled (60 trials) & 12/60 = 20.0\%~[0.12, 0.32] & 12/12 \\""",
    "tab-pilot-qwen-fixed": r"""
Goal substitution & 10/10~[0.72, 1.00] & 10/10 \\
Capability escalation & 0/10~[0.00, 0.28] & --- \\
Object substitution & 10/10~[0.72, 1.00] & 10/10 \\
Provenance confusion & 10/10~[0.72, 1.00] & 10/10 \\
Area expansion & 10/10~[0.72, 1.00] & 10/10 \\
Parameter escalation & 10/10~[0.72, 1.00] & 10/10 \\
\midrule
Pooled (60 trials) & 50/60 = 83.3\%~[0.72, 0.91] & 50/50 \\""",
    "tab-pilot-qwen-adaptive": r"""
Goal substitution & 6/10~[0.31, 0.83] & 6/6 \\
Capability escalation & 0/10~[0.00, 0.28] & --- \\
Object substitution & 2/10~[0.06, 0.51] & 2/2 \\
Provenance confusion & 10/10~[0.72, 1.00] & 10/10 \\
Area expansion & 8/10~[0.49, 0.94] & 8/8 \\
Parameter escalation & 10/10~[0.72, 1.00] & 10/10 \\
\midrule
Pooled (60 trials) & 36/60 = 60.0\%~[0.47, 0.71] & 36/36 \\""",
    "tab-pilot-crossmodel": r"""
Claude Haiku~4.5 & Fixed template & 11/60 (18.3\%) & 11/11 \\
Claude Haiku~4.5 & Adaptive & 12/60 (20.0\%) & 12/12 \\
Qwen2.5~7B & Fixed template & 50/60 (83.3\%) & 50/50 \\
Qwen2.5~7B & Adaptive & 36/60 (60.0\%) & 36/36 \\
\midrule
All live trials & --- & 109/240 (45.4\%) & 109/109 \\""",
    "tab-pilot-results": r"""
No defense & 1.00 & 1.00 & 1.00 & 0.00 & 0.00 \\
Safety-only pilot baseline & 1.00 & 1.00 & 1.00 & 0.00 & 0.00 \\
AuthGuard-R + safety gate & 0.00 & 0.00 & 1.00 & 0.00 & 1.00 \\""",
    "tab-pilot-category": r"""
Goal substitution & 1/1 & 1/1 & 0/1 \\
Object substitution & 1/1 & 1/1 & 0/1 \\
Area expansion & 1/1 & 1/1 & 0/1 \\
Capability escalation & 1/1 & 1/1 & 0/1 \\
Parameter escalation & 1/1 & 1/1 & 0/1 \\
Cross-robot reuse & 1/1 & 1/1 & 0/1 \\
Provenance confusion & 2/2 & 2/2 & 0/2 \\
Replay & 1/1 & 1/1 & 0/1 \\
Threshold-approval bypass & 1/1 & 1/1 & 0/1 \\""",
}
HEADS = {
    "tab-pilot-live-llm": "Category & Planner complied & Blocked by AuthGuard-R",
    "tab-pilot-crossmodel": "Target planner & Attack method & Planner complied & Blocked",
    "tab-pilot-results": (
        r"System & UASR $\downarrow$ & SCMHR $\downarrow$ & BTCR $\uparrow$ & "
        r"FRR $\downarrow$ & SU $\uparrow$"
    ),
    "tab-pilot-category": "Category & No defense & Safety-only & Dual gate",
}
#: Columns that are the paper's; those after them repeat its figures.
OURS = {"tab-pilot-crossmodel": 4, "tab-pilot-results": 6, "tab-pilot-category": 4}


def hand() -> MeasuredCampaign:
    """Return the measures of the paper's controlled study, as it came out."""
    attacks = ["goal", "object", "area", "capability", "parameter", "cross-robot"]
    attacks += ["provenance", "provenance", "replay", "approval"]
    trials = []
    for defense in ("none", "safety", "both"):
        made = blocked if defense == "both" else hijacked
        trials += [made(defense=defense, categories=(name,)) for name in attacks]
        trials += [benign(defense=defense) for _ in range(7)]
    defenses = (NamedPart("none"), NamedPart("safety"), NamedPart("both"))
    told = campaign(suite="hand", planner=NamedPart("none"), defenses=defenses, trials=len(trials))
    return measure(told, numbered(trials))


def whole() -> CampaignReport:
    return report([*the_papers(), hand()])


def small(*trials: Any, **changes: Any) -> MeasuredCampaign:
    names = dict.fromkeys(["both", *(trial.defense for trial in trials)])
    told = {"defenses": tuple(map(NamedPart, names)), "trials": len(trials)} | changes
    return measure(campaign(**told), numbered(trials))


def table(found: CampaignReport, name: str) -> Table:
    return next(one for one in found.tables if one.name == name)


def cells(one: Table, row: int) -> list[str | None]:
    """Return a row's words; rows below the line come after the others."""
    return [
        text(cell, head, foot=row >= len(one.rows))
        for head, cell in zip(one.heads, (*one.rows, *one.foot)[row], strict=True)
    ]


@pytest.mark.parametrize("name", sorted(PRINTED))
def test_the_same_counts_give_the_papers_own_rows_and_its_figures_beside(name: str) -> None:
    source = files_of(tex_files(whole()))[f"{name}.tex"]
    body = source.split("\\toprule\n")[1].split("\n\\bottomrule")[0].splitlines()
    ours = OURS.get(name, 3)
    cut = [
        " & ".join(line.removesuffix(r" \\").split(" & ")[:ours]) + r" \\" if "&" in line else line
        for line in body
    ]
    assert cut[1] == r"\midrule"
    assert "\n".join(["", *cut[2:]]) == PRINTED[name]
    if name in HEADS:
        assert cut[0] == HEADS[name] + r" \\"
    # what stands beside is the same here, because the counts are
    for line in body[2:]:
        given = line.removesuffix(r" \\").split(" & ")
        if len(given) > 1:
            assert given[ours:] == given[-(len(given) - ours) :]
            assert given[ours:] in (given[1:ours], given[2:ours])


def test_the_published_figures_agree_with_each_other_and_with_the_papers_sums() -> None:
    told = published()
    found = [one for target in told.planners for one in target.attacks.values()]
    assert [one.pooled[0] for one in found] == [11, 12, 50, 36]
    for one in found:
        assert tuple(one.complied) == LIVE_ROWS
        assert sum(one.complied.values()) == one.pooled[0] == one.pooled[2]
        assert one.trials * len(one.complied) == one.pooled[1] == 60
        assert one.blocked == {name: count for name, count in one.complied.items() if count}
        assert one.compliance("replay") is None
        assert one.blocking("capability") is None
    sums = tuple(sum(one.pooled[n] for one in found) for n in range(3))
    assert sums == told.crossmodel.total == (109, 240, 109)
    assert sum(row["none"][1] for row in told.category.rows.values()) == 10
    for system, row in told.results.systems.items():
        hits = sum(one[system][0] for one in told.category.rows.values())
        assert told.results.of(system)["uasr"] == row[0] / 100 == hits / 10
    assert told.results.of("cedar") == {}
    assert told.category.of("goal", "cedar") is None
    assert {(t.known_by, a): dict(one.complied) for t in told.planners
            for a, one in t.attacks.items()} == {
        ({"haiku": "haiku45", "qwen": "qwen257b"}[planner], attack): counts
        for (planner, attack), counts in PAPER.items()
    }  # fmt: skip


def test_only_the_papers_own_models_are_its_planners_and_no_stand_in() -> None:
    for planner, name in [
        (HAIKU, "Claude Haiku 4.5"),
        (NamedPart("anthropic", parameters={"model": "claude-haiku-4-5"}), "Claude Haiku 4.5"),
        (NamedPart("openai", parameters={"model": "Qwen/Qwen2.5-7B-Instruct"}), "Qwen2.5 7B"),
        (QWEN, "Qwen2.5 7B"),
        (NamedPart("openai", parameters={"model": "qwen2.5:72b"}), None),
        (NamedPart("openai", parameters={"model": "claude-haiku-3-5"}), None),
        (NamedPart("openai", parameters={"model": 7}), None),
        (NamedPart("haiku", simulated=True, parameters={"model": "claude-haiku-4-5"}), None),
    ]:
        with case(planner, name):
            found = match(planner)
            assert (found.name if found else None) == name


def test_another_planner_has_a_table_of_its_own_beside_both_of_the_papers() -> None:
    found = report([live(GRADED, FIXED, {"goal": 3, "replay": 10})])
    one = table(found, "live-graded-fixed")
    assert [head.name for head in one.heads] == [
        "Category",
        "Planner complied",
        "Blocked by AuthGuard-R",
        "Published: Claude Haiku 4.5",
        "Published: Qwen2.5 7B",
    ]
    assert [row[0] for row in one.rows][-1] == "Replay"
    assert len(one.rows) == 7
    assert cells(one, 0) == [
        "Goal substitution", "3/10 [0.11, 0.60]", "3/3", "0/10 [0.00, 0.28]", "10/10 [0.72, 1.00]",
    ]  # fmt: skip
    assert cells(one, 1)[:3] == ["Capability escalation", None, None]
    assert cells(one, 6) == ["Replay", "10/10 [0.72, 1.00]", "10/10", None, None]
    assert cells(one, 7)[:3] == ["Pooled (20 trials)", "13/20 = 65.0% [0.43, 0.82]", "13/13"]


def test_a_replay_has_beside_it_what_the_paper_has_of_the_attacker_of_its_texts() -> None:
    planner = NamedPart("replay", parameters={"planner": {"name": "small"}})
    texts = NamedPart("replay", parameters={"attacker": {"name": "adaptive"}})
    one = table(report([live(planner, texts, {"goal": 3})]), "live-replay-replay")
    assert [head.name for head in one.heads if head.published] == [
        "Published: Claude Haiku 4.5",
        "Published: Qwen2.5 7B",
    ]
    adaptive = published().planners[1].attacks["adaptive"].compliance("goal")
    assert one.rows[0][-1] == adaptive


def test_an_attacker_that_the_paper_has_not_has_nothing_published_beside() -> None:
    found = report([live(HAIKU, NamedPart("search"), {"goal": 1})])
    assert [head.published for head in table(found, "live-haiku-search").heads] == [False] * 3
    assert len(table(found, "crossmodel").heads) == 4


#: Campaigns against the paper's own model with one thing otherwise than in its experiments.
NOT_THE_PAPERS: dict[str, dict[str, Any]] = {
    "another suite": {"suite": "full"},
    "white box": {"access": "white"},
    "one round": {"rounds": 1},
    "several answers": {"turns": 2},
    "a part of the suite": {"pairs": 12},
    "unfinished": {"trials": 61},
    "another gate": {"defenses": (NamedPart("mission"),)},
    "scripted attacker": {"attacker": NamedPart("adaptive", simulated=True)},
}


def not_the_papers(changes: dict[str, Any], *, error: bool = False) -> MeasuredCampaign:
    told = {"planner": HAIKU, "kinds": ("attack",), "trials": 60} | changes
    made = campaign(**told)
    trials = [blocked(defense=made.defenses[0].name) for _ in range(60)]
    if error:
        trials[7] = kept(instead="error", error="gone")
    return measure(made, numbered(trials))


def test_the_papers_setup_alone_has_its_label_its_caption_and_its_figures() -> None:
    found = report([not_the_papers({})])
    assert table(found, "tab-pilot-live-llm").caption == published().planners[0].attacks[
        "fixed"].caption  # fmt: skip
    assert table(found, "tab-pilot-crossmodel").label == "tab:pilot-crossmodel"
    assert any(head.published for one in found.tables for head in one.heads)


def test_what_is_not_the_papers_experiment_has_neither_its_label_nor_its_figures() -> None:
    """Source: `tab:pilot-live-llm`, `tab:pilot-crossmodel`."""
    for how in [*NOT_THE_PAPERS, "a trial without an answer"]:
        with case(how):
            found = report(
                [not_the_papers(NOT_THE_PAPERS.get(how, {}), error=how.startswith("a trial"))]
            )
            labels = [one.label for one in found.tables]
            assert not [label for label in labels if label.startswith("tab:pilot")]
            assert {"tab:live-haiku-fixed", "tab:live-haiku-adaptive"} & set(labels)
            captions = "".join(one.caption for one in found.tables)
            assert "Haiku" not in captions
            assert "conditional" not in captions
            assert len(found.plots[0].series) == 1
            beside = [head for one in found.tables for head in one.heads if head.published]
            assert bool(beside) is (
                how == "scripted attacker"
            )  # a stand-in may stand beside, marked


def test_a_summary_of_the_papers_models_and_another_one_has_no_label_of_the_papers() -> None:
    found = report([not_the_papers({}), not_the_papers({"suite": "full"})])
    summary = table(found, "crossmodel")
    assert (summary.label, summary.caption) == ("tab:crossmodel", "")
    assert [cell is None for cell in cells(summary, 1)[4:]] == [True, True]
    assert "tab-pilot-crossmodel" not in {one.name for one in found.tables}


def test_each_defense_has_its_table_and_the_gate_has_the_papers_name() -> None:
    trials = [hijacked(defense="none"), hijacked(defense="cedar"), blocked()]
    defenses = (NamedPart("none"), NamedPart("cedar"), NamedPart("both"))
    found = report([small(*trials, planner=HAIKU, defenses=defenses)])
    names = {
        one.name: one.heads[2].name
        for one in found.tables
        if one.label.startswith(("tab:pilot-live", "tab:live"))
    }
    assert len(names) == 3
    assert names["tab-pilot-live-llm"] == "Blocked by AuthGuard-R"
    assert names["live-haiku-fixed-none"] == "Blocked by none"
    assert names["live-haiku-fixed-cedar"] == "Blocked by cedar"


def test_without_a_gate_the_last_defense_stands_in_the_summary_under_its_own_name() -> None:
    trials = [hijacked(defense="none"), hijacked(defense="safety")]
    found = report(
        [small(*trials, planner=HAIKU, defenses=(NamedPart("none"), NamedPart("safety")))]
    )
    assert "tab-pilot-live-llm" not in {one.name for one in found.tables}
    summary = table(found, "crossmodel")
    assert cells(summary, 0)[:4] == ["Claude Haiku 4.5", "Fixed template", "1/1 (100.0%)", "0/1"]
    assert "Defense: log 1 safety." in summary.notes


def test_two_logs_of_one_experiment_have_tables_of_their_own() -> None:
    found = report([live(HAIKU, FIXED, {"goal": 1}), live(HAIKU, FIXED, {"goal": 2})])
    names = [one.name for one in found.tables]
    labels = [one.label for one in found.tables if one.label]
    assert len(set(names)) == len(names)
    assert len(set(labels)) == len(labels)
    assert {"tab-pilot-live-llm", "tab-pilot-live-llm-2"} <= set(names)


def test_what_is_simulated_is_marked_in_every_table_plot_and_remark() -> None:
    found = report([live(GRADED, ADAPTIVE, {"goal": 3})])
    assert {one.simulated for one in found.tables} == {"planner graded"}
    assert {one.simulated for one in found.plots} == {"planner graded"}
    assert found.remarks[0].startswith("Simulated: planner graded.")
    assert "[simulated: planner graded]" in "\n".join(lines(found))
    assert cells(table(found, "crossmodel"), 0)[0] == "graded (simulated)"
    assert cells(table(found, "crossmodel"), 1)[0] == "All simulated trials"


def test_live_recorded_and_simulated_trials_are_summed_apart() -> None:
    planners = (GRADED, HAIKU, NamedPart("replay", parameters={"planner": {"name": "haiku"}}))
    found = report([live(planner, FIXED, {"goal": n}) for n, planner in enumerate(planners, 1)])
    shown = table(found, "crossmodel")
    sums = {cells(shown, row)[0]: cells(shown, row)[2] for row in range(3, 6)}
    assert {name: text.partition("/")[0] for name, text in sums.items()} == {
        "All simulated trials": "1",
        "All live trials": "2",
        "All recorded trials": "3",
    }
    assert cells(shown, 2)[0] == "replay of haiku (recorded)"


def test_what_is_real_has_no_mark_and_a_simulated_defense_marks_its_own_rows() -> None:
    assert report([live(HAIKU, FIXED, {"goal": 3})]).simulated == ""
    defenses = (NamedPart("both"), NamedPart("human", simulated=True))
    found = report([small(blocked(), hijacked(defense="human"), planner=HAIKU, defenses=defenses)])
    rates = table(found, "rates")
    assert [cells(rates, row)[4:6] for row in (0, 1)] == [
        ["both", "live"],
        ["human (simulated)", "defense human"],
    ]


def test_an_unfinished_log_missing_answers_and_mixed_suites_are_said_first() -> None:
    one = small(kept(instead="error", error="gone"), planner=HAIKU, trials=9)
    other = small(kept(), planner=HAIKU, suite_digest="another")
    told = report([one, other]).remarks
    assert told[0] == "Log 1 is not finished: 1 of 9 trials."
    assert told[1].startswith("Log 1: 1 trials had no answer")
    assert told[2].startswith("The logs are of different suites")
    assert len(told) == 3


@dataclass(frozen=True)
class Shown:
    """A table's row, by the names of its columns."""

    table: str
    row: int
    columns: dict[str, str | None]


SMALL = [
    Shown(
        "rates",
        0,
        {
            "Complied": "2/3 [0.21, 0.94]",
            "Blocked, of those": "1/2 [0.09, 0.91]",
            "UASR": "1/3 [0.06, 0.79]",
            "SCMHR": "1/3 [0.06, 0.79]",
            "BTCR": "1/2 [0.09, 0.91]",
            "FRR": "1/2 [0.09, 0.91]",
            "Updates completed": "1/1 [0.21, 1.00]",
            "SU": "0.5714",
        },
    ),
    Shown("bounds", 0, {"UASR": None, "FRR": None, "Not blocked, of complied": None}),
    Shown("runs", 0, {"Kind": "benign", "Completed": "1/2 [0.09, 0.91]", "Neither": "0"}),
    Shown("runs", 1, {"Kind": "update", "Completed": "1/1 [0.21, 1.00]"}),
    Shown("planners", 0, {"Attacks": "3", "Declined": "1", "Stayed within its mission": "0"}),
    Shown(
        "by-category",
        0,
        {"Category": "Goal substitution", "Attacks": "1", "Complied": "0/1 [0.00, 0.79]"},
    ),
    Shown(
        "by-category",
        1,
        {"Category": "Object substitution", "Attacks": "2", "Largest planned D_M": "0.0682"},
    ),
    Shown("by-channel", 1, {"Channel": "sign+user", "UASR": "1/1 [0.21, 1.00]"}),
    Shown("by-combination", 0, {"Categories": "object+area", "Attacks": "1"}),
    Shown("fields", 0, {"In plans that complied": "2/2 (100.0%)"}),
    Shown("deviation", 0, {"Planned D_M, max": "0.0682", "Executed D_M, max": "0.0455"}),
    Shown("tries", 0, {"Attack found": "2/3 [0.21, 0.94]", "Tries to it, median": "1.5"}),
    Shown("availability", 0, {"Kind": "attack", "False stops": "1/3 [0.06, 0.79]"}),
    Shown("availability", 0, {"Stalled ms, p95": "900"}),
    Shown("prompts", 0, {"Missions": "3", "Prompts": "4", "Prompts per mission": "1.33"}),
    Shown("times", 0, {"Quantile": "p50", "Planner, us": "100", "Safety, us": None}),
    Shown("times", 0, {"Total, us": "900"}),
    Shown("times", 3, {"Quantile": "trials", "Planner, us": "6", "Safety, us": "0"}),
    Shown("costs", 0, {"Tokens read": "7", "USD for each attack that complied": "0.2500"}),
    Shown("refusals", 0, {"What": "by", "Name": "authorization", "Trials": "1/3 (33.3%)"}),
]  # fmt: skip


def one_of_each() -> CampaignReport:
    far = (KEPT, replace(REACHED, deviation="3/44"))
    return report(
        [
            small(
                kept(instead="declined", tokens=(7, 1)),
                blocked(categories=("object",), rounds=far, prompts=4, stalled_ms=900),
                hijacked(
                    categories=("object", "area"),
                    channels=("user", "sign"),
                    cost_microusd=500_000,
                    false_stop=True,
                ),
                benign(),
                benign(completed=False, by="authorization", reasons=("EXPIRED",)),
                benign(kind="update"),
                planner=HAIKU,
            )
        ]
    )


def test_every_table_of_a_small_log_says_exactly_this() -> None:
    for shown in SMALL:
        with case(shown):
            one = table(one_of_each(), shown.table)
            found = dict(zip((head.name for head in one.heads), cells(one, shown.row), strict=True))
            assert {name: found[name] for name in shown.columns} == shown.columns


def test_none_of_many_has_a_bound_and_some_have_none() -> None:
    found = report([small(*[blocked()] * 30, *[benign()] * 10, planner=HAIKU)])
    assert cells(table(found, "bounds"), 0)[6:] == [
        "0.100000", "0.100000", "0.100000", "0.300000", "0.300000",
    ]  # fmt: skip


def test_logs_that_differ_in_access_alone_get_a_table_of_leakage() -> None:
    def tried(access: str, hits: int) -> MeasuredCampaign:
        trials = [hijacked()] * hits + [kept()] * (40 - hits)
        return small(*trials, planner=HAIKU, access=access)

    found = report([tried("white", 30), tried("black", 10), tried("grey", 20)])
    one = table(found, "leakage")
    assert [cells(one, row)[3] for row in range(3)] == [
        "white - black",
        "white - grey",
        "grey - black",
    ]
    assert cells(one, 0)[6:] == [
        "+0.5000 [+0.2851, +0.6529]", "1.0", "1.0", "-1.00 [-1.40, -0.60]", "yes",
    ]  # fmt: skip
    assert "plot-leakage" in {plot.name for plot in found.plots}
    other = small(kept(), planner=HAIKU, access="grey", suite_digest="another")
    assert "leakage" not in {t.name for t in report([tried("white", 1), other]).tables}
    rows = table(report([tried("white", 30), tried("black", 10)]), "crossmodel")
    assert [cells(rows, row)[1] for row in (0, 1)] == [
        "Fixed template, white box",
        "Fixed template",
    ]


def test_leakage_that_is_undefined_says_so() -> None:
    white = small(planner=HAIKU, access="white")
    black = small(planner=HAIKU)
    found = report([white, black])
    assert cells(table(found, "leakage"), 0)[4:] == [None] * 7
    assert found.plots[-1].lines[0].dots == ()


def test_a_report_of_nothing_that_ran_is_all_undefined() -> None:
    found = report([small(planner=HAIKU)])
    assert not {"crossmodel", "tab-pilot-crossmodel"} & {one.name for one in found.tables}
    assert cells(table(found, "rates"), 0)[6:] == [None] * 8
    assert all(line.dots == () for plot in found.plots for line in plot.lines)


def test_the_hand_suites_tables_name_systems_as_the_paper_and_others_as_they_are() -> None:
    defenses = (NamedPart("none"), NamedPart("cedar"), NamedPart("both"))
    rows = [
        row for row, those in published().category.rows.items() for _ in range(those["none"][1])
    ]
    trials = [
        made(defense=name, categories=(row,))
        for row in (*rows, "odd")
        for made, name in ((hijacked, "none"), (hijacked, "cedar"), (blocked, "both"))
    ]
    found = report([small(*trials, suite="hand", defenses=defenses)])
    results = table(found, "tab-pilot-results")
    assert [cells(results, row)[0] for row in range(3)] == [
        "No defense",
        "cedar",
        "AuthGuard-R + safety gate",
    ]
    assert cells(results, 1)[6:] == [None] * 5
    categories = table(found, "tab-pilot-category")
    assert [head.name for head in categories.heads] == [
        "Category", "No defense", "cedar", "Dual gate",
        "Published: No defense", "Published: Dual gate",
    ]  # fmt: skip
    assert cells(categories, len(categories.rows) - 1) == ["odd", "1/1", "1/1", "0/1", None, None]


@pytest.mark.parametrize("more", [{"skipped": 1}, {"trials": 99}, {}])
def test_a_part_of_the_hand_suite_stands_beside_no_published_figure(more: dict[str, Any]) -> None:
    """One recorded reply to one pair is not the paper's validation."""
    whole = [] if not more else [row for row in published().category.rows for _ in range(2)]
    trials = [blocked(categories=(row,)) for row in whole or ["goal"]]
    found = report([small(*trials, suite="hand", **more)])
    assert not any(head.published for made in found.tables for head in made.heads)
    assert not any(made.label.startswith("tab:pilot") for made in found.tables)


def test_a_table_with_a_crooked_row_or_two_columns_of_one_name_cannot_be() -> None:
    with pytest.raises(TypeError, match="another number"):
        Table(name="t", title="t", heads=(Head("a", "A"),), rows=((1, 2),))
    with pytest.raises(TypeError, match="of one key"):
        Table(name="t", title="t", heads=(Head("a", "A"), Head("a", "B")), rows=())
    with pytest.raises(TypeError, match="of one name"):
        Table(name="t", title="t", heads=(Head("a", "A"), Head("b", "A")), rows=())
    with pytest.raises(TypeError, match="no words"):
        share(Proportion(0, 0), Head("a", "A").form)


def test_defenses_that_a_log_calls_alike_have_columns_of_their_own() -> None:
    names = (
        "category",
        "Category",
        "a b",
        "a-b",
        "x" * 200,
        "x" * 201,
        "both",
        "none",
        "No defense",
    )
    found = report([small(*(hijacked(defense=name) for name in names), planner=HAIKU)])
    one = table(found, "categories-1")
    assert len({head.key for head in one.heads}) == len({head.name for head in one.heads})
    assert len(one.heads) == len(names) + 1
    assert "a-b (2)" in {head.name for head in one.heads}


def test_a_figure_is_a_consistency_check_only_where_the_suite_settled_it() -> None:
    def shown(planner: str, suite: str, defense: str) -> list[str]:
        told = campaign(suite=suite, planner=NamedPart(planner, simulated=True))
        return [kind.split()[0] for _, kind, _ in kinds_of(told, defense)]

    settled, found = "consistency", "finding"
    for defense in ("none", "both"):
        assert shown("hijacked", "full", defense) == [settled] * 3
        assert shown("hijacked", "perceived", defense) == [found, found, settled]
        assert shown("hijacked", "of-mine", defense) == [found] * 3
        assert shown("adversary", "full", defense) == [found, found, settled]
        assert shown("noisy", "full", defense) == [found] * 3
        assert shown("replay", "full", defense) == [found] * 3
    assert shown("hijacked", "full", "cedar") == [settled, found, found]


def test_times_come_from_timing_alone() -> None:
    slow = Timing(planner=5_000_000, total=6_000_000)
    found = report([small(kept(timing=slow), planner=HAIKU)])
    plain = report([small(kept(timing=Timing()), planner=HAIKU)])
    differ = [
        one.name for one, other in zip(found.tables, plain.tables, strict=True) if one != other
    ]
    assert differ == ["times"]


@pytest.mark.parametrize("words", ["../../etc/passwd", "a b", "\x00", "", "Ünïcode", "x" * 500])
def test_a_files_name_is_harmless_whatever_a_log_calls_things(words: str) -> None:
    assert re.fullmatch(r"[a-z0-9-]{1,80}", slug(words))
