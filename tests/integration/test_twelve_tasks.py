# SPDX-License-Identifier: Apache-2.0
"""A person who knows only `--help` and the program's messages does twelve tasks."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = Path(__file__).resolve().parents[1] / "programs" / "twelve_tasks.py"


@pytest.mark.complete
def test_twelve_tasks_need_no_more_than_help_and_messages(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(PROGRAM), str(tmp_path / "person")],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1].startswith("12 tasks done")
