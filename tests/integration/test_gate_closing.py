# SPDX-License-Identifier: Apache-2.0
"""A mission that has done its work closes: it may go home, and do nothing else, until it is over.

Real processes: gate, stop lane, robot, estimator. A mission closes by its last success, never by an
order. In each test here it is closing while its robot moves; each ends it in another way and looks
at the registry, the log and the robot.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from typing import Any

import pytest

from authguard_r.client import GateClient
from authguard_r.core.errors import RefusedError
from authguard_r.core.mission import Mission
from authguard_r.core.standing import Outcome
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.wire.messages import ClientRole, Kind, Propose
from fixtures import scenarios
from fixtures.gate_process import Line, RunningGate, Told, order, shown, until
from integration.test_gate_watching import FAST, connected, operator, sensors, speed, stands

SCAN = b"scan()"
#: What the closing grant allows; slow enough to be under way for as long as a test wants.
HOME = b'navigate_to(destination="Corridor", speed=0.05)'
HOME_FAST = b'navigate_to(destination="Corridor", speed=0.8)'
#: What the mission allows before it closes.
LEAVE = b'navigate_to(destination="Pharmacy", speed=0.8)'
#: The robot is in its dock, well off the door.
IN_DOCK_MM = 35_000
NUMBER = count(1)


def drafted(gate: RunningGate, **changes: Any) -> Mission:
    """Return a mission that closes with its one scan and may then go home."""
    grants = {grant["id"]: grant for grant in scenarios.draft()["grants"]}
    regions = ["dock", "pharmacy", "public-corridor"]

    def way(name: str, destination: str, **more: Any) -> dict[str, Any]:
        row = {"source": "dock", "destination": destination, "regions": regions}
        return {**grants["go-to-pharmacy"], "id": name, "rows": [row], "until": [], **more}

    return gate.mission(
        mission=f"closing-{next(NUMBER)}",
        grants=[
            {**grants["look-out"], "completes": True, "repeat": 1, "starts": 2},
            way("leave", "pharmacy"),
            way("go-home", "public-corridor", after=["look-out"]),
        ],
        **{"closing": {"grants": ["go-home"], "for": "10 min"}, **changes},
    )


class Going:
    """A robot that moves in a mission that is closing.

    Args:
        gate: a gate without an active mission.
        plan: where it goes.
        changes: of the mission's draft.
    """

    def __init__(self, gate: RunningGate, plan: bytes = HOME, **changes: Any) -> None:
        self.gate = gate
        self.mission = drafted(gate, **changes)
        self.digest = gate.activate(gate.token(self.mission))["digest"]
        with operator(gate) as person:  # the state is the robot's own, and new
            until(lambda: accepted(person.evaluate(LEAVE)["steps"][0]), "a robot in its dock")
        assert propose(gate, SCAN)["execution"]["outcome"] == "succeeded"
        self.line = Line(gate.socket).hello(ClientRole.PLANNER, f"goes-{next(NUMBER)}")
        self.go(plan)

    def go(self, plan: bytes) -> None:
        """Set out, by the closing grant."""
        key = f"home-{next(NUMBER)}"
        self.line.say(Kind.PROPOSE, Propose(key=key, plan=plan, dialect="auto"))
        step = self.line.told(Kind.EVENT)
        assert step["released"] is True
        self.ticket = step["ticket"]
        with sensors(self.gate) as seen:
            seen.until(lambda s: speed(s) > 0)

    def ended(self) -> dict[str, Any]:
        """Return how it went, once it has ended."""
        (step,) = self.line.told(Kind.REPLY)["steps"]
        execution: dict[str, Any] = step["execution"]
        return execution

    def aborted(self) -> list[str]:
        """Return why it was stopped; the robot stands, and the log has it."""
        execution = self.ended()
        assert (execution["outcome"], execution["recorded"]) == ("aborted", True)
        stands(self.gate)
        (record,) = self.outcomes()
        assert record.decision == "aborted"
        return record.reasons

    def outcomes(self) -> list[Told]:
        """Return what the log has of its end."""
        found = [r for r in self.gate.records() if r.kind == "outcome"]
        return [r for r in found if r.open["ticket"] == self.ticket]

    def order(self, verb: Verb, **more: Any) -> dict[str, Any]:
        """Give a signed order; return the standing after it."""
        with operator(self.gate) as person:
            return person.command(order(self.gate, self.mission, self.digest, verb, **more))

    def refused(self, verb: Verb) -> None:
        """An order that is impossible, and changes nothing."""
        before = self.status
        with pytest.raises(RefusedError, match="TRANSITION_REFUSED"):
            self.order(verb)
        assert self.status == before

    @property
    def status(self) -> str | None:
        """Where the mission is in its life; None when no mission is named active."""
        with operator(self.gate) as person:
            mission = person.status()["mission"]
        return None if mission is None else str(mission["status"])

    @property
    def leases(self) -> int:
        """How many actions are under way."""
        with operator(self.gate) as person:
            return len(person.status()["leases"])


def accepted(step: dict[str, Any]) -> bool:
    return bool(step["outcome"] == "accept")


def propose(gate: RunningGate, plan: bytes) -> dict[str, Any]:
    with gate.client(ClientRole.PLANNER, f"asks-{next(NUMBER)}") as planner:
        step: dict[str, Any] = planner.propose(plan)["steps"][0]
    return step


def reasons(gate: RunningGate, plan: bytes) -> list[str]:
    """Return why a plan is refused, once there is state of now; nothing of it is released."""

    def refused() -> dict[str, Any] | None:
        step = propose(gate, plan)
        assert (step["outcome"], step["released"]) == ("reject", False)
        return None if "STATE_BEFORE_MOTION" in step["reasons"] else step

    return list(until(refused, "a refusal on state of now")["reasons"])


def what_if(gate: RunningGate, plan: bytes) -> list[str]:
    with operator(gate) as person:
        return list(person.evaluate(plan)["steps"][0]["reasons"])


@contextmanager
def going(gate: RunningGate, plan: bytes = HOME, **changes: Any) -> Iterator[Going]:
    with sensors(gate) as seen:
        parked = seen.next().pose.x_mm >= IN_DOCK_MM
    if not parked:
        gate.stop_process("robot")
        gate.start_robot(*FAST)
    with shown(gate):
        made = Going(gate, plan, **changes)
        try:
            yield made
        finally:
            made.line.close()


@pytest.fixture(scope="module")
def gate() -> Iterator[RunningGate]:
    with RunningGate(robot=FAST, estimator=True, refusals=0, fold_ms=0) as running:
        yield running


def test_it_cannot_wait_and_an_order_that_completes_it_ends_the_motion(gate: RunningGate) -> None:
    with going(gate) as home:
        home.refused(Verb.SUSPEND)
        home.refused(Verb.RESUME)
        assert home.leases == 1
        assert home.order(Verb.COMPLETE)["status"] == "completed"
        assert home.aborted() == ["MISSION_COMPLETED"]
        home.refused(Verb.RESUME)
        home.refused(Verb.COMPLETE)
        assert reasons(gate, HOME) == ["NO_ACTIVE_MISSION"]


def test_an_operators_stop_completes_it_and_nobody_resumes_it(gate: RunningGate) -> None:
    with going(gate) as home:
        gate.mark()
        with GateClient.connect(gate.stop_socket, role=ClientRole.OPERATOR, client="hand") as hand:
            assert hand.stop("enough")["stopped"] is True
        assert set(home.aborted()) <= {"STOPPED", "MISSION_COMPLETED"}
        until(lambda: home.status == "completed", "the mission's end")
        (record,) = [r for r in gate.news() if r.kind == "management"]
        said = {"verb": "complete", "by": "stop", "status": "completed"}
        assert {name: record.open[name] for name in said} == said
        home.refused(Verb.RESUME)
        assert reasons(gate, HOME)[0] == "MISSION_COMPLETED"
        assert reasons(gate, LEAVE)[0] == "MISSION_COMPLETED"


def test_a_planners_stop_ends_the_motion_alone_and_it_may_set_out_again(gate: RunningGate) -> None:
    with going(gate) as home:
        gate.mark()
        with GateClient.connect(gate.stop_socket, role=ClientRole.PLANNER, client="shy") as shy:
            assert shy.stop()["stopped"] is True
        assert home.aborted() == ["STOPPED"]
        assert home.status == "closing"
        until(lambda: [r for r in gate.news() if r.kind == "stop"], "that the gate heard of it")
        home.go(HOME)
        assert home.order(Verb.REVOKE)["status"] == "revoked"
        assert home.aborted() == ["REVOKED"]
        assert home.status is None


def test_what_set_out_in_time_goes_on_until_the_next_mission_takes_its_place(
    gate: RunningGate,
) -> None:
    with going(gate, closing={"grants": ["go-home"], "for": "2 s"}) as home:
        assert home.mission.closing is not None
        until(lambda: "GRANT_CLOSED" in what_if(gate, HOME), "the end of its time")
        assert (home.status, home.leases) == ("closing", 1)
        gate.mark()
        after = drafted(gate)
        active = gate.activate(gate.token(after))
        assert active["status"] == "active"
        assert home.aborted() == ["MISSION_COMPLETED"]
        lapsed, _, activated, *_ = [r for r in gate.news() if r.kind == "management"]
        assert (lapsed.open["verb"], lapsed.open["status"]) == ("lapse", "completed")
        assert activated.open["verb"] == "activate"
        with operator(gate) as person:
            assert person.status()["mission"]["mid"] == after.mid
            person.command(order(gate, after, active["digest"], Verb.COMPLETE))


def test_a_killed_gate_finds_it_closing_and_what_was_under_way_used(gate: RunningGate) -> None:
    with going(gate) as home:
        before = home.ticket
        gate.kill9()
        stands(gate)  # the controller's own watch
        gate.start_gate()
        until(lambda: connected(gate), "the controller's return")
        until(lambda: recoveries(gate), "the recovery")
        assert recoveries(gate)[-1] == {
            "verb": "recover",
            "status": "closing",
            "unknown": 1,
            "unclean": True,
        }
        with operator(gate) as person:
            status = person.status()["mission"]
        assert (status["status"], status["open"]) == ("closing", [before])
        # not suspended, and not new: nothing but its closing grant, of which one may be under way
        home.refused(Verb.RESUME)
        home.refused(Verb.SUSPEND)
        assert reasons(gate, LEAVE) == ["GRANT_CLOSED"]
        assert reasons(gate, HOME) == ["REPEAT_EXHAUSTED"]
        standing = home.order(Verb.RESOLVE, ticket=before, outcome=Outcome.ABORTED)
        assert (standing["status"], standing.get("open", [])) == ("closing", [])
        with Line(gate.socket).hello(ClientRole.PLANNER, "again") as line:
            home.line.close()
            home.line = line
            home.go(HOME)
            assert home.order(Verb.COMPLETE)["status"] == "completed"
            assert home.aborted() == ["MISSION_COMPLETED"]
        assert home.status is None


def recoveries(gate: RunningGate) -> list[dict[str, Any]]:
    return [r.open for r in gate.records() if r.decision == "recover"]


@pytest.mark.smoke
def test_while_it_goes_home_nothing_else_is_begun_and_it_arrives(gate: RunningGate) -> None:
    with going(gate, HOME_FAST) as home:
        assert home.status == "closing"
        gate.mark()
        assert reasons(gate, LEAVE) == ["GRANT_CLOSED"]
        assert reasons(gate, SCAN)[0] == "GRANT_CLOSED"
        with pytest.raises(RefusedError, match="TRANSITION_REFUSED"):
            gate.activate(gate.token(drafted(gate)))
        assert home.leases == 1  # all of this was during the motion, and did nothing to it
        assert home.ended()["outcome"] == "succeeded"
        assert home.status == "closing"
        assert home.order(Verb.COMPLETE)["status"] == "completed"
        assert home.status is None
        assert reasons(gate, HOME) == ["NO_ACTIVE_MISSION"]
        assert [r.decision for r in gate.news() if r.decision == "accept"] == []
