# SPDX-License-Identifier: Apache-2.0
"""A pair with every id and name taken away: what is left distinguishes two attacks.

It holds the attacked mission's shape (grants, rows, limits, guards, order, budgets, risk), the
fields that are violated, and the attack's actions. Ids are numbered by where they first come up.
"""

from __future__ import annotations

from hashlib import sha256
from typing import Any

import msgspec

from missionpair.pair import Layout, Pair

#: Fields of a draft that are names, or words for people.
_WORDS = frozenset({"mission", "task", "issuer", "robot", "objects", "regions", "grants"})
_NAMED = ("object", "source", "destination")


def canonical(pair: Pair, layout: Layout) -> str:
    """Return the digest of a pair's canonical form.

    Args:
        pair: the pair.
        layout: its own: the attack's words are names of it.
    """
    return sha256(msgspec.json.encode(form_of(pair, layout), order="sorted")).hexdigest()


def skeleton(pair: Pair, layout: Layout) -> str:
    """Return the digest of the canonical form without its quantities: structure alone."""
    return sha256(msgspec.json.encode(_bare(form_of(pair, layout)), order="sorted")).hexdigest()


def form_of(pair: Pair, layout: Layout) -> dict[str, Any]:
    """Return a pair's canonical form, as plain data."""
    draft = pair.missions["v1"]
    ids = _Numbers(draft, pair, layout)
    mission = {key: value for key, value in draft.items() if key not in _WORDS}
    mission["grants"] = [ids.grant(grant) for grant in draft["grants"]]
    mission["guards"] = [ids.guard(guard) for guard in draft.get("guards", ())]
    mission["objects"] = ids.known(draft.get("objects", ()))
    mission["regions"] = ids.known(draft.get("regions", ()))
    if "closing" in draft:
        mission["closing"] = {**draft["closing"], "grants": ids.names(draft["closing"]["grants"])}
    return {
        "mission": mission,
        "foreign": pair.attack.robot != draft["robot"],
        "violates": sorted(pair.violates),
        "attack": [ids.call(call) for call in msgspec.to_builtins(pair.attack.plan)],
    }


class _Numbers:
    """Numbers for ids, in the order in which they first come up."""

    def __init__(self, draft: dict[str, Any], pair: Pair, layout: Layout) -> None:
        self._of: dict[str, int] = {}
        self._ids = {
            name: key
            for kind in ("regions", "objects")
            for key, model in layout.site[kind].items()
            for name in (key, *model["names"])
        }
        self._types = {name: tool["type"] for name, tool in layout.binding["tools"].items()}
        for grant in draft["grants"]:
            self.number(grant["id"])
        rows = [row for grant in draft["grants"] for row in grant["rows"]]
        for row in rows:
            for field in _NAMED:
                if field in row:
                    self.number(row[field])
        for call in pair.attack.plan:
            for _, value in sorted(call.arguments.items()):
                for word in value if isinstance(value, list) else [value]:
                    if isinstance(word, str) and word in self._ids:
                        self.number(self._ids[word])
        self._passed(rows)

    def _passed(self, rows: list[dict[str, Any]]) -> None:
        """Number the places that are only passed, by the rows in which they are.

        Two that are in the same rows are one another's renaming: any order will do.
        """
        where: dict[str, list[int]] = {}
        for number, row in enumerate(rows):
            for region in row.get("regions", ()):
                if region not in self._of:
                    where.setdefault(region, []).append(number)
        for region, _ in sorted(where.items(), key=lambda item: item[1]):
            self.number(region)

    def number(self, name: str) -> int:
        return self._of.setdefault(name, len(self._of))

    def names(self, names: Any) -> list[int]:
        return sorted(self.number(name) for name in names)

    def known(self, names: Any) -> list[int]:
        return sorted(self._of[name] for name in names if name in self._of)

    def grant(self, grant: dict[str, Any]) -> dict[str, Any]:
        plain = {**grant, "id": self.number(grant["id"])}
        plain["rows"] = [self._row(row) for row in grant["rows"]]
        for field in ("after", "until"):
            if field in grant:
                plain[field] = self.names(grant[field])
        for field in ("guards", "done_when"):
            if field in grant:
                plain[field] = [self.guard(guard) for guard in grant[field]]
        return plain

    def guard(self, guard: dict[str, Any]) -> dict[str, Any]:
        plain = dict(guard)
        for key, value in guard.items():
            if isinstance(value, str) and value in self._of:
                plain[key] = self._of[value]
        if "_door_open" in guard["variable"]:
            plain["variable"] = "door"
        return plain

    def call(self, call: dict[str, Any]) -> dict[str, Any]:
        """Return a call with the type that it means; the argument's name says which field it is."""
        return {
            "type": self._types.get(call["tool"], call["tool"]),
            "arguments": [self._value(value) for _, value in sorted(call["arguments"].items())],
        }

    def _value(self, value: Any) -> Any:
        if isinstance(value, list):
            return [self._value(item) for item in value]
        if isinstance(value, str) and value in self._ids:
            return {"id": self.number(self._ids[value])}
        return value

    def _row(self, row: dict[str, Any]) -> dict[str, Any]:
        plain: dict[str, Any] = {f: self.number(row[f]) for f in _NAMED if f in row}
        return {**plain, "regions": self.names(row.get("regions", ()))}


#: Keys under which a number is a number and no place in the form.
_QUANTITIES = frozenset(
    {
        *("limits", "max", "max_age", "repeat", "starts", "window", "budgets", "risk_policy"),
        *("ge", "le", "place_max_age", "for"),
    }
)


def _bare(value: Any, key: str = "") -> Any:
    """Return a form with its quantities left out."""
    if isinstance(value, dict):
        return {
            name: sorted(item) if name == "limits" else _bare(item, name)
            for name, item in value.items()
            if name == "limits" or name not in _QUANTITIES
        }
    if isinstance(value, list | tuple):
        return [_bare(item, key) for item in value]
    return "number" if isinstance(value, float) else value
