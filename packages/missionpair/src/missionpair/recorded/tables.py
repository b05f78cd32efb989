# SPDX-License-Identifier: Apache-2.0
"""Tables of replayed runs, and every call that a reader may ask about, with its cause.

The figures are of office tools, not of robots: external validity. How-to:
docs/howto/missionpair-recorded.md
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable
from typing import Any

from msgspec import Struct

from missionpair.measures import Proportion
from missionpair.recorded.replay import NONE, ReplayedRun

LABEL = "external validity: office tools, not robots"
#: Pipelines whose runs were looked at while the missions were written; all others were held out.
TUNED = frozenset(
    {
        "claude-3-5-sonnet-20241022",
        "gemini-1.5-flash-001",
        "gpt-3.5-turbo-0125",
        "gpt-4o-2024-05-13",
        "meta-llama_Llama-3-70b-chat-hf",
    }
)
#: Why a call ran: what was asked of it.
_WHY = {
    NONE: "no gate",
    "allowlist": "a step of the mission uses the tool",
    **dict.fromkeys(("both", "cedar", "mission"), "the mission allows it for the task"),
}
TUNED_GROUP, HELD_OUT = "looked at", "held out"


class OutcomeRow(Struct, kw_only=True):
    """What one defense did with the runs of one group of pipelines.

    Args:
        group: `TUNED_GROUP` or `HELD_OUT`.
        defense: the defense.
        landed: runs in which an attack reached its goal, and how many of them made a call that
            the attack asks for.
        leaks: of the landed runs, those in which such a call would have run.
        changes: of the landed runs, those in which a call that changes something would have run.
        shared: of the landed runs, those in which only a read would have run that the attack and
            the task both need.
        refusals: of the runs without an attack that did their task, those with a refused call.
    """

    group: str
    defense: str
    landed: Proportion = Proportion(0, 0)
    leaks: Proportion = Proportion(0, 0)
    changes: Proportion = Proportion(0, 0)
    shared: Proportion = Proportion(0, 0)
    refusals: Proportion = Proportion(0, 0)

    def add(self, one: ReplayedRun) -> None:
        """Count one run."""
        if one.run.landed:
            self.landed += Proportion(int(any(one.unauthorized)), 1)
            self.leaks += Proportion(int(one.leaks), 1)
            self.changes += Proportion(int(one.changes_leak), 1)
            self.shared += Proportion(int(one.shares), 1)
        elif not one.run.kind and one.run.useful:
            self.refusals += Proportion(int(one.refuses), 1)


class Remaining(Struct, frozen=True, kw_only=True):
    """A call that leaked, or one that was refused in a run without an attack.

    Args:
        what: `leak`, `leak that changes`, `shared read` or `refusal`.
        group: of pipelines.
        defense: the defense.
        suite: of the run.
        task: of the run.
        attack: of the run; empty of a refusal.
        tool: what was called.
        cause: why it ran, or the refusal's codes.
        runs: how many runs have it.
        pipelines: whose runs, sorted.
        label: of the figures.
    """

    what: str
    group: str
    defense: str
    suite: str
    task: str
    attack: str
    tool: str
    cause: str
    runs: int
    pipelines: tuple[str, ...]
    label: str = LABEL


class Replay:
    """Counts runs as they come, in bounded memory."""

    def __init__(self) -> None:
        self._rows: dict[tuple[str, str], OutcomeRow] = {}
        self._remaining: defaultdict[tuple[str, ...], Counter[str]] = defaultdict(Counter)
        self.runs = 0

    def add(self, one: ReplayedRun) -> None:
        """Count one run under one defense."""
        group = TUNED_GROUP if one.run.pipeline in TUNED else HELD_OUT
        key = (group, one.defense)
        self._rows.setdefault(key, OutcomeRow(group=group, defense=one.defense)).add(one)
        for found in set(_remaining(one)):
            self._remaining[group, *found][one.run.pipeline] += 1
        self.runs += 1

    @property
    def rows(self) -> list[OutcomeRow]:
        """The rows, the group that was looked at first."""
        return [self._rows[key] for key in sorted(self._rows, key=lambda key: key[0] == HELD_OUT)]

    @property
    def remaining(self) -> list[Remaining]:
        """Every kind of call that leaked or was refused, the most frequent first."""
        found = sorted(self._remaining.items(), key=lambda item: (-item[1].total(), item[0]))
        return [
            Remaining(
                group=group,
                defense=defense,
                what=what,
                suite=suite,
                task=task,
                attack=attack,
                tool=tool,
                cause=cause,
                runs=runs.total(),
                pipelines=tuple(sorted(runs)),
            )
            for (group, defense, what, suite, task, attack, tool, cause), runs in found
        ]


def _remaining(one: ReplayedRun) -> Iterable[tuple[str, ...]]:
    """Yield each leak of a landed run, or each refusal of a run that did its task."""
    run = one.run
    named = (run.suite, run.task, run.attack)
    for number, call in enumerate(run.calls):
        is_asked = one.unauthorized[number] or one.shared[number]
        if run.landed and one.ran[number] and is_asked:
            what = "leak that changes" if one.changes[number] else "leak"
            what = "shared read" if one.shared[number] else what
            why = _WHY.get(one.defense, f"`{one.defense}` lets it through")
            yield (one.defense, what, *named, call.tool, why)
        elif not run.kind and run.useful and not one.ran[number]:
            yield (one.defense, "refusal", *named, call.tool, ", ".join(one.reasons[number]))


def lines(rows: list[OutcomeRow]) -> list[str]:
    """Return the table for people."""
    head = (
        "runs",
        "defense",
        "attack's call ran",
        "state-changing one ran",
        "only a read of the task's own ran",
        "benign run with a refused call",
    )
    body = [
        (
            *(row.group, row.defense),
            *map(_told, (row.leaks, row.changes, row.shared, row.refusals)),
        )
        for row in rows
    ]
    widths = [max(len(line[n]) for line in (head, *body)) for n in range(len(head))]
    told = (
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in (head, *body)
    )
    return [LABEL, *told]


def _told(share: Proportion) -> str:
    if share.interval is None:
        return "-"
    low, high = share.interval
    percent = f"{100 * share.k / share.n:.1f} %"
    return f"{share.k}/{share.n} = {percent} [{100 * low:.1f}, {100 * high:.1f}]"


def plain(rows: list[OutcomeRow]) -> list[dict[str, Any]]:
    """Return the rows as `--json` prints them."""
    names = ("landed", "leaks", "changes", "shared", "refusals")
    return [
        {"group": row.group, "defense": row.defense}
        | {name: _plain(getattr(row, name)) for name in names}
        for row in rows
    ]


def _plain(share: Proportion) -> dict[str, Any]:
    return {"k": share.k, "n": share.n, "interval": share.interval}
