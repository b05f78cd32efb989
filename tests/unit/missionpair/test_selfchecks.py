# SPDX-License-Identifier: Apache-2.0
"""The sixteen self-checks hold: no number is printed without them."""

from __future__ import annotations

from pathlib import Path

from missionpair.bench import make_bench
from missionpair.selfchecks import SELF_CHECKS


def test_every_self_check_holds(tmp_path: Path) -> None:
    bench = make_bench(tmp_path / "trust")
    assert [check.name for check in SELF_CHECKS if not check.holds(bench)] == []
