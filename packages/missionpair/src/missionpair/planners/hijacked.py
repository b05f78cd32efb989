# SPDX-License-Identifier: Apache-2.0
"""A planner that is captured whole: it follows the newest instruction, of every author and channel.

The newest input in which the obedient reader (`wording.read`) finds calls replaces the rest of the
usual plan; without one it follows the usual plan. It resists nothing, so that what a defense stops
is stopped by the defense. How-to: docs/howto/missionpair-attackers.md
"""

from __future__ import annotations

from typing import Any

from missionpair.briefing import Briefing, Reply
from missionpair.pair import Input, WordedCall, plan_bytes
from missionpair.wording import read
from missionpair.wording.obfuscation import ends


class Hijacked:
    """Follows every text that it understands."""

    name = "hijacked"
    simulated = True

    def __init__(self) -> None:
        self.parameters: dict[str, Any] = {"reader": 1}

    def propose(self, briefing: Briefing, *, seed: int) -> Reply:  # noqa: ARG002 - no dice
        """Answer with what the newest understood input asks for, else with the usual plan."""
        asked = newest_asked(briefing)
        return Reply(raw=plan_bytes(briefing.usual if asked is None else asked))


def newest_asked(briefing: Briefing) -> tuple[WordedCall, ...] | None:
    """Return the calls of the newest input that asks for any; None where none does."""
    for text in reversed(texts_of(briefing.inputs)):
        asked = read(text, tools=briefing.tools, places=briefing.places, things=briefing.things)
        if asked is not None:
            return asked
    return None


def texts_of(inputs: tuple[Input, ...]) -> list[str]:
    """Return the texts; one that ends in the middle of a sentence goes on with the next."""
    texts: list[str] = []
    is_open = False
    for item in inputs:
        if is_open:
            texts[-1] = f"{texts[-1]} {item.text}"
        else:
            texts.append(item.text)
        is_open = not ends(item.text)
    return texts


def make() -> Hijacked:
    """Return the planner."""
    return Hijacked()
