# SPDX-License-Identifier: Apache-2.0
"""The wiring: which part stands behind which port. Nothing is decided here.

Everything else receives its parts; this module alone knows them all.
Spec page: docs/explanation/architecture.md
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

from msgspec import Struct

from authguard_r.audit.record import Terminal, read_record
from authguard_r.core.action import Action
from authguard_r.core.encoding import Tag, b64, decode
from authguard_r.core.errors import ControllerError, EnvironmentFault, MalformedError, StoreError
from authguard_r.core.facts import SiteFacts
from authguard_r.core.identifiers import Digest, RobotId
from authguard_r.core.lease import Lease
from authguard_r.core.ports import Clock, Controller, Flight, SafetyGate, Signer, StateSource, Store
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.token import sign_object
from authguard_r.enforcement import Enforcer
from authguard_r.intake import Intake
from authguard_r.keys.certificate import Role
from authguard_r.keys.setup import Member
from authguard_r.keys.signer import FileSigner, read_signer
from authguard_r.keys.trust import Trust, read_trust
from authguard_r.ledger import High, Ledger
from authguard_r.management import Management
from authguard_r.normalize import Binder
from authguard_r.normalize.binding import Binding, binding_digest
from authguard_r.safety import EnvelopeGate, SafetyConfig, default_config, safety_digest
from authguard_r.sim.robot import Faults, SymbolicRobot
from authguard_r.sim.state import WorldState
from authguard_r.sim.world import initial_state
from authguard_r.site.model import Site, facts_of, profile_digest
from authguard_r.store.memory import MemoryStore
from authguard_r.store.sqlite import open_store, read_held, read_rows

#: What the first record of a log with simulated time says of its clock.
SIMULATED = "simulated"


class SystemClock:
    """The machine's clocks (`core.ports.Clock`)."""

    def wall_ms(self) -> int:
        """Return the wall clock."""
        return time.time_ns() // 1_000_000

    def mono_ms(self) -> int:
        """Return the monotonic clock."""
        return time.monotonic_ns() // 1_000_000

    def pause(self, duration_ms: int) -> None:
        """Sleep."""
        time.sleep(duration_ms / 1_000)


class Gate(Struct, frozen=True, kw_only=True):
    """One robot's gate, whole: what a process or a test holds.

    Args:
        enforcer: the road to the controller.
        management: the operator's side.
        ledger: store and trusted time.
        facts: the site and who this gate is.
        trust: who may say what.
    """

    enforcer: Enforcer
    management: Management
    ledger: Ledger
    facts: SiteFacts
    trust: Trust

    def close(self) -> None:
        """Let go of the store."""
        self.ledger.close()


def assemble(
    *,
    trust: Trust,
    chain: tuple[bytes, ...],
    site: Site,
    safety: SafetyGate,
    controller: Controller,
    source: StateSource,
    clock: Clock,
    store: Store,
    genesis: dict[str, object],
    demo: bool = False,
    salts: Callable[[int], bytes] = os.urandom,
) -> Gate:
    """Return the gate made of these parts.

    Args:
        trust: the trust root.
        chain: the gate's own certificate chain: its robot id and profile come from here alone.
        site: the site model; missions bind its digest.
        safety: the second gate.
        controller: the actuators.
        source: the estimator's channel.
        clock: the only source of time.
        store: registry and log.
        genesis: what else the log's first record says.
        demo: take a root that says `demo`; nothing that guards a real robot does.
        salts: randomness for commitments.

    Raises:
        AuthenticityError: the gate's certificate does not hold.
        EnvironmentFault: the site does not know this robot.
        StoreError: the store cannot be used.
    """
    try:
        _require_real(trust, demo=demo)
        rid, profile = trust.gate_identity(chain, Now(clock.wall_ms(), 0))
        facts = facts_of(site, rid=rid, profile=profile)
        first = {"site": facts.digest, "profile": profile, "demo": trust.demo, **genesis}
        ledger = Ledger(store, clock, robot=rid, salts=salts, genesis=first, inputs={"site": site})
    except BaseException:
        store.close()  # it was handed over; a gate that is not made holds nothing
        raise
    intake = Intake(ledger, trust, source=source, facts=facts)
    enforcer = Enforcer(
        ledger, intake, facts=facts, safety=safety, controller=controller, clock=clock
    )
    management = Management(ledger, intake, verifier=trust, facts=facts)
    enforcer.before_first(management.recover)
    return Gate(enforcer=enforcer, management=management, ledger=ledger, facts=facts, trust=trust)


def _require_real(trust: Trust, *, demo: bool) -> None:
    """Refuse a root that says it is for demonstration, unless this is one."""
    if trust.demo and not demo:
        raise EnvironmentFault(
            "the root is for demonstration only: every private key lies in its folder",
            reason=Reason.CERTIFICATE_INVALID,
            where="root",
        )


def sign_terminal(gate: Gate, signer: Signer) -> bytes:
    """Return the signed terminal digest of the log as it is now: its anchor, if kept elsewhere."""
    size, head = gate.ledger.run(lambda act: act.head())
    terminal = Terminal(
        log=gate.facts.robot.rid,
        size=size,
        head=Digest(b64(head)),
        time_ms=gate.ledger.now().utc_ms,
    )
    return sign_object(terminal, Tag.CHECKPOINT, signer)


class Simulation(Struct, frozen=True, kw_only=True):
    """A whole gate on the symbolic robot, with its own simulated time.

    Args:
        gate: the gate.
        robot: the robot: controller, estimator and clock in one.
        binder: turns planner calls into actions.
        signer: the gate's own key, for terminal digests.
        store: the store's file, None when it is in memory.
    """

    gate: Gate
    robot: SymbolicRobot
    binder: Binder
    signer: Signer
    store: Path | None


def simulate(
    folder: Path,
    site: Site,
    binding: Binding,
    *,
    rid: RobotId,
    start_ms: int,
    store: Path | None,
    state: WorldState | None = None,
    faults: Faults | None = None,
    safety: SafetyConfig | None = None,
) -> Simulation:
    """Return a gate over the symbolic robot, with keys from a one-folder demo set-up.

    Args:
        folder: written by `authguard keys init`.
        site: the site.
        binding: the planner's tools.
        rid: the robot.
        start_ms: simulated wall clock at the start.
        store: the store's file; None keeps registry and log in memory.
        state: the world at the start; None puts everything at home.
        faults: what goes wrong in the world.
        safety: authentic safety configuration; None takes the profile's own envelope.

    Raises:
        AuthGuardError: a part is missing, not authentic or not usable.
    """
    trust = read_trust(folder)
    robot = SymbolicRobot(
        site,
        rid,
        state or initial_state(site, site.robots[rid].home),
        estimator=folder_signer(folder, f"estimator-{rid}"),
        start_ms=start_ms,
        faults=faults or Faults(),
        epoch=1 if store is None else time.time_ns() // 1_000_000,
    )
    signer = folder_signer(folder, gate_name(rid))
    config = safety or default_config(site, rid)
    gate = assemble(
        trust=trust,
        chain=signer.chain,
        site=site,
        safety=EnvelopeGate(config),
        controller=robot,
        source=robot,
        clock=robot,
        store=MemoryStore() if store is None else open_store(store),
        genesis={
            "binding": binding_digest(binding),
            "safety": safety_digest(config),
            "clock": SIMULATED,
        },
        demo=True,
    )
    binder = Binder(site, binding)
    return Simulation(gate=gate, robot=robot, binder=binder, signer=signer, store=store)


class _SimulatedSince:
    """A clock for a store whose time is simulated: never behind what was committed there."""

    def __init__(self, high_ms: int) -> None:
        self._high_ms = high_ms
        self._system = SystemClock()

    def wall_ms(self) -> int:
        """Return the wall clock, or the simulated time when that is ahead."""
        return max(self._system.wall_ms(), self._high_ms)

    def mono_ms(self) -> int:
        """Return the monotonic clock."""
        return self._system.mono_ms()

    def pause(self, duration_ms: int) -> None:
        """Sleep."""
        self._system.pause(duration_ms)


def store_clock(store: Path) -> Clock:
    """Return the clock that a store's times were taken from: the machine's, or a simulated one.

    Only a log that says so in its first record has simulated time; `authguard run` writes such.
    """
    if not store.is_file() or store.stat().st_size == 0:
        return SystemClock()
    try:
        first = next(iter(read_rows(store)), None)
        high = read_held(store, "clock", "high")
        if first is None or high is None:
            return SystemClock()
        if read_record(first.record, where="record 0").open.get("clock") != SIMULATED:
            return SystemClock()
        return _SimulatedSince(decode(high, High, where="store.clock").utc_ms)
    except (StoreError, MalformedError):
        return SystemClock()  # opening the store says what is wrong with it


class _NoRobot:
    """Stands where a gate without a robot has its controller and estimator: nothing moves."""

    def latest(self) -> bytes | None:
        """Return nothing: no state is attested."""
        return None

    def dispatch(self, action: Action, lease: Lease) -> Flight:  # noqa: ARG002
        """Refuse: there is no robot here.

        Raises:
            ControllerError: always.
        """
        raise ControllerError("no robot is connected")

    def stop(self) -> None:
        """Do nothing: nothing moves."""


def offline_gate(folder: Path, site: Site, *, rid: RobotId, store: Path) -> Gate:
    """Return a gate without a robot, for management acts on a store that nobody holds.

    Raises:
        AuthGuardError: a part is missing, not authentic, or the store is in use.
    """
    nothing = _NoRobot()
    return assemble(
        trust=read_trust(folder),
        chain=folder_signer(folder, gate_name(rid)).chain,
        site=site,
        safety=EnvelopeGate(default_config(site, rid)),
        controller=nothing,
        source=nothing,
        clock=store_clock(store),
        store=open_store(store),
        genesis={"clock": SIMULATED},  # only a demo folder gets here, and its robot is symbolic
        demo=True,
    )


def demo_members(site: Site, rids: tuple[RobotId, ...]) -> tuple[Member, ...]:
    """Return who gets a key in a one-folder set-up: people, and the machines of each robot."""
    people = (
        Member(id="operator-1", role=Role.OPERATOR),
        Member(id="supervisor-1", role=Role.SUPERVISOR),
        Member(id="supervisor-2", role=Role.SUPERVISOR),
        Member(id="safety-officer-1", role=Role.SAFETY_OFFICER),
        Member(id="site-authority-1", role=Role.SITE_AUTHORITY),
        Member(id="witness-1", role=Role.WITNESS),
    )
    machines: list[Member] = []
    for rid in rids:
        profile = profile_digest(site.robots[rid].profile)
        machines += [
            Member(id=gate_name(rid), role=Role.GATE, robot=rid, profile=profile),
            Member(id=f"estimator-{rid}", role=Role.ESTIMATOR, robot=rid),
        ]
    return (*people, *machines)


def folder_trust(folder: Path) -> Trust:
    """Return the trust root in a folder."""
    return read_trust(folder)


def folder_signer(folder: Path, name: str) -> FileSigner:
    """Return the signer that a one-folder set-up holds for a principal.

    Raises:
        EnvironmentFault: the folder has no such key.
    """
    key = folder / "keys" / f"{name}.key.pem"
    if not key.is_file():
        raise EnvironmentFault(
            f"`{folder}` holds no key of `{name}`",
            reason=Reason.STORE_UNAVAILABLE,
            where=str(key),
        )
    return read_signer(key, folder / "keys" / f"{name}.cert.pem")


def gate_name(rid: RobotId) -> str:
    """Return the name under which a one-folder set-up keeps a robot's gate."""
    return f"gate-{rid}"
