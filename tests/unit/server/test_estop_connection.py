# SPDX-License-Identifier: Apache-2.0
"""Why a lane that was started does not serve is told in its own words, or not at all."""

from __future__ import annotations

import subprocess
import sys

import pytest
from msgspec.structs import replace

from authguard_r.core.errors import EnvironmentFault
from authguard_r.estop.connection import _ready, start_stop_process
from authguard_r.estop.files import EStopFiles
from fixtures import estop_fixtures


@pytest.fixture
def files() -> EStopFiles:
    return estop_fixtures.files()


def test_a_run_folder_whose_path_is_too_long_is_said_as_the_lane_says_it(files: EStopFiles) -> None:
    long = files.run / ("x" * 100)
    long.mkdir()
    with pytest.raises(EnvironmentFault, match="the stop process does not serve: ") as fault:
        start_stop_process(replace(files, run=long))
    assert "{'" not in fault.value.message
    assert str(long) in fault.value.message


@pytest.mark.parametrize(
    ("program", "told"),
    [
        ("", "it does not say that it serves"),
        ("print('[1]')", "it does not say that it serves"),
        ('print(\'{"error": "no"}\')', "it does not say that it serves"),
        ('print(\'{"error": {"message": "no room"}}\')', "no room"),
        ('print(\'{"error": {"message": "no", "where": "there"}}\')', r"no \(at there\)"),
    ],
)
def test_a_lane_that_ends_at_once_is_a_fault_in_words(program: str, told: str) -> None:
    words = [sys.executable, "-c", program]
    process = subprocess.Popen(words, stdout=subprocess.PIPE)
    with pytest.raises(EnvironmentFault, match=f"does not serve: {told} at `stop`$"):
        _ready(process)
    assert process.poll() is not None
