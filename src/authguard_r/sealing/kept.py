# SPDX-License-Identifier: Apache-2.0
"""What a store holds of sealed fields: where keys are told, and whose fields are kept.

Spec page: docs/spec/sealed-fields.md#retention
"""

from __future__ import annotations

from msgspec import Struct

from authguard_r.core.encoding import encode
from authguard_r.core.identifiers import Count, MissionId
from authguard_r.core.ports import Store, Turn
from authguard_r.ledger import Act, read_held
from authguard_r.sealing.policy import SealingPolicy

#: Where the store holds which record tells the newest keys of a mission.
HELD = "sealing"
#: Where it holds what the last gate sealed, and the missions whose fields have an end to come.
POLICY, _NEWEST, _DUE = "sealing-policy", "newest", "due"


class Kept(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which records tell the keys of a mission.

    Args:
        newest: number of the last of them; each names the one before it.
    """

    newest: Count


def due_missions(turn: Turn | Act) -> tuple[MissionId, ...]:
    """Return the missions whose sealed fields have an end to come.

    Raises:
        StoreError: what is held is no list of them.
    """
    held = turn.get(POLICY, _DUE)
    return read_held(held, tuple[MissionId, ...], POLICY) if held else ()


def hold_due(turn: Turn | Act, missions: tuple[MissionId, ...]) -> None:
    """Hold the missions whose sealed fields have an end to come."""
    turn.put(POLICY, _DUE, encode(missions))


def newest_keys(turn: Turn | Act, mid: str) -> int | None:
    """Return the number of the record with a mission's newest keys; None: nothing was sealed.

    Raises:
        StoreError: what is held is none.
    """
    held = turn.get(HELD, mid)
    return read_held(held, Kept, HELD).newest if held else None


def policy_of(store: Store, given: SealingPolicy | None) -> SealingPolicy:
    """Return what is sealed: as the gate's configuration says, which the store then holds too.

    Args:
        store: the robot's.
        given: of the configuration; None: who acts on the store has none, and what the last gate
            had goes on.

    Raises:
        StoreError: what is held is none.
    """
    spelled = None if given is None else encode(given)

    def job(turn: Turn) -> bytes | None:
        held = turn.get(POLICY, _NEWEST)
        if spelled is not None and spelled != held and (held or given != SealingPolicy()):
            turn.put(POLICY, _NEWEST, spelled)
        return held

    held = store.run(job)
    if given is not None or not held:
        return given or SealingPolicy()
    return read_held(held, SealingPolicy, POLICY)
