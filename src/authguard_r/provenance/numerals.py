# SPDX-License-Identifier: Apache-2.0
"""Words of a text, with number words read as the numbers they are: for evidence only.

`one hundred and three`, `one-oh-three`, `one twenty three` and `103rd` say a number that a name
writes in digits. English number words below a million; a text in another language keeps its words.

Spec page: docs/spec/provenance.md#mentions
"""

from __future__ import annotations

import re
from itertools import pairwise

import msgspec
from msgspec import Struct

from authguard_r.provenance.folding import fold, skeleton

#: Ends the text of an ordinal; no letter or digit, so that no written word has it.
ORDINAL = "\u00b0"

#: Writings without spaces between words are taken character by character.
_WORD = re.compile(r"[\u2e80-\ud7ff]|[^\W_\u2e80-\ud7ff]+")
_HUMP = re.compile(r"(?<=[a-z])(?=[A-Z])")
_SUFFIXED = re.compile(r"([0-9]+)(?:st|nd|rd|th)")
_SENTENCE = re.compile(r"[.,;:!?]")
_FILLERS = frozenset({"no", "nr", "num", "number"})
_SCALES = (100, 1_000)

_ONES = "zero one two three four five six seven eight nine ten eleven twelve thirteen fourteen"
_ONES += " fifteen sixteen seventeen eighteen nineteen"
_TENS = "twenty thirty forty fifty sixty seventy eighty ninety"
#: What a cardinal number word below a hundred says.
_CARDINALS = {
    **dict.fromkeys(("oh", "o", "nought"), 0),
    **{word: value for value, word in enumerate(_ONES.split())},
    **{word: 10 * value for value, word in enumerate(_TENS.split(), start=2)},
}
#: Ordinals that do not end their number in `th` alone.
_IRREGULAR = {"first": 1, "second": 2, "third": 3}
_IRREGULAR |= {"fifth": 5, "eighth": 8, "ninth": 9, "twelfth": 12}


class ComparedToken(Struct, frozen=True, kw_only=True):
    """One word of a text as it is compared.

    Args:
        text: folded; digits when it says a number, and `ORDINAL` after those of an ordinal.
        skeleton: `text` with letters and digits that pass for each other made one.
        start: where it begins in the text that was cut up.
        end: where it ends there.
        spoken: a number in words.
        changed: it is compared as something else than what was written.
        apart: a mark that ends a clause stands before it.
    """

    text: str
    skeleton: str
    start: int
    end: int
    spoken: bool = False
    changed: bool = False
    apart: bool = False


class _Word(Struct, frozen=True):
    value: int
    ordinal: bool


def _words() -> dict[str, _Word]:
    """Return every number word by its skeleton: `0ne` says one too."""
    cardinals = {**_CARDINALS, "hundred": 100, "thousand": 1_000}
    said = {f"{name}th": _Word(value, ordinal=True) for name, value in cardinals.items()}
    said |= {
        f"{name[:-1]}ieth": _Word(value, ordinal=True)
        for name, value in cardinals.items()
        if name in _TENS.split()
    }
    said |= {name: _Word(value, ordinal=True) for name, value in _IRREGULAR.items()}
    said |= {name: _Word(value, ordinal=False) for name, value in cardinals.items()}
    return {skeleton(name): meant for name, meant in said.items()}


_NUMBERS = _words()


def read_tokens(text: str) -> list[ComparedToken]:
    """Return the words of a text in order, numbers read, in time that grows with the text."""
    return _without_fillers(_numbered(_cut(text)))


def has_humps(text: str) -> bool:
    """True when the text has words such as `goToStation`, which are taken apart."""
    return _HUMP.search(text) is not None


def joins(one: ComparedToken, other: ComparedToken) -> bool:
    """True when the two, side by side in a text, may be parts of one name.

    Digits join digits only one by one (`1 0 3`) or when they were in words (`one twenty-three`):
    `Station 10, 1 nurse` names no station 101. A number in words does not join over the end of a
    clause: `at the office, one nurse`.
    """
    if other.apart and (one.spoken or other.spoken):
        return False
    if one.text[-1].isdigit() and other.text[0].isdigit():
        return all(token.spoken or len(token.text) == 1 for token in (one, other))
    return True


def is_number(token: ComparedToken) -> bool:
    """True for a number in digits or words, `hundred and` included."""
    return token.text[0].isdigit() or token.text == "and" or token.text in _FILLERS


def _cut(text: str) -> list[ComparedToken]:
    tokens: list[ComparedToken] = []
    known: dict[str, list[ComparedToken]] = {}  # a word that comes often is read once
    last = 0
    for match in _WORD.finditer(text):
        begin, end = match.span()
        word = match.group()
        if word not in known:
            known[word] = _parts(word)
        apart = _SENTENCE.search(text, last, begin) is not None
        tokens += [
            ComparedToken(
                text=part.text,
                skeleton=part.skeleton,
                start=begin + part.start,
                end=begin + part.end,
                changed=part.changed,
                apart=apart and part.start == 0,
            )
            for part in known[word]
        ]
        last = end
    return tokens


def _parts(word: str) -> list[ComparedToken]:
    """Return the parts of one word, at their places in it."""
    parts: list[ComparedToken] = []
    for start, end in _humps(word):
        text = _compared(word[start:end])
        if text:
            bones, changed = skeleton(text), text.endswith(ORDINAL)
            parts.append(
                ComparedToken(text=text, skeleton=bones, start=start, end=end, changed=changed)
            )
    return parts


def _humps(word: str) -> list[tuple[int, int]]:
    """Return where the parts of a word such as `goToStation` begin and end."""
    if word.islower() or word.isupper():
        return [(0, len(word))]
    cuts = [0, *(hump.start() for hump in _HUMP.finditer(word)), len(word)]
    return list(pairwise(cuts))


def _compared(written: str) -> str:
    """Return a word as it is compared: folded, `103rd` as an ordinal."""
    folded = fold(written)
    if not written.isascii():
        folded = "".join(filter(str.isalnum, folded))
    suffixed = _SUFFIXED.fullmatch(folded)
    return folded if suffixed is None else suffixed[1] + ORDINAL


def _numbered(tokens: list[ComparedToken]) -> list[ComparedToken]:
    """Put one token in the place of the words of each number in words."""
    found: list[ComparedToken] = []
    at = 0
    while at < len(tokens):
        begin = tokens[at]
        end, value, ordinal = _number(tokens, at)
        if end == at or (begin.text in {"o", "oh"} and not _among_numbers(found, tokens, at)):
            found.append(begin)
            at += 1
            continue
        text = f"{value}{ORDINAL if ordinal else ''}"
        found.append(
            ComparedToken(
                text=text,
                skeleton=skeleton(text),
                start=begin.start,
                end=tokens[end - 1].end,
                spoken=True,
                changed=True,
                apart=begin.apart,
            )
        )
        at = end
    return found


def _number(tokens: list[ComparedToken], at: int) -> tuple[int, int, bool]:
    """Return the end, value and kind of the longest number said at `at`; no words, no number."""
    total = part = 0
    first = at
    if tokens[at].text == "a" and _value(tokens, at + 1) in _SCALES:
        part, at = 1, at + 1
    while True:
        word = _word(tokens, at)
        if word is None or not _fits(total, part, word.value, begins=at == first):
            return at, total + part, False
        if word.value == 1_000:
            total, part = max(part, 1) * 1_000, 0
        elif word.value == 100:
            part = max(part, 1) * 100
        else:
            part += word.value
        at += 1
        if word.ordinal or word.value == 0:
            return at, total + part, word.ordinal
        if word.value in _SCALES and _is_and(tokens, at, total, part):
            at += 1


def _fits(total: int, part: int, value: int, *, begins: bool) -> bool:
    """True when a number so far (`total` thousands, `part` beyond) goes on with this word."""
    if begins:
        return True
    if value == 1_000:
        return total == 0 < part
    if value == 100:
        return 0 < part < 100
    if value >= 20:
        return part % 100 == 0
    return value > 0 and (part % 100 == 0 or (value < 10 and part % 10 == 0 and part % 100 >= 20))


def _is_and(tokens: list[ComparedToken], at: int, total: int, part: int) -> bool:
    """True for the `and` of `hundred and three`."""
    if at >= len(tokens) or tokens[at].text != "and":
        return False
    value = _value(tokens, at + 1)
    return value is not None and value < 100 and _fits(total, part, value, begins=False)


def _word(tokens: list[ComparedToken], at: int) -> _Word | None:
    if at >= len(tokens) or tokens[at].text.isdigit():
        return None
    return _NUMBERS.get(tokens[at].skeleton)


def _value(tokens: list[ComparedToken], at: int) -> int | None:
    word = _word(tokens, at)
    return None if word is None else word.value


def _among_numbers(found: list[ComparedToken], tokens: list[ComparedToken], at: int) -> bool:
    """True when a number stands before or after: `oh` and `o` are a zero only there."""
    if found and found[-1].text[-1].isdigit():
        return True
    return at + 1 < len(tokens) and (
        tokens[at + 1].text.isdigit() or _value(tokens, at + 1) is not None
    )


def _without_fillers(tokens: list[ComparedToken]) -> list[ComparedToken]:
    """Leave out the `number` of `Station number 103`."""
    found: list[ComparedToken] = []
    left_out: ComparedToken | None = None
    for place, token in enumerate(tokens):
        after = tokens[place + 1] if place + 1 < len(tokens) else None
        if token.text in _FILLERS and after is not None and after.text[0].isdigit():
            left_out = token
            continue
        if left_out is not None:
            token = msgspec.structs.replace(token, apart=left_out.apart, changed=True)  # noqa: PLW2901
        found.append(token)
        left_out = None
    return found
