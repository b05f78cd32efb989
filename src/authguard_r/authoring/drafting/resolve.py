# SPDX-License-Identifier: Apache-2.0
"""From a phrase to the one thing that it means, or the question which one.

Nothing is chosen among two: a name with several owners, a pronoun with several antecedents and a
slot that nothing fills are asked about, with everything that the site has for it.
"""

from __future__ import annotations

from collections.abc import Iterable

from authguard_r.authoring.drafting.asking import DraftDialog
from authguard_r.authoring.drafting.clauses import Clause, NounPhrase, PhraseWay, Sentence
from authguard_r.authoring.drafting.doors import doors, doors_at, passages
from authguard_r.authoring.drafting.frames import UNSETTLED
from authguard_r.authoring.drafting.lexicon import Ref, Sort
from authguard_r.authoring.drafting.profile import DraftProfile
from authguard_r.authoring.drafting.restraint import limits
from authguard_r.authoring.drafting.unparsed_words import (
    CONDITION,
    slot_of,
    slot_of_stray,
    words_of,
)
from authguard_r.authoring.drafting.unresolved_modifiers import UnresolvedModifiers
from authguard_r.site.model import Site

OBJECTS = (Sort.OBJECT,)
REGIONS = (Sort.REGION,)
ANY = (Sort.REGION, Sort.OBJECT)


def field_of(clause: Clause, slot: str) -> str:
    """Return the name that a question about a slot has, and its answer."""
    return slot if clause.number == 1 else f"step{clause.number}.{slot}"


def not_understood(words: Iterable[str]) -> str:
    """Return the beginning of a question about words that stand at what it asks for."""
    said = " and ".join(f'"{word}"' for word in words)
    return f"{said} is not understood. " if said else ""


class Resolver:
    """Resolves the phrases of one sentence at one site."""

    def __init__(
        self, site: Site, sentence: Sentence, profile: DraftProfile, asking: DraftDialog
    ) -> None:
        self._site = site
        self._sentence = sentence
        self._profile = profile
        self._asking = asking
        self._meant: dict[int, Ref] = {}
        self._read: set[tuple[int, str]] = set()
        self._explained: set[int] = set()
        self._leftovers = UnresolvedModifiers(asking)

    def one(
        self, clause: Clause, role: str, slot: str, sorts: tuple[Sort, ...], *, able: str = ""
    ) -> Ref | None:
        """Return the one thing in a role, or None once it is asked for.

        Args:
            clause: the clause.
            role: where the phrase stands.
            slot: the field of the question.
            sorts: what it may be.
            able: what a pronoun's antecedent must lend itself to.
        """
        phrases = self.read(clause, role)
        if len(phrases) != 1:
            every = self._everything(sorts)
            if phrases:
                found = [self._options(phrase, sorts) or () for phrase in phrases]
                every = tuple(dict.fromkeys(ref for refs in found for ref in refs))
            return self._ask(clause, slot, f"Which {slot} is meant?", every)
        return self.thing(clause, phrases[0], slot, sorts, able=able)

    def each(
        self, clause: Clause, role: str, slot: str, sorts: tuple[Sort, ...], *, able: str = ""
    ) -> list[Ref]:
        """Return the things in a role that may hold several; a question for each open one."""
        phrases = self.read(clause, role)
        if not phrases:
            found = [self._ask(clause, slot, f"Which {slot} is meant?", self._everything(sorts))]
        else:
            found = [
                self.thing(clause, phrase, slot if n == 0 else f"{slot}{n + 1}", sorts, able=able)
                for n, phrase in enumerate(phrases)
            ]
        return [ref for ref in found if ref is not None]

    def thing(
        self,
        clause: Clause,
        phrase: NounPhrase,
        slot: str,
        sorts: tuple[Sort, ...],
        *,
        able: str = "",
    ) -> Ref | None:
        """Return what one phrase means, or None once it is asked about."""
        options = self._options(phrase, sorts, able=able)
        if options is None:
            return None
        words = self._words_at(phrase)
        if len(options) == 1 and not words:
            self._meant[phrase.number] = options[0]
            if phrase.way is not PhraseWay.NAMED or not phrase.exact:
                why = f"nothing else that `{phrase.text}` can mean here"
                self._asking.assume(field_of(clause, slot), options[0].id, why)
            return options[0]
        if not options and "door" in phrase.text.lower().split():
            found = self._ask_door(clause, phrase, slot)
        else:
            question = f"{not_understood(words)}Which {slot} does `{phrase.text}` mean?"
            if any(word.lower() in UNSETTLED for word in words):
                options = self._around(options, sorts)
            found = self._ask(clause, slot, question, options or self._everything(sorts))
        if found is not None:
            self._meant[phrase.number] = found
        return found

    def _words_at(self, phrase: NounPhrase) -> tuple[str, ...]:
        """Return words at a phrase that nothing explains; the question about it is theirs too."""
        found = []
        for number, stray in enumerate(self._sentence.unknown):
            if stray.phrase == phrase.number and not stray.slot:
                self._explained.add(number)
                found.append(words_of(stray, self._sentence.text))
        return tuple(found)

    def _around(self, options: tuple[Ref, ...], sorts: tuple[Sort, ...]) -> tuple[Ref, ...]:
        """Return the options, and the places that lie at them: for `near` and its like."""
        if Sort.REGION not in sorts:
            return options
        places: list[str] = []
        for ref in options:
            if ref.sort is Sort.OBJECT:
                places.append(self._site.objects[ref.id].home)  # type: ignore[index]
            for door in self._site.doors:
                places += [side for side in door.between if ref.id in door.between]
        return tuple(dict.fromkeys((*options, *(Ref(Sort.REGION, place) for place in places))))

    def _ask_door(self, clause: Clause, phrase: NounPhrase, slot: str) -> Ref | None:
        """Ask which door is meant; a passage that is no thing of the site cannot be opened."""
        known = doors(self._site)
        if known:
            return self._ask(clause, slot, f"Which {slot} does `{phrase.text}` mean?", known)
        field = field_of(clause, slot)
        question = f"The site has no thing that is `{phrase.text}`: which door is meant?"
        answer = self._asking.ask(field, question, passages(self._site))
        if answer is not None:
            self._asking.insist(
                field,
                f"`{answer}` says whether a door is open, but the site has no thing of class "
                "`door` for it: say it otherwise",
            )
        return None

    def read(self, clause: Clause, role: str) -> list[NounPhrase]:
        """Return the phrases in a role; from then on they count as used."""
        self._read.add((clause.number, role))
        return clause.roles.get(role, [])

    def require_read(self, clause: Clause) -> None:
        """Ask about phrases in roles that the clause's steps had no use for."""
        for role, phrases in clause.roles.items():
            if (clause.number, role) not in self._read:
                for phrase in phrases:
                    things = [ref for ref in phrase.refs if ref.sort is Sort.OBJECT]
                    slot = "object" if things and role == "object" else slot_of(role, clause.frame)
                    self.unknown(clause, slot, phrase.text)

    def unknown(self, clause: Clause | None, slot: str, text: str) -> None:
        """Keep words without a use here, to be asked about: a condition could hide in them."""
        limited = any(limits(word) for word in text.split())
        slot = CONDITION if limited else slot
        field = slot if clause is None else field_of(clause, slot)
        self._leftovers.add(field, text, limits=limited)

    def finish(self) -> None:
        """Ask about everything that no step used, each at the slot that it could change."""
        for text in self._sentence.unsettled:
            self.unknown(None, CONDITION, text)
        by_number = {clause.number: clause for clause in self._sentence.clauses}
        for number, stray in enumerate(self._sentence.unknown):
            if number in self._explained:
                continue
            clause = by_number.get(stray.clause)
            text = words_of(stray, self._sentence.text)
            if clause is None:
                why = "the sentence has no verb that a robot could follow"
                self._asking.insist(CONDITION, f'"{text}": {why}')
                continue
            slot = slot_of_stray(stray, clause.frame)
            self._leftovers.add(field_of(clause, slot), text, limits=stray.limits, said=True)
        self._leftovers.ask()

    def _options(
        self, phrase: NounPhrase, sorts: tuple[Sort, ...], *, able: str = ""
    ) -> tuple[Ref, ...] | None:
        """Return what a phrase can mean; None while another open question decides it."""
        if phrase.number in self._meant and self._meant[phrase.number].sort in sorts:
            return (self._meant[phrase.number],)
        if phrase.way is PhraseWay.DOOR:
            return doors_at(self._site, phrase.sides)
        if phrase.way is PhraseWay.NAMED:
            return tuple(ref for ref in phrase.refs if ref.sort in sorts)
        if phrase.way is not PhraseWay.PRONOUN:
            able = "open"
        found: list[Ref] = []
        for other in self._sentence.phrases[: phrase.number]:
            if other.clause == phrase.clause or other.way is not PhraseWay.NAMED:
                continue
            meant = self._meant.get(other.number)
            options = (meant,) if meant is not None else other.refs
            fitting = [ref for ref in options if ref.sort in sorts and self._fits(ref, able)]
            if len(fitting) > 1:
                return None
            found += fitting
        return tuple(dict.fromkeys(found))

    def _fits(self, ref: Ref, able: str) -> bool:
        """False when the site's class of an object says that the verb cannot mean it."""
        if ref.sort is not Sort.OBJECT or not able:
            return True
        kind = self._site.objects[ref.id].kind  # type: ignore[index]
        return able in self._profile.classes.get(kind, (able,))

    def _everything(self, sorts: tuple[Sort, ...]) -> tuple[Ref, ...]:
        known: dict[Sort, Iterable[str]] = {
            Sort.OBJECT: self._site.objects,
            Sort.REGION: self._site.regions,
        }
        return tuple(Ref(sort, item) for sort in sorts for item in sorted(known[sort]))

    def _ask(
        self, clause: Clause, slot: str, question: str, options: tuple[Ref, ...] | None
    ) -> Ref | None:
        """Ask which of the options is meant; a thing and a place of one id are told apart."""
        ids = [ref.id for ref in options or ()]
        named = {
            ref.id if ids.count(ref.id) == 1 else f"{ref.sort} {ref.id}": ref
            for ref in options or ()
        }
        answer = self._asking.ask(field_of(clause, slot), question, named)
        return None if answer is None else named.get(answer)
