# SPDX-License-Identifier: Apache-2.0
"""Freeze the suites: `python -m missionpair.suites._freeze`, after a version was raised.

A suite that changed without a new version is refused: published figures name suite and version.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from missionpair import registry, suites
from missionpair.suites import counts_of, load, require_suite

#: Made of rows or sentences that are not shipped: the caller has them.
OPEN = frozenset({"household-rows", "private"})
_FILE = Path(__file__).with_name("frozen.json")


def names() -> tuple[str, ...]:
    """Return the suites that are frozen."""
    return tuple(name for name in registry.names(suites) if name not in OPEN)


def refrozen(held: dict[str, list[dict[str, Any]]]) -> dict[str, list[dict[str, Any]]]:
    """Return what is frozen, with the new versions behind the old ones.

    Raises:
        ValueError: a suite changed and its version did not.
    """
    found = dict(held)
    for name in names():
        suite, _ = load(name)
        require_suite(suite)
        counts, before = counts_of(suite), held.get(name, [])
        if before and before[-1]["digest"] == counts["digest"]:
            found[name] = [*before[:-1], counts]  # the same suite, perhaps counted further
            continue
        if before and before[-1]["version"] >= counts["version"]:
            raise ValueError(f"`{name}` changed: raise its `VERSION` in its module, then freeze")
        found[name] = [*before, counts]
    return dict(sorted(found.items()))


def main() -> int:
    """Write `frozen.json` anew; return the exit code."""
    held = json.loads(_FILE.read_text(encoding="utf-8")) if _FILE.exists() else {}
    try:
        found = refrozen(held)
    except ValueError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    _FILE.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
