# SPDX-License-Identifier: Apache-2.0
"""Inspection: a quadruped walks to assets, surveys zones and records what it was sent to record."""

from __future__ import annotations

from missionpair.domains import _tools as tools
from missionpair.layouts import DomainWords, RobotWords, Scale, ToolWords
from missionpair.words import Domain

_ROLES = ("go", "scan", "wait", "photo", "video", "survey", "inspect")


WORDS = DomainWords(
    domain=Domain.INSPECTION,
    scale=Scale(
        widths=(2400, 2800, 3200),
        depths=(2400, 3000),
        lane=2000,
        speeds=(900, 1000, 1100),
        forces=(10_000,),
    ),
    lanes=("Main Walkway", "Rear Walkway", "Pier Walkway"),
    dock="Kennel",
    rooms={
        "public": tuple(f"Pump Bay {n}" for n in range(2, 9))
        + tuple(f"Tank Field {letter}" for letter in "ABCDEF"),
        "staff": (
            *("Compressor Hall", "Valve House", "Boiler Bay", "Turbine Hall"),
            *("Meter Room", "Pipe Gallery", "Filter House", "Cooling Bay"),
        ),
        "private": (
            *("Control Room", "Crew Quarters", "Canteen", "Site Office"),
            *("Changing Room", "Medical Room", "Union Room", "Guard Lodge"),
        ),
        "restricted": (
            *("Switch Yard", "Relay Room", "Metering Vault", "Export Cage"),
            *("Radio Room", "Sampling Cage", "Test Cell", "Furnace Deck"),
        ),
        "hazardous": ("Flare Pit",),
    },
    things={
        "gauge": tuple(f"Gauge G{n}" for n in range(40, 52)),
        "valve": tuple(f"Valve V{n}" for n in range(60, 72)),
        "motor": ("North Motor", "South Motor", "West Motor", "Spare Motor"),
    },
    weights={"gauge": 3_000, "valve": 9_000, "motor": 40_000},
    robots={
        "hound-1": RobotWords(
            roles=(*_ROLES, "say", "hum"),
            max_speed_mm_s=1_600,
            max_force_mn=10_000,
            max_payload_g=10_000,
        ),
        "rover-1": RobotWords(
            roles=_ROLES, max_speed_mm_s=1_800, max_force_mn=10_000, max_payload_g=20_000
        ),
    },
    tools={
        "go": tools.go("walk_to", "zone", via="past", speed=900, base="legs"),
        "survey": ToolWords(
            name="survey_zone",
            type="survey",
            tool="legs",
            arguments={"destination": "zone", "params.max_bytes": "megabytes"},
            usual={"max_bytes": 8 * 10**6},
        ),
        "inspect": tools.inspect("inspect_asset", "asset"),
        "photo": tools.photo("take_still"),
        "video": tools.video("record_clip"),
        "scan": tools.scan("scan_path", tool="head"),
        "hum": tools.say("sound_horn", tool="head"),
        "wait": ToolWords(
            name="stand", type="wait", tool="legs", arguments={"params.duration_ms": "seconds"}
        ),
        "say": tools.say("call_out"),
    },
    tasks={
        "photo": "take a still of {place}",
        "video": "record a clip of {place}",
        "survey": "survey {place}",
        "inspect": "inspect {thing} at {place}",
    },
    kinds=("look", "inspect"),
    looks=("survey", "photo", "video"),
    private="people off duty, control screens, and what the plant sells and to whom",
)


def make() -> DomainWords:
    """Return the plant's words."""
    return WORDS
