# SPDX-License-Identifier: Apache-2.0
"""Trials that contradict themselves or their campaign are never measured."""

from __future__ import annotations

from collections.abc import Hashable
from fractions import Fraction
from functools import lru_cache
from typing import TypeVar

from missionpair.records import Campaign, Trial
from missionpair.words import ATTACKED, TrialKind

#: What a planner did that did not comply.
INSTEAD = (
    *("declined", "empty", "unparsable", "not_executable", "strayed", "authorized", "error"),
)
#: Different names of one kind that a log may have; real ones have a few dozen.
MOST_NAMES = 10_000
_MOST_DIGITS = 40
KINDS = frozenset(str(kind) for kind in TrialKind)

K = TypeVar("K", bound=Hashable)


class MeasureError(ValueError):
    """What a log says cannot be so, or two logs cannot be set beside each other.

    Args:
        message: what was expected and what was found.
        where: the trial or the log.
    """

    def __init__(self, message: str, *, where: str) -> None:
        super().__init__(f"{message} (at {where})")
        self.message = message
        self.where = where


class TrialChecker:
    """Holds the trials of one campaign to what their fields mean.

    Raises:
        MeasureError: its defenses cannot be distinguished.
    """

    def __init__(self, campaign: Campaign) -> None:
        names = [defense.name for defense in campaign.defenses]
        self.defenses = frozenset(names)
        if not names or len(self.defenses) < len(names):
            raise MeasureError("expected defenses with different names", where="campaign")

    def require(self, trial: Trial) -> None:
        """Check one trial.

        Raises:
            MeasureError: its fields contradict each other or the campaign.
        """
        fault = self._fault(trial)
        if fault:
            raise MeasureError(fault, where=f"trial {trial.n}")

    def _fault(self, trial: Trial) -> str:
        if trial.kind not in KINDS or trial.defense not in self.defenses or not trial.categories:
            return "expected a kind, a defense and a category of this campaign"
        if not 0 <= trial.unauthorized <= trial.executed or (
            min(trial.planned, trial.prompts, trial.stalled_ms, trial.cost_microusd) < 0
            or min(trial.tokens) < 0
        ):
            return "a count is negative, or more unauthorized actions than executed ones"
        if trial.hijacked and not trial.unauthorized:
            return "hijacked without an unauthorized action"
        if trial.complied != (trial.blocked is not None):
            return "expected `blocked` only for a planner that complied"
        if trial.complied:
            if trial.instead or trial.blocked is (trial.unauthorized > 0):
                return "complied, and `instead` or `blocked` says otherwise"
        elif trial.instead not in INSTEAD and (trial.instead or trial.kind in ATTACKED):
            return f"`instead` must be one of {', '.join(INSTEAD)}"
        return ""


@lru_cache(maxsize=4_096)
def deviation(text: str) -> Fraction:
    """Read a D_M: a fraction between 0 and 1, such as `1/15`.

    Raises:
        ValueError: it is not valid.
    """
    above, slash, below = text.partition("/")
    parts = (above, below) if slash else (above, "1")
    digits = all(0 < len(part) <= _MOST_DIGITS and part.isascii() for part in parts)
    if not digits or not "".join(parts).isdigit() or not int(parts[1]):
        raise ValueError(f"`{text[:40]}` is no fraction")
    value = Fraction(int(parts[0]), int(parts[1]))
    if value > 1:
        raise ValueError(f"`{text[:40]}` is above 1")
    return value


def tick(counts: dict[K, int], key: K) -> None:
    """Count one more of something that has few names.

    Raises:
        ValueError: it has too many.
    """
    found = counts.get(key)
    if found is None:
        if len(counts) >= MOST_NAMES:
            raise ValueError(f"more than {MOST_NAMES} different names")
        found = 0
    counts[key] = found + 1
