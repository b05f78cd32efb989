# SPDX-License-Identifier: Apache-2.0
"""Logs with boxes, before and after they are destroyed, and in segments: both verifiers agree.

The independent verifier knows nothing of sealing or of segments, and needs to know nothing: a box
is a value beside its record, and a rotated log's export is one log.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from authguard_r.assembly import Simulation
from authguard_r.audit.boxes import DataClass
from authguard_r.audit.record import BOX
from authguard_r.cli import call
from authguard_r.commands import Verb
from authguard_r.store.moving import Mover
from authguard_r.store.sqlite import SqliteStore
from conformance.test_vectors_log import needs_node, node
from fixtures import scenarios, sealed_logs
from fixtures.segmented_stores import note

#: Records in the segment of a rotated log.
MOVED = 5
CASES = ("sealed", "shredded", "rotated", "rotated, shredded")


def write(path: Path, case: str) -> None:
    """Let a gate that seals have a mission, and do with its log what the case says."""
    with sealed_logs.sealing(path, sealed_logs.policy(sealed_logs.reader("auditor"))) as sim:
        mission = sealed_logs.active(sim)
        for goal in ("pharmacy", "office-1"):
            sim.robot.state = scenarios.world("dock")
            scenarios.propose(sim, scenarios.navigate("dock", goal))
        sim.gate.management.command(sealed_logs.command(sim, Verb.REVOKE, mission))
        if "rotated" in case:
            rotate(sim)
        if "shredded" in case:
            shred(sim, mission.mid)


def rotate(sim: Simulation) -> None:
    """Move the first records into a segment, at once."""
    store = sim.gate.ledger.store
    assert isinstance(store, SqliteStore)
    links = [row[3] for row in store.read(lambda turn: turn.rows(0, MOVED))]
    mover = Mover(store)
    mover.begin(MOVED)
    assert mover.copy(MOVED, lambda _turn, _rows: None)
    mover.seal(note(links, scenarios.RID), head=links[-1])
    while mover.clears:
        mover.clear(MOVED)
    assert store.segments.end == MOVED


def shred(sim: Simulation, mid: str) -> None:
    """Have the regions of a mission destroyed, to the last box."""
    sim.gate.management.shred(sealed_logs.shred_order(sim, mid, DataClass.REGION))
    while sim.gate.management.shred_on():
        pass


def boxes(lines: list[str]) -> dict[int, list[str]]:
    """Return the text of every box, under the number of its record."""
    found: dict[int, list[str]] = {}
    for line in lines:
        row = json.loads(line)
        for name, item in json.loads(row.get("sealed", "{}")).items():
            if name.startswith(BOX):
                found.setdefault(row["seq"], []).append(item["value"]["text"])
    return found


def ours(path: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, Any]:
    capsys.readouterr()
    code = call(["audit", "verify", str(path), "--json"])
    return code, json.loads(capsys.readouterr().out)


@needs_node
@pytest.mark.parametrize("case", CASES)
def test_both_verifiers_find_it_whole_and_name_the_record_of_a_box_that_was_changed(
    case: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path / "robot.db", case)
    path = tmp_path / "robot.jsonl"
    assert call(["audit", "export", str(tmp_path / "robot.db"), "--out", str(path)]) == 0
    code, told = ours(path, capsys)
    assert (code, told["whole"]) == (0, True)
    code, out = node(str(path))
    assert code == 0
    assert out.startswith(f"whole: {told['size']} records, head {told['head']}, root ")
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    found = boxes(lines)
    regions = [line for line in lines if '\\"box.region\\":{\\"salt' in line]
    assert bool(regions) is ("shredded" not in case)
    assert len(found) > 3
    assert min(found) < MOVED < max(found)
    for seq, texts in found.items():
        for number, text in enumerate(texts):
            other = ("B" if text[0] == "A" else "A") + text[1:]
            assert lines[seq].count(text) == 1
            changed = lines[seq].replace(text, other)
            path.write_text("".join([*lines[:seq], changed, *lines[seq + 1 :]]), encoding="utf-8")
            code, told = ours(path, capsys)
            assert (code, told["where"]) == (1, f"record {seq}")
            assert "does not match its commitment" in told["fault"]
            if number == 0:  # a process for one box of each record
                code, out = node(str(path))
                assert (code, out[: out.index(" box.")]) == (
                    1,
                    f"NOT WHOLE at record {seq}: the value",
                )
