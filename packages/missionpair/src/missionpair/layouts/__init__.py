# SPDX-License-Identifier: Apache-2.0
"""Generated floor plans: sites and bindings as plain data, the same bytes every time.

Spec page: docs/spec/missionpair.md#layouts
"""

from __future__ import annotations

from missionpair.layouts.furnish import furnished
from missionpair.layouts.ground import Ground
from missionpair.layouts.shape import shape_of
from missionpair.layouts.words import DomainWords, RobotWords, Scale, ToolWords, call_of

#: Layouts of one domain.
EACH = 40

__all__ = [
    "EACH",
    "DomainWords",
    "Ground",
    "RobotWords",
    "Scale",
    "ToolWords",
    "call_of",
    "layouts_of",
    "shape_of",
]


def layouts_of(words: DomainWords, count: int = EACH) -> tuple[Ground, ...]:
    """Return so many layouts of a domain, no two of one shape, in a fixed order.

    Args:
        words: the domain's.
        count: how many.
    """
    found: dict[str, Ground] = {}
    attempt = 0
    while len(found) < count:
        layout = furnished(words, attempt, number=len(found) + 1)
        found.setdefault(shape_of(layout.site), Ground(layout, words))
        attempt += 1
    return tuple(found.values())
