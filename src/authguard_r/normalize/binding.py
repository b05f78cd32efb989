# SPDX-License-Identifier: Apache-2.0
"""Bindings: what each field of each planner tool means, and what becomes of it.

Every argument is `mapped`, `refused` or `noted` (recorded, not forwarded); what the tool does not
carry is `fixed` here or `attested` by state. Nothing is guessed: an argument that the binding does
not name refuses the whole plan. Spec page: docs/spec/binding.md
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from enum import StrEnum
from fractions import Fraction
from typing import Any, Literal

from msgspec import Struct

from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import (
    ActionType,
    Digest,
    Identifier,
    Integer,
    ParameterId,
    ToolId,
)
from authguard_r.core.reasons import Reason
from authguard_r.site.model import ActionModel, Site

#: A positive number of at most 20 characters: `1000`, `0.5` or `1/3`.
_FACTOR = re.compile(r"(?=.{1,20}\Z)[0-9]+(?:\.[0-9]+|/[0-9]+)?")


class Use(StrEnum):
    """What becomes of an argument."""

    MAPPED = "mapped"
    REFUSED = "refused"
    NOTED = "noted"


class Argument(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """One argument of a planner's tool.

    Args:
        use: what becomes of it.
        to: the action field it fills: `object`, `destination`, `source`, `route` or
            `params.NAME`.
        per_unit: how many of the parameter's units one of the argument's is (1000 for meters
            per second into millimeters per second), as an exact decimal or fraction `N/M`.
        optional: the planner may leave it out; then `default` is carried, or nothing.
        default: the value carried when it is left out, in the parameter's unit.
    """

    use: Use
    to: str = ""
    per_unit: str = "1"
    optional: bool = False
    default: Integer | None = None


class ToolBinding(
    Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True
):
    """One tool of a planner.

    Args:
        type: the canonical action type that it means.
        tool: the canonical tool that carries it out.
        arguments: by external name; what is not here is refused.
        fixed: action fields and parameters that the controller's configuration settles.
        attested: fields that attested state fills when the plan's turn comes.
        noted: why the tool is bound as it is; for people.
    """

    type: ActionType
    tool: ToolId
    arguments: dict[str, Argument] = {}
    fixed: dict[str, Integer | Identifier] = {}
    attested: tuple[Literal["source"], ...] = ()
    noted: str = ""


class Binding(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """All tools of one planner interface at one site."""

    schema: Literal["authguard-r/binding/1"]
    id: Identifier
    site: Identifier
    tools: dict[str, ToolBinding]


def binding_digest(binding: Binding) -> Digest:
    """Return the digest under which the log names the binding."""
    return digest_of(Tag.BINDING, binding)


def require_sound(binding: Binding, site: Site) -> None:
    """Hold a binding to the site: every target exists, every field has exactly one origin.

    Raises:
        MalformedError: with the place of the first fault.
    """
    if binding.site != site.id:
        raise MalformedError(f"expected a binding for `{site.id}`", where="site")
    for name, tool in binding.tools.items():
        if not all(word.isascii() for word in (name, *tool.arguments)):
            raise MalformedError("expected names in ASCII", where=f"tools.{name!a}")
        for place, fault in _faults(tool, site):
            where = f"tools.{name}.{place}"
            raise MalformedError(fault, where=where, reason=Reason.SCHEMA_INVALID)


def _faults(tool: ToolBinding, site: Site) -> Iterator[tuple[str, str]]:
    kind = site.vocabulary.get(tool.type)
    if kind is None:
        yield "type", f"expected an action type of the site, got `{tool.type}`"
    else:
        yield from _kind_faults(tool, kind, site)


def _kind_faults(tool: ToolBinding, kind: ActionModel, site: Site) -> Iterator[tuple[str, str]]:
    wanted = {*kind.fields, *(f"params.{name}" for name in kind.params)}
    origins: list[str] = [*tool.fixed, *tool.attested]
    yield from _settled_faults(tool, kind, site)
    for name, argument in tool.arguments.items():
        if (argument.use is Use.MAPPED) != bool(argument.to):
            yield f"arguments.{name}.to", "expected a target exactly when it is mapped"
        if not _is_factor(argument.per_unit):
            yield (
                f"arguments.{name}.per_unit",
                "expected a positive number, such as `1000` or `1/3`",
            )
        if argument.use is Use.MAPPED:
            origins.append(argument.to)
    for target in origins:
        if target not in wanted:
            yield target, f"expected a field of `{tool.type}`: {', '.join(sorted(wanted))}"
        if origins.count(target) > 1:
            yield target, "expected one origin"
    required = {f"params.{n}" for n, p in kind.params.items() if p.required}
    required |= {field for field in kind.fields if field != "route"}
    missing = sorted(required.difference(origins))
    if missing and not kind.state_writing:
        yield "arguments", f"expected an origin for `{missing[0]}`"


def _settled_faults(tool: ToolBinding, kind: ActionModel, site: Site) -> Iterator[tuple[str, str]]:
    """Values that nobody proposes must be such as the field or parameter can have."""
    settled = [(f"fixed.{target}", target, value) for target, value in tool.fixed.items()]
    settled += [
        (f"arguments.{name}.default", argument.to, argument.default)
        for name, argument in tool.arguments.items()
        if argument.default is not None
    ]
    for place, target, value in settled:
        if not _is_value(value, target, kind, site):
            yield place, f"expected a value that `{target}` can have"


def _is_value(value: int | str, target: str, kind: ActionModel, site: Site) -> bool:
    """True when a settled value is one that the field or parameter can have."""
    if target.startswith("params."):
        parameter = kind.params.get(ParameterId(target.removeprefix("params.")))
        return (
            parameter is not None
            and isinstance(value, int)
            and parameter.low <= value <= parameter.high
        )
    if target == "route":
        return False  # a list; nobody settles a way
    known = site.objects if target == "object" else site.regions
    return value in known


def _is_factor(text: str) -> bool:
    try:
        return _FACTOR.fullmatch(text) is not None and Fraction(text) > 0
    except (ValueError, ZeroDivisionError):
        return False


def load_binding(data: Any, *, site: Site, where: str) -> Binding:
    """Return plain data as a binding that is sound for the site.

    Raises:
        MalformedError: with the place of the first fault.
    """
    from authguard_r.site.source import convert

    binding = convert(data, Binding, where=where)
    require_sound(binding, site)
    return binding
