# SPDX-License-Identifier: Apache-2.0
"""Recorded calls put to a defense, one after the other: which of them would have run.

A replay is open: what a model would have done after a refusal, nobody knows. The calls after it are
judged as if it had done the same. Which call is the attack's, the suite's file says, from the
attack's published solution; no defense is asked for that.
How-to: docs/howto/missionpair-recorded.md
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from itertools import groupby
from multiprocessing import get_context
from operator import and_, gt

import msgspec
from msgspec import Struct

from missionpair import defenses
from missionpair.campaign.cluster import Cluster, ClusterError
from missionpair.defenses import Defense
from missionpair.pair import Pair
from missionpair.recorded.agentdojo import RecordedRun
from missionpair.recorded.office import (
    Office,
    OfficeCall,
    read_suite,
    require_known,
    suite_digest,
)
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
        shared: whether each call is a read that the attack and the task both need.
        changes: whether each call changes something.
    """

    run: RecordedRun
    defense: str
    ran: tuple[bool, ...]
    reasons: tuple[tuple[str, ...], ...]
    unauthorized: tuple[bool, ...]
    shared: tuple[bool, ...]
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
    def shares(self) -> bool:
        """A call of the attack would have run, and each that would is the task's as well."""
        return not self.leaks and any(map(and_, self.ran, self.shared))

    @property
    def refuses(self) -> bool:
        """A call would not have run."""
        return not all(self.ran)


class OfficeReplay:
    """Runs of one suite, put to defenses.

    Args:
        suite: its name.
        yard: where its situations are made.
    """

    def __init__(self, suite: str, yard: Yard) -> None:
        self.office, self._yard = Office(read_suite(suite)), yard
        self._stages: dict[tuple[str, str], Stage] = {}
        self._defenses: dict[str, Defense] = {}
        self._known: dict[tuple[str, str, bytes], list[tuple[str, ...] | None]] = {}

    def replay(self, runs: Iterable[RecordedRun], names: tuple[str, ...]) -> Iterator[ReplayedRun]:
        """Yield each run under each defense."""
        for run in runs:
            asked = [self.office.is_the_attacks(call, run.attack) for call in run.calls]
            shared = [self.office.is_shared(call, run.task) for call in run.calls]
            changes = tuple(self.office.changes(call) for call in run.calls)
            for name in names:
                refused = self._refused(name, run)
                yield ReplayedRun(
                    run=run,
                    defense=name,
                    ran=tuple(reasons is None for reasons in refused),
                    reasons=tuple(reasons or () for reasons in refused),
                    unauthorized=tuple(map(gt, asked, shared)),
                    shared=tuple(map(and_, asked, shared)),
                    changes=changes,
                )

    def _refused(self, name: str, run: RecordedRun) -> list[tuple[str, ...] | None]:
        """Return why each call would not have run; None where it would have."""
        if name == NONE:
            return [None] * len(run.calls)
        # models often make the same calls: what is decided once is the same every time
        key = (name, run.task, msgspec.json.encode(run.calls))
        if key not in self._known:
            self._known[key] = self._decided(name, run)
        return self._known[key]

    def _decided(self, name: str, run: RecordedRun) -> list[tuple[str, ...] | None]:
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


def replay_all(
    runs: Iterable[RecordedRun],
    names: tuple[str, ...],
    *,
    jobs: int = 1,
    ray: str = "",
    show: Callable[[int], None] = lambda _: None,
) -> Iterator[ReplayedRun]:
    """Yield each run of a user's task under each defense, by suite and task.

    Args:
        runs: in any order. Runs of a task that is an attack's, without a user's, are left out.
        names: the defenses.
        jobs: how many processes.
        ray: address of a Ray cluster that replays; empty: this machine does.
        show: called with the number of runs so far.

    Raises:
        SourceError: a run is of a suite, a task or an attack that was not written down.
    """
    kept = [run for run in runs if not run.task.startswith("injection_task")]
    for run in kept:
        require_known(run.suite, run.task, run.attack, where=f"{run.pipeline}, {run.suite}")
    kept.sort(key=_task_of)
    parts = [list(part) for _, part in groupby(kept, key=_task_of)]
    done = 0
    for part, replayed in zip(parts, _everywhere(parts, names, jobs, ray), strict=True):
        done += len(part)
        show(done)
        yield from replayed


def _task_of(run: RecordedRun) -> tuple[str, str]:
    return run.suite, run.task


def _everywhere(
    parts: list[list[RecordedRun]], names: tuple[str, ...], jobs: int, ray: str
) -> Iterator[list[ReplayedRun]]:
    """Yield each part, replayed: here, in processes, or on a cluster."""
    given = [(part, names, suite_digest(part[0].suite)) for part in parts]
    if ray:
        with Cluster(ray) as cluster:
            yield from cluster.mapped(replayed_here, given)
    elif jobs == 1:
        yield from (replayed_here(*one) for one in given)
    else:
        with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
            asked = [pool.submit(replayed_here, *one) for one in given]
            yield from (answer.result() for answer in asked)


def replayed_here(
    part: list[RecordedRun], names: tuple[str, ...], digest: str
) -> list[ReplayedRun]:
    """Replay runs of one task here.

    Raises:
        ClusterError: the missions on this machine are not those of the machine that asks.
    """
    if suite_digest(part[0].suite) != digest:
        text = f"a machine has another `{part[0].suite}`: install one version everywhere"
        raise ClusterError(text, where=os.uname().nodename)
    with Yard() as yard:
        return list(OfficeReplay(part[0].suite, yard).replay(part, names))
