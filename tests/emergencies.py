# SPDX-License-Identifier: Apache-2.0
"""Emergency policies for tests: the hospital with a marked safe place."""

from __future__ import annotations

from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import msgspec

import worlds
from authguard_r.assembly import demo_members, folder_signer
from authguard_r.core.encoding import Tag
from authguard_r.core.identifiers import ActionType
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.token import sign_object
from authguard_r.emergency.opened import OpenedPolicy, open_emergency
from authguard_r.emergency.policy import Capability, EmergencyPolicy
from authguard_r.keys.setup import init_folder
from authguard_r.keys.trust import read_trust
from authguard_r.site.model import Emergency, Site, profile_digest, site_digest
from authguard_r.site.words import standard_words

DAY_MS = 86_400_000
WAY = ["dock", "public-corridor", "station-103"]


@cache
def site() -> Site:
    """Return the hospital with the dock marked as safe, and a gripper that lets go."""
    plain = worlds.site()
    robot = plain.robots[worlds.RID]
    tools = {**robot.profile.tools, ActionType("drop"): ("gripper",)}
    profile = msgspec.structs.replace(robot.profile, tools=tools)
    words = {**plain.vocabulary, ActionType("drop"): standard_words()[ActionType("drop")]}
    return msgspec.structs.replace(
        plain,
        robots={**plain.robots, worlds.RID: msgspec.structs.replace(robot, profile=profile)},
        vocabulary=words,
        emergency=Emergency(places={"dock": "charging"}),
    )


@cache
def trust_folder() -> Path:
    """Return a set-up whose gate is certified for that site's profile."""
    folder = Path(mkdtemp(prefix="authguard-test-")) / "trust"
    begin = datetime.fromtimestamp(worlds.START_MS / 1000, UTC)
    init_folder(folder, demo_members(site(), (worlds.RID,)), now=begin)
    return folder


def guard(variable: str, comparison: str, value: Any, max_age_ms: int = 500) -> dict[str, Any]:
    return {
        "variable": variable,
        "comparison": comparison,
        "value": value,
        "max_age_ms": max_age_ms,
    }


#: The battery of a fresh robot is full: the first holds, the second does not.
TRUE, FALSE = guard("battery_permille", "le", 1_000), guard("battery_permille", "le", 100)
GO_SAFE: dict[str, Any] = {
    "id": "go-safe",
    "aim": "safe_place",
    "type": "navigate",
    "tool": "base",
    "destination": "dock",
    "params": {"speed_mm_s": 300},
    "regions": WAY,
    "place_max_age_ms": 1_000,
    "guards": [TRUE],
    "callers": ["operator", "planner"],
    "without": ["clock", "mission", "store"],
    "max_ms": 120_000,
    "per_hour": 3,
}
CALL: dict[str, Any] = {
    "id": "call-help",
    "aim": "call_help",
    "type": "announce",
    "tool": "speaker",
    "guards": [FALSE],
    "callers": ["operator", "planner"],
    "without": ["mission"],
    "max_ms": 5_000,
    "per_hour": 10,
}
LET_GO: dict[str, Any] = {
    "id": "let-go",
    "aim": "release_force",
    "type": "drop",
    "tool": "gripper",
    "guards": [guard("holding", "ne", "nothing")],
    "callers": ["gate", "operator"],
    "without": ["mission"],
    "max_ms": 5_000,
    "per_hour": 10,
}


def policy(
    *capabilities: dict[str, Any], at: Site | None = None, **changes: Any
) -> EmergencyPolicy:
    """Return a policy of the courier with these capabilities, or with the three above."""
    here = at or site()
    plain = {
        "schema": "authguard-r/emergency-policy/1",
        "id": "courier-emergency",
        "version": 1,
        "robot": worlds.RID,
        "profile": profile_digest(here.robots[worlds.RID].profile),
        "site": site_digest(here),
        "not_before": to_timestamp(worlds.START_MS - DAY_MS // 24),
        "expiry": to_timestamp(worlds.START_MS + 30 * DAY_MS),
        "capabilities": list(capabilities or (GO_SAFE, CALL, LET_GO)),
        **changes,
    }
    return msgspec.convert(plain, EmergencyPolicy)


def capability(**changes: Any) -> Capability:
    return msgspec.convert({**GO_SAFE, **changes}, Capability)


def token(
    value: EmergencyPolicy, *, by: str = "safety-officer-1", folder: Path | None = None
) -> bytes:
    signer = folder_signer(folder or trust_folder(), by)
    return sign_object(value, Tag.EMERGENCY_POLICY, signer)


def opened(value: EmergencyPolicy | None = None) -> OpenedPolicy:
    """Return the policy as a gate has it."""
    return open_emergency(
        token(value or policy()),
        verifier=read_trust(trust_folder()),
        now=worlds.NOW,
        site=site(),
        robot=worlds.RID,
    )
