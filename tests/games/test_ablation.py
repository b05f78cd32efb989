# SPDX-License-Identifier: Apache-2.0
"""Every check earns its place: without it, an unauthorized action is accepted.

For each check a case that only it refuses; the oracle, which has all checks, says what the
acceptance is worth. Then the hand-constructed suite: each attack meets the one check named for it.
"""

from __future__ import annotations

from pathlib import Path
from random import Random

import pytest

import authguard_reference as oracle
from fixtures import scenarios
from fixtures.decision_cases import ALONE, agree_accepts
from missionpair.ablation import CHECKS, without
from missionpair.bench import make_bench
from missionpair.suite import ATTACKS
from missionpair.systems import System, run_trial

#: The reason that each check alone can give.
ONLY: dict[str, str] = {
    "check_certificate": "CERTIFICATE_EXPIRED",
    "check_time": "EXPIRED",
    "check_registry": "MISSION_SUSPENDED",
    "check_robot": "ROBOT_MISMATCH",
    "check_meta": "META_MISMATCH",
    "check_capability": "CAPABILITY_EXCEEDED",
    "check_ceilings": "PARAMETER_OUT_OF_BOUNDS",
    "check_mission_guards": "GUARD_FALSE",
    "check_type": "ACTION_OUT_OF_SCOPE",
    "check_tool": "TOOL_OUT_OF_SCOPE",
    "check_parameters": "PARAMETER_NOT_ALLOWED",
    "check_data_rights": "DATA_RIGHT_MISSING",
    "check_order": "ORDER_VIOLATED",
    "check_uses": "STARTS_EXHAUSTED",
    "check_budgets": "RATE_EXCEEDED",
    "check_grant_guards": "GUARD_FALSE",
    "check_provenance": "PROVENANCE_DENIED",
    "check_object": "OBJECT_OUT_OF_SCOPE",
    "check_source": "SOURCE_OUT_OF_SCOPE",
    "check_place": "SOURCE_NOT_ATTESTED",
    "check_destination": "DESTINATION_OUT_OF_SCOPE",
    "check_route": "ROUTE_OUT_OF_SCOPE",
    "check_approval": "APPROVAL_DENIED",
}
ROUNDS = 60


def test_every_check_has_an_attack_of_its_own() -> None:
    assert set(ONLY) == set(CHECKS)


@pytest.mark.parametrize("check", sorted(ONLY))
def test_without_the_check_unauthorized_actions_are_accepted(check: str) -> None:
    cases = [attack(check, Random(seed)) for seed in range(ROUNDS)]
    assert not any(ours for ours, _ in map(agree_accepts, cases))
    with without(check):
        unauthorized = sum(ours and not theirs for ours, theirs in map(agree_accepts, cases))
    rate = oracle.uasr(unauthorized, len(cases))
    assert rate is not None
    assert rate > 0


def attack(check: str, rnd: Random):  # type: ignore[no-untyped-def]
    """Return a case that this check refuses; grant guards and ceilings need one of their own."""
    case = ALONE[ONLY[check]](rnd)
    if check == "check_grant_guards":
        return guard_in_grant(case)
    if check == "check_ceilings":
        return over_the_ceiling(rnd)
    return case


def guard_in_grant(case):  # type: ignore[no-untyped-def]
    """Move the false guard from the mission into the grant."""
    from fixtures.decision_cases import _with_grant, _with_mission

    guards = case.mission.guards
    return _with_grant(_with_mission(case, guards=()), guards=guards)


def over_the_ceiling(rnd: Random):  # type: ignore[no-untyped-def]
    """Lower the mission's ceiling under what the grant allows."""
    from authguard_r.core.mission import Limit
    from fixtures.decision_cases import _plain, _with_mission

    case = _plain(rnd, "navigate")
    speed = case.action.params["speed_mm_s"]
    return _with_mission(case, limits=(Limit(parameter="speed_mm_s", low=0, high=speed - 1),))


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory):  # type: ignore[no-untyped-def]
    return make_bench(Path(tmp_path_factory.mktemp("bench")) / "trust")


#: Attacks that more than one check refuses: taking one out is not enough, which is as it should be.
SEVERAL = {"Capability escalation", "Availability manipulation"}


@pytest.mark.parametrize(
    "trial", [t for t in ATTACKS if t.category not in SEVERAL], ids=lambda t: t.name
)
def test_without_its_check_the_attack_of_the_suite_succeeds(trial, bench) -> None:  # type: ignore[no-untyped-def]
    assert not run_trial(trial.prepare(bench), System.BOTH).unauthorized
    scene = trial.prepare(bench)
    with without(trial.check):
        assert run_trial(scene, System.BOTH).unauthorized


def test_the_bench_is_the_hospital(bench) -> None:  # type: ignore[no-untyped-def]
    assert bench.site == scenarios.site()
