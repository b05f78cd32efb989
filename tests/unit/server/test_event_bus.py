# SPDX-License-Identifier: Apache-2.0
"""An alert is recorded first; who watches is told; a journal unread holds nobody up."""

from __future__ import annotations

import fcntl
import os
from collections import Counter
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest

from authguard_r.server.event_log import EventLog
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.json_log import MOST_LINES
from authguard_r.wire.messages import ClientRole, Kind
from fixtures.estop_fixtures import until
from unit.server.demo_site import FORBIDDEN, SCAN, DemoGate


def test_an_alert_is_a_record_an_event_and_a_line() -> None:
    with DemoGate(robot=False) as house:
        watcher = house.enter(ClientRole.AUDITOR)
        other = house.enter(ClientRole.AUDITOR, "other")
        number = watcher.say(Kind.WATCH, {})
        house.do(lambda: house.service.events.alert("smoke", {"silent_ms": 5}))
        (record,) = house.log("alert")
        assert record.open == {"what": "smoke", "silent_ms": 5}
        (event,) = watcher.bodies(Kind.EVENT, number)
        assert event["what"] == "smoke"
        assert event["time_ms"] >= 0
        assert other.bodies(Kind.EVENT) == []
        assert house.journal[-1]["what"] == "smoke"


def test_an_alert_that_cannot_be_recorded_is_told_all_the_same() -> None:
    with DemoGate(robot=False, estimator=False) as house:
        watcher = house.enter(ClientRole.AUDITOR)
        number = watcher.say(Kind.WATCH, {})
        house.do(house.gate.ledger.store.close)
        house.do(lambda: house.service.events.alert("smoke", {}))
        assert [event["what"] for event in watcher.bodies(Kind.EVENT, number)] == ["smoke"]
        house.crashes = True


def test_a_clock_behind_leaves_events_without_a_time() -> None:
    with DemoGate(robot=False, estimator=False) as house:
        watcher = house.enter(ClientRole.AUDITOR)
        number = watcher.say(Kind.WATCH, {})
        house.clock.ms -= 3_600_000
        house.do(lambda: house.service.events.publish({"event": "x"}))
        assert watcher.bodies(Kind.EVENT, number) == [{"time_ms": None, "event": "x"}]
        house.crashes = True


def test_the_journal_holds_no_content_of_a_mission() -> None:
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.enter(ClientRole.AUDITOR).say(Kind.WATCH, {})
        house.activate()
        house.propose(planner, SCAN)
        house.propose(planner, FORBIDDEN)
        house.stop(ClientRole.OPERATOR, 1, why="the pharmacy burns")
        house.do(house.service._listen)
        text = msgspec.json.encode(house.journal).decode()
        for word in ("office", "pharmacy", "package", "look-out", "deliver", "scan", "burns"):
            assert word not in text
        assert {"management", "stop", "client", "counts"} <= {
            line["event"] for line in house.journal
        }


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    read, write = os.pipe()
    yield read, write
    os.close(read)
    os.close(write)


def test_a_journal_that_nobody_reads_drops_lines_and_says_how_many(pipe: tuple[int, int]) -> None:
    read, write = pipe
    fcntl.fcntl(write, fcntl.F_SETPIPE_SZ, 4_096)
    os.set_blocking(read, False)
    journal = EventLog(write)

    def told() -> dict[str, Any] | None:
        """Say something until it is written: only so many lines a second are."""
        journal.event({"event": "client"})
        try:
            line: dict[str, Any] = msgspec.json.decode(os.read(read, 1 << 20).splitlines()[-1])
        except BlockingIOError:
            return None
        return line

    for _ in range(2_000):
        journal.event({"event": "alert", "what": "x" * 200, "destination": "office-1"})
    os.read(read, 1 << 20)
    assert until(told, "a line")["dropped"] > 1_900
    assert until(told, "a line").get("dropped", 0) < 100


def test_who_connects_over_and_over_hides_no_alert(pipe: tuple[int, int]) -> None:
    read, write = pipe
    journal = EventLog(write)
    for _ in range(4 * MOST_LINES):
        journal.event({"event": "client", "here": True})
    journal.event({"event": "recovery", "unclean": True})
    lines = [msgspec.json.decode(line) for line in os.read(read, 1 << 20).splitlines()]
    assert len(lines) < 4 * MOST_LINES  # there is a bound
    assert lines[-1]["event"] == "recovery"
    assert lines[-1]["dropped"] > 0


def test_counts_are_told_when_they_changed_and_not_too_often(pipe: tuple[int, int]) -> None:
    read, write = pipe
    os.set_blocking(read, False)
    journal, counted = EventLog(write), Counter({"shed": 1})

    def told(now_ms: int) -> bytes:
        journal.counts(counted, now_ms)
        journal.event({"event": "outcome"})  # only counted
        try:
            return os.read(read, 1 << 16)
        except BlockingIOError:
            return b""

    assert msgspec.json.decode(told(0))["shed"] == 1
    counted["shed"] += 1
    assert told(LIMITS.counts_ms - 1) == b""
    assert msgspec.json.decode(told(LIMITS.counts_ms))["shed"] == 2
    assert told(5 * LIMITS.counts_ms) == b""
