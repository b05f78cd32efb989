# SPDX-License-Identifier: Apache-2.0
"""Words that hold something back, and the few that can be left out without widening anything.

No list of limiting words is ever complete. Therefore only what stands on the short list of harmless
words may be left out on an answer; the long list decides merely how far a limit reaches.
"""

from __future__ import annotations

import re


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


#: Words that deny, take back, or bound what was said in number, place, time or condition.
LIMITING = _words(
    "not no never none nothing nor neither nobody nowhere cannot without unless except "
    "excepting excepted exclude excluding exclusively but only solely just merely purely "
    "instead rather otherwise else besides apart minus barring bar save avoid avoiding "
    "refuse refusing refrain forbid forbidden prohibit prohibited disallow disallowed ban "
    "banned deny denied skip skipping omit omitting ignore stop halt beware lest keep stay "
    "away out off if when whenever where wherever whether while until till after before "
    "during once as or either provided providing given assuming supposing"
) | _words(
    "least most less fewer more max maximum min minimum exactly half faster slower within "
    "hardly barely scarcely seldom rarely ensure ensuring prevent preventing requirement "
    "must should may might supervised unsupervised later soon now today tomorrow tonight "
    "daily weekly"
)
#: `dont`, `wont`, `mustnt`: a denial that lost its apostrophe, or has another one.
_DENIED = frozenset(
    f"{verb}nt"
    for verb in _words(
        "do does did wo ca must sha should would could is are was were has have had need might "
        "dare ought ai"
    )
) | {"cant"}
#: `n't` with any character for the apostrophe.
_CONTRACTION = re.compile(r"n[^a-z0-9]t\Z")
#: Politeness, address, haste, and manners that no grant could hold: without them a sentence asks
#: for no more.
HARMLESS = _words(
    "please kindly also the a an hello hi hey thanks thank you ok okay dear quickly swiftly "
    "rapidly hurriedly promptly firmly quietly silently nicely neatly politely"
)


def limits(word: str) -> bool:
    """True when leaving the word out could grant what the sentence holds back."""
    low = word.lower()
    letters = "".join(mark for mark in low if mark.isascii() and mark.isalpha())
    return low in LIMITING or letters in _DENIED or _CONTRACTION.search(low) is not None


def harmless(text: str) -> bool:
    """True when every word may be left out; what is not known to be harmless may not."""
    return HARMLESS.issuperset(text.lower().split())
