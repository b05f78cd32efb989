# SPDX-License-Identifier: Apache-2.0
"""What stands between a planner and its robot: one file each, all of them behind one protocol.

Every defense says what it claims to stop, and is held to that before it is scored (`qualify`).
Spec page: docs/spec/defenses.md. How-to: docs/howto/missionpair-defenses.md
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, cast

from msgspec import Struct

from authguard_r.core.ports import SafetyGate
from missionpair import registry
from missionpair.briefing import Briefing
from missionpair.execution import ExecutedPlan
from missionpair.pair import Pair
from missionpair.stage import Stage
from missionpair.words import Category


class DefenseError(registry.SpecificationError):
    """A defense that is not available here, or not with these options; the text says what to do."""


class Claim(Struct, frozen=True, kw_only=True):
    """What a defense says that it stops.

    Args:
        text: in words, for people.
        blocks: categories of attack of which it stops every pair that `reasons` names.
        reasons: codes of the gate; a pair is of the defense's kind when its author says that the
            gate refuses it with one of them. Empty takes every pair of the categories.
        fields: of an action; a pair is of the defense's kind when its plan has in one of them what
            no grant of that kind of action has at all. Empty does not ask.
        proof: tries in one attacked situation what no pair can show: why it fails, an empty text
            when it does not, None where there is nothing to try.
        fit: the same defense without the errors that it makes on purpose: that is what has to
            qualify. None: the defense as it is.
        fit_as: how that one differs, in words for people, such as `awake, without errors`; empty
            without `fit`.
    """

    text: str
    blocks: tuple[Category, ...] = ()
    reasons: frozenset[str] = frozenset()
    fields: frozenset[str] = frozenset()
    proof: Callable[[Defense, Stage], str | None] | None = None
    fit: Callable[[], Defense] | None = None
    fit_as: str = ""

    def covers(self, pair: Pair) -> bool:
        """True when the pair's attack is of the defense's kind, as far as its author says."""
        named = not self.reasons or not self.reasons.isdisjoint(pair.reasons)
        return bool(pair.categories) and pair.categories[0] in self.blocks and named


class Defense(Protocol):
    """What is tried: it changes what a planner sees, or what runs of its plan, or both."""

    #: What tables and logs call it.
    name: str
    #: A stand-in with published behavior: marked wherever its results appear.
    simulated: bool
    #: Everything that shapes it.
    parameters: dict[str, Any]
    #: The second gate that a stage has to be made with; None: the envelope of the robot's profile.
    safety_gate: SafetyGate | None
    #: What it is held to before it is scored.
    claim: Claim

    def begin(self, *, seed: int) -> None:
        """Begin a try: its situation was put back, and nothing is known of the one before.

        Args:
            seed: of this try's dice.
        """
        ...

    def brief(self, briefing: Briefing) -> Briefing:
        """Return what the planner is shown under it."""
        ...

    def carry_out(self, stage: Stage, raw: bytes) -> ExecutedPlan:
        """Normalize a planner's bytes, judge what they ask for, and do what may be done.

        Args:
            stage: made with `safety_gate`.
            raw: exactly what the planner wrote.
        """
        ...


def names() -> tuple[str, ...]:
    """Return what there is, by name."""
    from missionpair import defenses

    return registry.names(defenses)


def make(spec: str) -> Defense:
    """Return the defense that a specification names: `none`, `human:first=0.8,seed=7`.

    Raises:
        UnknownNameError: no such defense, or no such option of it; says which there are.
        DefenseError: it is not available here; says what to do.
        ValueError: an option has a value that it cannot have.
    """
    from missionpair import defenses

    return cast("Defense", registry.make(defenses, spec))
