# SPDX-License-Identifier: Apache-2.0
"""The tests that need ROS 2, each file in a network of its own: real nodes, and nobody else.

The wheels of ROS start every Python of their environment anew, so they have one of their own
(tests/ros/make.sh); `AUTHGUARD_ROS` names its folder. Their deadlines are real: nothing else runs
beside them. Source: docs/spec/ros.md
"""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import pytest

from fixtures.gate_process import environment
from fixtures.scenarios import ROOT

ENVIRONMENT = os.environ.get("AUTHGUARD_ROS", "")
pytestmark = pytest.mark.skipif(
    not ENVIRONMENT, reason="AUTHGUARD_ROS names no environment (tests/ros/make.sh)"
)
PYTHON = Path(ENVIRONMENT) / "bin" / "python"
FILES = sorted((ROOT / "tests" / "ros").glob("test_*.py"))
#: Tests of one file that may be asked again, once.
MOST_AGAIN = 2
ALONE = ("sh", str(ROOT / "tests" / "ros" / "alone.sh"))


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem.removeprefix("test_"))
def test_on_real_nodes(file: Path, tmp_path: Path) -> None:
    done = run([str(file)], tmp_path)
    # a busy machine misses a tenth of a second, and discovery loses a first message now and then:
    # what failed has to hold when it is asked once more, alone
    failed = failures(tmp_path)
    if done.returncode == 1 and 0 < len(failed) <= MOST_AGAIN:
        print(f"once more: {failed}")
        done = run(["--last-failed", str(file)], tmp_path)
    assert done.returncode == 0, done.stdout[-8_000:] + done.stderr[-2_000:]
    # what was skipped has not been shown
    assert "skipped" not in done.stdout.splitlines()[-1], done.stdout[-2_000:]


def failures(folder: Path) -> list[str]:
    """Return what failed, or could not be set up, in the run before."""
    found = folder / "cache" / "v" / "cache" / "lastfailed"
    return list(json.loads(found.read_text())) if found.is_file() else []


def run(what: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run tests in a network and with shared memory of their own."""
    words = [str(PYTHON), "-m", "pytest", "-q", "-p", "no:xdist", "-o", f"cache_dir={folder}/cache"]
    return subprocess.run(
        [*ALONE, *words, f"--basetemp={folder}/base", *what],
        cwd=ROOT,
        env=environment(measured=True),
        capture_output=True,
        text=True,
        check=False,
        timeout=900,
    )
