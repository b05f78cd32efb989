# SPDX-License-Identifier: Apache-2.0
"""Signed orders about a mission: what may be asked for, and in which words it is signed.

Spec page: docs/spec/standing.md#commands
"""

from __future__ import annotations

from enum import StrEnum

from msgspec import Struct

from authguard_r.core.identifiers import Base64Url, Count, Digest, MissionId, Positive
from authguard_r.core.lifecycle import Event
from authguard_r.core.standing import Outcome


class Verb(StrEnum):
    """What a command asks for."""

    SUSPEND = "suspend"
    RESUME = "resume"
    REVOKE = "revoke"
    COMPLETE = "complete"
    RESOLVE = "resolve"


EVENTS: dict[Verb, Event] = {
    Verb.SUSPEND: Event.SUSPEND,
    Verb.RESUME: Event.RESUME,
    Verb.REVOKE: Event.REVOKE,
    Verb.COMPLETE: Event.COMPLETE,
}
#: What a safety officer may order too.
NARROWING = frozenset({Verb.SUSPEND, Verb.REVOKE})


class Command(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """A principal's signed order about one mission version.

    Args:
        verb: what is asked for.
        mid: the mission.
        version: its version.
        mission: digest of the signed mission.
        nonce: fresh random bytes; a command is carried out once.
        expires_ms: trusted time after which it is worth nothing.
        ticket: for `resolve`, the open release.
        outcome: for `resolve`, what became of it.
    """

    verb: Verb
    mid: MissionId
    version: Positive
    mission: Digest
    nonce: Base64Url
    expires_ms: Count
    ticket: Digest | None = None
    outcome: Outcome | None = None
