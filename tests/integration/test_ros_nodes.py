# SPDX-License-Identifier: Apache-2.0
"""The tests that need ROS 2, each file in a network of its own: real nodes, and nobody else.

The wheels of ROS start every Python of their environment anew, so they have one of their own, which
`.ci/run` makes; `AUTHGUARD_ROS` names its folder. Source: docs/spec/ros.md
"""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from gates import environment
from worlds import ROOT

ENVIRONMENT = os.environ.get("AUTHGUARD_ROS", "")
pytestmark = pytest.mark.skipif(
    not ENVIRONMENT, reason="AUTHGUARD_ROS names no environment (.ci/run makes one)"
)
PYTHON = Path(ENVIRONMENT) / "bin" / "python"
FILES = sorted((ROOT / "tests" / "ros").glob("test_*.py"))
ALONE = 'ip link set lo up && exec "$@"'


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem.removeprefix("test_"))
def test_on_real_nodes(file: Path) -> None:
    variables = {k: v for k, v in environment(measured=True).items() if "ROS_WHEELS" not in k}
    # what was skipped has not been shown
    words = [PYTHON, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", file]
    done = subprocess.run(
        ["unshare", "--user", "--map-root-user", "--net", "sh", "-c", ALONE, "sh", *words],
        cwd=ROOT,
        env={**variables, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"},
        capture_output=True,
        text=True,
        check=False,
        timeout=900,
    )
    assert done.returncode == 0, done.stdout[-8_000:] + done.stderr[-2_000:]
    assert "skipped" not in done.stdout.splitlines()[-1], done.stdout[-2_000:]
