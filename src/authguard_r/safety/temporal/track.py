# SPDX-License-Identifier: Apache-2.0
"""One formula, followed from action to action: what is left of it, and whether it still can hold.

What is left is a set of ways; a way is a set of obligations, each one a part of the formula, all
of which the rest of the trace has to meet. No way left: nothing that follows can satisfy the
formula. A way without obligations: anything can. There are finitely many parts, so there are
finitely many sets; how many may be met with is bounded. Source: progression (Bacchus and Kabanza),
on finite traces (De Giacomo and Vardi). Spec page: docs/spec/safety.md#semantics
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import product
from typing import TypeVar

from msgspec import Struct

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.safety.temporal.formula import (
    MORE,
    NO_MORE,
    TRUTH,
    Atom,
    AtomComparison,
    Formula,
    Op,
)

K = TypeVar("K")
V = TypeVar("V")
#: Different atoms of one rule.
MAX_ATOMS = 16
#: Ways that may be left at once.
MAX_WAYS = 64
#: Sets of ways times kinds of action that are looked at to know what can still be satisfied.
MAX_STEPS = 8_192

Way = frozenset[int]
#: Numbers of parts; below 0, an atom that is unknown.
Left = frozenset[Way]

#: Anything satisfies it; nothing does.
ANYTHING: Left = frozenset({frozenset()})
NOTHING: Left = frozenset()
#: Parts that a trace without a further action satisfies.
_AT_END = frozenset({Op.WEAK_NEXT, Op.WEAK_UNTIL, Op.RELEASE})
_MOST_KNOWN = 1_024


class Letter(Struct, frozen=True):
    """One action as a rule sees it: the numbers of its atoms that hold, and of those not known."""

    true: frozenset[int]
    unknown: frozenset[int] = frozenset()


class FormulaTrack:
    """A formula with all that following it takes. It is made once and changes nothing it says.

    Args:
        formula: the formula.
        where: prefix of the place in messages.

    Raises:
        MalformedError: more than `MAX_ATOMS`, `MAX_WAYS` or `MAX_STEPS`, or no trace with an
            action satisfies it.
    """

    def __init__(self, formula: Formula, *, where: str) -> None:
        self._where = where
        self.atoms = tuple(dict.fromkeys(_atoms(formula)))
        if len(self.atoms) > MAX_ATOMS:
            raise self._grown(f"at most {MAX_ATOMS} atoms")
        self._number: dict[Atom | None, int] = {atom: n for n, atom in enumerate(self.atoms)}
        self.parts = tuple(dict.fromkeys((*_parts(formula), MORE, NO_MORE)))
        self._place = {part: place for place, part in enumerate(self.parts)}
        self._letters = self._all_letters()
        self.start = self._ways(formula)
        # what was worked out lately; working it out again gives the same
        self._known: dict[Left, bool] = {}
        self._after: dict[tuple[Left, Letter], Left] = {}
        self._both: dict[tuple[Left, Left], Left] = {}
        self._living = self._explored()
        if not any(self.can_hold(self.after(self.start, letter)) for letter in self._letters):
            raise MalformedError("no action could ever be done under it", where=where)

    def after(self, left: Left, letter: Letter) -> Left:
        """Return what is left after one more action (progression).

        Raises:
            MalformedError: more than `MAX_WAYS` are left.
        """
        key = (left, letter)
        if key not in self._after:
            met = (self._all(self._met(self.parts[n], letter) for n in way) for way in left)
            _keep(self._after, key, self._any(met))
        return self._after[key]

    def both(self, one: Left, other: Left) -> Left:
        """Return what is left when each of two traces may be the one that happened.

        Raises:
            MalformedError: more than `MAX_WAYS` are left.
        """
        key = (one, other)
        if key not in self._both:
            _keep(self._both, key, self._all(key))
        return self._both[key]

    def may_end(self, left: Left) -> bool:
        """True when the trace satisfies the formula if no further action follows."""
        return any(all(self.parts[place].op in _AT_END for place in way) for way in left)

    def can_hold(self, left: Left) -> bool:
        """True when some actions from here on, possibly none, satisfy the formula.

        Raises:
            MalformedError: that cannot be computed within `MAX_STEPS`.
        """
        if left in self._living:
            return self._living[left]
        if left not in self._known:
            living = any(self.may_end(reached) for reached, _ in self._steps(left))
            _keep(self._known, left, living)
        return self._known[left]

    def _explored(self) -> dict[Left, bool]:
        """Return of all that the formula can become whether it can still hold."""
        steps = dict(self._steps(self.start))
        living = {left for left in steps if self.may_end(left)}
        count = -1
        while count != len(living):
            count = len(living)
            living |= {left for left, then in steps.items() if not living.isdisjoint(then)}
        return {left: left in living for left in steps}

    def _steps(self, start: Left) -> Iterator[tuple[Left, frozenset[Left]]]:
        """Give everything that can be left from here on, each once, with what can follow it."""
        seen, waiting = {start}, [start]
        while waiting:
            left = waiting.pop(0)
            if len(seen) * len(self._letters) > MAX_STEPS:
                raise self._grown(f"at most {MAX_STEPS} steps to find its possible continuations")
            then = frozenset(self.after(left, letter) for letter in self._letters)
            yield left, then
            waiting += sorted(then - seen, key=spelled)
            seen |= then

    def _ways(self, formula: Formula) -> Left:
        """Return the formula as it stands, as ways."""
        if formula.op is Op.AND:
            return self._all(map(self._ways, formula.parts))
        if formula.op is Op.OR:
            return self._any(map(self._ways, formula.parts))
        if formula.op in _CONSTANT:
            return _CONSTANT[formula.op]
        return frozenset({frozenset({self._place[formula]})})

    def _met(self, formula: Formula, letter: Letter) -> Left:
        """Return what the rest of the trace has to meet when the next action is this one."""
        op, parts = formula.op, formula.parts
        if op in {Op.ATOM, Op.NOT}:
            return self._literal(formula, letter)
        if op is Op.AND:
            return self._all(self._met(part, letter) for part in parts)
        if op is Op.OR:
            return self._any(self._met(part, letter) for part in parts)
        if op is Op.NEXT:
            return self._all((self._ways(parts[0]), self._ways(MORE)))
        if op is Op.WEAK_NEXT:
            return self._any((self._ways(parts[0]), self._ways(NO_MORE)))
        if op in _CONSTANT:
            return _CONSTANT[op]
        first, second = self._met(parts[0], letter), self._met(parts[1], letter)
        if op in {Op.UNTIL, Op.WEAK_UNTIL}:
            return self._any((second, self._all((first, self._ways(formula)))))
        return self._all((second, self._any((first, self._ways(formula)))))

    def _literal(self, formula: Formula, letter: Letter) -> Left:
        number = self._number[formula.atom]
        if number in letter.unknown:
            return frozenset({frozenset({-1 - number})})
        return ANYTHING if (number in letter.true) == (formula.op is Op.ATOM) else NOTHING

    def _any(self, lefts: Iterable[Left]) -> Left:
        """Join: one of them has to be met. A way that asks more than another is dropped."""
        ways: set[Way] = set().union(*lefts)
        kept = frozenset(way for way in ways if not any(other < way for other in ways))
        if len(kept) > MAX_WAYS:
            raise self._grown(f"at most {MAX_WAYS} ways to satisfy the rest")
        return kept

    def _all(self, lefts: Iterable[Left]) -> Left:
        """Cross: all of them have to be met."""
        met = ANYTHING
        for left in lefts:
            met = self._any(frozenset({one | other}) for one, other in product(met, left))
        return met

    def _all_letters(self) -> tuple[Letter, ...]:
        """Return every action that the atoms can tell apart."""
        groups: dict[str, list[int]] = {}
        for number, atom in enumerate(self.atoms):
            # a route holds many regions at once; every other field has one value
            key = str(atom) if atom.test is AtomComparison.CONTAINS else atom.field
            groups.setdefault(key, []).append(number)
        choices = [self._choices(numbers) for numbers in groups.values()]
        count = 1
        for one in choices:
            count *= len(one)
        if count > MAX_STEPS:
            raise self._grown(f"at most {MAX_STEPS} kinds of action to tell apart")
        return tuple(Letter(frozenset().union(*chosen)) for chosen in product(*choices))

    def _choices(self, numbers: list[int]) -> list[frozenset[int]]:
        """Return which of a field's atoms can hold together."""
        atoms = {number: self.atoms[number] for number in numbers}
        values: list[int | str | None] = []
        for atom in atoms.values():
            values += _beside(atom)
        chosen = (
            frozenset(number for number, atom in atoms.items() if _would_hold(atom, value))
            for value in values
        )
        return list(dict.fromkeys(chosen))

    def _grown(self, expected: str) -> MalformedError:
        return MalformedError(
            f"expected {expected}", where=self._where, reason=Reason.INPUT_TOO_LARGE
        )


def unknown_atoms(left: Left) -> tuple[int, ...]:
    """Return the numbers of the unknown atoms that the rest depends on."""
    return tuple(sorted({-1 - place for way in left for place in way if place < 0}))


def spelled(left: Left) -> tuple[tuple[int, ...], ...]:
    """Return the one spelling of what is left: sorted ways of sorted parts."""
    return tuple(sorted(tuple(sorted(way)) for way in left))


def _keep(known: dict[K, V], key: K, value: V) -> None:
    """Keep a result, and never more of them than a bound."""
    if len(known) >= _MOST_KNOWN:
        known.clear()
    known[key] = value


_CONSTANT = {Op.TRUE: ANYTHING, Op.FALSE: NOTHING}


def _beside(atom: Atom) -> tuple[int | str | None, ...]:
    """Return a value for each relation of a field to an atom; None stands for any other text."""
    if isinstance(atom.value, int):
        return (atom.value - 1, atom.value, atom.value + 1)
    if atom.value in TRUTH and atom.field.startswith("state."):
        return tuple(TRUTH)
    return (atom.value, None)


def _would_hold(atom: Atom, value: int | str | None) -> bool:
    if isinstance(value, int) and isinstance(atom.value, int):
        return value <= atom.value if atom.test is AtomComparison.AT_MOST else value == atom.value
    return value == atom.value


def _atoms(formula: Formula) -> Iterator[Atom]:
    if formula.atom is not None:
        yield formula.atom
    for part in formula.parts:
        yield from _atoms(part)


def _parts(formula: Formula) -> Iterator[Formula]:
    """Give everything in a formula that can be an obligation, outermost first."""
    if formula.op not in {Op.TRUE, Op.FALSE, Op.AND, Op.OR}:
        yield formula
    for part in formula.parts:
        yield from _parts(part)
