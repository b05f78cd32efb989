# SPDX-License-Identifier: Apache-2.0
"""SPINE plans: bare words, tuples, rows; no quotation marks, no prose, no stray comma."""

from __future__ import annotations

import json
from decimal import Decimal
from typing import Any

import pytest

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.dialects import Call, Dialect, read_plan
from fixtures.cases import case

BOTH = pytest.mark.parametrize("dialect", [Dialect.SPINE, Dialect.AUTO])


def plan(value: Any, **beside: Any) -> str:
    return json.dumps({**beside, "plan": value})


def refused(
    text: str, where: str, reason: Reason = Reason.MALFORMED, dialect: Dialect = Dialect.SPINE
) -> None:
    with pytest.raises(MalformedError) as caught:
        read_plan(text, dialect)
    assert (caught.value.reason, caught.value.where) == (reason, where)


@BOTH
@pytest.mark.parametrize(
    ("written", "values"),
    [
        ("replan()", []),
        ("replan( )", []),
        ("goto(dock_1)", ["dock_1"]),
        ("goto( dock_1 )", ["dock_1"]),
        ("inspect(desk_1, is anybody there?)", ["desk_1", "is anybody there?"]),
        ("answer(It's the nurse's cup; 2 of 3: done!)", ["It's the nurse's cup; 2 of 3: done!"]),
        ("explore(room_1, 5)", ["room_1", 5]),
        ("extend(-12.50, 1e2)", [Decimal("-12.50"), Decimal("1e2")]),
        ("goto(007)", ["007"]),
        ("goto(1_0)", ["1_0"]),
        ("goto(5 m)", ["5 m"]),
        ("goto(true)", ["true"]),
        ("goto(caf\u00e9)", ["caf\u00e9"]),
        ("goto(a  b)", ["a  b"]),
    ],
)
def test_a_bare_word_is_text_and_a_number_is_a_number(
    dialect: Dialect, written: str, values: list[Any]
) -> None:
    for text in (f"[{written}]", plan(f"[{written}]"), plan(f" [ {written} ] ")):
        (call,) = read_plan(text, dialect)
        assert repr(list(call.arguments.values())) == repr(values)
        assert list(call.arguments) == [str(n) for n in range(1, len(values) + 1)]


@BOTH
def test_a_question_with_a_comma_is_one_argument_more_and_never_glued_together(
    dialect: Dialect,
) -> None:
    (call,) = read_plan("[inspect(desk, is it red, or blue?)]", dialect)
    assert call.arguments == {"1": "desk", "2": "is it red", "3": "or blue?"}


@BOTH
@pytest.mark.parametrize(
    "rows",
    [
        "[('goto', 'dock'), ('look', 'desk', 1.50)]",
        '[("goto", "dock"), ["look", "desk", 1.50],]',
        '[["goto", "dock"], ["look", "desk", 1.50]]',
        "[\n  ('goto', 'dock'),\n  ('look', 'desk', 1.50)\n]",
    ],
)
def test_tuples_are_calls(dialect: Dialect, rows: str) -> None:
    for where, text in (("input", rows), ("plan", plan(rows))):
        assert read_plan(text, dialect) == (
            Call("goto", {"1": "dock"}, f"{where}[0]"),
            Call("look", {"1": "desk", "2": Decimal("1.50")}, f"{where}[1]"),
        )
    assert read_plan("[('replan',)]", dialect)[0].arguments == {}


@BOTH
def test_the_places_are_offsets_in_the_plan(dialect: Dialect) -> None:
    found = read_plan(plan("[goto(a),  look(b)]", reasoning="because"), dialect)
    assert [call.where for call in found] == ["plan[1]", "plan[11]"]


def test_what_is_said_beside_the_plan_is_prose_and_only_text_is_prose() -> None:
    prose = {"primary_goal": "[stop()]", "relevant_graph": "a, b", "reasoning": '{"plan": ""}'}
    assert read_plan(plan("[goto(a)]", **prose), Dialect.AUTO)[0].tool == "goto"
    for beside in (None, 1, True, [], {}, ["stop()"]):
        refused(plan("[goto(a)]", reasoning=beside), "input.reasoning")
    refused(plan("[goto(a)]", café=1), r"input.caf\xe9")


def test_a_list_that_is_broken_is_refused_where_it_breaks() -> None:
    for written, at in [
        ("", 0),
        ("goto(a)", 0),
        ("Plan: [goto(a)]", 0),
        ("[goto(a)", 8),
        ("[goto(a),]", 9),
        ("[goto(a),, goto(b)]", 9),
        ("[goto(a) goto(b)]", 9),
        ("[goto(a)] and stop", 10),
        ("[goto(a)][goto(b)]", 9),
        ("[,]", 1),
        ("[goto]", 1),
        ("[goto (a)]", 1),
        ("[goto[a]]", 1),
        ("[a.goto(b)]", 1),
        ("[2go(a)]", 1),
        ("[g\u00f6(a)]", 1),
        ("['goto(a)']", 1),
        ("[goto(]", 6),
        ("[goto(,)]", 6),
        ("[goto(a,)]", 8),
        ("[goto(a,,b)]", 8),
        ("[goto(", 6),
        ("[goto(a", 7),
        ("[goto('a')]", 6),
        ('[goto("a")]', 6),
        ("[goto(`a`)]", 6),
        ('[goto(a "b")]', 8),
        ("[goto(a(b))]", 7),
        ("[goto([a])]", 6),
        ("[goto({a})]", 6),
        ("[goto(a]", 7),
        ("[goto(a\x00b)]", 7),
        ("[goto(1e41)]", 6),
        ("[goto(1" + "0" * 40 + ")]", 6),
        ("[goto(a); goto(b)]", 8),
        ("[# go\ngoto(a)]", 1),
    ]:
        with case(written, at):
            refused(plan(written), f"plan[{at}]")
            if not written.lstrip().startswith("{"):
                refused(written, f"input[{at}]")


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("{}", "plan"),
        ('{"reasoning": "none"}', "plan"),
        (plan(None), "plan"),
        (plan({"goto": "a"}), "plan"),
        (plan(["goto(a)"]), "plan[0]"),
        (plan([{"tool": "goto", "arguments": {}}]), "plan[0]"),
        (plan([[]]), "plan[0][0]"),
        (plan([[1, "a"]]), "plan[0][0]"),
        (plan([["goto", "a"], ["look"], None]), "plan[2]"),
        (plan("[('goto', a)]"), "plan.line[1]"),
        (plan("[('goto', 'a'),\n 1 + 1]"), "plan.line[2]"),
        (plan("[('goto', 'a')] done"), "plan.line[1]"),
        (plan("[('goto')]"), "plan[0]"),
        (plan("[(1, 'a')]"), "plan[0][0]"),
        (plan("[(goto(a))]"), "plan.line[1]"),
        ("[(goto, a)]", "input.line[1]"),
        ('{"plan": "[goto(a)]",}', None),
        ('{"plan": "[goto(a)]"} ok', "input[22]"),
        ("{'plan': '[goto(a)]'}", "input[1]"),
    ],
)
def test_a_reply_that_is_no_plan_is_refused_in_its_place(text: str, where: str | None) -> None:
    if where is None:  # a trailing comma: readers of different years disagree where
        with pytest.raises(MalformedError, match="input"):
            read_plan(text, Dialect.SPINE)
        return
    refused(text, where)


@pytest.mark.parametrize("text", ["[]", "[ ]", plan("[]"), plan(" [ ] "), plan([])])
def test_an_empty_list_is_an_empty_plan(text: str) -> None:
    refused(text, "input", Reason.PLAN_EMPTY)
