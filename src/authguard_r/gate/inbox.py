# SPDX-License-Identifier: Apache-2.0
"""The estimator's channel as the intake reads it: the newest snapshot that came in.

Spec page: docs/spec/gate-protocol.md#state
"""

from __future__ import annotations


class Inbox:
    """Holds the newest snapshot token (`core.ports.StateSource`); nothing in it is believed yet."""

    def __init__(self) -> None:
        self._newest: bytes | None = None

    def put(self, token: bytes) -> None:
        """Put a snapshot in the place of the one before."""
        self._newest = token

    def latest(self) -> bytes | None:
        """Return the newest snapshot token, None before the first."""
        return self._newest
