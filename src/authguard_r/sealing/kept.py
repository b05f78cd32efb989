# SPDX-License-Identifier: Apache-2.0
"""What a store holds of sealed fields: where keys are told, and whose fields are kept.

Spec page: docs/spec/sealed-fields.md#retention
"""

from __future__ import annotations

from msgspec import Struct

from authguard_r.core.encoding import encode
from authguard_r.core.identifiers import Count, MissionId
from authguard_r.core.ports import Turn
from authguard_r.ledger import Act, read_held
from authguard_r.sealing.policy import POLICY

#: Where the store holds which record tells the newest keys of a mission.
HELD = "sealing"
_DUE = "due"


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
