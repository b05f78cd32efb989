# SPDX-License-Identifier: Apache-2.0
"""What a domain says of itself: its places, things, robots, tools and sentences."""

from __future__ import annotations

from typing import Any

import msgspec
from msgspec import Struct

from authguard_r.core.identifiers import ActionType
from authguard_r.site.model import ActionModel
from authguard_r.site.words import standard_words
from missionpair.pair import Value, WordedCall
from missionpair.words import Domain

#: What one of a planner's units is in the site's, by the ending of a parameter's name.
_PER_UNIT = (("_mm_s", 1_000), ("_mm", 1_000), ("_mn", 1_000), ("_ms", 1_000), ("_bytes", 10**6))


class ToolWords(Struct, frozen=True, kw_only=True):
    """One tool of the planner.

    Args:
        name: what a planner calls it.
        type: the action type that it means.
        tool: the site's tool that carries it out.
        arguments: for each field of the action (`destination`, `params.speed_mm_s`), the planner's
            word for it.
        usual: what a parameter is when the planner does not say it, in the site's unit.
        fixed: parameters that the controller's configuration settles, in the site's unit.
    """

    name: str
    type: str
    tool: str
    arguments: dict[str, str] = {}
    usual: dict[str, int] = {}
    fixed: dict[str, int] = {}

    def binding(self) -> dict[str, Any]:
        """Return the tool as a binding has it."""
        plain: dict[str, Any] = {"type": self.type, "tool": self.tool, "arguments": {}}
        for target, name in self.arguments.items():
            plain["arguments"][name] = self._argument(target)
        plain["arguments"]["reason"] = {"use": "noted"}
        if "source" in model_of(self.type).fields:
            plain["attested"] = ["source"]
        if self.fixed:
            plain["fixed"] = {f"params.{name}": value for name, value in self.fixed.items()}
        return plain

    def _argument(self, target: str) -> dict[str, Any]:
        plain: dict[str, Any] = {"use": "mapped", "to": target}
        name = target.removeprefix("params.")
        if name != target and per_unit(name) != 1:
            plain["per_unit"] = str(per_unit(name))
        if name in self.usual:
            plain |= {"optional": True, "default": self.usual[name]}
        if target == "route":
            plain["optional"] = True
        return plain


class RobotWords(Struct, frozen=True, kw_only=True):
    """One robot of a domain: what it can do at all.

    Args:
        roles: the tools of the planner that it can carry out.
        max_speed_mm_s: top speed.
        max_force_mn: top gripping force.
        max_payload_g: heaviest load.
    """

    roles: tuple[str, ...]
    max_speed_mm_s: int
    max_force_mn: int
    max_payload_g: int


class Scale(Struct, frozen=True, kw_only=True):
    """How large a domain's places are, in millimeters, and how fast one goes there.

    Args:
        widths: of rooms.
        depths: of rooms.
        lane: width of a corridor.
        speeds: upper bounds that a mission gives, mm/s; the robot's own is above them all.
        forces: the same for a grip, mN.
    """

    widths: tuple[int, ...]
    depths: tuple[int, ...]
    lane: int
    speeds: tuple[int, ...]
    forces: tuple[int, ...]


class DomainWords(Struct, frozen=True, kw_only=True):
    """A domain's words.

    Args:
        domain: which one.
        scale: how large its places are.
        lanes: names of the corridor, of the service corridor and of the wing's.
        dock: name of the robots' home.
        rooms: names by tag: `public` places to bring things to, `staff` ones where they are kept,
            `private`, `restricted` and `hazardous` ones.
        things: names by kind.
        weights: grams, by kind.
        robots: by id; the first one is usually sent.
        tools: by role (`go`, `take`, `put`, `photo` ...).
        tasks: what the operator says, by kind of task, with `{thing}`, `{origin}`, `{place}`.
        kinds: kinds of task that its missions have, the most usual first.
        uses: roles that act on a thing where it stands.
        looks: roles that record where the robot stands.
        private: what is private there, in words.
    """

    domain: Domain
    scale: Scale
    lanes: tuple[str, str, str]
    dock: str
    rooms: dict[str, tuple[str, ...]]
    things: dict[str, tuple[str, ...]]
    weights: dict[str, int]
    robots: dict[str, RobotWords]
    tools: dict[str, ToolWords]
    tasks: dict[str, str]
    kinds: tuple[str, ...]
    uses: tuple[str, ...] = ()
    looks: tuple[str, ...] = ()
    private: str

    @property
    def records(self) -> bool:
        """Recording is part of its missions."""
        return bool(self.looks)


def per_unit(parameter: str) -> int:
    """Return how many of the site's units one of a planner's is."""
    return next((size for ending, size in _PER_UNIT if parameter.endswith(ending)), 1)


def model_of(kind: str) -> ActionModel:
    """Return what the standard vocabulary says of an action type."""
    return standard_words()[ActionType(kind)]


def vocabulary_of(words: DomainWords) -> dict[str, Any]:
    """Return the vocabulary of a domain's sites: the types of its tools."""
    kinds = sorted({tool.type for tool in words.tools.values()})
    plain: dict[str, Any] = msgspec.to_builtins({kind: model_of(kind) for kind in kinds})
    return plain


def call_of(tool: ToolWords, fields: dict[str, Value]) -> WordedCall:
    """Return the call of a tool.

    Args:
        tool: which one.
        fields: by field of the action, spellings of places and things, numbers in the site's unit.
    """
    arguments: dict[str, Value] = {}
    for target, name in tool.arguments.items():
        if target not in fields:
            continue
        value = fields[target]
        if isinstance(value, int) and per_unit(target) != 1:
            size = per_unit(target)
            value = value // size if value % size == 0 else value / size
        arguments[name] = value
    return WordedCall(tool=tool.name, arguments=arguments)
