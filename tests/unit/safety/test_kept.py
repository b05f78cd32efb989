# SPDX-License-Identifier: Apache-2.0
"""The memory on the whole road: committed with a release, kept over restarts, else unmoved.

Every gate here is whole, and where it matters its store is a real file and its process is killed.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.audit.record import read_record
from authguard_r.core.action import Action
from authguard_r.core.encoding import Tag, b64, decode, encode_fast, unb64
from authguard_r.core.errors import ControllerError
from authguard_r.core.mission import Mission
from authguard_r.core.ports import SafetyGate
from authguard_r.core.safety import SafetyDecision
from authguard_r.core.standing import Outcome, issue
from authguard_r.core.token import sign_object
from authguard_r.enforcement.leases import Running
from authguard_r.enforcement.report import Report
from authguard_r.enforcement.signed_orders import Command, Verb
from authguard_r.normalize import Step
from authguard_r.operations.simulation import Simulation, simulate
from authguard_r.safety import EnvelopeGate, Rule, SafetyConfig, Together, default_config
from authguard_r.safety.stored_memory import LOST, MissionMemory, memory_of, remember, settle_memory
from fixtures import scenarios

SCAN = Action(type="scan_obstacles", tool="lidar")
TELL = Action(type="announce", tool="speaker")
MID = "many-looks"


def mission(**changes: Any) -> Mission:
    """Return a mission that may look and tell as often as it likes."""
    often = {"repeat": 1_000, "starts": 1_000, "max": "5 s", "irreversible": False}
    rows = {"rows": [{}], "chooser": "operator"}
    look = {"id": "look", "type": "scan_obstacles", "tool": "lidar", **often, **rows}
    tell = {"id": "tell", "type": "announce", "tool": "speaker", **often, **rows}
    budgets = {
        "actions": 1_000,
        "rate": {"count": 1_000, "per": "10 s"},
        "motion": "0 s",
        "waiting": "0 s",
        "recorded_bytes": 0,
        "prompts": 0,
        "planner_stops": 0,
    }
    wanted = {"mission": MID, "grants": [look, tell], "closing": None, "budgets": budgets}
    return scenarios.mission(**{**wanted, "window": {"for": "20 h"}, **changes})


def irreversible() -> Mission:
    made = mission()
    tell = msgspec.structs.replace(made.actions[1], irreversible=True)
    return msgspec.structs.replace(made, actions=(made.actions[0], tell))


#: At most one announcement in a mission.
ONCE = "G (type = announce -> WX G type != announce)"
#: Nothing is announced before somebody looked.
LOOKED = "type != announce W type = scan_obstacles"


def config(*formulas: str) -> SafetyConfig:
    rules = tuple(Rule(id=f"rule-{n}", formula=text) for n, text in enumerate(formulas))
    return msgspec.structs.replace(default_config(scenarios.site(), scenarios.RID), rules=rules)


def begin(
    *formulas: str, store: Path | None = None, made: Mission | None = None, start_ms: int = 0
) -> Simulation:
    """Return a gate with these rules whose mission is active."""
    sim = simulate(
        scenarios.trust_folder(),
        scenarios.site(),
        scenarios.binding(),
        rid=scenarios.RID,
        start_ms=scenarios.START_MS + start_ms,
        store=store,
        safety=config(*formulas),
    )
    if sim.gate.ledger.run(lambda act: act.active()) is None:
        sim.gate.management.activate(scenarios.token(made or mission()))
    return sim


def safe(report: Report) -> bool:
    """True when it was released, False when the safety gate alone refused it."""
    assert report.judged is not None, report.refusal
    assert str(report.judged.decision.verdict) == "accept"
    assert report.judged.safety is not None
    assert report.judged.released == report.judged.safety.safe
    return report.judged.released


def memory(sim: Simulation) -> bytes:
    standing = sim.gate.management.standing(MID)  # type: ignore[arg-type]
    return sim.gate.ledger.peek(lambda turn: memory_of(turn, standing))


def held(sim: Simulation) -> MissionMemory:
    data = sim.gate.ledger.peek(lambda turn: turn.get("safety", MID))
    assert data is not None
    return decode(data, MissionMemory)


def put(sim: Simulation, data: bytes) -> None:
    sim.gate.ledger.run(lambda act: act.put("safety", MID, data))


def test_a_release_moves_the_memory_and_a_refusal_does_not() -> None:
    sim = begin(ONCE)
    assert memory(sim) == b""
    assert safe(scenarios.propose(sim, SCAN))
    looked = held(sim)
    assert (looked.actions, unb64(looked.succeeded)) == (1, memory(sim))
    assert safe(scenarios.propose(sim, TELL))
    told = held(sim)
    assert told.actions == 2
    assert not safe(scenarios.propose(sim, TELL))
    assert held(sim) == told
    unauthorized = scenarios.propose(sim, scenarios.navigate("dock", "pharmacy"))
    assert str(unauthorized.judged.decision.verdict) == "reject"
    assert held(sim) == told
    assert sim.gate.management.standing(MID).actions == 2
    assert [action.type for _, action in moved(sim)] == ["scan_obstacles", "announce"]


def moved(sim: Simulation) -> list[tuple[int, Action]]:
    """Return what was recorded as released, in order."""
    rows = sim.gate.ledger.peek(lambda turn: turn.rows(0, 1_000))
    found = []
    for row in rows:
        record = read_record(row[1], where="record")
        if record.kind == "decision" and record.open["ticket"] != "-":
            sealed = msgspec.json.decode(row[2])
            found.append((row[0], msgspec.convert(sealed["action"]["value"], Action)))
    return found


def test_a_record_says_what_was_unsafe_and_not_what_is_remembered() -> None:
    """Whoever may read the actions can follow the rules; the record's open part tells nothing."""
    sim = begin(ONCE)
    scenarios.propose(sim, TELL)
    scenarios.propose(sim, TELL)
    rows = sim.gate.ledger.peek(lambda turn: turn.rows(0, 1_000))
    records = [read_record(row[1], where="record") for row in rows]
    told = [record.open["safety"] for record in records if record.kind == "decision"]
    assert told == [{"safe": True, "hazards": []}, {"safe": False, "hazards": ["RULE"]}]


def test_without_rules_nothing_is_held() -> None:
    sim = begin()
    assert safe(scenarios.propose(sim, TELL))
    assert sim.gate.ledger.peek(lambda turn: turn.get("safety", MID)) is None


def test_a_new_mission_begins_with_fresh_memory() -> None:
    sim = begin(ONCE)
    assert [safe(scenarios.propose(sim, TELL)) for _ in range(2)] == [True, False]
    order(sim, Verb.REVOKE)
    sim.gate.management.activate(scenarios.token(mission(mission="other-looks")))
    assert [safe(scenarios.propose(sim, TELL)) for _ in range(2)] == [True, False]


def test_the_next_version_of_a_mission_goes_on_with_the_memory() -> None:
    sim = begin(ONCE)
    assert safe(scenarios.propose(sim, TELL))
    standing = sim.gate.management.standing(MID)  # type: ignore[arg-type]
    assert standing is not None
    second = msgspec.structs.replace(
        mission(), version=2, supersedes=standing.digest, nonce=b64(b"2" * 16)
    )
    sim.gate.management.activate(scenarios.token(second))
    assert sim.gate.management.standing(MID).version == 2
    assert not safe(scenarios.propose(sim, TELL))


def order(sim: Simulation, verb: Verb, **more: Any) -> None:
    standing = sim.gate.management.standing(MID)  # type: ignore[arg-type]
    assert standing is not None
    made = Command(
        verb=verb,
        mid=standing.mid,
        version=standing.version,
        mission=standing.digest,
        nonce=b64(os.urandom(16)),
        expires_ms=sim.robot.wall_ms() + 60_000,
        issued_ms=sim.robot.wall_ms() + 1,
        **more,
    )
    signer = scenarios.folder_signer(scenarios.trust_folder(), "operator-1")
    sim.gate.management.command(sign_object(made, Tag.COMMAND, signer))


# how it ended


def refuse_to_begin(sim: Simulation) -> None:
    def dispatch(*_: Any) -> Any:
        raise ControllerError("it does not begin")

    sim.robot.dispatch = dispatch  # type: ignore[method-assign]


def test_what_was_never_started_was_never_done() -> None:
    """Neither way: it is not forbidden a second time, and nothing may follow that it allows."""
    for formula, then in ((ONCE, True), (LOOKED, False)):
        sim = begin(formula)
        begun = sim.robot.dispatch
        refuse_to_begin(sim)
        first = TELL if formula == ONCE else SCAN
        report = scenarios.propose(sim, first)
        assert report.outcome is Outcome.NOT_STARTED
        assert (memory(sim), held(sim).actions) == (b"", 1)
        sim.robot.dispatch = begun  # type: ignore[method-assign]
        assert safe(scenarios.propose(sim, TELL)) is then


def test_what_cannot_be_undone_is_not_believed_to_be_undone() -> None:
    sim = begin(ONCE, made=irreversible())
    begun = sim.robot.dispatch
    refuse_to_begin(sim)
    assert scenarios.propose(sim, TELL).outcome is Outcome.NOT_STARTED
    sim.robot.dispatch = begun  # type: ignore[method-assign]
    assert not safe(scenarios.propose(sim, TELL))


@pytest.mark.parametrize("outcome", [Outcome.FAILED, Outcome.ABORTED, Outcome.UNKNOWN])
def test_what_did_not_succeed_may_have_happened_and_may_not(outcome: Outcome) -> None:
    """So it forbids what it forbids when it happened, and allows nothing that needs it."""
    for formula, first in ((ONCE, TELL), (LOOKED, SCAN)):
        sim = begin(formula)
        assert safe(_ended(sim, first, outcome))
        if outcome is Outcome.UNKNOWN:
            ticket = sim.gate.management.standing(MID).open[0].ticket
            order(sim, Verb.RESOLVE, ticket=ticket, outcome=Outcome.FAILED)
            order(sim, Verb.RESUME)
        assert not safe(scenarios.propose(sim, TELL))


@pytest.mark.parametrize(
    ("outcome", "then"),
    [(Outcome.SUCCEEDED, True), (Outcome.NOT_STARTED, False), (Outcome.FAILED, False)],
)
def test_an_operator_who_resolves_says_how_it_ended(outcome: Outcome, then: bool) -> None:
    sim = begin(LOOKED)
    _ended(sim, SCAN, Outcome.UNKNOWN)
    ticket = sim.gate.management.standing(MID).open[0].ticket
    order(sim, Verb.RESOLVE, ticket=ticket, outcome=outcome)
    order(sim, Verb.RESUME)
    assert safe(scenarios.propose(sim, TELL)) is then


def _ended(sim: Simulation, action: Action, outcome: Outcome) -> Report:
    """Propose an action whose controller says that it ended so."""
    begun = sim.robot.dispatch

    class Ended:
        def outcome(self) -> Outcome:
            return outcome

        def used(self) -> Any:
            return handle.used()

    def dispatch(released: Action, lease: Any) -> Any:
        nonlocal handle
        handle = begun(released, lease)
        return Ended()

    handle: Any = None
    sim.robot.dispatch = dispatch  # type: ignore[method-assign]
    report: Report = scenarios.propose(sim, action)
    sim.robot.dispatch = begun  # type: ignore[method-assign]
    assert report.outcome is outcome
    return report


def test_while_one_action_runs_another_is_held_against_both_ends_of_it() -> None:
    sim = begin(LOOKED)

    def submit(action: Action) -> Any:
        return sim.gate.enforcer.submit(
            Step(action=action, attested=()),
            planner="planner",
            evidence=b64(bytes(32)),
            context=sim.binder.context(),
        )

    running = submit(SCAN)
    assert not isinstance(running, Report)
    assert not safe(submit(TELL))
    second = submit(SCAN)
    while running.poll() is None:
        sim.robot.pause(100)
    assert held(sim).ticket == second.report.judged.ticket
    assert not safe(submit(TELL))  # what ended was not the last one: the doubt stays
    while second.poll() is None:
        sim.robot.pause(100)
    assert isinstance(submit(TELL), Running)


# a memory that is not the mission's


def test_rules_that_begin_in_the_middle_of_a_mission_do_not_know_what_was_done(
    tmp_path: Path,
) -> None:
    store = tmp_path / "robot.db"
    sim = begin(store=store)
    assert safe(scenarios.propose(sim, TELL))
    sim.gate.close()
    later = begin(ONCE, store=store, start_ms=60_000)
    assert memory(later) == LOST
    report = scenarios.propose(later, TELL)
    assert not safe(report)
    assert [str(f.hazard) for f in report.judged.safety.findings] == ["STATE_UNKNOWN"]
    order(later, Verb.REVOKE)
    later.gate.management.activate(scenarios.token(mission(mission="other-looks")))
    assert safe(scenarios.propose(later, TELL))
    later.gate.close()


@pytest.mark.parametrize(
    "touch",
    [
        lambda kept: b"",
        lambda kept: b"{}",
        lambda kept: encode_fast(msgspec.structs.replace(kept, actions=0)),
        lambda kept: encode_fast(msgspec.structs.replace(kept, memory=b64(b"{}"))),
        lambda kept: encode_fast(msgspec.structs.replace(kept, memory="A")),
    ],
)
def test_a_memory_that_somebody_touched_is_none(touch: Any) -> None:
    sim = begin(ONCE)
    assert safe(scenarios.propose(sim, SCAN))
    put(sim, touch(held(sim)))
    report = scenarios.propose(sim, SCAN)
    assert report.judged is None or not safe(report)
    assert sim.gate.management.standing(MID).actions == 1


def test_the_memory_of_another_mission_in_its_place_is_none() -> None:
    sim = begin(ONCE)
    assert safe(scenarios.propose(sim, TELL))
    order(sim, Verb.REVOKE)
    sim.gate.management.activate(scenarios.token(mission(mission="other-looks")))
    assert safe(scenarios.propose(sim, SCAN))
    fresh = sim.gate.ledger.peek(lambda turn: turn.get("safety", "other-looks"))
    stolen = msgspec.structs.replace(decode(fresh, MissionMemory), memory=held(sim).memory)
    sim.gate.ledger.run(lambda act: act.put("safety", "other-looks", encode_fast(stolen)))
    assert not safe(scenarios.propose(sim, SCAN))


# restarts


def live(store: str) -> None:
    """Be a gate on a store: announce, start another look, say so, and wait to be killed."""
    sim = begin(ONCE, LOOKED, store=Path(store))
    assert safe(scenarios.propose(sim, SCAN))
    assert safe(scenarios.propose(sim, TELL))

    def dispatch(*_: Any) -> Any:
        os.write(1, b"moving\n")
        signal.pause()

    sim.robot.dispatch = dispatch  # type: ignore[method-assign]
    scenarios.propose(sim, SCAN)


def test_kill_9_while_the_robot_moves_leaves_the_memory_of_all_that_was_released(
    tmp_path: Path,
) -> None:
    store = tmp_path / "robot.db"
    code = f"from unit.safety import test_kept as t; t.live({str(store)!r})"
    environment = {
        **os.environ,
        "PYTHONPATH": str(scenarios.ROOT / "tests"),
        "AUTHGUARD_TEST_TRUST": str(scenarios.trust_folder()),
    }
    patched = (
        "import os; from fixtures import scenarios; from pathlib import Path; "
        "scenarios.trust_folder = lambda: Path(os.environ['AUTHGUARD_TEST_TRUST']); "
    )
    gate = subprocess.Popen(
        [sys.executable, "-c", patched + code], stdout=subprocess.PIPE, env=environment
    )
    assert gate.stdout is not None
    assert gate.stdout.readline() == b"moving\n"
    gate.kill()
    gate.wait()
    gate.stdout.close()
    sim = begin(ONCE, LOOKED, store=store, start_ms=600_000)
    tickets = sim.gate.management.recover()
    for ticket in tickets:
        order(sim, Verb.RESOLVE, ticket=ticket, outcome=Outcome.SUCCEEDED)
    order(sim, Verb.RESUME)
    assert held(sim).actions == 3
    assert not safe(scenarios.propose(sim, TELL))  # announced already, before it was killed
    assert safe(scenarios.propose(sim, SCAN))
    sim.gate.close()
    again = begin(ONCE, LOOKED, store=store, start_ms=1_200_000)
    assert not safe(scenarios.propose(again, TELL))
    again.gate.close()


def test_recovery_that_sees_that_it_was_done_settles_the_memory() -> None:
    made = mission()
    battery = scenarios.mission().guards[0]
    seen = tuple(msgspec.structs.replace(one, done_when=(battery,)) for one in made.actions)
    sim = begin(LOOKED, made=msgspec.structs.replace(made, actions=seen))
    _ended(sim, SCAN, Outcome.UNKNOWN)
    assert memory(sim) != unb64(held(sim).succeeded)
    sim.gate.enforcer.inputs.refresh()
    assert sim.gate.management.recover() == ()
    assert memory(sim) == unb64(held(sim).succeeded)


# the parts alone


class Cells:
    """A turn of a store, as far as a memory needs one."""

    def __init__(self) -> None:
        self.held: dict[tuple[str, str], bytes] = {}

    def get(self, kind: str, key: str) -> bytes | None:
        return self.held.get((kind, key))

    def put(self, kind: str, key: str, value: bytes) -> None:
        self.held[kind, key] = value


def test_what_was_not_released_or_is_not_the_last_release_moves_nothing() -> None:
    cells, verified = Cells(), scenarios.verified(mission())
    standing = issue(verified)
    remember(cells, standing, None, ticket="A" * 43)
    remember(cells, standing, SafetyDecision(safe=True), ticket="A" * 43)
    settle = {"ticket": "A" * 43, "outcome": Outcome.SUCCEEDED}
    settle_memory(cells, standing, verified.mission, **settle)
    assert cells.held == {}
    assert memory_of(cells, None) == b""
    remember(cells, standing, SafetyDecision(safe=True, memory=(b"one", b"two")), ticket="B" * 43)
    before = dict(cells.held)
    settle_memory(cells, standing, verified.mission, **settle)
    assert cells.held == before


def test_of_several_gates_one_remembers() -> None:
    class Remembers:
        def __init__(self, memory: bytes = b"") -> None:
            self.memory = memory

        def recall(self, memory: bytes) -> SafetyGate:
            return Remembers(memory)

        def assess(self, *_: Any) -> SafetyDecision:
            return SafetyDecision(safe=True, memory=(self.memory + b"?", self.memory + b"!"))

    ground = EnvelopeGate(config())
    gate = Together(ground, Remembers()).recall(b"once")
    asked = (
        scenarios.navigate("dock", "pharmacy"),
        scenarios.state(),
        scenarios.facts(),
        scenarios.NOW,
    )
    assert gate.assess(*asked).memory == (b"once?", b"once!")
    assert Together(ground, ground).assess(*asked) == SafetyDecision(safe=True)
    with pytest.raises(RuntimeError, match="two safety gates remember"):
        Together(Remembers(), Remembers()).assess(*asked)
