# SPDX-License-Identifier: Apache-2.0
"""What a tools' server said of its tools, kept: a later word of it counts for nothing.

A description is read by the planner's model, so a server that changes one speaks to the planner
past every gate. What is shown is what was kept; a server whose tools differ is not used.
Spec page: docs/spec/mcp.md#pins
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import mcp_types as types
import msgspec
from msgspec import Struct

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.keys.trust import read_file

SCHEMA = "authguard-r/mcp-tools/2"
#: Kept names, descriptions and inputs alone: a server could change all else that it says.
_OLD = "authguard-r/mcp-tools/1"
#: Most that a server may say of its tools, in bytes.
MAX_PINS = 4 << 20


class Pin(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One tool, as its server describes it.

    Args:
        name: its name.
        description: what it is for; the planner is shown it.
        schema: of its arguments; the planner is shown it.
        more: all else that is said of it, by the protocol's names. The planner is shown none of it.
    """

    name: str
    description: str = ""
    schema: dict[str, Any] = {}
    more: dict[str, Any] = {}


class Pins(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Every tool of a server, by name."""

    schema: str
    tools: tuple[Pin, ...]

    def differ(self, other: Pins) -> tuple[str, ...]:
        """Return the names of tools that the two do not have alike, sorted."""
        one, two = ({pin.name: pin for pin in pins.tools} for pins in (self, other))
        names = sorted(one.keys() | two.keys())
        return tuple(name for name in names if one.get(name) != two.get(name))


def pins_of(tools: Iterable[types.Tool]) -> Pins:
    """Return what a server lists, as it is kept.

    Raises:
        MalformedError: two tools have one name.
    """
    pins = sorted(map(_pin_of, tools), key=lambda pin: pin.name)
    names = [pin.name for pin in pins]
    if len(set(names)) != len(names):
        raise MalformedError("expected one tool of each name", where="tools")
    return Pins(schema=SCHEMA, tools=tuple(pins))


def _pin_of(tool: types.Tool) -> Pin:
    said = tool.model_dump(mode="json", by_alias=True, exclude_none=True)
    shown = {"name", "description", "inputSchema"}
    return Pin(
        name=tool.name,
        description=tool.description or "",
        schema=dict(tool.input_schema),
        more={name: said[name] for name in sorted(said.keys() - shown)},
    )


def read_pins(path: Path) -> Pins:
    """Return the pins in a file.

    Raises:
        MalformedError: it is no such file.
        EnvironmentFault: it cannot be read.
    """
    data = read_file(path)
    try:
        found = msgspec.json.decode(data, type=Pins)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise MalformedError(str(error), where=str(path), reason=Reason.SCHEMA_INVALID) from error
    if found.schema == _OLD:
        raise MalformedError(
            "these pins lack a part of the server's tool list: write them again with "
            "`authguard advanced mcp-tools --out`, and compare them",
            where=str(path),
            reason=Reason.SCHEMA_INVALID,
        )
    if found.schema != SCHEMA:
        raise MalformedError(f"expected `{SCHEMA}`", where=str(path), reason=Reason.SCHEMA_INVALID)
    return found


def pins_bytes(pins: Pins) -> bytes:
    """Return the bytes of a file of pins, for people to read and compare."""
    return msgspec.json.format(msgspec.json.encode(pins), indent=1) + b"\n"
