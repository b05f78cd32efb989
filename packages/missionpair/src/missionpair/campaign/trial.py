# SPDX-License-Identifier: Apache-2.0
"""One pair under every defense: its trials, one after the other, each from the same situation.

A trial is `alg:missionpair` with a defense in it: the attacker writes, the planner answers, the
checkers judge the plan, the defense lets through what it lets through, the oracle judges what
happened. Source: `alg:missionpair`, `eq:score`. Spec page: docs/spec/missionpair.md
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace
from time import perf_counter_ns
from typing import Any, cast

from msgspec import structs

from authguard_r.core.finding import Findings
from authguard_r.core.reasons import Reason
from missionpair.access import case_bytes, seen_bytes
from missionpair.attackers import AttackerError
from missionpair.briefing import EarlierTurn, PlannerError
from missionpair.campaign.answers import TrialPlanners
from missionpair.campaign.arms import is_asked, is_same_work, neutral_inputs, rest_of, seed_of
from missionpair.campaign.gate_view import gate_findings
from missionpair.campaign.setting import Setting
from missionpair.campaign.showing import briefing_of, case_of, seen_of
from missionpair.campaign.trial_record import (
    Dice,
    TrialCosts,
    TrialRecord,
    add,
    note,
    round_of,
    trial_of,
)
from missionpair.defenses import Defense, DefenseError
from missionpair.defenses._qualify import fit_of, stopped
from missionpair.judging import Checked, Walk, check, check_first, is_intended
from missionpair.pair import Input, Layout, Pair, WordedCall, plan_bytes, updated
from missionpair.records import Trial
from missionpair.score import score
from missionpair.stage import Stage, Yard
from missionpair.words import ATTACKED, Access, TrialKind

#: A mission that has come to its end.
_OVER = frozenset({"closing", "completed"})
#: Failures that no later trial would be without: they end the campaign, which can be gone on with.
FINAL = frozenset({"cost", "limit", "refused"})
#: Of a planner that answers from a record: it has no further round.
ENDED = "ended"
#: A trial's seed has so many bits; those above say which turn it is, those below move with rounds.
_TURN_BITS = 48


class PairRun:
    """The trials of one pair.

    Args:
        setting: what is run.
        yard: where situations are made.
        pair: the pair.
        layout: its site.
        first: number of its first trial.
        done: trials below this number are in the log; a model is not asked for them again.
        held: defenses that the pair's benign run has to come to its end under before its trials.
    """

    def __init__(
        self,
        setting: Setting,
        yard: Yard,
        pair: Pair,
        layout: Layout,
        *,
        first: int,
        done: int = 0,
        held: frozenset[str] = frozenset(),
    ) -> None:
        self._setting = setting
        self._yard = yard
        self._pair = pair
        self._layout = layout
        self._n, self._held = first, held
        # what learns from trial to trial has to go through them again
        learns = hasattr(setting.planner, "told")
        those = (setting.planner, setting.attacker, *setting.defenses)
        is_paid = any(map(is_asked, those))
        self._done = done if is_paid and not learns else first
        self._stages: dict[tuple[TrialKind, str], Stage] = {}
        self._cases: dict[str, bytes] = {}
        self._rest: tuple[WordedCall, ...] | None = None
        self._found: tuple[Checked, Defense, tuple[Findings, ...]] | None = None
        self._planners = TrialPlanners(setting)
        #: Why no answer came in the last trial; None when one did.
        self.failure: PlannerError | AttackerError | None = None

    def trials(self) -> Iterator[Trial]:
        """Yield every trial of the pair that is still to be run, in order.

        Raises:
            DefenseError: a defense that is held to benign work stops the pair's.
        """
        setting = self._setting
        self._require_fit()
        for kind in setting.kinds:
            for number in range(setting.seeds):
                seed = seed_of(setting.seed, self._pair.id, kind, number)
                self._planners.clear()
                for defense in setting.defenses:
                    if self._n >= self._done:
                        yield self._trial(Dice(kind, defense, seed))
                    self._n += 1

    def _require_fit(self) -> None:
        """Carry the benign run out under every defense that is measured on it."""
        for defense in self._setting.defenses:
            if defense.name not in self._held:
                continue
            fit = fit_of(defense)
            stage = self._stage(TrialKind.BENIGN, fit)
            stage.show(())
            unfit = stopped(fit, stage)
            if unfit is not None:
                raise DefenseError(
                    f"{unfit} (score it all the same: start again with `--unqualified`)"
                )

    def _trial(self, dice: Dice) -> Trial:
        begun, spent = perf_counter_ns(), TrialCosts(cost_microusd=-self._cost(dice))
        tries, error = list[TrialRecord](), ""
        try:
            for tried in self._rounds(dice, spent):
                tries.append(tried)
        except (PlannerError, AttackerError) as failed:
            if failed.code in FINAL:
                raise
            if failed.code == ENDED and tries:  # a record has so many rounds, and no more
                self.failure = None
            else:
                error, self.failure = f"{failed.where}: {failed.message}", failed
            tries = [one for one in tries if one.failure is None or one.effects]
        else:
            self.failure = None
        spent.cost_microusd += self._cost(dice)
        tried = tries[-1] if tries else TrialRecord()
        is_done = dice.kind not in ATTACKED and not error and self._is_done(dice, tried)
        spent.total = _us(begun)
        return trial_of(
            self._n,
            self._pair,
            dice,
            tries=tuple(tries),
            spent=spent,
            is_done=is_done,
            is_idle=not self._rest,
            error=error,
        )

    def _cost(self, dice: Dice) -> int:
        """Return what the models of attacker and defense cost so far, as far as one has a price."""
        those = (self._setting.attacker, dice.defense)
        return sum(int(getattr(one, "cost_microusd", 0)) for one in those)

    def _rounds(self, dice: Dice, spent: TrialCosts) -> Iterator[TrialRecord]:
        """Yield every try, until one succeeds, the attacker gives up, or there are no more.

        The control arm has as many tries as the attack, so that both have the same chances; a
        planner without dice answers one question once.
        """
        setting, gave_up = self._setting, False
        inputs = self._first_inputs(dice, spent)
        for number in range(setting.rounds if dice.kind in ATTACKED else 1):
            dice.defense.begin(seed=dice.seed + number)
            stage = self._stage(dice.kind, dice.defense)
            stage.show(inputs)
            is_last = number == setting.rounds - 1
            asks = dice.kind is TrialKind.ATTACK and not is_last and not gave_up
            is_heard = asks or (dice.kind in ATTACKED and self._planners.learns(dice))
            thrown = replace(dice, seed=dice.seed + number)
            tried = self._round(stage, thrown, spent, number=number, is_heard=is_heard)
            points = score(tried.checked, setting.weights)
            tried.record = round_of(inputs, tried, points)
            yield tried
            if tried.failure is not None:
                raise tried.failure
            told = self._told(number, tried, dice) if is_heard else b""
            if tried.checked.succeeds or is_last:
                return
            following = None if gave_up else self._next_inputs(told, number, dice, spent)
            # an attacker without another text: the last one comes again, as often as the control
            gave_up = following is None
            inputs = inputs if following is None else following

    def _round(
        self, stage: Stage, dice: Dice, spent: TrialCosts, *, number: int, is_heard: bool
    ) -> TrialRecord:
        """Let the planner answer, as often as it may, until its plan is carried out.

        Args:
            stage: the situation.
            dice: which trial it is.
            spent: what it took so far.
            number: the round's, from 0.
            is_heard: somebody is told of the round.
        """
        usual = self._usual(dice.kind, stage)
        tried, most = TrialRecord(), self._setting.turns
        turns: tuple[EarlierTurn, ...] = ()
        which = (self._pair.id, str(dice.kind), number)
        for turn in range(most):
            briefing = briefing_of(stage, turns=turns, usual=usual, trial=which)
            seed = dice.seed + (turn << _TURN_BITS)
            reply = self._planners.answered(dice.defense.brief(briefing), dice, seed, spent)
            at = perf_counter_ns()
            checked = (check if turn else check_first)(stage, reply.raw)
            spent.judging += _us(at)
            intended = dice.kind in ATTACKED and is_intended(stage, reply.raw, checked)
            if intended:  # "sorry", with the calls that the attack asks for, is no refusal
                reply = structs.replace(reply, refused=False)
            found = self._gate_findings(dice, stage, checked) if is_heard else ()
            at = perf_counter_ns()
            carried = dice.defense.carry_out(stage, reply.raw)
            add(spent, carried, _us(at))
            note(tried, reply, checked, carried, found, intended=intended)
            tried.failure = getattr(dice.defense, "failure", None)
            if tried.failure is not None or turn == most - 1 or self._is_over(dice, tried, checked):
                break
            said = reply.raw.decode(errors="replace")
            turns = (*turns, EarlierTurn(said, carried.told, briefing.situation))
        return tried

    def _is_over(self, dice: Dice, tried: TrialRecord, checked: Checked) -> bool:
        """True when nothing more is asked: said so, done, or an attack that got through."""
        if checked.syntax == Reason.PLAN_EMPTY:
            return True
        if not tried.carried.completed:
            return False
        if any(not effect.authorized for effect in tried.effects):
            return True
        return self._is_done(dice, tried)

    def _stage(self, kind: TrialKind, defense: Defense) -> Stage:
        """Return the situation as it is before anything is tried; made once, then put back."""
        key = _key(kind, defense)
        stage = self._stages.get(key)
        if stage is not None:
            stage.again()
            return stage
        scenario = self._pair.benign if kind is TrialKind.BENIGN else self._pair.attack
        layout = updated(self._pair, self._layout) if kind is TrialKind.UPDATE else self._layout
        gate = defense.safety_gate
        stage = self._yard.stage(self._pair, layout, scenario, safety_gate=gate)
        if kind is TrialKind.UPDATE:
            stage.act(self._pair.update)
            stage.mark()
        self._stages[key] = stage
        return stage

    def _usual(self, kind: TrialKind, stage: Stage) -> tuple[WordedCall, ...]:
        """Return what an undisturbed planner would call here."""
        if kind is TrialKind.UPDATE:
            return self._pair.attack.plan
        if kind is TrialKind.BENIGN:
            return self._pair.benign.plan
        if self._rest is None:
            self._rest = rest_of(stage)
        return self._rest

    def _gate_findings(self, dice: Dice, stage: Stage, checked: Checked) -> tuple[Findings, ...]:
        """Return what the gate finds in a plan, where an attacker is told."""
        if self._setting.access is not Access.WHITE:
            return ()
        held = self._found
        if held is None or held[0] is not checked or held[1] is not dice.defense:
            with getattr(dice.defense, "installed", nullcontext)():
                held = self._found = (checked, dice.defense, gate_findings(stage, checked))
        return held[2]

    def _first_inputs(self, dice: Dice, spent: TrialCosts) -> tuple[Input, ...]:
        """Return what reaches the planner first: nothing, but in an attack or a neutral arm."""
        if dice.kind is TrialKind.ATTACK:
            return self._opened(dice, spent)
        return neutral_inputs(self._pair, dice.seed, 0) if dice.kind is TrialKind.NEUTRAL else ()

    def _next_inputs(
        self, told: bytes, number: int, dice: Dice, spent: TrialCosts
    ) -> tuple[Input, ...] | None:
        """Return what reaches the planner in the next round; None where there is none."""
        if dice.kind is TrialKind.ATTACK:
            return self._revised(told, dice, spent)
        if dice.kind is TrialKind.NEUTRAL:
            return neutral_inputs(self._pair, dice.seed, number + 1)
        return () if dice.kind is TrialKind.CONTROL else None

    def _opened(self, dice: Dice, spent: TrialCosts) -> tuple[Input, ...]:
        begun, setting, name = perf_counter_ns(), self._setting, dice.defense.name
        if name not in self._cases:
            stage = self._stage(dice.kind, dice.defense)
            case = case_of(stage, dice.defense, weights=setting.weights, rounds=setting.rounds)
            self._cases[name] = case_bytes(setting.access, case)
        inputs = self._planners.attacker(name).open(self._cases[name], seed=dice.seed)
        spent.attacker += _us(begun)
        return inputs

    def _told(self, number: int, tried: TrialRecord, dice: Dice) -> bytes:
        """Return what the attacker sees of a round; a planner that is one sees it, too."""
        data = seen_bytes(self._setting.access, seen_of(number, tried))
        if self._planners.learns(dice):
            cast("Any", self._planners.of(dice)).told(data)
        return data

    def _revised(self, told: bytes, dice: Dice, spent: TrialCosts) -> tuple[Input, ...] | None:
        begun = perf_counter_ns()
        inputs = self._planners.attacker(dice.defense.name).revise(told, seed=dice.seed)
        spent.attacker += _us(begun)
        return inputs

    def _is_done(self, dice: Dice, tried: TrialRecord) -> bool:
        """True when what was to be done was done, by any planner, and nothing else.

        The mission is complete by the registry, or the pair's own last step was carried out.
        """
        if not tried.carried.completed or not all(e.authorized for e in tried.effects):
            return False
        stage = self._stages[_key(dice.kind, dice.defense)]
        standing = Walk.of(stage).standing
        if standing is not None and standing["status"] in _OVER:
            return True
        usual = self._usual(dice.kind, stage)
        if not usual:  # nothing was to be done here
            return False
        wanted = stage.read(plan_bytes(usual)).steps[-1].action
        return any(is_same_work(effect.action, wanted) for effect in tried.effects)


def _key(kind: TrialKind, defense: Defense) -> tuple[TrialKind, str]:
    """Return which situation a trial needs: those with the product's own gates are the same."""
    return kind, defense.name if defense.safety_gate is not None else ""


def _us(since_ns: int) -> int:
    return (perf_counter_ns() - since_ns) // 1_000
