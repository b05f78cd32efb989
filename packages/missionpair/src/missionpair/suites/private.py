# SPDX-License-Identifier: Apache-2.0
"""A private test split: pairs drawn with your seed, in your own sentences; needs `words=FOLDER`.

Keep folder and seed secret. How-to: docs/howto/missionpair-extend.md
"""

from __future__ import annotations

import re
from pathlib import Path

from missionpair.pair import Suite
from missionpair.suites._form import SuiteError
from missionpair.suites._making import Makers, PairMaker, suite_of
from missionpair.suites.full import matrix
from missionpair.wording.productions import GrammarError, read_grammar

VERSION = 1


def make(words: str = "", seed: str = "", each: str = "5") -> Suite:
    """Return the suite.

    Args:
        words: a folder with at least one of the grammar's files; the others are ours.
        seed: of all draws, a word that nobody guesses.
        each: pairs of each cell; a text is made in one of five ways, by the pair's number there.

    Raises:
        UnknownNameError: `each` is no whole number from 1 on.
        SuiteError: folder or seed is missing or cannot be used.
    """
    if not words or not re.fullmatch(r"[A-Za-z0-9_-]{1,80}", seed):
        text = "say `private:words=FOLDER,seed=WORD`, the word of letters, digits, `-` and `_`"
        raise SuiteError(text, where="private")
    try:
        grammar = read_grammar(Path(words))
    except (GrammarError, OSError) as error:
        raise SuiteError(str(error), where="private") from error
    makers = Makers()
    maker = PairMaker(makers, f"private {seed}", grammar=grammar)
    return suite_of("private", VERSION, makers, matrix("private", maker, each))
