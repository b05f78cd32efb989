# SPDX-License-Identifier: Apache-2.0
"""Naughty strings and look-alikes as names, tools, fields, identifiers and task text (L2).

A text is refused, or it means exactly what it says. Nothing but our own errors leaves.
"""

from __future__ import annotations

import json
import unicodedata
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import pytest
import rfc8785

from authguard_r.core.encoding import decode, encode
from authguard_r.core.errors import AuthGuardError, MalformedError
from authguard_r.core.identifiers import is_identifier
from authguard_r.core.mission import Mission, Row, require_schema
from authguard_r.core.reasons import Reason
from authguard_r.normalize import Binder, Dialect, read_plan
from authguard_r.provenance.context import ContextLedger
from fixtures import scenarios

ROOT = Path(__file__).resolve().parent.parent.parent
EXTERNAL = ROOT.parent / "shared" / "external"

pytestmark = [
    pytest.mark.external,
    pytest.mark.skipif(not EXTERNAL.is_dir(), reason=f"no public test data at {EXTERNAL}"),
]

DIALECTS = [Dialect.JSON, Dialect.CALLS, Dialect.OPENAI]


@cache
def naughty() -> tuple[str, ...]:
    return tuple(json.loads((EXTERNAL / "blns" / "blns.json").read_text(encoding="utf-8")))


@cache
def confusables() -> tuple[tuple[str, str], ...]:
    """Return (look-alike, what it looks like) for every pair whose original is ASCII."""
    path = EXTERNAL / "confusables" / "woodgern_confusables.txt"
    pairs = []
    for line in path.read_text(encoding="utf-8-sig").splitlines():
        fields = line.split("#")[0].split(";")
        if len(fields) < 3:
            continue
        twin, original = ("".join(chr(int(c, 16)) for c in f.split()) for f in fields[:2])
        if original.isascii():
            pairs.append((twin, original))
    return tuple(pairs)


@cache
def binder() -> Binder:
    return Binder(scenarios.site(), scenarios.binding())


def quoted(text: str) -> str:
    """Spell a text as a literal of the calls dialect, which has no escapes."""
    return f"'{text}'" if '"' in text else f'"{text}"'


def said(dialect: Dialect, tool: str, field: str, value: str) -> bytes:
    """Return a plan of one call with one text argument, as a planner would write it."""
    if dialect is Dialect.CALLS:
        text = f"{tool}({field}={quoted(value)})"
    elif dialect is Dialect.JSON:
        text = json.dumps({"tool": tool, "arguments": {field: value}}, ensure_ascii=False)
    else:
        function = {"name": tool, "arguments": json.dumps({field: value})}
        message = {"tool_calls": [{"type": "function", "function": function}]}
        text = json.dumps({"choices": [{"finish_reason": "stop", "message": message}]})
    return text.encode("utf-8", "surrogatepass")


def meant(dialect: Dialect, tool: str, field: str, value: str) -> Any:
    """Return the one action that is meant, or the reason of the refusal."""
    try:
        plan = read_plan(said(dialect, tool, field, value), binder=binder(), dialect=dialect)
    except MalformedError as error:
        return error.reason
    assert len(plan.steps) == 1
    return plan.steps[0].action


def regions() -> dict[str, str]:
    return {n: r for r, m in scenarios.site().regions.items() for n in (r, *m.names)}


def objects() -> dict[str, str]:
    return {n: o for o, m in scenarios.site().objects.items() for n in (o, *m.names)}


def twins(name: str) -> Iterator[str]:
    """Yield every text that differs from the name and looks like it."""
    prototypes = dict(confusables())
    for twin, original in confusables():
        # all that look like one prototype look like each other: 1, l, | and their kin
        for part in {original, *(c for c in name if prototypes.get(c) == original)}:
            yield name.replace(part, twin, 1)
            yield name.replace(part, twin)
            yield name.replace(part, original)
    for form in ("NFC", "NFD", "NFKC", "NFKD"):
        yield unicodedata.normalize(form, name)
    yield from (name.upper(), name.lower(), name.title(), name.swapcase(), name.casefold())
    for mark in " \t\n\r\u00a0\u200b\u200d\u2060\ufeff\u00ad\u202e\u034f\0":
        yield from (name + mark, mark + name, name.replace(" ", mark), mark.join(name))
    yield "".join(chr(ord(c) + 0xFEE0) if "!" <= c <= "~" else c for c in name)  # full width


# -- naughty strings -------------------------------------------------------------------------------


def test_the_list_is_whole() -> None:
    assert len(naughty()) == 515
    assert len(confusables()) > 1_000


@pytest.mark.parametrize("dialect", DIALECTS)
@pytest.mark.parametrize(
    ("tool", "field"),
    [("navigate_to", "destination"), ("pick_up", "object")],
    ids=["place", "object"],
)
def test_a_naughty_string_names_nothing(dialect: Dialect, tool: str, field: str) -> None:
    """None is a spelling of this site, so every one is refused, and by these two reasons only."""
    known = regions() if field == "destination" else objects()
    for text in naughty():
        assert text not in known
        found = meant(dialect, tool, field, text)
        assert found in {Reason.NAME_UNKNOWN, Reason.MALFORMED}, text
        if dialect is not Dialect.CALLS:
            assert found is Reason.NAME_UNKNOWN, text


@pytest.mark.parametrize("dialect", DIALECTS)
def test_a_naughty_string_is_no_tool_and_no_field(dialect: Dialect) -> None:
    for text in naughty():
        expected = {Reason.TOOL_UNKNOWN, Reason.MALFORMED, Reason.PLAN_EMPTY}
        assert meant(dialect, text, "destination", "Dock") in expected, text
        expected = {Reason.FIELD_UNKNOWN, Reason.MALFORMED}
        assert meant(dialect, "navigate_to", text, "Dock") in expected, text


@pytest.mark.parametrize("dialect", DIALECTS)
def test_a_naughty_string_in_a_noted_field_changes_nothing(dialect: Dialect) -> None:
    plain = read_plan(b"say()", binder=binder()).steps[0].action
    for text in naughty():
        found = meant(dialect, "say", "text", text)
        if dialect is Dialect.CALLS and found is Reason.MALFORMED:
            assert set(text) & set("'\"\\\n"), text  # what the dialect cannot quote
        else:
            assert found == plain, text


def test_a_naughty_string_is_a_whole_plan_of_nothing() -> None:
    for text in naughty():
        for dialect in Dialect:
            with pytest.raises(AuthGuardError):
                read_plan(text.encode("utf-8", "surrogatepass"), binder=binder(), dialect=dialect)


def test_a_naughty_string_is_an_identifier_only_when_it_is_spelled_like_one() -> None:
    for text in naughty():
        plain_enough = (
            1 <= len(text) <= 64
            and set(text) <= set("abcdefghijklmnopqrstuvwxyz0123456789_.:-")
            and text[0].isalnum()
        )
        assert is_identifier(text) is plain_enough, text
        data = rfc8785.dumps({"object": text})
        if plain_enough:
            assert decode(data, Row).object == text
        else:
            with pytest.raises(MalformedError) as caught:
                decode(data, Row, where="row")
            assert (caught.value.reason, caught.value.where) == (Reason.MALFORMED, "row.object")


def test_a_naughty_task_is_signed_as_it_is_or_refused_for_its_form() -> None:
    """The task explains and never authorizes; it must survive byte for byte all the same."""
    mission = scenarios.mission()
    for text in naughty():
        changed = msgspec.structs.replace(mission, task=text)
        data = encode(changed)
        if not 1 <= len(text) <= 2000:
            with pytest.raises(MalformedError) as caught:
                decode(data, Mission)
            assert caught.value.where == "task"
            continue
        found = decode(data, Mission)
        assert found == changed
        if unicodedata.is_normalized("NFC", text):
            require_schema(found)
        else:
            with pytest.raises(MalformedError) as caught:
                require_schema(found)
            assert (caught.value.reason, caught.value.where) == (Reason.SCHEMA_INVALID, "task")


def test_a_naughty_string_in_any_channel_is_noted_and_harms_nothing() -> None:
    context = ContextLedger(binder().spellings())
    for text in naughty():
        context.add("ocr", text)
    action = read_plan(b'navigate_to(destination="Station 101")', binder=binder()).steps[0].action
    assert context.influences(action) == ()


# -- look-alikes -----------------------------------------------------------------------------------


@pytest.mark.parametrize("dialect", [Dialect.JSON, Dialect.OPENAI])
@pytest.mark.parametrize(
    ("tool", "field", "name"),
    [("navigate_to", "destination", "Station 101"), ("pick_up", "object", "Package P1")],
)
def test_a_look_alike_of_a_name_is_another_name_and_unknown(
    dialect: Dialect, tool: str, field: str, name: str
) -> None:
    known = regions() if field == "destination" else objects()
    tried = set(twins(name)) - {name}
    assert len(tried) > 250
    for twin in tried:
        assert twin not in known, twin
        assert meant(dialect, tool, field, twin) is Reason.NAME_UNKNOWN, twin


@pytest.mark.parametrize("name", ["Station 101", "station-101", "Dock", "Pharmacy Desk A"])
def test_a_look_alike_in_the_calls_dialect_is_unknown_or_cannot_be_said(name: str) -> None:
    for twin in set(twins(name)) - set(regions()):
        found = meant(Dialect.CALLS, "navigate_to", "destination", twin)
        assert found in {Reason.NAME_UNKNOWN, Reason.MALFORMED}, twin
        if not set(twin) & set("'\"\\\n"):
            assert found is Reason.NAME_UNKNOWN, twin


def test_a_look_alike_of_a_tool_or_a_field_is_unknown() -> None:
    for twin in set(twins("navigate_to")) - {"navigate_to"}:
        assert meant(Dialect.JSON, twin, "destination", "Dock") is Reason.TOOL_UNKNOWN, twin
    for twin in set(twins("destination")) - {"destination"}:
        assert meant(Dialect.JSON, "navigate_to", twin, "Dock") is Reason.FIELD_UNKNOWN, twin


def test_a_look_alike_outside_ascii_is_no_identifier() -> None:
    """So no signed word has a twin in another alphabet."""
    for identifier in ("station-101", "package-p1", "courier-1", "operator-1"):
        for twin in set(twins(identifier)) - {identifier}:
            if not twin.isascii():
                assert not is_identifier(twin), twin
                with pytest.raises(MalformedError):
                    decode(rfc8785.dumps({"object": twin}), Row)
