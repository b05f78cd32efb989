# SPDX-License-Identifier: Apache-2.0
"""Suites by name or by file: `make()` of a module returns its suite, the same bytes every time.

How to add one: docs/howto/missionpair-extend.md. Spec page: docs/spec/missionpair.md#suites
"""

from __future__ import annotations

import sys
from pathlib import Path

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
    "canonical",
    "counts_of",
    "digest_of",
    "frozen",
    "load",
    "read_suite",
    "require_suite",
    "skeleton",
    "write_suite",
]


def load(spec: str) -> tuple[Suite, str]:
    """Return a suite with its digest.

    Args:
        spec: a name with options (`full:each=1`), or the path of a suite's file.

    Raises:
        UnknownNameError: no such suite, and no such file.
        SuiteError: the file is no suite.
    """
    path = Path(spec)
    if path.suffix == ".jsonl" or path.is_file():
        suite = read_suite(path)
    else:
        try:
            suite = registry.make(sys.modules[__name__], spec)
        except (OSError, registry.OptionError) as error:
            raise SuiteError(str(error), where=spec) from error
    return suite, digest_of(suite)
