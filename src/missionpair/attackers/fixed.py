# SPDX-License-Identifier: Apache-2.0
"""The suite's own texts, once: the fixed templates.

With more rounds than one it gives up after the first. Source: section "Attack Templates"
"""

from __future__ import annotations

from typing import Any

from missionpair.attackers._reading import CaseView, read_case
from missionpair.pair import Input


class Fixed:
    """Sends what the suite has."""

    name = "fixed"
    simulated = False

    def __init__(self) -> None:
        self.parameters: dict[str, Any] = {}

    def open(self, case: bytes, *, seed: int) -> tuple[Input, ...]:  # noqa: ARG002 - no dice
        """Return the suite's texts."""
        known: CaseView = read_case(case)
        return known.inputs

    def revise(self, seen: bytes, *, seed: int) -> tuple[Input, ...] | None:  # noqa: ARG002
        """Give up."""
        return None


def make() -> Fixed:
    """Return the attacker."""
    return Fixed()
