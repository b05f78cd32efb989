# SPDX-License-Identifier: Apache-2.0
"""Is this log whole, and says who? Reads rows, trusts nothing in them.

A chain by itself shows that nothing inside was changed; only a terminal digest that was signed
and kept elsewhere shows that nothing is missing at the end. The answer always says which of the
two was looked at. Source: theorem "Tamper evidence of the anchored log".
Spec page: docs/spec/audit-record.md#verification
"""

from __future__ import annotations

from collections.abc import Iterable

from msgspec import Struct

from authguard_r.audit.record import Terminal, commit, evidence, read_record, read_sealed
from authguard_r.core.chain import GENESIS, link
from authguard_r.core.encoding import b64
from authguard_r.core.errors import MalformedError


class Row(Struct, frozen=True):
    """One stored row: number, record, the values beside it, and its link."""

    seq: int
    record: bytes
    sealed: bytes
    link: bytes


class Verification(Struct, frozen=True, kw_only=True):
    """What was found.

    Args:
        whole: every record follows from the one before and matches its own digests.
        size: records read.
        head: the last link, base64url.
        anchored: `unanchored`, or `signed-terminal` when an authentic terminal digest fits.
        anchored_size: how many records that digest covers.
        fault: the first thing that is wrong, empty when nothing is.
        where: the record that it is wrong at.
    """

    whole: bool
    size: int
    head: str
    anchored: str = "unanchored"
    anchored_size: int = 0
    fault: str = ""
    where: str = ""


def verify_rows(rows: Iterable[Row], *, terminal: Terminal | None) -> Verification:
    """Return whether the chain holds, and whether it fits the terminal digest.

    Args:
        rows: the log, in order, from a store that nobody trusts.
        terminal: an authentic signed terminal digest, None when there is none.
    """
    prev, size, anchored = GENESIS, 0, 0
    for row in rows:
        fault = _fault(row, size, prev)
        if fault:
            return Verification(
                whole=False, size=size, head=b64(prev), fault=fault, where=f"record {size}"
            )
        prev, size = row.link, size + 1
        if terminal is not None and terminal.size == size:
            if terminal.head != b64(prev):
                return _broken(size, prev, f"expected the signed head {terminal.head}")
            anchored = size
    if terminal is not None and anchored == 0:
        return _broken(size, prev, f"expected at least the {terminal.size} signed records")
    return Verification(
        whole=True,
        size=size,
        head=b64(prev),
        anchored="signed-terminal" if anchored else "unanchored",
        anchored_size=anchored,
    )


def _broken(size: int, prev: bytes, fault: str) -> Verification:
    return Verification(
        whole=False, size=size, head=b64(prev), fault=fault, where=f"record {max(size - 1, 0)}"
    )


def _fault(row: Row, seq: int, prev: bytes) -> str:
    """Return what is wrong with one row, empty when nothing is."""
    try:
        record = read_record(row.record, where=f"record {seq}")
        sealed = read_sealed(row.sealed, where=f"record {seq}")
    except MalformedError as error:
        return f"not a record: {error.message}"
    if row.seq != seq or record.link.seq != seq:
        return f"expected record {seq}, found {record.link.seq}: missing, inserted or reordered"
    if record.link.prev != b64(prev):
        return "does not follow the record before it"
    if record.link.evidence != evidence(record.kind, record.open, record.committed):
        return "its fields do not match their digest"
    if link(record.link) != row.link:
        return "its link does not match its fields"
    for name, item in sealed.items():
        if record.committed.get(name) != commit(name, item):
            return f"the value `{name}` does not match its commitment"
    return ""
