# SPDX-License-Identifier: Apache-2.0
"""Signed orders count by when they were signed, not by when they arrive (lesson L24).

A gate as a process, with the symbolic robot in it. Spec page: docs/spec/standing.md#commands
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest

from authguard_r.approvals import Selection
from authguard_r.assembly import folder_signer
from authguard_r.client import GateClient
from authguard_r.commands import Verb
from authguard_r.core.encoding import Tag, b64
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.mission import Mission
from authguard_r.core.token import sign_object
from authguard_r.wire.messages import ClientRole
from fixtures import scenarios
from fixtures.gate_process import RunningGate, order, until
from integration.test_gate_watching import FAST, operator

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
