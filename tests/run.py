# SPDX-License-Identifier: Apache-2.0
"""Behind `python3 dev.py test`, `groups` and `mutants`: runs in the environment of the project."""

from __future__ import annotations

import sys

from runner import complete, listing, mutants

if __name__ == "__main__":
    task, *words = sys.argv[1:]
    tasks = {"test": complete.main, "groups": listing.main, "mutants": mutants.main}
    sys.exit(tasks[task](words))
