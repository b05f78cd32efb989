# SPDX-License-Identifier: Apache-2.0
"""Mission templates: signed once with named holes over finite signed sets, filled many times.

An operator signs a template; a scheduler whose certificate is bound to the template's digest signs
instances. What comes out is a mission like any other, and never one that the operator's signature
does not cover. Spec page: docs/spec/template.md
"""

from __future__ import annotations

from authguard_r.enforcement.templates.expansion import combinations, expand, filled
from authguard_r.enforcement.templates.instance import (
    SCHEDULER_ROLES,
    Delegations,
    Instance,
    Instantiated,
    VerifiedTemplate,
    covered,
    instantiate,
    open_template,
    sign_instance,
)
from authguard_r.enforcement.templates.mission_cache import (
    HeldMission,
    claimed,
    claimed_mission,
    claimed_template,
    held_mission,
)
from authguard_r.enforcement.templates.template import Hole, HoleKind, Template, require_sound
from authguard_r.enforcement.templates.template_store import (
    InstancePair,
    KeptTemplate,
    TemplateStanding,
    is_pair,
)

__all__ = [
    "SCHEDULER_ROLES",
    "Delegations",
    "HeldMission",
    "Hole",
    "HoleKind",
    "Instance",
    "InstancePair",
    "Instantiated",
    "KeptTemplate",
    "Template",
    "TemplateStanding",
    "VerifiedTemplate",
    "claimed",
    "claimed_mission",
    "claimed_template",
    "combinations",
    "covered",
    "expand",
    "filled",
    "held_mission",
    "instantiate",
    "is_pair",
    "open_template",
    "require_sound",
    "sign_instance",
]
