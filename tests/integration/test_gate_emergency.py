# SPDX-License-Identifier: Apache-2.0
"""An emergency at a gate that runs: without a mission, on a full disk, by a wrong clock, killed.

Real processes. What was done is in the log exactly once, whatever ended the gate that did it, and
nothing else is: not what a thief of the disk wrote.
"""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.core.quantities import to_timestamp
from authguard_r.enforcement.emergency.policy import EmergencyPolicy
from authguard_r.server.emergencies import STRANGE
from authguard_r.wire.messages import ClientRole, Kind
from fixtures import emergency_policies, scenarios
from fixtures.emergency_files import forge, record
from fixtures.estimator import attesting
from fixtures.gate_process import AUTHGUARD, PATIENCE_S, Line, RunningGate, until
from integration.test_gate_recovery import fill, turn_the_clock_back
from integration.test_gate_watching import connected, operator

HOUR_MS = 3_600_000
#: A day that is over, whatever the clock says.
OVER = {"not_before": "2020-01-01T00:00:00Z", "expiry": "2020-01-02T00:00:00Z"}
FAST = ("--speed-up", "50", "--at", "station-103")
#: Faster than the emergency capability's 300 mm/s.
GO = b'navigate_to(destination="Pharmacy", speed=0.5)'
WAIT_MS = int(PATIENCE_S * 1_000)


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
            return planner.emergency(capability, timeout_ms=WAIT_MS)

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


def test_a_robot_that_moves_faster_than_the_capability_is_helped_for_one_use(
    tmp_path: Path,
) -> None:
    twice = {**emergency_policies.GO_SAFE, "per_hour": 2}
    with Ward(tmp_path, twice, robot=("--speed-up", "8")) as ward, ThreadPoolExecutor(1) as beside:
        ward.activate()
        with ward.client(ClientRole.PLANNER, "walks") as planner, operator(ward) as person:
            walk = beside.submit(planner.propose, GO)
            until(lambda: person.status()["leases"], "the walk")
            time.sleep(0.5)  # it has its speed
            helped = person.emergency("go-safe", timeout_ms=WAIT_MS)
            assert helped["execution"]["outcome"] == "succeeded", helped
            assert walk.result()["steps"][0]["execution"]["outcome"] == "aborted"
            second, third = (person.emergency("go-safe", timeout_ms=WAIT_MS) for _ in range(2))
        assert second["execution"]["outcome"] == "succeeded", second
        assert third["reasons"] == ["RATE_EXCEEDED"]  # the first was one use, and not two
        assert [decision for decision, _ in ward.told()] == ["accept", "succeeded"] * 2


def test_what_a_controller_does_not_start_is_no_use_and_each_caller_has_its_own(
    tmp_path: Path,
) -> None:
    once = {**emergency_policies.GO_SAFE, "per_hour": 1}
    once["callers"] = ["gate", "operator", "planner"]
    with (
        Ward(tmp_path, once, robot=False, estimator=False) as ward,
        attesting(ward, "station-103"),
        Line(ward.socket).hello(ClientRole.CONTROLLER) as controller,
        ThreadPoolExecutor(1) as beside,
    ):

        def ends(outcome: str) -> None:
            item = controller.next()
            while item is not None and item.kind is not Kind.DISPATCH:  # of the one before
                item = controller.next()
            assert item is not None
            ticket = msgspec.json.decode(item.body)["ticket"]
            controller.say(Kind.ENDED, {"ticket": ticket, "outcome": outcome})

        def call(role: ClientRole, name: str, outcome: str) -> str:
            """Return how a call ended, of which the controller says how it ended."""
            with ward.client(role, name) as client:
                asked = beside.submit(client.emergency, "go-safe", timeout_ms=WAIT_MS)
                ends(outcome)
                return str(asked.result()["execution"]["outcome"])

        ends("succeeded")  # the gate's own, which comes first: its guards hold
        until(lambda: len(ward.told()) == 2, "its record")
        for name in ("one", "two", "one", "two"):
            assert call(ClientRole.PLANNER, name, "not_started") == "not_started"
        assert call(ClientRole.PLANNER, "one", "succeeded") == "succeeded"
        assert ward.call("go-safe", "two")["reasons"] == ["RATE_EXCEEDED"]
        assert call(ClientRole.OPERATOR, "nurse", "succeeded") == "succeeded"
        callers = [r.open["caller"] for r in ward.records() if r.decision == "succeeded"]
        assert callers == ["gate", "planner", "operator"]


def test_what_a_thief_of_the_disk_wrote_into_the_journal_is_told_of_and_not_believed(
    ward: Ward,
) -> None:
    assert ward.call("go-safe")["execution"]["outcome"] == "succeeded"
    assert ward.stop_process("gate") == 0
    forged = [record(n, caller="operator", by="u1000.nurse") for n in range(1, 5)]
    forge(ward.store.with_name("robot.db.emergency"), *forged, record(5, robot=scenarios.OTHER))
    ward.start_gate()
    with operator(ward) as person:
        alerts = [alert for alert in person.status()["alerts"] if alert["what"] == STRANGE]
    assert alerts == [{"what": STRANGE, "entries": 5}]
    assert [r.open for r in ward.records() if r.kind == "alert"] == alerts
    assert ward.told() == [("accept", 0), ("succeeded", 0)]  # its own, from before
    until(lambda: connected(ward), "the controller's return")
    assert until(lambda: ward.call("go-safe")["ticket"], "an emergency after it")
    assert ward.stop_process("gate") == 0
    assert ward.verified()


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
        words += ["--store", ward.store, "--gate", ward.run, "--robot", ward.rid, "--demo"]
        words += ["--trust", ward.trust, "--emergency-policy", ward.policy, "--json"]
        done = subprocess.run([AUTHGUARD, "gate", *words], capture_output=True, check=False)
        assert done.returncode == 4
        assert msgspec.json.decode(done.stdout)["error"]["code"] == code
        assert not ward.store.exists()
    finally:
        ward.end()
