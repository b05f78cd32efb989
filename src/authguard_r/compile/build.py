# SPDX-License-Identifier: Apache-2.0
"""From a draft to the structure that is signed: resolved, complete, canonical, or a question.

The compiler adds nothing: an absent privileged field is asked for, an unknown word is refused.
Source: section "Mission Compilation and Clarification". How-to: docs/howto/missions.md
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NoReturn

from authguard_r.compile.draft import Draft, DraftGrant, DraftGuard, DraftRow, Quantity
from authguard_r.compile.units import to_integer
from authguard_r.core.errors import ClarificationError, MalformedError
from authguard_r.core.identifiers import ActionType, ParameterId, RobotId, Timestamp
from authguard_r.core.mission import Comparison, Mission, require_schema
from authguard_r.core.quantities import Now, to_ms, to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.site.model import Site, profile_digest, site_digest
from authguard_r.site.source import convert

_MS = "millisecond"


def compile_draft(draft: Draft, site: Site, *, now: Now, nonce: str) -> Mission:
    """Return the mission that the draft means at this site.

    Args:
        draft: what a person wrote.
        site: gives the words their meaning; its digest is bound.
        now: the instant that a relative window starts at.
        nonce: 22 characters of base64url, fresh.

    Raises:
        ClarificationError: a privileged field is absent or ambiguous.
        MalformedError: a word that the site does not know, or a rule of the language broken.
    """
    if not _is_text(draft.task):
        raise MalformedError("expected text that UTF-8 can spell", where="task")
    rid = _robot(draft, site)
    first, last = _window(draft, now)
    rows = [row for grant in draft.grants for row in grant.rows or ()]
    plain: dict[str, Any] = {
        "schema": "authguard-r/mission/1",
        "mid": draft.mission,
        "version": draft.version,
        "rid": rid,
        "profile": profile_digest(site.robots[RobotId(rid)].profile),
        "site": site_digest(site),
        "issuer": draft.issuer or _ask("Who signs this mission?", "issuer"),
        "task": draft.task,
        "actions": [_grant(grant, n, draft, site) for n, grant in enumerate(draft.grants)],
        "objects": _ceiling(draft.objects, (row.object for row in rows)),
        "regions": _ceiling(draft.regions, (region for row in rows for region in row.regions)),
        "limits": _limits(draft.limits, site, "limits"),
        "guards": [_guard(guard, f"guards[{n}]") for n, guard in enumerate(draft.guards)],
        "not_before": first,
        "expiry": last,
        "place_max_age_ms": _duration(draft.place_max_age, "place_max_age"),
        "nonce": nonce,
        "risk_policy": _risk(draft, site),
        "budgets": _budgets(draft),
        "on_refusal": draft.on_refusal or _ask_refusal(),
    }
    if draft.supersedes is not None:
        plain["supersedes"] = draft.supersedes
    if draft.closing is not None:
        plain["closing"] = {
            "grants": sorted(draft.closing.get("grants", ())),
            "for_ms": _duration(draft.closing.get("for"), "closing.for"),
        }
    mission = convert(plain, Mission, where="draft")
    require_schema(mission)
    _require_words(mission, site)
    return mission


def _is_text(text: str) -> bool:
    return not any("\ud800" <= mark <= "\udfff" for mark in text)


def _robot(draft: Draft, site: Site) -> str:
    if draft.robot is None:
        _ask("Which robot is meant?", "robot", sorted(site.robots))
    if draft.robot not in site.robots:
        raise MalformedError(f"the site has no robot `{draft.robot}`", where="robot")
    return draft.robot


def _window(draft: Draft, now: Now) -> tuple[str, str]:
    window = draft.window
    if window is None:
        _ask("From when until when is the mission valid?", "window")
    if set(window) == {"for"}:
        length = to_integer(window["for"], _MS, where="window.for")
        return to_timestamp(now.utc_ms), to_timestamp(now.utc_ms + length)
    if set(window) != {"not_before", "expiry"}:
        raise MalformedError("expected `for`, or `not_before` and `expiry`", where="window")
    for name in ("not_before", "expiry"):
        if "T" not in window[name]:
            _ask("A time needs its date and zone: 2026-01-31T14:30:00Z?", f"window.{name}")
        instant = convert(window[name], Timestamp, where=f"window.{name}")
        to_ms(instant, where=f"window.{name}")
    return window["not_before"], window["expiry"]


def _grant(grant: DraftGrant, number: int, draft: Draft, site: Site) -> dict[str, Any]:
    place = f"grants[{number}]"
    if grant.type not in site.vocabulary:
        raise MalformedError(f"the site has no action type `{grant.type}`", where=f"{place}.type")
    tools = site.robots[RobotId(draft.robot or "")].profile.tools.get(ActionType(grant.type), ())
    if grant.tool is None:
        _ask(f"Which tool carries out `{grant.id}`?", f"{place}.tool", tools)
    if not grant.rows:
        _ask(f"Which object and places does `{grant.id}` cover?", f"{place}.rows")
    plain: dict[str, Any] = {
        "id": grant.id,
        "type": grant.type,
        "tool": grant.tool,
        "alternatives": [
            _row(row, f"{place}.rows[{n}]", grant.type, site) for n, row in enumerate(grant.rows)
        ],
        "chooser": grant.chooser or _ask_chooser(grant, place),
        "repeat": _count(grant.repeat, f"How often may `{grant.id}` succeed?", f"{place}.repeat"),
        "starts": _count(grant.starts, f"How often may `{grant.id}` start?", f"{place}.starts"),
        "max_ms": _duration(grant.max, f"{place}.max"),
        "irreversible": _settled(grant, place),
        "limits": _limits(grant.limits, site, f"{place}.limits"),
        "guards": [_guard(g, f"{place}.guards[{n}]") for n, g in enumerate(grant.guards)],
        "data": _data(grant, place, site),
        "after": sorted(grant.after),
        "until": sorted(grant.until),
        "done_when": [_guard(g, f"{place}.done_when[{n}]") for n, g in enumerate(grant.done_when)],
        "completes": grant.completes,
    }
    _require_limits(grant, place, site)
    return plain


def _row(row: DraftRow, place: str, kind: str, site: Site) -> dict[str, Any]:
    """Ask for every field that actions of this type have."""
    known: dict[str, Iterable[str]] = {
        "object": site.objects,
        "source": site.regions,
        "destination": site.regions,
    }
    plain: dict[str, Any] = {"regions": sorted(set(row.regions))}
    fields = site.vocabulary[ActionType(kind)].fields
    for field, candidates in known.items():
        value = getattr(row, field)
        if value is None and field in fields:
            _ask(f"Which {field} is meant?", f"{place}.{field}", sorted(candidates))
        if value is not None and value not in candidates:
            raise MalformedError(f"the site has no `{value}`", where=f"{place}.{field}")
        if value is not None and field not in fields:
            raise MalformedError(f"`{kind}` has no {field}", where=f"{place}.{field}")
        if value is not None:
            plain[field] = value
    return plain


def _require_limits(grant: DraftGrant, place: str, site: Site) -> None:
    """Ask for a bound on every parameter that the type requires."""
    for name, parameter in site.vocabulary[ActionType(grant.type)].params.items():
        if parameter.required and name not in grant.limits:
            _ask(
                f"Between which bounds may `{name}` of `{grant.id}` lie?", f"{place}.limits.{name}"
            )


def _data(grant: DraftGrant, place: str, site: Site) -> dict[str, bool]:
    """Ask about every right that a recording type touches; silence is not consent."""
    kind = site.vocabulary[ActionType(grant.type)]
    for right, used in (
        ("record", kind.records),
        ("store", kind.stores),
        ("transmit", kind.transmits),
    ):
        if used and right not in grant.data:
            _ask(f"May `{grant.id}` {right} sensor data?", f"{place}.data.{right}", ("yes", "no"))
    return dict(grant.data)


def _limits(
    limits: dict[str, tuple[Quantity, Quantity]], site: Site, place: str
) -> list[dict[str, Any]]:
    units = {
        name: parameter.unit
        for kind in site.vocabulary.values()
        for name, parameter in kind.params.items()
    }
    plain = []
    for name, (low, high) in sorted(limits.items()):
        unit = units.get(ParameterId(name))
        if unit is None:
            raise MalformedError(f"the site has no parameter `{name}`", where=f"{place}.{name}")
        where = f"{place}.{name}"
        plain.append(
            {
                "parameter": name,
                "low": to_integer(low, unit, where=where),
                "high": to_integer(high, unit, where=where),
            }
        )
    return plain


def _guard(guard: DraftGuard, place: str) -> dict[str, Any]:
    found = [c for c in Comparison if getattr(guard, c) is not None]
    if len(found) != 1:
        raise MalformedError("expected exactly one of eq, ne, lt, le, gt, ge", where=place)
    return {
        "variable": guard.variable,
        "comparison": found[0],
        "value": getattr(guard, found[0]),
        "max_age_ms": _duration(guard.max_age, f"{place}.max_age"),
    }


def _budgets(draft: Draft) -> dict[str, Any]:
    given = draft.budgets
    if given is None:
        _ask("How much may the mission do in all?", "budgets")
    rate = given.get("rate") or {}
    return {
        "actions": _named(given, "actions"),
        "rate": {
            "count": _named(rate, "count", "rate."),
            "per_ms": _duration(rate.get("per"), "budgets.rate.per"),
        },
        "motion_ms": _duration(given.get("motion"), "budgets.motion"),
        "wait_ms": _duration(given.get("waiting"), "budgets.waiting"),
        "recorded_bytes": _named(given, "recorded_bytes"),
        "prompts": _named(given, "prompts"),
        "planner_stops": _named(given, "planner_stops"),
    }


def _risk(draft: Draft, site: Site) -> dict[str, Any]:
    if draft.risk_policy is None:
        _ask("Who must approve what?", "risk_policy")
    plain = dict(draft.risk_policy)
    plain["valid_ms"] = _duration(plain.pop("valid", None), "risk_policy.valid")
    units = {n: p.unit for kind in site.vocabulary.values() for n, p in kind.params.items()}
    plain["parameters"] = [
        {
            **item,
            "full_scale": to_integer(
                item["full_scale"],
                units.get(item["parameter"], ""),
                where="risk_policy.parameters",
            ),
        }
        for item in plain.get("parameters", ())
    ]
    return plain


def _named(given: dict[str, Any], name: str, prefix: str = "") -> Any:
    if name not in given:
        _ask(f"How much is `{prefix}{name}`?", f"budgets.{prefix}{name}")
    return given[name]


def _ceiling(given: tuple[str, ...] | None, named: Iterable[str | None]) -> list[str]:
    """Return the ceiling: what the author wrote, else exactly what the rows name."""
    if given is not None:
        return sorted(set(given))
    return sorted({item for item in named if item is not None})


def _duration(value: Quantity | None, field: str) -> int:
    if value is None:
        _ask("How long?", field, ("1 s", "1 min"))
    return to_integer(value, _MS, where=field)


def _count(value: int | None, question: str, field: str) -> int:
    if value is None:
        _ask(question, field)
    return value


def _settled(grant: DraftGrant, place: str) -> bool:
    if grant.irreversible is None:
        _ask(f"Can `{grant.id}` be undone?", f"{place}.irreversible", ("true", "false"))
    return grant.irreversible


def _ask_chooser(grant: DraftGrant, place: str) -> NoReturn:
    candidates = ("operator", "supervisor", "trusted_sensor", "planner")
    _ask(f"Who may choose among the rows of `{grant.id}`?", f"{place}.chooser", candidates)


def _ask_refusal() -> NoReturn:
    _ask("What happens after a refusal?", "on_refusal", ("hold", "stop", "ask"))


def _ask(question: str, field: str, candidates: Iterable[str] = ()) -> NoReturn:
    raise ClarificationError(question, field=field, candidates=tuple(candidates))


def _require_words(mission: Mission, site: Site) -> None:
    """Refuse ceilings and rows that name what the site does not have."""
    held: list[tuple[str, Iterable[str], Iterable[str]]] = [
        ("objects", mission.objects, site.objects),
        ("regions", mission.regions, site.regions),
    ]
    for number, grant in enumerate(mission.actions):
        held += [
            (f"actions[{number}].alternatives[{n}].regions", row.regions, site.regions)
            for n, row in enumerate(grant.alternatives)
        ]
    for where, words, known in held:
        unknown = sorted(set(words).difference(known))
        if unknown:
            raise MalformedError(
                f"the site has no `{unknown[0]}`", where=where, reason=Reason.NAME_UNKNOWN
            )
