# SPDX-License-Identifier: Apache-2.0
"""An estimator's end of the gate says once that it is there, and once what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from authguard_r.client.attesting import Attester, AttestingEnd, Measurement, since
from authguard_r.client.link import ProcessLog
from authguard_r.keys.signer import folder_signer
from authguard_r.keys.trust import read_trust
from authguard_r.sim.sight import snapshot_of
from authguard_r.wire.frames import Frame
from authguard_r.wire.messages import Fault, Kind
from fixtures import scenarios
from unit.sim.controller_bench import framed


def end(readied: list[bool]) -> AttestingEnd:
    signer = folder_signer(scenarios.trust_folder(), f"estimator-{scenarios.RID}")
    return AttestingEnd(
        scenarios.RID,
        Attester(signer, epoch=1, rate_hz=20),
        Path("/nowhere"),
        trust=lambda: read_trust(scenarios.trust_folder()),
        look=lambda now: None,
        ready=lambda: readied.append(True),
        log=ProcessLog(),
    )


def refusal(reason: str) -> Frame:
    return framed(Kind.ERROR, Fault(code=reason, where="gate.sock", message="no"))


def test_it_is_ready_once_the_gate_has_taken_a_snapshot() -> None:
    readied: list[bool] = []
    it = end(readied)
    it.heard(refusal("STATE_STALE"))
    assert not readied
    it.heard(framed(Kind.REPLY, {}))
    it.heard(framed(Kind.REPLY, {}))
    assert readied == [True]


def test_a_refusal_is_said_once_and_again_when_it_is_another(
    capsys: pytest.CaptureFixture[str],
) -> None:
    it = end([])
    for reason in ("STATE_STALE", "STATE_STALE", "REVOKED", "STATE_STALE"):
        it.heard(refusal(reason))
    said = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    assert [one["code"] for one in said] == ["STATE_STALE", "REVOKED", "STATE_STALE"]


@pytest.mark.parametrize(
    ("after_ms", "fence"), [(0, 0), (249, 0), (250, 0), (251, 7), (1_000, 7)], ids=str
)
def test_a_message_that_may_have_been_on_its_way_since_before_a_fence_does_not_carry_it(
    after_ms: int, fence: int
) -> None:
    """A message says nothing of when it was measured; it may have taken 250 ms."""
    told = snapshot_of(scenarios.world(), robot=scenarios.RID, epoch=0, seq=0)
    signed = since(Measurement(told, 1_000 + after_ms, 250), 7, 1_000)
    assert signed.pose is not None
    values = (signed.pose, *signed.readings.values())
    assert {value.fence for value in values} == {fence}


def test_the_age_of_a_message_is_added_to_its_time_on_the_way() -> None:
    told = snapshot_of(scenarios.world(), robot=scenarios.RID, epoch=0, seq=0, pose_age_ms=10)
    signed = since(Measurement(told, 1_255, 250), 7, 1_000)
    assert signed.pose is not None
    assert (signed.pose.fence, signed.readings["holding"].fence) == (0, 7)
