# SPDX-License-Identifier: Apache-2.0
"""`authguard run`: a plan on the symbolic robot, every step through both gates."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import msgspec
import typer

from authguard_r.cli.gateway import beside_store, told_of
from authguard_r.cli.inputs import (
    BindingOption,
    JsonFlag,
    NowOption,
    RepairOption,
    SiteOption,
    TokenOption,
    TrustOption,
    WeightOption,
    gate_robot,
    load_site,
    read_context,
    read_input,
    require_robot,
    wall_now,
)
from authguard_r.cli.offline import CounterOption, counter_of
from authguard_r.core.identifiers import Identifier, MissionId, ObjectId, RegionId, RobotId
from authguard_r.normalize.dialects import Dialect
from authguard_r.wire.output import emit

if TYPE_CHECKING:  # loaded when a plan is run
    from authguard_r.cli.run_plan import PlanResult
    from authguard_r.core.quantities import Now
    from authguard_r.normalize.binding import Binding
    from authguard_r.operations.simulation import Simulation
    from authguard_r.safety import SafetyConfig
    from authguard_r.sim.state import WorldState
    from authguard_r.site.model import Site

_ApproverOption = Annotated[
    list[Path] | None,
    typer.Option("--approver", help="An approver's private key: asks for approval; repeatable."),
]
_YesFlag = Annotated[bool, typer.Option("--yes", help="Approve without a question (for scripts).")]
_PlanOption = Annotated[
    list[Path], typer.Option("--plan", help="Planner output; `-`: standard input; repeatable.")
]
_DialectOption = Annotated[Dialect, typer.Option("--dialect", help="The format of the plan.")]
_ContextOption = Annotated[
    Path | None, typer.Option("--context", help="What the planner saw (JSON Lines).")
]
_StoreOption = Annotated[
    Path | None, typer.Option("--store", help="The robot's store (default: a new one).")
]
_SafetyOption = Annotated[
    Path | None, typer.Option("--safety", help="A safety officer's signed configuration.")
]
_RobotOption = Annotated[
    str | None, typer.Option("--robot", help="The robot, if the trust folder has several gates.")
]
_AtOption = Annotated[str | None, typer.Option("--at", help="The region where the robot starts.")]
_HoldingOption = Annotated[
    str | None, typer.Option("--holding", help="The object that the robot holds.")
]
_DriftToOption = Annotated[
    str | None, typer.Option("--drift-to", help="Fault: the robot drives to this region.")
]


def run_command(
    token: TokenOption,
    trust: TrustOption,
    site: SiteOption,
    binding: BindingOption,
    plan: _PlanOption,
    dialect: _DialectOption = (Dialect.AUTO),
    context: _ContextOption = None,
    store: _StoreOption = None,
    safety: _SafetyOption = None,
    robot: _RobotOption = None,
    at: _AtOption = None,
    holding: _HoldingOption = None,
    drift_to: _DriftToOption = None,
    repair: RepairOption = False,
    now: NowOption = None,
    counter: CounterOption = None,
    weight: WeightOption = None,
    approver: _ApproverOption = None,
    yes: _YesFlag = False,
    as_json: JsonFlag = False,
) -> int:
    """Enforce a plan on the simulated robot: decide, check, commit, move, observe, record."""
    from authguard_r.access.files import read_binding
    from authguard_r.cli.run_approvals import approvers
    from authguard_r.cli.run_plan import run_plan

    instant = wall_now(now)
    people = approvers(approver, yes=yes, as_json=as_json)
    model = load_site(site, trust, instant)
    rid = require_robot(model, gate_robot(trust, robot), where="--robot" if robot else "--trust")
    config = None if safety is None else _configured(safety, trust, instant)
    path = store or Path(tempfile.mkdtemp(prefix="authguard-")) / "robot.db"
    simulation = _simulated(
        trust,
        model,
        read_binding(binding, model),
        rid=rid,
        start=instant if now is not None else None,
        store=path,
        state=_world(model, rid, at, holding),
        drift_to=drift_to,
        safety=config,
        counter=counter,
    )
    try:
        _hold(simulation, config)
        mid = _activate(simulation, token)
        ledger = read_context(context, simulation.binder.spellings(), channels=model.channels)
        ask = sys.stdin.isatty() and not as_json
        given = partial(
            run_plan, dialect=dialect, context=ledger, ask=ask, repair=repair, people=people
        )
        runs = [given(simulation, read_input(each)) for each in plan]
        left = () if config is None else _unfulfilled(simulation, config, mid)
        payload = _payload(simulation, runs, path, weight or ())
    finally:
        simulation.gate.close()
    emit({**payload, "rules_open": left}, _lines(runs, path, left), as_json=as_json)
    return max(_code(run) for run in runs)


def _simulated(
    trust: Path,
    site: Site,
    binding: Binding,
    *,
    rid: RobotId,
    start: Now | None,
    store: Path,
    drift_to: str | None,
    counter: Path | None,
    **more: Any,
) -> Simulation:
    """Return the gate over the symbolic robot; without a start, from the store's time on."""
    from authguard_r.operations.simulation import simulate
    from authguard_r.sim.robot import Faults
    from authguard_r.store.clocks import store_clock

    begun = wall_now(None).utc_ms if start is None else start.utc_ms
    faults = Faults(drift_to=RegionId(drift_to) if drift_to else None)
    with told_of(beside_store(store), store):
        known = store_clock(store).wall_ms() if start is None else 0
        return simulate(
            trust,
            site,
            binding,
            rid=rid,
            start_ms=max(begun, known),
            store=store,
            faults=faults,
            counter=counter_of(store, counter),
            **more,
        )


def _configured(path: Path, trust: Path, now: Now) -> SafetyConfig:
    from authguard_r.keys.trust import read_file, read_trust
    from authguard_r.safety import open_config

    return open_config(read_file(path), verifier=read_trust(trust), now=now)


def _hold(simulation: Simulation, given: SafetyConfig | None) -> None:
    """Hold what is in force against what the store has seen (`server.configurations`)."""
    from authguard_r.enforcement.management.configurations import Configuration, ConfiguredPart
    from authguard_r.safety import default_config, safety_digest

    robot = simulation.robot
    config = given or default_config(robot.site, robot.rid)
    parts = {
        ConfiguredPart.BINDING: Configuration(digest=simulation.binder.digest),
        ConfiguredPart.SAFETY: Configuration(digest=safety_digest(config), version=config.version),
    }
    sealed: dict[ConfiguredPart, dict[str, object]] = {ConfiguredPart.SAFETY: {"safety": config}}
    simulation.gate.management.hold_configurations(parts, sealed=sealed)


def _activate(simulation: Simulation, path: Path) -> MissionId:
    """Activate the mission, unless this very version is active already; return which it is."""
    from authguard_r.core.encoding import Tag, decode, digest, unb64
    from authguard_r.core.lifecycle import Status
    from authguard_r.core.mission import Mission
    from authguard_r.core.token import read_token
    from authguard_r.keys.trust import read_file

    token, management = read_file(path), simulation.gate.management
    payload = unb64(read_token(token).payload, where="token.payload")
    mission = decode(payload, Mission, where="mission")
    standing = management.standing(mission.mid)
    known = standing is not None and standing.digest == digest(Tag.MISSION, payload)
    if standing is None or not known or standing.status not in {Status.ACTIVE, Status.CLOSING}:
        management.activate(token)
    return mission.mid


def _unfulfilled(
    simulation: Simulation, config: SafetyConfig, mid: MissionId
) -> tuple[Identifier, ...]:
    """Return the safety rules that do not hold if the mission ends now."""
    from authguard_r.safety import TemporalGate
    from authguard_r.safety.stored_memory import memory_of

    gate = simulation.gate
    remembered = partial(memory_of, standing=gate.management.standing(mid))
    return TemporalGate(config, gate.ledger.peek(remembered)).unfulfilled()


def _world(site: Site, rid: str, at: str | None, holding: str | None) -> WorldState:
    from authguard_r.sim.world import initial_state

    home = RegionId(at) if at is not None else site.robots[rid].home  # type: ignore[index]
    if home not in site.regions:
        raise typer.BadParameter(f"the site has no region `{home}`", param_hint="--at")
    state = initial_state(site, home)
    if holding is None:
        return state
    if holding not in state.places:
        raise typer.BadParameter(f"the site has no object `{holding}`", param_hint="--holding")
    item = ObjectId(holding)
    places = {thing: place for thing, place in state.places.items() if thing != item}
    return msgspec.structs.replace(state, holding=item, places=places)


def _payload(
    simulation: Simulation, runs: list[PlanResult], path: Path, weight: Sequence[str]
) -> dict[str, Any]:
    from authguard_r.authoring.compile.sources import given_weights
    from authguard_r.enforcement.json_views import plan_json, report_json
    from authguard_r.server.wiring import sign_terminal

    terminal = sign_terminal(simulation.gate, simulation.signer)
    anchor = path.with_suffix(".checkpoint")
    anchor.write_bytes(terminal)
    state = simulation.robot.state
    weights = given_weights(weight, where="--weight")
    judged = [report.judged for run in runs for report in run.reports]
    return {
        "steps": [report_json(report) for run in runs for report in run.reports],
        "planned": sum(run.steps for run in runs),
        "deviation": plan_json([item for item in judged if item is not None], weights),
        "alerts": [alert for run in runs for alert in run.alerts],
        "on_refusal": next((run.then for run in runs if run.then is not None), None),
        "smallest_change": next((run.change.draft for run in runs if run.change is not None), None),
        "robot": {"region": state.region, "holding": state.holding},
        "store": str(path),
        "checkpoint": str(anchor),
    }


def _lines(runs: list[PlanResult], path: Path, rules: tuple[Identifier, ...]) -> list[str]:
    from authguard_r.cli.out import report_lines
    from authguard_r.cli.run_approvals import next_step

    lines = [f"rule `{rule}` is not satisfied if the mission ends here" for rule in rules]
    for run in runs:
        for report in run.reports:
            lines += [*report_lines(report), *next_step(report)]
        if run.then is not None:
            left = max(run.steps - len(run.reports), 0)
            lines.append(f"then: {run.then}; {left} further step(s) not tried")
        if run.change is not None:
            lines.append("a signed next version could allow it (--json has it as a draft):")
            lines += [f"  {line}" for line in run.change.adds]
    return [*lines, f"log: {path} (authguard audit verify {path})"]


def _code(run: PlanResult) -> int:
    from authguard_r.cli.out import report_code

    codes = [report_code(report) for report in run.reports]
    if run.steps == 0:
        refusal = run.reports[0].refusal
        return 4 if refusal is not None else 5
    return max(codes)
