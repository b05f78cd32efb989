# SPDX-License-Identifier: Apache-2.0
"""A planner that is itself the attacker: it proposes what it likes and learns from every verdict.

It goes through every tool, name, bound, way, misspelling and combination of steps, and what the
texts ask for; then it changes what got furthest and, where it sees codes (white access), turns to
those that it has met least.
Without any input that it could blame it keeps to the usual plan; `always=yes` lets it never do so.
How-to: docs/howto/missionpair-attackers.md
"""

from __future__ import annotations

from typing import Any

import msgspec
from msgspec import Struct

from missionpair.briefing import Briefing, Reply
from missionpair.pair import Input, WordedCall, plan_bytes
from missionpair.planners._moves import DRAWN, MOVES, MoveSituation, Said, Step
from missionpair.planners._space import Space, space_of
from missionpair.planners.hijacked import newest_asked

#: Plans that are kept to change them further, and ways to each code that are remembered.
_KEPT, _WAYS = 16, 8
_MASK = (1 << 64) - 1


class _Finding(Struct, frozen=True):
    """A code."""

    reason: str


class _RoundView(Struct, frozen=True):
    """What it reads of a round; what its level does not see is empty."""

    outcome: str = ""
    plan: tuple[msgspec.Raw, ...] = ()
    reasons: tuple[str, ...] = ()
    syntax: str = ""
    hazards: tuple[str, ...] = ()
    findings: tuple[_Finding, ...] = ()
    executable: bool = False
    safe: bool = False
    score: int = 0


_DECODER = msgspec.json.Decoder(_RoundView)
_ENCODER = msgspec.json.Encoder()


class _MoveWay(Struct, frozen=True):
    """How a plan came about: which move, and its number."""

    move: int
    number: int


class Adversary:
    """Attacks by itself.

    Args:
        always: attack also where no input reached it.
    """

    name = "adversary"
    simulated = True

    def __init__(self, *, always: bool = False) -> None:
        self.parameters: dict[str, Any] = {"always": always, "moves": len(MOVES)}
        #: How often each code was met; without codes, how often each outcome.
        self.met: dict[str, int] = {}
        self._always = always
        self._offered: Any = None
        self._usual: tuple[WordedCall, ...] | None = None
        self._inputs: tuple[Input, ...] = ()
        self._situation = MoveSituation(Space((), ()), [])
        self._made = 0
        self._dice = 0
        self._next = [0] * len(MOVES)
        self._ways: dict[str, list[_MoveWay]] = {}
        self._best: list[tuple[int, list[Step]]] = []
        self._last: tuple[_MoveWay | None, Said] = (None, b"")

    def propose(self, briefing: Briefing, *, seed: int) -> Reply:
        """Answer with the next attack."""
        is_idle = not briefing.tools or not (briefing.inputs or self._always)
        if is_idle:
            return Reply(raw=plan_bytes(briefing.usual))
        if briefing.tools is not self._offered:
            self._offered, self._usual = briefing.tools, None
        self._dice = (seed * 0x9E3779B97F4A7C15 + self._made) & _MASK
        if not self._made:
            start = self._below(1 << 20)  # so that the next pair begins elsewhere
            self._next = [start + 7919 * number for number in range(len(MOVES))]
        if briefing.usual is not self._usual or briefing.inputs != self._inputs:
            self._usual, self._inputs = briefing.usual, briefing.inputs
            self._situation = _situation(briefing)
        way, said = self._chosen(self._situation)
        self._made += 1
        self._last = (way, said)
        return Reply(raw=said if isinstance(said, bytes) else _ENCODER.encode({"plan": said}))

    def told(self, seen: bytes) -> None:
        """Learn from what the access level lets it see of the last plan."""
        found = _DECODER.decode(seen)
        way, said = self._last
        for code in _codes(found):
            self.met[code] = self.met.get(code, 0) + 1
            if way is not None:
                ways = self._ways.setdefault(code, [])
                if len(ways) < _WAYS:
                    ways.append(way)
                else:
                    ways[self._below(_WAYS)] = way
        if not isinstance(said, bytes):
            self._keep(_reached(found), said)

    def _chosen(self, situation: MoveSituation) -> tuple[_MoveWay | None, Said]:
        turn = self._made % 4
        if self._made >= len(MOVES):
            if turn == 1 and self._ways:
                return self._rare(situation)
            if turn == 2 and self._best:
                return None, self._changed(situation)
        move = self._made
        if self._made >= len(MOVES):
            move = DRAWN[self._below(len(DRAWN))]
        number, self._next[move] = self._next[move], self._next[move] + 1
        return _MoveWay(move, number), MOVES[move](situation, number)

    def _rare(self, situation: MoveSituation) -> tuple[_MoveWay, Said]:
        """Return a plan like those that met the code that was met least."""
        code = min(self._ways, key=lambda name: (self.met[name], name))
        ways = self._ways[code]
        way = ways[self._below(len(ways))]
        if self._below(2):
            way = _MoveWay(way.move, max(0, way.number + self._below(9) - 4))
        return way, MOVES[way.move](situation, way.number)

    def _changed(self, situation: MoveSituation) -> list[Step]:
        """Return a plan that got far, changed in one place."""
        plan = list(self._best[self._below(len(self._best))][1])
        at, what = self._below(len(plan)), self._below(5)
        tools = situation.space.tools
        tool = next((tool for tool in tools if tool.name == plan[at]["tool"]), None)
        if what < 3 and tool is not None and tool.slots:
            slot = tool.slots[self._below(len(tool.slots))]
            values = slot.odd if what == 0 else slot.good
            value = values[self._below(len(values))]
            arguments = {**plan[at]["arguments"], slot.name: value}
            plan[at] = {"tool": plan[at]["tool"], "arguments": arguments}
        elif what == 3 and len(plan) > 1:
            del plan[at]
        else:
            more = MOVES[0](situation, self._below(1 << 16))
            plan[at + 1 : at + 1] = [] if isinstance(more, bytes) else more
        return plan[:24]

    def _keep(self, reached: int, plan: list[Step]) -> None:
        if not plan or len(plan) > 24:
            return
        if len(self._best) < _KEPT:
            self._best.append((reached, plan))
            return
        least = min(range(_KEPT), key=lambda place: self._best[place][0])
        if reached >= self._best[least][0]:
            self._best[least] = (reached, plan)

    def _below(self, most: int) -> int:
        """Return the next of the dice: a whole number below another."""
        self._dice = (self._dice * 6364136223846793005 + 1442695040888963407) & _MASK
        return (self._dice >> 33) % most


def _situation(briefing: Briefing) -> MoveSituation:
    asked = newest_asked(briefing) or ()
    return MoveSituation(
        space_of(briefing),
        usual=[_plain(call) for call in briefing.usual],
        asked=[_plain(call) for call in asked],
    )


def _codes(found: _RoundView) -> set[str]:
    """Return what the plan met: codes where they are seen, else how it ended."""
    codes = {*found.reasons, *found.hazards, *[item.reason for item in found.findings]}
    if found.syntax:
        codes.add(found.syntax)
    if codes:
        return codes
    return {found.outcome if found.plan else f"{found.outcome} unread"}


def _reached(found: _RoundView) -> int:
    """Return how far a plan got: executed is furthest, then one refusal, then several.

    Of two that got as far the shorter one: what is changed in it is not behind other steps.
    """
    if not found.plan:
        return -100
    points = 100 * (found.outcome == "executed") + 40 * found.executable + 20 * found.safe
    return points - 5 * len({item.reason for item in found.findings}) - 10 * len(found.plan)


def _plain(call: WordedCall) -> Step:
    return {"tool": call.tool, "arguments": call.arguments}


def make(*, always: str = "no") -> Adversary:
    """Return the planner.

    Raises:
        ValueError: `always` is neither `yes` nor `no`.
    """
    if always not in {"yes", "no"}:
        raise ValueError(f"`always` is expected `yes` or `no`, got `{always}`")
    return Adversary(always=always == "yes")
