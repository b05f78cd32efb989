# SPDX-License-Identifier: Apache-2.0
"""Stops that were carried out, by the lane or by the gate, written down, each once.

Spec page: docs/spec/gate-protocol.md#stop-lane
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from authguard_r.core.errors import AuthGuardError
from authguard_r.core.identifiers import Identifier
from authguard_r.enforcement import Enforcer
from authguard_r.gate.clients import Client
from authguard_r.gate.controller import RemoteController
from authguard_r.gate.lane.journal import SUSPENDING
from authguard_r.gate.liveness import Liveness
from authguard_r.gate.motions import Motions
from authguard_r.gate.notices import Notices
from authguard_r.gate.view import View
from authguard_r.wire.messages import ClientRole, Stop, StopHeard

#: Stops of the lane that are known when they come again: it forgets what it was told of.
_KNOWN = 4_096
#: The second way of a stop that was sent by both comes within this, in milliseconds.
_BOTH_MS = 10_000
#: What is said while no stop is heard of.
_GONE = "the stop lane is gone"
#: What is said while the lane is connected and does not answer.
_SILENT = "the stop lane does not answer"


class StopBook:
    """Hears of every stop (`gate.lane.keeper.Listener`).

    Args:
        enforcer: records, counts and suspends.
        controller: is told which stops the gate knows of; None where the gate has none.
        view: counts for `status`.
        motions: open leases, looked at after each stop.
        liveness: alerts.
        notices: tells those who watch.
        mono_ms: the gate's monotonic clock.
    """

    def __init__(
        self,
        enforcer: Enforcer,
        controller: RemoteController | None,
        *,
        view: View,
        motions: Motions,
        liveness: Liveness,
        notices: Notices,
        mono_ms: Callable[[], int],
    ) -> None:
        self._enforcer = enforcer
        self._controller = controller
        self._view = view
        self._motions = motions
        self._liveness = liveness
        self._notices = notices
        self._mono_ms = mono_ms
        self._keys: dict[tuple[int, ClientRole, str], tuple[bool, int]] = {}
        self._known: deque[tuple[int, int]] = deque(maxlen=_KNOWN)

    @property
    def settled(self) -> bool:
        """True when everything that was heard has taken its effect on disk."""
        settled = self._enforcer.settle_stops()
        self._view.mission_changed()  # a suspension that was owed may have been written just now
        return settled

    def begun(self, role: ClientRole) -> None:
        """Suspend the mission at once when an operator stops; the stop is recorded later."""
        if role in SUSPENDING:
            self._enforcer.stopping.hold()
            self._view.mission_changed()

    def taken(self, client: Client, stop: Stop, stood_ms: int | None, more: int) -> None:
        """Record a stop that the gate itself carried out, unless the lane did and told of it.

        Args:
            client: whose stop it is; an operator's has suspended the mission already.
            stop: as it was asked for.
            stood_ms: after how long the robot stood; None: nobody confirmed it.
            more: later stops of the same user and role that were folded into this one.
        """
        if self._is_other(client.uid, client.role, stop.key, by_lane=False, stood_ms=stood_ms):
            return
        self._view.stops += 1
        details = {"more": more}
        self._record(client.name, client.role, stop.why, stood_ms, details, suspends=False)

    def stopped(self, heard: StopHeard) -> None:
        """Record a stop that the lane carried out, once.

        An operator's suspends the mission until a signed `resume`.
        """
        name = (heard.epoch, heard.n)
        if name in self._known:
            return
        self._known.append(name)
        who, stood_ms = (heard.uid, heard.role, heard.key), heard.stood_ms
        if not self._is_other(*who, by_lane=True, stood_ms=stood_ms):
            self._view.stops += 1
            by = Identifier(f"u{heard.uid}.{heard.by}")
            details = {"lane": [heard.epoch, heard.n], "at_ms": heard.time_ms, "more": heard.more}
            suspends = heard.role in SUSPENDING
            self._record(by, heard.role, heard.why, stood_ms, details, suspends=suspends)
        # only now: what was decided before the mission was suspended may not start after it
        if self._controller is not None and heard.stops is not None:
            self._controller.heard_of(heard.life, heard.stops)
        self._motions.look()

    def _is_other(
        self, uid: int, role: ClientRole, key: str, *, by_lane: bool, stood_ms: int | None
    ) -> bool:
        """Return True of the second way of one stop; the same way again is another stop."""
        if not key:
            return False
        now_ms, name = self._mono_ms(), (uid, role, key)
        known = self._keys.pop(name, (by_lane, now_ms))
        is_other = known[0] is not by_lane and now_ms - known[1] <= _BOTH_MS
        for old in tuple(self._keys)[: max(0, len(self._keys) - _KNOWN)]:
            del self._keys[old]
        if not is_other:
            self._keys[name] = (by_lane, now_ms)
        elif stood_ms is not None:
            self._unconfirmed(is_so=False, by=Identifier("gate"))
        return is_other

    def lane_lost(self, why: AuthGuardError | None) -> None:
        """Say that no stop is heard of until the lane is back."""
        self._liveness.holds(_SILENT, is_so=False)
        self._liveness.holds(_GONE, is_so=True, details={} if why is None else {"why": str(why)})

    def lane_silent(self, *, is_silent: bool) -> None:
        """Say that the lane is there and does not answer, or does again."""
        self._liveness.holds(_GONE, is_so=False)
        self._liveness.holds(_SILENT, is_so=is_silent)

    def _record(
        self,
        by: Identifier,
        role: ClientRole,
        why: str,
        stood_ms: int | None,
        details: dict[str, Any],
        *,
        suspends: bool,
    ) -> None:
        too_many = self._enforcer.stopped(
            by=by,
            is_planner=role is ClientRole.PLANNER,
            suspends=suspends,
            details={"stood_ms": -1 if stood_ms is None else stood_ms, **details},
            why=why,
        )
        if too_many:
            self._liveness.follow()
            self._liveness.tell("planner stops", {"by": by})
            self._notices.publish({"event": "alert", "what": "planner stops", "by": by})
        self._view.mission_changed()
        self._notices.publish({"event": "stop", "by": by, "role": role, "stood_ms": stood_ms})
        self._unconfirmed(is_so=stood_ms is None, by=by)

    def _unconfirmed(self, *, is_so: bool, by: Identifier) -> None:
        """Raise the alert at the first stop that nobody confirms, until one is confirmed."""
        self._liveness.holds("nobody confirmed a stop", is_so=is_so, details={"by": by})
