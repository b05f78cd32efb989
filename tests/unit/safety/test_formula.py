# SPDX-License-Identifier: Apache-2.0
"""A rule's text: one reading, and a place in the text for everything else."""

from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import MAX_INTEGER
from authguard_r.core.reasons import Reason
from authguard_r.safety.temporal.formula import (
    FALSE,
    TRUE,
    Atom,
    AtomComparison,
    Formula,
    Op,
    negated,
)
from authguard_r.safety.temporal.parse import MAX_DEPTH, MAX_LENGTH, parse
from fixtures.cases import case


def word(field: str, value: str | int, test: AtomComparison = AtomComparison.EQUAL) -> Formula:
    return Formula(Op.ATOM, (), Atom(field, test, value))


P, Q, R = (word("type", name) for name in ("p", "q", "r"))
NO = negated


def test_every_part_of_the_grammar_has_one_reading() -> None:
    for text, formula in [
        ("true", TRUE),
        ("!true", FALSE),
        ("  type = p ", P),
        ("type=p", P),
        ("type != p", NO(P)),
        ("!type=p", NO(P)),
        ("!!type=p", P),
        ("type=p & type=q | type=r", Formula(Op.OR, (Formula(Op.AND, (P, Q)), R))),
        ("type=p -> type=q -> type=r", Formula(Op.OR, (NO(P), Formula(Op.OR, (NO(Q), R))))),
        ("type=p->type=q", Formula(Op.OR, (NO(P), Q))),
        ("type=p U type=q & type=r", Formula(Op.AND, (Formula(Op.UNTIL, (P, Q)), R))),
        ("type=p U type=q U type=r", Formula(Op.UNTIL, (P, Formula(Op.UNTIL, (Q, R))))),
        ("type=p W type=q", Formula(Op.WEAK_UNTIL, (P, Q))),
        ("type=p R type=q", Formula(Op.RELEASE, (P, Q))),
        ("type=p M type=q", Formula(Op.STRONG_RELEASE, (P, Q))),
        ("G type=p", Formula(Op.RELEASE, (FALSE, P))),
        ("F type=p", Formula(Op.UNTIL, (TRUE, P))),
        ("X type=p", Formula(Op.NEXT, (P,))),
        ("WX type=p", Formula(Op.WEAK_NEXT, (P,))),
        ("!X type=p", Formula(Op.WEAK_NEXT, (NO(P),))),
        ("!(type=p U type=q)", Formula(Op.RELEASE, (NO(P), NO(Q)))),
        ("!(type=p W type=q)", Formula(Op.STRONG_RELEASE, (NO(P), NO(Q)))),
        ("!G type=p", Formula(Op.UNTIL, (TRUE, NO(P)))),
        ("object = package-p1", word("object", "package-p1")),
        ("source = a", word("source", "a")),
        ("destination = a.b:c_d-", word("destination", "a.b:c_d-")),
        ("route contains hall", word("route", "hall", AtomComparison.CONTAINS)),
        ("!route contains hall", NO(word("route", "hall", AtomComparison.CONTAINS))),
        ("params.v <= 5", word("params.v", 5, AtomComparison.AT_MOST)),
        ("params.v < 5", word("params.v", 4, AtomComparison.AT_MOST)),
        ("params.v > 5", NO(word("params.v", 5, AtomComparison.AT_MOST))),
        ("params.v >= -5", NO(word("params.v", -6, AtomComparison.AT_MOST))),
        ("params.v = 5", word("params.v", 5)),
        ("params.v != 0", NO(word("params.v", 0))),
        ("state.door = open", word("state.door", "open")),
        ("state.door != true", NO(word("state.door", "true"))),
        ("state.far = 7", word("state.far", 7)),
        ("state.far <= 7", word("state.far", 7, AtomComparison.AT_MOST)),
        ("state.a.b = 007", word("state.a.b", "007")),
        (f"params.v <= {MAX_INTEGER}", word("params.v", MAX_INTEGER, AtomComparison.AT_MOST)),
    ]:
        with case(text, formula):
            assert parse(text) == formula


def test_an_unknown_atom_and_any_other_text_is_refused_with_its_column() -> None:
    for text, column in [
        ("", 1),
        ("   ", 4),
        ("type", 5),
        ("type =", 7),
        ("type = ->", 8),
        ("type = P", 8),
        ("type <= p", 6),
        ("color = red", 1),
        ("__import__", 1),
        ("params.v", 9),
        ("params.v = fast", 12),
        ("params.v = true", 12),
        ("params.v contains 5", 10),
        ("params. = 5", 1),
        ("params.v <= 1.5", 13),
        ("params.v <= 1e3", 13),
        (f"params.v <= {MAX_INTEGER + 1}", 13),
        (f"params.v < -{MAX_INTEGER}", 12),
        ("params.v <= 01", 13),
        ("params.v <= -", 13),
        ("state.door <= open", 15),
        ("state.door = OPEN", 14),
        ("route = hall", 7),
        ("route contains", 15),
        ("metadata.planner = x", 1),
        ("(type = p", 10),
        ("type = p)", 9),
        ("type = p type = q", 10),
        ("type = p &", 11),
        ("type = p X type = q", 10),
        ("G", 2),
        ("U type = p", 1),
        ("type = p <-> type = q", 10),
        ("type = p // no", 10),
        ("type = p\n", 9),
        ("type = \u0440", 8),
        ("type = " + "a" * 65, 8),
    ]:
        with case(text, column):
            with pytest.raises(MalformedError) as refused:
                parse(text, where="rule")
            assert refused.value.where == f"rule:{column}"


def test_a_formula_is_neither_long_nor_deep() -> None:
    assert parse("true" + " " * (MAX_LENGTH - 4)) == TRUE
    with pytest.raises(MalformedError) as long:
        parse("true" + " " * (MAX_LENGTH - 3))
    assert long.value.reason is Reason.INPUT_TOO_LARGE
    assert parse("(" * MAX_DEPTH + "true" + ")" * MAX_DEPTH) == TRUE
    for deep in ("(", "!", "G", "X ", "true->", "true U "):
        with pytest.raises(MalformedError, match=f"at most {MAX_DEPTH} levels"):
            parse(deep * (MAX_DEPTH + 1) + "true")


@given(st.text(alphabet="GFXUWRM!&|()-><= .:0159abtruefalsepotyn_", max_size=60))
def test_whatever_the_text_it_is_a_formula_or_malformed(text: str) -> None:
    with suppress(MalformedError):
        assert isinstance(parse(text), Formula)


def test_an_atom_is_told_as_it_is_written() -> None:
    assert str(P.atom) == "type = p"
    assert str(word("params.v", 5, AtomComparison.AT_MOST).atom) == "params.v <= 5"
