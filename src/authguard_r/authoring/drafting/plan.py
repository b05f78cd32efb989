# SPDX-License-Identifier: Apache-2.0
"""The steps that a mission needs: what the sentence asks for, and what that takes on the way.

The plan keeps track of where the robot and each thing would be. A step that is only implied (going
there, picking it up, looking for it) is marked, so that the reviewer sees where it comes from.
"""

from __future__ import annotations

from typing import Any

import msgspec
from msgspec import Struct

from authguard_r.authoring.drafting.asking import DraftDialog
from authguard_r.authoring.drafting.clauses import Clause
from authguard_r.authoring.drafting.frames import STAYS_OPEN
from authguard_r.authoring.drafting.limits import StepLimits
from authguard_r.authoring.drafting.profile import DraftProfile
from authguard_r.authoring.drafting.resolve import Resolver, field_of
from authguard_r.authoring.drafting.routes import shortest
from authguard_r.core.identifiers import ActionType, ObjectId, RegionId, RobotId
from authguard_r.site.model import Site

NOTHING = "nothing"
#: Implied steps that may be done before what the sentence says first: they only prepare.
_PREPARES = frozenset({"fill", "open", "pick"})


class GrantStep(Struct, kw_only=True):
    """One grant in the making.

    Args:
        type: the action type.
        object: what it acts on.
        source: where the robot is.
        destination: where it ends.
        ways: for a motion, the regions from each place where it may be resumed.
        looks: for a search, further places where the thing may be.
        limits: bounds by parameter.
        holding: what must be in the gripper; None when nothing is said about it.
        leaves: what is in the gripper afterwards; None when nothing is said about it.
        data: data rights.
        condition: a guard as the draft spells it.
        after: the steps that come before it, by index.
        until: the step that closes it.
        repeat: successes.
        implied: the sentence does not say it; it is on the way.
        closes: it may be done after completion.
        free: its condition says when it may be done, beside everything else.
    """

    type: str
    object: str | None = None
    source: str | None = None
    destination: str | None = None
    ways: tuple[tuple[str, ...], ...] = ()
    looks: tuple[str, ...] = ()
    limits: dict[str, tuple[Any, Any]] = msgspec.field(default_factory=dict)
    holding: str | None = None
    leaves: str | None = None
    data: dict[str, bool] = msgspec.field(default_factory=dict)
    condition: dict[str, Any] | None = None
    after: tuple[int, ...] = ()
    until: int | None = None
    repeat: int = 1
    implied: bool = False
    closes: bool = False
    free: bool = False


class DraftPlan:
    """Where everything is while the clauses are worked through, and the steps so far.

    Args:
        site: the model.
        robot: who does it; None while that is asked, and then nothing depends on it.
        profile: the defaults.
        asking: questions and assumptions.
        resolver: what phrases mean.
    """

    def __init__(
        self,
        site: Site,
        robot: str | None,
        profile: DraftProfile,
        asking: DraftDialog,
        resolver: Resolver,
    ) -> None:
        self.site = site
        self.robot = robot
        self.profile = profile
        self.asking = asking
        self.resolver = resolver
        self.steps: list[GrantStep] = []
        self.at: str | None = None if robot is None else site.robots[RobotId(robot)].home
        self.holding: str | None = None
        self.places = {str(item): str(model.home) for item, model in site.objects.items()}
        self.opened: set[str] = set()
        self.kept_open: set[int] = set()
        self.filled: dict[str, str | None] = {}
        self.seen: dict[str, list[str]] = {}
        self.last: tuple[int, ...] = ()
        self.limits = StepLimits(site, robot, profile, asking)
        self._ways: list[int] = []

    def go(self, clause: Clause, region: str, *, implied: bool = True) -> None:
        """Move to a region; nothing when the robot is there already."""
        if self.at == region and implied:
            return
        start, self.at = self.at, region
        if start is None or self.robot is None or start == region:
            return
        way = self._way(clause, start, region)
        if way is None:
            return
        step = GrantStep(
            type="navigate",
            source=start,
            destination=region,
            ways=tuple(way[n:] for n in range(len(way) - 1)),
            implied=implied,
        )
        if self.holding is not None:
            step.holding = self.holding
        number = self.add(clause, step)
        if implied:
            self._ways.append(number)
            self.asking.assume(f"go.{region}", f"{start} to {region}", "the sentence needs it")

    def _way(self, clause: Clause, start: str, goal: str) -> tuple[str, ...] | None:
        """Return the way, or None once it is asked whether it may lead through what it must."""
        avoid = frozenset(self.profile.avoid)
        way = shortest(self.site, start, goal, avoid=avoid)
        if way is not None:
            return way
        through = shortest(self.site, start, goal, avoid=frozenset())
        options = () if through is None else (", ".join(through),)
        question = (
            f"No way from `{start}` to `{goal}` keeps out of {', '.join(sorted(avoid))} regions: "
            "may it lead through them?"
            if options
            else f"No door leads from `{start}` to `{goal}`: say it otherwise"
        )
        answer = self.asking.ask(field_of(clause, f"route.{goal}"), question, options)
        return through if answer is not None else None

    def come_back(self, clause: Clause, home: str) -> None:
        """Let the robot return from wherever this mission may have led it, at any time.

        From where is attested state's to say; a region with a tag that ways avoid is no start.
        """
        touched = {region for step in self.steps for way in step.ways for region in way}
        avoid = frozenset(self.profile.avoid)
        starts = sorted(
            str(region)
            for region, model in self.site.regions.items()
            if region != home
            and not avoid.intersection(model.tags)
            and (not touched or region in touched)
        )
        found = [shortest(self.site, start, home, avoid=avoid) for start in starts]
        ways = tuple(way for way in found if way is not None)
        if ways:
            step = GrantStep(type="navigate", source=ways[0][0], destination=home, ways=ways)
            self.add(clause, step, free=True)
            where = ", ".join(way[0] for way in ways)
            self.asking.assume(f"go.{home}", f"from {where}", "a return starts where the robot is")

    def do(self, clause: Clause, kind: str, **details: Any) -> int:
        """Add a step where the robot stands; what is said after it comes after it."""
        return self.add(clause, GrantStep(type=kind, source=self.at, **details))

    def add(self, clause: Clause, step: GrantStep, *, free: bool = False) -> int:
        """Add a step with its order, its bounds and its condition; return its index.

        Args:
            clause: what asks for it.
            step: the step.
            free: it has no place in the order; its condition says when it may be done.
        """
        early = free or (step.implied and step.type in _PREPARES)
        step.after = tuple(sorted({*step.after, *(() if early else self.last)}))
        step.condition = self.limits.condition(clause)
        if self._can(clause, step.type):
            step.limits = self.limits.of(clause, step.type)
        number = len(self.steps)
        self.steps.append(step)
        step.free = free and bool(self.last)
        if not step.implied and not step.free:
            self.last = (number,)
            self._arrived(number)
        return number

    def _arrived(self, number: int) -> None:
        """Close the motions that led here once the step they were for is done."""
        for way in self._ways:
            self.steps[way].until = number
        self._ways = []

    def see(self, item: str) -> None:
        """Remember that a thing is dealt with here, so that it may be looked for."""
        places = self.seen.setdefault(item, [])
        if self.places[item] not in places:
            places.append(self.places[item])

    def reach(self, clause: Clause, item: str) -> None:
        """Go to where a thing is."""
        self.see(item)
        self.go(clause, self.places[item])

    def take(self, clause: Clause, item: str, *, source: str | None, implied: bool) -> None:
        """Have a thing in the gripper."""
        if source is not None:
            self.places[item] = source
        if self.holding == item:
            return
        if source is None:
            home = self.places[item]
            self.asking.assume(field_of(clause, "source"), home, f"where `{item}` is")
        self.reach(clause, item)
        number = self.do(clause, "pick", object=item, holding=NOTHING, leaves=item, implied=implied)
        self.last = tuple(sorted({*self.last, number}))
        self.holding = item
        self._arrived(number)

    def fill(self, clause: Clause, item: str) -> None:
        """Have a vessel filled with what the clause names, unless that is in it already."""
        if clause.liquid is None or self.filled.get(item) == clause.liquid:
            return
        self.reach(clause, item)
        number = self.do(clause, "fill", object=item, implied=True)
        self.last = tuple(sorted({*self.last, number}))
        self.filled[item] = clause.liquid
        self.asking.assume(f"fill.{item}", clause.liquid, "what is poured is filled in first")

    def unlock(self, clause: Clause, receiver: str) -> bool:
        """Open a thing that must be open for what comes; true when it was not said."""
        kind = self.site.objects[ObjectId(receiver)].kind
        if "open" not in self.profile.classes.get(kind, ()) or receiver in self.opened:
            return False
        self.do(clause, "open", object=receiver, implied=True)
        self.asking.assume(f"open.{receiver}", "open and close", f"its class is `{kind}`")
        return True

    def lock(self, clause: Clause, receiver: str, after: int) -> None:
        """Let what was opened on the way be closed again, after completion too."""
        self.do(clause, "close", object=receiver, implied=True, after=(after,), closes=True)

    def close(self, clause: Clause, item: str) -> None:
        """Close a thing; what was only implied becomes what was said."""
        for number, step in enumerate(self.steps):
            if step.closes and (step.type, step.object) == ("close", item):
                step.implied = step.closes = False
                step.after = tuple(sorted({*step.after, *self.last}))
                self.last = (number,)
                self._arrived(number)
                return
        self.do(clause, "close", object=item, repeat=max(clause.repeat, 1))

    def put(self, clause: Clause, item: str, region: str) -> None:
        """Put what is held down in a region."""
        self.go(clause, region)
        self.do(
            clause,
            "place",
            object=item,
            destination=region,
            holding=item,
            leaves=NOTHING,
        )
        self.places[item], self.holding = region, None

    def put_into(self, clause: Clause, item: str, receiver: str) -> None:
        """Put what is held into or onto a thing; what was opened for it may be closed again."""
        self.reach(clause, receiver)
        opens = self.unlock(clause, receiver)
        number = self.do(
            clause, "put_in", object=receiver, destination=self.at, holding=item, leaves=NOTHING
        )
        if STAYS_OPEN in clause.extras and (opens or receiver in self.opened):
            self.kept_open.add(clause.number)
        elif opens:
            self.lock(clause, receiver, number)
        self.places[item], self.holding = self.places[receiver], None

    def able(self, kind: str) -> bool:
        """True when the robot can do an action type at all."""
        if self.robot is None:
            return kind in self.site.vocabulary
        tools = self.site.robots[RobotId(self.robot)].profile.tools
        return kind in self.site.vocabulary and bool(tools.get(ActionType(kind)))

    def tags(self, region: str) -> tuple[str, ...]:
        """Return the tags of a region."""
        return self.site.regions[RegionId(region)].tags

    def _can(self, clause: Clause, kind: str) -> bool:
        if self.able(kind):
            return True
        others = sorted(
            str(rid)
            for rid, robot in self.site.robots.items()
            if kind in self.site.vocabulary and robot.profile.tools.get(ActionType(kind))
        )
        who = f"`{self.robot}` cannot `{kind}`"
        if others:
            self.asking.ask("robot", f"{who}: which robot is meant?", others)
        else:
            field = field_of(clause, "type")
            self.asking.ask(field, f"No robot of this site can `{kind}`: say it otherwise")
        return False
