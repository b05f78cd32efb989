# SPDX-License-Identifier: Apache-2.0
"""What each check is worth: take one out of the gate, and see what gets through.

Removing code from the gate is the attacker's side of the house; nothing in the product can do it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any
from unittest.mock import patch

from authguard_r.core import decide as gate
from authguard_r.core import lease
from authguard_r.core.checks import GRANT_CHECKS, MISSION_CHECKS, ROW_CHECKS

#: Every check of the gate by name; the certificate and the approval are not in a list.
CHECKS: tuple[str, ...] = (
    "check_certificate",
    *(check.__name__ for check in (*MISSION_CHECKS, *GRANT_CHECKS, *ROW_CHECKS)),
    "check_approval",
)


@contextmanager
def without(*names: str) -> Iterator[None]:
    """Run with some checks of the gate finding nothing in every case."""
    with ExitStack() as stack:
        for attribute in ("MISSION_CHECKS", "GRANT_CHECKS", "ROW_CHECKS"):
            kept = tuple(c for c in getattr(gate, attribute) if c.__name__ not in names)
            stack.enter_context(patch.object(gate, attribute, kept))
        for name in ("check_certificate", "check_approval"):
            if name in names:
                stack.enter_context(patch.object(gate, name, _finds_nothing))
        for attribute, checks in _ASKED_AGAIN.items():
            if not checks.isdisjoint(names):
                stack.enter_context(patch.object(lease, attribute, _ANSWERS[attribute]))
        yield


def _finds_nothing(*_: Any, **__: Any) -> tuple[()]:
    return ()


def _holds(*_: Any, **__: Any) -> None:
    return None


#: What the lease asks again, just before the robot moves and while it does, and which check first
#: asked it: a condition that is gone is gone from both.
_ASKED_AGAIN: dict[str, frozenset[str]] = {
    "time_findings": frozenset({"check_time"}),
    "registry_findings": frozenset({"check_registry"}),
    "place_findings": frozenset({"check_place"}),
    "guard_finding": frozenset({"check_mission_guards", "check_grant_guards"}),
}
_ANSWERS = dict.fromkeys(_ASKED_AGAIN, _finds_nothing) | {"guard_finding": _holds}
