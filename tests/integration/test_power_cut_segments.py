# SPDX-License-Identifier: Apache-2.0
"""The power goes at any write of a rotation: the log is whole, and none of it is lost.

The disk is that of `test_power_cut`. A segment's file and its name are on it like the store's, so a
name that was given and not synced may be gone, and a page of it that was not synced, too.
"""

from __future__ import annotations

import os
import random

from authguard_r.audit.record import LogRow
from authguard_r.audit.verify import verify_rows
from authguard_r.core.errors import StoreError
from authguard_r.store.folder import Folder
from authguard_r.store.segment_mover import Mover
from authguard_r.store.segments import PART
from authguard_r.store.sqlite import SqliteStore, open_store
from fixtures.segmented_stores import SECRET, copying, fill
from integration.test_power_cut import STORE, Disk, File

SEED = int(os.environ.get("AUTHGUARD_SEED", "2306"))
LIVES, CUTS = 150, 4
#: Operations on the disk until the power goes; a life opens, fills, moves and clears in it.
LONGEST = 700


class Platter(Folder):
    """The folder of segments on a disk that loses its power."""

    def __init__(self, disk: Disk, *, syncs: bool = True) -> None:
        super().__init__(STORE)
        self._disk, self._syncs = disk, syncs

    def has(self, name: str) -> bool:
        return self.place(name) in self._disk._files

    def names(self) -> tuple[str, ...]:
        here = self.place("")
        return tuple(sorted(p.removeprefix(here) for p in self._disk._files if p.startswith(here)))

    def create(self, name: str) -> None:
        self.remove(name)
        self._disk._files[self.place(name)] = File()

    def publish(self, part: str, name: str) -> None:
        self._disk.burn()
        self._disk._files[self.place(name)] = self._disk._files.pop(self.place(part))
        self._disk.burn()
        if self._syncs:
            self._disk.sync_folder()
            self._disk.burn()

    def remove(self, name: str) -> None:
        self._disk.burn()
        self._disk._files.pop(self.place(name), None)

    def free_bytes(self) -> int:
        return 1 << 40

    def place(self, name: str) -> str:
        return f"{STORE}.segments/{name}"


class Life:
    """A store on a disk, from power on to power off, and what it promised."""

    def __init__(self, dice: random.Random, *, syncs: bool) -> None:
        self._dice, self._syncs = dice, syncs
        self.files: dict[str, bytes] = {}
        self.links: dict[int, bytes] = {}
        self.gone: set[int] = set()
        self.moved = 0

    def live(self) -> None:
        """Work until the power goes, then hold what is left to what was promised."""
        disk = Disk(self.files, self._dice, self._dice.randrange(40, LONGEST))
        store = self._open(disk)
        store._connection.execute(f"PRAGMA wal_autocheckpoint = {self._dice.choice((3, 40, 1000))}")
        mover = Mover(store)
        while not disk.is_dead:
            self._work(store, mover, disk)
        self.files = disk.pull()
        store.close()
        disk.unregister()
        self._look()

    def _open(self, disk: Disk) -> SqliteStore:
        folder = Platter(disk, syncs=self._syncs)
        return open_store(STORE, vfs=disk.name, folder=folder)

    def _work(self, store: SqliteStore, mover: Mover, disk: Disk) -> None:
        fill(store, self._dice.randrange(1, 9))
        size = store.read(lambda turn: turn.head())[0]
        rows = store.read(lambda turn: turn.rows(0, size))
        if not disk.is_dead:
            self.links |= {row[0]: row[3] for row in rows}
        number = self._dice.randrange(size)
        if self._dice.random() < 0.5:
            store.run(lambda turn: turn.forget(number, {"here"}))
            if not disk.is_dead:
                self.gone.add(number)
        if mover.clears:
            mover.clear(self._dice.randrange(1, 9))
        elif size - mover.mark > 8:
            self._move(store, mover, disk, size - self._dice.randrange(1, 4))

    def _move(self, store: SqliteStore, mover: Mover, disk: Disk, end: int) -> None:
        for step in copying(mover, store, end):
            step()
            number = self._dice.randrange(end)
            if self._dice.random() < 0.2:
                store.run(lambda turn, seq=number: turn.forget(seq, {"here"}))
                if not disk.is_dead:
                    self.gone.add(number)
        self.moved += not disk.is_dead

    def _look(self) -> None:
        disk = Disk(self.files, self._dice, -1)
        try:
            store = self._open(disk)
            rows = store.read(lambda turn: turn.rows(0, 1 << 40))
            assert not [name for name in Platter(disk).names() if name.endswith(PART)]
            store.close()
        finally:
            disk.unregister()
        found = verify_rows([LogRow(*row) for row in rows])
        assert found.whole, found
        links = {row[0]: row[3] for row in rows}
        assert not [seq for seq, link in self.links.items() if links.get(seq) != link]
        data = b"".join(bytes(file.now) for file in disk._files.values())
        assert not [seq for seq in self.gone if f'"{SECRET}{seq}"'.encode() in data]


def test_a_power_cut_at_any_write_of_a_rotation_loses_nothing_and_brings_nothing_back() -> None:
    moved = 0
    for number in range(LIVES):
        print(f"AUTHGUARD_SEED={SEED} life {number}")
        life = Life(random.Random(f"{SEED}-{number}"), syncs=True)
        for _ in range(CUTS):
            life.live()
        moved += life.moved
    assert moved > LIVES


def test_a_name_that_is_not_synced_before_the_mark_loses_the_log() -> None:
    """The harness can tell: without the sync of the folder there are lives that end badly."""
    bad = 0
    for number in range(40):
        life = Life(random.Random(f"{SEED}-{number}"), syncs=False)
        try:
            for _ in range(CUTS):
                life.live()
        except StoreError as error:
            assert "is missing" in error.message, error  # noqa: PT017 - a life may end well
            bad += 1
    assert bad
