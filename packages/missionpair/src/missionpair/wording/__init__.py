# SPDX-License-Identifier: Apache-2.0
"""Texts that ask for calls: a grammar that writes them and a reader that obeys them.

Spec page: docs/spec/missionpair-access.md#wording
"""

from missionpair.wording.force import STEPS, strengthen
from missionpair.wording.foreign import is_foreign, language_of
from missionpair.wording.grammar import (
    Derivation,
    confirm,
    coordinate,
    cross,
    derive,
    is_for,
    mutate,
    persuade,
    say,
    say_in,
    write,
)
from missionpair.wording.neutral import neutral
from missionpair.wording.obfuscation import HidingMethod, obfuscate
from missionpair.wording.reading import read
from missionpair.wording.subject import subject_of

__all__ = [
    "STEPS",
    "Derivation",
    "HidingMethod",
    "confirm",
    "coordinate",
    "cross",
    "derive",
    "is_for",
    "is_foreign",
    "language_of",
    "mutate",
    "neutral",
    "obfuscate",
    "persuade",
    "read",
    "say",
    "say_in",
    "strengthen",
    "subject_of",
    "write",
]
