# SPDX-License-Identifier: Apache-2.0
"""What the drafting tests share: the hospital, one instant, and answers to what is never said."""

from __future__ import annotations

from typing import Any

from authguard_r.authoring.compile.answers import compile_plain
from authguard_r.authoring.drafting.profile import read_profile
from authguard_r.authoring.drafting.proposal import DraftProposal
from authguard_r.authoring.drafting.template import TemplateProposer
from authguard_r.core.mission import Grant, Mission
from authguard_r.core.quantities import Now
from authguard_r.site.model import Site
from fixtures import scenarios

#: 2026-01-01, 10:00 UTC.
NOW_MS = 1_767_261_600_000
GIVEN = {"issuer": "operator-1", "window": "25 min"}


def propose(
    sentence: str,
    *,
    site: Site | None = None,
    robot: str | None = "courier-1",
    given: dict[str, str] | None = None,
    **settled: str,
) -> DraftProposal:
    """Return the grammar's proposal; `__` in a settled name stands for a dot."""
    answers = {name.replace("__", "."): value for name, value in settled.items()}
    proposer = TemplateProposer(read_profile(), NOW_MS)
    return proposer.propose(
        sentence,
        site or scenarios.site(),
        robot=robot,
        settled={**(GIVEN if given is None else given), **answers},
    )


def fields(proposal: DraftProposal) -> dict[str, tuple[str, ...]]:
    """Return the questions as candidates by field."""
    return {question.field: question.candidates for question in proposal.questions}


def asked_about(proposal: DraftProposal, words: str) -> list[str]:
    """Return the fields whose question quotes these words as not understood."""
    return [
        question.field
        for question in proposal.questions
        if any(words in quoted.split() or words == quoted for quoted in _quoted(question.question))
    ]


def _quoted(text: str) -> list[str]:
    return text.split('"')[1::2]


def compiled(proposal: DraftProposal, site: Site | None = None) -> Mission:
    """Return the mission that a proposal without questions compiles to."""
    assert proposal.questions == ()
    return compile_plain(
        proposal.draft, site or scenarios.site(), now=Now(NOW_MS, 0), nonce="A" * 22
    )


def mission(sentence: str, *, site: Site | None = None, **settled: Any) -> Mission:
    """Return the mission that a sentence means."""
    return compiled(propose(sentence, site=site, **settled), site)


def shape(grants: tuple[Grant, ...]) -> list[tuple[str, str | None, str | None]]:
    """Return what each grant is about: type, object, destination of its first row."""
    return [(g.type, g.alternatives[0].object, g.alternatives[0].destination) for g in grants]
