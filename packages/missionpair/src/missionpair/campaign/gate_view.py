# SPDX-License-Identifier: Apache-2.0
"""What the gate's own checks find in a plan, for an attacker who sees the gate from inside.

It is what such an attacker is shown (white access), and no measure is made of it.
Spec page: docs/spec/missionpair-access.md
"""

from __future__ import annotations

import msgspec

from authguard_r.core.approval import VerifiedApproval
from authguard_r.core.decide import decide
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.finding import Findings
from authguard_r.core.standing import Standing
from missionpair.judging import Checked, Walk
from missionpair.stage import Stage


def gate_findings(stage: Stage, checked: Checked) -> tuple[Findings, ...]:
    """Return what the gate finds in each step that the judge reached; none without a mission.

    Args:
        stage: the situation, before the plan is carried out.
        checked: what the judge says of the plan.
    """
    gate = stage.sim.gate
    try:
        verified = gate.ledger.run(gate.enforcer.inputs.active_mission)
    except AuthGuardError:
        return ()
    walk, found = Walk.of(stage), list[Findings]()
    for effect in checked.effects:
        standing = msgspec.convert(walk.standing, Standing | None)
        decided = decide(
            verified,
            effect.action,
            state=walk.attested(),
            facts=walk.facts,
            now=walk.now,
            standing=standing,
            approvals=() if standing is None else _answers(stage, standing),
        )
        found.append(decided.findings)
        walk.go_on(effect.action, grant=effect.grant if effect.authorized else "")
    return tuple(found)


def _answers(stage: Stage, standing: Standing) -> tuple[VerifiedApproval, ...]:
    gate = stage.sim.gate
    if not standing.requests:
        return ()
    return gate.ledger.run(lambda act: gate.enforcer.inputs.answers(act, standing)).approvals
