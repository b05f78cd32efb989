# SPDX-License-Identifier: Apache-2.0
"""The tools that a planner is offered: those of its binding that its robot has.

Spec page: docs/spec/adapters.md#schemas
"""

from __future__ import annotations

from collections.abc import Mapping
from sys import maxsize
from types import MappingProxyType

from authguard_r.core.identifiers import RobotId
from authguard_r.integrations.tools.argument_schema import ArgumentSchemas, places_of, things_of
from authguard_r.integrations.tools.tool_schemas import tool_schemas
from authguard_r.normalize.binding import Binding, ToolBinding
from authguard_r.site.model import Site
from missionpair.briefing import OfferedTool

__all__ = ["places_of", "things_of", "tools_of"]


def tools_of(
    site: Site,
    binding: Binding,
    *,
    robot: RobotId | None = None,
    beyond: Mapping[str, str] = MappingProxyType({}),
    in_words: bool = True,
) -> tuple[OfferedTool, ...]:
    """Return the tools of a binding, in its order.

    Args:
        site: whose names and words they speak.
        binding: the planner's interface.
        robot: leave out what it cannot do; None offers every tool.
        beyond: tools by action type that are offered although the robot's profile lacks them.
        in_words: list the names that an argument may be; else it is any text, as interfaces have it
            that do not know their site.
    """
    able = None if robot is None else site.robots[robot].profile.tools
    more = set(beyond.items())

    def usable(way: ToolBinding) -> bool:
        return able is None or way.tool in able.get(way.type, ()) or (way.type, way.tool) in more

    words = ArgumentSchemas(site, names=maxsize if in_words else 0, most=_most(site, robot))
    offered = tool_schemas(binding, site, arguments=words, usable=usable)
    return tuple(OfferedTool(tool.name, tool.description, tool.parameters) for tool in offered)


def _most(site: Site, robot: RobotId | None) -> dict[str, int]:
    """Return how fast and how hard a robot can, by parameter; nothing of any robot."""
    if robot is None:
        return {}
    profile = site.robots[robot].profile
    return {"speed_mm_s": profile.max_speed_mm_s, "force_mn": profile.max_force_mn}
