# SPDX-License-Identifier: Apache-2.0
"""A stream is one decision; each sample is held to the signed limits and to where it would lead.

Real processes on a yard made for it: a lane of twenty meters and a street beyond its end.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import pytest

from authguard_r.authoring.keys.setup import demo_members, init_folder
from authguard_r.client import AsyncGateClient, GateClient
from authguard_r.client.stream_handle import StreamHandle
from authguard_r.core.errors import RefusedError
from authguard_r.core.identifiers import Digest, RobotId
from authguard_r.site.source import read_site
from authguard_r.wire.messages import ClientRole
from fixtures.gate_process import RunningGate, until
from fixtures.shared_gate import SharedGate
from integration.test_gate_watching import sensors, speed, stands

SITE = """
schema: authguard-r/site/1
id: yard
version: 1
words: standard
regions:
  lane:
    {map: main, floor: 0, points: [[0, 0], [20000, 0], [20000, 4000], [0, 4000]],
     approach: [2000, 2000], tags: [public], names: [Lane]}
  street:
    {map: main, floor: 0, points: [[20000, 0], [40000, 0], [40000, 4000], [20000, 4000]],
     approach: [30000, 2000], tags: [public], names: [Street]}
doors:
  - {between: [lane, street], at: [20000, 2000]}
objects: {}
robots:
  mule-1:
    home: lane
    profile:
      tools: {drive: [base]}
      max_speed_mm_s: 2000
      max_force_mn: 0
      max_payload_g: 0
      brake_mm_s2: 1000
      reaction_ms: 100
"""
BINDING = """
schema: authguard-r/binding/1
id: mule-tools
site: yard
tools:
  drive:
    type: drive
    tool: base
    attested: [source]
    arguments:
      linear: {use: mapped, to: params.linear_mm_s, per_unit: "1000"}
      lateral: {use: mapped, to: params.lateral_mm_s, per_unit: "1000"}
      turn: {use: mapped, to: params.turn_urad_s, per_unit: "1000000"}
      seconds: {use: mapped, to: params.duration_ms, per_unit: "1000"}
"""
MISSION = """
mission: yard-work
robot: mule-1
issuer: operator-1
task: Let the operator's assistant drive the mule up and down the lane.
window: {for: 25 min}
place_max_age: 1 s
guards: []
limits: {}
grants:
  - id: drive-in-lane
    type: drive
    tool: base
    rows:
      - {source: lane, regions: [lane]}
    limits:
      linear_mm_s: [-0.5 m/s, 1.0 m/s]
      lateral_mm_s: [0 m/s, 0 m/s]
      turn_urad_s: [-1 rad/s, 1 rad/s]
      duration_ms: [1 s, 60 s]
    chooser: trusted_sensor
    repeat: 50
    starts: 50
    max: 60 s
    irreversible: false
budgets:
  actions: 50
  rate: {count: 50, per: 10 s}
  motion: 60 min
  waiting: 0 s
  recorded_bytes: 0
  prompts: 0
  planner_stops: 3
on_refusal: hold
risk_policy:
  types: {drive: 5}
  region_tags: {public: 0}
  otherwise: 60
  privacy: 15
  tau_1: 30
  tau_2: 60
  t: 2
  roles: [supervisor]
  valid: 2 min
"""
DRIVE = b"drive(linear=0.2, lateral=0, turn=0, seconds=50)"


@pytest.fixture(scope="module")
def yard() -> Path:
    folder = Path(mkdtemp(prefix="ag-yard-", dir="/tmp"))
    (folder / "site.yaml").write_text(SITE)
    (folder / "binding.yaml").write_text(BINDING)
    (folder / "mission.yaml").write_text(MISSION)
    site = read_site(folder / "site.yaml")
    init_folder(folder / "trust", demo_members(site, (RobotId("mule-1"),)), now=datetime.now(UTC))
    return folder


@pytest.fixture(scope="module")
def shared(yard: Path) -> Iterator[SharedGate]:
    made = SharedGate(
        robot=True,
        estimator=True,
        renew_within_ms=300,
        rid=RobotId("mule-1"),
        trust=yard / "trust",
        site=yard / "site.yaml",
        binding=yard / "binding.yaml",
    )
    with made:
        yield made


@pytest.fixture
def gate(shared: SharedGate, yard: Path) -> Iterator[RunningGate]:
    with shared.one_test() as running:
        running.activate(running.token(running.mission(str(yard / "mission.yaml"))))
        yield running


class Stream:
    """An open stream and the client that proposed it."""

    def __init__(self, gate: RunningGate) -> None:
        self.planner = gate.client(ClientRole.PLANNER, gate.mid, timeout_ms=20_000)
        self.answer: dict[str, Any] = {}
        self.ticket = self.planner.open_stream(DRIVE, key="drive")

    def sample(self, linear: int, *, lateral: int = 0, turn: int = 0) -> bool:
        time.sleep(0.02)  # what comes sooner than 10 ms after the last is shed
        params = {"linear_mm_s": linear, "lateral_mm_s": lateral, "turn_urad_s": turn}
        return self.planner.sample(self.ticket, params)

    def close(self) -> dict[str, Any]:
        self.planner.close_stream(self.ticket)
        return self.planner.stream_ended(self.ticket)


def records(gate: RunningGate) -> list[dict[str, Any]]:
    return [{**r.open, **r.sealed} for r in gate.news() if r.kind == "stream"]


def test_samples_within_the_limits_are_forwarded_and_counted(gate: RunningGate) -> None:
    stream = Stream(gate)
    with sensors(gate) as seen:
        for n in range(60):
            assert stream.sample(500 if n < 40 else -300)
        seen.until(lambda s: speed(s) == 300)
    ended = stream.close()
    assert ended["steps"][0]["execution"]["outcome"] == "succeeded"
    found = records(gate)
    assert sum(r["samples"] for r in found) == sum(r["forwarded"] for r in found) == 60
    assert found[-1]["last"] is True
    extremes = [r["extremes"]["linear_mm_s"] for r in found if r["extremes"]]
    assert (min(e[0] for e in extremes), max(e[1] for e in extremes)) == (-300, 500)
    decisions = [r for r in gate.news() if r.kind == "decision"]
    assert len(decisions) == 1  # one decision, whatever was sampled
    stands(gate)


def test_a_stream_is_steered_while_its_proposal_is_waited_for(gate: RunningGate) -> None:
    async def drive() -> tuple[list[bool], dict[str, Any]]:
        told: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
        made = await AsyncGateClient.connect(gate.socket, role=ClientRole.PLANNER, client=gate.mid)
        async with made as planner:
            going = asyncio.ensure_future(planner.propose(DRIVE, on_step=told.put_nowait))
            stream = StreamHandle(planner, Digest((await told.get())["ticket"]))
            found = []
            for linear in (300, 1_001):
                params = {"linear_mm_s": linear, "lateral_mm_s": 0, "turn_urad_s": 0}
                found.append(await stream.sample(params))
                await asyncio.sleep(0.02)
            await stream.close()
            ended = await going
            with pytest.raises(RefusedError):
                await stream.close()
            return found, ended

    found, ended = asyncio.run(drive())
    assert found == [True, False]
    assert ended["steps"][0]["execution"]["outcome"] == "succeeded"


@pytest.mark.smoke
def test_a_sample_outside_the_signed_limits_becomes_zero(gate: RunningGate) -> None:
    stream = Stream(gate)
    assert stream.sample(800)
    assert not stream.sample(1_001)
    assert not stream.sample(-501)
    assert not stream.sample(100, lateral=1)
    with sensors(gate) as seen:
        seen.until(lambda s: speed(s) == 0)
    time.sleep(0.02)
    assert not stream.planner.sample(stream.ticket, {"linear_mm_s": 100})
    stream.close()
    assert sum(r["zeroed"] for r in records(gate)) == 4


def test_a_sample_that_could_not_stop_inside_becomes_zero(gate: RunningGate) -> None:
    """At 1 m/s the mule needs 0.6 m to stand; nobody gets it into the street."""
    stream = Stream(gate)
    refused = 0

    def at_the_edge() -> bool:
        nonlocal refused
        refused += not stream.sample(1_000)
        return refused > 3

    with sensors(gate) as seen:
        until(at_the_edge, "a sample that is refused")
        last = seen.until(lambda s: speed(s) == 0)
    assert last.pose.x_mm < 20_000 - last.pose.margin_mm
    ended = stream.close()
    assert ended["steps"][0]["execution"]["outcome"] == "succeeded"  # the lease never had to end


def test_a_stream_without_samples_stands_and_its_end_is_recorded(gate: RunningGate) -> None:
    stream = Stream(gate)
    assert stream.sample(600)
    with sensors(gate) as seen:
        seen.until(lambda s: speed(s) > 0)
        seen.until(lambda s: speed(s) == 0)
    assert stream.close()["steps"][0]["execution"]["outcome"] == "succeeded"


def test_a_stream_that_is_refused_is_none(gate: RunningGate) -> None:
    out_of_bounds = pytest.raises(RefusedError, match="PARAMETER_OUT_OF_BOUNDS")
    with gate.client(ClientRole.PLANNER, gate.mid) as planner, out_of_bounds:
        planner.open_stream(b"drive(linear=1.5, lateral=0, turn=0, seconds=50)")
    assert not [r for r in gate.news() if r.kind == "stream"]


@pytest.mark.smoke
def test_nobody_else_samples_or_ends_a_stream(gate: RunningGate) -> None:
    stream = Stream(gate)
    with gate.client(ClientRole.PLANNER, "thief") as thief:
        with pytest.raises(RefusedError):
            thief.sample(stream.ticket, {"linear_mm_s": 1, "lateral_mm_s": 0, "turn_urad_s": 0})
        with pytest.raises(RefusedError):
            thief.close_stream(stream.ticket)
    assert stream.sample(100)
    stream.close()


def test_a_stopped_stream_takes_no_more_samples(gate: RunningGate) -> None:
    stream = Stream(gate)
    assert stream.sample(600)
    with GateClient.connect(gate.stop_socket, role=ClientRole.PLANNER) as shy:
        assert shy.stop()["stopped"] is True
    ended = stream.planner.stream_ended(stream.ticket)
    assert ended["steps"][0]["execution"]["reasons"] == ["STOPPED"]
    with pytest.raises(RefusedError):
        stream.sample(600)
    stands(gate)
