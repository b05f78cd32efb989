# SPDX-License-Identifier: Apache-2.0
"""The test bench: real keys, real missions, a real gate over the symbolic hospital."""

from __future__ import annotations

import json
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from authguard_r.approvals import Selection, answer
from authguard_r.audit.deviation import Weights
from authguard_r.authoring.compile.build import compile_draft
from authguard_r.authoring.compile.draft import Draft
from authguard_r.authoring.keys.setup import demo_members, init_folder
from authguard_r.core.approval import ApprovalVerdict
from authguard_r.core.encoding import Tag, b64, digest_of
from authguard_r.core.identifiers import GrantId, Identifier, RobotId
from authguard_r.core.lifecycle import Event
from authguard_r.core.mission import Mission
from authguard_r.core.quantities import Now
from authguard_r.core.standing import Standing, advance, issue
from authguard_r.core.token import sign_object
from authguard_r.enforcement.report import Report
from authguard_r.enforcement.signed_orders import Command, Verb
from authguard_r.keys.signer import folder_signer
from authguard_r.normalize import read_plan
from authguard_r.normalize.bind import site_spellings
from authguard_r.normalize.binding import Binding, load_binding
from authguard_r.operations.simulation import Simulation, simulate
from authguard_r.provenance.context import ContextLedger
from authguard_r.provenance.mentions import MentionNames
from authguard_r.safety import SafetyConfig
from authguard_r.sim.example import bundled_hospital
from authguard_r.sim.state import WorldState
from authguard_r.sim.world import initial_state
from authguard_r.site.model import Site
from authguard_r.site.source import convert, read_site, read_text, read_yaml
from authguard_r.store.transactions import Transaction

T = TypeVar("T")

COURIER = RobotId("courier-1")
LIFTER = RobotId("lifter-1")
PLANNER = Identifier("planner")


@dataclass(frozen=True)
class Bench:
    """Keys, site and words that every trial shares.

    Args:
        folder: a demo trust set-up for two robots.
        site: the hospital.
        binding: the planner's tools.
        start_ms: the simulated instant at which every trial begins.
        field_weights: w_j of D_M for the whole campaign; none: as each mission signs them.
    """

    folder: Path
    site: Site
    binding: Binding
    start_ms: int
    field_weights: Weights = field(default_factory=dict)
    _kept: dict[Hashable, Any] = field(default_factory=dict, compare=False, repr=False)

    def kept(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return what is the same in every situation of this bench, made the first time.

        Args:
            key: what it is, and of which robot.
            make: makes it.
        """
        if key not in self._kept:
            self._kept[key] = make()
        found: T = self._kept[key]
        return found

    def draft(self, **changes: Any) -> dict[str, Any]:
        """Return the hospital's mission draft as plain data, with top-level fields replaced."""
        plain = read_yaml(read_text(bundled_hospital() / "mission.yaml"), where="mission.yaml")
        if not isinstance(plain, dict):
            raise TypeError("the hospital's draft is no mapping")
        return {**plain, **changes}

    @cached_property
    def names(self) -> MentionNames:
        """Every spelling of the site, made ready once to be found in texts."""
        return MentionNames(site_spellings(self.site))

    def mission(self, draft: dict[str, Any], *, nonce: str = b64(bytes(16))) -> Mission:
        """Return a draft compiled at the start of the trials."""
        now = Now(self.start_ms, 0)
        compiled = convert(draft, Draft, where="draft")
        return compile_draft(compiled, self.site, now=now, nonce=nonce)

    def sign(self, mission: Mission, by: str = "operator-1") -> bytes:
        """Return the mission signed by a principal."""
        return sign_object(mission, Tag.MISSION, folder_signer(self.folder, by))

    def simulation(
        self,
        *,
        rid: RobotId = COURIER,
        state: WorldState | None = None,
        store: Path | None = None,
        start_ms: int | None = None,
        safety: Callable[[Site, RobotId], SafetyConfig] | None = None,
    ) -> Simulation:
        """Return a fresh gate and robot."""
        return simulate(
            self.folder,
            self.site,
            self.binding,
            rid=rid,
            start_ms=self.start_ms if start_ms is None else start_ms,
            store=store,
            state=state,
            safety=None if safety is None else safety(self.site, rid),
        )


@dataclass
class BenchScene:
    """One prepared situation: what came before is done, the plan is about to arrive.

    Args:
        sim: the gate and its robot.
        mission: the version in force; None when nothing is.
        plan: what the planner writes.
        context: what the planner saw, as channel and text.
        between: what happens after a refusal, before the same plan comes again; benign
            approvals arrive here. None when the plan comes once.
        usable_until_ms: when the issuer's certificates end.
        names: the site's, made ready once for many situations.
    """

    sim: Simulation
    mission: Mission
    plan: bytes
    context: list[tuple[str, str]] = field(default_factory=list)
    between: Callable[[BenchScene], None] | None = None
    usable_until_ms: int = 1 << 52
    names: MentionNames | None = None

    @property
    def digest(self) -> str:
        """The digest of the version in force."""
        return digest_of(Tag.MISSION, self.mission)

    def standing(self) -> Standing | None:
        """Return the registry's entry as it is now."""
        return self.sim.gate.ledger.standing(self.mission.mid)

    def ledger(self) -> ContextLedger:
        """Return the context as the gate keeps it."""
        ledger = ContextLedger(self.names or self.sim.binder.spellings())
        for channel, text in self.context:
            ledger.add(channel, text)
        return ledger


def make_bench(folder: Path, *, begin: datetime | None = None) -> Bench:
    """Return a bench with keys in a new folder; trials begin today at 14:05 UTC."""
    site = read_site(bundled_hospital() / "site.yaml")
    start = begin or datetime.now(UTC).replace(hour=14, minute=5, second=0, microsecond=0)
    init_folder(folder, demo_members(site, (COURIER, LIFTER)), now=start)
    data = read_yaml(read_text(bundled_hospital() / "binding.yaml"), where="binding.yaml")
    binding = load_binding(data, site=site, where="binding.yaml")
    return Bench(folder, site, binding, int(start.timestamp()) * 1000)


def world(bench: Bench, at: str, *, holding: str | None = None) -> WorldState:
    """Return the hospital with the robot somewhere, perhaps with something in its gripper."""
    state = initial_state(bench.site, at)  # type: ignore[arg-type]
    if holding is None:
        return state
    places = {item: place for item, place in state.places.items() if item != holding}
    return msgspec.structs.replace(state, holding=holding, places=places)


def calls(*steps: tuple[str, dict[str, Any]]) -> bytes:
    """Return a plan of tool calls as bare JSON."""
    plan = [{"tool": name, "arguments": arguments} for name, arguments in steps]
    return json.dumps({"plan": plan}).encode()


def propose(scene: BenchScene) -> list[Report]:
    """Send the scene's plan through the whole product, step by step until one is refused."""
    plan = read_plan(scene.plan, binder=scene.sim.binder)
    reports: list[Report] = []
    for step in plan.steps:
        reports.append(
            scene.sim.gate.enforcer.propose(
                step, planner=PLANNER, evidence=plan.evidence, context=scene.ledger()
            )
        )
        if reports[-1].outcome is None:
            break
    return reports


def carry_out(scene: BenchScene, plan: bytes) -> None:
    """Carry out a plan that must succeed: the history of a trial."""
    for report in propose(BenchScene(sim=scene.sim, mission=scene.mission, plan=plan)):
        if str(report.outcome) != "succeeded":
            raise RuntimeError(f"the history of a trial was refused: {report}")


def order(bench: Bench, scene: BenchScene, verb: Verb, *, by: str = "operator-1") -> None:
    """Give a signed order about the scene's mission."""
    command = Command(
        verb=verb,
        mid=scene.mission.mid,
        version=scene.mission.version,
        mission=digest_of(Tag.MISSION, scene.mission),
        nonce=b64(f"{verb}-{scene.sim.robot.elapsed_ms}".encode()),
        expires_ms=scene.sim.robot.wall_ms() + 60_000,
        issued_ms=scene.sim.robot.wall_ms(),
    )
    signed = sign_object(command, Tag.COMMAND, folder_signer(bench.folder, by))
    scene.sim.gate.management.command(signed)


def choose(
    bench: Bench, scene: BenchScene, grant: str, row: int, *, by: str = "operator-1"
) -> None:
    """Give a signed choice of one row."""
    selection = Selection(
        mid=scene.mission.mid,
        version=scene.mission.version,
        mission=digest_of(Tag.MISSION, scene.mission),
        grant=GrantId(grant),
        row=row,
        nonce=b64(f"{grant}-{row}-{scene.sim.robot.elapsed_ms}".encode()),
        expires_ms=scene.sim.robot.wall_ms() + 60_000,
        issued_ms=scene.sim.robot.wall_ms(),
    )
    signed = sign_object(selection, Tag.SELECTION, folder_signer(bench.folder, by))
    scene.sim.gate.management.select(signed)


def approve(
    bench: Bench,
    scene: BenchScene,
    *by: str,
    verdict: ApprovalVerdict = ApprovalVerdict.APPROVE,
    **changes: Any,
) -> None:
    """Answer every open request of the scene's mission, signed by each principal."""
    standing = scene.standing()
    if standing is None:
        return
    verified = scene.sim.gate.ledger.run(scene.sim.gate.enforcer.inputs.active_mission)
    for grant, request in standing.requests.items():
        made = answer(verified, grant, request, rid=scene.sim.robot.rid, verdict=verdict)
        made = msgspec.structs.replace(made, **changes)
        for name in by:
            signed = sign_object(made, Tag.APPROVAL, folder_signer(bench.folder, name))
            scene.sim.gate.management.approve(signed)


def force_in(scene: BenchScene, token: bytes) -> None:
    """Put a mission into a gate's registry past activation, as a thief of its disk could.

    Activation refuses a foreign mission already; the attack is on what comes after.
    """

    def job(act: Transaction) -> None:
        verified = scene.sim.gate.enforcer.inputs.verify_mission(token, act)
        standing = advance(issue(verified), Event.ACTIVATE)
        if standing is None:
            raise RuntimeError("an issued mission could not be activated")
        act.keep_token(verified.digest, token)
        act.hold(standing)
        act.make_active(verified.mission.mid)

    scene.sim.gate.ledger.run(job)
