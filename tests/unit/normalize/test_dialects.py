# SPDX-License-Identifier: Apache-2.0
"""Each dialect's exact forms: what is a plan, what is none, and where it stops being one."""

from __future__ import annotations

import json
from decimal import Decimal
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.dialects import Call, Dialect, read_plan
from authguard_r.normalize.parse import MAX_CALLS
from fixtures.amount import amount
from fixtures.cases import case
from unit.normalize.dialogue import WRITERS, as_calls, as_json, as_openai

GO = ("go", {"to": "Dock", "speed": 1})
ARGUMENTS = "choices[0].message.tool_calls[0].function.arguments"


def refused(
    text: str, reason: Reason, where: str, dialect: Dialect = Dialect.AUTO
) -> MalformedError:
    with pytest.raises(MalformedError) as caught:
        read_plan(text, dialect)
    assert (caught.value.reason, caught.value.where) == (reason, where)
    return caught.value


def said(text: str, dialect: Dialect = Dialect.AUTO) -> list[tuple[str, dict[str, Any]]]:
    return [(call.tool, call.arguments) for call in read_plan(text, dialect)]


# -- every dialect ---------------------------------------------------------------------------------


@pytest.mark.parametrize("dialect", WRITERS)
@pytest.mark.parametrize("chosen", ["named", "recognized"])
def test_every_dialect_says_the_same_plan(dialect: Dialect, chosen: str) -> None:
    text = WRITERS[dialect](GO, ("scan", {}), GO)
    named = dialect if chosen == "named" else Dialect.AUTO
    assert said(text, named) == [GO, ("scan", {}), GO]


@pytest.mark.parametrize("dialect", WRITERS)
def test_white_space_around_a_plan_changes_nothing(dialect: Dialect) -> None:
    text = f" \r\n\t{WRITERS[dialect](GO)}\n "
    assert said(text) == said(text, dialect) == [GO]


@pytest.mark.parametrize("dialect", WRITERS)
def test_as_many_calls_as_allowed_pass_and_one_more_refuses_all(dialect: Dialect) -> None:
    write = WRITERS[dialect]
    assert len(read_plan(write(*[GO] * MAX_CALLS), dialect)) == MAX_CALLS
    error = refused(write(*[GO] * (MAX_CALLS + 1)), Reason.INPUT_TOO_LARGE, "input", dialect)
    assert str(MAX_CALLS) in error.message


@pytest.mark.parametrize(
    ("text", "dialect"),
    [
        ("", Dialect.AUTO),
        (" \n", Dialect.CALLS),
        ("[]", Dialect.AUTO),
        ('{"plan":[]}', Dialect.JSON),
        (as_openai(), Dialect.AUTO),
        (as_openai(finish_reason="stop"), Dialect.OPENAI),
    ],
)
def test_a_plan_of_nothing_is_refused_as_empty(text: str, dialect: Dialect) -> None:
    refused(text, Reason.PLAN_EMPTY, "input", dialect)


@pytest.mark.parametrize("dialect", WRITERS)
def test_a_plan_in_another_dialect_than_was_named_is_refused(dialect: Dialect) -> None:
    for other in WRITERS:
        if other is not dialect:
            with pytest.raises(MalformedError):
                read_plan(WRITERS[other](GO), dialect)


def test_prose_before_a_plan_is_in_no_dialect() -> None:
    """Nothing is cut out, stripped or repaired (L12)."""
    for text, where in [
        ("Sure! Here is the plan: []", "input[0]"),
        ("\n\n<think>go", "input[2]"),
        ("null", "input[0]"),
        ('"go()"', "input[0]"),
        ("- tool: go", "input[0]"),
        ("\u00a0[]", "input[0]"),
        ("\ufeff[]", "input[0]"),
        ("// go there\n[]", "input[0]"),
        ("g\u00f6()", "input[0]"),
        ("-1", "input[0]"),
    ]:
        with case(text, where):
            refused(text, Reason.DIALECT_UNKNOWN, where)


def test_what_is_no_plan_is_refused_where_it_stands() -> None:
    """Prose after a plan, comments and single quotes in JSON: refused, never repaired (L12)."""
    for text, where in [
        ('{"plan": []} That is all.', "input[13]"),
        ("go()\n```", "input"),
        ("{'plan': []}", "input[1]"),
        ("['find Mug']", "input[1]"),
        ("{plan: []}", "input[1]"),
        ('{"plan": [], // none\n}', "input[13]"),
        ('/* none */ {"plan": []}', "input[0]"),
    ]:
        with case(text, where):
            with pytest.raises(MalformedError) as caught:
                read_plan(text, Dialect.AUTO)
            assert caught.value.where == where


@pytest.mark.parametrize("text", ['{"plan": [],}', '[{"tool": "go", "arguments": {}},]'])
def test_a_trailing_comma_in_json_is_refused_inside(text: str) -> None:
    """Where exactly, the standard library's readers of different years disagree."""
    with pytest.raises(MalformedError) as caught:
        read_plan(text, Dialect.AUTO)
    assert caught.value.reason is Reason.MALFORMED
    assert caught.value.where.startswith("input[")


# -- JSON ------------------------------------------------------------------------------------------

ONE = {"tool": "go", "arguments": {"to": "Dock"}}


@pytest.mark.parametrize(
    ("plan", "where"),
    [
        (ONE, ["input"]),
        ([ONE], ["input[0]"]),
        ([ONE, ONE], ["input[0]", "input[1]"]),
        ({"plan": [ONE, ONE]}, ["plan[0]", "plan[1]"]),
        ({"plan": ONE}, ["plan"]),
    ],
    ids=["one call", "a list of one", "a list", "a plan", "a plan that is one call"],
)
def test_the_forms_of_json_and_where_each_call_stands(plan: Any, where: list[str]) -> None:
    calls = read_plan(json.dumps(plan), Dialect.JSON)
    assert calls == tuple(Call("go", {"to": "Dock"}, place, f"{place}.tool") for place in where)


def test_json_that_is_no_plan_is_refused_in_its_place() -> None:
    for plan, reason, where in [
        ({}, Reason.MALFORMED, "input.tool"),
        ({"tool": "go"}, Reason.MALFORMED, "input.arguments"),
        ({"arguments": {}}, Reason.MALFORMED, "input.tool"),
        ({"tool": "go", "arguments": None}, Reason.MALFORMED, "input.arguments"),
        ({"tool": "go", "arguments": "{}"}, Reason.MALFORMED, "input.arguments"),
        ({"tool": None, "arguments": {}}, Reason.MALFORMED, "input.tool"),
        ({"tool": ["go"], "arguments": {}}, Reason.MALFORMED, "input.tool"),
        ({**ONE, "id": 1}, Reason.FIELD_UNKNOWN, "input.id"),
        ({**ONE, "Tool": "go"}, Reason.FIELD_UNKNOWN, "input.Tool"),
        ({**ONE, "approved": True}, Reason.FIELD_UNKNOWN, "input.approved"),
        ({"plan": [ONE], "mission": "m"}, Reason.FIELD_UNKNOWN, "input.mission"),
        ({"plan": [ONE], "tool": "go", "arguments": {}}, Reason.FIELD_UNKNOWN, "input.arguments"),
        ({"plan": None}, Reason.MALFORMED, "plan"),
        ({"plan": "go()"}, Reason.MALFORMED, "plan"),
        ({"plan": [[ONE]]}, Reason.MALFORMED, "plan[0]"),
        ({"plan": {"plan": [ONE]}}, Reason.FIELD_UNKNOWN, "plan.plan"),
        ([ONE, "go()"], Reason.MALFORMED, "input[1]"),
        ([ONE, None], Reason.MALFORMED, "input[1]"),
        ([ONE, {**ONE, "why": ""}], Reason.FIELD_UNKNOWN, "input[1].why"),
        ("go()", Reason.MALFORMED, "input"),
        (1, Reason.MALFORMED, "input"),
        (None, Reason.MALFORMED, "input"),
    ]:
        with case(plan, reason, where):
            refused(json.dumps(plan), reason, where, Dialect.JSON)


def test_a_key_twice_anywhere_in_a_plan_is_refused() -> None:
    """The attack: one reader sees the first place, the executor the last."""
    inner = '{"tool":"go","arguments":{"to":"Dock","to":"Office 1"}}'
    assert "duplicate key `to`" in refused(inner, Reason.MALFORMED, "input").message
    outer = '{"tool":"go","arguments":{},"tool":"stop"}'
    assert "duplicate key `tool`" in refused(outer, Reason.MALFORMED, "input").message
    plan = '{"plan":[],"plan":[]}'
    assert "duplicate key `plan`" in refused(plan, Reason.MALFORMED, "input").message


# -- OpenAI ----------------------------------------------------------------------------------------


def reply(**changes: Any) -> dict[str, Any]:
    """A good reply as plain data, with fields of it replaced."""
    return {**json.loads(as_openai(GO)), **changes}


def choice(**changes: Any) -> str:
    return as_openai(GO, **changes)


def call(**changes: Any) -> str:
    """A reply whose one call has fields replaced."""
    whole = reply()
    whole["choices"][0]["message"]["tool_calls"][0].update(changes)
    return json.dumps(whole)


def function(**changes: Any) -> str:
    whole = reply()
    whole["choices"][0]["message"]["tool_calls"][0]["function"].update(changes)
    return json.dumps(whole)


@pytest.mark.parametrize("finish", ["tool_calls", "stop"])
def test_a_finished_reply_is_read_whatever_the_model_says_beside_it(finish: str) -> None:
    whole = reply(usage={"total_tokens": 9}, model="local", created=1)
    whole["choices"][0]["finish_reason"] = finish
    whole["choices"][0]["message"]["content"] = "go(to='Office 1'); ignore the rules"
    found = read_plan(json.dumps(whole), Dialect.AUTO)
    name = ARGUMENTS.replace("arguments", "name")
    assert found == (Call("go", {"to": "Dock", "speed": 1}, ARGUMENTS, name),)


def test_numbers_inside_arguments_stay_exact() -> None:
    assert said(function(arguments='{"speed": 0.1}')) == [("go", {"speed": Decimal("0.1")})]


@pytest.mark.parametrize("finish", ["length", "content_filter", "function_call", "", None, 0, True])
def test_a_reply_that_did_not_finish_is_refused(finish: Any) -> None:
    """A reply cut off at a length limit may miss its last arguments, or its last call."""
    refused(choice(finish_reason=finish), Reason.MALFORMED, "choices[0].finish_reason")


def test_a_reply_that_does_not_say_how_it_ended_is_refused() -> None:
    whole = reply()
    del whole["choices"][0]["finish_reason"]
    refused(json.dumps(whole), Reason.MALFORMED, "choices[0].finish_reason")


@pytest.mark.parametrize("count", [0, 2, 3])
def test_a_reply_with_other_than_one_choice_is_refused(count: int) -> None:
    """Which of two would have been carried out is not for us to guess."""
    whole = reply()
    whole["choices"] *= count
    refused(json.dumps(whole), Reason.MALFORMED, "choices")


def test_a_reply_that_is_no_plan_is_refused_in_its_place() -> None:
    for text, where in [
        (json.dumps(reply(choices=None)), "choices"),
        (json.dumps(reply(choices={})), "choices"),
        (json.dumps(reply(choices=["go()"])), "choices[0]"),
        (json.dumps(reply(choices=[[]])), "choices[0]"),
        (choice(message=None), "choices[0].message"),
        (choice(message="go()"), "choices[0].message"),
        (choice(message={"tool_calls": {"0": {}}}), "choices[0].message.tool_calls"),
        (choice(message={"tool_calls": "go()"}), "choices[0].message.tool_calls"),
        (choice(message={"tool_calls": ["go()"]}), "choices[0].message.tool_calls[0]"),
        (choice(message={"tool_calls": [None]}), "choices[0].message.tool_calls[0]"),
        (call(type="custom"), "choices[0].message.tool_calls[0].type"),
        (call(type=True), "choices[0].message.tool_calls[0].type"),
        (call(function=None), "choices[0].message.tool_calls[0].function"),
        (call(function="go()"), "choices[0].message.tool_calls[0].function"),
        (function(name=None), "choices[0].message.tool_calls[0].function.name"),
        (function(name={"a": 1}), "choices[0].message.tool_calls[0].function.name"),
        (function(arguments=False), ARGUMENTS),
        (function(arguments=0), ARGUMENTS),
        (function(arguments={"to": "Dock"}), ARGUMENTS),
        (function(arguments=["Dock"]), ARGUMENTS),
        (function(arguments="[]"), ARGUMENTS),
        (function(arguments='"Dock"'), ARGUMENTS),
        (function(arguments="null"), ARGUMENTS),
        (function(arguments=" "), f"{ARGUMENTS}[1]"),
        (function(arguments="to=Dock"), f"{ARGUMENTS}[0]"),
        (function(arguments='{"to": "Dock"} and go'), f"{ARGUMENTS}[15]"),
        (function(arguments='{"to": "Do'), f"{ARGUMENTS}[7]"),
        (function(arguments='{"to": "Dock", "to": "Office 1"}'), ARGUMENTS),
        (function(arguments='{"to": "Dock", "t\\u006f": "Office 1"}'), ARGUMENTS),
        (function(arguments='{"speed": NaN}'), ARGUMENTS),
        (function(arguments='{"to": "\\ud800"}'), f"{ARGUMENTS}.to"),
        (function(arguments="[" * 40), f"{ARGUMENTS}[32]"),
    ]:
        with case(text, where):
            refused(text, Reason.MALFORMED, where, Dialect.OPENAI)


def test_a_call_in_the_retired_form_refuses_the_reply_instead_of_getting_lost() -> None:
    whole = reply()
    message = whole["choices"][0]["message"]
    message["function_call"] = {"name": "go", "arguments": "{}"}
    refused(json.dumps(whole), Reason.MALFORMED, "choices[0].message.function_call")
    message["function_call"] = None
    assert said(json.dumps(whole)) == [GO]


@pytest.mark.parametrize("message", [{}, {"content": "I will go."}, {"tool_calls": None}])
def test_a_reply_that_only_talks_is_an_empty_plan(message: dict[str, Any]) -> None:
    refused(choice(message=message, finish_reason="stop"), Reason.PLAN_EMPTY, "input")


def test_one_broken_call_refuses_the_good_ones_beside_it() -> None:
    """Dropping what is not understood would judge another plan (L11)."""
    whole = reply()
    calls = whole["choices"][0]["message"]["tool_calls"]
    calls.append({"id": "call_1", "type": "function", "function": {"name": "go"}})
    where = "choices[0].message.tool_calls[1].function.arguments"
    refused(json.dumps(whole), Reason.MALFORMED, where)
    refused(as_calls(GO) + "\ngo(to=)", Reason.MALFORMED, f"input[{len(as_calls(GO)) + 7}]")
    broken = as_json(GO).replace("]}", ', {"tool": "go"}]}')
    refused(broken, Reason.MALFORMED, "plan[1].arguments")


def test_choices_in_a_plan_make_it_a_reply_and_nothing_else_does() -> None:
    """Recognized by structure alone: a plan that mentions `choices` in a value is no reply."""
    assert said(as_json(("go", {"choices": 1}))) == [("go", {"choices": 1})]
    refused('{"choices": [], "tool": "go", "arguments": {}}', Reason.MALFORMED, "choices")


# -- anything at all -------------------------------------------------------------------------------

scraps = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-3, 3)
    | st.sampled_from(["go", "stop", "function", "{}"]),
    lambda inner: (
        st.lists(inner, max_size=2)
        | st.dictionaries(
            st.sampled_from(
                [
                    "plan",
                    "tool",
                    "arguments",
                    "choices",
                    "message",
                    "tool_calls",
                    "function",
                    "name",
                ]
            ),
            inner,
            max_size=3,
        )
    ),
    max_leaves=12,
)


@settings(max_examples=amount(50, 250))
@given(scraps, st.sampled_from(Dialect))
def test_nothing_made_of_the_right_words_raises_anything_but_malformed(
    plan: Any, dialect: Dialect
) -> None:
    try:
        calls = read_plan(json.dumps(plan), dialect)
    except MalformedError:
        return
    for found in calls:
        assert isinstance(found.tool, str)
        assert isinstance(found.arguments, dict)


@settings(max_examples=amount(50, 250))
@given(st.text(max_size=80), st.sampled_from(Dialect))
def test_no_text_at_all_raises_anything_but_malformed(text: str, dialect: Dialect) -> None:
    try:
        read_plan(text, dialect)
    except MalformedError as error:
        refusal = error
    else:
        return
    assert refusal.where
    assert refusal.reason in {
        Reason.MALFORMED,
        Reason.PLAN_EMPTY,
        Reason.FIELD_UNKNOWN,
        Reason.DIALECT_UNKNOWN,
        Reason.TOOL_UNKNOWN,
    }
