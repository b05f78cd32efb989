# SPDX-License-Identifier: Apache-2.0
"""Every fault of a site's text in one round, for its author.

A part that is no site is cut out, and the rest is read again. A fault that only follows from a cut
is not reported. How-to: docs/howto/site.md
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from authguard_r.core.errors import MalformedError
from authguard_r.site.check import SiteFault, faults
from authguard_r.site.model import Site
from authguard_r.site.source import site_of
from authguard_r.site.strict import read_yaml
from authguard_r.site.words import with_words

_FIELD = re.compile(r"object (?:(missing) required|contains unknown) field `([^`]*)`.*", re.DOTALL)
_ENTRY = re.compile(r"(\w+)\[(\d+)\]")


def text_faults(text: str, *, where: str) -> tuple[SiteFault, ...]:
    """Return the faults of a text that is no site; none: it is one, and `faults` checks it.

    Args:
        text: what an author wrote.
        where: the file's name, for places in messages.

    Raises:
        MalformedError: not YAML, or a fault outside of entries: nothing else can be looked at.
    """
    rest = _Rest(with_words(read_yaml(text, where=where), where=where))
    found: list[SiteFault] = []
    while True:
        try:
            site = site_of(rest.data, where=where)
        except MalformedError as error:
            place = error.where.removeprefix(f"{where}:")
            field = _FIELD.fullmatch(error.message)
            written = rest.as_written(place)
            follows = field is not None and field[1] and f"{written}.{field[2]}" in rest.cuts
            if not follows:
                found.append(SiteFault(written, error.message))
            if not rest.cut(place, None if field is None or field[1] else field[2]):
                raise
        else:
            return (*found, *rest.further(site)) if found else ()


class _Rest:
    """What is left of the text's data, and what was cut out of it.

    Args:
        data: as it was read; parts of it are removed.
    """

    def __init__(self, data: Any) -> None:
        self.data = data
        self.cuts: set[str] = set()
        self._entries: set[str] = set()
        self._gone: dict[str, list[int]] = {}

    def cut(self, place: str, field: str | None) -> bool:
        """Remove the innermost named part at a place, or a field of it; False: all would go."""
        trail, node, rest = [], self.data, f".{place}"
        while rest:
            key, size = _step(node, rest)
            if key is None:
                break
            trail.append((node, key, f".{place}"[: -len(rest) or None] + rest[:size]))
            node, rest = node[key], rest[size:]
        if field is not None and isinstance(node, dict) and field in node:
            del node[field]
            return True
        while len(trail) > 2 and isinstance(trail[-1][0], list):
            trail.pop()
        if len(trail) < 2:
            return False
        parent, key, path = trail[-1]
        del parent[key]
        self.cuts.add(self.as_written(path.removeprefix(".")))
        if len(trail) == 2:
            self._removed(str(trail[0][1]), key)
        return True

    def _removed(self, group: str, key: str | int) -> None:
        if isinstance(key, int):
            self._gone.setdefault(group, []).append(self._original(group, key))
        else:
            self._entries.add(str(key))

    def as_written(self, place: str) -> str:
        """Return a place with the number that its entry has in the text."""
        entry = _ENTRY.match(place)
        if entry is None:
            return place
        return f"{entry[1]}[{self._original(entry[1], int(entry[2]))}]{place[entry.end() :]}"

    def _original(self, group: str, number: int) -> int:
        for gone in sorted(self._gone.get(group, [])):
            number += gone <= number
        return number

    def further(self, site: Site) -> Iterator[SiteFault]:
        """Yield the faults of what is left; those that speak of an entry that was cut follow."""
        for fault in faults(site):
            if any(f"`{name}`" in fault.message for name in self._entries):
                continue
            written = self.as_written(fault.where)
            if not any(re.match(rf"{re.escape(cut)}(?=$|[.\[])", written) for cut in self.cuts):
                yield SiteFault(written, fault.message)


def _step(node: Any, rest: str) -> tuple[Any, int]:
    """Return the key that the rest of a place begins with, and its length; None: it is not here."""
    if isinstance(node, list):
        number = re.match(r"\[(\d+)\]", rest)
        inside = number is not None and int(number[1]) < len(node)
        return (int(number[1]), number.end()) if inside and number is not None else (None, 0)
    names = [str(key) for key in node] if isinstance(node, dict) else []
    fitting = [n for n in names if re.match(rf"\.{re.escape(n)}(?=$|[.\[])", rest)]
    longest = max(fitting, key=len, default=None)
    return (longest, 0 if longest is None else len(longest) + 1)
