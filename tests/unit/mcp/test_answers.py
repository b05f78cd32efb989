# SPDX-License-Identifier: Apache-2.0
"""A server's answer passes through the gate whole, and no word in it passes unnoted.

Source: docs/spec/mcp.md#results
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mcp_types as types
import pytest

from authguard_r.integrations.mcp.answers import answer_from, texts_of

META = {"org.example/by": "word-meta", "word-key": ["word-list"]}
NOTES = types.Annotations(audience=["user"], last_modified="word-modified")
LINK: dict[str, Any] = {"uri": "robot://word-uri", "name": "word-name", "title": "word-title"}
TEXT = types.TextResourceContents(
    uri="robot://word-note", text="word-text", mime_type="word/mime", _meta=META
)
BLOB = types.BlobResourceContents(uri="robot://word-blob", blob="AAAA", mime_type="word/mime")
ITEMS: list[Any] = [
    types.TextContent(type="text", text="word-plain", annotations=NOTES, _meta=META),
    types.ImageContent(type="image", data="AAAA", mime_type="word/image"),
    types.AudioContent(type="audio", data="AAAA", mime_type="word/sound", _meta=META),
    types.ResourceLink(type="resource_link", description="word-described", _meta=META, **LINK),
    types.EmbeddedResource(type="resource", resource=TEXT, annotations=NOTES),
    types.EmbeddedResource(type="resource", resource=BLOB),
]


def words(value: Any) -> Iterator[str]:
    """Yield every word that somebody could have chosen."""
    if isinstance(value, dict):
        for name, inner in value.items():
            yield name
            yield from words(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from words(inner)
    elif isinstance(value, str):
        yield value


@pytest.mark.parametrize("item", ITEMS, ids=lambda item: f"{item.type}")
def test_every_word_of_an_item_is_noted(item: Any) -> None:
    result = types.CallToolResult(content=[item])
    noted = "\n".join(texts_of(result))
    chosen = [word for word in words(item.model_dump(by_alias=True)) if "word" in word]
    assert chosen
    assert [word for word in chosen if word not in noted] == []
    assert "AAAA" not in noted


def test_what_is_structured_is_noted_and_an_empty_answer_is_an_answer() -> None:
    result = types.CallToolResult(content=[], structured_content={"word-a": {"word-b": ["ü"]}})
    assert list(texts_of(result)) == ['{"word-a": {"word-b": ["ü"]}}']
    told = answer_from(types.CallToolResult(content=[])).told
    assert told is not None
    assert told.texts == ("",)
