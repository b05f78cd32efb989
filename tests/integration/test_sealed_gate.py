# SPDX-License-Identifier: Apache-2.0
"""A gate that seals its log: real processes, killed in the middle, told to destroy it."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from authguard_r.audit.record import BOX, WRAP, LogRow
from authguard_r.cli.logs import open_log
from authguard_r.cli.replay import LogReplay
from authguard_r.core.approval import ApprovalVerdict
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.identifiers import MissionId
from authguard_r.core.mission import DataClass, Mission
from authguard_r.core.quantities import to_ms
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.keys.trust import read_trust
from authguard_r.wire.messages import ClientRole
from fixtures import approvals, scenarios, sealed_logs
from fixtures.gate_process import AUTHGUARD, RunningGate, order, until
from integration.test_approvals_gate import PLAN, key, reasons
from integration.test_gate_watching import operator

REGION, PERSON = DataClass.REGION, DataClass.PERSON
SCAN = b"scan()"
READERS = (sealed_logs.reader("auditor"), sealed_logs.reader("porter", REGION))


class SealingGate(RunningGate):
    """A gate with the robot inside, which seals for an auditor and a porter."""

    def __init__(self, **more: Any) -> None:
        super().__init__(simulate=True, refusals=0, fold_ms=0, readers=READERS, **more)

    def active(self, **changes: Any) -> tuple[Mission, str]:
        mission = self.mission(**changes)
        return mission, self.activate(self.token(mission))["digest"]

    def scans(self, count: int = 1) -> None:
        with self.client(ClientRole.PLANNER) as planner:
            for _ in range(count):
                step = planner.propose(SCAN)["steps"][0]
                assert step["reasons"] == []

    def refused(self, count: int) -> None:
        """Let the planner ask for what its mission does not grant."""
        with self.client(ClientRole.PLANNER) as planner:
            for _ in range(count):
                assert not planner.propose(PLAN)["steps"][-1]["released"]

    def ends(self, mission: Mission, digest: str) -> None:
        with operator(self) as person:
            person.command(order(self, mission, digest, Verb.REVOKE))

    def shreds(
        self,
        mid: str,
        *classes: DataClass,
        words: tuple[object, ...] = (),
        then: Callable[[], None] = lambda: None,
    ) -> Any:
        """Order as a person does at a terminal; return exit code and what is said.

        Args:
            then: what happens once it is said, before the command has ended.
        """
        said = ["audit", "shred", mid, "--trust", self.trust, "--yes", "--json"]
        said += [word for data in classes for word in ("--class", data)]
        said += words or ("--gate", self.run)
        with subprocess.Popen(
            [str(AUTHGUARD), *map(str, said)], stdout=subprocess.PIPE, cwd=scenarios.ROOT
        ) as process:
            assert process.stdout is not None
            line = process.stdout.readline()
            then()
        return process.returncode, json.loads(line)

    def shredded(self) -> bool:
        """True when the log says that every box is gone."""
        return any(told.open.get("verb") == "shredded" for told in self.records())


@pytest.fixture
def gate() -> Iterator[SealingGate]:
    with SealingGate() as running:
        yield running


def replayed(rows: list[LogRow], trust: Path, role: str = "auditor") -> LogReplay:
    replay = LogReplay(read_trust(trust))
    for row in sealed_logs.opened(rows, role):
        assert replay.see(row) is None
    return replay


def said(rows: list[LogRow], role: str) -> bytes:
    """Return the values that a role reads beside the records."""
    return b"".join(row.sealed for row in sealed_logs.opened(rows, role)[1:])


@pytest.mark.smoke
def test_the_log_of_a_gate_is_closed_to_who_has_the_file_and_open_to_its_auditor(
    gate: SealingGate,
) -> None:
    mission, digest = gate.active()
    gate.scans(2)
    with gate.client(ClientRole.PLANNER) as planner:
        plan = b'{"tool": "navigate_to", "arguments": {"destination": "Nowhere-7", "speed": 0.5}}'
        assert planner.propose(plan)["steps"][0]["reasons"] == ["NAME_UNKNOWN"]
    with operator(gate) as person:
        told = str(person.explain(None)["text"])  # a gate opens nothing for whoever has no key
        assert ("NAME_UNKNOWN" in told, "Nowhere-7" in told) == (True, False)
    gate.ends(mission, digest)
    gate.stop_process("gate")
    rows = sealed_logs.rows_of(gate.store)
    said = b"".join(row.record + row.sealed for row in rows[1:])
    for word in ("Nowhere-7", "operator-1", "scan", "camera", mission.task, "look-out", "speed"):
        assert word.encode() not in said, word
    replay = replayed(rows, gate.trust)
    assert (replay.agree, replay.decisions) == (2, 2)
    porter = replayed(rows, gate.trust, "porter")
    assert (porter.agree, porter.not_replayable) == (0, 2)


def test_a_repeat_after_a_restart_is_told_without_what_is_closed(gate: SealingGate) -> None:
    gate.active()
    with gate.client(ClientRole.PLANNER) as planner:
        first = planner.propose(SCAN, key="one")["steps"][0]
    gate.kill9()
    gate.start_gate()
    with gate.client(ClientRole.PLANNER) as planner:
        again = planner.propose(SCAN, key="one")
    step = again["steps"][0]
    assert again["repeated"] is True
    for name in ("outcome", "reasons", "released", "seq"):
        assert step[name] == first[name]


def test_an_open_request_of_before_a_restart_shows_nothing_that_is_closed(
    gate: SealingGate,
) -> None:
    """What the gate cannot read, nobody is shown, so nobody signs an answer to it."""
    gate.activate(gate.token(approvals.at_gate(gate)))
    with gate.client(ClientRole.PLANNER) as planner:
        until(lambda: reasons(planner) == ["APPROVAL_REQUIRED"], "the question")
        with gate.client(ClientRole.OPERATOR) as console:
            (question,) = console.approvals()
            assert question.scope_bytes is not None
    gate.stop_process("gate")
    gate.start_gate()
    with gate.client(ClientRole.OPERATOR) as console:
        (question,) = console.approvals()
        assert (question.scope_bytes, question.is_current) == (None, False)
        with pytest.raises(AuthGuardError):
            console.answer(question, ApprovalVerdict.APPROVE, key("supervisor-1"))


def test_an_order_at_a_terminal_destroys_and_a_kill_in_the_middle_loses_nothing(
    gate: SealingGate,
) -> None:
    mission, digest = gate.active()
    gate.refused(200)
    code, told = gate.shreds(mission.mid, REGION)
    assert (code, told["error"]["code"]) == (1, "TRANSITION_REFUSED")  # it goes on
    gate.ends(mission, digest)
    with open_log(gate.store) as log:
        before = said(list(log.rows), "porter")
    code, told = gate.shreds(mission.mid, REGION, then=gate.kill9)
    assert (code, told["shredding"]["classes"], gate.shredded()) == (0, ["region"], False)
    gate.start_gate()
    until(gate.shredded, "the last box")
    assert gate.shreds(mission.mid, REGION)[1]["error"]["code"] == "MISSION_UNKNOWN"
    gate.stop_process("gate")
    rows = sealed_logs.rows_of(gate.store)
    assert regions(rows, mission.mid) == []
    replay = replayed(rows, gate.trust)
    assert (replay.agree, replay.not_replayable) == (0, replay.decisions)
    # where the planner wanted to go, which the porter could read
    after = said(rows, "porter")
    for word in (b'"action.regions"', b'"destination":"isolation-room"'):
        assert before.count(word) == 200, word
        assert word not in after


def test_a_gate_without_a_rule_destroys_a_class_at_the_time_that_its_mission_says(
    gate: SealingGate,
) -> None:
    """Also when the gate was killed before, and only for that mission."""
    other, digest = gate.active(mission="other")
    gate.ends(other, digest)
    mission, _ = gate.active(window={"for": "5 s"}, retention={"region": "1 s"})
    gate.kill9()
    over_ms = to_ms(mission.expiry, where="expiry") + mission.retention[REGION]
    until(lambda: time.time_ns() // 1_000_000 > over_ms, "the end of the mission's own time")
    gate.start_gate()
    until(gate.shredded, "the last box")
    gate.stop_process("gate")
    rows = sealed_logs.rows_of(gate.store)
    (done,) = [told for told in map(sealed_logs.told, rows) if told.open.get("verb") == "shred"]
    assert (done.open["of"], done.open["classes"]) == (mission.mid, ["region"])
    left = {mid: regions(rows, mid) for mid in (mission.mid, other.mid)}
    assert (left[mission.mid], bool(left[other.mid])) == ([], True)


def regions(rows: list[LogRow], mid: MissionId) -> list[str]:
    """Return what of a mission is still sealed for readers of regions."""
    mine = [row for row in rows if sealed_logs.told(row).link.mid == mid]
    names = [name for row in mine for name in sealed_logs.values(row)]
    return [name for name in names if name.startswith((BOX, WRAP)) and "region" in name]


def test_an_order_is_carried_out_on_a_store_that_no_gate_holds(gate: SealingGate) -> None:
    mission, digest = gate.active()
    gate.scans()
    gate.ends(mission, digest)
    gate.stop_process("gate")
    place = ("--store", gate.store, "--site", gate.site, "--robot", gate.rid)
    code, told = gate.shreds(mission.mid, PERSON, words=place)
    assert (code, told["shredding"]["mid"]) == (0, mission.mid)
    code, told = gate.shreds("-", PERSON, REGION, words=place)
    assert (code, told["shredding"]["mid"]) == (0, "-")
    mine = [
        row
        for row in sealed_logs.rows_of(gate.store)
        if sealed_logs.told(row).link.mid == mission.mid
    ]
    assert not [name for row in mine for name in sealed_logs.values(row) if "person" in name]
    assert gate.shreds(mission.mid, PERSON, words=("--store", gate.store))[0] == 2  # no site
