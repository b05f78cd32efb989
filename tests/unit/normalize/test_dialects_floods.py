# SPDX-License-Identifier: Apache-2.0
"""Refusing costs little: no flood in any dialect takes a second, or 200 MB (L19).

A flood is what a planner, or whoever moves it, can send to keep the gate busy: a megabyte, 10,000
levels, 10,000 calls, and whatever makes a careless parser recurse or go back again and again.
"""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from functools import cache, partial
from typing import Any

import pytest

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.dialects import Dialect, read_plan
from authguard_r.normalize.parse import MAX_TEXT, read_text
from fixtures.amount import amount
from fixtures.time_bounds import at_most
from unit.normalize.writers import WAYS, Call, as_exact_openai

SECOND, MEMORY = 1.0, 200_000_000


def refused_in_time(read: Callable[[], Any]) -> MalformedError:
    """Assert a refusal within a second of this process's time."""
    with at_most(SECOND), pytest.raises(MalformedError) as caught:
        read()
    assert caught.value.where
    return caught.value


def refuses_in_little_memory(read: Callable[[], Any], *, share: float) -> None:
    """Assert that a share of a flood takes at most that share of the memory (measuring is slow)."""
    tracemalloc.start()
    try:
        with pytest.raises(MalformedError):
            read()
        assert tracemalloc.get_traced_memory()[1] < MEMORY * share
    finally:
        tracemalloc.stop()


def whole(data: bytes, dialect: Dialect) -> Callable[[], Any]:
    return lambda: read_plan(read_text(data), dialect)


@cache
def many(way: str, count: int) -> str:
    _, write, calls = WAYS[way]
    return write(*[calls[0]] * count)


@pytest.mark.parametrize("way", WAYS)
def test_a_megabyte_in_its_own_form_is_refused_by_its_length(way: str) -> None:
    data = many(way, 10_000).encode()
    assert len(data) >= 1 << 17
    data *= (1 << 20) // len(data) + 1
    for dialect in (WAYS[way][0], Dialect.AUTO):
        error = refused_in_time(whole(data[: 1 << 20], dialect))
        assert error.reason is Reason.INPUT_TOO_LARGE


@pytest.mark.parametrize("way", WAYS)
def test_10_000_calls_are_refused_by_the_reader_without_the_cap_on_length(way: str) -> None:
    text = many(way, 10_000)
    for dialect in (WAYS[way][0], Dialect.AUTO):
        error = refused_in_time(partial(read_plan, text, dialect))
        assert error.reason is Reason.INPUT_TOO_LARGE
    some = amount(2_500, 10_000)
    refuses_in_little_memory(partial(read_plan, many(way, some), WAYS[way][0]), share=some / 10_000)


@pytest.mark.parametrize("way", WAYS)
def test_as_many_calls_as_fit_into_the_longest_text_are_refused(way: str) -> None:
    one = (len(many(way, 10_000)) - len(many(way, 1_000))) / 9_000
    text = many(way, int((MAX_TEXT - 1_000) / (one + 1)))
    assert len(text) <= MAX_TEXT
    for dialect in (WAYS[way][0], Dialect.AUTO):
        error = refused_in_time(whole(text.encode(), dialect))
        assert error.reason is Reason.INPUT_TOO_LARGE


DEEP = {
    "lists": ("[", "]"),
    "open lists": ("[", ""),
    "objects": ('{"a":', "}"),
    "open objects": ('{"plan":', ""),
    "single-quoted objects": ("{'function':", "}"),
    "tuples": ("(", ",)"),
    "lists of tuples": ("[(", ")]"),
    "calls": ("go(", ")"),
    "named calls": ("go(a=", ")"),
    "chained calls": ("go()", ""),
    "chained lists": ("go[0]", ""),
    "attributes": ("a.", ""),
    "minus signs": ("-", ""),
    "sums": ("1+", ""),
    "powers": ("2**", ""),
    "nots": ("not ", ""),
    "lambdas": ("lambda:", ""),
    "conditions": ("1 if 1 else ", ""),
    "comparisons": ("1<", ""),
    "assignments": ("a=", ""),
    "annotations": ("a:", ""),
    "awaits": ("await ", ""),
    "strings": ("'a' ", ""),
    "f-strings": ("f'{", ""),
    "blocks": ("if 1:\n ", ""),
    "back slashes": ("\\\n", ""),
    "steps": ("find ", ""),
    "numbers": ("1. ", ""),
    "content blocks": ('{"stop_reason":"tool_use","content":[', "]}"),
    "choices": ('{"choices":[', "]}"),
    "requests": ('{"jsonrpc":"2.0","params":', "}"),
    "messages": ('{"op":"publish","msg":', "}"),
}
PLACES = {
    "alone": "{}",
    "in a call": "go(a={})",
    "in code, later": "go()\ngo({})",
    "in a step": "find {}",
    "in a bare list": "[goto({})]",
    "in tuples": "[('goto', {})]",
    "in a plan": '{{"plan": "[goto({})]"}}',
    "in a function": "{{'function': [{}]}}",
}


@pytest.mark.parametrize("place", PLACES)
def test_10_000_levels_of_anything_are_refused_or_flat_text(place: str) -> None:
    """Python's own parser would recurse, run out of its stack, or end the process."""
    places = {}
    for opening, (before, after) in DEEP.items():
        text = PLACES[place].format(before * 10_000 + "1" + after * 10_000)
        for dialect in Dialect:
            try:
                with at_most(SECOND):
                    calls = read_plan(text, dialect)
            except MalformedError as error:
                places[opening, dialect] = error.where
            else:  # free text is flat: a name of 10,000 words, which no binding knows
                assert dialect in {Dialect.STEPS, Dialect.SPINE, Dialect.AUTO}, opening
                for call in calls:
                    assert all(isinstance(word, str) for word in call.arguments.values()), opening
    assert [at for at, where in places.items() if not where] == []


def items(count: int) -> str:
    return f"go(a=[{'0,' * count}], a=1)"


def tuples(count: int) -> str:
    return "[" + "('a',)," * count + "]"


LONG = {
    "digits": "1" * MAX_TEXT,
    "places": "0." + "1" * (MAX_TEXT - 2),
    "an exponent": "1e" + "9" * (MAX_TEXT - 2),
    "digits in a call": f"go(a={'1' * 60_000})",
    "a number that ends badly": f"go(a={'1' * 60_000}x)",
    "an open string": "go(a='" + "x" * 60_000,
    "an open string of escapes": "go(a='" + "\\n" * 30_000,
    "a string of quotes": "go(a='" + "\\'" * 30_000,
    "spaces": " " * MAX_TEXT,
    "spaces in a call": f"go({' ' * 60_000}",
    "spaces in a list": "[" + " " * (MAX_TEXT - 1),
    "lines": "\n" * (MAX_TEXT - 1) + "x",
    "lines of numbers": "1. \n" * (MAX_TEXT // 4),
    "comments": "#\n" * 30_000,
    "comments to the limit": "#\n" * (MAX_TEXT // 2),
    "a name": "a" * MAX_TEXT,
    "a dotted name": "a." * (MAX_TEXT // 2),
    "fields": "go(" + ",".join(f"k{n}=0" for n in range(8_000)) + ",k0=0)",
    "items": items(30_000),
    "keys": "go(a={" + ",".join(f"'{n}':0" for n in range(6_000)) + ",'0':0})",
    "words": f"[goto({'a,' * (MAX_TEXT // 2 - 10)}",
    "one word": f"[goto({'a ' * (MAX_TEXT // 2 - 10)}",
    "spaces in a word": f"[goto(a{' ' * (MAX_TEXT - 20)}",
    "tuples": tuples(9_000),
    "quotes": "'" * MAX_TEXT,
    "double quotes": '"' * MAX_TEXT,
    "strings": '["' + "a" * (MAX_TEXT - 2),
    "back slashes": '{"' + "\\" * (MAX_TEXT - 2),
}


@pytest.mark.parametrize("name", LONG)
def test_a_flood_of_one_thing_is_refused(name: str) -> None:
    text = LONG[name]
    assert len(text) <= MAX_TEXT
    for dialect in Dialect:
        refused_in_time(partial(read_plan, text, dialect))


@pytest.mark.parametrize(("flood", "count"), [(items, 30_000), (tuples, 9_000)])
def test_a_flood_of_values_takes_little_memory(flood: Callable[[int], str], count: int) -> None:
    share = 1 / amount(4, 1)
    for dialect in set(Dialect) - {Dialect.AUTO}:
        read = partial(read_plan, flood(int(count * share)), dialect)
        refuses_in_little_memory(read, share=share)


def test_the_memory_of_a_flood_of_arguments_is_bounded() -> None:
    """The most that fits: a reply of numbers, written as text within text."""
    call: Call = ("go", {"a": [0] * 60_000})
    text = as_exact_openai(call)
    assert len(text) <= MAX_TEXT
    tracemalloc.start()
    try:
        assert len(read_plan(text, Dialect.AUTO)[0].arguments["a"]) == 60_000
        assert tracemalloc.get_traced_memory()[1] < MEMORY
    finally:
        tracemalloc.stop()
