# SPDX-License-Identifier: Apache-2.0
"""What a new version of a site model changes, what changes the meaning of a word first.

A mission that was reviewed with one site says something else with another, although not a letter
of it changed: a name that now is another place, a wall that moved, a limit that grew. Those come
before what merely exists now or exists no more. How-to: docs/howto/site.md
"""

from __future__ import annotations

from collections.abc import Iterator
from enum import StrEnum
from typing import Any

import msgspec
from msgspec import Struct

from authguard_r.core.provenance import TRUST, WIDEST, Label, SourceField
from authguard_r.site.channels import CHANNELS
from authguard_r.site.model import Site
from authguard_r.site.names import named, shown


class ChangeEffect(StrEnum):
    """What a change does to what was written or signed before, in the order of reporting."""

    MEANING = "meaning"  # the same word now says something else
    WIDENS = "widens"  # more can be asked for, or less is checked
    NARROWS = "narrows"
    ADDS = "adds"
    REMOVES = "removes"
    COUNTS = "counts"  # the version number


class SiteChange(Struct, frozen=True, kw_only=True):
    """One difference.

    Args:
        effect: what it does.
        group: the part of the model, such as `regions`; `names` for a spelling.
        where: the place in it.
        old: the value before, as plain data; None when there was none.
        new: the value now; None when there is none.
    """

    effect: ChangeEffect
    group: str
    where: str
    old: Any
    new: Any


#: Parts that hold things by id.
_THINGS = ("regions", "objects", "robots", "vocabulary", "people")
#: A larger value lets more happen.
_MORE = frozenset(
    {"high", "max_speed_mm_s", "max_force_mn", "max_payload_g", "max_accel_mm_s2", "beside"}
)
#: A smaller one, or false instead of true, lets more happen or has less checked.
_LESS = frozenset(
    {"low", "mass_g", "privacy", "required"}
    | {"moves", "waits", "records", "stores", "transmits", "state_writing"}
)
#: What more members of these hold lets more happen.
_GROWING = frozenset({"tools", "roles", "places", "baseline"})


def changes(old: Site, new: Site) -> tuple[SiteChange, ...]:
    """Return every difference, what changes meaning first, then in the order of the model."""
    before, after = _plain(old), _plain(new)
    found = [*_names(old, new)]
    for part in _THINGS:
        found += _differences((part,), before[part], after[part])
    found += _doors(before["doors"], after["doors"])
    places = [site.emergency.places if site.emergency is not None else {} for site in (old, new)]
    found += _differences(("emergency", "places"), *places)
    found += _channels(before["channels"], after["channels"])
    found += _sources(old, new)
    for part in ("baseline", "id", "version"):
        found += _differences((part,), before[part], after[part])
    order = list(ChangeEffect)
    return tuple(sorted(found, key=lambda change: order.index(change.effect)))


def line_of(change: SiteChange) -> str:
    """Return a change for people, in one line of ASCII."""
    old, new = (_text(value) for value in (change.old, change.new))
    if change.old is None:
        told = f"new: {new}"
    elif change.new is None:
        told = f"gone: {old}"
    else:
        told = f"{old} -> {new}"
    return f"{change.effect.upper():8} {change.where}: {told}"


def _names(old: Site, new: Site) -> Iterator[SiteChange]:
    """Yield each spelling that means another thing, something new, or nothing any more."""
    before = {(thing.group, name): thing.item for thing in named(old) for name in thing.names}
    after = {(thing.group, name): thing.item for thing in named(new) for name in thing.names}
    for group, name in sorted({*before, *after}):
        was, now = before.get((group, name)), after.get((group, name))
        if was != now:
            effect = ChangeEffect.MEANING
            if was is None or now is None:
                effect = ChangeEffect.ADDS if was is None else ChangeEffect.REMOVES
            where = f"{group} named `{shown(name)}`"
            yield SiteChange(effect=effect, group="names", where=where, old=was, new=now)


def _doors(old: list[Any], new: list[Any]) -> Iterator[SiteChange]:
    """Yield the doors that are new or gone; one that moved is both."""
    for door in new:
        if door not in old:
            yield _change(ChangeEffect.ADDS, ("doors",), None, door)
    for door in old:
        if door not in new:
            yield _change(ChangeEffect.REMOVES, ("doors",), door, None)


def _channels(old: dict[str, str], new: dict[str, str]) -> Iterator[SiteChange]:
    """Yield the channels that are new, gone, or trusted more or less than before."""
    for channel in sorted({*old, *new}):
        written = (old.get(channel), new.get(channel))
        if written[0] == written[1]:
            continue
        was, now = (word or CHANNELS.get(channel) for word in written)
        if was is None or now is None or was == now:
            effect = ChangeEffect.ADDS if written[0] is None else ChangeEffect.REMOVES
        else:
            less = TRUST.index(Label(now)) > TRUST.index(Label(was))
            effect = ChangeEffect.NARROWS if less else ChangeEffect.WIDENS
        yield _change(effect, ("channels", channel), *written)


def _sources(old: Site, new: Site) -> Iterator[SiteChange]:
    """Yield the fields that more or fewer labels may set than before."""
    for field in SourceField:
        was, now = (site.sources.get(field, tuple(sorted(WIDEST[field]))) for site in (old, new))
        if was != now:
            effect = ChangeEffect.NARROWS if set(now) < set(was) else ChangeEffect.WIDENS
            yield _change(effect, ("sources", str(field)), list(was), list(now))


def _differences(path: tuple[str, ...], old: Any, new: Any) -> Iterator[SiteChange]:
    """Yield the differences between two values, down to the smallest that differ."""
    if old == new:
        return
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted({*old, *new}):
            yield from _differences((*path, key), old.get(key), new.get(key))
        return
    yield _change(_effect(path, old, new), path, old, new)


def _effect(path: tuple[str, ...], old: Any, new: Any) -> ChangeEffect:
    """Return what it does that a value became another; unknown is a change of meaning."""
    word = path[-1]
    if path == ("version",):
        return ChangeEffect.COUNTS
    if _GROWING & {word, *path[-2:-1]}:
        return _grown(old, new)
    if len(path) == 2 and path[0] in _THINGS:  # the path names a thing, not a part of one
        return ChangeEffect.ADDS if old is None else ChangeEffect.REMOVES
    if old is not None and new is not None and word in _MORE | _LESS:
        return ChangeEffect.WIDENS if (new > old) == (word in _MORE) else ChangeEffect.NARROWS
    if word == "monitored_by" and None in {old, new}:
        return ChangeEffect.WIDENS if new is None else ChangeEffect.NARROWS
    return ChangeEffect.MEANING


def _grown(old: Any, new: Any) -> ChangeEffect:
    """Return what it does that a set has other members, or a place another purpose."""
    if isinstance(old, str) and isinstance(new, str):
        return ChangeEffect.MEANING
    if new is None:
        return ChangeEffect.NARROWS
    return ChangeEffect.WIDENS if old is None or {*new} - {*old} else ChangeEffect.NARROWS


def _change(effect: ChangeEffect, path: tuple[str, ...], old: Any, new: Any) -> SiteChange:
    return SiteChange(effect=effect, group=path[0], where=".".join(path), old=old, new=new)


def _text(value: Any) -> str:
    return shown(value if isinstance(value, str) else msgspec.json.encode(value).decode())


def _plain(value: Any) -> Any:
    """Return a struct as plain data with its defaults, so that false and absent are one.

    Names are left out: they are compared as spellings, each with the thing that it means.
    """
    if isinstance(value, Struct):
        fields = (field for field in value.__struct_fields__ if field != "names")
        return {field: _plain(getattr(value, field)) for field in fields}
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return str(value) if isinstance(value, StrEnum) else value
