# SPDX-License-Identifier: Apache-2.0
"""What a proposer hands over: a draft that authorizes nothing, or the questions before it.

A proposal is plain data. It reaches a signature only through the compiler's strict schema and the
review card, as if a person had typed it. How-to: docs/howto/drafting.md
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from msgspec import Struct

from authguard_r.core.errors import ClarificationError
from authguard_r.site.model import Site


class DraftQuestion(Struct, frozen=True):
    """One thing that only a person can say.

    Args:
        field: the slot that the answer settles, such as `destination` or `window.expiry`.
        question: one sentence for the operator.
        candidates: the answers that are possible; none when any may be given.
    """

    field: str
    question: str
    candidates: tuple[str, ...] = ()


class Assumption(Struct, frozen=True):
    """One thing that the sentence did not say, shown to the reviewer with its origin.

    Args:
        field: what was settled.
        value: to what.
        why: the profile, the site model, or the rule of the grammar that it comes from.
    """

    field: str
    value: str
    why: str


class DraftProposal(Struct, frozen=True):
    """A draft, or questions; never both, and never authority.

    Args:
        draft: plain data in the draft format; empty while a question is open.
        questions: what is open, in the order of the sentence.
        proposer: who proposes, for the record.
        assumed: what the sentence did not say.
    """

    draft: dict[str, Any]
    questions: tuple[DraftQuestion, ...]
    proposer: str
    assumed: tuple[Assumption, ...] = ()


class Proposer(Protocol):
    """Anything that turns a sentence into a proposal; always untrusted."""

    def propose(
        self, sentence: str, site: Site, *, robot: str | None, settled: Mapping[str, str]
    ) -> DraftProposal:
        """Return a draft for the sentence, or what must be asked first.

        Args:
            sentence: what the operator said.
            site: the site model that the words are looked up in.
            robot: the robot that is meant; None leaves it to the sentence.
            settled: answers to earlier questions, by field.

        Raises:
            MalformedError: the sentence or an answer cannot be read.
            EnvironmentFault: a part that the proposer needs is missing or does not answer.
        """
        ...


def clarification(questions: Sequence[DraftQuestion]) -> ClarificationError:
    """Return the questions as the one error that the command line and the compiler know.

    Args:
        questions: at least one; the first is the error's own.
    """
    first, *others = [
        ClarificationError(item.question, field=item.field, candidates=item.candidates)
        for item in questions
    ]
    return ClarificationError(
        first.question, field=first.field, candidates=first.candidates, others=tuple(others)
    )
