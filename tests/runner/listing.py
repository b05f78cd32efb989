# SPDX-License-Identifier: Apache-2.0
"""`python3 dev.py groups`: which groups there are, or which of them CI has to run, and why."""

from __future__ import annotations

import shutil
import sys
from argparse import ArgumentParser

from runner import records
from runner.groups import GroupError, read_groups


def main(words: list[str]) -> int:
    """Print one line for each group; return the exit code."""
    parser = ArgumentParser(prog="dev.py groups", description="List the groups of tests.")
    add = parser.add_argument
    add("--changed", action="store_true", help="only those that changed since their complete run")
    add("--packages", action="store_true", help="print the Debian packages that they still need")
    asked = parser.parse_args(words)
    try:
        groups = read_groups()
    except GroupError as error:
        print(error, file=sys.stderr)
        return 2
    reasons = records.changed_groups(groups)
    chosen = [group for group in groups.every if not asked.changed or group.name in reasons]
    if asked.packages:
        needed = {
            package
            for group in chosen
            for program, package in group.programs.items()
            if shutil.which(program) is None
        }
        print(*sorted(needed))
        return 0
    for group in chosen:
        print(f"{group.name:12} {reasons[group.name] if asked.changed else group.about}")
    return 0
