# SPDX-License-Identifier: Apache-2.0
"""The estimator: newest wins, one at a time, and nothing is ever fresher than it is."""

from __future__ import annotations

import pytest

from authguard_r.client.attesting import ANSWER_MS
from authguard_r.client.sensing import ID_MODULUS
from authguard_r.core.encoding import Tag
from authguard_r.core.errors import MalformedError
from authguard_r.core.state import Snapshot
from authguard_r.core.token import open_token
from authguard_r.keys.signer import folder_signer
from authguard_r.keys.trust import read_trust
from authguard_r.sim.estimator import Estimator
from authguard_r.sim.robot import Faults, SymbolicRobot
from authguard_r.sim.sensors import reading_frame
from authguard_r.sim.sight import snapshot_of
from authguard_r.wire.frames import Frame, FrameReader, read_body
from authguard_r.wire.messages import Attest, Fault, Kind
from fixtures import scenarios
from unit.sim.controller_bench import framed

EPOCH = 1_700_000_000_000


def estimator(rate_hz: int = 20) -> Estimator:
    signer = folder_signer(scenarios.trust_folder(), f"estimator-{scenarios.RID}")
    return Estimator(scenarios.RID, signer, epoch=EPOCH, rate_hz=rate_hz)


def cut(data: bytes) -> Frame:
    (item,) = FrameReader(lambda _: 1 << 20).feed(data)
    return item


def reading(measured_ms: int, *, at: str = "dock", rid: str = scenarios.RID) -> Frame:
    seen = snapshot_of(scenarios.world(at), robot=rid, epoch=0, seq=0, pose_age_ms=7)
    return cut(reading_frame(seen, measured_ms))


def opened(data: bytes | None) -> Snapshot:
    assert data is not None
    snapshot, _, signer = open_token(
        read_body(cut(data).body, Attest).token,
        Snapshot,
        tag=Tag.STATE,
        roles=frozenset({"estimator"}),
        verifier=read_trust(scenarios.trust_folder()),
        now=scenarios.NOW,
    )
    assert signer.id == f"estimator-{scenarios.RID}"
    return snapshot


def test_nothing_is_said_before_anything_was_heard() -> None:
    assert estimator().attester.due(None, 1_000) is None


def test_a_snapshot_is_signed_with_epoch_and_growing_seq() -> None:
    it = estimator()
    it.heard(reading(1_000), 1_000)
    first = opened(it.attester.due(it.seen, 1_000))
    it.attester.answered(framed(Kind.REPLY, {}))
    second = opened(it.attester.due(it.seen, 1_050))
    assert (first.epoch, first.seq, second.seq) == (EPOCH, 1, 2)
    assert first.robot == scenarios.RID


def test_at_most_one_is_on_its_way_and_the_newest_wins() -> None:
    it = estimator()
    it.heard(reading(1_000), 1_000)
    assert it.attester.due(it.seen, 1_000) is not None
    for at in (1_050, 1_100, 1_150):
        it.heard(reading(at, at="pharmacy" if at == 1_150 else "dock"), at)
        assert it.attester.due(it.seen, at) is None
    it.attester.fence(7, 1_155)  # no answer
    assert it.attester.due(it.seen, 1_160) is None
    it.attester.answered(framed(Kind.REPLY, {}))
    got = opened(it.attester.due(it.seen, 1_160))
    assert got.pose is not None
    assert (got.pose.x_mm, got.seq) == (4_000, 2)


def test_what_was_heard_grows_old_and_is_never_fresh_again() -> None:
    it = estimator()
    it.heard(reading(1_000), 1_020)  # it was 20 ms on its way
    ages = []
    for now in (1_020, 1_500, 9_000):
        got = opened(it.attester.due(it.seen, now))
        assert got.pose is not None
        ages.append((got.pose.age_ms, got.readings["speed_mm_s"].age_ms))
        it.attester.answered(framed(Kind.REPLY, {}))
    assert ages == [(27, 20), (507, 500), (8_007, 8_000)]


def test_readings_that_waited_in_a_buffer_are_as_old_as_they_are() -> None:
    it = estimator()
    it.heard(reading(1_000), 61_000)
    got = opened(it.attester.due(it.seen, 61_000))
    assert got.readings["battery_permille"].age_ms == 60_000


def test_the_clock_of_a_frame_may_have_gone_round() -> None:
    it = estimator()
    it.heard(reading(ID_MODULUS - 5), ID_MODULUS + 5)
    assert opened(it.attester.due(it.seen, ID_MODULUS + 5)).readings["speed_mm_s"].age_ms == 10


def test_what_claims_to_come_from_the_future_is_very_old() -> None:
    it = estimator()
    it.heard(reading(5_000), 1_000)
    assert opened(it.attester.due(it.seen, 5_001)).readings["speed_mm_s"].age_ms > 1_000_000_000


def test_the_rate_is_kept() -> None:
    it = estimator(rate_hz=10)
    sent = []
    for now in range(1_000, 2_000, 5):
        it.heard(reading(now), now)
        if it.attester.due(it.seen, now) is not None:
            sent.append(now)
            it.attester.answered(framed(Kind.REPLY, {}))
    assert len(sent) == 10


def test_a_refusal_is_returned_and_the_next_one_is_sent() -> None:
    it = estimator()
    it.heard(reading(1_000), 1_000)
    it.attester.due(it.seen, 1_000)
    fault = Fault(code="STATE_STALE", message="older", where="state.seq")
    refusal = it.attester.answered(framed(Kind.ERROR, fault))
    assert refusal is not None
    assert "older" in refusal.message
    assert it.attester.due(it.seen, 1_050) is not None


def test_a_gate_that_answers_nothing_is_overdue_until_it_hangs_up() -> None:
    it = estimator()
    it.heard(reading(1_000), 1_000)
    it.attester.due(it.seen, 1_000)
    assert not it.attester.is_overdue(1_000 + ANSWER_MS)
    assert it.attester.is_overdue(1_001 + ANSWER_MS)
    it.attester.hung_up()
    assert not it.attester.is_overdue(9_000)
    assert opened(it.attester.due(it.seen, 9_000)).seq == 2


def test_another_robot_is_not_attested() -> None:
    it = estimator()
    with pytest.raises(MalformedError):
        it.heard(reading(1_000, rid=scenarios.OTHER), 1_000)
    with pytest.raises(MalformedError):
        it.heard(framed(Kind.EVENT, {"robot": scenarios.RID}), 1_000)
    assert it.attester.due(it.seen, 1_000) is None


def test_a_robot_without_an_estimator_signs_nothing_and_still_sees() -> None:
    faults = Faults(localization_stops_ms=200, estimator_dies_ms=1_000)
    robot = SymbolicRobot(
        scenarios.site(),
        scenarios.RID,
        scenarios.world(),
        estimator=None,
        start_ms=scenarios.START_MS,
        faults=faults,
    )
    assert robot.latest() is None
    seen = robot.sensed()
    assert seen is not None
    assert (seen.epoch, seen.seq) == (0, 0)
    robot.pause(500)
    later = robot.sensed()
    assert later is not None
    assert later.pose is not None
    assert later.pose.age_ms >= 300
    robot.pause(500)
    assert robot.sensed() is None


def fences(snapshot: Snapshot) -> set[int]:
    assert snapshot.pose is not None
    return {snapshot.pose.fence, *(reading.fence for reading in snapshot.readings.values())}


def test_what_was_measured_before_a_fence_does_not_carry_it() -> None:
    it = estimator()
    it.heard(reading(1_000), 1_000)
    it.attester.fence(7, 1_000)  # of the same millisecond: who was first, nobody knows
    assert fences(opened(it.attester.due(it.seen, 1_001))) == {0}


def test_what_was_measured_after_a_fence_carries_its_number() -> None:
    it = estimator()
    it.attester.fence(7, 1_000)
    it.heard(reading(1_008), 1_008)
    assert fences(opened(it.attester.due(it.seen, 1_009))) == {7}


def test_a_value_that_is_older_than_its_snapshot_carries_no_fence() -> None:
    it = estimator()
    it.attester.fence(7, 1_000)
    it.heard(reading(1_007), 1_007)  # its pose is 7 ms older than the rest
    got = opened(it.attester.due(it.seen, 1_008))
    assert got.pose is not None
    assert (got.pose.fence, got.readings["holding"].fence) == (0, 7)


def test_a_fence_ends_with_the_connection_that_it_came_on() -> None:
    it = estimator()
    it.attester.fence(7, 1_000)
    it.attester.hung_up()
    it.heard(reading(1_050), 1_050)
    assert fences(opened(it.attester.due(it.seen, 1_051))) == {0}
