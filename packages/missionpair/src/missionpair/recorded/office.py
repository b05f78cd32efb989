# SPDX-License-Identifier: Apache-2.0
"""Office tools as a site with its binding, and office tasks as missions that an operator signs.

A suite's file says which argument of a tool names a thing, a place that something goes to, or an
amount; what a task may do; and nothing of what any model did. Texts (subjects, bodies, titles) are
noted: no mission judges them. How-to: docs/howto/missionpair-recorded.md
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from functools import lru_cache
from hashlib import sha256
from importlib.resources import files
from itertools import chain
from typing import Any, Literal

from msgspec import Struct

from authguard_r.core.encoding import b64
from authguard_r.site.source import convert, read_yaml
from missionpair.missions.amend import Draft
from missionpair.missions.grants import risk
from missionpair.pair import Layout, Pair, PriorAct, Scenario
from missionpair.recorded.archive import SourceError
from missionpair.words import Category, Channel, Domain, Family

ROBOT, TOOL, DESK = "assistant-1", "office", "desk"
#: What a place, a thing or a word is that the suite does not name: no mission grants such a place
#: or thing, and its own word is number 0.
UNKNOWN = "unknown"
#: What every read-only grant has: so many successes, and no more.
READS = 60
#: How many web addresses a call's texts name that the suite does not: an argument of its own.
LINKS = "foreign_links"
_LINK = re.compile(r"(?:https?://|www\.)[^\s'\")>\]]+", re.IGNORECASE)
#: Longest lease of a call, in milliseconds.
_LEASE_MS = 20_000
#: An amount's unit: hundredths.
_AMOUNT = {"unit": "count", "low": 0, "high": 10**10, "rounding": "count", "required": False}


class ToolModel(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One tool of an office suite.

    Args:
        group: what it belongs to (`bank`, `mail`); a task's `reads` names groups.
        effect: `reads`, or `changes` something.
        object: the argument that names a thing.
        to: arguments that name places, or lists of them; the call reaches each of them.
        amounts: the argument of each amount, by parameter.
        words: arguments that may be one of some words alone, with the word's number.
        links: texts that may name no web address but those of the suite's things and places.
        texts: arguments that nothing judges.
        defaults: what the tool takes for an argument that is absent or null, as it documents.
    """

    group: str
    effect: Literal["reads", "changes"] = "reads"
    object: str = ""
    to: tuple[str, ...] = ()
    amounts: dict[str, str] = {}
    words: dict[str, dict[str, int]] = {}
    links: tuple[str, ...] = ()
    texts: tuple[str, ...] = ()
    defaults: dict[str, Any] = {}


class Allowed(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One thing that a task may do.

    Args:
        tool: with which tool.
        objects: which things, alternatives.
        to: which places it may reach, all of them or some.
        amounts: most and least of each amount, in hundredths.
        times: how often it may succeed.
    """

    tool: str
    objects: tuple[str, ...] = ()
    to: tuple[str, ...] = ()
    amounts: dict[str, tuple[int, int]] = {}
    times: int = 1


class Goal(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One call that an attack asks for.

    Args:
        tool: of which tool.
        where: a text that each of these arguments holds, or an item of it, in any case.
    """

    tool: str
    where: dict[str, str] = {}


class TaskModel(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What an operator signs for one task.

    Args:
        task: it, in our words.
        reads: groups whose read-only tools it may use, on every thing of the suite's `own`.
        allows: what else it may do.
        joins: tasks that it consists of; it may do what each of them may.
        uses: tools of its published solution.
    """

    task: str
    joins: tuple[str, ...] = ()
    uses: tuple[str, ...] = ()
    reads: tuple[str, ...] = ()
    allows: tuple[Allowed, ...] = ()


class SuiteModel(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One office suite.

    Args:
        suite: its name in the transcripts.
        places: where something can go, with their spellings.
        things: what a call can name, with their spellings.
        own: things that a task which reads their tool's group may read.
        prefixes: how the spelling of a place begins, where its rest is an attacker's.
        tools: by name.
        tasks: by name.
        attacks: what each asks for, from its published solution.
    """

    suite: str
    places: dict[str, tuple[str, ...]]
    things: dict[str, tuple[str, ...]] = {}
    own: tuple[str, ...] = ()
    prefixes: dict[str, str] = {}
    tools: dict[str, ToolModel]
    tasks: dict[str, TaskModel]
    attacks: dict[str, tuple[Goal, ...]] = {}


@lru_cache
def suite_names() -> tuple[str, ...]:
    """Return the names of the suites that ship with the package."""
    names = (entry.name for entry in (files(__package__) / "offices").iterdir())
    return tuple(sorted(name.removesuffix(".yaml") for name in names if name.endswith(".yaml")))


@lru_cache
def read_suite(name: str) -> SuiteModel:
    """Return a suite that ships with the package."""
    return convert(read_yaml(_suite_file(name).decode(), where=name), SuiteModel, where=name)


def require_known(suite: str, task: str, attack: str, *, where: str) -> None:
    """Refuse a run that no suite knows.

    Args:
        suite: the name of its suite.
        task: what its user asked for; it may be an attack's own task.
        attack: what the attack asked for; empty without one.
        where: the run.

    Raises:
        SourceError: its suite, task or attack was not written down.
    """
    known = read_suite(suite) if suite in suite_names() else None
    if known is None or task not in {*known.tasks, *known.attacks}:
        raise SourceError(f"no mission was written for the task `{task}`", where=where)
    if attack and attack not in known.attacks:
        text = f"the suite's file does not list the calls of the attack `{attack}`"
        raise SourceError(text, where=where)


def suite_digest(name: str) -> str:
    """Return the SHA-256 of a suite's file, base64url: other missions, other digest."""
    return b64(sha256(_suite_file(name)).digest())


def _suite_file(name: str) -> bytes:
    return (files(__package__) / "offices" / f"{name}.yaml").read_bytes()


def layout_of(suite: SuiteModel) -> Layout:
    """Return the suite's site and binding."""
    return Layout(
        id=f"office-{suite.suite}",
        domain=Domain.OFFICE,
        site={
            "schema": "authguard-r/site/1",
            "id": f"office-{suite.suite}",
            "version": 1,
            "regions": dict(_regions(suite)),
            "objects": {
                name: {"kind": "record", "home": DESK, "mass_g": 0}
                for name in (*suite.things, UNKNOWN)
            },
            "robots": {ROBOT: {"home": DESK, "profile": _profile(suite)}},
            "vocabulary": {name: _kind(tool) for name, tool in suite.tools.items()},
        },
        binding={
            "schema": "authguard-r/binding/1",
            "id": f"office-{suite.suite}",
            "tools": {name: _bound(name, tool) for name, tool in suite.tools.items()},
        },
    )


def _regions(suite: SuiteModel) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the desk, and beside it one square for each place."""
    for number, name in enumerate((DESK, UNKNOWN, *suite.places)):
        left, right = 2_000 * number, 2_000 * number + 1_000
        yield (
            name,
            {
                "map": "office",
                "floor": 0,
                "points": [[left, 0], [right, 0], [right, 1_000], [left, 1_000]],
                "approach": [left + 500, 500],
                "tags": ["public"],
            },
        )


def _profile(suite: SuiteModel) -> dict[str, Any]:
    tools = {name: [TOOL] for name in suite.tools}
    return {"tools": tools, "max_speed_mm_s": 1, "max_force_mn": 1, "max_payload_g": 1}


def _kind(tool: ToolModel) -> dict[str, Any]:
    fields = ["destination", "route"] if tool.to else []
    fields += ["object"] if tool.object else []
    words = {f"{argument}_no": {**_AMOUNT, "required": True} for argument in tool.words}
    links = {f"{LINKS}_count": {**_AMOUNT, "required": True}} if tool.links else {}
    return {
        "fields": sorted(fields),
        "params": {**dict.fromkeys(tool.amounts, _AMOUNT), **words, **links},
        "privacy": 0,
    }


def _bound(name: str, tool: ToolModel) -> dict[str, Any]:
    arguments: dict[str, Any] = {}
    if tool.object:
        arguments[tool.object] = {"use": "mapped", "to": "object"}
    if tool.to:
        arguments["to"] = {
            "use": "mapped",
            "to": "stops",
            "each": {"place": {"use": "mapped", "to": "region"}},
        }
    for parameter, argument in tool.amounts.items():
        to = f"params.{parameter}"
        arguments[argument] = {"use": "mapped", "to": to, "per_unit": "100", "optional": True}
    for argument, words in tool.words.items():
        values = {UNKNOWN: 0, **words}
        arguments[argument] = {"use": "mapped", "to": f"params.{argument}_no", "values": values}
    if tool.links:
        arguments[LINKS] = {"use": "mapped", "to": f"params.{LINKS}_count"}
    arguments |= {text: {"use": "noted"} for text in (*tool.texts, *tool.links)}
    return {"type": name, "tool": TOOL, "arguments": arguments}


class OfficeCall(Struct, frozen=True):
    """One call of a tool, as a planner made it.

    Args:
        tool: the tool's name.
        arguments: as they were written.
    """

    tool: str
    arguments: dict[str, Any]


class Office:
    """One suite ready for calls: its layout, its missions, and how a call is put to a gate.

    Args:
        suite: its model.
    """

    def __init__(self, suite: SuiteModel) -> None:
        self.suite = suite
        self.layout = layout_of(suite)
        self._places = _Spellings(suite.places, suite.prefixes)
        self._things = _Spellings(suite.things, suite.prefixes)

    def parts_of(self, task: str) -> tuple[TaskModel, ...]:
        """Return the tasks that a task consists of, itself the last."""
        model = self.suite.tasks[task]
        return (*(self.suite.tasks[name] for name in model.joins), model)

    def changes(self, call: OfficeCall) -> bool:
        """Return whether a call changes something, rather than reads."""
        tool = self.suite.tools.get(call.tool)
        return tool is None or tool.effect == "changes"

    def is_the_attacks(self, call: OfficeCall, attack: str) -> bool:
        """Return whether an attack asks for a call."""
        return any(_is_met(goal, call) for goal in self.suite.attacks.get(attack, ()))

    def is_shared(self, call: OfficeCall, task: str) -> bool:
        """Return whether a task makes calls like this one itself.

        Such a call only reads, with a tool of the task's published solution, and names a thing of
        the suite, or nothing.
        """
        if self.changes(call) or all(call.tool not in part.uses for part in self.parts_of(task)):
            return False
        named = self.suite.tools[call.tool].object
        return not named or self._things.id_of(call.arguments.get(named)) != UNKNOWN

    def plan(self, call: OfficeCall) -> bytes:
        """Return the bytes of a plan of one call, with everything said that its tool assumes.

        A spelling that the site does not know is `unknown`: each defense sees it as a place or a
        thing of that name.
        """
        tool = self.suite.tools.get(call.tool)
        arguments = dict(call.arguments)
        if tool is not None:
            arguments = self._explicit(tool, arguments)
        steps = [{"tool": call.tool, "arguments": arguments}]
        return json.dumps({"plan": steps}, ensure_ascii=False).encode()

    def _explicit(self, tool: ToolModel, given: dict[str, Any]) -> dict[str, Any]:
        arguments = {name: value for name, value in given.items() if value is not None}
        arguments = {**tool.defaults, **arguments}
        if tool.to:
            reached = [arguments.pop(name) for name in tool.to if name in arguments]
            named = chain.from_iterable(r if isinstance(r, list) else [r] for r in reached)
            places = sorted({self._places.id_of(name) for name in named})
            arguments["to"] = [{"place": place} for place in places]
        if tool.object and tool.object in arguments:
            arguments[tool.object] = self._things.id_of(arguments[tool.object])
        if tool.links:
            texts = (str(arguments.get(name, "")) for name in tool.links)
            arguments[LINKS] = sum(
                self._is_foreign(link) for t in texts for link in _LINK.findall(t)
            )
        for argument in tool.words:
            word = str(arguments.get(argument, ""))
            arguments[argument] = word if word in tool.words[argument] else UNKNOWN
        return arguments

    def _is_foreign(self, link: str) -> bool:
        """Return whether a web address is none of a thing or place of the suite."""
        bare = link.rstrip(".,:;*!?/")
        named = (self._things.id_of(bare), self._places.id_of(bare))
        return named == (UNKNOWN, UNKNOWN)

    def pair(self, name: str) -> Pair:
        """Return a task as a pair without an attack: its mission, in force before the first call.

        Raises:
            KeyError: the suite has no such task.
        """
        task = self.suite.tasks[name]
        begun = Scenario(robot=ROBOT, before=(PriorAct(do="activate", mission="v1"),))
        return Pair(
            id=f"{self.layout.id}-{name}",
            domain=Domain.OFFICE,
            layout=self.layout.id,
            categories=(Category.GOAL,),
            family=Family.DESTINATION_CHANGE,
            channels=(Channel.DOCUMENT,),
            missions={"v1": self._draft(name)},
            task=task.task,
            benign=begun,
            attack=begun,
            update=(),
            inputs=(),
            violates=(),
            reasons=(),
        )

    def _draft(self, name: str) -> Draft:
        grants = [*self._reads(name), *self._writes(name)]
        return {
            "mission": f"{self.layout.id}-{name}".replace("_", "-"),
            "robot": ROBOT,
            "issuer": "operator-1",
            "task": self.suite.tasks[name].task,
            "window": {"for": "4 h"},
            "place_max_age": "10 s",
            "guards": [],
            "limits": {},
            "grants": grants,
            "budgets": {
                "actions": READS * len(grants),
                "rate": {"count": 1_000, "per": "10 s"},
                "motion": "0 s",
                "waiting": "0 s",
                "recorded_bytes": 0,
                "prompts": 0,
                "planner_stops": 0,
            },
            "on_refusal": "hold",
            "risk_policy": risk(),
        }

    def _reads(self, name: str) -> Iterator[Draft]:
        """Yield a grant for each read-only tool of the groups that the task reads."""
        groups = {group for part in self.parts_of(name) for group in part.reads}
        for tool_name, tool in self.suite.tools.items():
            if tool.group in groups and tool.effect == "reads":
                objects = self.suite.own if tool.object else ()
                allowed = Allowed(tool=tool_name, objects=objects, times=READS)
                yield self._grant(f"read-{tool_name}", allowed)

    def _writes(self, name: str) -> Iterator[Draft]:
        allows = (allowed for part in self.parts_of(name) for allowed in part.allows)
        for number, allowed in enumerate(allows, 1):
            yield self._grant(f"do-{number}", allowed)

    def _grant(self, name: str, allowed: Allowed) -> Draft:
        rows: list[dict[str, Any]] = [{}]
        if allowed.objects:
            rows = [{"object": thing} for thing in allowed.objects]
        if allowed.to:
            within = sorted({DESK, *allowed.to})
            rows = [
                {**row, "destination": place, "regions": within}
                for row in rows
                for place in allowed.to
            ]
        limits = {name: list(bounds) for name, bounds in allowed.amounts.items()}
        if self.suite.tools[allowed.tool].links:
            limits[f"{LINKS}_count"] = [0, 0]
        return {
            "id": name.replace("_", "-"),
            "type": allowed.tool,
            "tool": TOOL,
            "rows": rows,
            "limits": limits,
            "chooser": "operator" if len(rows) == 1 else "planner",
            "repeat": allowed.times,
            "starts": allowed.times,
            "max": _LEASE_MS,
            "irreversible": False,
        }


class _Spellings:
    """Which place or thing a spelling means.

    Args:
        names: spellings by id.
        prefixes: how some spellings begin, by id.
    """

    def __init__(self, names: dict[str, tuple[str, ...]], prefixes: dict[str, str]) -> None:
        self._ids = {word: name for name, words in names.items() for word in (name, *words)}
        self._prefixes = {text: name for name, text in prefixes.items() if name in names}

    def id_of(self, value: object) -> str:
        """Return the id; `UNKNOWN` where no name is spelled so."""
        spelled = value.strip() if isinstance(value, str) else _canonical(value)
        starts = (name for text, name in self._prefixes.items() if spelled.startswith(text))
        return self._ids.get(spelled) or next(starts, UNKNOWN)


def _is_met(goal: Goal, call: OfficeCall) -> bool:
    if goal.tool != call.tool:
        return False
    for argument, wanted in goal.where.items():
        given = call.arguments.get(argument)
        items = given if isinstance(given, list) else [given]
        if not any(wanted.casefold() in str(item).casefold() for item in items):
            return False
    return True


def _canonical(value: object) -> str:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
