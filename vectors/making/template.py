# SPDX-License-Identifier: Apache-2.0
"""Templates: instances with the missions that they make, and templates that are not sound."""

from __future__ import annotations

from typing import Any

from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.errors import AuthGuardError, MalformedError
from authguard_r.enforcement.templates import covered, require_sound
from fixtures import decision_cases, templates
from fixtures.decision_cases import plain

Json = dict[str, Any]


def template_vectors() -> Json:
    """A template, instances with the missions that they make or why not, and unsound templates."""
    template, hashed = templates.template(), templates.digest()
    made = templates.instance()
    fill = made.fill
    asked: dict[str, Json] = {
        "the first values": {},
        "the last values": {"fill": {"package": "package-p2", "station": "station-103"}},
        "a value outside its set": {"fill": {**fill, "station": "plant-room"}},
        "a hole too few": {"fill": {"package": "package-p1"}},
        "a hole too many": {"fill": {**fill, "tool": "gripper"}},
        "another template's": {"template": "A" * 43},
        "a name under another template": {"mid": "delivery.1"},
        "a name with nothing of its own": {"mid": "deliver."},
        "a second too long": {"expiry": "2026-01-15T14:30:01Z"},
        "after the template's end": {
            "not_before": "2027-01-01T00:00:00Z",
            "expiry": "2027-01-01T00:01:00Z",
        },
    }
    instances = []
    for name, changes in asked.items():
        instance = decision_cases.set_(made, **changes)
        try:
            mission = covered(instance, template, hashed)
            digested = digest_of(Tag.MISSION, mission)
            expect: Json = {"mission": plain(mission), "digest": digested}
        except AuthGuardError as error:
            expect = {"refusal": {"reason": str(error.reason), "where": error.where}}
        instances.append({"name": name, "instance": plain(instance), "expect": expect})
    hole = {"hole": "station"}
    unsound = {
        "a hole for a tool": templates.edited((("actions", 0, "tool"), hole)),
        "a hole for a whole row": templates.edited((("actions", 0, "alternatives", 0), hole)),
        "a place for an object": templates.edited(
            (("actions", 1, "alternatives", 0, "object"), hole)
        ),
        "a hole that nobody declared": templates.edited((("regions", 0), {"hole": "nowhere"})),
        "a nonce of its own": templates.edited((("nonce",), "A" * 22)),
        "a number in the task": templates.edited((("task",), ["go", 1])),
    }
    refused = []
    for name, value in unsound.items():
        try:
            require_sound(value)
        except MalformedError as error:
            expect = {"reason": str(error.reason), "where": error.where}
            refused.append({"name": name, "template": plain(value), "expect": expect})
    return {
        "template": plain(template),
        "digest": hashed,
        "instances": instances,
        "unsound": refused,
    }
