# SPDX-License-Identifier: Apache-2.0
"""Where a value entered the system, which is not whether it is true.

Source: section "Provenance Labels" and `tab:provenance`. Spec page: docs/spec/provenance.md
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum


class Label(StrEnum):
    """The paper's finite set of source labels."""

    OPERATOR = "operator"
    SUPERVISOR = "supervisor"
    TRUSTED_SENSOR = "trusted_sensor"
    CAMERA = "camera"
    AUDIO = "audio"
    RETRIEVAL = "retrieval"
    MEMORY = "memory"
    MODEL = "model"


class Chooser(StrEnum):
    """Who may choose among the signed rows of a grant.

    `planner` says that the signer accepts every row, also one that an attacker picks.
    """

    OPERATOR = "operator"
    SUPERVISOR = "supervisor"
    TRUSTED_SENSOR = "trusted_sensor"
    PLANNER = "planner"


#: Most trusted first. Labels of equal trust differ only in the log.
TRUST: tuple[Label, ...] = (
    Label.OPERATOR,
    Label.SUPERVISOR,
    Label.TRUSTED_SENSOR,
    Label.MODEL,
    Label.MEMORY,
    Label.RETRIEVAL,
    Label.AUDIO,
    Label.CAMERA,
)

#: The fields of an action that have a label.
LABELED: tuple[str, ...] = ("type", "tool", "object", "source", "destination", "route", "params")


class SourceField(StrEnum):
    """The fields f that AllowedSrc(f) can be signed for.

    The first six are set by a proposal, `recording` and `approval_threshold` by the mission's
    signature, `position` and `state` (obstacles included) by what is attested.
    """

    TYPE = "type"
    TOOL = "tool"
    OBJECT = "object"
    DESTINATION = "destination"
    ROUTE = "route"
    PARAMETERS = "parameters"
    RECORDING = "recording"
    APPROVAL_THRESHOLD = "approval_threshold"
    POSITION = "position"
    STATE = "state"


#: Labels of a value that a person signed.
SIGNED: frozenset[Label] = frozenset({Label.OPERATOR, Label.SUPERVISOR})
#: Labels of a value that was neither signed nor attested.
UNTRUSTED: frozenset[Label] = frozenset(TRUST[TRUST.index(Label.MODEL) :])
_ATTESTED = frozenset({Label.TRUSTED_SENSOR})
_ANY = frozenset(Label)
#: The widest source set that can be signed for each field; what stands when none is signed, but
#: for object and destination (`core.checks.provenance.allowed_sources`).
WIDEST: dict[SourceField, frozenset[Label]] = {
    **dict.fromkeys(SourceField, _ANY),
    SourceField.RECORDING: SIGNED,
    SourceField.APPROVAL_THRESHOLD: SIGNED,
    SourceField.POSITION: _ATTESTED,
    SourceField.STATE: _ATTESTED,
}

#: AllowedSrc(f) by field; a field that is absent is not narrowed.
AllowedSources = Mapping[SourceField, frozenset[Label]]


def allowed_of(signed: Mapping[SourceField, tuple[Label, ...]]) -> AllowedSources:
    """Return signed source sets in the shape that the decision reads."""
    return {field: frozenset(labels) for field, labels in signed.items()}


def least_trusted(labels: frozenset[Label]) -> Label:
    """Return the label that a value takes when it may come from any of `labels`.

    `model` when nothing untrusted reached the planner: a planner's own words are never more.
    """
    return max(labels | {Label.MODEL}, key=TRUST.index)
