# SPDX-License-Identifier: Apache-2.0
"""ROS 2 goals, messages and service requests, in the words of the rosbridge protocol, version 2.

Only what acts on a robot is a call: subscribing, advertising and the like are refused with every
other operation. The message stays nested, so that a binding can settle each of its fields (L16).
Spec page: docs/spec/normalize.md#dialects
"""

from __future__ import annotations

from typing import Any

from msgspec import Struct

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize.dialects.call import Call, expect, expect_fields


class _Operation(Struct, frozen=True):
    """An operation's fields: text, nested objects, and those that may be left out."""

    texts: frozenset[str]
    objects: frozenset[str]
    optional: frozenset[str]


#: A goal without `args` would be all defaults of its message; an empty request is an ordinary one.
_OPERATIONS: dict[str, _Operation] = {
    "send_action_goal": _Operation(
        texts=frozenset({"action", "action_type"}),
        objects=frozenset({"args"}),
        optional=frozenset(),
    ),
    "publish": _Operation(
        texts=frozenset({"topic", "type"}),
        objects=frozenset({"msg"}),
        optional=frozenset({"type"}),
    ),
    "call_service": _Operation(
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
    expect_fields(operation, {"op", "id"} | fields, where)
    expect(operation.get("id", ""), str, f"{where}.id")
    arguments = {field: it for field, it in operation.items() if field not in {"op", "id"}}
    for field in sorted(fields - (known.optional - arguments.keys())):
        kind = str if field in known.texts else dict
        expect(arguments.get(field), kind, f"{where}.{field}")
    return Call(name, arguments, where)
