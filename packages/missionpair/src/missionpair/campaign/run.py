# SPDX-License-Identifier: Apache-2.0
"""A whole campaign: every trial of every pair, on as many processes as asked for, into one log.

A deterministic campaign gives the same log for every number of processes, and for every number of
times that it was killed and resumed. How-to: docs/howto/missionpair.md
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

from missionpair import suites
from missionpair.campaign.ahead import Ahead
from missionpair.campaign.arms import is_asked
from missionpair.campaign.cluster import on_cluster
from missionpair.campaign.log import LogWriter, has_trials
from missionpair.campaign.plan import CampaignPlan, PlanError, Progress
from missionpair.campaign.team import Team
from missionpair.campaign.worker import TrialResult, Worker
from missionpair.defenses import DefenseError
from missionpair.records import SCHEMA, Campaign, NamedPart, Qualified, Trial

__all__ = ["CampaignPlan", "Progress", "run"]

#: Defenses that are no baseline: nothing, and the product itself.
_UNHELD = frozenset({"both", "mission", "none"})
#: So many trials in a row without an answer end a campaign, which can be resumed.
MOST_SILENT = 3
#: Trials between two words of progress.
SHOWN = 200


def run(
    plan: CampaignPlan,
    log: Path,
    *,
    jobs: int = 1,
    ray: str = "",
    show: Callable[[Progress], None] = lambda _: None,
) -> Campaign:
    """Run what is not in the log yet, and return what was run.

    Every trial is in the log at the latest half a second after it and all before it were run,
    however the campaign ends.

    Args:
        plan: what is asked for.
        log: where the trials go; one of the same plan goes on where it was cut off.
        jobs: processes; threads where a model is waited for.
        ray: address of a Ray cluster that runs the pairs; empty: this machine does.
        show: called with the progress.

    Raises:
        ClusterError: the cluster cannot be had, or lost a pair for good.
        PlanError: a cluster was to ask a model.
        LogError: the log cannot be written, or is of another campaign.
        SuiteError: no such suite, or a broken one.
        UnknownNameError: no such planner, attacker or defense, or no such option.
        DefenseError: a baseline does not do what it claims.
        PlannerError: the model cannot be had at all, or answers nothing.
        AttackerError: as `PlannerError`, of the one that writes.
        StageError: a pair cannot be made real.
    """
    with TemporaryDirectory(prefix="missionpair-") as folder:
        worker = Worker(plan, suites.load(plan.suite), Path(folder) / "first")
        if ray and (worker.is_paid or any(map(is_asked, worker.setting.defenses))):
            text = "`--ray` does not support planners, attackers or defenses that ask a model"
            raise PlanError(f"{text}: use `--jobs`")
        return _run(worker, log, Path(folder), (jobs, ray), show)


def _run(
    worker: Worker,
    log: Path,
    folder: Path,
    by: tuple[int, str],
    show: Callable[[Progress], None],
) -> Campaign:
    jobs, ray = by
    is_held = not worker.plan.unqualified and not has_trials(log)
    qualified = require_fit(worker) if is_held else ()
    with LogWriter(log, campaign_of(worker, qualified)) as writer:
        campaign = writer.campaign
        show(Progress(writer.done, campaign.trials))
        if writer.is_whole:
            return campaign
        worker.done = writer.done
        # a resumed log keeps what its first line says; other options do not count
        worker.held = frozenset(one.defense for one in campaign.qualified if one.pairs)
        # what a model said is paid for, and outlasts this run; the rest is only run again
        ahead = Ahead(_beside(log) if worker.is_paid else folder / "ahead", campaign)
        begun = writer.done // worker.setting.trials
        numbers = iter(range(begun, campaign.pairs))
        jobs = min(jobs, campaign.pairs - begun)
        with Team(worker, folder, ahead, jobs, writer.forget) as team:
            if ray:
                found = on_cluster(worker, ray, numbers)
            else:
                found = alone(worker, ahead, numbers) if jobs == 1 else team.in_order(numbers)
            for trial in answered(found):
                if trial.n < writer.done:
                    continue
                writer.add(trial)
                if writer.done % SHOWN == 0:
                    show(Progress(writer.done, campaign.trials))
        writer.end()
        ahead.remove()
        show(Progress(writer.done, campaign.trials))
    return campaign


def alone(worker: Worker, ahead: Ahead, numbers: Iterable[int]) -> Iterator[TrialResult]:
    """Yield the trials of these pairs, run one after the other."""
    for number in numbers:
        kept = ahead.kept(number) if worker.is_paid else ()
        yield from kept or worker.trials(number)


def answered(found: Iterable[TrialResult]) -> Iterator[Trial]:
    """Yield trials, but none of those at the end without an answer.

    A trial without an answer waits until a later one has one. So a model that is away leaves no
    trial that a second start would not ask for again.

    Raises:
        PlannerError: no answer in `MOST_SILENT` trials in a row, at all, or, when the model cannot
            be reached, in the last one.
        AttackerError: as `PlannerError`.
    """
    waiting: list[TrialResult] = []
    is_heard = False
    for ran in found:
        waiting.append(ran)
        if ran.failure is None:
            is_heard = True
            yield from (one.trial for one in waiting)
            waiting.clear()
        elif len(waiting) == MOST_SILENT:
            raise ran.failure
    for ran in waiting[-1:]:
        if ran.failure is not None and (not is_heard or ran.failure.code == "unreachable"):
            raise ran.failure
    yield from (one.trial for one in waiting)


def require_fit(worker: Worker) -> tuple[Qualified, ...]:
    """Hold every baseline to what it claims before the first trial; return to how much.

    The benign runs of the campaign's own pairs follow with their pairs (`PairRun`): all of them
    before the start would cost as much as the benign trials themselves.

    Raises:
        DefenseError: one stops benign work, or does not stop its own kind of attack.
    """
    from missionpair.defenses._qualify import hold

    held: list[Qualified] = []
    for defense in worker.setting.defenses:
        if defense.name in _UNHELD:
            continue
        found = hold(defense, worker.suite, worker.yard)
        if found.unfit:
            text = "score it all the same with `--unqualified`"
            raise DefenseError(f"{found.unfit[0]} ({text})")
        held.append(
            Qualified(
                defense=defense.name,
                benign=found.benign,
                own=found.own,
                pairs=len(worker.pairs),
                held_as=defense.claim.fit_as,
            )
        )
    return tuple(held)


def campaign_of(worker: Worker, qualified: tuple[Qualified, ...] = ()) -> Campaign:
    """Return the first line of the log."""
    plan, setting, pairs = worker.plan, worker.setting, len(worker.pairs)
    return Campaign(
        schema=SCHEMA,
        suite=worker.suite.name,
        suite_version=worker.suite.version,
        suite_digest=worker.digest,
        pairs=pairs,
        every=plan.every,
        skipped=worker.skipped,
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
        field_weights={str(field): weight for field, weight in plan.field_weights.items()},
        trials=pairs * setting.trials,
        version=version("authguard-r"),
        qualified=qualified,
    )


def _beside(log: Path) -> Path:
    return log.with_name(f"{log.name}.ahead")


def _named(thing: object, spec: str) -> NamedPart:
    parameters = dict(getattr(thing, "parameters", {}))
    return NamedPart(
        name=str(getattr(thing, "name", spec.partition(":")[0])),
        simulated=bool(getattr(thing, "simulated", False)),
        parameters=parameters,
    )
