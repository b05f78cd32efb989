# SPDX-License-Identifier: Apache-2.0
"""What attack and control arm share: the dice, what is left to do, a text beside another one.

Spec page: docs/spec/measures.md#control
"""

from __future__ import annotations

from hashlib import sha256

from authguard_r.core.action import Action
from missionpair.judging import check
from missionpair.pair import Input, Pair, WordedCall, plan_bytes
from missionpair.stage import Stage
from missionpair.wording import STEPS, language_of, neutral, strengthen
from missionpair.words import ATTACKED, TrialKind


def rest_of(stage: Stage) -> tuple[WordedCall, ...]:
    """Return what is left of the mission in an attacked situation, as far as it can be done there.

    The longest end of what the pair says is left, or else of the benign plan, that can be carried
    out from here, every step authorized; empty when there is none.
    """
    plan = stage.pair.rest or stage.pair.benign.plan
    for number in range(len(plan)):
        checked = check(stage, plan_bytes(plan[number:]))
        if checked.executable and checked.deviation == 0:
            return plan[number:]
    return ()


def neutral_inputs(pair: Pair, seed: int, tries: int) -> tuple[Input, ...]:
    """Return what stands in the place of the pair's own texts: as long, and asking for nothing.

    Args:
        pair: the pair.
        seed: of the dice.
        tries: how many came before: a text is as long as the pair's own, strengthened as often.
    """
    found = []
    for number, item in enumerate(pair.inputs):
        length = len(strengthen(item.text, item.channel, steps=min(tries, STEPS)))
        dice = seed + tries + number
        text = neutral(item.channel, length, seed=dice, language=language_of(item.text))
        found.append(Input(item.channel, text))
    return tuple(found)


def seed_of(seed: int, pair: str, kind: TrialKind, number: int) -> int:
    """Return the dice of one trial; every defense, and the control arm, gets the same."""
    kind = TrialKind.ATTACK if kind in ATTACKED else kind
    return int.from_bytes(sha256(f"{seed}|{pair}|{kind}|{number}".encode()).digest()[:6])


def is_same_work(one: Action, other: Action) -> bool:
    """True when two actions do the same with the same thing at the same place."""
    return (one.type, one.object, one.destination) == (other.type, other.object, other.destination)


def is_asked(thing: object) -> bool:
    """True of a planner, an attacker or a defense that asks a model, or a stand-in for one."""
    return hasattr(thing, "client") or hasattr(thing, "cost_microusd")
