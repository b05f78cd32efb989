# SPDX-License-Identifier: Apache-2.0
"""The stop lane as its gate starts it: one line that it serves, or one that says why not."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys

from coverage import Coverage

from authguard_r.estop.connection import _MAIN
from authguard_r.estop.files import ask
from fixtures import estop_fixtures, scenarios


def started(argument: str) -> subprocess.Popen[bytes]:
    env = dict(os.environ)
    if Coverage.current() is not None:  # what it runs through counts too
        env |= {"COVERAGE_PROCESS_START": str(scenarios.ROOT / "pyproject.toml")}
    words = [sys.executable, "-c", _MAIN, argument]
    return subprocess.Popen(words, stdout=subprocess.PIPE, env=env, cwd=scenarios.ROOT)


def test_a_lane_says_that_it_serves_and_ends_on_a_signal() -> None:
    with started(ask(estop_fixtures.files())) as process:
        assert process.stdout is not None
        said = json.loads(process.stdout.readline())
        assert (said["ready"], said["pid"]) == (True, process.pid)
        process.send_signal(signal.SIGTERM)
        assert process.wait(60) == 0


def test_a_lane_that_cannot_serve_says_why() -> None:
    files = estop_fixtures.files()
    files.config.unlink()
    process = started(ask(files))
    out, _ = process.communicate(timeout=60)
    assert json.loads(out)["error"]["code"] == "FILE_UNAVAILABLE"
    assert process.returncode == 5
