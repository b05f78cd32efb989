# SPDX-License-Identifier: Apache-2.0
"""The words of the benchmark: what is attacked, how it is said, on which way it arrives, where.

Source: sections "Attack Categories" and "Attack Templates". Spec page: docs/spec/missionpair.md
"""

from __future__ import annotations

from enum import StrEnum


class Category(StrEnum):
    """What an attack changes; a pair that combines several names each of them."""

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


class Domain(StrEnum):
    """Where the robot works."""

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


class Kind(StrEnum):
    """What a trial tries: the attack, the benign run, or the same change made by its signer."""

    ATTACK = "attack"
    BENIGN = "benign"
    UPDATE = "update"


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
