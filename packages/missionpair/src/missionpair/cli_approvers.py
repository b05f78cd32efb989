# SPDX-License-Identifier: Apache-2.0
"""`missionpair approvers`: people who answer a gate's requests by a script, for measuring."""

from __future__ import annotations

import sys
from itertools import islice
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from authguard_r.client import GateClient
from authguard_r.keys.signer import folder_signer
from authguard_r.wire.messages import ClientRole
from missionpair.approvers import Policy, Script, read_delay


def approvers_command(
    socket: Annotated[Path, typer.Option("--gate", help="The gate's socket.")],
    trust: Annotated[Path, typer.Option("--trust", help="The demonstration's trust folder.")],
    people: Annotated[list[str], typer.Option("--as", help="Person who answers; repeatable.")],
    delay: Annotated[
        str, typer.Option("--delay", help="fixed:2s, exponential:3s or lognormal:5s,0.8.")
    ] = "fixed:0s",
    seed: Annotated[int, typer.Option("--seed", help="Seed of the delays.")] = 0,
    most_risk: Annotated[
        int, typer.Option("--most-risk", help="Deny requests with a higher risk.")
    ] = 1 << 30,
    count: Annotated[
        int | None, typer.Option("--count", help="End after this number of answers.", min=1)
    ] = None,
    as_json: Annotated[  # noqa: ARG001 - there is no other form, and every command takes it
        bool, typer.Option("--json", help="The output is always JSON: one object for each answer.")
    ] = False,
) -> int:
    """Answer a gate's approval requests by a script; one JSON object for each answer.

    `waited_ms` is the person's time, drawn at random; `machine_us` is the machine's work.
    """
    try:
        drawn = read_delay(delay)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--delay") from error
    signers = {name: folder_signer(trust, name) for name in people}
    with GateClient.connect(socket, role=ClientRole.OPERATOR, client="script") as client:
        policy = Policy(most_risk=most_risk)
        script = Script(client, signers, delay=drawn, seed=seed, policy=policy)
        for answer in islice(script.answers(), count):
            sys.stdout.write(msgspec.json.encode(answer).decode() + "\n")
            sys.stdout.flush()
    return 0
