# SPDX-License-Identifier: Apache-2.0
"""What a reader knows of one planner's tools: which verbs call them, which names are names.

Spec page: docs/spec/missionpair-access.md#reading
"""

from __future__ import annotations

from msgspec import Struct

from missionpair.wording.lexing import Lexicon, first_word
from missionpair.wording.verbs import FRAMES, Frame


def words(text: str) -> frozenset[str]:
    """Return the words of a text."""
    return frozenset(text.split())


#: Verbs of a delivery: go there, and put down there what is named.
DELIVERIES = words("deliver bring carry take transport send move redirect reroute")


class Bound(Struct, frozen=True):
    """A frame with the tool that it calls here.

    Args:
        frame: the verbs and slots.
        tool: the offered tool.
        names: what the tool calls each slot; None: it has no such argument.
    """

    frame: Frame
    tool: str
    names: tuple[str | None, ...]


class Phrase(Struct, frozen=True):
    """A verb, word by word, and what it calls."""

    words: tuple[str, ...]
    bound: Bound


class Vocabulary:
    """Tools, verbs and names.

    Args:
        offered: each tool with the names of its arguments.
        places: spellings of places.
        things: spellings of things.
    """

    def __init__(
        self,
        offered: dict[str, tuple[str, ...]],
        places: tuple[str, ...],
        things: tuple[str, ...],
    ) -> None:
        self.lexicon = Lexicon(places, things)
        self.offered = offered
        #: By their first word, the longest first.
        self.phrases: dict[str, list[Phrase]] = {}
        self._bound: dict[str, Bound] = {}
        for frame in FRAMES:
            tool = next((tool for tool in frame.tools if tool in offered), None)
            if tool is None:
                continue
            bound = bind(frame, tool, offered[tool])
            self._bound[frame.tools[0]] = bound
            for verb in (*frame.verbs, *frame.also):
                words = tuple(verb.split())
                self.phrases.setdefault(words[0], []).append(Phrase(words, bound))
        for phrases in self.phrases.values():
            phrases.sort(key=lambda phrase: -len(phrase.words))
        #: First words of all that may be asked for; `{` begins JSON.
        self.beginnings = {*self.phrases, *DELIVERIES, "{", *map(first_word, offered)}

    def frame(self, tool: str) -> Bound | None:
        """Return the frame whose first tool this is, with the tool that is offered for it."""
        return self._bound.get(tool)


def bind(frame: Frame, tool: str, arguments: tuple[str, ...]) -> Bound:
    """Return the frame with what the tool calls its slots; no argument fills two of them."""
    names: list[str | None] = []
    for slot in frame.slots:
        known = (name for name in slot.names if name in arguments and name not in names)
        names.append(next(known, None))
    return Bound(frame, tool, tuple(names))
