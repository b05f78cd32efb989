# SPDX-License-Identifier: Apache-2.0
"""What a rule says, as a value: atoms over one action, and the operators between actions.

Always in negation normal form: `!` stands in front of atoms only, so that a formula and what is
left of it are made of the same few parts.
"""

from __future__ import annotations

from enum import StrEnum

from msgspec import Struct


class AtomComparison(StrEnum):
    """How an atom compares."""

    EQUAL = "="
    AT_MOST = "<="
    CONTAINS = "contains"


#: Words that stand for truth values where an atom asks about the state.
TRUTH = {"true": True, "false": False}


class Atom(Struct, frozen=True):
    """One question about one action, or about the state in which it is proposed.

    Args:
        field: `type`, `object`, `source`, `destination`, `route`, `params.NAME`, `state.NAME`.
        test: how it compares.
        value: an integer or a word; `true` and `false` are words that stand for truth values.
    """

    field: str
    test: AtomComparison
    value: int | str

    def __str__(self) -> str:
        return f"{self.field} {self.test} {self.value}"


class Op(StrEnum):
    """What a formula is made of."""

    TRUE = "true"
    FALSE = "false"
    ATOM = "atom"
    NOT = "!"
    AND = "&"
    OR = "|"
    #: There is a next action, and it is such.
    NEXT = "X"
    #: If there is a next action, it is such.
    WEAK_NEXT = "WX"
    UNTIL = "U"
    WEAK_UNTIL = "W"
    RELEASE = "R"
    STRONG_RELEASE = "M"


class Formula(Struct, frozen=True):
    """One formula.

    Args:
        op: its outermost part; `NOT` is the negation of an atom.
        parts: what it joins: two or more for `AND` and `OR`, one for the nexts, else two.
        atom: of `ATOM` and `NOT` alone.
    """

    op: Op
    parts: tuple[Formula, ...] = ()
    atom: Atom | None = None


TRUE, FALSE = Formula(Op.TRUE), Formula(Op.FALSE)
#: At least one more action follows; none does.
MORE = Formula(Op.UNTIL, (TRUE, TRUE))
NO_MORE = Formula(Op.RELEASE, (FALSE, FALSE))

_DUAL = {
    Op.TRUE: Op.FALSE,
    Op.ATOM: Op.NOT,
    Op.AND: Op.OR,
    Op.NEXT: Op.WEAK_NEXT,
    Op.UNTIL: Op.RELEASE,
    Op.WEAK_UNTIL: Op.STRONG_RELEASE,
}
_DUAL |= {dual: op for op, dual in _DUAL.items()}


def negated(formula: Formula) -> Formula:
    """Return the formula that every trace with an action satisfies when it fails this one."""
    return Formula(_DUAL[formula.op], tuple(map(negated, formula.parts)), formula.atom)
