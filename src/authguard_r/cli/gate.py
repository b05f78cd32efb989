# SPDX-License-Identifier: Apache-2.0
"""`authguard gate`: the one process that holds a robot's controller and store."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from authguard_r.access.gate_config import GateConfig, open_gate_config
from authguard_r.anchoring.anchor import read_counter
from authguard_r.anchoring.counter import Counter, FileCounter
from authguard_r.cli.inputs import (
    BindingOption,
    JsonFlag,
    RiskPolicyOption,
    SiteOption,
    TrustOption,
    gate_robot,
    load_site,
    read_binding,
    read_risk_policy,
    wall_now,
)
from authguard_r.cli.out import emit
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.identifiers import RobotId
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.enforcement.emergency.opened import open_emergency
from authguard_r.estop.files import EStopFiles
from authguard_r.keys.clock_floor import boot_ms, token_ms
from authguard_r.keys.signer import FileSigner, folder_signer, read_signer
from authguard_r.keys.trust import Trust, read_file, read_trust
from authguard_r.normalize.shipped import shipped_interface
from authguard_r.operations.checkup import GateSetup, require_safe
from authguard_r.safety import SafetyConfig, default_config, open_config
from authguard_r.server.parts import EmergencyParts, GateParts, SimulatedRobot
from authguard_r.server.process import Rendezvous, run_gate
from authguard_r.site.model import Site
from authguard_r.store.clocks import committed_ms

_ConfigOption = Annotated[
    Path, typer.Option("--config", help="The signed gate configuration (`gate-config`).")
]
_StoreOption = Annotated[Path, typer.Option("--store", help="The robot's store; made if absent.")]
_RunOption = Annotated[Path, typer.Option("--run", help="The run folder, for the sockets.")]
_KeyOption = Annotated[
    Path | None, typer.Option("--key", help="The gate's key (default: the demo folder's).")
]
_CertOption = Annotated[Path | None, typer.Option("--cert", help="The gate's certificates.")]
_SafetyOption = Annotated[
    Path | None, typer.Option("--safety", help="A safety officer's signed configuration.")
]
_EmergencyOption = Annotated[
    Path | None,
    typer.Option("--emergency-policy", help="A safety officer's signed emergency policy."),
]
_EmergencyJournalOption = Annotated[
    Path | None,
    typer.Option("--emergency-journal", help="Its journal (default: beside the store)."),
]
_CounterOption = Annotated[
    Path | None,
    typer.Option("--counter", help="The outside counter's file, on another mount."),
]
_RobotOption = Annotated[str | None, typer.Option("--robot", help="Which robot's gate.")]
_DemoOption = Annotated[
    bool, typer.Option("--demo", help="Take a root that says `demo`; never on a real robot.")
]
_SimulateOption = Annotated[
    bool,
    typer.Option("--simulate", help="With --demo: a symbolic robot inside, in its own time."),
]


def gate_command(
    trust: TrustOption,
    site: SiteOption,
    binding: BindingOption,
    config: _ConfigOption,
    store: _StoreOption,
    run: _RunOption,
    key: _KeyOption = None,
    cert: _CertOption = None,
    safety: _SafetyOption = None,
    risk_policy: RiskPolicyOption = None,
    emergency: _EmergencyOption = None,
    emergency_journal: _EmergencyJournalOption = None,
    counter: _CounterOption = None,
    robot: _RobotOption = None,
    demo: _DemoOption = False,
    simulate: _SimulateOption = False,
    as_json: JsonFlag = False,
) -> int:
    """Hold one robot's controller and store, and serve its clients until SIGTERM.

    Everything that reaches the robot goes through this process. `authguard status` looks at it,
    `authguard stop` stops the robot whatever this process does.
    """
    anchor, kept = read_trust(trust), None if counter is None else FileCounter(counter)
    model = load_site(site, anchor, now := _boot(anchor, store, kept, config))
    rid = _possible(model, gate_robot(trust, robot), simulate=simulate, demo=demo and anchor.demo)
    key, cert, signer = _identity(trust, rid, key, cert)
    signed = open_gate_config(read_file(config), verifier=anchor, now=now, robot=rid)
    setup = GateSetup(
        demo=demo and anchor.demo,
        uid=os.geteuid(),
        trust=trust,
        key=key,
        chain=cert,
        site=model,
        binding=(tools := read_binding(binding, model)),
        model=site,
        tools=binding,
        config=signed,
        store=store,
        run=make_run(run),
        counter=counter,
        journal=emergency_journal,
        interface=shipped_interface(str(binding)) or (),
        files=(site, binding, config, *filter(None, (safety, risk_policy, emergency))),
    )
    require_safe(setup, now)
    files = EStopFiles(run=run, robot=rid, trust=trust, key=key, cert=cert, config=config)
    parts = GateParts(
        emergency=_emergency((emergency, emergency_journal), anchor, model, rid=rid, now=now),
        run=run,
        trust=anchor,
        signer=signer,
        site=model,
        binding=tools,
        safety=_safety(safety, anchor, model, rid=rid, now=now),
        config=signed,
        store=store,
        lane=None if simulate else files,
        journal=sys.stderr.fileno(),
        demo=demo,
        key=key,
        simulated=_symbolic(trust, model, rid) if simulate else None,
        risk=read_risk_policy(risk_policy, anchor, now),
        counter=kept,
    )
    run_gate(parts, lambda told: _ready(told, signed, as_json=as_json))
    return 0


def _boot(trust: Trust, store: Path, counter: Counter | None, config: Path) -> Now:
    """Return the machine's clock; where it has none yet, the latest time that is known to be over.

    The gate then serves stops, and refuses the rest until somebody sets the clock.
    """
    wall, counted = wall_now(None).utc_ms, read_counter(counter, verifier=trust)
    known_ms = (committed_ms(store), counted.time_ms, token_ms(read_file(config)))
    return Now(boot_ms(wall, trust, *known_ms), 0)


def _possible(site: Site, rid: RobotId, *, simulate: bool, demo: bool) -> RobotId:
    """Return the robot, if the site knows it and it may be tried out as it was asked for."""
    if rid not in site.robots:
        raise typer.BadParameter(f"the site has no robot `{rid}`", param_hint="--robot")
    if simulate and not demo:
        raise typer.BadParameter(
            "only with --demo and a root that says `demo`", param_hint="--simulate"
        )
    return rid


def make_run(run: Path) -> Path:
    """Return the folder for the sockets, made if it was absent.

    Raises:
        EnvironmentFault: something else is there.
    """
    if run.exists() and not run.is_dir():
        raise EnvironmentFault(
            f"expected a folder for sockets, got `{run}`",
            reason=Reason.STORE_UNAVAILABLE,
            where="--run",
        )
    run.mkdir(parents=True, exist_ok=True, mode=0o750)
    return run


def _identity(
    trust: Path, rid: RobotId, key: Path | None, cert: Path | None
) -> tuple[Path, Path, FileSigner]:
    """Return the gate's key and certificates, those named or the demo folder's, and both read."""
    if (key is None) is not (cert is None):
        raise typer.BadParameter("--key and --cert go together", param_hint="--key")
    name = trust / "keys" / f"gate-{rid}"
    key, cert = key or Path(f"{name}.key.pem"), cert or Path(f"{name}.cert.pem")
    return key, cert, read_signer(key, cert)


def _safety(path: Path | None, trust: Trust, site: Site, *, rid: RobotId, now: Now) -> SafetyConfig:
    """Return the signed configuration; without one, the profile's envelope beside a demo root."""
    if path is not None:
        return open_config(read_file(path), verifier=trust, now=now)
    if not trust.demo:
        raise EnvironmentFault(
            "expected a safety officer's signed configuration outside demonstration",
            reason=Reason.SIGNATURE_INVALID,
            where="--safety",
        )
    return default_config(site, rid)


def _emergency(
    paths: tuple[Path | None, Path | None], trust: Trust, site: Site, *, rid: RobotId, now: Now
) -> EmergencyParts | None:
    """Return the signed policy and where its journal is; without one only stops need no mission."""
    path, journal = paths
    if path is None and journal is not None:
        raise typer.BadParameter("needs --emergency-policy", param_hint="--emergency-journal")
    if path is None:
        return None
    opened = open_emergency(read_file(path), verifier=trust, now=now, site=site, robot=rid)
    return EmergencyParts(policy=opened, journal=journal)


def _symbolic(trust: Path, site: Site, rid: RobotId) -> SimulatedRobot:
    from authguard_r.sim.robot import SymbolicRobot
    from authguard_r.sim.world import initial_state

    now = wall_now(None).utc_ms
    return SymbolicRobot(
        site,
        rid,
        initial_state(site, site.robots[rid].home),
        estimator=folder_signer(trust, f"estimator-{rid}"),
        start_ms=now,
        epoch=now,
    )


def _ready(told: Rendezvous, config: GateConfig, *, as_json: bool) -> None:
    shadow = "; SHADOW MODE: nothing is released" if config.mode == "shadow" else ""
    line = f"{told.robot}: serving at {told.socket} (pid {told.pid}){shadow}"
    payload = {"ready": True, "mode": str(config.mode), **msgspec.to_builtins(told)}
    emit(payload, [line], as_json=as_json)
