# SPDX-License-Identifier: Apache-2.0
"""A safety gate's memory in the store: moved by a release, in the release's own commit.

A released action counts as having taken place and as not having taken place until its outcome
says which: what comes next has to be safe either way. The bytes are the gate's; nothing here
reads them. Spec page: docs/spec/safety.md#memory
"""

from __future__ import annotations

from typing import Protocol

from msgspec import Struct, structs

from authguard_r.core.encoding import b64, decode, encode_fast, unb64
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Base64Url, Count, Digest
from authguard_r.core.mission import Mission
from authguard_r.core.safety import SafetyDecision
from authguard_r.core.standing import Outcome, Standing

_KIND = "safety"
#: Given to a gate when its memory is gone; it belongs to no gate.
LOST = b"lost"


class MemoryTurn(Protocol):
    """What can be read and written in the writer's turn."""

    def get(self, kind: str, key: str) -> bytes | None:
        """Return what is held."""
        ...

    def put(self, kind: str, key: str, value: bytes) -> None:
        """Hold it when the turn commits."""


class Read(Protocol):
    """What can be read in a turn."""

    def get(self, kind: str, key: str) -> bytes | None:
        """Return what is held."""
        ...


class MissionMemory(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The memory of one mission as it is held.

    Args:
        actions: releases of the mission that it knows of.
        ticket: the last one.
        memory: in force.
        before: in force again when the last one was never started.
        succeeded: in force from when the last one succeeded.
    """

    actions: Count
    ticket: Digest
    memory: Base64Url
    before: Base64Url
    succeeded: Base64Url


def memory_of(turn: Read, standing: Standing | None) -> bytes:
    """Return what the safety gate is given back for a mission.

    Args:
        turn: reads the store.
        standing: the mission's, as it is read in the same turn; None: it has done nothing.

    Returns:
        Empty before the mission's first release; `LOST` when releases were made that the memory
        does not know of: under a gate without a memory, or after a change of the store.
    """
    if standing is None or standing.actions == 0:
        return b""
    kept = _kept(turn, standing)
    known = kept is not None and kept.actions == standing.actions
    return unb64(kept.memory) if kept is not None and known else LOST


def remember(
    turn: MemoryTurn, before: Standing, safety: SafetyDecision | None, *, ticket: Digest
) -> None:
    """Move the memory with a release; nothing is held for a gate that remembers nothing.

    Args:
        turn: of the release.
        before: the mission's standing before it.
        safety: what the gate said of it.
        ticket: the release.
    """
    if safety is None or not any(safety.memory):
        return
    doubted, succeeded = map(b64, safety.memory)
    kept = MissionMemory(
        actions=before.actions + 1,
        ticket=ticket,
        memory=doubted,
        before=b64(memory_of(turn, before)),
        succeeded=succeeded,
    )
    turn.put(_KIND, before.mid, encode_fast(kept))


def settle_memory(
    turn: MemoryTurn, standing: Standing, mission: Mission, *, ticket: Digest, outcome: Outcome
) -> None:
    """Say how the last release ended; doubt about an earlier one stays.

    Args:
        turn: of the outcome.
        standing: the mission's, before the outcome.
        mission: under which it was released: of a grant that it calls irreversible even
            `not_started` is not trusted.
        ticket: the release.
        outcome: how it ended.
    """
    kept = _kept(turn, standing)
    if kept is None or kept.ticket != ticket:
        return
    memory = kept.succeeded if outcome is Outcome.SUCCEEDED else kept.memory
    grant = next((release.grant for release in standing.open if release.ticket == ticket), None)
    undone = any(one.id == grant and not one.irreversible for one in mission.actions)
    if outcome is Outcome.NOT_STARTED and undone:
        memory = kept.before
    turn.put(_KIND, standing.mid, encode_fast(structs.replace(kept, memory=memory)))


def _kept(turn: Read, standing: Standing) -> MissionMemory | None:
    data = turn.get(_KIND, standing.mid)
    if data is None:
        return None
    try:
        return decode(data, MissionMemory, where="store.safety")
    except MalformedError:
        return None
