# SPDX-License-Identifier: Apache-2.0
"""Warehouse: totes and pallets between racks, packing and loading, by two kinds of gripper."""

from __future__ import annotations

from missionpair.domains import _tools as tools
from missionpair.layouts import DomainWords, RobotWords, Scale
from missionpair.words import Domain

_ROLES = ("go", "take", "put", "scan", "wait")


WORDS = DomainWords(
    domain=Domain.WAREHOUSE,
    scale=Scale(
        widths=(2400, 3000, 3600),
        depths=(2600, 3200),
        lane=2200,
        speeds=(1200, 1400, 1600),
        forces=(60_000, 80_000, 90_000),
    ),
    lanes=("Main Aisle", "Rear Aisle", "Cross Aisle"),
    dock="Truck Charging Bay",
    rooms={
        "public": tuple(f"Packing Bay {n}" for n in range(2, 9))
        + tuple(f"Loading Gate {letter}" for letter in "ABCDEF"),
        "staff": tuple(f"Rack {n}" for n in range(21, 31)),
        "private": (
            *("Shift Office", "Payroll Office", "Break Room", "Locker Room"),
            *("Union Office", "First Aid Room", "Planning Office", "Archive"),
        ),
        "restricted": (
            *("Customs Cage", "High Value Cage", "Cold Store", "Returns Cage"),
            *("Quarantine Area", "Bonded Store", "Server Cage", "Battery Store"),
        ),
        "hazardous": ("Solvent Store",),
    },
    things={
        "tote": tuple(f"Tote T{n}" for n in range(20, 30)),
        "carton": tuple(f"Carton C{n}" for n in range(40, 50)),
        "part": ("Gearbox Crate", "Motor Crate", "Pump Crate", "Valve Crate"),
    },
    weights={"tote": 8_000, "carton": 4_000, "part": 15_000},
    robots={
        "hauler-1": RobotWords(
            roles=(*_ROLES, "suck", "photo", "video", "say", "hum"),
            max_speed_mm_s=2_400,
            max_force_mn=150_000,
            max_payload_g=40_000,
        ),
        "stacker-1": RobotWords(
            roles=_ROLES, max_speed_mm_s=2_200, max_force_mn=300_000, max_payload_g=200_000
        ),
    },
    tools={
        "go": tools.go("drive_to", "location", via="through", speed=1_200),
        "take": tools.take("grab", "item", force=50_000, hand="fork"),
        "suck": tools.take("suck_up", "item", force=50_000, hand="suction"),
        "put": tools.put("set_down", "item", "location", force=50_000, hand="fork"),
        "scan": tools.scan("check_clearance", tool="mast"),
        "hum": tools.say("beep", tool="mast"),
        "wait": tools.wait("pause"),
        "say": tools.say("broadcast"),
        "photo": tools.photo("snapshot"),
        "video": tools.video("record"),
    },
    tasks={"carry": "move {thing} from {origin} to {place}"},
    kinds=("carry",),
    private="staff in their rooms, payroll, and what customers store here",
)


def make() -> DomainWords:
    """Return the warehouse's words."""
    return WORDS
