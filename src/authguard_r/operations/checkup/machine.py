# SPDX-License-Identifier: Apache-2.0
"""What a gate needs of the machine that it runs on: Python, SQLite, clocks, room.

How-to: docs/howto/deploy.md
"""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import apsw
import cryptography

from authguard_r.operations.checkup.advice import Advice, AdviceCode, fine, unsafe, warning

#: First SQLite without the WAL-reset corruption bug.
_OLDEST_SQLITE = (3, 51, 3)
#: The versions of Python that are tested.
_TESTED = ((3, 11), (3, 14))
#: `struct timex` has at most 208 bytes; all zero, it asks and sets nothing.
_TIMEX_BYTES = 512
#: What adjtimex(2) returns while the clock is not synchronized.
_TIME_ERROR = 5
#: A lease is looked at every 100 ms; a clock that steps by more than this is too coarse for it.
_COARSEST_S = 0.01


def machine_advice() -> Iterator[Advice]:
    """Yield what this machine is to a gate."""
    yield python_advice(sys.version_info[:3])
    yield fine("cryptography", AdviceCode.LIBRARY, cryptography.__version__)
    yield sqlite_advice(apsw.sqlite_lib_version())
    yield platform_advice(sys.platform)
    yield kept_advice(clock_state())
    yield resolution_advice(time.get_clock_info("monotonic").resolution)


def python_advice(version: tuple[int, int, int]) -> Advice:
    """Return whether this Python is one that is tested."""
    told = ".".join(map(str, version))
    first, beyond = _TESTED
    if first <= version[:2] < beyond:
        return fine("python", AdviceCode.PYTHON, told)
    return warning(
        "python", AdviceCode.PYTHON, f"{told} is not tested", mend="use Python 3.11 to 3.13"
    )


def sqlite_advice(version: str) -> Advice:
    """Return whether this SQLite keeps a WAL whole."""
    if tuple(map(int, version.split("."))) >= _OLDEST_SQLITE:
        return fine("sqlite", AdviceCode.SQLITE, version)
    return unsafe(
        "sqlite",
        AdviceCode.SQLITE,
        f"{version} can corrupt a WAL",
        mend="install apsw's own wheel, which brings 3.51.3 or newer",
    )


def platform_advice(platform: str) -> Advice:
    """Return whether a gate can hold a robot on this system."""
    if platform.startswith("linux"):
        return fine("platform", AdviceCode.PLATFORM, platform)
    return unsafe(
        "platform",
        AdviceCode.PLATFORM,
        f"{platform}: missions can be written and signed here, not enforced",
        mend="run the gate on Linux",
    )


def clock_state() -> int:
    """Return what adjtimex(2) returns: 5 while the clock is not synchronized, -1 on an error."""
    try:
        import ctypes  # here, because a hardened process may not load it

        asked = ctypes.create_string_buffer(_TIMEX_BYTES)
        return int(ctypes.CDLL(None).adjtimex(asked))
    except (ImportError, MemoryError, AttributeError, OSError):  # pragma: no cover - hardened
        return -1


def kept_advice(state: int) -> Advice:
    """Return whether the wall clock is synchronized, as `clock_state` says."""
    if 0 <= state < _TIME_ERROR:
        return fine("clock", AdviceCode.CLOCK_KEPT, "synchronized")
    told = "not synchronized" if state == _TIME_ERROR else "the system does not name its source"
    return warning(
        "clock",
        AdviceCode.CLOCK_KEPT,
        f"{told}: missions begin and end by it",
        mend="timedatectl set-ntp true",
    )


def resolution_advice(seconds: float) -> Advice:
    """Return whether the monotonic clock is fine enough to watch a lease by."""
    if seconds <= _COARSEST_S:
        return fine("monotonic clock", AdviceCode.CLOCK_COARSE, f"steps of {seconds:g} s")
    return unsafe(
        "monotonic clock",
        AdviceCode.CLOCK_COARSE,
        f"steps of {seconds:g} s are too coarse to watch a motion by",
        mend="use a machine whose monotonic clock steps by 10 ms or less",
    )


def room_advice(folder: Path, reserve_bytes: int) -> Advice:
    """Return whether the store's disk has room for more than what is kept back.

    Args:
        folder: the store's, existing.
        reserve_bytes: from the signed configuration.
    """
    free = shutil.disk_usage(folder).free
    told = f"{free >> 20} MiB free, {reserve_bytes >> 20} MiB of it reserved"
    if free < reserve_bytes:
        return unsafe(
            "disk",
            AdviceCode.DISK,
            f"{told}: everything but stops and management is refused",
            place=str(folder),
            mend="make room",
        )
    if free < 4 * reserve_bytes or reserve_bytes == 0:
        return warning("disk", AdviceCode.DISK, told, place=str(folder), mend="make room")
    return fine("disk", AdviceCode.DISK, told, place=str(folder))
