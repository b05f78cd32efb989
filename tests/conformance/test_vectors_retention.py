# SPDX-License-Identifier: Apache-2.0
"""A gate takes the published times of a mission, and destroys each class at the published instant.

Source: docs/spec/sealed-fields.md#retention-of-one-mission
"""

from __future__ import annotations

from itertools import starmap
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from authguard_r.anchoring.sealing.policy import SealingPolicy
from authguard_r.audit.record import BOX, LogRow
from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.mission import DataClass, Mission
from authguard_r.core.quantities import to_ms
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.operations.simulation import Simulation
from fixtures import scenarios, sealed_logs
from fixtures.cases import case
from fixtures.vectors import load, named, refusal

Json = dict[str, Any]
RETENTION = load("retention.json")
GO = scenarios.navigate("dock", "pharmacy")


def policy_of(name: str) -> SealingPolicy:
    """Return a published configuration; each reader has a key of its own."""
    written = RETENTION["configurations"][name]
    readers = (
        sealed_logs.reader(f"reader-{number}", *map(DataClass, classes))
        for number, classes in enumerate(written["readers"])
    )
    rules = tuple(
        sealed_logs.rule(DataClass(one["data"]), least_ms=one["least_ms"], most_ms=one["most_ms"])
        for one in written["retention"]
    )
    return SealingPolicy(readers=tuple(readers), retention=rules)


def ended(sim: Simulation, *versions: Json) -> Mission:
    """Activate each version of a mission, let it do something, and revoke it."""
    before: Json = {}
    for number, retention in enumerate(versions, 1):
        mission = scenarios.mission(retention=retention, version=number, **before)
        sim.gate.management.activate(scenarios.token(mission))
        scenarios.propose(sim, GO)
        before = {"supersedes": digest_of(Tag.MISSION, mission)}
    sim.gate.management.command(sealed_logs.command(sim, Verb.REVOKE, mission))
    return mission


def come_to(sim: Simulation, mission: Mission, at_ms: int) -> None:
    """Let it be as long after the mission's expiry as an instant is after the published one."""
    over_ms = to_ms(mission.expiry, where="expiry") + at_ms - RETENTION["expiry_ms"]
    sim.robot.elapsed_ms += over_ms - sim.gate.ledger.now().utc_ms


def left(sim: Simulation, mission: Mission) -> set[str]:
    """Return of which classes the boxes tell that the gate leaves now, of one mission."""
    assert sim.gate.management.retire().stuck == ()
    while sim.gate.management.shred_on():
        pass
    rows = sim.gate.ledger.peek(lambda turn: turn.rows(0, 10_000))
    mine = [row for row in starmap(LogRow, rows) if mission.mid == mid_of(row)]
    names = {name for row in mine for name in sealed_logs.values(row)}
    return {name.removeprefix(BOX) for name in names if name.startswith(BOX)}


def mid_of(row: LogRow) -> str:
    return sealed_logs.told(row).link.mid


@pytest.mark.parametrize("name", sorted(RETENTION["configurations"]))
def test_every_time_of_a_mission_is_taken_or_refused_as_published(
    tmp_path: Path, name: str
) -> None:
    with sealed_logs.sealing(tmp_path / "robot.db", policy_of(name)) as sim:
        for number, vector in enumerate(RETENTION["taken"]):
            if vector["configuration"] != name:
                continue
            with case(named(vector)):
                made = scenarios.mission(mission=f"m-{number}", retention=vector["retention"])
                mission = replace(made, schema=vector["schema"])
                found: Json | str = "ok"
                try:
                    sim.gate.management.activate(scenarios.token(mission))
                except AuthGuardError as error:
                    found = refusal(error)
                assert found == vector["expect"]
                standing = sim.gate.management.standing(mission.mid)
                assert (standing is not None) is (found == "ok")
                if standing is not None:
                    sim.gate.management.command(sealed_logs.command(sim, Verb.REVOKE, mission))


@pytest.mark.parametrize("vector", RETENTION["times"], ids=named)
def test_every_class_is_destroyed_at_the_published_millisecond(
    tmp_path: Path, vector: Json
) -> None:
    path, expect = tmp_path / "robot.db", vector["expect"]
    with sealed_logs.sealing(path, policy_of(vector["began"])) as sim:
        mission = ended(sim, *vector["versions"])
        assert left(sim, mission) == set(expect)
    with sealed_logs.sealing(path, policy_of(vector["then"])) as sim:
        ends = sorted({at_ms for at_ms in expect.values() if at_ms is not None})
        for at_ms in [RETENTION["expiry_ms"], *ends]:
            for now_ms in (at_ms - 1, at_ms):
                come_to(sim, mission, now_ms)
                later = {data for data, end in expect.items() if end is None or end > now_ms}
                assert left(sim, mission) == later
        come_to(sim, mission, max([RETENTION["expiry_ms"], *ends]) + 100 * 86_400_000)
        assert left(sim, mission) == {data for data, end in expect.items() if end is None}


@pytest.mark.parametrize("vector", RETENTION["orders"], ids=named)
def test_an_order_is_carried_out_from_the_published_millisecond_on(
    tmp_path: Path, vector: Json
) -> None:
    with sealed_logs.sealing(tmp_path / "robot.db", policy_of(vector["configuration"])) as sim:
        mission = ended(sim, vector["retention"])
        come_to(sim, mission, vector["at_ms"])
        order = sealed_logs.shred_order(sim, mission.mid, DataClass.OBJECT, DataClass.REGION)
        found = "ok"
        try:
            sim.gate.management.shred(order)
        except AuthGuardError as error:
            found = str(error.reason)
        assert found == vector["expect"]
