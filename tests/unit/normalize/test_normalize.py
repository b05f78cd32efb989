# SPDX-License-Identifier: Apache-2.0
"""The whole normalizer: evidence, no evaluation, bounded work, nothing but its own errors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from authguard_r.core.encoding import Tag, digest
from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize import Dialect, read_plan
from authguard_r.normalize.parse import MAX_TEXT
from fixtures import scenarios
from fixtures.amount import amount
from fixtures.cases import case
from fixtures.time_bounds import at_most
from unit.normalize.dialogue import WRITERS, as_json, as_openai, binder, read, refused

REPLIES = sorted((scenarios.HOSPITAL / "replies").iterdir())
GO = ("navigate_to", {"destination": "Dock"})

#: What a normalizer may answer with; anything else is a wrong answer or a crash.
OURS = {
    Reason.MALFORMED,
    Reason.INPUT_TOO_LARGE,
    Reason.DIALECT_UNKNOWN,
    Reason.PLAN_EMPTY,
    Reason.TOOL_UNKNOWN,
    Reason.FIELD_UNKNOWN,
    Reason.FIELD_MISSING,
    Reason.FIELD_REFUSED,
    Reason.VALUE_INVALID,
    Reason.VALUE_OUT_OF_RANGE,
    Reason.NAME_UNKNOWN,
    Reason.STATE_WRITING_REFUSED,
}


def answers_or_refuses(data: bytes, dialect: Dialect = Dialect.AUTO) -> None:
    try:
        plan = read_plan(data, binder=binder(), dialect=dialect)
    except MalformedError as error:
        refusal = error
    else:
        assert plan.steps
        return
    assert refusal.reason in OURS
    assert refusal.where


# -- evidence --------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", REPLIES, ids=lambda path: path.name)
def test_every_shipped_reply_is_read_or_refused_by_name(path: Path) -> None:
    if path.name.startswith("07-unknown-place"):
        where = "choices[0].message.tool_calls[0].function.arguments.destination"
        refused(path.read_bytes(), Reason.NAME_UNKNOWN, where)
        return
    plan = read(path.read_bytes())
    told = {"deliver.bare.json": Dialect.JSON, "deliver.calls.txt": Dialect.CALLS}
    assert plan.dialect is told.get(path.name, Dialect.OPENAI)
    assert plan.evidence == digest(Tag.RAW, path.read_bytes())


def test_the_evidence_is_of_the_exact_bytes_also_where_they_mean_the_same() -> None:
    texts = [as_json(GO), f" {as_json(GO)}", WRITERS[Dialect.CALLS](GO), as_openai(GO)]
    plans = [read(text) for text in texts]
    assert [str(plan.dialect) for plan in plans] == ["json", "json", "calls", "openai"]
    assert len({plan.evidence for plan in plans}) == len(texts)
    assert len({str(plan.steps) for plan in plans}) == 1
    assert [plan.evidence for plan in plans] == [digest(Tag.RAW, t.encode()) for t in texts]


# -- parse, never evaluate (L12) -------------------------------------------------------------------

CODE = [
    '__import__("os").system("touch {path}")',
    "__import__('os').system('touch {path}')",
    "eval(\"open('{path}', 'w')\")",
    "exec(\"open('{path}', 'w')\")",
    "open('{path}', 'w')",
    "navigate_to(destination=open('{path}', 'w'))",
    "navigate_to(destination=__import__('os').system('touch {path}'))",
    'navigate_to(destination=f\'{{open("{path}", "w")}}\')',
    "navigate_to(speed=(lambda: open('{path}', 'w'))())",
    "navigate_to(destination='Dock'); import os; os.system('touch {path}')",
    "navigate_to(destination='Dock') or open('{path}', 'w')",
    "[navigate_to(destination='Dock') for _ in open('{path}', 'w')]",
    '{{"tool": open("{path}", "w"), "arguments": {{}}}}',
    '{{"__class__": "os.system", "args": ["touch {path}"]}}',
    '{{"py/object": "os.system", "py/reduce": ["touch {path}"]}}',
    "cos\nsystem\n(S'touch {path}'\ntR.",
    "$(touch {path})",
    "`touch {path}`",
    "{{% for x in ().__class__.__bases__ %}}{{% endfor %}}",
    "!!python/object/apply:os.system ['touch {path}']",
]


@pytest.mark.parametrize("dialect", Dialect)
def test_code_is_refused_and_nothing_of_it_runs(dialect: Dialect, tmp_path: Path) -> None:
    target = tmp_path / "run"
    for code in CODE:
        with case(code):
            with pytest.raises(MalformedError):
                read(code.format(path=target), dialect)
            assert not target.exists()


def test_code_in_a_value_is_text_that_names_nothing(tmp_path: Path) -> None:
    target = tmp_path / "run"
    for code in CODE:
        text = code.format(path=target)
        to_text = as_json(("navigate_to", {"destination": text}))
        with case(code):
            refused(to_text, Reason.NAME_UNKNOWN, "plan[0].destination")
            refused(as_json((text, {})), Reason.TOOL_UNKNOWN, "plan[0].tool")
            read(as_json(("say", {"text": text})))
            assert not target.exists()


# -- bounded work (L19) ----------------------------------------------------------------------------

FLOODS: dict[str, bytes] = {
    "a megabyte of text": b"a" * (1 << 20),
    "a megabyte of brackets": b"[" * (1 << 20),
    "a megabyte of calls": b"scan()\n" * (1 << 20 >> 3),
    "10,000 deep, lists": b"[" * 10_000 + b"]" * 10_000,
    "10,000 deep, objects": b'{"plan":' * 10_000 + b"1" + b"}" * 10_000,
    "10,000 deep, arguments": as_openai()
    .replace('"tool_calls": []', '"tool_calls": ' + "[" * 10_000)
    .encode(),
    "10,000 calls": b"scan()\n" * 10_000,
    "5,000 calls as JSON": json.dumps([{"tool": "scan", "arguments": {}}] * 5_000).encode(),
    "brackets to the limit": b"[" * MAX_TEXT,
    "quotes to the limit": b'"' * MAX_TEXT,
    "an open string to the limit": b'["' + b"a" * (MAX_TEXT - 2),
    "a call with an open string": b"go(a='" + b"x" * (MAX_TEXT - 6),
    "back slashes to the limit": b'["' + b"\\" * (MAX_TEXT - 2),
    "spaces to the limit": b" " * MAX_TEXT,
    "a number to the limit": b'{"a":' + b"1" * (MAX_TEXT - 6) + b"}",
    "a number of places to the limit": b'{"a":0.' + b"1" * (MAX_TEXT - 8) + b"}",
    "a name to the limit": b"a" * MAX_TEXT,
    "list items to the limit": b"[" + b"0," * (MAX_TEXT // 2 - 1) + b"0]",
    "empty objects to the limit": b"[" + b"{}," * (MAX_TEXT // 3 - 1) + b"{}]",
    "keys to the limit": ("{" + ",".join(f'"{n:x}":0' for n in range(25_000)) + "}").encode(),
    "fields to the limit": ("go(" + ",".join(f"k{n}=0" for n in range(25_000)) + ")").encode(),
    "a long key over many items": b'{"' + b"k" * 120_000 + b'":[' + b"0," * 60_000 + b"0]}",
    "escapes to the limit": b'{"a":"' + b"\\u0041" * (MAX_TEXT // 6 - 2) + b'"}',
}


@pytest.mark.parametrize("data", FLOODS.values(), ids=FLOODS)
def test_a_flood_is_refused_within_a_second(data: bytes) -> None:
    """Refusing must cost less than sending; measured in this process's own time."""
    with at_most(1), pytest.raises(MalformedError) as caught:
        read(data)
    assert caught.value.reason in OURS


def test_a_reply_at_the_limit_is_still_read() -> None:
    room = MAX_TEXT - len(as_json(("say", {"text": ""})))
    assert len(read(as_json(("say", {"text": "x" * room}))).steps) == 1
    refused(as_json(("say", {"text": "x" * (room + 1)})), Reason.INPUT_TOO_LARGE, "input")


# -- anything at all -------------------------------------------------------------------------------

FUZZ = settings(max_examples=amount(50, 250))
words = st.sampled_from(
    [
        "navigate_to",
        "pick_up",
        "relocalize",
        "scan",
        "destination",
        "object",
        "via",
        "speed",
        "Dock",
        "P1",
        "plan",
        "tool",
        "arguments",
        "choices",
    ]
)
scalars = (
    words
    | st.none()
    | st.booleans()
    | st.integers(-(10**45), 10**45)
    | st.floats(allow_nan=True, allow_infinity=True)
    | st.text(max_size=5)
)
trees = st.recursive(
    scalars,
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(words | st.text(max_size=3), inner, max_size=3)
    ),
    max_leaves=15,
)
arguments = st.dictionaries(words | st.text(max_size=3), trees, max_size=4)


@FUZZ
@given(st.binary(max_size=120), st.sampled_from(Dialect))
def test_no_bytes_raise_anything_but_malformed(data: bytes, dialect: Dialect) -> None:
    answers_or_refuses(data, dialect)


@FUZZ
@given(trees, st.sampled_from(Dialect))
def test_no_json_raises_anything_but_malformed(tree: Any, dialect: Dialect) -> None:
    answers_or_refuses(json.dumps(tree).encode("utf-8", "surrogatepass"), dialect)


@FUZZ
@given(words | st.text(max_size=5), arguments, st.sampled_from([Dialect.JSON, Dialect.OPENAI]))
def test_no_arguments_raise_anything_but_malformed(
    tool: str, values: dict[str, Any], dialect: Dialect
) -> None:
    text = WRITERS[dialect]((tool, values))
    answers_or_refuses(text.encode("utf-8", "surrogatepass"), dialect)


@settings(FUZZ, derandomize=True)
@given(st.data())
def test_no_change_of_a_good_reply_raises_anything_but_malformed(data: st.DataObject) -> None:
    good = data.draw(st.sampled_from([path.read_bytes() for path in REPLIES]))
    at = data.draw(st.integers(0, len(good)))
    new = data.draw(st.binary(max_size=4) | st.sampled_from([b"null", b"[]", b"{}", b'"', b"1e9"]))
    answers_or_refuses(good[:at] + new + good[at + data.draw(st.integers(0, 12)) :])
