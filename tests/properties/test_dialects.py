# SPDX-License-Identifier: Apache-2.0
"""Laws of every dialect: what is written is what is read, and nothing but a refusal ever leaves."""

from __future__ import annotations

from decimal import Decimal
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from authguard_r.core.errors import MalformedError
from authguard_r.normalize.dialects import Call, Dialect, read_plan, read_reply
from authguard_r.normalize.dialects.verbs import DRIVE_VERBS, STEP_VERBS
from authguard_r.normalize.parse import read_text
from fixtures.amount import amount
from unit.normalize.writers import WAYS

LAW = settings(max_examples=amount(25, 100))

# -- what each dialect can say ---------------------------------------------------------------------

letters = st.characters(exclude_categories=["Cs"])
names = st.from_regex(r"[A-Za-z][A-Za-z0-9_]{0,7}", fullmatch=True).map("f_{}".format)
dotted = st.lists(names, min_size=1, max_size=3).map(".".join)
numbers = (
    st.integers(-(10**30), 10**30)
    | st.decimals(-1000, 1000, places=3)
    | st.sampled_from([Decimal("1E+2"), Decimal("-0.0"), Decimal("1E-40")])
)
plain = st.booleans() | numbers | st.text(letters, max_size=12)
unquoted = st.text(st.characters(exclude_categories=["Cs"], exclude_characters='"\\\n'), max_size=9)
nested = st.recursive(
    plain,
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.text(letters, max_size=6), inner, max_size=3)
    ),
    max_leaves=8,
)
words = st.from_regex(r"[A-Za-z_][A-Za-z0-9_]*(?: [A-Za-z0-9?'-]+){0,2}", fullmatch=True)


def positional(values: st.SearchStrategy[Any]) -> st.SearchStrategy[dict[str, Any]]:
    return st.lists(values, max_size=3).map(lambda v: {str(n): i for n, i in enumerate(v, 1)})


def plans(tools: Any, arguments: Any) -> Any:
    return st.lists(st.tuples(tools, arguments), min_size=1, max_size=4)


free = plans(st.text(letters, max_size=9), st.dictionaries(st.text(letters), nested, max_size=3))
code = plans(
    dotted,
    st.builds(lambda a, b: {**a, **b}, positional(nested), st.dictionaries(names, nested)),
)
flat = plans(names, st.dictionaries(names, plain, max_size=3))
rows = plans(st.text(letters, max_size=9), positional(nested))
steps = st.lists(
    st.sampled_from(sorted(STEP_VERBS)).flatmap(
        lambda spelled: st.tuples(
            st.just(spelled),
            st.lists(names, min_size=STEP_VERBS[spelled].low, max_size=STEP_VERBS[spelled].high),
        )
    ),
    min_size=1,
    max_size=4,
)
objects = st.dictionaries(st.text(letters, max_size=6), nested, max_size=3)
operations = plans(
    st.just("send_action_goal"),
    st.fixed_dictionaries({"action": st.text(letters), "action_type": names, "args": objects}),
) | plans(st.just("publish"), st.fixed_dictionaries({"topic": st.text(letters), "msg": objects}))

SAYABLE: dict[str, Any] = {
    "openai": free,
    "anthropic": free,
    "responses": free,
    "gemini": free,
    "bedrock": free,
    "ollama": free,
    "langchain": free,
    "mcp": free,
    "llama": free,
    "pythonic": code,
    "json": free,
    "calls": plans(names, st.dictionaries(names, st.booleans() | numbers | unquoted, max_size=3)),
    "python": code,
    "badrobot": code,
    "badrobot in JSON": code,
    "spine": plans(names, positional(words | numbers)),
    "spine, the bare list": plans(names, positional(words | numbers)),
    "spine, tuples": rows,
    "spine, rows": rows,
    "go2": flat,
    "dolphins": plans(st.sampled_from(sorted(DRIVE_VERBS)), st.just({})),
    "ros2": operations,
}


def same(found: tuple[Call, ...], written: Any) -> bool:
    """Return whether calls are the written ones, with `1`, `1.0` and `True` three things."""
    return repr([(c.tool, c.arguments) for c in found]) == repr([(t, a) for t, a in written])


# -- the laws --------------------------------------------------------------------------------------


@pytest.mark.parametrize("way", SAYABLE)
def test_every_plan_that_a_dialect_can_say_is_read_back(way: str) -> None:
    dialect, write, _ = WAYS[way]

    @LAW
    @given(SAYABLE[way])
    def law(written: Any) -> None:
        assert same(read_plan(write(*written), dialect), written)

    law()


@pytest.mark.parametrize("way", SAYABLE)
def test_what_auto_reads_is_what_the_dialect_it_names_reads(way: str) -> None:
    _, write, _ = WAYS[way]

    @LAW
    @given(SAYABLE[way])
    def law(written: Any) -> None:
        text = write(*written)
        reading = read_reply(text, Dialect.AUTO)
        assert reading.dialect is not Dialect.AUTO
        assert read_plan(text, reading.dialect) == reading.calls
        assert same(reading.calls, written)

    law()


@pytest.mark.parametrize("way", ["steps", "steps, numbered", "steps in JSON"])
def test_every_list_of_steps_is_read_back_in_canonical_verbs(way: str) -> None:
    dialect, write, _ = WAYS[way]

    @LAW
    @given(steps)
    def law(written: Any) -> None:
        named = [(verb, {str(n): w for n, w in enumerate(ws, 1)}) for verb, ws in written]
        meant = [(STEP_VERBS[verb].tool, arguments) for verb, arguments in named]
        assert same(read_plan(write(*named), dialect), meant)
        assert same(read_plan(write(*named), Dialect.AUTO), meant)

    law()


def refusal_or_calls(text: str, dialect: Dialect) -> tuple[Call, ...] | None:
    """Return the calls, or None after making sure that what came out is a refusal with a place."""
    try:
        calls = read_plan(text, dialect)
    except MalformedError as error:
        refusal = error
    else:
        require_plain(calls)
        return calls
    assert refusal.where
    assert refusal.message
    return None


def require_plain(calls: tuple[Call, ...]) -> None:
    """Hold calls to what a reader may let out."""
    assert calls
    for call in calls:
        assert isinstance(call.tool, str)
        assert call.where
        plain_data(call.arguments)


def plain_data(value: Any) -> None:
    """Hold a value to what leaves a reader: text that UTF-8 can say, exact numbers, no floats."""
    if isinstance(value, str):
        value.encode("utf-8")
    elif isinstance(value, dict):
        for name, item in value.items():
            name.encode("utf-8")
            plain_data(item)
    elif isinstance(value, list):
        for item in value:
            plain_data(item)
    else:
        assert value is None or type(value) in {bool, int, Decimal}


def as_text(data: bytes) -> str | None:
    try:
        return read_text(data)
    except MalformedError as error:
        refusal = error
    assert refusal.where
    return None


tokens = st.sampled_from(
    [
        *"()[]{},:=.'\"#\\-+*@; \n\t\r\x00",
        "go",
        "go(",
        "find Mug",
        "1. ",
        "True",
        "None",
        "lambda:",
        "plan",
        "tool",
        "function",
        "op",
        "choices",
        "jsonrpc",
        "stop_reason",
        "\\u",
        "\\x41",
        "0x",
        "'''",
        'f"',
        "1e",
        "-1",
        "0.5",
        "import os",
        "\u00a0",
        "\uff47\uff4f(",
        "\u202e",
        "if ",
    ]
)


@LAW
@given(st.lists(tokens, max_size=25).map("".join) | st.text(max_size=60))
def test_no_text_makes_a_reader_raise_anything_but_a_refusal_with_a_place(text: str) -> None:
    for dialect in Dialect:
        refusal_or_calls(text, dialect)


@LAW
@given(st.binary(max_size=80))
def test_no_bytes_make_a_reader_raise_anything_but_a_refusal_with_a_place(data: bytes) -> None:
    text = as_text(data)
    if text is None:
        return
    for dialect in Dialect:
        refusal_or_calls(text, dialect)


@pytest.mark.parametrize("way", WAYS)
def test_no_change_of_a_good_plan_raises_anything_but_a_refusal_with_a_place(way: str) -> None:
    dialect, write, calls = WAYS[way]
    good = write(*calls)

    @LAW
    @given(st.integers(0, len(good)), st.integers(0, 9), st.lists(tokens, max_size=3).map("".join))
    def law(at: int, cut: int, new: str) -> None:
        text = good[:at] + new + good[at + cut :]
        refusal_or_calls(text, dialect)
        refusal_or_calls(text, Dialect.AUTO)

    law()


@pytest.mark.parametrize("way", WAYS)
def test_a_plan_cut_short_is_refused_or_ends_after_a_whole_call(way: str) -> None:
    """The attack: cut a reply so that half an argument means another place.

    What ends with its last call (call text, steps, some templates) cannot tell; the rest is refused
    at every cut.
    """
    dialect, write, calls = WAYS[way]
    good = write(*calls)
    for end in range(len(good)):
        found = refusal_or_calls(good[:end], dialect)
        if found is not None:
            assert dialect in {
                Dialect.CALLS,
                Dialect.PYTHON,
                Dialect.GO2,
                Dialect.STEPS,
                Dialect.DOLPHINS,
                *(Dialect.HERMES, Dialect.MISTRAL, Dialect.LLAMA),
            }


@LAW
@given(
    st.lists(tokens, max_size=12).map(lambda parts: "go(" + "".join(parts))
    | plans(names, st.dictionaries(names, st.booleans() | numbers | unquoted)).map(
        lambda calls: WAYS["calls"][1](*calls)
    )
)
def test_call_text_and_python_never_read_two_different_plans(text: str) -> None:
    """Why `auto` need not ask the second once the first fits."""
    first, second = (refusal_or_calls(text, d) for d in (Dialect.CALLS, Dialect.PYTHON))
    if first is not None and second is not None:
        assert same(first, [(call.tool, call.arguments) for call in second])
    go2 = refusal_or_calls(text, Dialect.GO2)
    if go2 is not None:
        assert go2 == second


@LAW
@given(st.sampled_from(sorted(WAYS)), st.sampled_from(sorted(WAYS)), st.integers(0, 3))
def test_auto_never_reads_what_the_dialect_that_it_names_would_not(
    one: str, two: str, gap: int
) -> None:
    """Two plans in one text are none: the seam is refused, or both halves are one dialect's."""
    text = WAYS[one][1](*WAYS[one][2]) + "\n" * gap + WAYS[two][1](*WAYS[two][2])
    found = refusal_or_calls(text, Dialect.AUTO)
    if found is not None:
        named = read_reply(text, Dialect.AUTO).dialect
        assert read_plan(text, named) == found
