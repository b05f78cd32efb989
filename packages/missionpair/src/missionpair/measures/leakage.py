# SPDX-License-Identifier: Apache-2.0
"""What an attacker gains by knowing more: the same campaign with two kinds of access.

Source: section "Adaptive Attacker Models" (information leakage through codes or scores).
"""

from __future__ import annotations

from fractions import Fraction

from msgspec import Struct

from missionpair.measures.campaign import MeasuredCampaign
from missionpair.measures.faults import MeasureError
from missionpair.measures.rates import Gap, Proportion, difference
from missionpair.measures.resample import mean_difference
from missionpair.measures.spread import Spread
from missionpair.measures.tally import Tally
from missionpair.words import Access

#: What must be the same for access to be the only difference.
SAME = (
    *("suite", "suite_version", "suite_digest", "pairs", "every", "seeds", "planner", "rounds"),
    *("turns", "weights", "field_weights"),
)


class Leak(Struct, frozen=True, kw_only=True):
    """What more access is worth under one defense.

    Args:
        defense: its name.
        more: the wider access, such as `white`.
        less: the narrower one.
        scmhr: hijacked with each of them, the wider first.
        gain: difference in SCMHR, with Newcombe's interval; None where undefined.
        median_rounds: tries until `alg:missionpair` returns, with each of them.
        rounds: difference of the mean tries, with a bootstrap's interval; an attack that never came
            there counts as all its tries, so that who finds the easy ones alone is not the faster.
            Below 0: more access needs fewer tries.
    """

    defense: str
    more: str
    less: str
    scmhr: tuple[Proportion, Proportion]
    gain: Gap | None
    median_rounds: tuple[Fraction | None, Fraction | None]
    rounds: Gap | None


def leakage(more: MeasuredCampaign, less: MeasuredCampaign) -> tuple[Leak, ...]:
    """Return the differences of two campaigns, for each defense that both have.

    Raises:
        MeasureError: they differ in more than what the attacker sees.
    """
    one, two = more.campaign, less.campaign
    differ = [name for name in SAME if getattr(one, name) != getattr(two, name)]
    if one.attacker.name != two.attacker.name:
        differ.append("attacker")
    if differ:
        where = f"{one.access} and {two.access}"
        raise MeasureError(f"expected two campaigns with the same {', '.join(differ)}", where=where)
    found = []
    for defense in (name for name in more.defenses if name in less.defenses):
        first, second = more.tally(defense), less.tally(defense)
        found.append(
            Leak(
                defense=defense,
                more=one.access,
                less=two.access,
                scmhr=(first.scmhr, second.scmhr),
                gain=difference(first.scmhr, second.scmhr),
                median_rounds=(first.rounds.median, second.rounds.median),
                rounds=_faster(first, second, more.campaign.rounds),
            )
        )
    return tuple(found)


def _faster(first: Tally, second: Tally, rounds: int) -> Gap | None:
    """Return the difference of the mean tries; None where neither side found anything."""
    if not first.rounds.n + second.rounds.n:
        return None
    return mean_difference(_tries(first, rounds), _tries(second, rounds))


def _tries(tally: Tally, rounds: int) -> Spread:
    """Return the tries of every attack."""
    found = Spread()
    found.merge(tally.rounds)
    for _ in range(tally.n - tally.rounds.n):
        found.add(rounds)
    return found


def wider(one: MeasuredCampaign, other: MeasuredCampaign) -> bool:
    """Return True when the first attacker sees more than the second."""
    order = tuple(map(str, Access))
    seen = (one.campaign.access, other.campaign.access)
    return all(access in order for access in seen) and order.index(seen[0]) > order.index(seen[1])
