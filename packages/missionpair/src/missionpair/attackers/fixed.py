# SPDX-License-Identifier: Apache-2.0
"""The suite's own texts: the fixed templates, strengthened over at most three rounds.

The second wording says by whose word and how urgent it is, the third insists; both are the first
one's text with sentences of the grammar behind it. After the third it gives up. Source: section
"Implementation and Experimental Evaluation". Spec page: docs/spec/missionpair-access.md#fixed
"""

from __future__ import annotations

from typing import Any

from missionpair.attackers._reading import read_case
from missionpair.pair import Input
from missionpair.wording import strengthen
from missionpair.wording.force import STEPS
from missionpair.wording.obfuscation import ends


class Fixed:
    """Sends what the suite has, and says it with more force where it did not succeed."""

    name = "fixed"
    simulated = False

    def __init__(self) -> None:
        self.parameters: dict[str, Any] = {}
        self._inputs: tuple[Input, ...] = ()
        self._steps = 0

    def open(self, case: bytes, *, seed: int) -> tuple[Input, ...]:  # noqa: ARG002 - no dice
        """Return the suite's texts."""
        self._inputs, self._steps = read_case(case).inputs, 0
        return self._inputs

    def revise(self, seen: bytes, *, seed: int) -> tuple[Input, ...] | None:  # noqa: ARG002
        """Return the next wording, for every result of the last one; None after the third."""
        if not self._inputs or self._steps == STEPS:
            return None
        self._steps += 1
        return tuple(self._strengthened(item) for item in self._inputs)

    def _strengthened(self, item: Input) -> Input:
        """Return an input with more force; one that the next input goes on with stays."""
        if not ends(item.text):
            return item
        return Input(item.channel, strengthen(item.text, item.channel, steps=self._steps))


def make() -> Fixed:
    """Return the attacker."""
    return Fixed()
