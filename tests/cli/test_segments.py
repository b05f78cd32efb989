# SPDX-License-Identifier: Apache-2.0
"""`audit growth` and `audit segments`; and every other reader of a log that was rotated."""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

import apsw
import pytest

from authguard_r.anchoring.checkpoints import Checkpoints
from authguard_r.anchoring.rotation import Rotation, RotationPolicy
from authguard_r.cli import call
from authguard_r.keys.signer import folder_signer
from authguard_r.operations.checkup.advice import AdviceCode
from authguard_r.operations.checkup.logbook import store_advice
from authguard_r.store.segments import name_of
from authguard_r.store.sqlite import SqliteStore, open_store
from conformance.test_vectors_log import NODE, VERIFIER, needs_node
from fixtures import scenarios
from fixtures.segmented_stores import fill
from fixtures.small_witness import log_keys
from unit.test_untrusted_stores import ENDLESS, MOST_KIB, SOON_S

GO = scenarios.navigate("dock", "pharmacy")
SCAN = "scan_obstacles"
#: Records of the log, its first segment's end, and the end of the second.
SIZE, FIRST, SECOND = 1_899, 1_024, 1_536
KEY = ("--log-key", log_keys()[0].text())


def made(path: Path) -> None:
    """Write a gate's log of missions, stops and much else, and move what is old of it."""
    sim = scenarios.simulation(store=path)
    sim.gate.management.activate(scenarios.token())
    scenarios.propose(sim, GO)
    store = sim.gate.ledger.store
    assert isinstance(store, SqliteStore)
    signer = folder_signer(scenarios.trust_folder(), f"gate-{scenarios.RID}")
    checkpoints = Checkpoints(sim.gate.ledger, robot=scenarios.RID, signer=signer)
    fill(store, SIZE - 1 - store.read(lambda turn: turn.head())[0])
    sim.gate.ledger.raise_fence(sim.gate.ledger.fence + SIZE)  # those came past the ledger
    checkpoints.make()
    rotation = Rotation(
        sim.gate.ledger,
        store,
        robot=scenarios.RID,
        signer=signer,
        policy=RotationPolicy(records=1_024),
    )
    while store.segments.end < FIRST:
        rotation.tick()
    for _ in range(9):
        rotation.tick()
    scenarios.propose(sim, GO)
    rotation._policy = RotationPolicy(records=512)
    while store.segments.end < SECOND:
        rotation.tick()
    sim.gate.close()


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rotated") / "robot.db"
    made(path)
    return path


@pytest.fixture
def log(kept: Path, tmp_path: Path) -> Path:
    """A copy of the rotated log, to be spoiled."""
    shutil.copytree(kept.parent, tmp_path / "copy")
    return tmp_path / "copy" / kept.name


def segment(log: Path, first: int) -> Path:
    return log.with_name(f"{log.name}.segments") / name_of(first)


def said(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str]:
    capsys.readouterr()
    code = call(["audit", *map(str, words)])
    out, err = capsys.readouterr()
    return code, out + err


def told(capsys: pytest.CaptureFixture[str], *words: object) -> Any:
    code, out = said(capsys, *words, "--json")
    return code, json.loads(out)


# every reader


def test_verify_reads_one_log_over_segments_and_store(
    kept: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, found = told(capsys, "verify", kept, *KEY)
    assert (code, found["whole"], found["size"]) == (0, True, SIZE)
    assert found["anchored"] == "checkpoint"


@needs_node
def test_an_export_of_a_rotated_log_is_whole_to_a_stranger(
    kept: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "log.jsonl"
    assert said(capsys, "export", kept, "--out", out)[0] == 0
    assert told(capsys, "verify", out, *KEY)[1]["size"] == SIZE
    assert NODE is not None
    done = subprocess.run(
        [NODE, str(VERIFIER), str(out), "--key", KEY[1]],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert f"{SIZE} records" in done.stdout


def test_show_explain_replay_and_prompts_begin_in_the_first_segment(
    kept: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, shown = told(capsys, "show", kept, "--kind", "decision")
    numbers = [record["seq"] for record in shown["records"]]
    assert numbers[0] < FIRST
    assert numbers[-1] >= SECOND
    assert told(capsys, "explain", kept, numbers[0])[0] == 0
    code, replayed = told(capsys, "replay", kept)
    assert (code, replayed["whole"], replayed["agree"]) == (0, True, len(numbers))
    assert told(capsys, "prompts", kept)[1]["missions"] == 1


# growth


def test_growth_is_told_for_each_mission_and_adds_up(
    kept: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, found = told(capsys, "growth", kept)
    none, mission = found["missions"]
    assert code == 0
    assert (none["mission"], mission["mission"]) == ("-", scenarios.mission().mid)
    assert found["told_by"] is None
    for name in ("records", "decisions", "bytes"):
        assert found[name] == none[name] + mission[name]
    assert (found["records"], found["share"]) == (SIZE, 1.0)
    assert (none["decisions"], none["bytes_per_decision"]) == (0, None)
    each = round(mission["bytes"] / mission["decisions"])
    assert (mission["decisions"], mission["bytes_per_decision"]) == (2, each)


def test_growth_of_an_export_is_that_of_its_store(
    kept: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "log.jsonl"
    said(capsys, "export", kept, "--out", out)
    assert told(capsys, "growth", out) == told(capsys, "growth", kept)


def test_growth_is_a_table_for_people(kept: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, text = said(capsys, "growth", kept)
    head, *rows = text.splitlines()
    assert head.split() == ["mission", "records", "decisions", "bytes", "bytes/decision", "share"]
    assert [row.split()[0] for row in rows] == ["-", scenarios.mission().mid, "all"]
    assert rows[-1].split()[1] == f"{SIZE:,}"
    assert rows[-1].endswith("100.0%")
    assert len({len(row) for row in (head, *rows)}) == 1


def test_a_log_of_nothing_has_grown_by_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    empty = tmp_path / "empty.db"
    open_store(empty).close()
    code, found = told(capsys, "growth", empty)
    assert (code, found["missions"], found["share"]) == (0, [], 0.0)


# segments


def test_each_segment_is_listed_and_held_to_the_key(
    kept: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, found = told(capsys, "segments", kept, *KEY)
    files = [segment(kept, first) for first in (0, FIRST)]
    assert code == 0
    assert found["segments"] == [
        {
            "file": str(file),
            "first": first,
            "end": end,
            "bytes": file.stat().st_size,
            "verified": True,
        }
        for file, first, end in zip(files, (0, FIRST), (FIRST, SECOND), strict=True)
    ]
    _, text = said(capsys, "segments", kept)
    assert text.count("not verified") == 2
    assert f"{files[1]}: records {FIRST} to {SECOND - 1}, " in text
    assert said(capsys, "segments", kept, *KEY)[1].count("checkpoint verified") == 2


def test_a_store_without_segments_has_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "robot.db"
    scenarios.simulation(store=path).gate.close()
    assert said(capsys, "segments", path) == (
        0,
        "no segments: every record is in the store itself\n",
    )
    assert said(capsys, "segments", tmp_path / "nothing.db")[0] == 5


def test_a_store_that_a_gate_holds_has_its_segments_listed(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sim = scenarios.simulation(store=log)
    assert len(told(capsys, "segments", log)[1]["segments"]) == 2
    sim.gate.close()


@pytest.mark.parametrize("first", [0, FIRST])
def test_a_segment_that_is_gone_is_named(
    log: Path, capsys: pytest.CaptureFixture[str], first: int
) -> None:
    segment(log, first).unlink()
    for words in (("segments", log), ("verify", log), ("growth", log)):
        code, text = said(capsys, *words)
        assert code in {4, 5}
        assert name_of(first) in text


def test_a_segment_whose_links_were_changed_is_not_its_checkpoints(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    connection = apsw.Connection(str(segment(log, FIRST)))
    connection.execute("DROP TRIGGER audit_only_forgets")
    connection.execute("UPDATE audit SET link = zeroblob(32) WHERE seq = 1100")
    connection.close()
    assert said(capsys, "segments", log)[0] == 0
    code, text = said(capsys, "segments", log, *KEY)
    assert code == 4
    assert "not those of its checkpoint" in text
    assert str(segment(log, FIRST)) in text
    assert "record 1100" in said(capsys, "verify", log)[1]


def test_a_segment_that_another_key_signed_is_refused(
    kept: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    key = log_keys()[0]
    forged = type(key)("authguard-r/another/audit", key.kind, key.public)
    code, text = said(capsys, "segments", kept, "--log-key", forged.text())
    assert code == 4
    assert "SIGNATURE_MISSING" in text


def test_a_segment_that_others_read_is_said(log: Path) -> None:
    segment(log, FIRST).chmod(0o644)
    found = store_advice(log, scenarios.NOW, uid=os.geteuid(), deep=True)
    places = [one.place for one in found if one.code is AdviceCode.READABLE]
    assert str(segment(log, FIRST)) in places
    assert str(segment(log, 0)) not in places


def test_a_file_that_is_none_and_links_that_are_none_are_named(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (segment(log, 0).parent / "notes.txt").write_text("not a segment's")
    assert said(capsys, "segments", log)[0] == 0
    connection = apsw.Connection(str(segment(log, FIRST)))
    connection.execute(
        "ALTER TABLE audit RENAME TO old; "
        "CREATE TABLE audit (seq INTEGER PRIMARY KEY, record, sealed, link); "
        "INSERT INTO audit SELECT * FROM old; UPDATE audit SET link = 7 WHERE seq = 1100"
    )
    connection.close()
    assert said(capsys, "segments", log, *KEY)[0] == 4
    segment(log, FIRST).write_bytes(b"no segment")
    code, text = said(capsys, "segments", log)
    assert code == 4
    assert name_of(FIRST) in text


# a segment that is a program

VIEW = "ALTER TABLE audit RENAME TO old; CREATE VIEW audit(seq, record, sealed, link) AS"
#: What is done to a segment of ours; its checkpoint and its records are there as before.
HOSTILE = {
    "a view of its own records": f"{VIEW} SELECT seq, record, sealed, link FROM old",
    "a view that changes with time": (
        f"{VIEW} SELECT seq, CASE WHEN seq = 1100 THEN strftime('%s') ELSE record END, "
        "sealed, link FROM old"
    ),
    "a view in the place of the table": (
        "CREATE TABLE rows AS SELECT * FROM audit; DROP TABLE audit; "
        "CREATE VIEW audit AS SELECT * FROM rows"
    ),
    "a view without an end": f"{VIEW} {ENDLESS}",
    "a view of a long value": f"{VIEW} SELECT seq, zeroblob(1000000000), sealed, link FROM old",
    "a trigger of its own": (
        "CREATE TRIGGER more AFTER UPDATE ON audit BEGIN DELETE FROM audit; END"
    ),
    "a trigger on what it holds": (
        "CREATE TRIGGER audit_no_gap AFTER INSERT ON held BEGIN DELETE FROM held; END"
    ),
}


@pytest.mark.parametrize("schema", HOSTILE.values(), ids=HOSTILE.keys())
@pytest.mark.parametrize("command", ["verify", "show", "replay", "growth", "prompts", "segments"])
def test_a_segment_that_is_a_program_is_refused_with_its_reason_and_at_once(
    log: Path, capsys: pytest.CaptureFixture[str], command: str, schema: str
) -> None:
    """A segment is read by whoever was given it: nothing in it may run (lesson L26)."""
    connection = apsw.Connection(str(segment(log, FIRST)))
    for (trigger,) in connection.execute(
        "SELECT name FROM sqlite_schema WHERE type = 'trigger'"
    ).fetchall():
        connection.execute(f"DROP TRIGGER {trigger}")
    connection.execute(schema)
    connection.close()
    begun, before = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    code, found = told(capsys, command, log)
    assert time.process_time() - begun < SOON_S
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < MOST_KIB
    assert (code, found["error"]["code"]) == (4, "STORE_CORRUPT")
    assert name_of(FIRST) in found["error"]["where"] + found["error"]["message"]
