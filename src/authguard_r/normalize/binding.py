# SPDX-License-Identifier: Apache-2.0
"""Bindings: what each field of each planner tool means, and how it is used.

Every argument is `mapped`, `fixed`, `refused` or `noted` (recorded, not forwarded); what the tool
does not carry is `fixed` or `monitored` here or `attested` by state. Nothing is guessed: an
argument that the binding does not name refuses the whole plan. Spec page: docs/spec/binding.md
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from collections.abc import Set as AbstractSet
from decimal import Decimal
from enum import StrEnum
from fractions import Fraction
from itertools import pairwise
from typing import Annotated, Any, Literal

from msgspec import Meta, Struct

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
from authguard_r.normalize.dialects import ReplyForm
from authguard_r.normalize.expected import DECIMAL, AnswerMatch, Constant, match_fault, same
from authguard_r.site.channels import channel_labels
from authguard_r.site.model import ActionModel, Site

#: A positive number of at most 20 characters: `1000`, `0.5` or `1/3`.
_FACTOR = re.compile(r"(?=.{1,20}\Z)[0-9]+(?:\.[0-9]+|/[0-9]+)?")
#: Targets that together name the region in which a position lies.
POSE = ("pose.x", "pose.y", "pose.map")
#: Arguments whose constant names what is really moved, as ROS interfaces call them.
_MOVED = ("topic", "action", "action_name", "service", "service_name")
#: Arguments that only name the form of a message: in any form it goes to the same receiver.
FORMS = frozenset({"type", "msg_type", "action_type", "service_type"})
#: The target of a list of places: the last is the destination, those before it the route.
STOPS = "stops"
#: The target of a place's name within `each`.
REGION = "region"


class ArgumentUse(StrEnum):
    """How an argument is used."""

    MAPPED = "mapped"
    FIXED = "fixed"
    REFUSED = "refused"
    NOTED = "noted"


class Argument(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """One argument of a planner's tool.

    Args:
        use: how it is used.
        to: the action field it fills: `object`, `destination`, `source`, `route`, `stops`,
            `pose.x`, `pose.y`, `pose.map` or `params.NAME`; within `each`: `region` or a pose.
        per_unit: how many of the parameter's units one of the argument's is (1000 for meters
            per second into millimeters per second), as an exact decimal or fraction `N/M`.
        offset: what is added after that, in the parameter's unit (273150 for Celsius into mK).
        whole: the tool takes whole numbers only.
        optional: the planner may leave it out; then `default` is carried, or nothing.
        default: the value carried when it is left out, in the parameter's unit.
        value: of a fixed argument, the one value it may have; of a noted one, what the tool is
            given in its place.
        decimal: the same for a number that is not whole, as an exact decimal (`0.1`).
        values: the parameter's number for each word that the argument may be.
        also: other names under which the planner may give it (`1` for the first position).
        each: of a list of places: the fields of one.
    """

    use: ArgumentUse
    to: str = ""
    per_unit: str = "1"
    offset: Integer = 0
    whole: bool = False
    optional: bool = False
    default: Integer | None = None
    value: Constant | None = None
    decimal: str = ""
    values: dict[str, Integer] = {}
    also: tuple[str, ...] = ()
    each: dict[str, Argument] = {}

    def constant(self) -> Constant | Decimal | None:
        """Return what the tool is given independent of the planner; None when that is nothing."""
        return Decimal(self.decimal) if self.decimal else self.value


class ToolBinding(
    Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True
):
    """One tool of a planner, or one way of using it.

    Args:
        type: the canonical action type that it means.
        tool: the canonical tool that carries it out.
        arguments: by external name, or by dotted path to a nested one (`goal.pose.position.x`,
            `doors.0`); what is not here is refused.
        fixed: action fields and parameters that the controller's configuration settles.
        controller: the controller whose configuration settles them; its digest is in the profile
            of every robot that has the tool.
        monitored: those fixed parameters that the lease holds on attested state.
        attested: fields that attested state fills when the plan's turn comes.
        when: arguments whose constants tell this way from the others of the same tool.
        effect: what is really moved, a topic, action, service or controller; empty: what
            `effect_of` reads from the constants. Ways to one effect have one type and one tool.
        message: the ROS type whose fields stand under `body` (`nav2_msgs/action/Wait`).
        body: the path under which they stand; empty: at the top.
        result: the channel by which the tool's result reaches the planner; empty: it counts as the
            least trusted of all.
        succeeds: paths in the tool's structured answer, or `TEXT` for its words, with what stands
            there when it has done its work; empty: every answer but an error.
        fails: the same, with what stands there when it has not; one of them is enough.
        noted: why the tool is bound as it is; for people.
    """

    type: ActionType
    tool: ToolId
    arguments: dict[str, Argument] = {}
    fixed: dict[str, Integer | Identifier] = {}
    controller: Identifier | None = None
    monitored: tuple[str, ...] = ()
    attested: tuple[Literal["source"], ...] = ()
    when: dict[str, Constant] = {}
    effect: str = ""
    message: str = ""
    body: str = ""
    result: str = ""
    succeeds: dict[str, Constant | AnswerMatch] = {}
    fails: dict[str, Constant | AnswerMatch] = {}
    noted: str = ""


Ways = Annotated[tuple[ToolBinding, ...], Meta(min_length=1)]


class Binding(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """All tools of one planner interface.

    Args:
        schema: the version of this language.
        id: what people call it.
        site: the one site that it is made for; absent: any whose vocabulary has the types.
        reply: the form of the planner's JSON, where it is none of the known ones.
        tools: by external name; `when` distinguishes several ways of a tool.
    """

    schema: Literal["authguard-r/binding/1"]
    id: Identifier
    site: Identifier | None = None
    reply: ReplyForm | None = None
    tools: dict[str, ToolBinding | Ways]


class ToolWay(Struct, frozen=True):
    """One way of one tool: the tool's external name, the place in the binding, what it says."""

    name: str
    place: str
    tool: ToolBinding


def ways(binding: Binding) -> tuple[ToolWay, ...]:
    """Return every way of every tool, in the order in which the binding names them."""
    return tuple(way for name in binding.tools for way in ways_of(binding, name))


def ways_of(binding: Binding, name: str) -> tuple[ToolWay, ...]:
    """Return the ways of one tool."""
    found = binding.tools[name]
    if isinstance(found, ToolBinding):
        return (ToolWay(name, f"tools.{name}", found),)
    return tuple(ToolWay(name, f"tools.{name}[{n}]", tool) for n, tool in enumerate(found))


def effect_of(tool: ToolBinding) -> str:
    """Return what a way really moves, without outer slashes; empty when nothing says it.

    It is what the author declares, else the ROS name that the way holds constant: `/cmd_vel` and
    `cmd_vel` move the same wheels, for every form of the message.
    """
    constants = {n: a.constant() for n, a in tool.arguments.items()} | tool.when
    named = (tool.effect, *(constants.get(name) for name in _MOVED))
    found = (name for name in named if isinstance(name, str) and name)
    return next(found, "").strip("/ ")


def binding_digest(binding: Binding) -> Digest:
    """Return the digest under which the log names the binding."""
    return digest_of(Tag.BINDING, binding)


def require_sound(binding: Binding, site: Site) -> None:
    """Hold a binding to the site: every target exists, every field has exactly one origin.

    Raises:
        MalformedError: with the place of the first fault.
    """
    for where, message in binding_faults(binding, site):
        raise MalformedError(message, where=where, reason=Reason.SCHEMA_INVALID)


def binding_faults(binding: Binding, site: Site) -> Iterator[tuple[str, str]]:
    """Yield the place and the message of every fault; nothing when the binding is sound."""
    if binding.site not in {None, site.id}:
        yield "site", f"expected a binding for `{site.id}`"
    if binding.reply is not None:
        yield from binding.reply.faults()
    for name in binding.tools:
        found = ways_of(binding, name)
        for number, way in enumerate(found):
            words = (name, way.tool.effect, *_words(way.tool.arguments))
            if not all(word.isascii() for word in words):
                yield f"tools.{name!a}", "expected names in ASCII"
                continue
            for place, fault in _faults(way.tool, site):
                yield f"{way.place}.{place}", fault
            for other in found[:number]:
                if not _apart(way.tool, other.tool):
                    yield f"{way.place}.when", f"expected a constant that `{other.place}` has not"
    yield from _effect_faults(binding, site)


def _effect_faults(binding: Binding, site: Site) -> Iterator[tuple[str, str]]:
    """A refusal of one way has no effect while another way to the same effect has another name."""
    movers: dict[str, list[ToolWay]] = {}
    for way in ways(binding):
        kind, effect = site.vocabulary.get(way.tool.type), effect_of(way.tool)
        if not effect or kind is None or kind.state_writing:  # the last move nothing, ever
            continue
        others = movers.setdefault(effect, [])
        other = next((other for other in others if not _may_share(way.tool, other.tool)), None)
        if other is not None:
            wanted, got = (f"`{w.tool.type}` by `{w.tool.tool}`" for w in (other, way))
            message = f"expected {wanted} as `{other.place}` moves `{effect}`, got {got}"
            yield f"{way.place}.effect", message
        others.append(way)


def _may_share(one: ToolBinding, two: ToolBinding) -> bool:
    """True when two ways to one effect are one kind of action, or two commands of one receiver."""
    if (one.type, one.tool) == (two.type, two.tool):
        return True
    return not (one.effect or two.effect) and _apart(one, two, beside=(*_MOVED, *FORMS))


def _words(arguments: dict[str, Argument]) -> Iterator[str]:
    for name, argument in arguments.items():
        yield from (name, *argument.also, *_words(argument.each))


def _apart(one: ToolBinding, two: ToolBinding, *, beside: tuple[str, ...] = ()) -> bool:
    """True when no call can be both: they hold one argument to different constants.

    Args:
        one: a way.
        two: another.
        beside: the arguments that do not count.
    """
    return any(
        not same(constant, two.when[path])
        for path, constant in one.when.items()
        if path in two.when and path not in beside
    )


def _faults(tool: ToolBinding, site: Site) -> Iterator[tuple[str, str]]:
    kind = site.vocabulary.get(tool.type)
    if kind is None:
        yield "type", f"expected an action type of the site, got `{tool.type}`"
        return
    every = tool.arguments.values()
    also = [name for argument in every for name in argument.also]
    lists = {n for path, a in tool.arguments.items() if a.each for n in (path, *a.also)}
    yield from _path_faults([*tool.arguments, *also, *tool.when], "arguments", lists)
    for name, argument in tool.arguments.items():
        for place, fault in _argument_faults(argument):
            yield f"arguments.{name}.{place}", fault
    yield from _settled_faults(tool, kind, site)
    yield from _controller_faults(tool, site)
    if tool.result and tool.result not in channel_labels(site.channels):
        yield "result", f"expected a channel of the site, got `{tool.result!a}`"
    for name, wanted in (("succeeds", tool.succeeds), ("fails", tool.fails)):
        for path, match in wanted.items():
            if fault := match_fault(path, match):
                yield f"{name}.{path}", fault
    yield from _origin_faults(tool, kind)


def _path_faults(
    paths: list[str], where: str, lists: AbstractSet[str] = frozenset()
) -> Iterator[tuple[str, str]]:
    """Each value of a call stands on exactly one path; a list's items are counted from 0.

    Args:
        paths: of one level.
        where: their place in the binding.
        lists: names of lists of places: an object may stand there too, with paths.
    """
    split = sorted(tuple(path.split(".")) for path in paths)
    for path in split:
        if not all(path):
            yield f"{where}.{'.'.join(path)}", "expected names between the dots"
    for one, two in pairwise(split):
        if two[: len(one)] == one and (one == two or ".".join(one) not in lists):
            yield f"{where}.{'.'.join(two)}", f"expected no path within `{'.'.join(one)}`"
    children: dict[tuple[str, ...], set[str]] = {}
    for path in split:
        for depth in range(1, len(path)):
            children.setdefault(path[:depth], set()).add(path[depth])
    for parent, keys in children.items():
        if any(map(is_index, keys)) and keys != {str(n) for n in range(len(keys))}:
            yield f"{where}.{'.'.join(parent)}", "expected the items 0, 1, ... of a list"


def is_index(name: str) -> bool:
    """True when a name within a path counts the item of a list."""
    return name.isascii() and name.isdecimal()


def _argument_faults(argument: Argument) -> Iterator[tuple[str, str]]:
    mapped = argument.use is ArgumentUse.MAPPED
    if mapped != bool(argument.to):
        yield "to", "expected a target exactly when it is mapped"
    if not _is_factor(argument.per_unit):
        yield "per_unit", "expected a positive number, such as `1000` or `1/3`"
    if argument.decimal and DECIMAL.fullmatch(argument.decimal) is None:
        yield "decimal", "expected a number that is not whole, such as `0.1`"
        return
    settled = argument.constant() is not None
    if settled != (argument.use is ArgumentUse.FIXED) and not (
        settled and argument.use is ArgumentUse.NOTED
    ):
        yield "value", "expected a value of a fixed or noted argument only, and of every fixed one"
    if argument.decimal and argument.value is not None:
        yield "decimal", "expected a `value` or a `decimal`"
    if argument.values and not argument.to.startswith("params."):
        yield "values", "expected words for a parameter"
    yield from _place_faults(argument)


def _place_faults(argument: Argument) -> Iterator[tuple[str, str]]:
    if argument.optional and argument.to in {*POSE, STOPS, REGION}:
        yield "optional", "expected a place that the planner must name"
    if argument.each:
        if argument.to not in {STOPS, "route"}:
            yield "each", "expected a list of places: `stops` or `route`"
        yield from _each_faults(argument.each)
    elif argument.to == STOPS:
        yield "each", "expected the fields of one place"


def _each_faults(each: dict[str, Argument]) -> Iterator[tuple[str, str]]:
    yield from _path_faults(list(each), "each")
    targets = [argument.to for argument in each.values() if argument.to]
    if sorted(targets) not in ([REGION], sorted(POSE), sorted(POSE[:2])):
        yield "each", "expected one `region`, or `pose.x` and `pose.y`"
    for name, argument in each.items():
        if argument.each or argument.also:
            yield f"each.{name}", "expected neither `each` nor `also` within `each`"
        for place, fault in _argument_faults(argument):
            yield f"each.{name}.{place}", fault


def origins(tool: ToolBinding, *, always: bool = False) -> Iterator[str]:
    """Yield the field that each part of the tool fills; twice when two parts do.

    Args:
        tool: one way of a tool.
        always: only what is there in every action.
    """
    mapped = [
        argument.to
        for argument in tool.arguments.values()
        if argument.use is ArgumentUse.MAPPED
        and not (always and argument.optional and argument.default is None)
    ]
    for target in (*tool.fixed, *tool.attested, *mapped):
        if target == STOPS:
            yield "destination"
            yield from () if always else ("route",)
        elif target == POSE[0]:
            yield "destination"
        elif target not in POSE:
            yield target


def _origin_faults(tool: ToolBinding, kind: ActionModel) -> Iterator[tuple[str, str]]:
    wanted = {*kind.fields, *(f"params.{name}" for name in kind.params)}
    found = list(origins(tool))
    for target in found:
        if target not in wanted:
            yield target, f"expected a field of `{tool.type}`: {', '.join(sorted(wanted))}"
        if found.count(target) > 1:
            yield target, "expected one origin"
    poses = [a.to for a in tool.arguments.values() if a.to in POSE]
    poses += [target for target in tool.fixed if target in POSE]
    if poses and sorted(poses) not in (sorted(POSE), sorted(POSE[:2])):
        yield "pose", "expected `pose.x` and `pose.y`, and at most one `pose.map`"
    required = {f"params.{n}" for n, p in kind.params.items() if p.required}
    required |= {field for field in kind.fields if field != "route"}
    missing = sorted(required.difference(found))
    if missing and not kind.state_writing:
        yield "arguments", f"expected an origin for `{missing[0]}`"


def _settled_faults(tool: ToolBinding, kind: ActionModel, site: Site) -> Iterator[tuple[str, str]]:
    """Values that the planner does not propose must be such as the field or parameter can have."""
    settled = [(f"fixed.{target}", target, value) for target, value in tool.fixed.items()]
    for name, argument in tool.arguments.items():
        place = f"arguments.{name}"
        if argument.default is not None:
            settled.append((f"{place}.default", argument.to, argument.default))
        settled += [(f"{place}.values.{w}", argument.to, v) for w, v in argument.values.items()]
    for place, target, value in settled:
        if not _is_value(value, target, kind, site):
            yield place, f"expected a value that `{target}` can have"
    for target in tool.monitored:
        parameter = kind.params.get(ParameterId(target.removeprefix("params.")))
        if target not in tool.fixed or parameter is None or parameter.monitored_by is None:
            yield f"monitored.{target}", "expected a fixed parameter that attested state shows"


def _controller_faults(tool: ToolBinding, site: Site) -> Iterator[tuple[str, str]]:
    """What a controller settles hangs on the digest of its configuration in a signed profile."""
    if tool.controller is None:
        return
    if not tool.fixed:
        yield "controller", "expected values under `fixed` that it settles"
    for rid, robot in site.robots.items():
        able = tool.tool in robot.profile.tools.get(tool.type, ())
        if able and tool.controller not in robot.profile.controllers:
            message = f"expected a controller in the profile of `{rid}`, got `{tool.controller}`"
            yield "controller", message


def _is_value(value: int | str, target: str, kind: ActionModel, site: Site) -> bool:
    """True when a settled value is one that the field or parameter can have."""
    if target.startswith("params."):
        parameter = kind.params.get(ParameterId(target.removeprefix("params.")))
        return (
            parameter is not None
            and isinstance(value, int)
            and parameter.low <= value <= parameter.high
        )
    known: dict[str, Iterable[str]] = {
        "object": site.objects,
        "source": site.regions,
        "destination": site.regions,
        "pose.map": {region.map for region in site.regions.values()},
    }
    return value in frozenset(known.get(target, ()))  # no value settles a way or a position


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
