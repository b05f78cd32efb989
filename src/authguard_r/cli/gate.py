# SPDX-License-Identifier: Apache-2.0
"""`authguard gate`: check the set-up of one robot's gate, then become its process."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated, NoReturn

import typer
from msgspec.structs import replace

from authguard_r.access.files import trusted_site
from authguard_r.cli.inputs import (
    BindingOption,
    JsonFlag,
    RiskPolicyOption,
    SiteOption,
    TrustOption,
    gate_robot,
    require_robot,
)
from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.reasons import Reason
from authguard_r.keys.trust import read_trust
from authguard_r.normalize.interface import shipped_interface
from authguard_r.operations.checkup import GateSetup, require_safe
from authguard_r.server.files import GateFiles, ask, open_parts, parts_digest, start_time

_ConfigOption = Annotated[
    Path, typer.Option("--config", help="The signed gate configuration (`gate-config`).")
]
_StoreOption = Annotated[
    Path, typer.Option("--store", help="The robot's store; created if it does not exist.")
]
_RunOption = Annotated[Path, typer.Option("--gate", help="The run folder, for the sockets.")]
_KeyOption = Annotated[
    Path | None, typer.Option("--key", help="The gate's key (default: the demonstration's).")
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
    typer.Option("--emergency-journal", help="Journal of emergencies (default: beside the store)."),
]
_CounterOption = Annotated[
    Path | None,
    typer.Option("--counter", help="File of the outside counter, on another mount."),
]
_RobotOption = Annotated[str | None, typer.Option("--robot", help="The robot.")]
_DemoOption = Annotated[
    bool, typer.Option("--demo", help="Accept a demonstration root; never on a real robot.")
]
_SimulateOption = Annotated[
    bool,
    typer.Option("--simulate", help="With --demo: simulate the robot in this process."),
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
) -> NoReturn:
    """Run the gate of one robot: its controller, its store and its clients, until SIGTERM.

    Every command to the robot goes through this process. `authguard status` shows its state, and
    `authguard stop` stops the robot even when this process hangs.
    """
    read_trust(trust)
    rid = gate_robot(trust, robot)
    key, cert = _identity(trust, rid, key, cert)
    files = GateFiles(
        robot=rid,
        trust=trust,
        site=site,
        binding=str(binding),
        config=config,
        store=store,
        run=run,
        key=key,
        cert=cert,
        safety=safety,
        risk_policy=risk_policy,
        emergency=emergency,
        emergency_journal=emergency_journal,
        counter=counter,
        demo=demo,
        simulate=simulate,
    )
    become_gate(checked(files), as_json=as_json)


def checked(files: GateFiles) -> GateFiles:
    """Check everything that a gate reads; return its files with the digest of what was checked.

    The gate's process reads the files again and starts only with the same contents.

    Raises:
        BadParameter: an option that cannot be.
        AuthGuardError: a part that cannot be used, or an unsafe set-up.
    """
    trust = read_trust(files.trust)
    now = start_time(files, trust)
    require_robot(trusted_site(files.site, trust, now), files.robot)
    if files.simulate and not (files.demo and trust.demo):
        raise typer.BadParameter(
            "only with --demo and a root that says `demo`", param_hint="--simulate"
        )
    if files.emergency is None and files.emergency_journal is not None:
        raise typer.BadParameter("needs --emergency-policy", param_hint="--emergency-journal")
    parts = open_parts(files)
    _make_run(files.run)
    believed = (files.site, Path(files.binding), files.config)
    signed = (files.safety, files.risk_policy, files.emergency)
    setup = GateSetup(
        demo=files.demo and trust.demo,
        uid=os.geteuid(),
        trust=files.trust,
        key=files.key,
        chain=files.cert,
        site=parts.site,
        binding=parts.binding,
        model=files.site,
        tools=Path(files.binding),
        config=parts.config,
        store=parts.store,
        run=parts.run,
        counter=files.counter,
        journal=files.emergency_journal,
        interface=shipped_interface(files.binding) or (),
        files=(*believed, *(path for path in signed if path is not None)),
    )
    require_safe(setup, now)
    return replace(files, checked=parts_digest(parts))


def become_gate(files: GateFiles, *, as_json: bool) -> NoReturn:
    """Replace this program by the gate's process, which keeps its process id."""
    sys.stdout.flush()
    words = [sys.executable, "-P", "-m", "authguard_r.server.main", ask(files)]
    os.execv(sys.executable, words + ["--json"] * as_json)  # noqa: S606 - our own program


def _make_run(run: Path) -> None:
    """Make the folder for the sockets if it is absent.

    Raises:
        EnvironmentFault: something else is there.
    """
    if run.exists() and not run.is_dir():
        raise EnvironmentFault(
            f"expected a folder for sockets, got `{run}`",
            reason=Reason.FILE_UNAVAILABLE,
            where="--gate",
        )
    run.mkdir(parents=True, exist_ok=True, mode=0o750)


def _identity(trust: Path, rid: str, key: Path | None, cert: Path | None) -> tuple[Path, Path]:
    """Return the files of the gate's key and certificates: those named, or the trust folder's."""
    if (key is None) is not (cert is None):
        raise typer.BadParameter("--key and --cert go together", param_hint="--key")
    name = trust / "keys" / f"gate-{rid}"
    return key or Path(f"{name}.key.pem"), cert or Path(f"{name}.cert.pem")
