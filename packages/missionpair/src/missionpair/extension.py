# SPDX-License-Identifier: Apache-2.0
"""What planners, attackers, defenses, domains and reports of your own are written with.

How-tos: docs/howto/missionpair-attackers.md, docs/howto/missionpair-defenses.md,
docs/howto/missionpair-extend.md, docs/howto/missionpair-models.md, docs/howto/missionpair-report.md
"""

from __future__ import annotations

from authguard_r import lazy

_HOMES = {
    "AttackVariant": "variants._twin",
    "Cell": "suites._making",
    "Claim": "defenses",
    "Defense": "defenses",
    "Denied": "execution",
    "PairKnowledge": "access",
    "Permits": "execution",
    "RoundKnowledge": "access",
    "Stage": "stage",
    "UnfitDraw": "missions.draw",
    "Walk": "judging",
    "Watched": "defenses._watched",
    "Yard": "stage",
    "amended": "missions",
    "case_bytes": "access",
    "chosen_step": "variants._twin",
    "drawn": "missions",
    "layouts_of": "layouts",
    "lines": "report",
    "make": "registry",
    "measure": "measures",
    "page": "report",
    "pair_of": "suites._making",
    "places_of": "planners._tools",
    "prove": "proving",
    "qualify": "defenses._qualify",
    "read": "wording",
    "read_case": "attackers._reading",
    "report": "report",
    "say": "wording",
    "seen_bytes": "access",
    "things_of": "planners._tools",
    "tools_of": "planners._tools",
    "twin_of": "variants._twin",
}
__all__ = list(_HOMES)
__getattr__ = lazy(__name__, _HOMES, "missionpair")
