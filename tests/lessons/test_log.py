# SPDX-License-Identifier: Apache-2.0
"""Faults seen in the logs of other projects that guard robots and agents; each is refused here.

One test for one lesson, named after it; the numbers are those of the project's list of lessons.
"""

from __future__ import annotations

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from authguard_r.audit.record import LogRow, Record, read_record
from authguard_r.audit.verify import verify_rows
from authguard_r.auditor.export_format import note_line, row_line
from authguard_r.cli import call
from authguard_r.core.errors import AuthGuardError, MalformedError, StoreError
from authguard_r.normalize import read_plan
from authguard_r.operations.simulation import Simulation
from authguard_r.safety.envelope import EnvelopeGate
from authguard_r.sim.robot import Faults
from authguard_r.store.sqlite import open_store, read_rows
from fixtures import scenarios
from fixtures.audit_game import QUORUM, Genuine, genuine
from fixtures.small_logs import edited, rechained

#: Threads that stop the robot at once, and how often each.
THREADS, STOPS = 8, 25


class Desk:
    """Verifies files as a user does."""

    def __init__(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self._folder, self._capsys = folder, capsys
        self.log: Genuine = genuine(24, 5)

    def verify(
        self, rows: tuple[LogRow, ...], *options: str, noted: bool = True
    ) -> tuple[int, dict[str, Any], str]:
        """Return the exit code, and what is told of an export of these rows, in both ways."""
        path = self._folder / "log.jsonl"
        note = self.log.notes[self.log.size].encode()
        path.write_bytes(b"".join([*map(row_line, rows), note_line(note) * noted]))
        code = call(["audit", "verify", str(path), *options])
        text = self._capsys.readouterr().out
        assert call(["audit", "verify", str(path), *options, "--json"]) == code
        return code, json.loads(self._capsys.readouterr().out), text

    def anchored(self) -> tuple[str, ...]:
        """Return the options that name keys, witnesses and the checkpoint that was kept."""
        given = ["--key", self.log.keys[0].text(), "--quorum", str(QUORUM)]
        for one in self.log.witnesses:
            given += ["--witness", one.named.text()]
        return (*given, "--checkpoint", str(self.log.kept()))


@pytest.fixture
def session(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Desk:
    return Desk(tmp_path, capsys)


def test_l8_a_log_that_was_cut_chained_anew_or_deleted_does_not_verify(session: Desk) -> None:
    log, given = session.log, session.anchored()
    code, told, _ = session.verify(log.rows, *given)
    assert (code, told["anchored"], told["anchored_size"]) == (0, "witnessed", log.size)
    for size in (0, 1, 11, log.size - 1):  # at 0 everything is gone
        code, told, text = session.verify(log.rows[:size], *given)
        assert (code, told["where"]) == (1, f"record {size}")
        assert "NOT WHOLE" in text
        turned = edited(log.rows[size], mid="m-other")
        changed = rechained([*log.rows[:size], turned, *log.rows[size + 1 :]], size)
        assert verify_rows(changed).whole
        assert session.verify(tuple(changed), *given)[0] == 1


def test_l8_verify_never_says_of_a_shortened_log_that_nothing_is_missing(session: Desk) -> None:
    """Where nobody from outside vouches for the end, that is what is said."""
    for size in (0, 1, 11, session.log.size):
        if size:  # an empty file is no log
            code, told, text = session.verify(session.log.rows[:size], noted=False)
            assert (code, told["anchored"], told["anchored_size"]) == (0, "unanchored", 0)
            assert "no outside checkpoint shows that no record is missing at the end" in text
        # a checkpoint that lies beside it is held against it, whoever signed that
        code, told, text = session.verify(session.log.rows[:size])
        assert (code, told["anchored"]) == (int(size < session.log.size), "unanchored")
        assert ("the log is cut off" in text) is (size < session.log.size)
    # with the key of the log alone the file's own checkpoint shows it
    key = ("--key", session.log.keys[0].text())
    assert session.verify(session.log.rows[:-1], *key)[0] == 1
    code, _, text = session.verify(session.log.rows, *key)
    assert (code, "records after it may be missing" in text) == (0, True)


#: What goes wrong on the way to the controller, what is recorded of it, and with which reason.
PATHS: dict[str, tuple[str, str]] = {
    "a plan that cannot be read": ("refusal", "TOOL_UNKNOWN"),
    "a mission that is no token": ("refusal", "MALFORMED"),
    "a mission that is here already": ("refusal", "TRANSITION_REFUSED"),
    "an action outside of it": ("decision", "DESTINATION_OUT_OF_SCOPE"),
    "a fault of the gate's own": ("refusal", "INTERNAL_FAULT"),
    "a robot that does not begin": ("outcome", "CONTROLLER_FAILED"),
    "an action of no mission": ("refusal", "NO_ACTIVE_MISSION"),
}


def take(path: str, monkeypatch: pytest.MonkeyPatch) -> Simulation:
    """Return a gate on which this has just gone wrong."""
    fails = Faults(controller_refuses=path == "a robot that does not begin")
    sim = scenarios.simulation(faults=fails)
    if path != "an action of no mission":
        sim.gate.management.activate(scenarios.token())
    if path == "a fault of the gate's own":
        monkeypatch.delattr(EnvelopeGate, "assess")
    if path == "a plan that cannot be read":
        with pytest.raises(MalformedError) as error:
            read_plan(b'{"tool": "fly", "arguments": {}}', binder=sim.binder)
        sim.gate.enforcer.refuse_plan(error.value, planner="planner")
    elif path.startswith("a mission"):
        with pytest.raises(AuthGuardError):
            sim.gate.management.activate(b"{" if path.endswith("token") else scenarios.token())
    else:
        goal = "nowhere" if path == "an action outside of it" else "pharmacy"
        scenarios.propose(sim, scenarios.navigate("dock", goal))
    return sim


@pytest.mark.parametrize("path", PATHS)
def test_l8_every_way_in_which_something_goes_wrong_leaves_a_record(
    path: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Over the gate's socket: unit/server/test_service.py, integration/test_gate_bad_input.py."""
    last = records(take(path, monkeypatch))[-1]
    kind, reason = PATHS[path]
    assert (last.kind, last.open["reasons"][0]) == (kind, reason)


def test_l8_a_stop_that_does_not_count_any_more_is_recorded_like_the_others() -> None:
    """No stop is refused; past a planner's budget an alert stands beside it.

    A flood of them is counted, and the count recorded: unit/test_stopping.py. A lane on its own
    tells its stops later: lessons/test_running_gate.py.
    """
    sim = scenarios.simulation()
    mission = scenarios.mission()
    sim.gate.management.activate(scenarios.token(mission))
    before, stops = len(records(sim)), mission.budgets.planner_stops + 3
    for _ in range(stops):
        sim.gate.enforcer.stop(by="planner", is_planner=True)
    kinds = [record.kind for record in records(sim)[before:]]
    assert (kinds.count("stop"), kinds.count("alert")) == (stops, 1)


def records(sim: Simulation) -> list[Record]:
    rows = sim.gate.ledger.store.rows()  # type: ignore[attr-defined]
    return [read_record(row.record, where="") for row in rows]


def test_l8_records_that_are_written_at_once_make_one_chain(tmp_path: Path) -> None:
    sim = scenarios.simulation(store=tmp_path / "robot.db")

    def stops(number: int) -> None:
        for _ in range(STOPS):
            sim.gate.enforcer.stop(by=f"person-{number}", is_planner=False)

    with ThreadPoolExecutor(THREADS) as pool:
        assert list(pool.map(stops, range(THREADS))) == [None] * THREADS
    with pytest.raises(StoreError):  # and nobody else writes beside this gate
        open_store(tmp_path / "robot.db")
    sim.gate.close()
    rows = list(read_rows(tmp_path / "robot.db"))
    assert verify_rows(rows).whole
    kinds = [read_record(row.record, where="").kind for row in rows]
    assert kinds.count("stop") == THREADS * STOPS
