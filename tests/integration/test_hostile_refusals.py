# SPDX-License-Identifier: Apache-2.0
"""A plan that cannot even be quoted is refused, recorded once and printed safely."""

from __future__ import annotations

import pytest

from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.normalize import read_plan
from authguard_r.operations.simulation import simulate
from authguard_r.store.memory import MemoryStore
from fixtures import scenarios

HOSTILE = [
    b'{"tool":"x","\\ud800":1,"\\ud800":2}',
    b'{"tool":"x","\\u001b[2Jk":1,"\\u001b[2Jk":2}',
    b'{"tool":"' + b"k" * 200_000 + b'","arguments":{}}',
    b'{"' + b"k" * 100_000 + b'":1,"' + b"k" * 100_000 + b'":2}',
]


@pytest.mark.parametrize("data", HOSTILE, ids=["half a character", "escape", "long", "long twice"])
def test_a_plan_that_cannot_be_quoted_is_refused_and_recorded(data: bytes) -> None:
    simulation = simulate(
        scenarios.trust_folder(),
        scenarios.site(),
        scenarios.binding(),
        rid=scenarios.RID,
        start_ms=scenarios.START_MS,
        store=None,
    )
    with pytest.raises(MalformedError) as caught:
        read_plan(data, binder=simulation.binder)
    store = simulation.gate.ledger.store
    assert isinstance(store, MemoryStore)
    before = len(store.rows())
    report = simulation.gate.enforcer.refuse_plan(caught.value, planner="planner")
    assert report.refusal is not None
    assert report.refusal.reason in {Reason.MALFORMED, Reason.TOOL_UNKNOWN, Reason.DIALECT_UNKNOWN}
    assert len(store.rows()) == before + 1
    assert len(store.rows()[-1].sealed) < 10_000
    assert report.refusal.message.isprintable()
