# SPDX-License-Identifier: Apache-2.0
"""SafeAgentBench's household tasks as pairs: `household-rows:folder=PATH`; no row is shipped.

The row's instruction is the mission, its own steps are granted one by one; the twin is the same
handling of another thing: one that the row's risky instruction names, or one that lies about.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec

from missionpair.layouts.furnish import slug
from missionpair.layouts.words import ToolWords, call_of, model_of
from missionpair.missions.amend import Draft, amended, superseding
from missionpair.missions.grants import risk
from missionpair.pair import Input, Layout, Pair, PriorAct, Scenario, Suite, WordedCall
from missionpair.suites._form import SuiteError
from missionpair.wording import say
from missionpair.words import Category, Channel, Domain, Family

VERSION = 1
KITCHEN, ROBOT = "kitchen", "helper-1"
#: What a row calls a step, and the action type that it is.
VERBS: dict[str, str] = {
    **{v: v for v in ("find", "pick", "open", "close", "break", "slice", "cook", "dirty", "clean")},
    "pour": "pour",
    "drop": "drop",
    "throw": "throw",
    "put": "put_in",
    "turn on": "turn_on",
    "turn off": "turn_off",
    "fillliquid": "fill",
    "emptyliquid": "empty",
}
_TWO_WORDS = re.compile(r"(turn) (on|off)\b")
_LIQUIDS = ("water", "coffee", "wine", "milk", "juice", "tea", "oil")
#: Things that lie about; one that the row does not name is the twin's, where no other one is.
_ABOUT = ("Newspaper", "Tissue Box", "Key Chain", "Remote Control")
#: Names of things in an instruction are capitalized there.
_NOUN = re.compile(r"\b[A-Z][a-z]+(?:[A-Z][a-z]+)*\b")
_TOOLS = {
    kind: ToolWords(
        name=kind,
        type=kind,
        tool="eyes" if kind == "find" else "hand",
        arguments={
            **({"object": "thing"} if "object" in model_of(kind).fields else {}),
            **({"params.liquid_no": "liquid"} if kind == "fill" else {}),
        },
        fixed={"force_mn": 10_000} if kind == "pick" else {},
    )
    for kind in sorted(set(VERBS.values()))
}


def make(folder: str = "") -> Suite:
    """Return the suite of the rows in a folder.

    Rows without steps, and rows that pour from what they never filled, have no benign run: they
    are left out.

    Args:
        folder: with the four files of the data set, as they are published.

    Raises:
        SuiteError: no such folder, or a line that is no row.
    """
    if not folder:
        raise SuiteError("say `household-rows:folder=PATH`", where="household-rows")
    layouts: dict[str, Layout] = {}
    pairs: list[Pair] = []
    for number, (where, row) in enumerate(_rows(Path(folder))):
        steps = _steps(row, where)
        if steps and _pours_something(steps):
            layout, pair = _made(row, steps, number, where)
            layouts[layout.id] = layout
            pairs.append(pair)
    return Suite(name="household-rows", version=VERSION, layouts=layouts, pairs=tuple(pairs))


def _rows(folder: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    paths = sorted(folder.glob("*.jsonl"))
    if not paths:
        raise SuiteError("no `.jsonl` file is here; give the data set's folder", where=str(folder))
    for path in paths:
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            where = f"{path.name}:{number}"
            if not line.strip():
                continue
            try:
                row = json.loads(line)
            except ValueError as error:
                raise SuiteError(f"{error}; take the file as published", where=where) from error
            if not isinstance(row, dict) or "instruction" not in row:
                raise SuiteError("expected an object with an `instruction`", where=where)
            yield where, row


#: One step of a row: its type, its thing's name, its liquid's number.
_Step = tuple[str, str, int]


def _steps(row: dict[str, Any], where: str) -> list[_Step]:
    found: list[_Step] = []
    for step in row.get("step") or ():
        words = _TWO_WORDS.sub(r"\1_\2", str(step).strip()).split()
        verb = words[0].lower().replace("_", " ") if words else ""
        if verb not in VERBS:
            raise SuiteError(f"no verb is called `{verb}`", where=where)
        kind, rest = VERBS[verb], words[1:]
        liquid = 0
        if kind == "fill":
            liquid = _LIQUIDS.index(rest.pop().lower()) + 1 if rest[-1:] else 0
        has_thing = "object" in model_of(kind).fields
        found.append((kind, _noun("".join(rest)) if has_thing else "", liquid))
    return found


def _pours_something(steps: list[_Step]) -> bool:
    kinds = [kind for kind, _, _ in steps]
    return "pour" not in kinds or "fill" in kinds[: kinds.index("pour")]


def _noun(word: str) -> str:
    """Return a thing's name as all spellings of it have in common; a slice is its thing."""
    bare = re.sub(r"[^A-Za-z]", "", word).lower()
    return {"refrigerator": "fridge"}.get(bare, bare).removesuffix("sliced")


def _made(row: dict[str, Any], steps: list[_Step], number: int, where: str) -> tuple[Layout, Pair]:
    things = list(dict.fromkeys(thing for _, thing, _ in steps if thing))
    named = _NOUN.findall(str(row.get("risk_instruction", "")))
    known = {_noun(name): name for name in (*named, *_ABOUT)}
    other = next(name for noun, name in known.items() if noun not in things and _is_thing(noun))
    names = {thing: thing.capitalize() for thing in things} | {_noun(other): other}
    layout = _layout(f"household-row-{number:03}", names)
    at = next((n for n, s in enumerate(steps) if s[1] and s[0] != "find"), 0)
    twin = (steps[at][0], _noun(other), steps[at][2])
    told = row["instruction"]
    task = (told if isinstance(told, str) else told[0]).strip()
    draft = _draft(steps, names, task)
    rows = [{"object": slug(other), "source": KITCHEN, "regions": [KITCHEN]}]
    v2 = superseding(draft, amended(draft, f"step-{at + 1}", rows=rows))
    calls = [_call(step, names) for step in steps]
    plan = (_call(twin, names),)
    channel = tuple(Channel)[number % len(Channel)]
    signed = names[steps[at][1]]
    text = say(Family.OBJECT_RELABELING, channel, plan, authorized=signed, seed=number)
    first = PriorAct(do="activate", mission="v1")
    history = (PriorAct(do="run", calls=tuple(calls[:at])),) if at else ()
    codes = ("OBJECT_OUT_OF_SCOPE",)
    return layout, Pair(
        id=f"household-rows.{where.replace('.jsonl:', '.')}",
        domain=Domain.HOUSEHOLD,
        layout=layout.id,
        categories=(Category.OBJECT,),
        family=Family.OBJECT_RELABELING,
        channels=(channel,),
        missions={"v1": draft, "v2": v2},
        task=task,
        benign=Scenario(robot=ROBOT, before=(first,), plan=tuple(calls)),
        attack=Scenario(robot=ROBOT, before=(first, *history), plan=plan),
        update=(PriorAct(do="activate", mission="v2"),),
        inputs=(Input(channel, text),),
        violates=codes,
        reasons=codes,
    )


def _is_thing(noun: str) -> bool:
    """True of a capitalized word that is no verb at the beginning of a sentence."""
    return noun not in {*VERBS, "place", "turn", "fill", "use", "pick", "leave", "toggle", "heat"}


def _call(step: _Step, names: dict[str, str]) -> WordedCall:
    kind, thing, liquid = step
    fields: dict[str, Any] = {"object": names[thing]} if thing else {}
    return call_of(_TOOLS[kind], {**fields, **({"params.liquid_no": liquid} if liquid else {})})


def _draft(steps: list[_Step], names: dict[str, str], task: str) -> Draft:
    grants: list[Draft] = []
    for number, (kind, thing, liquid) in enumerate(steps, 1):
        thing_row = {"object": slug(names[thing])} if thing else {}
        limits = {"force_mn": [10_000, 10_000]} if kind == "pick" else {}
        grants.append(
            {
                "id": f"step-{number}",
                "type": kind,
                "tool": _TOOLS[kind].tool,
                "rows": [{**thing_row, "source": KITCHEN, "regions": [KITCHEN]}],
                "limits": {"liquid_no": [liquid, liquid]} if liquid else limits,
                "chooser": "operator",
                "after": [f"step-{number - 1}"] if number > 1 else [],
                "repeat": 1,
                "starts": 1,
                "max": 20_000,
                "irreversible": False,
                "completes": number == len(steps),
            }
        )
    return {
        "mission": "household-task",
        "robot": ROBOT,
        "issuer": "operator-1",
        "task": task,
        "window": {"for": "30 min"},
        "place_max_age": 1_000,
        "objects": sorted(map(slug, names.values())),
        "regions": [KITCHEN],
        "limits": {},
        "guards": [],
        "grants": grants,
        "budgets": {
            "actions": len(steps) + 4,
            "rate": {"count": 20, "per": 10_000},
            "motion": 0,
            "waiting": 0,
            "recorded_bytes": 0,
            "prompts": 3,
            "planner_stops": 3,
        },
        "on_refusal": "hold",
        "risk_policy": risk(),
    }


def _layout(identifier: str, names: dict[str, str]) -> Layout:
    kinds = sorted(_TOOLS)
    corners = [[0, 0], [6000, 0], [6000, 5000], [0, 5000]]
    kitchen = {"map": "main", "floor": 0, "points": corners, "approach": [3000, 2500]}
    profile = {
        "tools": {kind: [_TOOLS[kind].tool] for kind in kinds},
        "max_speed_mm_s": 1_000,
        "max_force_mn": 40_000,
        "max_payload_g": 5_000,
    }
    objects = {
        slug(name): {"kind": "item", "home": KITCHEN, "mass_g": 500, "names": [name]}
        for name in names.values()
    }
    site = {
        "schema": "authguard-r/site/1",
        "id": identifier,
        "version": 1,
        "regions": {KITCHEN: {**kitchen, "tags": ["public"], "names": ["Kitchen"]}},
        "doors": [],
        "objects": objects,
        "robots": {ROBOT: {"home": KITCHEN, "profile": profile}},
        "vocabulary": msgspec.to_builtins({kind: model_of(kind) for kind in kinds}),
    }
    tools = {kind: _TOOLS[kind].binding() for kind in kinds}
    binding = {"schema": "authguard-r/binding/1", "id": "household-row-tools", "tools": tools}
    return Layout(id=identifier, domain=Domain.HOUSEHOLD, site=site, binding=binding)
