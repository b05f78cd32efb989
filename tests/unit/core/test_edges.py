# SPDX-License-Identifier: Apache-2.0
"""Corners of the core that no ordinary case reaches; each is a law of its own."""

from __future__ import annotations

from random import Random
from typing import Any

import msgspec
import pytest

import authguard_reference as oracle
from authguard_r.core.checks.grant import spend_of
from authguard_r.core.checks.guards import guard_finding
from authguard_r.core.checks.provenance import selectable_rows
from authguard_r.core.encoding import decode
from authguard_r.core.errors import AuthGuardError, MalformedError
from authguard_r.core.facts import ActionKind
from authguard_r.core.finding import in_paper_order
from authguard_r.core.lease import permit, still
from authguard_r.core.lifecycle import Event, Status
from authguard_r.core.mission import Guard, Limit, Row
from authguard_r.core.provenance import Label, least_trusted
from authguard_r.core.quantities import Now, to_ms, to_timestamp
from authguard_r.core.reasons import ORDER, Reason
from authguard_r.core.risk import rho
from authguard_r.core.standing import (
    Outcome,
    Spend,
    advance,
    carry_over,
    finish,
    is_complete,
    reserve,
    settle,
)
from fixtures import scenarios
from fixtures.cases import case
from fixtures.decision_cases import ALONE, accepted_case, decide_case, plain, plain_facts

SET = msgspec.structs.replace
MISSION = scenarios.mission()
VERIFIED = scenarios.verified(MISSION)


def grant(name: str):  # type: ignore[no-untyped-def]
    return next(g for g in MISSION.actions if g.id == name)


def test_a_type_that_the_site_does_not_know_reserves_nothing() -> None:
    assert spend_of(None, grant("pick-p1"), {}) == Spend()


def test_what_a_lease_can_use_follows_from_the_type() -> None:
    kind = ActionKind(fields=frozenset(), params={}, moves=True, waits=True, records=True)
    spend = spend_of(kind, grant("pick-p1"), {"max_bytes": 7})
    assert spend == Spend(motion_ms=20_000, wait_ms=20_000, recorded_bytes=7)


def test_only_integers_have_an_order() -> None:
    for value in ["nothing", True]:
        for comparison in ["lt", "le", "gt", "ge"]:
            with case(value, comparison):
                guard = Guard(
                    variable="holding", comparison=comparison, value=value, max_age_ms=9_999
                )
                guard = msgspec.convert(plain(guard), Guard)
                readings = {
                    "holding": SET(scenarios.state().snapshot.readings["holding"], value=value)
                }
                state = scenarios.attested(SET(scenarios.state().snapshot, readings=readings))
                finding = guard_finding(guard, state, scenarios.RID, scenarios.NOW)
                assert finding is not None
                assert finding.reason is Reason.GUARD_FALSE


def test_a_guard_compares_values_of_one_type() -> None:
    for comparison, value, holds in [
        ("eq", 870, True),
        ("ne", 870, False),
        ("ne", 1, True),
        ("lt", 871, True),
        ("lt", 870, False),
        ("le", 870, True),
        ("gt", 869, True),
        ("gt", 870, False),
        ("ge", 870, True),
        ("ge", 871, False),
        ("eq", True, False),
        ("ne", True, False),
        ("eq", "870", False),
    ]:
        with case(comparison, value, holds):
            plain_guard = {
                "variable": "battery_permille",
                "comparison": comparison,
                "value": value,
                "max_age_ms": 9,
            }
            guard = msgspec.convert(plain_guard, Guard)
            assert (
                guard_finding(guard, scenarios.state(), scenarios.RID, scenarios.NOW) is None
            ) == holds


def test_a_value_from_the_future_is_stale() -> None:
    guard = msgspec.convert(
        {"variable": "battery_permille", "comparison": "ge", "value": 1, "max_age_ms": 9}, Guard
    )
    finding = guard_finding(
        guard, scenarios.state(), scenarios.RID, Now(scenarios.NOW.utc_ms, 9_999)
    )
    assert finding is not None
    assert finding.reason is Reason.STATE_STALE


def test_a_selection_leaves_one_row_and_a_bad_one_all() -> None:
    rows = (Row(regions=("dock",)), Row(regions=("pharmacy",)))
    both = SET(grant("pick-p1"), alternatives=rows)
    standing = SET(scenarios.active(VERIFIED), selected={"pick-p1": 1})
    assert selectable_rows(both, standing) == rows[1:]
    assert selectable_rows(both, SET(standing, selected={"pick-p1": 2})) == rows
    assert selectable_rows(both, None) == rows


def test_text_that_no_encoder_writes_is_malformed() -> None:
    with pytest.raises(MalformedError):
        decode(b'"\\ud800"', str)


def test_risk_counts_force_privacy_state_and_what_nobody_knows() -> None:
    policy = MISSION.risk_policy
    base = {"state": scenarios.state(), "facts": scenarios.facts(), "now": scenarios.NOW}
    action = scenarios.navigate("dock", "pharmacy")
    assert rho(action, policy, **base) == 10
    grip = scenarios.Action(
        type="pick", tool="gripper", object="package-p1", params={"force_mn": 20_001}
    )
    assert rho(grip, policy, **base) == 5 + 5 + 6
    unknown = scenarios.Action(type="dance", tool="base", object="thing", destination="moon")
    assert rho(unknown, policy, **base) == 60 + 60 + 60 + 3 * 15
    guard = {"variable": "battery_permille", "comparison": "lt", "value": 900, "max_age_ms": 9}
    risky = msgspec.convert(
        {**plain(policy), "states": [{"guard": guard, "weight": 7}]}, type(policy)
    )
    assert rho(action, risky, **base) == 17
    assert rho(action, risky, **{**base, "state": None}) == 17
    charged = SET(risky.states[0], guard=SET(risky.states[0].guard, value=100))
    assert rho(action, SET(risky, states=(charged,)), **base) == 10
    backwards = SET(grip, params={"force_mn": -20_001})
    assert rho(backwards, policy, **base) == rho(grip, policy, **base)


def started(name: str = "pick-p1"):  # type: ignore[no-untyped-def]
    standing = scenarios.active(VERIFIED)
    return reserve(
        standing,
        grant(name),
        ticket="T" * 43,
        spend=Spend(motion_ms=9),
        now=scenarios.NOW,
        per_ms=1_000,
    )


def test_an_outcome_of_nothing_open_changes_nothing() -> None:
    standing = started()
    other = settle(standing, MISSION, ticket="X" * 43, outcome=Outcome.FAILED, used=Spend())
    assert other == standing
    unknown = settle(standing, MISSION, ticket="T" * 43, outcome=Outcome.UNKNOWN, used=Spend())
    assert unknown == standing


def test_only_not_started_gives_a_start_back_and_never_for_the_irreversible() -> None:
    for outcome, starts in (
        (Outcome.SUCCEEDED, 1),
        (Outcome.FAILED, 1),
        (Outcome.ABORTED, 1),
        (Outcome.NOT_STARTED, 0),
    ):
        after = settle(started(), MISSION, ticket="T" * 43, outcome=outcome, used=Spend())
        assert after.uses["pick-p1"].starts == starts
    final = SET(MISSION, actions=tuple(SET(g, irreversible=True) for g in MISSION.actions))
    kept = settle(started(), final, ticket="T" * 43, outcome=Outcome.NOT_STARTED, used=Spend())
    assert kept.uses["pick-p1"].starts == 1
    gone = SET(MISSION, actions=MISSION.actions[:1])
    kept = settle(started(), gone, ticket="T" * 43, outcome=Outcome.NOT_STARTED, used=Spend())
    assert kept.uses["pick-p1"].starts == 1


def test_what_was_used_takes_the_place_of_what_was_reserved() -> None:
    more = Spend(motion_ms=50, wait_ms=-1)
    after = settle(started(), MISSION, ticket="T" * 43, outcome=Outcome.FAILED, used=more)
    assert after.spent == Spend(motion_ms=50)


def test_a_mission_without_completing_grants_is_never_complete() -> None:
    never = SET(MISSION, actions=tuple(SET(g, completes=False) for g in MISSION.actions))
    assert not is_complete(scenarios.active(VERIFIED), never)


def test_a_mission_finishes_when_it_is_active_and_all_is_done() -> None:
    from authguard_r.core.standing import Use

    active = scenarios.active(VERIFIED)
    assert finish(active, MISSION, scenarios.NOW) == active
    done = SET(active, uses={"place-at-101": Use(starts=1, successes=1, last_success=1)})
    revoked = advance(done, Event.REVOKE)
    assert revoked is not None
    assert finish(revoked, MISSION, scenarios.NOW) == revoked
    plain_end = finish(done, SET(MISSION, closing=None), scenarios.NOW)
    assert plain_end.status is Status.COMPLETED
    closing = finish(done, MISSION, scenarios.NOW)
    assert (closing.status, closing.closes_ms) == (Status.CLOSING, scenarios.NOW.utc_ms + 600_000)


def test_a_new_grant_starts_from_nothing_and_a_narrower_one_is_refused() -> None:
    old = SET(started(), uses={"pick-p1": SET(started().uses["pick-p1"], starts=2)})
    added = SET(MISSION, actions=(*MISSION.actions, SET(grant("pick-p1"), id="pick-again")))
    carried = carry_over(old, MISSION, scenarios.verified(added))
    assert carried is not None
    assert carried.uses == old.uses
    assert carried.open == old.open
    fewer = tuple(SET(g, starts=1) if g.id == "pick-p1" else g for g in MISSION.actions)
    assert carry_over(old, MISSION, scenarios.verified(SET(MISSION, actions=fewer))) is None


@pytest.mark.parametrize(
    "changes",
    [
        {"type": "place"},
        {"tool": "claw"},
        {"alternatives": (*grant("pick-p1").alternatives, Row(object="package-p2"))},
        {"alternatives": grant("go-to-101").alternatives},
    ],
    ids=["type", "tool", "a row more", "other rows"],
)
def test_a_grant_that_keeps_its_name_and_changes_its_meaning_is_refused(
    changes: dict[str, Any],
) -> None:
    other = tuple(SET(g, **changes) if g.id == "pick-p1" else g for g in MISSION.actions)
    assert carry_over(started(), MISSION, scenarios.verified(MISSION)) is not None
    assert carry_over(started(), MISSION, scenarios.verified(SET(MISSION, actions=other))) is None


def test_the_lease_is_the_oracles_lease() -> None:
    match = next(g for g in VERIFIED.grants if g.grant.id == "go-to-pharmacy").grant
    lease = permit(
        VERIFIED,
        scenarios.navigate("dock", "pharmacy"),
        grant=match,
        row=match.alternatives[0],
        facts=scenarios.facts(),
        now=scenarios.NOW,
        ticket="T" * 43,
    )
    rnd, seen = Random(5), set()
    for _ in range(600):
        now = Now(
            scenarios.NOW.utc_ms + rnd.choice([0, 9, 10**8]),
            scenarios.NOW.mono_ms + rnd.choice([0, 500, 10**6]),
        )
        standing = rnd.choice(
            [
                scenarios.active(VERIFIED),
                None,
                SET(scenarios.active(VERIFIED), status=Status.REVOKED),
                SET(scenarios.active(VERIFIED), digest="A" * 43, version=2),
                SET(scenarios.active(VERIFIED), mid="other"),
            ]
        )
        state = rnd.choice(
            [
                scenarios.state(),
                scenarios.state("office-1"),
                scenarios.state(rid=scenarios.OTHER),
                None,
            ]
        )
        if state is not None and rnd.random() < 0.5:
            readings = dict(state.snapshot.readings)
            name = rnd.choice(["speed_mm_s", "battery_permille"])
            change = rnd.choice(
                [
                    {"value": 501},
                    {"value": 5},
                    {"value": True},
                    {"label": "camera"},
                    {"age_ms": 10**5},
                ]
            )
            readings[name] = SET(readings[name], **change)
            state = scenarios.attested(SET(state.snapshot, readings=readings))
        ours = [
            str(f.reason)
            for f in still(lease, state, facts=scenarios.facts(), now=now, standing=standing)
        ]
        theirs = oracle.still(
            plain(lease),
            None
            if state is None
            else {"snapshot": plain(state.snapshot), "arrived_mono_ms": state.arrived_mono_ms},
            facts=plain_facts(scenarios.facts()),
            now=plain(now),
            standing=None if standing is None else plain(standing),
        )
        assert list(dict.fromkeys(ours)) == theirs
        seen |= set(theirs)
    assert seen >= {
        "LEASE_ENDED",
        "EXPIRED",
        "OUTSIDE_REGIONS",
        "BOUND_EXCEEDED",
        "REVOKED",
        "SUPERSEDED",
        "MISSION_UNKNOWN",
        "STATE_MISSING",
        "STATE_FOREIGN",
        "STATE_STALE",
        "GUARD_FALSE",
    }


def test_findings_come_in_paper_order_without_repeats() -> None:
    for seed in range(50):
        findings = decide_case(ALONE["GUARD_FALSE"](Random(seed))).findings
        assert list(findings) == sorted(set(findings), key=lambda f: (ORDER[f.reason], f.field))
        assert in_paper_order(findings + findings) == findings
        assert all(1 <= finding.step <= 7 for finding in findings)


def test_a_grant_more_never_refuses_what_was_accepted() -> None:
    for seed in range(60):
        case = accepted_case(Random(seed))
        extra = SET(grant("look-out"), id="extra", limits=(Limit(parameter="x", low=0, high=1),))
        for actions in ((extra, *case.mission.actions), (*case.mission.actions, extra)):
            from fixtures.decision_cases import _with_mission

            assert str(decide_case(_with_mission(case, actions=actions)).verdict) == "accept"


def test_removing_an_approval_never_accepts() -> None:
    from dataclasses import replace

    for seed in range(200):
        case = accepted_case(Random(seed))
        if case.approvals:
            assert str(decide_case(replace(case, approvals=case.approvals[1:])).verdict) != "accept"


def test_labels_have_one_order_of_trust() -> None:
    assert least_trusted(frozenset()) is Label.MODEL
    assert least_trusted(frozenset({Label.OPERATOR})) is Label.MODEL
    assert least_trusted(frozenset({Label.MEMORY, Label.CAMERA, Label.AUDIO})) is Label.CAMERA


def test_an_instant_has_two_spellings_and_no_third() -> None:
    assert to_timestamp(to_ms("2026-01-31T14:30:00Z", where="x")) == "2026-01-31T14:30:00Z"
    with pytest.raises(AuthGuardError) as refused:
        to_ms("2026-02-30T14:30:00Z", where="expiry")
    assert refused.value.where == "expiry"
    assert "SCHEMA_INVALID" in str(refused.value)


def test_a_tool_that_this_robot_does_not_have_exceeds_its_capability() -> None:
    from fixtures.decision_cases import _plain, _with_action, _with_grant

    case = _with_grant(_plain(Random(1)), tool="claw")
    found = decide_case(_with_action(case, tool="claw")).findings
    assert [(str(f.reason), f.field) for f in found] == [("CAPABILITY_EXCEEDED", "tool")]


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("expected `Büro 1`", "expected `Büro 1`"),
        ("a\x1b[2Jb", "a\\x1b[2Jb"),
        ("two\nlines\ttab", "two\\nlines\\ttab"),
        ("half \ud800 a character", "half \\ud800 a character"),
        ("\u202ereversed", "\\u202ereversed"),
        ("k" * 200_000, "k" * 1_000),
    ],
)
def test_an_error_can_be_logged_and_printed_whoever_wrote_its_text(text: str, wanted: str) -> None:
    error = MalformedError(text, where=text)
    assert (error.message, error.where) == (wanted, wanted)
    assert str(error).encode("utf-8")
