# SPDX-License-Identifier: Apache-2.0
"""The tree is RFC 6962's, and a proof shows what it says it shows and nothing else.

Source: RFC 6962 section 2.1; docs/spec/checkpoint.md#tree
"""

from __future__ import annotations

from hashlib import sha256
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from authguard_r.audit.tree import (
    EMPTY_ROOT,
    Frontier,
    consistency_proof,
    leaf_hash,
    node_hash,
    root_of,
    verify_consistency,
)
from fixtures.amount import amount
from fixtures.inclusion import inclusion_proof, verify_inclusion
from fixtures.memory_tree import MemoryTree

MOST = 64
LAW = settings(max_examples=amount(60, 300))
#: Leaves and roots of the test data of Certificate Transparency.
CT_LEAVES = [
    bytes.fromhex(text)
    for text in (
        *("", "00", "10", "2021", "3031", "40414243", "5051525354555657"),
        "606162636465666768696a6b6c6d6e6f",
    )
]
CT_ROOTS = (
    "6e340b9cffb37a989ca544e6bb780a2c78901d3fb33738768511a30617afa01d",
    "fac54203e7cc696cf0dfcb42c92a1d9dbaf70ad9e621f4bd8d98662f00e3c125",
    "aeb6bcfe274b70a14fb067a5e5578264db0fa9b51af5e0ba159158f329e06e77",
    "d37ee418976dd95753c1c73862b9398fa2a2cf9b4ff0fdfe8b30cd95209614b7",
    "4e3bbb1f7b478dcfe71fb631631519a3bca12c9aefca1612bfce4c13a86264d4",
    "76e67dadbcdf1e10e1b74ddc608abd2f98dfb16fbce75277b5232a127f2087ef",
    "ddb89be403809e325750d3d263cd78929c2942b7942a34b77e122c9594a74c8c",
    "5dc9da79a70659a9ad559cb701ded9a2ab9d823aad2f4960cfe370eff4604328",
)


# the second opinion: RFC 6962 as it is written, over lists of leaves


def split(n: int) -> int:
    k = 1
    while k * 2 < n:
        k *= 2
    return k


def mth(leaves: list[bytes]) -> bytes:
    n = len(leaves)
    if n == 0:
        return sha256(b"").digest()
    if n == 1:
        return sha256(b"\x00" + leaves[0]).digest()
    k = split(n)
    return sha256(b"\x01" + mth(leaves[:k]) + mth(leaves[k:])).digest()


def path(m: int, leaves: list[bytes]) -> list[bytes]:
    n = len(leaves)
    if n == 1:
        return []
    k = split(n)
    if m < k:
        return [*path(m, leaves[:k]), mth(leaves[k:])]
    return [*path(m - k, leaves[k:]), mth(leaves[:k])]


def subproof(m: int, leaves: list[bytes], *, known: bool) -> list[bytes]:
    n = len(leaves)
    if m == n:
        return [] if known else [mth(leaves)]
    k = split(n)
    if m <= k:
        return [*subproof(m, leaves[:k], known=known), mth(leaves[k:])]
    return [*subproof(m - k, leaves[k:], known=False), mth(leaves[:k])]


def leaves_of(size: int) -> list[bytes]:
    return [f"leaf {number}".encode() for number in range(size)]


def tree_of(leaves: list[bytes]) -> MemoryTree:
    tree = MemoryTree()
    for leaf in leaves:
        tree.append(leaf_hash(leaf))
    return tree


LEAVES = leaves_of(MOST)
TREE = tree_of(LEAVES)
ROOTS = [mth(LEAVES[:size]) for size in range(MOST + 1)]


def test_the_reference_roots_of_certificate_transparency() -> None:
    tree = tree_of(CT_LEAVES)
    for size, root in enumerate(CT_ROOTS, 1):
        assert root_of(tree, size).hex() == root
        assert Frontier().grown(map(leaf_hash, CT_LEAVES[:size])).root().hex() == root
    assert root_of(tree, 0) == Frontier().root() == EMPTY_ROOT == sha256(b"").digest()


def test_frontier_and_tree_agree_with_the_rfc_at_every_size() -> None:
    frontier = Frontier()
    for size in range(MOST + 1):
        assert frontier.size == size
        assert len(frontier.peaks) == size.bit_count()
        assert frontier.root() == root_of(TREE, size) == ROOTS[size]
        if size < MOST:
            frontier = frontier.grown([leaf_hash(LEAVES[size])])
    assert TREE.size == MOST


@pytest.mark.parametrize("cuts", [(0, 1, 64), (0, 7, 8, 9, 63, 64), (0, 31, 33, 64)])
def test_a_frontier_that_grows_in_parts_is_the_one_that_grew_at_once(cuts: tuple[int, ...]) -> None:
    frontier = Frontier()
    for first, end in pairwise(cuts):
        frontier = frontier.grown(map(leaf_hash, LEAVES[first:end]))
    assert frontier == Frontier().grown(map(leaf_hash, LEAVES))
    assert frontier.grown([]) == frontier


def test_every_inclusion_proof_is_the_rfcs_and_holds_at_its_own_place_alone() -> None:
    for size in range(1, MOST + 1):
        root = ROOTS[size]
        for index in range(size):
            proof = inclusion_proof(TREE, index, size)
            assert list(proof) == path(index, LEAVES[:size])
            leaf = leaf_hash(LEAVES[index])
            assert verify_inclusion(leaf, index, size, proof, root)
            other = (index + 1) % size
            assert other == index or not verify_inclusion(leaf, other, size, proof, root)
            assert not verify_inclusion(leaf_hash(b"other"), index, size, proof, root)
            assert not verify_inclusion(leaf, index, size, (*proof, root), root)
            assert not proof or not verify_inclusion(leaf, index, size, proof[:-1], root)
            assert not verify_inclusion(leaf, index, size, proof, ROOTS[size - 1])


def test_every_consistency_proof_is_the_rfcs_and_holds_between_its_own_roots_alone() -> None:
    for size in range(MOST + 1):
        for old in range(size + 1):
            proof = consistency_proof(TREE, old, size)
            expected = subproof(old, LEAVES[:size], known=True) if old else []
            assert list(proof) == expected
            before, after = ROOTS[old], ROOTS[size]
            assert verify_consistency(old, size, before, after, proof)
            wrong = sha256(before).digest()
            assert not verify_consistency(old, size, wrong, after, proof)
            assert old == 0 or not verify_consistency(old, size, before, wrong, proof)
            assert not verify_consistency(old, size, before, after, (*proof, wrong))
            assert not proof or not verify_consistency(old, size, before, after, proof[:-1])


def test_a_proof_about_nothing_is_refused() -> None:
    leaf, root = leaf_hash(LEAVES[0]), ROOTS[1]
    for index, size in ((-1, 1), (1, 1), (0, 0), (2, 1)):
        assert not verify_inclusion(leaf, index, size, (), root)
        with pytest.raises(ValueError, match="no leaf"):
            inclusion_proof(TREE, index, size)
    for old, size in ((2, 1), (-1, 1)):
        assert not verify_consistency(old, size, ROOTS[1], ROOTS[1], ())
        with pytest.raises(ValueError, match="leaves among"):
            consistency_proof(TREE, old, size)
    # between trees of other sizes something has to be shown
    assert not verify_consistency(3, 5, ROOTS[3], ROOTS[5], ())
    assert not verify_consistency(4, 5, ROOTS[4], ROOTS[5], ())


def test_an_empty_log_is_the_beginning_of_every_log_and_of_no_other_root() -> None:
    assert verify_consistency(0, 0, EMPTY_ROOT, EMPTY_ROOT, ())
    assert verify_consistency(0, 5, EMPTY_ROOT, ROOTS[5], ())
    assert not verify_consistency(0, 0, EMPTY_ROOT, ROOTS[1], ())
    assert not verify_consistency(0, 5, ROOTS[1], ROOTS[5], ())
    assert not verify_consistency(0, 5, EMPTY_ROOT, ROOTS[5], (ROOTS[1],))


def test_leaves_and_nodes_are_told_apart() -> None:
    left, right = leaf_hash(b"a"), leaf_hash(b"b")
    assert node_hash(left, right) != leaf_hash(left + right)  # no leaf passes for two


@LAW
@given(data=st.data(), size=st.integers(1, MOST))
def test_no_changed_proof_verifies(data: st.DataObject, size: int) -> None:
    index = data.draw(st.integers(0, size - 1))
    old = data.draw(st.integers(0, size))
    leaf = leaf_hash(LEAVES[index])
    proof = inclusion_proof(TREE, index, size)
    changed = data.draw(mutations(proof))
    assert changed == proof or not verify_inclusion(leaf, index, size, changed, ROOTS[size])
    proof = consistency_proof(TREE, old, size)
    changed = data.draw(mutations(proof))
    holds = verify_consistency(old, size, ROOTS[old], ROOTS[size], changed)
    assert changed == proof or not holds


@st.composite
def mutations(draw: st.DrawFn, proof: tuple[bytes, ...]) -> tuple[bytes, ...]:
    """Return the proof with a bit turned, a hash lost, doubled, moved or put in."""
    hashes = list(proof)
    trick = draw(st.sampled_from(["turn", "drop", "twice", "swap", "insert"]))
    if trick == "insert" or not hashes:
        at = draw(st.integers(0, len(hashes)))
        hashes.insert(at, draw(st.sampled_from(ROOTS) | st.binary(min_size=32, max_size=32)))
        return tuple(hashes)
    at, other = draw(st.integers(0, len(hashes) - 1)), draw(st.integers(0, len(hashes) - 1))
    if trick == "turn":
        bit = draw(st.integers(0, 255))
        number = int.from_bytes(hashes[at], "big") ^ 1 << bit
        hashes[at] = number.to_bytes(32, "big")
    elif trick == "drop":
        del hashes[at]
    elif trick == "twice":
        hashes.insert(at, hashes[at])
    else:
        hashes[at], hashes[other] = hashes[other], hashes[at]
    return tuple(hashes)
