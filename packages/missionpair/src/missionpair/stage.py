# SPDX-License-Identifier: Apache-2.0
"""A situation of a pair, made real: keys, a gate with its store and log, a robot in its world.

Everything is as an operator, an estimator and a gate would have it, in simulated time that begins
at a fixed instant: two runs of one situation are equal.
How-to: docs/howto/missionpair.md
"""

from __future__ import annotations

import tempfile
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from hashlib import sha256
from pathlib import Path
from time import perf_counter_ns
from types import TracebackType
from typing import Any, Self, TypeVar

import msgspec

from authguard_r.audit.deviation import Weights
from authguard_r.authoring.keys.setup import demo_members, init_folder
from authguard_r.core.action import Action
from authguard_r.core.encoding import Tag, b64, digest_of
from authguard_r.core.errors import AuthGuardError, MalformedError
from authguard_r.core.facts import SiteFacts
from authguard_r.core.identifiers import RobotId
from authguard_r.core.mission import Mission
from authguard_r.core.ports import SafetyGate
from authguard_r.core.quantities import Now
from authguard_r.core.safety import SafetyDecision
from authguard_r.core.standing import Standing
from authguard_r.core.state import AttestedState
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.normalize import Plan, read_plan
from authguard_r.normalize.binding import load_binding
from authguard_r.operations.simulation import Simulation
from authguard_r.provenance.context import ContextLedger
from authguard_r.safety import SafetyConfig
from authguard_r.sim.state import WorldState
from authguard_r.sim.world import initial_state, taken
from authguard_r.site.model import Site, profile_digest
from authguard_r.site.source import convert
from missionpair.bench import Bench, BenchScene, approve, choose, force_in, order, propose
from missionpair.memento import Memento
from missionpair.pair import Input, Layout, Pair, PriorAct, Scenario, Start, WordedCall, plan_bytes
from missionpair.words import GATE_CHANNELS

T = TypeVar("T")

#: When every situation begins.
BEGIN = datetime(2026, 1, 15, 14, 5, tzinfo=UTC)
#: Compiled missions, benches and prepared situations that are kept at most.
_MOST_MISSIONS, _MOST_BENCHES = 512, 64


class StageError(Exception):
    """A situation that cannot be made: its pair is at fault.

    Args:
        where: the pair, and the part of it.
        message: what happened there.
    """

    def __init__(self, message: str, *, where: str) -> None:
        super().__init__(f"{where}: {message}")
        self.where = where
        self.message = message

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how another process makes it again."""
        return partial(StageError, where=self.where), (self.message,)


class _Timed:
    """The second gate with a watch beside it: what it says is what it says without one."""

    def __init__(self, gate: SafetyGate, took: list[int]) -> None:
        self.gate, self._took = gate, took

    def recall(self, memory: bytes) -> SafetyGate:
        """Return the gate as of this memory, timed."""
        at = perf_counter_ns()
        recalled = self.gate.recall(memory)
        self._took[0] += perf_counter_ns() - at
        return self if recalled is self.gate else _Timed(recalled, self._took)

    def assess(
        self, action: Action, state: AttestedState | None, facts: SiteFacts, now: Now
    ) -> SafetyDecision:
        """Return the gate's verdict."""
        at = perf_counter_ns()
        decided = self.gate.assess(action, state, facts, now)
        self._took[0] += perf_counter_ns() - at
        return decided


@dataclass
class Stage:
    """One prepared situation.

    Args:
        bench: its site, binding and keys.
        pair: what is tried.
        scenario: which situation of the pair.
        scene: gate and robot, and the mission in force.
        missions: every mission of the pair that was compiled here, by key.
        inputs: what reached the planner.
        approvers: the people who answer requests.
        walk: how far plans went past the gate (`judging.Walk`); None: nowhere yet.
        safety_took: nanoseconds that the second gate took so far, in a list of one.
        checked: bytes, and what the judge said of them at the mark (`judging.check_first`).
        asked: what the attack asks for here (`judging.asked`); None until the first plan is judged.
        reference: a mission, and the oracle with it (`judging.reference`).
    """

    bench: Bench
    pair: Pair
    scenario: Scenario
    scene: BenchScene
    missions: dict[str, Mission] = field(default_factory=dict)
    inputs: tuple[Input, ...] = ()
    approvers: tuple[str, ...] = ()
    walk: Any = None
    safety_took: list[int] = field(default_factory=lambda: [0])
    checked: tuple[bytes, Any] | None = None
    asked: Any = None
    reference: tuple[Mission, Any] | None = None
    _read: tuple[bytes, Plan | MalformedError] | None = None
    _context: ContextLedger | None = None
    _mark: Memento | None = None

    @property
    def sim(self) -> Simulation:
        """The gate and its robot."""
        return self.scene.sim

    @property
    def safety_gate(self) -> SafetyGate:
        """The second gate, without its watch."""
        found = self.sim.gate.safety
        return found.gate if isinstance(found, _Timed) else found

    def read(self, raw: bytes) -> Plan:
        """Return what a planner's bytes mean to the normalizer; the last answer is kept.

        Raises:
            MalformedError: they mean nothing to it.
        """
        if self._read is None or self._read[0] != raw:
            try:
                self._read = (raw, read_plan(raw, binder=self.sim.binder))
            except MalformedError as error:
                self._read = (raw, error)
        found = self._read[1]
        if isinstance(found, MalformedError):
            raise found
        return found

    @property
    def field_weights(self) -> Weights:
        """The w_j of D_M: the campaign's, else those that the mission in force signs."""
        return self.bench.field_weights or self.scene.mission.risk_policy.field_weights

    def standing(self) -> Standing | None:
        """Return the registry's entry of the mission in force, as it is now."""
        return self.scene.standing()

    def context(self) -> ContextLedger:
        """Return the inputs as the gate keeps them, labeled by their channels."""
        if self._context is None:
            self._context = ContextLedger(self.bench.names)
            for item in self.inputs:
                self._context.add(GATE_CHANNELS[item.channel], item.text)
        return self._context

    def show(self, inputs: tuple[Input, ...]) -> None:
        """Let other inputs reach the planner, instead of those before."""
        if inputs != self.inputs:
            self.inputs, self._context = inputs, None

    def mark(self) -> None:
        """Keep how everything is now, for `again`: with what is verified once for all of them."""
        with suppress(AuthGuardError):
            gate = self.sim.gate
            gate.ledger.run(gate.enforcer.inputs.active_mission)
            gate.enforcer.inputs.refresh()
        self._mark, self.checked, self.asked = Memento(self.sim.gate, self.sim.robot), None, None

    def again(self) -> None:
        """Put gate, store, log and world back to where they were marked."""
        self.walk = None
        if self._mark is not None:
            self._mark.restore()

    def act(self, acts: tuple[PriorAct, ...]) -> None:
        """Do what happens here before the planner is asked, or what authorizes its plan.

        Raises:
            StageError: it cannot be done here.
        """
        for number, item in enumerate(acts):
            try:
                _ACTS[item.do](self, item)
            except (AuthGuardError, KeyError, ValueError, TypeError) as error:
                where = f"{self.pair.id}: {item.do} ({number})"
                raise StageError(f"{type(error).__name__}: {error}", where=where) from error

    def mission(self, key: str) -> Mission:
        """Return a mission of the pair, compiled; a later version supersedes what is in force."""
        if key not in self.missions:
            draft = self.pair.missions[key]
            if int(draft.get("version", 1)) > 1:
                draft = {**draft, "supersedes": digest_of(Tag.MISSION, self.scene.mission)}
            self.missions[key] = self.bench.mission(draft, nonce=_nonce(self.pair.id, key))
        return self.missions[key]


def done_by(action: Action) -> tuple[object, ...]:
    """Return what an action does, however much of it: type, tool, thing, place and way."""
    return action.type, action.tool, action.object, action.destination, action.route


class Yard:
    """Where situations are made: keys of robots are made once, missions compiled once.

    Args:
        folder: for the keys; None makes a temporary one that goes with the yard.
        safety: a safety configuration for a bench's robot; None takes the profile's envelope.
        field_weights: w_j of D_M; none: as each mission signs them.
    """

    def __init__(
        self,
        folder: Path | None = None,
        *,
        safety: Callable[[Site, RobotId], SafetyConfig] | None = None,
        field_weights: Weights = {},  # noqa: B006 - it is only read
    ) -> None:
        self._own = None if folder else tempfile.TemporaryDirectory(prefix="missionpair-")
        self._folder = folder or Path(self._own.name if self._own else "")
        self._keys: dict[str, Path] = {}
        self._benches: OrderedDict[str, Bench] = OrderedDict()
        self.safety = safety
        self._field_weights = field_weights

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Remove the keys."""
        if self._own is not None:
            self._own.cleanup()

    def bench(self, layout: Layout) -> Bench:
        """Return the bench over a layout, with keys for its robots.

        Raises:
            StageError: the layout's site or binding is not one.
        """
        return _kept(self._benches, layout.id, _MOST_BENCHES, lambda: self._bench(layout))

    def stage(
        self,
        pair: Pair,
        layout: Layout,
        scenario: Scenario,
        *,
        store: Path | None = None,
        safety_gate: SafetyGate | None = None,
    ) -> Stage:
        """Return a situation, prepared: what comes first is done, the plan is about to arrive.

        Args:
            pair: whose situation.
            layout: the pair's.
            scenario: one of the pair's.
            store: the gate's store; None keeps it in memory.
            safety_gate: stands in the place of the product's second gate; None leaves that.

        Raises:
            StageError: the pair cannot be made real.
        """
        bench = self.bench(layout)
        try:
            state = _world(bench.site, scenario)
            sim = bench.simulation(
                rid=RobotId(scenario.robot), state=state, store=store, safety=self.safety
            )
            first = next(iter(pair.missions))
            mission = bench.mission(pair.missions[first], nonce=_nonce(pair.id, first))
        except (AuthGuardError, KeyError) as error:
            where = f"{pair.id}: {scenario.robot}"
            raise StageError(f"{type(error).__name__}: {error}", where=where) from error
        took = [0]
        sim = _with_gate(sim, _Timed(safety_gate or sim.gate.safety, took))
        scene = BenchScene(sim=sim, mission=mission, plan=b"", names=bench.names)
        made = Stage(bench, pair, scenario, scene, {first: mission}, safety_took=took)
        made.approvers = scenario.approvers
        made.act(scenario.before)
        made.mark()
        return made

    def _bench(self, layout: Layout) -> Bench:
        try:
            site = convert(layout.site, Site, where="site")
            binding = load_binding(layout.binding, site=site, where="binding")
        except AuthGuardError as error:
            raise StageError(str(error), where=f"layout {layout.id}") from error
        begin = int(BEGIN.timestamp()) * 1_000
        keys = self._keys_for(site)
        return Bench(keys, site, binding, begin, field_weights=self._field_weights)

    def _keys_for(self, site: Site) -> Path:
        """Return the folder with the keys of robots that are called and made like these."""
        robots = {rid: profile_digest(robot.profile) for rid, robot in site.robots.items()}
        name = sha256(msgspec.json.encode(sorted(robots.items()))).hexdigest()[:16]
        if name not in self._keys:
            folder = self._folder / name
            if not folder.exists():
                init_folder(folder, demo_members(site, tuple(site.robots)), now=BEGIN)
            self._keys[name] = folder
        return self._keys[name]


def _with_gate(sim: Simulation, safety: SafetyGate) -> Simulation:
    """Return the simulation with another second gate, as an assembler of a gate could put it in.

    This is the attacker's side of the house; no configuration of the product does it.
    """
    sim.gate.enforcer._safety = safety  # noqa: SLF001
    return msgspec.structs.replace(sim, gate=msgspec.structs.replace(sim.gate, safety=safety))


def _world(site: Site, scenario: Scenario) -> WorldState:
    start: Start = scenario.start
    home = site.robots[RobotId(scenario.robot)].home
    charge = {"battery_permille": start.battery} if start.battery else {}
    state = initial_state(site, site_region(site, start.at) if start.at else home, **charge)
    if start.places:
        state = msgspec.structs.replace(state, places={**state.places, **start.places})
    return taken(state, start.holding) if start.holding else state  # type: ignore[arg-type]


def site_region(site: Site, name: str) -> Any:
    """Return a region's id, which is known to the site.

    Raises:
        KeyError: it is not.
    """
    if name not in site.regions:
        raise KeyError(name)
    return name


def _nonce(pair: str, key: str) -> str:
    return b64(sha256(f"{pair} {key}".encode()).digest()[:16])


def _kept(held: OrderedDict[str, T], key: str, most: int, made: Callable[[], T]) -> T:
    """Return what is held under a key, made when it is not; the oldest goes when it is full."""
    if key not in held:
        held[key] = made()
        if len(held) > most:
            held.popitem(last=False)
    held.move_to_end(key)
    return held[key]


# what can happen


def _activate(stage: Stage, item: PriorAct) -> None:
    mission = stage.mission(item.mission or next(iter(stage.pair.missions)))
    by = item.by[0] if item.by else mission.issuer
    stage.sim.gate.management.activate(stage.bench.sign(mission, by))
    stage.scene.mission = mission


def _force(stage: Stage, item: PriorAct) -> None:
    mission = stage.mission(item.mission or next(iter(stage.pair.missions)))
    force_in(stage.scene, stage.bench.sign(mission, mission.issuer))
    stage.scene.mission = mission


def _run(stage: Stage, item: PriorAct) -> None:
    reports = _proposed(stage, item.calls)
    ended = [str(report.outcome) for report in reports]
    if ended != ["succeeded"] * len(item.calls):
        last = reports[-1] if reports else None
        why = last.refusal or (last.judged and last.judged.decision.reasons) if last else "nothing"
        raise ValueError(f"step {len(reports)} of {len(item.calls)} did not succeed: {why}")


def _propose(stage: Stage, item: PriorAct) -> None:
    _proposed(stage, item.calls)


def _proposed(stage: Stage, calls: tuple[WordedCall, ...]) -> list[Any]:
    stage.scene.plan = plan_bytes(calls)
    reports = propose(stage.scene)
    stage.scene.plan = b""
    return reports


def _approve(stage: Stage, item: PriorAct) -> None:
    approve(stage.bench, stage.scene, *item.by)


def _choose(stage: Stage, item: PriorAct) -> None:
    choose(stage.bench, stage.scene, item.grant, item.row, by=item.by[0])


def _order(stage: Stage, item: PriorAct) -> None:
    order(stage.bench, stage.scene, Verb(item.verb), by=item.by[0])


def _wait(stage: Stage, item: PriorAct) -> None:
    stage.sim.robot.pause(item.ms)


_ACTS: dict[str, Callable[[Stage, PriorAct], None]] = {
    "activate": _activate,
    "force": _force,
    "run": _run,
    "propose": _propose,
    "approve": _approve,
    "choose": _choose,
    "order": _order,
    "wait": _wait,
}
