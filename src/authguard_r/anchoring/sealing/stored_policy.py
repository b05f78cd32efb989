# SPDX-License-Identifier: Apache-2.0
"""What a store holds of sealed fields: where keys are recorded, and whose fields are kept.

Spec page: docs/spec/sealed-fields.md#retention
"""

from __future__ import annotations

from msgspec import Struct

from authguard_r.anchoring.sealing.policy import SealingPolicy
from authguard_r.core.encoding import encode
from authguard_r.core.errors import StoreError
from authguard_r.core.identifiers import Count, Digest, MissionId, Positive
from authguard_r.core.lifecycle import TERMINAL
from authguard_r.core.mission import DataClass, Mission
from authguard_r.core.ports import Store, Turn
from authguard_r.core.reasons import Reason
from authguard_r.store.transactions import Transaction, read_held

#: Where the store holds which record has the newest keys of a mission.
HELD = "sealing"
#: Where it holds what the last gate sealed, and the missions whose fields have an end to come.
POLICY, _NEWEST, _DUE = "sealing-policy", "newest", "due"
#: Where it holds which mission's token was taken in last.
_LAST = "last"
#: Where it holds when a mission expires.
_EXPIRY = "sealing-expiry"
#: Where it holds the retention times that a mission's newest version has of its own.
_RETENTION = "sealing-retention"


class KeyRecords(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Which records tell the keys of a mission.

    Args:
        newest: number of the last of them; each names the one before it.
    """

    newest: Count


def due_missions(turn: Turn | Transaction) -> tuple[MissionId, ...]:
    """Return the missions whose sealed fields have an end to come.

    Raises:
        StoreError: what is held is no list of them.
    """
    held = turn.get(POLICY, _DUE)
    return read_held(held, tuple[MissionId, ...], POLICY) if held else ()


def hold_due(turn: Turn | Transaction, missions: tuple[MissionId, ...]) -> None:
    """Hold the missions whose sealed fields have an end to come."""
    turn.put(POLICY, _DUE, encode(missions))


def add_due(turn: Turn | Transaction, mid: MissionId) -> None:
    """Add a mission to those whose sealed fields have an end to come, once."""
    due = due_missions(turn)
    if mid not in due:
        hold_due(turn, (*due, mid))


def has_retention(turn: Turn | Transaction, mid: str) -> bool:
    """Return whether the newest version of a mission has retention times of its own."""
    return bool(turn.get(_RETENTION, mid))


def hold_retention(act: Transaction, mission: Mission) -> None:
    """Hold a mission's own retention times in place of those of the version before."""
    if mission.retention:
        act.put(_RETENTION, mission.mid, encode(mission.retention))
        add_due(act, mission.mid)
    elif has_retention(act, mission.mid):
        act.put(_RETENTION, mission.mid, b"")


def retention_of(turn: Turn | Transaction, mid: str, policy: SealingPolicy) -> dict[DataClass, int]:
    """Return how long after its expiry a mission's sealed fields are kept, in milliseconds.

    Args:
        turn: reads the store.
        mid: the mission.
        policy: the gate's newest; its bounds hold for a mission that began under others, too.

    Returns:
        The mission's own time of a class, else the policy's; an absent class has no end.

    Raises:
        StoreError: what the store holds are no times.
    """
    held, most_ms = turn.get(_RETENTION, mid), policy.most_ms
    own = read_held(held, dict[DataClass, Positive], _RETENTION) if held else {}
    times = {data: max(kept_ms, policy.least_ms) for data, kept_ms in own.items()}
    return most_ms | {data: min(ms, most_ms.get(data, ms)) for data, ms in times.items()}


def newest_keys(turn: Turn | Transaction, mid: str) -> int | None:
    """Return the number of the record with a mission's newest keys; None: nothing was sealed.

    Raises:
        StoreError: the stored value is not valid.
    """
    held = turn.get(HELD, mid)
    return read_held(held, KeyRecords, HELD).newest if held else None


def hold_expiry(act: Transaction, mid: MissionId, expiry_ms: int) -> None:
    """Hold when the newest version of a mission expires: its token does not stay."""
    act.put(_EXPIRY, mid, str(expiry_ms).encode("ascii"))


def drop_last(act: Transaction, mid: MissionId, digest: Digest) -> None:
    """Keep the token of the mission that was active before no longer, once it is over.

    Only where the log is sealed: elsewhere it says all of it anyway.

    Args:
        act: the activation of the next one.
        mid: that one's.
        digest: that one's.
    """
    last, _, before = (act.get(POLICY, _LAST) or b"").decode("ascii", "replace").partition(" ")
    standing = act.standing(MissionId(last)) if last and last != mid else None
    is_over = standing is not None and standing.status in TERMINAL and not standing.open
    if is_over and act.seals:
        act.drop_token(Digest(before))
    act.put(POLICY, _LAST, f"{mid} {digest}".encode("ascii"))


def expiry_ms(act: Transaction, mid: MissionId) -> int | None:
    """Return when the newest version of a mission expires; None: an older store did not hold it.

    Raises:
        StoreError: what the store holds is no time.
    """
    held = act.get(_EXPIRY, mid)
    if held is not None and not held.isdigit():
        text = f"expected when `{mid}` expires"
        raise StoreError(text, where=f"store.{_EXPIRY}", reason=Reason.STORE_CORRUPT)
    return None if held is None else int(held)


def policy_of(store: Store, given: SealingPolicy | None) -> SealingPolicy:
    """Return what is sealed: as the gate's configuration says, else as the store holds it.

    Args:
        store: the robot's.
        given: of the configuration; None: who acts on the store has none, and what the last gate
            had goes on.

    Raises:
        StoreError: the stored value is not valid.
    """
    held = None if given is not None else store.read(lambda turn: turn.get(POLICY, _NEWEST))
    return read_held(held, SealingPolicy, POLICY) if held else given or SealingPolicy()


def hold_policy(store: Store, given: SealingPolicy | None) -> None:
    """Hold what a gate's configuration says, for those who act on the store when no gate runs.

    Asked once it is known that the store is this gate's.
    """
    spelled = None if given is None else encode(given)

    def job(turn: Turn) -> None:
        held = turn.get(POLICY, _NEWEST)
        if spelled is not None and spelled != held and (held or given != SealingPolicy()):
            turn.put(POLICY, _NEWEST, spelled)

    store.run(job)
