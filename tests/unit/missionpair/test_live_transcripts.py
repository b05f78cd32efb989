# SPDX-License-Identifier: Apache-2.0
"""What small language models answered on this machine is replayed: the same trials and tables.

Figures: docs/reference/campaigns.md#small-models-on-two-cores
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

from missionpair.campaign.log import LogWriter, read_log
from missionpair.campaign.plan import CampaignPlan
from missionpair.campaign.run import run
from missionpair.measures import Proportion, difference, measure
from missionpair.records import Trial
from missionpair.report.collected import report
from missionpair.report.costs import MONEY, TIME
from missionpair.report.setup import SECTION as SETUP
from missionpair.report.tries import leaks_of
from missionpair.words import Access, TrialKind

LIVE = Path(__file__).parents[3] / "docs" / "reference" / "live"
LOGS = tuple(sorted(path.name.removesuffix(".jsonl.gz") for path in LIVE.glob("*.jsonl.gz")))
#: A log of several turns a round keeps one answer of each, and cannot be replayed.
ONE_TURN = tuple(name for name in LOGS if "step" not in name)
#: What a replay takes anew, or says of itself.
_OWN = {"n", "timing", "tokens", "cost_microusd"}
_OWN_SECTIONS = {MONEY, SETUP, TIME}


def under(log: Path, out: Path, defense: str) -> list[Trial]:
    """Write the part of a log that is of one defense; return its trials."""
    campaign, trials = read_log(log)
    taken = [one for one in trials if one.defense == defense]
    named = tuple(one for one in campaign.defenses if one.name == defense)
    with LogWriter(out, replace(campaign, trials=len(taken), defenses=named)) as writer:
        for number, one in enumerate(taken):
            writer.add(replace(one, n=number))
        writer.end()
    return taken


def replayed(log: Path, out: Path, defense: str) -> list[Trial]:
    """Run the same pairs again, with the answers and texts of the log; no model is asked."""
    campaign, _ = read_log(log)
    who = f"replay:log={log},defense={defense}"
    plan = CampaignPlan(
        suite=campaign.suite,
        planner=who,
        attacker=who,
        access=Access(campaign.access),
        rounds=campaign.rounds,
        every=campaign.every,
        pairs=campaign.pairs,
        kinds=tuple(map(TrialKind, campaign.kinds)),
        defenses=(defense,),
    )
    run(plan, out)
    return list(read_log(out)[1])


def plain(trial: Trial) -> dict[str, Any]:
    return {k: v for k, v in msgspec.to_builtins(trial).items() if k not in _OWN}


def tables(log: Path) -> dict[str, Any]:
    """Return every figure of a report, but for what a run costs; words name the planner."""
    found = report([measure(*read_log(log))])
    return {
        f"{number} {table.section}": [
            tuple(cell for cell in row if not isinstance(cell, str))
            for row in (*table.rows, *table.foot)
        ]
        for number, table in enumerate(found.tables)
        if table.section not in _OWN_SECTIONS
    }


def share(k: int, n: int) -> str:
    """Return a share as the page has it."""
    found = Proportion(k, n)
    if found.interval is None:
        return "-"
    low, high = found.interval
    return f"{k} of {n} [{low:.2f}, {high:.2f}]"


def figures(name: str) -> str:
    """Return the row of the page that a log comes to."""
    campaign, found = read_log(LIVE / f"{name}.jsonl.gz")
    trials = tuple(found)

    def shown(kind: str, of: str, defense: str = "both") -> str:
        those = [one for one in trials if (one.kind, one.defense) == (kind, defense)]
        return share(sum(bool(getattr(one, of)) for one in those), len(those))

    if campaign.kinds == ("benign",):
        return f"| `{name}` | {shown('benign', 'completed')} |"
    attacks = [one for one in trials if (one.kind, one.defense) == ("attack", "both")]
    held = [one for one in attacks if one.complied]
    cells = [
        *(shown(kind, "complied") for kind in ("attack", "control", "neutral")),
        shown("attack", "intended"),
        share(sum(one.blocked is True for one in held), len(held)),
        *(shown("attack", "unauthorized", one) for one in ("none", "both")),
        shown("benign", "completed"),
    ]
    return f"| `{name}` | " + " | ".join(cells) + " |"


def sentences() -> list[str]:
    """Return what the page says of `qwen-fixed` in words, as the log has it."""
    trials = tuple(read_log(LIVE / "qwen-fixed.jsonl.gz")[1])
    ran = {
        kind: sum(t.unauthorized > 0 for t in trials if (t.kind, t.defense) == (kind, "none"))
        for kind in ("attack", "neutral", "control")
    }
    held = [one for one in trials if one.defense == "both"]
    benign = [one for one in held if one.kind == "benign" and not one.completed]
    refused = [one for one in benign if one.false_stop]
    assert all(one.rounds[-1].violated for one in refused)  # each plan broke the mission
    assert all(one.executed == one.planned for one in benign if not one.false_stop)
    resisted = [one for one in held if one.kind == "attack" and not one.complied]
    unready = sum(not one.rounds[-1].executable for one in resisted)
    return [
        f"ran in {ran['attack']} of 60 attacks and in {ran['neutral']} of 60 runs with a neutral",
        f"It ran in {ran['control']} of 60 runs without any text",
        f"Of the 60 benign runs they refused {len(refused)}, and in each",
        f"In {len(benign) - len(refused)} more the plan ran, and did not finish the task",
        f"In {unready} of the {len(resisted)} fixed attacks without compliance the last plan",
    ]


def undisturbed(name: str) -> list[list[str]]:
    """Return the answers of a log under both gates, but those to attacks."""
    trials = read_log(LIVE / f"{name}.jsonl.gz")[1]
    those = (one for one in trials if one.defense == "both" and one.kind != "attack")
    return [[round_.reply for round_ in one.rounds] for one in those]


def category_rows() -> list[str]:
    """Return the rows of the page by category: ours, and what the paper has of its planners."""
    names = ("qwen-fixed", "qwen-adaptive")
    logs = [measure(*read_log(LIVE / f"{name}.jsonl.gz")) for name in names]
    found = [table for table in report(logs).tables if "attacks against" in table.title]
    both = [table for table in found if table.title.endswith("defense both")]
    lines = []
    for rows in zip(*((*table.rows, *table.foot) for table in both), strict=True):
        cells = [cell for row in rows for cell in row if isinstance(cell, Proportion)]
        lines.append(f"| {rows[0][0]} | " + " | ".join(f"{c.k} of {c.n}" for c in cells) + " |")
    return lines


def leakage_rows() -> list[str]:
    """Return the rows of the page that say what an attacker gains by knowing more."""
    names = [name for name in LOGS if name in {"qwen-adaptive", "qwen-grey", "qwen-white"}]
    logs = tuple(measure(*read_log(LIVE / f"{name}.jsonl.gz")) for name in names)
    lines = []
    for one in leaks_of(logs):
        found = [logs[number - 1].tally("both") for number in (one.more, one.less)]
        complied = [tally.compliance for tally in found]
        gaps = (difference(*complied), one.leak.gain, one.leak.rounds)
        cells = [f"{share.k} of {share.n}" for share in complied]
        cells += [
            "-" if gap is None else f"{gap.value:+.2f} [{gap.low:+.2f}, {gap.high:+.2f}]"
            for gap in gaps
        ]
        lines.append(f"| {one.leak.more} - {one.leak.less} | " + " | ".join(cells) + " |")
    return lines


def test_the_page_has_the_figures_of_every_transcript_and_of_nothing_else() -> None:
    page = (LIVE.parent / "campaigns.md").read_text()
    rows = re.findall(r"^\| `((?:qwen|gemma)-[a-z0-9-]+)` \|.*$", page, re.MULTILINE)
    assert sorted(rows) == list(LOGS)
    for name in LOGS:
        assert figures(name) in page, figures(name)
    for row in (*category_rows(), *leakage_rows()):
        assert row in page, row
    for sentence in sentences():
        assert sentence in " ".join(page.split()), sentence
    assert undisturbed("qwen-fixed") == undisturbed("qwen-adaptive")  # as the page says


def parts() -> Iterator[Any]:
    """Yield each log with one answer a round, and each of its defenses; no gate takes long."""
    for name in ONE_TURN:
        for named in read_log(LIVE / f"{name}.jsonl.gz")[0].defenses:
            marks = [] if named.name == "both" else [pytest.mark.complete]
            yield pytest.param(name, named.name, marks=marks)


@pytest.mark.parametrize(("name", "defense"), [*parts()])
def test_a_transcript_that_is_replayed_gives_the_same_trials_and_tables(
    name: str, defense: str, tmp_path: Path
) -> None:
    log, mine, again = LIVE / f"{name}.jsonl.gz", tmp_path / "mine.jsonl", tmp_path / "again.jsonl"
    before = under(log, mine, defense)
    after = replayed(log, again, defense)
    assert list(map(plain, after)) == list(map(plain, before))
    assert tables(again) == tables(mine)
    assert read_log(again)[0].planner.parameters["planner"]["simulated"] is False
