# SPDX-License-Identifier: Apache-2.0
"""Whatever the store or the clock does, the answer is a refusal with its own code.

Each test breaks one thing under a whole gate and asks for an action of the hospital story: it is
refused, nothing dispatched, nothing half written; and once the thing is mended, the story goes on.
"""

from __future__ import annotations

import itertools
import json
import os
import random
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import apsw
import pytest

from authguard_r.audit.record import LogRow
from authguard_r.audit.verify import verify_rows
from authguard_r.core.action import Action
from authguard_r.core.encoding import Tag, b64
from authguard_r.core.errors import ClockError, StoreError
from authguard_r.core.lease import Lease
from authguard_r.core.lifecycle import Event, Status
from authguard_r.core.ports import GoalHandle, Store, Turn
from authguard_r.core.reasons import Reason
from authguard_r.core.standing import Outcome, Standing, advance
from authguard_r.core.token import sign_object
from authguard_r.enforcement.report import stop_entry
from authguard_r.enforcement.signed_orders import Command, Verb
from authguard_r.keys.signer import folder_signer
from authguard_r.operations import simulation
from authguard_r.operations.simulation import Simulation
from authguard_r.sim.robot import Faults
from authguard_r.store import clocks
from authguard_r.store.memory import MemoryStore
from authguard_r.store.sqlite import APPLICATION_ID, FORMAT, open_store, read_held, read_rows
from authguard_r.store.transactions import Ledger
from authguard_r.wire.gate_limits import LIMITS
from fixtures import scenarios

T = TypeVar("T")
SEED = int(os.environ.get("AUTHGUARD_SEED", "404"))
HOUR_MS = 3_600_000
PATIENCE = 60
#: The hospital mission for a whole day: a store's own time may be later than the story's.
MISSION = scenarios.mission(window={"for": "20 h"})
MID = MISSION.mid
LOOK = Action(type="scan_obstacles", tool="lidar", params={})
LEG = scenarios.navigate("dock", "pharmacy", speed=800)
PICK = Action(
    type="pick",
    tool="gripper",
    object="package-p1",
    source="pharmacy",
    params={"force_mn": 5_000},
)
_NAMES = itertools.count()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "store.db"


@pytest.fixture
def sim(path: Path) -> Iterator[Simulation]:
    """A gate on a file, with the hospital mission active."""
    made = scenarios.simulation(store=path)
    made.gate.management.activate(scenarios.token(MISSION))
    yield made
    made.gate.close()


def connection(sim: Simulation) -> apsw.Connection:
    return sim.gate.ledger.store._connection  # type: ignore[attr-defined, no-any-return]


def rows_of(sim: Simulation) -> tuple[LogRow, ...]:
    query = "SELECT seq, record, sealed, link FROM audit ORDER BY seq"
    return tuple(LogRow(*row) for row in connection(sim).execute(query))


def kinds(rows: tuple[LogRow, ...]) -> list[str]:
    return [json.loads(row.record)["kind"] for row in rows]


def standing_of(sim: Simulation) -> Standing:
    found = sim.gate.management.standing(MID)
    assert found is not None
    return found


def require_refused(sim: Simulation, report: Any, reason: Reason) -> None:
    """Refused with that code, and nothing was dispatched."""
    assert report.judged is None
    assert report.refusal.reason is reason
    assert report.outcome is None
    assert sim.robot.trace == []


def require_goes_on(sim: Simulation) -> None:
    """The next action is carried out, and the log is whole."""
    report = scenarios.propose(sim, LOOK)
    assert report.outcome is Outcome.SUCCEEDED
    assert report.outcome_recorded
    assert len(sim.robot.trace) == 1
    rows = rows_of(sim)
    assert kinds(rows)[-2:] == ["decision", "outcome"]
    assert verify_rows(rows, terminal=None).whole


def command(sim: Simulation, verb: Verb, **more: Any) -> Standing:
    standing = standing_of(sim)
    made = Command(
        verb=verb,
        mid=MID,
        version=standing.version,
        mission=standing.digest,
        nonce=b64(os.urandom(16)),
        expires_ms=sim.robot.wall_ms() + 60_000,
        issued_ms=sim.robot.wall_ms() + 1,
        **more,
    )
    signer = folder_signer(scenarios.trust_folder(), "operator-1")
    return sim.gate.management.command(sign_object(made, Tag.COMMAND, signer))


# the disk under a running gate


class Breakable(apsw.VFS):
    """The operating system's file system, with a log file that can stop taking writes."""

    def __init__(self) -> None:
        self.name = f"breakable-{next(_NAMES)}"
        super().__init__(self.name, "")
        self.write_fault: type[apsw.Error] | None = None
        self.sync_fault: type[apsw.Error] | None = None

    def xOpen(self, name: Any, flags: list[int]) -> LogFile:  # noqa: N802 - SQLite's word
        return LogFile(self, name, flags)


class LogFile(apsw.VFSFile):
    def __init__(self, vfs: Breakable, name: Any, flags: list[int]) -> None:
        super().__init__("", name, flags)
        self._vfs = vfs
        self._is_log = bool(flags[0] & apsw.SQLITE_OPEN_WAL)

    def xWrite(self, data: bytes, offset: int) -> None:  # noqa: N802
        if self._is_log and self._vfs.write_fault is not None:
            raise self._vfs.write_fault("broken for the test")
        super().xWrite(data, offset)

    def xSync(self, flags: int) -> None:  # noqa: N802
        if self._is_log and self._vfs.sync_fault is not None:
            raise self._vfs.sync_fault("broken for the test")
        super().xSync(flags)


def fill(sim: Simulation) -> None:
    """Record small things until not even one of them has room."""
    stop = stop_entry("operator-1", is_planner=False, details={}, why="")

    def has_room() -> bool:
        try:
            sim.gate.ledger.note(stop)
        except StoreError:
            return False
        return True

    while has_room():
        pass


class Broken:
    """A way for the store to break, and to be mended."""

    def __init__(self, fault: str, vfs: Breakable) -> None:
        self._fault = fault
        self._vfs = vfs

    def break_it(self, sim: Simulation) -> None:
        match self._fault:
            case "full":
                self._vfs.write_fault = apsw.FullError
            case "read-only":
                self._vfs.write_fault = apsw.ReadOnlyError
            case "unwritable":
                self._vfs.write_fault = apsw.IOError
            case "unsyncable":
                self._vfs.sync_fault = apsw.IOError
            case "page-limit":
                size = connection(sim).execute("PRAGMA page_count").get
                connection(sim).execute(f"PRAGMA max_page_count = {size}").fetchall()
                fill(sim)
            case "query-only":
                connection(sim).execute("PRAGMA query_only = ON")
            case _:
                raise NotImplementedError(self._fault)

    def mend(self, sim: Simulation) -> None:
        self._vfs.write_fault = self._vfs.sync_fault = None
        if self._fault == "page-limit":
            connection(sim).execute("PRAGMA max_page_count = 1000000").fetchall()
        if self._fault == "query-only":
            connection(sim).execute("PRAGMA query_only = OFF")


FAULTS = {
    "full": Reason.STORE_FULL,
    "page-limit": Reason.STORE_FULL,
    "read-only": Reason.STORE_READ_ONLY,
    "query-only": Reason.STORE_READ_ONLY,
    "unwritable": Reason.STORE_UNAVAILABLE,
    "unsyncable": Reason.STORE_UNAVAILABLE,
}


@pytest.fixture(params=FAULTS)
def fault(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[Broken, Reason]]:
    """A fault and its code; every store opened from here on can be broken by it."""
    vfs = Breakable()
    monkeypatch.setattr(simulation, "open_store", partial(open_store, vfs=vfs.name))
    yield Broken(request.param, vfs), FAULTS[request.param]
    vfs.unregister()


@pytest.mark.smoke
def test_an_action_that_cannot_be_recorded_is_refused_and_never_begun(
    fault: tuple[Broken, Reason], path: Path
) -> None:
    (broken, reason), sim = fault, scenarios.simulation(store=path)
    sim.gate.management.activate(scenarios.token(MISSION))
    standing = standing_of(sim)
    broken.break_it(sim)
    rows = rows_of(sim)
    for _ in range(3):
        require_refused(sim, scenarios.propose(sim, LOOK), reason)
    broken.mend(sim)
    assert rows_of(sim) == rows
    assert standing_of(sim) == standing
    require_goes_on(sim)
    sim.gate.close()
    assert verify_rows(read_rows(path), terminal=None).whole


def test_a_mission_that_cannot_be_recorded_is_not_activated(
    fault: tuple[Broken, Reason], path: Path
) -> None:
    (broken, reason), sim = fault, scenarios.simulation(store=path)
    broken.break_it(sim)
    with pytest.raises(StoreError) as refused:
        sim.gate.management.activate(scenarios.token(MISSION))
    assert refused.value.reason is reason
    broken.mend(sim)
    assert sim.gate.management.standing(MID) is None
    assert "management" not in kinds(rows_of(sim))
    assert scenarios.propose(sim, LOOK).refusal.reason is Reason.NO_ACTIVE_MISSION
    sim.gate.management.activate(scenarios.token(MISSION))
    require_goes_on(sim)
    sim.gate.close()


@pytest.mark.smoke
def test_a_stop_is_carried_out_on_a_store_that_takes_nothing(
    fault: tuple[Broken, Reason], path: Path
) -> None:
    (broken, _), sim = fault, scenarios.simulation(store=path)
    sim.gate.management.activate(scenarios.token(MISSION))
    broken.break_it(sim)
    sim.gate.enforcer.stop(by="planner", is_planner=True)
    sim.gate.enforcer.stop(by="operator-1", is_planner=False)
    assert sim.robot.stops == 2
    broken.mend(sim)
    require_goes_on(sim)
    sim.gate.close()


def test_an_outcome_that_cannot_be_recorded_leaves_its_release_to_a_person(
    fault: tuple[Broken, Reason], path: Path
) -> None:
    (broken, _), sim = fault, scenarios.simulation(store=path)
    sim.gate.management.activate(scenarios.token(MISSION))
    begin = sim.robot.dispatch

    def dispatch(action: Action, lease: Lease) -> GoalHandle:
        broken.break_it(sim)
        return begin(action, lease)

    sim.robot.dispatch = dispatch  # type: ignore[method-assign, assignment]
    report = scenarios.propose(sim, LEG)
    assert report.outcome is Outcome.SUCCEEDED
    assert not report.outcome_recorded
    assert sim.robot.state.region == "pharmacy"
    broken.mend(sim)
    (release,) = standing_of(sim).open
    assert "outcome" not in kinds(rows_of(sim))
    sim.gate.close()

    later_ms = scenarios.START_MS + 600_000
    again = scenarios.simulation(store=path, start=sim.robot.state, start_ms=later_ms)
    assert again.gate.management.recover() == (release.ticket,)
    assert standing_of(again).status is Status.SUSPENDED
    assert scenarios.propose(again, PICK).judged.decision.reasons[0] is Reason.MISSION_SUSPENDED
    command(again, Verb.RESOLVE, ticket=release.ticket, outcome=Outcome.SUCCEEDED)
    assert scenarios.propose(again, PICK).judged.decision.reasons[0] is Reason.MISSION_SUSPENDED
    assert again.robot.trace == []
    command(again, Verb.RESUME)
    assert scenarios.propose(again, PICK).outcome is Outcome.SUCCEEDED
    again.gate.close()
    assert verify_rows(read_rows(path), terminal=None).whole


def test_a_gate_whose_store_was_closed_refuses(sim: Simulation) -> None:
    sim.gate.close()
    report = scenarios.propose(sim, LOOK)
    require_refused(sim, report, Reason.STORE_UNAVAILABLE)
    assert report.seq is None
    sim.gate.enforcer.stop(by="operator-1", is_planner=False)
    assert sim.robot.stops == 1


# a file that cannot be opened


def require_not_opened(path: Path, reason: Reason) -> None:
    """Nothing gets a store out of the file, and nobody changes it by trying."""
    before = path.read_bytes()
    attempts: tuple[Callable[[], object], ...] = (
        lambda: open_store(path),
        lambda: scenarios.simulation(store=path),
        lambda: list(read_rows(path)),
        lambda: read_held(path, "active", "mission"),
    )
    for attempt in attempts:
        with pytest.raises(StoreError) as refused:
            attempt()
        assert refused.value.reason is reason
        assert refused.value.where == str(path)
    assert path.read_bytes() == before


def test_a_store_that_a_gate_holds_cannot_be_opened_again(sim: Simulation, path: Path) -> None:
    require_not_opened(path, Reason.STORE_UNAVAILABLE)
    require_goes_on(sim)


@pytest.mark.smoke
def test_a_store_that_another_process_holds_cannot_be_opened(path: Path) -> None:
    scenarios.simulation(store=path).gate.close()
    program = (
        "import sys; from pathlib import Path; from authguard_r.store.sqlite import open_store; "
        "store = open_store(Path(sys.argv[1])); print('open', flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", program, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"open\n"
        require_not_opened(path, Reason.STORE_UNAVAILABLE)
        other.communicate()
    again = scenarios.simulation(store=path)
    again.gate.management.activate(scenarios.token(MISSION))
    require_goes_on(again)
    again.gate.close()


@pytest.mark.parametrize(
    "content",
    [
        b"not a database\n" * 1_000,
        b"\x89PNG\r\n\x1a\n" + bytes(600),
        bytes(8_192),
        b"SQLite format 3\0",
        b"SQLite format 3\0" + bytes(4_080),
        b"SQLite format 3\0" + b"\xff" * 8_176,
    ],
    ids=["text", "image", "zeros", "magic", "magic-zeros", "magic-ones"],
)
def test_a_file_that_is_no_database_is_refused_and_left_alone(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    require_not_opened(path, Reason.STORE_CORRUPT)


@pytest.mark.parametrize(
    "setup",
    [
        "CREATE TABLE theirs (a); INSERT INTO theirs VALUES (1)",
        f"PRAGMA application_id = {APPLICATION_ID + 1}; CREATE TABLE theirs (a)",
        f"PRAGMA application_id = {APPLICATION_ID + 1}",
        "PRAGMA user_version = 7",
    ],
    ids=["unmarked", "marked", "marked-empty", "versioned-empty"],
)
def test_a_database_of_another_program_is_refused_and_left_alone(path: Path, setup: str) -> None:
    foreign = apsw.Connection(str(path))
    foreign.execute(setup)
    foreign.close()
    require_not_opened(path, Reason.STORE_CORRUPT)


def test_a_store_of_a_newer_program_is_refused_until_it_is_ours_again(path: Path) -> None:
    made = scenarios.simulation(store=path)
    made.gate.management.activate(scenarios.token(MISSION))
    made.gate.close()
    for version in (FORMAT + 1, 1_000):
        set_version(path, version)
        require_not_opened(path, Reason.STORE_NEWER)
    set_version(path, FORMAT)
    again = scenarios.simulation(store=path)
    require_goes_on(again)
    again.gate.close()


def set_version(path: Path, version: int) -> None:
    plain = apsw.Connection(str(path))
    plain.execute(f"PRAGMA user_version = {version}")
    plain.close()


class ReadOnly(apsw.VFS):
    """A file system that was mounted read-only; being root does not help."""

    def __init__(self) -> None:
        self.name = f"read-only-{next(_NAMES)}"
        super().__init__(self.name, "")

    def xOpen(self, name: Any, flags: list[int]) -> apsw.VFSFile:  # noqa: N802 - SQLite's word
        if flags[0] & apsw.SQLITE_OPEN_READWRITE:
            flags[0] &= ~(apsw.SQLITE_OPEN_READWRITE | apsw.SQLITE_OPEN_CREATE)
            flags[0] |= apsw.SQLITE_OPEN_READONLY
        return apsw.VFSFile("", name, flags)


def test_a_store_on_a_read_only_disk_is_refused_until_it_can_be_written(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = scenarios.simulation(store=path)
    made.gate.management.activate(scenarios.token(MISSION))
    made.gate.close()
    before = path.read_bytes()
    vfs = ReadOnly()
    with monkeypatch.context() as patched:
        patched.setattr(simulation, "open_store", partial(open_store, vfs=vfs.name))
        with pytest.raises(StoreError) as refused:
            scenarios.simulation(store=path)
    vfs.unregister()
    assert refused.value.reason is Reason.STORE_READ_ONLY
    assert path.read_bytes() == before
    again = scenarios.simulation(store=path)
    require_goes_on(again)
    again.gate.close()


@pytest.mark.parametrize("place", ["folder", "missing-folder"])
def test_a_place_that_can_hold_no_file_is_refused(tmp_path: Path, place: str) -> None:
    path = tmp_path if place == "folder" else tmp_path / "no" / "store.db"
    with pytest.raises(StoreError) as refused:
        scenarios.simulation(store=path)
    assert refused.value.reason is Reason.STORE_UNAVAILABLE
    with pytest.raises(StoreError):
        list(read_rows(path))
    with pytest.raises(StoreError):
        read_held(path, "active", "mission")


# a file whose maker was killed


class Snapshots(apsw.VFS):
    """The operating system's file system, which keeps what is there at the first removal."""

    def __init__(self, folder: Path) -> None:
        self.name = f"snapshots-{next(_NAMES)}"
        super().__init__(self.name, "")
        self._folder = folder

    def xDelete(self, name: str, sync_folder: bool) -> None:  # noqa: N802 - SQLite's word
        if not self._folder.exists():
            shutil.copytree(Path(name).parent, self._folder)
        super().xDelete(name, sync_folder)


def half_made(how: str, folder: Path) -> Path:
    """Return a file as a gate leaves it that is killed while it makes its store."""
    made = folder / "made"
    made.mkdir()
    path = made / "store.db"
    if how == "empty":
        path.touch()
    elif how == "header":
        plain = apsw.Connection(str(path))
        plain.execute("PRAGMA journal_mode = WAL").fetchall()
        plain.close()
    else:
        vfs = Snapshots(folder / "snapshot")
        open_store(path, vfs=vfs.name).close()
        vfs.unregister()
        path = folder / "snapshot" / "store.db"
        assert path.with_name("store.db-journal").exists()
    return path


@pytest.mark.parametrize("how", ["empty", "header", "journal"])
def test_a_store_that_was_half_made_is_made_anew(tmp_path: Path, how: str) -> None:
    sim = scenarios.simulation(store=half_made(how, tmp_path))
    sim.gate.management.activate(scenarios.token(MISSION))
    require_goes_on(sim)
    assert kinds(rows_of(sim)) == ["genesis", *["management"] * 2, "decision", "outcome"]
    sim.gate.close()


@pytest.mark.parametrize("how", ["empty", "header", "journal"])
def test_a_store_that_was_half_made_is_of_no_simulated_time(tmp_path: Path, how: str) -> None:
    """So nothing keeps a gate with the machine's clock from making it anew."""
    path = half_made(how, tmp_path)
    assert isinstance(clocks.store_clock(path), clocks.SystemClock)
    open_store(path).close()


# a file that was damaged


@pytest.fixture(scope="module")
def filled(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A closed store with an active mission that has some history and is not done."""
    path = tmp_path_factory.mktemp("filled") / "store.db"
    sim = scenarios.simulation(store=path)
    sim.gate.management.activate(scenarios.token(MISSION))
    for _ in range(8):
        assert scenarios.propose(sim, LOOK).outcome is Outcome.SUCCEEDED
    sim.gate.close()
    return path.read_bytes()


LATER_MS = scenarios.START_MS + 60_000
PAGE = 4_096


def root_of(image: bytes, table: str, tmp_path: Path) -> int:
    """Return where the table's first page begins."""
    copy = tmp_path / "copy.db"
    copy.write_bytes(image)
    plain = apsw.Connection(str(copy))
    root = plain.execute("SELECT rootpage FROM sqlite_schema WHERE name = ?", (table,)).get
    plain.close()
    assert isinstance(root, int)
    return (root - 1) * PAGE


def require_corrupt(act: Callable[[], object]) -> None:
    with pytest.raises(StoreError) as refused:
        act()
    assert refused.value.reason is Reason.STORE_CORRUPT


@pytest.mark.parametrize("table", ["audit", "held"])
@pytest.mark.parametrize("garbage", [b"\xff", b"\x5a"], ids=["ones", "letters"])
def test_a_table_that_was_overwritten_stops_the_gate_and_nothing_else(
    filled: bytes, path: Path, tmp_path: Path, table: str, garbage: bytes
) -> None:
    at = root_of(filled, table, tmp_path)
    path.write_bytes(filled[:at] + garbage * PAGE + filled[at + PAGE :])
    if table == "held":
        assert verify_rows(read_rows(path), terminal=None).whole
    else:
        require_corrupt(lambda: list(read_rows(path)))
    require_corrupt(lambda: scenarios.simulation(store=path, start_ms=LATER_MS))
    path.write_bytes(filled)
    again = scenarios.simulation(store=path, start_ms=LATER_MS)
    require_goes_on(again)
    again.gate.close()


def test_a_gate_that_cannot_be_assembled_lets_go_of_its_store(
    filled: bytes, path: Path, tmp_path: Path
) -> None:
    at = root_of(filled, "held", tmp_path)
    path.write_bytes(filled[:at] + b"\xff" * PAGE + filled[at + PAGE :])
    with pytest.raises(StoreError) as refused:
        scenarios.simulation(store=path, start_ms=LATER_MS)
    open_store(path).close()  # although the exception, and with it every frame, still lives
    assert refused.value.reason is Reason.STORE_CORRUPT


def test_a_held_page_that_rots_under_an_open_gate_refuses_its_next_action(
    filled: bytes, path: Path, tmp_path: Path
) -> None:
    path.write_bytes(filled)
    sim = scenarios.simulation(store=path, start_ms=LATER_MS)
    at = root_of(filled, "held", tmp_path)
    connection(sim).execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
    with path.open("r+b") as file:
        file.seek(at)
        file.write(b"\xff" * PAGE)
    connection(sim).release_memory()
    connection(sim).execute("PRAGMA shrink_memory").fetchall()
    report = scenarios.propose(sim, LOOK)
    require_refused(sim, report, Reason.STORE_CORRUPT)
    sim.gate.close()


@pytest.mark.parametrize("kept", [0.25, 0.5, 0.9])
def test_a_store_that_was_cut_short_is_refused(filled: bytes, path: Path, kept: float) -> None:
    path.write_bytes(filled[: int(len(filled) * kept) // PAGE * PAGE])
    require_corrupt(lambda: list(read_rows(path)))
    require_corrupt(lambda: scenarios.simulation(store=path, start_ms=LATER_MS))


@pytest.mark.parametrize(
    "cell", ["NULL", "7", str(2**62), "1.5", "'text'", "CAST(x'ff91' AS TEXT)"]
)
@pytest.mark.parametrize("column", ["record", "sealed", "link"])
def test_a_log_whose_cells_are_not_bytes_is_refused(path: Path, column: str, cell: str) -> None:
    """What a flipped bit in a row's header, or somebody with the file, makes of a blob."""
    columns = {"record": "x'00'", "sealed": "x'00'", "link": "x'00'", column: cell}
    plain = apsw.Connection(str(path))
    plain.execute(
        f"PRAGMA application_id = {APPLICATION_ID}; PRAGMA user_version = {FORMAT};"
        "CREATE TABLE held (kind, key, value, PRIMARY KEY (kind, key)) WITHOUT ROWID;"
        "CREATE TABLE audit (seq INTEGER PRIMARY KEY, record, sealed, link);"
        f"INSERT INTO audit VALUES (0, {', '.join(columns.values())});"
        f"INSERT INTO held VALUES ('active', 'mission', {cell})"
    )
    plain.close()
    require_corrupt(lambda: list(read_rows(path)))
    require_corrupt(lambda: read_held(path, "active", "mission"))
    if column == "link":  # the one cell that opening reads
        require_corrupt(lambda: open_store(path))


def damaged(image: bytes, dice: random.Random) -> bytes:
    """Return the file after one of four accidents, anywhere behind the first header."""
    data = bytearray(image)
    page = dice.randrange(len(image) // PAGE) * PAGE
    accident = dice.randrange(4)
    if accident == 0:
        data[page : page + PAGE] = dice.choice((bytes(PAGE), b"\xff" * PAGE, dice.randbytes(PAGE)))
    elif accident == 1:
        for _ in range(dice.randrange(1, 6)):
            data[dice.randrange(100, len(data))] = dice.randrange(256)
    elif accident == 2:
        size = dice.randrange(1, 600)
        at = dice.randrange(100, len(data) - size)
        data[at : at + size] = dice.randbytes(size)
    else:
        for _ in range(3):  # where SQLite keeps the shape of a page
            data[max(100, page) + dice.randrange(200)] = dice.randrange(256)
    return bytes(data)


def attempt(act: Callable[[], T]) -> T | None:
    """Return what the act returns, or None where the store says that it is corrupt."""
    try:
        return act()
    except StoreError as error:
        if error.reason in {Reason.STORE_CORRUPT, Reason.ROBOT_MISMATCH}:
            return None  # a damaged name may still be a name
        raise


def test_no_damage_to_the_file_gets_anything_but_a_store_error_out_of_it(
    filled: bytes, path: Path
) -> None:
    refused = 0
    for number in range(300):
        print(f"AUTHGUARD_SEED={SEED} damage {number}")
        for file in path.parent.glob("store.db*"):
            file.unlink()
        path.write_bytes(damaged(filled, random.Random(f"{SEED}-{number}")))
        found = attempt(lambda: verify_rows(read_rows(path), terminal=None))
        attempt(lambda: read_held(path, "standing", MID))
        attempt(lambda: clocks.store_clock(path))
        sim = attempt(lambda: scenarios.simulation(store=path, start_ms=LATER_MS))
        if sim is not None:
            report = scenarios.propose(sim, LOOK)  # whatever it says, it says it
            assert report.judged is not None or sim.robot.trace == []
            sim.gate.enforcer.stop(by="planner", is_planner=True)
            assert sim.robot.stops > 0
            sim.gate.close()
        refused += found is None or not found.whole or sim is None
    assert refused > 100


# the clock


def test_a_clock_that_ran_backwards_refuses_once_in_the_log_and_lets_nothing_move(
    sim: Simulation,
) -> None:
    before = rows_of(sim)
    sim.robot._start_ms -= HOUR_MS
    report = scenarios.propose(sim, LOOK)
    require_refused(sim, report, Reason.CLOCK_BEHIND)
    (added,) = rows_of(sim)[len(before) :]
    record = json.loads(added.record)
    assert (report.seq, record["kind"]) == (added.seq, "refusal")
    assert record["open"]["reasons"] == [Reason.CLOCK_BEHIND]
    # the record's own time does not run backwards
    assert record["link"]["time_ms"] >= json.loads(before[-1].record)["link"]["time_ms"]
    assert verify_rows(rows_of(sim), terminal=None).whole


@pytest.mark.smoke
def test_a_clock_that_ran_backwards_stops_no_stop(sim: Simulation) -> None:
    sim.robot._start_ms -= HOUR_MS
    sim.gate.enforcer.stop(by="operator-1", is_planner=False)
    sim.gate.enforcer.stop(by="planner", is_planner=True)
    assert sim.robot.stops == 2
    assert kinds(rows_of(sim))[-2:] == ["stop", "stop"]


def test_a_clock_that_ran_backwards_gives_and_takes_no_authority(sim: Simulation) -> None:
    rows, standing = rows_of(sim), standing_of(sim)
    sim.robot._start_ms -= HOUR_MS
    signer = folder_signer(scenarios.trust_folder(), "operator-1")
    order = Command(
        verb=Verb.REVOKE,
        mid=MID,
        version=standing.version,
        mission=standing.digest,
        nonce=b64(bytes(16)),
        expires_ms=sim.robot.wall_ms() + 60_000,
    )
    management = sim.gate.management
    acts: tuple[Callable[[], object], ...] = (
        lambda: management.command(sign_object(order, Tag.COMMAND, signer)),
        lambda: management.activate(scenarios.token(scenarios.mission(mission="another"))),
    )
    for act in acts:
        with pytest.raises(ClockError):
            act()
    assert rows_of(sim) == rows
    sim.robot._start_ms += HOUR_MS
    assert standing_of(sim) == standing


def test_a_mission_goes_on_when_the_clock_is_mended(sim: Simulation) -> None:
    sim.robot._start_ms -= HOUR_MS
    require_refused(sim, scenarios.propose(sim, LOOK), Reason.CLOCK_BEHIND)
    sim.robot._start_ms += HOUR_MS
    # the snapshot that came in between was no fault of its own
    require_goes_on(sim)


@pytest.mark.parametrize(
    ("behind_ms", "is_refused"), [(LIMITS.skew_ms, False), (LIMITS.skew_ms + 1, True)]
)
def test_a_clock_may_be_behind_by_the_skew_and_no_more(
    sim: Simulation, behind_ms: int, is_refused: bool
) -> None:
    sim.robot._start_ms -= behind_ms
    report = scenarios.propose(sim, LOOK)
    assert (report.refusal is not None) is is_refused
    if not is_refused:
        assert report.outcome is Outcome.SUCCEEDED
        times = [json.loads(row.record)["link"]["time_ms"] for row in rows_of(sim)]
        assert times == sorted(times)  # trusted time did not follow the wall clock back


def test_a_clock_that_runs_backwards_under_way_stops_the_robot(sim: Simulation) -> None:
    glide = sim.robot.pause

    def pause(duration_ms: int) -> None:
        glide(duration_ms)
        if sim.robot.elapsed_ms == 2_000:
            sim.robot._start_ms -= HOUR_MS

    sim.robot.pause = pause  # type: ignore[method-assign]
    report = scenarios.propose(sim, LEG)
    assert report.outcome is Outcome.ABORTED
    assert [finding.reason for finding in report.reasons] == [Reason.CLOCK_BEHIND]
    assert sim.robot.stops == 1
    assert sim.robot.state.speed_mm_s == 0
    # no trusted time, no outcome: the release stays open for a person to settle
    assert not report.outcome_recorded
    sim.robot._start_ms += HOUR_MS
    (release,) = standing_of(sim).open
    assert sim.gate.management.recover() == (release.ticket,)
    assert standing_of(sim).status is Status.SUSPENDED


def test_a_gate_restarted_on_a_clock_that_is_behind_its_store_refuses(path: Path) -> None:
    first = scenarios.simulation(store=path, start_ms=scenarios.START_MS + 2 * HOUR_MS)
    first.gate.management.activate(scenarios.token(MISSION))
    first.gate.close()
    behind = scenarios.simulation(store=path, start_ms=scenarios.START_MS + 2 * HOUR_MS)
    behind.robot._start_ms -= HOUR_MS
    require_refused(behind, scenarios.propose(behind, LOOK), Reason.CLOCK_BEHIND)
    with pytest.raises(ClockError):
        behind.gate.management.recover()
    behind.gate.enforcer.stop(by="operator-1", is_planner=False)
    assert behind.robot.stops == 1
    behind.gate.close()
    mended = scenarios.simulation(store=path, start_ms=scenarios.START_MS + 3 * HOUR_MS)
    require_goes_on(mended)
    mended.gate.close()


def test_a_simulated_gate_takes_no_time_from_the_machine(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenarios.simulation(store=path).gate.close()
    monkeypatch.setattr(time, "time_ns", lambda: (scenarios.START_MS + 48 * HOUR_MS) * 1_000_000)
    again = scenarios.simulation(store=path, start_ms=scenarios.START_MS + HOUR_MS)
    assert again.robot.wall_ms() == scenarios.START_MS + HOUR_MS
    again.gate.close()


# threads that come back in another order than they committed


class Late:
    """A store whose answer takes its time to reach one thread (`core.ports.Store`)."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._slow: int | None = None
        self._committed = threading.Event()
        self._back = threading.Event()

    def run(self, job: Callable[[Turn], T], *, essential: bool = False) -> T:
        result = self._store.run(job, essential=essential)
        if threading.get_ident() == self._slow:
            self._committed.set()
            assert self._back.wait(PATIENCE)
        return result

    def read(self, job: Callable[[Turn], T]) -> T:
        return self._store.read(job)

    def restore(self) -> bool:
        return self._store.restore()

    def close(self) -> None:
        self._store.close()

    def overtaken(self, slow: Callable[[], object], fast: Callable[[], object]) -> None:
        """Commit the slow act, then the fast one; come back from them the other way round."""

        def work() -> None:
            self._slow = threading.get_ident()
            slow()

        thread = threading.Thread(target=work, daemon=True)
        thread.start()
        assert self._committed.wait(PATIENCE)
        fast()
        self._back.set()
        thread.join(PATIENCE)
        assert not thread.is_alive()


class SetClock:
    """A clock that stands where it was put."""

    def __init__(self) -> None:
        self.wall = scenarios.START_MS
        self.mono = 0

    def wall_ms(self) -> int:
        return self.wall

    def mono_ms(self) -> int:
        return self.mono

    def pause(self, duration_ms: int) -> None:
        self.wall += duration_ms
        self.mono += duration_ms


def late_ledger() -> tuple[Late, SetClock, Ledger]:
    store, clock = Late(MemoryStore()), SetClock()
    ledger = Ledger(store, clock, robot=scenarios.RID, salts=scenarios.random_bytes, genesis={})
    return store, clock, ledger


@pytest.mark.smoke
def test_an_act_that_comes_back_late_does_not_undo_a_revocation_for_a_running_lease() -> None:
    store, _, ledger = late_ledger()
    active = scenarios.active(scenarios.verified())
    revoked = advance(active, Event.REVOKE)
    assert revoked is not None
    ledger.run(lambda act: act.hold(active))
    store.overtaken(
        slow=lambda: ledger.run(lambda act: act.standing(active.mid)),
        fast=lambda: ledger.run(lambda act: act.hold(revoked)),
    )
    # this is what a lease is held against while the robot moves
    assert ledger.standing(active.mid) == revoked


def test_an_act_that_comes_back_late_does_not_turn_trusted_time_back() -> None:
    store, clock, ledger = late_ledger()

    def later() -> None:
        clock.pause(60_000)
        ledger.run(lambda act: act.now)

    store.overtaken(slow=lambda: ledger.run(lambda act: act.now), fast=later)
    clock.wall -= 30_000
    with pytest.raises(ClockError):
        ledger.now()


def test_a_controller_that_refuses_is_no_store_fault_and_gives_the_start_back(path: Path) -> None:
    """The near miss of everything above: the store works, and the log says what did not."""
    sim = scenarios.simulation(store=path, faults=Faults(controller_refuses=True))
    sim.gate.management.activate(scenarios.token(MISSION))
    report = scenarios.propose(sim, LOOK)
    assert report.outcome is Outcome.NOT_STARTED
    assert [finding.reason for finding in report.reasons] == [Reason.CONTROLLER_FAILED]
    assert kinds(rows_of(sim))[-2:] == ["decision", "outcome"]
    assert standing_of(sim).uses["look-out"].starts == 0
    sim.gate.close()
