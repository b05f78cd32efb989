# SPDX-License-Identifier: Apache-2.0
"""What is doubtful about a position is found, and what is sound is passed: on plain numbers.

Spec page: docs/spec/ros-position.md#sound
"""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from authguard_r.integrations.ros.position import (
    AHEAD_MS,
    MS,
    SETTLE_MS,
    SETTLE_SAMPLES,
    SILENCE_MS,
    SPACED_MS,
    DoubtCause,
    Fix,
    PositionSample,
    PositionTrack,
    Stamps,
    covariance_fault,
)
from fixtures.cases import case

STEP_MS = 20
MARGIN_MM, MAX_MM_S = 150, 1_500
NOBODY = b""


def track() -> PositionTrack:
    return PositionTrack(max_speed_mm_s=MAX_MM_S, margin_mm=MARGIN_MM)


def at(ms: float, x: float = 0.0, y: float = 0.0, **more: object) -> PositionSample:
    ns = int(ms * MS)
    given = {"z": 0.0, "who": b"a", "newest_ns": ns, "oldest_ns": ns, "speed": 0.0, **more}
    return PositionSample(x=x, y=y, **given)  # type: ignore[arg-type]


def settled(speed: float | None = 0.0) -> tuple[PositionTrack, int]:
    """Return a track that is sound, and when."""
    it, ms = track(), 0
    while it.fix is None:
        it.take(at(ms, speed=speed))
        ms += STEP_MS
    return it, ms


def test_nothing_is_attested_before_it_was_sound_for_long_enough() -> None:
    it, found = track(), list[int]()
    for ms in range(0, SETTLE_MS + STEP_MS, STEP_MS):
        it.take(at(ms))
        if it.fix is not None:
            found.append(ms)
    assert found == [SETTLE_MS]
    assert it.why is None


def test_few_samples_in_a_long_time_are_not_enough() -> None:
    it = track()
    for number in range(SETTLE_SAMPLES - 1):
        it.take(at(number * 600))
    assert it.fix is None
    it.take(at((SETTLE_SAMPLES - 1) * 600))
    assert it.fix is not None


def test_it_is_to_the_millimeter_and_no_speed_is_less_than_it_was_said() -> None:
    it, ms = settled()
    it.take(at(ms, 0.0014, -0.0016, speed=0.1001, oldest_ns=(ms - 7) * MS))
    assert it.fix == Fix(x_mm=1, y_mm=-2, speed_mm_s=101, measured_ns=(ms - 7) * MS)


FAULTS: list[tuple[DoubtCause, dict[str, object]]] = [
    (DoubtCause.NOT_FINITE, {"x": math.nan}),
    (DoubtCause.NOT_FINITE, {"speed": math.inf}),
    (DoubtCause.HEIGHT, {"z": 1.1}),
    (DoubtCause.HEIGHT, {"z": -1.1}),
    (DoubtCause.FAR, {"y": -1e7}),
    (DoubtCause.UNNAMED, {"who": NOBODY}),
    (DoubtCause.ANOTHER, {"who": b"b"}),
    (DoubtCause.JUMP, {"x": 0.4}),
    (DoubtCause.SILENCE, {"oldest_ns": 1}),
]


def test_a_sample_that_is_doubtful_ends_what_is_attested() -> None:
    for why, change in FAULTS:
        with case(why, change):
            it, ms = settled()
            it.take(at(ms, **change))  # type: ignore[arg-type]
            assert (it.fix, it.why, it.is_lost) == (None, why, True)
            # and one of them makes nothing sound
            it.take(at(ms + STEP_MS))
            assert (it.fix, it.why) == (None, why)


def test_silence_is_found_by_the_clock_and_by_the_next_sample() -> None:
    it, ms = settled()
    last = (ms - STEP_MS) * MS
    it.look(last + SILENCE_MS * MS - 1)
    assert it.fix is not None
    it.look(last + SILENCE_MS * MS)
    assert (it.fix, it.why) == (None, DoubtCause.SILENCE)
    it.look(last + 9 * SILENCE_MS * MS)  # and once
    it, ms = settled()
    it.take(at(ms - STEP_MS + SILENCE_MS))
    assert (it.fix, it.why, it.is_lost) == (None, DoubtCause.SILENCE, False)


def test_a_doubt_that_nothing_follows_becomes_a_silence() -> None:
    it, ms = settled()
    it.doubt(DoubtCause.LATE)
    for late, why in (
        (0, DoubtCause.LATE),
        (SILENCE_MS - 1, DoubtCause.LATE),
        (SILENCE_MS, DoubtCause.SILENCE),
    ):
        it.look((ms + late) * MS)
        assert (it.why, it.fix) == (why, None)
    it.doubt(DoubtCause.FRAME)  # somebody says something again
    it.look((ms + SILENCE_MS + 1) * MS)
    assert it.why is DoubtCause.FRAME


def test_who_was_never_heard_is_no_silence() -> None:
    it = track()
    for ms in (0, SILENCE_MS, 2 * SILENCE_MS):
        it.look(ms * MS)
    assert it.why is DoubtCause.START


def test_a_silence_after_a_silence_is_forgotten_too() -> None:
    """What was said between the two counts for nothing when something is said again."""
    it, ms = settled()
    for beginning in (ms, ms + 3 * SILENCE_MS):
        it.take(at(beginning))
        it.look((beginning + SILENCE_MS) * MS)
        assert (it.why, it.is_lost) == (DoubtCause.SILENCE, True)


def test_two_names_in_turn_are_never_sound() -> None:
    it = track()
    for ms in range(0, 5 * SETTLE_MS, STEP_MS):
        it.take(at(ms, who=b"ab"[ms // STEP_MS % 2 :][:1]))
        assert it.fix is None


def test_a_jump_within_the_margins_is_passed_and_many_of_them_are_not() -> None:
    """Each is explained; all of them together are a robot that is too fast."""
    it, ms = settled()
    it.take(at(ms, 0.29))
    assert it.fix is not None
    it.take(at(ms + STEP_MS, 0.58))
    assert it.why is DoubtCause.JUMP


def test_the_newest_position_counts_although_it_comes_too_soon_to_be_kept() -> None:
    """From the kept one the way is slow enough; from the newest it is not."""
    it, ms = settled()
    kept_ms = ms + SPACED_MS
    newest_ms = kept_ms + SPACED_MS - 1
    it.take(at(kept_ms))
    it.take(at(newest_ms))
    it.take(at(newest_ms + 303, 0.7575))
    assert it.why is DoubtCause.JUMP


def test_a_speed_that_is_said_to_be_none_is_what_the_positions_show() -> None:
    """Of odometry what no margin explains; of transforms all of it."""
    fast, ms = settled()
    slow, _ = settled(speed=None)
    for number in range(60):
        x = 1.2 * number * STEP_MS / 1_000
        fast.take(at(ms + number * STEP_MS, x))
        slow.take(at(ms + number * STEP_MS, x, speed=None))
    assert fast.fix is not None
    assert slow.fix is not None
    assert 850 <= fast.fix.speed_mm_s <= 1_200
    assert slow.fix.speed_mm_s == pytest.approx(1_200, abs=2)


@given(
    st.lists(
        st.tuples(st.integers(5, 400), st.floats(-3, 3), st.floats(0, 1)), min_size=1, max_size=60
    )
)
def test_no_two_attested_positions_are_farther_apart_than_the_profile_explains(
    steps: list[tuple[int, float, float]],
) -> None:
    it, ms, x, found = track(), 0, 0.0, list[Fix | None]()
    for took_ms, speed, _ in steps:
        ms += took_ms
        x += speed * took_ms / 1_000
        it.take(at(ms, x, speed=abs(speed)))
        found.append(it.fix)
    for one, other in itertools.pairwise(found):
        if one is not None and other is not None:
            gone = abs(other.x_mm - one.x_mm) - 2 * MARGIN_MM - 2
            assert gone <= MAX_MM_S * (other.measured_ns - one.measured_ns) / 1e9


@given(st.lists(st.integers(1, 900), min_size=10, max_size=60), st.integers(0, 2**60))
def test_a_robot_within_its_profile_is_never_doubtful(gaps: list[int], clock: int) -> None:
    it, stamps, ms = track(), Stamps(), 1
    for gap in gaps:
        ms += gap
        measured = stamps.take(clock + ms * MS, ms * MS)
        assert not isinstance(measured, DoubtCause)
        # the clock of its own is allowed to be a thousandth slower
        assert 0 <= ms * MS - measured <= ms * MS // 1_000 + 1
        it.take(at(measured / MS, 1.49 * ms / 1_000, speed=1.49))
        assert it.why in {None, DoubtCause.START}


def test_stamps_that_go_back_stand_still_or_run_are_none() -> None:
    it = Stamps()
    assert it.take(5 * MS, 100 * MS) == 100 * MS
    assert it.take(5 * MS, 120 * MS) is DoubtCause.STILL
    assert it.take(4 * MS, 120 * MS) is DoubtCause.BACK
    assert it.take((25 + AHEAD_MS + 1) * MS, 120 * MS) is DoubtCause.AHEAD
    assert it.take(25 * MS, 120 * MS) == 120 * MS


def test_what_took_longer_than_the_fastest_is_older_by_that() -> None:
    it = Stamps()
    assert it.take(1, 1_000 * MS) == 1_000 * MS
    assert it.take(1 + 20 * MS, 1_090 * MS) == 1_020 * MS + 90_000
    assert it.take(1 + 40 * MS, 3_000 * MS) is DoubtCause.LATE


def test_stamps_that_run_little_by_little_run_too_and_a_slow_clock_does_not() -> None:
    fast, slow = Stamps(), Stamps()
    told = [fast.take(3 * ms * MS, ms * MS) for ms in range(0, 400, STEP_MS)]
    assert told[-1] is DoubtCause.AHEAD
    for ms in range(0, 600_000, 1_000):
        assert slow.take(ms * MS - ms * 900, ms * MS) == ms * MS


def test_a_covariance_has_to_bear_the_margin() -> None:
    def fault(a: float, b: float, other: float, c: float) -> DoubtCause | None:
        values = [0.0] * 36
        values[0], values[1], values[6], values[7] = a, b, other, c
        return covariance_fault(values, MARGIN_MM)

    assert fault(0.0, 0.0, 0.0, 0.0) is None  # it says nothing
    assert fault(0.0025, 0.0, 0.0, 0.0024) is None
    assert fault(0.0026, 0.0, 0.0, 0.0) is DoubtCause.COVARIANCE
    assert fault(0.0, 0.0, 0.0, 0.0026) is DoubtCause.COVARIANCE
    assert (
        fault(0.002, 0.001, 0.001, 0.002) is DoubtCause.COVARIANCE
    )  # its longer axis lies between
    assert fault(0.001, 0.0005, 0.0, 0.001) is DoubtCause.COVARIANCE
    assert fault(0.001, 0.002, 0.002, 0.001) is DoubtCause.COVARIANCE
    assert fault(-1.0, 0.0, 0.0, 0.0) is DoubtCause.COVARIANCE
    assert covariance_fault([0.0] * 35, MARGIN_MM) is DoubtCause.COVARIANCE
    assert covariance_fault([0.0] * 35 + [math.nan], MARGIN_MM) is DoubtCause.NOT_FINITE
