# SPDX-License-Identifier: Apache-2.0
"""Snapshots are ordered by their estimators' starts, and no start lies in the future."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from authguard_r.audit.record import read_record
from authguard_r.core.encoding import Tag
from authguard_r.core.errors import StoreError
from authguard_r.core.identifiers import MAX_INTEGER
from authguard_r.core.token import sign_object
from authguard_r.sim.robot import snapshot_of
from authguard_r.wire.gate_limits import LIMITS
from fixtures import scenarios

NOW = scenarios.START_MS


@pytest.fixture
def sim() -> Any:
    made = scenarios.simulation()
    made.gate.management.activate(scenarios.token())
    made.gate.enforcer.inputs.refresh()
    return made


def show(sim: Any, epoch: int, seq: int = 1) -> tuple[int, int]:
    """Let the gate see a snapshot by an estimator of its robot; return the last it took in."""
    seen = snapshot_of(scenarios.world(), robot=scenarios.RID, epoch=epoch, seq=seq)
    signer = scenarios.folder_signer(scenarios.trust_folder(), f"estimator-{scenarios.RID}")
    token = sign_object(seen, Tag.STATE, signer)
    sim.robot.latest = lambda: token
    state = sim.gate.enforcer.inputs.refresh()
    return state.snapshot.epoch, state.snapshot.seq


def refused(sim: Any) -> list[tuple[Any, ...]]:
    read = [read_record(row.record, where="") for row in sim.gate.ledger.store.rows()]
    return [tuple(record.open["reasons"]) for record in read if record.kind == "intake"]


def test_an_estimator_that_claims_the_largest_epoch_shuts_no_later_one_out(sim: Any) -> None:
    before = sim.gate.ledger.snapshot
    assert show(sim, MAX_INTEGER, MAX_INTEGER) == before
    assert refused(sim) == [("VALUE_OUT_OF_RANGE",)]
    assert sim.gate.enforcer.inputs.fault.where == "state.epoch"
    assert sim.gate.ledger.snapshot == before  # what is held with the next commit
    assert show(sim, NOW) == (NOW, 1)
    assert sim.robot.trace == []


@pytest.mark.parametrize(("ahead", "taken"), [(LIMITS.skew_ms, True), (LIMITS.skew_ms + 1, False)])
def test_an_epoch_may_lead_trusted_time_by_the_clocks_skew_and_no_more(
    sim: Any, ahead: int, *, taken: bool
) -> None:
    assert (show(sim, NOW + ahead) == (NOW + ahead, 1)) is taken


def test_who_leads_as_far_as_may_be_shuts_out_nobody_who_starts_after_that(sim: Any) -> None:
    assert show(sim, NOW + LIMITS.skew_ms, MAX_INTEGER) == (
        NOW + LIMITS.skew_ms,
        MAX_INTEGER,
    )
    assert show(sim, NOW) == (
        NOW + LIMITS.skew_ms,
        MAX_INTEGER,
    )  # it ran already: it has to start anew
    assert refused(sim) == [("STATE_REPLAYED",)]
    sim.robot.pause(LIMITS.skew_ms + 1)
    assert show(sim, NOW + LIMITS.skew_ms + 1) == (NOW + LIMITS.skew_ms + 1, 1)


def test_a_simulation_that_begins_again_at_the_same_time_is_a_later_start(tmp_path: Path) -> None:
    epochs = []
    for _ in range(2):
        sim = scenarios.simulation(store=tmp_path / "robot.db")
        epochs.append(sim.gate.enforcer.inputs.refresh().snapshot.epoch)
        sim.gate.management.started()  # something that is committed
        sim.gate.close()
    assert epochs == [NOW, NOW + 1]


def test_a_store_that_cannot_be_read_names_no_epoch_and_says_so_itself(tmp_path: Path) -> None:
    path = tmp_path / "robot.db"
    path.write_bytes(b"junk")
    with pytest.raises(StoreError):
        scenarios.simulation(store=path)
