# SPDX-License-Identifier: Apache-2.0
"""Stores with segments, for tests: records are moved as a gate moves them, at once."""

from __future__ import annotations

from collections.abc import Callable

import worlds
from authguard_r.assembly import folder_signer
from authguard_r.audit.checkpoint import Checkpoint, origin_of
from authguard_r.audit.note import Note
from authguard_r.audit.record import Entry, append
from authguard_r.audit.tree import Frontier, leaf_hash
from authguard_r.core.identifiers import RobotId
from authguard_r.core.ports import Turn
from authguard_r.keys.notes import sign_text
from authguard_r.store.moving import Mover
from authguard_r.store.sqlite import SqliteStore

ROBOT = RobotId("porter-1")
#: A value that is to be found in no file once it is let go.
SECRET = "a secret that is told again "


def fill(store: SqliteStore, count: int, *, secret: str = SECRET) -> None:
    """Append records, each with two sealed values of its own."""

    def job(turn: Turn) -> None:
        for _ in range(count):
            seq = turn.head()[0]
            sealed = {"here": f"{secret}{seq}", "there": f"what stays {seq}"}
            entry = Entry(kind="stop", time_ms=1, decision="stop", open={}, sealed=sealed)
            append(turn, entry, salts=bytes(32))

    store.run(job)


def note(links: list[bytes], robot: RobotId = ROBOT) -> bytes:
    """Return the gate's checkpoint of a log with these links."""
    root = Frontier().grown(map(leaf_hash, links)).root()
    origin = origin_of(robot)
    text = Checkpoint(origin=origin, size=len(links), root=root, chain=links[-1]).text()
    signer = folder_signer(worlds.trust_folder(), f"gate-{worlds.RID}")
    return Note(text, sign_text(text, origin, signer)).encode()


def rotate(store: SqliteStore, end: int, *, clear: bool = True) -> None:
    """Move every record before `end` into one more segment."""
    mover = Mover(store)
    steps = [*copying(mover, store, end)]
    for step in steps:
        step()
    while clear and mover.clears:
        mover.clear(7)


def copying(mover: Mover, store: SqliteStore, end: int) -> list[Callable[[], object]]:
    """Return the steps that make a segment, one by one."""
    links = [row[3] for row in store.read(lambda turn: turn.rows(0, end))]
    pages = -(-(end - mover.mark) // 5)
    return [
        lambda: mover.begin(end),
        *[lambda: mover.copy(5, lambda _turn, _rows: None)] * pages,
        lambda: mover.seal(note(links), head=links[-1]),
    ]
