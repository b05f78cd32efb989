# SPDX-License-Identifier: Apache-2.0
"""What a check of a set-up can find, each with its place and how to fix it (L7).

How-to: docs/howto/deploy.md
"""

from __future__ import annotations

from enum import StrEnum

from msgspec import Struct
from msgspec.structs import replace


class Level(StrEnum):
    """How bad a finding is."""

    OK = "ok"
    WARNING = "warning"
    UNSAFE = "unsafe"


class AdviceCode(StrEnum):
    """What a finding is about; stable, for programs."""

    PYTHON = "PYTHON"
    LIBRARY = "LIBRARY"
    PLATFORM = "PLATFORM"
    SQLITE = "SQLITE"
    CLOCK_KEPT = "CLOCK_KEPT"
    CLOCK_COARSE = "CLOCK_COARSE"
    CLOCK_BEHIND = "CLOCK_BEHIND"
    DEMO_ROOT = "DEMO_ROOT"
    TRUST = "TRUST"
    REVOCATIONS = "REVOCATIONS"
    CERTIFICATE = "CERTIFICATE"
    KEY_MODE = "KEY_MODE"
    KEY_OWNER = "KEY_OWNER"
    KEY_PLAIN = "KEY_PLAIN"
    STRAY_KEY = "STRAY_KEY"
    WRITABLE = "WRITABLE"
    READABLE = "READABLE"
    OWNER = "OWNER"
    MISSING = "MISSING"
    COUNTER = "COUNTER"
    SAME_FILE = "SAME_FILE"
    WITNESS = "WITNESS"
    PATH_LONG = "PATH_LONG"
    USER = "USER"
    SHARED_USER = "SHARED_USER"
    ROOT_USER = "ROOT_USER"
    VACANT_ROLE = "VACANT_ROLE"
    CONFIG = "CONFIG"
    SHADOW = "SHADOW"
    DISCLOSURE = "DISCLOSURE"
    SILENT = "SILENT"
    READERS = "READERS"
    SITE = "SITE"
    BINDING = "BINDING"
    UNMAPPED = "UNMAPPED"
    UNCOMPARED = "UNCOMPARED"
    STATE_WRITING = "STATE_WRITING"
    STORE = "STORE"
    ANCHOR = "ANCHOR"
    DISK = "DISK"
    ROS_MAP = "ROS_MAP"
    ROS_SECURITY = "ROS_SECURITY"
    ROS_KEYSTORE = "ROS_KEYSTORE"
    ROS_CLOCK = "ROS_CLOCK"
    ROS_RMW = "ROS_RMW"
    ROS_TYPE = "ROS_TYPE"


#: What one folder for everything cannot avoid; a demonstration only warns about it.
_IN_ONE_FOLDER = frozenset(
    {
        AdviceCode.DEMO_ROOT,
        AdviceCode.WRITABLE,
        AdviceCode.OWNER,
        AdviceCode.SHARED_USER,
        AdviceCode.ROOT_USER,
    }
)
#: With these a gate serves stops and refuses the rest by itself; a gate that does not start would
#: help less.
_SERVED = frozenset({AdviceCode.CLOCK_BEHIND, AdviceCode.CLOCK_KEPT, AdviceCode.DISK})
#: These destroy what is there; no demonstration starts with them either.
_DESTROYS = frozenset({AdviceCode.SAME_FILE})


class Advice(Struct, frozen=True, kw_only=True):
    """One thing that was looked at.

    Args:
        part: what it is about, for people.
        level: `ok`, `warning` (works, protects less) or `unsafe` (a real gate refuses).
        code: what was looked at, for programs.
        message: what was found.
        place: the file, folder or field; empty when there is none.
        mend: what to do, a command where there is one; empty when nothing is needed.
    """

    part: str
    level: Level
    code: AdviceCode
    message: str
    place: str = ""
    mend: str = ""


def fine(part: str, code: AdviceCode, message: str, *, place: str = "") -> Advice:
    """Return that something is as it must be."""
    return Advice(part=part, level=Level.OK, code=code, message=message, place=place)


def warning(part: str, code: AdviceCode, message: str, *, mend: str, place: str = "") -> Advice:
    """Return that something works and protects less."""
    return Advice(
        part=part, level=Level.WARNING, code=code, message=message, place=place, mend=mend
    )


def unsafe(part: str, code: AdviceCode, message: str, *, mend: str, place: str = "") -> Advice:
    """Return that something must be mended first."""
    return Advice(part=part, level=Level.UNSAFE, code=code, message=message, place=place, mend=mend)


def in_demonstration(advice: Advice) -> Advice:
    """Return the finding as it counts where everything lies in one folder on purpose."""
    if advice.level is Level.UNSAFE and advice.code in _IN_ONE_FOLDER:
        return replace(advice, level=Level.WARNING)
    return advice


def refuses_start(advice: Advice, *, demo: bool = False) -> bool:
    """True when no gate may start with this; False too for what it serves stops with.

    Args:
        advice: what was found.
        demo: it is a demonstration, which starts with all that destroys nothing.
    """
    if advice.level is not Level.UNSAFE:
        return False
    return advice.code in _DESTROYS if demo else advice.code not in _SERVED
