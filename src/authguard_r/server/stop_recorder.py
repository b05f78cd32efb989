# SPDX-License-Identifier: Apache-2.0
"""Stops that were carried out, by the stop process or by the gate, written down, each once.

Spec page: docs/spec/gate-protocol.md#stop-lane
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from msgspec import Struct
from msgspec.structs import replace

from authguard_r.core.errors import AuthGuardError
from authguard_r.core.identifiers import Identifier
from authguard_r.enforcement.enforcer import Enforcer
from authguard_r.server.event_bus import EventBus
from authguard_r.server.fair_queue import ServedClient
from authguard_r.server.liveness import Liveness
from authguard_r.server.queries import GateQueries
from authguard_r.server.remote_controller import RemoteController
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import SUSPENDING, ClientRole, Stop, StopHeard

#: What is said while no stop is heard of.
_GONE = "the stop process is gone"
#: What is said while the stop process is connected and does not answer.
_SILENT = "the stop process does not answer"


class _ReportedStop(Struct, frozen=True, kw_only=True):
    """A stop as the stop process, or the gate itself, reports it.

    Args:
        by: who asked.
        uid: its user.
        role: what it is here.
        key: names the stop; empty: nothing else is the same.
        why: its words.
        stood_ms: after how long the robot stood; None when it was not confirmed.
        by_lane: the stop process reports it, or else the gate itself.
    """

    by: Identifier
    uid: int
    role: ClientRole
    key: str
    why: str
    stood_ms: int | None
    by_lane: bool


class _Known(Struct, frozen=True):
    """What is known of a stop's name.

    Args:
        by_lane: who reported it last.
        at_ms: when, on the gate's monotonic clock.
        is_confirmed: a controller said that the robot stood.
        is_whole: stop process and gate have reported it since.
    """

    by_lane: bool
    at_ms: int
    is_confirmed: bool
    is_whole: bool = False


class StopRecorder:
    """Hears of every stop (`estop.supervisor.StopListener`).

    Args:
        enforcer: records, counts and suspends.
        controller: hears which stops the gate knows of; None where the gate has none.
        view: counts for `status`.
        look: looks at every open lease; called after each stop.
        liveness: alerts.
        events: sends to the clients that watch.
        mono_ms: the gate's monotonic clock.
    """

    def __init__(
        self,
        enforcer: Enforcer,
        controller: RemoteController | None,
        *,
        view: GateQueries,
        look: Callable[[], None],
        liveness: Liveness,
        events: EventBus,
        mono_ms: Callable[[], int],
    ) -> None:
        self._enforcer = enforcer
        self._controller = controller
        self._view = view
        self._look = look
        self._liveness = liveness
        self._events = events
        self._mono_ms = mono_ms
        self._keys: dict[tuple[int, ClientRole, str], _Known] = {}
        self._known: deque[tuple[int, int]] = deque(maxlen=LIMITS.known_stops)

    @property
    def settled(self) -> bool:
        """True when everything that was heard has taken its effect on disk."""
        settled = self._enforcer.settle_stops()
        self._view.mission.changed()  # a suspension that was owed may have been written just now
        return settled

    def begun(self, role: ClientRole) -> None:
        """Suspend the mission at once when an operator stops; the stop is recorded later."""
        if role in SUSPENDING:
            self._enforcer.stopping.hold()
            self._view.mission.changed()

    def taken(self, client: ServedClient, stop: Stop, stood_ms: int | None, more: int) -> None:
        """Record a stop that the gate itself carried out, unless the stop process reported it.

        Args:
            client: whose stop it is; an operator's has suspended the mission already.
            stop: as it was asked for.
            stood_ms: after how long the robot stood; None when it was not confirmed.
            more: later stops of the same user and role that were folded into this one.
        """
        told = _ReportedStop(
            by=client.name,
            uid=client.uid,
            role=client.role,
            key=stop.key,
            why=stop.why,
            stood_ms=stood_ms,
            by_lane=False,
        )
        self._note(told, {"more": more}, suspends=False)

    def stopped(self, heard: StopHeard) -> None:
        """Record a stop that the stop process carried out, once.

        An operator's suspends the mission until a signed `resume`.
        """
        name = (heard.epoch, heard.n)
        if name in self._known:
            return
        self._known.append(name)
        told = _ReportedStop(
            by=Identifier(f"u{heard.uid}.{heard.by}"),
            uid=heard.uid,
            role=heard.role,
            key=heard.key,
            why=heard.why,
            stood_ms=heard.stood_ms,
            by_lane=True,
        )
        details = {"lane": [heard.epoch, heard.n], "at_ms": heard.time_ms, "more": heard.more}
        self._note(told, details, suspends=heard.role in SUSPENDING)
        # only now: what was decided before the mission was suspended may not start after it
        if self._controller is not None and heard.stops is not None:
            self._controller.heard_of(heard.life, heard.stops)
        self._look()

    def stop_process_lost(self, why: AuthGuardError | None) -> None:
        """Raise the alert that stops are not reported until the stop process is back."""
        self._liveness.holds(_SILENT, is_so=False)
        self._liveness.holds(_GONE, is_so=True, details={} if why is None else {"why": str(why)})

    def stop_process_silent(self, *, is_silent: bool) -> None:
        """Say that the stop process is there and does not answer, or does again."""
        self._liveness.holds(_GONE, is_so=False)
        self._liveness.holds(_SILENT, is_so=is_silent)

    def _note(self, told: _ReportedStop, details: dict[str, Any], *, suspends: bool) -> None:
        """Record a stop, once; one that is confirmed later has a second record, without `why`."""
        known = self._recall(told)
        if known is None:
            self._view.stops += 1
            self._record(told, details, suspends=suspends)
        elif not known.is_confirmed:
            if suspends:  # it is asked for still
                self.begun(told.role)
            if told.stood_ms is not None:
                self._confirm(told)

    def _recall(self, told: _ReportedStop) -> _Known | None:
        """Return what is known of the same stop.

        Stop process and gate each report it, and report it again until it is confirmed. Once it is
        confirmed and one of the two reports the same name again, that is another stop.
        """
        if not told.key:
            return None
        name, now_ms = (told.uid, told.role, told.key), self._mono_ms()
        known = self._keys.pop(name, None)
        for old in tuple(self._keys)[: max(0, len(self._keys) + 1 - LIMITS.known_stops)]:
            del self._keys[old]
        if known is not None and now_ms - known.at_ms > LIMITS.same_stop_ms:
            known = None
        if known is not None and known.is_confirmed:
            is_late = known.is_whole and told.stood_ms is None  # a try from before
            if is_late or (known.by_lane is not told.by_lane and not known.is_whole):
                self._keys[name] = replace(known, is_whole=True)
                return known
            known = None
        self._keys[name] = _Known(told.by_lane, now_ms, told.stood_ms is not None)
        return known

    def _record(self, told: _ReportedStop, details: dict[str, Any], *, suspends: bool) -> None:
        by, role, stood_ms = told.by, told.role, told.stood_ms
        too_many = self._enforcer.stopped(
            by=by,
            is_planner=role is ClientRole.PLANNER,
            suspends=suspends,
            details={"stood_ms": -1 if stood_ms is None else stood_ms, **details},
            why=told.why,
        )
        if too_many:
            self._liveness.follow()
            self._liveness.tell("planner stops", {"by": by})
            self._events.publish({"event": "alert", "what": "planner stops", "by": by})
        self._view.mission.changed()
        self._publish(told)
        self._unconfirmed(is_so=stood_ms is None, by=by)

    def _confirm(self, told: _ReportedStop) -> None:
        """Record that an unconfirmed stop is confirmed; a planner's stop has no such record."""
        if told.role is not ClientRole.PLANNER:
            details = {"stood_ms": told.stood_ms, "confirms": True}
            self._enforcer.stopped(by=told.by, is_planner=False, details=details)
        self._publish(told)
        self._unconfirmed(is_so=False, by=told.by)

    def _publish(self, told: _ReportedStop) -> None:
        event = {"event": "stop", "by": told.by, "role": told.role, "stood_ms": told.stood_ms}
        self._events.publish(event)

    def _unconfirmed(self, *, is_so: bool, by: Identifier) -> None:
        """Raise the alert at the first unconfirmed stop, until a stop is confirmed."""
        self._liveness.holds("a stop was not confirmed", is_so=is_so, details={"by": by})
