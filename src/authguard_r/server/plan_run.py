# SPDX-License-Identifier: Apache-2.0
"""One plan on its way through the gate: who waits for it, and what became of it so far.

Spec page: docs/spec/gate-protocol.md#propose
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from authguard_r.core.identifiers import Digest
from authguard_r.enforcement.json_views import told_json
from authguard_r.enforcement.report import Report
from authguard_r.normalize import Step
from authguard_r.server.fair_queue import ServedClient
from authguard_r.server.proposals import Numbers, ProposalAnswer
from authguard_r.wire.disclosure import Disclosure
from authguard_r.wire.messages import Propose


class Later(Protocol):
    """Lets something of a client wait for its turn."""

    def __call__(
        self, client: ServedClient, act: Callable[[], None], *, first: bool = False
    ) -> None:
        """Put it behind what waits of the client, or `first`, before all of that."""
        ...


class ServedPlan:
    """One plan on its way.

    Args:
        client: who is answered; another connection of the same client may take its place.
        number: the request.
        asked: what it asked for.
        evidence: digest of the planner's exact bytes.
    """

    def __init__(self, client: ServedClient, number: int, asked: Propose, evidence: Digest) -> None:
        self.client = client
        self.number = number
        self.asked = asked
        self.evidence = evidence
        self.steps: tuple[Step, ...] = ()
        self.reports: list[Report] = []
        self.numbers: tuple[Numbers, ...] = ()
        self.told: list[dict[str, Any]] = []
        self.noting = 0  # results that are still looked through

    def answered(self, then: str | None = None) -> ProposalAnswer:
        """Return what is known of it so far."""
        return ProposalAnswer(
            evidence=self.evidence,
            planned=len(self.steps),
            steps=tuple(self.told),
            on_refusal=then,
        )

    def add(self, report: Report, disclosure: Disclosure) -> None:
        """Take in a step's final report, and what the planner is told of it."""
        self.reports.append(report)
        self.told.append(told_json(report, disclosure))
