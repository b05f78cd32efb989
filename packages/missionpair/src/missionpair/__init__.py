# SPDX-License-Identifier: Apache-2.0
"""MissionPAIR: attacks that are safe and unauthorized, and how many of them get through.

The public interface is the names in `__all__`, and `missionpair.extension` for your own planners,
attackers, defenses and domains; docs/reference/python.md shows each. Everything else is
internal and may change in any release.
"""

from __future__ import annotations

from authguard_r import lazy

_HOMES = {
    "Access": "words",
    "Briefing": "briefing",
    "Campaign": "records",
    "Category": "words",
    "Channel": "words",
    "Domain": "words",
    "Family": "words",
    "Input": "pair",
    "LogWriter": "campaign.log",
    "NamedPart": "records",
    "OfferedTool": "briefing",
    "Reply": "briefing",
    "Round": "records",
    "SCHEMA": "records",
    "Suite": "pair",
    "Timing": "records",
    "Trial": "records",
    "WordedCall": "pair",
    "plan_bytes": "pair",
    "read_log": "campaign.log",
}
__all__ = list(_HOMES)
__getattr__ = lazy(__name__, _HOMES, "missionpair")
