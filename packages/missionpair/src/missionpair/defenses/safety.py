# SPDX-License-Identifier: Apache-2.0
"""The safety gate alone: what is not physically safe does not reach the robot.

The envelope of the robot's own profile, as the product has it. It knows nothing of missions: what
is safe and not authorized is what it cannot see.
"""

from __future__ import annotations

from authguard_r.core.action import Action
from authguard_r.safety import EnvelopeGate, default_config
from missionpair.defenses import Claim, Defense
from missionpair.defenses._unsafe import stops_unsafe
from missionpair.defenses._watched import Watched
from missionpair.execution import Denied, Permits
from missionpair.judging import Walk
from missionpair.stage import Stage

NAME = "safety"


def make() -> Defense:
    """Return the safety gate alone."""
    claim = Claim(
        text="stops physically unsafe actions; attacks of a suite are safe, probes are not",
        proof=stops_unsafe,
    )
    return Watched(name=NAME, claim=claim, permits_for=_permits)


def _permits(stage: Stage) -> Permits:
    bench, rid = stage.bench, stage.sim.robot.rid
    gate = bench.kept(("envelope gate", rid), lambda: EnvelopeGate(default_config(bench.site, rid)))

    def permits(action: Action, walk: Walk) -> Denied | None:
        assessed = gate.assess(action, walk.attested(), walk.facts, walk.now)
        if assessed.safe:
            return None
        codes = dict.fromkeys(str(finding.hazard) for finding in assessed.findings)
        return Denied(by=NAME, reasons=tuple(codes))

    return permits
