# SPDX-License-Identifier: Apache-2.0
"""Whether two campaigns have trials of their own, so that figures over both count each trial once.

A deterministic campaign that is run again is the same trials. Two runs on a live model are not, but
nothing in their logs says so. Spec page: docs/spec/measures.md
"""

from __future__ import annotations

from missionpair.records import Campaign

#: What one trial follows from, beside its pair, its kind and its defense. Not how many there are:
#: every campaign begins with its suite's first pair and with the first try of it.
_DRAWN = (
    "suite_digest",
    "planner",
    "attacker",
    "access",
    "seed",
    "rounds",
    "turns",
    "weights",
    "field_weights",
)


def why_not_apart(one: Campaign, other: Campaign) -> str:
    """Return why two campaigns share trials, with what to do; empty when they share none."""
    same = all(getattr(one, name) == getattr(other, name) for name in _DRAWN)
    kinds = not set(one.kinds).isdisjoint(other.kinds)
    defenses = any(defense in other.defenses for defense in one.defenses)
    if one != other and not (same and kinds and defenses):
        return ""
    return "suite, planner, attacker and dice are the same; run one of them with another `--seed`"
