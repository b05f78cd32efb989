# SPDX-License-Identifier: Apache-2.0
"""Progression, operator by operator; the end of a trace; what can still hold; and the bounds."""

from __future__ import annotations

import pytest

from authguard_r.core.errors import MalformedError
from authguard_r.safety.temporal.formula import Atom
from authguard_r.safety.temporal.parse import parse
from authguard_r.safety.temporal.track import (
    ANYTHING,
    NOTHING,
    FormulaTrack,
    Left,
    Letter,
    spelled,
    unknown_atoms,
)
from fixtures.cases import case

A, B = "route contains a", "route contains b"


def track(text: str) -> FormulaTrack:
    """Return the track of a formula in which `a` and `b` stand for two atoms."""
    words = {"a": A, "b": B}
    return FormulaTrack(
        parse(" ".join(words.get(word, word) for word in text.split())), where="rule"
    )


def letter(here: FormulaTrack, holding: str, unknown: str = "") -> Letter:
    numbers = {atom.value: number for number, atom in enumerate(here.atoms)}
    return Letter(
        frozenset(numbers[name] for name in holding if name in numbers),
        frozenset(numbers[name] for name in unknown if name in numbers),
    )


def left(text: str, *trace: str) -> tuple[FormulaTrack, Left]:
    here = track(text)
    found = here.start
    for holding in trace:
        found = here.after(found, letter(here, holding))
    return here, found


def verdict(text: str, *trace: str) -> str:
    """Return `holds` if it holds at the end of the trace, `may` if it still can, else `dead`."""
    here, found = left(text, *trace)
    if here.may_end(found):
        return "holds"
    return "may" if here.can_hold(found) else "dead"


def test_progression_of_each_operator() -> None:
    for text, trace, told in [
        ("a", ["a"], "holds"),
        ("a", [""], "dead"),
        ("! a", ["b"], "holds"),
        ("! a", ["a"], "dead"),
        ("a & b", ["ab"], "holds"),
        ("a & b", ["a"], "dead"),
        ("a | b", ["b"], "holds"),
        ("a | b", [""], "dead"),
        ("a -> b", [""], "holds"),
        ("a -> b", ["a"], "dead"),
        # strong next: there has to be one
        ("X a", [""], "may"),
        ("X a", ["", "a"], "holds"),
        ("X a", ["", ""], "dead"),
        ("X true", [""], "may"),
        ("X true", ["", ""], "holds"),
        ("F X a", ["a"], "may"),
        # weak next: if there is one
        ("WX a", [""], "holds"),
        ("WX a", ["", "a"], "holds"),
        ("WX a", ["", ""], "dead"),
        ("F ( a & WX false )", ["a"], "holds"),
        ("F ( a & WX false )", ["a", ""], "may"),
        ("F ( a & WX false )", ["a", "", "a"], "holds"),
        ("a U b", ["b"], "holds"),
        ("a U b", ["a"], "may"),
        ("a U b", ["a", "b"], "holds"),
        ("a U b", ["a", ""], "dead"),
        ("a W b", ["a", "a"], "holds"),
        ("a W b", ["a", ""], "dead"),
        ("a W b", ["b", ""], "holds"),
        ("a R b", ["b", "b"], "holds"),
        ("a R b", ["b", ""], "dead"),
        ("a R b", ["ab", ""], "holds"),
        ("a R b", ["a"], "dead"),
        ("a M b", ["b", "b"], "may"),
        ("a M b", ["b", "ab"], "holds"),
        ("a M b", ["b", "a"], "dead"),
        ("F a", ["", ""], "may"),
        ("F a", ["", "a", ""], "holds"),
        ("G a", ["a", "a"], "holds"),
        ("G a", ["a", ""], "dead"),
        ("G ( a -> F b )", ["a"], "may"),
        ("G ( a -> F b )", ["a", "b"], "holds"),
        ("G ( a -> WX G ! a )", ["a", "", "b"], "holds"),
        ("G ( a -> WX G ! a )", ["a", "", "a"], "dead"),
        ("F a & F b", ["a", "b"], "holds"),
        ("true", [""], "holds"),
    ]:
        with case(text, trace, told):
            assert verdict(text, *trace) == told


def test_a_dead_end_is_seen_before_it_is_reached() -> None:
    """`b` can never come once `a` is forbidden to end before it, and it is forbidden, too."""
    text = "( G ( a -> X b ) ) & G ( b -> ! b | ! F a )"
    assert verdict("F b & G ( a -> G ! b )", "a") == "dead"
    assert verdict(text, "a") == "may"


@pytest.mark.parametrize("text", ["false", "a & ! a", "X a & WX ! a", "G X true", "F a & G ! a"])
def test_a_rule_that_no_action_could_ever_satisfy_is_none(text: str) -> None:
    with pytest.raises(MalformedError, match="no action could ever be done"):
        track(text)


def test_values_of_one_field_exclude_each_other() -> None:
    """Nobody waits for an action that is two things at once."""
    both = "F (type = p & type = q)"
    with pytest.raises(MalformedError, match="no action could ever"):
        FormulaTrack(parse(both), where="rule")
    for text in (
        "G (params.v <= 4 & params.v > 6 | type = p)",
        "G (state.a = true & state.a = false | type = p)",
        "G (state.a = 3 & state.a <= 2 | type = p)",
    ):
        here = FormulaTrack(parse(text), where="rule")
        # only by `type = p` does it live on
        number = here.atoms.index(parse("type = p").atom)
        assert not here.can_hold(here.after(here.start, Letter(frozenset())))
        assert here.can_hold(here.after(here.start, Letter(frozenset({number}))))
    apart = FormulaTrack(parse("F (params.v >= 4 & params.v < 6 & params.v != 4)"), where="rule")
    assert apart.can_hold(apart.start)
    other = FormulaTrack(parse("F (state.a != open & state.a != shut)"), where="rule")
    assert other.can_hold(other.start)


def test_what_nobody_knows_stays_only_where_it_matters() -> None:
    here = track("G ( a -> b )")
    assert unknown_atoms(here.after(here.start, letter(here, "a", "b"))) == (1,)
    assert unknown_atoms(here.after(here.start, letter(here, "b", "a"))) == ()
    assert unknown_atoms(here.after(here.start, letter(here, "", "b"))) == ()
    assert unknown_atoms(here.after(here.start, letter(here, "", "ab"))) == (0, 1)
    never = track("! a & b")
    assert unknown_atoms(never.after(never.start, letter(never, "", "a"))) == ()
    assert never.after(never.start, letter(never, "", "a")) == NOTHING


def test_both_traces_have_to_go_on() -> None:
    here, before = left("G ( a -> WX ! a )")
    after = here.after(before, letter(here, "a"))
    doubted = here.both(before, after)
    assert here.may_end(doubted)
    assert not here.can_hold(here.after(doubted, letter(here, "a")))
    assert here.can_hold(here.after(doubted, letter(here, "b")))
    # two traces that want different things next
    turns, one = left("( a & WX ( b & WX a ) )")
    other = turns.after(one, letter(turns, "a"))
    apart = turns.both(turns.after(other, letter(turns, "b")), one)
    assert turns.can_hold(apart)
    asked, was = left("X ( a & ! b ) | X ( b & ! a )", "")
    torn = asked.both(asked.after(was, letter(asked, "a")), was)
    assert asked.can_hold(torn)


def test_doubt_that_nothing_resolves_is_dead() -> None:
    here, start = left("a & WX G ! a")
    later = here.after(start, letter(here, "a"))
    torn = here.both(start, later)
    assert (here.can_hold(start), here.can_hold(later), here.can_hold(torn)) == (True, True, False)
    assert not here.can_hold(torn)  # as it was remembered


def test_what_was_looked_at_is_forgotten_before_it_fills_the_memory(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("authguard_r.safety.temporal.track._MOST_KNOWN", 1)
    here, start = left("a & WX G ! a")
    later = here.after(start, letter(here, "a"))
    for _ in range(2):  # no trace leaves either
        assert not here.can_hold(here.both(start, later))
        assert not here.can_hold(frozenset({frozenset({0, 1, 2})}))
        assert len(here._known) == 1


def test_ways_are_spelled_in_one_order() -> None:
    assert spelled(frozenset({frozenset({3, 1}), frozenset({2})})) == ((1, 3), (2,))
    assert (spelled(ANYTHING), spelled(NOTHING)) == (((),), ())


@pytest.mark.parametrize(
    ("text", "bound"),
    [
        (" | ".join(f"type = t{n}" for n in range(17)), "at most 16 atoms"),
        (" & ".join(f"(X route contains t{n} | X X route contains t{n})" for n in range(7)), "way"),
        (" & ".join(f"(route contains t{n} | true)" for n in range(14)), "kinds of action"),
        (" & ".join(f"(F route contains t{n})" for n in range(7)), "steps"),
    ],
)
def test_a_rule_that_grows_is_no_rule(text: str, bound: str) -> None:
    with pytest.raises(MalformedError, match=bound) as refused:
        FormulaTrack(parse(text), where="rule")
    assert (refused.value.where, str(refused.value.reason)) == ("rule", "INPUT_TOO_LARGE")


def test_sixteen_values_of_one_field_are_no_growth() -> None:
    """As many letters as values, not two to their power."""
    here = FormulaTrack(
        parse("G (" + " | ".join(f"type = t{n}" for n in range(16)) + ")"), where="rule"
    )
    assert len(here.atoms) == 16
    assert len(here._letters) == 17
    assert isinstance(here.atoms[0], Atom)
