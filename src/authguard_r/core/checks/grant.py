# SPDX-License-Identifier: Apache-2.0
"""Checks of one grant: type, tool, parameters, data rights, order, uses, budgets, guards."""

from __future__ import annotations

from authguard_r.core.checks.case import Case
from authguard_r.core.checks.guards import guard_finding
from authguard_r.core.facts import ActionKind
from authguard_r.core.finding import Finding, Findings
from authguard_r.core.identifiers import ParameterId
from authguard_r.core.lifecycle import Status
from authguard_r.core.mission import Grant
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Spend, in_flight, use_of
from authguard_r.core.token import IndexedGrant

#: The parameter that a recording action must carry: the most it may record.
MAX_BYTES = ParameterId("max_bytes")


def check_type(case: Case, indexed: IndexedGrant) -> Findings:
    """(6) The grant is for this action type; exactly, never by prefix (L21)."""
    if case.action.type == indexed.grant.type:
        return ()
    return _one("type", Reason.ACTION_OUT_OF_SCOPE, indexed.grant.type, case.action.type)


def check_tool(case: Case, indexed: IndexedGrant) -> Findings:
    """(6) The grant is for this tool."""
    if case.action.tool == indexed.grant.tool:
        return ()
    return _one("tool", Reason.TOOL_OUT_OF_SCOPE, indexed.grant.tool, case.action.tool)


def check_parameters(case: Case, indexed: IndexedGrant) -> Findings:
    """(6) Every limit's parameter is present and within; no parameter is without a limit (L3)."""
    params, limits = case.action.params, indexed.limits
    found: list[Finding] = []
    for name, limit in limits.items():
        value = params.get(name)
        if value is None:
            found.append(Finding(f"params.{name}", Reason.PARAMETER_MISSING, "a value", "none"))
        elif type(value) is not int or not limit.low <= value <= limit.high:
            place, expected = f"params.{name}", f"{limit.low} to {limit.high}"
            found.append(Finding(place, Reason.PARAMETER_OUT_OF_BOUNDS, expected, str(value)))
    if len(params) != len(limits) or found:
        found += [
            Finding(f"params.{name}", Reason.PARAMETER_NOT_ALLOWED, "no such parameter", str(v))
            for name, v in params.items()
            if name not in limits
        ]
    return tuple(found)


def check_data_rights(case: Case, indexed: IndexedGrant) -> Findings:
    """(6) Recording, storing and transmitting each have their own right."""
    kind, rights = case.kind, indexed.grant.data
    if kind is None or not (kind.records or kind.stores or kind.transmits):
        return ()
    wanted = (
        ("record", kind.records, rights.record),
        ("store", kind.stores, rights.store),
        ("transmit", kind.transmits, rights.transmit),
    )
    return tuple(
        Finding(f"data.{name}", Reason.DATA_RIGHT_MISSING, f"the right to {name}", "none")
        for name, needed, granted in wanted
        if needed and not granted
    )


def check_order(case: Case, indexed: IndexedGrant) -> Findings:
    """(6) What must come first has succeeded since; what ends the grant has not."""
    standing, grant = case.standing, indexed.grant
    if standing is None or not (grant.after or grant.until or standing.status is Status.CLOSING):
        return ()
    mine = use_of(standing, grant.id).last_success
    found = [
        Finding("grant.after", Reason.ORDER_VIOLATED, f"`{before}` succeeded first", "not yet")
        for before in grant.after
        if use_of(standing, before).last_success <= mine
    ]
    found += [
        Finding("grant.until", Reason.GRANT_CLOSED, f"before `{end}` succeeds", "it succeeded")
        for end in grant.until
        if use_of(standing, end).successes
    ]
    closing = case.verified.mission.closing
    if standing.status is Status.CLOSING and (
        closing is None or grant.id not in closing.grants or case.now.utc_ms > standing.closes_ms
    ):
        found.append(Finding("grant.id", Reason.GRANT_CLOSED, "a closing grant, in time", grant.id))
    return tuple(found)


def check_uses(case: Case, indexed: IndexedGrant) -> Findings:
    """(6) A success and a start are left; an action in flight holds one of each."""
    standing, grant = case.standing, indexed.grant
    if standing is None:
        return ()
    use = use_of(standing, grant.id)
    taken = use.successes + (in_flight(standing, grant.id) if standing.open else 0)
    if taken < grant.repeat and use.starts < grant.starts:
        return ()
    held = (
        ("grant.repeat", Reason.REPEAT_EXHAUSTED, taken, grant.repeat),
        ("grant.starts", Reason.STARTS_EXHAUSTED, use.starts, grant.starts),
    )
    return tuple([Finding(f, why, f"under {m}", str(n)) for f, why, n, m in held if n >= m])


def check_budgets(case: Case, indexed: IndexedGrant) -> Findings:
    """(6) The rate, and every budget with this lease's maximum added."""
    standing, budgets = case.standing, case.verified.mission.budgets
    if standing is None:
        return ()
    found: list[Finding] = []
    since = case.now.mono_ms - budgets.rate.per_ms
    recent = len([at for at in standing.releases if at > since])
    if recent >= budgets.rate.count:
        rate = f"under {budgets.rate.count} in {budgets.rate.per_ms} ms"
        found.append(Finding("budgets.rate", Reason.RATE_EXCEEDED, rate, str(recent)))
    spend, spent = spend_of(case.kind, indexed.grant, case.action.params), standing.spent
    held = (
        ("actions", standing.actions, 1, budgets.actions),
        ("motion_ms", spent.motion_ms, spend.motion_ms, budgets.motion_ms),
        ("wait_ms", spent.wait_ms, spend.wait_ms, budgets.wait_ms),
        ("recorded_bytes", spent.recorded_bytes, spend.recorded_bytes, budgets.recorded_bytes),
    )
    found += [
        Finding(f"budgets.{name}", Reason.BUDGET_EXCEEDED, f"at most {most}", str(used + more))
        for name, used, more, most in held
        if more and used + more > most
    ]
    return tuple(found)


def check_grant_guards(case: Case, indexed: IndexedGrant) -> Findings:
    """(6) Every guard of the grant holds on attested, fresh state."""
    rid = case.facts.robot.rid
    found = [guard_finding(g, case.state, rid, case.now) for g in indexed.grant.guards]
    return tuple([finding for finding in found if finding is not None])


def spend_of(kind: ActionKind | None, grant: Grant, params: dict[ParameterId, int]) -> Spend:
    """Return the most that one lease of this grant can use: reserved at commit."""
    if kind is None:
        return Spend()
    return Spend(
        motion_ms=grant.max_ms if kind.moves else 0,
        wait_ms=grant.max_ms if kind.waits else 0,
        recorded_bytes=params.get(MAX_BYTES, 0) if kind.records else 0,
    )


def _one(field: str, reason: Reason, expected: str, got: str) -> Findings:
    return (Finding(field, reason, expected, got),)
