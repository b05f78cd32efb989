# SPDX-License-Identifier: Apache-2.0
"""A decision rests on state that was measured after the robot's last motion (lesson L23).

Real processes: gate, robot and estimator. Spec page: docs/spec/state.md#fences
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from authguard_r.client import GateClient
from authguard_r.core.encoding import Tag
from authguard_r.core.token import sign_object
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.keys.signer import folder_signer
from authguard_r.sim.sight import snapshot_of
from authguard_r.wire.messages import ClientRole
from fixtures import scenarios
from fixtures.gate_process import RunningGate, order, until
from integration.test_mcp_gateway import DemoGateway, verdict

NOTHING_HELD = {"variable": "holding", "eq": "nothing", "max_age": "1 s"}
GO = 'navigate_to(destination="Pharmacy", speed=0.8)'
PICK = 'pick_up(object="P1", force=12)'
BACK = 'navigate_to(destination="Station 101", speed=0.8)'
SCAN = "scan()"
#: Longest wait for newer state, in milliseconds, of a gate whose estimator is slow.
WAIT_MS = 1_500


def plan(*steps: str) -> bytes:
    return "\n".join(steps).encode()


def guarded_scan() -> list[dict[str, Any]]:
    """Return the shipped grants; looking out needs an empty gripper."""
    grants: list[dict[str, Any]] = scenarios.draft()["grants"]
    return [{**g, "guards": [NOTHING_HELD]} if g["id"] == "look-out" else g for g in grants]


@pytest.fixture
def gate() -> Iterator[RunningGate]:
    with RunningGate(robot=("--speed-up", "20"), estimator=True, refusals=0) as running:
        yield running


def proposed(gate: RunningGate, *steps: str) -> list[dict[str, Any]]:
    with gate.client(ClientRole.PLANNER) as planner:
        told: list[dict[str, Any]] = planner.propose(plan(*steps))["steps"]
    return told


@pytest.mark.smoke
def test_l23_a_guard_that_the_last_action_made_false_refuses_the_next(gate: RunningGate) -> None:
    gate.activate(gate.token(gate.mission(grants=guarded_scan())))
    gone, picked, scanned = proposed(gate, GO, PICK, SCAN)
    assert [step["execution"]["outcome"] for step in (gone, picked)] == ["succeeded"] * 2
    assert (scanned["reasons"], scanned["released"]) == (["GUARD_FALSE"], False)


def test_l23_an_honest_plan_goes_on_where_the_last_action_ended(gate: RunningGate) -> None:
    gate.activate()
    steps = proposed(gate, GO, PICK, BACK)
    assert [step["execution"]["outcome"] for step in steps] == ["succeeded"] * 3


class SlowEstimator:
    """An estimator of the test's own: it says what the test says, with the fence that it says."""

    def __init__(self, gate: RunningGate) -> None:
        self._gate = gate
        self._client = gate.client(ClientRole.ESTIMATOR)
        self._signer = folder_signer(gate.trust, f"estimator-{scenarios.RID}")
        self._epoch, self._seq = time.time_ns() // 1_000_000, 0

    @property
    def fence(self) -> int:
        """Return the newest fence that has come."""
        self.attest("dock", fence=0)
        return self._client.fence

    def attest(self, place: str, *, fence: int) -> None:
        self._seq += 1
        seen = snapshot_of(
            scenarios.world(place),
            robot=scenarios.RID,
            epoch=self._epoch,
            seq=self._seq,
            fence=fence,
            pose_fence=fence,
        )
        self._client.attest(sign_object(seen, Tag.STATE, self._signer))


@pytest.fixture
def unattested() -> Iterator[RunningGate]:
    with RunningGate(robot=("--speed-up", "20"), refusals=0, state_wait_ms=WAIT_MS) as running:
        yield running


def test_a_step_waits_for_state_from_after_the_motion_and_is_refused_without(
    unattested: RunningGate,
) -> None:
    gate, slow = unattested, SlowEstimator(unattested)
    gate.activate()
    slow.attest("dock", fence=slow.fence)
    (first,) = proposed(gate, SCAN)
    assert first["execution"]["outcome"] == "succeeded"
    slow.attest("dock", fence=0)  # fresh by its age, and from before the action's end
    begun = time.monotonic()
    (second,) = proposed(gate, SCAN)
    took_ms = (time.monotonic() - begun) * 1_000
    assert (second["reasons"], second["released"]) == (["STATE_BEFORE_MOTION"], False)
    assert second["retryable"] is True
    assert took_ms >= WAIT_MS
    slow.attest("dock", fence=slow.fence)
    (third,) = proposed(gate, SCAN)
    assert third["execution"]["outcome"] == "succeeded"


def test_a_step_that_waits_holds_up_neither_a_stop_nor_another_client(
    unattested: RunningGate,
) -> None:
    gate, slow = unattested, SlowEstimator(unattested)
    gate.activate()
    slow.attest("dock", fence=slow.fence)
    proposed(gate, SCAN)
    slow.attest("dock", fence=0)
    with ThreadPoolExecutor(1) as beside:
        waiting = beside.submit(proposed, gate, SCAN)
        with gate.client(ClientRole.OPERATOR) as person:
            assert person.status()["mission"]["status"] == "active"
        with GateClient.connect(gate.stop_socket, role=ClientRole.PLANNER) as hand:
            until(lambda: hand.stop()["stopped"], "the robot's word that it stands")
        assert not waiting.done()
        # the gate hears of it a moment later, and raises the fence
        until(lambda: "stop" in [told.kind for told in gate.news()], "the record of the stop")
        slow.attest("dock", fence=slow.fence)
        assert waiting.result()[0]["execution"]["outcome"] == "succeeded"


def test_state_from_before_a_restart_counts_for_nothing(gate: RunningGate) -> None:
    gate.activate()
    gate.stop_process("estimator")
    gate.restart()
    slow = SlowEstimator(gate)
    slow.attest("dock", fence=0)
    (step,) = until(lambda: proposed(gate, SCAN), "an answer")
    assert step["reasons"] == ["STATE_BEFORE_MOTION"]


def test_a_number_from_before_a_restart_counts_for_nothing(unattested: RunningGate) -> None:
    """The last record before it ended a motion: the newest number of then is of before, too."""
    gate, slow = unattested, SlowEstimator(unattested)
    gate.activate()
    slow.attest("dock", fence=slow.fence)
    assert proposed(gate, SCAN)[0]["execution"]["outcome"] == "succeeded"
    number = slow.fence
    gate.restart()
    again = SlowEstimator(gate)
    again.attest("dock", fence=number)
    (step,) = until(lambda: proposed(gate, SCAN), "an answer")
    assert (step["reasons"], step["retryable"]) == (["STATE_BEFORE_MOTION"], True)


def to_and_fro() -> list[dict[str, Any]]:
    """Return two ways to the pharmacy, of which the first is used up, and one that leads away."""
    go, _, carry, *_ = scenarios.draft()["grants"]
    once = {**go, "until": [], "rows": [way("dock", "pharmacy")]}
    away = {**carry, "guards": [], "after": [], "rows": [way("pharmacy", "station-101")]}
    back = {**once, "id": "go-back", "rows": [way("station-101", "pharmacy")]}
    return [once, away, back]


def way(source: str, destination: str) -> dict[str, Any]:
    regions = [source, "public-corridor", destination]
    return {"source": source, "destination": destination, "regions": regions}


@pytest.mark.parametrize("comes", [True, False], ids=["newer state comes", "none comes"])
def test_a_step_waits_though_an_old_place_makes_another_grant_the_closest(
    gate: RunningGate, comes: bool
) -> None:
    gate.activate(gate.token(gate.mission(grants=to_and_fro(), closing=None)))
    steps = proposed(gate, GO, BACK)
    assert [step["execution"]["outcome"] for step in steps] == ["succeeded"] * 2
    gate.stop_process("estimator")
    slow = SlowEstimator(gate)
    slow.attest("dock", fence=0)  # from before the first motion
    with ThreadPoolExecutor(1) as beside:
        asked = beside.submit(proposed, gate, GO)
        time.sleep(0.2)
        assert not asked.done()
        while comes and not asked.done():
            slow.attest("station-101", fence=slow.fence)
            time.sleep(0.02)
        (step,) = asked.result()
    if comes:
        assert step["released"] is True
    else:
        assert set(step["reasons"]) > {"STATE_BEFORE_MOTION"}
        assert (step["retryable"], step["released"]) == (True, False)


def leaving() -> list[dict[str, Any]]:
    """Return the way to the pharmacy, and one to station 101 that begins at the dock alone."""
    go, *_ = scenarios.draft()["grants"]
    row = {"source": "dock", "destination": "station-101"}
    regions = ["dock", "public-corridor", "station-101"]
    way = {**go, "id": "from-dock-only", "rows": [{**row, "regions": regions}], "until": []}
    return [{**go, "until": []}, way]


@pytest.mark.smoke
def test_l23_a_place_that_the_last_call_has_left_is_no_source(tmp_path: Path) -> None:
    """Behind a server of tools, and an estimator that measures a while after the call's end."""
    with RunningGate() as gate:
        gate.activate(gate.token(gate.mission(grants=leaving(), place_max_age="2 s", closing=None)))
        slow, house = SlowEstimator(gate), DemoGateway(gate, tmp_path)

        def measure(place: str, after_s: float) -> None:
            fence = slow.fence
            time.sleep(after_s)
            slow.attest(place, fence=fence)

        async def talk() -> list[dict[str, Any]]:
            async with house.talking() as client:
                await asyncio.to_thread(measure, "dock", 0)
                went = await client.call_tool("navigate_to", {"destination": "Pharmacy"})
                measured = asyncio.to_thread(measure, "pharmacy", 0.3)
                leaves = client.call_tool("navigate_to", {"destination": "Station 101"})
                left, _ = await asyncio.gather(leaves, measured)
                return [verdict(went), verdict(left)]

        went, left = asyncio.run(talk())
    assert went["execution"] == "succeeded"
    assert (left["outcome"], left["reasons"][0]) == ("reject", "SOURCE_OUT_OF_SCOPE")
    assert [call["arguments"]["destination"] for call in house.calls()] == ["Pharmacy"]


@pytest.mark.parametrize("ends", ["stop", "abort"])
def test_state_from_before_a_stop_or_an_abort_counts_for_nothing(
    unattested: RunningGate, ends: str
) -> None:
    """Nobody knows what the robot did meanwhile: a person may have driven it."""
    gate, slow = unattested, SlowEstimator(unattested)
    gate.activate()
    slow.attest("dock", fence=slow.fence)
    if ends == "stop":
        with GateClient.connect(gate.stop_socket, role=ClientRole.PLANNER) as hand:
            until(lambda: hand.stop()["stopped"], "the robot's word that it stands")
        until(lambda: "stop" in [told.kind for told in gate.news()], "the record of the stop")
    else:  # its lease has no newer state than this, and ends
        (gone,) = proposed(gate, GO)
        assert gone["execution"]["outcome"] == "aborted"
    slow.attest("dock", fence=0)
    (step,) = proposed(gate, SCAN)
    assert step["reasons"] == ["STATE_BEFORE_MOTION"]
    slow.attest("dock", fence=slow.fence)
    assert proposed(gate, SCAN)[0]["execution"]["outcome"] == "succeeded"


def test_state_from_before_a_resume_counts_for_nothing_after_a_person_drove_the_robot(
    unattested: RunningGate,
) -> None:
    gate, slow = unattested, SlowEstimator(unattested)
    mission = gate.mission()
    digest = gate.activate(gate.token(mission))["digest"]
    slow.attest("dock", fence=slow.fence)
    with GateClient.connect(gate.stop_socket, role=ClientRole.OPERATOR) as hand:
        until(lambda: hand.stop()["stopped"], "the robot's word that it stands")
    with gate.client(ClientRole.OPERATOR) as person:
        suspended = lambda: person.status()["mission"]["status"] == "suspended"  # noqa: E731
        until(suspended, "the record of the stop")
        before = slow.fence
        slow.attest("dock", fence=before)  # newer than the stop
        assert "STATE_BEFORE_MOTION" not in proposed(gate, SCAN)[0]["reasons"]
        # and now the person drives it to the pharmacy by hand
        person.command(order(gate, mission, digest, Verb.RESUME))
    assert slow.fence > before
    slow.attest("dock", fence=before)
    (step,) = proposed(gate, SCAN)
    assert (step["reasons"], step["released"]) == (["STATE_BEFORE_MOTION"], False)
    slow.attest("pharmacy", fence=slow.fence)
    assert proposed(gate, SCAN)[0]["execution"]["outcome"] == "succeeded"
