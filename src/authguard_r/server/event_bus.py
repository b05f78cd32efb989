# SPDX-License-Identifier: Apache-2.0
"""Events for all watchers, and alerts, which are recorded first.

Spec page: docs/spec/gate-protocol.md#alerts
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from typing import Any

from authguard_r.access.gate_config import GateConfig
from authguard_r.audit.record import NONE, Entry
from authguard_r.enforcement.leases import quietly
from authguard_r.server.event_log import EventLog
from authguard_r.server.fair_queue import ServedClient
from authguard_r.store.transactions import Ledger


class EventBus:
    """Sends events to the clients that watch.

    Args:
        ledger: the time, and where alerts are recorded.
        clients: who is connected.
        journal: the event log that the machine's administrator reads.
    """

    def __init__(
        self, ledger: Ledger, clients: Callable[[], Iterable[ServedClient]], journal: EventLog
    ) -> None:
        self._ledger = ledger
        self._clients = clients
        self._journal = journal

    @property
    def wanted(self) -> bool:
        """True when a client watches; without one no event is written."""
        return any(client.watching is not None for client in self._clients())

    def publish(self, event: dict[str, Any]) -> None:
        """Send an event to every client that watches, and to the journal."""
        self._journal.event(event)
        if not self.wanted:
            return
        now = quietly(self._ledger.now)
        told = {"time_ms": None if now is None else now.utc_ms, **event}
        for client in tuple(self._clients()):
            if client.watching is not None:
                client.event(client.watching, told)

    def client(self, client: ServedClient, *, here: bool) -> None:
        """Tell every client that watches that a client came (`here`) or left."""
        told = {"client": client.name, "role": client.role, "here": here}
        self.publish({"event": "client", **told})

    def start(self, config: GateConfig, *, unclean: bool) -> None:
        """Tell every client that watches that the gate started.

        Args:
            config: the signed configuration.
            unclean: the gate's run before this one did not end cleanly.
        """
        started = {"robot": config.robot, "mode": str(config.mode), "pid": os.getpid()}
        self.publish({"event": "start", **started, "unclean": unclean})

    def alert(self, what: str, details: dict[str, Any]) -> None:
        """Record an alert and send it to every client that watches."""

        def entry(at: int) -> Entry:
            opened = {"what": what, **details}
            return Entry(kind="alert", time_ms=at, decision="alert", mid=NONE, open=opened)

        quietly(lambda: self._ledger.note(entry, essential=True))
        self.publish({"event": "alert", "what": what, **details})
