# SPDX-License-Identifier: Apache-2.0
"""What a tools' server said once is what it has to say again."""

from __future__ import annotations

from pathlib import Path

import mcp_types as types
import pytest

from authguard_r.core.errors import MalformedError
from authguard_r.integrations.mcp.pins import Pins, pins_bytes, pins_of, read_pins


def tool(name: str, **more: object) -> types.Tool:
    return types.Tool.model_validate(
        {"name": name, "inputSchema": {"type": "object"}, **more}, by_alias=True
    )


def test_they_are_read_as_they_were_written(tmp_path: Path) -> None:
    pins = pins_of([tool("b", description="does b"), tool("a")])
    path = tmp_path / "pins.json"
    path.write_bytes(pins_bytes(pins))
    assert read_pins(path) == pins
    assert [pin.name for pin in pins.tools] == ["a", "b"]


def test_any_word_of_a_tool_that_changed_is_named() -> None:
    pins = pins_of([tool("a"), tool("b"), tool("c")])
    other = pins_of(
        [
            tool("a", description="obey the sign"),
            tool("b", inputSchema={"type": "array"}),
            tool("d"),
        ]
    )
    assert pins.differ(other) == ("a", "b", "c", "d")
    assert pins.differ(pins) == ()


@pytest.mark.parametrize(
    "said",
    [
        {"outputSchema": {"type": "object", "properties": {"x": {"pattern": "^(a+)+$"}}}},
        {"annotations": {"readOnlyHint": True}},
        {"title": "Harmless"},
        {"icons": [{"src": "https://example.org/a.png"}]},
        {"execution": {"taskSupport": "optional"}},
        {"_meta": {"a": "b"}},
    ],
    ids=lambda said: next(iter(said)),
)
def test_all_that_a_server_says_of_a_tool_is_kept(said: dict[str, object]) -> None:
    plain, more = pins_of([tool("a")]), pins_of([tool("a", **said)])
    assert plain.differ(more) == ("a",)
    assert more.tools[0].more == said


def test_older_pins_are_refused_with_what_helps(tmp_path: Path) -> None:
    path = tmp_path / "pins.json"
    path.write_bytes(b'{"schema": "authguard-r/mcp-tools/1", "tools": []}')
    with pytest.raises(MalformedError, match="authguard advanced mcp-tools --out"):
        read_pins(path)


def test_two_tools_of_one_name_are_refused() -> None:
    with pytest.raises(MalformedError, match="one tool of each name"):
        pins_of([tool("a"), tool("a")])


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "truncated"),
        (b"{", "truncated"),
        (b"\xff", "malformed|utf-8"),
        (b'{"schema": "authguard-r/mcp-tools/2", "tools": [{"name": 1}]}', "Expected `str`"),
        (b'{"schema": "authguard-r/mcp-tools/2", "tools": [], "more": 1}', "unknown field"),
        (b'{"schema": "authguard-r/mcp-tools/3", "tools": []}', "mcp-tools/2"),
        (b"[" * 100_000, "."),
    ],
)
def test_a_file_that_is_none_is_refused_by_name(tmp_path: Path, data: bytes, said: str) -> None:
    path = tmp_path / "pins.json"
    path.write_bytes(data)
    with pytest.raises(MalformedError, match=said) as refused:
        read_pins(path)
    assert refused.value.where == str(path)


def test_no_tools_are_pins_too() -> None:
    assert pins_of([]) == Pins(schema="authguard-r/mcp-tools/2", tools=())
