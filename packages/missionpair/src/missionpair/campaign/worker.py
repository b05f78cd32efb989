# SPDX-License-Identifier: Apache-2.0
"""What one process or thread of a campaign has: suite, keys, planner, attacker and defenses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple, cast

from missionpair import attackers, defenses, planners, registry
from missionpair.attackers import Attacker, AttackerError
from missionpair.briefing import Briefing, Planner, PlannerError, Reply
from missionpair.campaign.arms import is_asked
from missionpair.campaign.plan import CampaignPlan, PlanError
from missionpair.campaign.setting import Participants, Setting
from missionpair.campaign.trial import PairRun
from missionpair.defenses import Defense, DefenseError
from missionpair.pair import Pair, Suite
from missionpair.records import Campaign, Trial
from missionpair.stage import Yard
from missionpair.words import TrialKind

#: Held by the thread that works.
ONE = Lock()


class TrialResult(NamedTuple):
    """One trial, and why no answer came in it; None when one did."""

    trial: Trial
    failure: PlannerError | AttackerError | None = None


class Worker:
    """What one process or thread needs to run pairs.

    Planner and attacker are made anew for each pair, so that no pair knows of another one; a model
    that plans is one for all, and a model that writes one for each thread.

    Args:
        plan: what is asked for.
        suite: with its digest.
        folder: for keys.
        live: the model, where there is one.
    """

    def __init__(
        self,
        plan: CampaignPlan,
        suite: tuple[Suite, str],
        folder: Path,
        live: Planner | None = None,
    ) -> None:
        self.plan = plan
        self.suite, self.digest = suite
        self._live = live
        #: Trials below this number are in the log.
        self.done = 0
        #: Defenses that are held to the benign run of each pair, by the log's first line.
        self.held: frozenset[str] = frozenset()
        self._writer: Attacker | None = None
        self.setting = self._made()
        for part in (self.setting.planner, self.setting.attacker):
            if (getattr(part, "suite_digest", None) or self.digest) != self.digest:
                text = f"is of another suite than `{plan.suite}`, or of another version of it"
                raise PlanError(f"`{part.name}` {text}: take the suite of its log")
            require_same_setup(part, plan)
        require_known(self.setting.planner, self.suite)
        taken = plan.taken(self.suite.pairs)
        #: Those that are tried; a planner that answers from a record knows some of them alone.
        self.pairs = known_to(self.setting.planner, taken, plan.kinds)
        self.skipped = len(taken) - len(self.pairs)
        if hasattr(self.setting.planner, "knows") and plan.seeds > 1:
            text = "has one reply for each trial, which several seeds would count several times"
            raise PlanError(f"`{self.setting.planner.name}` {text}: run with `--seeds 1`")
        #: The time of a planner is waiting, not computing.
        self.is_live = is_asked(self.setting.planner)
        if self.is_live:
            self._live = self.setting.planner
        folder.mkdir()
        self.yard = Yard(folder, field_weights=self.plan.field_weights)

    @property
    def is_paid(self) -> bool:
        """A model answers in some part: what it said is not to be had a second time for nothing."""
        return self.is_live or self._writer is not None

    def twin(self, folder: Path) -> Worker:
        """Return another one of the same suite, with keys of its own."""
        live = None if self._live is None else cast("Planner", _WaitingModel(self._live))
        made = Worker(self.plan, (self.suite, self.digest), folder, live)
        made.done, made.held = self.done, self.held
        return made

    def trials(self, number: int) -> Iterator[TrialResult]:
        """Yield the trials of one pair, each as soon as it was run.

        Raises:
            PlannerError: no later trial would be without this failure.
            AttackerError: as `PlannerError`.
            StageError: the pair cannot be made real.
            DefenseError: a baseline stops the pair's benign run.
        """
        pair, setting = self.pairs[number], self._made()
        layout, first = self.suite.layouts[pair.layout], number * setting.trials
        run = PairRun(setting, self.yard, pair, layout, first=first, done=self.done, held=self.held)
        for trial in run.trials():
            yield TrialResult(trial, run.failure)

    def _made(self) -> Setting:
        plan, who = self.plan, self._who()
        made = apart(plan.defenses)
        if not plan.unqualified:
            require_reader(who.planner, made)
        return Setting(
            planner=who.planner,
            attacker=who.attacker,
            access=plan.access,
            defenses=made,
            rounds=plan.rounds,
            turns=plan.turns,
            seed=plan.seed,
            seeds=plan.seeds,
            kinds=plan.kinds,
            weights=plan.weights,
            fresh=self._who,
        )

    def _who(self) -> Participants:
        """Return planner and attacker, made anew unless they are models."""
        attacker = self._writer or registry.make(attackers, self.plan.attacker)
        self._writer = attacker if is_asked(attacker) else None
        return Participants(self._live or registry.make(planners, self.plan.planner), attacker)


def known_to(
    planner: Planner, pairs: tuple[Pair, ...], kinds: tuple[TrialKind, ...]
) -> tuple[Pair, ...]:
    """Return the pairs that a planner can answer in each kind of trial; most planners all.

    Raises:
        PlannerError: none.
    """
    knows = getattr(planner, "knows", None)
    if knows is None:
        return pairs
    found = tuple(pair for pair in pairs if knows(pair.id, tuple(map(str, kinds))))
    if not found:
        text = f"has no pair with replies to each of {', '.join(kinds)}, and to as many rounds"
        text += " without the attack as with it: choose kinds with `--kind`"
        raise PlannerError(text, code="file", where=planner.name)
    return found


def require_known(planner: Planner, suite: Suite) -> None:
    """Refuse recorded replies to pairs that the suite does not have.

    Raises:
        PlannerError: it names a pair that the suite does not have.
    """
    answered: frozenset[str] = getattr(planner, "answered", frozenset())
    unknown = answered - {pair.id for pair in suite.pairs}
    if unknown:
        text = f"answers `{min(unknown)[:80]}`, which is no pair of the suite"
        text += f"; {len(unknown)} such pairs: `missionpair list` prints those of a suite"
        raise PlannerError(text, code="file", where=planner.name)


def require_same_setup(part: Planner | Attacker, plan: CampaignPlan) -> None:
    """Refuse a campaign that asks what the replayed log does not answer.

    Raises:
        PlanError: it asks for other kinds of trial, more rounds or turns, another seed or access.
    """
    before: Campaign | None = getattr(part, "replayed", None)
    if before is None:
        return
    log = f"the log that `{part.name}` answers from"
    if hasattr(part, "propose"):
        missing = [kind for kind in plan.kinds if kind not in before.kinds]
        if missing:
            have = " ".join(f"--kind {kind}" for kind in before.kinds)
            raise PlanError(f"{log} has no trial of kind {', '.join(missing)}: run with {have}")
    for name in ("rounds", "turns", "seeds"):
        most = getattr(before, name)
        if getattr(plan, name) > most:
            raise PlanError(f"{log} has {name} {most}: run with `--{name} {most}` at most")
    for name in ("seed", "access"):
        value = getattr(before, name)
        if getattr(plan, name) != value:
            raise PlanError(f"{log} has {name} {value}: run with `--{name} {value}`")


def apart(specs: tuple[str, ...]) -> tuple[Defense, ...]:
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


def require_reader(planner: Planner, those: Iterable[Defense]) -> None:
    """Hold a defense that is a rule for its reader to a planner that reads rules.

    Raises:
        DefenseError: the planner reads none, so that its figures would say nothing of the defense.
    """
    for defense in those:
        if getattr(defense, "rule", "") and not getattr(planner, "reads_rules", False):
            raise DefenseError(
                f"`{defense.name}` is a rule for the planner, and `{planner.name}` reads none: "
                "take a model or `graded` (score it all the same with `--unqualified`)"
            )


class _WaitingModel:
    """A model that is waited for: the waiting trial lets the others work.

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
        ONE.release()
        try:
            return self._planner.propose(briefing, seed=seed)
        finally:
            ONE.acquire()
