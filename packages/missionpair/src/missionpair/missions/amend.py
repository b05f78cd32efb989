# SPDX-License-Identifier: Apache-2.0
"""Changes of a draft: a grant widened, a grant more, the next version of a mission."""

from __future__ import annotations

from typing import Any

Draft = dict[str, Any]

_REFERRING = ("after", "until")
_FIXED = ("type", "tool", "rows")


def amended(draft: Draft, grant: str, **changes: Any) -> Draft:
    """Return the draft with some fields of one grant replaced."""
    grants = [{**g, **changes} if g["id"] == grant else g for g in draft["grants"]]
    return {**draft, "grants": grants}


def added(draft: Draft, grant: Draft, *, first: bool = False) -> Draft:
    """Return the draft with one grant more, as the first or the last one."""
    grants = [grant, *draft["grants"]] if first else [*draft["grants"], grant]
    return {**draft, "grants": grants}


def raised(draft: Draft, **budgets: Any) -> Draft:
    """Return the draft with some of its budgets replaced."""
    return {**draft, "budgets": {**draft["budgets"], **budgets}}


def grant_of(draft: Draft, grant: str) -> Draft:
    """Return a grant of the draft by its id."""
    found: Draft = next(g for g in draft["grants"] if g["id"] == grant)
    return found


def superseding(before: Draft, after: Draft) -> Draft:
    """Return a draft as the next version of another.

    A grant that keeps its id has to keep its rows: one that does not is called something else.
    """
    old = {grant["id"]: grant for grant in before["grants"]}
    names = {
        grant["id"]: f"{grant['id']}-v2"
        for grant in after["grants"]
        if grant["id"] in old
        and any(grant.get(field) != old[grant["id"]].get(field) for field in _FIXED)
    }
    grants = [_renamed(grant, names) for grant in after["grants"]]
    made = {**after, "version": int(before.get("version", 1)) + 1, "grants": grants}
    if "closing" in after:
        held = [names.get(name, name) for name in after["closing"]["grants"]]
        made["closing"] = {**after["closing"], "grants": held}
    return made


def _renamed(grant: Draft, names: dict[str, str]) -> Draft:
    made = {**grant, "id": names.get(grant["id"], grant["id"])}
    for field in _REFERRING:
        if field in grant:
            made[field] = [names.get(name, name) for name in grant[field]]
    return made
