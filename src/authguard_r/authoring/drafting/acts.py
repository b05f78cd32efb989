# SPDX-License-Identifier: Apache-2.0
"""What each frame asks the robot to do, as steps of the plan.

A frame grants what its sentence says and what that takes on the way; a slot that is still open
ends it, because the rest would rest on a guess.
"""

from __future__ import annotations

from collections.abc import Callable

from authguard_r.authoring.drafting.clauses import BatteryCondition, Clause
from authguard_r.authoring.drafting.frames import PLAIN, VerbFrame
from authguard_r.authoring.drafting.lexicon import Ref, Sort
from authguard_r.authoring.drafting.plan import DraftPlan, GrantStep
from authguard_r.authoring.drafting.resolve import ANY, OBJECTS, REGIONS, field_of
from authguard_r.core.identifiers import RobotId

#: What a pronoun's antecedent must lend itself to, by frame.
_ABLE = {VerbFrame.OPEN: "open", VerbFrame.CLOSE: "open", VerbFrame.FILL: "fill"}
ALWAYS = "always"
WHEN_LOW = "when the battery is low"


def act(plan: DraftPlan, clause: Clause) -> None:
    """Add the steps of one clause to the plan, or ask what it leaves open."""
    first = len(plan.steps)
    for _ in range(_rounds(plan, clause)):
        if clause.frame in PLAIN:
            _plain(plan, clause)
        else:
            _ACTS[clause.frame](plan, clause)
    if clause.careful and not any(step.limits for step in plan.steps[first:]):
        field = field_of(clause, "manner")
        plan.asking.assume(field, "no bound", "nothing in this clause has a speed or a force")


def _rounds(plan: DraftPlan, clause: Clause) -> int:
    """Return how often the clause's steps are laid out; a plain act is repeated by its grant."""
    if clause.frame in _REPEATED_BY_GRANT or clause.repeat <= 1:
        return 1
    if clause.repeat > 16 or clause.frame not in _LAID_OUT:
        plan.resolver.unknown(clause, "count", f"{clause.repeat} times")
        return 1
    return clause.repeat


def _items(plan: DraftPlan, clause: Clause, able: str) -> list[str]:
    found = plan.resolver.each(clause, "object", "object", OBJECTS, able=able)
    return [ref.id for ref in found]


def _place_of(plan: DraftPlan, ref: Ref) -> str:
    """Return the region that a thing or a place is."""
    return plan.places[ref.id] if ref.sort is Sort.OBJECT else ref.id


def _plain(plan: DraftPlan, clause: Clause) -> None:
    for item in _items(plan, clause, _ABLE.get(clause.frame, "")):
        plan.reach(clause, item)
        if clause.frame is VerbFrame.CLOSE:
            plan.close(clause, item)
            plan.opened.discard(item)
            continue
        plan.do(clause, str(clause.frame), object=item, repeat=max(clause.repeat, 1))
        if clause.frame is VerbFrame.OPEN:
            plan.opened.add(item)


def _turn(plan: DraftPlan, clause: Clause) -> None:
    states = clause.state
    if not states:
        answer = plan.asking.ask(field_of(clause, "state"), "On or off?", ("on", "off"))
        states = [] if answer is None else [answer]
    for item in _items(plan, clause, "switch"):
        plan.reach(clause, item)
        for state in dict.fromkeys(states):
            plan.do(clause, f"turn_{state}", object=item, repeat=max(clause.repeat, 1))


def _find(plan: DraftPlan, clause: Clause) -> None:
    for item in _items(plan, clause, ""):
        plan.reach(clause, item)
        plan.do(clause, "find", object=item)


def _source(plan: DraftPlan, clause: Clause) -> tuple[bool, str | None]:
    """Return whether the source is settled, and what the sentence says of it."""
    if "from" not in clause.roles:
        return True, None
    ref = plan.resolver.one(clause, "from", "source", ANY)
    return (False, None) if ref is None else (True, _place_of(plan, ref))


def _pick(plan: DraftPlan, clause: Clause) -> None:
    if "to" in clause.roles and "from" not in clause.roles:
        clause.roles["from"] = clause.roles.pop("to")  # `pick the mug in the kitchen`
    known, source = _source(plan, clause)
    for item in _items(plan, clause, "carry") if known else ():
        plan.take(clause, item, source=source, implied=False)


def _deliver(plan: DraftPlan, clause: Clause) -> None:
    """Bring things somewhere; `take P1` alone is a pick, `move to the dock` a motion."""
    if clause.verb == "move" and "object" not in clause.roles:
        _go(plan, clause)
        return
    if clause.verb == "take" and "to" not in clause.roles:
        _pick(plan, clause)
        return
    items = _items(plan, clause, "carry")
    target = plan.resolver.one(clause, "to", "destination", _targets(clause))
    known, source = _source(plan, clause)
    for item in items if known and target is not None else ():
        plan.take(clause, item, source=source, implied=True)
        _put_at(plan, clause, item, target)


def _targets(clause: Clause) -> tuple[Sort, ...]:
    """A thing is a destination only where the sentence names one; else places are asked for."""
    return ANY if clause.roles.get("to") else REGIONS


def _put(plan: DraftPlan, clause: Clause) -> None:
    items = _items(plan, clause, "carry")
    target = plan.resolver.one(clause, "to", "destination", ANY)
    for item in items if target is not None else ():
        plan.fill(clause, item)
        plan.take(clause, item, source=None, implied=True)
        _put_at(plan, clause, item, target)


def _put_at(plan: DraftPlan, clause: Clause, item: str, target: Ref | None) -> None:
    if target is None:
        return
    if target.sort is Sort.REGION:
        plan.put(clause, item, target.id)
    elif target.id == item:
        plan.resolver.unknown(clause, "destination", f"{item} into itself")
    else:
        plan.put_into(clause, item, target.id)


def _let_go(plan: DraftPlan, clause: Clause) -> None:
    """Drop or throw."""
    for item in _items(plan, clause, "carry"):
        target = (
            plan.resolver.one(clause, "to", "destination", ANY) if "to" in clause.roles else None
        )
        plan.take(clause, item, source=None, implied=True)
        if target is not None and target.sort is Sort.OBJECT:
            plan.reach(clause, target.id)
        elif target is not None:
            plan.go(clause, target.id)
        plan.do(clause, str(clause.frame), object=item, holding=item, leaves="nothing")
        plan.places[item], plan.holding = plan.at or plan.places[item], None


def _goals(plan: DraftPlan, clause: Clause) -> list[str]:
    role = "to" if "to" in clause.roles or "object" not in clause.roles else "object"
    sorts = ANY if clause.roles.get(role) else REGIONS
    return [_place_of(plan, ref) for ref in plan.resolver.each(clause, role, "destination", sorts)]


def _go(plan: DraftPlan, clause: Clause) -> None:
    if "from" in clause.roles:
        start = plan.resolver.one(clause, "from", "source", REGIONS)
        if start is None:
            return
        plan.at = start.id
    for region in _goals(plan, clause):
        plan.go(clause, region, implied=False)


def _return(plan: DraftPlan, clause: Clause) -> None:
    """Go home: after something, or under a condition; never whenever the planner likes."""
    if "object" in clause.roles:
        _deliver(plan, clause)
        return
    if "to" in clause.roles:
        goals = _goals(plan, clause)
    else:
        goals = [] if plan.robot is None else [str(plan.site.robots[RobotId(plan.robot)].home)]
    if clause.condition is None and not plan.last:
        _ask_condition(plan, clause)
    for region in goals:
        _go_back(plan, clause, region)


def _ask_condition(plan: DraftPlan, clause: Clause) -> None:
    field = field_of(clause, "condition")
    question = "Under which condition may the robot return?"
    answer = plan.asking.ask(field, question, (WHEN_LOW, ALWAYS))
    if answer == WHEN_LOW:
        clause.condition = BatteryCondition(WHEN_LOW, "lt", None)


def _go_back(plan: DraftPlan, clause: Clause, region: str) -> None:
    """Return after the step before; on a condition or alone, from wherever the robot may be."""
    if clause.condition is None and plan.last:
        plan.go(clause, region, implied=False)
    elif plan.robot is not None:
        plan.come_back(clause, region)


def _guide(plan: DraftPlan, clause: Clause) -> None:
    _go(plan, clause)


def _wait(plan: DraftPlan, clause: Clause) -> None:
    first = len(plan.steps)
    if "to" in clause.roles:
        target = plan.resolver.one(clause, "to", "destination", ANY)
        if target is None:
            return
        plan.go(clause, _place_of(plan, target))
    plan.do(clause, "wait", after=tuple(range(first, len(plan.steps))))


def _look(plan: DraftPlan, clause: Clause) -> None:
    """Inspect, photograph or record: each data right is said or asked about, none is implied."""
    role = "object" if "object" in clause.roles or "to" not in clause.roles else "to"
    slot = "destination" if role == "to" or _names_places(clause) else "object"
    ref = plan.resolver.one(clause, role, slot, ANY)
    rights = _rights(plan, clause)
    if ref is None or rights is None:
        return
    if role == "object" and "to" in clause.roles and ref.sort is Sort.OBJECT:
        where = plan.resolver.one(clause, "to", "source", REGIONS)  # `inspect P1 in station 102`
        if where is None:
            return
        plan.places[ref.id] = where.id
    plan.go(clause, _place_of(plan, ref), implied=bool(rights.get("record")))
    if ref.sort is Sort.OBJECT:
        plan.see(ref.id)
    if not rights.get("record"):
        return
    kind = _camera(plan, clause, ref, rights)
    held = plan.site.vocabulary.get(kind)  # type: ignore[call-overload]
    item = ref.id if held is not None and "object" in held.fields else None
    plan.do(clause, kind, object=item, data=rights)


def _names_places(clause: Clause) -> bool:
    """True when what is looked at can only be a place."""
    refs = [ref for phrase in clause.roles.get("object", ()) for ref in phrase.refs]
    return bool(refs) and all(ref.sort is Sort.REGION for ref in refs)


def _camera(plan: DraftPlan, clause: Clause, ref: Ref, rights: dict[str, bool]) -> str:
    """Return the type that sees what is asked for and needs no right that was not given."""
    if clause.frame is not VerbFrame.INSPECT:
        return str(clause.frame)
    usable = ("inspect", "take_photo", "record_video")
    for kind in usable if ref.sort is Sort.OBJECT else usable[1:]:
        if plan.able(kind):
            model = plan.site.vocabulary[kind]  # type: ignore[index]
            if (not model.stores or rights["store"]) and (
                not model.transmits or rights["transmit"]
            ):
                return kind
    return "take_photo"


def _rights(plan: DraftPlan, clause: Clause) -> dict[str, bool] | None:
    """Return the data rights, or None while one is open."""
    said = dict(clause.rights)
    if clause.frame is not VerbFrame.INSPECT:
        said.setdefault("record", True)
    for right in ("record", "store", "transmit"):
        if right in said:
            continue
        if said.get("record") is False:
            said[right] = False
            continue
        field = field_of(clause, f"data.{right}")
        answer = plan.asking.ask(field, f"May the robot {right} sensor data?", ("yes", "no"))
        if answer is not None:
            said[right] = answer == "yes"
    return said if len(said) == 3 else None


def _fill(plan: DraftPlan, clause: Clause) -> None:
    for item in _items(plan, clause, "fill"):
        plan.reach(clause, item)
        plan.do(clause, "fill", object=item)
        plan.filled[item] = clause.liquid


def _pour(plan: DraftPlan, clause: Clause) -> None:
    """Pour from a vessel onto a thing or place; what is poured is filled in first if it must be."""
    role = next((name for name in ("from", "with", "object") if name in clause.roles), "")
    target = plan.resolver.one(clause, "to", "destination", ANY)
    vessel = _vessel(plan, clause, role)
    if vessel is None or target is None:
        return
    plan.see(vessel)
    if plan.able("fill"):
        plan.fill(clause, vessel)
    plan.take(clause, vessel, source=None, implied=True)
    opens = False
    if target.sort is Sort.OBJECT:
        plan.reach(clause, target.id)
        opens = "into" in clause.extras and plan.unlock(clause, target.id)
    else:
        plan.go(clause, target.id)
    number = plan.do(clause, "pour", destination=plan.at, holding=vessel)
    if opens:
        plan.lock(clause, target.id, number)
    plan.filled.pop(vessel, None)


def _vessel(plan: DraftPlan, clause: Clause, role: str) -> str | None:
    if role:
        ref = plan.resolver.one(clause, role, "object", OBJECTS, able="fill")
        return None if ref is None else ref.id
    if len(plan.filled) == 1:
        (only,) = plan.filled
        plan.asking.assume(field_of(clause, "object"), only, "the one thing that was filled")
        return only
    return plan.asking.ask(
        field_of(clause, "object"), "What is it poured from?", sorted(plan.site.objects)
    )


def _heat(plan: DraftPlan, clause: Clause) -> None:
    """Put a thing into an appliance and turn that on; without one, `cook`."""
    if "to" not in clause.roles:
        for item in _items(plan, clause, "carry"):
            plan.reach(clause, item)
            plan.do(clause, "cook", object=item)
        return
    items = _items(plan, clause, "carry")
    target = plan.resolver.one(clause, "to", "destination", OBJECTS, able="switch")
    for item in items if target is not None else ():
        plan.take(clause, item, source=None, implied=True)
        _put_at(plan, clause, item, target)
    if items and target is not None:
        plan.do(clause, "turn_on", object=target.id)


def _leave(plan: DraftPlan, clause: Clause) -> None:
    """`leave it open` opens what is closed; any other leaving grants nothing.

    It says how a thing is left, not in which order: where no drive is needed, it may be opened
    before what was said first, and for a while after completion.
    """
    plan.resolver.read(clause, "object")
    if not clause.extras:
        plan.resolver.unknown(clause, "object", clause.verb)
    for item in _items(plan, clause, "open") if "open" in clause.extras else ():
        if item not in plan.opened:
            here = plan.at == plan.places[item] and bool(plan.last)
            plan.reach(clause, item)
            step = GrantStep(type="open", source=plan.at, object=item, closes=here)
            plan.add(clause, step, free=here)
            plan.opened.add(item)


_LAID_OUT = frozenset(
    {
        VerbFrame.PATROL,
        VerbFrame.WAIT,
        VerbFrame.INSPECT,
        VerbFrame.PHOTO,
        VerbFrame.RECORD,
        VerbFrame.POUR,
    }
)
_REPEATED_BY_GRANT = frozenset({VerbFrame.TURN, *PLAIN})
_ACTS: dict[VerbFrame, Callable[[DraftPlan, Clause], None]] = {
    VerbFrame.DELIVER: _deliver,
    VerbFrame.FETCH: _deliver,
    VerbFrame.PICK: _pick,
    VerbFrame.PUT: _put,
    VerbFrame.DROP: _let_go,
    VerbFrame.THROW: _let_go,
    VerbFrame.GO: _go,
    VerbFrame.PATROL: _go,
    VerbFrame.GUIDE: _guide,
    VerbFrame.RETURN: _return,
    VerbFrame.WAIT: _wait,
    VerbFrame.INSPECT: _look,
    VerbFrame.PHOTO: _look,
    VerbFrame.RECORD: _look,
    VerbFrame.FIND: _find,
    VerbFrame.TURN: _turn,
    VerbFrame.POUR: _pour,
    VerbFrame.FILL: _fill,
    VerbFrame.HEAT: _heat,
    VerbFrame.LEAVE: _leave,
}
