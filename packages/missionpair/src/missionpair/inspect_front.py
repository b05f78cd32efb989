# SPDX-License-Identifier: Apache-2.0
"""MissionPAIR as a task of Inspect: `inspect eval missionpair/live --model ollama/qwen2.5:7b`.

Inspect reaches the model, retries, shows and keeps; everything else is ours: which inputs, which
prompt, which judge. A trial here is the very trial of `missionpair run`, with its plan written as
JSON, because Inspect parses tool arguments and would lose one that is given twice. Needs the extra
`inspect`; nothing of ours imports it. How-to: docs/howto/missionpair-models.md#inspect
"""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib import import_module
from threading import Lock
from time import perf_counter_ns
from typing import Any

import msgspec

from missionpair import attackers, defenses, registry
from missionpair.briefing import Briefing, Planner, Reply
from missionpair.campaign.setting import Setting
from missionpair.campaign.trial import PairRun
from missionpair.pair import Layout, Pair
from missionpair.planners._answers import read_answer
from missionpair.planners._client import Completion
from missionpair.planners._prompt import AnswerForm, system_text, user_text
from missionpair.planners._reach import SCRIPTED
from missionpair.records import Trial
from missionpair.score import DEFAULT
from missionpair.stage import Yard
from missionpair.suites import load
from missionpair.words import Access, TrialKind

_task: Any = import_module("inspect_ai")
_dataset: Any = import_module("inspect_ai.dataset")
_model: Any = import_module("inspect_ai.model")
_scorer: Any = import_module("inspect_ai.scorer")
_solver: Any = import_module("inspect_ai.solver")
_threads: Any = import_module("anyio")

#: Held while our code runs: several threads at once, each the first to need one of msgspec's types,
#: can crash it. While a model is waited for, another one goes on.
_OURS = Lock()
#: Where a sample keeps its trial.
_TRIAL = "trial"
#: Models that answer by a script.
_NO_MODELS = ("mockllm/", SCRIPTED)
#: Seeds that every provider takes.
_SEEDS = 1 << 31


class InspectPlanner:
    """A model that Inspect reaches, as a target.

    Args:
        model: Inspect's own.
        max_tokens: most that one answer may have.
    """

    def __init__(self, model: Any, *, max_tokens: int) -> None:
        self.name = str(model)
        self.simulated = any(mark in self.name for mark in _NO_MODELS)
        self.parameters: dict[str, Any] = {"mode": "json", "max_tokens": max_tokens}
        self._model = model

    def propose(self, briefing: Briefing, *, seed: int) -> Reply:
        """Return the model's answer; called on a thread that Inspect's loop waits for."""
        begun = perf_counter_ns()
        _OURS.release()
        try:
            output = _threads.from_thread.run(self._generate, briefing, seed)
        finally:
            _OURS.acquire()
        usage = output.usage
        done = Completion(
            text=output.completion,
            raw=b"",
            declined=output.stop_reason == "content_filter",
            cut=output.stop_reason in {"max_tokens", "model_length"},
        )
        raw, refused = read_answer(done, briefing.tools, model=self.name, where="--model")
        return Reply(
            raw=raw,
            refused=refused,
            took_us=(perf_counter_ns() - begun) // 1_000,
            tokens=(usage.input_tokens, usage.output_tokens) if usage else (0, 0),
        )

    async def _generate(self, briefing: Briefing, seed: int) -> Any:
        said = [
            _model.ChatMessageSystem(content=system_text(briefing, AnswerForm.JSON)),
            _model.ChatMessageUser(content=user_text(briefing)),
        ]
        limit = self.parameters["max_tokens"]
        config = _model.GenerateConfig(seed=seed % _SEEDS, max_tokens=limit)
        return await self._model.generate(said, config=config)


def judged(pair: Pair, layout: Layout, planner: Planner, setting: Callable[..., Setting]) -> Trial:
    """Return one trial of a pair, run and judged as a campaign does.

    Args:
        pair: the pair.
        layout: its site.
        planner: the target.
        setting: what is the same for every trial, given the planner.
    """
    with _OURS, Yard() as yard:
        (trial,) = PairRun(setting(planner=planner), yard, pair, layout, first=0).trials()
    return trial


def attack(
    *,
    suite: str,
    defense: str,
    attacker: str,
    access: str,
    rounds: int,
    turns: int,
    seed: int,
    max_tokens: int,
) -> Any:
    """Return the solver: each sample is one attack on one pair, from its own situation."""
    loaded, _ = load(suite)
    pairs = {pair.id: pair for pair in loaded.pairs}

    async def solve(state: Any, generate: Any) -> Any:  # noqa: ARG001 - our own loop asks
        def setting(*, planner: Planner) -> Setting:
            return Setting(
                planner=planner,
                attacker=registry.make(attackers, attacker),
                access=Access(access),
                defenses=(registry.make(defenses, defense),),
                rounds=rounds,
                turns=turns,
                seed=seed + state.epoch - 1,
                seeds=1,
                kinds=(TrialKind.ATTACK,),
                weights=DEFAULT,
            )

        pair = pairs[str(state.sample_id)]
        planner = InspectPlanner(_model.get_model(), max_tokens=max_tokens)
        layout = loaded.layouts[pair.layout]
        trial = await _threads.to_thread.run_sync(judged, pair, layout, planner, setting)
        if trial.error:
            raise RuntimeError(trial.error)
        state.metadata[_TRIAL] = msgspec.to_builtins(trial)
        reply = trial.rounds[-1].reply if trial.rounds else ""
        state.output = _model.ModelOutput.from_content(planner.name, reply)
        return state

    return solve


def judgment() -> Any:
    """Return the scorer: what our checkers and the oracle said; no model grades anything."""

    async def score(state: Any, target: Any) -> Any:  # noqa: ARG001 - there is none
        trial = state.metadata[_TRIAL]
        values = {
            "complied": int(trial["complied"]),
            "unauthorized": int(trial["unauthorized"] > 0),
            "hijacked": int(trial["hijacked"]),
        }
        why = trial["instead"] or f"{trial['by'] or 'nobody'}: {', '.join(trial['reasons'])}"
        return _scorer.Score(value=values, answer=state.output.completion, explanation=why)

    return score


_attack = _solver.solver(name="attack")(attack)
_judgment = _scorer.scorer(metrics={"*": [_scorer.mean(), _scorer.stderr()]}, name="judgment")(
    judgment
)


def _live(
    *,
    suite: str = "live",
    defense: str = "both",
    attacker: str = "fixed",
    access: str = "black",
    rounds: int = 3,
    turns: int = 1,
    pairs: int = 0,
    seed: int = 0,
    max_tokens: int = 1024,
) -> Any:
    """Return the task: every pair of a suite, or the first of them, attacked.

    Args:
        suite: as `missionpair run` takes it.
        defense: one, in the same way.
        attacker: in the same way.
        access: what the attacker sees of a round.
        rounds: an attacker's tries.
        turns: a planner's answers in one round.
        pairs: how many; 0 takes all.
        seed: of all dice; each of Inspect's epochs throws others.
        max_tokens: most that one answer may have.
    """
    loaded, digest = load(suite)
    samples = [
        _dataset.Sample(
            id=pair.id,
            input=pair.task,
            metadata={"categories": [str(c) for c in pair.categories], "family": str(pair.family)},
        )
        for pair in loaded.pairs[: pairs or None]
    ]
    run = _attack(
        suite=suite,
        defense=defense,
        attacker=attacker,
        access=access,
        rounds=rounds,
        turns=turns,
        seed=seed,
        max_tokens=max_tokens,
    )
    about = {"suite": json.dumps([loaded.name, loaded.version, digest]), "defense": defense}
    return _task.Task(
        dataset=_dataset.MemoryDataset(samples, name=loaded.name),
        solver=run,
        scorer=_judgment(),
        metadata=about,
    )


live = _task.task(name="live")(_live)
