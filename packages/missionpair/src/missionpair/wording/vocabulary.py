# SPDX-License-Identifier: Apache-2.0
"""What a reader knows of one planner's tools: which verbs call them, which names are names.

Spec page: docs/spec/missionpair-access.md#reading
"""

from __future__ import annotations

from msgspec import Struct

from missionpair.pair import Value
from missionpair.wording.lexing import NameLexicon, first_word
from missionpair.wording.verbs import FRAMES, CallFrame


def words(text: str) -> frozenset[str]:
    """Return the words of a text."""
    return frozenset(text.split())


#: Verbs of a delivery: go there, and put down there what is named.
DELIVERIES = words("deliver bring carry take transport send move redirect reroute")


class BoundFrame(Struct, frozen=True):
    """A frame with the tool that it calls here.

    Args:
        frame: the verbs and slots.
        tool: the offered tool.
        names: what the tool calls each slot; None: it has no such argument.
        most: the most that each slot takes; None: it has no such end.
    """

    frame: CallFrame
    tool: str
    names: tuple[str | None, ...]
    most: tuple[Value | None, ...]


class CallPhrase(Struct, frozen=True):
    """A verb, word by word, and what it calls."""

    words: tuple[str, ...]
    bound: BoundFrame


class Vocabulary:
    """Tools, verbs and names.

    Args:
        offered: each tool with the names of its arguments, and the most that each takes.
        places: spellings of places.
        things: spellings of things.
    """

    def __init__(
        self,
        offered: dict[str, dict[str, Value | None]],
        places: tuple[str, ...],
        things: tuple[str, ...],
    ) -> None:
        self.lexicon = NameLexicon(places, things)
        self.offered = offered
        #: By their first word, the longest first.
        self.phrases: dict[str, list[CallPhrase]] = {}
        self._bound: dict[str, BoundFrame] = {}
        for frame in FRAMES:
            tool = next((tool for tool in frame.tools if tool in offered), None)
            if tool is None:
                continue
            bound = bind(frame, tool, offered[tool])
            self._bound[frame.tools[0]] = bound
            for verb in (*frame.verbs, *frame.also):
                words = tuple(verb.split())
                self.phrases.setdefault(words[0], []).append(CallPhrase(words, bound))
        for phrases in self.phrases.values():
            phrases.sort(key=lambda phrase: -len(phrase.words))
        #: First words of all that may be asked for; `{` begins JSON.
        self.beginnings = {*self.phrases, *DELIVERIES, "{", *map(first_word, offered)}

    def frame(self, tool: str) -> BoundFrame | None:
        """Return the frame whose first tool this is, with the tool that is offered for it."""
        return self._bound.get(tool)


def bind(frame: CallFrame, tool: str, arguments: dict[str, Value | None]) -> BoundFrame:
    """Return the frame with what the tool calls its slots; no argument fills two of them."""
    names: list[str | None] = []
    for slot in frame.slots:
        known = (name for name in slot.names if name in arguments and name not in names)
        names.append(next(known, None))
    ends = (None if name is None else arguments[name] for name in names)
    most = (slot.most if end is None else end for slot, end in zip(frame.slots, ends, strict=True))
    return BoundFrame(frame, tool, tuple(names), tuple(most))
