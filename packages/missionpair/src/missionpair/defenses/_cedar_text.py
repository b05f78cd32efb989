# SPDX-License-Identifier: Apache-2.0
"""A mission's scope in Cedar: one policy for each signed row, ceilings that forbid, a schema.

What Cedar says without bending: who, which kind of action, with which tool, on which thing, from
where, to where, through what, within which limits, in which attested state, from when until when.
Spec page: docs/spec/defenses.md#cedar
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from authguard_r.core.action import Action
from authguard_r.core.facts import ActionKind, SiteFacts
from authguard_r.core.mission import Comparison, Grant, Guard, Limit, Mission, Row
from authguard_r.core.quantities import to_ms
from missionpair.defenses._cedar_context import conditions, context_type
from missionpair.judging import Walk

_SPELLED = {
    Comparison.EQ: "==",
    Comparison.NE: "!=",
    Comparison.LT: "<",
    Comparison.LE: "<=",
    Comparison.GT: ">",
    Comparison.GE: ">=",
}
_TYPES: dict[type, str] = {bool: "Bool", int: "Long", str: "String"}


def policies(mission: Mission, facts: SiteFacts, *, full: bool = False) -> str:
    """Return the mission's scope as Cedar policies; what no policy permits is denied.

    Args:
        mission: the one that is in force.
        facts: the site, for what a kind of action records.
        full: ask also what the caller remembers (`_cedar_context`).
    """
    made = [
        _permit(
            mission,
            grant,
            row,
            more=conditions(mission, grant, row, facts.vocabulary[grant.type]) if full else (),
        )
        for grant in mission.actions
        if _may_record(grant, facts.vocabulary.get(grant.type))
        for row in grant.alternatives
    ]
    return "\n".join((*made, *_ceilings(mission)))


def schema(mission: Mission, facts: SiteFacts, *, full: bool = False) -> str:
    """Return the Cedar schema that the mission's policies are of."""
    more = f", {context_type(mission)}" if full else ""
    state = {guard.variable: _TYPES[type(guard.value)] for guard in _guards(mission)}
    read = ", ".join(f'"{name}"?: {kind}' for name, kind in sorted(state.items()))
    actions = [
        f'action "{name}" appliesTo {{ principal: [Robot], resource: [Tool], context: '
        f"{{ object?: String, source?: String, destination?: String, route: Set<String>, "
        f"place: Set<String>, named: Set<String>, params: {{ {_params(kind)} }}, "
        f"state: {{ {read} }}, now: Long{more} }} }};"
        for name, kind in sorted(facts.vocabulary.items())
    ]
    return "\n".join(("entity Robot;", "entity Tool;", *actions))


def request(walk: Walk, action: Action) -> dict[str, Any]:
    """Return the question that an action puts; its context is a value, to be spelled once."""
    attested = walk.attested()
    readings = attested.snapshot.readings
    context: dict[str, Any] = {
        "route": action.route,
        "place": sorted(attested.place),
        "named": tuple(action.params),
        "params": action.params,
        "state": {str(name): found.value for name, found in readings.items()},
        "now": walk.now.utc_ms,
    }
    for field in ("object", "source", "destination"):
        value = getattr(action, field)
        if value is not None:
            context[field] = value
    return {
        "principal": {"type": "Robot", "id": walk.facts.robot.rid},
        "action": {"type": "Action", "id": action.type},
        "resource": {"type": "Tool", "id": action.tool},
        "context": context,
    }


def _permit(mission: Mission, grant: Grant, row: Row, *, more: Iterable[str] = ()) -> str:
    told = [
        f"context.now >= {to_ms(mission.not_before, where='not_before')}",
        f"context.now <= {to_ms(mission.expiry, where='expiry')}",
        *(_field(name, getattr(row, name)) for name in ("object", "source", "destination")),
        _within("context.route", row.regions),
        *_place(row),
        _within("context.named", [limit.parameter for limit in grant.limits]),
        *(text for limit in grant.limits for text in _limit(limit)),
        *(text for guard in (*mission.guards, *grant.guards) for text in _guard(guard)),
        *more,
    ]
    return (
        f'permit (principal == Robot::"{mission.rid}", action == Action::"{grant.type}", '
        f'resource == Tool::"{grant.tool}") when {{ {" && ".join(told)} }};'
    )


def _ceilings(mission: Mission) -> Iterator[str]:
    """Give what forbids: a thing, a place or a value outside the mission as a whole."""
    ends = {"object": mission.objects, "source": mission.regions, "destination": mission.regions}
    found = [f"context has {name} && !{_one_of(name, words)}" for name, words in ends.items()]
    for text in (*found, f"!({_within('context.route', mission.regions)})"):
        yield f"forbid (principal, action, resource) when {{ {text} }};"
    for limit in mission.limits:
        name = limit.parameter
        outside = (
            f'context.params["{name}"] < {limit.low} || context.params["{name}"] > {limit.high}'
        )
        kinds = {f'Action::"{grant.type}"' for grant in mission.actions if _has(grant, limit)}
        if kinds:  # only these actions can have it
            yield (
                f"forbid (principal, action in [{', '.join(sorted(kinds))}], resource) when "
                f'{{ context.params has "{name}" && ({outside}) }};'
            )


def _has(grant: Grant, limit: Limit) -> bool:
    return any(own.parameter == limit.parameter for own in grant.limits)


def _field(name: str, value: str | None) -> str:
    if value is None:
        return f"!(context has {name})"
    return f'context has {name} && context.{name} == "{value}"'


def _place(row: Row) -> tuple[str, ...]:
    """Say where the robot has to be: at the row's source, else inside the row's regions."""
    if row.source is None and not row.regions:
        return ()
    near = row.regions if row.source is None else (row.source,)
    return (f"{_set(near)}.containsAny(context.place)", _within("context.place", near))


def _limit(limit: Limit) -> tuple[str, ...]:
    value = f'context.params["{limit.parameter}"]'
    return (
        f'context.params has "{limit.parameter}"',
        f"{value} >= {limit.low}",
        f"{value} <= {limit.high}",
    )


def _guard(guard: Guard) -> tuple[str, ...]:
    value = f'"{guard.value}"' if isinstance(guard.value, str) else str(guard.value).lower()
    read = f'context.state["{guard.variable}"]'
    return (
        f'context.state has "{guard.variable}"',
        f"{read} {_SPELLED[guard.comparison]} {value}",
    )


def _guards(mission: Mission) -> Iterator[Guard]:
    yield from mission.guards
    for grant in mission.actions:
        yield from grant.guards


def _may_record(grant: Grant, kind: ActionKind | None) -> bool:
    """True when the grant has every right to data that its kind of action needs."""
    if kind is None:
        return False
    rights = grant.data
    return (
        rights.record >= kind.records
        and rights.store >= kind.stores
        and rights.transmit >= kind.transmits
    )


def _params(kind: ActionKind) -> str:
    return ", ".join(f'"{name}"?: Long' for name in sorted(kind.params))


def _one_of(field: str, names: Iterable[str]) -> str:
    return f"({' || '.join(f'context.{field} == {_quoted(name)}' for name in names) or 'false'})"


def _within(value: str, names: Sequence[str]) -> str:
    """Say that a set holds nothing else; Cedar has no spelling of an empty set that has a type."""
    return f"{_set(names)}.containsAll({value})" if names else f"{value}.isEmpty()"


def _quoted(name: str) -> str:
    return f'"{name}"'


def _set(names: Iterable[str]) -> str:
    return f"[{', '.join(map(_quoted, names))}]"
