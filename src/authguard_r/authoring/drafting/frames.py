# SPDX-License-Identifier: Apache-2.0
"""The words of the grammar itself: verbs with their frames, prepositions, and what is mere filler.

A word is here because the grammar knows what it grants or that it grants nothing. Everything else
in a sentence is a name of the site, a quantity, or a question.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType

from msgspec import Struct


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


class VerbFrame(StrEnum):
    """What a clause asks for."""

    DELIVER = "deliver"
    FETCH = "fetch"
    PICK = "pick"
    PUT = "put"
    DROP = "drop"
    THROW = "throw"
    GO = "go"
    PATROL = "patrol"
    GUIDE = "guide"
    RETURN = "return"
    WAIT = "wait"
    INSPECT = "inspect"
    PHOTO = "take_photo"
    RECORD = "record_video"
    FIND = "find"
    TURN = "turn"
    POUR = "pour"
    FILL = "fill"
    HEAT = "heat"
    LEAVE = "leave"
    OPEN = "open"
    CLOSE = "close"
    SLICE = "slice"
    BREAK = "break"
    COOK = "cook"
    CLEAN = "clean"
    DIRTY = "dirty"
    EMPTY = "empty"
    USE_UP = "use_up"


class VerbWording(Struct, frozen=True):
    """One wording of a frame; `state` is what `turn on` and `turn off` differ by."""

    frame: VerbFrame
    state: str = ""


#: Frames that act on one thing where it is: the action type has the frame's own name.
PLAIN = frozenset(
    {
        VerbFrame.OPEN,
        VerbFrame.CLOSE,
        VerbFrame.SLICE,
        VerbFrame.BREAK,
        VerbFrame.COOK,
        VerbFrame.CLEAN,
        VerbFrame.DIRTY,
        VerbFrame.EMPTY,
        VerbFrame.USE_UP,
    }
)

_WORDINGS: dict[VerbFrame, str] = {
    VerbFrame.DELIVER: "deliver, bring, carry, transport, hand over, take, move",
    VerbFrame.FETCH: "fetch, get, collect, retrieve",
    VerbFrame.PICK: "pick up, pick, grab, grasp, lift, pick it up",
    VerbFrame.PUT: "put down, put, place, set down, set, insert, lay",
    VerbFrame.DROP: "drop",
    VerbFrame.THROW: "throw, toss, hurl",
    VerbFrame.GO: "go, drive, navigate, head, travel, proceed, come, go back, drive back",
    VerbFrame.PATROL: "patrol, make a round of, make rounds of",
    VerbFrame.GUIDE: "guide, lead, escort, accompany, show",
    VerbFrame.RETURN: "return, come home, go home, drive home, go back home",
    VerbFrame.WAIT: "wait, pause",
    VerbFrame.INSPECT: "inspect, check, examine, look at, have a look at",
    VerbFrame.PHOTO: "photograph, take a photo of, take a picture of, take photos of, take a photo",
    VerbFrame.RECORD: "record, film, record a video of, take a video of, make a video of",
    VerbFrame.FIND: "find, locate, look for",
    VerbFrame.TURN: "turn, switch, toggle, power",
    VerbFrame.POUR: "pour",
    VerbFrame.FILL: "fill, fillliquid, fill up",
    VerbFrame.HEAT: "heat, heat up, warm, warm up",
    VerbFrame.LEAVE: "leave",
    VerbFrame.OPEN: "open",
    VerbFrame.CLOSE: "close, shut",
    VerbFrame.SLICE: "slice, cut, chop",
    VerbFrame.BREAK: "break, smash, shatter",
    VerbFrame.COOK: "cook",
    VerbFrame.CLEAN: "clean, wash, wipe",
    VerbFrame.DIRTY: "dirty, soil",
    VerbFrame.EMPTY: "empty",
    VerbFrame.USE_UP: "use up",
}
_STATES = {
    "on": "turn on, switch on, toggle on, power on, start, light, ignite, activate",
    "off": "turn off, switch off, toggle off, power off, extinguish, deactivate",
}


def _verbs() -> Mapping[tuple[str, ...], VerbWording]:
    found = {
        tuple(wording.split()): VerbWording(frame)
        for frame, wordings in _WORDINGS.items()
        for wording in wordings.split(", ")
    }
    for state, wordings in _STATES.items():
        for wording in wordings.split(", "):
            found[tuple(wording.split())] = VerbWording(VerbFrame.TURN, state)
    return MappingProxyType(found)


#: Every wording, word by word in lower case.
VERBS = _verbs()
LONGEST_VERB = max(map(len, VERBS))

#: Prepositions of place that no action type has a meaning for: kept, and asked about.
UNSETTLED = frozenset(
    {
        "next to",
        *_words("near beside behind above below around between across towards toward opposite"),
        *_words("outside against beyond"),
    }
)
#: A preposition and the role of what follows it.
ROLES: Mapping[str, str] = MappingProxyType(
    {
        **dict.fromkeys(_words("to into onto in on inside at over under"), "to"),
        "from": "from",
        "with": "with",
        "using": "with",
        "of": "object",
        **dict.fromkeys(UNSETTLED, "to"),
        **dict.fromkeys(_words("via through past along"), "via"),
    }
)
#: Fillers before a noun only: behind one, or in capitals within a sentence, they may be a label.
DETERMINERS = _words("the a an its your robot")
#: Words that may stand between phrases and settle nothing.
FILLERS = DETERMINERS | _words("please also kindly")
#: Words that part two clauses; a list goes on after them, or a new clause begins.
BOUNDARIES = _words("and then next finally afterwards afterward , ; . ! ?")
#: Openings that ask politely.
OPENINGS: tuple[tuple[str, ...], ...] = (
    ("can", "you"),
    ("could", "you"),
    ("would", "you"),
    ("i", "want", "you", "to"),
    ("you", "should"),
    ("make", "sure", "to"),
)
#: Frame words without authority: `pick it up`, `a video of`, `guide the visitor`.
EXTRAS: Mapping[VerbFrame, frozenset[str]] = MappingProxyType(
    {
        VerbFrame.PICK: frozenset({"up"}),
        VerbFrame.PUT: frozenset({"down", "back"}),
        VerbFrame.GO: frozenset({"back", "over"}),
        VerbFrame.RETURN: frozenset({"back"}),
        VerbFrame.LEAVE: _words("there running closed open on off unattended position"),
        VerbFrame.GUIDE: _words(
            "visitor visitors guest guests patient patients person people me us them"
        ),
        VerbFrame.PHOTO: frozenset({"photo", "photos", "picture", "pictures", "image", "images"}),
        VerbFrame.RECORD: frozenset({"video", "footage"}),
        VerbFrame.DELIVER: frozenset({"over"}),
    }
)
PRONOUNS = frozenset({"it", "them", "this", "that", "these", "those"})
#: The extra that a clause has which says so.
STAYS_OPEN = "stays open"
#: What says that a container stays as it was opened.
LEFT_OPEN: tuple[tuple[str, ...], ...] = tuple(
    tuple(text.split())
    for text in (
        "with the door left open",
        "with its door left open",
        "with the lid left open",
        "with its lid left open",
        "with the door open",
        "with the lid open",
    )
)
#: A part of a thing that stands for the thing: `close the door` of the one thing that has one.
PARTS = frozenset({"door", "lid"})
#: Manners that the profile turns into tighter bounds; no manner ever loosens one.
CAREFUL = _words("gently carefully softly slowly securely safely")
COUNTS: Mapping[str, int] = MappingProxyType({"once": 1, "twice": 2, "thrice": 3})
#: Words about a manner that is not understood, and what they are about.
MANNERS: Mapping[str, str] = MappingProxyType(
    {
        **dict.fromkeys(_words("velocity speed pace fast quick rapid slow hurry"), "speed"),
        **dict.fromkeys(_words("force pressure hard strong might"), "force"),
        **dict.fromkeys(
            _words("second seconds minute minutes hour hours moment long few briefly"), "duration"
        ),
        **dict.fromkeys(_words("more again repeat repeatedly times"), "count"),
    }
)
#: Frames whose object is where they lead.
TRAVEL = frozenset(
    {VerbFrame.GO, VerbFrame.PATROL, VerbFrame.GUIDE, VerbFrame.RETURN, VerbFrame.WAIT}
)
#: Words for the place that a robot returns to.
HOMES = frozenset({"base", "home"})
#: What introduces a quantity that bounds from above, longest first, and the limit that it names.
BOUNDS: tuple[tuple[tuple[str, ...], str], ...] = tuple(
    (tuple(words.split()), meant)
    for words, meant in (
        ("at a maximum speed of", "speed"),
        ("with a maximum speed of", "speed"),
        ("with a maximum force of", "force"),
        ("at a speed of", "speed"),
        ("with a speed of", "speed"),
        ("with a force of", "force"),
        ("not faster than", "speed"),
        ("no faster than", "speed"),
        ("slower than", "speed"),
        ("with at most", ""),
        ("using at most", ""),
        ("not more than", ""),
        ("no more than", ""),
        ("for up to", "duration"),
        ("for at most", "duration"),
        ("at up to", ""),
        ("at most", ""),
        ("at speed", "speed"),
        ("with force", "force"),
        ("up to", ""),
        ("speed", "speed"),
        ("force", "force"),
        ("with", ""),
        ("for", "duration"),
        ("at", "at"),
    )
)
RIGHTS: Mapping[str, str] = MappingProxyType(
    {
        **dict.fromkeys(_words("record recording recordings"), "record"),
        **dict.fromkeys(_words("store storing storage keep keeping save saving"), "store"),
        **dict.fromkeys(
            _words("transmit transmitting transmission send sending share sharing"),
            "transmit",
        ),
    }
)
DENIALS: tuple[tuple[str, ...], ...] = (("do", "not"), ("don't",), ("without",), ("no",), ("not",))
ALLOWANCES: tuple[tuple[str, ...], ...] = (("with",), ("allow",), ("you", "may"))


def reserved() -> frozenset[str]:
    """Return the words that a name of the site cannot take away from the grammar."""
    groups = (FILLERS, BOUNDARIES, ROLES, PRONOUNS, CAREFUL, COUNTS, ("on", "off"))
    return frozenset(word for group in groups for word in group)


def gerund(word: str) -> tuple[str, ...]:
    """Return the verbs that an `-ing` form can come from: `turning` is `turn` or `turne`."""
    if not word.endswith("ing") or len(word) < 6:
        return ()
    stem = word[:-3]
    doubled = (stem[:-1],) if stem[-1] == stem[-2] else ()
    return (stem, stem + "e", *doubled)
