# SPDX-License-Identifier: Apache-2.0
"""The obedient reader: which calls a text asks for, by verbs and names, without a model.

It obeys every text and refuses nothing, so that a planner that uses it is captured by every text
that it understands. Spec page: docs/spec/missionpair-access.md#reading
"""

from __future__ import annotations

from functools import lru_cache

from missionpair.briefing import OfferedTool
from missionpair.pair import Value, WordedCall
from missionpair.wording.lexing import Text
from missionpair.wording.obfuscation import plain
from missionpair.wording.outright import called_outright
from missionpair.wording.slots import fill
from missionpair.wording.vocabulary import DELIVERIES, Vocabulary, words

#: Words after which an imperative may stand in the middle of a sentence.
_LEADS = words(
    """
    and then please kindly must to now should robot instead just immediately also therefore so
    will shall first next finally always but or can may simply directly quickly better
    """
)
#: Words that may stand between a denial and the verb that it denies.
_FILLERS = words(
    """
    to please ever longer more now need try have any may can should must will be you it ask
    robot use call run invoke the tool for reason
    """
)
_DENIALS = words(
    "not don't don\u2019t never no cannot can't can\u2019t nobody without avoid refuse"
)
_TO = words("to into towards toward")
#: Words after which another order begins.
_NEXT = words("and then")
#: How many words may stand between such a verb and its `to`.
_REACH = 6


def read(
    text: str, *, tools: tuple[OfferedTool, ...], places: tuple[str, ...], things: tuple[str, ...]
) -> tuple[WordedCall, ...] | None:
    """Return the calls that the text asks for, in its order; None where it asks for none.

    Never raises on any text.

    Args:
        text: untrusted.
        tools: what may be called; a verb whose tool is not among them asks for nothing.
        places: spellings of places.
        things: spellings of things.
    """
    offered = tuple([(tool.name, _ends(tool)) for tool in tools])
    return _read(_vocabulary(offered, places, things), text)


def _ends(tool: OfferedTool) -> tuple[tuple[str, Value | None], ...]:
    """Return each argument of a tool with the most that it takes, where the tool says so."""
    properties = tool.parameters.get("properties", {})
    return tuple((name, schema.get("maximum")) for name, schema in properties.items())


@lru_cache(maxsize=1024)
def _vocabulary(
    offered: tuple[tuple[str, tuple[tuple[str, Value | None], ...]], ...],
    places: tuple[str, ...],
    things: tuple[str, ...],
) -> Vocabulary:
    return Vocabulary({name: dict(ends) for name, ends in offered}, places, things)


@lru_cache(maxsize=8192)
def _read(vocabulary: Vocabulary, written: str) -> tuple[WordedCall, ...] | None:
    text = vocabulary.lexicon.cut(plain(written))
    calls: list[WordedCall] = []
    place = 0
    while place < len(text.tokens):
        token = text.tokens[place]
        if token.kind != "code" and token.text not in vocabulary.beginnings:
            place += 1
            continue
        found = called_outright(text, place, vocabulary.offered)
        if found is not None:
            if not _is_denied(text, place):
                calls += found.calls
            place = found.end
            continue
        asked, place = _asked(text, place, vocabulary)
        calls += asked
    return tuple(calls) or None


def _asked(text: Text, place: int, vocabulary: Vocabulary) -> tuple[list[WordedCall], int]:
    """Return what a verb asks for here, and the place to go on from."""
    if not _may_begin(text, place):
        return [], place + 1
    found = _delivery(text, place, vocabulary) or _framed(text, place, vocabulary)
    if found is None:
        return [], place + 1
    calls, end = found
    return ([] if _is_denied(text, place) else calls), end


def _framed(text: Text, place: int, vocabulary: Vocabulary) -> tuple[list[WordedCall], int] | None:
    """Return the call of the longest verb that begins here and has what it needs."""
    for phrase in vocabulary.phrases.get(text.word(place), ()):
        if text.has(place, phrase.words):
            filled = fill(text, place + len(phrase.words), phrase.bound)
            if filled is not None:
                return [filled.call], filled.end
    return None


def _delivery(
    text: Text, place: int, vocabulary: Vocabulary
) -> tuple[list[WordedCall], int] | None:
    """Return the calls of "deliver THING to PLACE": to go there and, where it is named, put it."""
    go, put = vocabulary.frame("navigate_to"), vocabulary.frame("put_down")
    if text.word(place) not in DELIVERIES or go is None:
        return None
    thing = None
    for at in range(place + 1, min(place + 1 + _REACH, len(text.tokens))):
        name = text.name(at)
        if name is not None:
            if not name.is_thing or thing is not None:
                return None
            thing = name.spelling
        elif text.word(at) in _TO:
            gone = fill(text, at + 1, go)
            if gone is None:
                return None
            calls = [gone.call]
            if thing is not None and put is not None and put.names[0] is not None:
                there = gone.call.arguments.get(go.names[0] or "")
                where = {} if put.names[1] is None or there is None else {put.names[1]: there}
                calls.append(WordedCall(tool=put.tool, arguments={put.names[0]: thing, **where}))
            return calls, gone.end
        elif text.kind(at) != "word" or text.word(at) in _NEXT:
            return None
    return None


def _may_begin(text: Text, place: int) -> bool:
    """True when an imperative may begin here: at the start, after a mark, or after a lead."""
    if place == 0 or text.tokens[place].is_fresh:
        return True
    return text.kind(place - 1) == "mark" or text.word(place - 1) in _LEADS


def _is_denied(text: Text, place: int) -> bool:
    before = place - 1
    while before >= 0 and text.word(before) in _FILLERS:
        before -= 1
    return before >= 0 and text.word(before) in _DENIALS
