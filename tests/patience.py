# SPDX-License-Identifier: Apache-2.0
"""How long a hostile input may take: a bound against hanging, held to this thread's own time.

Measurements are in `benchmarks/`. Here what belongs to the run of the tests is left out of what is
timed, so that a bound is the same number in every run: the tracer of coverage, threads that another
test began, and the collector's way through what thousands of tests before left in memory. A machine
that is slower than the one that the bounds were set on, or busy, gets as much more time as plain
work takes there at that moment.
"""

from __future__ import annotations

import gc
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

#: What the yardstick took where the bounds were set, in processor seconds.
_YARD_S = 0.012


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Fail when the block takes more processor seconds than that, as plain work goes here and now.

    The block has to do its work in the thread that it is called in.
    """
    tracer = sys.gettrace()
    sys.settrace(None)
    gc.freeze()
    before_s = _yard_s()
    begun = time.thread_time()
    try:
        yield
    finally:  # a refusal has to be quick too
        took = time.thread_time() - begun
        most = seconds * max(1.0, before_s / _YARD_S, _yard_s() / _YARD_S)
        gc.unfreeze()
        sys.settrace(tracer)
        assert took <= most, f"{took:.3f} s of the processor, {most:.3f} at most"


def _yard_s() -> float:
    """Return how long plain work takes, in processor seconds."""
    begun, number = time.thread_time(), 0
    for step in range(200_000):
        number = (number * 31 + step) & 0xFFFF
    return time.thread_time() - begun
