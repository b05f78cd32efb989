# SPDX-License-Identifier: Apache-2.0
"""An emergency at a gate that runs: without a mission, on a full disk, by a wrong clock, killed.

Real processes. What was done is in the log exactly once, whatever ended the gate that did it.
"""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.core.quantities import to_timestamp
from authguard_r.emergency.policy import EmergencyPolicy
from authguard_r.wire.messages import ClientRole
from fixtures import emergency_policies, scenarios
from fixtures.gate_process import AUTHGUARD, PATIENCE_S, RunningGate, until
from integration.test_gate_recovery import fill, turn_the_clock_back
from integration.test_gate_watching import connected, operator

HOUR_MS = 3_600_000
#: A day that is over, whatever the clock says.
OVER = {"not_before": "2020-01-01T00:00:00Z", "expiry": "2020-01-02T00:00:00Z"}
FAST = ("--speed-up", "50", "--at", "station-103")


def site_file(folder: Path) -> Path:
    """Write the hospital with its safe place as people write it."""
    path = folder / "site.json.yaml"
    path.write_bytes(msgspec.json.encode(emergency_policies.site()))
    return path


def policy_now(*capabilities: dict[str, Any], **changes: Any) -> EmergencyPolicy:
    """Return a policy by the clock of the machine, which is a real gate's."""
    now = time.time_ns() // 1_000_000
    times = {
        "not_before": to_timestamp(now - HOUR_MS),
        "expiry": to_timestamp(now + 30 * emergency_policies.DAY_MS),
    }
    return emergency_policies.policy(*capabilities, **{**times, **changes})


class Ward(RunningGate):
    """A gate with an emergency policy."""

    def __init__(self, folder: Path, *capabilities: dict[str, Any], **more: Any) -> None:
        super().__init__(
            **{
                "robot": FAST,
                "estimator": True,
                "site": site_file(folder),
                "trust": emergency_policies.trust_folder(),
                **more,
            }
        )
        self.policy = folder / "emergency.token"
        self.policy.write_bytes(emergency_policies.token(policy_now(*capabilities)))

    def start_gate(self, *more: str) -> dict[str, Any]:
        return super().start_gate("--emergency-policy", str(self.policy), *more)

    def call(self, capability: str, name: str = "planner") -> dict[str, Any]:
        with self.client(ClientRole.PLANNER, name) as planner:
            return planner.emergency(capability, timeout_ms=int(PATIENCE_S * 1_000))

    def told(self) -> list[tuple[str, int]]:
        """Return what the log says of emergencies: decision, and number in the journal."""
        return [
            (r.decision, r.open.get("journal", 0))
            for r in self.records()
            if r.kind == "emergency" and r.decision != "policy"
        ]

    def verified(self) -> bool:
        done = subprocess.run(
            [AUTHGUARD, "audit", "verify", self.store], capture_output=True, check=False
        )
        return done.returncode == 0


@pytest.fixture
def ward(tmp_path: Path) -> Iterator[Ward]:
    with Ward(tmp_path) as running:
        yield running


@pytest.mark.smoke
def test_a_real_one_is_carried_out_without_a_mission_and_by_a_clock_that_is_behind(
    ward: Ward,
) -> None:
    assert ward.call("go-safe")["execution"]["outcome"] == "succeeded"
    false = ward.call("call-help")
    assert (false["outcome"], false["reasons"]) == ("reject", ["GUARD_FALSE"])
    with operator(ward) as person:
        alerts = [alert["what"] for alert in person.status()["alerts"]]
    assert alerts == ["emergency", "false emergency"]
    assert ward.stop_process("gate") == 0
    turn_the_clock_back(ward, HOUR_MS)
    ward.start_gate()
    until(lambda: connected(ward), "the controller's return")

    def works() -> bool:
        answer = ward.call("go-safe")  # its state may not have come yet
        return bool(answer["execution"]["outcome"] == "succeeded")

    until(works, "an emergency by a wrong clock")
    assert ward.told()[-1] == ("succeeded", 0)
    assert ward.stop_process("gate") == 0
    assert ward.verified()


def test_what_a_full_disk_did_not_take_is_in_the_log_once_after_a_kill(tmp_path: Path) -> None:
    if os.geteuid() != 0:
        pytest.skip("mounting a small file system needs root")
    often = {**emergency_policies.GO_SAFE, "per_hour": 60}
    ward = Ward(tmp_path, often, reserve_bytes=0)
    disk = ward.folder / "disk"
    disk.mkdir()
    if os.system(f"mount -t tmpfs -o size=8m tmpfs {disk} 2>/dev/null") != 0:
        ward.end()
        pytest.skip("this machine lets nobody mount a file system")
    ward.store = disk / "robot.db"
    try:
        with ward:
            filler = fill(disk / "filler")
            while not journaled(ward):
                fill_up(ward)
            ward.kill9()
            filler.unlink()
            ward.start_gate()
            until(lambda: connected(ward), "the controller's return")
            numbers = [number for _, number in until(ward.told, "the replay") if number]
            assert numbers == list(range(1, len(numbers) + 1))
            ward.kill9()
            ward.start_gate()
            assert [number for _, number in ward.told() if number] == numbers
            assert ward.stop_process("gate") == 0
            assert ward.verified()
    finally:
        with suppress(OSError):
            ward.end()
        os.system(f"umount -l {disk}")


def journaled(ward: Ward) -> bool:
    return b'"decision":"accept"' in ward.store.with_name("robot.db.emergency").read_bytes()


def fill_up(ward: Ward) -> None:
    """Call until the disk takes nothing any more."""
    answer = ward.call("go-safe")
    assert answer["outcome"] == "accept", answer


@pytest.mark.parametrize(
    ("changes", "by", "code"),
    [
        (OVER, "safety-officer-1", "EXPIRED"),
        ({"robot": scenarios.OTHER}, "safety-officer-1", "ROBOT_MISMATCH"),
        ({}, "operator-1", "ROLE_DENIED"),
        (None, "", "MALFORMED"),
    ],
)
def test_a_gate_does_not_start_with_a_policy_that_does_not_count(
    tmp_path: Path, changes: dict[str, Any] | None, by: str, code: str
) -> None:
    ward = Ward(tmp_path)
    try:
        if changes is None:
            ward.policy.write_bytes(msgspec.json.encode(emergency_policies.policy()))
        else:
            value = policy_now(**changes)
            ward.policy.write_bytes(emergency_policies.token(value, by=by))
        words = ["--site", ward.site, "--binding", ward.binding, "--config", ward._config]
        words += ["--store", ward.store, "--run", ward.run, "--robot", ward.rid, "--demo"]
        words += ["--trust", ward.trust, "--emergency-policy", ward.policy, "--json"]
        done = subprocess.run([AUTHGUARD, "gate", *words], capture_output=True, check=False)
        assert done.returncode == 4
        assert msgspec.json.decode(done.stdout)["error"]["code"] == code
        assert not ward.store.exists()
    finally:
        ward.end()
