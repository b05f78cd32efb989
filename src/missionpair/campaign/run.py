# SPDX-License-Identifier: Apache-2.0
"""A whole campaign: every trial of every pair, on as many processes as asked for, into one log.

A deterministic campaign gives the same log whatever the number of processes, and however often it
was killed and taken up again. How-to: docs/howto/missionpair.md
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from itertools import islice
from multiprocessing import get_context
from os import getpid
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Lock, get_ident, local
from typing import Any, cast

from msgspec import Struct

from missionpair import attackers, defenses, planners, registry, suites
from missionpair.attackers import Attacker
from missionpair.briefing import Briefing, Planner, Reply
from missionpair.campaign.log import LogWriter
from missionpair.campaign.trial import PairRun, Setting
from missionpair.defenses import Defense, DefenseError
from missionpair.pair import Suite
from missionpair.records import SCHEMA, Campaign, Named, Trial
from missionpair.score import DEFAULT, Weights
from missionpair.stage import Yard
from missionpair.words import Access, Kind

#: Defenses that are no baseline: nothing, and the product itself.
_UNHELD = frozenset({"both", "mission", "none"})
#: Pairs that a baseline is held to its claim with.
FIT_PAIRS = 6
#: Pairs that are under way at once, for each process.
_AHEAD = 4


class Plan(Struct, frozen=True, kw_only=True):
    """What is asked for, in words that another process understands.

    Args:
        suite: a suite's name, or the path of its file.
        planner: `name:option=value,...`, as `--planner` takes it.
        attacker: as `--attacker` takes it.
        defenses: as `--defense` takes each.
        access: what the attacker sees.
        seed: of all dice.
        seeds: how often each pair is tried.
        rounds: an attacker's tries at most.
        turns: a planner's answers in a round at most.
        pairs: how many pairs, from the first; None takes all.
        kinds: which kinds of trial.
        weights: of the score.
        unqualified: score also baselines that do not do what they claim.
    """

    suite: str
    planner: str
    attacker: str = "fixed"
    defenses: tuple[str, ...] = ("both",)
    access: Access = Access.BLACK
    seed: int = 0
    seeds: int = 1
    rounds: int = 1
    turns: int = 1
    pairs: int | None = None
    kinds: tuple[Kind, ...] = tuple(Kind)
    weights: Weights = DEFAULT
    unqualified: bool = False


@dataclass(frozen=True)
class Progress:
    """How far a campaign is."""

    done: int
    trials: int


def run(
    plan: Plan, log: Path, *, jobs: int = 1, show: Callable[[Progress], None] = lambda _: None
) -> Campaign:
    """Run what is not in the log yet, and return what was run.

    Args:
        plan: what is asked for.
        log: where the trials go; one of the same plan goes on where it was cut off.
        jobs: processes; threads where a model is waited for.
        show: told of progress.

    Raises:
        LogError: the log cannot be written, or is of another campaign.
        SuiteError: no such suite, or a broken one.
        UnknownNameError: no such planner, attacker or defense, or no such option.
        PlannerError: the model cannot be had at all.
        StageError: a pair cannot be made real.
    """
    with closing(_Worker(plan, suites.load(plan.suite))) as worker:
        return _run(plan, worker, log, jobs, show)


def _run(
    plan: Plan, worker: _Worker, log: Path, jobs: int, show: Callable[[Progress], None]
) -> Campaign:
    campaign, each = campaign_of(plan, worker), worker.setting.trials
    if not plan.unqualified and not log.exists():
        require_fit(worker)
    with LogWriter(log, campaign) as writer:
        show(Progress(writer.done, campaign.trials))
        if not writer.is_whole:
            for trials in _pairs(worker, campaign, first=writer.done // each, jobs=jobs):
                for trial in trials:
                    if trial.n >= writer.done:
                        writer.add(trial)
                show(Progress(writer.done, campaign.trials))
            writer.end()
    return campaign


def require_fit(worker: _Worker) -> None:
    """Hold every baseline to what it claims, on a few pairs, before anything of it is scored.

    Raises:
        DefenseError: one stops benign work, or does not stop its own kind of attack.
    """
    from missionpair.defenses._qualify import qualify, slice_of

    for defense in worker.setting.defenses:
        if defense.name in _UNHELD:
            continue
        some = slice_of(worker.suite, [defense], most=FIT_PAIRS)
        # a suite without its own kind of attack says nothing against it
        unfit = [one for one in qualify(defense, some, worker.yard) if one.pair]
        if unfit:
            raise DefenseError(f"{unfit[0]} (score it all the same with `--unqualified`)")


def campaign_of(plan: Plan, worker: _Worker) -> Campaign:
    """Return the first line of the log."""
    suite, setting = worker.suite, worker.setting
    pairs = len(suite.pairs) if plan.pairs is None else min(plan.pairs, len(suite.pairs))
    return Campaign(
        schema=SCHEMA,
        suite=suite.name,
        suite_version=suite.version,
        suite_digest=worker.digest,
        pairs=pairs,
        planner=_named(setting.planner, plan.planner),
        attacker=_named(setting.attacker, plan.attacker),
        access=str(plan.access),
        defenses=tuple(
            _named(one, spec) for one, spec in zip(setting.defenses, plan.defenses, strict=True)
        ),
        seed=plan.seed,
        seeds=plan.seeds,
        rounds=plan.rounds,
        turns=plan.turns,
        kinds=tuple(map(str, plan.kinds)),
        weights=plan.weights.thousandths,
        trials=pairs * setting.trials,
        version=version("authguard-r"),
    )


class _Worker:
    """What one process or thread needs to run pairs.

    Planner and attacker are made anew for each pair, so that no pair knows of another one; a model
    that plans is one for all, and a model that writes one for each thread.

    Args:
        plan: what is asked for.
        suite: with its digest.
        folder: for keys; None makes one.
        live: the model, where there is one.
    """

    def __init__(
        self,
        plan: Plan,
        suite: tuple[Suite, str],
        folder: Path | None = None,
        live: Planner | None = None,
    ) -> None:
        self.plan = plan
        self.suite, self.digest = suite
        self._live = live
        self._writer: Attacker | None = None
        self.setting = self._made()
        self.is_live = is_asked(self.setting.planner)
        if self.is_live:
            self._live = self.setting.planner
        self.yard = Yard(folder)

    def twin(self, folder: Path) -> _Worker:
        """Return another one of the same suite, with keys of its own."""
        folder.mkdir()
        live = None if self._live is None else cast("Planner", _Waiting(self._live))
        return _Worker(self.plan, (self.suite, self.digest), folder, live)

    def close(self) -> None:
        """Remove the keys."""
        self.yard.close()

    def trials(self, number: int) -> list[Trial]:
        """Return the trials of one pair, run."""
        pair, setting = self.suite.pairs[number], self._made()
        layout, first = self.suite.layouts[pair.layout], number * setting.trials
        return list(PairRun(setting, self.yard, pair, layout, first=first).trials())

    def _made(self) -> Setting:
        plan = self.plan
        if self._writer is None:
            attacker = registry.make(attackers, plan.attacker)
            self._writer = attacker if is_asked(attacker) else None
        return Setting(
            planner=self._live or registry.make(planners, plan.planner),
            attacker=self._writer or attacker,
            access=plan.access,
            defenses=_apart(plan.defenses),
            rounds=plan.rounds,
            turns=plan.turns,
            seed=plan.seed,
            seeds=plan.seeds,
            kinds=plan.kinds,
            weights=plan.weights,
        )


def _apart(specs: tuple[str, ...]) -> tuple[Defense, ...]:
    """Return the defenses, each with a name of its own in the log.

    Raises:
        UnknownNameError: there is no such one, or two have one name.
    """
    made = tuple(registry.make(defenses, spec) for spec in specs)
    names = [defense.name for defense in made]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise registry.UnknownNameError(f"two defenses are called `{twice}`: give each its own log")
    return made


def is_asked(thing: object) -> bool:
    """True of a planner or an attacker that asks a model, whoever answers in its place."""
    return hasattr(thing, "client") or hasattr(thing, "cost_microusd")


class _Waiting:
    """A model that is waited for: whoever waits lets the others work.

    Everything of ours is done by one thread at a time: the decoder of a type that two threads use
    for the first time at once is not safe, and a campaign on models waits, and hardly works.

    Args:
        planner: the model.
    """

    def __init__(self, planner: Planner) -> None:
        self._planner = planner

    def __getattr__(self, name: str) -> Any:
        return getattr(self._planner, name)

    def propose(self, briefing: Briefing, *, seed: int) -> Reply:
        """Ask the model, and hold nothing meanwhile."""
        _ONE.release()
        try:
            return self._planner.propose(briefing, seed=seed)
        finally:
            _ONE.acquire()


def _pairs(worker: _Worker, campaign: Campaign, *, first: int, jobs: int) -> Iterator[list[Trial]]:
    """Yield the trials of every pair from the first on, in order."""
    numbers = range(first, campaign.pairs)
    if jobs == 1:
        yield from map(worker.trials, numbers)
        return
    rest = iter(numbers)
    if worker.is_live:  # the first one alone, so that every decoder was used once
        yield from map(worker.trials, islice(rest, 1))
    with _pool(worker, jobs) as pool:
        waiting: deque[Future[list[Trial]]] = deque()
        for number in islice(rest, jobs * _AHEAD):
            waiting.append(pool.submit(_trials, number))
        while waiting:
            yield waiting.popleft().result()
            for number in islice(rest, 1):
                waiting.append(pool.submit(_trials, number))


@contextmanager
def _pool(worker: _Worker, jobs: int) -> Iterator[Executor]:
    """Give processes, or threads where a model is waited for; what has not begun is given up.

    A process takes over the suite that is loaded here; its keys lie in a folder of its own.
    """
    pool: Executor
    with TemporaryDirectory(prefix="missionpair-") as folder:
        begin = partial(_begin, worker, Path(folder))
        if worker.is_live:
            pool = ThreadPoolExecutor(jobs, initializer=begin)
        else:
            pool = ProcessPoolExecutor(jobs, mp_context=get_context("fork"), initializer=begin)
        try:
            yield pool
        finally:
            pool.shutdown(cancel_futures=True)


_OF_THIS = local()
#: Held by the thread that works.
_ONE = Lock()


def _begin(worker: _Worker, folder: Path) -> None:
    with _ONE:
        _OF_THIS.worker = worker.twin(folder / f"{getpid()}-{get_ident()}")


def _trials(number: int) -> list[Trial]:
    with _ONE:
        trials: list[Trial] = _OF_THIS.worker.trials(number)
    return trials


def _named(thing: object, spec: str) -> Named:
    parameters = dict(getattr(thing, "parameters", {}))
    return Named(
        name=str(getattr(thing, "name", spec.partition(":")[0])),
        simulated=bool(getattr(thing, "simulated", False)),
        parameters=parameters,
    )
