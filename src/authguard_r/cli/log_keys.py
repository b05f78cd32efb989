# SPDX-License-Identifier: Apache-2.0
"""`authguard audit key`: the public keys that a stranger verifies a robot's log with."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from authguard_r.audit.note import NoteKey
from authguard_r.cli.inputs import JsonFlag, TrustOption, gate_robot, wall_now
from authguard_r.core.identifiers import RobotId
from authguard_r.keys.notes import gate_keys
from authguard_r.keys.trust import ROOT_LISTS, read_certificates, read_trust
from authguard_r.wire.output import emit


def key_command(
    trust: TrustOption,
    robot: Annotated[
        str | None,
        typer.Option("--robot", help="The robot, if the trust folder has several gates."),
    ] = None,
    cert: Annotated[
        Path | None,
        typer.Option("--cert", help="The gate's certificate, if it is not in the trust folder."),
    ] = None,
    as_json: JsonFlag = False,
) -> int:
    """Print the keys that verify a robot's log, for `audit verify --log-key` on another machine.

    A set-up with two roots has two keys, and every checkpoint has both signatures.
    """
    rid = gate_robot(trust, robot)
    keys = [key.text() for key in keys_of(trust, rid, cert=cert)]
    emit({"robot": rid, "keys": keys}, keys, as_json=as_json)
    return 0


def keys_of(trust: Path, robot: RobotId, *, cert: Path | None = None) -> tuple[NoteKey, ...]:
    """Return the keys of a robot's log, from its gate's certificate.

    Raises:
        EnvironmentFault: there is no certificate.
        AuthenticityError: it does not hold now, or is another's.
    """
    path = cert or trust / "keys" / f"gate-{robot}.cert.pem"
    found = read_certificates(path, most=2 * len(ROOT_LISTS))
    return gate_keys(found, robot=robot, trust=read_trust(trust), now=wall_now(None))
