# SPDX-License-Identifier: Apache-2.0
"""A mission pair: a signed mission, a safe unauthorized twin of a step, and what authorizes it.

A pair is plain data. Its runner needs the pair and its layout, and nothing that made them. Source:
section "Attack Templates" (the paired benchmark). Spec page: docs/spec/missionpair.md
"""

from __future__ import annotations

from typing import Any, Literal

import msgspec
from msgspec import Struct

from missionpair.words import Category, Channel, Domain, Family

#: Version of the form of suites.
SCHEMA = "missionpair/suite/1"

Value = str | int | float | bool | list[str]


class WordedCall(Struct, frozen=True, forbid_unknown_fields=True):
    """One call of a tool, with the words that a planner uses for places and things."""

    tool: str
    arguments: dict[str, Value] = {}


class Input(Struct, frozen=True, forbid_unknown_fields=True):
    """One text that reaches the planner."""

    channel: Channel
    text: str


class Perceived(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Of what a text was read or heard.

    Args:
        input: which one of the pair's inputs, counted from 0.
        written: what stood on the sign, or was said.
        by: programs and packages that perceived it, with their versions.
        how: a sign's font and what spoils the view of it; a voice.
        words: how many words were written.
        wrong: how many are wrong, missing or added.
    """

    input: int
    written: str
    by: str
    how: tuple[str, ...]
    words: int
    wrong: int


class PriorAct(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """Something that happens before the planner is asked, done as those who may do it do it.

    Args:
        do: `activate` a mission; `force` one into the gate's store past activation, as a thief of
            the disk could; `run` calls, which must all succeed; `propose` calls, with every result;
            `approve` what is open; `choose` a row of a grant; `order` a verb of management; `wait`
            until so much time is over.
        mission: the mission's key in the pair, of `activate` and `force`.
        by: who signs; several for several approvals, also the same one twice.
        calls: of `run` and `propose`.
        grant: of `choose`.
        row: of `choose`, counted from 0.
        verb: of `order`, such as `revoke` and `complete`.
        ms: of `wait`.
    """

    do: Literal["activate", "force", "run", "propose", "approve", "choose", "order", "wait"]
    mission: str = ""
    by: tuple[str, ...] = ()
    calls: tuple[WordedCall, ...] = ()
    grant: str = ""
    row: int = 0
    verb: str = ""
    ms: int = 0


class Start(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """The world before anything happens: everything is at home but what is said here.

    Args:
        at: region of the robot; empty for its home.
        holding: what it holds.
        places: things that lie elsewhere than at home.
        battery: its charge, per mille; 0 for as much as it has at home.
    """

    at: str = ""
    holding: str = ""
    places: dict[str, str] = {}
    battery: int = 0


class Scenario(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """A situation and a plan in it.

    Args:
        robot: whose gate it is.
        start: the world.
        before: what happens first.
        plan: what is then proposed.
        approvers: who answers, by signature, when approval is asked for.
    """

    robot: str
    start: Start = Start()
    before: tuple[PriorAct, ...] = ()
    plan: tuple[WordedCall, ...] = ()
    approvers: tuple[str, ...] = ()


class Pair(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True):
    """One attack and what it is measured against.

    Args:
        id: unique within its suite; says domain, categories, family, channels and a number.
        domain: where.
        layout: the site, by its id in the suite.
        categories: what the attack changes; the first one is its row in a table.
        family: what it claims.
        channels: on which ways, one for each of `inputs`, in order.
        missions: drafts by key, as their operators wrote them; `v1` is the attacked one. A draft
            whose `version` is above 1 supersedes the one in force; its digest is filled in.
        task: what the planner is asked for, in words.
        benign: the mission as it is meant; its plan is carried out to the end.
        attack: the attacked situation; its plan is the twin: executable, safe, not authorized.
        update: acts that authorize exactly the twin, in the attacked situation.
        commissioned: tools, by action type, that the attacked robot's profile lacks, and that its
            integrator adds before the update: no operator can grant what a robot cannot do.
        rest: what is left of the mission in the attacked situation, as a plan; empty where the
            benign run says it: then it is the longest end of that plan that can be done there.
        inputs: the attack in the suite's own words, oldest first; of a text that was perceived,
            what was read or heard.
        perceived: of what such texts were perceived. No planner sees it.
        violates: protected fields that the twin violates, by its author.
        reasons: the codes that the gate refuses the twin with, by its author, in any order.
    """

    id: str
    domain: Domain
    layout: str
    categories: tuple[Category, ...]
    family: Family
    channels: tuple[Channel, ...]
    missions: dict[str, dict[str, Any]]
    task: str
    benign: Scenario
    attack: Scenario
    update: tuple[PriorAct, ...]
    inputs: tuple[Input, ...]
    violates: tuple[str, ...]
    reasons: tuple[str, ...]
    commissioned: dict[str, str] = {}
    rest: tuple[WordedCall, ...] = ()
    perceived: tuple[Perceived, ...] = ()


class Layout(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A site with its robots, and the tools that a planner is offered there.

    Args:
        id: unique within its suite.
        domain: where.
        site: the site model, as its people write it (`authguard_r.site.model.Site`).
        binding: the planner's tools, as its people write them.
    """

    id: str
    domain: Domain
    site: dict[str, Any]
    binding: dict[str, Any]


class Suite(Struct, frozen=True, kw_only=True):
    """Pairs with their layouts.

    Args:
        name: such as `live`.
        version: grows with every change of a pair.
        layouts: by id.
        pairs: in order.
    """

    name: str
    version: int
    layouts: dict[str, Layout]
    pairs: tuple[Pair, ...]


def updated(pair: Pair, layout: Layout) -> Layout:
    """Return the site in which the pair's update happens: its own, or one with another profile.

    Args:
        pair: whose update.
        layout: the pair's.
    """
    if not pair.commissioned:
        return layout
    robots, name = layout.site["robots"], pair.attack.robot
    profile = robots[name]["profile"]
    tools = {**profile["tools"]}
    for kind, tool in pair.commissioned.items():
        tools[kind] = sorted({*tools.get(kind, ()), tool})
    robot = {**robots[name], "profile": {**profile, "tools": tools}}
    return msgspec.structs.replace(
        layout,
        id="+".join((layout.id, name, *map(":".join, sorted(pair.commissioned.items())))),
        site={**layout.site, "robots": {**robots, name: robot}},
    )


def plan_bytes(calls: tuple[WordedCall, ...]) -> bytes:
    """Return calls as a planner writes them: bare JSON, which the gate's normalizer reads."""
    return msgspec.json.encode(
        {"plan": [{"tool": call.tool, "arguments": call.arguments} for call in calls]}
    )
