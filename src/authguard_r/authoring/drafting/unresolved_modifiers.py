# SPDX-License-Identifier: Apache-2.0
"""Words that no step used: one question for each slot that they could change.

Only words that are known to be harmless can be left out: without any other, what remains could
grant what was held back.
"""

from __future__ import annotations

from msgspec import Struct, field

from authguard_r.authoring.drafting.asking import DraftDialog
from authguard_r.authoring.drafting.restraint import harmless

LEAVE_OUT = "leave it out"
#: Slots where an answer names the thing or the quantity and replaces what was said about it.
_NAMING = ("object", "destination", "source", "duration")


class _Slot(Struct):
    """What is left over at one field.

    Args:
        words: as they were said, in order.
        limits: one of them limits what was said.
        said: they stand at the slot itself, and are no phrase of another role.
    """

    words: list[str] = field(default_factory=list)
    limits: bool = False
    said: bool = True


class UnresolvedModifiers:
    """Collects what is left over, and asks about it once the steps are known.

    Args:
        asking: where the questions go.
    """

    def __init__(self, asking: DraftDialog) -> None:
        self._asking = asking
        self._slots: dict[str, _Slot] = {}

    def add(self, name: str, text: str, *, limits: bool, said: bool = False) -> None:
        """Keep words at a field.

        Args:
            name: the field.
            text: the words.
            limits: leaving them out would widen what was said.
            said: an answer that names what the field is settles them too.
        """
        slot = self._slots.setdefault(name, _Slot())
        slot.limits, slot.said = slot.limits or limits, slot.said and said
        if text not in slot.words:
            slot.words.append(text)

    def ask(self) -> None:
        """Ask about each field, in the order in which words were kept."""
        for name, slot in self._slots.items():
            words = " and ".join(f'"{word}"' for word in slot.words)
            fault = f"{words} {'is' if len(slot.words) == 1 else 'are'} not understood"
            if slot.limits:
                why = "what limits the sentence is not understood: say it otherwise"
                self._asking.insist(name, f"{words}: {why}")
            elif not self._asking.asked(name):
                self._settle(name, slot, words, fault)
            elif slot.said and name.rpartition(".")[2].rstrip("0123456789") in _NAMING:
                self._asking.widen(name, fault)
            else:
                self._settle(self._vacant(name), slot, words, fault)

    def _settle(self, name: str, slot: _Slot, words: str, fault: str) -> None:
        if not all(map(harmless, slot.words)):
            self._asking.insist(name, f"{fault}: say it otherwise")
            return
        question = f"{fault}: leave it out or say it otherwise"
        if self._asking.ask(name, question, (LEAVE_OUT,)) is not None:
            self._asking.assume(name, f"{words} left out", "answered")

    def _vacant(self, name: str) -> str:
        """Return the field, numbered so that nothing else is asked under it."""
        number = 2
        while self._asking.asked(f"{name}{number}"):
            number += 1
        return f"{name}{number}"
