# SPDX-License-Identifier: Apache-2.0
"""AllowedSrc(f): which labels may set which field; docs/spec/provenance.md, `tab:provenance`."""

from typing import Any

Json = dict[str, Any]

SIGNED: list[str] = ["operator", "supervisor"]
UNTRUSTED: list[str] = ["camera", "audio", "retrieval", "memory", "model"]
ALL: list[str] = [*SIGNED, "trusted_sensor", *UNTRUSTED]


def label_of_signer(role: str) -> str:
    """Name the label of what a person signs.

    Args:
        role: The role of the signer's certificate.

    Returns:
        operator for an operator, supervisor for a role above.
    """
    return "operator" if role == "operator" else "supervisor"


def rows_in_question(grant: Json, standing: Json | None) -> list[int]:
    """List the rows that may match.

    Args:
        grant: The grant.
        standing: The standing, or None.

    Returns:
        The index of the selected row if a selection names one, else of all rows.
    """
    indices = list(range(len(grant["alternatives"])))
    held = standing if standing is not None else {}
    selected = held.get("selected", {}).get(grant["id"])
    return [selected] if selected in indices else indices


def proposed(action: Json, field: str) -> str:
    """Name the label of a value that the planner set.

    Args:
        action: The normalized action.
        field: The field of the action.

    Returns:
        The label, or "unknown" when the action has none that a planner's value can have.
    """
    label: str = action.get("provenance", {}).get(field, "unknown")
    return label if label in UNTRUSTED else "unknown"


def label_of_choice(
    field: str, grant: Json, action: Json, standing: Json | None, issuer: str
) -> str:
    """Name who set the object or the destination.

    Args:
        field: object or destination.
        grant: The grant.
        action: The normalized action.
        standing: The standing, or None.
        issuer: The label of what the mission's issuer signs.

    Returns:
        The label.
    """
    rows = grant["alternatives"]
    if len({row.get(field) for row in rows}) == 1:  # absent counts as a value: None
        return issuer
    chosen = [rows[index] for index in rows_in_question(grant, standing)]
    if len({row.get(field) for row in chosen}) == 1:
        return "supervisor" if grant.get("chooser") == "supervisor" else "operator"
    here = [row for row in chosen if "source" not in row or row["source"] == action.get("source")]
    left = here if here != [] else chosen
    if len({row.get(field) for row in left}) == 1:
        return "trusted_sensor"
    return proposed(action, field)


def allowed(field: str, grant: Json, mission: Json, facts: Json) -> list[str]:
    """List AllowedSrc(f).

    Args:
        field: The field f.
        grant: The grant.
        mission: The mission, with its signed sets.
        facts: The facts, with the site's signed sets.

    Returns:
        The labels that may set the field; unknown is among them where every label is.
    """
    labels = list(ALL)
    if field in ("recording", "approval_threshold"):
        labels = list(SIGNED)
    if field in ("object", "destination") and grant.get("chooser") != "planner":
        labels = list(SIGNED)
        if len(grant["alternatives"]) > 1:
            labels.append("trusted_sensor")
    for signed in (facts.get("sources", {}), mission.get("sources", {})):
        if field in signed:
            labels = [label for label in labels if label in signed[field]]
    return [*labels, "unknown"] if sorted(labels) == sorted(ALL) else labels


def provenance_findings(
    grant: Json,
    mission: Json,
    action: Json,
    *,
    facts: Json,
    standing: Json | None,
    issuer: str,
) -> list[str]:
    """Check that every field was set by a label that may set it.

    Args:
        grant: The grant.
        mission: The mission.
        action: The normalized action.
        facts: The facts of the site and the robot.
        standing: The standing, or None.
        issuer: The label of what the mission's issuer signs.

    Returns:
        PROVENANCE_DENIED for each field that was not.
    """
    labels: dict[str, str] = {
        "type": proposed(action, "type"),
        "tool": proposed(action, "tool"),
        "approval_threshold": issuer,
    }
    for field in ("object", "destination"):
        labels[field] = label_of_choice(field, grant, action, standing, issuer)
    if action.get("route", []) != []:
        labels["route"] = proposed(action, "route")
    if any(limit["low"] != limit["high"] for limit in grant.get("limits", [])):
        labels["parameters"] = proposed(action, "params")
    kind = facts["vocabulary"].get(action["type"], {})
    if any(kind.get(does, False) for does in ("records", "stores", "transmits")):
        labels["recording"] = issuer
    return [
        "PROVENANCE_DENIED"
        for field, label in labels.items()
        if label not in allowed(field, grant, mission, facts)
    ]
