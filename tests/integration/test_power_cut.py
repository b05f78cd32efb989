# SPDX-License-Identifier: Apache-2.0
"""The power goes at any write: what the ledger acknowledged is there, and nothing is half there.

The file system is SQLite's own interface over memory. It knows which bytes were synced; when the
power goes, any of the others may have reached the disk or not, whole or in sectors of 512 bytes,
in any order, and a file that was made or removed since its folder was synced may be gone or back.
The store opens its files by itself, with its own settings. The same harness loses acts once a test
weakens `synchronous` behind the store's back, so it can tell (L17).
"""

from __future__ import annotations

import itertools
import json
import os
import random
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import apsw

from authguard_r.anchoring.checkpoints import Checkpoints
from authguard_r.audit.checkpoint import read_checkpoint
from authguard_r.audit.note import Note
from authguard_r.audit.record import Entry, LogRow
from authguard_r.audit.verify import verify_rows
from authguard_r.core.encoding import Tag, decode, digest_of
from authguard_r.core.standing import Outcome, Spend, Standing, Use, reserve, settle
from authguard_r.keys.signer import folder_signer
from authguard_r.store.sqlite import SqliteStore, open_store
from authguard_r.store.transactions import ClockWatermark, Ledger, Transaction
from fixtures import scenarios

SEED = int(os.environ.get("AUTHGUARD_SEED", "1704"))
SECTOR = 512
#: What SQLite calls `PRAGMA synchronous = FULL`: a sync for every commit, in a WAL too.
FULL = 2
LOGS = apsw.SQLITE_OPEN_WAL | apsw.SQLITE_OPEN_MAIN_JOURNAL | apsw.SQLITE_OPEN_SUPER_JOURNAL
STORE = Path("/store.db")
#: Operations on the disk until the power goes; opening a new store alone takes about 20.
LONGEST = 260
#: Keys that grow and shrink beside the standing, so that pages are freed and used again.
KEYS = 12

VERIFIED = scenarios.verified()
GRANT = next(grant for grant in VERIFIED.mission.actions if grant.id == "look-out")
MID = VERIFIED.mission.mid
GATE = folder_signer(scenarios.trust_folder(), f"gate-{scenarios.RID}")
_NAMES = itertools.count()


class File:
    """One file: what a crash cannot take, what is read now, and the writes between the two."""

    def __init__(self, synced: bytes = b"") -> None:
        self.synced = synced
        self.now = bytearray(synced)
        self.unsynced: list[tuple[int, bytes | None]] = []

    def write(self, at: int, data: bytes) -> None:
        _put(self.now, at, data)
        self.unsynced.append((at, data))

    def cut(self, size: int) -> None:
        del self.now[size:]
        self.unsynced.append((size, None))

    def sync(self) -> None:
        self.synced = bytes(self.now)
        self.unsynced.clear()


class Disk(apsw.VFS):
    """A disk under SQLite that loses its power before the `fuse`-th operation is done."""

    def __init__(self, files: dict[str, bytes], dice: random.Random, fuse: int) -> None:
        self.name = f"disk-{next(_NAMES)}"
        super().__init__(self.name, "")
        self._files = {path: File(data) for path, data in files.items()}
        self._folder = dict(self._files)  # the names as last synced
        self._dice = dice
        self._fuse = fuse
        #: What is left after the cut; None while there is power.
        self.left: dict[str, bytes] | None = None

    @property
    def is_dead(self) -> bool:
        return self.left is not None

    def pull(self) -> dict[str, bytes]:
        """Cut the power now, if it was not cut before, and return what is left."""
        if self.left is None:
            self.left = self._survivors()
        return self.left

    def burn(self) -> None:
        """Count one operation; the machine goes on, but nobody will hear of what it does."""
        self._fuse -= 1
        if self._fuse == 0:
            self.pull()

    def sync_folder(self) -> None:
        """Make every name made or removed so far last."""
        self._folder = dict(self._files)

    def _survivors(self) -> dict[str, bytes]:
        how = self._dice.choice((self._none, self._all, self._some, self._torn))
        left = {}
        for path in sorted(self._files.keys() | self._folder.keys()):
            file = self._dice.choice((self._files, self._folder)).get(path)
            if file is None:
                continue
            data = bytearray(file.synced)
            for at, written in file.unsynced:
                how(data, at, written)
            left[path] = bytes(data)
        return left

    def _none(self, data: bytearray, at: int, written: bytes | None) -> None:
        pass

    def _all(self, data: bytearray, at: int, written: bytes | None) -> None:
        if written is None:
            del data[at:]
        else:
            _put(data, at, written)

    def _some(self, data: bytearray, at: int, written: bytes | None) -> None:
        if self._dice.random() < 0.5:
            self._all(data, at, written)

    def _torn(self, data: bytearray, at: int, written: bytes | None) -> None:
        if written is None:
            self._some(data, at, written)
            return
        end = at + len(written)
        while at < end:
            upto = min(end, (at // SECTOR + 1) * SECTOR)
            self._some(data, at, written[len(written) - (end - at) :][: upto - at])
            at = upto

    # SQLite's words

    def xOpen(self, name: Any, flags: list[int]) -> Handle:  # noqa: N802
        path = name.filename() if isinstance(name, apsw.URIFilename) else name
        assert path is not None, "the store needs no temporary files"
        flags[1] = flags[0]
        is_new_log = path not in self._files and bool(flags[0] & LOGS)
        return Handle(self, self._files.setdefault(path, File()), is_new_log=is_new_log)

    def xAccess(self, path: str, flags: int) -> bool:  # noqa: N802
        return path in self._files

    def xDelete(self, path: str, sync_folder: bool) -> None:  # noqa: N802
        self.burn()
        del self._files[path]
        if sync_folder:
            self.sync_folder()

    def xFullPathname(self, path: str) -> str:  # noqa: N802
        return path


class Handle:
    """An open file of the disk; a new log's first sync syncs its folder too, as on Unix."""

    def __init__(self, disk: Disk, file: File, *, is_new_log: bool) -> None:
        self._disk = disk
        self._file = file
        self._is_new_log = is_new_log

    def xRead(self, size: int, at: int) -> bytes:  # noqa: N802
        return bytes(self._file.now[at : at + size])

    def xWrite(self, data: bytes, at: int) -> None:  # noqa: N802
        self._file.write(at, bytes(data))
        self._disk.burn()

    def xTruncate(self, size: int) -> None:  # noqa: N802
        self._file.cut(size)
        self._disk.burn()

    def xSync(self, flags: int) -> None:  # noqa: N802
        self._disk.burn()
        self._file.sync()
        if self._is_new_log:
            self._disk.burn()
            self._disk.sync_folder()
            self._is_new_log = False

    def xFileSize(self) -> int:  # noqa: N802
        return len(self._file.now)

    def xSectorSize(self) -> int:  # noqa: N802
        return 4096

    def xDeviceCharacteristics(self) -> int:  # noqa: N802
        return apsw.SQLITE_IOCAP_POWERSAFE_OVERWRITE  # as SQLite takes every Linux disk to be

    def xFileControl(self, *_: Any) -> bool:  # noqa: N802
        return False

    def xLock(self, level: int) -> None:  # noqa: N802
        pass

    def xUnlock(self, level: int) -> None:  # noqa: N802
        pass

    def xCheckReservedLock(self) -> bool:  # noqa: N802
        return False

    def xClose(self) -> None:  # noqa: N802
        pass


def _put(data: bytearray, at: int, written: bytes) -> None:
    data.extend(bytes(max(0, at - len(data))))
    data[at : at + len(written)] = written


class Ticking:
    """A clock that moves a little whenever somebody looks."""

    def __init__(self, start_ms: int) -> None:
        self._mono = 0
        self._start = start_ms

    def wall_ms(self) -> int:
        return self._start + self.mono_ms()

    def mono_ms(self) -> int:
        self._mono += 7
        return self._mono

    def pause(self, duration_ms: int) -> None:
        self._mono += duration_ms


class Machine:
    """One robot's ledger on a disk, from power on to power off.

    Args:
        disk: what the store writes to.
        dice: what to do next.
        start_ms: the clock at power on.
        weakened: `synchronous` of a store that is to break its promises; None: the store's own.
    """

    def __init__(
        self, disk: Disk, dice: random.Random, *, start_ms: int, weakened: str | None = None
    ) -> None:
        self._disk = disk
        self._dice = dice
        self.store: SqliteStore = open_store(STORE, vfs=disk.name)
        pages = dice.choice((3, 10, 40, 1_000))
        self.store._connection.execute(f"PRAGMA wal_autocheckpoint = {pages}").fetchall()
        if weakened is not None:
            self.store._connection.execute(f"PRAGMA synchronous = {weakened}")
        self.ledger = Ledger(
            self.store,
            Ticking(start_ms),
            robot=scenarios.RID,
            salts=bytes,
            genesis={"site": "hospital"},
        )
        self.checkpoints = Checkpoints(self.ledger, robot=scenarios.RID, signer=GATE)
        #: True once the power went while a checkpoint was being committed.
        self.cut_in_checkpoint = False

    def work(self, acknowledged: dict[int, bytes]) -> None:
        """Act until the power goes; note what was acknowledged while it was on."""
        acts: tuple[Callable[[Transaction], tuple[int, bytes]], ...] = (self.release, self.outcome)
        while not self._disk.is_dead:
            if self._dice.random() < 0.25:
                seq, link = self.checkpoint()
            elif self._dice.random() < 0.1:
                seq = self.ledger.note(lambda at: _entry("stop", at, {}))
                link = self.ledger.run(lambda act: act.head())[1]
            else:
                seq, link = self.ledger.run(self._dice.choice(acts))
            if not self._disk.is_dead:
                acknowledged[seq] = link

    def checkpoint(self) -> tuple[int, bytes]:
        """Make one, and return the last record that a witness would know of now."""
        self.checkpoints.make()  # only its commit writes, and the power goes at a write
        self.cut_in_checkpoint = self._disk.is_dead
        assert self.checkpoints.newest is not None
        said = read_checkpoint(self.checkpoints.newest.text, where="")
        assert said.chain is not None
        return said.size - 1, said.chain

    def release(self, act: Transaction) -> tuple[int, bytes]:
        """Use one start, open one release, and hold a value of some length."""
        standing = act.standing(MID) or scenarios.active(VERIFIED)
        ticket = digest_of(Tag.ACTION, act.head()[0])
        after = reserve(standing, GRANT, ticket=ticket, spend=Spend(), now=act.now, per_ms=100)
        act.hold(after)
        return self._record(act, "decision", {"ticket": ticket})

    def outcome(self, act: Transaction) -> tuple[int, bytes]:
        """Close the oldest open release, when there is one."""
        standing = act.standing(MID)
        if standing is None or not standing.open:
            return self.release(act)
        ticket = standing.open[0].ticket
        outcome = self._dice.choice((Outcome.SUCCEEDED, Outcome.NOT_STARTED, Outcome.ABORTED))
        mission = VERIFIED.mission
        act.hold(settle(standing, mission, ticket=ticket, outcome=outcome, used=Spend()))
        return self._record(act, "outcome", {"ticket": ticket, "outcome": outcome})

    def _record(self, act: Transaction, kind: str, opened: dict[str, Any]) -> tuple[int, bytes]:
        key, size = str(self._dice.randrange(KEYS)), self._dice.randrange(6_000)
        act.put("value", key, _value(act.head()[0], size))
        seq = act.record(_entry(kind, act.now.utc_ms, {**opened, "key": key, "size": size}))
        return seq, act.head()[1]


def _entry(kind: str, time_ms: int, opened: dict[str, Any]) -> Entry:
    return Entry(kind=kind, time_ms=time_ms, decision=kind, open=opened, sealed={"at": time_ms})


def _value(seq: int, size: int) -> bytes:
    """Return bytes that only the act with this record writes."""
    return (sha256(str(seq).encode()).digest() * (size // 32 + 1))[:size]


def look(disk: Disk, *, start_ms: int) -> tuple[tuple[LogRow, ...], Note | None]:
    """Open what is left; return its log and newest checkpoint; nothing in it is half done."""
    machine = Machine(disk, random.Random(0), start_ms=start_ms)
    connection = machine.store._connection
    assert connection.execute("PRAGMA integrity_check").get == "ok"
    rows = tuple(
        LogRow(*row)
        for row in connection.execute("SELECT seq, record, sealed, link FROM audit ORDER BY seq")
    )
    found = verify_rows(rows, terminal=None)
    assert found.whole, found
    assert machine.store.run(lambda turn: turn.head()) == (len(rows), rows[-1].link)
    held = {
        (kind, key): bytes(value)
        for kind, key, value in connection.execute("SELECT kind, key, value FROM held")
    }
    require_one_story(rows, held)
    assert machine.checkpoints.fits()  # never ahead of the log, and never of another one
    newest = machine.checkpoints.held()
    machine.ledger.close()
    return rows, newest


def require_one_story(rows: tuple[LogRow, ...], held: dict[tuple[str, str], bytes]) -> None:
    """The registry holds what the records say, no more and no less."""
    starts = successes = last_success = actions = last_ms = 0
    tickets: list[str] = []
    values: dict[tuple[str, str], bytes] = {}
    for row in rows:
        record = json.loads(row.record)
        opened = record["open"]
        if record["kind"] == "decision":
            starts, actions = starts + 1, actions + 1
            tickets.append(opened["ticket"])
        if record["kind"] == "outcome":
            tickets.remove(opened["ticket"])
            starts -= opened["outcome"] == Outcome.NOT_STARTED
            actions -= opened["outcome"] == Outcome.NOT_STARTED
            if opened["outcome"] == Outcome.SUCCEEDED:
                successes, last_success = successes + 1, successes + 1
        if "key" in opened:
            values["value", opened["key"]] = _value(row.seq, opened["size"])
            last_ms = record["link"]["time_ms"]
    assert {key: value for key, value in held.items() if key[0] == "value"} == values
    data = held.get(("standing", MID))
    if data is None:
        assert actions == 0
        return
    standing = decode(data, Standing)
    use = Use(starts=starts, successes=successes, last_success=last_success)
    assert standing.uses == {GRANT.id: use}
    assert (standing.order, standing.actions) == (successes, actions)
    assert [release.ticket for release in standing.open] == tickets
    # the act that reads the head after a `note` moves the clock and records nothing
    assert decode(held["clock", "high"], ClockWatermark).utc_ms >= last_ms


class BrokenPromiseError(AssertionError):
    """An acknowledged act is lost, or what is left is damaged."""


class Lived(NamedTuple):
    """What became of one disk.

    Args:
        acknowledged: acts.
        in_checkpoints: cuts that fell inside a checkpoint's commit.
        kept: how many of these checkpoints were there afterwards all the same.
    """

    acknowledged: int
    in_checkpoints: int
    kept: int


def one_life(dice: random.Random, *, cuts: int, weakened: str | None = None) -> Lived:
    """Cut the power again and again on one disk; return what became of it.

    Raises:
        BrokenPromiseError: what the store had promised is not there; the first argument is
            `lost` or `damaged`.
    """
    files: dict[str, bytes] = {}
    acknowledged: dict[int, bytes] = {}
    in_checkpoints = kept = 0
    for number in range(cuts):
        start_ms = scenarios.START_MS + 3_600_000 * number
        disk = Disk(files, dice, dice.randrange(1, LONGEST))
        machine = Machine(disk, dice, start_ms=start_ms, weakened=weakened)
        machine.work(acknowledged)
        files = disk.pull()
        machine.ledger.close()
        disk.unregister()
        again = Disk(files, dice, -1)
        try:
            rows, held = look(again, start_ms=start_ms + 1_800_000)
        except Exception as error:  # whatever it is, the promise is broken
            raise BrokenPromiseError("damaged", number, error) from error
        finally:
            again.unregister()
        in_checkpoints += machine.cut_in_checkpoint
        kept += machine.cut_in_checkpoint and held == machine.checkpoints.newest
        links = {row.seq: row.link for row in rows}
        gone = [seq for seq, link in acknowledged.items() if links.get(seq) != link]
        if gone:
            raise BrokenPromiseError("lost", number, gone)
    return Lived(len(acknowledged), in_checkpoints, kept)


def test_a_store_syncs_every_commit_and_its_checkpoints(tmp_path: Path) -> None:
    store = open_store(tmp_path / "store.db")
    for _ in ("made", "opened again"):
        assert store._connection.execute("PRAGMA synchronous").get == FULL
        assert store._connection.execute("PRAGMA journal_mode").get == "wal"
        store.close()
        store = open_store(tmp_path / "store.db")
    store.close()


def test_a_thousand_power_cuts_lose_nothing_acknowledged() -> None:
    cuts, lives = 4, []
    for life in range(250):
        print(f"AUTHGUARD_SEED={SEED} life {life}")
        dice = random.Random(f"{SEED}-{life}")
        lives.append(one_life(dice, cuts=cuts))
    acknowledged, in_checkpoints, kept = map(sum, zip(*lives, strict=True))
    print(f"{acknowledged} acknowledged, {in_checkpoints} cuts in checkpoints, {kept} kept")
    assert acknowledged > 250 * cuts * 5  # the cuts fall among acts, not only while opening
    # and some inside a checkpoint's commit, on either side of the moment from which it lasts
    assert in_checkpoints >= 250 * cuts // 100
    assert 0 < kept < in_checkpoints


def broken_promises(weakened: str) -> list[str]:
    """Return what became of the lives in which a weaker store kept less than it promised."""
    broken: list[str] = []
    for life in range(40):
        try:
            one_life(random.Random(f"{SEED}-{life}"), cuts=2, weakened=weakened)
        except BrokenPromiseError as error:
            broken.append(error.args[0])
    return broken


def test_the_same_harness_sees_a_store_without_a_sync_per_commit_forget() -> None:
    broken = broken_promises("NORMAL")
    assert len(broken) > 0
    # the last acts are forgotten; what is left is consistent, as SQLite says of this mode
    assert set(broken) == {"lost"}


def test_the_same_harness_sees_a_store_that_never_syncs_ruined() -> None:
    assert broken_promises("OFF").count("damaged") > 0
