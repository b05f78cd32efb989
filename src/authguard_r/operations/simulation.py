# SPDX-License-Identifier: Apache-2.0
"""A whole gate over the symbolic robot, in one process and in simulated time."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from msgspec import Struct

from authguard_r.anchoring.counter import Counter
from authguard_r.core.identifiers import RobotId
from authguard_r.core.principals import Signer
from authguard_r.keys.signer import folder_signer, gate_name
from authguard_r.keys.trust import read_trust
from authguard_r.normalize import Binder
from authguard_r.normalize.binding import Binding, binding_digest
from authguard_r.safety import SafetyConfig, default_config, gate_of, safety_digest
from authguard_r.server.wiring import Gate, LogSettings, assemble
from authguard_r.sim.robot import Faults, SymbolicRobot
from authguard_r.sim.state import WorldState
from authguard_r.sim.world import initial_state
from authguard_r.site.model import Site
from authguard_r.store.clocks import SIMULATED, last_epoch
from authguard_r.store.memory import MemoryStore
from authguard_r.store.sqlite import open_store


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
    faults: Faults | Mapping[str, Any] | None = None,
    safety: SafetyConfig | None = None,
    counter: Counter | None = None,
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
        faults: what goes wrong in the world, by the names of `sim.robot.Faults`.
        safety: authentic safety configuration; None takes the profile's own envelope.
        counter: kept outside of the store; None keeps none.

    Raises:
        AuthGuardError: a part is missing, not authentic or not usable.
    """
    robot = SymbolicRobot(
        site,
        rid,
        state or initial_state(site, site.robots[rid].home),
        estimator=folder_signer(folder, f"estimator-{rid}"),
        start_ms=start_ms,
        faults=faults if isinstance(faults, Faults) else Faults(**(faults or {})),
        epoch=1 if store is None else max(start_ms, last_epoch(store) + 1),
    )
    signer = folder_signer(folder, gate_name(rid))
    config = safety or default_config(site, rid)
    genesis: dict[str, object] = {
        "binding": binding_digest(binding),
        "safety": safety_digest(config),
        "clock": SIMULATED,
    }
    gate = assemble(
        trust=read_trust(folder),
        chain=signer.chain,
        site=site,
        safety=gate_of(config),
        controller=robot,
        source=robot,
        clock=robot,
        store=MemoryStore() if store is None else open_store(store),
        log=LogSettings(genesis=genesis, sealed={"safety": config}, counter=counter, signer=signer),
        demo=True,
    )
    binder = Binder(site, binding)
    return Simulation(gate=gate, robot=robot, binder=binder, signer=signer, store=store)
