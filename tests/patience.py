# SPDX-License-Identifier: Apache-2.0
"""How long a hostile input may take: a bound against hanging, held to this thread's own time.

Measurements are in `benchmarks/`, beside a yardstick. Here what belongs to the run of the tests is
left out of what is timed, so that a bound is the same number in every run: the tracer of coverage,
threads that another test began, and the collector's way through what thousands of tests before
left in memory.
"""

from __future__ import annotations

import gc
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Fail when the block takes more processor seconds than that, the run's own work apart.

    The block has to do its work in the thread that it is called in.
    """
    tracer = sys.gettrace()
    sys.settrace(None)
    gc.freeze()
    begun = time.thread_time()
    try:
        yield
    finally:  # a refusal has to be quick too
        took = time.thread_time() - begun
        gc.unfreeze()
        sys.settrace(tracer)
        assert took <= seconds, f"{took:.3f} s of the processor, {seconds} at most"
