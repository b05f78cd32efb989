# SPDX-License-Identifier: Apache-2.0
"""One key, one plan: what had an effect is held for good, what was refused for a while."""

from __future__ import annotations

import msgspec
import pytest

from authguard_r.audit.record import read_record, read_sealed
from authguard_r.core.encoding import Tag, b64, digest, encode_fast
from authguard_r.core.errors import RefusedError, StoreError
from authguard_r.core.identifiers import Digest, Identifier
from authguard_r.core.reasons import Reason
from authguard_r.enforcement.json_views import report_json
from authguard_r.enforcement.report import Refusal, Report
from authguard_r.server.proposals import (
    CommitRecorder,
    ProposalAnswer,
    ProposalRecord,
    ProposalRegistry,
)
from authguard_r.server.replayed_response import replayed_step
from authguard_r.store.transactions import Transaction
from authguard_r.wire.disclosure import Disclosure
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import ClientRole
from fixtures import scenarios
from unit.server.demo_site import GO, SCAN, DemoGate

ONE, TWO = (Digest(b64(bytes([n]) * 32)) for n in (1, 2))
CLIENT, OTHER = Identifier("u1.planner"), Identifier("u2.planner")
REFUSED = Report(judged=None, refusal=Refusal(Reason.MALFORMED, "x", "y"))


def answered(*steps: Report, evidence: Digest = ONE) -> ProposalAnswer:
    return ProposalAnswer(evidence=evidence, planned=2, steps=tuple(map(report_json, steps)))


def test_what_is_held_with_an_effect_is_recalled_and_no_other_plan_takes_its_key() -> None:
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        answer = house.propose(planner, SCAN, "k")
        ledger, name = house.gate.ledger, house.client(planner).name
        held = ProposalRegistry(ledger, Disclosure.FULL).recall(
            name, "k", digest(Tag.RAW, SCAN)
        )  # another gate's memory
        assert held is not None
        assert (held.planned, held.steps[0]["execution"]) == (1, answer["steps"][0]["execution"])
        with pytest.raises(RefusedError) as refused:
            ProposalRegistry(ledger, Disclosure.FULL).recall(name, "k", TWO)
        assert refused.value.reason is Reason.KEY_REUSED
        assert ProposalRegistry(ledger, Disclosure.FULL).recall(OTHER, "k", TWO) is None


def test_what_is_told_again_is_what_was_told() -> None:
    with DemoGate(disclosure=Disclosure.FULL) as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        first = house.propose(planner, SCAN + b"\n" + GO, "k")
        name = house.client(planner).name
        held = ProposalRegistry(house.gate.ledger, Disclosure.FULL).recall(
            name, "k", digest(Tag.RAW, SCAN + b"\n" + GO)
        )
        assert held is not None
        for told, again in zip(first["steps"], held.steps, strict=True):
            plain = msgspec.json.decode(msgspec.json.encode(again))
            assert told.items() >= plain.items() or told == plain


def test_records_that_are_damaged_are_not_told_again() -> None:
    sim = scenarios.simulation()
    sim.gate.management.activate(scenarios.token())
    scenarios.propose(sim, scenarios.navigate("dock", "office-1"))
    row = sim.gate.ledger.store.rows()[-1]
    record, sealed = read_record(row.record, where=""), read_sealed(row.sealed, where="")
    told = replayed_step(record, sealed, None, {})
    assert (told["safety"], told["action"]["destination"]) == ("not evaluated", "office-1")
    assert replayed_step(record, {}, None, {})["action"] is None  # destroyed since
    for changes in ({"deviation": [1, 0]}, {"safety": 5}):
        damaged = msgspec.structs.replace(record, open={**record.open, **changes})
        with pytest.raises(StoreError) as fault:
            replayed_step(damaged, sealed, None, {})
        assert fault.value.reason is Reason.STORE_CORRUPT


def test_a_step_whose_end_nobody_recorded_is_told_without_one() -> None:
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        house.begin(planner, GO, "k")
        name = house.client(planner).name
        held = ProposalRegistry(house.gate.ledger, Disclosure.FULL).recall(
            name, "k", digest(Tag.RAW, GO)
        )
        assert held is not None
        assert held.steps[0]["released"] is True
        assert held.steps[0]["execution"]["outcome"] is None


def test_what_is_held_in_a_turn_that_fails_is_not_held() -> None:
    ledger = scenarios.simulation().gate.ledger
    recorder = CommitRecorder(CLIENT, "k", ProposalRecord(evidence=ONE, planned=1, steps=()))

    def job(act: Transaction) -> None:
        recorder(act, REFUSED, 0)
        raise StoreError("power is gone")

    with pytest.raises(StoreError):
        ledger.run(job)
    assert ProposalRegistry(ledger, Disclosure.FULL).recall(CLIENT, "k", ONE) is None


def test_a_record_that_is_gone_is_a_fault_of_the_store() -> None:
    ledger = scenarios.simulation().gate.ledger
    held = ProposalRecord(evidence=ONE, planned=1, steps=((10**6, -1),))
    ledger.run(lambda act: act.put("proposal", f"{CLIENT} k", encode_fast(held)))
    with pytest.raises(StoreError) as fault:
        ProposalRegistry(ledger, Disclosure.FULL).recall(CLIENT, "k", ONE)
    assert fault.value.reason is Reason.STORE_CORRUPT


def test_what_was_refused_is_remembered_for_a_while_and_no_more_than_that() -> None:
    proposals = ProposalRegistry(scenarios.simulation().gate.ledger, Disclosure.FULL)
    for number in range(LIMITS.remembered_answers + 1):
        proposals.remember(CLIENT, f"k{number}", answered(REFUSED))
    assert proposals.recall(CLIENT, "k0", TWO) is None
    assert proposals.recall(CLIENT, "k1", ONE) == answered(REFUSED)
    with pytest.raises(RefusedError):
        proposals.recall(CLIENT, f"k{LIMITS.remembered_answers}", TWO)


def test_a_held_answer_that_is_damaged_is_a_fault_of_the_store_not_a_new_proposal() -> None:
    ledger = scenarios.simulation().gate.ledger
    ledger.run(lambda act: act.put("proposal", f"{CLIENT} k", b"{}"))
    with pytest.raises(StoreError) as fault:
        ProposalRegistry(ledger, Disclosure.FULL).recall(CLIENT, "k", ONE)
    assert fault.value.reason is Reason.STORE_CORRUPT
