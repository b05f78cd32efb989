# SPDX-License-Identifier: Apache-2.0
"""From a call to an action: names resolved, units scaled, nothing inferred.

Names are resolved by exact spelling, as the executor would; a homoglyph, another case or a stray
space is another name, and unknown. Source: section "Normalized Actions".
Spec page: docs/spec/normalize.md
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from decimal import Decimal
from fractions import Fraction
from typing import Any

from msgspec import Struct

from authguard_r.core.action import Action
from authguard_r.core.identifiers import ActionType, ParameterId, ToolId
from authguard_r.core.provenance import TRUST
from authguard_r.core.reasons import Reason
from authguard_r.normalize.argument_paths import (
    Tree,
    flatten,
    look,
    refusal,
    suffix_of,
    tree_of,
    unknown_field,
)
from authguard_r.normalize.binding import (
    FORMS,
    POSE,
    REGION,
    STOPS,
    Argument,
    ArgumentUse,
    Binding,
    ToolBinding,
    Ways,
    binding_digest,
    ways,
    ways_of,
)
from authguard_r.normalize.dialects import Call
from authguard_r.normalize.expected import Constant, Expected, same
from authguard_r.normalize.places import Places
from authguard_r.normalize.quantity import COORDINATE, scale
from authguard_r.provenance.context import ContextLedger
from authguard_r.site.channels import channel_labels
from authguard_r.site.model import ActionModel, Site

#: Longest route, in regions.
MAX_ROUTE = 64

#: The channel of an input without one: a shipped one with the least trusted label.
UNTOLD = str(TRUST[-1])

Reader = Callable[[Any, str], Any]


class _Form(Struct, frozen=True):
    """What one level of arguments is held to, worked out once.

    Args:
        names: the names that may be there.
        tree: the way to each path; None when every name is a path, as it stands.
        readers: path, place below the call, target, what reads it, what is carried without it,
            and whether a call without it is refused.
    """

    names: frozenset[str]
    tree: Tree | None
    readers: tuple[tuple[str, str, str, Reader, int | None, bool], ...]


class _BoundWay(Struct, frozen=True):
    """One way of a tool, worked out once.

    Args:
        tool: the way itself.
        kind: the action type that it means.
        form: what its arguments are held to.
        places: regions follow from other fields.
        params: the parameters that it can fill, sorted, each with its target.
    """

    tool: ToolBinding
    kind: ActionModel
    form: _Form
    places: bool
    params: tuple[tuple[ParameterId, str], ...]


class Binder:
    """Turns calls into actions of one site through one binding.

    Args:
        site: the site whose words are meant.
        binding: sound for that site (`normalize.binding.require_sound`).
    """

    def __init__(self, site: Site, binding: Binding) -> None:
        self._site = site
        self._places = Places(site)
        self._regions = _spellings({r: m.names for r, m in site.regions.items()})
        self._objects = _spellings({o: m.names for o, m in site.objects.items()})
        self._tools = {
            name: tuple(self._way(way.tool) for way in ways_of(binding, name))
            for name in binding.tools
        }
        self._results = result_channels(binding, site)
        #: the form of replies that the binding declares
        self.reply = binding.reply
        #: names the binding
        self.digest = binding_digest(binding)

    def bind(self, call: Call) -> Action:
        """Return the action that the call means, without provenance and meta.

        Raises:
            MalformedError: unknown tool, field or name; missing, refused or invalid value.
        """
        way = self._choose(call)
        if way.kind.state_writing:
            raise refusal(
                Reason.STATE_WRITING_REFUSED,
                f"`{call.tool}` writes state, or no grant can limit it; no planner may call it",
                call.where,
            )
        fields: dict[str, Any] = dict(way.tool.fixed)
        self._collect(way.form, call.arguments, fields, call.where, call.tool)
        if way.places:
            self._settle(fields, call.where)
        return Action(
            type=way.tool.type,
            tool=way.tool.tool,
            object=fields.get("object"),
            source=fields.get("source"),
            destination=fields.get("destination"),
            route=fields.get("route", ()),
            params={name: fields[target] for name, target in way.params if target in fields},
        )

    def way(self, call: Call) -> ToolBinding:
        """Return the way of its tool that a call is.

        Raises:
            MalformedError: no way of a tool is this call.
        """
        return self._choose(call).tool

    def spellings(self) -> dict[str, str]:
        """Return every external spelling of regions and objects with the id that it names."""
        return site_spellings(self._site)

    def context(self, channels: Mapping[str, str] | None = None) -> ContextLedger:
        """Return a record of what a planner sees, empty, that knows the site's names.

        Args:
            channels: the site's own channels, each with its label; None: the standard ones.
        """
        return ContextLedger(self.spellings(), channels=channels)

    def expected(self, call: Call) -> Expected:
        """Return what stands in the answer of a call that has done its work, or has not.

        Raises:
            MalformedError: no way of a tool is this call.
        """
        tool = self._choose(call).tool
        return Expected(tool.succeeds, tool.fails)

    def result_channel(self, action: Action) -> str:
        """Return the channel of what an action brings to light: of several, the least trusted."""
        return self._results.get((action.type, action.tool), UNTOLD)

    def _choose(self, call: Call) -> _BoundWay:
        """Return the one way that the call is; ways of a tool exclude each other."""
        found = self._tools.get(call.tool)
        if found is None:
            raise refusal(
                Reason.TOOL_UNKNOWN,
                f"expected a bound tool, got `{ascii(call.tool)[1:-1][:80]}`",
                call.named or call.where,
            )
        if len(found) == 1 and not found[0].tool.when:
            return found[0]
        for way in found:
            if all(same(look(call.arguments, p), c) for p, c in way.tool.when.items()):
                return way
        silent = [way for way in found if _says_no_form(way.tool, call.arguments)]
        if len(silent) == 1:
            return silent[0]
        path = _stray(call, tuple(way.tool for way in found))
        raise refusal(
            Reason.TOOL_UNKNOWN,
            f"expected a value of `{path}` for which `{call.tool}` is bound",
            call.where + suffix_of(path),
        )

    def _way(self, tool: ToolBinding) -> _BoundWay:
        kind = self._site.vocabulary[tool.type]
        targets = {*tool.fixed, *(argument.to for argument in tool.arguments.values())}
        form = self._form(tool.arguments, tool.when, kind)
        params = tuple((name, f"params.{name}") for name in sorted(kind.params))
        held = tuple((name, target) for name, target in params if target in targets)
        return _BoundWay(tool, kind, form, not targets.isdisjoint({STOPS, POSE[0]}), held)

    def _form(
        self, arguments: dict[str, Argument], when: dict[str, Constant], kind: ActionModel
    ) -> _Form:
        paths = {path: (path, *argument.also) for path, argument in arguments.items()}
        paths |= {path: (path,) for path in when}
        flat = all(names == (path,) and "." not in path for path, names in paths.items())
        return _Form(
            names=frozenset(paths),
            tree=None if flat else tree_of(paths),
            readers=tuple(
                (path, suffix_of(path), a.to, self._reader(a, kind), a.default, _is_needed(a))
                for path, a in arguments.items()
                if a.use is not ArgumentUse.NOTED
            ),
        )

    @staticmethod
    def _collect(
        form: _Form, given: dict[str, Any], fields: dict[str, Any], where: str, tool: str
    ) -> None:
        """Read every argument of one level into the fields that it fills."""
        if form.tree is not None:
            found: dict[str, Any] = {}
            flatten(form.tree, given, found, where, tool)
            given = found
        elif not given.keys() <= form.names:
            unknown = min(given.keys() - form.names)
            raise unknown_field(tool, f"{where}.{ascii(unknown)[1:-1][:80]}")
        for path, suffix, target, reader, default, needed in form.readers:
            # null says that an optional argument is left out; a needed one has to have a value
            if given.get(path) is not None or (needed and path in given):
                fields[target] = reader(given[path], where + suffix)
            elif default is not None:
                fields[target] = default
            elif needed:
                raise refusal(Reason.FIELD_MISSING, "expected a value", where + suffix)

    def _settle(self, fields: dict[str, Any], where: str) -> None:
        """Turn positions and stops into the destination and the route that they mean."""
        if STOPS in fields:
            *route, fields["destination"] = fields.pop(STOPS)
            fields["route"] = tuple(route)
        if POSE[0] in fields:
            fields["destination"] = self._region(fields, where)

    def _region(self, fields: dict[str, Any], where: str) -> str:
        x, y, frame = (fields.pop(name, None) for name in POSE)
        return self._places.region_at((x, y), frame, where=where)

    def _reader(self, argument: Argument, kind: ActionModel) -> Reader:
        """Return what turns a planner's value, at a place, into the argument's target."""
        if argument.use is ArgumentUse.REFUSED:
            return _refuse
        if argument.use is ArgumentUse.FIXED:
            return _constant(argument.constant(), "or nothing" if argument.optional else "")
        if argument.each:
            return self._list(argument, kind)
        if argument.to == "object":
            return lambda value, where: _resolve(value, self._objects, "object", where)
        if argument.to in {"source", "destination", REGION}:
            return lambda value, where: _resolve(value, self._regions, "region", where)
        if argument.to == "route":
            return self._route
        if argument.to == POSE[2]:
            maps = {name: name for name in self._places.maps}
            return lambda value, where: _resolve(value, maps, "map", where)
        return _number(argument, kind)

    def _route(self, value: Any, where: str) -> tuple[str, ...]:
        if not isinstance(value, list) or len(value) > MAX_ROUTE:
            raise refusal(Reason.VALUE_INVALID, "expected a list of regions", where)
        return tuple(
            _resolve(item, self._regions, "region", f"{where}[{n}]") for n, item in enumerate(value)
        )

    def _list(self, argument: Argument, kind: ActionModel) -> Reader:
        """Return what reads a list of places, each with its own fields."""
        form = self._form(argument.each, {}, kind)
        least = 1 if argument.to == STOPS else 0

        def read(value: Any, where: str) -> tuple[str, ...]:
            if not isinstance(value, list) or not least <= len(value) <= MAX_ROUTE:
                raise refusal(
                    Reason.VALUE_INVALID, f"expected a list of {least} to {MAX_ROUTE} places", where
                )
            return tuple(one(item, f"{where}[{n}]") for n, item in enumerate(value))

        def one(item: Any, where: str) -> str:
            if not isinstance(item, dict):
                raise refusal(Reason.VALUE_INVALID, "expected an object", where)
            fields: dict[str, Any] = {}
            self._collect(form, item, fields, where, "place")
            return str(fields[REGION]) if REGION in fields else self._region(fields, where)

        return read


def _is_needed(argument: Argument) -> bool:
    """True when a call that leaves the argument out is refused, unless something is carried."""
    return argument.use is not ArgumentUse.REFUSED and not argument.optional


def _says_no_form(tool: ToolBinding, arguments: dict[str, Any]) -> bool:
    """True of a way that a call is but for the form of its message, which it leaves out."""
    forms = tool.when.keys() & FORMS
    return forms.isdisjoint(arguments) and all(
        path in forms or same(look(arguments, path), constant)
        for path, constant in tool.when.items()
    )


def _stray(call: Call, tools: Ways) -> str:
    """Return the first path whose value fits no way; else the first path of all."""
    paths = list(dict.fromkeys(path for tool in tools for path in tool.when))
    for path in paths:
        value = look(call.arguments, path)
        if not any(same(value, tool.when[path]) for tool in tools if path in tool.when):
            return path
    return paths[0]


def _refuse(value: Any, where: str) -> Any:  # noqa: ARG001 - whatever it is
    raise refusal(Reason.FIELD_REFUSED, "expected the field to be left out", where)


def _constant(constant: Any, otherwise: str) -> Reader:
    """Return what lets one value pass and fills nothing."""
    wanted = f"expected `{constant}` {otherwise}".rstrip()

    def read(value: Any, where: str) -> None:
        if not same(value, constant):
            raise refusal(Reason.FIELD_REFUSED, wanted, where)

    return read


def _number(argument: Argument, kind: ActionModel) -> Reader:
    """Return what reads a parameter or a coordinate."""
    name = ParameterId(argument.to.removeprefix("params."))
    parameter = COORDINATE if argument.to in POSE else kind.params[name]
    per_unit, offset = Fraction(argument.per_unit), argument.offset

    def word(value: Any, where: str) -> int:
        if not isinstance(value, str) or value not in argument.values:
            expected = ", ".join(argument.values)
            raise refusal(Reason.VALUE_INVALID, f"expected one of: {expected}", where)
        return argument.values[value]

    def whole(value: Any, where: str) -> int:
        if isinstance(value, Decimal):
            raise refusal(Reason.VALUE_INVALID, "expected a whole number", where)
        return scale(value, parameter, per_unit=per_unit, where=where, offset=offset)

    if argument.values:
        return word
    if argument.whole:
        return whole
    return lambda value, where: scale(
        value, parameter, per_unit=per_unit, where=where, offset=offset
    )


def result_channels(binding: Binding, site: Site) -> dict[tuple[ActionType, ToolId], str]:
    """Return by which channel what each kind of action brings to light reaches the planner.

    Several ways may lead to one action, and which of them is taken is not the planner's to choose:
    the least trusted of their channels counts.
    """
    labels = channel_labels(site.channels)
    found: dict[tuple[ActionType, ToolId], str] = {}
    for way in ways(binding):
        key, channel = (way.tool.type, way.tool.tool), way.tool.result or UNTOLD
        known = found.get(key, channel)
        found[key] = max(known, channel, key=lambda name: TRUST.index(labels[name]))
    return found


def site_spellings(site: Site) -> dict[str, str]:
    """Return every external spelling of a site's regions and objects with the id it names."""
    regions = _spellings({region: model.names for region, model in site.regions.items()})
    objects = _spellings({item: model.names for item, model in site.objects.items()})
    return {**regions, **objects}


def _spellings(named: dict[Any, tuple[str, ...]]) -> dict[str, str]:
    return {name: item for item, names in named.items() for name in (item, *names)}


def _resolve(value: Any, spellings: dict[str, str], kind: str, where: str) -> str:
    if not isinstance(value, str):
        raise refusal(Reason.VALUE_INVALID, f"expected the name of a {kind}", where)
    found = spellings.get(value)
    if found is None:
        shown = ascii(value)[1:-1]
        raise refusal(Reason.NAME_UNKNOWN, f"no {kind} is called `{shown[:80]}`", where)
    return found
