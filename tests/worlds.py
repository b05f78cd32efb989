# SPDX-License-Identifier: Apache-2.0
"""One valid world, built from the shipped hospital; a test changes one thing in it.

Nothing here is a mock: sites, missions, keys and the simulated robot are the product's own.
"""

from __future__ import annotations

import os
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import msgspec

from authguard_r.assembly import Simulation, demo_members, folder_signer, simulate
from authguard_r.compile.build import compile_draft
from authguard_r.compile.draft import Draft
from authguard_r.core.action import Action
from authguard_r.core.encoding import Tag, b64, digest_of
from authguard_r.core.facts import SiteFacts
from authguard_r.core.identifiers import Digest, RobotId
from authguard_r.core.lifecycle import Event
from authguard_r.core.mission import Mission
from authguard_r.core.quantities import Now
from authguard_r.core.standing import Standing, advance, issue
from authguard_r.core.state import AttestedState, Snapshot, attest
from authguard_r.core.token import Principal, Scope, VerifiedMission, index_mission, sign_object
from authguard_r.keys.certificate import Role
from authguard_r.keys.setup import Member, init_folder
from authguard_r.normalize import Step
from authguard_r.normalize.binding import Binding, load_binding
from authguard_r.normalize.context import ContextLedger
from authguard_r.sim.robot import Faults, snapshot_of
from authguard_r.sim.state import WorldState
from authguard_r.sim.world import initial_state
from authguard_r.site.model import Site, facts_of, profile_digest
from authguard_r.site.source import convert, read_site, read_text, read_yaml

ROOT = Path(__file__).resolve().parent.parent
HOSPITAL = ROOT / "examples" / "hospital"
RID = RobotId("courier-1")
OTHER = RobotId("lifter-1")
#: Of a release that no gate made.
TICKET = Digest("t" * 43)
#: A certificate that confines its holder to nothing.
EVERYWHERE = Scope(robots=None, regions=None)
#: The story's instant: today's keys are valid at it, and nothing depends on the real clock.
_BEGIN = datetime.now(UTC).replace(hour=14, minute=5, second=0, microsecond=0)
START_MS = int(_BEGIN.timestamp()) * 1000
NOW = Now(START_MS, 10_000)


@cache
def site() -> Site:
    return read_site(HOSPITAL / "site.yaml")


@cache
def binding() -> Binding:
    path = HOSPITAL / "binding.yaml"
    return load_binding(read_yaml(read_text(path), where="binding"), site=site(), where="binding")


@cache
def facts(rid: RobotId = RID) -> SiteFacts:
    return facts_of(site(), rid=rid, profile=profile_digest(site().robots[rid].profile))


@cache
def trust_folder() -> Path:
    """One demo set-up for the whole test run, with two robots and a second operator."""
    folder = Path(mkdtemp(prefix="authguard-test-")) / "trust"
    members = (
        *demo_members(site(), (RID, OTHER)),
        Member(id="operator-2", role=Role.OPERATOR, robots=None, regions=None),
    )
    init_folder(folder, members, now=datetime.fromtimestamp(START_MS / 1000, UTC))
    return folder


def draft(name: str = "mission.yaml", **changes: Any) -> dict[str, Any]:
    """Return a shipped draft as plain data, with top-level fields replaced."""
    plain = read_yaml(read_text(HOSPITAL / name), where=name)
    assert isinstance(plain, dict)
    return {**plain, **changes}


def mission(name: str = "mission.yaml", **changes: Any) -> Mission:
    """Return the shipped mission, compiled at the story's instant."""
    plain = draft(name, **changes)
    compiled = convert(plain, Draft, where=name)
    return compile_draft(compiled, site(), now=NOW, nonce=b64(bytes(16)))


def token(value: Mission | None = None, *, by: str = "operator-1") -> bytes:
    """Return the mission signed by a principal of the test set-up."""
    return sign_object(value or mission(), Tag.MISSION, folder_signer(trust_folder(), by))


def verified(value: Mission | None = None) -> VerifiedMission:
    """Return a mission as if its token had been verified; for tests of what comes after."""
    opened = value or mission()
    issuer = Principal(
        id=opened.issuer, role="operator", scope=EVERYWHERE, usable_until_ms=START_MS + 10**9
    )
    return index_mission(opened, digest_of(Tag.MISSION, opened), issuer)


def active(value: VerifiedMission) -> Standing:
    """Return the standing of a mission that was just activated."""
    standing = advance(issue(value), Event.ACTIVATE)
    assert standing is not None
    return standing


def world(at: str = "dock", holding: str | None = None) -> WorldState:
    """Return the hospital with the robot somewhere and perhaps something in its gripper."""
    state = initial_state(site(), at)
    if holding is None:
        return state
    places = {item: place for item, place in state.places.items() if item != holding}
    return msgspec.structs.replace(state, holding=holding, places=places)


def state(at: str = "dock", holding: str | None = None, *, rid: RobotId = RID) -> AttestedState:
    """Return what the estimator would attest of that world."""
    return attested(snapshot_of(world(at, holding), robot=rid, epoch=1, seq=1))


def attested(snapshot: Snapshot, *, arrived_mono_ms: int = NOW.mono_ms) -> AttestedState:
    return attest(snapshot, facts(), arrived_mono_ms=arrived_mono_ms)


def navigate(source: str, destination: str, *, speed: int = 500, **changes: Any) -> Action:
    """Return a motion of the courier."""
    fields = {
        "type": "navigate",
        "tool": "base",
        "source": source,
        "destination": destination,
        "params": {"speed_mm_s": speed},
    }
    return Action(**{**fields, **changes})


def simulation(
    *,
    start: WorldState | None = None,
    faults: Faults | None = None,
    store: Path | None = None,
    rid: RobotId = RID,
    start_ms: int = START_MS,
) -> Simulation:
    """Return a whole gate over the symbolic robot, in memory unless a store is named."""
    return simulate(
        trust_folder(),
        site(),
        binding(),
        rid=rid,
        start_ms=start_ms,
        store=store,
        state=start,
        faults=faults,
    )


def propose(sim: Simulation, action: Action, context: ContextLedger | None = None) -> Any:
    """Send one action down the whole road and return the report."""
    ledger = context or ContextLedger(sim.binder.spellings())
    return sim.gate.enforcer.propose(
        Step(action=action, attested=()), planner="planner", evidence=b64(bytes(32)), context=ledger
    )


def random_bytes(count: int) -> bytes:
    return os.urandom(count)
