# SPDX-License-Identifier: Apache-2.0
"""What a machine must be for a gate, said of what it says of itself."""

from __future__ import annotations

from pathlib import Path

import pytest

from authguard_r.operations.checkup.advice import AdviceCode, Level, refuses_start
from authguard_r.operations.checkup.machine import (
    clock_state,
    kept_advice,
    machine_advice,
    platform_advice,
    python_advice,
    resolution_advice,
    room_advice,
    sqlite_advice,
)


def test_this_machine_can_run_a_gate() -> None:
    found = {item.code: item for item in machine_advice()}
    assert len(found) == 6
    assert [item for item in found.values() if item.level is Level.UNSAFE] == []


@pytest.mark.parametrize(
    ("version", "level"),
    [("3.40.1", Level.UNSAFE), ("3.51.2", Level.UNSAFE), ("3.51.3", Level.OK), ("3.54.1", "ok")],
)
def test_a_sqlite_that_can_corrupt_its_log_is_unsafe(version: str, level: Level) -> None:
    assert sqlite_advice(version).level == level


@pytest.mark.parametrize(
    ("version", "level"),
    [((3, 10, 9), "warning"), ((3, 11, 0), "ok"), ((3, 13, 9), "ok"), ((3, 14, 0), "warning")],
)
def test_a_python_that_is_not_tested_is_said(version: tuple[int, int, int], level: str) -> None:
    assert python_advice(version).level == level


def test_only_linux_enforces() -> None:
    assert platform_advice("linux").level is Level.OK
    assert platform_advice("darwin").level is Level.UNSAFE


def test_a_clock_that_nobody_keeps_is_said_and_refuses_no_start() -> None:
    assert kept_advice(0).level is Level.OK
    for state in (5, -1):
        assert kept_advice(state).level is Level.WARNING
        assert not refuses_start(kept_advice(state))
    assert -1 <= clock_state() <= 5


def test_a_monotonic_clock_in_leaps_is_unsafe() -> None:
    assert resolution_advice(1e-9).level is Level.OK
    assert refuses_start(resolution_advice(0.016))


def test_a_disk_without_the_reserve_is_unsafe_and_the_gate_still_serves_stops(
    tmp_path: Path,
) -> None:
    assert room_advice(tmp_path, 1).level is Level.OK
    assert room_advice(tmp_path, 0).level is Level.WARNING
    import shutil

    free = shutil.disk_usage(tmp_path).free
    assert room_advice(tmp_path, free // 2).level is Level.WARNING
    full = room_advice(tmp_path, 1 << 60)
    assert (full.level, full.code) == (Level.UNSAFE, AdviceCode.DISK)
    assert not refuses_start(full)
