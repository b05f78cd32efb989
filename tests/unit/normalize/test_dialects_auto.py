# SPDX-License-Identifier: Apache-2.0
"""Recognizing: the one dialect that fits is named, none and two that differ are refused."""

from __future__ import annotations

import json
from typing import Any

import pytest

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.dialects import Dialect, read_plan, read_reply
from authguard_r.normalize.dialects.verbs import DRIVE_VERBS, STEP_VERBS
from authguard_r.normalize.parse import MAX_CALLS
from fixtures.cases import case
from unit.normalize.writers import WAYS, as_anthropic, as_mcp, as_ros2, dumps

ONE = {"tool": "go", "arguments": {}}
OPENAI = {
    "choices": [
        {
            "finish_reason": "stop",
            "message": {
                "tool_calls": [{"type": "function", "function": {"name": "go", "arguments": "{}"}}]
            },
        }
    ]
}
ANTHROPIC = json.loads(as_anthropic(("go", {})))


def refused(text: str, reason: Reason, where: str) -> MalformedError:
    with pytest.raises(MalformedError) as caught:
        read_plan(text, Dialect.AUTO)
    assert (caught.value.reason, caught.value.where) == (reason, where)
    return caught.value


def test_every_dialect_has_a_writer() -> None:
    """Those of one call, and the declared one, are in the table of reply formats."""
    other = {Dialect.AUTO, Dialect.HARMONY, Dialect.REACT, Dialect.REPLY}
    assert {dialect for dialect, _, _ in WAYS.values()} == set(Dialect) - other


def test_what_was_written_is_read_in_the_named_dialect() -> None:
    for way in WAYS:
        with case(way):
            dialect, write, calls = WAYS[way]
            reading = read_reply(write(*calls), dialect)
            assert reading.dialect is dialect
            assert [(call.tool, call.arguments) for call in reading.calls] == list(calls)
            assert all(call.where for call in reading.calls)


def test_the_dialect_is_recognized_and_named() -> None:
    """A Go2 block is call text or Python: they read it alike, so it needs no name of its own."""
    for count in [1, 2]:
        for way in WAYS:
            with case(count, way):
                dialect, write, calls = WAYS[way]
                reading = read_reply(write(*calls[:count]), Dialect.AUTO)
                assert [(call.tool, call.arguments) for call in reading.calls] == list(
                    calls[:count]
                )
                assert reading.dialect is (Dialect.CALLS if dialect is Dialect.GO2 else dialect)


def test_white_space_around_a_plan_changes_nothing() -> None:
    for way in [way for way in WAYS if way not in {"python", "go2"}]:
        with case(way):
            dialect, write, calls = WAYS[way]
            text = f" \r\n\t{write(*calls)}\n "
            for named in (dialect, Dialect.AUTO):
                assert [(c.tool, c.arguments) for c in read_plan(text, named)] == list(calls)


def test_as_many_calls_as_allowed_pass_and_one_more_refuses_all() -> None:
    for way in WAYS:
        with case(way):
            dialect, write, calls = WAYS[way]
            assert len(read_plan(write(*[calls[0]] * MAX_CALLS), dialect)) == MAX_CALLS
            with pytest.raises(MalformedError) as caught:
                read_plan(write(*[calls[0]] * (MAX_CALLS + 1)), dialect)
            assert (caught.value.reason, caught.value.where) == (Reason.INPUT_TOO_LARGE, "input")


#: The dialects whose calls stand within tags.
TAGGED = {Dialect.HERMES, Dialect.MISTRAL, Dialect.LLAMA, Dialect.DEEPSEEK}
#: What models write around a plan, before and after.
AROUND = [
    ("Sure! ", ""),
    ("```\n", ""),
    ("```json\n", "\n```\n```"),
    ("<tool_call>", "</tool_call>"),
    ("", "\nI hope that this helps!"),
    ("", " // done"),
    ("", ";"),
    ("\ufeff", ""),
    ("'", "'"),
    ("plan = ", ""),
    ("<plan>", "</plan>"),
]


def test_what_is_wrapped_around_a_plan_is_refused_and_not_unwrapped() -> None:
    """L12: a refusal with a place is the right answer to broken output."""
    for way in WAYS:
        for named in [True, False]:
            with case(way, named):
                dialect, write, calls = WAYS[way]
                for before, after in AROUND:
                    if dialect in TAGGED and not after:
                        continue  # free text may stand before the first tag
                    text = f"{before}{write(*calls)}{after}"
                    if after == ";" and (
                        dialect is Dialect.CALLS or (dialect is Dialect.GO2 and not named)
                    ):
                        continue  # call text may be separated so
                    with case(before, after):
                        if (
                            dialect is Dialect.STEPS
                            and after in {" // done", ";"}
                            and "[" not in text
                        ):
                            last = read_plan(text, dialect)[-1]
                            assert last.arguments["2"] != calls[-1][1]["2"]  # another name
                            continue
                        with pytest.raises(MalformedError) as caught:
                            read_plan(text, dialect if named else Dialect.AUTO)
                        assert caught.value.where


# -- none fits -------------------------------------------------------------------------------------


def test_json_that_no_dialect_has_is_refused() -> None:
    for plan in [
        {},
        {"steps": []},
        {"Tool": "go", "arguments": {}},
        {"Name": "go", "arguments": {}},
        {"type": "function", "function_name": "go"},
        {"content": []},
        {"content": [{"type": "tool_use", "id": "a", "name": "go", "input": {}}]},
        [1],
        [None],
        [True, ONE],
        [{}],
        [OPENAI],
        [ANTHROPIC],
        [{"function": ["go()"], "response": ""}],
    ]:
        with case(plan):
            refused(json.dumps(plan), Reason.DIALECT_UNKNOWN, "input")


def test_text_that_begins_like_no_dialect_is_refused() -> None:
    for text, where in [
        ("go", "input[0]"),
        ("  Go to the dock.", "input[2]"),
        ("1. Find the mug", "input[0]"),
        ("0. find Mug", "input[0]"),
        ("1.find Mug", "input[0]"),
        ("Find Mug", "input[0]"),
        ("finding Mug", "input[0]"),
        ("Accelerate", "input[0]"),
        ("go (to='Dock')", "input[0]"),
        ("(go())", "input[0]"),
        ("'find Mug'", "input[0]"),
        ("@go()", "input[0]"),
        ("\u0261o()", "input[0]"),
        ("\uff47\uff4f()", "input[0]"),
    ]:
        with case(text, where):
            refused(text, Reason.DIALECT_UNKNOWN, where)


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("go(to=Dock)", "input[6]"),
        ("go(to='Dock'", "input[12]"),
        ("go(1", "input[3]"),
        ("go(to='Dock')\nimport os", "input[14]"),
    ],
)
def test_where_call_text_and_python_both_refuse_the_place_is_the_first_reader_s(
    text: str, where: str
) -> None:
    refused(text, Reason.MALFORMED, where)


@pytest.mark.parametrize(
    ("text", "dialect", "arguments"),
    [
        ("go(to='Dock')", Dialect.CALLS, {"to": "Dock"}),
        ("go(to=true)", Dialect.CALLS, {"to": True}),
        ("go('Dock')", Dialect.PYTHON, {"1": "Dock"}),
        ("go(to=['Dock'])", Dialect.PYTHON, {"to": ["Dock"]}),
        ("# go there\ngo(to='Dock')", Dialect.PYTHON, {"to": "Dock"}),
    ],
)
def test_call_text_is_asked_first_and_python_reads_what_it_cannot(
    text: str, dialect: Dialect, arguments: dict[str, Any]
) -> None:
    reading = read_reply(text, Dialect.AUTO)
    assert (reading.dialect, reading.calls[0].arguments) == (dialect, arguments)


def test_steps_and_maneuvers_share_no_word() -> None:
    """So the first word tells which of the two a list is."""
    assert not STEP_VERBS.keys() & DRIVE_VERBS.keys()
    first = {verb.split(" ")[0] for verb in STEP_VERBS if " " in verb}
    assert not first & (STEP_VERBS.keys() | DRIVE_VERBS.keys())


# -- two fit ---------------------------------------------------------------------------------------


def test_two_dialects_that_fit_and_differ_are_refused_by_name() -> None:
    """The attack: one reply that the gate reads as one plan and the executor as another."""
    other = json.loads(as_anthropic(("stop", {})))
    message = refused(json.dumps({**OPENAI, **other}), Reason.DIALECT_UNKNOWN, "input").message
    assert "`openai`" in message
    assert "`anthropic`" in message


def test_a_plan_beside_none_is_a_difference_too() -> None:
    talk = json.loads(as_anthropic(content=[], stop_reason="end_turn"))
    refused(json.dumps({**OPENAI, **talk}), Reason.DIALECT_UNKNOWN, "input")


@pytest.mark.parametrize(("one", "two"), [("1", "1.0"), ("1", "true"), ("0.5", "0.50")])
def test_values_that_python_calls_equal_are_two_values(one: str, two: str) -> None:
    first = json.loads(json.dumps(OPENAI))
    function = first["choices"][0]["message"]["tool_calls"][0]["function"]
    function["arguments"] = f'{{"a": {one}}}'
    block = f'[{{"type": "tool_use", "id": "a", "name": "go", "input": {{"a": {two}}}}}]'
    text = f'{json.dumps(first)[:-1]}, "stop_reason": "tool_use", "content": {block}}}'
    refused(text, Reason.DIALECT_UNKNOWN, "input")
    same = text.replace(f'"a": {two}}}', f'"a": {one}}}')
    assert read_reply(same, Dialect.AUTO).dialect is Dialect.OPENAI


def test_two_dialects_that_say_the_same_are_the_first() -> None:
    reading = read_reply(json.dumps({**OPENAI, **ANTHROPIC}), Dialect.AUTO)
    assert (reading.dialect, [c.tool for c in reading.calls]) == (Dialect.OPENAI, ["go"])


def test_of_two_that_claim_a_shape_the_one_that_fits_is_named() -> None:
    whole = {**ANTHROPIC, "choices": []}
    assert read_reply(json.dumps(whole), Dialect.AUTO).dialect is Dialect.ANTHROPIC
    beside = {"plan": "[goto(dock)]", "tool": "go"}
    assert read_reply(json.dumps(beside), Dialect.AUTO).dialect is Dialect.SPINE


@pytest.mark.parametrize(
    ("plan", "reason", "where"),
    [
        ({"choices": [], **ONE}, Reason.MALFORMED, "choices"),
        ({"op": "publish", "jsonrpc": "2.0"}, Reason.FIELD_UNKNOWN, "input.op"),
        ({"plan": 1, "op": "publish"}, Reason.FIELD_UNKNOWN, "input.plan"),
    ],
)
def test_where_no_claim_holds_the_first_one_s_refusal_stands(
    plan: Any, reason: Reason, where: str
) -> None:
    refused(json.dumps(plan), reason, where)


def test_shapes_that_are_close_to_each_other_are_told_apart() -> None:
    for text, dialect in [
        (as_mcp(("go", {})), Dialect.MCP),
        (as_ros2(("publish", {"topic": "/t", "msg": {}})), Dialect.ROS2),
        (dumps([ONE]), Dialect.JSON),
        (dumps({"plan": [ONE]}), Dialect.JSON),
        (dumps({"plan": "[go(a)]"}), Dialect.SPINE),
        (dumps({"plan": [["go", "a"]]}), Dialect.SPINE),
        ('[["go", "a"]]', Dialect.SPINE),
        ("[('go', 'a')]", Dialect.SPINE),
        ('["find Mug"]', Dialect.STEPS),
        ("{ 'function': ['go()']}", Dialect.BADROBOT),
    ]:
        with case(text, dialect):
            assert read_reply(text, Dialect.AUTO).dialect is dialect
