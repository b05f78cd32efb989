# SPDX-License-Identifier: Apache-2.0
"""Every way of every shipped binding: accepted by both gates and executed in the simulator.

The planner's bytes are a sample call that the binding itself yields; the mission grants exactly
the sample actions; what writes belief is refused before anything is decided.
"""

from __future__ import annotations

from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.authoring.binding.samples import Sampler
from authguard_r.authoring.keys.setup import demo_members, init_folder
from authguard_r.core.action import Action
from authguard_r.core.encoding import Tag, b64
from authguard_r.core.errors import MalformedError
from authguard_r.core.mission import Mission, require_schema
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Outcome
from authguard_r.core.token import sign_object
from authguard_r.keys.signer import folder_signer
from authguard_r.normalize import Dialect, read_plan
from authguard_r.normalize.bind import Binder
from authguard_r.normalize.binding import Binding, ToolWay, ways
from authguard_r.normalize.rebuild import Rebuilder, call_bytes
from authguard_r.normalize.shipped import binding_source, shipped_names
from authguard_r.operations.simulation import Simulation, simulate
from authguard_r.sim.state import WorldState
from authguard_r.sim.world import initial_state
from authguard_r.site.check import faults
from authguard_r.site.model import Site, profile_digest, site_digest
from authguard_r.site.source import convert
from authguard_r.site.words import standard_words
from fixtures import scenarios

WORDS = standard_words()
RID = "robot-1"
DAY_MS = 86_400_000
ROOMS = ("room-1", "room-2", "room-3")
#: Types that need something in the hand.
HANDS = {"place", "put_in", "drop", "throw", "pour"}


@cache
def shipped(name: str) -> Binding:
    return convert(binding_source(name), Binding, where=name)


@cache
def lab(name: str) -> Site:
    """Return three rooms in a row, two things, and a robot that has every tool of the binding."""
    tools: dict[str, set[str]] = {}
    for way in ways(shipped(name)):
        tools.setdefault(way.tool.type, set()).add(way.tool.tool)
    site = convert(
        {
            "schema": "authguard-r/site/1",
            "id": "lab",
            "version": 1,
            "regions": {
                room: {
                    "map": "map",
                    "floor": 0,
                    "points": [[x, 0], [x + 4000, 0], [x + 4000, 4000], [x, 4000]],
                    "approach": [x + 2000, 2000],
                    "tags": ["public"],
                    "names": [room.replace("-", " ").title()],
                }
                for room, x in zip(ROOMS, (0, 4000, 8000), strict=True)
            },
            "doors": [
                {"between": [ROOMS[n], ROOMS[n + 1]], "at": [4000 * (n + 1), 2000]} for n in (0, 1)
            ],
            "objects": {
                f"thing-{n}": {
                    "kind": "thing",
                    "home": "room-1",
                    "mass_g": 100,
                    "names": [f"Thing {n}"],
                }
                for n in (1, 2)
            },
            "robots": {
                RID: {
                    "home": "room-1",
                    "profile": {
                        "tools": {kind: sorted(found) for kind, found in tools.items()},
                        "max_speed_mm_s": 100_000,
                        "max_force_mn": 500_000,
                        "max_payload_g": 5_000,
                    },
                }
            },
            "vocabulary": msgspec.to_builtins(WORDS),
        },
        Site,
        where=name,
    )
    assert faults(site) == ()
    return site


def samples(name: str) -> list[tuple[ToolWay, bytes]]:
    """Return the planner's bytes for each way of a shipped binding."""
    sampler = Sampler(lab(name))
    made = []
    for way in ways(shipped(name)):
        call = sampler.call(way)
        assert call is not None, way.place
        made.append((way, call_bytes(call)))
    return made


def granted(name: str, actions: list[Action]) -> Mission:
    """Return a mission that grants exactly these actions, and asks nobody."""
    grants: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for action in actions:
        source = "room-1" if "source" in WORDS[action.type].fields else None
        row = {"object": action.object, "source": source, "destination": action.destination}
        plain = {key: value for key, value in row.items() if value is not None}
        place = (action.type, action.tool, tuple(sorted(action.params)))
        rows = grants.setdefault(place, [])
        if {**plain, "regions": list(ROOMS)} not in rows:
            rows.append({**plain, "regions": list(ROOMS)})
    site = lab(name)
    far = 9_000_000_000
    plain_mission = {
        "schema": "authguard-r/mission/1",
        "mid": f"every-{name}",
        "version": 1,
        "rid": RID,
        "profile": profile_digest(site.robots[RID].profile),
        "site": site_digest(site),
        "issuer": "operator-1",
        "task": "Show every tool once.",
        "actions": [
            {
                "id": f"grant-{n}",
                "type": kind,
                "tool": tool,
                "alternatives": rows,
                "limits": [
                    {
                        "parameter": param,
                        "low": WORDS[kind].params[param].low,
                        "high": WORDS[kind].params[param].high,
                    }
                    for param in params
                ],
                "data": {"record": True, "store": True, "transmit": True},
                "chooser": "planner",
                "repeat": 1_000,
                "starts": 1_000,
                "max_ms": 4_000_000,
                "irreversible": False,
            }
            for n, ((kind, tool, params), rows) in enumerate(grants.items())
        ],
        "objects": ["thing-1", "thing-2"],
        "regions": list(ROOMS),
        "limits": [],
        "guards": [],
        "not_before": to_timestamp(scenarios.START_MS - DAY_MS),
        "expiry": to_timestamp(scenarios.START_MS + DAY_MS),
        "place_max_age_ms": 1_000,
        "nonce": b64(bytes(16)),
        "risk_policy": {
            "otherwise": 0,
            "tau_1": 1_000,
            "tau_2": 2_000,
            "t": 2,
            "roles": ["supervisor"],
            "privacy": 0,
            "valid_ms": 1_000,
        },
        "budgets": {
            "actions": 1_000,
            "rate": {"count": 1_000, "per_ms": 1_000},
            "motion_ms": far,
            "wait_ms": far,
            "recorded_bytes": far,
            "prompts": 0,
            "planner_stops": 0,
        },
        "on_refusal": "hold",
    }
    mission = convert(plain_mission, Mission, where="mission")
    require_schema(mission)
    return mission


def state_for(name: str, way: ToolWay) -> WorldState:
    """Return the world in which the call makes sense: a full hand for what lets go."""
    state = initial_state(lab(name), "room-1")
    state = msgspec.structs.replace(state, things={"thing-1": ("filled-1",)})
    if way.tool.type not in HANDS:
        return state
    held = "thing-1" if way.tool.type in {"pour", "place"} else "thing-2"
    places = {item: place for item, place in state.places.items() if item != held}
    return msgspec.structs.replace(state, holding=held, places=places)


def started(name: str, folder: Path, way: ToolWay, token: bytes) -> Simulation:
    simulation = simulate(
        folder,
        lab(name),
        shipped(name),
        rid=RID,
        start_ms=scenarios.START_MS,
        store=None,
        state=state_for(name, way),
    )
    simulation.gate.management.activate(token)
    return simulation


@pytest.mark.parametrize("name", shipped_names())
def test_every_way_of_a_shipped_binding_is_accepted_and_executed(name: str, tmp_path: Path) -> None:
    folder, site = tmp_path / "trust", lab(name)
    init_folder(
        folder,
        demo_members(site, (RID,)),
        now=datetime.fromtimestamp(scenarios.START_MS / 1000, UTC),
    )
    binder = Binder(site, shipped(name))
    usable = [(way, data) for way, data in samples(name) if not WORDS[way.tool.type].state_writing]
    actions = [
        read_plan(data, binder=binder, dialect=Dialect.JSON).steps[0].action for _, data in usable
    ]
    token = sign_object(granted(name, actions), Tag.MISSION, folder_signer(folder, "operator-1"))
    executed = set()
    for way, data in usable:
        simulation = started(name, folder, way, token)
        try:
            plan = read_plan(data, binder=simulation.binder, dialect=Dialect.JSON)
            report = simulation.gate.enforcer.propose(
                plan.steps[0],
                planner="planner",
                evidence=plan.evidence,
                context=simulation.binder.context(),
            )
        finally:
            simulation.gate.close()
        assert report.judged is not None, (way.place, report.refusal)
        assert report.outcome is Outcome.SUCCEEDED, (
            way.place,
            report.judged.decision.findings,
            report.judged.safety,
            report.reasons,
        )
        assert simulation.robot.trace[-1].action == report.judged.action
        executed.add(way.tool.type)
    assert executed == {way.tool.type for way, _ in usable}


@pytest.mark.parametrize("name", shipped_names())
def test_what_writes_belief_is_refused_before_anything_is_decided(name: str) -> None:
    binder = Binder(lab(name), shipped(name))
    for way, data in samples(name):
        if WORDS[way.tool.type].state_writing:
            with pytest.raises(MalformedError) as caught:
                read_plan(data, binder=binder, dialect=Dialect.JSON)
            assert caught.value.reason is Reason.STATE_WRITING_REFUSED, way.place


@pytest.mark.parametrize("name", shipped_names())
def test_the_call_that_is_dispatched_means_the_action_that_was_judged(name: str) -> None:
    site = lab(name)
    binder, rebuilder = Binder(site, shipped(name)), Rebuilder(site, shipped(name))
    for way, data in samples(name):
        if WORDS[way.tool.type].state_writing:
            continue
        plan = read_plan(data, binder=binder, dialect=Dialect.JSON)
        action = plan.steps[0].action
        again = binder.bind(rebuilder.rebuild(action, tool=way.name))
        assert msgspec.structs.replace(again, source=action.source) == action, way.place
