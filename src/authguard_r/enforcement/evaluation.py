# SPDX-License-Identifier: Apache-2.0
"""What both gates would say of an action: nothing is consumed, recorded or released.

Spec page: docs/spec/enforcement.md
"""

from __future__ import annotations

import msgspec

from authguard_r.audit.deviation import weights_of
from authguard_r.core.action import Action
from authguard_r.core.decide import decide
from authguard_r.core.encoding import Tag, digest_of
from authguard_r.core.facts import SiteFacts
from authguard_r.core.ports import SafetyGate
from authguard_r.core.provenance import Label
from authguard_r.core.quantities import Now
from authguard_r.core.standing import Standing
from authguard_r.core.state import AttestedState
from authguard_r.core.token import VerifiedMission
from authguard_r.enforcement.report import Judged
from authguard_r.provenance.labels import label_fields


def evaluate(
    verified: VerifiedMission,
    action: Action,
    *,
    state: AttestedState | None,
    facts: SiteFacts,
    now: Now,
    standing: Standing | None,
    safety: SafetyGate | None = None,
    base: Label = Label.MODEL,
) -> Judged:
    """Return what both gates would say, without consuming, recording or releasing: a what-if.

    Args:
        verified: the mission.
        action: the proposal; its labels and meta are set here, never taken over.
        state: what would be attested.
        facts: the signed site and the gate's identity.
        now: the instant to ask about.
        standing: the registry's entry to ask about.
        safety: the second gate; asked also when the first refuses, to show the two apart.
        base: the least trusted label of anything the planner could have seen.
    """
    labels = label_fields(action, verified, standing, base=base)
    action = msgspec.structs.replace(action, provenance=labels, meta=None)
    decision = decide(verified, action, state=state, facts=facts, now=now, standing=standing)
    digested = digest_of(Tag.ACTION, action)
    return Judged(
        action=action,
        action_digest=digested,
        decision=decision,
        safety=None if safety is None else safety.assess(action, state, facts, now),
        verified=verified,
        standing=standing,
        state=state,
        now=now,
        ticket=digested,
        weights=weights_of(verified.mission.risk_policy, facts.risk),
    )
