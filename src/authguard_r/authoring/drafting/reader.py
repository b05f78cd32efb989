# SPDX-License-Identifier: Apache-2.0
"""From tokens to clauses: one pass, the first rule that fits takes the words it explains.

A rule consumes only words whose meaning it keeps. What no rule explains is kept as unknown and
becomes a question, because a condition could hide in it.
"""

from __future__ import annotations

from authguard_r.authoring.drafting import clauses, frames, terms
from authguard_r.authoring.drafting.amounts import is_filler, take_amount, take_count, take_details
from authguard_r.authoring.drafting.cursor import Cursor
from authguard_r.authoring.drafting.doors import read_door
from authguard_r.authoring.drafting.frames import VerbFrame
from authguard_r.authoring.drafting.lexicon import Lexicon, Ref, Sort
from authguard_r.authoring.drafting.tokens import Tokens
from authguard_r.authoring.drafting.unparsed_words import UnparsedWords, settle_clauses
from authguard_r.authoring.drafting.verbs import VerbPhrase, ends, leads, read_gerund, read_verb

_IMPLIED = frozenset({"in", "inside", "into"})


def read_sentence(
    text: str, tokens: Tokens, lexicon: Lexicon, *, liquids: frozenset[str]
) -> clauses.Sentence:
    """Return what the sentence says.

    Args:
        text: the sentence.
        tokens: its tokens.
        lexicon: the site's names.
        liquids: the liquids that the profile knows.
    """
    reader = _SentenceReader(text, tokens, lexicon, liquids)
    reader.read()
    return reader.said


class _SentenceReader:
    """The pass: where it stands, and what it has understood so far."""

    def __init__(
        self, text: str, tokens: Tokens, lexicon: Lexicon, liquids: frozenset[str]
    ) -> None:
        self.said = clauses.Sentence(text)
        self._here = Cursor(tokens)
        self._lexicon = lexicon
        self._liquids = liquids
        self._clause: clauses.Clause | None = None
        self._fresh = True  # a clause or the next item of a list may begin here
        self._role, self._preposition = "object", ""
        self._waiting: clauses.BatteryCondition | None = None
        self._last_name = ""
        self._strays = UnparsedWords(self.said)
        self._preposition_at = -1
        self._behind_noun = -1  # the token right behind a noun: no article stands there

    def read(self) -> None:
        """Read every token; each pass of the loop takes at least one."""
        rules = (
            self._boundary,
            self._opening,
            self._robot,
            self._window,
            self._condition,
            self._rights,
            self._after,
            self._verb,
            self._particle,
            self._bound,
            self._door,
            self._name,
            self._pronoun,
            self._term,
            self._detail,
            self._prepositional,
        )
        while self._here.at < len(self._here.tokens):
            if not any(rule() for rule in rules):
                self._unknown()
        self._end_of_phrase()
        if self._waiting is not None:
            self.said.unsettled.append(self._waiting.text)
        settle_clauses(self.said)

    def _unknown(self) -> None:
        token = self._here.tokens[self._here.at]
        role, under = "" if self._fresh else self._role, -1
        if self._preposition:
            role, under = frames.ROLES[self._preposition], self._preposition_at
        self._strays.add(token, self._clause, role=role, under=under, label=self._here.low(1))
        self._here.at += 1

    def _boundary(self) -> bool:
        if self._here.low() not in frames.BOUNDARIES or self._here.starts(("next", "to")):
            return False
        self._end_of_phrase()
        self._strays.end(self._here.low())
        self._here.at += 1
        self._fresh = True
        return True

    def _end_of_phrase(self) -> None:
        """A preposition that nothing followed: `place it inside`."""
        if not self._preposition:
            return
        if self._preposition in _IMPLIED and self._clause is not None:
            self._add(clauses.PhraseWay.INSIDE, self._preposition)
        elif self._preposition not in frames.UNSETTLED:
            at, role = self._preposition_at, frames.ROLES[self._preposition]
            self._strays.dangling(at, at + len(self._preposition), self._clause, role)
        self._preposition = ""

    def _opening(self) -> bool:
        size = self._here.first(frames.OPENINGS) if self._fresh else 0
        self._here.at += size
        return size > 0

    def _window(self) -> bool:
        return terms.take_end(self._here, self.said) or terms.take_start(self._here, self.said)

    def _condition(self) -> bool:
        """A condition belongs to the clause that it stands in, else to the one that follows."""
        clause = None if self._fresh else self._clause
        if self._waiting is not None or (clause is not None and clause.condition is not None):
            return False
        found = terms.take_condition(self._here, self.said)
        if found is not None and clause is not None:
            clause.condition = found
        elif found is not None:
            self._waiting = found
        return found is not None

    def _rights(self) -> bool:
        here, clause = self._here, self._clause
        if clause is None:
            return False
        return (self._fresh and terms.take_right(here, clause)) or terms.take_rights(here, clause)

    def _after(self) -> bool:
        """`after turning it on`: what comes first, said last; `before closing it`: as `then`."""
        word = self._here.low()
        if word not in {"after", "before"} or self._clause is None:
            return False
        careful = self._here.low(1) in frames.CAREFUL
        found = read_gerund(self._here, 1 + careful)
        if found is None:
            return False
        self._end_of_phrase()
        self._here.at += 1 + careful + found.size
        self._fresh = word == "before"
        self._open(found).careful = careful
        return True

    def _term(self) -> bool:
        """Quantities, counts and details of a clause that stand without a phrase."""
        clause = self._clause
        if clause is None:
            return False
        return take_count(self._here, clause) or take_details(self._here, clause, self._liquids)

    def _bound(self) -> bool:
        clause = self._clause
        return clause is not None and not self._preposition and take_amount(self._here, clause)

    def _verb(self) -> bool:
        found = read_verb(self._here) if self._fresh else None
        if found is None:
            return False
        self._here.at += found.size
        self._open(found)
        return True

    def _open(self, found: VerbPhrase) -> clauses.Clause:
        """Begin a clause; one that is said last and done first goes before the one before it."""
        said, verb = self.said.clauses, found.verb
        earlier = self._clause is not None and not self._fresh
        clause = clauses.Clause(len(said) + 1, verb.frame, found.wording, earlier=earlier)
        clause.state += [verb.state] if verb.state else []
        clause.condition, self._waiting = self._waiting, None
        place = said.index(self._clause) if earlier and self._clause in said else len(said)
        said.insert(place, clause)
        self._clause, self._fresh, self._role = clause, False, "object"
        return clause

    def _particle(self) -> bool:
        """`turn it on`, `on and off`: the part of the verb that comes after its object."""
        clause, word = self._clause, self._here.low()
        if clause is None or clause.frame is not VerbFrame.TURN or word not in {"on", "off"}:
            return False
        named = self._here.at + 1 < len(self._here.tokens) and self._next_is_phrase()
        settled = "object" in clause.roles or (bool(clause.state) and not self._fresh)
        if named and settled and word == "on":
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

    def _robot(self) -> bool:
        """`courier-1, bring ...`: who is meant, wherever it is said."""
        match = self._lexicon.match(self._here.tokens, self._here.at)
        if match is None or any(ref.sort is not Sort.ROBOT for ref in match.refs):
            return False
        if self._preposition or self._listed(match.size):
            return False  # it stands for a thing or a place, and is asked about as one
        self.said.robots += [ref.id for ref in match.refs]
        self._here.at += match.size
        self._behind_noun = self._here.at
        return True

    def _listed(self, size: int) -> bool:
        """True for `and courier-1` that no verb follows: it goes on with a list of things."""
        listed = self._clause is not None and self._here.low(-1) in {"and", "then"}
        return listed and leads(self._here, size) is None

    def _door(self) -> bool:
        """`the door of the pharmacy`, `the pharmacy door`: a door by what it leads to."""
        clause = self._clause
        if clause is None or clause.frame not in {VerbFrame.OPEN, VerbFrame.CLOSE}:
            return False
        found = read_door(self._here, self._lexicon)
        if found is None:
            return False
        first, last = self._here.span(found.size)
        self._here.at += found.size
        self._add(clauses.PhraseWay.DOOR, self.said.text[first:last], sides=found.sides)
        return True

    def _name(self) -> bool:
        match = self._lexicon.match(self._here.tokens, self._here.at)
        if match is None:
            return self._numbered()
        if self._clause is None:
            return False
        self._here.at += match.size
        self._add(clauses.PhraseWay.NAMED, match.text, match.refs, exact=match.exact)
        self._last_name = match.text
        self._skip_part()
        self._behind_noun = self._here.at
        return True

    def _numbered(self) -> bool:
        """`stations 101, 102 and 103`: a number that goes on with the last name."""
        if not self._fresh or self._clause is None:
            return False
        match = self._lexicon.numbered(self._here.tokens[self._here.at], self._last_name)
        if match is not None:
            self._here.at += 1
            self._add(clauses.PhraseWay.NAMED, match.text, match.refs)
        return match is not None

    def _skip_part(self) -> None:
        """`the microwave door`: the part of a thing is the thing, when it is opened or closed."""
        clause = self._clause
        if clause is not None and clause.frame in {VerbFrame.OPEN, VerbFrame.CLOSE}:
            self._here.at += self._here.low() in frames.PARTS

    def _pronoun(self) -> bool:
        if self._clause is None:
            return False
        word = self._here.low()
        if word in frames.PRONOUNS:
            way = clauses.PhraseWay.PRONOUN
        elif word in frames.PARTS and self._clause.frame in {VerbFrame.OPEN, VerbFrame.CLOSE}:
            way = clauses.PhraseWay.PART
        else:
            return False
        self._here.at += 1
        if way is clauses.PhraseWay.PART and self._here.low() == "of":  # `the door of the fridge`
            self._here.at += 1
        else:
            self._add(way, word)
        return True

    def _add(
        self,
        way: clauses.PhraseWay,
        text: str,
        refs: tuple[Ref, ...] = (),
        *,
        exact: bool = True,
        sides: tuple[tuple[Ref, ...], ...] = (),
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
        phrase = clauses.NounPhrase(
            text, way, len(self.said.phrases), clause.number, refs, exact, sides
        )
        self._strays.phrase(phrase.number)
        self._behind_noun = self._here.at
        clause.roles.setdefault(self._role, []).append(phrase)
        self.said.phrases.append(phrase)
        self._preposition, self._fresh = "", False

    def _detail(self) -> bool:
        """Manners, liquids, words of the frame, fillers and quotation marks."""
        word, clause = self._here.low(), self._clause
        if word in frames.CAREFUL:
            return self._manner()
        if clause is not None and word in self._liquids and self._takes_liquid(clause):
            clause.liquid, self._preposition = word, ""
            self._behind_noun = self._here.at + 1
        elif clause is not None and self._is_extra(clause, word):
            clause.extras.add(word)
            self._preposition = ""
            self._behind_noun = self._here.at + (clause.frame is VerbFrame.GUIDE)
        elif clause is not None and clause.frame is VerbFrame.RETURN and word in frames.HOMES:
            clause.extras.add("home")
            self._preposition = ""
            self._behind_noun = self._here.at + 1
        elif not is_filler(self._here, fresh=self._fresh, behind=self._behind_noun):
            return False
        self._here.at += 1
        return True

    def _is_extra(self, clause: clauses.Clause, word: str) -> bool:
        """True for a word of the frame itself; `leave it on the desk` is not `leave it on`."""
        if word not in frames.EXTRAS.get(clause.frame, ()):
            return False
        return word not in frames.ROLES or not self._next_is_phrase()

    def _manner(self) -> bool:
        """`gently place ...`: the manner of the verb that follows; else of the clause it ends."""
        size = leads(self._here) if self._fresh else None
        if size is None and (self._clause is None or (self._fresh and not ends(self._here))):
            return False  # `go there, gently, and put it down`: of which of the two?
        self._here.at += 1 if size is None else size
        if size is not None:
            self._verb()
        if self._clause is not None:
            self._clause.careful = True
        return True

    def _takes_liquid(self, clause: clauses.Clause) -> bool:
        return clause.frame in {VerbFrame.POUR, VerbFrame.FILL} and clause.liquid is None

    def _prepositional(self) -> bool:
        taken = bool(self._preposition) and not self._strays.holds(self._preposition_at)
        if self._clause is None or taken:
            return False
        size = 2 if self._here.starts(("next", "to")) else 1
        word = " ".join(self._here.low(n) for n in range(size))
        if word not in frames.ROLES:
            return False
        if self._preposition:  # words that nothing explains had followed the one before
            self._strays.extend(self._preposition_at)
        self._strays.preposition()
        self._preposition, self._preposition_at = word, self._here.tokens[self._here.at].at
        for _ in range(size if word in frames.UNSETTLED else 0):
            self._unknown()
        self._here.at += 0 if word in frames.UNSETTLED else size
        return True
