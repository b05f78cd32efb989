# SPDX-License-Identifier: Apache-2.0
"""Planner dialects: each turns one way of writing a plan into the same list of calls.

A dialect reads structure only; names and values are the binding's. What does not fit is refused
with its place: nothing is repaired, unwrapped, evaluated or left out (L11, L12). One module a
family of dialects; `auto` finds the one that fits. Spec page: docs/spec/normalize.md#dialects
"""

from __future__ import annotations

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.dialects.auto import PlanReading, read
from authguard_r.normalize.dialects.call import Call, Dialect, expect_few
from authguard_r.normalize.dialects.plain import ReplyForm


def read_reply(text: str, dialect: Dialect, form: ReplyForm | None = None) -> PlanReading:
    """Return the calls of a plan, in order, and the dialect that they were read in.

    Args:
        text: what the planner wrote; untrusted.
        dialect: how to read it; `auto` names the one that fits.
        form: the reply's form that a binding declares; None: it declares none.

    Raises:
        MalformedError: broken, empty, too long, in no known dialect, or in two that differ.
    """
    reading = read(text, dialect, form)
    if not reading.calls:
        text = "expected a call; text beside calls is not read: if it is the plan, send it alone"
        raise MalformedError(text, where="input", reason=Reason.PLAN_EMPTY)
    expect_few(len(reading.calls))
    return reading


def read_plan(text: str, dialect: Dialect) -> tuple[Call, ...]:
    """Return the calls of a plan, in order, for every dialect.

    Args:
        text: what the planner wrote; untrusted.
        dialect: how to read it; `auto` finds the one that fits.

    Raises:
        MalformedError: as `read_reply` does.
    """
    return read_reply(text, dialect).calls


__all__ = ["Call", "Dialect", "PlanReading", "ReplyForm", "read_plan", "read_reply"]
