# SPDX-License-Identifier: Apache-2.0
"""Small logs, made record by record with the product's own `append`, and the ways to change them.

Salts are numbered, so that a log is the same each time.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec

from authguard_r.audit.checkpoint import Checkpoint, origin_of
from authguard_r.audit.record import Entry, append, evidence, read_record
from authguard_r.audit.tree import Frontier, leaf_hash
from authguard_r.audit.verify import Row
from authguard_r.core.chain import GENESIS, Link, link
from authguard_r.core.encoding import b64, encode_fast
from authguard_r.core.identifiers import Digest, RobotId

START_MS = 1_763_620_000_000
ROBOT = RobotId("courier-1")
Json = dict[str, Any]


class Pages:
    """A turn that keeps what is appended (`core.ports.Turn`)."""

    def __init__(self) -> None:
        self.kept: list[Row] = []

    def get(self, kind: str, key: str) -> bytes | None:
        return None

    def put(self, kind: str, key: str, value: bytes) -> None:
        raise AssertionError("an append holds nothing")

    def head(self) -> tuple[int, bytes]:
        return len(self.kept), self.kept[-1].link if self.kept else GENESIS

    def append(self, record: bytes, sealed: bytes, link: bytes) -> int:
        self.kept.append(Row(len(self.kept), record, sealed, link))
        return len(self.kept) - 1

    def rows(self, first: int, count: int) -> tuple[tuple[int, bytes, bytes, bytes], ...]:
        page = self.kept[max(first, 0) : max(first + count, 0)]
        return tuple((row.seq, row.record, row.sealed, row.link) for row in page)


def entry(number: int) -> Entry:
    """Return an entry of each of several shapes."""
    at = START_MS + number * 500
    if number == 0:
        opened: Json = {"format": 1, "robot": ROBOT, "site": "s", "demo": True}
        return Entry(kind="genesis", time_ms=at, decision="genesis", open=opened)
    shape = number % 3
    if shape == 0:
        opened = {"reasons": [], "ticket": f"t{number}", "used": number}
        sealed: Json = {"findings": []}
        return Entry(
            kind="outcome", time_ms=at, decision="succeeded", open=opened, sealed=sealed, mid="m-1"
        )
    if shape == 1:
        return Entry(kind="stop", time_ms=at, decision="stop", open={"by": "planner", "more": 0})
    opened = {"reasons": ["RATE_LIMITED", 'é\u2028\x1f\\"'], "deviation": [number, 7]}
    sealed = {
        "action": {"type": "navigate", "destination": f"room-{number}"},
        "now": {"utc_ms": at, "mono_ms": -number},
        "who": "Zoë \U0001f916 \x7f",
    }
    return Entry(
        kind="decision", time_ms=at, decision="reject", open=opened, sealed=sealed, mid="m-1"
    )


def log_of(size: int, make: Callable[[int], Entry] = entry) -> list[Row]:
    """Return a log of so many records."""
    pages = Pages()
    for number in range(size):
        made = make(number)
        salts = b"".join(
            (number << 8 | place).to_bytes(16, "big") for place in range(len(made.sealed))
        )
        append(pages, made, salts=salts)
    return pages.kept


def root_of(rows: list[Row]) -> bytes:
    """Return the root of the tree over the rows' links."""
    return Frontier().grown(leaf_hash(row.link) for row in rows).root()


def checkpoint_of(rows: list[Row], robot: RobotId = ROBOT) -> Checkpoint:
    """Return what a gate says of these rows."""
    head = rows[-1].link if rows else None
    return Checkpoint(origin=origin_of(robot), size=len(rows), root=root_of(rows), chain=head)


def rechained(rows: list[Row], start: int = 0) -> list[Row]:
    """Return the rows with every number and link from `start` on worked out anew."""
    done = rows[:start]
    for seq, row in enumerate(rows[start:], start):
        record = read_record(row.record, where="")
        prev = Digest(b64(done[-1].link if done else GENESIS))
        linked: Link = msgspec.structs.replace(
            record.link,
            prev=prev,
            seq=seq,
            evidence=evidence(record.kind, record.open, record.committed),
        )
        forged = msgspec.structs.replace(record, link=linked)
        done.append(Row(seq, encode_fast(forged), row.sealed, link(linked)))
    return done


def edited(row: Row, **fields: Any) -> Row:
    """Return the row with fields of its record (`open`, `kind`, ...) or link taken place of."""
    record = read_record(row.record, where="")
    names = set(record.__struct_fields__)
    outer = {name: value for name, value in fields.items() if name in names}
    inner = {name: value for name, value in fields.items() if name not in names}
    linked = msgspec.structs.replace(record.link, **inner)
    changed = msgspec.structs.replace(record, **{"link": linked, **outer})
    return msgspec.structs.replace(row, record=encode_fast(changed))
