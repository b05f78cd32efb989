# SPDX-License-Identifier: Apache-2.0
"""Filling a template, as docs/spec/template.md says it: values for holes, and nothing else.

Takes plain data. The caller holds what it returns to the mission's schema.
"""

from __future__ import annotations

from itertools import product
from typing import Any

Json = dict[str, Any]


def fills(template: Json) -> list[Json]:
    """Return every combination of values."""
    names = sorted(template["holes"])
    sets = [template["holes"][name]["values"] for name in names]
    return [dict(zip(names, values, strict=True)) for values in product(*sets)]


def covers(template: Json, template_digest: str, instance: Json, length_ms: int) -> bool:
    """True when an instance says nothing that the template's signer did not sign.

    The caller, which knows the time, asks whether it ends by `not_after`, and how many there were.
    """
    return (
        instance["template"] == template_digest
        and instance["fill"] in fills(template)
        and instance["mid"].partition(".")[0] == template["template"]
        and instance["mid"].partition(".")[2] != ""
        and length_ms <= template["for_ms"]
    )


def expand(template: Json, instance: Json) -> Json:
    """Return the mission of an instance."""
    mission: Json = filled(template["mission"], instance["fill"])
    task = mission["task"]
    if isinstance(task, list):
        mission["task"] = "".join(str(part) for part in task)
    mission["objects"] = sorted(mission["objects"])
    mission["regions"] = sorted(mission["regions"])
    for grant in mission["actions"]:
        for row in grant["alternatives"]:
            if "regions" in row:
                row["regions"] = sorted(row["regions"])
    for field in ("mid", "nonce", "not_before", "expiry"):
        mission[field] = instance[field]
    mission["version"] = 1
    return mission


def filled(value: Any, fill: Json) -> Any:
    """Return plain data with values where `{"hole": NAME}` stands."""
    if isinstance(value, dict):
        if list(value) == ["hole"] and isinstance(value["hole"], str):
            return fill[value["hole"]]
        return {key: filled(item, fill) for key, item in value.items()}
    if isinstance(value, list):
        return [filled(item, fill) for item in value]
    return value
