# SPDX-License-Identifier: Apache-2.0
"""Clients of a running gate: `GateClient` waits, `AsyncGateClient` is for an event loop.

`stop_robot` stops by every way there is.

They hold no authority. What a client may ask, the kernel's word on its user decides; what it may
have done, signed missions and orders do. Spec page: docs/spec/gate-protocol.md#connections
"""

from __future__ import annotations

from authguard_r.client.asynchronous import AsyncGateClient
from authguard_r.client.blocking import GateClient
from authguard_r.client.stopping import StopEverywhere, stop_robot

__all__ = ["AsyncGateClient", "GateClient", "StopEverywhere", "stop_robot"]
