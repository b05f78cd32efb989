# SPDX-License-Identifier: Apache-2.0
"""No signed configuration goes back on a store, and each change of what is in force is recorded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from authguard_r.audit.record import NONE, Record, read_record, read_sealed
from authguard_r.core.encoding import Tag, b64, digest_of
from authguard_r.core.errors import ClockError, RefusedError
from authguard_r.core.reasons import Reason
from authguard_r.core.token import sign_object
from authguard_r.enforcement.management.configurations import Configuration, ConfiguredPart
from authguard_r.enforcement.signed_orders import Command, Verb
from authguard_r.keys.signer import folder_signer
from authguard_r.operations.simulation import Simulation
from authguard_r.store.transactions import STOP, Transaction
from fixtures import scenarios


@pytest.fixture
def sim() -> Simulation:
    return scenarios.simulation()


def held(
    sim: Simulation, digest: str, version: int, part: ConfiguredPart = ConfiguredPart.SAFETY
) -> None:
    sim.gate.management.hold_configurations(
        {part: Configuration(digest=digest, version=version)},
        sealed={part: {"safety": {"digest": digest}}},
    )


def changes(sim: Simulation) -> list[Record]:
    rows = sim.gate.ledger.run(lambda act: act.rows(0, 1_000))
    records = [read_record(row[1], where="") for row in rows]
    return [record for record in records if record.link.decision == "configuration"]


@pytest.mark.parametrize("part", ConfiguredPart)
@pytest.mark.parametrize(
    ("now", "why"),
    [
        (("b", 4), "expected version 5 or later, got version 4"),
        (("a", 4), "expected version 5 or later, got version 4"),
        (("b", 5), "version 5 was another one before: a change is a new version"),
        (("b", 0), "expected version 5 or later, got none that is signed"),
        ((NONE, 0), "expected version 5 or later, got none that is signed"),
    ],
)
def test_what_is_older_than_what_was_in_force_is_refused_and_changes_nothing(
    sim: Simulation, part: ConfiguredPart, now: tuple[str, int], why: str
) -> None:
    held(sim, "a", 5, part)
    before = len(changes(sim))
    with pytest.raises(RefusedError) as refused:
        held(sim, *now, part)
    assert (refused.value.reason, refused.value.message) == (Reason.SUPERSEDED, why)
    assert refused.value.where == f"{part}.version"
    held(sim, "a", 5, part)  # what was in force still is
    assert len(changes(sim)) == before


def test_a_clock_that_is_behind_lets_nothing_go_back(tmp_path: Path) -> None:
    sim = scenarios.simulation(store=tmp_path / "robot.db")
    held(sim, "a", 5)
    sim.gate.close()
    late = scenarios.simulation(
        store=tmp_path / "robot.db", start_ms=scenarios.START_MS - 3_600_000
    )
    with pytest.raises(ClockError):
        late.gate.ledger.now()
    with pytest.raises(RefusedError, match="SUPERSEDED"):
        held(late, "b", 4)
    late.gate.close()


def test_what_stood_in_an_older_store_stands_since_its_first_start(sim: Simulation) -> None:
    """Stops and suspensions had no times: a `resume` from before ends neither."""
    sim.gate.management.activate(scenarios.token())
    before_ms = sim.robot.wall_ms()
    sim.gate.enforcer.stop(by="operator", is_planner=False, suspends=True)

    def age(act: Transaction) -> None:
        act.put(*STOP, b"1")
        act.put("suspended", scenarios.mission().mid, b"")

    sim.gate.ledger.run(age)
    sim.robot.pause(1_000)
    held(sim, "a", 1)
    sim.robot.pause(1_000)
    for issued_ms, said in ((before_ms + 500, "ORDER_TOO_OLD"), (before_ms + 1_500, "active")):
        token = resume(issued_ms, sim.robot.wall_ms() + 60_000)
        try:
            status = str(sim.gate.management.command(token).status)
        except RefusedError as refused:
            status = str(refused.reason)
        assert status == said


def resume(issued_ms: int, expires_ms: int) -> bytes:
    mission = scenarios.mission()
    value = Command(
        verb=Verb.RESUME,
        mid=mission.mid,
        version=mission.version,
        mission=digest_of(Tag.MISSION, mission),
        nonce=b64(str(issued_ms).encode()),
        expires_ms=expires_ms,
        issued_ms=issued_ms,
    )
    return sign_object(value, Tag.COMMAND, folder_signer(scenarios.trust_folder(), "operator-1"))


def test_each_change_is_recorded_with_what_was_before_and_what_a_replay_needs(
    sim: Simulation,
) -> None:
    for digest, version in (("a", 1), ("a", 1), ("b", 2), ("b", 2), ("c", 9)):
        held(sim, digest, version)
    told: list[Any] = [
        (r.open["part"], r.open["was"], r.open["digest"], r.open["version"]) for r in changes(sim)
    ]
    assert [one[1:] for one in told[1:]] == [("a", "b", 2), ("b", "c", 9)]
    assert told[0][2:] == ("a", 1)  # the store's first record names another one
    seq = changes(sim)[-1].link.seq
    (row,) = sim.gate.ledger.run(lambda act: act.rows(seq, 1))
    assert read_sealed(row[2], where="")["safety"].value == {"digest": "c"}


def test_a_first_start_on_a_store_that_names_another_one_is_recorded(sim: Simulation) -> None:
    """Of a version before, or of a command that made the store without a gate."""
    sim.gate.management.hold_configurations(
        {part: Configuration(digest="x", version=3) for part in ConfiguredPart}, sealed={}
    )
    assert [record.open["part"] for record in changes(sim)] == ["binding", "safety"]


def test_what_nobody_versioned_may_change_and_is_recorded(sim: Simulation) -> None:
    for digest in ("a", "b", "a"):
        held(sim, digest, 0, ConfiguredPart.BINDING)
    assert [record.open["digest"] for record in changes(sim)] == ["a", "b", "a"]


def test_parts_do_not_share_their_versions(sim: Simulation) -> None:
    held(sim, "a", 5, ConfiguredPart.GATE)
    held(sim, "a", 1, ConfiguredPart.SAFETY)
    assert [record.open["part"] for record in changes(sim)] == ["safety"]
