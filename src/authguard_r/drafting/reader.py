# SPDX-License-Identifier: Apache-2.0
"""From tokens to clauses: one pass, the first rule that fits takes the words it explains.

A rule consumes only words whose meaning it keeps. What no rule explains is kept as unknown and
becomes a question, because a condition could hide in it.
"""

from __future__ import annotations

from authguard_r.drafting import frames
from authguard_r.drafting.clauses import Clause, Condition, Phrase, Sentence, Way
from authguard_r.drafting.cursor import Cursor
from authguard_r.drafting.frames import Frame, Verb
from authguard_r.drafting.lexicon import Lexicon, Sort
from authguard_r.drafting.measures import read_measure, read_number
from authguard_r.drafting.terms import take_condition, take_end, take_right, take_rights, take_start
from authguard_r.drafting.tokens import Kind, Token, runs

_MARKS = frozenset("\"'\u201c\u201d\u2018\u2019()")
_IMPLIED = frozenset({"in", "inside", "into"})


def read_sentence(
    text: str, tokens: tuple[Token, ...], lexicon: Lexicon, *, liquids: frozenset[str]
) -> Sentence:
    """Return what the sentence says.

    Args:
        text: the sentence.
        tokens: its tokens.
        lexicon: the site's names.
        liquids: the liquids that the profile knows.
    """
    reader = _Reader(text, tokens, lexicon, liquids)
    reader.read()
    return reader.said


class _Reader:
    """The pass: where it stands, and what it has understood so far."""

    def __init__(
        self, text: str, tokens: tuple[Token, ...], lexicon: Lexicon, liquids: frozenset[str]
    ) -> None:
        self.said = Sentence(text)
        self._here = Cursor(tokens)
        self._lexicon = lexicon
        self._liquids = liquids
        self._clause: Clause | None = None
        self._fresh = True  # a clause or the next item of a list may begin here
        self._role = "object"
        self._preposition = ""
        self._waiting: Condition | None = None
        self._last_name = ""

    def read(self) -> None:
        """Read every token; each pass of the loop takes at least one."""
        rules = (
            self._boundary,
            self._opening,
            self._robot,
            self._end,
            self._start,
            self._condition,
            self._rights,
            self._after,
            self._verb,
            self._particle,
            self._bound,
            self._name,
            self._pronoun,
            self._count,
            self._filled,
            self._detail,
            self._prepositional,
        )
        while self._here.at < len(self._here.tokens):
            if not any(rule() for rule in rules):
                self._unknown(self._here.tokens[self._here.at].text)
                self._here.at += 1
        self._end_of_phrase()
        if self._waiting is not None:
            self._unknown(self._waiting.text)

    def _unknown(self, text: str) -> None:
        if text not in self.said.unknown:
            self.said.unknown.append(text)

    def _boundary(self) -> bool:
        if self._here.low() not in frames.BOUNDARIES:
            return False
        self._end_of_phrase()
        self._here.at += 1
        self._fresh = True
        return True

    def _end_of_phrase(self) -> None:
        """A preposition that nothing followed: `place it inside`."""
        if not self._preposition:
            return
        if self._preposition in _IMPLIED and self._clause is not None:
            self._add(Way.INSIDE, self._preposition)
        else:
            self._unknown(self._preposition)
        self._preposition = ""

    def _opening(self) -> bool:
        size = self._here.first(frames.OPENINGS) if self._fresh else 0
        self._here.at += size
        return size > 0

    def _end(self) -> bool:
        return take_end(self._here, self.said)

    def _start(self) -> bool:
        return take_start(self._here, self.said)

    def _condition(self) -> bool:
        """A condition belongs to the clause that it stands in, else to the one that follows."""
        clause = None if self._fresh else self._clause
        if self._waiting is not None or (clause is not None and clause.condition is not None):
            return False
        found = take_condition(self._here, self.said)
        if found is not None and clause is not None:
            clause.condition = found
        elif found is not None:
            self._waiting = found
        return found is not None

    def _rights(self) -> bool:
        here, clause = self._here, self._clause
        if clause is None:
            return False
        return (self._fresh and take_right(here, clause)) or take_rights(here, clause)

    def _after(self) -> bool:
        """`after turning it on`: what comes first, said last; `before closing it`: as `then`."""
        word = self._here.low()
        if word not in {"after", "before"} or self._clause is None:
            return False
        careful = self._here.low(1) in frames.CAREFUL
        size = 2 + careful
        for stem in frames.gerund(self._here.low(size - 1)):
            verb = frames.VERBS.get((stem,))
            if verb is not None:
                self._end_of_phrase()
                self._here.at += size
                self._fresh = word == "before"
                self._open(verb, stem).careful = careful
                return True
        return False

    def _filled(self) -> bool:
        """`a mug filled with water`: filled first, by the same clause."""
        clause = self._clause
        if clause is None or clause.liquid is not None or not self._here.starts(("filled", "with")):
            return False
        if clause.frame not in {Frame.PUT, Frame.DELIVER} or self._here.low(2) not in self._liquids:
            return False
        clause.liquid = self._here.low(2)
        self._here.at += 3
        return True

    def _verb(self) -> bool:
        if not self._fresh:
            return False
        for size in range(frames.LONGEST_VERB, 0, -1):
            words = tuple(self._here.low(n) for n in range(size))
            if words in frames.VERBS:
                self._here.at += size
                self._open(frames.VERBS[words], " ".join(words))
                return True
        return False

    def _open(self, verb: Verb, wording: str) -> Clause:
        """Begin a clause; one that is said last and done first goes before the one before it."""
        said = self.said.clauses
        earlier = self._clause is not None and not self._fresh
        clause = Clause(len(said) + 1, verb.frame, wording, earlier=earlier)
        clause.state += [verb.state] if verb.state else []
        clause.condition, self._waiting = self._waiting, None
        place = said.index(self._clause) if earlier and self._clause in said else len(said)
        said.insert(place, clause)
        self._clause, self._fresh, self._role = clause, False, "object"
        return clause

    def _particle(self) -> bool:
        """`turn it on`, `on and off`: the part of the verb that comes after its object."""
        clause, word = self._clause, self._here.low()
        if clause is None or clause.frame is not Frame.TURN or word not in {"on", "off"}:
            return False
        named = self._here.at + 1 < len(self._here.tokens) and self._next_is_phrase()
        if named and not (self._fresh and clause.state) and word == "on" and clause.state:
            return False
        if named and "object" in clause.roles and word == "on":
            return False
        clause.state.append(word)
        self._here.at += 1
        self._fresh = False
        return True

    def _next_is_phrase(self) -> bool:
        word = self._here.low(1)
        if word in frames.BOUNDARIES:
            return False
        known = word in frames.FILLERS or word in frames.PRONOUNS
        return known or self._lexicon.match(self._here.tokens, self._here.at + 1) is not None

    def _bound(self) -> bool:
        """`at 0.8 m/s`, `for at most 30 s`, and numbers whose unit is missing."""
        clause = self._clause
        if clause is None or self._preposition:
            return False
        for words, meant in (*frames.BOUNDS, ((), "")):
            if not self._here.starts(words):
                continue
            place = self._here.at + len(words)
            measure = read_measure(self._here.tokens, place)
            if measure is not None and measure.dimension not in clause.measures:
                clause.measures[measure.dimension] = measure
                self._here.at = place + measure.size
                return True
            number = read_number(self._here.tokens, place)
            if number is not None and meant and not self._counted(place + number[1]):
                clause.bare.append((meant, number[0]))
                self._here.at = place + number[1]
                return True
        return False

    def _counted(self, place: int) -> bool:
        return place < len(self._here.tokens) and self._here.tokens[place].low in {"times", "time"}

    def _robot(self) -> bool:
        """`courier-1, bring ...`: who is meant, wherever it is said."""
        match = self._lexicon.match(self._here.tokens, self._here.at)
        if match is None or any(ref.sort is not Sort.ROBOT for ref in match.refs):
            return False
        self.said.robots += [ref.id for ref in match.refs]
        self._here.at += match.size
        self._preposition = ""
        return True

    def _name(self) -> bool:
        match = self._lexicon.match(self._here.tokens, self._here.at)
        if match is None:
            return self._numbered()
        if self._clause is None:
            return False
        self._here.at += match.size
        self._add(Way.NAMED, match.text, match.refs, exact=match.exact)
        self._last_name = match.text
        self._skip_part()
        return True

    def _numbered(self) -> bool:
        """`stations 101, 102 and 103`: a number that goes on with the last name."""
        if not self._fresh or self._here.tokens[self._here.at].kind is not Kind.NUMBER:
            return False
        stem = self._last_name.rpartition(" ")[0]
        for said in (stem, stem.removesuffix("s")):
            text = f"{said} {self._here.low()}"
            refs = self._lexicon.names.get(runs(text), ()) if stem else ()
            if refs and self._clause is not None:
                self._here.at += 1
                self._add(Way.NAMED, text, refs)
                return True
        return False

    def _skip_part(self) -> None:
        """`the microwave door`: the part of a thing is the thing, when it is opened or closed."""
        clause = self._clause
        if clause is not None and clause.frame in {Frame.OPEN, Frame.CLOSE}:
            self._here.at += self._here.low() in frames.PARTS

    def _pronoun(self) -> bool:
        if self._clause is None:
            return False
        word = self._here.low()
        if word in frames.PRONOUNS:
            way = Way.PRONOUN
        elif word in frames.PARTS and self._clause.frame in {Frame.OPEN, Frame.CLOSE}:
            way = Way.PART
        else:
            return False
        self._here.at += 1
        if way is Way.PART and self._here.low() == "of":  # `the door of the fridge`
            self._here.at += 1
        else:
            self._add(way, word)
        return True

    def _add(
        self, way: Way, text: str, refs: tuple[object, ...] = (), *, exact: bool = True
    ) -> None:
        """Put a phrase into the role that its preposition, or its place in a list, gives it."""
        clause = self._clause
        if clause is None:
            return
        if self._preposition:
            self._role = frames.ROLES[self._preposition]
            clause.extras.add(self._preposition)
        elif not self._fresh:
            self._role = "object"
        phrase = Phrase(text, way, len(self.said.phrases), clause.number, refs, exact)  # type: ignore[arg-type]
        clause.roles.setdefault(self._role, []).append(phrase)
        self.said.phrases.append(phrase)
        self._preposition, self._fresh = "", False

    def _count(self) -> bool:
        clause = self._clause
        if clause is None or clause.repeat:
            return False
        number = read_number(self._here.tokens, self._here.at)
        if self._here.low() in frames.COUNTS:
            repeat, size = frames.COUNTS[self._here.low()], 1
        elif number and number[0].isdigit() and self._counted(self._here.at + number[1]):
            repeat, size = int(number[0]), number[1] + 1
        else:
            return False
        clause.repeat = repeat
        self._here.at += size if repeat else 0
        return repeat > 0

    def _detail(self) -> bool:
        """Manners, liquids, words of the frame, fillers and quotation marks."""
        word, clause = self._here.low(), self._clause
        if clause is not None and word in frames.CAREFUL:
            clause.careful = True
        elif clause is not None and word in self._liquids and self._takes_liquid(clause):
            clause.liquid, self._preposition = word, ""
        elif clause is not None and self._is_extra(clause, word):
            clause.extras.add(word)
            self._preposition = ""
        elif clause is not None and clause.frame is Frame.RETURN and word in frames.HOMES:
            clause.extras.add("home")
            self._preposition = ""
        elif word not in frames.FILLERS and word not in _MARKS:
            if clause is None and word in frames.CAREFUL:
                return self._careful_opening()
            return False
        self._here.at += 1
        return True

    def _is_extra(self, clause: Clause, word: str) -> bool:
        """True for a word of the frame itself; `leave it on the desk` is no `leave it on`."""
        if word not in frames.EXTRAS.get(clause.frame, ()):
            return False
        return word not in frames.ROLES or not self._next_is_phrase()

    def _careful_opening(self) -> bool:
        """`gently place ...`: the manner of the verb that follows."""
        before, self._here.at = self._here.at, self._here.at + 1
        if self._verb() and self._clause is not None:
            self._clause.careful = True
            return True
        self._here.at = before
        return False

    def _takes_liquid(self, clause: Clause) -> bool:
        return clause.frame in {Frame.POUR, Frame.FILL} and clause.liquid is None

    def _prepositional(self) -> bool:
        if self._clause is None or self._here.low() not in frames.ROLES or self._preposition:
            return False
        self._preposition = self._here.low()
        self._here.at += 1
        return True
