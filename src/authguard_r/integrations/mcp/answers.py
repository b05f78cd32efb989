# SPDX-License-Identifier: Apache-2.0
"""What a tool's server answered, as the planner sees it, and every word in it.

What a server says about its own answer decides nothing; the words are for the ledger of what the
planner has seen. Spec page: docs/spec/mcp.md#results
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import mcp_types as types

from authguard_r.client.controller import ExecutionNews
from authguard_r.integrations.tools.server import WITHHELD, ToolAnswer, fits

_TOO_LONG = types.CallToolResult(
    content=[types.TextContent(type="text", text=WITHHELD)], is_error=True
)


def answer_from(result: types.CallToolResult) -> ToolAnswer:
    """Return a result as a body reads it, and as it passes through the gate."""
    told = _told_of(result)
    return ToolAnswer(
        is_error=bool(result.is_error),
        structured=result.structured_content,
        text="\n".join(i.text for i in result.content if isinstance(i, types.TextContent)),
        told=told if fits(told) else _told_of(_TOO_LONG),
    )


def _told_of(result: types.CallToolResult) -> ExecutionNews:
    content = result.model_dump_json(by_alias=True, exclude_none=True).encode()
    return ExecutionNews(content, tuple(texts_of(result)) or ("",))


def answer_of(content: bytes) -> types.CallToolResult:
    """Return the answer again, without what its server claimed about it.

    Raises:
        ValueError: it is not valid.
    """
    return types.CallToolResult.model_validate_json(content).model_copy(update={"meta": None})


def texts_of(result: types.CallToolResult) -> Iterator[str]:
    """Yield every word that a model could read; of a picture or a sound, that there is one."""
    for item in result.content:
        yield from _words(item.model_dump(mode="json", by_alias=True, exclude_none=True))
    if result.structured_content is not None:
        yield json.dumps(result.structured_content, ensure_ascii=False)


def _words(fields: dict[str, Any]) -> Iterator[str]:
    """Yield what stands in an item, title and media type too: its server wrote all of it."""
    for name, value in fields.items():
        if name in {"data", "blob"}:
            yield ""
        elif name == "resource":
            yield from _words(value)
        elif name != "type":  # the protocol's own word
            yield value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
