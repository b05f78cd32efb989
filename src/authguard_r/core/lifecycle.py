# SPDX-License-Identifier: Apache-2.0
"""The life of a mission as one table; what is not in it is refused.

Source: section "Stateful Action Verification" (the registry R). Spec page: docs/spec/lifecycle.md
"""

from __future__ import annotations

from enum import StrEnum

from authguard_r.core.reasons import Reason


class Status(StrEnum):
    """The registry status of one mission version."""

    ISSUED = "issued"
    ACTIVE = "active"
    SUSPENDED = "suspended"
    CLOSING = "closing"
    COMPLETED = "completed"
    REVOKED = "revoked"
    EXPIRED = "expired"
    SUPERSEDED = "superseded"


class Event(StrEnum):
    """What can happen to a mission. Each is recorded before it has an effect."""

    ACTIVATE = "activate"
    SUSPEND = "suspend"
    RESUME = "resume"
    BEGIN_CLOSING = "begin_closing"
    COMPLETE = "complete"
    REVOKE = "revoke"
    EXPIRE = "expire"
    SUPERSEDE = "supersede"


TRANSITIONS: dict[tuple[Status, Event], Status] = {
    (Status.ISSUED, Event.ACTIVATE): Status.ACTIVE,
    (Status.ISSUED, Event.REVOKE): Status.REVOKED,
    (Status.ISSUED, Event.EXPIRE): Status.EXPIRED,
    (Status.ISSUED, Event.SUPERSEDE): Status.SUPERSEDED,
    (Status.ACTIVE, Event.SUSPEND): Status.SUSPENDED,
    (Status.ACTIVE, Event.BEGIN_CLOSING): Status.CLOSING,
    (Status.ACTIVE, Event.COMPLETE): Status.COMPLETED,
    (Status.ACTIVE, Event.REVOKE): Status.REVOKED,
    (Status.ACTIVE, Event.EXPIRE): Status.EXPIRED,
    (Status.ACTIVE, Event.SUPERSEDE): Status.SUPERSEDED,
    (Status.SUSPENDED, Event.RESUME): Status.ACTIVE,
    (Status.SUSPENDED, Event.COMPLETE): Status.COMPLETED,
    (Status.SUSPENDED, Event.REVOKE): Status.REVOKED,
    (Status.SUSPENDED, Event.EXPIRE): Status.EXPIRED,
    (Status.SUSPENDED, Event.SUPERSEDE): Status.SUPERSEDED,
    (Status.CLOSING, Event.COMPLETE): Status.COMPLETED,
    (Status.CLOSING, Event.REVOKE): Status.REVOKED,
    (Status.CLOSING, Event.EXPIRE): Status.EXPIRED,
}

#: A mission that ended stays ended: no event leads out (`Replay resistance`).
TERMINAL: frozenset[Status] = frozenset(Status) - {status for status, _ in TRANSITIONS}

#: Why a mission in this status authorizes nothing. `closing` authorizes its closing grants only.
REFUSAL: dict[Status, Reason] = {
    Status.ISSUED: Reason.MISSION_NOT_ACTIVE,
    Status.SUSPENDED: Reason.MISSION_SUSPENDED,
    Status.COMPLETED: Reason.MISSION_COMPLETED,
    Status.REVOKED: Reason.REVOKED,
    Status.EXPIRED: Reason.EXPIRED,
    Status.SUPERSEDED: Reason.SUPERSEDED,
}
