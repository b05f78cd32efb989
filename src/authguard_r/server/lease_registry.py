# SPDX-License-Identifier: Apache-2.0
"""Every open lease of the gate: looked at together, renewed while it holds, settled at its end.

Spec page: docs/spec/gate-protocol.md#watching
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from msgspec import Struct

from authguard_r.core.action import Action
from authguard_r.core.identifiers import ActionType, Digest, Identifier
from authguard_r.core.lease import Lease
from authguard_r.enforcement.emergency_enforcer import EmergencyExecution, EmergencyReport
from authguard_r.enforcement.leases import Running
from authguard_r.enforcement.report import Report
from authguard_r.server.remote_controller import RemoteController
from authguard_r.server.streams import Streams
from authguard_r.wire.messages import Result


class OpenLease(Struct, frozen=True, kw_only=True):
    """What `status` says of an open lease; times on the gate's monotonic clock."""

    ticket: Digest
    action: ActionType
    since_ms: int
    until_ms: int


class _Moving(Protocol):
    """What moves: a released action, or an emergency."""

    lease: Lease
    since_ms: int

    @property
    def action(self) -> Action: ...

    @property
    def holds(self) -> bool: ...

    def poll(self) -> Report | EmergencyReport | None: ...


class _WatchedLease(Struct, frozen=True):
    running: _Moving
    ended: Callable[[Any], None]
    told: Callable[[Result], None] | None = None


class LeaseRegistry:
    """The released actions whose outcome is not recorded yet.

    Args:
        controller: hears which leases still hold; None where there is none.
        streams: what may be sampled while it runs; None where nothing can be.
    """

    def __init__(self, controller: RemoteController | None, streams: Streams | None) -> None:
        self._controller = controller
        self._streams = streams
        self._open: dict[Digest, _WatchedLease] = {}

    def __len__(self) -> int:
        return len(self._open)

    def add(
        self,
        client: Identifier,
        running: Running,
        ended: Callable[[Report], None],
        *,
        gone: Callable[[], bool],
        told: Callable[[Result], None] | None = None,
    ) -> None:
        """Watch an action of a client.

        Args:
            client: its planner.
            running: the released action.
            ended: called once, with its final report.
            gone: true once the planner is not connected any more.
            told: called with each result of the action while it runs.
        """
        self._open[running.lease.ticket] = _WatchedLease(running, ended, told)
        streams = self._streams
        if streams is not None:
            streams.begin(client, running, gone)
            running.before_outcome(lambda: streams.ended(running.lease.ticket))

    def watch_emergency(
        self, execution: EmergencyExecution, ended: Callable[[EmergencyReport], None]
    ) -> None:
        """Watch an emergency; `ended` is called once, with its report."""
        self._open[execution.lease.ticket] = _WatchedLease(execution, ended)

    def tell(self, result: Result) -> None:
        """Pass on what a running action brought to light; what comes after its end is dropped."""
        lease = self._open.get(result.ticket)
        if lease is not None and lease.told is not None:
            lease.told(result)

    def look(self) -> None:
        """Look at every open lease once."""
        if self._controller is not None:
            self._controller.check()
        if self._streams is not None:
            self._streams.record()
        for ticket, lease in tuple(self._open.items()):
            report = lease.running.poll()
            if report is not None:
                self._end(ticket, lease, report)
            elif lease.running.holds and self._controller is not None:
                self._controller.renew(ticket)

    def leases(self) -> tuple[OpenLease, ...]:
        """Return what is open."""
        return tuple(
            OpenLease(
                ticket=ticket,
                action=lease.running.action.type,
                since_ms=lease.running.since_ms,
                until_ms=lease.running.lease.until_mono_ms,
            )
            for ticket, lease in self._open.items()
        )

    def _end(self, ticket: Digest, lease: _WatchedLease, report: Report | EmergencyReport) -> None:
        del self._open[ticket]
        if self._controller is not None:
            self._controller.forget(ticket)
        lease.ended(report)
