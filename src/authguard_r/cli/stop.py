# SPDX-License-Identifier: Apache-2.0
"""`authguard stop`: brake and hold, until a controller confirms it."""

from __future__ import annotations

import asyncio
import sys
from contextlib import suppress
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import msgspec
import typer

from authguard_r.cli.gateway import CLIENT, GATE_SOCKET, STOP_SOCKET, GateOption, socket_in
from authguard_r.cli.inputs import JsonFlag
from authguard_r.cli.offline import CounterOption, OfflineStore, offline
from authguard_r.client.stopping import Answers, StopEverywhere, StopReply
from authguard_r.core.errors import EnvironmentFault
from authguard_r.wire.messages import ClientRole
from authguard_r.wire.output import emit


class StoppingRole(StrEnum):
    """What may stop at a stop process, in the order in which a stop without `--role` tries them."""

    OPERATOR = "operator"
    AUDITOR = "auditor"
    PLANNER = "planner"
    ESTIMATOR = "estimator"


def stop_command(
    gate: GateOption = None,
    role: Annotated[
        StoppingRole | None,
        typer.Option("--role", help="The role to stop as (default: the first that you may be)."),
    ] = None,
    why: Annotated[str, typer.Option("--reason", help="A text for the log.")] = "",
    store: Annotated[
        Path | None, typer.Option("--store", help="Record the stop in a store; no gate is called.")
    ] = None,
    trust: Annotated[Path | None, typer.Option("--trust", help="The trust folder.")] = None,
    site: Annotated[Path | None, typer.Option("--site", help="The site model.")] = None,
    robot: Annotated[str | None, typer.Option("--robot", help="The robot, with --store.")] = None,
    counter: CounterOption = None,
    as_json: JsonFlag = False,
) -> int:
    """Stop the robot now, through the gate and through the process that only serves stops.

    The command repeats the stop until one of them confirms that the robot stands; Ctrl-C ends it.
    It ends by itself when a controller does not confirm within 10 s, or when no controller is
    connected for 5 s: exit 5. An operator's stop suspends the active mission until a signed
    `resume`. Without --role, the command uses the first role of operator, auditor, planner and
    estimator that you have. With --store it only records the stop in a store that no gate has
    open.
    """
    if store is not None:
        if gate is not None or trust is None or site is None:
            raise typer.BadParameter("takes --trust and --site, not --gate", param_hint="--store")
        place = OfflineStore(store=store, trust=trust, site=site, robot=robot, counter=counter)
        return _stop_store(place, as_json=as_json)
    roles = [ClientRole(name) for name in (StoppingRole if role is None else (role,))]
    stop = StopEverywhere(_folder(gate), roles=roles, why=why, client=CLIENT)
    told: set[str] = set()
    try:
        reached = asyncio.run(
            stop.confirmed(lambda _: None if as_json else _tell(stop.answers, told))
        )
    except KeyboardInterrupt:
        return _given_up(stop.answers, as_json=as_json)
    except EnvironmentFault as error:
        text = f"NOT STOPPED ({error.message}); use the robot's own emergency stop"
        raise EnvironmentFault(text, reason=error.reason, where=error.where) from error
    said = {**msgspec.to_builtins(reached.answer), "role": str(reached.role)}
    said |= _silent(stop.answers)
    emit(said, _stop_lines(said), as_json=as_json)
    return 0 if said["stopped"] else 5


def _folder(gate: Path | None) -> Path:
    """Return the run folder; the machine's only one has either socket."""
    try:
        return socket_in(gate, STOP_SOCKET).parent
    except EnvironmentFault:
        return socket_in(gate, GATE_SOCKET).parent


def _tell(answers: Answers, told: set[str]) -> None:
    """Say who has not answered, in full once; a text that cannot be printed prevents no stop."""
    line = _waits(answers)
    with suppress(OSError, ValueError, AttributeError):
        sys.stderr.write(line if line not in told else "still not confirmed, trying again\n")
        told.add(line)
        sys.stderr.flush()


def _stop_lines(said: dict[str, Any]) -> list[str]:
    if said.get("stopped") is True:
        line = f"stopped: the robot stands after {said.get('after_ms')} ms"
    elif said.get("controller") is True:
        line = (
            "NOT CONFIRMED: the controller got the stop and did not confirm that the robot stands"
        )
    else:
        line = "NOT CONFIRMED: no controller is connected"
    told = [f"{line}; {_follows(str(said.get('role')))}"]
    return told + [f"{part} did not answer" for part in said.get("silent") or []]


def _follows(role: str) -> str:
    """Return what a stop in a role means for the mission."""
    if role != StoppingRole.OPERATOR:
        article = "an" if role[:1] in "aeiou" else "a"
        return f"recorded as {article} {role}'s stop"
    return (
        "the active mission is suspended until `authguard resume`; a mission that was closing "
        "has ended"
    )


def _waits(answers: Answers) -> str:
    """Return the line that is shown once a second until the stop is confirmed."""
    told = "; ".join(_missing(answers))
    return f"not confirmed yet, trying again (Ctrl-C gives up); {told}\n"


def _missing(answers: Answers) -> list[str]:
    """Return what each part has not done yet, for people."""
    return [f"{part.words}: {_why(one)}" for part, one in answers.items() if not one.has_stopped]


def _why(one: StopReply) -> str:
    """Return why a part has not confirmed the stop."""
    if one.why or one.hangs or one.answer is None:
        return one.why or "it does not answer"
    if one.has_told:
        return "it sent the stop to the controller, which did not confirm that the robot stands"
    return "no controller is connected to it"


def _silent(answers: Answers) -> dict[str, Any]:
    """Return which parts serve and did not answer, if any."""
    silent = [part.words for part, one in answers.items() if one.hangs]
    return {"silent": silent} if silent else {}


def _given_up(answers: Answers, *, as_json: bool) -> int:
    """Say that a person gave up before the stop was confirmed, and who did not answer."""
    told = [one.answer for one in answers.values() if one.answer is not None]
    controller = any(answer.controller for answer in told)
    said = {"stopped": False, "controller": controller, "after_ms": None, "role": None}
    lines = ["NOT CONFIRMED: given up", *_missing(answers)]
    emit({**said, **_silent(answers)}, lines, as_json=as_json)
    return 5


def _stop_store(place: OfflineStore, *, as_json: bool) -> int:
    """Record an operator's stop: the active mission goes on only after a signed `resume`.

    It reaches no robot: the symbolic one lives only while `run` does.
    """
    with offline(place) as gate:
        gate.enforcer.stop(by="operator", is_planner=False, suspends=True)
    line = (
        "no gate answered and no robot was reached: the stop is recorded in the store alone. "
        "The mission continues after `authguard mission resume`"
    )
    emit({"stopped": False, "recorded": True, "by_gate": False}, [line], as_json=as_json)
    return 5
