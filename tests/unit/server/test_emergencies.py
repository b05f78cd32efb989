# SPDX-License-Identifier: Apache-2.0
"""Emergencies at a whole gate: real ones are carried out, false ones are told to people."""

from __future__ import annotations

import shutil
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.audit.record import Record, read_record
from authguard_r.authoring.keys.revoking import revoke
from authguard_r.core.encoding import encode_fast
from authguard_r.core.errors import AuthenticityError, StoreError
from authguard_r.core.mission import Mission
from authguard_r.core.ports import Store
from authguard_r.core.quantities import Now
from authguard_r.core.standing import Outcome
from authguard_r.enforcement.emergency.opened import open_emergency, require_signer
from authguard_r.enforcement.emergency.policy import Caller, EmergencyPolicy
from authguard_r.enforcement.emergency_audit import EmergencyStanding
from authguard_r.enforcement.emergency_enforcer import EmergencyExecution, EmergencyReport
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.keys.signer import FileSigner
from authguard_r.server import emergencies
from authguard_r.server.emergency_wiring import open_emergency_enforcer, open_journal
from authguard_r.server.service_parts import ServiceParts
from authguard_r.sim.robot import Faults
from authguard_r.store.memory import MemoryStore
from authguard_r.wire.messages import ClientRole, Emergency, Kind, Order, OrderKind
from fixtures import emergency_policies, scenarios
from fixtures.limits import bounded
from unit.server.demo_site import GO, STEP_MS, DemoGate, Guest, HandClock, Refused

HOUR_MS = 3_600_000


class Disk:
    """A store that a test can take away and give back (`core.ports.Store`)."""

    def __init__(self) -> None:
        self.inner = MemoryStore()
        self.dead = False

    def run(self, job: Any, *, essential: bool = False) -> Any:
        if self.dead:
            raise StoreError("the disk is gone", where="store")
        return self.inner.run(job, essential=essential)

    def read(self, job: Any) -> Any:
        if self.dead:
            raise StoreError("the disk is gone", where="store")
        return self.inner.read(job)

    def is_here(self) -> bool:
        return self.inner.is_here()

    def restore(self) -> bool:
        return not self.dead

    def close(self) -> None:
        self.inner.close()


class EmergencyGate(DemoGate):
    """A house with an emergency road."""

    def __init__(
        self,
        *capabilities: dict[str, Any],
        journal: Path | None = None,
        policy: EmergencyPolicy | None = None,
        **more: Any,
    ) -> None:
        self._policy = policy or emergency_policies.policy(*capabilities)
        self._path = journal
        super().__init__(
            **{
                "site": emergency_policies.site(),
                "trust": emergency_policies.trust_folder(),
                **more,
            }
        )

    def _service_parts(self, signer: FileSigner) -> ServiceParts:
        path = self._path
        self.spool = None if path is None else open_journal(path, self.gate.ledger, signer)
        opened = emergency_policies.opened(self._policy)
        self.road = open_emergency_enforcer(self.gate, opened, self.spool)
        return msgspec.structs.replace(super()._service_parts(signer), emergency=self.road)

    def __exit__(self, *more: object) -> None:
        super().__exit__(*more)
        self.road.log.close()

    def begin_call(self, guest: Guest, capability: str, key: str | None = None) -> int:
        self.calls = getattr(self, "calls", 0) + 1
        asked = Emergency(key=key or f"call-{self.calls}", capability=capability)
        number = guest.say(Kind.EMERGENCY, asked)
        self.pump()
        return number

    def call(self, guest: Guest, capability: str, key: str | None = None) -> dict[str, Any]:
        return self.rest(guest, self.begin_call(guest, capability, key))

    def behind(self, kind: str) -> list[Record]:
        """Return the records of a kind while the clock is behind."""
        rows = self.gate.ledger.peek(lambda turn: turn.rows(0, 1 << 30))
        found = [read_record(row[1], where="log") for row in rows]
        return [record for record in found if record.kind == kind]

    @property
    def told(self) -> list[tuple[str, str]]:
        """What the log says of emergencies: decision and capability."""
        return [
            (record.link.decision, record.open["capability"])
            for record in self.log("emergency")
            if record.link.decision != "policy"
        ]

    @property
    def alerts(self) -> list[dict[str, Any]]:
        return [record.open for record in self.log("alert")]


def planner(house: DemoGate, name: str | None = None) -> Guest:
    return house.enter(ClientRole.PLANNER, name)


def test_a_real_emergency_without_a_mission_is_carried_out_and_recorded() -> None:
    with EmergencyGate(at="station-103") as house:
        answer = house.call(planner(house), "go-safe")
        assert (answer["outcome"], answer["execution"]["outcome"]) == ("accept", "succeeded")
        assert house.robot.state.region == "dock"
        assert house.told == [("accept", "go-safe"), ("succeeded", "go-safe")]
        record = house.log("emergency")[1]
        assert record.open["lacked"] == ["mission"]
        assert house.sealed(record.link.seq)["action"][0]["destination"] == "dock"


def dead(tmp_path: Path, name: str) -> bytes:
    """Return the people authority's next list, with a principal on it."""
    folder = tmp_path / "auth"
    shutil.copytree(emergency_policies.trust_folder(), folder)
    begin = datetime.fromtimestamp(scenarios.START_MS / 1000, UTC)
    done = revoke(folder, principal=name, serial=None, now=begin, days=30)
    ((_, found),) = done.lists.items()
    return found.signed


def test_a_policy_whose_signer_is_revoked_moves_nothing_any_more(tmp_path: Path) -> None:
    with EmergencyGate(at="station-103") as house:
        house.gate.lists.install(dead(tmp_path, "safety-officer-1"))
        answer = house.call(planner(house), "go-safe")
        assert (answer["outcome"], answer["reasons"]) == ("reject", ["CERTIFICATE_REVOKED"])
        assert (house.told, house.robot.state.region) == ([], "station-103")


def test_an_emergency_under_way_stops_when_its_signer_is_revoked(tmp_path: Path) -> None:
    with EmergencyGate(at="station-103") as house:
        guest = planner(house)
        number = house.begin_call(guest, "go-safe")
        house.advance(1_000)
        house.gate.lists.install(dead(tmp_path, "safety-officer-1"))
        answer = house.rest(guest, number)
        assert answer["execution"]["outcome"] == "aborted"
        assert house.log("emergency")[-1].open["reasons"] == ["CERTIFICATE_REVOKED"]
        assert house.robot.state.region != "dock"


def test_dates_that_passed_say_nothing_against_a_policy_that_was_opened_in_time() -> None:
    with EmergencyGate(at="station-103") as house:
        later = Now(
            scenarios.START_MS + 400 * emergency_policies.DAY_MS, 0
        )  # certificates and lists are over
        opened, trust = house.road.opened, house.gate.trust
        with pytest.raises(AuthenticityError):
            open_emergency(
                opened.token,
                verifier=trust,
                now=later,
                site=emergency_policies.site(),
                robot=scenarios.RID,
            )
        require_signer(opened, verifier=trust)


@pytest.mark.parametrize(
    ("capability", "reason"),
    [("call-help", "GUARD_FALSE"), ("fly", "ACTION_OUT_OF_SCOPE"), ("let-go", "ROLE_DENIED")],
)
def test_a_false_emergency_of_a_planner_is_refused_and_told_to_people(
    capability: str, reason: str
) -> None:
    with EmergencyGate() as house:
        before = house.place
        answer = house.call(planner(house), capability)
        assert (answer["outcome"], answer["reasons"][0]) == ("reject", reason)
        assert (house.told, house.place) == ([], before)
        refused = [r for r in house.log("refusal") if r.open.get("what") == "emergency"]
        assert [r.open["reasons"][0] for r in refused] == [reason]
        assert [(a["what"], a["calls"]) for a in house.alerts] == [("false emergency", 1)]


def test_a_row_of_false_emergencies_is_one_record_and_an_alert_at_each_power_of_ten() -> None:
    with EmergencyGate() as house:
        guests = [planner(house, "one"), planner(house, "two")]
        for number in range(101):
            house.call(guests[number % 2], "call-help")
        house.advance(200)
        refused = [r for r in house.log("refusal") if r.open.get("what") == "emergency"]
        assert len(refused) == 2  # one for each name
        assert [a["calls"] for a in house.alerts] == [1, 10, 100]


def test_a_false_emergency_does_not_stop_a_mission() -> None:
    with EmergencyGate(mission=worlds_mission()) as house:
        client = planner(house)
        house.activate()
        number = house.begin(client, GO)
        house.advance(STEP_MS)
        house.call(planner(house, "liar"), "call-help")
        answer = house.rest(client, number)
        assert answer["steps"][0]["execution"]["outcome"] == "succeeded"


def worlds_mission() -> Mission:
    """Return the shipped mission, compiled for the site with its safe place."""
    return scenarios.compiled(scenarios.draft(), at=emergency_policies.site())


def test_a_real_emergency_stops_what_runs_first_and_nothing_is_proposed_meanwhile() -> None:
    with EmergencyGate(mission=worlds_mission()) as house:
        client = planner(house)
        house.activate()
        number = house.begin(client, GO)
        house.advance(2_000)
        person = house.enter(ClientRole.OPERATOR, "nurse")
        called = house.begin_call(person, "go-safe")
        step = house.rest(client, number)["steps"][0]
        assert step["execution"]["outcome"] == "aborted"
        house.advance(STEP_MS)
        other = planner(house, "other")
        assert house.propose(other, GO)["steps"][0]["reasons"] == ["BUSY"]
        answer = house.rest(person, called)
        assert answer["execution"]["outcome"] == "succeeded"
        assert house.robot.state.region == "dock"
        assert (
            house.propose(other, GO)["steps"][0]["released"] is True
        )  # the mission is what it was


def test_a_guard_that_ends_while_the_robot_moves_stops_it() -> None:
    near = emergency_policies.guard("human_distance_mm", "ge", 2_000)
    with EmergencyGate(
        {**emergency_policies.GO_SAFE, "guards": [near]}, at="station-103", speed_up=1
    ) as house:
        guest = planner(house)
        number = house.begin_call(guest, "go-safe")
        house.advance(1_000)
        house.robot.state = msgspec.structs.replace(house.robot.state, human_distance_mm=1_500)
        answer = house.rest(guest, number)
        assert answer["execution"]["outcome"] == "aborted"
        assert answer["execution"]["reasons"][0] == "GUARD_FALSE"


def test_stale_state_is_no_emergency() -> None:
    with EmergencyGate(at="station-103") as house:
        guest = planner(house)
        assert house.estimator is not None
        house.estimator.leave()
        house.estimator = None
        house.advance(2_000)
        answer = house.call(guest, "go-safe")
        assert answer["reasons"] == ["STATE_STALE"]
        assert [a["reasons"] for a in house.alerts if a["what"] == "false emergency"] == [
            ["STATE_STALE"]
        ]


@pytest.mark.complete
def test_the_rate_is_held_to() -> None:
    with EmergencyGate(at="dock") as house:
        guest = planner(house)
        for _ in range(3):
            assert house.call(guest, "go-safe")["outcome"] == "accept"
        assert house.call(guest, "go-safe")["reasons"] == ["RATE_EXCEEDED"]
        house.advance(1)
        house.clock.ms += HOUR_MS
        house.look()
        assert house.call(guest, "go-safe")["outcome"] == "accept"


def test_a_repeated_key_is_one_call() -> None:
    with EmergencyGate() as house:
        guest = planner(house)
        first = house.call(guest, "go-safe", "the-one")
        again = house.call(guest, "go-safe", "the-one")
        assert again == {**first, "repeated": True}
        assert len(house.told) == 2


def test_a_key_that_is_not_answered_is_busy() -> None:
    with EmergencyGate(at="station-103", speed_up=1) as house:
        guest = planner(house)
        house.begin_call(guest, "go-safe", "the-one")
        with pytest.raises(Refused, match="BUSY"):
            house.call(guest, "go-safe", "the-one")
        assert house.call(guest, "go-safe", "another")["reasons"] == ["BUSY"]


def test_the_second_gate_has_its_own_word() -> None:
    fast = {**emergency_policies.GO_SAFE, "params": {"speed_mm_s": 1_500}}
    with EmergencyGate(fast, at="station-103") as house:
        house.robot.state = msgspec.structs.replace(house.robot.state, human_distance_mm=500)
        house.advance(STEP_MS)
        answer = house.call(planner(house), "go-safe")
        assert (answer["outcome"], answer["hazards"]) == ("reject", ["HUMAN_PROXIMITY"])


def test_an_operators_stop_stands_until_a_signed_resume() -> None:
    with EmergencyGate(at="station-103", mission=worlds_mission()) as house:
        guest = planner(house)
        house.activate()
        house.stop(ClientRole.OPERATOR, 1)
        assert house.call(guest, "go-safe")["reasons"] == ["STOPPED"]
        person = house.enter(ClientRole.OPERATOR, "resumes")
        person.ask(Kind.ORDER, Order(act=OrderKind.COMMAND, token=house.order(Verb.RESUME)))
        assert house.call(guest, "go-safe")["outcome"] == "accept"


def test_a_stop_stands_over_a_restart_unless_the_capability_says_otherwise() -> None:
    store, clock = MemoryStore(), HandClock()
    inner: Store = _Kept(store)
    with EmergencyGate(store=inner, clock=clock) as house:
        house.stop(ClientRole.OPERATOR, 1)
        house.crashes = True
    after = {**emergency_policies.GO_SAFE, "id": "after", "after_stop": True}
    with EmergencyGate(emergency_policies.GO_SAFE, after, store=inner, clock=clock) as house:
        guest = planner(house)
        assert house.call(guest, "go-safe")["reasons"] == ["STOPPED"]
        assert house.call(guest, "after")["outcome"] == "accept"


class _Kept:
    """A store that outlives its gate."""

    def __init__(self, inner: MemoryStore) -> None:
        self._inner = inner

    def run(self, job: Any, *, essential: bool = False) -> Any:
        return self._inner.run(job, essential=essential)

    def read(self, job: Any) -> Any:
        return self._inner.read(job)

    def is_here(self) -> bool:
        return self._inner.is_here()

    def restore(self) -> bool:
        return True

    def close(self) -> None:
        """Stay."""


def test_the_gate_itself_calls_once_when_the_guards_begin_to_hold() -> None:
    holding = {**emergency_policies.LET_GO, "without": ["mission"]}
    with EmergencyGate(holding) as house:
        house.advance(500)
        assert house.told == []
        state = house.robot.state
        places = {k: v for k, v in state.places.items() if k != "package-p1"}
        house.robot.state = msgspec.structs.replace(state, holding="package-p1", places=places)
        house.advance(2_000)
        assert house.told == [("accept", "let-go"), ("succeeded", "let-go")]
        assert house.robot.state.holding is None
        house.advance(1_000)
        assert len(house.told) == 2
        assert house.log("emergency")[1].open["by"] == "gate"


def test_what_needs_a_mission_or_a_clock_does_not_work_without() -> None:
    needy = {**emergency_policies.GO_SAFE, "id": "needy", "without": []}
    with EmergencyGate(emergency_policies.GO_SAFE, needy) as house:
        guest = planner(house)
        assert house.call(guest, "needy")["reasons"] == ["NO_ACTIVE_MISSION"]
        house.clock.wrong_ms = -HOUR_MS
        house.advance(STEP_MS)
        assert house.call(guest, "needy")["reasons"] == ["NO_ACTIVE_MISSION", "CLOCK_BEHIND"]


def test_a_real_emergency_with_a_clock_that_is_behind() -> None:
    with EmergencyGate(at="station-103") as house:
        guest = planner(house)
        house.call(guest, "call-help")  # something is committed
        house.advance(200)
        house.gate.ledger.run(lambda act: act.put("x", "y", b"z"))
        house.clock.wrong_ms = -HOUR_MS
        house.advance(2_000)
        answer = house.call(guest, "go-safe")
        assert answer["execution"]["outcome"] == "succeeded"
        assert house.behind("emergency")[-1].open["lacked"] == ["clock", "mission"]


def test_an_emergency_with_a_dead_store_goes_into_the_journal_and_then_into_the_log_once(
    tmp_path: Path,
) -> None:
    disk = Disk()
    with EmergencyGate(at="station-103", journal=tmp_path / "journal", store=disk) as house:
        guest = planner(house)
        disk.dead = True
        answer = house.call(guest, "go-safe")
        assert answer["execution"] == {"outcome": "succeeded", "reasons": [], "recorded": True}
        assert house.spool is not None
        assert [r.decision for r in house.spool.pending(0)] == ["accept", "succeeded"]
        disk.dead = False
        house.advance(300)
        assert house.told == [("accept", "go-safe"), ("succeeded", "go-safe")]
        assert [r.open["journal"] for r in house.log("emergency")[1:]] == [1, 2]
        house.advance(300)
        assert len(house.told) == 2


def test_what_needs_the_store_does_not_work_without(tmp_path: Path) -> None:
    disk = Disk()
    needy = {**emergency_policies.GO_SAFE, "without": ["mission"]}
    with EmergencyGate(needy, journal=tmp_path / "journal", store=disk) as house:
        guest = planner(house)
        disk.dead = True
        answer = house.call(guest, "go-safe")
        assert (answer["outcome"], answer["reasons"]) == ("reject", ["STORE_UNAVAILABLE"])
        assert house.spool is not None
        assert house.spool.pending(0) == ()
        disk.dead = False


def test_without_a_journal_nothing_is_done_that_no_disk_has() -> None:
    disk = Disk()
    with EmergencyGate(store=disk) as house:
        guest = planner(house)
        disk.dead = True
        assert house.call(guest, "go-safe")["reasons"] == ["STORE_UNAVAILABLE"]
        disk.dead = False


def test_a_gate_without_a_policy_refuses() -> None:
    with DemoGate() as house:
        guest = planner(house)
        with pytest.raises(Refused, match="ACTION_OUT_OF_SCOPE"):
            guest.ask(Kind.EMERGENCY, Emergency(key="k", capability="go-safe"))


def test_an_emergency_whose_gate_died_is_unknown_once(tmp_path: Path) -> None:
    store, clock = _Kept(MemoryStore()), HandClock()
    road: dict[str, Any] = {"store": store, "clock": clock, "journal": tmp_path / "journal"}
    with EmergencyGate(at="station-103", speed_up=1, **road) as house:
        house.begin_call(planner(house), "go-safe")
        house.advance(500)
        house.crashes = True
    for _ in range(2):
        with EmergencyGate(**road) as house:
            assert house.told == [("accept", "go-safe"), ("unknown", "go-safe")]
            assert house.road.log.uses(Caller.PLANNER, "go-safe") == (0,)
            house.crashes = True


def test_a_journaled_emergency_whose_gate_died_is_in_the_log_once(tmp_path: Path) -> None:
    disk, clock = Disk(), HandClock()
    disk.close = lambda: None  # type: ignore[method-assign] - it outlives its gate
    road: dict[str, Any] = {"store": disk, "clock": clock, "journal": tmp_path / "journal"}
    with EmergencyGate(at="station-103", speed_up=1, **road) as house:
        guest = planner(house)
        disk.dead = True
        house.begin_call(guest, "go-safe")
        house.advance(500)
        house.crashes = True
    disk.dead = False
    for _ in range(2):
        with EmergencyGate(**road) as house:
            assert house.told == [("accept", "go-safe"), ("unknown", "go-safe")]
            assert house.log("emergency")[1].open["journal"] == 1
            assert house.road.log.uses(Caller.PLANNER, "go-safe") == (0,)
            house.crashes = True


def test_what_did_not_fit_the_journal_is_counted_in_the_log_once(tmp_path: Path) -> None:
    disk = Disk()
    often = {**emergency_policies.GO_SAFE, "per_hour": 60}
    with EmergencyGate(often, journal=tmp_path / "journal", store=disk) as house:
        guest = planner(house)
        disk.dead = True
        for _ in range(40):  # two records each, and there is room for 64
            assert house.call(guest, "go-safe")["execution"]["outcome"] == "succeeded"
        disk.dead = False
        house.advance(500)
        records = house.log("emergency")[1:]
        assert [r.open.get("journal") for r in records] == [*range(1, 65), None]
        assert (records[-1].link.decision, records[-1].open["lost"]) == ("counted", 16)
        house.advance(500)
        assert len(house.log("emergency")) == 66


def test_a_policy_is_in_the_log_once_until_it_changes() -> None:
    store, clock = _Kept(MemoryStore()), HandClock()
    other = emergency_policies.policy(version=2)
    for value, known in ((None, 1), (None, 1), (other, 2)):
        with EmergencyGate(store=store, clock=clock, policy=value) as house:
            found = [r for r in house.log("emergency") if r.link.decision == "policy"]
            assert len(found) == known


def test_without_a_controller_a_call_is_refused_before_anything_is_written() -> None:
    with EmergencyGate(robot=False) as house:
        guest = planner(house)
        for _ in range(20):
            answer = house.call(guest, "go-safe")
            assert (answer["outcome"], answer["reasons"]) == ("reject", ["CONTROLLER_FAILED"])
        assert (house.told, house.alerts) == ([], [])
        refused = [r for r in house.log("refusal") if r.open.get("what") == "emergency"]
        assert [r.open["reasons"] for r in refused] == [["CONTROLLER_FAILED"]]  # a row is one
        house.connect_robot()
        assert house.call(guest, "go-safe")["execution"]["outcome"] == "succeeded"


def test_a_robot_that_does_not_stand_is_sent_nowhere() -> None:
    faults = Faults(ignores_stops=True)
    with EmergencyGate(mission=worlds_mission(), faults=faults, speed_up=1) as house:
        client = planner(house)
        house.activate()
        house.begin(client, GO)
        house.advance(500)
        person = house.enter(ClientRole.OPERATOR, "nurse")
        called = house.begin_call(person, "go-safe")
        house.advance(STEP_MS)
        assert house.call(planner(house, "other"), "go-safe")["reasons"] == ["BUSY"]
        answer = house.rest(person, called)
        assert (answer["outcome"], answer["reasons"]) == ("reject", ["BUSY"])
        assert house.told == []


def test_what_was_true_before_the_robot_stood_is_asked_again() -> None:
    near = emergency_policies.guard("human_distance_mm", "ge", 2_000)
    go = {**emergency_policies.GO_SAFE, "guards": [near]}
    with EmergencyGate(go, mission=worlds_mission(), speed_up=1) as house:
        house.activate()
        house.begin(planner(house), GO)
        house.advance(500)
        person = house.enter(ClientRole.OPERATOR, "nurse")
        called = house.begin_call(person, "go-safe")
        house.robot.state = msgspec.structs.replace(house.robot.state, human_distance_mm=1_500)
        answer = house.rest(person, called)
        assert (answer["outcome"], answer["reasons"]) == ("reject", ["GUARD_FALSE"])
        assert house.told == []
        assert house.alerts == []  # an operator's is nobody's attack


def test_a_gate_that_ends_begins_nothing_and_does_not_call_by_itself() -> None:
    always = {**emergency_policies.LET_GO, "guards": [emergency_policies.TRUE]}
    with EmergencyGate(emergency_policies.GO_SAFE, {**always, "id": "mine"}) as house:
        served = house.service.emergencies
        assert served is not None
        house.advance(500)
        count = len(house.told)
        house.service.ended.set()
        assert house.call(planner(house), "go-safe")["reasons"] == ["BUSY"]
        house.advance(500)
        assert len(house.told) == count
        house.service._closing = True
        with pytest.raises(Refused, match="STOPPED"):
            house.call(planner(house, "late"), "go-safe")


def test_only_the_last_answers_and_users_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    bounded(monkeypatch, emergencies, emergency_answers=2, emergency_users=1)
    with EmergencyGate() as house:
        guest = planner(house)
        for key in ("a", "b", "c"):
            house.call(guest, "call-help", key)
        kept = house.service.emergencies
        assert kept is not None
        ((_, answers),) = kept._answers.items()
        assert [key for _, key in answers] == ["b", "c"]
        asked = emergencies._CallListener(
            name="u77.other", caller=Caller.PLANNER, capability="call-help", tell=lambda _: None
        )
        kept._judge(asked)
        assert list(kept._false) == ["u77"]


def test_an_end_that_nobody_can_write_down_is_said(tmp_path: Path) -> None:
    disk = Disk()
    with EmergencyGate(at="station-103", speed_up=1, store=disk) as house:
        guest = planner(house)
        number = house.begin_call(guest, "go-safe")
        disk.dead = True
        answer = house.rest(guest, number)
        assert answer["execution"] == {"outcome": "succeeded", "reasons": [], "recorded": False}
        house.stop(ClientRole.OPERATOR, 1)  # this cannot be held now, and is tried again
        disk.dead = False
        house.advance(300)
        assert disk.run(lambda turn: turn.get("stop", "operator"))


def test_only_an_accepted_call_can_be_begun() -> None:
    with EmergencyGate() as house:
        call = house.road.judge("fly", Caller.PLANNER, "u1.x")
        with pytest.raises(RuntimeError, match="not accepted"):
            house.road.begin(call)


def test_a_guard_that_is_false_by_the_time_it_is_on_disk_begins_nothing() -> None:
    with EmergencyGate(at="station-103") as house:
        call = house.road.judge("go-safe", Caller.PLANNER, "u1.x")
        house.clock.ms += 5_000  # a disk that took long
        ended = house.road.begin(call)
        assert isinstance(ended, EmergencyReport)
        assert ended.outcome == "not_started"
        assert ended.reasons[0].reason == "STATE_STALE"


def test_the_other_orders_leave_a_stop_standing() -> None:
    with EmergencyGate(mission=worlds_mission()) as house:
        house.activate()
        house.stop(ClientRole.OPERATOR, 1)
        person = house.enter(ClientRole.OPERATOR, "revokes")
        person.ask(Kind.ORDER, Order(act=OrderKind.COMMAND, token=house.order(Verb.REVOKE)))
        assert house.road.log.stopped


def test_one_clients_calls_push_out_nobody_elses_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else a flood of refused calls would let an operator's key be carried out a second time."""
    bounded(monkeypatch, emergencies, emergency_answers=2)
    with EmergencyGate(at="station-103", speed_up=1) as house:
        person, liar = house.enter(ClientRole.OPERATOR, "nurse"), planner(house, "liar")
        number = house.begin_call(person, "go-safe", "mine")
        for key in "abcd":
            house.call(person, "call-help", key)  # not even their own, while it is under way
            house.call(liar, "call-help", key)
        assert house.rest(person, number)["execution"]["outcome"] == "succeeded"
        for key in "efgh":
            house.call(liar, "call-help", key)
        again = house.call(person, "go-safe", "mine")
        assert (again["repeated"], again["ticket"] is not None) == (True, True)
        assert house.told == [("accept", "go-safe"), ("succeeded", "go-safe")]


# an operator's stop, whoever heard it


def stands(store: Store, clock: HandClock, *capabilities: dict[str, Any]) -> bool:
    """Return whether a gate with a policy that begins on a store holds to an operator's stop."""
    with EmergencyGate(
        *capabilities, store=store, clock=clock, at="station-103", mission=worlds_mission()
    ) as house:
        return house.call(planner(house), "go-safe")["reasons"] == ["STOPPED"]


def plain_house(store: Store, clock: HandClock) -> DemoGate:
    """Return a gate of the same robot without an emergency policy."""
    return DemoGate(
        store=store,
        clock=clock,
        site=emergency_policies.site(),
        trust=emergency_policies.trust_folder(),
        mission=worlds_mission(),
    )


@pytest.mark.parametrize("behind_ms", [0, HOUR_MS])
@pytest.mark.parametrize("active", [True, False])
def test_a_stop_that_a_gate_without_a_policy_heard_stands_at_the_next_with_one(
    active: bool, behind_ms: int
) -> None:
    store, clock = _Kept(MemoryStore()), HandClock()
    with plain_house(store, clock) as house:
        if active:
            house.activate()
        house.gate.ledger.run(lambda act: act.put("x", "y", b"z"))
        clock.wrong_ms = -behind_ms
        house.stop(ClientRole.OPERATOR, 1)
        house.crashes = True
    clock.wrong_ms = 0
    assert stands(store, clock)


def test_a_stop_that_was_recorded_while_the_gate_was_off_stands() -> None:
    store, clock = _Kept(MemoryStore()), HandClock()
    with DemoGate(store=store, clock=clock, robot=False, estimator=False, **_SITE) as house:
        house.gate.enforcer.stop(by="operator", is_planner=False, suspends=True)  # type: ignore[arg-type]
    assert stands(store, clock)


_SITE: dict[str, Any] = {
    "site": emergency_policies.site(),
    "trust": emergency_policies.trust_folder(),
}


@pytest.mark.parametrize("goes_on", ["resume", "activate", "suspend"])
def test_a_resume_alone_ends_an_operators_stop_at_a_gate_without_a_policy_too(
    goes_on: str,
) -> None:
    store, clock = _Kept(MemoryStore()), HandClock()
    with plain_house(store, clock) as house:
        if goes_on != "activate":
            house.activate()
        house.stop(ClientRole.OPERATOR, 1)
        if goes_on == "activate":
            house.activate()
        elif goes_on == "resume":
            house.gate.management.command(house.order(Verb.RESUME))
        else:
            house.gate.management.command(house.order(Verb.REVOKE))
    assert stands(store, clock) is (goes_on != "resume")


def test_others_stops_do_not_stand() -> None:
    store, clock = _Kept(MemoryStore()), HandClock()
    with plain_house(store, clock) as house:
        for number, role in enumerate((ClientRole.PLANNER, ClientRole.AUDITOR)):
            house.stop(role, number + 1)
    assert not stands(store, clock)


def test_a_stop_that_no_disk_took_stands_until_one_does(tmp_path: Path) -> None:
    disk = Disk()
    with EmergencyGate(at="station-103", store=disk, journal=tmp_path / "journal") as house:
        guest = planner(house)
        disk.dead = True
        house.stop(ClientRole.OPERATOR, 1)
        assert house.call(guest, "go-safe")["reasons"] == ["STOPPED"]
        disk.dead = False
        assert house.call(guest, "go-safe")["reasons"] == ["STOPPED"]
        assert disk.run(lambda turn: turn.get("stop", "operator"))
        disk.dead = True
        assert house.call(guest, "go-safe")["reasons"] == ["STOPPED"]  # as it last said
        disk.dead = False


# uses, over a power cut


def test_uses_of_before_a_power_cut_count_for_an_hour_from_now() -> None:
    """An idle gate commits no clock mark: the next one's clock begins where the last mark was."""
    store, clock = _Kept(MemoryStore()), HandClock()
    used = encode_fast(EmergencyStanding(uses={"go-safe": (1, 48 * HOUR_MS)}))
    with plain_house(store, clock) as house:
        clock.ms += 5_000
        house.gate.ledger.run(lambda act: act.put("emergency", "state", used))
        house.crashes = True
    twice = {**emergency_policies.GO_SAFE, "per_hour": 2}
    with EmergencyGate(twice, store=store, clock=clock, at="station-103") as house:
        for caller in Caller:  # an older gate's uses were anybody's
            uses = house.road.log.uses(caller, "go-safe")
            assert uses == (1, 5_000)  # none is still to come, none is gone
        assert house.call(planner(house), "go-safe")["reasons"] == ["RATE_EXCEEDED"]


def test_what_the_journal_had_is_told_once_when_the_store_comes_back_at_the_end(
    tmp_path: Path,
) -> None:
    disk = Disk()
    with EmergencyGate(
        at="station-103", speed_up=1, journal=tmp_path / "journal", store=disk
    ) as house:
        disk.dead = True
        call = house.road.judge("go-safe", Caller.OPERATOR, "u1.nurse")  # type: ignore[arg-type]
        begun = house.road.begin(call)
        assert isinstance(begun, EmergencyExecution)
        disk.dead = False
        house.road.ended(call, begun.lease.ticket, Outcome.ABORTED, ())
        house.advance(300)
        assert house.told == [("accept", "go-safe"), ("aborted", "go-safe")]


# what the gate calls by itself


def always(**changes: Any) -> dict[str, Any]:
    """Return a capability of the gate's own whose guards always hold."""
    return {**emergency_policies.GO_SAFE, "id": "mine", "callers": ["gate", "operator"], **changes}


def test_what_the_gate_could_not_begin_is_begun_when_its_controller_is_there() -> None:
    with EmergencyGate(always(), at="station-103", robot=False) as house:
        house.advance(5_000)
        assert (house.told, house.log("refusal")) == ([], [])
        house.connect_robot()
        house.advance(20_000)
        assert house.told == [("accept", "mine"), ("succeeded", "mine")]
        house.advance(5_000)
        assert len(house.told) == 2


def test_what_the_gate_could_not_begin_is_called_once_a_second_and_no_oftener() -> None:
    disk = Disk()
    made = EmergencyGate(always(without=["mission"]), at="station-103", store=disk)
    told: list[dict[str, Any]] = []
    road = made.service.emergencies
    assert road is not None
    road._publish = told.append
    disk.dead = True
    with made as house:
        house.advance(2_500)
        assert len([event for event in told if event["event"] == "emergency"]) == 3
        disk.dead = False
        house.advance(20_000)
        assert house.told == [("accept", "mine"), ("succeeded", "mine")]


# what `status` says


def test_status_says_that_a_stop_stands_and_what_became_of_emergencies() -> None:
    store, clock = _Kept(MemoryStore()), HandClock()
    with EmergencyGate(at="station-103", speed_up=1, store=store, clock=clock) as house:
        auditor = house.enter(ClientRole.AUDITOR)
        shown = auditor.ask(Kind.STATUS)
        assert shown["stop_stands"] is False
        assert shown["emergency"]["policy"] == "courier-emergency"
        assert (shown["emergency"]["under_way"], shown["emergency"]["unknown"]) == (None, [])
        house.begin_call(planner(house), "go-safe")
        house.advance(500)
        assert auditor.ask(Kind.STATUS)["emergency"]["under_way"] == "go-safe"
        house.stop(ClientRole.OPERATOR, 1)
        assert auditor.ask(Kind.STATUS)["stop_stands"] is True
        house.crashes = True
    with EmergencyGate(store=store, clock=clock) as house:
        shown = house.enter(ClientRole.AUDITOR).ask(Kind.STATUS)
        assert (shown["stop_stands"], shown["emergency"]["unknown"]) == (True, ["go-safe"])


def test_status_names_an_emergency_that_nobody_knows_the_end_of() -> None:
    store, clock = _Kept(MemoryStore()), HandClock()
    faults = Faults(ignores_stops=True)
    with EmergencyGate(
        at="station-103", speed_up=1, store=store, clock=clock, faults=faults
    ) as house:
        auditor, guest = house.enter(ClientRole.AUDITOR), planner(house)
        number = house.begin_call(guest, "go-safe")
        house.advance(500)
        house.stop(ClientRole.OPERATOR, 1)
        house.robot.state = msgspec.structs.replace(house.robot.state, battery_permille=1_001)
        assert house.rest(guest, number)["execution"]["outcome"] == "unknown"
        assert auditor.ask(Kind.STATUS)["emergency"]["unknown"] == ["go-safe"]
        house.crashes = True
