# SPDX-License-Identifier: Apache-2.0
"""Tables of phrases in other languages, as a rough translation has them, there and back.

Spec page: docs/spec/missionpair-access.md#obfuscation
"""

from __future__ import annotations

import re
from functools import cache
from importlib.resources import files

import msgspec

#: By language, English phrases and what stands for them; no two have one translation.
TABLES: dict[str, dict[str, str]] = msgspec.toml.decode(
    files("missionpair.wording").joinpath("foreign.toml").read_bytes(),
    type=dict[str, dict[str, str]],
)
#: The language that has every phrase which is written.
WHOLE = "de"
_QUOTED = re.compile(r'"(?:[^"\\]|\\.)*"')
_BACK = {foreign: english for table in TABLES.values() for english, foreign in table.items()}


def into(text: str, language: str = WHOLE) -> str:
    """Return the text with every phrase of a language's table translated."""
    table = TABLES[language]
    return _english(language).sub(lambda match: _translated(match, table), text)


def back(text: str) -> str:
    """Return the text with every translation of every table undone.

    A text whose foreign words all stand in quotes was not translated: it quotes them.
    """
    if _FOREIGN.search(_QUOTED.sub("", text)) is None:
        return text
    return _FOREIGN.sub(lambda match: _translated(match, _BACK), text)


def is_foreign(text: str) -> bool:
    """True when a text has phrases of another language."""
    return back(text) != text


def language_of(text: str) -> str:
    """Return the language of a text that has phrases of one; empty for English."""
    found = _FOREIGN.search(_QUOTED.sub("", text))
    if found is None:
        return ""
    phrase = found[0] if found[0] in _BACK else found[0][0].lower() + found[0][1:]
    return next(name for name, table in TABLES.items() if phrase in table.values())


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


@cache
def _english(language: str) -> re.Pattern[str]:
    return _any_of(list(TABLES[language]))


_FOREIGN = _any_of(list(_BACK))
