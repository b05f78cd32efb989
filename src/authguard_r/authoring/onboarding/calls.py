# SPDX-License-Identifier: Apache-2.0
"""What planners' calls looked like: for each tool, each field's kinds, ranges and words.

Nothing is understood here: a field is a path, a value is a value. An attacker who fed the planner
chose both, so every count, name and word is bounded, and calls that cannot be distinguished are
left out with a reason. How-to: docs/howto/onboarding.md
"""

from __future__ import annotations

from collections.abc import Iterator
from decimal import Decimal
from typing import Any

from authguard_r.authoring.onboarding.evidence import (
    Proposed,
    RawPlan,
    ShadowEvidence,
    Unused,
    require_known,
)
from authguard_r.authoring.onboarding.graph import OPERATIONS
from authguard_r.authoring.onboarding.listing import (
    FIELD,
    MAX_FIELDS,
    MAX_PATH,
    MAX_TOOLS,
    tool_name,
)
from authguard_r.core.action import Action
from authguard_r.core.errors import MalformedError
from authguard_r.normalize import Binder
from authguard_r.normalize.dialects import Call, read_reply
from authguard_r.normalize.parse import read_text
from authguard_r.site.model import Site
from authguard_r.site.names import shown

#: Most fields of all tools together: what a person can go through, and one file can hold.
MAX_ALL = 1_500
#: Most different words of one field that are kept, and the longest of them, in characters.
MAX_WORDS = 64
MAX_WORD = 200

#: What distinguishes the calls of one rosbridge operation.
_REACHED = {operation: name for operation, name, _, _ in OPERATIONS.values()}
#: One way of a tool: its name, and for rosbridge what it reaches.
WayKey = tuple[str, tuple[str, str] | None]


class SeenField:
    """One field of one way, over all calls."""

    def __init__(self) -> None:
        self.count = 0
        self.kinds: dict[str, int] = {}
        self.words: dict[str, int] = {}
        self.low: int | Decimal | None = None
        self.high: int | Decimal | None = None
        self.crowded = False
        self._first: Any = None
        self.constant = True

    def add(self, value: Any) -> None:
        """Take a value in."""
        if self.count == 0:
            self._first = value
        elif type(value) is not type(self._first) or value != self._first:
            self.constant = False
        self.count += 1
        kind = _kind(value)
        self.kinds[kind] = self.kinds.get(kind, 0) + 1
        if kind == "text":
            self._add_word(value)
        elif kind in {"whole number", "number"}:
            self.low = value if self.low is None else min(self.low, value)
            self.high = value if self.high is None else max(self.high, value)

    def _add_word(self, word: str) -> None:
        if len(word) > MAX_WORD or (word not in self.words and len(self.words) >= MAX_WORDS):
            self.crowded = True
        else:
            self.words[word] = self.words.get(word, 0) + 1

    @property
    def only(self) -> bool | int | Decimal | str | None:
        """The one value that it always had; None when it had others, or none that can be held."""
        held = self.constant and isinstance(self._first, bool | int | Decimal | str)
        return self._first if held else None

    def are(self, *kinds: str) -> bool:
        """True when every value was of one of the kinds."""
        return bool(self.kinds) and self.kinds.keys() <= set(kinds)


class SeenWay:
    """One tool, or one way of rosbridge, over all its calls."""

    def __init__(self) -> None:
        self.count = 0
        self.seqs: list[int] = []
        self.fields: dict[str, SeenField] = {}

    def add(self, seq: int, flat: dict[str, Any]) -> None:
        """Take a call in."""
        self.count += 1
        if seq not in self.seqs[-1:]:
            self.seqs.append(seq)
        for path, value in flat.items():
            self.fields.setdefault(path, SeenField()).add(value)

    def settle(self) -> None:
        """Merge what was now a value and now an object: it is no place for either."""
        for path in sorted(self.fields):
            parents = path.split(".")
            outer = [".".join(parents[:n]) for n in range(1, len(parents))]
            if any(name in self.fields for name in outer):
                first = next(name for name in outer if name in self.fields)
                self.fields[first].kinds["object"] = self.fields[first].kinds.get("object", 0) + 1
                self.fields[first].constant = False
                del self.fields[path]


class ObservedCalls:
    """Everything that the plans of a run say.

    Args:
        site: gives names their meaning, through the binder.
        binder: turns calls into actions; None when no tool is bound yet.
    """

    def __init__(self, site: Site, binder: Binder | None) -> None:
        self._site = site
        self._binder = binder
        self.calls = 0
        self.plans = 0
        self._fields = 0
        self.ways: dict[WayKey, SeenWay] = {}
        self.actions: list[Proposed] = []
        self.unused: list[Unused] = []

    def add(self, plan: RawPlan) -> None:
        """Take a plan in; what cannot be read is noted with its reason."""
        try:
            calls = read_reply(read_text(plan.data), plan.dialect).calls
        except MalformedError as error:
            self._leave(plan.seq, f"{error.message} (at {error.where})")
            return
        self.plans += 1
        for call in calls:
            self.calls += 1
            action = self._bound(call)
            if action is not None:
                self.actions.append(
                    Proposed(seq=plan.seq, action=action, place=frozenset(), influences=None)
                )
            else:
                self._hear(plan.seq, call)

    def _bound(self, call: Call) -> Action | None:
        if self._binder is None:
            return None
        try:
            action = self._binder.bind(call)
            require_known(action, self._site)
        except MalformedError:
            return None
        return action

    def _hear(self, seq: int, call: Call) -> None:
        try:
            key, flat = _way(call), dict(_flat(call.arguments, ""))
            self._require_room(key, flat)
        except MalformedError as error:
            self._leave(seq, f"a call of `{shown(call.tool)}`: {error.message}")
            return
        way = self.ways.setdefault(key, SeenWay())
        before = len(way.fields)
        way.add(seq, flat)
        self._fields += len(way.fields) - before

    def _require_room(self, key: WayKey, flat: dict[str, Any]) -> None:
        known = self.ways.get(key)
        if known is None and len(self.ways) >= MAX_TOOLS:
            raise MalformedError(f"more than {MAX_TOOLS} tools")
        fields = flat.keys() | (set() if known is None else known.fields.keys())
        if len(fields) > MAX_FIELDS:
            raise MalformedError(f"more than {MAX_FIELDS} fields of one tool")
        new = len(fields) - (0 if known is None else len(known.fields))
        if self._fields + new > MAX_ALL:
            raise MalformedError(f"more than {MAX_ALL} fields of all tools")

    def _leave(self, seq: int, why: str) -> None:
        self.unused.append(Unused(seq, why))


def hear(evidence: ShadowEvidence, site: Site, binder: Binder | None) -> ObservedCalls:
    """Return what the plans of a run say.

    Args:
        evidence: a whole log's.
        site: the site.
        binder: of a binding that is sound for it; None: every call is only looked at.
    """
    heard = ObservedCalls(site, binder)
    for plan in evidence.plans:
        heard.add(plan)
    for way in heard.ways.values():
        way.settle()
    return heard


def _way(call: Call) -> WayKey:
    """Return the way that a call is of.

    Raises:
        MalformedError: a name that no binding should hold.
    """
    name = tool_name(call.tool, call.where)
    path = _REACHED.get(name)
    if path is None:
        return name, None
    reached = call.arguments.get(path)
    if not isinstance(reached, str) or not 0 < len(reached) <= MAX_WORD or not reached.isascii():
        raise MalformedError(f"expected a name in ASCII as `{path}`")
    return name, (path, reached)


def _flat(node: dict[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    """Yield the path of each value of a call; a list is one value."""
    for name, value in node.items():
        path = f"{prefix}{name}"
        positional = not prefix and name.isascii() and name.isdecimal() and len(name) < 4
        if (not positional and FIELD.fullmatch(name) is None) or len(path) > MAX_PATH:
            raise MalformedError(f"a field `{shown(path)}` that no path can name")
        if isinstance(value, dict) and value:
            yield from _flat(value, f"{path}.")
        else:
            yield path, value


def _kind(value: Any) -> str:
    if value is None:
        return "null"
    for kind, name in (
        (bool, "truth value"),
        (int, "whole number"),
        (Decimal, "number"),
        (str, "text"),
        (list, "list"),
    ):
        if isinstance(value, kind):
            return name
    return "object"
