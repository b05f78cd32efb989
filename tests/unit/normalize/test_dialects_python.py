# SPDX-License-Identifier: Apache-2.0
"""Plan code: literals and calls of names are read as Python reads them, all else has its line."""

from __future__ import annotations

import ast
import json
import warnings
from decimal import Decimal
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.dialects import Call, Dialect, read_plan
from authguard_r.normalize.dialects.python_code import MAX_CODE, read_literal
from authguard_r.normalize.parse import MAX_DEPTH, MAX_NUMBER
from fixtures.amount import amount
from fixtures.cases import case
from unit.normalize.writers import as_badrobot


def refused(
    text: str,
    where: str,
    dialect: Dialect = Dialect.PYTHON,
    reason: Reason = Reason.MALFORMED,
) -> MalformedError:
    with pytest.raises(MalformedError) as caught:
        read_plan(text, dialect)
    assert (caught.value.reason, caught.value.where) == (reason, where)
    return caught.value


def said(text: str, dialect: Dialect = Dialect.PYTHON) -> list[tuple[str, dict[str, Any]]]:
    return [(call.tool, call.arguments) for call in read_plan(text, dialect)]


# -- Python ----------------------------------------------------------------------------------------


def test_code_is_read_as_python_reads_it() -> None:
    for text, tool, arguments in [
        ("go()", "go", {}),
        ("go( )", "go", {}),
        ("go ()", "go", {}),
        ("robot.arm.go()", "robot.arm.go", {}),
        ("a.b.c.d.e.f.g.h()", "a.b.c.d.e.f.g.h", {}),
        ("match(case=1)", "match", {"case": 1}),
        ("go('Dock', 2, fast=True)", "go", {"1": "Dock", "2": 2, "fast": True}),
        ("go(x=-1, y=-0.50, z=2e3)", "go", {"x": -1, "y": Decimal("-0.50"), "z": Decimal("2e3")}),
        (
            "go(a=0.1000000000000000055511151231257)",
            "go",
            {"a": Decimal("0.1000000000000000055511151231257")},
        ),
        ("go(a=False)", "go", {"a": False}),
        ("go(a=[1, [2.5], ()])", "go", {"a": [1, [Decimal("2.5")], []]}),
        ("go(a=(1, 'b'))", "go", {"a": [1, "b"]}),
        ("go(a=(1))", "go", {"a": 1}),
        ("go(a=(1,))", "go", {"a": [1]}),
        (
            "go(a={'x': 1.5, 'y': {'z': [-2]}}, b=3)",
            "go",
            {"a": {"x": Decimal("1.5"), "y": {"z": [-2]}}, "b": 3},
        ),
        ("go(a={})", "go", {"a": {}}),
        ("go(\n    a=1,\n    b='x',\n)", "go", {"a": 1, "b": "x"}),
        ("go(a=1,\r\n b=2)", "go", {"a": 1, "b": 2}),
        (
            "go(a='it\\'s', b=\"\\\"\\\\\\n\\x41\\u00e9\\U0001f916\")",
            "go",
            {"a": "it's", "b": '"\\\nA\u00e9\U0001f916'},
        ),
        ("go(a='# no comment (')", "go", {"a": "# no comment ("}),
        ("go(a='')", "go", {"a": ""}),
        ("go(a='caf\u00e9', b=1.5)", "go", {"a": "caf\u00e9", "b": Decimal("1.5")}),
        ("# first\n\n  # \u201ccareful\u201d, import os\ngo()", "go", {}),
    ]:
        with case(text, tool, arguments):
            found = said(text)
            assert found == [(tool, arguments)]
            assert repr(found[0][1]) == repr(arguments)  # 1 is not 1.0 and not True


def test_each_statement_is_a_call_with_its_line() -> None:
    text = "# plan\ngo(a=1)\n\nstop()\ngo(\n  a=2\n)\r\nstop()"
    assert read_plan(text, Dialect.PYTHON) == (
        Call("go", {"a": 1}, "line[2]"),
        Call("stop", {}, "line[4]"),
        Call("go", {"a": 2}, "line[5]"),
        Call("stop", {}, "line[8]"),
    )


REFUSED = [
    "x = go()",
    "x: int = 1",
    "x += 1",
    "x",
    "x, y",
    "True",
    "'go()'",
    "'''go()'''",
    "1",
    "-1",
    "(go())",
    "[go()]",
    "{'go': 1}",
    "...",
    "pass",
    "import os",
    "from os import system",
    "if x: go()",
    "for x in y: go(x)",
    "while True: go()",
    "def f(): go()",
    "class A: go()",
    "lambda: go()",
    "with a: go()",
    "try: go()",
    "del x",
    "global x",
    "assert go()",
    "raise go()",
    "return go()",
    "yield go()",
    "await go()",
    "async def f(): go()",
    "print 'x'",
    "match x:\n  case 1: go()",
    "type X = int",
    "@go",
    "go().wait()",
    "go()()",
    "go()[0]",
    "go[0]()",
    "'x'.join()",
    "True()",
    "True.go()",
    "go.()",
    ".go()",
    "a . b()",
    "a.if()",
    "a.b.c.d.e.f.g.h.i()",
    "go(*a)",
    "go(**a)",
    "go(a)",
    "go(a=b)",
    "go(a=b.c)",
    "go(a=none)",
    "go(none)",
    "go(a=...)",
    "go(a=f())",
    "go(a=f'x')",
    "go(a=F'{x}')",
    "go(a=b'x')",
    "go(a=r'x')",
    "go(a=u'x')",
    "go(a='x' 'y')",
    "go(a='x'\n'y')",
    "go(a='''x''')",
    "go(a='x' + 'y')",
    "go(a='x' % 1)",
    "go(a=1 + 1)",
    "go(a=1 -1)",
    "go(a=1-1)",
    "go(a=-1-1)",
    "go(a=2**9)",
    "go(a=--1)",
    "go(a=- 1)",
    "go(a=+1)",
    "go(a=~1)",
    "go(a=not True)",
    "go(a=-True)",
    "go(a=True or False)",
    "go(a=1 if True else 2)",
    "go(a=1 < 2)",
    "go(a:=1)",
    "go(a=(b:=1))",
    "go(a=[b for b in c])",
    "go(a={1, 2})",
    "go(a={'b'})",
    "go(a={1: 2})",
    "go(a={('b',): 2})",
    "go(a={**b})",
    "go(a={'b': 1, 'b': 2})",
    "go(a={'b': 1, '\\x62': 2})",
    "go(a=[*b])",
    "go(a=[1][0])",
    "go(a='x'[0])",
    "go(a=0x10)",
    "go(a=0o7)",
    "go(a=0b1)",
    "go(a=1_000)",
    "go(a=1j)",
    "go(a=1.)",
    "go(a=.5)",
    "go(a=01)",
    "go(a=00)",
    "go(a=1.5.2)",
    "go(a=1e)",
    "go(a=1e41)",
    "go(a=1e999)",
    "go(a=1" + "0" * MAX_NUMBER + ")",
    "go(a=1" + "0" * 5000 + ")",
    "go(a=nan)",
    "go(a=inf)",
    "go(a=1if)",
    "go(a=\u0661)",
    "go(a=\uff11)",
    "g\u00f6()",
    "\uff47\uff4f()",
    "g\u043e()",
    "go(\uff41=1)",
    "go(a=\u2018x\u2019)",
    "go(a='x)",
    "go(a='x\ny')",
    "go(a='x\\\ny')",
    "go(a='\\d')",
    "go(a='\\0')",
    "go(a='\\101')",
    "go(a='\\N{BULLET}')",
    "go(a='\\x4')",
    "go(a='\\ud800')",
    "go(a='\\ud83e\\udd16')",
    "go(a='\\U00110000')",
    "go(a=['\\udfff'])",
    "go(a={'\\udfff': 1})",
    "go(a='\0')",
    "go(a=1, a=1)",
    "go(a=1, 2)",
    "go(1 2)",
    "go(,)",
    "go(a=1,,)",
    "go(a=)",
    "go(=1)",
    "go(1=1)",
    "go('a'=1)",
    "go(True=1)",
    "go(a=1",
    "go(a=[1)",
    "go(a=1]",
    "go)",
    ")go(",
    "go())",
    "go(); stop()",
    "go() stop()",
    "go(), stop()",
    " go()",
    "\tgo()",
    "go()\\\n",
    "go()\x0c",
    "go()\0",
    "# \0\ngo()",
    "`go()`",
    "$go()",
    "!go()",
    "go()?",
    "go(a@b)",
]


def test_everything_else_is_refused_with_its_line() -> None:
    for line in [1, 3]:
        for text in REFUSED:
            with case(line, text):
                where = refused("# x\n" * (line - 1) + text, _line(text, line)).where
                assert where.startswith("line[")
                if line == 1:
                    later = f"go()\n\n{text}"
                    with pytest.raises(MalformedError) as caught:
                        read_plan(later, Dialect.PYTHON)
                    assert caught.value.where == _line(text, 3)


def _line(text: str, first: int) -> str:
    """Return the line that is at fault: the last one of a text, but for those named here."""
    within = {
        "match x:\n  case 1: go()": 0,
        "go(a='x\ny')": 0,
        "go(a='x\\\ny')": 0,
        "go()\\\n": 0,
        "go(  # now\n)": 0,
        "# \0\ngo()": 0,
    }
    return f"line[{first + within.get(text, text.count(chr(10)))}]"


@pytest.mark.parametrize("text", ["go(a='\\d')", "go(a=1)(2)", "go(a='x'())", "go(a=1 is 1)"])
def test_hostile_code_does_not_make_python_warn(text: str) -> None:
    """A warning of Python's parser goes to the log of the gate, or ends it under `-W error`."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with pytest.raises(MalformedError):
            read_plan(text, Dialect.PYTHON)
    assert caught == []


def test_text_that_python_cannot_even_encode_is_refused() -> None:
    """Half a character cannot come in as bytes; a caller of the library can pass it anyway."""
    for text in ("go(a='\ud800')", "# \ud800\ngo()"):
        refused(text, "line[1]")


def test_a_comment_is_never_looked_at_wherever_it_stands() -> None:
    assert said("# one\n# two\ngo()") == [("go", {})]
    code = "go()  # stop()\n# stop()\ngo(a=1,  # b=2\n   c=3)\n# end"
    assert said(code) == [("go", {}), ("go", {"a": 1, "c": 3})]
    refused("# nothing\n", "input", reason=Reason.PLAN_EMPTY)


@pytest.mark.parametrize(("opening", "closing"), [("[", "]"), ("{'a':", "}"), ("(", ",)")])
def test_nesting_is_read_to_its_limit_and_refused_beyond(opening: str, closing: str) -> None:
    inner = MAX_DEPTH - 1
    assert said(f"go({opening * inner}1{closing * inner})")[0][0] == "go"
    refused(f"go(\n{opening * MAX_DEPTH}1{closing * MAX_DEPTH})", "line[2]")


def test_code_is_read_to_its_longest_and_refused_beyond() -> None:
    room = MAX_CODE - len("go(a='')")
    assert len(said(f"go(a='{'x' * room}')")[0][1]["a"]) == room
    text = f"go(a='{'x' * (room + 1)}')"
    refused(text, "input", reason=Reason.INPUT_TOO_LARGE)


@settings(max_examples=amount(40, 200))
@given(st.text(alphabet="go(a='1',-.)[]{}:= \n#\\xTrue\"", max_size=40) | st.text(max_size=40))
def test_whatever_is_accepted_python_means_too(text: str) -> None:
    """The oracle is Python's own literals: same names, same values, floats apart."""
    try:
        calls = read_plan(text, Dialect.PYTHON)
    except MalformedError:
        return
    for node, call in zip(ast.parse(text).body, calls, strict=True):
        assert isinstance(node, ast.Expr)
        assert isinstance(node.value, ast.Call)
        assert ast.unparse(node.value.func) == call.tool
        values = [*node.value.args, *(keyword.value for keyword in node.value.keywords)]
        for value, found in zip(values, call.arguments.values(), strict=True):
            assert _floats(found) == _lists(ast.literal_eval(value))


def _floats(value: Any) -> Any:
    if isinstance(value, list):
        return [_floats(item) for item in value]
    if isinstance(value, dict):
        return {name: _floats(item) for name, item in value.items()}
    return float(value) if isinstance(value, Decimal) else value


def _lists(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return [_lists(item) for item in value]
    return {n: _lists(v) for n, v in value.items()} if isinstance(value, dict) else value


# -- one literal -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1", 1),
        ("\n\n\t 'a'\n", "a"),
        ("[('a', 1.50),\n\n  ('b',)]", [["a", Decimal("1.50")], ["b"]]),
        ("{'a': [True]}", {"a": [True]}),
    ],
)
def test_a_literal_is_read_whatever_lines_it_stands_on(text: str, value: Any) -> None:
    assert repr(read_literal(text, where="x")) == repr(value)


def test_what_is_no_literal_is_refused_with_its_line() -> None:
    """Text must not climb out of the parentheses that it is put in."""
    for text, line in [
        ("1)", 1),
        ("1) + (2", 1),
        ("\n[1]) or ([2]", 2),
        ("[1]\n[2]", 2),
        ("# note\n[1]", 1),
        ("[1, # note\n2]", 1),
        ("[go()]", 1),
        ("go", 1),
        ("[\n*a]", 2),
        ("a := 1", 1),
        ("[" * (MAX_DEPTH + 1), 1),
    ]:
        with case(text, line):
            with pytest.raises(MalformedError) as caught:
                read_literal(text, where="x")
            assert caught.value.where == f"x.line[{line}]"


def test_a_literal_is_as_long_as_code_at_most() -> None:
    with pytest.raises(MalformedError) as caught:
        read_literal("1" * (MAX_CODE + 1), where="x")
    assert (caught.value.reason, caught.value.where) == (Reason.INPUT_TOO_LARGE, "x")


# -- Go2 -------------------------------------------------------------------------------------------


def test_a_go2_block_is_named_plain_values() -> None:
    text = "stand_up()\nwalk(distance=-1.5)\nvolume(value='10%+')\navoid(switch=True)"
    assert said(text, Dialect.GO2) == [
        ("stand_up", {}),
        ("walk", {"distance": Decimal("-1.5")}),
        ("volume", {"value": "10%+"}),
        ("avoid", {"switch": True}),
    ]


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("walk(1)", "line[1].1"),
        ("walk(d=1)\nwalk(1)", "line[2].1"),
        ("walk(d=[1])", "line[1].d"),
        ("walk(d={'a': 1})", "line[1].d"),
        ("dog.walk(d=1)", "line[1]"),
        ("walk(d=x)", "line[1]"),
        ("Now I walk.", "line[1]"),
    ],
)
def test_a_go2_block_has_no_other_form(text: str, where: str) -> None:
    refused(text, where, Dialect.GO2)


# -- BadRobot --------------------------------------------------------------------------------------

BOTH = [
    as_badrobot(("arm.go", {"1": "Dock"}), ("nod", {})),
    json.dumps({"function": ["arm.go('Dock')", "nod()"], "response": "It's done {soon}."}),
    '{"function": ["arm.go(\\"Dock\\")", "# then\\nnod()"]}',
    "{'response': \"It's done.\", 'function': (\"arm.go('Dock')\", 'nod()',),}",
]


def test_each_string_under_function_is_one_call_and_the_response_is_prose() -> None:
    for dialect in [Dialect.BADROBOT, Dialect.AUTO]:
        for text in BOTH:
            with case(dialect, text):
                assert read_plan(text, dialect) == (
                    Call("arm.go", {"1": "Dock"}, "function[0]"),
                    Call("nod", {}, "function[1]"),
                )


def test_a_badrobot_reply_that_is_broken_is_refused_in_its_place() -> None:
    for text, where in [
        ("{'function': ['go()'], 'response': 'it's done'}", "input.line[1]"),
        ("{'function': ['go('x')'], 'response': ''}", "input.line[1]"),
        ("{'function':\n ['go()'],\n 'response': None}", "response"),
        ("{'function':\n ['go()'],\n 'response': no}", "input.line[3]"),
        ("{'function': ['go()'], 'function': ['stop()']}", "input.line[1]"),
        ("{'function': ['go()']} Done.", "input.line[1]"),
        ("{'function': [go()]}", "input.line[1]"),
        ("{'function': ['go()' if 1 else 'stop()']}", "input.line[1]"),
        ("{\"function\": ['go()']}", "input[14]"),
        ('{"function": ["go()"], "function": []}', "input"),
        ("{'response': 'done'}", "function"),
        ("{'function': 'go()'}", "function"),
        ("{'function': [1]}", "function[0]"),
        ("{'function': [['go()']]}", "function[0]"),
        ("{'function': ['go()', '']}", "function[1]"),
        ("{'function': ['go()\\nstop()']}", "function[0]"),
        ("{'function': ['go(); stop()']}", "function[0].line[1]"),
        ("{'function': ['\\ngo(x)']}", "function[0].line[2]"),
        ("{'function': ['go()', 'then stop']}", "function[1].line[1]"),
        ("{'function': ['__import__(\"os\").system(\"x\")']}", "function[0].line[1]"),
        ("{'function': ['go()'], 'response': 1}", "response"),
        ("[]", "input"),
        ("go()", "input[0]"),
    ]:
        with case(text, where):
            refused(text, where, Dialect.BADROBOT)


def test_a_badrobot_reply_has_no_other_field() -> None:
    text = "{'function': ['go()'], 'tool': 'go'}"
    refused(text, "input.tool", Dialect.BADROBOT, Reason.FIELD_UNKNOWN)
    refused("{'function': []}", "input", Dialect.BADROBOT, Reason.PLAN_EMPTY)
