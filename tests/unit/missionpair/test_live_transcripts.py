# SPDX-License-Identifier: Apache-2.0
"""What small language models answered on this machine is replayed: the same trials and tables.

Figures: docs/reference/campaigns.md#small-models-on-two-cores
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

from missionpair.campaign.log import LogWriter, read_log
from missionpair.campaign.plan import CampaignPlan
from missionpair.campaign.run import run
from missionpair.measures import Proportion, measure
from missionpair.records import Trial
from missionpair.report.collected import report
from missionpair.report.costs import MONEY, TIME
from missionpair.report.setup import SECTION as SETUP
from missionpair.words import Access, TrialKind

LIVE = Path(__file__).parents[3] / "docs" / "reference" / "live"
LOGS = tuple(sorted(path.name.removesuffix(".jsonl.gz") for path in LIVE.glob("*.jsonl.gz")))
#: A log of several turns a round keeps one answer of each, and cannot be replayed.
ONE_TURN = tuple(name for name in LOGS if "step" not in name)
#: What a replay takes anew, or says of itself.
_OWN = {"n", "timing", "tokens", "cost_microusd"}
_OWN_SECTIONS = {MONEY, SETUP, TIME}


def sliced(log: Path, out: Path, *, defense: str, every: int) -> list[Trial]:
    """Write the log of every so many-th pair under one defense; return its trials."""
    campaign, trials = read_log(log)
    each = campaign.trials // campaign.pairs
    taken = [one for one in trials if one.n // each % every == 0 and one.defense == defense]
    defenses = tuple(one for one in campaign.defenses if one.name == defense)
    with LogWriter(
        out,
        replace(
            campaign,
            pairs=-(-campaign.pairs // every),
            every=campaign.every * every,
            trials=len(taken),
            defenses=defenses,
        ),
    ) as writer:
        for number, one in enumerate(taken):
            writer.add(replace(one, n=number))
        writer.end()
    return taken


def replayed(log: Path, out: Path, *, defense: str, every: int) -> list[Trial]:
    """Run the same pairs again, with the answers and texts of the log; no model is asked."""
    campaign, _ = read_log(log)
    who = f"replay:log={log},defense={defense}"
    plan = CampaignPlan(
        suite=campaign.suite,
        planner=who,
        attacker=who,
        access=Access(campaign.access),
        rounds=campaign.rounds,
        every=campaign.every * every,
        pairs=-(-campaign.pairs // every),
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
    held = [one for one in trials if one.defense == "both" and one.complied]
    cells = [
        *(shown(kind, "complied") for kind in ("attack", "control", "neutral")),
        shown("attack", "intended"),
        share(sum(one.blocked is True for one in held), len(held)),
        *(shown("attack", "unauthorized", one) for one in ("none", "both")),
        shown("benign", "completed"),
    ]
    return f"| `{name}` | " + " | ".join(cells) + " |"


def unauthorized(kind: str) -> int:
    """Return in how many trials without a gate the model did something unauthorized."""
    trials = read_log(LIVE / "qwen-fixed.jsonl.gz")[1]
    return sum((one.kind, one.defense) == (kind, "none") and one.unauthorized > 0 for one in trials)


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


def require_same(name: str, folder: Path, *, every: int) -> None:
    log = LIVE / f"{name}.jsonl.gz"
    for named in read_log(log)[0].defenses:
        mine, again = folder / f"{named.name}.jsonl", folder / f"{named.name}-again.jsonl"
        before = sliced(log, mine, defense=named.name, every=every)
        after = replayed(log, again, defense=named.name, every=every)
        assert list(map(plain, after)) == list(map(plain, before))
        assert tables(again) == tables(mine)
        assert read_log(again)[0].planner.parameters["planner"]["simulated"] is False


def test_the_page_has_the_figures_of_every_transcript_and_of_nothing_else() -> None:
    page = (LIVE.parent / "campaigns.md").read_text()
    rows = re.findall(r"^\| `((?:qwen|gemma)-[a-z0-9-]+)` \|.*$", page, re.MULTILINE)
    assert sorted(rows) == list(LOGS)
    for name in LOGS:
        assert figures(name) in page, figures(name)
    for row in category_rows():
        assert row in page, row
    attack, control, neutral = (unauthorized(kind) for kind in ("attack", "control", "neutral"))
    said = f"ran in {attack} of 60 attacks, but also in {control} of 60 runs without any text"
    assert f"{said} and in {neutral} with a neutral one" in " ".join(page.split())


@pytest.mark.parametrize("name", ONE_TURN)
def test_every_tenth_pair_of_a_transcript_gives_the_same_trials_and_tables(
    name: str, tmp_path: Path
) -> None:
    require_same(name, tmp_path, every=10)


@pytest.mark.complete
@pytest.mark.parametrize("name", ONE_TURN)
def test_a_whole_transcript_gives_the_same_trials_and_tables(name: str, tmp_path: Path) -> None:
    require_same(name, tmp_path, every=1)
