# SPDX-License-Identifier: Apache-2.0
"""A program of ours, measured from when everything that it needs is imported.

    python run_measured.py CONFIGURATION [MODULE] WORDS...

MODULE is one of ours that has a `main`; without it, WORDS are a command of `authguard`. Tracing
makes an import twice as long, and shows what the tests' own process shows by importing the same.
CONFIGURATION is coverage's; processes that the program starts are measured by it too.
"""

from __future__ import annotations

import os
import sys
from importlib import import_module

import coverage

if __name__ == "__main__":
    os.environ["COVERAGE_PROCESS_START"] = sys.argv.pop(1)
    if sys.argv[1].startswith("authguard_r."):
        main = import_module(sys.argv.pop(1)).main
    else:
        main = import_module("authguard_r.cli").main
        command = import_module("authguard_r.cli.app").program(sys.argv[1])
        for word in sys.argv[1:]:
            command = getattr(command, "commands", {}).get(word)
    coverage.process_startup()
    sys.exit(main())
