# SPDX-License-Identifier: Apache-2.0
"""What a free text states, word for word: the check of a plan that a language model read from it.

A model may only repeat the text. Each place, object and value of its plan must stand there, by the
site's own names and with its unit; nothing is completed. Verbs, negation and order are not checked.

Source: section "Normalized Actions". Spec page: docs/spec/normalize.md#free-text
"""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Callable, Iterator

from authguard_r.core.action import Action
from authguard_r.core.errors import AuthGuardError, ClarificationError, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize import Plan, read_plan
from authguard_r.normalize.bind import Binder, site_spellings
from authguard_r.normalize.binding import Binding, ToolBinding
from authguard_r.normalize.dialects import Call, Dialect, read_reply
from authguard_r.normalize.parse import read_text
from authguard_r.provenance.folding import fold
from authguard_r.provenance.mentions import Mention, MentionMatch, MentionNames
from authguard_r.provenance.numerals import read_tokens
from authguard_r.site.model import Site

#: Reads `0.5 m/s` as a whole number of a unit, or raises an `AuthGuardError`.
ReadQuantity = Callable[[str, str], int]

#: Longest free text that is read, in characters.
MAX_FREE_TEXT = 1 << 14
#: Most names of a place that a refusal lists.
_LISTED = 8
#: How many times as long as its name a look-alike may be.
_NEAR = 4
#: Most characters before a name in which white space is looked for.
_MARKS = 8
_BEFORE = re.compile(r"""(?:^|\s)[("'\[\u2018\u201c]*\Z""")
_AFTER = re.compile(r"""[)"'\]\u2019\u201d.,;:!?]*(?:\s|\Z)""")
_OPENING, _CLOSING = "(\"'[\u2018\u201c", ")\"'].,;:!?\u2019\u201d"
_WORD = re.compile(r"\S+")
_NUMBER = re.compile(r"-?[0-9]+(?:\.[0-9]+)?")
#: A letter or digit that shows something: four letters of Korean are blank.
_SHOWN = re.compile(r"[^\W_\u115f\u1160\u3164\uffa0]")
_PART = re.compile(r"[^\W_]+")
#: Categories of signs: mathematical ones, and dashes.
_SIGNS = frozenset({"Sm", "Pd"})
#: Words that join the number before them with the number behind them.
_JOINING = frozenset(
    """and plus or to times by over of a an the another further more extra additional about
    up through until till as well""".split()  # noqa: SIM905
)
#: Words beside a quantity that make it another one: operators, units, and numbers in words that
#: `numerals` does not read.
_CHANGING = frozenset(
    """x e minus negative per divided squared cubed point percent half quarter dozen score couple
    pair double triple twice thrice million billion trillion k
    ms s sec min minute h hr hour day week month year mm cm m km meter metre n kn newton g kg
    byte kb mb rad deg degree""".split()  # noqa: SIM905
)


def read_free_text(data: bytes) -> str:
    """Return a planner's free text.

    Raises:
        MalformedError: not UTF-8, empty, or too long (`INPUT_TOO_LARGE`).
    """
    text = read_text(data)
    if len(text) > MAX_FREE_TEXT:
        raise MalformedError(
            f"expected at most {MAX_FREE_TEXT} characters of free text, got {len(text)}",
            where="input",
            reason=Reason.INPUT_TOO_LARGE,
        )
    if not text.strip():
        raise MalformedError("expected a text", where="input", reason=Reason.PLAN_EMPTY)
    return text


def normalize_stated(
    reply: bytes,
    text: str,
    *,
    site: Site,
    binding: Binding,
    quantity: ReadQuantity,
    dialect: Dialect = Dialect.AUTO,
) -> Plan:
    """Return the plan in a model's reply once the text states all of it.

    The plan has no more authority than any other: the mission and the gate still decide.

    Args:
        reply: what the model made of the text; untrusted.
        text: what the planner wrote; untrusted.
        site: the site whose names count.
        binding: the planner's tools; sound for the site.
        quantity: reads the quantities of the text.
        dialect: how the reply is written.

    Raises:
        MalformedError: as `normalize` does; or a place, an object or a tool that the text does
            not name (`NAME_UNKNOWN`), or a value that it does not state (`VALUE_INVALID`), at
            `actions[n].FIELD`.
        ClarificationError: the text names it only by a name of several things.
    """
    binder = Binder(site, binding)
    plan = read_plan(reply, binder=binder, dialect=dialect)
    calls = read_reply(read_text(reply), plan.dialect).calls
    stated = StatedText(text, site=site, tools=frozenset(binding.tools), quantity=quantity)
    for number, (call, step) in enumerate(zip(calls, plan.steps, strict=True)):
        stated.require(step.action, call, binder.way(call), where=f"actions[{number}]")
    return plan


class StatedText:
    """The names and quantities that stand in one free text.

    Args:
        text: what a planner wrote; untrusted.
        site: the site whose names count.
        tools: the external names of the planner's tools.
        quantity: reads the quantities of the text.
    """

    def __init__(
        self, text: str, *, site: Site, tools: frozenset[str], quantity: ReadQuantity
    ) -> None:
        text = " ".join(text.split())
        self._site = site
        self._quantity = quantity
        self._spelled: dict[tuple[str, str], tuple[str, ...]] = {
            **{("place", item): (*model.names, item) for item, model in site.regions.items()},
            **{("object", item): (*model.names, item) for item, model in site.objects.items()},
        }
        owners: dict[str, set[tuple[str, str]]] = {}
        for thing, names in self._spelled.items():
            for name in names:
                owners.setdefault(_spaced(name), set()).add(thing)
        found = _exact(site_spellings(site), text)
        spans = [(start, end) for start, end in found if not _numbered(text, start, end)]
        #: what each name in the text stands for: one thing, or several
        self._named = {frozenset(owners[_spaced(text[start:end])]) for start, end in spans}
        spelled = {tool.replace("_", " "): tool for tool in tools} | {tool: tool for tool in tools}
        called = {_spaced(name): tool for name, tool in spelled.items()}
        self._tools = {called[_spaced(text[start:end])] for start, end in _exact(spelled, text)}
        taken = {at for start, end in spans for at in range(start, end)}
        #: the words of the text, those of names left empty: their digits are no value
        self._words = [
            word[0] if taken.isdisjoint(range(*word.span())) else ""
            for word in _WORD.finditer(text)
        ]
        self._values: dict[str, frozenset[int]] = {}

    def require(self, action: Action, call: Call, way: ToolBinding, *, where: str) -> None:
        """Refuse an action of which the text does not state every part.

        Args:
            action: what the call means.
            call: what the model wrote.
            way: the binding of the call.
            where: the place of the action, for messages.

        Raises:
            MalformedError: a part that does not stand in the text.
            ClarificationError: a name of several things.
        """
        carried = [
            ("object", "object", action.object),
            ("place", "source", action.source),
            ("place", "destination", action.destination),
            *(("place", f"route[{n}]", region) for n, region in enumerate(action.route)),
        ]
        named = [(kind, field, item) for kind, field, item in carried if item is not None]
        for kind, field, item in named:
            self._require_name((kind, item), f"{where}.{field}")
        if not named and call.tool not in self._tools:
            raise MalformedError(
                f"the text does not name `{call.tool}`; an action without a place and an object "
                "needs the name of its tool",
                where=f"{where}.tool",
                reason=Reason.NAME_UNKNOWN,
            )
        for name, value in action.params.items():
            unit = self._site.vocabulary[action.type].params[name].unit
            if value not in {*_carried(way, name), *self._by_word(way, name), *self._in(unit)}:
                raise MalformedError(
                    f"the text does not state {value} {unit}; expected a number of the text with "
                    "its unit, such as `0.5 m/s` or `30 s`, or no value",
                    where=f"{where}.params.{name}",
                    reason=Reason.VALUE_INVALID,
                )

    def _require_name(self, thing: tuple[str, str], where: str) -> None:
        if frozenset({thing}) in self._named:
            return
        shared = sorted({other for owners in self._named if thing in owners for other in owners})
        if shared:
            meant = tuple(f"{kind} {item}" for kind, item in shared)
            raise ClarificationError(
                f"a name in the text stands for {' and '.join(meant)}; which one is meant?",
                field=where,
                candidates=meant,
            )
        names = ", ".join(f"`{name}`" for name in self._spelled[thing][:_LISTED])
        raise MalformedError(
            f"the text does not name `{thing[1]}`; expected one of its whole names: {names}",
            where=where,
            reason=Reason.NAME_UNKNOWN,
        )

    def _by_word(self, way: ToolBinding, name: str) -> Iterator[int]:
        """Yield the values of a parameter whose word in the binding stands in the text."""
        words = {_spaced(word.strip(_OPENING + _CLOSING)) for word in self._words}
        for argument in way.arguments.values():
            if argument.to == f"params.{name}":
                yield from (value for word, value in argument.values.items() if word in words)

    def _in(self, unit: str) -> frozenset[int]:
        """Return every quantity of the text that is a whole number of a unit."""
        if unit not in self._values:
            self._values[unit] = frozenset(self._quantities(unit))
        return self._values[unit]

    def _quantities(self, unit: str) -> Iterator[int]:
        """Yield the value of each quantity of a unit that its neighbors leave as it is."""
        for at, word in enumerate(self._words):
            opened = word.lstrip(_OPENING)
            bare, size = opened.rstrip(_CLOSING), 1
            said = bare
            if unit == "count" and _NUMBER.fullmatch(bare):
                said = f"{bare} count"
            elif _NUMBER.fullmatch(opened) and at + 1 < len(self._words):
                said, size = f"{opened} {self._words[at + 1].rstrip(_CLOSING)}", 2
            elif not bare[:1].isdigit() and bare[:1] != "-":
                continue
            try:
                value = self._quantity(said, unit)
            except AuthGuardError:
                continue
            if not self._goes_on(at - 1, -1) and not self._goes_on(at + size, 1):
                yield value

    def _goes_on(self, at: int, step: int) -> bool:
        """True when the words from one on may belong to the quantity beside them."""
        joined = False
        while 0 <= at < len(self._words) and _joins(self._words[at]):
            joined = True
            at += step
        if not 0 <= at < len(self._words):
            return False
        beyond = self._words[at + step] if 0 <= at + step < len(self._words) else ""
        # `5 N and 30 s`, `2 loads of 30 s`: before a joining word counts each word with a number
        return _changes(self._words[at], step) or (joined and step < 0 and _is_numeric(beyond))


def _changes(word: str, step: int) -> bool:
    """True when a word beside a quantity may make it another one.

    Args:
        word: it; empty for a word of a name.
        step: -1 for the word before the quantity, 1 for the word behind it.
    """
    if not word:
        return False
    edge = word.rstrip(_CLOSING)[-1:] if step < 0 else word.lstrip(_OPENING)[:1]
    return (
        _is_numeric(word)
        or not any(char.isalpha() for char in _SHOWN.findall(word))
        or unicodedata.category(edge or "x") in _SIGNS
        or fold(edge) in {"*", "/", "%", "^"}
        or not _CHANGING.isdisjoint(_parts(word))
    )


def _is_numeric(word: str) -> bool:
    """True for a word with a digit of any script, or with a number in English words."""
    return any(char.isnumeric() for char in word) or any(
        token.spoken for said in (word, *_parts(word)) for token in read_tokens(said)
    )


def _joins(word: str) -> bool:
    parts = _PART.findall(fold(word))
    return bool(parts) and _JOINING.issuperset(parts)


def _parts(word: str) -> frozenset[str]:
    """Return the parts of a word such as `and/or`, in lower case and without an `s` at the end."""
    found = _PART.findall(fold(word).replace("'", "").replace("\u2019", ""))
    return frozenset(found) | frozenset(part.removesuffix("s") for part in found if len(part) > 2)


def _carried(way: ToolBinding, name: str) -> Iterator[object]:
    """Yield what the binding gives a parameter without the planner."""
    target = f"params.{name}"
    if target in way.fixed:
        yield way.fixed[target]
    yield from (a.default for a in way.arguments.values() if a.to == target)


def _exact(spelled: dict[str, str], text: str) -> Iterator[tuple[int, int]]:
    """Yield where a whole name stands in a text as the site spells it, in any case and spacing.

    Of names within each other the longest counts; of names that share a word none does, nor does
    one that is part of what looks like another name.
    """
    names, reach = MentionNames(spelled), _NEAR * max(map(len, spelled), default=0)
    seen = names.find(text)
    found = [m for m in seen if m.how is MentionMatch.EXACT]
    alike = {m.ids for m in seen if m.how is not MentionMatch.EXACT}
    for number, mention in enumerate(found):
        start, end = mention.start, mention.end
        near = (*found[max(0, number - 1) : number], *found[number + 1 : number + 2])
        alone = all(other.end <= start or end <= other.start for other in near)
        free = _BEFORE.search(text, max(0, start - _MARKS), start) and _AFTER.match(text, end)
        if not alone or not free or (alike and _hidden(names, text, mention, reach)):
            continue
        yield start, end


def _numbered(text: str, start: int, end: int) -> bool:
    """True when a number follows a name (`Station 101 02`), or comes before its first digit."""
    after = _SHOWN.search(text, end)
    if after is not None and after.group().isnumeric():
        return True
    if not text[start].isnumeric():
        return False
    return next(filter(_SHOWN.match, reversed(text[:start])), "").isnumeric()


def _hidden(names: MentionNames, text: str, mention: Mention, reach: int) -> bool:
    """True when a name is part of what looks like another name: the one in `5taff Corridor`.

    Names may be found in other characters than those of the text, so that their places do not
    compare: what is found only in the whole reaches over the name's ends.
    """
    start, end = mention.start, mention.end
    left, name, right = (
        text[max(0, start - reach) : start],
        text[start:end],
        text[end : end + reach],
    )
    whole = Counter(found.ids for found in names.find(left + name + right))
    parts = Counter(found.ids for part in (left, name, right) for found in names.find(part))
    return any(count > parts[ids] for ids, count in whole.items() if ids != mention.ids)


def _spaced(text: str) -> str:
    return " ".join(text.casefold().split())
