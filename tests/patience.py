# SPDX-License-Identifier: Apache-2.0
"""How long a hostile input may take: a bound against hanging, held to this process's own time.

Measurements are in `benchmarks/`, beside a yardstick. Here the tracer of the coverage run is left
out of what is timed, so that a bound is the same number in every run.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def at_most(seconds: float) -> Iterator[None]:
    """Fail when the block takes more processor seconds than that, tracing apart."""
    tracer = sys.gettrace()
    sys.settrace(None)
    begun = time.process_time()
    try:
        yield
    finally:  # a refusal has to be quick too
        took = time.process_time() - begun
        sys.settrace(tracer)
        assert took <= seconds
