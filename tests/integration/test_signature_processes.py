# SPDX-License-Identifier: Apache-2.0
"""Gate, stop lane, controller and estimator as processes, with the largest tokens there are.

Two roots of the longest signatures: every hello, snapshot, order and proof passes the sockets, and
nothing that lacks one of the two signatures does.
"""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import msgspec
import pytest

from authguard_r.authoring.keys.setup import init_folder
from authguard_r.client import GateClient
from authguard_r.core.encoding import encode_fast
from authguard_r.core.errors import AuthenticityError
from authguard_r.core.reasons import Reason
from authguard_r.core.token import read_token
from authguard_r.keys.algorithms import Algorithm
from authguard_r.keys.trust import read_trust
from authguard_r.wire.messages import ClientRole
from fixtures import scenarios
from fixtures.gate_process import RunningGate, until
from integration.test_gate_watching import FAST, connected

COLLECT = (scenarios.HOSPITAL / "replies" / "01-collect.json").read_bytes()


@pytest.fixture(scope="module")
def gate(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningGate]:
    folder: Path = tmp_path_factory.mktemp("large") / "trust"
    init_folder(
        folder,
        scenarios.demo_members(scenarios.site(), (scenarios.RID,)),
        now=datetime.now(UTC),
        algorithms=(Algorithm.ML_DSA_87, Algorithm.ML_DSA_87),
    )
    with RunningGate(robot=FAST, estimator=True, trust=folder) as running:
        yield running


def test_a_mission_is_refused_in_halves_and_carried_out_whole(gate: RunningGate) -> None:
    token = gate.token()
    assert len(token) > 50_000
    whole = read_token(token)
    with gate.client(ClientRole.OPERATOR, "person", proof=True) as person:
        for half in whole.endorsements:
            data = encode_fast(msgspec.structs.replace(whole, endorsements=(half,)))
            with pytest.raises(AuthenticityError) as caught:
                person.activate(data)
            assert caught.value.reason is Reason.SIGNATURE_MISSING
        assert person.activate(token)["status"] == "active"
    until(lambda: connected(gate), "the controller")
    with gate.client(ClientRole.PLANNER, "llm", proof=True) as planner:
        told = planner.propose(COLLECT)
    assert [step["execution"]["outcome"] for step in told["steps"]] == ["succeeded", "succeeded"]


def test_the_stop_lane_proves_itself_with_both_keys_and_stops(gate: RunningGate) -> None:
    until(lambda: connected(gate), "the controller")
    with GateClient.connect(
        gate.stop_socket,
        role=ClientRole.OPERATOR,
        verifier=read_trust(gate.trust),
        robot=scenarios.RID,
    ) as hand:
        assert hand.stop()["stopped"] is True
