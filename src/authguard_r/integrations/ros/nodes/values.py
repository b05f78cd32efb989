# SPDX-License-Identifier: Apache-2.0
"""Messages as plain JSON data and back, without a guess; types by their names.

What a planner sent is read as what it says and no more: no NaN, no number of another kind. What is
sent to the robot is made from what was rebuilt, and from nothing else.
Spec page: docs/spec/ros.md#values
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from typing import Any, NamedTuple

from rosidl_parser.definition import (
    AbstractNestedType,
    AbstractString,
    AbstractWString,
    Array,
    BasicType,
    BoundedSequence,
    NamespacedType,
)

from authguard_r.core.errors import EnvironmentFault, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.integrations.ros.names import TypePart, part_of
from authguard_r.integrations.ros.transforms import Quaternion, is_unit

#: Most values of one message: more than any goal has, and soon refused.
MAX_VALUES = 20_000
_FLOATS = {"float": 32, "double": 64}
_BYTE = "octet"
_BOOL = "boolean"
_SINGLE = struct.Struct("<f")
#: Sequences of these may hold text that a reader decodes.
_TEXT = {_BYTE, "int8", "uint8", "char"}


def load_type(name: str, part: TypePart) -> Any:
    """Return the class of a type such as `std_srvs/srv/SetBool`, its type support loaded.

    Args:
        name: the type's.
        part: what it has to be.

    Raises:
        MalformedError: no name of such a type.
        EnvironmentFault: the type is not installed here, or cannot be loaded.
    """
    if part_of(name) is not part:
        raise MalformedError(f"expected `package/{part}/Name`, got `{name}`", where="type")
    package, _, last = name.split("/")
    try:
        found = getattr(import_module(f"{package}.{part}"), last)
        type(found).__import_type_support__()
    except (ImportError, AttributeError, OSError) as error:
        raise EnvironmentFault(
            f"expected the type `{name}` to be installed", reason=Reason.TOOL_UNKNOWN, where="type"
        ) from error
    return found


def asked_of(kind: Any, part: TypePart) -> Any:
    """Return the class of what planners send of a type: a goal, a request or the message."""
    asked = {TypePart.ACTION: "Goal", TypePart.SERVICE: "Request"}.get(part)
    return kind if asked is None else getattr(kind, asked)


def require_narrow(kind: Any, part: TypePart, *, where: str) -> None:
    """Require that what planners send of a type has no wide string.

    The Python of ROS 2 crashes on one whose units are no text, before it could be refused.

    Raises:
        MalformedError: it has one.
    """
    if any(_wide(asked_of(kind, part))):
        raise MalformedError("expected a type that planners send without `wstring`", where=where)


def plain_of(message: Any, *, where: str = "", is_asked: bool = False) -> dict[str, Any]:
    """Return a message as plain JSON data: what it holds, and nothing else.

    A number of 32 bits is the shortest decimal that means it.

    Args:
        message: untrusted.
        where: its place.
        is_asked: a consumer needs it: an orientation has to be one.

    Raises:
        MalformedError: an invalid number, or too much of everything; of what is asked for, a
            quaternion whose length is not 1.
    """
    return _MessageReader(is_asked=is_asked).message(message, where)


def message_of(kind: Any, plain: Any, *, where: str = "") -> Any:
    """Return a message that holds exactly this data; the type's default where it is silent.

    Args:
        kind: the message's class.
        plain: rebuilt from what was authorized.
        where: its place.

    Raises:
        MalformedError: a field that the type does not have, or a value that is not the field's.
    """
    if not isinstance(plain, dict):
        raise MalformedError("expected fields", where=where)
    fields = _fields(kind)
    unknown = sorted(map(str, plain.keys() - fields.keys()))
    if unknown:
        raise MalformedError("expected no such field", where=_below(where, unknown[0]))
    message = kind()
    for name, value in plain.items():
        setattr(message, name, _made(fields[name], value, _below(where, name)))
    return message


def has_path(kind: Any, path: str) -> bool:
    """Return whether a message's class has a field on a dotted path, which no list interrupts."""
    name, _, below = path.partition(".")
    field = _fields(kind).get(name)
    if not below:
        return field is not None and not isinstance(field, NamespacedType)
    if not isinstance(field, NamespacedType):
        return False
    return has_path(_class_of(tuple(field.namespaces), field.name), below)


def texts_of(message: Any) -> tuple[str, ...]:
    """Return every word in a message, each once, in the order in which they stand."""
    return tuple(dict.fromkeys(filter(None, _words_of(message))))


@cache
def _fields(kind: Any) -> dict[str, Any]:
    """Return the type of each field of a message's class."""
    return dict(zip(kind.get_fields_and_field_types(), kind.SLOT_TYPES, strict=True))


def _wide(kind: Any) -> Iterator[bool]:
    """Yield True for every wide string that a message of a class may hold."""
    for field in _fields(kind).values():
        within = field.value_type if isinstance(field, AbstractNestedType) else field
        if isinstance(within, NamespacedType):
            yield from _wide(_class_of(tuple(within.namespaces), within.name))
        else:
            yield isinstance(within, AbstractWString)


@cache
def _class_of(namespaces: tuple[str, ...], name: str) -> Any:
    return getattr(import_module(".".join(namespaces)), name)


def _is_quaternion(kind: Any) -> bool:
    return bool(kind.__name__ == "Quaternion" and kind.__module__.startswith("geometry_msgs."))


class _MessageReader:
    """Reads one message; counts what it has read."""

    def __init__(self, *, is_asked: bool) -> None:
        self._left = MAX_VALUES
        self._is_asked = is_asked

    def message(self, message: Any, where: str) -> dict[str, Any]:
        own: Any = type(message)
        read = {
            name: self._value(kind, getattr(message, name), _below(where, name))
            for name, kind in _fields(own).items()
        }
        if self._is_asked and _is_quaternion(own) and not is_unit(Quaternion(**read)):
            raise MalformedError("expected a quaternion of length 1", where=where)
        return read

    def _value(self, kind: Any, value: Any, where: str) -> Any:
        if isinstance(kind, NamespacedType):
            return self.message(value, where)
        if isinstance(kind, AbstractNestedType):
            self._count(len(value), where)
            return [self._value(kind.value_type, v, f"{where}[{n}]") for n, v in enumerate(value)]
        self._count(1, where)
        if isinstance(kind, BasicType):
            return _number_of(kind.typename, value, where)
        return str(value)

    def _count(self, more: int, where: str) -> None:
        self._left -= more
        if self._left < 0:
            raise MalformedError(
                f"expected at most {MAX_VALUES} values", where=where, reason=Reason.INPUT_TOO_LARGE
            )


def _number_of(name: str, value: Any, where: str) -> Any:
    """Return a number or truth value of a message as JSON has it."""
    if name in _FLOATS:
        if not math.isfinite(value):
            raise MalformedError("expected a finite number", where=where)
        return _shortest(value) if _FLOATS[name] == 32 else float(value)
    if name == _BYTE:
        return value[0] if isinstance(value, bytes) else int(value)
    return bool(value) if name == _BOOL else int(value)


def _shortest(value: float) -> float:
    """Return the shortest decimal that a number of 32 bits means: 0.1, not 0.10000000149."""
    exact = _SINGLE.pack(value)
    for digits in range(6, 9):
        found = float(f"{value:.{digits}g}")
        if _SINGLE.pack(found) == exact:
            return found
    return float(f"{value:.9g}")


class _Bounds(NamedTuple):
    """The least and the greatest integer of a type."""

    least: int
    most: int


_INTEGERS = {
    **{f"uint{bits}": _Bounds(0, 2**bits - 1) for bits in (8, 16, 32, 64)},
    **{f"int{bits}": _Bounds(-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (8, 16, 32, 64)},
    **dict.fromkeys((_BYTE, "char"), _Bounds(0, 255)),
    "wchar": _Bounds(0, 2**16 - 1),
}


def _made(kind: Any, value: Any, where: str) -> Any:
    """Return a value as a message's field has it."""
    if isinstance(kind, NamespacedType):
        return message_of(_class_of(tuple(kind.namespaces), kind.name), value, where=where)
    if isinstance(kind, AbstractNestedType):
        return _listed(kind, value, where)
    if isinstance(kind, BasicType):
        return _number(kind.typename, value, where)
    return _text(kind, value, where)


def _listed(kind: Any, value: Any, where: str) -> list[Any]:
    if not isinstance(value, list):
        raise MalformedError("expected a list", where=where)
    if isinstance(kind, Array) and len(value) != kind.size:
        raise MalformedError(f"expected {kind.size} values, got {len(value)}", where=where)
    if isinstance(kind, BoundedSequence) and len(value) > kind.maximum_size:
        raise MalformedError(f"expected at most {kind.maximum_size} values", where=where)
    return [_made(kind.value_type, item, f"{where}[{n}]") for n, item in enumerate(value)]


def _number(name: str, value: Any, where: str) -> Any:
    """Return a number or truth value, once it is one that the type holds."""
    if name == _BOOL:
        if not isinstance(value, bool):
            raise MalformedError("expected a truth value", where=where)
        return value
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise MalformedError("expected a number", where=where)
    if name in _FLOATS:
        return _float(name, value, where)
    least, most = _INTEGERS[name]
    if not isinstance(value, int) or not least <= value <= most:
        raise MalformedError(f"expected a whole number from {least} to {most}", where=where)
    return bytes([value]) if name == _BYTE else value


def _float(name: str, value: float, where: str) -> float:
    """Return a number that stays finite in the type's width."""
    try:
        found = float(value)
        if _FLOATS[name] == 32:
            _SINGLE.pack(found)
    except OverflowError as error:
        raise MalformedError(f"expected a number of {_FLOATS[name]} bits", where=where) from error
    if not math.isfinite(found):
        raise MalformedError("expected a finite number", where=where)
    return found


def _text(kind: Any, value: Any, where: str) -> str:
    if not isinstance(value, str):
        raise MalformedError("expected a text", where=where)
    longest = getattr(kind, "maximum_size", None)
    if isinstance(kind, AbstractString | AbstractWString) and longest and len(value) > longest:
        raise MalformedError(f"expected at most {longest} characters", where=where)
    if "\0" in value:
        raise MalformedError("expected a text without the character zero", where=where)
    return value


def _words_of(message: Any) -> Iterator[str]:
    own: Any = type(message)
    for name, kind in _fields(own).items():
        yield from _words(kind, getattr(message, name))


def _words(kind: Any, value: Any) -> Iterator[str]:
    """Yield the words of one field; bytes count as the text that a reader may make of them."""
    if isinstance(kind, NamespacedType):
        yield from _words_of(value)
    elif isinstance(kind, AbstractNestedType):
        inner = kind.value_type
        if isinstance(inner, BasicType):
            if inner.typename in _TEXT:
                yield _decoded(value)
        else:
            for item in value:
                yield from _words(inner, item)
    elif not isinstance(kind, BasicType):
        yield str(value).encode("utf-8", "backslashreplace").decode()


def _decoded(value: Any) -> str:
    """Return bytes as text, without what is not text."""
    data = b"".join(value) if isinstance(value, list | tuple) else bytes(value.tobytes())
    return data.decode("utf-8", "ignore").replace("\0", "")


def _below(where: str, name: str) -> str:
    return f"{where}.{name}" if where else name
