# SPDX-License-Identifier: Apache-2.0
"""Signed orders about a mission: what may be asked for, and in which words it is signed.

Spec page: docs/spec/standing.md#commands
"""

from __future__ import annotations

from enum import StrEnum

from msgspec import Struct

from authguard_r.core.identifiers import Base64Url, Count, Digest, MissionId, Positive
from authguard_r.core.lifecycle import Event
from authguard_r.core.mission import DataClass
from authguard_r.core.standing import Outcome


class Verb(StrEnum):
    """What a command asks for."""

    SUSPEND = "suspend"
    RESUME = "resume"
    REVOKE = "revoke"
    COMPLETE = "complete"
    RESOLVE = "resolve"
    #: Of a template, not of a mission.
    WITHDRAW = "withdraw"
    #: Of a store, not of a mission.
    ACCEPT_STORE = "accept_store"
    #: Of what a log has sealed.
    SHRED = "shred"


EVENTS: dict[Verb, Event] = {
    Verb.SUSPEND: Event.SUSPEND,
    Verb.RESUME: Event.RESUME,
    Verb.REVOKE: Event.REVOKE,
    Verb.COMPLETE: Event.COMPLETE,
}
#: What ends or settles: also ordered of a mission that has no valid signature any more.
ENDING = frozenset({Verb.SUSPEND, Verb.REVOKE, Verb.COMPLETE, Verb.RESOLVE})
#: What a safety officer may order too.
NARROWING = frozenset({Verb.SUSPEND, Verb.REVOKE, Verb.WITHDRAW})


class StoreClaim(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which store a person accepts, as it was at that moment, in place of which counter.

    Args:
        store: L_0, the link of its first record.
        size: number of its records.
        head: L_{size-1}.
        number: the counter's, 0 when it has no authentic one.
    """

    store: Digest
    size: Positive
    head: Digest
    number: Count


class Command(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """A principal's signed order about one mission version, a template or a store.

    Args:
        verb: what is asked for.
        mid: the mission; for `withdraw`, the template's name; for `accept_store`, the robot's; for
            `shred` of records of no mission, the robot's.
        version: its version; for `withdraw`, `accept_store` and `shred`, 1.
        mission: digest of the mission; for `withdraw`, of the template, which is no mission's;
            for `accept_store` and `shred`, the store's L_0.
        nonce: fresh random bytes; a command is carried out once.
        expires_ms: trusted time after which it is worth nothing.
        issued_ms: when it was signed, by its signer's clock; 0 when it is not given.
        ticket: for `resolve`, the open release.
        outcome: for `resolve`, how it ended.
        accepts: for `accept_store`, what is accepted.
        shreds: for `shred`, the classes of sealed fields that are destroyed, sorted.
    """

    verb: Verb
    mid: MissionId
    version: Positive
    mission: Digest
    nonce: Base64Url
    expires_ms: Count
    issued_ms: Count = 0
    ticket: Digest | None = None
    outcome: Outcome | None = None
    accepts: StoreClaim | None = None
    shreds: tuple[DataClass, ...] = ()
