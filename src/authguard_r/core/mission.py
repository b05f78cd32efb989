# SPDX-License-Identifier: Apache-2.0
"""The mission language: everything that a signature can grant, and nothing that it can imply.

Absent never means anything: no limit, no parameter; no list, nothing; granting a region grants
no child. Source: `eq:mission`. Spec page: docs/spec/mission-language.md
"""

from __future__ import annotations

import unicodedata
from collections.abc import Iterator
from enum import StrEnum
from operator import lt
from typing import Annotated, Literal

from msgspec import Meta, Struct

from authguard_r.core import identifiers as ids
from authguard_r.core.errors import MalformedError
from authguard_r.core.provenance import WIDEST, Chooser, Label, SourceField
from authguard_r.core.quantities import to_ms
from authguard_r.core.reasons import Reason

MAX_GRANTS = 64
MAX_ROWS = 256
#: The language, and the one before it had `sources`, `retention` and `risk_policy.field_weights`.
SCHEMA, FIRST_SCHEMA = "authguard-r/mission/2", "authguard-r/mission/1"
_NO_SET = "expected a sorted set without repeats"
_NO_ENDS = "expected the row's source and destination among them"


class Comparison(StrEnum):
    """How a guard compares an attested value with a signed one."""

    EQ = "eq"
    NE = "ne"
    LT = "lt"
    LE = "le"
    GT = "gt"
    GE = "ge"


class OnRefusal(StrEnum):
    """What the enforcer does after a refusal: hold still, stop the run, or ask the operator."""

    HOLD = "hold"
    STOP = "stop"
    ASK = "ask"


class ProtectedField(StrEnum):
    """The fields j that D_M of `eq:action-deviation` weighs, in the order of findings."""

    MISSION = "mission"
    TIME = "time"
    ROBOT = "robot"
    TYPE = "type"
    TOOL = "tool"
    OBJECT = "object"
    SOURCE = "source"
    DESTINATION = "destination"
    ROUTE = "route"
    PARAMETERS = "parameters"
    ORDER = "order"
    USE = "use"
    STATE = "state"
    PROVENANCE = "provenance"
    APPROVAL = "approval"


class DataClass(StrEnum):
    """What a sealed field of the log is about; the order is that in which keys are joined."""

    EVIDENCE = "evidence"
    OBJECT = "object"
    PARAMETER = "parameter"
    PERSON = "person"
    REGION = "region"


class _Signed(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """The manner of every signed struct: closed, immutable, one spelling."""


class Row(_Signed, frozen=True, kw_only=True):
    """One alternative of a grant: these fields together, never a cross product.

    Args:
        object: the object; absent when the action type has none.
        source: where the action starts.
        destination: where it ends.
        regions: everything that the robot may touch on the way, source and destination included.
    """

    object: ids.ObjectId | None = None
    source: ids.RegionId | None = None
    destination: ids.RegionId | None = None
    regions: tuple[ids.RegionId, ...] = ()


class Limit(_Signed, frozen=True, kw_only=True):
    """Closed bounds of one parameter, in the unit that its name ends with."""

    parameter: ids.ParameterId
    low: ids.Integer
    high: ids.Integer


class Guard(_Signed, frozen=True, kw_only=True):
    """A condition on attested state that must hold at the decision and while the robot acts.

    Args:
        variable: the state variable.
        comparison: how the attested value compares with `value`.
        value: an integer, truth value or identifier; types must agree, order only on integers.
        max_age_ms: how old the reading may be, in milliseconds.
    """

    variable: ids.VariableId
    comparison: Comparison
    value: ids.Integer | bool | ids.Identifier
    max_age_ms: ids.Count


class DataRights(_Signed, frozen=True, kw_only=True):
    """What may be done with sensor data; each right is separate, none implies another."""

    record: bool = False
    store: bool = False
    transmit: bool = False


class Grant(_Signed, frozen=True, kw_only=True):
    """One permission: an action type by a tool, over rows, within limits, so often.

    Args:
        id: name that standing, order and updates refer to.
        type: the canonical action type.
        tool: the tool that may carry it out.
        alternatives: the rows; the action must match one whole row.
        limits: bounds for every parameter that an action may carry; others may not be carried.
        guards: conditions beside the mission's own.
        data: data rights; stated even when there are none, for a default would have two spellings.
        chooser: who may choose among rows.
        after: grants that must have succeeded since this one's last success.
        until: grants whose success closes this one.
        repeat: successes allowed.
        starts: releases allowed, at least `repeat`.
        max_ms: longest lease of one release, in milliseconds.
        irreversible: a start is never given back.
        done_when: attested postcondition that settles an unknown outcome.
        completes: the mission is complete when every such grant has all its successes.
    """

    id: ids.GrantId
    type: ids.ActionType
    tool: ids.ToolId
    alternatives: Annotated[tuple[Row, ...], Meta(min_length=1, max_length=MAX_ROWS)]
    chooser: Chooser
    repeat: ids.Positive
    starts: ids.Positive
    max_ms: ids.Positive
    irreversible: bool
    limits: tuple[Limit, ...] = ()
    guards: tuple[Guard, ...] = ()
    data: DataRights
    after: tuple[ids.GrantId, ...] = ()
    until: tuple[ids.GrantId, ...] = ()
    done_when: tuple[Guard, ...] = ()
    completes: bool = False


class Rate(_Signed, frozen=True, kw_only=True):
    """At most `count` releases in any `per_ms` milliseconds of the gate's monotonic clock."""

    count: ids.Positive
    per_ms: ids.Positive


class Budgets(_Signed, frozen=True, kw_only=True):
    """Mission-wide totals; zero is zero, not unlimited.

    Args:
        actions: releases in all.
        rate: releases in a window.
        motion_ms: time in motion, milliseconds.
        wait_ms: time in deliberate waiting, milliseconds.
        recorded_bytes: sensor data recorded, bytes.
        prompts: times that a person may be asked.
        planner_stops: stops that the planner may ask for before an alert.
    """

    actions: ids.Count
    rate: Rate
    motion_ms: ids.Count
    wait_ms: ids.Count
    recorded_bytes: ids.Count
    prompts: ids.Count
    planner_stops: ids.Count


class ParameterRisk(_Signed, frozen=True, kw_only=True):
    """Adds `weight` times the parameter's share of `full_scale`, rounded up."""

    parameter: ids.ParameterId
    full_scale: ids.Positive
    weight: ids.Count


class StateRisk(_Signed, frozen=True, kw_only=True):
    """Adds `weight` while the condition holds, or while it cannot be attested that it does not."""

    guard: Guard
    weight: ids.Count


class RiskPolicy(_Signed, frozen=True, kw_only=True):
    """The weights of rho(a,s) and the thresholds of `eq:threshold`.

    Args:
        types: weight by action type.
        region_tags: weight by region tag; the heaviest tag of all regions involved counts.
        object_classes: weight by object class.
        parameters: weight of forceful parameters.
        privacy: weight of each step of the type's privacy impact.
        states: weight of states of the world.
        otherwise: weight of a type, tag or class that is not listed.
        tau_1: from here on two principals must approve.
        tau_2: from here on `t` principals must approve.
        t: number of principals, the issuer included, at least 2.
        roles: roles whose holders may approve.
        valid_ms: how long a request and its approvals live, in milliseconds.
        field_weights: w_j of `eq:action-deviation` by protected field; a field that is absent
            weighs 1. They measure how far an action deviates and authorize nothing.
    """

    otherwise: ids.Count
    tau_1: ids.Count
    tau_2: ids.Count
    t: Annotated[int, Meta(ge=2, le=64)]
    roles: Annotated[tuple[ids.Identifier, ...], Meta(min_length=1)]
    privacy: ids.Count
    valid_ms: ids.Positive
    types: dict[ids.ActionType, ids.Count] = {}
    region_tags: dict[ids.Identifier, ids.Count] = {}
    object_classes: dict[ids.Identifier, ids.Count] = {}
    parameters: tuple[ParameterRisk, ...] = ()
    states: tuple[StateRisk, ...] = ()
    field_weights: dict[ProtectedField, ids.Positive] = {}


#: AllowedSrc(f): the labels that may set a field, sorted, at least one.
Sources = dict[SourceField, Annotated[tuple[Label, ...], Meta(min_length=1)]]


class Closing(_Signed, frozen=True, kw_only=True):
    """Grants that stay open for a while after completion, such as going home."""

    grants: Annotated[tuple[ids.GrantId, ...], Meta(min_length=1)]
    for_ms: ids.Positive


class Mission(_Signed, frozen=True, kw_only=True):
    """The signed policy Pi_M: the paper's thirteen fields, with site and profile bound.

    Args:
        schema: version of this language.
        mid: the mission's name; with `version` it names one policy.
        version: v, from 1.
        supersedes: digest of version v-1; absent for version 1 only.
        rid: the one robot.
        profile: digest of the capability profile the mission was written for.
        site: digest of the signed site model that gives the words their meaning.
        issuer: the principal who signs.
        task: the request in the operator's words; explains, never authorizes.
        actions: the grants, in the order in which they are tried.
        objects: ceiling: no grant reaches an object outside.
        regions: ceiling: no grant reaches a region outside.
        limits: ceilings on the parameters that they name.
        guards: conditions on every action.
        not_before: first second of validity.
        expiry: last instant of validity; only t > expiry is refused.
        place_max_age_ms: how old the attested place may be, in milliseconds.
        nonce: 16 fresh random bytes.
        risk_policy: who must approve what.
        budgets: totals.
        on_refusal: what happens after a refusal.
        closing: grants that outlive completion.
        sources: AllowedSrc(f) by field: the labels that may set it, sorted. It narrows what site
            and grant allow; a field that is absent is not narrowed.
        retention: how long after `expiry` the gate keeps the sealed fields of a class, in
            milliseconds; a class that is absent is kept as the gate's configuration says.
    """

    schema: Literal["authguard-r/mission/1", "authguard-r/mission/2"]
    mid: ids.MissionId
    version: ids.Positive
    rid: ids.RobotId
    profile: ids.Digest
    site: ids.Digest
    issuer: ids.PrincipalId
    task: Annotated[str, Meta(min_length=1, max_length=2000)]
    actions: Annotated[tuple[Grant, ...], Meta(min_length=1, max_length=MAX_GRANTS)]
    objects: tuple[ids.ObjectId, ...]
    regions: tuple[ids.RegionId, ...]
    limits: tuple[Limit, ...]
    guards: tuple[Guard, ...]
    not_before: ids.Timestamp
    expiry: ids.Timestamp
    place_max_age_ms: ids.Count
    nonce: Annotated[str, Meta(pattern=r"\A[A-Za-z0-9_-]{22}\Z")]
    risk_policy: RiskPolicy
    budgets: Budgets
    on_refusal: OnRefusal
    supersedes: ids.Digest | None = None
    closing: Closing | None = None
    sources: Sources = {}
    retention: dict[DataClass, ids.Positive] = {}


def require_schema(mission: Mission) -> None:
    """Hold a decoded mission to the rules that its types cannot say (`SchemaValid`).

    Raises:
        MalformedError: with reason `SCHEMA_INVALID` and the place of the first fault.
    """
    for place, fault in _faults(mission):
        raise MalformedError(fault, where=place, reason=Reason.SCHEMA_INVALID)


def _faults(mission: Mission) -> Iterator[tuple[str, str]]:
    if unicodedata.normalize("NFC", mission.task) != mission.task:
        yield "task", "expected text in normalization form C"
    if (mission.version == 1) != (mission.supersedes is None):
        yield "supersedes", "expected the digest of the version before, and none for version 1"
    if to_ms(mission.not_before, where="not_before") > to_ms(mission.expiry, where="expiry"):
        yield "expiry", "expected an instant not before `not_before`"
    if mission.risk_policy.tau_1 > mission.risk_policy.tau_2:
        yield "risk_policy.tau_2", "expected at least `tau_1`"
    yield from _newer(mission)
    yield from source_faults(mission.sources)
    yield from _set("objects", mission.objects)
    yield from _set("regions", mission.regions)
    yield from _set("risk_policy.roles", mission.risk_policy.roles)
    yield from _limits("limits", mission.limits)
    known = {grant.id for grant in mission.actions}
    if len(known) != len(mission.actions):
        yield "actions", "expected grant ids that differ"
    for number, grant in enumerate(mission.actions):
        for place, fault in _grant_faults(grant, known):
            yield f"actions[{number}].{place}", fault
    if mission.closing:
        yield from _named("closing.grants", mission.closing.grants, known)


def _newer(mission: Mission) -> Iterator[tuple[str, str]]:
    """Yield the fields that the first language does not have: it is what it was."""
    newer = (
        ("sources", mission.sources),
        ("retention", mission.retention),
        ("risk_policy.field_weights", mission.risk_policy.field_weights),
    )
    if mission.schema == FIRST_SCHEMA:
        for place, value in newer:
            if value:
                fault = f"expected none in `{FIRST_SCHEMA}`"
                yield place, f"{fault}: `authguard mission compile` writes `{SCHEMA}`"


def source_faults(sources: Sources) -> Iterator[tuple[str, str]]:
    """Yield where AllowedSrc names a label twice, or one that the paper's bound leaves out."""
    for field, labels in sources.items():
        yield from _set(f"sources.{field}", labels)
        if not WIDEST[field].issuperset(labels):
            yield (
                f"sources.{field}",
                f"expected labels of {', '.join(sorted(WIDEST[field]))}",
            )


def _rising(items: tuple[str, ...]) -> bool:
    return len(items) < 2 or all(map(lt, items, items[1:]))


def _set(place: str, items: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    if not _rising(items):
        yield place, _NO_SET


def _named(
    place: str, grants: tuple[ids.GrantId, ...], known: set[ids.GrantId]
) -> Iterator[tuple[str, str]]:
    yield from _set(place, grants)
    if not known.issuperset(grants):
        yield place, "expected ids of grants of this mission"


def _limits(place: str, limits: tuple[Limit, ...]) -> Iterator[tuple[str, str]]:
    if len(limits) > 1 and not _rising(tuple([limit.parameter for limit in limits])):
        yield place, "expected limits sorted by parameter, one for each"
    for number, limit in enumerate(limits):
        if limit.low > limit.high:
            yield f"{place}[{number}].high", "expected at least `low`"


def _grant_faults(grant: Grant, known: set[ids.GrantId]) -> Iterator[tuple[str, str]]:
    """Yield the faults of one grant; a place is spelled only when there is a fault in it."""
    if grant.starts < grant.repeat:
        yield "starts", "expected at least `repeat`"
    if grant.after or grant.until:
        yield from _named("after", grant.after, known)
        yield from _named("until", grant.until, known)
        if grant.id in grant.after or grant.id in grant.until:
            yield "id", "expected a grant that does not wait for itself"
    if 1 < len(grant.alternatives) != len(set(grant.alternatives)):
        yield "alternatives", "expected rows that differ"
    yield from _limits("limits", grant.limits)
    for index, row in enumerate(grant.alternatives):
        if not _rising(row.regions):
            yield f"alternatives[{index}].regions", _NO_SET
        for end in (row.source, row.destination):
            if end is not None and end not in row.regions:
                yield f"alternatives[{index}].regions", _NO_ENDS
