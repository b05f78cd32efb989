# SPDX-License-Identifier: Apache-2.0
"""Strict YAML: what people write is what is meant, or it is refused with its place.

Safe loading only: no tags, no aliases, no duplicate keys, no floats where integers belong; a word
that only looks like a truth value or a date stays a word. How-to: docs/howto/site.md
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import yaml

from authguard_r.core.encoding import MAX_BYTES
from authguard_r.core.errors import EnvironmentFault, MalformedError
from authguard_r.core.reasons import Reason

T = TypeVar("T")


class _StrictLoader(yaml.SafeLoader):
    """SafeLoader that refuses duplicate keys, aliases, and words that only look like values."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.events.AliasEvent):
            event = self.peek_event()  # type: ignore[no-untyped-call]
            raise yaml.YAMLError(f"aliases are not allowed{event.start_mark}")
        tagged = self.peek_event()  # type: ignore[no-untyped-call]
        if getattr(tagged, "tag", None) is not None:
            raise yaml.YAMLError(f"tags are not allowed{tagged.start_mark}")
        return super().compose_node(parent, index)

    def construct_scalar(self, node: Any) -> Any:
        value = super().construct_scalar(node)
        if any("\ud800" <= char <= "\udfff" for char in value):
            raise yaml.YAMLError(f"half a character is not allowed{node.start_mark}")
        return value

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
        MalformedError: it is too long or not UTF-8.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise EnvironmentFault(
            f"cannot read `{path}`: {error.strerror}",
            reason=Reason.STORE_UNAVAILABLE,
            where=str(path),
        ) from error
    return as_text(data, where=str(path))


def as_text(data: bytes, *, where: str) -> str:
    """Return a file's bytes as text.

    Raises:
        MalformedError: too long or not UTF-8.
    """
    if len(data) > MAX_BYTES:
        raise MalformedError(f"expected at most {MAX_BYTES} bytes", where=where)
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise MalformedError("expected UTF-8", where=where) from error


def read_yaml(text: str, *, where: str) -> object:
    """Return the plain data in strict YAML.

    Raises:
        MalformedError: with the place that the parser names.
    """
    try:
        return yaml.load(text, Loader=_StrictLoader)  # noqa: S506 - a SafeLoader
    except (yaml.YAMLError, ValueError, OverflowError, RecursionError) as error:
        message = " ".join(str(error).split())
        raise MalformedError(message, where=where) from error


def convert(data: object, kind: type[T], *, where: str) -> T:
    """Return plain data as a struct, strictly.

    Raises:
        MalformedError: with the place of the first fault.
    """
    try:
        return msgspec.convert(data, kind)
    except msgspec.ValidationError as error:
        text, _, place = str(error).partition(" - at ")
        place = place.rpartition(" in ")[2]  # a key's fault is told as "`key` in `$.place`"
        place = place.strip("`").removeprefix("$").removeprefix(".")
        joined = f"{where}:{place}" if place else where
        raise MalformedError(text[:1].lower() + text[1:], where=joined) from error
