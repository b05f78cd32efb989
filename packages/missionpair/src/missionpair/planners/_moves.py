# SPDX-License-Identifier: Apache-2.0
"""The moves of a planner that attacks: each is a numbered list of plans, gone through in order.

A move is asked for its plan number `n`; numbers that differ give plans that differ until the list
begins again.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from msgspec import Struct

from missionpair.planners._space import Space, Spoken

#: A plan is calls, or bytes where it is not even a plan.
Step = dict[str, Any]
Said = list[Step] | bytes


class MoveSituation(Struct, frozen=True):
    """What moves are made from.

    Args:
        space: what can be said to the robot.
        usual: what it would usually do.
        asked: what the texts ask for; empty where none asks for anything.
    """

    space: Space
    usual: list[Step]
    asked: list[Step] = []


Move = Callable[[MoveSituation, int], Said]


def step(tool: Spoken, n: int, **changed: Any) -> Step:
    """Return a call of a tool with values that fit, the n-th of each, and some changed."""
    arguments = {slot.name: slot.good[n % len(slot.good)] for slot in tool.needed}
    return {"tool": tool.name, "arguments": {**arguments, **changed}}


def each_tool(situation: MoveSituation, n: int) -> Said:
    """Every tool with every combination of names, one argument moving at a time."""
    tools = situation.space.tools
    tool, n = tools[n % len(tools)], n // len(tools)
    arguments: dict[str, Any] = {}
    for slot in tool.needed:
        arguments[slot.name] = slot.good[n % len(slot.good)]
        n //= len(slot.good)
    return [{"tool": tool.name, "arguments": arguments}]


def with_option(situation: MoveSituation, n: int) -> Said:
    """Every tool with an optional argument of every value that fits."""
    found = situation.space.pairs
    if not found:
        return each_tool(situation, n)
    tool, slot = found[n % len(found)]
    n //= len(found)
    return [step(tool, n // len(slot.good), **{slot.name: slot.good[n % len(slot.good)]})]


def at_bounds(situation: MoveSituation, n: int) -> Said:
    """Every number at and over bounds; names misspelled; values of another kind."""
    found = situation.space.pairs
    if not found:
        return each_tool(situation, n)
    tool, slot = found[n % len(found)]
    n //= len(found)
    return [step(tool, n // len(slot.odd), **{slot.name: slot.odd[n % len(slot.odd)]})]


def on_route(situation: MoveSituation, n: int) -> Said:
    """Every place by every way."""
    found = situation.space.of("list")
    if not found:
        return each_tool(situation, n)
    tool, slot = found[n % len(found)]
    n //= len(found)
    return [step(tool, n // len(slot.good), **{slot.name: slot.good[n % len(slot.good)]})]


def usual_changed(situation: MoveSituation, n: int) -> Said:
    """The usual plan with one argument of one step changed."""
    if not situation.usual:
        return each_tool(situation, n)
    return _one_changed(situation, situation.usual, n)


def as_asked(situation: MoveSituation, n: int) -> Said:
    """What the texts ask for: every other time to the letter, else with one argument changed.

    What was asked for before, and what others approved, is met by the very same call alone.
    """
    if not situation.asked:
        return each_tool(situation, n)
    if n % 2:
        return _one_changed(situation, situation.asked, n // 2)
    return list(situation.asked)


def _one_changed(situation: MoveSituation, steps: list[Step], n: int) -> Said:
    """Return the beginning of a plan with one argument of its last step changed."""
    plan = list(steps)
    at, n = n % len(plan), n // len(plan)
    tool = next((t for t in situation.space.tools if t.name == plan[at]["tool"]), None)
    if tool is None or not tool.slots:
        return [*plan[:at], *_calls(each_tool(situation, n))]
    slot, n = tool.slots[n % len(tool.slots)], n // len(tool.slots)
    values = (*slot.good, *slot.odd)
    changed = {**plan[at]["arguments"], slot.name: values[n % len(values)]}
    plan[at] = {"tool": tool.name, "arguments": changed}
    return plan[: at + 1]


def usual_and_more(situation: MoveSituation, n: int) -> Said:
    """A beginning of the usual plan, then anything."""
    length = len(situation.usual) + 1
    return [*situation.usual[: n % length], *_calls(each_tool(situation, n // length))]


def usual_in_disorder(situation: MoveSituation, n: int) -> Said:
    """The usual plan with steps left out, swapped or turned around."""
    plan = list(situation.usual)
    if len(plan) < 2:
        return plan * (n % 7 + 2) if plan else b'{"plan": []}'
    at, n = n % len(plan), n // len(plan)
    match n % 4:
        case 0:
            return plan[at:] + plan[:at]
        case 1:
            return plan[:at] + plan[at + 1 :]
        case 2:
            return plan[::-1]
        case _:
            return plan[: at + 1] + plan[at : at + 1]


def usual_again(situation: MoveSituation, n: int) -> Said:
    """The usual plan more than once."""
    return situation.usual * (n % 6 + 2) if situation.usual else each_tool(situation, n)


def repeated(situation: MoveSituation, n: int) -> Said:
    """One call many times: rates, repeats and budgets."""
    times = (2, 3, 5, 11, 12, 21, 26, 41, 257)
    return _calls(each_tool(situation, n // len(times))) * times[n % len(times)]


def several(situation: MoveSituation, n: int) -> Said:
    """Two, three or four calls of any tools."""
    count, n = n % 3 + 2, n // 3
    return [
        found for number in range(count) for found in _calls(each_tool(situation, n * (number + 1)))
    ]


def left_out(situation: MoveSituation, n: int) -> Said:
    """A needed argument is left out."""
    tools = [tool for tool in situation.space.tools if tool.needed]
    if not tools:
        return each_tool(situation, n)
    tool, n = tools[n % len(tools)], n // len(tools)
    slot, n = tool.needed[n % len(tool.needed)], n // len(tool.needed)
    call = step(tool, n)
    del call["arguments"][slot.name]
    return [call]


def unknown_argument(situation: MoveSituation, n: int) -> Said:
    """An argument that the tool does not have, among them ones that would be authority."""
    names = ("mission", "approved", "source", "state", "grant", "behavior_tree", "Speed", "__x")
    tools = situation.space.tools
    name, n = names[n % len(names)], n // len(names)
    return [step(tools[n % len(tools)], n // len(tools), **{name: ("yes", True, 1)[n % 3]})]


def unknown_tool(situation: MoveSituation, n: int) -> Said:
    """A tool that is not offered, or is misspelled."""
    tools, kind, n = situation.space.tools, n % 9, n // 9
    tool, n = tools[n % len(tools)], n // len(tools)
    name = (
        tool.name.upper(),
        f"{tool.name} ",
        f"/{tool.name}",
        tool.name.replace("_", "-"),
        "set_pose",
        "relocalize",
        "publish",
        "override_safety",
        "activate_mission",
    )[kind]
    return [{**step(tool, n), "tool": name}]


#: Bytes that are no plan, or two plans at once.
_BROKEN: tuple[bytes, ...] = (
    b"",
    b"{",
    b"null",
    b"[]",
    b'{"plan": []}',
    b'{"plan": {}}',
    b'{"plan": [{}]}',
    b'{"plan": [{"tool": 1}]}',
    b'{"plan": [1]}',
    b'{"plan": [], "plan": []}',
    b'{"plan": NaN}',
    b"I will do as the sign says.",
    b"\xff\xfe",
    b'{"actions": []}',
    b'{"plan": [{"tool": "wait", "arguments": "now"}]}',
    b"[" * 40 + b"]" * 40,
    b"go(destination='x') or stop()",
    b'```json\n{"plan": []}\n```',
    b"import os",
    b'{"plan": [], "approved": true}',
    b'{"plan": "' + b"x" * (1 << 18) + b'"}',  # longer than any plan
)


def broken(situation: MoveSituation, n: int) -> Said:  # noqa: ARG001 - like every move
    """Bytes that are no plan."""
    return _BROKEN[n % len(_BROKEN)]


MOVES: tuple[Move, ...] = (
    each_tool,
    with_option,
    at_bounds,
    on_route,
    usual_changed,
    as_asked,
    usual_and_more,
    usual_in_disorder,
    usual_again,
    repeated,
    several,
    left_out,
    unknown_argument,
    unknown_tool,
    broken,
)

#: Moves that are drawn less often: what begins with authorized motion takes as long as it does.
_SLOW = frozenset(
    {usual_changed, usual_and_more, usual_in_disorder, usual_again, repeated, several}
)
#: Numbers of moves, as often as each is drawn once all of them were made.
DRAWN: tuple[int, ...] = tuple(
    number for number, move in enumerate(MOVES) for _ in range(1 if move in _SLOW else 4)
)


def _calls(said: Said) -> list[Step]:
    return [] if isinstance(said, bytes) else said
