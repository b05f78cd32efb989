# SPDX-License-Identifier: Apache-2.0
"""Examples of plans, of another building, in the tools that a planner is offered.

They show the form and what a delivery takes, and name nothing of the site.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from missionpair.briefing import OfferedTool

#: The place and what is held at first, the task, and what is done for it: what a tool is for, the
#: place and the thing.
EXAMPLES: tuple[tuple[str, str, str, tuple[tuple[str, str, str], ...]], ...] = (
    (
        "Gate",
        "nothing",
        "Carry Box 7 from Hall A to Room B, then carry Crate 2 from Room C to Room D.",
        (
            ("Navigate", "Hall A", ""),
            ("Pick", "Hall A", "Box 7"),
            ("Navigate", "Room B", ""),
            ("Place", "Room B", "Box 7"),
            ("Navigate", "Room C", ""),
            ("Pick", "Room C", "Crate 2"),
            ("Navigate", "Room D", ""),
            ("Place", "Room D", "Crate 2"),
        ),
    ),
    (
        "Hall A",
        "nothing",
        "Carry Box 7 from Hall A to Room B.",
        (
            ("Pick", "Hall A", "Box 7"),
            ("Navigate", "Room B", ""),
            ("Place", "Room B", "Box 7"),
        ),
    ),
    (
        "Hall A",
        "Box 7",
        "Carry Box 7 from Hall A to Room B, then return to Gate.",
        (
            ("Navigate", "Room B", ""),
            ("Place", "Room B", "Box 7"),
            ("Navigate", "Gate", ""),
        ),
    ),
)


def examples(tools: tuple[OfferedTool, ...], *, one_by_one: bool) -> Iterator[str]:
    """Yield each example as text; none where a tool for it is missing.

    Args:
        tools: what is offered.
        one_by_one: one answer for each call, and the empty plan at the end.
    """
    for place, held, task, steps in EXAMPLES:
        calls = [_call(tools, *step) for step in steps]
        if not all(calls):
            return
        yield f"Example: the task is {json.dumps(task)}. "
        yield f"The robot is at {place} and holds {held}. "
        if one_by_one:
            answers = [f'{{"plan": [{call}]}}' for call in calls]
            yield "The answers are, in turn:\n"
            yield "".join(f"{answer}\n" for answer in (*answers, '{"plan": []}'))
        else:
            written = ",\n".join(f"  {call}" for call in calls)
            yield f'The answer is:\n{{"plan": [\n{written}\n]}}\n'


def _call(tools: tuple[OfferedTool, ...], purpose: str, place: str, thing: str) -> str:
    """Return the call of the first tool that is for this, with what it requires; else nothing."""
    for tool in tools:
        properties = tool.parameters.get("properties", {})
        required = tool.parameters.get("required", ())
        if tool.description.partition(",")[0] != purpose:
            continue
        said = {"destination": place, "thing": thing, "place": place}
        arguments: dict[str, Any] = {
            name: said.get(properties[name].get("description", ""), "") for name in required
        }
        if all(arguments.values()):
            return json.dumps({"tool": tool.name, "arguments": arguments})
    return ""
