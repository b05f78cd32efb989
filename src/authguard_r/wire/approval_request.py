# SPDX-License-Identifier: Apache-2.0
"""An open approval request as a gate sends it: the bytes that an approval binds.

What is shown has to be rendered from `scope_bytes` and `situation_bytes` alone, and only once their
digests are those of the request (`client.approvals.shown`). Nothing here carries authority.
Spec page: docs/spec/gate-protocol.md#approvals
"""

from __future__ import annotations

from typing import Any

from msgspec import Struct

from authguard_r.core.approval import ApprovalVerdict
from authguard_r.core.identifiers import (
    Count,
    Digest,
    GrantId,
    Identifier,
    MissionId,
    Positive,
    PrincipalId,
    RegionId,
    RobotId,
)
from authguard_r.core.mission import Guard


class ApprovalAnswer(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One answer that the gate holds.

    Args:
        approver: who signed it.
        role: in which role.
        kind: `individual`, or `threshold` for a group's key.
        threshold: how many people stand behind one signature of a group.
        members: the group's people; empty for one person.
        verdict: approve or deny.
        why_not: code of why it does not count; empty when it does.
    """

    approver: PrincipalId
    role: Identifier
    kind: str
    threshold: Positive
    members: tuple[PrincipalId, ...]
    verdict: ApprovalVerdict
    why_not: str


class Truth(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A condition of the mission or the grant, and whether it held when people were asked."""

    guard: Guard
    held: bool


class Question(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An open request.

    Args:
        counter: its number in the mission; never used twice.
        mid: the mission.
        version: its version.
        mission: digest of the signed mission.
        rid: the robot.
        issuer: who signed the mission, and is never an approver of it.
        task: the request in the operator's words; explains, never authorizes.
        grant: the grant that asks.
        planner: the client whose proposal it is.
        asked_ms: trusted time when it was opened.
        expires_ms: trusted time after which answers are too late.
        left_ms: how long that is from now; negative when it is over.
        scope: digest of the action's effect.
        situation: digest of the guards' truth and the risk tier.
        scope_bytes: what `scope` is the digest of; null when it was destroyed.
        situation_bytes: what `situation` is the digest of; null when it is not available any more.
        guards: the conditions in the order of the situation.
        risk: the score.
        required: people needed, the issuer included.
        behind: people that stand behind it now, the issuer included.
        denied: a person who may answer denied.
        roles: roles whose holders may answer.
        places: regions that an approver's certificate has to name.
        answers: what was answered so far.
        is_current: effect and situation are still what they were when people were asked.
        influenced_by: inputs that mentioned what the action carries.
        seq: number of the decision's record.
    """

    counter: Positive
    mid: MissionId
    version: Positive
    mission: Digest
    rid: RobotId
    issuer: PrincipalId
    task: str
    grant: GrantId
    planner: str
    asked_ms: Count
    expires_ms: Count
    left_ms: int
    scope: Digest
    situation: Digest
    scope_bytes: bytes | None
    situation_bytes: bytes | None
    guards: tuple[Truth, ...]
    risk: Count
    required: Positive
    behind: Positive
    denied: bool
    roles: tuple[Identifier, ...]
    places: tuple[RegionId, ...]
    answers: tuple[ApprovalAnswer, ...]
    is_current: bool
    influenced_by: tuple[dict[str, Any], ...]
    seq: Count


class Questions(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The answer to `APPROVALS`: every open request of the robot's active mission."""

    robot: RobotId
    now_ms: Count
    requests: tuple[Question, ...]
