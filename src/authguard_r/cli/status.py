# SPDX-License-Identifier: Apache-2.0
"""`authguard status`: a gate's state, with what needs an answer first."""

from __future__ import annotations

from authguard_r.authoring.compile.request import headlines
from authguard_r.cli.gateway import (
    GateOption,
    ProofOption,
    ReadingRole,
    RoleOption,
    connected,
)
from authguard_r.cli.inputs import JsonFlag
from authguard_r.cli.status_lines import has_requests, status_lines
from authguard_r.wire.output import emit


def status_command(
    gate: GateOption = None,
    role: RoleOption = ReadingRole.OPERATOR,
    trust: ProofOption = None,
    as_json: JsonFlag = False,
) -> int:
    """Show what needs an answer first, then the robot, the mission and the connected clients."""
    with connected(gate, role, trust) as client:
        status = client.status()
        requests = headlines(client.approvals()) if has_requests(status) else ()
    emit(status, status_lines(status, requests), as_json=as_json)
    return 0
