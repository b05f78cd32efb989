# SPDX-License-Identifier: Apache-2.0
"""An estimator's end of the gate says once that it is there, and once what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from authguard_r.assembly import folder_signer
from authguard_r.client.attesting import Attester, AttestingEnd
from authguard_r.client.link import Log
from authguard_r.keys.trust import read_trust
from authguard_r.wire.frames import Frame
from authguard_r.wire.messages import Fault, Kind
from fixtures import scenarios
from unit.sim.desks import framed


def end(readied: list[bool]) -> AttestingEnd:
    signer = folder_signer(scenarios.trust_folder(), f"estimator-{scenarios.RID}")
    return AttestingEnd(
        scenarios.RID,
        Attester(signer, epoch=1, rate_hz=20),
        Path("/nowhere"),
        trust=lambda: read_trust(scenarios.trust_folder()),
        look=lambda now: None,
        ready=lambda: readied.append(True),
        log=Log(),
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
