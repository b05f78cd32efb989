# SPDX-License-Identifier: Apache-2.0
"""The JSON schema of a plan: the tools that are offered, with names as choices.

Servers that can (llama.cpp, vLLM, Ollama, OpenAI) let the model write nothing else. What has no
upper end in a tool's own schema gets one here, so that an answer comes to its end.
"""

from __future__ import annotations

from typing import Any

from missionpair.briefing import OfferedTool

#: Most characters of a free text, items of a list, and calls of a plan.
_TEXT, _ITEMS, _CALLS = 80, 8, 40


def plan_schema(tools: tuple[OfferedTool, ...], *, most: int | None = None) -> dict[str, Any]:
    """Return the schema of an answer.

    Args:
        tools: what may be called.
        most: calls that one answer may have; None: as many as any plan needs.
    """
    calls = [
        _object({"tool": {"const": tool.name}, "arguments": _ended(tool.parameters)})
        for tool in tools
    ]
    items = {"type": "array", "items": {"anyOf": calls}, "maxItems": most or _CALLS}
    return _object({"plan": items})


def _object(properties: dict[str, Any]) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }


def _ended(schema: dict[str, Any]) -> dict[str, Any]:
    """Return a schema whose texts and lists have an end."""
    made = dict(schema)
    if "properties" in made:
        made["properties"] = {name: _ended(one) for name, one in made["properties"].items()}
    if "items" in made:
        made["items"] = _ended(made["items"])
    if "anyOf" in made:
        made["anyOf"] = [_ended(one) for one in made["anyOf"]]
    if made.get("type") == "string" and "enum" not in made:
        made.setdefault("maxLength", _TEXT)
    if made.get("type") == "array":
        made.setdefault("maxItems", _ITEMS)
    return made
