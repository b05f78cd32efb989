# SPDX-License-Identifier: Apache-2.0
"""A gate in shadow mode decides and records, releases nothing, and says so everywhere.

From a tool list to a mission that a person can sign: the first hour, with real processes.
"""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest

from authguard_r.authoring.keys.setup import demo_members, init_folder
from authguard_r.core.errors import RefusedError
from authguard_r.wire.messages import ClientRole, Mode
from fixtures import scenarios
from fixtures.gate_process import RunningGate

GO = (scenarios.HOSPITAL / "replies" / "01-collect.json").read_bytes()
HIJACKED = (scenarios.HOSPITAL / "replies" / "03-hijacked-by-notice.json").read_bytes()


@pytest.fixture(scope="module")
def gate() -> Iterator[RunningGate]:
    with RunningGate(mode=Mode.SHADOW, estimator=False) as running:
        yield running


def test_enforcement_clients_refuse_a_shadow_gate_unless_they_are_told_to_take_it(
    gate: RunningGate,
) -> None:
    with pytest.raises(RefusedError, match="shadow"):
        gate.client(ClientRole.PLANNER, "unaware")
    with gate.client(ClientRole.PLANNER, "aware", allow_shadow=True) as planner:
        assert planner.welcome.mode is Mode.SHADOW


@pytest.mark.smoke
def test_a_controller_gets_nothing_from_a_shadow_gate(gate: RunningGate) -> None:
    with pytest.raises(RefusedError, match="shadow"):
        gate.client(ClientRole.CONTROLLER, "arm")


def test_every_record_of_a_shadow_run_says_so_and_every_step_is_judged(gate: RunningGate) -> None:
    with gate.client(ClientRole.PLANNER, "old-road", allow_shadow=True) as planner:
        unheld = planner.propose(b"nothing that anybody can read")
        early = planner.propose(GO, dialect="openai")  # no mission is active yet
        gate.activate()
        judged = planner.propose(HIJACKED, dialect="openai")
    assert unheld["shadow"] is early["shadow"] is judged["shadow"] is True
    assert len(early["steps"]) == len(judged["steps"]) == 2  # whatever became of the first
    records = gate.records()
    assert {record.open["mode"] for record in records} == {"shadow"}
    unread = [r for r in records if r.kind == "refusal" and "plan" in r.sealed]
    assert [r.sealed["dialect"] for r in unread] == ["auto"]
    undecided = [r for r in records if r.reasons == ["NO_ACTIVE_MISSION"]]
    assert [r.sealed["action"]["type"] for r in undecided] == ["navigate", "pick"]


@pytest.mark.smoke
def test_shadow_is_never_the_default() -> None:
    from authguard_r.access.gate_config import Peer, default_config

    peer = Peer(uid=1, roles=(ClientRole.PLANNER,))
    with pytest.raises(TypeError):
        default_config(scenarios.RID, (peer,))  # type: ignore[call-arg]


def test_a_simulated_robot_of_a_shadow_gate_moves_nothing(tmp_path: Path) -> None:
    trust = tmp_path / "trust"  # of another house: the gate above has this one's robot
    init_folder(trust, demo_members(scenarios.site(), (scenarios.RID,)), now=datetime.now(UTC))
    with RunningGate(mode=Mode.SHADOW, simulate=True, trust=trust) as gate:
        gate.activate()
        with gate.client(ClientRole.PLANNER, "old-road", allow_shadow=True) as planner:
            steps = planner.propose(GO, dialect="openai")["steps"]
            again = planner.propose(GO, dialect="openai")["steps"]
        records = gate.records()
    assert steps[0]["execution"]["outcome"] == "succeeded"  # as is assumed
    assert steps[1]["outcome"] == "reject"  # what it would pick up is not where it is
    where = [r.sealed["state"][0]["snapshot"]["pose"] for r in records if r.kind == "decision"]
    assert len(again) == 2
    assert len({(pose["x_mm"], pose["y_mm"]) for pose in where}) == 1
    assert all(r.open["used"] == {} for r in records if r.kind == "outcome" and "used" in r.open)
    assert {record.open["mode"] for record in records} == {"shadow"}
