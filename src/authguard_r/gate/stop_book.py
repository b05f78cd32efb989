# SPDX-License-Identifier: Apache-2.0
"""Stops that the lane has carried out, written down by the gate, each once.

Spec page: docs/spec/gate-protocol.md#stop-lane
"""

from __future__ import annotations

from collections import deque

from authguard_r.core.errors import AuthGuardError
from authguard_r.core.identifiers import Identifier
from authguard_r.enforcement import Enforcer
from authguard_r.gate.controller import RemoteController
from authguard_r.gate.liveness import Liveness
from authguard_r.gate.motions import Motions
from authguard_r.gate.notices import Notices
from authguard_r.gate.view import View
from authguard_r.wire.messages import ClientRole, StopHeard

#: Stops that are known when they come again; the lane forgets what it was told of.
_KNOWN = 4_096
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
    ) -> None:
        self._enforcer = enforcer
        self._controller = controller
        self._view = view
        self._motions = motions
        self._liveness = liveness
        self._notices = notices
        self._known: deque[tuple[int, int]] = deque(maxlen=_KNOWN)

    @property
    def settled(self) -> bool:
        """True when everything that was heard has taken its effect on disk."""
        settled = self._enforcer.settle_stops()
        self._view.mission_changed()  # a suspension that was owed may have been written just now
        return settled

    def stopped(self, heard: StopHeard) -> None:
        """Record a stop, once; an operator's suspends the mission until a signed `resume`."""
        name = (heard.epoch, heard.n)
        if name in self._known:
            return
        self._known.append(name)
        self._view.stops += 1
        by = Identifier(f"u{heard.uid}.{heard.by}")
        self._record(heard, by)
        # only now: what was decided before the mission was suspended may not start after it
        if self._controller is not None and heard.stops is not None:
            self._controller.heard_of(heard.life, heard.stops)
        self._view.mission_changed()
        self._motions.look()
        self._notices.publish(
            {"event": "stop", "by": by, "role": heard.role, "stood_ms": heard.stood_ms}
        )
        if heard.stood_ms is None:
            self._liveness.alert("nobody confirmed a stop", {"by": by})
        else:
            self._liveness.end("nobody confirmed a stop")

    def lane_lost(self, why: AuthGuardError | None) -> None:
        """Say that no stop is heard of until the lane is back."""
        self._liveness.holds(_SILENT, is_so=False)
        self._liveness.holds(_GONE, is_so=True, details={} if why is None else {"why": str(why)})

    def lane_silent(self, *, is_silent: bool) -> None:
        """Say that the lane is there and does not answer, or does again."""
        self._liveness.holds(_GONE, is_so=False)
        self._liveness.holds(_SILENT, is_so=is_silent)

    def _record(self, heard: StopHeard, by: Identifier) -> None:
        too_many = self._enforcer.stopped(
            by=by,
            is_planner=heard.role is ClientRole.PLANNER,
            suspends=heard.role is ClientRole.OPERATOR,
            details={
                "lane": [heard.epoch, heard.n],
                "at_ms": heard.time_ms,
                "stood_ms": -1 if heard.stood_ms is None else heard.stood_ms,
                "more": heard.more,
            },
            why=heard.why,
        )
        if too_many:
            self._liveness.follow()
            self._liveness.tell("planner stops", {"by": by})
            self._notices.publish({"event": "alert", "what": "planner stops", "by": by})
