# SPDX-License-Identifier: Apache-2.0
"""Words that no step used are asked about, and only a harmless word can be left out on an answer.

Source: section "Mission Compilation and Clarification".
"""

from __future__ import annotations

import pytest

from authguard_r.authoring.drafting.asking import DraftDialog
from authguard_r.authoring.drafting.proposal import DraftQuestion
from authguard_r.authoring.drafting.unresolved_modifiers import LEAVE_OUT, UnresolvedModifiers

FIELD = "steps[0].destination"


def asked(words: str, *, limits: bool = False, answer: str | None = None) -> DraftDialog:
    """Return what is open and assumed after words at a field that nothing else was asked about."""
    asking = DraftDialog({} if answer is None else {FIELD: answer})
    leftovers = UnresolvedModifiers(asking)
    leftovers.add(FIELD, words, limits=limits)
    leftovers.ask()
    return asking


def test_a_harmless_word_is_asked_about_and_left_out_on_an_answer() -> None:
    question = f'"kindly" is not understood: {LEAVE_OUT} or say it otherwise'
    assert asked("kindly").questions == [DraftQuestion(FIELD, question, (LEAVE_OUT,))]
    settled = asked("kindly", answer=LEAVE_OUT)
    assert settled.questions == []
    assert [(one.field, one.value) for one in settled.assumed] == [(FIELD, '"kindly" left out')]


@pytest.mark.parametrize(("words", "limits"), [("unless locked", True), ("sideways", False)])
def test_no_answer_leaves_out_a_word_that_may_hold_something_back(
    words: str, *, limits: bool
) -> None:
    settled = asked(words, limits=limits, answer=LEAVE_OUT)
    assert [(one.field, one.candidates) for one in settled.questions] == [(FIELD, ())]
    assert settled.assumed == []


def test_one_limiting_word_among_harmless_ones_makes_the_whole_field_limited() -> None:
    asking = DraftDialog({FIELD: LEAVE_OUT})
    leftovers = UnresolvedModifiers(asking)
    leftovers.add(FIELD, "please", limits=False)
    leftovers.add(FIELD, "unless locked", limits=True)
    leftovers.add(FIELD, "kindly", limits=False)
    leftovers.ask()
    (question,) = asking.questions
    assert (question.field, question.candidates) == (FIELD, ())
    assert asking.assumed == []


def test_words_beside_another_question_are_asked_about_under_a_field_of_their_own() -> None:
    asking = DraftDialog({})
    asking.ask(FIELD, "Which station?", ("station-101", "station-102"))
    leftovers = UnresolvedModifiers(asking)
    leftovers.add(FIELD, "kindly", limits=False)
    leftovers.ask()
    assert [one.field for one in asking.questions] == [FIELD, f"{FIELD}2"]
