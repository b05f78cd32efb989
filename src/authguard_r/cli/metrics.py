# SPDX-License-Identifier: Apache-2.0
"""`authguard metrics`: a gate's counts as Prometheus reads them, on loopback and nowhere else."""

from __future__ import annotations

from collections.abc import Callable
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated, Any

import typer

from authguard_r.cli.gateway import GateOption, ProofOption, ReadingRole, RoleOption, connected
from authguard_r.cli.inputs import JsonFlag
from authguard_r.wire.output import emit


def metrics_command(
    gate: GateOption = None,
    role: RoleOption = ReadingRole.OPERATOR,
    trust: ProofOption = None,
    listen: Annotated[
        str | None,
        typer.Option("--listen", help="Serve the metrics at 127.0.0.1:PORT."),
    ] = None,
    as_json: JsonFlag = False,
) -> int:
    """Print the metrics of a gate in the Prometheus text format, or serve them on loopback."""
    from authguard_r.operations.exposition import exposition, serve

    read = _reader(gate, role, trust)
    if listen is not None:
        if as_json:
            raise typer.BadParameter("not together with --json", param_hint="--listen")
        serve(*_loopback(listen), read)
        return 0
    metrics = read()
    emit(metrics, exposition(metrics).decode().splitlines(), as_json=as_json)
    return 0


def _reader(
    gate: Path | None, role: ReadingRole, trust: Path | None
) -> Callable[[], dict[str, Any]]:
    def read() -> dict[str, Any]:
        with connected(gate, role, trust) as client:
            return client.metrics()

    return read


def _loopback(text: str) -> tuple[str, int]:
    """Return the address and port to listen at; only the machine itself may reach it."""
    host, _, port = text.rpartition(":")
    try:
        address, number = ip_address(host.strip("[]")), int(port)
    except ValueError as error:
        raise typer.BadParameter("expected 127.0.0.1:PORT", param_hint="--listen") from error
    if not address.is_loopback or address.version != 4 or not 0 <= number <= 65_535:
        raise typer.BadParameter(
            "only loopback, 127.0.0.1:PORT: put a proxy of your own in front to show it elsewhere",
            param_hint="--listen",
        )
    return str(address), number
