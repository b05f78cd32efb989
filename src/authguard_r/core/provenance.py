# SPDX-License-Identifier: Apache-2.0
"""Where a value entered the system, which is not whether it is true.

Source: section "Provenance Labels" and `tab:provenance`. Spec page: docs/spec/provenance.md
"""

from __future__ import annotations

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


#: Most trusted first. Labels of equal trust are told apart only for the log.
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

#: The fields of an action that carry authority and therefore a label (AllowedSrc(f) of the paper).
PRIVILEGED: tuple[str, ...] = ("object", "source", "destination", "route")


def least_trusted(labels: frozenset[Label]) -> Label:
    """Return the label that a value takes when it may come from any of `labels`.

    `model` when nothing untrusted reached the planner: a planner's own words are never more.
    """
    return max(labels | {Label.MODEL}, key=TRUST.index)
