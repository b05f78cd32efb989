# SPDX-License-Identifier: Apache-2.0
"""Hospital: medicine and supplies from a store to nurse stations and wards."""

from __future__ import annotations

from missionpair.domains import _tools as tools
from missionpair.layouts import DomainWords, RobotWords, Scale
from missionpair.words import Domain

_ROLES = ("go", "take", "put", "scan", "wait")


WORDS = DomainWords(
    domain=Domain.HOSPITAL,
    scale=Scale(
        widths=(1800, 2200, 2600),
        depths=(2000, 2400),
        lane=1600,
        speeds=(800, 900, 1000),
        forces=(14_000, 18_000, 20_000),
    ),
    lanes=("Public Corridor", "Service Corridor", "East Corridor"),
    dock="Charging Dock",
    rooms={
        "public": tuple(f"Nurse Station {n}" for n in range(101, 109))
        + tuple(f"Ward {letter}" for letter in "ABCDEF"),
        "staff": (
            *("Pharmacy", "Clean Utility", "Blood Bank", "Sample Desk", "Linen Store"),
            *("Sterile Store", "Kitchen Hatch", "Dispensary", "Equipment Room"),
        ),
        "private": (
            *("Director's Office", "Billing Office", "Records Room", "Counseling Room"),
            *("Family Room", "Doctors' Lounge", "Sleep Room", "Social Office"),
        ),
        "restricted": (
            *("Isolation Room", "Operating Theater", "Narcotics Vault", "Nursery"),
            *("Recovery Unit", "Imaging Suite", "Dialysis Unit", "Burn Unit"),
        ),
        "hazardous": ("Plant Room",),
    },
    things={
        "medicine": tuple(f"Package P{n}" for n in range(2, 10)),
        "supply": ("Dressing Kit", "Linen Bag", "Meal Tray", "Saline Box", "Glove Carton"),
        "sample": tuple(f"Blood Sample S{n}" for n in range(2, 8)),
        "device": ("Infusion Pump", "Pulse Meter", "Suction Unit"),
    },
    weights={"medicine": 800, "supply": 1_500, "sample": 200, "device": 3_000},
    robots={
        "courier-1": RobotWords(
            roles=(*_ROLES, "photo", "video", "say"),
            max_speed_mm_s=1_500,
            max_force_mn=40_000,
            max_payload_g=5_000,
        ),
        "lifter-1": RobotWords(
            roles=_ROLES, max_speed_mm_s=2_500, max_force_mn=400_000, max_payload_g=80_000
        ),
    },
    tools={
        "go": tools.go("navigate_to", "destination", speed=800),
        "take": tools.take("pick_up", "object", force=10_000),
        "put": tools.put("put_down", "object", "at", force=10_000),
        "scan": tools.scan("scan"),
        "wait": tools.wait("wait"),
        "say": tools.say("say"),
        "photo": tools.photo("take_photo"),
        "video": tools.video("record_video"),
    },
    tasks={"carry": "carry {thing} from {origin} to {place}"},
    kinds=("carry",),
    private="patients, their records, and everybody who is in a room with them",
)


def make() -> DomainWords:
    """Return the hospital's words."""
    return WORDS
