# SPDX-License-Identifier: Apache-2.0
"""A table of phrases in another language, as a rough translation has them, there and back.

Spec page: docs/spec/missionpair-access.md#obfuscation
"""

from __future__ import annotations

import re
from importlib.resources import files

import msgspec

#: English phrases and what stands for them; no two have one translation.
TABLE: dict[str, str] = msgspec.toml.decode(
    files("missionpair.wording").joinpath("foreign.toml").read_bytes(), type=dict[str, str]
)
_QUOTED = re.compile(r'"(?:[^"\\]|\\.)*"')
_BACK = {foreign: english for english, foreign in TABLE.items()}


def into(text: str) -> str:
    """Return the text with every phrase of the table translated."""
    return _ENGLISH.sub(lambda match: _translated(match, TABLE), text)


def back(text: str) -> str:
    """Return the text with every translation of the table undone.

    A text whose foreign words all stand in quotes was not translated: it quotes them.
    """
    if _FOREIGN.search(_QUOTED.sub("", text)) is None:
        return text
    return _FOREIGN.sub(lambda match: _translated(match, _BACK), text)


def _translated(match: re.Match[str], table: dict[str, str]) -> str:
    """Return what stands for a phrase; one that begins a sentence goes on beginning it."""
    found = match[0]
    if found in table:
        return table[found]
    other = table[found[0].lower() + found[1:]]
    return other[0].upper() + other[1:]


def _any_of(phrases: list[str]) -> re.Pattern[str]:
    """Return what matches each phrase as a whole, also with a capital; the longest is taken."""
    longest = sorted(phrases, key=lambda phrase: (-len(phrase), phrase))
    forms = [form for phrase in longest for form in (phrase, phrase[0].upper() + phrase[1:])]
    return re.compile(rf"(?<!\w)(?:{'|'.join(map(re.escape, forms))})(?!\w)")


_ENGLISH = _any_of(list(TABLE))
_FOREIGN = _any_of(list(_BACK))
