# SPDX-License-Identifier: Apache-2.0
"""Strict YAML: what people write is what is meant, or it is refused with its place.

Safe loading only: no tags, no aliases, no duplicate keys, no floats where integers belong; a word
that only looks like a truth value or a date stays a word. libyaml cuts the text up, always: two
parsers would be two readings of one file, and the other one takes seconds for a hostile megabyte.
How-to: docs/howto/site.md
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import yaml
from yaml.composer import Composer

from authguard_r.core.encoding import MAX_BYTES
from authguard_r.core.errors import EnvironmentFault, MalformedError
from authguard_r.core.reasons import Reason

T = TypeVar("T")

#: Most keys and values of one text, so that a megabyte of `[],` is no burden.
MAX_NODES = 100_000
#: How deep a text may be nested for every reader; a site needs eight.
MAX_DEPTH = 64


class _TooLargeError(yaml.YAMLError):
    """The text has more keys and values than one may have."""


class _StrictLoader(Composer, yaml.CSafeLoader):
    """Refuses duplicate keys, aliases, tags, and words that only look like values.

    The composer comes before the parser's own, which has no hook for a node.
    """

    def __init__(self, stream: str) -> None:
        yaml.CSafeLoader.__init__(self, stream)
        Composer.__init__(self)
        self._nodes = 0
        self._depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        self._nodes += 1
        if self._nodes > MAX_NODES:
            raise _TooLargeError(f"expected at most {MAX_NODES} keys and values")
        event: Any = self.peek_event()
        if self._depth > MAX_DEPTH:
            raise yaml.YAMLError(f"expected at most {MAX_DEPTH} levels{event.start_mark}")
        if isinstance(event, yaml.events.AliasEvent):
            raise yaml.YAMLError(f"aliases are not allowed{event.start_mark}")
        if getattr(event, "tag", None) is not None:
            raise yaml.YAMLError(f"tags are not allowed{event.start_mark}")
        self._depth += 1
        node = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def construct_mapping(self, node: Any, deep: bool = True) -> dict[Any, Any]:  # noqa: FBT001, FBT002
        keys = [self.construct_object(key, deep=True) for key, _ in node.value]
        seen: set[Any] = set()
        for key in keys:
            if not isinstance(key, str | int) or key in seen:
                raise yaml.YAMLError(f"duplicate key `{key}`{node.start_mark}")
            seen.add(key)
        return super().construct_mapping(node, deep=deep)


# `on`, `no` and dates are words of the site, not truth values and instants.
_StrictLoader.yaml_implicit_resolvers = {
    first: [(tag, rule) for tag, rule in rules if not tag.endswith((":timestamp", ":bool", ":int"))]
    for first, rules in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_StrictLoader.add_implicit_resolver(
    "tag:yaml.org,2002:int", re.compile(r"^(?:0|-?[1-9][0-9]*)$"), list("-0123456789")
)
_StrictLoader.add_implicit_resolver(
    "tag:yaml.org,2002:bool", re.compile(r"^(?:true|false)$"), list("tf")
)


def read_text(path: Path) -> str:
    """Return a file's text.

    Raises:
        EnvironmentFault: it cannot be read.
        MalformedError: it is too long (`INPUT_TOO_LARGE`) or not UTF-8.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise EnvironmentFault(
            f"cannot read `{path}`: {error.strerror}",
            reason=Reason.FILE_UNAVAILABLE,
            where=str(path),
        ) from error
    return as_text(data, where=str(path))


def as_text(data: bytes, *, where: str) -> str:
    """Return a file's bytes as text.

    Raises:
        MalformedError: too long (`INPUT_TOO_LARGE`) or not UTF-8.
    """
    if len(data) > MAX_BYTES:
        raise _too_large(f"expected at most {MAX_BYTES} bytes, got {len(data)}", where)
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise MalformedError("expected UTF-8", where=where) from error


def read_yaml(text: str, *, where: str) -> object:
    """Return the plain data in strict YAML.

    Args:
        text: untrusted; what it costs is bounded by its length and its number of values.
        where: the file's name, for places in messages.

    Raises:
        MalformedError: with the place that the parser names; longer than `MAX_BYTES` or more
            than `MAX_NODES` keys and values (`INPUT_TOO_LARGE`).
    """
    if len(text) > MAX_BYTES:
        raise _too_large(f"expected at most {MAX_BYTES} characters, got {len(text)}", where)
    try:
        return yaml.load(text, Loader=_StrictLoader)  # noqa: S506 - safe
    except _TooLargeError as error:
        raise _too_large(str(error), where) from error
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        message = " ".join(str(error).split())
        raise MalformedError(message, where=where) from error


def _too_large(message: str, where: str) -> MalformedError:
    return MalformedError(message, where=where, reason=Reason.INPUT_TOO_LARGE)


def convert(data: object, kind: type[T], *, where: str) -> T:
    """Return plain data as a struct, strictly.

    Raises:
        MalformedError: with the place of the first fault.
    """
    try:
        return msgspec.convert(data, kind)
    except msgspec.ValidationError as error:
        from authguard_r.site.fault_places import fault_of

        text, place = fault_of(data, kind, error)
        raise MalformedError(text, where=f"{where}:{place}" if place else where) from error
