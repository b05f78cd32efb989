# SPDX-License-Identifier: Apache-2.0
"""Help texts use plain words: no metaphors as terms, no chains of `nobody` and `whoever`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from authguard_r.cli.app import program
from missionpair.cli import program as missionpair

#: Words that a reader cannot look up: metaphors, and pronouns in the place of the actor.
FORBIDDEN = re.compile(
    r"\b(road|house|lane|mends?|mended|hold|holds|held|desk|ring|nobody|whoever|everybody|somebody"
    r"|told|kept|spoken|believed|anew|goes on|go on|let .* go on|put back|look through|says it)\b",
    re.IGNORECASE,
)
#: Longest sentence of a help text, in words.
LONGEST = 32
#: The object that a gripper holds is one.
ALLOWED = {"The object that the robot holds.", "Make a group key that no member ever holds"}


def texts(command: Any, name: str) -> Iterator[tuple[str, str]]:
    """Yield every help text of a command and those below it, with its place."""
    yield name, command.help or ""
    for word, below in getattr(command, "commands", {}).items():
        yield from texts(below, f"{name} {word}")
    for option in () if hasattr(command, "commands") else command.params:
        yield f"{name} {option.opts[0]}", getattr(option, "help", None) or ""


def every_text() -> list[tuple[str, str]]:
    """Return every help text of both programs."""
    return [*texts(program(), "authguard"), *texts(missionpair(), "missionpair")]


def test_no_help_text_has_a_word_that_a_reader_cannot_look_up() -> None:
    found = [(place, text) for place, text in every_text() if text not in ALLOWED]
    assert len(found) > 500
    assert [(place, text) for place, text in found if FORBIDDEN.search(text)] == []


def test_the_sentences_of_help_are_short() -> None:
    long = [
        (place, sentence)
        for place, text in every_text()
        for sentence in re.split(r"(?<=[.;:])\s+|\n\n", " ".join(text.split(" ")))
        if len(sentence.split()) > LONGEST
    ]
    assert long == []
