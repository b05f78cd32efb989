# SPDX-License-Identifier: Apache-2.0
"""`authguard mcp`: a robot's MCP server behind its gate."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from authguard_r.access.files import read_binding
from authguard_r.cli.inputs import BindingOption, JsonFlag, SiteOption, TrustOption, load_site
from authguard_r.core.identifiers import RobotId
from authguard_r.keys.files import write_whole
from authguard_r.keys.trust import read_trust
from authguard_r.normalize.dialects import Call
from authguard_r.wire.output import emit

RunOption = Annotated[Path, typer.Option("--gate", help="The gate's run folder.")]


_ServerArgument = Annotated[
    list[str],
    typer.Argument(metavar="SERVER...", help="The MCP server: its command, or its URL."),
]
_RobotOption = Annotated[str, typer.Option("--robot", help="The robot.")]
_PinsOption = Annotated[
    Path | None, typer.Option("--pins", help="File of pinned tools (`advanced mcp-tools --out`).")
]
_VariableOption = Annotated[
    list[str] | None,
    typer.Option("--env", help="Environment variable for the server: NAME or NAME=VALUE."),
]
_StopOption = Annotated[
    list[str] | None,
    typer.Option("--stop-call", help='Call that stops the robot: TOOL or TOOL={"argument": ...}.'),
]
_ListenOption = Annotated[
    str | None,
    typer.Option("--listen", help="Serve streamable HTTP on HOST:PORT of this machine."),
]
_BearerOption = Annotated[
    Path | None,
    typer.Option("--token-file", help="With --listen: file with the bearer token of the clients."),
]
_ShadowOption = Annotated[
    bool,
    typer.Option(
        "--shadow", help="Shadow mode: every call runs, and the gate records its decision."
    ),
]
_ClientOption = Annotated[str, typer.Option("--client", help="Name of the planner in the log.")]


def mcp_command(
    server: _ServerArgument,
    robot: _RobotOption,
    run: RunOption,
    site: SiteOption,
    binding: BindingOption,
    trust: TrustOption,
    pins: _PinsOption = None,
    variable: _VariableOption = None,
    stop: _StopOption = None,
    listen: _ListenOption = None,
    bearer: _BearerOption = None,
    shadow: _ShadowOption = False,
    client: _ClientOption = "mcp",
) -> int:
    """Serve the tools of a robot's MCP server to a planner, through the gate.

    Use this command in the client's configuration in place of the server's command. The client
    sees the bound tools. The gate decides each call, and the server gets only released calls.
    """
    from authguard_r.integrations.http_listener.access import listening, read_bearer
    from authguard_r.integrations.mcp.http_front import serve_http
    from authguard_r.integrations.mcp.pins import read_pins
    from authguard_r.integrations.mcp.process import GatewaySetup, over_stdio, serve

    if (listen is None) != (bearer is None):
        text = "a port does not identify the caller: give --listen with --token-file"
        raise typer.BadParameter(text, param_hint="--listen")

    model = load_site(site, trust)
    setup = GatewaySetup(
        robot=RobotId(robot),
        run=run,
        site=model,
        binding=read_binding(binding, model),
        trust=lambda: read_trust(trust),
        server=tuple(server),
        environment=dict(map(_variable, variable or ())),
        pins=None if pins is None else read_pins(pins),
        stops=tuple(map(_call, stop or ())),
        client=client,
        shadow=shadow,
    )
    read_trust(trust)  # what is missing is said now; each connection reads it anew
    if listen is None or bearer is None:
        asyncio.run(serve(setup, over_stdio))
        return 0
    token = read_bearer(bearer)
    with listening(listen) as made:
        host, port, *_ = made.getsockname()
        sys.stderr.write(f"serving http://{host}:{port}/mcp\n")
        asyncio.run(serve(setup, lambda front: serve_http(front, made, token)))
    return 0


def mcp_tools_command(
    server: Annotated[
        list[str],
        typer.Argument(metavar="SERVER...", help="The MCP server: its command, or its URL."),
    ],
    site: SiteOption,
    binding: BindingOption,
    out: Annotated[
        Path | None, typer.Option("--out", help="File for the pinned tools (`mcp --pins`).")
    ] = None,
    variable: Annotated[
        list[str] | None,
        typer.Option("--env", help="Environment variable for the server: NAME or NAME=VALUE."),
    ] = None,
    as_json: JsonFlag = False,
) -> int:
    """List the tools of a robot's MCP server, and what the gateway does with each.

    Exit 1 when binding and server do not have the same tools: the binding is for another version.
    """
    from authguard_r.integrations.mcp.front import fate
    from authguard_r.integrations.mcp.pins import pins_bytes
    from authguard_r.integrations.mcp.upstream import listed

    model = load_site(site)
    tools = read_binding(binding, model)
    pins = asyncio.run(listed(tuple(server), dict(map(_variable, variable or ()))))
    fates = {pin.name: fate(pin.name, tools, model) for pin in pins.tools}
    gone = sorted(set(tools.tools) - set(fates))
    if out is not None:
        write_whole(out, pins_bytes(pins))
    width = max(map(len, fates), default=0)
    lines = [f"{name.ljust(width)}  {text}" for name, text in fates.items()]
    lines += [f"bound, and the server has none: {', '.join(gone)}"] if gone else []
    emit({"tools": fates, "missing": gone}, lines, as_json=as_json)
    return 1 if "hidden: not bound" in fates.values() or gone else 0


def _call(text: str) -> Call:
    name, _, written = text.partition("=")
    try:
        arguments = json.loads(written or "{}")
    except (ValueError, RecursionError) as error:
        raise typer.BadParameter(f"expected JSON: {error}", param_hint="--stop-call") from error
    if not name or not isinstance(arguments, dict):
        raise typer.BadParameter('expected TOOL={"argument": ...}', param_hint="--stop-call")
    return Call(name, arguments, "--stop-call")


def _variable(text: str) -> tuple[str, str]:
    name, is_set, value = text.partition("=")
    if is_set:
        return name, value
    if name not in os.environ:
        raise typer.BadParameter(f"`{name}` is not set here", param_hint="--env")
    return name, os.environ[name]
