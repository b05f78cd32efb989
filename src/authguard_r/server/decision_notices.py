# SPDX-License-Identifier: Apache-2.0
"""What follows each decision and outcome: it is counted and published.

A planner that makes no progress has its robot stopped.
"""

from __future__ import annotations

from authguard_r.core.identifiers import Identifier
from authguard_r.enforcement.enforcer import Enforcer
from authguard_r.enforcement.json_views import report_json
from authguard_r.enforcement.report import Report
from authguard_r.server.approval_requests import OpenQuestions
from authguard_r.server.event_bus import EventBus
from authguard_r.server.fair_queue import ServedClient
from authguard_r.server.liveness import Liveness
from authguard_r.server.queries import GateQueries


class DecisionNotices:
    """Passes decisions and outcomes on to the rest of the gate.

    Args:
        enforcer: stops the robot.
        queries: counts decisions and outcomes for `status`.
        questions: approval requests that a decision opened.
        events: the clients that watch.
        liveness: judges whether a planner makes progress.
    """

    def __init__(
        self,
        enforcer: Enforcer,
        queries: GateQueries,
        questions: OpenQuestions,
        events: EventBus,
        liveness: Liveness,
    ) -> None:
        self._enforcer = enforcer
        self._queries = queries
        self._questions = questions
        self._events = events
        self._liveness = liveness

    def decided(self, client: ServedClient, report: Report) -> None:
        """Count and publish a decision."""
        self._queries.count_decision(report)
        self._questions.decided(report)
        self._tell("decision", client, report)

    def ended(self, client: ServedClient, report: Report) -> None:
        """Count and publish an outcome."""
        self._queries.count_outcome(report)
        self._tell("outcome", client, report)

    def _tell(self, event: str, client: ServedClient, report: Report) -> None:
        if self._events.wanted:
            self._events.publish({"event": event, "client": client.name, **report_json(report)})
        if self._liveness.judge(client.name, report):
            self._enforcer.stop(by=Identifier("gate"), is_planner=False)
