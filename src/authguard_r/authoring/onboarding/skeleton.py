# SPDX-License-Identifier: Apache-2.0
"""A set-up in which every call of every tool is refused, as the files that a person goes on with.

A tool is bound to a type that no grant can hold (`unheld`), each of its fields is `refused`; the
site has one place that was not reviewed and a robot that can do nothing. What is added later is
added by a person. How-to: docs/howto/onboarding.md
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from typing import Any

from msgspec import Struct

from authguard_r.authoring.binding.check import BindingReport, check_binding
from authguard_r.authoring.onboarding.graph import OPERATIONS, GraphEntry, read_ros
from authguard_r.authoring.onboarding.listing import ListedTool, Source, read_mcp, read_openai
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import RobotId
from authguard_r.normalize.binding import Binding
from authguard_r.normalize.interface import ITEM, listed_interface
from authguard_r.site.check import UNREVIEWED
from authguard_r.site.model import Site
from authguard_r.site.source import convert, parse_site, read_yaml, require_sound

#: The type of a call that no grant can describe or hold: it is always refused.
UNHELD = "unheld"
_REFUSED = "{use: refused}"


class Skeleton(Struct, frozen=True, kw_only=True):
    """The three files of a set-up, proven to refuse everything.

    Args:
        site: text of the site model.
        binding: text of the binding.
        interface: text of the list, in the short form that `binding check` compares with.
        model: the site, as read.
        report: what the check of the binding found: no fault, nothing unmapped.
    """

    site: str
    binding: str
    interface: str
    model: Site
    report: BindingReport


class _RefusedWay(Struct, frozen=True):
    """One refused way: the tool, what distinguishes it, its fields, its ROS message and body."""

    tool: str
    when: dict[str, str]
    paths: tuple[str, ...]
    message: str = ""
    body: str = ""


def make_skeleton(text: str, *, source: Source, robot: RobotId, where: str) -> Skeleton:
    """Return the set-up for a tool list.

    Args:
        text: the list; untrusted.
        source: what kind of list it is.
        robot: what the robot is to be called.
        where: the list's name, for places.

    Raises:
        MalformedError: not such a list, or one that a binding cannot hold; with the place.
    """
    tools: Callable[[], tuple[tuple[_RefusedWay, ...], str]] = {
        Source.MCP: lambda: _of_tools(read_mcp(text, where=where)),
        Source.OPENAI: lambda: _of_tools(read_openai(text, where=where)),
        Source.ROS: lambda: _of_graph(read_ros(text, where=where)),
    }[source]
    ways, interface = tools()
    binding, site = _binding_text(ways), site_text(robot)
    model = require_sound(parse_site(site, where="site.yaml"), where="site.yaml")
    return Skeleton(
        site=site,
        binding=binding,
        interface=interface,
        model=model,
        report=_proven(binding, interface, model, where),
    )


def _proven(binding: str, interface: str, site: Site, where: str) -> BindingReport:
    """Return the check's answer on the very texts that are to be written.

    Raises:
        MalformedError: they hold less than the list says, or are longer than a file may be.
    """
    found = convert(read_yaml(binding, where=where), Binding, where=where)
    surfaces = listed_interface(read_yaml(interface, where=where), where=where)
    report = check_binding(found, site, interface=surfaces)
    for fault in report.faults:
        raise MalformedError(fault.message, where=f"{where}: {fault.where}")
    return report


def _of_tools(tools: tuple[ListedTool, ...]) -> tuple[tuple[_RefusedWay, ...], str]:
    ways = tuple(_RefusedWay(tool.name, {}, _paths(tool.fields)) for tool in tools)
    return ways, _interface_text({tool.name: tool.fields for tool in tools}, {})


def _of_graph(found: tuple[GraphEntry, ...]) -> tuple[tuple[_RefusedWay, ...], str]:
    """Return a way for each topic, service and action, and what rosbridge itself takes."""
    ways: list[_RefusedWay] = []
    tools: dict[str, dict[str, bool]] = {}
    messages: dict[str, list[dict[str, bool]]] = {}
    for item in found:
        operation, name, kind, body = OPERATIONS[item.kind]
        tools[operation] = {name: False, kind: False, body: True}
        below = tuple(f"{body}.{path}" for path in _paths(item.fields or {}))
        paths = (kind, *(below or (body,)))
        ways.append(
            _RefusedWay(operation, {name: item.name}, paths, item.type, body if item.type else "")
        )
        if item.fields:
            messages.setdefault(item.type.rpartition("/")[2], []).append(item.fields)
    told = {name: shapes[0] for name, shapes in messages.items() if _agree(shapes)}
    return tuple(ways), _interface_text(tools, told)


def _agree(shapes: list[dict[str, bool]]) -> bool:
    """True when types of one name have the same fields: the check knows them by name alone."""
    return all(shape == shapes[0] for shape in shapes)


def _paths(fields: dict[str, bool]) -> tuple[str, ...]:
    """Return where fields are refused; what is within the items of a list, with the list."""
    return tuple(dict.fromkeys(path.partition(f".{ITEM}")[0] for path in fields))


def quoted(text: str) -> str:
    """Return text as YAML and JSON both read it, in ASCII."""
    return json.dumps(text)


def _interface_text(tools: dict[str, Any], messages: dict[str, Any]) -> str:
    lines = ["# The tools' own description; `binding check --interface` compares with it."]
    for group, members in (("tools", tools), ("messages", messages)):
        lines += [f"{group}:"] if members else []
        for name, fields in members.items():
            words = " ".join(f"{path}.*" if is_open else path for path, is_open in fields.items())
            lines.append(f"  {quoted(name)}: {quoted(words)}")
    return "\n".join(lines) + "\n"


def _binding_text(ways: tuple[_RefusedWay, ...]) -> str:
    grouped: dict[str, list[_RefusedWay]] = {}
    for way in ways:
        grouped.setdefault(way.tool, []).append(way)
    lines = [
        "# Every call of every tool is refused. To allow one, give it the type that it means and",
        "# say what each field means: docs/howto/bindings.md.",
        "schema: authguard-r/binding/1",
        "id: tools",
        "tools:",
    ]
    for tool, group in grouped.items():
        lines.append(f"  {quoted(tool)}:")
        for way in group:
            first, rest = ("    - ", "      ") if way.when else ("    ", "    ")
            body = list(_way_lines(way))
            lines += [f"{first if n == 0 else rest}{line}" for n, line in enumerate(body)]
    return "\n".join(lines) + "\n"


def _way_lines(way: _RefusedWay) -> Iterator[str]:
    yield f"type: {UNHELD}"
    yield f"tool: {UNHELD}"
    if way.when:
        held = ", ".join(f"{name}: {quoted(value)}" for name, value in way.when.items())
        yield f"when: {{{held}}}"
    if way.message:
        yield f"message: {quoted(way.message)}"
        yield f"body: {way.body}"
    if way.paths:
        yield "arguments:"
        yield from (f"  {quoted(path)}: {_REFUSED}" for path in way.paths)


def site_text(robot: RobotId) -> str:
    """Return a sound site of one place for a robot that can do nothing.

    Args:
        robot: its id.
    """
    return f"""\
# A skeleton. It is sound and says nothing of your place yet: docs/howto/site.md.
schema: authguard-r/site/1
id: my-site
version: 1

# One canonical type for each effect; list those that the robot has, or add your own.
words: standard

# In millimeters. `{UNREVIEWED}` marks what you have to review before you can sign the site.
regions:
  home:
    map: map
    floor: 0
    points: [[0, 0], [1000, 0], [1000, 1000], [0, 1000]]
    approach: [500, 500]
    tags: [{UNREVIEWED}]
    names: []

# From one place into the next it goes through a door: - {{between: [home, ...], at: [1000, 500]}}
doors: []

objects: {{}}

# What the robot can do at all. Nothing yet: list action types with their tools, and
# the numbers of its data sheet. The gate's certificate binds this profile: after a change of it,
# make the keys again.
robots:
  {quoted(robot)}:
    home: home
    profile:
      tools: {{}}
      max_speed_mm_s: 0
      max_force_mn: 0
      max_payload_g: 0
"""
