# SPDX-License-Identifier: Apache-2.0
"""Clients of a running gate: `GateClient` waits, `AsyncGateClient` is for an event loop.

`stop_robot` stops the robot by every way there is. Clients hold no authority: the gate
authenticates their user by Unix peer credentials, and signed missions and orders say what it may
do. A name is imported when it is first used, so that a stop loads no cryptography.
Spec page: docs/spec/gate-protocol.md#connections
"""

from __future__ import annotations

from authguard_r import lazy

_HOMES = {
    "ApprovalVerdict": "core.approval",
    "AsyncGateClient": "client.asynchronous",
    "ClientRole": "wire.messages",
    "GateClient": "client.blocking",
    "StopEverywhere": "client.stopping",
    "chat_reply": "client.streams",
    "messages_reply": "client.streams",
    "read_signer": "keys.signer",
    "shown": "client.approvals",
    "stop_robot": "client.stopping",
}
__all__ = list(_HOMES)
__getattr__ = lazy(__name__, _HOMES)
