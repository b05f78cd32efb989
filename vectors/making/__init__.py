# SPDX-License-Identifier: Apache-2.0
"""What writes each file of vectors, under one instant for all of them.

Importing the package fixes the instant of `scenarios`; whoever needs `cases` imports it after that.
"""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
sys.path[:0] = [str(ROOT / "tests")]

from fixtures import scenarios  # noqa: E402

#: 2026-01-15T14:05:00Z, whatever day it is.
scenarios.START_MS = 1_768_485_900_000
scenarios.NOW = type(scenarios.NOW)(scenarios.START_MS, 10_000)
