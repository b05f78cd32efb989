# SPDX-License-Identifier: Apache-2.0
"""What a new version of a mission changes, widening first; every signed field that differs.

A change widens when it lets an action pass that was refused before: a wider limit, a longer window,
more starts, an added row, a removed guard. How-to: docs/howto/missions.md
"""

from __future__ import annotations

from collections.abc import Iterator

from authguard_r.authoring.compile.facets import Bears, Facet, facets, listed_weights
from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.mission import Mission
from authguard_r.site.model import Site

_WORD = {Bears.WIDENS: "ADDS   ", Bears.NEITHER: "changes", Bears.NARROWS: "removes"}


def compare(old: Mission, new: Mission, site: Site) -> tuple[str, ...]:
    """Return one line for each thing that differs: `ADDS`, then `changes`, then `removes`.

    Args:
        old: the version before.
        new: the version that is to be signed.
        site: gives the words their units; both versions are read with it.
    """
    if old == new:
        return ("changes no permission",)
    listed = listed_weights(old.risk_policy) | listed_weights(new.risk_policy)
    lines = [
        *_differences(facets(old, site, listed), facets(new, site, listed), _ids(old), _ids(new)),
        *_orders(old, new),
    ]
    # a set that is not sorted: no schema-valid mission, but a file may hold one
    lines = lines or [(Bears.NEITHER, "the order of a set")]
    ranked = sorted(lines, key=lambda line: -line[0])
    return tuple(f"{_WORD[bears]} {text}" for bears, text in ranked)


def is_next(old: Mission, new: Mission) -> bool:
    """True when `new` is the version after `old` and names its digest: only so it supersedes it."""
    named = (new.mid, new.version, new.supersedes)
    return named == (old.mid, old.version + 1, digest_of(Tag.MISSION, old))


def _ids(mission: Mission) -> frozenset[str]:
    return frozenset(grant.id for grant in mission.actions)


def _differences(
    old: dict[str, Facet],
    new: dict[str, Facet],
    before: frozenset[str],
    after: frozenset[str],
) -> Iterator[tuple[Bears, str]]:
    for name, now in new.items():
        was = old.get(name)
        if was is None:
            yield from _appeared(now, is_new=bool(now.owner) and now.owner not in before)
        elif was != now:
            yield _bearing(was, now), f"{now.text()} (was {was.value})"
    for name, was in old.items():
        if name not in new:
            yield from _gone(was, is_over=bool(was.owner) and was.owner not in after)


def _bearing(was: Facet, now: Facet) -> Bears:
    grown = (now.size > was.size) - (now.size < was.size)
    return Bears(grown * now.more)


def _appeared(facet: Facet, *, is_new: bool) -> Iterator[tuple[Bears, str]]:
    """Say what came: all of a new grant is new permission, with its conditions."""
    if is_new:
        if facet.value != "no":
            yield Bears.WIDENS, facet.text()
    elif facet.presence is Bears.WIDENS:
        yield Bears.WIDENS, facet.text()
    else:
        yield facet.presence, f"{facet.text()} (new)"


def _gone(facet: Facet, *, is_over: bool) -> Iterator[tuple[Bears, str]]:
    """Say what was removed: a removed grant stands for all of its rows."""
    if is_over:
        if facet.is_row:
            yield Bears.NARROWS, facet.text()
    elif facet.presence is Bears.WIDENS:
        yield Bears.NARROWS, facet.text()
    else:
        yield Bears(-facet.presence), f"{facet.text()} (no longer)"


def _orders(old: Mission, new: Mission) -> Iterator[tuple[Bears, str]]:
    """Say where the same things stand in another order: the first that fits is taken."""
    for label, was, now in _sequences(old, new):
        if _kept(was, now) != _kept(now, was):
            yield Bears.NEITHER, f"{label} stand in another order"


def _kept(items: tuple[object, ...], others: tuple[object, ...]) -> list[object]:
    """Return the items that are among the others too, in their order, each once."""
    found: list[object] = []
    for item in items:
        if item in others and item not in found:
            found.append(item)
    return found


def _sequences(
    old: Mission, new: Mission
) -> Iterator[tuple[str, tuple[object, ...], tuple[object, ...]]]:
    before = {grant.id: grant for grant in old.actions}
    yield "grants", tuple(g.id for g in old.actions), tuple(g.id for g in new.actions)
    yield "conditions of the mission", old.guards, new.guards
    yield "risks of parameters", old.risk_policy.parameters, new.risk_policy.parameters
    yield "risks of states", old.risk_policy.states, new.risk_policy.states
    for grant in new.actions:
        was = before.get(grant.id)
        if was is not None:
            yield f"{grant.id}: rows", was.alternatives, grant.alternatives
            yield f"{grant.id}: conditions", was.guards, grant.guards
            yield f"{grant.id}: signs of being done", was.done_when, grant.done_when
