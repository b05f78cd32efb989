# SPDX-License-Identifier: Apache-2.0
"""ROS 2 goals, messages and service requests, in the words of the rosbridge protocol, version 2.

Only what acts on a robot is a call: subscribing, advertising and the like are refused with every
other operation. The message stays nested, so that a binding can settle each of its fields (L16).
Spec page: docs/spec/normalize.md#dialects
"""

from __future__ import annotations

import re
from typing import Any

from msgspec import Struct

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.dialects.call import Call, expect, expect_fields


class _Operation(Struct, frozen=True):
    """An operation: how its type is spelled, and its fields.

    Args:
        folder: what stands between package and name; ROS 1 leaves it out, as rosbridge lets one.
        texts: fields with text.
        objects: nested ones.
        optional: those of them that may be left out.
        beside: fields that change nothing that the robot does.
    """

    folder: str
    texts: frozenset[str]
    objects: frozenset[str]
    optional: frozenset[str]
    beside: frozenset[str] = frozenset()


_OLD_TYPE = re.compile(r"\A([A-Za-z0-9_]+)/([A-Za-z0-9_]+)\Z")
#: A goal without `args` would be all defaults of its message; an empty request is an ordinary one.
_OPERATIONS: dict[str, _Operation] = {
    "send_action_goal": _Operation(
        folder="action",
        texts=frozenset({"action", "action_type"}),
        objects=frozenset({"args"}),
        optional=frozenset(),
        beside=frozenset({"feedback"}),
    ),
    "publish": _Operation(
        folder="msg",
        texts=frozenset({"topic", "type"}),
        objects=frozenset({"msg"}),
        optional=frozenset({"type"}),
        beside=frozenset({"latch"}),
    ),
    "call_service": _Operation(
        folder="srv",
        texts=frozenset({"service", "type"}),
        objects=frozenset({"args"}),
        optional=frozenset({"type", "args"}),
    ),
}


def read_ros2(value: Any) -> tuple[Call, ...]:
    """Return the calls of one rosbridge operation, or of a list of them.

    The operation is the tool; its remaining fields are the arguments, nested as they stand. The
    `id` only matches answers to requests and is left out.

    Args:
        value: the operation as strict JSON spells it; untrusted.

    Raises:
        MalformedError: another operation, another field, or arguments without names.
    """
    if isinstance(value, dict):
        return (_operation(value, "input"),)
    items = expect(value, list, "input")
    return tuple(_operation(item, f"input[{number}]") for number, item in enumerate(items))


def _operation(item: Any, where: str) -> Call:
    operation = expect(item, dict, where)
    name = expect(operation.get("op"), str, f"{where}.op")
    known = _OPERATIONS.get(name)
    if known is None:
        raise MalformedError(
            f"expected {', '.join(f'`{op}`' for op in sorted(_OPERATIONS))}",
            where=f"{where}.op",
            reason=Reason.TOOL_UNKNOWN,
        )
    fields = known.texts | known.objects
    beside = {"op", "id", *known.beside}
    expect_fields(operation, beside | fields, where)
    expect(operation.get("id", ""), str, f"{where}.id")
    if type(operation.get("feedback", False)) is not bool:
        raise MalformedError("expected a truth value", where=f"{where}.feedback")
    if operation.get("latch", False) is not False:  # it would be sent again to who comes later
        raise MalformedError("expected `false`", where=f"{where}.latch")
    arguments = {field: it for field, it in operation.items() if field not in beside}
    for field in sorted(fields - (known.optional - arguments.keys())):
        kind = str if field in known.texts else dict
        expect(arguments.get(field), kind, f"{where}.{field}")
    for field in ("type", "action_type"):
        if isinstance(arguments.get(field), str):
            arguments[field] = _OLD_TYPE.sub(rf"\1/{known.folder}/\2", arguments[field])
    return Call(name, arguments, where)
