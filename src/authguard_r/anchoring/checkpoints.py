# SPDX-License-Identifier: Apache-2.0
"""Makes checkpoints of a store's log, in turns of their own: no decision waits for a tree.

Held beside the log are the frontier, the roots of every 256 records and of 256 times more on each
level above, and the newest signed note. None of it is bound by the chain: who reads it holds it
against the log. Spec page: docs/spec/rollback.md#checkpoints
"""

from __future__ import annotations

from collections.abc import Iterable

from msgspec import Struct

from authguard_r.anchoring import growth
from authguard_r.audit.checkpoint import Checkpoint, origin_of, read_checkpoint
from authguard_r.audit.note import Note, read_note
from authguard_r.audit.tree import HASH_BYTES, Frontier, consistency_proof, leaf_hash, root_of
from authguard_r.core.encoding import b64, decode, encode, unb64
from authguard_r.core.errors import MalformedError, StoreError
from authguard_r.core.identifiers import Count, RobotId
from authguard_r.core.ports import Turn
from authguard_r.core.principals import Signer
from authguard_r.core.reasons import Reason
from authguard_r.keys.notes import sign_text
from authguard_r.store.transactions import Ledger
from authguard_r.wire.gate_limits import LIMITS

#: Where the newest note lies, and the newest that enough witnesses have cosigned.
CHECKPOINT, NEWEST, WITNESSED = "checkpoint", "newest", "witnessed"
#: Where the tree lies.
TREE, FRONTIER = "tree", "frontier"
#: Roots of complete subtrees of these levels are held; lower ones come from the links.
LEVELS = (8, 16, 24, 32)
_STEP = LEVELS[0]
_BLOCK = 1 << _STEP


class _StoredFrontier(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A frontier as a store holds it, its hashes in base64url."""

    size: Count
    peaks: tuple[str, ...]


class StoredNodes:
    """Roots of complete subtrees out of a store (`audit.tree.Nodes`).

    A proof of n records reads at most 256 links, and 256 held roots for each level above.

    Args:
        turn: a view of the store, for as long as this is used.
    """

    def __init__(self, turn: Turn) -> None:
        self._turn = turn

    def node(self, level: int, index: int) -> bytes:
        """Return a complete subtree's root.

        Raises:
            StoreError: the store does not hold what it takes (`STORE_CORRUPT`).
        """
        if level not in LEVELS:
            return self.folded(level, index)
        held = self._turn.get(TREE, f"{level}.{index}")
        if held is None or len(held) != HASH_BYTES:
            raise _corrupt(f"{TREE}.{level}.{index}")
        return held

    def folded(self, level: int, index: int) -> bytes:
        """Return a complete subtree's root out of those that are held below it.

        Raises:
            StoreError: as above.
        """
        below = max((step for step in LEVELS if step < level), default=0)
        count = 1 << level - below
        first = index * count
        if below:
            nodes = [self.node(below, number) for number in range(first, first + count)]
        else:
            nodes = leaves(self._turn, first, count)
        return Frontier().grown(nodes).root()


def block_root(links: Iterable[bytes]) -> bytes:
    """Return the root of the tree over a few links alone."""
    return Frontier().grown(map(leaf_hash, links)).root()


def size_of(turn: Turn, key: str) -> int:
    """Return how many records a held note covers, 0 when there is none.

    Raises:
        MalformedError: what is held is no checkpoint.
    """
    note = _note(turn, key)
    return 0 if note is None else read_checkpoint(note.text, where=CHECKPOINT).size


def leaves(turn: Turn, first: int, count: int) -> list[bytes]:
    """Return the leaf hashes of so many records.

    Raises:
        StoreError: they are not all there.
    """
    found = [leaf_hash(link) for _, _, _, link in turn.rows(first, count)]
    if len(found) != count:
        raise _corrupt(f"audit.{first + len(found)}")
    return found


class Checkpoints:
    """The checkpoints of one store's log.

    Args:
        ledger: the store.
        robot: whose log it is.
        signer: the gate's own key; None makes none, and still holds the store to what it has.
    """

    def __init__(self, ledger: Ledger, *, robot: RobotId, signer: Signer | None) -> None:
        self._ledger = ledger
        self._origin = origin_of(robot)
        self._signer = signer
        #: The newest note that was made since the start; None before the first.
        self.newest: Note | None = None
        self._size = 0

    def fits(self) -> bool:
        """Return whether the log is the one that the store's own checkpoint and tree speak of.

        The signature is not checked: the key may have been another one's then.
        """
        try:
            return self._ledger.peek(self._fits)
        except (MalformedError, StoreError):
            return False

    def held(self, key: str = NEWEST) -> Note | None:
        """Return the newest note, or the newest that enough witnesses cosigned.

        Raises:
            MalformedError: what is held is no note.
        """
        return self._ledger.peek(lambda turn: _note(turn, key))

    @property
    def size(self) -> int:
        """How many records it covers."""
        return self._size

    def make(self) -> None:
        """Make a checkpoint of everything that is committed, unless there is one.

        Raises:
            StoreError: it is not held; the last one still is.
            EnvironmentFault: the key cannot be used.
        """
        while not self.step():
            pass

    def step(self) -> bool:
        """Do one turn's worth; True when the newest checkpoint covers the log, signed by this key.

        Raises:
            StoreError, EnvironmentFault: as above.
        """
        signer = self._signer
        if signer is None:
            return True
        note = self._ledger.store.run(lambda turn: self._grow(turn, signer))
        if note is None:
            return False
        if note != self.newest:
            self.newest, self._size = note, read_checkpoint(note.text, where=CHECKPOINT).size
        return True

    def keep(self, note: Note, *, witnessed: bool) -> None:
        """Hold the cosignatures that came, if the note is still the newest.

        Args:
            note: one that was the newest; its signatures have been verified.
            witnessed: enough witnesses have cosigned it: then it is held in any case.
        """

        def job(turn: Turn) -> None:
            newest = _note(turn, NEWEST)
            if newest is not None and newest.text == note.text:
                turn.put(CHECKPOINT, NEWEST, note.encode())
            if witnessed:
                turn.put(CHECKPOINT, WITNESSED, note.encode())

        self._ledger.store.run(job)
        if self.newest is not None and self.newest.text == note.text:
            self.newest = note

    def proof(self, old: int, size: int) -> tuple[bytes, ...]:
        """Return the proof that the log of `size` records begins with its first `old` ones.

        Raises:
            StoreError: the store does not hold what it takes.
        """
        return self._ledger.peek(lambda turn: consistency_proof(StoredNodes(turn), old, size))

    def restart(self) -> None:
        """Forget tree and notes: a person has accepted the log as it is.

        Raises:
            StoreError: they are still held.
        """

        def job(turn: Turn) -> None:
            _put_frontier(turn, Frontier())
            turn.put(CHECKPOINT, NEWEST, b"")
            turn.put(CHECKPOINT, WITNESSED, b"")

        self._ledger.store.run(job, essential=True)
        self.newest, self._size = None, 0

    def _fits(self, turn: Turn) -> bool:
        frontier, size = _frontier(turn), turn.head()[0]
        nodes = StoredNodes(turn)
        if frontier.size > size or frontier.root() != root_of(nodes, frontier.size):
            return False
        note = _note(turn, NEWEST)
        if note is None:
            return True
        said = read_checkpoint(note.text, where=CHECKPOINT)
        if said.origin != self._origin or not 0 < said.size <= frontier.size:
            return False
        link = turn.rows(said.size - 1, 1)[0][3]
        return (said.root, said.chain) == (root_of(nodes, said.size), link)

    def _grow(self, turn: Turn, signer: Signer) -> Note | None:
        """Take a page into the tree; return the note when that was the last."""
        growth.count(turn)
        before, (size, head) = _frontier(turn), turn.head()
        frontier = _grown(turn, before, min(size, before.size + LIMITS.tree_page))
        if frontier.size > before.size:
            _put_frontier(turn, frontier)
        if frontier.size < size:
            return None
        text = Checkpoint(origin=self._origin, size=size, root=frontier.root(), chain=head).text()
        if self.newest is not None and self.newest.text == text:
            return self.newest
        held = _note(turn, NEWEST)  # of an earlier start, perhaps signed by an earlier key
        others = held.signatures if held is not None and held.text == text else ()
        signatures = (
            *sign_text(text, self._origin, signer),
            *(one for one in others if one.name != self._origin),  # witnesses'
        )
        note = Note(text, signatures)
        turn.put(CHECKPOINT, NEWEST, note.encode())
        return note


def held_notes(turn: Turn) -> tuple[str, ...]:
    """Return the checkpoints that a store holds, the newest first; they are not verified here."""
    held = (turn.get(CHECKPOINT, key) for key in (NEWEST, WITNESSED))
    return tuple(note.decode("utf-8", "replace") for note in dict.fromkeys(held) if note)


def _grown(turn: Turn, frontier: Frontier, size: int) -> Frontier:
    """Return the frontier of more records, holding the roots that were completed."""
    blocks = frontier.size >> _STEP
    upper = Frontier(size=blocks, peaks=frontier.peaks[: blocks.bit_count()])
    low = Frontier(size=frontier.size % _BLOCK, peaks=frontier.peaks[blocks.bit_count() :])
    at = frontier.size
    while at < size:
        count = min(_BLOCK - low.size, size - at)
        low, at = low.grown(leaves(turn, at, count)), at + count
        if low.size == _BLOCK:
            _hold_roots(turn, upper.size, low.root())
            upper, low = upper.grown((low.root(),)), Frontier()
    return Frontier(size=size, peaks=(*upper.peaks, *low.peaks))


def _hold_roots(turn: Turn, block: int, root: bytes) -> None:
    """Hold the root of a block of 256 records, and of every subtree that ends with it."""
    turn.put(TREE, f"{_STEP}.{block}", root)
    nodes, end = StoredNodes(turn), (block + 1) << _STEP
    for level in LEVELS[1:]:
        if end % (1 << level) == 0:
            index = (end >> level) - 1
            turn.put(TREE, f"{level}.{index}", nodes.folded(level, index))


def _put_frontier(turn: Turn, frontier: Frontier) -> None:
    held = _StoredFrontier(size=frontier.size, peaks=tuple(b64(peak) for peak in frontier.peaks))
    turn.put(TREE, FRONTIER, encode(held))


def _frontier(turn: Turn) -> Frontier:
    data = turn.get(TREE, FRONTIER)
    if not data:
        return Frontier()
    try:
        held = decode(data, _StoredFrontier, where=FRONTIER)
        peaks = tuple(unb64(peak, where=FRONTIER) for peak in held.peaks)
    except MalformedError as error:
        raise _corrupt(FRONTIER) from error
    if len(peaks) != held.size.bit_count() or any(len(peak) != HASH_BYTES for peak in peaks):
        raise _corrupt(FRONTIER)
    return Frontier(size=held.size, peaks=peaks)


def _note(turn: Turn, key: str) -> Note | None:
    data = turn.get(CHECKPOINT, key)
    return read_note(data, where=CHECKPOINT) if data else None


def _corrupt(where: str) -> StoreError:
    return StoreError("the tree is not whole", where=f"store.{where}", reason=Reason.STORE_CORRUPT)
