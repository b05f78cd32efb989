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

from authguard_r.anchoring.checkpoints import Checkpoints
from authguard_r.audit.note import signature_lines
from authguard_r.audit.record import BOX
from authguard_r.cli import call
from authguard_r.core.mission import DataClass
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.keys.signer import folder_signer
from authguard_r.operations.simulation import Simulation
from authguard_r.store.segment_mover import Mover
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


@needs_node
@pytest.mark.parametrize("covers", [True, False], ids=["after the order", "before the order"])
def test_an_order_to_destroy_counts_where_a_checkpoint_covers_it(
    covers: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Anybody can put a record behind what is signed for, and take every value away."""
    trust, path = scenarios.trust_folder(), tmp_path / "robot.jsonl"
    policy = sealed_logs.policy(sealed_logs.reader("auditor"))
    with sealed_logs.sealing(tmp_path / "robot.db", policy) as sim:
        mission = sealed_logs.active(sim)
        scenarios.propose(sim, scenarios.navigate("dock", "pharmacy"))
        sim.gate.management.command(sealed_logs.command(sim, Verb.REVOKE, mission))
        signer = folder_signer(trust, f"gate-{scenarios.RID}")
        checkpoints = Checkpoints(sim.gate.ledger, robot=scenarios.RID, signer=signer)
        checkpoints.make()
        before = checkpoints.held()
        assert before is not None
        shred(sim, mission.mid)
    assert call(["audit", "export", str(tmp_path / "robot.db"), "--out", str(path)]) == 0
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    note = json.loads(lines[-1])["checkpoint"]  # made at the gate's end
    path.write_text("".join(lines[:-1]), encoding="utf-8")
    early = f"{before.text}\n{signature_lines(before.signatures)}"
    (tmp_path / "note").write_text(note if covers else early, encoding="utf-8")
    capsys.readouterr()
    assert call(["audit", "key", "--trust", str(trust), "--robot", scenarios.RID]) == 0
    key = capsys.readouterr().out.strip()
    anchored = ("--key", key, "--checkpoint", str(tmp_path / "note"))
    code = call(["audit", "verify", str(path), *anchored, "--json"])
    told = json.loads(capsys.readouterr().out)
    assert (told["whole"], told["anchored"]) == (True, "checkpoint")
    assert (code, bool(told["missing"])) == ((0, False) if covers else (1, True))
    code, out = node(str(path), *anchored)
    assert (code, "MISSING: " in out) == ((0, False) if covers else (1, True))
