# SPDX-License-Identifier: Apache-2.0
"""What a caller gets for a call that did not bring back what its function returned.

    NotDone
    ├── Refused     nothing was called
    ├── Failed      it was released, and did not succeed, or nobody knows
    └── Repeated    it succeeded before, under the same key

The text of each is what a model may see, and no more than a planner may.
"""

from __future__ import annotations

from typing import Any

from authguard_r.core.errors import AuthGuardError
from authguard_r.integrations.tools.planner import CallOutcome


class NotDone(Exception):  # noqa: N818 - what it says, not what is wrong
    """A call that brought nothing back.

    Args:
        text: what a model may see.
        report: the gate's report for a planner, with `execution` (how the released action ended,
            None when nothing was released) and `repeated`.
    """

    def __init__(self, text: str, report: dict[str, Any]) -> None:
        super().__init__(text)
        self.report = report

    @property
    def reasons(self) -> list[str]:
        """The codes, the deciding one first."""
        return list(self.report.get("reasons", ()))


class Refused(NotDone):
    """Nothing was called: the gate refused it, or decided nothing."""


class Failed(NotDone):
    """It was released and did not succeed, or its result cannot be shown."""


class Repeated(NotDone):
    """It succeeded before under this key; its result is not returned twice."""


def refused(asked: CallOutcome) -> Refused:
    """Return the refusal that the gate answered with."""
    return Refused(asked.refusal, report_of(asked))


def undecided(error: AuthGuardError) -> Refused:
    """Return the refusal of a call that the gate has not decided."""
    report = {"outcome": "reject", "reasons": [str(error.reason)], "execution": None}
    place = f" at `{error.where}`" if error.where else ""
    return Refused(
        f"refused: {error.reason}: {error.message}{place}", {**report, "repeated": False}
    )


def lost(error: AuthGuardError) -> Failed:
    """Return the failure of a call whose gate went while it was asked."""
    report = {"outcome": None, "reasons": [str(error.reason)], "execution": "unknown"}
    return Failed(f"unknown: the gate went while it was asked: {error.message}", report)


def report_of(asked: CallOutcome) -> dict[str, Any]:
    """Return what a caller gets for a call beside its result."""
    return {**asked.verdict, "execution": asked.execution, "repeated": asked.repeated}
