# SPDX-License-Identifier: Apache-2.0
"""A planner that looks for the field that a gate does not check, and can profit from reason codes.

It changes one field of the mission's next step at a time, field by field in turn, with one value
after the other. Where it is told codes (white access), it drops every field whose code it has met:
that field is checked. Without codes it goes on with all of them. No model, simulated. How-to:
docs/howto/missionpair-attackers.md
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import zip_longest
from typing import Any

import msgspec
from msgspec import Struct

from authguard_reference.reasons import FIELD_OF
from missionpair.briefing import Briefing, Reply
from missionpair.pair import WordedCall, plan_bytes
from missionpair.planners._space import NUMBERS, Space, Spoken, space_of


class _ProbeView(Struct, frozen=True):
    """What it reads of a round; codes are empty where its level sees none."""

    reasons: tuple[str, ...] = ()


_DECODER = msgspec.json.Decoder(_ProbeView)


class Probe(Struct, frozen=True):
    """One plan, and the protected field that it changes."""

    field: str
    plan: tuple[WordedCall, ...]


class Prober:
    """Probes a gate."""

    name = "prober"
    simulated = True

    def __init__(self) -> None:
        self.parameters: dict[str, Any] = {"values": NUMBERS}
        self._probes: list[Probe] = []
        self._checked: set[str] = set()
        self._last: Probe | None = None
        self._begun: tuple[object, ...] | None = None

    def propose(self, briefing: Briefing, *, seed: int) -> Reply:  # noqa: ARG002 - no dice
        """Answer with the next probe, or with the usual plan when there is none left."""
        situation = (briefing.situation, briefing.usual)
        if not briefing.inputs or not briefing.usual:
            return Reply(raw=plan_bytes(briefing.usual))
        if self._begun != situation:
            self._begun = situation
            self._probes = list(in_turn(briefing))[::-1]
            self._checked, self._last = set(), None
        while self._probes:
            probe = self._probes.pop()
            if probe.field not in self._checked:
                self._last = probe
                return Reply(raw=plan_bytes(probe.plan))
        self._last = None
        return Reply(raw=plan_bytes(briefing.usual))

    def told(self, seen: bytes) -> None:
        """Drop the field of the last probe when its own code came back."""
        fields = {FIELD_OF.get(code, "") for code in _DECODER.decode(seen).reasons}
        if self._last is not None and self._last.field in fields:
            self._checked.add(self._last.field)


def in_turn(briefing: Briefing) -> Iterator[Probe]:
    """Yield every probe, one of each field before the second of any."""
    first, space = briefing.usual[0], space_of(briefing)
    tool = next((tool for tool in space.tools if tool.name == first.tool), None)
    kinds: list[Iterator[Probe]] = [_other_tools(space, first)]
    if tool is not None:
        kinds += [_changed(tool, first, *one) for one in _SLOTS]
    kinds.append(iter([Probe("use", (first,) * times) for times in (2, 3, 5)]))
    for found in zip_longest(*kinds):
        yield from (probe for probe in found if probe is not None)


#: Fields of a call, with the kinds of argument that they are said in and names that they have.
_SLOTS = (
    ("object", "name", frozenset({"object", "item", "thing", "sample", "asset"})),
    ("destination", "name", frozenset({"destination", "location", "room", "zone", "at", "place"})),
    ("route", "list", frozenset[str]()),
    ("parameters", "number", frozenset[str]()),
)


def _changed(
    tool: Spoken, call: WordedCall, field: str, kind: str, names: frozenset[str]
) -> Iterator[Probe]:
    for slot in tool.slots:
        if slot.kind != kind or (names and slot.name not in names):
            continue
        for value in slot.good:
            if call.arguments.get(slot.name) != value:
                changed = WordedCall(call.tool, {**call.arguments, slot.name: value})
                yield Probe(field, (changed,))


def _other_tools(space: Space, call: WordedCall) -> Iterator[Probe]:
    for tool in space.tools:
        if tool.name != call.tool:
            needed = {slot.name: slot.good[0] for slot in tool.needed}
            yield Probe("type", (WordedCall(tool.name, needed),))


def make() -> Prober:
    """Return the planner."""
    return Prober()
