# SPDX-License-Identifier: Apache-2.0
"""Streams: one decision, then samples that are checked in memory and forwarded or made zero.

A velocity for a time is one action; while it runs, its planner may change the velocity. Every
sample is held to the signed limits of the grant, and to where the robot would come to rest if it
were stopped the moment after: a sample that fails is forwarded as zero, so that the robot slows
instead of keeping the last one. Once a second, and at the end, one record says what went by.
Spec page: docs/spec/gate-protocol.md#streams
"""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum
from hashlib import sha256
from math import isqrt
from typing import Any

import msgspec
from msgspec import Struct

from authguard_r.audit.record import Entry
from authguard_r.core.action import Action
from authguard_r.core.encoding import b64, encode_fast
from authguard_r.core.errors import ControllerError, RefusedError
from authguard_r.core.facts import SiteFacts
from authguard_r.core.identifiers import Digest, Identifier
from authguard_r.core.lease import Lease
from authguard_r.core.mission import Limit
from authguard_r.core.reasons import Reason
from authguard_r.core.state import AttestedState, place_of
from authguard_r.enforcement.leases import Running, quietly, require_judged
from authguard_r.server.remote_controller import DURATION, RemoteController, is_stream
from authguard_r.store.transactions import Ledger
from authguard_r.wire.gate_limits import LIMITS

#: Returns how far a robot goes on when it is stopped at a speed, None when that is unknown.
StoppingWay = Callable[[int], int | None]


class StreamEnd(StrEnum):
    """Why the gate ended a controller's stream; every other end is the outcome's."""

    PLANNER = "planner"
    DURATION = "duration"
    GONE = "planner gone"


class _SampleTally(Struct, kw_only=True):
    """What went by since the last record."""

    samples: int = 0
    forwarded: int = 0
    zeroed: int = 0
    shed: int = 0
    extremes: dict[str, list[int]] = {}


class _Closed(Struct, frozen=True):
    """Why a stream was ended, and when its controller got the message."""

    why: StreamEnd
    at_ms: int


class _Stream:
    """One open stream."""

    def __init__(
        self, client: Identifier, running: Running, gone: Callable[[], bool], now_ms: int
    ) -> None:
        judged = require_judged(running.report)
        match = judged.decision.match
        if match is None:  # pragma: no cover - an accepted action has a match
            raise RuntimeError("a stream was released without a match")
        mission = judged.verified.mission
        self.client = client
        self.gone = gone
        self.lease: Lease = running.lease
        self.names = frozenset(judged.action.params) - {DURATION}
        self.limits: tuple[Limit, ...] = (*match.indexed.grant.limits, *mission.limits)
        self.seen = _SampleTally()
        self.digest = sha256()
        self.recorded_ms = now_ms
        self.ends_ms = now_ms + judged.action.params[DURATION]
        self.sampled = False
        self.sampled_ms = now_ms - LIMITS.sample_gap_ms
        self.closed: _Closed | None = None


class StreamBounds:
    """Whether a robot at a velocity could stop inside its regions.

    Args:
        facts: the signed site.
        mono_ms: the monotonic clock that states are measured on.
        stopping_mm: how far the robot goes on when it is stopped at a speed.
        state: returns the newest attested state.
    """

    def __init__(
        self,
        facts: SiteFacts,
        mono_ms: Callable[[], int],
        *,
        stopping_mm: StoppingWay,
        state: Callable[[], AttestedState | None],
    ) -> None:
        self._facts = facts
        self._mono_ms = mono_ms
        self._stopping_mm = stopping_mm
        self._state = state

    def admit(self, action: Action, lease: Lease) -> None:
        """Check a stream's own velocities as its samples are checked, before it begins.

        Raises:
            ControllerError: the robot could not stop inside its regions (`OUTSIDE_REGIONS`).
        """
        first: dict[str, int] = {n: v for n, v in action.params.items() if n != DURATION}
        if is_stream(action) and not self.stays_inside(lease, first):
            refused = ControllerError("it could not stop inside its regions at this velocity")
            refused.reason, refused.where = Reason.OUTSIDE_REGIONS, "params"
            raise refused

    def stays_inside(self, lease: Lease, params: dict[str, int]) -> bool:
        """Return True when the robot, stopped right after, comes to rest inside its regions."""
        if not lease.regions:
            return True
        state = self._state()
        if state is None or state.snapshot.pose is None:
            return False
        speeds = [value for name, value in params.items() if name.endswith("_mm_s")]
        speed = isqrt(sum(value * value for value in speeds)) + 1 if any(speeds) else 0
        way = self._stopping_mm(speed)
        if way is None:
            return True  # a profile that does not say how it brakes: the lease alone holds it
        pose = state.snapshot.pose
        age_ms = self._mono_ms() - state.arrived_mono_ms + pose.age_ms
        reach = pose.margin_mm + way + speed * max(age_ms, 0) // 1_000
        wider = msgspec.structs.replace(pose, margin_mm=reach)
        places = place_of(msgspec.structs.replace(state.snapshot, pose=wider), self._facts)
        return bool(places) and places <= frozenset(lease.regions)


class Streams:
    """Every open stream of the gate.

    Args:
        ledger: the clock, and where records go.
        controller: takes what passes.
        bounds: what each sample is checked against, beside its limits.
    """

    def __init__(self, ledger: Ledger, controller: RemoteController, bounds: StreamBounds) -> None:
        self._ledger = ledger
        self._controller = controller
        self._bounds = bounds
        self._open: dict[Digest, _Stream] = {}

    def begin(self, client: Identifier, running: Running, gone: Callable[[], bool]) -> None:
        """Let the action's planner sample it, if it is one that can be.

        Args:
            client: its planner.
            running: the released action.
            gone: true once its planner is not connected any more.
        """
        if is_stream(require_judged(running.report).action):
            now_ms = self._ledger.mono_ms()
            self._open[running.lease.ticket] = _Stream(client, running, gone, now_ms)

    def sample(self, client: Identifier, ticket: Digest, params: dict[str, int]) -> bool:
        """Forward a sample, or zero in its place; True when it was forwarded as it is.

        Args:
            client: who sent it.
            ticket: the release that it belongs to.
            params: what it asks for; untrusted.

        Raises:
            RefusedError: no such stream of this client.
        """
        stream = self._of(client, ticket)
        now_ms = self._ledger.mono_ms()
        if now_ms >= stream.ends_ms:
            raise RefusedError("the stream is over", reason=Reason.LEASE_ENDED, where="ticket")
        stream.seen.samples += 1
        stream.digest.update(encode_fast(params))
        if now_ms - stream.sampled_ms < LIMITS.sample_gap_ms:
            stream.seen.shed += 1
            return False
        stream.sampled, stream.sampled_ms = True, now_ms
        fits = self._fits(stream, params)
        if fits:
            _widen(stream.seen.extremes, params)
        stream.seen.forwarded += fits
        stream.seen.zeroed += not fits
        self._controller.forward(ticket, params if fits else dict.fromkeys(stream.names, 0))
        return fits

    def finish(self, client: Identifier, ticket: Digest) -> None:
        """End a stream because its planner says so.

        Raises:
            RefusedError: no such stream of this client.
        """
        self._end(ticket, self._of(client, ticket), StreamEnd.PLANNER)

    def ended(self, ticket: Digest) -> None:
        """Write the last record of a stream whose action has ended."""
        stream = self._open.pop(ticket, None)
        if stream is not None:
            self._record(ticket, stream, last=True)

    def record(self) -> None:
        """Write due records; end each stream whose time is over or whose planner is gone."""
        now_ms = self._ledger.mono_ms()
        due_ms = now_ms - LIMITS.stream_record_ms
        for ticket, stream in self._open.items():
            if now_ms >= stream.ends_ms:
                self._end(ticket, stream, StreamEnd.DURATION)
            elif stream.sampled and stream.gone():
                self._end(ticket, stream, StreamEnd.GONE)
            if stream.recorded_ms <= due_ms and stream.seen.samples:
                self._record(ticket, stream, last=False)

    def _end(self, ticket: Digest, stream: _Stream, why: StreamEnd) -> None:
        """Tell the controller, once, that a stream is over."""
        if stream.closed is None:
            stream.closed = _Closed(why, self._ledger.mono_ms())
            self._controller.close(ticket)

    def _of(self, client: Identifier, ticket: Digest) -> _Stream:
        stream = self._open.get(ticket)
        if stream is None or stream.client != client:
            raise RefusedError(
                "no such stream of this client", reason=Reason.LEASE_ENDED, where="ticket"
            )
        return stream

    def _fits(self, stream: _Stream, params: dict[str, int]) -> bool:
        """True for a sample that is whole, within its limits, and can still stop inside."""
        if params.keys() != stream.names:
            return False
        bounds: dict[str, list[Limit]] = {name: [] for name in stream.names}
        for limit in stream.limits:
            if limit.parameter in bounds:
                bounds[limit.parameter].append(limit)
        within = all(
            bounds[name] and all(limit.low <= value <= limit.high for limit in bounds[name])
            for name, value in params.items()
        )
        return within and self._bounds.stays_inside(stream.lease, params)

    def _record(self, ticket: Digest, stream: _Stream, *, last: bool) -> None:
        seen, stream.seen = stream.seen, _SampleTally()
        stream.recorded_ms = self._ledger.mono_ms()
        opened: dict[str, Any] = {
            "ticket": ticket,
            "client": stream.client,
            "samples": seen.samples,
            "forwarded": seen.forwarded,
            "zeroed": seen.zeroed,
            "shed": seen.shed,
            "digest": b64(stream.digest.digest()),
            "last": last,
        }
        if last and stream.closed is not None:
            stood_ms = stream.recorded_ms - stream.closed.at_ms
            opened |= {"closed": stream.closed.why, "stood_ms": stood_ms}
        sealed = {"extremes": seen.extremes}
        mid = stream.lease.mid
        quietly(
            lambda: self._ledger.note(
                lambda at: Entry(
                    kind="stream",
                    time_ms=at,
                    decision="stream",
                    mid=mid,
                    open=opened,
                    sealed=sealed,
                ),
                essential=True,
            )
        )


def _widen(extremes: dict[str, list[int]], params: dict[str, int]) -> None:
    for name, value in params.items():
        low, high = extremes.get(name, (value, value))
        extremes[name] = [min(low, value), max(high, value)]
