# SPDX-License-Identifier: Apache-2.0
"""A text with look-alike characters made one: for evidence, never for authority.

A sign may write a name in wide forms, with marks over the letters, in letters of another script, or
in characters that show nothing at all. A model reads it all the same, so a later search for what a
planner has read must find it. Names that decide anything are compared exactly (`normalize.bind`);
nothing here is called for those.

Spec page: docs/spec/provenance.md#mentions
"""

from __future__ import annotations

import re
import unicodedata

#: Letters and digits with the code points that pass for them, upper and lower case apart because
#: they do not look alike. Compatibility forms and digits of other scripts need no entry.
_PASSES_FOR = {
    "a": "0430 0410 03b1 0391 0251 1d00 13aa a4ee",
    "b": "042c 044c 0412 0432 0392 03b2 0299 13f4 a4d0 0185 0180 13cf",
    "c": "0441 0421 03f2 03f9 1d04 13df a4da 2ca4 2ca5",
    "d": "0501 1d05 13a0 a4d3 056a 0110 0111",
    "e": "0435 0415 03b5 0395 0454 0404 04bd 1d07 13ac a4f0 212e ab32",
    "f": "a730 0192 a4dd 03dc a799 ab35 0584 a798",
    "g": "0261 0581 0262 13c0 a4d6 050c 1d83",
    "h": "04bb 04ba 041d 043d 0397 029c 0570 13bb a4e7 0126 0127 2c8e 2c8f",
    "i": "0456 0406 03b9 0399 0131 026a 13a5 0269 a4f2 2c92 2c93 a647",
    "j": "0458 0408 03f3 1d0a a4d9 13ab 029d",
    "k": "043a 041a 03ba 039a 1d0b 13e6 a4d7 2c94 2c95",
    "l": "04c0 04cf 029f 13de a4e1 026d 01c0 0141 0142",
    "m": "043c 041c 039c 1d0d 13b7 a4df 2c98 2c99 03fa",
    "n": "043f 0578 039d 03b7 0274 a4e0 057c 2c9a 2c9b",
    "o": "043e 041e 03bf 039f 1d0f 0585 0555 03c3 a4f3 03b8 04e9 00d8 00f8 2c9e 2c9f 10ff 3007",
    "p": "0440 0420 03c1 03a1 1d18 13e2 a4d1 03f1 2ca2 2ca3",
    "q": "051b 051a 0563 0566",
    "r": "0433 1d26 0280 a4e3 13a1 13d2 027e ab47 2c85",
    "s": "0455 0405 a731 13da a4e2 0282 054f 13d5 01bd",
    "t": "0442 0422 03c4 03a4 1d1b 13a2 a4d4 0166 0167 2ca6 2ca7",
    "u": "03c5 057d 1d1c a4f4 054d",
    "v": "03bd 0475 0474 1d20 13d9 a4e6",
    "w": "051d 051c 0461 03c9 1d21 13b3 a4ea 0561",
    "x": "0445 0425 03c7 03a7 a4eb",
    "y": "0443 0423 03a5 03b3 028f 04af 04ae 13bd a4ec",
    "z": "0396 1d22 a4dc 0290",
    "3": "0417 0437 01b7 0292 04e0 021c",
    "6": "0431",
    "5": "01bc",
    "8": "0223 0222",
    "#": "2116",
}
_LOOK_ALIKES = {
    chr(int(code, 16)): plain for plain, codes in _PASSES_FOR.items() for code in codes.split()
}
#: Rows of A to Z that Unicode does not take apart: circled, squared and flag letters.
_LETTER_ROWS = (0x1F150, 0x1F170, 0x1F1E6)
#: Invisible tag characters, each of which repeats one ASCII character.
_TAGS = range(0xE0020, 0xE007F)
#: Marks over letters, and characters that show nothing.
_UNSEEN = frozenset({"Mn", "Me", "Cf"})
#: Letters and the digits that pass for them become one; each stays one character long.
_SKELETON = str.maketrans("oilzeasgtb", "0112345978")
_SYMBOL = re.compile(r"(?<=[a-z])[@$!|+](?=[a-z])")
_LETTER_OF = {"@": "a", "$": "s", "!": "i", "|": "l", "+": "t"}


def fold(text: str) -> str:
    """Return the text in lower case and, where there is one, in the ASCII that it looks like.

    Never longer than 18 times the text, in time that grows with it.
    """
    if text.isascii():
        return text.lower()
    seen = {ord(char): _plain(char) for char in set(text) if not char.isascii()}
    return text.translate(seen).lower()


def loosen(text: str) -> str:
    """Return folded text with what else passes for letters: `st@tion`, `Pharrnacy`, `vvard`.

    May take apart what `fold` leaves whole (`corner`), so it is looked at beside it, never instead.
    """
    folded = _SYMBOL.sub(lambda match: _LETTER_OF[match.group()], fold(text))
    return folded.replace("rn", "m").replace("vv", "w")


def skeleton(folded: str) -> str:
    """Return folded text with letters and digits that pass for each other made one.

    As long as the text, so that two spellings of one skeleton can be held against each other.
    """
    return folded.translate(_SKELETON)


def _plain(char: str) -> str:
    known = _LOOK_ALIKES.get(char)
    if known is not None:
        return known
    code = ord(char)
    if code in _TAGS:
        return chr(code - 0xE0000)
    for first in _LETTER_ROWS:
        if 0 <= code - first < 26:
            return chr(ord("a") + code - first)
    digit = unicodedata.decimal(char, None)
    if digit is not None:
        return str(digit)
    return "".join(
        _LOOK_ALIKES.get(part, part)
        for part in unicodedata.normalize("NFKD", char)
        if unicodedata.category(part) not in _UNSEEN
    ).casefold()
