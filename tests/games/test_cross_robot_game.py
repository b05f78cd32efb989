# SPDX-License-Identifier: Apache-2.0
"""RobotGame, in two variants: the wrong id, and the right id with the wrong profile.

The gate's own id and profile come from its certificate; whatever a transport field, a site or a
planner says of them changes nothing. Source: section "Cross-Robot Game", theorem "Cross-robot
rejection".
"""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import pytest

from authguard_r.core.errors import AuthGuardError
from authguard_r.core.mission import Mission
from fixtures import scenarios
from missionpair.bench import BenchScene
from missionpair.suite import force_in

VARIANTS: dict[str, Callable[[Mission], Mission]] = {
    "ROBOT_MISMATCH": lambda m: m,
    "PROFILE_MISMATCH": lambda m: msgspec.structs.replace(m, rid=scenarios.OTHER),
}


@pytest.mark.parametrize("reason", sorted(VARIANTS))
def test_another_robot_does_not_take_the_mission_in(reason: str) -> None:
    sim = scenarios.simulation(rid=scenarios.OTHER)
    with pytest.raises(AuthGuardError) as refused:
        sim.gate.management.activate(scenarios.token(VARIANTS[reason](scenarios.mission())))
    assert str(refused.value.reason) == reason
    assert sim.gate.management.standing("deliver-p1") is None


@pytest.mark.parametrize("reason", sorted(VARIANTS))
def test_another_robot_accepts_no_action_even_with_the_mission_in_its_registry(reason: str) -> None:
    sim = scenarios.simulation(rid=scenarios.OTHER)
    mission = VARIANTS[reason](scenarios.mission())
    force_in(BenchScene(sim=sim, mission=mission, plan=b""), scenarios.token(mission))
    report = scenarios.propose(sim, scenarios.navigate("dock", "pharmacy"))
    assert report.outcome is None
    assert reason in [str(r) for r in report.judged.decision.reasons]
    assert sim.robot.trace == []
