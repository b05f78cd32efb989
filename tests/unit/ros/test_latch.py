# SPDX-License-Identifier: Apache-2.0
"""Closed at any doubt, and open again only to one publisher that asked for standing all the while.

Source: docs/spec/ros-stopping.md#the-latch
"""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from authguard_r.integrations.ros.latch import MS, Latch, LatchCause
from fixtures.cases import case

SILENCE, SETTLE, PERIOD = 120, 200, 20
GATE, OTHER = b"gate", b"other"


def latch() -> Latch:
    return Latch(silence_ms=SILENCE, settle_ms=SETTLE)


def opened(who: bytes = GATE) -> tuple[Latch, int]:
    """Return a latch that just opened, and when."""
    made = latch()
    for at in range(0, SETTLE + 1, PERIOD):
        made.hear(who, at * MS, is_neutral=True)
    assert made.is_open
    return made, at


def test_it_begins_closed_and_hears_nothing_for_ever() -> None:
    made = latch()
    assert made.why is LatchCause.START
    assert not made.look(10**15)
    assert made.why is LatchCause.START


def test_a_sample_that_moves_never_opens_it() -> None:
    made = latch()
    for at in range(0, 10_000, PERIOD):
        assert made.hear(GATE, at * MS, is_neutral=False) is LatchCause.START


def test_it_opens_after_standing_was_heard_for_long_enough_and_not_before() -> None:
    made = latch()
    for at in range(0, SETTLE, PERIOD):
        assert made.hear(GATE, at * MS, is_neutral=True) is LatchCause.START
    assert made.hear(GATE, SETTLE * MS, is_neutral=True) is None


def test_open_it_lets_samples_that_move_go_on() -> None:
    made, at = opened()
    assert made.hear(GATE, (at + PERIOD) * MS, is_neutral=False) is None
    assert not made.look((at + PERIOD + SILENCE - 1) * MS)
    assert made.is_open


def test_silence_closes_it_at_a_look_or_at_the_late_sample_itself() -> None:
    made, at = opened()
    assert made.look((at + SILENCE) * MS)
    assert not made.look((at + SILENCE) * MS)  # once
    assert made.why is LatchCause.SILENCE
    made, at = opened()
    assert made.hear(GATE, (at + SILENCE) * MS, is_neutral=False) is LatchCause.SILENCE


def test_a_sample_of_another_publisher_closes_it_and_does_not_go_on() -> None:
    made, at = opened()
    assert made.hear(OTHER, (at + 1) * MS, is_neutral=True) is LatchCause.ANOTHER


def test_two_publishers_that_both_stand_never_open_it() -> None:
    made = latch()
    for at in range(0, 5_000, PERIOD):
        made.hear(GATE, at * MS, is_neutral=True)
        made.hear(OTHER, (at + 1) * MS, is_neutral=True)
    assert not made.is_open


def test_whatever_closes_it_the_first_cause_is_kept_and_the_wait_begins_anew() -> None:
    for why in list(LatchCause):
        with case(why):
            made, at = opened()
            assert made.stop(why)
            assert not made.stop(LatchCause.CLOSED)
            assert made.why is why
            for after in range(PERIOD, SETTLE, PERIOD):
                assert made.hear(GATE, (at + after) * MS, is_neutral=True) is why
            made.stop(LatchCause.DEADLINE)  # again, half way to open
            for after in range(SETTLE, 2 * SETTLE, PERIOD):
                assert made.hear(GATE, (at + after) * MS, is_neutral=True) is why
            assert made.hear(GATE, (at + 2 * SETTLE) * MS, is_neutral=True) is None


@given(
    st.lists(
        st.tuples(st.sampled_from([GATE, OTHER]), st.integers(0, 2 * SILENCE), st.booleans()),
        max_size=60,
    )
)
def test_a_sample_that_moves_goes_on_only_after_an_unbroken_lease(
    samples: list[tuple[bytes, int, bool]],
) -> None:
    """Whatever comes when: behind what went on there is standing of one, then no gap, no other."""
    made, at = latch(), 0
    heard: list[tuple[bytes, int, bool]] = []
    for who, pause, is_neutral in samples:
        at += pause
        heard.append((who, at, is_neutral))
        if made.hear(who, at * MS, is_neutral=is_neutral) is None:
            lease = unbroken(heard)
            assert {name for name, _, _ in lease} == {who}
            assert has_stood(lease)


def unbroken(heard: list[tuple[bytes, int, bool]]) -> list[tuple[bytes, int, bool]]:
    """Return the last samples of one publisher without a gap between them."""
    begin = 0
    for number, (before, after) in enumerate(pairwise(heard), 1):
        if before[0] != after[0] or after[1] - before[1] >= SILENCE:
            begin = number
    return heard[begin:]


def has_stood(lease: list[tuple[bytes, int, bool]]) -> bool:
    """True when only standing was asked for in some stretch that is long enough."""
    since: int | None = None
    for _, at, is_neutral in lease:
        if not is_neutral:
            since = None
        elif since is None:
            since = at
        elif at - since >= SETTLE:
            return True
    return False
