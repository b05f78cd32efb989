# SPDX-License-Identifier: Apache-2.0
"""Clients of a running gate: `GateClient` waits, `AsyncGateClient` is for an event loop.

`stop_robot` stops the robot by every way there is. Clients hold no authority: the gate
authenticates their user by Unix peer credentials, and signed missions and orders say what it may
do. Spec page: docs/spec/gate-protocol.md#connections
"""

from __future__ import annotations

from authguard_r.client.approvals import shown
from authguard_r.client.asynchronous import AsyncGateClient
from authguard_r.client.blocking import GateClient
from authguard_r.client.stopping import StopEverywhere, stop_robot
from authguard_r.core.approval import ApprovalVerdict
from authguard_r.keys.signer import read_signer
from authguard_r.wire.messages import ClientRole

__all__ = [
    "ApprovalVerdict",
    "AsyncGateClient",
    "ClientRole",
    "GateClient",
    "StopEverywhere",
    "read_signer",
    "shown",
    "stop_robot",
]
