# SPDX-License-Identifier: Apache-2.0
"""The estimator's channel as the intake reads it: the newest snapshot that came in.

Spec page: docs/spec/gate-protocol.md#state
"""

from __future__ import annotations

from authguard_r.server.fair_queue import ServedClient
from authguard_r.wire.messages import Fence


class StateInbox:
    """Holds the newest snapshot token (`core.ports.StateSource`); it is not verified yet.

    Every estimator gets the newest fence with its first snapshot, and each new one as it comes.
    """

    def __init__(self) -> None:
        self._newest: bytes | None = None
        self._fence = Fence(fence=0)
        self._estimators: set[ServedClient] = set()

    def put(self, token: bytes, estimator: ServedClient) -> None:
        """Put a snapshot in the place of the one before."""
        self._newest = token
        if estimator not in self._estimators:
            self._estimators.add(estimator)
            estimator.event(0, self._fence)

    def latest(self) -> bytes | None:
        """Return the newest snapshot token, None before the first."""
        return self._newest

    def fence(self, number: int) -> None:
        """Have every estimator measure anew."""
        self._fence = Fence(fence=number)
        self._estimators = {one for one in self._estimators if not one.gone}
        for estimator in self._estimators:
            estimator.event(0, self._fence)
