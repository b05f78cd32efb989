# SPDX-License-Identifier: Apache-2.0
"""Proof that a binding lets nothing through unseen: read, bound, rebuilt, mutated, compared.

(a) every field is mapped, fixed, refused or noted; (b) every privileged field has an origin that
the executor must respect; (c) each change in a valid call changes the scope's digest, or is
refused, or changes nothing that is dispatched; (d) several ways to one effect become one action.
What could not be shown is a fault, or the report says so. Spec page: docs/spec/binding.md#checking
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from msgspec import Struct

from authguard_r.authoring.binding.samples import Sampler
from authguard_r.core.action import Action, scope_of
from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Digest
from authguard_r.core.reasons import Reason
from authguard_r.normalize.bind import Binder
from authguard_r.normalize.binding import (
    Argument,
    ArgumentUse,
    Binding,
    ToolBinding,
    ToolWay,
    binding_faults,
    origins,
    ways,
)
from authguard_r.normalize.dialects import Call
from authguard_r.normalize.interface import Surface, interface_faults, uncompared
from authguard_r.normalize.rebuild import Rebuilder
from authguard_r.site.check import SiteFault
from authguard_r.site.model import Site

#: Values of every kind that a dialect can read, none of them likely to be meant.
_STRANGE: tuple[Any, ...] = (
    *("", "elsewhere", 0, -1, 10**9, True, False, None, [], {}, ["x"], {"x": 1}),
)
#: A name that no interface has.
_FOREIGN = "no_such_field"
_UNPROVEN = (
    "expected a site with something that a call of it can name: check it without `--site`, or with "
    "a site that has a region, a position or an object for it"
)


class BindingReport(Struct, frozen=True, kw_only=True):
    """What a check of a binding found.

    Args:
        binding: its id.
        tools: how many external tools it binds.
        ways: how many ways these have.
        fields: how many fields are mapped, fixed, refused and noted.
        interface: how many tools and messages of the interface it was compared with; None: with
            none, so nothing shows that every field is bound.
        unmapped: fields and tools of the interface that it does not bind; None: not compared.
        uncompared: the ways of which that interface says nothing, but for those that are always
            refused; None: not compared.
        groups: each effect that several ways share, with their places.
        unproven: the ways of which the site has no example; each is a fault.
        assumed: the ways that move the robot and read no answer: everything but an error counts as
            done.
        faults: everything to fix, with its place; none when the binding is sound.
    """

    binding: str
    tools: int
    ways: int
    fields: dict[str, int]
    interface: int | None
    unmapped: tuple[str, ...] | None
    uncompared: tuple[str, ...] | None
    groups: dict[str, tuple[str, ...]]
    unproven: tuple[str, ...]
    assumed: tuple[str, ...]
    faults: tuple[SiteFault, ...]


def check_binding(
    binding: Binding, site: Site, *, interface: tuple[Surface, ...] = ()
) -> BindingReport:
    """Return everything that is wrong with a binding at a site; nothing is raised for it.

    Args:
        binding: as it was read, sound or not.
        site: the site whose words it speaks.
        interface: what the planner's tools say of themselves; empty: they are not compared.
    """
    found = [SiteFault(where, message) for where, message in binding_faults(binding, site)]
    unmapped: list[str] = []
    for where, message, missing in interface_faults(binding, interface):
        found.append(SiteFault(where, message))
        if missing:
            unmapped.append(f"{where}: {message}")
    unproven: tuple[str, ...] = ()
    if not found:
        mutations = _Mutations(binding, site)
        unproven = mutations.unproven()
        found += (SiteFault(place, _UNPROVEN) for place in unproven)
        found += mutations.faults()
    return BindingReport(
        binding=binding.id,
        tools=len(binding.tools),
        ways=len(ways(binding)),
        fields=_counts(binding),
        interface=len(interface) or None,
        unmapped=tuple(unmapped) if interface else None,
        uncompared=tuple(_uncompared(binding, site, interface)) if interface else None,
        groups=_groups(binding, site),
        unproven=unproven,
        assumed=tuple(_assumed(binding, site)),
        faults=tuple(found),
    )


def _uncompared(binding: Binding, site: Site, interface: tuple[Surface, ...]) -> Iterator[str]:
    for way in uncompared(binding, interface):
        kind = site.vocabulary.get(way.tool.type)
        if kind is None or not kind.state_writing:
            yield way.place


def _assumed(binding: Binding, site: Site) -> Iterator[str]:
    for way in ways(binding):
        kind, tool = site.vocabulary.get(way.tool.type), way.tool
        moves = kind is not None and kind.moves and not kind.state_writing
        says = "/action/" in tool.message or "/msg/" in tool.message  # an action has a status
        if moves and not (tool.succeeds or tool.fails or says):
            yield way.place


class _Mutations:
    """Holds every way of a sound binding to part (c), by one sample call and all its changes."""

    def __init__(self, binding: Binding, site: Site) -> None:
        self._kinds = site.vocabulary
        self._binder = Binder(site, binding)
        self._rebuilder = Rebuilder(site, binding)
        self._sampler = Sampler(site)
        self._samples = tuple((way, self._sampler.call(way)) for way in ways(binding))

    def unproven(self) -> tuple[str, ...]:
        """Return the ways of which there is no sample, so of which nothing is shown."""
        return tuple(way.place for way, call in self._samples if call is None)

    def faults(self) -> Iterator[SiteFault]:
        """Yield each change of a sample that is neither refused nor dispatched as it is judged."""
        for way, call in ((way, call) for way, call in self._samples if call is not None):
            try:
                yield from self._way_faults(way, call)
            except MalformedError as error:
                yield SiteFault(
                    way.place, f"expected calls that bind and are rebuilt: {error.message}"
                )

    def _way_faults(self, way: ToolWay, call: Call) -> Iterator[SiteFault]:
        if self._kinds[way.tool.type].state_writing:
            told = self._refused(call)
            message = f"expected {Reason.STATE_WRITING_REFUSED}, got {told}"
            yield from [SiteFault(way.place, message)] * (told is not Reason.STATE_WRITING_REFUSED)
            return
        yield from self._rebuilt_faults(self._binder.bind(call), way, way.place)
        for path, changed in self._changes(way, call):
            if self._refused(changed) is None:  # else nothing of it is dispatched
                place = f"{way.place}.arguments.{path}"
                yield from self._rebuilt_faults(self._binder.bind(changed), way, place)

    def _refused(self, call: Call) -> Reason | None:
        try:
            self._binder.bind(call)
        except MalformedError as error:
            return error.reason
        return None

    def _rebuilt_faults(self, action: Action, way: ToolWay, place: str) -> Iterator[SiteFault]:
        """The dispatched call means the authorized action again, by this tool and by any."""
        for tool in (None, way.name):
            call = self._rebuilder.rebuild(action, tool=tool)
            differs = _scope(self._binder.bind(call)) != _scope(action)
            yield from [SiteFault(place, "expected a dispatched call of the same action")] * differs

    def _changes(self, way: ToolWay, call: Call) -> Iterator[tuple[str, Call]]:
        """Yield the sample with one path changed at a time, left out or added to."""
        for path, argument in (*way.tool.arguments.items(), *((p, None) for p in way.tool.when)):
            values = [*_STRANGE]
            if argument is not None and argument.use is ArgumentUse.MAPPED:
                values += self._sampler.values(way.tool, argument)
            for value in values:
                yield path, _with(call, path, value)
            yield path, _without(call, path)
        yield _FOREIGN, _with(call, _FOREIGN, 1)


def _with(call: Call, path: str, value: Any) -> Call:
    return Call(call.tool, _put(call.arguments, path.split("."), value), call.where)


def _put(node: Any, names: list[str], value: Any) -> Any:
    """Return a copy of nested arguments with one value set."""
    name, *rest = names
    if isinstance(node, list):
        return [
            _put({name: item}, names, value)[name] if str(n) == name else item
            for n, item in enumerate(node)
        ]
    kept = node if isinstance(node, dict) else {}
    return {**kept, name: _put(kept.get(name), rest, value) if rest else value}


def _without(call: Call, path: str) -> Call:
    """Return the call without the value at a path; as it is when nothing stands there."""
    *parents, last = path.split(".")
    arguments = _copy(call.arguments)
    node = arguments
    for name in parents:
        node = node[int(name)] if isinstance(node, list) else node.get(name, {})
    if isinstance(node, dict):
        node.pop(last, None)
    return Call(call.tool, arguments, call.where)


def _copy(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _copy(item) for name, item in value.items()}
    return [_copy(item) for item in value] if isinstance(value, list) else value


def _scope(action: Action) -> Digest:
    return digest_of(Tag.SCOPE, scope_of(action))


def _counts(binding: Binding) -> dict[str, int]:
    counts = {str(use): 0 for use in ArgumentUse}
    for way in ways(binding):
        counts[ArgumentUse.FIXED] += len(way.tool.when)
        for argument in _leaves(way.tool.arguments):
            counts[argument.use] += 1
    return counts


def _leaves(arguments: dict[str, Argument]) -> Iterator[Argument]:
    for argument in arguments.values():
        yield from _leaves(argument.each) if argument.each else (argument,)


def _groups(binding: Binding, site: Site) -> dict[str, tuple[str, ...]]:
    """Return the ways that can become one action: an effect has one name for all tools."""
    groups: list[list[ToolWay]] = []
    for way in ways(binding):
        kind = site.vocabulary.get(way.tool.type)
        if kind is not None and not kind.state_writing:
            home = next((g for g in groups if any(_meet(way.tool, o.tool) for o in g)), None)
            if home is None:
                groups.append([way])
            else:
                home.append(way)
    return {_effect(g[0].tool): tuple(way.place for way in g) for g in groups if len(g) > 1}


def _meet(one: ToolBinding, two: ToolBinding) -> bool:
    """True when some action could come from either way: what dispatches it is then the same."""
    return (one.type, one.tool) == (two.type, two.tool) and _fits(one, two) and _fits(two, one)


def _fits(one: ToolBinding, two: ToolBinding) -> bool:
    """True when the second way can fill all that the first always fills, with what it settles."""
    always, possible = set(origins(one, always=True)), set(origins(two))
    words = {a.to: set(a.values.values()) for a in two.arguments.values() if a.values}
    return always <= possible and all(
        two.fixed.get(target, value) == value and value in words.get(target, {value})
        for target, value in one.fixed.items()
    )


def _effect(tool: ToolBinding) -> str:
    settled = [f"{target}={value}" for target, value in sorted(tool.fixed.items())]
    return " ".join((tool.type, "by", tool.tool, *settled))
