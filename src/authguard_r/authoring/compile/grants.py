# SPDX-License-Identifier: Apache-2.0
"""One grant of a draft to one grant of a mission, in the site's ids and units.

A field is asked about when the grant's type has it and the draft does not say it; what hangs on
an open answer waits for it. Spec page: docs/spec/mission-language.md
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from msgspec import Struct

from authguard_r.authoring.compile.draft import DraftGrant, DraftGuard, DraftRow, Quantity
from authguard_r.authoring.compile.names import OBJECT, REGION, SiteNames, unknown
from authguard_r.authoring.compile.path import quiet_path
from authguard_r.authoring.compile.questions import CompileQuestions
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import ActionType, ParameterId, RegionId, RobotId
from authguard_r.core.mission import MAX_ROWS, Comparison
from authguard_r.core.provenance import Chooser
from authguard_r.site.formatting import site_units
from authguard_r.site.model import ActionModel, Site

_MS = "ms"
_YES_NO = ("true", "false")
#: The fields of a row that name one thing, and the kind of thing.
_NAMED = (("object", OBJECT), ("source", REGION), ("destination", REGION))


class GrantWords(Struct, frozen=True, kw_only=True):
    """What a grant is read with.

    Args:
        site: gives the words their meaning.
        names: its spellings.
        rid: the mission's robot; None while that is an open question.
        ceilings: the draft's mission-wide limits; offered where a grant's own are missing.
        asked: takes the questions.
    """

    site: Site
    names: SiteNames
    rid: RobotId | None
    ceilings: dict[str, tuple[Quantity, Quantity]]
    asked: CompileQuestions

    def resolve(self, text: str, kind: str, where: str) -> str | None:
        """Return the id of a thing of the site, or None once it was asked about."""
        return self.names.resolve(text, kind, where=where, questions=self.asked)


def build_grant(grant: DraftGrant, place: str, words: GrantWords) -> dict[str, Any]:
    """Return the grant's fields; what is open is None and asked about.

    Args:
        grant: as its author wrote it.
        place: its draft path.
        words: what it is read with.

    Raises:
        MalformedError: a word that the site does not know.
    """
    asked = words.asked
    model = _model(grant, place, words)
    tool = _tool(grant, place, words) if model is not None else None
    rows = grant.rows or (DraftRow(),)
    if len(rows) > MAX_ROWS:
        raise MalformedError(f"expected at most {MAX_ROWS} rows", where=f"{place}.rows")
    plain: dict[str, Any] = {
        "id": grant.id,
        "type": grant.type,
        "tool": tool,
        "alternatives": [
            _row(row, f"{place}.rows[{n}]", grant, model, words) for n, row in enumerate(rows)
        ],
        "limits": []
        if model is None or grant.type is None  # units hang on the type
        else build_limits(grant.limits, words, f"{place}.limits", ActionType(grant.type)),
    }
    if model is not None:
        _require_limits(grant, place, model, words)
    return plain | {
        "guards": build_guards(grant.guards, f"{place}.guards", words),
        "data": _data(grant, place, model, asked),
        "chooser": _chooser(grant, place, asked),
        "after": sorted(grant.after),
        "until": sorted(grant.until),
        "repeat": asked.given(
            grant.repeat, f"How often may `{grant.id}` succeed?", f"{place}.repeat"
        ),
        "starts": asked.given(
            grant.starts, f"How often may `{grant.id}` start?", f"{place}.starts"
        ),
        "max_ms": asked.integer(
            grant.max, _MS, field=f"{place}.max", question=f"How long may `{grant.id}` take?"
        ),
        "irreversible": _irreversible(grant, place, asked),
        "completes": grant.completes,
        "done_when": build_guards(grant.done_when, f"{place}.done_when", words),
    }


def _model(grant: DraftGrant, place: str, words: GrantWords) -> ActionModel | None:
    """Return what the site says of the grant's type, None once the type was asked about."""
    vocabulary = words.site.vocabulary
    if grant.type is None:
        robot = None if words.rid is None else words.site.robots[words.rid]
        able = vocabulary if robot is None else robot.profile.tools
        known = sorted(k for k in able if k in vocabulary and not vocabulary[k].state_writing)
        words.asked.ask(f"What kind of action is `{grant.id}`?", f"{place}.type", known)
        return None
    model = vocabulary.get(ActionType(grant.type))
    if model is None:
        raise unknown(grant.type, "action type", vocabulary, where=f"{place}.type")
    return model


def _tool(grant: DraftGrant, place: str, words: GrantWords) -> str | None:
    """Return the tool; it is asked about once it is settled which robot has the tools."""
    if grant.tool is None and words.rid is not None:
        tools = words.site.robots[words.rid].profile.tools.get(ActionType(grant.type or ""), ())
        words.asked.ask(f"Which tool carries out `{grant.id}`?", f"{place}.tool", tools)
    return grant.tool


def _row(
    row: DraftRow, place: str, grant: DraftGrant, model: ActionModel | None, words: GrantWords
) -> dict[str, Any]:
    """Ask for every field that actions of this type have."""
    plain: dict[str, Any] = {}
    for field, kind in _NAMED:
        text = getattr(row, field)
        if text is not None:
            plain[field] = words.resolve(text, kind, f"{place}.{field}")
            if model is not None and field not in model.fields:
                raise MalformedError(f"`{grant.type}` has no {field}", where=f"{place}.{field}")
        elif model is not None and field in model.fields:
            known = words.site.objects if kind is OBJECT else words.site.regions
            words.asked.ask(f"Which {field} is meant?", f"{place}.{field}", sorted(known))
            plain[field] = None
    plain["regions"] = _regions(row, plain, place, grant, words)
    return plain


def _regions(
    row: DraftRow, plain: dict[str, Any], place: str, grant: DraftGrant, words: GrantWords
) -> list[str]:
    """Return everything that the robot may touch on the way; asked about once both ends are."""
    if row.regions is not None:
        found = {
            words.resolve(region, REGION, f"{place}.regions[{n}]")
            for n, region in enumerate(row.regions)
        }
        return sorted(item for item in found if item is not None)
    ends = [plain[field] for field in ("source", "destination") if field in plain]
    if grant.type is None or None in ends or not (ends or not grant.rows):
        return []
    field, question = f"{place}.regions", f"Which regions may `{grant.id}` touch?"
    way = quiet_path(words.site, RegionId(ends[0]), RegionId(ends[-1])) if ends else ()
    words.asked.ask(question, field, [f"[{', '.join(sorted(way))}]"] if way else ())
    return []


def _require_limits(grant: DraftGrant, place: str, model: ActionModel, words: GrantWords) -> None:
    """Ask for a bound on every parameter that the type requires; the mission's own is offered."""
    for name, parameter in model.params.items():
        if parameter.required and name not in grant.limits:
            ceiling = words.ceilings.get(name)
            words.asked.ask(
                f"Between which bounds may `{name}` of `{grant.id}` lie: `[..., ...]`?",
                f"{place}.limits.{name}",
                () if ceiling is None else (f"[{ceiling[0]}, {ceiling[1]}]",),
            )


def _data(
    grant: DraftGrant, place: str, model: ActionModel | None, asked: CompileQuestions
) -> dict[str, bool]:
    """Ask about every right that a recording type touches; silence is not consent."""
    if model is not None:
        for right, used in (
            ("record", model.records),
            ("store", model.stores),
            ("transmit", model.transmits),
        ):
            if used and right not in grant.data:
                asked.ask(
                    f"May `{grant.id}` {right} sensor data?", f"{place}.data.{right}", _YES_NO
                )
    return dict(grant.data)


def _chooser(grant: DraftGrant, place: str, asked: CompileQuestions) -> str | None:
    if grant.chooser is None:
        question = f"Who may choose among the rows of `{grant.id}`?"
        asked.ask(question, f"{place}.chooser", (*map(str, Chooser),))
    return grant.chooser


def _irreversible(grant: DraftGrant, place: str, asked: CompileQuestions) -> bool | None:
    if grant.irreversible is None:
        asked.ask(f"Is `{grant.id}` impossible to undo?", f"{place}.irreversible", _YES_NO)
    return grant.irreversible


def build_limits(
    limits: dict[str, tuple[Quantity, Quantity]],
    words: GrantWords,
    place: str,
    kind: ActionType | None = None,
) -> list[dict[str, Any]]:
    """Return limits in the units of the site's parameters, sorted.

    Args:
        limits: as their author wrote them.
        words: what they are read with.
        place: their draft path.
        kind: the type of the grant that they are of; None for the whole mission's.

    Raises:
        MalformedError: no such parameter, or no such quantity.
    """
    plain = []
    for name, pair in sorted(limits.items()):
        unit = unit_of_limit(name, words, f"{place}.{name}", kind)
        low, high = (
            words.asked.integer(bound, unit, field=f"{place}.{name}[{n}]")
            for n, bound in enumerate(_alike(*pair))
        )
        plain.append({"parameter": name, "low": low, "high": high})
    return plain


def _alike(low: Quantity, high: Quantity) -> tuple[Quantity, Quantity]:
    """Return the pair; beside a bound with a unit, a bare number is one without.

    `[1, 20 N]` may mean 1 N or 1 mN; `[0, 20 N]` means one thing.
    """
    if isinstance(low, str) != isinstance(high, str):
        return low if low == 0 else str(low), high if high == 0 else str(high)
    return low, high


def unit_of_limit(name: str, words: GrantWords, where: str, kind: ActionType | None = None) -> str:
    """Return the unit of a parameter: its type's own, else the one that all types agree on.

    Raises:
        MalformedError: no type has such a parameter, or types give it different units: one number
            would then bound them differently.
    """
    units = site_units(ParameterId(name), words.site, kind)
    if not units:
        known = {item for model in words.site.vocabulary.values() for item in model.params}
        raise unknown(name, "parameter", known, where=where)
    if len(units) > 1:
        message = f"expected one unit for `{name}` at this site, got {', '.join(units)}"
        raise MalformedError(message, where=where)
    return units[0]


def build_guards(
    guards: Iterable[DraftGuard], place: str, words: GrantWords
) -> list[dict[str, Any]]:
    """Return conditions on attested state."""
    return [build_guard(guard, f"{place}[{n}]", words) for n, guard in enumerate(guards)]


def build_guard(guard: DraftGuard, place: str, words: GrantWords) -> dict[str, Any]:
    """Return one condition.

    Raises:
        MalformedError: none or several comparisons, or a name that the site does not know.
    """
    found = [c for c in Comparison if getattr(guard, c) is not None]
    if len(found) != 1:
        raise MalformedError("expected exactly one of eq, ne, lt, le, gt, ge", where=place)
    value = getattr(guard, found[0])
    if isinstance(value, str):
        value = words.names.value(value, where=f"{place}.{found[0]}", questions=words.asked)
    return {
        "variable": guard.variable,
        "comparison": found[0],
        "value": value,
        "max_age_ms": words.asked.integer(
            guard.max_age,
            _MS,
            field=f"{place}.max_age",
            question=f"How old may the reading of `{guard.variable}` be?",
        ),
    }
