# SPDX-License-Identifier: Apache-2.0
"""Everything that only a person can settle, gathered in the order of the draft.

One round of questions instead of one question a round: people who are asked piecemeal answer
without looking (L6). A question whose answer hangs on another open one is not asked yet.
Source: section "Mission Compilation and Clarification". Spec page: docs/spec/lint.md#questions
"""

from __future__ import annotations

from collections.abc import Iterable

from authguard_r.authoring.compile.draft import Quantity
from authguard_r.authoring.compile.units import to_integer
from authguard_r.core.errors import ClarificationError


class CompileQuestions:
    """The questions that one round of compiling found open."""

    def __init__(self) -> None:
        self._open: list[ClarificationError] = []

    def ask(self, question: str, field: str, candidates: Iterable[str] = ()) -> None:
        """Note a question.

        Args:
            question: one sentence for the operator.
            field: the draft path that the answer fills.
            candidates: what the site or the draft already knows for it; never taken unasked.
        """
        self._open.append(ClarificationError(question, field=field, candidates=tuple(candidates)))

    def integer(
        self, value: Quantity | None, unit: str, *, field: str, question: str = "How long?"
    ) -> int | None:
        """Return the quantity as a whole number of `unit`, or None once it has been asked about.

        Args:
            value: what the draft says.
            unit: the target's unit.
            field: the draft path.
            question: what to ask when the draft says nothing.

        Raises:
            MalformedError: another dimension, no whole number, or out of range.
        """
        if value is None:
            self.ask(question, field)
            return None
        try:
            return to_integer(value, unit, where=field)
        except ClarificationError as asked:
            self._open.append(asked)
            return None

    def given(self, value: int | None, question: str, field: str) -> int | None:
        """Return the value, or None once it has been asked about."""
        if value is None:
            self.ask(question, field)
        return value

    def require_none(self) -> None:
        """Raise the first open question with the further ones beside it.

        Raises:
            ClarificationError: a question is open.
        """
        if self._open:
            first, *others = self._open
            raise ClarificationError(
                first.question,
                field=first.field,
                candidates=first.candidates,
                others=tuple(others),
            )
