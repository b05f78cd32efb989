# SPDX-License-Identifier: Apache-2.0
"""How many distinct people are behind an action, however the groups chose their signers.

One person may sign alone and as a member of several groups. Of all the ways in which the groups'
signers may have been chosen, one with the fewest people counts.
Source: theorem "High-risk approval". Spec page: docs/spec/approval.md#people
"""

from __future__ import annotations

from math import prod

from authguard_r.core.identifiers import PrincipalId
from authguard_r.core.principals import Principal

#: So many of these people signed.
Signed = tuple[int, frozenset[PrincipalId]]
#: How many combinations of what the groups still need are looked at.
MOST_NEEDS = 256


def people_behind(issuer: Principal, approvers: list[Principal]) -> int:
    """Return how many people are behind an action for certain, the issuer's included.

    The mission's signature alone counts one, also a group's. A group whose members are unknown
    counts as one person beside it and adds no third one: its signers may be the other signers.
    """
    beside = [_signed(a) for a in approvers if _is_another(a, issuer)]
    return max(fewest_people([_signed(issuer), *beside]), 2) if beside else 1


def _is_another(approver: Principal, issuer: Principal) -> bool:
    """True when a person approved who certainly did not sign the mission."""
    (count, people), (_, own) = _signed(approver), _signed(issuer)
    return count > len(people & own) if people and own else len(own) == 1


def _signed(who: Principal) -> Signed:
    """Return how many of how many members signed; (0, 0) where a group's members are not known."""
    if who.members:
        return min(who.threshold, len(who.members)), who.members
    return (1, frozenset({who.id})) if who.threshold == 1 else (0, frozenset())


def fewest_people(groups: list[Signed]) -> int:
    """Return the size of a smallest set of people that has as many of each group as signed.

    Beyond `MOST_NEEDS` the groups that need fewest are left out, and it can only be less.
    """
    sure = {person for count, people in groups if count == len(people) for person in people}
    left = {(count - len(people & sure), people - sure) for count, people in groups}
    needy: list[Signed] = []
    for group in sorted(left, key=lambda group: (-group[0], sorted(group[1]))):
        if group[0] > 0 and prod(count + 1 for count, _ in (*needy, group)) <= MOST_NEEDS:
            needy.append(group)
    fewest = {tuple([count for count, _ in needy]): 0}
    for person in {person for _, people in needy for person in people}:
        helped = [person in people for _, people in needy]
        for needs, number in [*fewest.items()]:
            rest = tuple([max(n - h, 0) for n, h in zip(needs, helped, strict=True)])
            fewest[rest] = min(fewest.get(rest, number + 1), number + 1)
    return len(sure) + fewest[(0,) * len(needy)]
