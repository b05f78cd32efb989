# SPDX-License-Identifier: Apache-2.0
"""A fault of what a planner wrote, in the form of a decision's findings."""

from __future__ import annotations

from typing import Any


def fault_finding(reason: str, where: str, message: str) -> dict[str, Any]:
    """Return why nothing was decided as a finding, so that a planner reads one shape."""
    return {"field": where, "reason": reason, "expected": message, "got": "", "step": 0}
