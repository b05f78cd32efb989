# SPDX-License-Identifier: Apache-2.0
"""The paper's own figures, typed from its tables into `published.json`.

They stand beside what was measured, in columns of their own, and are never mixed into it.
Source: `tab:pilot-results` to `tab:pilot-crossmodel`
"""

from __future__ import annotations

import re
from fractions import Fraction
from functools import cache
from importlib.resources import files

import msgspec
from msgspec import Struct

from missionpair.measures import Proportion
from missionpair.records import NamedPart


class Live(Struct, frozen=True, forbid_unknown_fields=True):
    """One table of a live experiment.

    Args:
        label: the paper's.
        caption: the paper's, in LaTeX.
        trials: of each category.
        complied: by category.
        blocked: by category, of those that complied; absent where none did.
        pooled: complied, trials, blocked, as the last row has them.
    """

    label: str
    caption: str
    trials: int
    complied: dict[str, int]
    blocked: dict[str, int]
    pooled: tuple[int, int, int]

    def compliance(self, category: str) -> Proportion | None:
        """Return how many complied; None for a category that the table has not."""
        found = self.complied.get(category)
        return None if found is None else Proportion(found, self.trials)

    def blocking(self, category: str) -> Proportion | None:
        """Return how many of them were blocked; None where none complied."""
        found = self.blocked.get(category)
        return None if found is None else Proportion(found, self.complied[category])


class Target(Struct, frozen=True, forbid_unknown_fields=True):
    """One of the paper's planners and its experiments.

    Args:
        name: as the paper has it.
        tex: the same in LaTeX.
        known_by: letters and digits that its model's name has, in this order.
        attacks: its tables, by our name of the attacker.
    """

    name: str
    tex: str
    known_by: str
    attacks: dict[str, Live]


class Cross(Struct, frozen=True, forbid_unknown_fields=True):
    """The summary over planners: complied, trials, blocked of all of them."""

    label: str
    caption: str
    total: tuple[int, int, int]


class Results(Struct, frozen=True, forbid_unknown_fields=True):
    """The controlled table: measures by system, in hundredths."""

    label: str
    caption: str
    measures: tuple[str, ...]
    systems: dict[str, tuple[int, ...]]

    def of(self, system: str) -> dict[str, Fraction]:
        """Return a system's measures; nothing of a system that the paper has not."""
        found = self.systems.get(system, ())
        return {
            name: Fraction(value, 100) for name, value in zip(self.measures, found, strict=False)
        }


class ByCategory(Struct, frozen=True, forbid_unknown_fields=True):
    """The controlled table by category: successes and attempts, by category and system."""

    label: str
    caption: str
    rows: dict[str, dict[str, tuple[int, int]]]

    def of(self, category: str, system: str) -> Proportion | None:
        """Return successes over attempts; None for what the table has not."""
        found = self.rows.get(category, {}).get(system)
        return None if found is None else Proportion(*found)


class Published(Struct, frozen=True, forbid_unknown_fields=True):
    """Everything that was typed from the paper."""

    planners: tuple[Target, ...]
    crossmodel: Cross
    results: Results
    category: ByCategory


@cache
def published() -> Published:
    """Return the paper's figures."""
    data = files("missionpair.report").joinpath("published.json").read_bytes()
    return msgspec.json.decode(data, type=Published)


def match(planner: NamedPart) -> Target | None:
    """Return which of the paper's planners this is; None for others and for every simulated one."""
    if planner.simulated:
        return None
    told = (planner.name, planner.parameters.get("model"), planner.parameters.get("preset"))
    words = [re.sub(r"[^a-z0-9]", "", str(word).lower()) for word in told if word is not None]
    for target in published().planners:
        if any(target.known_by in word for word in words):
            return target
    return None
