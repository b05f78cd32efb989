# SPDX-License-Identifier: Apache-2.0
"""What strangers cause is counted, and hides nothing else.

Source: docs/spec/listeners.md#log
"""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from typing import Any

import pytest

from authguard_r.wire.json_log import MOST_LINES, Lines


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The time of the test's own, in milliseconds."""
    now = [1_000]
    monkeypatch.setattr(time, "time_ns", lambda: now[0] * 1_000_000)
    return now


def told(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_bytes().splitlines()]


def test_a_flood_is_counted_and_not_written(tmp_path: Path, clock: list[int]) -> None:
    with (tmp_path / "log").open("wb") as file:
        written = Lines(file.fileno())
        for number in range(MOST_LINES + 5):
            written.write({"number": number})
        clock[0] = 2_000
        written.write({"number": -1})
    lines = told(tmp_path / "log")
    assert [line["number"] for line in lines] == [*range(MOST_LINES), -1]
    assert lines[-1] == {"time_ms": 2_000, "number": -1, "dropped": 5}
    assert all("dropped" not in line for line in lines[:-1])


@pytest.mark.usefixtures("clock")
def test_a_flood_of_one_kind_hides_no_other(tmp_path: Path) -> None:
    with (tmp_path / "log").open("wb") as file:
        written = Lines(file.fileno(), 2)
        for _ in range(9):
            written.write({"event": "refused"}, kind="refused")
        written.write({"event": "alert"})
        for _ in range(9):
            written.write({"event": "request"}, kind=None)
    lines = told(tmp_path / "log")
    assert [line["event"] for line in lines] == ["refused"] * 2 + ["alert"] + ["request"] * 9
    assert lines[2]["dropped"] == 7


@pytest.mark.usefixtures("clock")
def test_what_says_nothing_by_itself_is_a_count(tmp_path: Path) -> None:
    with (tmp_path / "log").open("wb") as file:
        written = Lines(file.fileno())
        for _ in range(9):
            written.write({"event": "crowded"}, kind="crowded", most=1)
        written.write({"event": "long", "why": "x" * 4_096})
        written.write({"event": "end"})
    first, end = told(tmp_path / "log")
    assert (first["event"], end["event"], end["dropped"]) == ("crowded", "end", 9)


@pytest.mark.usefixtures("clock")
def test_a_journal_that_nobody_reads_is_not_waited_for() -> None:
    reading, writing = os.pipe()
    written = Lines(writing)
    os.set_blocking(writing, False)
    try:
        while True:
            os.write(writing, b"x" * 4_096)
    except BlockingIOError:
        os.set_blocking(writing, True)
    written.write({"event": "lost"})
    assert set(os.read(reading, 1 << 20)) == set(b"x")
    written.write({"event": "kept"})
    line = json.loads(os.read(reading, 1 << 16))
    assert line == {"time_ms": 1_000, "event": "kept", "dropped": 1}
    os.close(reading)
    os.close(writing)
    written.write({"event": "nowhere"})
