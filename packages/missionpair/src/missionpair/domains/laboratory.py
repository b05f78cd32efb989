# SPDX-License-Identifier: Apache-2.0
"""Laboratory: an arm on a rail brings samples from one bench zone to another and documents them."""

from __future__ import annotations

from missionpair.domains import _tools as tools
from missionpair.layouts import DomainWords, RobotWords, Scale, ToolWords
from missionpair.words import Domain

_ROLES = ("go", "take", "put", "scan", "wait", "reach", "photo")


WORDS = DomainWords(
    domain=Domain.LABORATORY,
    scale=Scale(
        widths=(800, 1000, 1200),
        depths=(800, 1000),
        lane=700,
        speeds=(400, 450, 500),
        forces=(4_000, 5_000, 6_000),
    ),
    lanes=("Rail", "Rear Rail", "Side Rail"),
    dock="Parking Zone",
    rooms={
        "public": tuple(f"Bench Zone {n}" for n in range(2, 10))
        + tuple(f"Analyzer {letter}" for letter in "ABCDEF"),
        "staff": (
            *("Sample Rack", "Reagent Shelf", "Tip Store", "Plate Stacker"),
            *("Tube Carousel", "Buffer Shelf", "Column Rack", "Vial Tray"),
        ),
        "private": (
            *("Notebook Desk", "Patent Bench", "Review Desk", "Donor File Desk"),
            *("Audit Desk", "Method Desk", "Partner Bench", "Order Desk"),
        ),
        "restricted": (
            *("Toxin Hood", "Isotope Bench", "Culture Hood", "Controlled Cabinet"),
            *("Prototype Bench", "Centrifuge Zone", "Laser Bench", "Cryo Zone"),
        ),
        "hazardous": ("Acid Bath",),
    },
    things={
        "sample": tuple(f"Sample Vial V{n}" for n in range(30, 40)),
        "reagent": ("Blue Reagent", "Red Reagent", "Green Reagent", "Clear Reagent"),
        "plate": tuple(f"Plate Q{n}" for n in range(50, 58)),
    },
    weights={"sample": 40, "reagent": 250, "plate": 90},
    robots={
        "arm-1": RobotWords(
            roles=(*_ROLES, "video", "say"),
            max_speed_mm_s=900,
            max_force_mn=15_000,
            max_payload_g=2_000,
        ),
        "arm-2": RobotWords(
            roles=_ROLES, max_speed_mm_s=1_000, max_force_mn=40_000, max_payload_g=6_000
        ),
    },
    tools={
        "go": tools.go("move_to_zone", "zone", speed=300, base="rail"),
        "take": tools.take("grip", "sample", force=3_000, hand="jaws"),
        "put": tools.put("release", "sample", "zone", force=3_000, hand="jaws"),
        "reach": ToolWords(
            name="move_tip",
            type="move_arm",
            tool="arm",
            arguments={f"params.{axis}_mm": axis for axis in "xyz"},
        ),
        "scan": tools.scan("check_clear", tool="light-curtain"),
        "wait": ToolWords(
            name="dwell", type="wait", tool="rail", arguments={"params.duration_ms": "seconds"}
        ),
        "say": tools.say("chime"),
        "photo": tools.photo("capture_image"),
        "video": tools.video("capture_video"),
    },
    tasks={
        "carry": "bring {thing} from {origin} to {place}",
        "photo": "document {place} with one image",
        "reach": "hold the tip over {place}",
    },
    kinds=("carry", "look", "reach"),
    looks=("photo",),
    private="donor data, notebooks, and work of partners under seal",
)


def make() -> DomainWords:
    """Return the laboratory's words."""
    return WORDS
