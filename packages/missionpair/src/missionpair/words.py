# SPDX-License-Identifier: Apache-2.0
"""The words of the benchmark: what is attacked, how it is said, on which way it arrives, where.

A category and a domain may also be one that is not named here: a file in the folder `variants` or
`domains` makes it one. What is named here is what the shipped suites are made of; they are frozen,
so that a new file changes none of them.
Source: sections "Attack Categories" and "Attack Templates". Spec page: docs/spec/missionpair.md
"""

from __future__ import annotations

import re
from enum import StrEnum
from importlib.util import find_spec
from typing import Self

#: How a file in such a folder may call what it adds.
_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*", re.ASCII)
#: The file of `variants` whose attacks are of several categories, and of none of their own.
COMBINED = "combined"


class _Open(StrEnum):
    """Words that a file in such a folder may add to."""

    @classmethod
    def _folder(cls) -> str:
        raise NotImplementedError

    @classmethod
    def _missing_(cls, value: object) -> Self | None:
        """Return the word that a file of the folder adds; None where there is no such file."""
        if not isinstance(value, str) or not _NAME.fullmatch(value) or value == COMBINED:
            return None
        if find_spec(f"missionpair.{cls._folder()}.{value.replace('-', '_')}") is None:
            return None
        added = str.__new__(cls, value)
        added._name_, added._value_ = value.replace("-", "_").upper(), value
        return added


class Category(_Open):
    """What an attack changes; a pair that combines several names each of them."""

    @classmethod
    def _folder(cls) -> str:
        return "variants"

    GOAL = "goal"
    OBJECT = "object"
    AREA = "area"
    CAPABILITY = "capability"
    PARAMETER = "parameter"
    CROSS_ROBOT = "cross-robot"
    AVAILABILITY = "availability"
    PROVENANCE = "provenance"
    REPLAY = "replay"
    APPROVAL = "approval"


class Family(StrEnum):
    """What an attack claims."""

    DESTINATION_CHANGE = "destination-change"
    OBJECT_RELABELING = "object-relabeling"
    PRIVACY_ESCALATION = "privacy-escalation"
    FALSE_EMERGENCY = "false-emergency"
    ROUTE_EXPANSION = "route-expansion"


class Channel(StrEnum):
    """How a text reaches the planner."""

    USER = "user"
    SIGN = "sign"
    SPEECH = "speech"
    DOCUMENT = "document"
    MEMORY = "memory"
    SCENE = "scene"
    TOOL = "tool"


class Domain(_Open):
    """Where the robot works."""

    @classmethod
    def _folder(cls) -> str:
        return "domains"

    HOSPITAL = "hospital"
    WAREHOUSE = "warehouse"
    LABORATORY = "laboratory"
    OFFICE = "office"
    INSPECTION = "inspection"
    HOUSEHOLD = "household"


class Access(StrEnum):
    """What an attacker sees of a round; never keys, trusted state or nonces that are not out."""

    BLACK = "black"
    GREY = "grey"
    WHITE = "white"


class TrialKind(StrEnum):
    """What a trial tries.

    The attack; the same situation with nothing or with a neutral text in its place (the control
    arm); the mission as it is meant; or the same change made by its signer.
    """

    ATTACK = "attack"
    CONTROL = "control"
    NEUTRAL = "neutral"
    BENIGN = "benign"
    UPDATE = "update"


#: The control arm: what a planner does in the attacked situation when nobody attacks it.
CONTROLS = (TrialKind.CONTROL, TrialKind.NEUTRAL)
#: Kinds of trial in the attacked situation.
ATTACKED = frozenset({TrialKind.ATTACK, *CONTROLS})


#: The gate's own name of each channel (`authguard_r.site.channels`), which gives it its label.
GATE_CHANNELS: dict[Channel, str] = {
    Channel.USER: "user",
    Channel.SIGN: "ocr",
    Channel.SPEECH: "speech",
    Channel.DOCUMENT: "document",
    Channel.MEMORY: "memory",
    Channel.SCENE: "camera",
    Channel.TOOL: "tool",
}
