# SPDX-License-Identifier: Apache-2.0
"""The courier's tools as an MCP server, as its vendor would ship it: it does what it is told.

    python examples/mcp/courier.py

It moves nothing: it says what it was asked for on standard error.
"""

from __future__ import annotations

import asyncio
import json
import sys
from typing import Any

import mcp_types as types
from mcp.server.lowlevel import Server
from mcp.server.stdio import stdio_server

#: The arguments of each tool, with their kinds.
TOOLS: dict[str, dict[str, str]] = {
    "navigate_to": {"destination": "string", "via": "array", "speed": "number"},
    "pick_up": {"object": "string", "force": "number"},
    "put_down": {"object": "string", "at": "string", "force": "number"},
    "relocalize": {"place": "string"},
    "record_video": {"seconds": "number"},
    "say": {"text": "string"},
    "scan": {},
    "take_photo": {},
    "wait": {"seconds": "number"},
}


async def list_tools(ctx: Any, params: Any) -> types.ListToolsResult:  # noqa: ARG001
    """Return every tool."""
    tools = []
    for name, arguments in TOOLS.items():
        properties = {argument: {"type": kind} for argument, kind in arguments.items()}
        schema = {"type": "object", "properties": properties}
        tools.append(types.Tool(name=name, description=f"Does {name}.", input_schema=schema))
    return types.ListToolsResult(tools=tools)


async def call_tool(ctx: Any, params: types.CallToolRequestParams) -> types.CallToolResult:  # noqa: ARG001
    """Do what is asked for, whoever asks."""
    sys.stderr.write(json.dumps({params.name: params.arguments or {}}) + "\n")
    return types.CallToolResult(content=[types.TextContent(type="text", text="done")])


async def main() -> None:
    """Serve one client over standard input and output."""
    server: Server[Any] = Server("courier", on_list_tools=list_tools, on_call_tool=call_tool)
    async with stdio_server() as (read, write):
        await server.run(read, write, server.create_initialization_options())


if __name__ == "__main__":
    asyncio.run(main())
