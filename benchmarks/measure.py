# SPDX-License-Identifier: Apache-2.0
"""Timing that a noisy machine hits evenly: subjects take turns, call by call or slice by slice.

What is compared runs in the same process, in the same minutes, A B A B. A subject measures
itself, so that what it prepares before each call is not counted.
"""

from __future__ import annotations

import gc
import math
import statistics
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter_ns
from typing import Any, NamedTuple

#: A timing is worth quoting from this many blocks on.
LEAST_BLOCKS = 5
#: A block whose median is so many times another's was measured on another machine, so to speak.
MOST_SPREAD = 2.0


class Subject(NamedTuple):
    """One thing that is timed.

    Args:
        name: its key in the results.
        once: does it once and returns how many nanoseconds it took.
    """

    name: str
    once: Callable[[], int]


class Timing(NamedTuple):
    """How long one subject took, in nanoseconds.

    Args:
        p50: the median of the blocks' medians.
        p95: of all samples together.
        p99: of all samples together.
        samples: how many there were.
        medians: the median of each block, in order.
    """

    p50: float
    p95: float
    p99: float
    samples: int
    medians: tuple[float, ...]

    def plain(self) -> dict[str, Any]:
        """Return it for JSON, in microseconds."""
        return {
            "p50_us": round(self.p50 / 1e3, 3),
            "p95_us": round(self.p95 / 1e3, 3),
            "p99_us": round(self.p99 / 1e3, 3),
            "samples": self.samples,
            "block_medians_us": [round(median / 1e3, 3) for median in self.medians],
        }


class Effort(NamedTuple):
    """How often.

    Args:
        blocks: rounds; each is a sample of the machine's mood.
        calls: timed calls of each subject in a block.
        stretch: calls of one subject before the next has its turn.
        warm_up: calls of each subject that are not counted.
    """

    blocks: int
    calls: int
    stretch: int = 1
    warm_up: int = 20


def timed(
    act: Callable[[], object], before: Callable[[], object] | None = None
) -> Callable[[], int]:
    """Return what does `before` uncounted, then `act` counted."""

    def once() -> int:
        if before is not None:
            before()
        start = perf_counter_ns()
        act()
        return perf_counter_ns() - start

    return once


def interleave(subjects: list[Subject], effort: Effort) -> dict[str, Timing]:
    """Return the timing of each subject, measured in turns.

    Raises:
        ValueError: fewer blocks than a median of medians needs.
    """
    if effort.blocks < LEAST_BLOCKS:
        raise ValueError(f"expected at least {LEAST_BLOCKS} blocks, got {effort.blocks}")
    for subject in subjects:
        for _ in range(effort.warm_up):
            subject.once()
    blocks: dict[str, list[list[int]]] = {subject.name: [] for subject in subjects}
    for number in range(effort.blocks):
        turn = number % len(subjects)
        order = subjects[turn:] + subjects[:turn]
        with _quiet():
            for name, samples in _block(order, effort).items():
                blocks[name].append(samples)
    return {name: timing_of(samples) for name, samples in blocks.items()}


def steady(*timings: Timing) -> bool:
    """True when no block's median is far from the others: else somebody else used the machine."""
    return all(max(t.medians) <= MOST_SPREAD * min(t.medians) for t in timings)


def ratio(one: Timing, other: Timing) -> float:
    """Return how many times as long one took.

    The median over blocks where both ran in the same ones: what slowed a block slowed both.
    """
    if len(one.medians) != len(other.medians):
        return one.p50 / other.p50
    return statistics.median(a / b for a, b in zip(one.medians, other.medians, strict=True))


def difference(one: Timing, other: Timing) -> float:
    """Return how much longer one took, in nanoseconds; paired as in `ratio`."""
    if len(one.medians) != len(other.medians):
        return one.p50 - other.p50
    return statistics.median(a - b for a, b in zip(one.medians, other.medians, strict=True))


def percentile(samples: list[int], share: int) -> float:
    """Return the nearest-rank percentile."""
    ranked = sorted(samples)
    return float(ranked[max(0, math.ceil(len(ranked) * share / 100) - 1)])


def timing_of(blocks: list[list[int]]) -> Timing:
    """Return the timing of samples in nanoseconds, block by block."""
    medians = [statistics.median(block) for block in blocks]
    every = [sample for block in blocks for sample in block]
    return Timing(
        p50=float(statistics.median(medians)),
        p95=percentile(every, 95),
        p99=percentile(every, 99),
        samples=len(every),
        medians=tuple(float(median) for median in medians),
    )


def _block(order: list[Subject], effort: Effort) -> dict[str, list[int]]:
    samples: dict[str, list[int]] = {subject.name: [] for subject in order}
    left = effort.calls
    while left > 0:
        stretch = min(left, effort.stretch)
        left -= stretch
        for name, once in order:
            samples[name] += [once() for _ in range(stretch)]
    return samples


@contextmanager
def _quiet() -> Iterator[None]:
    """Collect garbage between blocks, never inside one."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()
