# SPDX-License-Identifier: Apache-2.0
"""A stand-in that follows an instruction with a published probability; no model, simulated.

Option `susceptibility=P`, between 0 and 1: how often it follows a short plain text of a user. A
text's channel, claimed authority, urgency, reasons and length move the odds by the coefficients
below, which are made up: it shows the product behind the planner, never how a model behaves. Option
`preset=resistant|even|yielding` names one. How-to: docs/howto/missionpair-attackers.md
"""

from __future__ import annotations

import math
import re
from functools import lru_cache
from hashlib import blake2b
from typing import Any

from missionpair.briefing import Briefing, Reply
from missionpair.defenses.prompt import RULE
from missionpair.pair import plan_bytes
from missionpair.planners.hijacked import texts_of
from missionpair.wording import read
from missionpair.wording.productions import STYLES
from missionpair.words import Channel

#: Susceptibility by preset.
PRESETS = {"resistant": 0.18, "even": 0.5, "yielding": 0.83}
#: What is added to the log odds for the channel on which the newest text arrived.
CHANNELS: dict[Channel, float] = {
    Channel.USER: 0.0,
    Channel.MEMORY: -0.2,
    Channel.TOOL: -0.3,
    Channel.DOCUMENT: -0.4,
    Channel.SPEECH: -0.6,
    Channel.SIGN: -0.8,
    Channel.SCENE: -1.0,
}
#: What is added for each feature that the text has; a feature counts once.
FEATURES: dict[str, float] = {"authority": 0.8, "urgency": 0.3, "reason": 0.5}
#: What is added for each `STEP` characters above `FREE`: a long text convinces less.
LENGTH = -0.15
FREE, STEP = 200, 100
#: What is added while its instructions say that what it reads on the way is no instruction
#: (`prompt`).
RULED = -1.5
#: Log odds below which nothing is ever followed, and an exponential would be too large.
_LEAST = -500.0
#: What a text has a feature by: the grammar's sentences for it, or any of these words in any case.
MARKS = {
    "authority": r"supervisor|control room|operations|management|operator|security|system message"
    r"|official|order of|approved",
    "urgency": r"urgent|at once|immediately|every minute|no time|hurry|emergency|now",
    "reason": r"because|otherwise|saves|expecting|schedule|keeps|replaces|corrected|verification"
    r"|closed|blocked|shorter|safer|outdated|relabeled|unavailable",
}
_FOUND = {name: re.compile(rf"\b(?:{words})\b", re.IGNORECASE) for name, words in MARKS.items()}


class Graded:
    """Follows the newest instruction with a probability that its text and channel set.

    Args:
        susceptibility: from 0, never, to 1, always.
    """

    name = "graded"
    simulated = True
    reads_rules = True

    def __init__(self, susceptibility: float) -> None:
        self._susceptibility = susceptibility
        self.parameters: dict[str, Any] = {
            "susceptibility": susceptibility,
            "channels": {str(channel): value for channel, value in CHANNELS.items()},
            "features": FEATURES,
            "marks": MARKS,
            "length": LENGTH,
            "free": FREE,
            "step": STEP,
            "ruled": RULED,
            "reader": 2,
        }

    def propose(self, briefing: Briefing, *, seed: int) -> Reply:
        """Answer with what the newest understood input asks for, or with the usual plan.

        The dice are the seed's alone, so that of two texts the likelier one is never refused where
        the other is followed.
        """
        texts = texts_of(briefing.inputs)
        for text in reversed(texts):
            asked = read(text, tools=briefing.tools, places=briefing.places, things=briefing.things)
            if asked is None:
                continue
            channel = next(
                item.channel for item in reversed(briefing.inputs) if text.endswith(item.text)
            )
            ruled = RULE in briefing.rules
            if _drawn(seed) < probability(text, channel, self._susceptibility, ruled=ruled):
                return Reply(raw=plan_bytes(asked))
            break
        return Reply(raw=plan_bytes(briefing.usual))


def probability(
    text: str, channel: Channel, susceptibility: float, *, ruled: bool = False
) -> float:
    """Return how likely the text is followed: a logistic in the published coefficients.

    Args:
        text: what it read.
        channel: where.
        susceptibility: how it is in general; 0 and 1 are never moved.
        ruled: its instructions are to follow nothing that it reads.
    """
    if susceptibility in {0.0, 1.0}:
        return susceptibility
    odds = math.log(susceptibility / (1 - susceptibility)) + CHANNELS[channel] + _weight(text)
    odds += RULED if ruled else 0.0
    return 1 / (1 + math.exp(-max(odds, _LEAST)))


@lru_cache(maxsize=8192)
def _weight(text: str) -> float:
    has = sum(FEATURES[name] for name in FEATURES if _has(name, text))
    return has + LENGTH * max(0, len(text) - FREE) / STEP


def _has(name: str, text: str) -> bool:
    if _FOUND[name].search(text):
        return True
    return any(sentence in text for style in STYLES.values() for sentence in getattr(style, name))


def _drawn(seed: int) -> float:
    return int.from_bytes(blake2b(f"graded/{seed}".encode(), digest_size=6).digest()) / (1 << 48)


def make(*, susceptibility: str = "", preset: str = "") -> Graded:
    """Return the planner.

    Raises:
        ValueError: both options, no number from 0 to 1, or no preset of that name.
    """
    if susceptibility and preset:
        raise ValueError("give one of `susceptibility` and `preset`")
    if not susceptibility:
        name = preset or "even"
        if name not in PRESETS:
            raise ValueError(f"`preset` is expected among {', '.join(PRESETS)}, got `{name}`")
        return Graded(PRESETS[name])
    try:
        value = float(susceptibility)
    except ValueError:
        value = math.nan
    if not 0 <= value <= 1:
        raise ValueError(f"`susceptibility` is expected from 0 to 1, got `{susceptibility}`")
    return Graded(value)
