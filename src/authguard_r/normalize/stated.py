# SPDX-License-Identifier: Apache-2.0
"""What a free text states, word for word: the check of a plan that a language model read from it.

A model may only repeat the text. Each place, object and value of its plan must stand there, by the
site's own names and with its unit; nothing is completed. Verbs, negation and order are not checked.

Source: section "Normalized Actions". Spec page: docs/spec/normalize.md#free-text
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

from authguard_r.core.action import Action
from authguard_r.core.errors import AuthGuardError, ClarificationError, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize import Plan, normalize
from authguard_r.normalize.bind import Binder, site_spellings
from authguard_r.normalize.binding import Binding, ToolBinding
from authguard_r.normalize.dialects import Call, Dialect, read_reply
from authguard_r.normalize.mentions import How, Names
from authguard_r.normalize.parse import read_text
from authguard_r.site.model import Site

#: Reads `0.5 m/s` as a whole number of a unit, or raises an `AuthGuardError`.
ReadQuantity = Callable[[str, str], int]

#: Longest free text that is read, in characters.
MAX_FREE_TEXT = 1 << 14
#: Most names of a place that a refusal lists.
_LISTED = 8
#: Most characters before a name in which white space is looked for.
_MARKS = 8
_BEFORE = re.compile(r"""(?:^|\s)[("'\[\u2018\u201c]*\Z""")
_AFTER = re.compile(r"""[)"'\]\u2019\u201d.,;:!?]*(?:\s|\Z)""")
_OPENING, _CLOSING = "(\"'[\u2018\u201c", ")\"'].,;:!?\u2019\u201d"
_WORD = re.compile(r"\S+")
_NUMBER = re.compile(r"-?[0-9]+(?:\.[0-9]+)?")


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
    plan = normalize(reply, binder=binder, dialect=dialect)
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
        spans = list(_exact(Names(site_spellings(site)), text))
        #: what each name in the text stands for: one thing, or several
        self._named = {frozenset(owners[_spaced(text[start:end])]) for start, end in spans}
        spelled = {tool.replace("_", " "): tool for tool in tools} | {tool: tool for tool in tools}
        called = {_spaced(name): tool for name, tool in spelled.items()}
        self._tools = {
            called[_spaced(text[start:end])] for start, end in _exact(Names(spelled), text)
        }
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
            found = list(self._quantities(unit))
            ends, starts = {end for _, end, _ in found}, {start for start, _, _ in found}
            # `1 h 30 min` states neither of its parts
            self._values[unit] = frozenset(
                value for start, end, value in found if start not in ends and end not in starts
            )
        return self._values[unit]

    def _quantities(self, unit: str) -> Iterator[tuple[int, int, int]]:
        """Yield each quantity of a unit as its first word, the word behind it and its value."""
        after_number = False
        for at, word in enumerate(self._words):
            opened = word.lstrip(_OPENING)
            number = _NUMBER.fullmatch(opened)
            bare = opened.rstrip(_CLOSING)
            if after_number:
                pass  # `10 500 ms` is no 500 ms
            elif unit == "count" and _NUMBER.fullmatch(bare):
                yield from self._read(at, 1, f"{bare} count", unit)
            elif number and at + 1 < len(self._words):
                spelled = self._words[at + 1].rstrip(_CLOSING)
                yield from self._read(at, 2, f"{opened} {spelled}", unit)
            elif bare[:1].isdigit() or bare[:1] == "-":
                yield from self._read(at, 1, bare, unit)
            after_number = number is not None

    def _read(self, at: int, size: int, text: str, unit: str) -> Iterator[tuple[int, int, int]]:
        try:
            yield at, at + size, self._quantity(text, unit)
        except AuthGuardError:
            return


def _carried(way: ToolBinding, name: str) -> Iterator[object]:
    """Yield what the binding gives a parameter without the planner."""
    target = f"params.{name}"
    if target in way.fixed:
        yield way.fixed[target]
    yield from (a.default for a in way.arguments.values() if a.to == target)


def _exact(names: Names, text: str) -> Iterator[tuple[int, int]]:
    """Yield where a whole name stands in a text as the site spells it, in any case and spacing.

    Of names within each other the longest counts; of names that share a word none does.
    """
    found = [(m.start, m.end) for m in names.find(text) if m.how is How.EXACT]
    for number, (start, end) in enumerate(found):
        near = (*found[max(0, number - 1) : number], *found[number + 1 : number + 2])
        alone = all(other_end <= start or end <= other for other, other_end in near)
        free = _BEFORE.search(text, max(0, start - _MARKS), start) and _AFTER.match(text, end)
        if alone and free:
            yield start, end


def _spaced(text: str) -> str:
    return " ".join(text.casefold().split())
