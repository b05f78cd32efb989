# SPDX-License-Identifier: Apache-2.0
"""The strict readers: exact, bounded, never evaluating, never repairing (L3, L12)."""

from __future__ import annotations

import json
from decimal import Decimal
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.parse import (
    MAX_CALLS,
    MAX_DEPTH,
    MAX_NUMBER,
    MAX_TEXT,
    read_calls,
    read_json,
    read_number,
    read_text,
)
from fixtures.amount import amount
from fixtures.cases import case

LAW = settings(max_examples=amount(40, 200))


def refused_json(text: str, where: str = "input") -> MalformedError:
    with pytest.raises(MalformedError) as caught:
        read_json(text, where="input")
    assert (caught.value.reason, caught.value.where) == (Reason.MALFORMED, where)
    return caught.value


def refused_calls(text: str, at: int) -> MalformedError:
    with pytest.raises(MalformedError) as caught:
        read_calls(text)
    assert (caught.value.reason, caught.value.where) == (Reason.MALFORMED, f"input[{at}]")
    return caught.value


def test_the_limits_are_the_ones_of_the_spec() -> None:
    """docs/spec/normalize.md, "Input"."""
    assert (MAX_TEXT, MAX_DEPTH, MAX_CALLS, MAX_NUMBER) == (262_144, 32, 256, 40)


# -- text ------------------------------------------------------------------------------------------


def test_the_longest_reply_is_read_and_one_byte_more_is_not() -> None:
    assert len(read_text(b"a" * MAX_TEXT)) == MAX_TEXT
    with pytest.raises(MalformedError) as caught:
        read_text(b"a" * (MAX_TEXT + 1))
    assert (caught.value.reason, caught.value.where) == (Reason.INPUT_TOO_LARGE, "input")


def test_length_is_counted_in_bytes_and_not_in_characters() -> None:
    with pytest.raises(MalformedError) as caught:
        read_text("\u20ac".encode() * (MAX_TEXT // 3 + 1))
    assert caught.value.reason is Reason.INPUT_TOO_LARGE


@pytest.mark.parametrize(
    ("data", "at"),
    [
        (b"\xff", 0),
        (b"ab\xc0\xaf", 2),
        (b"\xed\xa0\x80", 0),
        (b"a\xe2\x82", 1),
        (b"\xf4\x90\x80\x80", 0),
    ],
    ids=["no byte of UTF-8", "overlong", "surrogate", "cut short", "beyond Unicode"],
)
def test_bytes_that_are_no_utf_8_are_refused_where_they_stop_being_it(data: bytes, at: int) -> None:
    with pytest.raises(MalformedError) as caught:
        read_text(data)
    assert (caught.value.reason, caught.value.where) == (Reason.MALFORMED, f"input[{at}]")


# -- JSON ------------------------------------------------------------------------------------------

values = st.recursive(
    st.text(alphabet=st.characters(exclude_categories=["Cs"]), max_size=10)
    | st.integers(-(10**30), 10**30)
    | st.booleans()
    | st.none(),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.text(st.characters(exclude_categories=["Cs"])), inner, max_size=4)
    ),
    max_leaves=20,
)


@LAW
@given(values, st.booleans(), st.sampled_from([None, 0, 1]))
def test_json_is_read_as_it_was_written(value: Any, escaped: bool, indent: int | None) -> None:
    text = json.dumps(value, ensure_ascii=escaped, indent=indent)
    assert read_json(text, where="input") == value


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("0.1", Decimal("0.1")),
        (
            "0.30000000000000000000000000000000000001",
            Decimal("0.30000000000000000000000000000000000001"),
        ),
        ("-0.0", Decimal("-0.0")),
        ("1e2", Decimal(100)),
        ("1E-2", Decimal("0.01")),
        ("1.50", Decimal("1.5")),
        ("12345678901234567890123456789012345", 12345678901234567890123456789012345),
    ],
)
def test_a_number_stays_exactly_what_was_written(text: str, value: Any) -> None:
    """No float, ever: 0.1 is a tenth, and a long number keeps its last digit."""
    found = read_json(text, where="input")
    assert found == value
    assert type(found) is type(value)
    assert read_number(text) == value


@pytest.mark.parametrize(
    "text", ["NaN", "Infinity", "-Infinity", "[NaN]", '{"speed": NaN}', '{"speed": -Infinity}']
)
def test_a_number_that_is_none_is_refused(text: str) -> None:
    assert "is no number" in refused_json(text).message


def test_what_only_looks_like_json_is_refused_where_it_stops() -> None:
    for text, where in [
        ("nan", "input[0]"),
        ("inf", "input[0]"),
        ("+1", "input[0]"),
        (".5", "input[0]"),
        ("1.", "input[1]"),
        ("01", "input[1]"),
        ("0x10", "input[1]"),
        ("1_000", "input[1]"),
        ("--1", "input[0]"),
        ("\u0661", "input[0]"),
        ("\uff11", "input[0]"),
        ("True", "input[0]"),
        ("None", "input[0]"),
        ("", "input[0]"),
        ("{}{}", "input[2]"),
        ("{a:1}", "input[1]"),
        ("{'a':1}", "input[1]"),
        ('["a\nb"]', "input[3]"),
        ('["\\x41"]', "input[2]"),
        ("// no comments\n1", "input[0]"),
        ("1 # no comments", "input[2]"),
        ("```json\n1\n```", "input[0]"),
        ("Sure! 1", "input[0]"),
        ("\ufeff1", "input[0]"),
        ("\u00a01", "input[0]"),
    ]:
        with case(text, where):
            refused_json(text, where)


@pytest.mark.parametrize("text", ["[1,]", '{"a":1,}', "[,1]", "[1 2]", '{"a" 1}', '{"a":}', "["])
def test_broken_lists_and_objects_are_refused_somewhere_inside(text: str) -> None:
    """Where exactly, the standard library's readers of different years disagree."""
    with pytest.raises(MalformedError) as caught:
        read_json(text, where="input")
    assert caught.value.reason is Reason.MALFORMED
    assert caught.value.where.startswith("input[")


def test_a_number_beyond_any_quantity_is_refused() -> None:
    for text in [
        "1" * (MAX_NUMBER + 1),
        "-" + "1" * MAX_NUMBER,
        "0." + "1" * (MAX_NUMBER - 1),
        "1e41",
        "1e-41",
        "-1e999999999999",
        "0e999",
        "[" + "9" * 5000 + "]",
    ]:
        with case(text):
            refused_json(text)


@pytest.mark.parametrize("text", ["1" * MAX_NUMBER, "0." + "1" * (MAX_NUMBER - 2), "1e40", "1e-40"])
def test_the_longest_and_the_largest_number_pass(text: str) -> None:
    assert read_json(text, where="input") == Decimal(text)


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ('{"a":1,"a":2}', "a"),
        ('{"a":1,"a":1}', "a"),
        ('{"a":1,"\\u0061":2}', "a"),
        ('[{"b":{"x":0,"y":0,"x":0}}]', "x"),
        ('{"":1,"":1}', ""),
        ('{"b":1,"a":2,"c":3,"a":4,"d":5}', "a"),
    ],
)
def test_a_key_twice_is_refused_however_it_is_spelled(text: str, key: str) -> None:
    assert refused_json(text).message == f"duplicate key `{key}`"


def test_keys_that_only_look_alike_are_two_keys() -> None:
    assert len(read_json('{"\\u00e9":1,"e\\u0301":2,"E":3}', where="input")) == 3


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ('"\\ud800"', "input"),
        ('"\\udc00\\ud800"', "input"),
        ('["a","\\ud83e"]', "input[1]"),
        ('{"a":{"b":["\\udfff"]}}', "input.a.b[0]"),
        ('{"\\ud800":1}', "input"),
        ('{"a":{"\\ud800":1}}', "input.a"),
    ],
)
def test_half_a_character_is_refused_in_its_place(text: str, where: str) -> None:
    refused_json(text, where)


def test_a_whole_character_in_two_halves_passes() -> None:
    assert read_json('"\\ud83e\\udd16"', where="input") == "\U0001f916"


@pytest.mark.parametrize(
    ("opening", "closing"), [("[", "]"), ('{"a":', "}")], ids=["lists", "objects"]
)
def test_nesting_is_read_to_its_limit_and_refused_beyond(opening: str, closing: str) -> None:
    read_json(opening * MAX_DEPTH + "1" + closing * MAX_DEPTH, where="input")
    deep = opening * (MAX_DEPTH + 1) + "1" + closing * (MAX_DEPTH + 1)
    at = len(opening) * MAX_DEPTH
    assert "levels" in refused_json(deep, f"input[{at}]").message
    refused_json(opening * 10_000, f"input[{at}]")


def test_brackets_in_a_string_are_text() -> None:
    text = json.dumps(['[{"' * 100, "\\", '\\"[', ']}"' * 100])
    assert len(read_json(text, where="input")) == 4


def test_brackets_side_by_side_are_not_deep() -> None:
    assert len(read_json("[" + "[]," * 500 + "[]]", where="input")) == 501


@LAW
@given(
    st.text(max_size=60) | st.text(alphabet='{}[]",:0123456789.eE+-truefalsn\\u \n', max_size=60)
)
def test_no_text_at_all_raises_anything_but_malformed_from_json(text: str) -> None:
    try:
        found = read_json(text, where="input")
    except MalformedError:
        return
    assert found == json.loads(text, parse_float=Decimal)


# -- calls -----------------------------------------------------------------------------------------


def test_calls_are_read_as_they_were_written() -> None:
    for text, calls in [
        ("", []),
        (" \t\r\n", []),
        ("go()", [("go", {}, "input[0]")]),
        ("go( )", [("go", {}, "input[0]")]),
        ("  go()  ", [("go", {}, "input[2]")]),
        ("_go_2(_a='x')", [("_go_2", {"_a": "x"}, "input[0]")]),
        ("Go(A='x')", [("Go", {"A": "x"}, "input[0]")]),
        (
            'go(to="Station 101", speed=0.8)',
            [("go", {"to": "Station 101", "speed": Decimal("0.8")}, "input[0]")],
        ),
        ("go(a=1,b=-2)", [("go", {"a": 1, "b": -2}, "input[0]")]),
        ("go( a=1\n,\tb=2 )", [("go", {"a": 1, "b": 2}, "input[0]")]),
        ("go(a=true, b=False)", [("go", {"a": True, "b": False}, "input[0]")]),
        ("go(a='it is \"so\"')", [("go", {"a": 'it is "so"'}, "input[0]")]),
        ('go(a="it\'s so")', [("go", {"a": "it's so"}, "input[0]")]),
        ("go(a='')", [("go", {"a": ""}, "input[0]")]),
        ("go(a='b(c=1)')", [("go", {"a": "b(c=1)"}, "input[0]")]),
        ("go(a='\u00e9\U0001f916')", [("go", {"a": "\u00e9\U0001f916"}, "input[0]")]),
        ("a();b()", [("a", {}, "input[0]"), ("b", {}, "input[4]")]),
        ("a(), b()", [("a", {}, "input[0]"), ("b", {}, "input[5]")]),
        ("a()\nb()", [("a", {}, "input[0]"), ("b", {}, "input[4]")]),
        ("a()b()", [("a", {}, "input[0]"), ("b", {}, "input[3]")]),
        ("a();", [("a", {}, "input[0]")]),
    ]:
        with case(text, calls):
            assert read_calls(text) == calls


def test_what_only_looks_like_a_call_is_refused_where_it_stops() -> None:
    for text, at in [
        ("go", 0),
        ("go to(a=1)", 0),
        ("go (a=1)", 0),
        ("2go()", 0),
        ("g\u00f6()", 0),
        ("\u0261o()", 0),
        ("arm.go()", 0),
        ("go[0]()", 0),
        ("x = go()", 0),
        ("(go())", 0),
        ("`go()`", 0),
        ("# go()", 0),
        ("// go()", 0),
        ("- go()", 0),
        ("1. go()", 0),
        ("I will go()", 0),
        ("go() then stop()", 5),
        ("go();;go()", 5),
        (";go()", 0),
        ("go().wait()", 4),
        ("go()(1)", 4),
        ("go(", 3),
        ("go(a", 3),
        ("go(1)", 3),
        ("go('x')", 3),
        ("go(*a)", 3),
        ("go(**a)", 3),
        ("go(a)", 3),
        ("go(a:1)", 3),
        ("go(a =1)", 3),
        ("go(a= 1)", 5),
        ("go(a=)", 5),
        ("go(a=1,)", 7),
        ("go(a=1", 6),
        ("go(a=1 b=2)", 7),
        ("go(a=1;b=2)", 6),
        ("go(a=1,a=1)", 7),
        ("go(a=1, b=2, a=3)", 13),
        ("go(a='x)", 5),
        ("go(a='x\\'y')", 5),
        ("go(a='x\ny')", 5),
        ('go(a="x\\u0041")', 5),
        ("go(a='x\")", 5),
        ("go(a='x' 'y')", 9),
        ("go(a='x'+'y')", 8),
        ("go(a=f'x')", 5),
        ("go(a=b'x')", 5),
        ("go(a=\u2018x\u2019)", 5),
        ("go(a=x)", 5),
        ("go(a=NULL)", 5),
        ("go(a=none)", 5),
        ("go(a=TRUE)", 5),
        ("go(a=nan)", 5),
        ("go(a=inf)", 5),
        ("go(a=+1)", 5),
        ("go(a=.5)", 5),
        ("go(a=1.)", 6),
        ("go(a=01)", 6),
        ("go(a=0x10)", 6),
        ("go(a=1_0)", 6),
        ("go(a=1j)", 6),
        ("go(a=1e)", 6),
        ("go(a=1e1000)", 5),
        ("go(a=\u0661)", 5),
        ("go(a=1+1)", 6),
        ("go(a=-x)", 5),
        ("go(a=[1])", 5),
        ("go(a={})", 5),
        ("go(a=(1))", 5),
        ("go(a=go())", 5),
        ("go(a=lambda: 1)", 5),
        ("go(a=1" + "0" * MAX_NUMBER + ")", 5),
        ("go(a=1e41)", 5),
        ("go(a=trueish)", 5),
    ]:
        with case(text, at):
            refused_calls(text, at)


@LAW
@given(
    st.lists(
        st.dictionaries(
            st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,5}", fullmatch=True),
            st.booleans()
            | st.integers(-(10**20), 10**20)
            | st.decimals(-100, 100, places=3)
            | st.text(st.characters(exclude_characters='"\\\n', exclude_categories=["Cs"])),
            max_size=4,
        ),
        max_size=4,
    )
)
def test_every_plan_that_calls_can_say_is_read_back(arguments: list[dict[str, Any]]) -> None:
    def spelled(value: Any) -> str:
        return f'"{value}"' if isinstance(value, str) else str(value)

    text = "\n".join(
        f"go({', '.join(f'{name}={spelled(value)}' for name, value in one.items())})"
        for one in arguments
    )
    assert [found for _, found, _ in read_calls(text)] == arguments


@LAW
@given(st.text(max_size=60) | st.text(alphabet="go(a='\"1.e-,;)true \n", max_size=60))
def test_no_text_at_all_raises_anything_but_malformed_from_calls(text: str) -> None:
    try:
        found = read_calls(text)
    except MalformedError:
        return
    for name, arguments, _ in found:
        assert name.isascii()
        for value in arguments.values():
            assert isinstance(value, str | bool | int | Decimal)


def test_read_number_says_that_a_number_is_none() -> None:
    for text in ["", "x", "1x", "--", "1e", "nan", "-Infinity", "1" * 41]:
        with case(text), pytest.raises(ValueError):
            read_number(text)
