# SPDX-License-Identifier: Apache-2.0
"""`authguard robot`: the symbolic robot as a process that obeys its own gate alone."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated

import typer

from authguard_r.cli.inputs import JsonFlag, SiteOption, TrustOption, load_site, require_robot
from authguard_r.core.identifiers import ObjectId, RegionId, RobotId
from authguard_r.keys.trust import read_trust
from authguard_r.sim.robot import Faults, SymbolicRobot
from authguard_r.sim.state import WorldState
from authguard_r.sim.world import initial_state, taken
from authguard_r.site.model import Site
from authguard_r.wire.output import emit

RunOption = Annotated[Path, typer.Option("--gate", help="The gate's run folder.")]
#: What may go wrong, and whether it takes a number.
_FAULTS = {
    "grasp-fails": ("grasp_fails", False),
    "refuses": ("controller_refuses", False),
    "localization-stops": ("localization_stops_ms", True),
    "sensors-stop": ("estimator_dies_ms", True),
    "overspeed": ("overspeed_permille", True),
    "late": ("answers_late_ms", True),
}
_FAULT_HELP = (
    "What goes wrong; may be repeated: `grasp-fails`, `refuses`, `localization-stops=MS`, "
    "`sensors-stop=MS`, `overspeed=PERMILLE`, `late=MS`."
)


def robot_command(
    site: SiteOption,
    robot: Annotated[str, typer.Option("--robot", help="The robot.")],
    run: RunOption,
    trust: TrustOption,
    at: Annotated[
        str | None, typer.Option("--at", help="The region where the robot starts.")
    ] = None,
    holding: Annotated[
        str | None, typer.Option("--holding", help="The object that the robot holds.")
    ] = None,
    drift_to: Annotated[
        str | None, typer.Option("--drift-to", help="Fault: the robot drives to this region.")
    ] = None,
    fault: Annotated[list[str] | None, typer.Option("--fault", help=_FAULT_HELP)] = None,
    ignore_halt: Annotated[
        bool, typer.Option("--ignore-halt", help="Fault: the robot ignores stops.")
    ] = False,
    speed_up: Annotated[
        int, typer.Option("--speed-up", min=1, max=1_000, help="Speed of the simulated clock.")
    ] = 1,
    as_json: JsonFlag = False,
) -> int:
    """Run the simulated robot until SIGTERM. It obeys only a gate that proves its key."""
    from authguard_r.sim.process import run_robot

    model = load_site(site, trust)
    rid = require_robot(model, robot)
    body = SymbolicRobot(
        model,
        rid,
        _world(model, rid, at, holding),
        estimator=None,
        start_ms=time.time_ns() // 1_000_000,
        faults=_faults(model, drift_to, fault or [], ignore_halt),
    )
    read_trust(trust)  # what is missing is said now; each connection reads it anew

    def ready() -> None:
        told = {"ready": True, "robot": rid, "role": "controller"}
        emit(told, [f"ready: {rid} obeys its gate"], as_json=as_json)

    run_robot(body, run, trust=lambda: read_trust(trust), speed_up=speed_up, ready=ready)
    return 0


def _world(site: Site, rid: RobotId, at: str | None, holding: str | None) -> WorldState:
    home = site.robots[rid].home if at is None else RegionId(at)
    if home not in site.regions:
        raise typer.BadParameter(f"the site has no region `{home}`", param_hint="--at")
    state = initial_state(site, home)
    if holding is None:
        return state
    if holding not in state.places:
        raise typer.BadParameter(f"the site has no object `{holding}`", param_hint="--holding")
    return taken(state, ObjectId(holding))


def _faults(site: Site, drift_to: str | None, texts: list[str], ignore_halt: bool) -> Faults:
    if drift_to is not None and drift_to not in site.regions:
        raise typer.BadParameter(f"the site has no region `{drift_to}`", param_hint="--drift-to")
    found: dict[str, int | bool] = {}
    for text in texts:
        name, _, number = text.partition("=")
        field, counts = _FAULTS.get(name, ("", False))
        if not field or counts != (number.isascii() and number.isdecimal()):
            raise typer.BadParameter(f"`{text}` is no fault", param_hint="--fault")
        found[field] = int(number) if counts else True
    return Faults(
        drift_to=None if drift_to is None else RegionId(drift_to),
        ignores_stops=ignore_halt,
        **found,  # type: ignore[arg-type]  # by name and kind from the table above
    )
