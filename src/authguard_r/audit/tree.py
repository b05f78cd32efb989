# SPDX-License-Identifier: Apache-2.0
"""The Merkle tree over the links of a log, and proofs out of it.

Leaf i is L_i. A root stands for the whole log in 32 bytes. A few hashes prove that one record is in
it (inclusion), or that a longer log begins with a shorter one (consistency), without the log. The
hashes are RFC 6962's, so that any witness can check them.

Source: RFC 6962 section 2.1; theorem "Tamper evidence of the anchored log".
Spec page: docs/spec/checkpoint.md#tree
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import reduce
from hashlib import sha256
from typing import Protocol

from msgspec import Struct

#: The root of a log without records.
EMPTY_ROOT = sha256(b"").digest()
#: Bytes of a hash.
HASH_BYTES = 32


def leaf_hash(data: bytes) -> bytes:
    """Return the hash of a leaf."""
    return sha256(b"\x00" + data).digest()


def node_hash(left: bytes, right: bytes) -> bytes:
    """Return the hash of an inner node."""
    return sha256(b"\x01" + left + right).digest()


class Nodes(Protocol):
    """Where the roots of complete subtrees are found."""

    def node(self, level: int, index: int) -> bytes:
        """Return the root of the leaves from `index << level` on, `1 << level` of them."""
        ...


class Frontier(Struct, frozen=True, kw_only=True):
    """All that is needed to add leaves to a tree and to say its root.

    Args:
        size: number of leaves.
        peaks: roots of the complete subtrees that it falls into, the largest first: one for each
            1 in the binary number `size`.
    """

    size: int = 0
    peaks: tuple[bytes, ...] = ()

    def grown(self, leaves: Iterable[bytes]) -> Frontier:
        """Return the frontier after more leaves, given by their hashes."""
        size, peaks = self.size, list(self.peaks)
        for leaf in leaves:
            peaks.append(leaf)
            full = size  # each 1 at the low end is a subtree that is joined with its neighbor
            while full & 1:
                right = peaks.pop()
                peaks[-1] = node_hash(peaks[-1], right)
                full >>= 1
            size += 1
        return Frontier(size=size, peaks=tuple(peaks))

    def root(self) -> bytes:
        """Return the root of the tree."""
        if not self.peaks:
            return EMPTY_ROOT
        return reduce(lambda right, left: node_hash(left, right), reversed(self.peaks))


def root_of(nodes: Nodes, size: int) -> bytes:
    """Return the root of the first `size` leaves."""
    return root_of_range(nodes, 0, size) if size else EMPTY_ROOT


def consistency_proof(nodes: Nodes, old: int, size: int) -> tuple[bytes, ...]:
    """Return the hashes that show that `size` leaves begin with the first `old` ones.

    Empty for nothing, and for everything: every log begins with none and with itself.

    Raises:
        ValueError: there are not that many leaves: a fault of the caller's.
    """
    if not 0 <= old <= size:
        raise ValueError(f"no {old} leaves among {size}")
    proof: list[bytes] = []
    first, end = 0, size
    known = True  # that the verifier has this subtree's hash: it is the old root itself
    while old not in (0, end):
        middle = first + split_of(end - first)
        if old <= middle:
            proof.append(root_of_range(nodes, middle, end))
            end = middle
        else:
            proof.append(root_of_range(nodes, first, middle))
            first, known = middle, False
    if old and not known:
        proof.append(root_of_range(nodes, first, end))
    return tuple(reversed(proof))


def verify_consistency(
    old: int, size: int, old_root: bytes, root: bytes, proof: tuple[bytes, ...]
) -> bool:
    """Return whether the proof shows that the longer log begins with the shorter one.

    Args:
        old: number of leaves under `old_root`.
        size: number of leaves under `root`.
        old_root: as it was seen.
        root: as it is said to be now.
        proof: from anyone.
    """
    if old == 0:
        return old_root == EMPTY_ROOT and not proof and (size > 0 or root == EMPTY_ROOT)
    if old == size:
        return old_root == root and not proof
    if not 0 < old < size:
        return False
    whole = old & (old - 1) == 0  # one complete subtree: its root is the first hash
    hashes = (old_root, *proof) if whole else proof
    if not hashes:
        return False
    node, last = old - 1, size - 1
    while node & 1:
        node, last = node >> 1, last >> 1
    before = after = hashes[0]
    for sibling in hashes[1:]:
        if last == 0:
            return False
        if node & 1 or node == last:
            before, after = node_hash(sibling, before), node_hash(sibling, after)
            while node and not node & 1:
                node, last = node >> 1, last >> 1
        else:
            after = node_hash(after, sibling)
        node, last = node >> 1, last >> 1
    return last == 0 and (before, after) == (old_root, root)


def split_of(count: int) -> int:
    """Return the largest power of two that is smaller than `count`, which is 2 or more."""
    return 1 << (count - 1).bit_length() - 1


def root_of_range(nodes: Nodes, first: int, end: int) -> bytes:
    """Return the root of a range as RFC 6962 splits it: it begins at a complete subtree."""
    count = end - first
    if count & (count - 1) == 0:
        level = count.bit_length() - 1
        return nodes.node(level, first >> level)
    middle = first + split_of(count)
    return node_hash(root_of_range(nodes, first, middle), root_of_range(nodes, middle, end))
