# SPDX-License-Identifier: Apache-2.0
"""`decide` is the specification: it agrees with the oracle, case by case (alg:authguard).

The oracle is a slow transcription that shares no line with the gate. Agreement alone could be
agreement on refusing, so the shares are asserted: what is accepted, and every reason alone.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from random import Random

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from authguard_r.core.approval import Approval, VerifiedApproval
from authguard_r.core.approval import ApprovalVerdict as Answer
from authguard_r.core.decision import Verdict
from authguard_r.core.reasons import DECIDED
from authguard_r.core.standing import ApprovalRequest
from fixtures.amount import amount
from fixtures.decision_bounds import BOUNDS
from fixtures.decision_cases import (
    ALONE,
    Case,
    accepted_case,
    broken_case,
    decide_case,
    oracle_case,
    organized,
    preapproved,
    set_,
    sourced,
)

#: Cases of each kind; at least 30 % of them accepted, in the complete run at least 20,000.
ACCEPTED, BROKEN, EACH = amount(900, 8_000), amount(1_000, 7_000), amount(20, 150)
#: Cases exactly at each bound, and as many on either side of it.
AT_BOUND = amount(6, 60)
#: Cases with policies of the organization and approvals of groups.
ORGANIZED = amount(200, 1_000)
#: Cases with pre-approvals.
PREAPPROVED = amount(300, 3_000)
#: Cases with labels and source sets.
SOURCED = amount(300, 3_000)
RELAXED = settings(
    database=None,
    derandomize=True,
    suppress_health_check=list(HealthCheck),
)
SEEDS = st.integers(min_value=0, max_value=2**63)


def agree(case: Case) -> tuple[str, list[str]]:
    """Assert that gate and oracle say the same, and return it."""
    ours, theirs = decide_case(case), oracle_case(case)
    reasons = [str(reason) for reason in ours.reasons]
    assert (str(ours.verdict), reasons) == (theirs["verdict"], theirs["reasons"])
    if ours.match is None or ours.need is None:
        assert theirs["grant"] is None
        return str(ours.verdict), reasons
    grant = ours.match.indexed.grant
    assert grant.id == theirs["grant"]
    assert grant.alternatives.index(ours.match.row) == theirs["row"]
    assert (ours.need.required, ours.need.risk) == (theirs["required"], theirs["risk"])
    return str(ours.verdict), reasons


def denied(case: Case) -> Case:
    """Return the case with a request for its action, which the one who approved in advance denies.

    The case is one that its first fitting pre-approval lets pass.
    """
    decided = decide_case(case)
    used = next(item for item in case.preapprovals if item.digest == decided.preapproved)
    need, said, standing = decided.need, used.preapproval, case.standing
    assert need is not None
    assert need.scope
    assert need.situation
    assert standing is not None
    request = ApprovalRequest(
        counter=1,
        scope=need.scope,
        situation=need.situation,
        required=need.required,
        expires_ms=case.now.utc_ms,
    )
    answer = Approval(
        mid=said.mid,
        version=said.version,
        mission=said.mission,
        rid=said.rid,
        grant=said.grant,
        scope=need.scope,
        situation=need.situation,
        counter=request.counter,
        expires_ms=case.now.utc_ms,
        verdict=Answer.DENY,
    )
    return replace(
        case,
        standing=set_(standing, requests={said.grant: request}),
        approvals=(VerifiedApproval(approval=answer, approver=used.approver),),
    )


def test_the_case_counts_add_up_to_what_is_claimed() -> None:
    total = ACCEPTED + BROKEN + EACH * len(ALONE)
    assert total >= amount(2_500, 20_000)
    assert ACCEPTED / total >= 0.30


def test_every_reason_that_decide_can_give_has_a_case_of_its_own() -> None:
    assert set(ALONE) == {str(reason) for reason in DECIDED}


def test_gate_and_oracle_agree_on_accepted_cases() -> None:
    seen = 0

    @settings(RELAXED, max_examples=ACCEPTED)
    @given(SEEDS)
    def holds(seed: int) -> None:
        nonlocal seen
        verdict, reasons = agree(accepted_case(Random(seed)))
        assert (verdict, reasons) == (Verdict.ACCEPT, [])
        seen += 1

    holds()
    assert seen >= ACCEPTED


@pytest.mark.parametrize("reason", sorted(ALONE))
def test_gate_and_oracle_agree_on_each_reason_alone(reason: str) -> None:
    alone = 0

    @settings(RELAXED, max_examples=EACH)
    @given(SEEDS)
    def holds(seed: int) -> None:
        nonlocal alone
        _, reasons = agree(ALONE[reason](Random(seed)))
        assert reason in reasons
        alone += reasons == [reason]

    holds()
    assert alone >= EACH * 2 // 3


@pytest.mark.parametrize("by", [-1, 0, 1])
@pytest.mark.parametrize("name", BOUNDS)
def test_a_value_at_its_bound_is_accepted_and_one_beyond_is_refused(name: str, by: int) -> None:
    bound = BOUNDS[name]
    for seed in range(AT_BOUND):
        _, reasons = agree(bound.case(Random(seed), by))
        assert reasons == bound.reasons(by), seed


def test_gate_and_oracle_agree_on_whatever_is_broken() -> None:
    seen = 0

    @settings(RELAXED, max_examples=BROKEN)
    @given(SEEDS, st.integers(min_value=1, max_value=4))
    def holds(seed: int, changes: int) -> None:
        nonlocal seen
        agree(broken_case(Random(seed), changes))
        seen += 1

    holds()
    assert seen >= BROKEN


def test_gate_and_oracle_agree_under_an_organization_and_with_groups() -> None:
    """The strictest policy counts, and nobody behind two signatures counts twice."""
    counted: Counter[str] = Counter()

    @settings(RELAXED, max_examples=ORGANIZED)
    @given(SEEDS)
    def holds(seed: int) -> None:
        case = organized(Random(seed))
        verdict, reasons = agree(case)
        counted[reasons[0] if reasons else verdict] += 1
        counted["group"] += verdict == Verdict.ACCEPT and any(
            answer.approver.members for answer in case.approvals
        )
        counted["group issues"] += verdict == Verdict.ACCEPT and bool(case.issuers[1])

    holds()
    assert counted["accept"] >= ORGANIZED // 5, counted
    assert counted["APPROVAL_REQUIRED"] >= ORGANIZED // 5, counted
    assert counted["group"] >= ORGANIZED // 20, counted
    assert counted["group issues"] >= ORGANIZED // 50, counted
    assert counted["APPROVAL_DENIED"] >= ORGANIZED // 50, counted


def test_gate_and_oracle_agree_on_who_may_set_which_field() -> None:
    """AllowedSrc(f) counts for every field, as the site and as the mission narrow it."""
    counted: Counter[str] = Counter()

    @settings(RELAXED, max_examples=SOURCED)
    @given(SEEDS)
    def holds(seed: int) -> None:
        case = sourced(Random(seed))
        verdict, reasons = agree(case)
        counted[reasons[0] if reasons else verdict] += 1
        for finding in decide_case(case).findings:
            counted[finding.field] += finding.reason == "PROVENANCE_DENIED"

    holds()
    assert counted["accept"] >= SOURCED // 10, counted
    for field in ("type", "tool", "object", "destination", "route", "parameters", "recording"):
        assert counted[field] >= SOURCED // 300, (field, counted)
    assert counted["approval_threshold"] >= SOURCED // 150, counted


def test_gate_and_oracle_agree_on_what_was_approved_in_advance() -> None:
    """A pre-approval covers tier 2 of its own class of actions, and no more."""
    counted: Counter[str] = Counter()

    @settings(RELAXED, max_examples=PREAPPROVED)
    @given(SEEDS)
    def holds(seed: int) -> None:
        case = preapproved(Random(seed))
        verdict, reasons = agree(case)
        counted[reasons[0] if reasons else verdict] += 1
        used = decide_case(case).preapproved
        assert used == oracle_case(case)["preapproved"]
        assert (used is not None) == (verdict == Verdict.ACCEPT)
        if used is not None:
            assert agree(denied(case)) == (Verdict.REJECT, ["APPROVAL_DENIED"])

    holds()
    assert counted["accept"] >= PREAPPROVED // 20, counted
    assert counted["APPROVAL_REQUIRED"] >= PREAPPROVED // 5, counted
    assert counted["APPROVAL_DENIED"] >= PREAPPROVED // 100, counted
