# SPDX-License-Identifier: Apache-2.0
"""From a draft to the structure that is signed: resolved, complete, canonical, or questions.

The compiler adds nothing: an absent privileged field is asked for, an unknown word is refused.
Every open question is asked at once, in the order of the draft.
Source: section "Mission Compilation and Clarification". How-to: docs/howto/missions.md
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from authguard_r.authoring.compile.draft import Draft
from authguard_r.authoring.compile.grants import GrantWords, build_grant, build_guards, build_limits
from authguard_r.authoring.compile.names import OBJECT, REGION, names_of, unknown
from authguard_r.authoring.compile.questions import CompileQuestions
from authguard_r.authoring.compile.sources import build_retention, build_sources
from authguard_r.authoring.compile.totals import build_budgets, build_risk
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import RobotId, Timestamp
from authguard_r.core.mission import MAX_GRANTS, SCHEMA, Mission, require_schema
from authguard_r.core.quantities import Now, to_ms, to_timestamp
from authguard_r.site.model import Site, profile_digest, site_digest
from authguard_r.site.source import convert

_MS = "ms"
_DAY_MS = 86_400_000
_CLOCK = re.compile(
    r"(?P<hour>[01][0-9]|2[0-3]):(?P<minute>[0-5][0-9])(?::(?P<second>[0-5][0-9]))?"
)


def compile_draft(draft: Draft, site: Site, *, now: Now, nonce: str) -> Mission:
    """Return the mission that the draft means at this site.

    Args:
        draft: what a person wrote.
        site: gives the words their meaning; its digest is bound.
        now: the instant that a relative window starts at.
        nonce: 22 characters of base64url, fresh.

    Raises:
        ClarificationError: privileged fields are absent or ambiguous; `others` holds the questions
            beside the first, all in the order of the draft.
        MalformedError: a word that the site does not know, or a rule of the language broken.
    """
    if draft.task is not None and not _is_text(draft.task):
        raise MalformedError("expected text that UTF-8 can spell", where="task")
    asked = CompileQuestions()
    plain = _plain(draft, site, now, asked)
    asked.require_none()
    rid = RobotId(plain["rid"])
    plain |= {"profile": profile_digest(site.robots[rid].profile), "nonce": nonce}
    mission = convert(plain, Mission, where="draft")
    require_schema(mission)
    return mission


def _plain(draft: Draft, site: Site, now: Now, asked: CompileQuestions) -> dict[str, Any]:
    """Return the mission's fields; what is open is None and asked about."""
    rid = _robot(draft, site, asked)
    words = GrantWords(site=site, names=names_of(site), rid=rid, ceilings=draft.limits, asked=asked)
    task = _said(draft.task, "What is asked for, in the operator's own words?", "task", asked)
    issuer = _said(draft.issuer, "Who signs this mission?", "issuer", asked)
    first, last = _window(draft, now, asked)
    place_age = asked.integer(draft.place_max_age, _MS, field="place_max_age")
    objects = _ceiling(draft.objects, OBJECT, words)
    regions = _ceiling(draft.regions, REGION, words)
    limits = build_limits(draft.limits, words, "limits")
    guards = build_guards(draft.guards, "guards", words)
    grants = _grants(draft, words)
    plain: dict[str, Any] = {
        "schema": SCHEMA,
        "mid": draft.mission,
        "version": draft.version,
        "rid": rid,
        "site": site_digest(site),
        "issuer": issuer,
        "task": task,
        "actions": grants,
        "objects": objects if draft.objects is not None else _named(grants, "object"),
        "regions": regions if draft.regions is not None else _touched(grants),
        "limits": limits,
        "guards": guards,
        "not_before": first,
        "expiry": last,
        "place_max_age_ms": place_age,
    }
    if draft.closing is not None:
        plain["closing"] = {
            "grants": sorted(draft.closing.grants),
            "for_ms": asked.integer(draft.closing.for_, _MS, field="closing.for"),
        }
    plain["budgets"] = build_budgets(draft.budgets, asked)
    question = "What happens after a refusal?"
    plain["on_refusal"] = _said(
        draft.on_refusal, question, "on_refusal", asked, ("hold", "stop", "ask")
    )
    plain["risk_policy"] = build_risk(draft.risk_policy, words)
    plain["sources"] = build_sources(draft.sources, site)
    plain["retention"] = build_retention(draft.retention, asked)
    if draft.supersedes is not None:
        plain["supersedes"] = draft.supersedes
    return plain


def _is_text(text: str) -> bool:
    return not any("\ud800" <= mark <= "\udfff" for mark in text)


def _said(
    value: str | None,
    question: str,
    field: str,
    asked: CompileQuestions,
    candidates: Iterable[str] = (),
) -> str | None:
    """Return the value, or None once it has been asked about."""
    if value is None:
        asked.ask(question, field, candidates)
    return value


def _robot(draft: Draft, site: Site, asked: CompileQuestions) -> RobotId | None:
    if draft.robot is None:
        asked.ask("Which robot is meant?", "robot", sorted(site.robots))
        return None
    if draft.robot not in site.robots:
        raise unknown(draft.robot, "robot", site.robots, where="robot")
    return RobotId(draft.robot)


def _window(draft: Draft, now: Now, asked: CompileQuestions) -> tuple[str | None, str | None]:
    window = draft.window
    if not window:
        shape = "`{for: ...}`, or `{not_before: ..., expiry: ...}`"
        asked.ask(f"From when until when is the mission valid: {shape}?", "window")
        return None, None
    if set(window) == {"for"}:
        return _from_now(window["for"], now, asked)
    if not {"not_before", "expiry"}.issuperset(window):
        raise MalformedError("expected `for`, or `not_before` and `expiry`", where="window")
    return (
        _instant(window.get("not_before"), "window.not_before", now, asked),
        _instant(window.get("expiry"), "window.expiry", now, asked),
    )


def _from_now(value: str | float, now: Now, asked: CompileQuestions) -> tuple[str, str | None]:
    """Return the window that starts now; here a bare integer has no unit either."""
    length = asked.integer(str(value), _MS, field="window.for")
    end = None if length is None else _to_timestamp(now.utc_ms + length, "window.for")
    return to_timestamp(now.utc_ms), end


def _to_timestamp(utc_ms: int, where: str) -> str:
    try:
        return to_timestamp(utc_ms)
    except (OverflowError, ValueError) as error:
        raise MalformedError("expected an instant before the year 10000", where=where) from error


def _instant(value: object, field: str, now: Now, asked: CompileQuestions) -> str | None:
    """Return an instant with date and zone; of a time without them, the next two are offered."""
    if value is None:
        asked.ask("Which instant is meant: 2026-01-31T14:30:00Z?", field)
        return None
    text = str(value)
    if "T" not in text:
        asked.ask(
            "A time needs its date and zone; which instant is meant?", field, _next(text, now)
        )
        return None
    instant = convert(text, Timestamp, where=field)
    to_ms(instant, where=field)
    return instant


def _next(text: str, now: Now) -> tuple[str, ...]:
    """Return the next two instants at which a clock in UTC shows this time."""
    read = _CLOCK.fullmatch(text.strip())
    if read is None:
        return ()
    clock = f"T{read['hour']}:{read['minute']}:{read['second'] or '00'}Z"
    days = (to_timestamp(now.utc_ms + n * _DAY_MS)[:10] for n in range(3))
    later = [day + clock for day in days if to_ms(day + clock, where="window") > now.utc_ms]
    return tuple(later[:2])


def _grants(draft: Draft, words: GrantWords) -> list[dict[str, Any]]:
    if not draft.grants:
        words.asked.ask("What may the robot do?", "grants")
    if len(draft.grants) > MAX_GRANTS:
        raise MalformedError(f"expected at most {MAX_GRANTS} grants", where="grants")
    return [build_grant(grant, f"grants[{n}]", words) for n, grant in enumerate(draft.grants)]


def _ceiling(given: tuple[str, ...] | None, kind: str, words: GrantWords) -> list[str | None]:
    """Return the ceiling that the author wrote, in ids."""
    field = f"{kind}s"
    found = {words.resolve(text, kind, f"{field}[{n}]") for n, text in enumerate(given or ())}
    return sorted(found, key=str)


def _named(grants: list[dict[str, Any]], field: str) -> list[str]:
    """Return what the rows name: the ceiling when the author wrote none."""
    rows = [row for grant in grants for row in grant["alternatives"]]
    return sorted({row[field] for row in rows if row.get(field) is not None})


def _touched(grants: list[dict[str, Any]]) -> list[str]:
    rows = [row for grant in grants for row in grant["alternatives"]]
    return sorted({region for row in rows for region in row["regions"] if region is not None})
