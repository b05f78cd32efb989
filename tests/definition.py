# SPDX-License-Identifier: Apache-2.0
"""Verification of a log as it is defined, check by check, so that a check can be taken out.

Slow and plain, and a second opinion on `verify_rows`; without a check an attack has to win here,
or the game could not be lost.
"""

from __future__ import annotations

from collections.abc import Sequence

from auditing import Told
from authguard_r.audit.record import commit, evidence, read_record, read_sealed
from authguard_r.audit.tree import Frontier, leaf_hash
from authguard_r.audit.verify import Anchor, Row
from authguard_r.core.chain import GENESIS, link
from authguard_r.core.encoding import b64
from authguard_r.core.errors import MalformedError

#: What is looked at: of each record, at each checkpoint, and at the end.
CHECKS = frozenset({"number", "follows", "evidence", "link", "value", "head", "root", "length"})
NOTHING: frozenset[str] = frozenset()


def plain(
    rows: Sequence[Row], anchors: Sequence[Anchor], *, without: frozenset[str] = NOTHING
) -> Told:
    """Return whether a log is whole, and how many of its records are vouched for.

    Args:
        rows: the log.
        anchors: what authentic checkpoints say.
        without: the checks that are left out.
    """
    left = sorted(anchors, key=lambda anchor: anchor.size)
    prev, frontier, vouched = GENESIS, Frontier(), 0
    for seq, row in enumerate(rows):
        if _faults(row, seq, prev) - without:
            return Told(whole=False, where=f"record {seq}")
        prev, frontier = row.link, frontier.grown((leaf_hash(row.link),))
        while left and left[0].size == seq + 1:
            anchor = left.pop(0)
            differs = {"head": anchor.head != row.link, "root": anchor.root != frontier.root()}
            if {name for name, wrong in differs.items() if wrong} - without:
                return Told(whole=False)
            vouched = anchor.size
    return Told(whole=not left or "length" in without, size=vouched)


def _faults(row: Row, seq: int, prev: bytes) -> set[str]:
    try:
        record, sealed = read_record(row.record, where=""), read_sealed(row.sealed, where="")
    except MalformedError:
        return {"record"}
    stated = evidence(record.kind, record.open, record.committed)
    wrong = {
        "number": not row.seq == record.link.seq == seq,
        "follows": record.link.prev != b64(prev),
        "evidence": record.link.evidence != stated,
        "link": link(record.link) != row.link,
        "value": any(record.committed.get(n) != commit(n, item) for n, item in sealed.items()),
    }
    return {name for name, is_wrong in wrong.items() if is_wrong}
