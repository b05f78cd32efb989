# SPDX-License-Identifier: Apache-2.0
"""Spellings: one to one, and none that a reviewer could take for another's (L2).

Machines compare names exactly; people review them. A name that differs from another thing's only
by case, space, marks or look-alike letters would pass a review as the other thing.
Spec page: docs/spec/site-model.md
"""

from __future__ import annotations

import unicodedata
from collections.abc import Iterator

from msgspec import Struct

from authguard_r.site.model import Site

#: What looks alike after case folding, by the letter that stands for all of them. Cyrillic, Greek
#: and others that a Latin text hides best; accents and full-width forms fall away before.
_LOOKS = {
    "l": "1i|\u0131\u0456\u04cf\u03b9\u05c0\u01c0\u2223\ua647",
    "o": "0\u043e\u03bf\u03c3\u0585\u05e1\u0ae6\u06f0\u0665",
    "a": "\u0430\u03b1\u0251",
    "b": "\u0432\u03b2",
    "c": "\u0441\u03f2",
    "d": "\u0501",
    "e": "\u0435\u03b5\u04bd",
    "g": "\u0261\u050d",
    "h": "\u043d\u04bb\u0570",
    "j": "\u0458\u03f3",
    "k": "\u043a\u03ba",
    "m": "\u043c\u03bc",
    "n": "\u0438\u03b7\u0578",
    "p": "\u0440\u03c1",
    "q": "\u051b",
    "s": "\u0455\ua731",
    "t": "\u0442\u03c4",
    "u": "\u057d\u03c5\u028b",
    "v": "\u03bd\u0475",
    "w": "\u051d\u0461",
    "x": "\u0445\u03c7",
    "y": "\u0443\u03b3",
    "z": "\u03b6\u1d22",
}
_PLAIN = str.maketrans({twin: letter for letter, twins in _LOOKS.items() for twin in twins})
#: What separates words in a name or an id, and what no eye sees.
_SILENT = frozenset("_.:-\u2010\u2011\u2012\u2013\u2014\u2212")
#: Longest stretch of a name that a message repeats.
_SHOWN = 60
#: Longest name, and most names of one thing: everything a planner reads is searched for each.
MOST_CHARACTERS = 200
MOST_NAMES = 64


class NamedThing(Struct, frozen=True):
    """One thing of the site with its spellings.

    Args:
        group: the kind of thing; one spelling may mean one thing of each.
        item: its id, which is a spelling of itself.
        names: its external spellings.
    """

    group: str
    item: str
    names: tuple[str, ...]


def skeleton(name: str) -> str:
    """Return what is left of an id or a name for the eye.

    Two spellings with equal skeletons (`room-101`, `Room 101`, `room-l0l`) look alike to a person
    who reviews a mission, so they may not mean two things (L2). Wrong reading: it is no
    normalization; a planner's word is compared exactly, never by its skeleton.
    """
    bare = "".join(
        c
        for c in unicodedata.normalize("NFKD", name).casefold()
        if c not in _SILENT and unicodedata.category(c)[0] not in "MCZ"
    )
    plain = bare.translate(_PLAIN).replace("rn", "m").replace("vv", "w")
    return plain or name


def shown(name: str) -> str:
    """Return a name for a message: ASCII, short, and nothing that moves the cursor."""
    cut = name if len(name) <= _SHOWN else f"{name[:_SHOWN]}..."
    return (
        "".join(c if c.isprintable() else repr(c)[1:-1] for c in cut)
        .encode("ascii", "backslashreplace")
        .decode("ascii")
    )


def named(site: Site) -> tuple[NamedThing, ...]:
    """Return everything of the site that has external spellings."""
    return (
        *(NamedThing("regions", item, model.names) for item, model in site.regions.items()),
        *(NamedThing("objects", item, model.names) for item, model in site.objects.items()),
        *(NamedThing("people", item, model.names) for item, model in site.people.items()),
    )


def twin_faults(site: Site) -> Iterator[tuple[str, str]]:
    """Yield the ids that a person would take for each other, with the place."""
    groups: dict[str, tuple[str, ...]] = {
        "regions": tuple(site.regions),
        "objects": tuple(site.objects),
        "robots": tuple(site.robots),
        "vocabulary": tuple(site.vocabulary),
        "people": tuple(site.people),
    }
    for group, ids in groups.items():
        seen: dict[str, str] = {}
        for item in ids:
            twin = seen.setdefault(skeleton(item), item)
            if twin != item:
                yield f"{group}.{item}", f"expected an id that cannot be taken for `{twin}`"


def name_faults(site: Site) -> Iterator[tuple[str, str]]:
    """Yield names that are no names, come twice, or could be taken for another thing's."""
    seen: dict[tuple[str, str], tuple[str, str]] = {}
    for thing in named(site):
        yield from _spelling_faults(thing)
        told = {thing.item}
        for name in (thing.item, *thing.names):
            spelling, owner = seen.setdefault((thing.group, skeleton(name)), (name, thing.item))
            both_ids = name == thing.item and spelling == owner  # reported by `twin_faults`
            if owner in told or both_ids:
                continue
            told.add(owner)
            rule = "other than" if spelling == name else "that cannot be taken for"
            yield (
                f"{thing.group}.{thing.item}.names",
                f"expected a name {rule} `{shown(spelling)}` of `{owner}`",
            )


def _spelling_faults(thing: NamedThing) -> Iterator[tuple[str, str]]:
    if len(thing.names) > MOST_NAMES:
        yield (
            f"{thing.group}.{thing.item}.names",
            f"expected at most {MOST_NAMES} names, got {len(thing.names)}",
        )
        return
    for number, name in enumerate(thing.names):
        place = f"{thing.group}.{thing.item}.names[{number}]"
        if len(name) > MOST_CHARACTERS:
            yield place, f"expected at most {MOST_CHARACTERS} characters, got {len(name)}"
        elif not name.strip():
            yield place, "expected a name that is not empty"
        elif name != name.strip():
            yield place, f"expected no space around `{shown(name)}`"
        elif not name.isprintable():
            yield place, f"expected printable characters, got `{shown(name)}`"
        elif name in thing.names[:number]:
            yield place, f"expected each name once, got `{shown(name)}` again"
