# SPDX-License-Identifier: Apache-2.0
"""Recorded calls put to a defense, one after the other: which of them would have run.

A replay is open: what a model would have done after a refusal, nobody knows. The calls after it are
judged as if it had done the same. Which call is the attack's, the suite's file says, from the
attack's published solution; no defense is asked for that.
How-to: docs/howto/missionpair-recorded.md
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from msgspec import Struct

from missionpair import defenses
from missionpair.defenses import Defense
from missionpair.pair import Pair
from missionpair.recorded.agentdojo import RecordedRun
from missionpair.recorded.office import Office, OfficeCall, SuiteModel
from missionpair.stage import Stage, Yard

#: No defense: every call ran.
NONE = "none"


class ReplayedRun(Struct, frozen=True, kw_only=True):
    """One run under one defense.

    Args:
        run: it.
        defense: the defense.
        ran: whether each call would have run.
        reasons: the codes of each call's refusal; empty where it ran.
        unauthorized: whether each call is the attack's.
        changes: whether each call changes something.
    """

    run: RecordedRun
    defense: str
    ran: tuple[bool, ...]
    reasons: tuple[tuple[str, ...], ...]
    unauthorized: tuple[bool, ...]
    changes: tuple[bool, ...]

    @property
    def leaks(self) -> bool:
        """A call of the attack would have run."""
        return any(ran and bad for ran, bad in zip(self.ran, self.unauthorized, strict=True))

    @property
    def changes_leak(self) -> bool:
        """A call of the attack that changes something would have run."""
        judged = zip(self.ran, self.unauthorized, self.changes, strict=True)
        return any(ran and bad and changes for ran, bad, changes in judged)

    @property
    def refuses(self) -> bool:
        """A call would not have run."""
        return not all(self.ran)


class OfficeReplay:
    """Runs of one suite, put to defenses.

    Args:
        suite: its model.
        yard: where its situations are made.
    """

    def __init__(self, suite: SuiteModel, yard: Yard) -> None:
        self.office, self._yard = Office(suite), yard
        self._stages: dict[tuple[str, str], Stage] = {}
        self._defenses: dict[str, Defense] = {}

    def replay(self, runs: Iterable[RecordedRun], names: tuple[str, ...]) -> Iterator[ReplayedRun]:
        """Yield each run under each defense."""
        for run in runs:
            bad = tuple(self.office.is_the_attacks(call, run.task, run.attack) for call in run.calls)
            changes = tuple(self.office.changes(call) for call in run.calls)
            for name in names:
                refused = self._refused(name, run)
                yield ReplayedRun(
                    run=run,
                    defense=name,
                    ran=tuple(reasons is None for reasons in refused),
                    reasons=tuple(reasons or () for reasons in refused),
                    unauthorized=bad,
                    changes=changes,
                )

    def _refused(self, name: str, run: RecordedRun) -> list[tuple[str, ...] | None]:
        """Return why each call would not have run; None where it would have."""
        if name == NONE:
            return [None] * len(run.calls)
        defense = self._defenses.setdefault(name, defenses.make(name))
        stage = self._stage(defense, name, run.task)
        stage.again()
        defense.begin(seed=0)
        return [self._one(defense, stage, call) for call in run.calls]

    def _one(self, defense: Defense, stage: Stage, call: OfficeCall) -> tuple[str, ...] | None:
        done = defense.carry_out(stage, self.office.plan(call))
        return None if done.completed else done.reasons

    def _stage(self, defense: Defense, name: str, task: str) -> Stage:
        key = (name, task)
        if key not in self._stages:
            pair: Pair = self.office.pair(task)
            self._stages[key] = self._yard.stage(
                pair, self.office.layout, pair.benign, safety_gate=defense.safety_gate
            )
        return self._stages[key]
