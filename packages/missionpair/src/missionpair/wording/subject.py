# SPDX-License-Identifier: Apache-2.0
"""What a text of the grammar makes its claim of: what an attacker may repeat, since it was said.

Spec page: docs/spec/missionpair-access.md#views
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from missionpair.wording.productions import (
    CLAIMS,
    PRODUCTIONS,
    STYLES,
    WRITTEN,
    sentences_of,
)
from missionpair.words import Family


def subject_of(texts: Sequence[str], family: Family, names: Iterable[str]) -> str:
    """Return the name that the texts claim something of; empty where they name nothing so.

    A name that is only asked for, or only mentioned, is not what the claim is of.

    Args:
        texts: in the grammar's words; others name nothing.
        family: what they claim.
        names: everything that could be meant, as people spell it.
    """
    sentences = [text for text in _sentences(family) if "{it}" in text]
    folded = [text.casefold() for text in texts]
    # the longest first: `Station 101` also stands in what is said of `Nurse Station 101`
    for name in sorted(set(names), key=lambda name: (-len(name), name)):
        filled = [text.replace("{it}", name).casefold() for text in sentences]
        if any(words in text for text in folded for words in filled):
            return name
    return ""


def _sentences(family: Family) -> tuple[str, ...]:
    """Return every sentence that may name what the mission has."""
    scenes = PRODUCTIONS.scenes[family]
    return (
        *(
            text
            for same in (False, True)
            for held in (CLAIMS, WRITTEN)
            for long in sentences_of(held, "", family, same=same)
            for text in long.split("{do}")
        ),
        *(text for style in STYLES.values() for text in style.former),
        *(*scenes.against, *scenes.same, *scenes.any),
        *PRODUCTIONS.confirmations,
    )
