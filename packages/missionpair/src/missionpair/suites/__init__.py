# SPDX-License-Identifier: Apache-2.0
"""Suites by name or by file: `make()` of a module returns its suite, the same bytes every time.

A module may say what is usual for its suite: `ROUNDS`, an attacker's tries, and `TURNS`, a
planner's answers in one round; each is 1 where it says nothing.
How to add one: docs/howto/missionpair-extend.md. Spec page: docs/spec/missionpair.md#suites
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import NamedTuple

from missionpair import registry
from missionpair.pair import Suite
from missionpair.suites._canonical import canonical, skeleton
from missionpair.suites._form import (
    SuiteError,
    counts_of,
    digest_of,
    frozen,
    read_suite,
    require_suite,
    write_suite,
)

__all__ = [
    "SuiteError",
    "Usual",
    "canonical",
    "counts_of",
    "digest_of",
    "frozen",
    "load",
    "read_suite",
    "require_suite",
    "skeleton",
    "usual",
    "write_suite",
]


class Usual(NamedTuple):
    """The defaults of a suite's campaign.

    Args:
        rounds: tries that an attacker has.
        turns: answers that a planner has in one round.
    """

    rounds: int = 1
    turns: int = 1


def usual(spec: str) -> Usual:
    """Return what is usual for a suite; it is not made for that.

    Args:
        spec: as `load` takes it; a file says nothing of it.

    Raises:
        UnknownNameError: no such suite, and no such file.
    """
    if _is_file(spec):
        return Usual()
    room, plain = sys.modules[__name__], Usual()
    return Usual(
        rounds=registry.said_by(room, spec, "ROUNDS", plain.rounds),
        turns=registry.said_by(room, spec, "TURNS", plain.turns),
    )


def load(spec: str) -> tuple[Suite, str]:
    """Return a suite with its digest.

    Args:
        spec: a name with options (`full:each=1`), or the path of a suite's file.

    Raises:
        UnknownNameError: no such suite, and no such file; or no such option, or value of it.
        SuiteError: the file is no suite.
    """
    if _is_file(spec):
        suite = read_suite(Path(spec))
    else:
        try:
            suite = registry.make(sys.modules[__name__], spec)
        except (OSError, registry.OptionError) as error:
            raise SuiteError(str(error), where=spec) from error
    return suite, digest_of(suite)


def _is_file(spec: str) -> bool:
    path = Path(spec)
    return path.suffix == ".jsonl" or path.is_file()
