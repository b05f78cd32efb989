# SPDX-License-Identifier: Apache-2.0
"""Clients of a running gate: `GateClient` waits, `AsyncGateClient` is for an event loop.

They hold no authority. What a client may ask, the kernel's word on its user decides; what it may
have done, signed missions and orders do. Spec page: docs/spec/gate-protocol.md#connections
"""

from __future__ import annotations

from authguard_r.client.asynchronous import AsyncGateClient
from authguard_r.client.blocking import GateClient

__all__ = ["AsyncGateClient", "GateClient"]
