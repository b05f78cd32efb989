# SPDX-License-Identifier: Apache-2.0
"""How long a hostile input may take in a test: a bound against hanging, not a measurement.

Measurements are in `benchmarks/`, beside a yardstick. Here a loaded machine and a coverage tracer
must not fail a test, while minutes or gigabytes must.
"""

from __future__ import annotations

import sys


def patient(seconds: float) -> float:
    """Return the processor seconds allowed for what should take at most `seconds`."""
    return seconds * (10 if sys.gettrace() is not None else 3)
