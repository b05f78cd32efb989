# SPDX-License-Identifier: Apache-2.0
"""Words that nothing explains, each run of them at the slot of the clause where it stands.

A question about such words names what they could change: the object, the destination, the speed,
or, where they limit or stand alone, the condition.
"""

from __future__ import annotations

import msgspec

from authguard_r.authoring.drafting import frames
from authguard_r.authoring.drafting.clauses import Clause, Sentence, UnparsedWord
from authguard_r.authoring.drafting.frames import VerbFrame
from authguard_r.authoring.drafting.restraint import limits
from authguard_r.authoring.drafting.tokens import SentenceToken

CONDITION = "condition"
_MANNER = "manner"
_SLOTS = {"object": "object", "to": "destination", "from": "source", "with": "object"}
_ENDS = frozenset(".!?")


def slot_of_stray(stray: UnparsedWord, frame: VerbFrame) -> str:
    """Return the slot that words could change in a frame; a manner of going is a speed."""
    if stray.slot == _MANNER:
        return "speed" if frame in frames.TRAVEL else "force"
    return stray.slot or slot_of(stray.role, frame)


def slot_of(role: str, frame: VerbFrame) -> str:
    """Return the slot that a role has in a frame: what one goes to is a destination."""
    if role == "object" and frame in frames.TRAVEL:
        return "destination"
    return _SLOTS.get(role, "route")


class UnparsedWords:
    """Collects the runs of one sentence.

    Args:
        said: the sentence; the runs are kept there.
    """

    def __init__(self, said: Sentence) -> None:
        self._said = said
        self._limited = False
        self._waiting: list[UnparsedWord] = []

    def add(
        self, token: SentenceToken, clause: Clause | None, *, role: str, under: int, label: str
    ) -> None:
        """Keep one word.

        Args:
            token: the word.
            clause: the clause that it stands in.
            role: the role of a phrase here; empty where a clause could begin.
            under: where the preposition stands that waits for its phrase; below 0 without one.
            label: the token behind; a colon there begins a requirement.
        """
        self._limited = self._limited or limits(token.low) or label == ":"
        slot = CONDITION if self._limited else _slot_of_word(token.low, role)
        end = token.at + len(token.text)
        number = 0 if clause is None else clause.number
        run = self._said.unknown[-1] if self._said.unknown else None
        if run is not None and run.clause == number and self._joins(run, token):
            if slot == "duration" and words_of(run, self._said.text).lower() == "for":
                run.slot = slot
            if run.slot == slot:
                run.end, run.limits = end, run.limits or self._limited
                run.phrase = None  # one word behind a noun may be its label; more say something
                return
        stray = UnparsedWord(token.at, end, number, role or "object", slot, self._limited, under)
        self._said.unknown.append(stray)
        phrases = [phrase for phrase in self._said.phrases if phrase.clause == number]
        if under < 0 and phrases:
            stray.phrase = phrases[-1].number
        else:
            self._waiting.append(stray)

    def dangling(self, at: int, end: int, clause: Clause | None, role: str) -> None:
        """Keep a preposition that no phrase followed, with the words that followed instead."""
        if self.holds(at):
            self.extend(at)
            return
        number = 0 if clause is None else clause.number
        self._said.unknown.append(UnparsedWord(at, end, number, role, "", limits=False, under=at))

    def holds(self, at: int) -> bool:
        """True when words without a meaning follow the preposition that stands there."""
        return any(stray.under == at for stray in self._said.unknown)

    def extend(self, at: int) -> None:
        """Take a preposition into the words that followed it."""
        for stray in self._said.unknown:
            if stray.under == at:
                stray.begin = at
                return

    def phrase(self, number: int) -> None:
        """Give the words that waited for it their phrase."""
        for stray in self._waiting:
            stray.phrase = number
        self._waiting = []

    def preposition(self) -> None:
        """Words before a preposition belong to no phrase behind it."""
        self._waiting = []

    def end(self, mark: str) -> None:
        """Words before a boundary belong to no phrase behind it; a full stop ends a limit."""
        self._waiting = []
        self._limited = self._limited and mark not in _ENDS

    def _joins(self, run: UnparsedWord, token: SentenceToken) -> bool:
        between = self._said.text[run.end : token.at].lower().split()
        return all(word in frames.FILLERS for word in between)


def words_of(stray: UnparsedWord, text: str) -> str:
    """Return the words of a run as they were said, on one line."""
    return " ".join(text[stray.begin : stray.end].split())


def settle_clauses(said: Sentence) -> None:
    """Give words before the first verb the clause that follows them."""
    if said.clauses:
        first = min(said.clauses, key=lambda clause: clause.number)
        said.unknown = [
            stray if stray.clause else msgspec.structs.replace(stray, clause=first.number)
            for stray in said.unknown
        ]


def _slot_of_word(low: str, role: str) -> str:
    """Return the slot that a word itself names; empty leaves it to the role that it stands in."""
    found = frames.MANNERS.get(low, _MANNER if low.endswith("ly") else "")
    return found or ("" if role else CONDITION)
