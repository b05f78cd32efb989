# SPDX-License-Identifier: Apache-2.0
"""A gate that is there to be killed: one warm process forks a whole gate for every round.

    crash_worker.py TRUST-FOLDER TOKEN-FILE

Each line on standard input orders one round (`Order` as JSON); the next line, whatever it says,
kills it. On standard output: `ready`, then for each round `born`, what the gate did as it did it
(`moving TICKET`, `acked SEQ OUTCOME`, `covering` and `covered` around a checkpoint), `fault ...`
for what must not happen, and `died SIGNAL`.
"""

from __future__ import annotations

import os
import random
import signal
import sys
from pathlib import Path
from typing import Any

import msgspec

from authguard_r.core.action import Action
from authguard_r.core.encoding import Tag, b64
from authguard_r.core.lease import Lease
from authguard_r.core.lifecycle import Status
from authguard_r.core.ports import GoalHandle
from authguard_r.core.standing import Outcome, Standing
from authguard_r.core.token import sign_object
from authguard_r.enforcement.signed_orders import Command, Verb
from authguard_r.keys.signer import folder_signer
from authguard_r.operations.simulation import Simulation, simulate
from fixtures import scenarios

SCAN = Action(type="scan_obstacles", tool="lidar", params={})
TELL = Action(type="announce", tool="speaker", params={})
#: Nobody granted that: decided, recorded, never released.
DRIVE = scenarios.navigate("dock", "pharmacy")
#: What an operator may say of a release that nobody saw the end of.
RESOLUTIONS = (Outcome.SUCCEEDED, Outcome.FAILED, Outcome.ABORTED, Outcome.NOT_STARTED)


class Order(msgspec.Struct, frozen=True, kw_only=True):
    """One round: which store, when it is, and which dice."""

    store: str
    start_ms: int
    seed: int


def gate(folder: Path, order: Order) -> Simulation:
    """Return the whole gate that the order asks for."""
    return simulate(
        folder,
        scenarios.site(),
        scenarios.binding(),
        rid=scenarios.RID,
        start_ms=order.start_ms,
        store=Path(order.store),
    )


def command(sim: Simulation, folder: Path, standing: Standing, verb: Verb, **more: Any) -> Standing:
    """Carry out one order that the mission's issuer signs on the spot."""
    made = Command(
        verb=verb,
        mid=standing.mid,
        version=standing.version,
        mission=standing.digest,
        nonce=b64(os.urandom(16)),
        expires_ms=sim.robot.wall_ms() + 60_000,
        issued_ms=sim.robot.wall_ms() + 1,
        **more,
    )
    signed = sign_object(made, Tag.COMMAND, folder_signer(folder, "operator-1"))
    return sim.gate.management.command(signed)


def settle(sim: Simulation, folder: Path, dice: random.Random) -> None:
    """Do what an operator does after a crash: recover, resolve, resume."""
    mid = sim.gate.ledger.run(lambda act: act.active())
    assert mid is not None
    tickets = sim.gate.management.recover()
    standing = sim.gate.management.standing(mid)
    assert standing is not None
    for ticket in tickets:
        outcome = dice.choice(RESOLUTIONS)
        standing = command(sim, folder, standing, Verb.RESOLVE, ticket=ticket, outcome=outcome)
    if standing.status is Status.SUSPENDED:
        command(sim, folder, standing, Verb.RESUME)


def say(line: str) -> None:
    """Write one line at once: a killed process has no buffers to flush."""
    os.write(1, f"{line}\n".encode())


def live(folder: Path, token: bytes, order: Order, parent: int) -> None:
    """Run one gate as fast as it goes, until somebody kills it."""
    sim, dice = gate(folder, order), random.Random(order.seed)
    if sim.gate.anchor.why is not None:  # its tree and newest checkpoint are the log's
        say(f"fault {sim.gate.anchor.shown()}")
    begin = sim.robot.dispatch

    def told(action: Action, lease: Lease) -> GoalHandle:
        say(f"moving {lease.ticket}")
        return begin(action, lease)

    sim.robot.dispatch = told  # type: ignore[method-assign, assignment]
    if sim.gate.ledger.run(lambda act: act.active()) is None:
        sim.gate.management.activate(token)
    else:
        settle(sim, folder, dice)
    while os.getppid() == parent:
        report = scenarios.propose(sim, dice.choices((SCAN, TELL, DRIVE), (5, 3, 2))[0])
        if report.refusal is not None or not report.outcome_recorded:
            say(f"fault {report}")
        say(f"acked {report.seq} {'-' if report.outcome is None else report.outcome}")
        if dice.random() < 0.3:
            say("covering")  # a checkpoint of everything, committed in a turn of its own
            if found := sim.gate.anchor.covered(irreversible=True):
                say(f"fault {found}")
            say("covered")


def main(folder: Path, token: bytes) -> None:
    """Fork a gate for every order and kill it when told."""
    here = os.getpid()
    say("ready")
    for line in iter(sys.stdin.readline, ""):
        order = msgspec.json.decode(line, type=Order)
        child = os.fork()
        if child == 0:
            try:
                live(folder, token, order, here)
            except BaseException as error:  # noqa: BLE001 - told to the test, which fails
                say(f"fault {error!r}")
            finally:
                os._exit(1)
        say("born")
        sys.stdin.readline()
        os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        say(f"died {os.WTERMSIG(status)}")


if __name__ == "__main__":
    scenarios.site(), scenarios.binding()  # read once, before the first fork
    main(Path(sys.argv[1]), Path(sys.argv[2]).read_bytes())
