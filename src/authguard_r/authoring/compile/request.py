# SPDX-License-Identifier: Apache-2.0
"""An open approval request in the words of the person who answers it.

Every word of what is to be approved comes from the decoded bytes (`client.approvals.Shown`), never
from what the gate says beside them. Spec page: docs/spec/gate-protocol.md#approvals
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from authguard_r.client.approvals import ShownRequest, shown
from authguard_r.core.action import ActionScope
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.quantities import to_timestamp
from authguard_r.site import formatting
from authguard_r.site.durations import duration
from authguard_r.site.model import Site
from authguard_r.wire.approval_request import ApprovalAnswer, Question

_TIERS = {1: "ordinary", 2: "elevated", 3: "high"}
_MARKED = frozenset({"private", "restricted", "hazardous"})


def action_line(scope: ActionScope, site: Site | None = None) -> str:
    """Return the effect on one line: what, with what, from where to where, how."""
    parts = [f"{scope.type} with {scope.tool}"]
    parts += [f"{word} {item}" for word, item in _named(scope) if item is not None]
    parts += [f"by way of {', '.join(scope.route)}"] if scope.route else []
    parts += [
        f"{name} {formatting.quantity(value, _unit(scope, name, site))}"
        for name, value in sorted(scope.params.items())
    ]
    return ", ".join(parts)


def marks(scope: ActionScope, site: Site) -> list[str]:
    """Return what of an effect is not harmless: `RESTRICTED: isolation-room`."""
    regions = (scope.source, scope.destination, *scope.route)
    found = [
        f"{tag.upper()}: {region}"
        for region in dict.fromkeys(region for region in regions if region is not None)
        for tag in formatting.tags_of(region, site)
        if tag in _MARKED
    ]
    thing = None if scope.object is None else site.objects.get(scope.object)
    is_hazardous = thing is not None and thing.kind == "hazardous"
    return [*found, *([f"HAZARDOUS: {scope.object}"] if is_hazardous else [])]


def brief(question: Question, opened: ShownRequest, site: Site | None = None) -> list[str]:
    """Return a request in a few lines, for a list."""
    return [
        f"{question.counter:4}  {action_line(opened.scope, site)}",
        f"      {_mission(question)}, risk {question.risk} ({_tier(opened)})",
        f"      {_head(question)}",
        *(f"      {_answer(answer)}" for answer in question.answers),
        f"      may answer: {', '.join(question.roles) or 'NO ONE'}; not {question.issuer}",
    ]


def headlines(questions: Iterable[Question], site: Site | None = None) -> list[str]:
    """Return each request on one line: what is asked, how long still, and what shows it."""
    lines = []
    for question in questions:
        try:
            told = f"{action_line(shown(question).scope, site)}; {_head(question)}"
        except AuthGuardError as error:
            told = f"CANNOT BE SHOWN: {error.message}"
        number = question.counter
        lines.append(f"REQUEST {number}: {told}: authguard approvals show {number}")
    return lines


def card(question: Question, opened: ShownRequest, site: Site | None = None) -> list[str]:
    """Return a request whole, for the person who is about to answer it."""
    return list(_card(question, opened, site))


def _card(question: Question, opened: ShownRequest, site: Site | None) -> Iterator[str]:
    yield f"Request {question.counter}: {_mission(question)}, robot {question.rid}"
    yield f"  WHAT  {action_line(opened.scope, site)}"
    for mark in () if site is None else marks(opened.scope, site):
        yield f"        {mark}"
    yield f"  asked {to_timestamp(question.asked_ms)} for planner {question.planner}"
    yield f"  {_left(question)} (until {to_timestamp(question.expires_ms)}){_worth(question)}"
    yield f"  risk {question.risk}: {_tier(opened)}; {question.required} people, issuer included"
    yield f"  behind it: {_people(question)}"
    yield f"    {question.issuer}: signed the mission"
    for answer in question.answers:
        yield f"    {_answer(answer)}"
    yield from _may_answer(question)
    yield "  conditions, as they were when it was asked:"
    for truth in question.guards:
        held = "met" if truth.held else "NOT MET"
        yield f"    {held}: {formatting.condition(truth.guard)}"
    for item in question.influenced_by:
        told = f"{item.get('channel')} ({item.get('label')})"
        yield f"  INFLUENCED by {told}: it mentions {item.get('field')} {item.get('value')}"
    yield f"  the mission's words, which grant nothing: {formatting.quoted(question.task)}"
    yield f"  scope {question.scope}"
    yield f"  situation {question.situation}"


def _may_answer(question: Question) -> Iterator[str]:
    """Say who may still answer; without names the gate waits for no person."""
    if not question.roles:
        yield "  may answer: NO ONE: mission and organization name no role in common"
        return
    places = f" and {', '.join(dict.fromkeys(question.places))}" if question.places else ""
    yield f"  may answer: {', '.join(question.roles)}; not {question.issuer}, who signed it"
    yield f"    whose certificates name {question.rid}{places}"


def _answer(answer: ApprovalAnswer) -> str:
    group = f", {answer.threshold} of {', '.join(answer.members)}" if answer.members else ""
    said = "approves" if answer.verdict == "approve" else "DENIES"
    worth = f"; DOES NOT COUNT: {answer.why_not}" if answer.why_not else ""
    return f"{answer.approver} ({answer.role}, {answer.kind}{group}): {said}{worth}"


def _mission(question: Question) -> str:
    return f"mission {question.mid} version {question.version}, grant {question.grant}"


def _tier(opened: ShownRequest) -> str:
    tier = opened.situation.tier
    return f"tier {tier}, {_TIERS.get(tier, 'unknown')}"


def _people(question: Question) -> str:
    return f"{question.behind} of {question.required}"


def _left(question: Question) -> str:
    """Return how long is left; whole seconds, never more than there is."""
    if question.left_ms < 0:
        return "RAN OUT"
    return f"{duration(question.left_ms // 1_000 * 1_000)} left"


def _head(question: Question) -> str:
    """Return how far a request is; a denial outweighs however many are behind it."""
    if question.denied:
        return "DENIED: closed; the next proposal gets this answer"
    return f"{_people(question)} people, {_left(question)}{_worth(question)}"


def _worth(question: Question) -> str:
    if question.denied:
        return "; DENIED"
    return "" if question.is_current else "; CHANGED SINCE: asked again when it is proposed again"


def _named(scope: ActionScope) -> tuple[tuple[str, str | None], ...]:
    return ("of", scope.object), ("from", scope.source), ("to", scope.destination)


def _unit(scope: ActionScope, name: str, site: Site | None) -> str:
    if site is None:
        return formatting.unit_in_name(name)
    return formatting.unit_of(name, site, scope.type)  # type: ignore[arg-type]
