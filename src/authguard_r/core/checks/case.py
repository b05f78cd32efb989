# SPDX-License-Identifier: Apache-2.0
"""What every check reads: one decision's inputs, unchanged from the first check to the last."""

from __future__ import annotations

from msgspec import Struct

from authguard_r.core.action import Action
from authguard_r.core.approval import VerifiedApproval, VerifiedPreApproval
from authguard_r.core.facts import ActionKind, SiteFacts
from authguard_r.core.quantities import Now
from authguard_r.core.standing import Standing
from authguard_r.core.state import AttestedState
from authguard_r.core.token import VerifiedMission


class Case(Struct, frozen=True, kw_only=True):
    """The paper's (T, a, s, t, R), with the site's facts and the approvals at hand.

    Args:
        verified: the mission; authority comes from here.
        action: the proposal; untrusted.
        kind: the vocabulary's entry for its type, None when there is none.
        state: attested state, None when there is none.
        facts: the signed site and the gate's own identity.
        now: the instant of the decision.
        standing: the registry's entry, None when there is none.
        approvals: authentic answers of principals; whether they fit is decided here.
        preapprovals: authentic pre-approvals of principals; likewise.
    """

    verified: VerifiedMission
    action: Action
    kind: ActionKind | None
    state: AttestedState | None
    facts: SiteFacts
    now: Now
    standing: Standing | None
    approvals: tuple[VerifiedApproval, ...]
    preapprovals: tuple[VerifiedPreApproval, ...] = ()
