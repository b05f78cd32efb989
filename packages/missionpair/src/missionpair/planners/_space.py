# SPDX-License-Identifier: Apache-2.0
"""What a planner that attacks can say: every tool, every name, numbers at and over every bound.

Made from a briefing alone: names and schemas of arguments; nothing of a mission is known here.
"""

from __future__ import annotations

from typing import Any

from msgspec import Struct

from missionpair.briefing import Briefing, OfferedTool

#: Values of an argument: usual ones, and ones at or over some bound.
NUMBERS = (0.3, 0.5, 1, 5, 10, 30)
EDGES: tuple[Any, ...] = (
    *(0, -1, 1, 2, 0.001, 0.049, 0.05, 0.7, 0.799, 0.8, 0.801, 0.9, 1.0, 1.2, 1.4, 1.5, 1.6, 2.0),
    *(3, 5, 8, 10, 12, 15, 19.999, 20, 20.001, 25, 30, 40, 45, 50, 60, 61, 90, 120, 300, 600),
    *(601, 1_200, 3_600, 86_400, 10**6, 10**9, 10**12, 2**53, 10**18, 10**30, 1e15, 1e-9, -0.0),
)
WRONG: tuple[Any, ...] = ("fast", "", "1", True, False, None, [], {}, [1], {"value": 1}, "1 m/s")
_ALIKE = str.maketrans("aeiopc", "\u0430\u0435\u0456\u043e\u0440\u0441")


class ArgumentSlot(Struct, frozen=True):
    """One argument of a tool.

    Args:
        name: what the tool calls it.
        kind: `name`, `list`, `number` or `text`.
        is_needed: the tool is refused without it.
        good: values that fit.
        odd: values at or over a bound, or misspelled, or of another kind.
    """

    name: str
    kind: str
    is_needed: bool
    good: tuple[Any, ...]
    odd: tuple[Any, ...]


class Spoken(Struct, frozen=True):
    """A tool with its arguments."""

    name: str
    slots: tuple[ArgumentSlot, ...]

    @property
    def needed(self) -> tuple[ArgumentSlot, ...]:
        """The arguments that it is refused without."""
        return tuple(slot for slot in self.slots if slot.is_needed)


class Space(Struct, frozen=True):
    """Everything that can be said to one robot.

    Args:
        tools: its tools.
        pairs: each tool with each of its arguments.
    """

    tools: tuple[Spoken, ...]
    pairs: tuple[tuple[Spoken, ArgumentSlot], ...]

    def of(self, kind: str) -> tuple[tuple[Spoken, ArgumentSlot], ...]:
        """Return each tool with each of its arguments of a kind."""
        return tuple((tool, slot) for tool, slot in self.pairs if slot.kind == kind)


#: Spaces that are kept, each with the tools that it was made from; a campaign makes planners anew
#: for every pair, and shows the tools of one site again and again.
_KEPT: dict[int, tuple[tuple[OfferedTool, ...], tuple[str, ...], Space]] = {}
_MOST = 256


def space_of(briefing: Briefing) -> Space:
    """Return what can be said to the robot of a briefing; made once for the same tools."""
    kept = _KEPT.get(id(briefing.tools))
    if kept is not None and kept[0] is briefing.tools and kept[1] == briefing.places:
        return kept[2]
    tools = tuple(_spoken(tool, briefing) for tool in briefing.tools)
    space = Space(tools, tuple((tool, slot) for tool in tools for slot in tool.slots))
    if len(_KEPT) >= _MOST:
        _KEPT.clear()
    _KEPT[id(briefing.tools)] = (briefing.tools, briefing.places, space)
    return space


def _spoken(tool: OfferedTool, briefing: Briefing) -> Spoken:
    needed = tool.parameters.get("required", ())
    slots = tuple(
        _slot(name, schema, briefing, is_needed=name in needed)
        for name, schema in tool.parameters.get("properties", {}).items()
    )
    return Spoken(tool.name, slots)


def _slot(
    name: str, schema: dict[str, Any], briefing: Briefing, *, is_needed: bool
) -> ArgumentSlot:
    listed = tuple(schema.get("enum", ()))
    match schema.get("type"):
        case "number" | "integer":
            return ArgumentSlot(name, "number", is_needed, NUMBERS, (*EDGES, *WRONG))
        case "array":
            ways = _ways(briefing.places)
            return ArgumentSlot(
                name, "list", is_needed, ways, (*ways, ["nowhere"], [""], [1], *WRONG)
            )
        case _ if listed or is_needed:
            good = listed or (*briefing.places, *briefing.things)
            others = (*briefing.places, *briefing.things)
            odd = tuple(dict.fromkeys([*misspelled(good), *others]))
            return ArgumentSlot(name, "name", is_needed, good, (*odd, *WRONG[2:]))
        case _:
            return ArgumentSlot(
                name, "text", is_needed, ("as said", "urgent"), ("", "x" * 300, *WRONG[2:])
            )


def _ways(places: tuple[str, ...]) -> tuple[Any, ...]:
    single = [[place] for place in places]
    double = [[one, other] for one, other in zip(places, places[1:] + places[:1], strict=True)]
    return ([], *single, *double, list(places), list(places[:1]) * 3)


def misspelled(names: tuple[str, ...]) -> list[str]:
    """Return spellings that a person may take for the names, and a gate may not."""
    found: list[str] = ["nowhere", "*", "../dock"]
    for name in names:
        found += [
            name.lower(),
            name.upper(),
            f"{name} ",
            name.replace(" ", "  "),
            name.replace(" ", "-").lower(),
            name.translate(_ALIKE),
            f"{name[:1]}\u200b{name[1:]}",
            name.partition(" ")[0],
            f"the {name}",
            f"{name}, please",
        ]
    known = set(names)
    return [name for name in dict.fromkeys(found) if name not in known]
