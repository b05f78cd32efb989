# SPDX-License-Identifier: Apache-2.0
"""Signed orders count by when they were signed, not by when they arrive (lesson L24).

A gate as a process, with the symbolic robot in it. Spec page: docs/spec/standing.md#commands
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from authguard_r.approvals import Selection
from authguard_r.cli import call
from authguard_r.client import GateClient
from authguard_r.core.encoding import Tag, b64
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.mission import Mission
from authguard_r.core.token import sign_object
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.keys.signer import folder_signer
from authguard_r.safety import default_config as default_safety
from authguard_r.wire.messages import ClientRole
from fixtures import emergency_policies, scenarios
from fixtures.gate_process import RunningGate, order, until
from integration.test_gate_emergency import Ward, policy_now
from integration.test_gate_watching import FAST, connected, operator

DAY_MS = 86_400_000
SCAN = b"scan()"


@pytest.fixture
def gate() -> Iterator[RunningGate]:
    with RunningGate(robot=FAST, estimator=True, refusals=0) as running:
        yield running


class Active:
    """An active mission, and orders about it that are signed now and handed in whenever."""

    def __init__(self, gate: RunningGate, **changes: Any) -> None:
        self.gate = gate
        self.mission: Mission = gate.mission(**changes)
        self.digest = gate.activate(gate.token(self.mission), resumes=False)["digest"]

    def signed(self, verb: Verb, **more: Any) -> bytes:
        return order(self.gate, self.mission, self.digest, verb, **more)

    def hand_in(self, token: bytes) -> str:
        """Hand an order in; return the mission's status, or why it was refused."""
        with operator(self.gate) as person:
            try:
                return str(person.command(token)["status"])
            except AuthGuardError as refused:
                return str(refused.reason)

    def choice(self, grant: str, row: int) -> bytes:
        now_ms = time.time_ns() // 1_000_000
        selection = Selection(
            mid=self.mission.mid,
            version=self.mission.version,
            mission=self.digest,
            grant=grant,
            row=row,
            nonce=b64(scenarios.random_bytes(16)),
            expires_ms=now_ms + 60_000,
            issued_ms=now_ms,
        )
        time.sleep(0.002)  # the next one is signed later
        return sign_object(selection, Tag.SELECTION, folder_signer(self.gate.trust, "operator-1"))

    def choose(self, token: bytes) -> str:
        """Hand a choice in; return the row that counts, or why it was refused."""
        with operator(self.gate) as person:
            try:
                return str(person.select(token)["selected"])
            except AuthGuardError as refused:
                return str(refused.reason)

    def stopped(self) -> None:
        """Stop the robot as an operator does, and wait until the mission is suspended."""
        with GateClient.connect(self.gate.stop_socket, role=ClientRole.OPERATOR) as hand:
            until(lambda: hand.stop("enough")["stopped"], "the robot's word that it stands")

        def is_suspended() -> bool:
            with operator(self.gate) as person:
                return bool(person.status()["mission"]["status"] == "suspended")

        until(is_suspended, "the suspension")


@pytest.mark.smoke
def test_l24_a_resume_that_was_signed_before_a_stop_ends_no_stop(gate: RunningGate) -> None:
    active = Active(gate)
    before = active.signed(Verb.RESUME)
    active.stopped()
    assert active.hand_in(before) == "ORDER_TOO_OLD"
    assert active.hand_in(active.signed(Verb.RESUME)) == "active"


def test_a_resume_that_was_signed_before_a_suspension_ends_none(gate: RunningGate) -> None:
    active = Active(gate)
    before = active.signed(Verb.RESUME)
    time.sleep(0.002)
    assert active.hand_in(active.signed(Verb.SUSPEND)) == "suspended"
    assert active.hand_in(before) == "ORDER_TOO_OLD"


def test_a_suspension_that_was_signed_before_a_resume_suspends_nothing(gate: RunningGate) -> None:
    active = Active(gate)
    assert active.hand_in(active.signed(Verb.SUSPEND)) == "suspended"
    late = active.signed(Verb.SUSPEND)
    time.sleep(0.002)
    assert active.hand_in(active.signed(Verb.RESUME)) == "active"
    assert active.hand_in(late) == "ORDER_TOO_OLD"


@pytest.mark.parametrize(("verb", "status"), [("complete", "completed"), ("revoke", "revoked")])
def test_an_end_that_was_signed_before_a_resume_ends_nothing(
    gate: RunningGate, verb: str, status: str
) -> None:
    active = Active(gate)
    late = active.signed(Verb(verb))
    time.sleep(0.002)
    assert active.hand_in(active.signed(Verb.SUSPEND)) == "suspended"
    time.sleep(0.002)
    assert active.hand_in(active.signed(Verb.RESUME)) == "active"
    assert active.hand_in(late) == "ORDER_TOO_OLD"
    time.sleep(0.002)
    assert active.hand_in(active.signed(Verb(verb))) == status


def test_a_newer_suspension_of_what_is_suspended_counts(gate: RunningGate) -> None:
    active = Active(gate)
    assert active.hand_in(active.signed(Verb.SUSPEND)) == "suspended"
    time.sleep(0.002)
    between = active.signed(Verb.RESUME)
    time.sleep(0.002)
    assert active.hand_in(active.signed(Verb.SUSPEND)) == "suspended"
    assert active.hand_in(between) == "ORDER_TOO_OLD"
    assert active.hand_in(active.signed(Verb.RESUME)) == "active"


def test_an_order_without_a_time_may_suspend_and_resumes_nothing(gate: RunningGate) -> None:
    active = Active(gate)
    assert active.hand_in(active.signed(Verb.SUSPEND, issued_ms=0)) == "suspended"
    assert active.hand_in(active.signed(Verb.RESUME, issued_ms=0)) == "ORDER_TOO_OLD"


def test_l24_of_two_choices_the_one_that_was_signed_later_counts(gate: RunningGate) -> None:
    grants = [{**g, "chooser": "operator"} for g in scenarios.draft()["grants"]]
    active = Active(gate, grants=grants)
    older, newer = active.choice("go-to-pharmacy", 1), active.choice("go-to-pharmacy", 0)
    assert active.choose(newer) == "{'go-to-pharmacy': 0}"
    assert active.choose(older) == "ORDER_TOO_OLD"


def test_an_activation_under_an_operators_stop_waits_for_a_resume(gate: RunningGate) -> None:
    first = Active(gate)
    first.stopped()
    assert first.hand_in(first.signed(Verb.COMPLETE)) == "completed"
    second = Active(gate, mission="another")
    with operator(gate) as person:
        assert person.status()["mission"]["status"] == "suspended"
    with gate.client(ClientRole.PLANNER) as planner:
        assert planner.propose(SCAN)["steps"][0]["reasons"][0] == "MISSION_SUSPENDED"
    assert second.hand_in(second.signed(Verb.RESUME)) == "active"


def test_an_order_is_good_for_a_day_and_is_not_of_the_time_to_come(gate: RunningGate) -> None:
    active, now_ms = Active(gate), time.time_ns() // 1_000_000
    long = active.signed(Verb.SUSPEND, expires_ms=now_ms + DAY_MS + 60_000)
    assert active.hand_in(long) == "VALUE_OUT_OF_RANGE"
    ahead = now_ms + 60_000  # by a clock that is wrong: it narrows, and is taken all the same
    assert active.hand_in(active.signed(Verb.SUSPEND, issued_ms=ahead)) == "suspended"
    assert active.hand_in(active.signed(Verb.RESUME, issued_ms=ahead)) == "NOT_YET_VALID"
    assert active.hand_in(active.signed(Verb.RESUME)) == "active"


@pytest.mark.smoke
def test_a_gate_does_not_start_under_a_configuration_that_is_older_than_one_before() -> None:
    with RunningGate(robot=FAST, estimator=True, version=5) as gate:
        gate.restart()
        gate.configure(msgspec.structs.replace(gate.config, version=7, state_wait_ms=1_000))
        gate.restart()
        told = [record for record in gate.records() if record.decision == "configuration"]
        assert [(r.open["part"], r.open["version"]) for r in told] == [("gate", 7)]
        gate.stop_process("gate")
        gate.configure(msgspec.structs.replace(gate.config, version=6))
        with pytest.raises(AssertionError, match="SUPERSEDED"):
            gate.start_gate()


class Configured(Ward):
    """A gate with a safety configuration and an emergency policy that are signed anew at will."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, robot=FAST)
        self.safety: Path | None = folder / "safety.token"
        self.has_emergency = True
        shutil.copy(self.binding, folder / "binding.yaml")
        self.binding = folder / "binding.yaml"
        self.sign_safety(5)
        self.sign_emergency(3)

    def sign_safety(self, version: int, **changes: Any) -> None:
        """Sign a safety configuration; it counts from the next start."""
        plain = default_safety(emergency_policies.site(), self.rid)
        config = msgspec.structs.replace(plain, version=version, **changes)
        officer = folder_signer(self.trust, "safety-officer-1")
        self.safety = self.folder / "safety.token"
        self.safety.write_bytes(sign_object(config, Tag.SAFETY, officer))

    def sign_emergency(self, version: int, **changes: Any) -> None:
        """Sign an emergency policy; it counts from the next start."""
        self.has_emergency = True
        self.policy.write_bytes(emergency_policies.token(policy_now(version=version, **changes)))

    def start_gate(self, *more: str) -> dict[str, Any]:
        safety = () if self.safety is None else ("--safety", str(self.safety))
        if self.has_emergency:
            return super().start_gate(*safety, *more)
        return RunningGate.start_gate(self, *safety, *more)

    def changes(self) -> list[tuple[str, int]]:
        """Return the part and the version of each change that the log holds."""
        found = [record for record in self.records() if record.decision == "configuration"]
        return [(record.open["part"], record.open["version"]) for record in found]

    def step(self, plan: bytes) -> dict[str, Any]:
        """Return what becomes of a plan of one step, once there is a robot and state of it."""

        def answer() -> dict[str, Any] | None:
            with self.client(ClientRole.PLANNER) as planner:
                step: dict[str, Any] = planner.propose(plan)["steps"][0]
            early = {"STATE_MISSING", "STATE_STALE", "STATE_BEFORE_MOTION", "CONTROLLER_FAILED"}
            return None if early & set(step["reasons"]) else step

        until(lambda: connected(self), "the controller's return")
        found: dict[str, Any] = until(answer, "a decision")
        return found


@pytest.fixture
def configured(tmp_path: Path) -> Iterator[Configured]:
    with Configured(tmp_path) as running:
        yield running


AS_BEFORE, UNSIGNED = "version {} was another one before", "got none that is signed"
#: What takes the place of what was in force: which part it is, what the gate says of it, and it.
OLDER: tuple[tuple[str, str, Callable[[Configured], object]], ...] = (
    ("safety", "got version 4", lambda gate: gate.sign_safety(4)),
    ("emergency", "got version 2", lambda gate: gate.sign_emergency(2)),
    ("safety", AS_BEFORE.format(5), lambda gate: gate.sign_safety(5, max_speed_mm_s=1_400)),
    ("emergency", AS_BEFORE.format(3), lambda gate: gate.sign_emergency(3, id="another")),
    ("safety", UNSIGNED, lambda gate: setattr(gate, "safety", None)),
    ("emergency", UNSIGNED, lambda gate: setattr(gate, "has_emergency", False)),
)


def test_a_gate_does_not_start_under_an_older_safety_configuration_or_emergency_policy(
    configured: Configured,
) -> None:
    gate = configured
    safety, emergency = gate.folder / "safety.token", gate.policy
    inforce = (safety.read_bytes(), emergency.read_bytes())
    before = gate.changes()
    gate.stop_process("gate")
    for part, why, older in OLDER:
        older(gate)
        with pytest.raises(AssertionError, match=f"SUPERSEDED.*{why}.*{part}.version"):
            gate.start_gate()
        gate.stop_process("gate")
        gate.safety, gate.has_emergency = safety, True
        safety.write_bytes(inforce[0])
        emergency.write_bytes(inforce[1])
    gate.start_gate()  # under what was in force
    assert gate.changes() == before


def test_each_configuration_that_changed_is_recorded_and_a_replay_goes_by_it(
    configured: Configured, capsys: pytest.CaptureFixture[str]
) -> None:
    gate = configured
    token = gate.token(gate.mission())
    gate.activate(token)
    assert gate.step(SCAN)["execution"]["outcome"] == "succeeded"
    first = gate.changes()
    gate.restart()  # nothing has changed
    assert gate.changes() == first
    gate.stop_process("gate")
    gate.sign_safety(7, max_speed_mm_s=300)
    gate.sign_emergency(8)
    old = gate.binding.read_text()
    gate.binding.write_text(old.replace("id: courier-tools", "id: courier-tools-2"))
    gate.start_gate()
    assert gate.changes() == [*first, ("binding", 0), ("emergency", 8), ("safety", 7)]
    fast = gate.step(b'navigate_to(destination="Pharmacy", speed=0.8)')
    assert (fast["outcome"], fast["released"]) == ("accept", False)
    gate.stop_process("gate")
    gate.binding.write_text(old)  # it has no version: a change back is one more change
    gate.start_gate()
    assert gate.changes()[-1] == ("binding", 0)
    assert gate.step(SCAN)["execution"]["outcome"] == "succeeded"
    told = [record for record in gate.records() if record.open.get("part") == "binding"]
    assert told[-1].open["digest"] == told[-2].open["was"]
    gate.stop_process("gate")
    assert call(["audit", "replay", str(gate.store), "--trust", str(gate.trust), "--json"]) == 0
    replayed = json.loads(capsys.readouterr().out)
    decided = [record for record in gate.records() if record.kind == "decision"]
    assert (replayed["whole"], replayed["agree"]) == (True, len(decided))
    hazards = [record.open["safety"]["hazards"] for record in decided if record.reasons == []]
    assert [found for found in hazards if found] == [["SPEED"]]
