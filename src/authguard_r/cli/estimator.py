# SPDX-License-Identifier: Apache-2.0
"""`authguard estimator`: signs what the symbolic robot's sensors say, for its gate."""

from __future__ import annotations

from typing import Annotated

import typer

from authguard_r.cli.inputs import JsonFlag, TrustOption, wall_now
from authguard_r.cli.robot import RunOption
from authguard_r.cli.signing_key import (
    CertOption,
    KeyOption,
    PassphraseFile,
    certificate_of,
    open_signer,
)
from authguard_r.core.identifiers import RobotId, is_identifier
from authguard_r.keys.key_access import require_estimator
from authguard_r.keys.trust import read_trust
from authguard_r.wire.output import emit


def estimator_command(
    robot: Annotated[str, typer.Option("--robot", help="The robot.")],
    run: RunOption,
    trust: TrustOption,
    key: KeyOption,
    cert: CertOption = None,
    passphrase_file: PassphraseFile = None,
    rate: Annotated[
        int, typer.Option("--rate", min=1, max=200, help="Snapshots in one second, at most.")
    ] = 20,
    as_json: JsonFlag = False,
) -> int:
    """Sign the robot's sensor values and send them to its gate until SIGTERM."""
    from authguard_r.sim.estimator import run_estimator

    if not is_identifier(robot):
        raise typer.BadParameter("expected an identifier", param_hint="--robot")
    rid = RobotId(robot)
    cert = certificate_of(key, cert)
    signer = open_signer(key, cert, passphrase_file)
    require_estimator(signer, read_trust(trust), rid, wall_now(None), where=cert)

    def ready() -> None:
        told = {"ready": True, "robot": rid, "role": "estimator"}
        emit(told, [f"ready: the gate of {rid} takes snapshots"], as_json=as_json)

    run_estimator(rid, signer, run, trust=lambda: read_trust(trust), rate_hz=rate, ready=ready)
    return 0
