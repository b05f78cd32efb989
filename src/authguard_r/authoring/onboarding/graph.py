# SPDX-License-Identifier: Apache-2.0
"""What a ROS 2 graph offers, from a file: topics, services and actions with their types.

Read from the lines of `ros2 topic list -t` and the like, or from YAML or JSON that also holds
what `ros2 interface show` prints of the types. Nothing here speaks to a graph.
How-to: docs/howto/onboarding.md
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from enum import StrEnum

from msgspec import Struct

from authguard_r.authoring.onboarding.listing import MAX_FIELDS, Apart, require_few, require_path
from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.interface import ITEM, read_interface
from authguard_r.normalize.parse import MAX_DEPTH, read_json
from authguard_r.site.names import shown
from authguard_r.site.strict import convert, read_yaml

_NAME = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(?:/[A-Za-z_][A-Za-z0-9_]*)*")
_TYPE = re.compile(r"[a-z][a-z0-9_]*/(?P<kind>msg|srv|action)/[A-Za-z][A-Za-z0-9_]*")
_LINE = re.compile(r"(?P<name>\S+)\s+\[(?P<types>[^\]]*)\]")
_FIELD = re.compile(
    r"(?P<type>[A-Za-z][A-Za-z0-9_/]*)(?:<=[0-9]+)?(?P<list>\[[^\]]*\])?\s+"
    r"(?P<name>[a-z][a-z0-9_]*)(?:\s.*)?"
)
_CONSTANT = re.compile(r"\S+\s+\w+\s*=.*")
_LONGEST = 128


class InterfaceKind(StrEnum):
    """How a robot is reached in ROS 2."""

    TOPIC = "topic"
    SERVICE = "service"
    ACTION = "action"


#: How rosbridge names what it reaches: the operation, and the fields of its name, type and body.
OPERATIONS: dict[InterfaceKind, tuple[str, str, str, str]] = {
    InterfaceKind.TOPIC: ("publish", "topic", "type", "msg"),
    InterfaceKind.SERVICE: ("call_service", "service", "type", "args"),
    InterfaceKind.ACTION: ("send_action_goal", "action", "action_type", "args"),
}
_OF_TYPE = {
    "msg": InterfaceKind.TOPIC,
    "srv": InterfaceKind.SERVICE,
    "action": InterfaceKind.ACTION,
}


class GraphEntry(Struct, frozen=True):
    """One topic, service or action.

    Args:
        kind: which of them.
        name: its ROS name.
        type: its type; empty when it has several, of which a caller may choose.
        fields: the path of every field of a message, request or goal, true for one whose inside
            nothing says; None when nothing says what fields there are.
    """

    kind: InterfaceKind
    name: str
    type: str
    fields: dict[str, bool] | None


class _GraphFile(Struct, frozen=True, forbid_unknown_fields=True):
    """The form with definitions; each name with its type, or its types."""

    topics: dict[str, str | list[str]] = {}
    services: dict[str, str | list[str]] = {}
    actions: dict[str, str | list[str]] = {}
    types: dict[str, str] = {}


def read_ros(text: str, *, where: str) -> tuple[GraphEntry, ...]:
    """Return every topic, service and action of a list.

    Args:
        text: lines `NAME [TYPE]`, or a mapping of `topics`, `services`, `actions` and `types`;
            untrusted.
        where: the file's name, for places.

    Raises:
        MalformedError: with the line or the place.
    """
    bare = (line.partition("#")[0].strip() for line in text.splitlines())
    first = next((line for line in bare if line), "")
    if _LINE.fullmatch(first) or (first[:1] == "/" and ":" not in first):
        found, types = list(_of_lines(text, where)), {}
    else:
        graph = _graph(text, where)
        found, types = list(_of_graph(graph, where)), graph.types
    require_few(len(found), "topics, services or actions", where)
    fields = {kind: _fields(kind, shape, where) for kind, shape in types.items()}
    named = {kind: Apart(str(kind)) for kind in InterfaceKind}
    for kind, name, _, place in found:
        named[kind].add(name, place)
    return tuple(
        GraphEntry(kind, name, of_type, _known(of_type, fields)) for kind, name, of_type, _ in found
    )


def _graph(text: str, where: str) -> _GraphFile:
    if text.lstrip()[:1] == "{":
        return convert(read_json(text, where=where), _GraphFile, where=where)
    plain = read_yaml(text, where=where)
    if not isinstance(plain, dict):
        message = "expected lines `NAME [TYPE]`, or `topics`, `services`, `actions` and `types`"
        raise MalformedError(message, where=where)
    return convert(plain, _GraphFile, where=where)


def _of_lines(text: str, where: str) -> Iterator[tuple[InterfaceKind, str, str, str]]:
    for number, line in enumerate(text.splitlines(), 1):
        bare, place = line.partition("#")[0].strip(), f"{where}:{number}"
        if not bare:
            continue
        found = _LINE.fullmatch(bare)
        if found is None:
            message = f"expected `NAME [TYPE]`, as `ros2 topic list -t` prints, got `{shown(bare)}`"
            raise MalformedError(message, where=place)
        types = [item.strip() for item in found["types"].split(",")]
        kinds = {_kind_of(item, place) for item in types}
        if len(kinds) > 1:
            raise MalformedError("expected types of one kind", where=place)
        yield kinds.pop(), _ros_name(found["name"], place), _one(types), place


def _of_graph(graph: _GraphFile, where: str) -> Iterator[tuple[InterfaceKind, str, str, str]]:
    groups = (
        (InterfaceKind.TOPIC, graph.topics),
        (InterfaceKind.SERVICE, graph.services),
        (InterfaceKind.ACTION, graph.actions),
    )
    for kind, group in groups:
        for name, said in group.items():
            place = f"{where}:{kind}s.{shown(name)}"
            types = [said] if isinstance(said, str) else said
            if not types or any(_kind_of(item, place) is not kind for item in types):
                raise MalformedError(f"expected the type of a {kind}", where=place)
            yield kind, _ros_name(name, place), _one(types), place


def _one(types: list[str]) -> str:
    return types[0] if len(set(types)) == 1 else ""


def _ros_name(name: str, where: str) -> str:
    if len(name) > _LONGEST or _NAME.fullmatch(name) is None:
        raise MalformedError(f"expected a ROS name, got `{shown(name)}`", where=where)
    return name


def _kind_of(of_type: str, where: str) -> InterfaceKind:
    found = _TYPE.fullmatch(of_type) if len(of_type) <= _LONGEST else None
    if found is None:
        message = f"expected a type such as `std_msgs/msg/String`, got `{shown(of_type)}`"
        raise MalformedError(message, where=where)
    return _OF_TYPE[found["kind"]]


def _known(of_type: str, fields: dict[str, dict[str, bool]]) -> dict[str, bool] | None:
    """Return the fields of a type: as the list defines it, else as ROS 2 itself does."""
    if of_type in fields or not of_type:
        return fields.get(of_type)
    package, _, name = of_type.split("/")
    (surface,) = read_interface(f"{package}/{name} body", name="body.msg")
    if surface.leaves == ("body",):
        return None
    return {leaf.removeprefix("body."): leaf in surface.open for leaf in surface.leaves}


def _fields(of_type: str, shape: str, where: str) -> dict[str, bool]:
    """Return the fields of a definition, as it is written or as `ros2 interface show` prints it."""
    place = f"{where}:types.{shown(of_type)}"
    suffix = {
        InterfaceKind.TOPIC: "msg",
        InterfaceKind.SERVICE: "srv",
        InterfaceKind.ACTION: "action",
    }[_kind_of(of_type, place)]
    head = shape.partition("\n---")[0] if not shape.startswith("---") else ""
    if any(line[:1] in {"\t", " "} and line.strip() for line in head.splitlines()):
        found = _shown_fields(head, place)
    else:
        (surface,) = read_interface(shape, name=f"{place}.{suffix}")
        found = {leaf: leaf in surface.open for leaf in surface.leaves}
    if len(found) > MAX_FIELDS:
        message = f"expected at most {MAX_FIELDS} fields of one type"
        raise MalformedError(message, where=place, reason=Reason.INPUT_TOO_LARGE)
    for path in found:
        require_path(path, place)
    return found


def _shown_fields(text: str, where: str) -> dict[str, bool]:
    """Return the leaves of a definition in which each field's own fields stand below it."""
    found: dict[str, bool] = {}
    above: list[tuple[int, str]] = []
    for number, line in enumerate(text.splitlines(), 1):
        bare = line.partition("#")[0].rstrip()
        if not bare.strip() or _CONSTANT.fullmatch(bare.strip()):
            continue
        field = _FIELD.fullmatch(bare.strip())
        if field is None:
            message = f"expected a ROS field, got `{shown(bare.strip())}`"
            raise MalformedError(message, where=f"{where}:{number}")
        depth = len(bare) - len(bare.lstrip())
        while above and above[-1][0] >= depth:
            above.pop()
        if len(above) >= MAX_DEPTH:
            raise MalformedError(f"expected at most {MAX_DEPTH} levels", where=f"{where}:{number}")
        parent = above[-1][1] if above else ""
        found.pop(parent.removesuffix(f".{ITEM}"), None)
        path = f"{parent}.{field['name']}" if parent else field["name"]
        found[path] = bool(field["list"]) or "/" in field["type"] or field["type"][:1].isupper()
        above.append((depth, f"{path}.{ITEM}" if field["list"] else path))
    return found
