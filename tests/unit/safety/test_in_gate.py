# SPDX-License-Identifier: Apache-2.0
"""Rules and a checker in the gate's own process: what-ifs remember, and nobody holds it up."""

from __future__ import annotations

import os
from typing import Any

import msgspec
import pytest

from authguard_r.core.errors import EnvironmentFault, MalformedError
from authguard_r.safety import ExternalChecker, Rule, SafetyConfig, default_config
from authguard_r.server.process import Rendezvous
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import ClientRole
from fixtures import estop_fixtures, scenarios
from unit.server.demo_site import SCAN
from unit.server.test_process import activate, client, parts, robot, served


def config(**changes: Any) -> SafetyConfig:
    return msgspec.structs.replace(default_config(scenarios.site(), scenarios.RID), **changes)


def safe(told: dict[str, Any]) -> list[bool]:
    return [step["safety"]["safe"] for step in told["steps"]]


def test_a_gate_and_its_what_ifs_go_by_what_was_released() -> None:
    once = Rule(id="once", formula="G (type = scan_obstacles -> WX G type != scan_obstacles)")
    made = parts(estop_fixtures.files(), os.open(os.devnull, os.O_WRONLY), simulated=robot())

    def work(told: Rendezvous) -> None:
        activate(told)
        with client(told, ClientRole.OPERATOR) as operator:
            assert safe(operator.evaluate(SCAN)) == [True]
        with client(told, ClientRole.PLANNER) as planner:
            first, second = (planner.propose(SCAN)["steps"][0] for _ in range(2))
            assert first["executed"], first
            assert not second.get("executed", False), second
        with client(told, ClientRole.OPERATOR) as operator:
            assert safe(operator.evaluate(SCAN)) == [False]

    served(msgspec.structs.replace(made, safety=config(rules=(once,))), work)
    os.close(made.journal)


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        (
            {
                "checker": ExternalChecker(
                    id="slow", socket="/run/checker.sock", timeout_ms=LIMITS.safety_ms + 1
                )
            },
            EnvironmentFault,
        ),
        ({"rules": (Rule(id="none", formula="G"),)}, MalformedError),
    ],
)
def test_a_gate_that_cannot_ask_as_it_should_does_not_start(
    changes: dict[str, Any], fault: type[Exception]
) -> None:
    made = parts(estop_fixtures.files(), os.open(os.devnull, os.O_WRONLY), safety=config(**changes))
    with pytest.raises(fault) as refused:
        served(made, lambda told: None)
    assert refused.value.where.startswith("safety.")  # type: ignore[attr-defined]
    assert not made.store.exists()
    os.close(made.journal)
