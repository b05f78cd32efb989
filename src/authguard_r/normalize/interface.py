# SPDX-License-Identifier: Apache-2.0
"""What a planner's interface says of itself: tools and messages with every leaf field.

Read from an MCP `tools/list`, an OpenAI tools array or its lines (BFCL), a list of signatures
(ROSA), a ROS definition or a list of names. Only names are taken from it: a server's word that a
tool is harmless decides nothing (L1). Spec page: docs/spec/binding.md#interfaces
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import PurePath
from typing import Any

from msgspec import Struct

from authguard_r.core.errors import MalformedError
from authguard_r.normalize.binding import (
    Argument,
    ArgumentUse,
    Binding,
    ToolBinding,
    ToolWay,
    is_index,
    ways,
)
from authguard_r.normalize.parse import read_json
from authguard_r.normalize.shipped import FOLDER, INTERFACES, read_shipped, shipped_names
from authguard_r.site.strict import convert

#: Stands for the items of a list within a path: `poses.[].header.frame_id`.
ITEM = "[]"
#: Ends a listed field whose inside the interface does not say.
_OPEN = ".*"
_ROS = {".action", ".srv", ".msg"}
_ROS_FIELD = re.compile(
    r"(?P<type>[A-Za-z0-9_/]+)(?P<list>\[[^\]]*\])?\s+(?P<name>[a-z][a-z0-9_]*)"
)
#: The messages that definitions share, as ROS 2 has them; what is not here stays closed.
_MESSAGES: dict[str, str] = {
    "Constraints": (
        "name joint_constraints:JointConstraint[] position_constraints orientation_constraints "
        "visibility_constraints"
    ),
    "JointConstraint": "joint_name position tolerance_above tolerance_below weight",
    "MotionPlanRequest": (
        "workspace_parameters start_state goal_constraints:Constraints[] path_constraints "
        "trajectory_constraints reference_trajectories pipeline_id planner_id group_name "
        "num_planning_attempts allowed_planning_time max_velocity_scaling_factor "
        "max_acceleration_scaling_factor cartesian_speed_limited_link max_cartesian_speed"
    ),
    "PlanningOptions": (
        "planning_scene_diff plan_only look_around look_around_attempts max_safe_execution_cost "
        "replan replan_attempts replan_delay"
    ),
    "builtin_interfaces/Duration": "sec nanosec",
    "builtin_interfaces/Time": "sec nanosec",
    "geometry_msgs/Point": "x y z",
    "geometry_msgs/Pose": "position:geometry_msgs/Point orientation:geometry_msgs/Quaternion",
    "geometry_msgs/PoseStamped": "header:std_msgs/Header pose:geometry_msgs/Pose",
    "geometry_msgs/PoseWithCovariance": "pose:geometry_msgs/Pose covariance",
    "geometry_msgs/PoseWithCovarianceStamped": (
        "header:std_msgs/Header pose:geometry_msgs/PoseWithCovariance"
    ),
    "geometry_msgs/Quaternion": "x y z w",
    "geometry_msgs/Twist": "linear:geometry_msgs/Vector3 angular:geometry_msgs/Vector3",
    "geometry_msgs/TwistStamped": "header:std_msgs/Header twist:geometry_msgs/Twist",
    "geometry_msgs/Vector3": "x y z",
    "nav_msgs/Goals": "header:std_msgs/Header goals:geometry_msgs/PoseStamped[]",
    "nav_msgs/Path": "header:std_msgs/Header poses:geometry_msgs/PoseStamped[]",
    "std_msgs/Header": "stamp:builtin_interfaces/Time frame_id",
    "std_msgs/String": "data",
}


class Surface(Struct, frozen=True):
    """One tool or message with the fields that a planner can set.

    Args:
        name: the tool's external name, or the message's without its package.
        message: it is a ROS message, found in a binding by its type.
        leaves: the path of every field.
        open: those of them whose inside the interface does not say.
    """

    name: str
    message: bool
    leaves: tuple[str, ...]
    open: frozenset[str]


class _Listing(Struct, frozen=True, forbid_unknown_fields=True):
    """The short form of an interface: the fields of each tool and each message."""

    tools: dict[str, str] = {}
    messages: dict[str, str] = {}


def read_interface(text: str, *, name: str) -> tuple[Surface, ...]:
    """Return what a definition says, in its order.

    Args:
        text: the definition; untrusted.
        name: the file's name; its ending tells a ROS definition, its stem names the message.

    Raises:
        MalformedError: no form that is known.
    """
    path = PurePath(name)
    if path.suffix in _ROS:
        return (_surface(path.stem, _ros_fields(text, where=name), message=True),)
    found = [_tool(item, where) for item, where in _items(text, name)]
    merged: dict[str, dict[str, bool]] = {}
    for tool, fields in found:  # one name in two modules: the binding must know the fields of both
        merged.setdefault(tool, {}).update(fields)
    return tuple(_surface(tool, fields, message=False) for tool, fields in merged.items())


def listed_interface(data: Any, *, where: str) -> tuple[Surface, ...]:
    """Return an interface that is listed in short: its tools and messages, each with its fields.

    Args:
        data: `{tools: {NAME: FIELDS}, messages: {NAME: FIELDS}}`, both optional; FIELDS are paths
            with spaces between. A `.*` behind one: what is below it the interface does not say.
        where: the place, for messages.

    Raises:
        MalformedError: no such list.
    """
    listing = convert(data, _Listing, where=where)
    return tuple(
        _surface(
            name,
            {field.removesuffix(_OPEN): field.endswith(_OPEN) for field in words.split()},
            message=message,
        )
        for message, group in ((False, listing.tools), (True, listing.messages))
        for name, words in group.items()
    )


def interface_faults(
    binding: Binding, surfaces: tuple[Surface, ...]
) -> Iterator[tuple[str, str, bool]]:
    """Yield place, message and whether a field is unmapped, for all that does not meet.

    Every tool and field of the interface must be bound, and nothing bound that is not there.
    """
    tools = {surface.name for surface in surfaces if not surface.message}
    for surface in surfaces:
        bound = [way for way in ways(binding) if _is_of(way.name, way.tool, surface)]
        if not bound:
            yield surface.name, "expected a binding for it", True
        for way in bound:
            fields = _bound_fields(way.tool, surface)
            for leaf in surface.leaves:
                if not _covers(fields, leaf, is_open=leaf in surface.open):
                    yield f"{way.place}.arguments", f"expected the field `{leaf}`", True
            for names in fields:
                if not any(_exists(name, surface) for name in names):
                    yield f"{way.place}.arguments.{names[0]}", "expected a field that exists", False
    for name in binding.tools if tools else ():
        if name not in tools:
            yield f"tools.{name}", "expected a tool that exists", False


def uncompared(binding: Binding, surfaces: tuple[Surface, ...]) -> Iterator[ToolWay]:
    """Yield the ways of which the interface says nothing: neither their tool nor their message."""
    for way in ways(binding):
        if not any(_is_of(way.name, way.tool, surface) for surface in surfaces):
            yield way


def shipped_interface(name: str) -> tuple[Surface, ...] | None:
    """Return the tools and fields that a shipped binding is for; None when none is called so.

    Args:
        name: compared exactly.
    """
    if name not in shipped_names():
        return None
    where = f"{name} interface"
    return listed_interface(read_shipped(name, FOLDER, INTERFACES), where=where)


def _is_of(name: str, tool: ToolBinding, surface: Surface) -> bool:
    if surface.message:
        return tool.message.rpartition("/")[2] == surface.name
    return name == surface.name


def _bound_fields(tool: ToolBinding, surface: Surface) -> dict[tuple[str, ...], bool]:
    """Return the names of each bound path, and whether all that is below it is bound with it."""
    bound = dict(_paths(tool.arguments)) | {(path,): False for path in tool.when}
    found = {tuple(map(_uncounted, names)): whole for names, whole in bound.items()}
    if not surface.message or not tool.body:
        return found
    below = f"{tool.body}."
    return {
        (f"{names[0]}.".removeprefix(below).removesuffix("."),): whole
        for names, whole in found.items()
        if f"{names[0]}.".startswith(below)
    }


def _uncounted(path: str) -> str:
    """Return a path with `[]` for the number of a list's item; the first name is no list's."""
    first, *rest = path.split(".")
    return ".".join([first, *(ITEM if is_index(name) else name for name in rest)])


def _paths(arguments: dict[str, Argument]) -> Iterator[tuple[tuple[str, ...], bool]]:
    for path, argument in arguments.items():
        for (below, *_), whole in _paths(argument.each):
            yield (f"{path}.{ITEM}.{below}",), whole
        if not argument.each:
            yield (path, *argument.also), argument.use in {ArgumentUse.REFUSED, ArgumentUse.NOTED}


def _covers(fields: dict[tuple[str, ...], bool], leaf: str, *, is_open: bool) -> bool:
    return any(
        name == leaf or (is_open and _within(name, leaf)) or (whole and _within(leaf, name))
        for names, whole in fields.items()
        for name in names
    )


def _exists(field: str, surface: Surface) -> bool:
    return any(
        field == leaf or _within(leaf, field) or (leaf in surface.open and _within(field, leaf))
        for leaf in surface.leaves
    )


def _within(path: str, outer: str) -> bool:
    """True when a path is below another; everything is below the empty one."""
    return not outer or path.startswith(f"{outer}.")


def _surface(name: str, fields: dict[str, bool], *, message: bool) -> Surface:
    opened = frozenset(path for path, is_open in fields.items() if is_open)
    return Surface(name, message, tuple(fields), opened)


def _items(text: str, name: str) -> Iterator[tuple[Any, str]]:
    """Yield each tool's description: of one JSON value, or of one a line."""
    lines = [line for line in text.splitlines() if line.strip()]
    if len(lines) > 1 and all(
        line.startswith("{") and line.rstrip().endswith("}") for line in lines
    ):
        for number, line in enumerate(lines, 1):
            yield read_json(line, where=f"{name}:{number}"), f"{name}:{number}"
        return
    value = read_json(text, where=name)
    if isinstance(value, dict) and isinstance(value.get("result"), dict):
        value = value["result"]
    if isinstance(value, dict):
        value = value.get("tools", [value])
    if not isinstance(value, list):
        raise MalformedError("expected a list of tools", where=name)
    for number, item in enumerate(value):
        yield item, f"{name}:tools[{number}]"


def _tool(item: Any, where: str) -> tuple[str, dict[str, bool]]:
    """Return a tool's name and its fields, whichever form it is described in."""
    if isinstance(item, dict) and isinstance(item.get("function"), dict):
        item = item["function"]
    if not isinstance(item, dict) or not isinstance(item.get("name"), str):
        raise MalformedError("expected a tool with a name", where=where)
    if isinstance(item.get("args"), list):
        return item["name"], dict(_signature(item["args"], where))
    for key in ("inputSchema", "parameters", "input_schema"):
        if isinstance(item.get(key), dict):
            return item["name"], dict(_schema(item[key]))
    raise MalformedError("expected a schema or a signature of its arguments", where=where)


def _signature(arguments: list[Any], where: str) -> Iterator[tuple[str, bool]]:
    for argument in arguments:
        if not isinstance(argument, dict) or not isinstance(argument.get("name"), str):
            raise MalformedError("expected arguments with names", where=where)
        kind = str(argument.get("type", ""))
        yield argument["name"], kind not in {"str", "int", "float", "bool"}


def _schema(schema: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, bool]]:
    """Yield the leaves of a JSON schema; an object without properties stays closed: it is open."""
    properties = schema.get("properties")
    for name, below in (properties if isinstance(properties, dict) else {}).items():
        path = f"{prefix}{name}"
        inner = below if isinstance(below, dict) else {}
        items = inner.get("items")
        if isinstance(inner.get("properties"), dict) and inner["properties"]:
            yield from _schema(inner, f"{path}.")
        elif isinstance(items, dict) and isinstance(items.get("properties"), dict):
            yield from _schema(items, f"{path}.{ITEM}.")
        else:
            yield path, inner.get("type") not in {"string", "integer", "number", "boolean", "float"}


def _ros_fields(text: str, *, where: str) -> dict[str, bool]:
    """Return the fields of a goal, a request or a message; results and constants are not set."""
    fields: dict[str, bool] = {}
    for line in text.splitlines():
        bare = line.partition("#")[0].strip()
        if bare == "---":
            break
        if not bare or re.search(r"^\S+\s+\w+\s*=", bare):
            continue
        found = _ROS_FIELD.match(bare)
        if found is None:
            raise MalformedError(f"expected a ROS field, got `{ascii(bare)[1:60]}`", where=where)
        fields.update(_ros_leaves(found["name"], found["type"], is_list=bool(found["list"])))
    return fields


def _ros_leaves(path: str, kind: str, *, is_list: bool) -> Iterator[tuple[str, bool]]:
    inner = _MESSAGES.get(kind)
    if inner is None:
        yield path, is_list or "/" in kind or kind[:1].isupper()
        return
    base = f"{path}.{ITEM}" if is_list else path
    for field in inner.split():
        name, _, below = field.partition(":")
        yield from _ros_leaves(
            f"{base}.{name}", below.removesuffix("[]"), is_list=below.endswith("[]")
        )
