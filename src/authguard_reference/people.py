# SPDX-License-Identifier: Apache-2.0
"""How many people are behind an action: docs/spec/approval.md, People."""

from collections import Counter
from functools import cache
from typing import Any

Json = dict[str, Any]
#: So many of these people signed.
Signed = tuple[int, frozenset[str]]

#: What the groups that are counted may need together, in combinations.
MOST_NEEDS = 256


def signed_by(who: Json) -> Signed:
    """Say how many of whom signed.

    Args:
        who: A person or a group, as the certificate names it.

    Returns:
        How many, of how many; (0, 0) for a group whose members are unknown.
    """
    members = frozenset(who.get("members", []))
    threshold = who.get("threshold", 1)
    if members:
        return min(threshold, len(members)), members
    if threshold == 1:
        return 1, frozenset([who["id"]])
    return 0, frozenset()


def is_another(approver: Json, issuer: Json) -> bool:
    """Decide whether a person approved who cannot be behind the mission's signature.

    Args:
        approver: Who approved.
        issuer: Who signed the mission.

    Returns:
        True when that is certain.
    """
    count, people = signed_by(approver)
    own = signed_by(issuer)[1]
    if len(own) == 0:  # any member may have signed the mission
        return False
    if len(people) == 0:  # any member may have approved, but one person is no group
        return len(own) == 1
    return len(people & own) < count


def least(kinds: tuple[tuple[frozenset[int], int], ...], needs: tuple[int, ...]) -> int | None:
    """Find the fewest people who fill every need.

    Args:
        kinds: The groups that people are in, and how many people are in exactly these.
        needs: How many people each group still needs.

    Returns:
        Their number; None when there are not enough.
    """

    @cache
    def search(place: int, left: tuple[int, ...]) -> int | None:
        if max(left, default=0) == 0:
            return 0
        if place == len(kinds):
            return None
        groups, there = kinds[place]
        found = []
        for taken in range(min(there, max(left)) + 1):
            rest = tuple(max(0, n - taken) if g in groups else n for g, n in enumerate(left))
            more = search(place + 1, rest)
            if more is not None:
                found.append(taken + more)
        return min(found, default=None)

    return search(0, needs)


def fewest(signed: list[Signed]) -> int:
    """Count a smallest set of people that has as many of each group as signed.

    Args:
        signed: How many of whom, for each signature.

    Returns:
        The size of the set; less when the groups are too many and too large.
    """
    sure: set[str] = set()
    for count, people in signed:
        if count == len(people):
            sure |= people
    open_ = {(count - len(people & sure), people - sure) for count, people in signed}
    order = sorted((-need, sorted(people)) for need, people in open_ if need > 0)
    counted: list[tuple[int, list[str]]] = []
    size = 1
    for less, names in order:
        if size * (1 - less) <= MOST_NEEDS:
            size *= 1 - less
            counted.append((-less, names))
    everybody = {person for _, names in counted for person in names}
    kinds = Counter(
        frozenset(place for place, (_, names) in enumerate(counted) if person in names)
        for person in everybody
    )
    more = least(tuple(kinds.items()), tuple(need for need, _ in counted))
    return len(sure) + (more or 0)


def people_behind(approvers: list[Json], issuer: Json) -> int:
    """Count the people behind an action, the issuer's included.

    Args:
        approvers: Who gave the fitting approvals.
        issuer: Who signed the mission.

    Returns:
        How many distinct people there are for certain; 1 for the mission's signature alone.
    """
    beside = [signed_by(approver) for approver in approvers if is_another(approver, issuer)]
    if beside == []:
        return 1
    return max(2, fewest([signed_by(issuer), *beside]))
