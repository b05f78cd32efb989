# SPDX-License-Identifier: Apache-2.0
"""A store's file that anybody made: read in bounded time and memory, or refused (lesson L26)."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import apsw
import pytest

from authguard_r.core.action import Action
from authguard_r.core.errors import StoreError
from authguard_r.core.reasons import Reason
from authguard_r.store.layout import APPLICATION_ID, TABLES
from authguard_r.store.sqlite import read_held, read_rows
from fixtures import scenarios

#: Bound against hanging, in seconds of the processor.
SOON_S = 5
#: What the reading of any small file may add to the process's memory, in KiB.
MOST_KIB = 200_000
SCAN = Action(type="scan_obstacles", tool="lidar")
HELD, AUDIT = (f"{part};" for part in TABLES.strip().removesuffix(";").split(";\n"))
VIEW = "CREATE VIEW audit(seq, record, sealed, link) AS"
ENDLESS = "WITH RECURSIVE n(x) AS (SELECT 0 UNION ALL SELECT x + 1 FROM n) SELECT x, x, x, x FROM n"
#: What takes the place of the tables of a store, or stands beside them.
HOSTILE = {
    "a view that changes with time": f"{HELD} {VIEW} SELECT 0, strftime('%s'), '{{}}', x'00'",
    "a view without an end": f"{HELD} {VIEW} {ENDLESS}",
    "a view of a long value": f"{HELD} {VIEW} SELECT 0, zeroblob(1000000000), '{{}}', x'00'",
    "a computed column": f"{HELD} CREATE TABLE audit (seq INTEGER PRIMARY KEY, record BLOB, "
    "sealed BLOB, link BLOB GENERATED ALWAYS AS (x'00'))",
    "a virtual table": f"{HELD} CREATE VIRTUAL TABLE audit USING fts5(record, sealed, link)",
    "a view beside them": f"{HELD} {AUDIT} CREATE VIEW more AS SELECT 1",
    "a table beside them": f"{HELD} {AUDIT} CREATE TABLE more (x)",
    "an index of its own": f"{HELD} {AUDIT} CREATE INDEX more ON audit (link)",
    "a trigger of its own": f"{HELD} {AUDIT} CREATE TRIGGER more AFTER INSERT ON audit BEGIN "
    "SELECT 1; END",
    "a held that is a view": f"{AUDIT} CREATE VIEW held(kind, key, value) AS SELECT 1, 2, 3",
    "neither table": "CREATE TABLE other (x)",
}


def store(path: Path, schema: str) -> None:
    """Make a file that says that it is a store, with this schema."""
    connection = apsw.Connection(str(path))
    connection.execute(f"PRAGMA application_id = {APPLICATION_ID}; PRAGMA user_version = 1;")
    connection.execute(schema)
    connection.close()


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "robot.db"


def refused(read: Callable[[], object]) -> StoreError:
    """Return why a file is refused, in bounded time and memory."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begun = time.process_time()
    with pytest.raises(StoreError) as caught:
        read()
    assert time.process_time() - begun < SOON_S
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < MOST_KIB
    assert caught.value.reason is Reason.STORE_CORRUPT
    return caught.value


@pytest.mark.parametrize("schema", HOSTILE.values(), ids=HOSTILE.keys())
def test_a_file_whose_schema_is_not_ours_is_no_store(file: Path, schema: str) -> None:
    store(file, schema)
    assert "the file is no store" in refused(lambda: list(read_rows(file))).message
    refused(lambda: read_held(file, "clock", "high"))


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the bytes of a gate's own store of many pages."""
    path = tmp_path_factory.mktemp("store") / "robot.db"
    sim = scenarios.simulation(store=path)
    sim.gate.management.activate(scenarios.token())
    for _ in range(15):
        scenarios.propose(sim, SCAN)
    sim.gate.close()
    return path.read_bytes()


def test_a_gates_own_store_is_read(file: Path, whole: bytes) -> None:
    file.write_bytes(whole)
    rows = list(read_rows(file))
    assert [row.seq for row in rows] == list(range(len(rows)))
    assert len(rows) > 20


def test_a_file_whose_pages_point_anywhere_ends(file: Path, whole: bytes) -> None:
    """Each inner page points at one page alone, at each in turn: read or refused, never endless."""
    size = int.from_bytes(whole[16:18], "big")
    pages = len(whole) // size
    inner = [page for page in range(1, pages) if whole[page * size] == 5]
    assert inner
    for page in inner:
        start = page * size
        cells = int.from_bytes(whole[start + 3 : start + 5], "big")
        for target in range(1, pages + 1):
            data = bytearray(whole)
            data[start + 8 : start + 12] = target.to_bytes(4, "big")
            for cell in range(cells):
                at = start + 12 + 2 * cell
                place = start + int.from_bytes(data[at : at + 2], "big")
                data[place : place + 4] = target.to_bytes(4, "big")
            file.write_bytes(data)
            begun = time.process_time()
            with suppress(StoreError):
                list(read_rows(file))
            assert time.process_time() - begun < SOON_S


def test_a_sparse_file_that_claims_to_be_long_ends(file: Path, whole: bytes) -> None:
    file.write_bytes(whole)
    with file.open("r+b") as opened:
        opened.truncate(1 << 33)
    begun = time.process_time()
    with suppress(StoreError):
        list(read_rows(file))
    assert time.process_time() - begun < SOON_S


def test_a_value_that_is_longer_than_any_of_ours_is_refused(file: Path) -> None:
    store(file, HELD + AUDIT)
    connection = apsw.Connection(str(file))
    connection.execute("INSERT INTO audit VALUES (0, zeroblob(17000000), x'7b7d', zeroblob(32))")
    connection.close()
    refused(lambda: list(read_rows(file)))
