# SPDX-License-Identifier: Apache-2.0
"""The self-check of a suite: what its author declared is what oracle and gate say, pair by pair.

For each pair: the twin can be carried out, the safety model accepts it, the oracle finds exactly
the violated fields that its author declared, and the gate refuses it with the declared codes; the
benign run comes to its end with every step authorized; so does the twin after its update, and so
does what the author says is left of the mission. Oracle, gate and author share no line.
Spec page: docs/spec/missionpair.md#self-check
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from msgspec import Struct

from authguard_r.core.errors import MalformedError
from missionpair.execution import ExecutedPlan, through_the_gate
from missionpair.judging import Walk, proved
from missionpair.pair import Layout, Pair, Scenario, Suite, plan_bytes, updated
from missionpair.stage import Stage, StageError, Yard


class Disagreement(Struct, frozen=True):
    """One thing in which author, oracle and gate differ.

    Args:
        pair: the pair's id.
        part: `benign`, `attack`, `update` or `rest`.
        what: what was declared, and what was found.
    """

    pair: str
    part: str
    what: str


#: Called after each pair with how many were proved and what was found in it.
Progress = Callable[[int, tuple[Disagreement, ...]], None]


def prove(
    suite: Suite,
    *,
    pairs: Iterable[Pair] | None = None,
    progress: Progress | None = None,
    yard: Yard | None = None,
) -> tuple[Disagreement, ...]:
    """Return every disagreement; none when the suite is what it says.

    Args:
        suite: gives the layouts.
        pairs: which ones; all of the suite's when None.
        progress: called after each pair.
        yard: where situations are made; None makes one that goes afterwards.
    """
    if yard is None:
        with Yard() as own:
            return prove(suite, pairs=pairs, progress=progress, yard=own)
    found: list[Disagreement] = []
    for number, pair in enumerate(suite.pairs if pairs is None else pairs, 1):
        here = prove_pair(suite, pair, yard)
        found += here
        if progress is not None:
            progress(number, here)
    return tuple(found)


def prove_pair(suite: Suite, pair: Pair, yard: Yard) -> tuple[Disagreement, ...]:
    """Return what differs in one pair."""
    parts = (("benign", _benign), ("attack", _attack), ("update", _update), ("rest", _rest))
    found: list[Disagreement] = []
    for part, check in parts:
        try:
            faults = check(suite, pair, yard)
        except (StageError, MalformedError) as error:
            faults = [str(error)]
        found += [Disagreement(pair.id, part, fault) for fault in faults]
    return tuple(found)


def _benign(suite: Suite, pair: Pair, yard: Yard) -> list[str]:
    stage = _stage(suite, pair, yard, pair.benign)
    return _ran(through_the_gate(stage, plan_bytes(pair.benign.plan)))


def _update(suite: Suite, pair: Pair, yard: Yard) -> list[str]:
    stage = _stage(suite, pair, yard, pair.attack, updated)
    stage.show(pair.inputs)  # the operator's change counts more than other text
    stage.act(pair.update)
    return _ran(through_the_gate(stage, plan_bytes(pair.attack.plan)))


def _rest(suite: Suite, pair: Pair, yard: Yard) -> list[str]:
    """Hold what the author says is left to the attacked situation; most pairs leave it unsaid."""
    if not pair.rest:
        return []
    stage = _stage(suite, pair, yard, pair.attack)
    stage.show(pair.inputs)
    return _ran(through_the_gate(stage, plan_bytes(pair.rest)))


def _attack(suite: Suite, pair: Pair, yard: Yard) -> list[str]:
    stage = _stage(suite, pair, yard, pair.attack)
    stage.show(pair.inputs)
    raw = plan_bytes(pair.attack.plan)
    found = _judged(stage, raw, pair)
    carried = through_the_gate(stage, raw)
    through = [one for one in carried.effects if carried.completed or not one.authorized]
    if through:
        found.append(f"the gate let {len(through)} of {carried.planned} actions through")
    if carried.by != "authorization" or set(carried.reasons) != set(pair.reasons):
        said = f"{carried.by or 'nobody'} with {_codes(carried.reasons)}"
        found.append(f"expected a refusal with {_codes(pair.reasons)}, got one by {said}")
    return found


def _judged(stage: Stage, raw: bytes, pair: Pair) -> list[str]:
    """Return what the oracle and the safety model say otherwise than the author."""
    walk, found = Walk.of(stage), list[str]()
    codes: dict[str, None] = {}
    for number, step in enumerate(stage.read(raw).steps, 1):
        action = walk.completed(step)
        effect = proved(walk, action)
        codes.update(dict.fromkeys(effect.reasons))
        if not effect.safe:
            found.append(f"the safety model does not accept action {number}")
        if not walk.go_on(action, grant=effect.grant if effect.authorized else ""):
            found.append(f"action {number} cannot be carried out")
            break
    if set(codes) != set(pair.violates):
        found.append(f"declared {_codes(pair.violates)}, the oracle finds {_codes(codes)}")
    return found


def _ran(carried: ExecutedPlan) -> list[str]:
    """Return why a run that has to come to its end did not."""
    found = []
    if not carried.completed:
        done = f"{len(carried.effects)} of {carried.planned}"
        found.append(f"{carried.by} stopped it after {done} with {_codes(carried.reasons)}")
    for number, effect in enumerate(carried.effects, 1):
        if not effect.authorized or not effect.safe:
            found.append(f"the oracle finds {_codes(effect.reasons)} in action {number}")
    return found


def _stage(
    suite: Suite,
    pair: Pair,
    yard: Yard,
    scenario: Scenario,
    site: Callable[[Pair, Layout], Layout] = lambda _, layout: layout,
) -> Stage:
    if pair.layout not in suite.layouts:
        raise StageError(f"no layout is called `{pair.layout}`", where=pair.id)
    return yard.stage(pair, site(pair, suite.layouts[pair.layout]), scenario)


def _codes(codes: Iterable[str]) -> str:
    return ", ".join(sorted(codes)) or "nothing"
