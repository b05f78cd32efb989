# SPDX-License-Identifier: Apache-2.0
"""The replay counts pre-approvals: one used too often, or never taken in, is found."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from authguard_r.audit.record import LogRow, read_record
from authguard_r.auditor.replay.preapproval import PreApprovals
from authguard_r.cli.replay import LogReplay
from authguard_r.core.approval import ApprovalVerdict, PreApproval
from authguard_r.core.encoding import Tag, digest_of
from authguard_r.keys.trust import read_trust
from fixtures import approvals
from missionpair.bench import Bench, BenchScene, make_bench, world

TO = "isolation-room"


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    return make_bench(tmp_path_factory.mktemp("bench") / "trust")


def twice(bench: Bench) -> BenchScene:
    """Return a scene whose robot went twice, on one pre-approval of two uses."""
    scene = approvals.scene(bench, TO)
    mission, now = scene.mission, scene.sim.robot.wall_ms()
    said = PreApproval(
        mid=mission.mid,
        version=mission.version,
        mission=digest_of(Tag.MISSION, mission),
        rid=mission.rid,
        grant=mission.actions[0].id,
        rows=(0,),
        most_risk=mission.risk_policy.tau_2 - 1,
        uses=2,
        expires_ms=now + 600_000,
        issued_ms=now,
    )
    token = approvals.signed(bench, said, "supervisor-1", tag=Tag.PREAPPROVAL)  # type: ignore[arg-type]
    scene.sim.gate.management.select(token)
    for _ in range(2):
        assert approvals.outcome(scene) == []
        scene.sim.robot.state = world(bench, "dock")
        scene.sim.robot.pause(500)
    return scene


def rows_of(scene: BenchScene) -> list[LogRow]:
    return [LogRow(*row) for row in scene.sim.gate.ledger.peek(lambda turn: turn.rows(0, 10_000))]


def test_an_honest_log_is_decided_again_as_it_was(bench: Bench) -> None:
    replay = LogReplay(read_trust(bench.folder))
    assert [wrong for row in rows_of(twice(bench)) if (wrong := replay.see(row))] == []
    assert (replay.decisions, replay.agree) == (2, 2)


def test_one_use_more_than_was_signed_is_found(bench: Bench) -> None:
    counted = PreApprovals()
    records = [read_record(row.record, where="") for row in rows_of(twice(bench))]
    released = [record for record in records if record.open.get("preapproved")]
    assert [counted.note(record) for record in records] == [""] * len(records)
    assert "was used up before it" in counted.note(released[-1])


def test_a_use_of_what_no_record_took_in_is_found(bench: Bench) -> None:
    counted = PreApprovals()
    records = [read_record(row.record, where="") for row in rows_of(twice(bench))]
    told = [counted.note(r) for r in records if r.open.get("verb") != "preapprove"]
    assert sum("no record before it took that in" in text for text in told) == 2


def test_a_standing_with_other_numbers_is_found(bench: Bench) -> None:
    scene, counted = twice(bench), PreApprovals()
    for row in rows_of(scene):
        counted.note(read_record(row.record, where=""))
    standing = scene.standing()
    assert standing is not None
    assert counted.wrong(standing) == ""
    (digest,) = standing.preapproved
    assert "by the records before it" in counted.wrong(replace(standing, preapproved={digest: 1}))


def test_a_denial_ends_what_the_records_count(bench: Bench) -> None:
    scene, counted = approvals.scene(bench, TO), PreApprovals()
    assert approvals.outcome(scene) == ["APPROVAL_REQUIRED"]
    approvals.hand_in(bench, scene, "safety-officer-1", verdict=ApprovalVerdict.DENY)
    for row in rows_of(scene):
        assert counted.note(read_record(row.record, where="")) == ""
    standing = scene.standing()
    assert standing is not None
    assert counted.wrong(standing) == ""
