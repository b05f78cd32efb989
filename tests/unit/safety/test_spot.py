# SPDX-License-Identifier: Apache-2.0
"""A second opinion: Spot, which reads finite traces in another way, on random rules and traces.

Spot makes of a formula on finite traces one on infinite traces with a letter `alive`, and of that
an automaton; ours progresses. They share no line of code.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable
from functools import cache, lru_cache
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from authguard_r.core.errors import MalformedError
from authguard_r.safety.temporal.parse import parse
from authguard_r.safety.temporal.track import FormulaTrack, Left, Letter
from fixtures.amount import amount

pytestmark = pytest.mark.skipif(
    find_spec("spot") is None and "AUTHGUARD_COMPLETE" not in os.environ,
    reason="spottl is not installed: nobody to compare with",
)

NAMES = ("a", "b", "c")
#: Formula and trace pairs of one run; a longer one is asked for by the environment.
PAIRS = int(os.environ.get("AUTHGUARD_PAIRS", amount(300, 1_500)))
LAWFUL = settings(
    max_examples=PAIRS,
    database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
)

#: A formula in a spelling that both read, but for atoms and nexts.
formulas = st.recursive(
    st.sampled_from((*NAMES, "true", "false")),
    lambda part: st.one_of(
        st.builds("(! {})".format, part),
        st.builds("({} {})".format, st.sampled_from(("G", "F", "NEXT", "WEAK")), part),
        st.builds("({} {} {})".format, part, st.sampled_from((*tuple("&|UWRM"), "->")), part),
    ),
    max_leaves=8,
)
letters = st.frozensets(st.sampled_from(NAMES))
traces = st.lists(letters, min_size=1, max_size=6)


def ours(text: str) -> FormulaTrack:
    """Return our track of the formula; one that nothing satisfies is refused, rightly or not."""
    words = {name: f"route contains {name}" for name in NAMES} | {"NEXT": "X", "WEAK": "WX"}
    spaced = text.replace("(", "( ").replace(")", " )").split()
    return FormulaTrack(parse(" ".join(words.get(word, word) for word in spaced)), where="rule")


@cache
def spots() -> Any:
    """Return Spot; its start warns of its own wrapper, and dies when that is made an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return import_module("spot")


@lru_cache(maxsize=64)
def theirs(text: str) -> Any:
    """Return Spot's automaton of the formula."""
    spot = spots()
    spelled = text.replace("NEXT", "X[!]").replace("WEAK", "X")
    return spot.translate(spot.from_ltlf(spot.formula(spelled), "alive"))


def step(names: Iterable[str], *, alive: bool) -> str:
    held = set(names)
    told = [name if name in held else f"!{name}" for name in NAMES]
    return " & ".join([*told, "alive" if alive else "!alive"])


def word(automaton: Any, trace: list[frozenset[str]]) -> Any:
    spot = spots()
    steps = [*(step(one, alive=True) for one in trace), f"cycle{{{step((), alive=False)}}}"]
    return spot.parse_word("; ".join(steps), automaton.get_dict()).as_automaton()


def accepts(text: str, trace: list[frozenset[str]]) -> bool:
    """Say whether Spot takes the trace, as it ends there."""
    automaton = theirs(text)
    return bool(word(automaton, trace).intersects(automaton))


def can_go_on(text: str, trace: list[frozenset[str]]) -> bool:
    """Say whether Spot knows a trace that begins so and is taken."""
    spot = spots()
    begin = "true"
    for one in reversed(trace):
        begin = f"{step(one, alive=True)} & X({begin})"
    automaton = theirs(text)
    prefix = spot.translate(spot.formula(begin), dict=automaton.get_dict())
    return bool(prefix.intersects(automaton))


def after(track: FormulaTrack, trace: list[frozenset[str]]) -> Left:
    left = track.start
    for one in trace:
        held = (n for n, atom in enumerate(track.atoms) if atom.value in one)
        left = track.after(left, Letter(frozenset(held)))
    return left


@LAWFUL
@given(formulas, traces)
def test_a_trace_is_accepted_exactly_when_spot_accepts_it(
    text: str, trace: list[frozenset[str]]
) -> None:
    try:
        track = ours(text)
    except MalformedError as error:
        assume("no action" in error.message)  # what grows past a bound is nobody's to compare
        assert not accepts(text, trace)
        return
    assert track.may_end(after(track, trace)) == accepts(text, trace)


@LAWFUL
@given(formulas, traces)
def test_an_action_is_a_dead_end_exactly_when_spot_knows_no_way_on(
    text: str, trace: list[frozenset[str]]
) -> None:
    try:
        track = ours(text)
    except MalformedError as error:
        assume("no action" in error.message)
        assert not can_go_on(text, trace)
        return
    assert track.can_hold(after(track, trace)) == can_go_on(text, trace)


@LAWFUL
@given(formulas, formulas, traces, traces)
def test_what_two_traces_leave_holds_when_both_do(
    text: str, other: str, trace: list[frozenset[str]], rest: list[frozenset[str]]
) -> None:
    """The doubt of a memory: `both` is satisfied by what satisfies each."""
    try:
        track = ours(f"({text} & {other}) | a | (! a)")
        shorter = after(track, trace[:-1]) if len(trace) > 1 else track.start
        longer = after(track, trace)
        left = track.both(shorter, longer)
        for one in rest:
            held = (n for n, atom in enumerate(track.atoms) if atom.value in one)
            letter = Letter(frozenset(held))
            left, shorter, longer = (track.after(x, letter) for x in (left, shorter, longer))
    except MalformedError:
        assume(False)
    assert track.may_end(left) == (track.may_end(shorter) and track.may_end(longer))
