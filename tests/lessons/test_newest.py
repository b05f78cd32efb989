# SPDX-License-Identifier: Apache-2.0
"""Faults seen from outside in what a gate believes, which order it obeys, and what its log says.

One test for one lesson, named after it; the numbers are those of the project's list of lessons.
"""

from __future__ import annotations

import asyncio
import json
import time
from pathlib import Path
from typing import Any

import pytest

from authguard_r.audit.record import read_record
from authguard_r.audit.verify import verify_rows
from authguard_r.cli import call
from authguard_r.core.standing import Outcome
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.integrations.tools.server import ToolAnswer
from authguard_r.normalize.expected import TEXT, AnswerMatch
from authguard_r.store.sqlite import read_rows
from authguard_r.wire.messages import ClientRole, OrderKind
from fixtures import scenarios
from unit.server.demo_site import GO, DemoGate, Refused
from unit.server.test_dispatcher import order
from unit.test_refusals import Full, entry_of, full
from unit.test_untrusted_stores import HOSTILE, store
from unit.tools.test_body import GO as DRIVE
from unit.tools.test_body import TICKET, Robot, body_of, until

BACK = b'navigate_to(destination="Station 101", speed=0.8)'
#: A file that anybody sent is read or refused within this, in seconds.
SOON_S = 5

__all__ = ["full"]  # a fixture


def test_l23_nothing_is_decided_on_state_from_before_the_last_motion_ended() -> None:
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        measures = house.robot.fence
        # an estimator that goes on speaking and has not heard that it should measure anew
        house.robot.fence = lambda _: None  # type: ignore[method-assign]
        (went,) = house.rest(planner, house.begin(planner, GO))["steps"]
        assert went["execution"]["outcome"] == "succeeded"
        (refused,) = house.rest(planner, house.begin(planner, BACK))["steps"]
        assert "STATE_BEFORE_MOTION" in refused["reasons"]
        house.robot.fence = measures  # type: ignore[method-assign]
        house.advance(100)
        (then,) = house.propose(planner, BACK)["steps"]
        assert "STATE_BEFORE_MOTION" not in then["reasons"]


def test_l23_a_number_from_before_a_restart_is_too_small_after_it(tmp_path: Path) -> None:
    given: list[int] = []
    for _ in range(3):
        sim = scenarios.simulation(store=tmp_path / "robot.db", start_ms=scenarios.START_MS)
        if not given:
            sim.gate.management.activate(scenarios.token())
            scenarios.propose(sim, scenarios.navigate("dock", "pharmacy"))
        for _ in range(3):  # ends that no record has room for
            sim.gate.ledger.raise_fence()
        given.append(sim.gate.ledger.fence)
        sim.gate.close()
        sim = scenarios.simulation(
            store=tmp_path / "robot.db", start_ms=scenarios.START_MS + 60_000 * len(given)
        )
        assert sim.gate.ledger.fence > max(given)
        sim.gate.close()


def test_l24_an_older_order_undoes_nothing_that_was_signed_after_it() -> None:
    with DemoGate() as house:
        house.activate()
        before = house.order(Verb.RESUME, issued_ms=house.clock.wall_ms())
        house.advance(50)
        house.stop(ClientRole.OPERATOR, 1)
        # of the stop's own millisecond: which of the two came first is unknown
        same = house.order(Verb.RESUME, issued_ms=house.clock.wall_ms())
        for early, token in ((50, before), (0, same)):
            with pytest.raises(Refused, match=f"ORDER_TOO_OLD: signed {early} ms before"):
                order(house, OrderKind.COMMAND, token)
        late = [house.order(verb) for verb in (Verb.SUSPEND, Verb.COMPLETE, Verb.REVOKE)]
        house.advance(50)
        answer = order(house, OrderKind.COMMAND, house.order(Verb.RESUME))
        assert answer["standing"]["status"] == "active"
        for token in late:
            with pytest.raises(Refused, match="ORDER_TOO_OLD"):
                order(house, OrderKind.COMMAND, token)


def test_l25_what_was_refused_on_a_full_disk_is_in_the_log_after_a_clean_stop(full: Full) -> None:
    ledger = full.ledger()
    full.fill_rest(ledger)
    hijacks = [f"hijack {number}" for number in range(2)]
    for name in hijacks:
        ledger.refuse(lambda at: entry_of("refusal", at), dedup_key=("llm", name, "plan"))
    assert ledger.refusals.only_counts  # which the gate says in an alert
    assert ledger.flush(everything=True)  # as a gate that ends does
    ledger.close()
    full.mend()
    told = [read_record(row.record, where="").open for row in read_rows(full.path)]
    (counted,) = [opened for opened in told if "repeats" in opened]
    assert (counted["repeats"], counted["cause"], counted["reasons"]) == (2, "no room", hijacks)


def test_l25_a_hijack_that_is_only_counted_is_not_said_to_be_recorded() -> None:
    sim = scenarios.simulation()
    sim.gate.management.activate(scenarios.token())
    hijack = scenarios.navigate("dock", "station-103")
    assert scenarios.propose(sim, hijack).outcome_recorded
    sim.gate.ledger.refusals._restore = lambda: False  # the disk is full
    sim.robot.pause(2_000)
    report = scenarios.propose(sim, hijack)
    assert (report.seq, report.outcome_recorded) == (None, False)
    sim.gate.close()


@pytest.mark.parametrize("schema", HOSTILE, ids=HOSTILE.keys())
@pytest.mark.parametrize("command", ["verify", "show", "replay"])
def test_l26_a_store_that_is_a_program_is_refused_with_its_reason_and_at_once(
    command: str, schema: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "robot.db"
    store(path, HOSTILE[schema])
    begun = time.process_time()
    assert call(["audit", command, str(path), "--json"]) == 4
    assert time.process_time() - begun < SOON_S
    assert json.loads(capsys.readouterr().out)["error"]["code"] == "STORE_CORRUPT"


def test_l26_each_command_that_reads_a_strange_store_refuses_it_in_the_same_way(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(tmp_path / "robot.db")
    store(Path(path), HOSTILE["a view without an end"])
    site = str(scenarios.HOSPITAL / "site.yaml")
    audits = ("verify", "show", "replay", "export", "growth", "segments", "prompts")
    commands = [["audit", name, path] for name in audits]
    commands[3] += ["--out", str(tmp_path / "robot.jsonl")]
    commands += [["explain", "0", "--store", path]]
    commands += [["learn", path, "--site", site, "--out", str(tmp_path / "learned")]]
    for words in commands:
        assert (call([*words, "--json"]), words) == (4, words)
        assert json.loads(capsys.readouterr().out)["error"]["code"] == "STORE_CORRUPT"


def test_l29_a_failure_in_a_success_envelope_has_failed() -> None:
    """Success is declared and matched, never assumed."""

    async def drive(text: str, **demand: Any) -> Outcome | None:
        robot = Robot(
            navigate_to=[ToolAnswer(is_error=False, text=text)], say=[ToolAnswer(is_error=False)]
        )
        handle = body_of(robot, "say", moves=demand).begin(DRIVE, TICKET)
        await until(lambda: handle.outcome() is not None)
        return handle.outcome()

    landed, unarmed = (
        {TEXT: AnswerMatch(starts_with="landed")},
        {TEXT: AnswerMatch(contains="not armed")},
    )
    for text, demand, ended in (
        ("failed: not armed", {"succeeds": landed}, Outcome.FAILED),
        ("failed: not armed", {"fails": unarmed}, Outcome.FAILED),
        ("landed", {"succeeds": landed, "fails": unarmed}, Outcome.SUCCEEDED),
    ):
        assert asyncio.run(drive(text, **demand)) is ended


def test_l30_a_mistyped_store_is_not_reached_and_not_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    # the commands go by the machine's clock
    Path("m.token").write_bytes(scenarios.token(scenarios.mission(window={"for": "20 h"})))
    site = str(scenarios.ROOT / "examples" / "hospital" / "site.yaml")
    at = ["--trust", str(scenarios.trust_folder()), "--site", site]
    at += ["--robot", scenarios.RID, "--store", "mistyped.db", "--json"]
    orders = [[verb, "m.token"] for verb in ("activate", "suspend", "resume", "revoke", "complete")]
    for words in (["stop"], *(["mission", *said] for said in orders)):
        assert call([*words, *at]) == 5, words
        error = json.loads(capsys.readouterr().out)["error"]
        assert (error["code"], error["where"]) == ("STORE_UNAVAILABLE", "mistyped.db")
        assert "no gate answers" in error["message"]
    assert [path.name for path in tmp_path.iterdir()] == ["m.token"]
    assert call(["mission", "activate", "m.token", *at, "--new"]) == 0
    assert json.loads(capsys.readouterr().out)["by_gate"] is False
    assert verify_rows(read_rows(Path("mistyped.db"))).whole
