# SPDX-License-Identifier: Apache-2.0
"""Everything that is asked and answered over HTTP; the OpenAPI document is made of these.

Spec page: docs/spec/http.md
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from msgspec import UNSET, Meta, Struct, UnsetType

from authguard_r.core.identifiers import Count, Digest, RobotId
from authguard_r.wire.messages import Mode

#: Most evaluations of one request.
MAX_BATCH = 100
#: Longest page of records, and its default length.
MAX_PAGE, PAGE = 1_000, 100

#: What the sender knows of a person or a thing; nothing here reads it.
Claims = dict[str, Any]


class _RequestPart(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A part of a request; what it does not have is refused, for it may be a misspelled field."""


class Subject(_RequestPart, frozen=True, kw_only=True):
    """Who asks, as the enforcement point calls it. It is no authority."""

    type: str
    id: str
    properties: Claims | UnsetType = UNSET


class Resource(_RequestPart, frozen=True, kw_only=True):
    """What is asked about: the robot, of type `robot`."""

    type: str
    id: str
    properties: Claims | UnsetType = UNSET


class ActionMessage(_RequestPart, frozen=True, kw_only=True):
    """A tool's call: its name, and its arguments as `properties`, as the planner wrote both."""

    name: str
    properties: dict[str, Any] | UnsetType = UNSET


class Evaluation(_RequestPart, frozen=True, kw_only=True):
    """One question of the Authorization API."""

    subject: Subject
    action: ActionMessage
    resource: Resource
    context: Claims | UnsetType = UNSET


class Part(_RequestPart, frozen=True, kw_only=True):
    """One question of several; what it leaves out is the whole request's."""

    subject: Subject | UnsetType = UNSET
    action: ActionMessage | UnsetType = UNSET
    resource: Resource | UnsetType = UNSET
    context: Claims | UnsetType = UNSET


#: When a batch ends before its last question.
Semantic = Literal["execute_all", "deny_on_first_deny", "permit_on_first_permit"]


class Options(_RequestPart, frozen=True, kw_only=True):
    """How a batch is evaluated."""

    evaluations_semantic: Semantic = "execute_all"


class Evaluations(_RequestPart, frozen=True, kw_only=True):
    """Several questions, or one without `evaluations`."""

    subject: Subject | UnsetType = UNSET
    action: ActionMessage | UnsetType = UNSET
    resource: Resource | UnsetType = UNSET
    context: Claims | UnsetType = UNSET
    options: Options = Options()
    evaluations: Annotated[tuple[Part, ...], Meta(max_length=MAX_BATCH)] = ()


class ProposalMessage(_RequestPart, frozen=True, kw_only=True):
    """A tool's call that is to be carried out."""

    tool: str
    arguments: dict[str, Any] = {}


class MissionName(Struct, frozen=True, kw_only=True):
    """The mission that was asked about."""

    mid: str
    version: int
    digest: Digest


class Trouble(Struct, frozen=True, kw_only=True):
    """Why one question of several has no answer of the gate."""

    status: int
    code: str
    message: str


class Said(Struct, frozen=True, kw_only=True):
    """What the gate says of a question.

    Args:
        authoritative: it was carried out under this decision; false for what was only asked.
        consumes: something was used up by it.
        holds_ms: how long the answer holds beyond its instant: not at all.
        robot: whose gate answers.
        outcome: the authorization gate's: `accept`, `reject`, `request_approval`.
        reasons: codes, the first is primary.
        safe: the safety gate's; null when it was not asked.
        retryable: the same question can be answered otherwise without a new signature.
        required_approvals: people that have to stand behind it.
        mission: the active mission; null without one, or where it was not looked at.
        action_digest: of the action that the call was understood as.
        findings: the fields of the refusal, as far as they are disclosed.
        detail: everything else that the gate says; at full disclosure.
        shadow: nothing is enforced: the decision is always to go on.
        would: what the decision would have been.
        error: of a question of a batch: there is no answer of the gate.
    """

    authoritative: bool
    consumes: bool
    holds_ms: int
    robot: RobotId
    outcome: str
    reasons: tuple[str, ...]
    safe: bool | None = None
    retryable: bool | None = None
    required_approvals: int | None = None
    mission: MissionName | None = None
    action_digest: str | None = None
    findings: tuple[dict[str, Any], ...] | UnsetType = UNSET
    detail: dict[str, Any] | UnsetType = UNSET
    shadow: bool | UnsetType = UNSET
    would: bool | UnsetType = UNSET
    error: Trouble | UnsetType = UNSET


class Decided(Struct, frozen=True, kw_only=True):
    """The answer to one question; `decision` is advice, and true for its instant alone."""

    decision: bool
    context: Said


class DecidedAll(Struct, frozen=True, kw_only=True):
    """The answers to several questions, in their order."""

    evaluations: tuple[Decided, ...]


class Carried(Struct, frozen=True, kw_only=True):
    """The result of a proposal.

    Args:
        decision: it was released.
        context: the gate's decision; this one counts.
        executed: the controller began it.
        execution: how it ended: `outcome`, `reasons`, `recorded`.
        seq: number of its record.
        repeated: this is the answer to an earlier proposal under the same key.
    """

    decision: bool
    context: Said
    executed: bool
    execution: dict[str, Any]
    seq: int | None
    repeated: bool


class Problem(Struct, frozen=True, kw_only=True):
    """Why a request has no answer.

    Args:
        code: a reason code.
        message: what was expected.
        where: the place in the request, or empty.
    """

    code: str
    message: str
    where: str


class Metadata(Struct, frozen=True, kw_only=True):
    """Where the endpoints of the Authorization API are."""

    policy_decision_point: str
    access_evaluation_endpoint: str
    access_evaluations_endpoint: str


class GrantUse(Struct, frozen=True, kw_only=True):
    """How often a grant was used, `of` how many times."""

    id: str
    type: str
    starts: int
    of: int | None


class MissionMessage(Struct, frozen=True, kw_only=True):
    """The active mission as it stands."""

    mid: str
    version: int
    status: str
    void: str | None
    issuer: str
    expiry: str
    closes: str | None
    open: tuple[str, ...]
    requests: dict[str, Any]
    prompts: int
    grants: tuple[GrantUse, ...]


class StandingMessage(Struct, frozen=True, kw_only=True):
    """The robot's mission, or that it has none."""

    robot: RobotId
    mission: MissionMessage | None
    stop_stands: bool


class StatusMessage(StandingMessage, frozen=True, kw_only=True):
    """What a gate says of itself."""

    mode: Mode
    uptime_ms: Count
    leases: tuple[dict[str, Any], ...]
    clients: tuple[dict[str, Any], ...]
    heard: dict[str, Any]
    stops: Count
    emergency: dict[str, Any] | None
    alerts: tuple[dict[str, Any], ...]
    log: dict[str, Any]
    refusals: dict[str, Any]
    disk: dict[str, Any] | None
    lane: dict[str, Any] | None
    anchor: dict[str, Any]


class RecordMessage(Struct, frozen=True, kw_only=True):
    """One record of the log, with the values beside it as they lie there."""

    seq: Count
    record: dict[str, Any]
    sealed: dict[str, Any]
    link: str


class RecordsMessage(Struct, frozen=True, kw_only=True):
    """A page of the log.

    Args:
        records: in the order of the log.
        next: the `first` of the next page; null when this one is empty.
    """

    records: tuple[RecordMessage, ...]
    next: Count | None


class Explanation(Struct, frozen=True, kw_only=True):
    """One record in words."""

    seq: Count
    kind: str
    time: str
    decision: str
    what: str
    who: str
    why: tuple[Any, ...]
    influenced_by: tuple[Any, ...]
    mends: tuple[Any, ...]
    smallest_change: Any
    text: tuple[str, ...]
    closed: Any = None


class Page(_RequestPart, frozen=True, kw_only=True):
    """Which records."""

    first: Count = 0
    count: Annotated[int, Meta(ge=1, le=MAX_PAGE)] = PAGE


class Numbered(_RequestPart, frozen=True, kw_only=True):
    """Which record."""

    seq: Count


class Counted(_RequestPart, frozen=True, kw_only=True):
    """Which approval request."""

    counter: Annotated[int, Meta(ge=1, le=9_007_199_254_740_991)]


class NoParameters(_RequestPart, frozen=True, kw_only=True):
    """No parameters."""
