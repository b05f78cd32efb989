# SPDX-License-Identifier: Apache-2.0
"""A gate that cannot destroy what it has to says so, once, and says when it can again.

Source: docs/spec/sealed-fields.md#retention
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from authguard_r.access.gate_config import default_config
from authguard_r.audit.record import Entry, append
from authguard_r.core.mission import DataClass
from authguard_r.core.quantities import to_ms
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.operations.simulation import Simulation
from authguard_r.server.liveness import Liveness
from authguard_r.server.retention import STUCK, RetentionWork
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import Mode
from fixtures import scenarios, sealed_logs

REGION, MINUTE_MS = DataClass.REGION, 60_000


class Watched:
    """A gate's retirement, and what people are told of it."""

    def __init__(self, sim: Simulation) -> None:
        self.sim = sim
        self.told: list[dict[str, Any]] = []
        self.ended = 0
        config = default_config(scenarios.RID, (), Mode.ENFORCE)
        self.liveness = Liveness(
            config, sim.gate.ledger.mono_ms, lambda what, more: self.told.append({what: more})
        )
        self.retirement = RetentionWork(
            sim.gate.management, sim.gate.ledger.mono_ms, self.liveness, self.end
        )

    def end(self) -> None:
        self.ended += 1

    def look(self, after_ms: int = 0) -> None:
        self.sim.robot.elapsed_ms += after_ms
        self.retirement.look()

    @property
    def over(self) -> list[bool]:
        return [bool(alert.get("over")) for alert in self.liveness.alerts]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "robot.db"


@pytest.fixture
def watched(path: Path) -> Iterator[Watched]:
    rules = (sealed_logs.rule(REGION, most_ms=MINUTE_MS),)
    with sealed_logs.sealing(path, sealed_logs.policy(retention=rules)) as sim:
        yield Watched(sim)


def ripe(watched: Watched) -> str:
    """Let a mission be over, and its time too; return its id."""
    mission = sealed_logs.active(watched.sim)
    watched.sim.gate.management.command(sealed_logs.command(watched.sim, Verb.REVOKE, mission))
    over_ms = to_ms(mission.expiry, where="expiry") + MINUTE_MS
    watched.sim.robot.elapsed_ms += over_ms - watched.sim.gate.ledger.now().utc_ms
    return mission.mid


def put(watched: Watched, kind: str, key: str, value: bytes) -> None:
    watched.sim.gate.ledger.run(lambda act: act.put(kind, key, value))


def test_what_has_no_more_time_goes_and_whoever_shows_missions_is_told(watched: Watched) -> None:
    ripe(watched)
    watched.look()
    for _ in range(5):
        watched.look()
    assert (watched.ended, watched.told) == (1, [])
    assert not watched.sim.gate.management.shred_on()


def test_it_is_looked_once_a_minute(watched: Watched) -> None:
    watched.look()
    mid = ripe(watched)
    watched.sim.robot.elapsed_ms -= 1  # the look before was less than a minute ago
    put(watched, "sealing-expiry", mid, b"soon")
    watched.retirement._looked_ms = watched.sim.gate.ledger.mono_ms()
    watched.look()
    watched.look(LIMITS.retention_ms - 1)
    assert watched.told == []
    watched.look(1)
    assert watched.told == [{STUCK: {"missions": [mid]}}]


def test_a_mission_whose_time_nobody_can_say_is_told_once_and_when_it_is_over(
    watched: Watched,
) -> None:
    mid = ripe(watched)
    put(watched, "sealing-expiry", mid, b"soon")
    for _ in range(3):
        watched.look(LIMITS.retention_ms)
    assert (watched.told, watched.over) == ([{STUCK: {"missions": [mid]}}], [False])
    put(watched, "sealing-expiry", mid, b"1")
    watched.look(LIMITS.retention_ms)
    assert (watched.ended, watched.over) == (1, [True])


def test_a_box_that_cannot_be_destroyed_is_told_beside_what_retention_says(
    watched: Watched,
) -> None:
    mid = ripe(watched)
    lie = Entry(kind="stop", time_ms=1, decision="stop", open={}, sealed={"box.region": 1})
    ledger = watched.sim.gate.ledger
    seq = ledger.run(lambda act: append(act._page.turn, lie, salts=bytes(16)))
    put(watched, "sealing-policy", "due", b"?")
    watched.look()
    watched.look()
    assert [alert[STUCK]["where"] for alert in watched.told] == ["store.sealing-policy"]
    put(watched, "sealing-policy", "due", f'["{mid}"]'.encode())
    watched.look(LIMITS.retention_ms)
    watched.look()
    assert [alert[STUCK]["where"] for alert in watched.told][1:] == [f"store.audit.{seq}"]
    assert watched.over == [True, False]


def test_an_alert_is_over_when_everything_is(watched: Watched) -> None:
    mid = ripe(watched)
    lie = Entry(kind="stop", time_ms=1, decision="stop", open={}, sealed={"box.region": 1})
    watched.sim.gate.ledger.run(lambda act: append(act._page.turn, lie, salts=bytes(16)))
    for _ in range(3):
        watched.look(LIMITS.retention_ms)
    assert watched.over == [False]
    put(watched, "sealing-policy", "due", b"?")
    watched.look(LIMITS.retention_ms)
    assert watched.over == [False, False]
    put(watched, "sealing-policy", "due", f'["{mid}"]'.encode())
    watched.look(LIMITS.retention_ms)
    assert watched.over == [False, False]  # the box still cannot be destroyed


def test_a_list_of_nothing_to_destroy_is_a_damaged_store_and_told(watched: Watched) -> None:
    put(watched, "shredding", "jobs", b"[]")
    for _ in range(3):
        watched.look()
    assert [alert[STUCK]["where"] for alert in watched.told] == ["store.shredding"]
    put(watched, "shredding", "jobs", b"")
    watched.look()
    assert watched.over == [True]


def test_while_the_clock_is_wrong_nothing_ends_and_nothing_more_is_told(watched: Watched) -> None:
    ripe(watched)
    watched.sim.robot._start_ms -= 3_600_000  # an hour back
    watched.look()
    assert (watched.told, watched.ended) == ([], 0)


def test_a_store_that_is_gone_is_told(watched: Watched) -> None:
    ripe(watched)
    watched.sim.gate.ledger.store.close()
    watched.look()
    assert len(watched.told) == 2  # neither the one nor the other
