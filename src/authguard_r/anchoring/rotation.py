# SPDX-License-Identifier: Apache-2.0
"""When a log's oldest records go into a sealed segment, so that no file grows for ever.

Only what a checkpoint covers is moved, and a witnessed one where witnesses are asked; the newest
records always stay. Each segment ends with a checkpoint of its own, signed by the gate.
Spec page: docs/spec/store.md#rotation
"""

from __future__ import annotations

from contextlib import suppress

from msgspec import Struct

from authguard_r.anchoring.anchor import AnchorNotice
from authguard_r.anchoring.checkpoints import NEWEST, WITNESSED, StoredNodes, block_root, size_of
from authguard_r.audit.checkpoint import Checkpoint, origin_of
from authguard_r.audit.note import Note
from authguard_r.audit.tree import root_of
from authguard_r.core.errors import AuthGuardError, StoreError
from authguard_r.core.identifiers import Count, RobotId
from authguard_r.core.ports import Turn
from authguard_r.core.principals import Signer
from authguard_r.core.reasons import Reason
from authguard_r.keys.notes import sign_text
from authguard_r.store.cells import Cells
from authguard_r.store.segment_mover import Mover
from authguard_r.store.sqlite import SqliteStore
from authguard_r.store.transactions import Ledger
from authguard_r.wire.gate_limits import LIMITS

#: The alert: what is old stays in the store, which goes on growing.
STUCK = "the log cannot be rotated"


class RotationPolicy(Struct, frozen=True, kw_only=True):
    """When records are moved.

    Args:
        records: while so many lie in the store; 0 moves none.
        witnessed: only what a quorum of witnesses has cosigned.
    """

    records: Count = 0
    witnessed: bool = False


class Rotation:
    """Moves the oldest records of one store into segments, a block at a time.

    Args:
        ledger: the store's.
        store: the store.
        robot: whose it is.
        signer: the gate's own key.
        policy: when.
    """

    def __init__(
        self,
        ledger: Ledger,
        store: SqliteStore,
        *,
        robot: RobotId,
        signer: Signer,
        policy: RotationPolicy,
    ) -> None:
        self._ledger = ledger
        self._mover = Mover(store)
        self._origin = origin_of(robot)
        self._signer = signer
        self._policy = policy
        self._end = 0
        self._again_ms = 0
        self._stuck = False

    def tick(self) -> tuple[AnchorNotice, ...]:
        """Do one step, if one is due; return the messages for people.

        For the one thread that holds the store, between its turns.
        """
        if self._ledger.mono_ms() < self._again_ms:
            return ()
        try:
            works = self._step()
        except AuthGuardError as error:
            return self._give_up(error)
        if not works or not self._stuck:
            return ()
        self._stuck = False
        return (AnchorNotice(STUCK, {}, over=True),)

    def _step(self) -> bool:
        """Do what is next; True when a segment was sealed, or nothing is left to do."""
        mover = self._mover
        if mover.clears:
            mover.clear(LIMITS.rotation_block // 2)
        elif not mover.copies:
            end = self._ledger.peek(self._due)
            if end <= mover.mark:
                return True
            self._end = end
            mover.begin(end)
        elif mover.copy(LIMITS.rotation_block, _require_tree):
            note, head = self._ledger.peek(self._sealed)
            mover.seal(note.encode(), head=head)
            return True
        return False

    def _due(self, turn: Turn) -> int:
        """Return the first record that is not moved now; the mark when there is none to move."""
        most, mark = self._policy.records, self._mover.mark
        size = turn.head()[0]
        if not most or size - mark < most:
            return mark
        covered = [size_of(turn, NEWEST)]
        covered += [size_of(turn, WITNESSED)] if self._policy.witnessed else []
        end = min(*covered, size - min(LIMITS.rotation_kept, most // 4), mark + most)
        return max(mark, end - end % LIMITS.rotation_block)

    def _sealed(self, turn: Turn) -> tuple[Note, bytes]:
        """Return the checkpoint of the segment's last record, signed, and that record's link."""
        head = turn.rows(self._end - 1, 1)[0][3]
        root = root_of(StoredNodes(turn), self._end)
        said = Checkpoint(origin=self._origin, size=self._end, root=root, chain=head).text()
        return Note(said, sign_text(said, self._origin, self._signer)), head

    def _give_up(self, error: AuthGuardError) -> tuple[AnchorNotice, ...]:
        """Free what was written so far, and try again later; raise the alert once."""
        self._again_ms = self._ledger.mono_ms() + LIMITS.rotation_again_ms
        with suppress(StoreError):  # else the next start removes what is not read
            self._mover.abandon()
        if self._stuck:
            return ()
        self._stuck = True
        return (AnchorNotice(STUCK, {"reason": str(error.reason), "why": error.message}),)


def _require_tree(turn: Turn, rows: tuple[Cells, ...]) -> None:
    """Hold a block against the tree that the checkpoints are made of.

    Raises:
        StoreError: it is not the block that was taken into the tree.
    """
    first = rows[0][0]
    if block_root([link for *_, link in rows]) != StoredNodes(turn).node(
        8, first // LIMITS.rotation_block
    ):
        text = f"records {first} to {rows[-1][0]} are not those of the tree"
        raise StoreError(text, where="store.audit", reason=Reason.STORE_CORRUPT)
