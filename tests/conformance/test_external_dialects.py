# SPDX-License-Identifier: Apache-2.0
"""Public bad input through every dialect: exactly what was meant, or a refusal with a place (L2).

Naughty strings, look-alikes and the JSON parsing suite, each as a whole plan and as every value,
tool and field that a dialect can carry. The real scene and its steps are read too.
"""

from __future__ import annotations

import ast
import json
import unicodedata
from collections import defaultdict
from decimal import Decimal
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.dialects import Call, Dialect, read_plan
from authguard_r.normalize.dialects.verbs import DRIVE_VERBS, STEP_VERBS
from authguard_r.normalize.parse import read_text
from fixtures.cases import case
from unit.normalize.writers import WAYS

ROOT = Path(__file__).resolve().parent.parent.parent
EXTERNAL = ROOT.parent / "shared" / "external"

pytestmark = [
    pytest.mark.external,
    pytest.mark.skipif(not EXTERNAL.is_dir(), reason=f"no public test data at {EXTERNAL}"),
]

#: The dialects that can carry any text at all as a value, as a tool and as a field.
VALUES = ["openai", "anthropic", "mcp", "json", "python", "badrobot", "spine, tuples", "ros2"]
TOOLS = ["openai", "anthropic", "mcp", "json", "spine, tuples", "spine, rows"]
FIELDS = ["openai", "anthropic", "mcp", "json"]


@cache
def naughty() -> tuple[str, ...]:
    return tuple(json.loads((EXTERNAL / "blns" / "blns.json").read_text(encoding="utf-8")))


@cache
def look_alikes() -> tuple[str, ...]:
    """Return every character that looks like a letter, a digit or a mark of ASCII."""
    path = EXTERNAL / "confusables" / "woodgern_confusables.txt"
    found = []
    for line in path.read_text(encoding="utf-8-sig").splitlines():
        fields = line.split("#")[0].split(";")
        if len(fields) < 3:
            continue
        twin, original = ("".join(chr(int(c, 16)) for c in f.split()) for f in fields[:2])
        if original.isascii() and not twin.isascii():
            found.append(twin)
    return tuple(found)


@cache
def twins(word: str) -> tuple[str, ...]:
    """Return texts that differ from a word and look like it, or are folded into it."""
    found = {word.replace(word[0], twin, 1) for twin in look_alikes()}
    found |= {f"{word}{mark}" for mark in "\u200b\u200d\u2060\ufeff\u00ad\u202e\u00a0\u0301"}
    found |= {"".join(chr(ord(c) + 0xFEE0) if "!" <= c <= "~" else c for c in word)}
    found |= {
        word.upper(),
        word.title(),
        unicodedata.normalize("NFKD", word.replace("i", "\uff49")),
    }
    return tuple(found - {word})


def read(text: str, dialect: Dialect) -> tuple[Call, ...] | None:
    """Return what bytes of that text say, or None after a refusal with a place."""
    try:
        return read_plan(read_text(text.encode("utf-8", "surrogatepass")), dialect)
    except MalformedError as error:
        refusal = error
    assert refusal.where, text
    return None


def whole(value: Any) -> set[Dialect]:
    """Return the dialects in which a text is a plan."""
    return {dialect for dialect in Dialect if read(value, dialect) is not None}


# -- naughty strings -------------------------------------------------------------------------------


def test_a_naughty_string_is_no_plan_in_any_dialect() -> None:
    """But for four that are calls by their form, of code: no binding knows what they name."""
    plans = {text for text in naughty() if whole(text)}
    for text in plans:
        calls = read(text, Dialect.AUTO)
        assert calls is not None
        assert text.startswith(calls[0].tool + "("), text
    assert len(plans) == 4, plans


def test_a_naughty_string_as_a_value_is_that_value_or_refused() -> None:
    """Only what UTF-8 or the dialect's own literals cannot say may be refused."""
    for way in VALUES:
        with case(way):
            dialect, write, ((tool, arguments), *_) = WAYS[way]
            name = "1" if way == "spine, tuples" else "to"
            for text in naughty():
                value = {"args": {name: text}} if dialect is Dialect.ROS2 else {name: text}
                call = (tool, {**arguments, **value} if dialect is Dialect.ROS2 else value)
                found = read(write(call), dialect)
                assert found is not None, text
                assert [(c.tool, c.arguments) for c in found] == [call], text


@pytest.mark.parametrize("way", ["calls", "go2", "spine", "spine, the bare list", "steps"])
def test_a_naughty_string_in_a_dialect_with_fewer_words_is_itself_or_refused(way: str) -> None:
    dialect, write, _ = WAYS[way]
    name = "to" if dialect in {Dialect.CALLS, Dialect.GO2} else "1"
    tool = "find" if dialect is Dialect.STEPS else "go"
    read_as_such = 0
    for text in naughty():
        found = read(write((tool, {name: text})), dialect)
        if found is None or dialect is Dialect.SPINE:
            continue
        said = text.strip(" \t\r") if dialect is Dialect.STEPS else text  # a line's own margin
        assert [(c.tool, c.arguments) for c in found] == [(tool, {name: said})], text
        read_as_such += 1
    if dialect is not Dialect.SPINE:
        assert read_as_such > 100


def test_a_naughty_string_as_a_bare_word_is_split_at_commas_and_nowhere_else() -> None:
    _, write, _ = WAYS["spine"]
    for text in naughty():
        found = read(write(("go", {"1": text})), Dialect.SPINE)
        if found is not None:
            (call,) = found
            shown = list(call.arguments.values())
            parts = [part.strip(" \t\r\n") for part in text.split(",")]
            assert len(shown) == len(parts) or parts == [""], text
            for value, part in zip(shown, parts, strict=False):
                assert value == (part if isinstance(value, str) else Decimal(part)), text


@pytest.mark.parametrize("way", TOOLS)
def test_a_naughty_string_as_a_tool_is_that_tool_or_refused(way: str) -> None:
    dialect, write, _ = WAYS[way]
    for text in naughty():
        assert [c.tool for c in read(write((text, {})), dialect) or ()] == [text], text


@pytest.mark.parametrize("way", FIELDS)
def test_a_naughty_string_as_a_field_is_that_field_or_refused(way: str) -> None:
    dialect, write, _ = WAYS[way]
    for text in naughty():
        found = read(write(("go", {text: 1})), dialect)
        assert [c.arguments for c in found or ()] == [{text: 1}], text


@pytest.mark.parametrize("way", ["calls", "python", "go2", "badrobot", "spine"])
def test_a_naughty_string_is_no_name_in_code(way: str) -> None:
    """Unless it is spelled like a name of ASCII: then it is that name."""
    dialect, write, _ = WAYS[way]
    for text in naughty():
        found = read(write((text, {})), dialect)
        if found is not None:
            assert found[0].tool == text
            assert all(part.isidentifier() for part in text.split("."))
            assert text.isascii()


# -- look-alikes -----------------------------------------------------------------------------------


def test_the_look_alikes_are_many() -> None:
    assert len(twins("find")) > 1_000


@pytest.mark.parametrize("way", ["calls", "python", "go2", "badrobot", "spine", "steps"])
def test_a_look_alike_of_a_name_never_becomes_the_name(way: str) -> None:
    """The attack: Python folds full-width and other letters into the name that they look like."""
    dialect, write, _ = WAYS[way]
    for twin in twins("find"):
        calls = [("find", {}), (twin, {"1": "Cup"} if dialect is Dialect.STEPS else {})]
        found = read(write(*calls), dialect)
        assert found is None or (twin.isascii() and found[1].tool == twin), twin


@pytest.mark.parametrize("way", ["calls", "python", "go2"])
def test_a_look_alike_of_a_field_never_becomes_the_field(way: str) -> None:
    dialect, write, _ = WAYS[way]
    for twin in twins("to"):
        found = read(write(("go", {twin: 1})), dialect)
        assert found is None or (twin.isascii() and list(found[0].arguments) == [twin]), twin


def test_a_look_alike_of_a_mark_of_the_grammar_is_never_that_mark() -> None:
    """Quotation marks, parentheses, commas, digits and the like of other alphabets."""
    for way, (dialect, write, calls) in WAYS.items():
        good = write(*calls)
        for mark in "()[]{}'\",:=.1":
            if mark not in good:
                continue
            for twin in look_alikes()[::9]:
                found = read(good.replace(mark, twin), dialect)
                if found is not None:  # inside a value, or in what is prose
                    assert len(found) <= len(calls), (way, twin)
                    assert twin not in "".join(call.tool for call in found)


# -- the JSON parsing suite ------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["y", "n", "i"])
def test_no_file_of_the_json_suite_is_a_plan_in_any_dialect(kind: str) -> None:
    files = sorted((EXTERNAL / "jsontestsuite" / "test_parsing").glob(f"{kind}_*.json"))
    assert len(files) > 30
    for path in files:
        for dialect in Dialect:
            with pytest.raises(MalformedError) as caught:
                read_plan(read_text(path.read_bytes()), dialect)
            assert caught.value.where, path.name


@pytest.mark.parametrize(
    "shape",
    [
        '{"tool": "go", "arguments": {"a": %s}}',
        '{"jsonrpc":"2.0","id":1,"method":"tools/call","params":{"name":"go","arguments":{"a":%s}}}',
        '{"stop_reason":"end_turn","content":[{"type":"tool_use","id":"i","name":"go","input":{"a":%s}}]}',
        '{"op": "publish", "topic": "/t", "msg": {"a": %s}}',
    ],
    ids=["json", "mcp", "anthropic", "ros2"],
)
def test_what_is_no_json_is_none_as_an_argument_either(shape: str) -> None:
    """Nor does one of these files close a bracket of ours."""
    for path in sorted((EXTERNAL / "jsontestsuite" / "test_parsing").glob("n_*.json")):
        data = shape.encode().replace(b"%s", path.read_bytes())
        with pytest.raises(MalformedError) as caught:
            read_plan(read_text(data), Dialect.AUTO)
        assert caught.value.where, path.name


# -- real plans ------------------------------------------------------------------------------------


def tasks() -> list[list[str]]:
    found = []
    for path in sorted((EXTERNAL / "safeagentbench").glob("*.jsonl")):
        for line in path.read_text(encoding="utf-8").splitlines():
            steps = json.loads(line).get("step")
            if steps is not None:
                found.append(ast.literal_eval(steps) if isinstance(steps, str) else steps)
    return found


def test_every_household_step_is_read_as_its_verb_but_for_one_that_is_misspelled() -> None:
    """All verbs that occur are in the dialect; `Open` is not how the executor spells `open`."""
    refused: dict[str, set[Reason]] = defaultdict(set)
    plans = 0
    for steps in tasks():
        for text in (json.dumps(steps), "\n".join(steps)):
            for dialect in (Dialect.STEPS, Dialect.AUTO):
                try:
                    calls = read_plan(text, dialect)
                except MalformedError as error:
                    refused["; ".join(steps)].add(error.reason)
                    continue
                plans += 1
                for step, call in zip(steps, calls, strict=True):
                    verb = next(
                        v for v in STEP_VERBS if step.split(" ")[: v.count(" ") + 1] == v.split(" ")
                    )
                    assert call.tool == STEP_VERBS[verb].tool
                    assert " ".join([verb, *call.arguments.values()]) == step
    assert plans >= 4 * 185
    assert all("Open" in steps for steps in refused)
    assert list(refused.values()) == [{Reason.TOOL_UNKNOWN}]


def test_every_call_that_public_robot_interfaces_name_can_be_said_in_its_dialect() -> None:
    known = json.loads((EXTERNAL / "robot_llm_apis" / "apis.json").read_text(encoding="utf-8"))
    for tool, arguments in known["jackal_and_spine"]["calls"]:
        found = read(f"[{tool}({', '.join('x_1' for _ in arguments)})]", Dialect.AUTO)
        assert [c.tool for c in found or ()] == [tool]
    for tool, arguments in known["unitree_go2"]["calls"]:
        text = f"{tool}({', '.join(f'{name.split()[0]}=1' for name in arguments)})"
        assert [c.tool for c in read(text, Dialect.GO2) or ()] == [tool]
        assert read(text, Dialect.AUTO) == read(text, Dialect.CALLS)
    for tool, arguments in known["badrobot_arms"]["calls"]:
        text = repr({"function": [f"{tool}({', '.join('1' for _ in arguments)})"], "response": ""})
        assert [c.tool for c in read(text, Dialect.AUTO) or ()] == [tool]
    assert {tool for tool, _ in known["dolphins"]["calls"]} == set(DRIVE_VERBS)
