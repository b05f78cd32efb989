# SPDX-License-Identifier: Apache-2.0
"""The tools of a binding in the form in which models read tools: names, purposes, arguments.

Nothing of a mission is in it, and nothing of the gate. Arguments that the binding refuses, and
tools that no planner may use, are left out. Spec page: docs/spec/adapters.md#schemas
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import StrEnum
from typing import Any

from msgspec import Struct

from authguard_r.integrations.tools.argument_schema import (
    ArgumentSchemas,
    Schema,
    constant,
    nested,
    offered_of,
    required_of,
)
from authguard_r.normalize.binding import Binding, ToolBinding, ways_of
from authguard_r.site.model import Site


class ToolSchema(Struct, frozen=True):
    """One tool as a model is shown it: its name, what it is for, its arguments' JSON schema."""

    name: str
    description: str
    parameters: dict[str, Any]


class ToolForm(StrEnum):
    """The form in which a server of models takes tools."""

    OPENAI = "openai"  #: Chat Completions; also vLLM, Ollama and llama.cpp
    RESPONSES = "responses"
    ANTHROPIC = "anthropic"
    GEMINI = "gemini"
    BEDROCK = "bedrock"
    MCP = "mcp"

    def tools(self, schemas: Sequence[ToolSchema]) -> list[dict[str, Any]]:
        """Return tools as this form's requests have them under `tools`."""
        made = [self._one(schema) for schema in schemas]
        return [{"functionDeclarations": made}] if self is ToolForm.GEMINI else made

    def _one(self, tool: ToolSchema) -> dict[str, Any]:
        said = {"name": tool.name, "description": tool.description}
        match self:
            case ToolForm.OPENAI:
                return {"type": "function", "function": {**said, "parameters": tool.parameters}}
            case ToolForm.RESPONSES:
                return {"type": "function", **said, "parameters": tool.parameters, "strict": False}
            case ToolForm.ANTHROPIC:
                return {**said, "input_schema": tool.parameters}
            case ToolForm.GEMINI:
                return {**said, "parametersJsonSchema": tool.parameters}
            case ToolForm.BEDROCK:
                return {"toolSpec": {**said, "inputSchema": {"json": tool.parameters}}}
        return {**said, "inputSchema": tool.parameters}


def tool_schemas(
    binding: Binding,
    site: Site,
    *,
    arguments: ArgumentSchemas | None = None,
    usable: Callable[[ToolBinding], bool] = lambda _: True,
) -> tuple[ToolSchema, ...]:
    """Return the tools of a binding, in its order.

    Args:
        binding: the planner's interface.
        site: whose words its actions are.
        arguments: makes the schemas of arguments; None: with the site's names and ranges.
        usable: tells whether a way of a tool is offered.
    """
    words = ArgumentSchemas(site) if arguments is None else arguments
    offered = []
    for name in binding.tools:
        ways = [
            way.tool
            for way in ways_of(binding, name)
            if not site.vocabulary[way.tool.type].state_writing and usable(way.tool)
        ]
        if ways:
            offered.append(_tool(name, ways, words))
    return tuple(offered)


def _tool(name: str, ways: list[ToolBinding], words: ArgumentSchemas) -> ToolSchema:
    """Return one tool; where it can be used in several ways, what each of them takes."""
    schemas: dict[str, Schema] = {}
    needed: list[set[str]] = []
    for way in ways:
        offered = offered_of(way.arguments)
        for path, argument in offered:
            _take_in(schemas, path, words.of(way, path, argument))
        for path, value in way.when.items():
            _take_in(schemas, path, constant(value))
        needed.append({*required_of(offered), *way.when})
    always = set.intersection(*needed)
    required = [path for path in schemas if path in always]
    kinds = dict.fromkeys(str(way.type).replace("_", " ") for way in ways)
    return ToolSchema(
        name=name,
        description=f"{' or '.join(kinds)}, with the {ways[0].tool}.".capitalize(),
        parameters=nested(schemas, required=required),
    )


def _take_in(schemas: dict[str, Schema], path: str, schema: Schema) -> None:
    """Let an argument be what it is in one more way of its tool."""
    held = schemas.setdefault(path, schema)
    if held == schema:
        return
    if set(held) == set(schema) == {"enum"}:
        new = [one for one in schema["enum"] if one not in held["enum"]]
        schemas[path] = {"enum": [*held["enum"], *new]}
        return
    others = held.get("anyOf", [held])
    schemas[path] = {"anyOf": others if schema in others else [*others, schema]}
