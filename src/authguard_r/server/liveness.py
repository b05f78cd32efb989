# SPDX-License-Identifier: Apache-2.0
"""Alerts for silent clients and planners without progress; they change no authority.

False warnings and endless replanning stop a robot as surely as an attack on its motors does; the
gate cannot make a planner useful, but it can raise an alert. Source: the liveness question of
section "Problem Formulation". Spec page: docs/spec/gate-protocol.md#alerts
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from msgspec import Struct

from authguard_r.access.gate_config import GateConfig
from authguard_r.core.decision import Verdict
from authguard_r.core.identifiers import Digest, Identifier
from authguard_r.core.lifecycle import Status
from authguard_r.core.mission import OnRefusal
from authguard_r.core.standing import Outcome
from authguard_r.enforcement.report import Report
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import ClientRole, Mode

#: What is said of a controller that is not there.
_AWAY = "controller is not connected"
#: Alerts about a mission: each ends when that mission ends or another one is activated.
_OF_MISSION = ("planner stops", "false emergency")
#: Alerts about a user's row: each ends when the user succeeds, or when the mission changes.
_OF_ROW = ("no progress", "a person is asked")


class MissionPhase(Struct, frozen=True):
    """A mission that has not ended, and how it stands."""

    mid: str
    version: int
    status: Status

    @property
    def runs(self) -> bool:
        """True while planners may act."""
        return self.status in {Status.ACTIVE, Status.CLOSING}


class Liveness:
    """Silence and refusals in a row.

    Args:
        config: how long and how many.
        mono_ms: the monotonic clock.
        raise_alert: records and publishes one; called with what it is and its details.
        mission: returns the mission that has not ended.
    """

    def __init__(
        self,
        config: GateConfig,
        mono_ms: Callable[[], int],
        raise_alert: Callable[[str, dict[str, Any]], None],
        mission: Callable[[], MissionPhase | None] = lambda: None,
    ) -> None:
        self._config = config
        self._mono_ms = mono_ms
        self._raise = raise_alert
        self._heard: dict[ClientRole, int] = {}
        self._holding: set[str] = set()
        self._refused: dict[str, int] = {}
        self._asked: dict[str, Digest] = {}
        self._phase: MissionPhase | None = None
        self._mission = mission
        self._active = False
        self._since_ms = mono_ms()
        self.alerts: deque[dict[str, Any]] = deque(maxlen=LIMITS.shown_alerts)

    def hear(self, role: ClientRole) -> None:
        """Note that a role was heard of."""
        self._heard[role] = self._mono_ms()
        self.holds(f"{role} is silent", is_so=False)

    def ages(self) -> dict[str, int | None]:
        """Return how long ago each role was heard of, in milliseconds, None for never."""
        now = self._mono_ms()
        return {
            f"{role}_ms": None if role not in self._heard else now - self._heard[role]
            for role in (ClientRole.PLANNER, ClientRole.ESTIMATOR, ClientRole.CONTROLLER)
        }

    def check(
        self,
        *,
        active: bool,
        controller: bool,
        estimator: bool = True,
        in_time: bool = True,
        only_counts: bool = False,
        has_store: bool = True,
    ) -> None:
        """Raise what is due, and end what is over: one alert for each silence.

        Args:
            active: a mission is active; without one no silence counts.
            controller: a controller is connected, or this gate needs none.
            estimator: an estimator has to speak; False where the robot is in this process.
            in_time: the wall clock is not behind what was committed.
            only_counts: refusals are counted and not recorded, for want of room.
            has_store: the store's file is where it was opened.
        """
        self.follow()
        if active and not self._active:
            self._since_ms = self._mono_ms()  # silence counts from the mission's begin
        self._active = active
        config = self._config
        self._check(ClientRole.PLANNER, config.planner_silence_ms)
        if estimator:
            self._check(ClientRole.ESTIMATOR, config.estimator_silence_ms)
        self.holds(_AWAY, is_so=active and not controller)
        self.holds("the clock is behind", is_so=not in_time)
        self.holds("the store was moved away", is_so=not has_store)
        self.holds("refusals are only counted: the disk is full", is_so=only_counts)

    def holds(self, what: str, *, is_so: bool, details: dict[str, Any] | None = None) -> None:
        """Raise an alert when something begins, and end it when that is over.

        Args:
            what: it is called so.
            is_so: whether it is so now.
            details: what else is said when it begins.
        """
        if is_so and what not in self._holding:
            self._holding.add(what)
            self.alert(what, details or {})
        elif not is_so and what in self._holding:
            self._holding.discard(what)
            self.end(what)

    def follow(self) -> MissionPhase | None:
        """End the alerts about a mission that has changed since; return the mission of now.

        To be called before such an alert is raised, or it would end with the mission before.
        """
        before, self._phase = self._phase, self._mission()
        if self._phase != before:
            self._refused.clear()
            self._asked.clear()
            kept = None if before is None else before.mid
            is_same = self._phase is not None and self._phase.mid == kept
            for what in _OF_ROW if is_same else (*_OF_ROW, *_OF_MISSION):
                self.end(what)
        return self._phase

    def judge(self, client: Identifier, report: Report) -> bool:
        """Count refusals in a row; True when it is time to stop the robot.

        Where the mission says that a person is asked, the first of a user's row asks. Neither
        alert is raised while no mission runs: then no planner can succeed. A gate in shadow mode
        holds no robot: nothing is counted.
        """
        if self._config.mode is not Mode.ENFORCE:
            return False
        user = client.partition(".")[0]  # under all its names: another name is no progress
        if report.outcome is Outcome.SUCCEEDED:
            self._refused.pop(user, None)
            self._refused.pop(client, None)
            self._asked.pop(user, None)
            for what in _OF_ROW:
                self.end(what, user=user)
            return False
        self._ask(client, user, report)
        if report.judged is not None and report.judged.released:
            return False  # it got somewhere, if not to the end
        rows = {self._count(client), self._count(user)}
        if self._config.refusals not in rows:  # once for each row of them; 0 is never reached
            return False
        if not self._runs():
            return False
        self.alert("no progress", {"client": client, "refusals": self._config.refusals})
        return True

    def _ask(self, client: Identifier, user: str, report: Report) -> None:
        """Tell people, who decide what is done now; the robot holds until they do."""
        judged = report.judged
        if judged is None or judged.verified.mission.on_refusal is not OnRefusal.ASK:
            return
        if judged.released and report.outcome is None:
            return  # it has just begun
        mission = judged.verified.digest
        if judged.decision.verdict is Verdict.REQUEST_APPROVAL or self._asked.get(user) == mission:
            return  # an approval's request asks by itself
        if self._runs():
            self._asked[user] = mission
            self.alert("a person is asked", {"client": client, "decision": report.seq})

    def _runs(self) -> bool:
        phase = self.follow()
        return phase is not None and phase.runs

    def _count(self, who: str) -> int:
        count = self._refused.pop(who, 0) + 1
        self._refused[who] = count
        if len(self._refused) > LIMITS.counted_users:
            del self._refused[next(iter(self._refused))]
        return count

    def tell(self, what: str, details: dict[str, Any]) -> None:
        """Keep an alert for `status` that is recorded already."""
        self.alerts.append({"what": what, **details})

    def alert(self, what: str, details: dict[str, Any]) -> None:
        """Raise an alert and keep it for `status`."""
        self.alerts.append({"what": what, **details})
        self._raise(what, details)

    def end(self, what: str, *, user: str | None = None) -> None:
        """End an alert whose cause is over; only one user's alert if a user is named."""
        for number, told in enumerate(self.alerts):
            if user is not None and str(told.get("client")).partition(".")[0] != user:
                continue
            if told["what"] == what:
                self.alerts[number] = {**told, "over": True}

    def _check(self, role: ClientRole, most_ms: int) -> None:
        silent_ms = self._mono_ms() - max(self._heard.get(role, 0), self._since_ms)
        is_silent = self._active and 0 < most_ms < silent_ms
        self.holds(f"{role} is silent", is_so=is_silent, details={"silent_ms": silent_ms})
