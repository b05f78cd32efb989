# SPDX-License-Identifier: Apache-2.0
"""Questions, answers and assumptions of one run, kept in the order of the sentence."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from authguard_r.authoring.drafting.proposal import Assumption, DraftQuestion
from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason


class DraftDialog:
    """What is settled, what is open, and what was assumed.

    Args:
        settled: answers by field, as the operator gave them.
    """

    def __init__(self, settled: Mapping[str, str]) -> None:
        self._settled = dict(settled)
        self._used: set[str] = set()
        self.questions: list[DraftQuestion] = []
        self.assumed: list[Assumption] = []

    def ask(self, field: str, question: str, candidates: Iterable[str] = ()) -> str | None:
        """Return the answer to a question, or None once the question is kept.

        Raises:
            MalformedError: an answer that is not one of the candidates.
        """
        known = tuple(candidates)
        answer = self.answer(field)
        if answer is None:
            asked = DraftQuestion(field, question, known)
            if asked.field not in {item.field for item in self.questions}:
                self.questions.append(asked)
            return None
        if known and answer not in known:
            raise MalformedError(
                f"expected one of {', '.join(f'`{item}`' for item in known)}, got `{answer}`",
                where=field,
                reason=Reason.VALUE_INVALID,
            )
        return answer

    def insist(self, field: str, question: str) -> None:
        """Keep a question that only another sentence can settle, instead of any other about it."""
        self._used.add(field)
        self.questions = [item for item in self.questions if item.field != field]
        self.questions.append(DraftQuestion(field, question))

    def asked(self, field: str) -> bool:
        """True when something was asked about a field, answered or not."""
        return field in self._used

    def widen(self, field: str, fault: str) -> None:
        """Let a question that names a thing settle words at it, too."""
        for number, item in enumerate(self.questions):
            if item.field == field:
                self.questions[number] = DraftQuestion(
                    field, f"{fault}. {item.question}", item.candidates
                )
                return
        self.assume(field, self._settled.get(field, ""), f"answered; {fault}")

    def answer(self, field: str) -> str | None:
        """Return what was answered for a field; None when nothing was."""
        self._used.add(field)
        return self._settled.get(field)

    def assume(self, field: str, value: object, why: str) -> None:
        """Keep what the sentence did not say, once."""
        item = Assumption(field, str(value), why)
        if item not in self.assumed:
            self.assumed.append(item)

    def require_used(self) -> None:
        """Refuse an answer to a question that was not asked.

        Raises:
            MalformedError: with the field.
        """
        asked = ", ".join(sorted(self._used))
        for field in self._settled:
            if field not in self._used and not self.questions:
                raise MalformedError(
                    f"no question has the field `{field}`; asked: {asked or 'nothing'}",
                    where=field,
                    reason=Reason.FIELD_UNKNOWN,
                )
