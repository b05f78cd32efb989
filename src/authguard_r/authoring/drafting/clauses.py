# SPDX-License-Identifier: Apache-2.0
"""What a sentence says, before anything is looked up: clauses with phrases in roles.

Nothing here decides; a phrase keeps every meaning that the site allows it. The planner of the
template grammar resolves phrases and asks about what is left over.
"""

from __future__ import annotations

from enum import StrEnum

import msgspec
from msgspec import Struct

from authguard_r.authoring.drafting.frames import VerbFrame
from authguard_r.authoring.drafting.lexicon import Ref
from authguard_r.authoring.drafting.measures import Daytime, Measure, QuantityDimension


class PhraseWay(StrEnum):
    """How a phrase names its thing."""

    NAMED = "named"
    PRONOUN = "pronoun"  # it, them
    PART = "part"  # the door: of the one thing that has one
    INSIDE = "inside"  # place it inside: of the one thing that has an inside
    DOOR = "door"  # the door of a place, or between two


class NounPhrase(Struct, frozen=True):
    """One noun phrase.

    Args:
        text: as it was said.
        way: how it names its thing.
        number: its place among the phrases of the sentence.
        clause: the number of its clause.
        refs: what it can mean; empty for a pronoun.
        exact: it is a whole name of the site.
        sides: for a door, the regions that each place at it can mean.
    """

    text: str
    way: PhraseWay
    number: int
    clause: int
    refs: tuple[Ref, ...] = ()
    exact: bool = True
    sides: tuple[tuple[Ref, ...], ...] = ()


class UnparsedWord(Struct):
    """A run of words that nothing explains.

    Args:
        begin: where it begins in the sentence, in characters.
        end: where it ends.
        clause: the number of its clause; 0 before the first.
        role: the role that it stands in.
        slot: what the words themselves are about; empty leaves it to the role.
        limits: it takes back or limits what was said, and cannot be left out.
        under: where the preposition stands that had no phrase yet; below 0 without one.
        phrase: the number of the phrase that it belongs to.
    """

    begin: int
    end: int
    clause: int
    role: str
    slot: str
    limits: bool
    under: int
    phrase: int | None = None


class BatteryCondition(Struct, frozen=True):
    """A condition on the battery: `low`, or a share with its side.

    Args:
        text: as it was said.
        comparison: `lt`, `le`, `gt` or `ge`.
        permille: the bound; None when the sentence says `low`.
    """

    text: str
    comparison: str
    permille: int | None


class Clause(Struct):
    """One verb with what belongs to it; filled while the sentence is read.

    Args:
        number: from 1, in the order of the sentence; answers name it.
        frame: what it asks for.
        verb: the wording.
        state: `on` or `off`, as far as the verb or a particle said it.
        roles: phrases by role (`object`, `to`, `from`, `with`).
        liquid: what is poured or filled in.
        measures: quantities by dimension; an upper bound each.
        bare: numbers whose unit is missing, with what the words around them name.
        repeat: how often; 0 when it was not said.
        careful: a manner such as `gently`.
        rights: what was said about recording, storing and transmitting.
        condition: when it may be done at all.
        earlier: it comes before the clause that it follows in the sentence (`after turning it on`).
        extras: words of the frame that settle a detail (`leave it open`).
    """

    number: int
    frame: VerbFrame
    verb: str
    state: list[str] = msgspec.field(default_factory=list)
    roles: dict[str, list[NounPhrase]] = msgspec.field(default_factory=dict)
    liquid: str | None = None
    measures: dict[QuantityDimension, Measure] = msgspec.field(default_factory=dict)
    bare: list[tuple[str, str]] = msgspec.field(default_factory=list)
    repeat: int = 0
    careful: bool = False
    rights: dict[str, bool] = msgspec.field(default_factory=dict)
    condition: BatteryCondition | None = None
    earlier: bool = False
    extras: set[str] = msgspec.field(default_factory=set)


class Sentence(Struct):
    """Everything that a sentence says.

    Args:
        text: the sentence.
        clauses: in the order in which they are to be done.
        phrases: every phrase, in the order of the sentence.
        robots: robots that were named.
        deadline: `before 14:30`: a time of day that still needs its date.
        start: `at 14:30`, likewise.
        begin: the instant that a bare `at 2` was settled to mean.
        expiry: an end with date and zone.
        length: `within 25 minutes`.
        delay: `in 25 minutes`, which may be the begin or the end, as it was said; empty: not said.
        unknown: words that nothing explains, in order.
        unsettled: conditions that no clause follows.
    """

    text: str
    clauses: list[Clause] = msgspec.field(default_factory=list)
    phrases: list[NounPhrase] = msgspec.field(default_factory=list)
    robots: list[str] = msgspec.field(default_factory=list)
    deadline: Daytime | None = None
    start: Daytime | None = None
    begin: str | None = None
    expiry: str | None = None
    length: Measure | None = None
    delay: str = ""
    unknown: list[UnparsedWord] = msgspec.field(default_factory=list)
    unsettled: list[str] = msgspec.field(default_factory=list)
