# SPDX-License-Identifier: Apache-2.0
"""How a situation was, so that it can be so again without being made anew.

A real gate, its store and its robot are a few dozen objects in memory. A memento keeps what each of
them held, and puts it back: thousands of tries begin in the very same situation, in a fraction of
the time in which it was prepared. That a try after this is the same as one in a situation made anew
is a law under test, not an assumption.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Iterable, Iterator
from functools import partial
from types import FunctionType, MethodType
from typing import Any

from msgspec import Struct

#: Only objects of these packages are looked into; what others hold never changes here.
_OURS = ("authguard_r.", "missionpair.")
_CONTAINERS = (dict, list, set, deque, bytearray)


class Memento:
    """What the objects that are reached from some roots hold.

    Args:
        roots: where to begin; a frozen struct is looked through, and not kept itself.
    """

    def __init__(self, *roots: object) -> None:
        self._objects: list[tuple[Any, Any]] = []
        self._containers: list[tuple[Any, Any]] = []
        seen: set[int] = set()
        waiting = list(roots)
        while waiting:
            item = waiting.pop()
            if id(item) not in seen:
                seen.add(id(item))
                waiting += self._kept(item)

    def restore(self) -> None:
        """Put everything back as it was kept."""
        for held, kept in (*self._objects, *self._containers):
            held.clear()
            if isinstance(held, dict | set):
                held.update(kept)
            else:
                held.extend(kept)

    def _kept(self, item: Any) -> Iterable[Any]:
        """Keep what one thing holds, and return what to look at next."""
        if isinstance(item, _CONTAINERS):
            self._containers.append((item, item.copy()))
            return _within(item)
        if isinstance(item, Struct):
            fields = (getattr(item, name) for name in item.__struct_fields__)
            return [value for value in fields if not isinstance(value, _CONTAINERS)]
        if isinstance(item, tuple):
            return [value for value in item if _is_ours(value)]
        if isinstance(item, MethodType):
            return [item.__self__]
        if isinstance(item, partial):
            return [item.func, *item.args, *item.keywords.values()]
        if isinstance(item, FunctionType):
            return [cell.cell_contents for cell in item.__closure__ or ()]
        if _is_ours(item) and hasattr(item, "__dict__"):
            self._objects.append((item.__dict__, dict(item.__dict__)))
            return list(item.__dict__.values())
        return ()


def _within(container: Any) -> Iterator[Any]:
    """Yield what a container holds that may itself change."""
    for value in container.values() if isinstance(container, dict | OrderedDict) else container:
        if _is_ours(value) or isinstance(value, (*_CONTAINERS, MethodType, FunctionType, partial)):
            yield value


def _is_ours(value: object) -> bool:
    return not isinstance(value, type) and type(value).__module__.startswith(_OURS)
