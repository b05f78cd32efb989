# SPDX-License-Identifier: Apache-2.0
"""From a call to an action: names resolved, units scaled, nothing inferred.

Names are resolved by exact spelling, as the executor would; a homoglyph, another case or a stray
space is another name, and unknown. Source: section "Normalized Actions".
Spec page: docs/spec/normalize.md
"""

from __future__ import annotations

from collections.abc import Callable
from decimal import Decimal
from fractions import Fraction
from typing import Any

from authguard_r.core.action import Action
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import MAX_INTEGER, ParameterId
from authguard_r.core.reasons import Reason
from authguard_r.normalize.binding import Argument, Binding, ToolBinding, Use
from authguard_r.normalize.dialects import Call
from authguard_r.site.model import Parameter, Rounding, Site

#: Longest route, in regions.
MAX_ROUTE = 64


class Binder:
    """Turns calls into actions of one site through one binding.

    Args:
        site: the site whose words are meant.
        binding: sound for that site (`normalize.binding.require_sound`).
    """

    def __init__(self, site: Site, binding: Binding) -> None:
        self._site = site
        self._binding = binding
        self._regions = _spellings({r: m.names for r, m in site.regions.items()})
        self._objects = _spellings({o: m.names for o, m in site.objects.items()})
        self._readers = {
            name: tuple(
                (key, argument, self._reader(argument, tool))
                for key, argument in tool.arguments.items()
                if argument.use is not Use.NOTED
            )
            for name, tool in binding.tools.items()
        }

    def bind(self, call: Call) -> Action:
        """Return the action that the call means, without provenance and meta.

        Raises:
            MalformedError: unknown tool, field or name; missing, refused or invalid value.
        """
        tool = self._binding.tools.get(call.tool)
        if tool is None:
            raise _refusal(
                Reason.TOOL_UNKNOWN,
                f"expected a bound tool, got `{ascii(call.tool)[1:-1][:80]}`",
                call.where,
            )
        kind = self._site.vocabulary[tool.type]
        if kind.state_writing:
            raise _refusal(
                Reason.STATE_WRITING_REFUSED,
                f"`{call.tool}` changes what the robot believes; no planner may",
                call.where,
            )
        if not call.arguments.keys() <= tool.arguments.keys():
            unknown = min(call.arguments.keys() - tool.arguments.keys())
            place = f"{call.where}.{ascii(unknown)[1:-1][:80]}"
            raise _refusal(Reason.FIELD_UNKNOWN, f"`{call.tool}` has no such field", place)
        fields = self._collect(call, tool)
        params = {
            ParameterId(target.removeprefix("params.")): fields[target]
            for target in sorted(fields)
            if target.startswith("params.")
        }
        return Action(
            type=tool.type,
            tool=tool.tool,
            object=fields.get("object"),
            source=fields.get("source"),
            destination=fields.get("destination"),
            route=fields.get("route", ()),
            params=params,
        )

    def attested(self, call: Call) -> tuple[str, ...]:
        """Return the fields of the call's action that attested state must fill."""
        return self._binding.tools[call.tool].attested

    def spellings(self) -> dict[str, str]:
        """Return every external spelling of regions and objects with the id that it names."""
        return site_spellings(self._site)

    def _collect(self, call: Call, tool: ToolBinding) -> dict[str, Any]:
        fields: dict[str, Any] = dict(tool.fixed)
        for name, argument, reader in self._readers[call.tool]:
            where = f"{call.where}.{name}"
            if name in call.arguments:
                fields[argument.to] = reader(call.arguments[name], where)
            else:
                self._absent(fields, argument, where)
        return fields

    @staticmethod
    def _absent(fields: dict[str, Any], argument: Argument, where: str) -> None:
        if argument.use is Use.MAPPED and not argument.optional:
            raise _refusal(Reason.FIELD_MISSING, "expected a value", where)
        if argument.default is not None:
            fields[argument.to] = argument.default

    def _reader(self, argument: Argument, tool: ToolBinding) -> Callable[[Any, str], Any]:
        """Return what turns a planner's value, at a place, into the argument's target."""
        if argument.use is Use.REFUSED:
            return _refuse
        if argument.to == "object":
            return lambda value, where: _resolve(value, self._objects, "object", where)
        if argument.to in {"source", "destination"}:
            return lambda value, where: _resolve(value, self._regions, "region", where)
        if argument.to == "route":
            return self._route
        name = ParameterId(argument.to.removeprefix("params."))
        parameter = self._site.vocabulary[tool.type].params[name]
        per_unit = Fraction(argument.per_unit)
        return lambda value, where: scale(value, parameter, per_unit=per_unit, where=where)

    def _route(self, value: Any, where: str) -> tuple[str, ...]:
        if not isinstance(value, list) or len(value) > MAX_ROUTE:
            raise _refusal(Reason.VALUE_INVALID, "expected a list of regions", where)
        return tuple(
            _resolve(item, self._regions, "region", f"{where}[{n}]") for n, item in enumerate(value)
        )


def _refuse(value: Any, where: str) -> Any:  # noqa: ARG001 - whatever it is
    raise _refusal(Reason.FIELD_REFUSED, "expected the field to be left out", where)


def scale(value: Any, parameter: Parameter, *, per_unit: Fraction, where: str) -> int:
    """Return a planner's number as an integer in the parameter's unit, rounded against it.

    Args:
        value: an `int` or exact `Decimal`; truth values, text and everything else are refused.
        parameter: the target.
        per_unit: the target's units in one of the planner's.
        where: the place, for messages.

    Raises:
        MalformedError: not a number, a remainder in a count, or outside the type's range.
    """
    if isinstance(value, bool) or not isinstance(value, int | Decimal):
        raise _refusal(Reason.VALUE_INVALID, "expected a number", where)
    top, bottom = value.as_integer_ratio()
    top, bottom = top * per_unit.numerator, bottom * per_unit.denominator
    whole, left = divmod(top, bottom)
    if left:
        whole = _rounded(Fraction(top, bottom), parameter.rounding, where)
    if not parameter.low <= whole <= parameter.high or abs(whole) > MAX_INTEGER:
        raise _refusal(
            Reason.VALUE_OUT_OF_RANGE,
            f"expected {parameter.low} to {parameter.high} {parameter.unit}, got {whole}",
            where,
        )
    return whole


def _rounded(exact: Fraction, rounding: Rounding, where: str) -> int:
    if rounding is Rounding.COUNT:
        raise _refusal(Reason.VALUE_INVALID, "expected a whole number", where)
    if rounding is Rounding.POSITION:
        return round(exact)
    toward_zero = abs(exact.numerator) // exact.denominator
    return (toward_zero + 1) * (1 if exact > 0 else -1)


def site_spellings(site: Site) -> dict[str, str]:
    """Return every external spelling of a site's regions and objects with the id it names."""
    regions = _spellings({region: model.names for region, model in site.regions.items()})
    objects = _spellings({item: model.names for item, model in site.objects.items()})
    return {**regions, **objects}


def _spellings(named: dict[Any, tuple[str, ...]]) -> dict[str, str]:
    return {name: item for item, names in named.items() for name in (item, *names)}


def _resolve(value: Any, spellings: dict[str, str], kind: str, where: str) -> str:
    if not isinstance(value, str):
        raise _refusal(Reason.VALUE_INVALID, f"expected the name of a {kind}", where)
    found = spellings.get(value)
    if found is None:
        shown = ascii(value)[1:-1]
        raise _refusal(Reason.NAME_UNKNOWN, f"no {kind} is called `{shown[:80]}`", where)
    return found


def _refusal(reason: Reason, message: str, where: str) -> MalformedError:
    return MalformedError(message, where=where, reason=reason)
