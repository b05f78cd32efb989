# SPDX-License-Identifier: Apache-2.0
"""Faults seen in other projects that guard robots; each is refused by a gate that runs.

One test for one lesson, named after it; the numbers are those of the project's list of lessons.
"""

from __future__ import annotations

import ast
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from authguard_r.access.gate_config import Peer
from authguard_r.client import GateClient
from authguard_r.core.encoding import Tag, b64
from authguard_r.core.errors import AuthenticityError, AuthGuardError, MalformedError, RefusedError
from authguard_r.core.reasons import Reason
from authguard_r.core.token import sign_object
from authguard_r.enforcement.enforcer import Enforcer
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.keys.signer import folder_signer
from authguard_r.sim.robot import snapshot_of
from authguard_r.wire.messages import MAY, Attest, ClientRole, Kind, Propose
from fixtures import scenarios
from fixtures.gate_process import Line, RunningGate, order, until

pytestmark = pytest.mark.smoke

SRC = scenarios.ROOT / "src"
SCAN = b"scan()"
#: A way that the mission grants; refused as a what-if or as nonsense, carried out as a proposal.
GO = (scenarios.HOSPITAL / "replies" / "01-collect.json").read_bytes()
NOBODY = b64(bytes(32))

#: A request of every kind that may come, but for `PROPOSE`.
ASKED: dict[Kind, Any] = {
    Kind.OBSERVE: {"channel": "camera", "text": "go to the pharmacy"},
    Kind.SAMPLE: {"ticket": NOBODY, "params": {"linear_mm_s": 500}},
    Kind.CLOSE: {"ticket": NOBODY},
    Kind.EMERGENCY: {"key": "k", "capability": "go-safe"},  # no policy is here
    Kind.SNAPSHOT: Attest(token=b"{}"),
    Kind.ORDER: {"act": "activate", "token": ""},
    Kind.EVALUATE: {"plan": "c2NhbigpCg=="},
    Kind.STATUS: {},
    Kind.RECORDS: {"first": 0},
    Kind.WATCH: {},
    Kind.METRICS: {},
    Kind.EXPLAIN: {},
    Kind.APPROVALS: {},
    Kind.BEGUN: {"ticket": NOBODY},
    Kind.ENDED: {"ticket": NOBODY, "outcome": "succeeded"},
    Kind.STOOD: {"stops": 1},
    Kind.RESULT: {"ticket": NOBODY, "content": "", "texts": ["go to the pharmacy"]},
}
#: What the enforcer does for effect, and whether it can begin a motion.
VERBS = {
    "require": False,
    "propose": True,
    "refuse_plan": False,
    "settle_stops": False,
    "stop": False,
    "stopped": False,
    "submit": True,
}
#: Nothing that a stop may ever wait for.
NOT_FOR_STOPS = (
    "approvals",
    "authoring",
    "core.decide",
    "enforcement",
    "operations",
    "safety",
    "server",
    "sim",
    "store",
)


@cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def places(name: str) -> set[str]:
    """Return the modules of the gate that say `.NAME`, as `package.module`."""
    return {
        ".".join(path.relative_to(SRC / "authguard_r").with_suffix("").parts)
        for path in (SRC / "authguard_r").rglob("*.py")
        for node in ast.walk(tree(path))
        if isinstance(node, ast.Attribute) and node.attr == name
    }


def imported(module: str) -> set[str]:
    """Return every module that a fresh process holds after it imported one."""
    asked = f"import sys, {module}; print(*sys.modules)"
    told = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True)
    return set(told.stdout.split())


@pytest.fixture
def lane() -> Iterator[RunningGate]:
    """A gate with its stop lane and no robot; planners may not stop here."""
    peers = (
        Peer(uid=os.geteuid(), roles=tuple(r for r in sorted(MAY) if r not in {"gate", "planner"})),
    )
    with RunningGate(peers=peers) as gate:
        yield gate


def test_l1_every_kind_of_request_but_a_proposal_begins_nothing_and_a_proposal_takes_the_road() -> (
    None
):
    assert {*ASKED, Kind.PROPOSE, Kind.STOP} == {
        k for r, m in MAY.items() if r != "gate" for k in m
    }
    with RunningGate() as gate:
        gate.activate(gate.token(gate.mission(guards=[], place_max_age="10 min")))
        seen = snapshot_of(scenarios.world(), robot=scenarios.RID, epoch=1, seq=1)
        state = sign_object(seen, Tag.STATE, folder_signer(gate.trust, "estimator-courier-1"))
        lines = {role: Line(gate.socket).hello(role) for role in MAY if role is not ClientRole.GATE}
        robot, planner = lines[ClientRole.CONTROLLER], lines[ClientRole.PLANNER]
        lines[ClientRole.ESTIMATOR].say(Kind.SNAPSHOT, Attest(token=state))
        lines[ClientRole.ESTIMATOR].told(Kind.REPLY)
        for role, line in lines.items():
            for number, kind in enumerate(sorted(MAY[role] - {Kind.PROPOSE, Kind.STOP}), 1):
                line.say(kind, ASKED[kind], number)
                got = None if line is robot else line.next()
                assert got is None or (got.id == number and b"INTERNAL_FAULT" not in got.body)
        planner.say(Kind.PROPOSE, Propose(key="k", plan=SCAN), 9)
        first = robot.told(Kind.DISPATCH)  # nothing at all came before it
        (accepted,) = [r for r in gate.records() if r.kind == "decision"]
        assert (accepted.decision, accepted.open["ticket"]) == ("accept", first["ticket"])
        robot.say(Kind.BEGUN, {"ticket": first["ticket"]})
        robot.say(Kind.ENDED, {"ticket": first["ticket"], "outcome": "succeeded"})
        assert planner.told(Kind.EVENT)["ticket"] == first["ticket"]
        assert planner.told(Kind.REPLY)["steps"][0]["execution"]["outcome"] == "succeeded"
        for role in (r for r, may in MAY.items() if Kind.STOP in may):
            lines[role].say(Kind.STOP, {}, 99)
            heard = iter(robot.next, None)
            assert next(f.kind for f in heard if f.kind is not Kind.RENEW) is Kind.HALT
        for line in lines.values():
            line.close()


def test_l1_one_place_dispatches_and_one_forwards_what_it_checked() -> None:
    assert {m for m in places("dispatch") if not m.startswith("sim")} == {
        "enforcement.enforcer",
        "enforcement.emergency_enforcer",
    }
    assert {m for m in places("forward") if not m.startswith("sim")} == {"server.streams"}
    assert {m for m in places("DISPATCH") if m.startswith("server")} == {"server.remote_controller"}
    assert {m for m in places("FORWARD") if m.startswith("server")} == {"server.remote_controller"}


def test_l1_every_verb_of_the_enforcer_that_begins_a_motion_goes_down_the_road() -> None:
    assert {name for name in vars(Enforcer) if not name.startswith("_")} == set(VERBS)
    sim = scenarios.simulation()
    sim.gate.management.activate(scenarios.token())
    enforcer = sim.gate.enforcer
    enforcer.stop(by="anybody", is_planner=False)
    enforcer.stopped(by="anybody", is_planner=True, why="go to the pharmacy")
    enforcer.require(lambda: None)
    assert enforcer.settle_stops() is True
    enforcer.refuse_plan(MalformedError("no plan"), planner="planner", inputs={"plan": "scan()"})
    assert sim.robot.trace == []
    assert scenarios.propose(sim, scenarios.navigate("dock", "office-1")).outcome is None
    assert sim.robot.trace == []  # refused
    report = scenarios.propose(sim, scenarios.navigate("dock", "pharmacy"))
    assert report.judged is not None
    assert report.judged.released
    enforcer.stopping.hold()
    assert len(sim.robot.trace) == 1
    sim.gate.close()


def test_l8_errors_and_refused_requests_are_in_the_log(lane: RunningGate) -> None:
    lane.mark()
    with pytest.raises(AuthenticityError):
        lane.client(ClientRole.PLANNER, "forged")
    with lane.client(ClientRole.OPERATOR, "asks") as person, pytest.raises(MalformedError):
        person.activate(b"{}")
    with lane.client(ClientRole.ESTIMATOR, "state") as state, pytest.raises(AuthGuardError):
        state.attest(b"{}")
    with Line(lane.socket) as line:
        line.send(b"\xff" * 9)
        line.dropped()
    uid = f"u{os.geteuid()}"
    wanted = {(uid, "ROLE_DENIED"), (f"{uid}.asks", "MALFORMED")}
    wanted |= {(f"{uid}.state", "MALFORMED"), (uid, "MALFORMED")}

    def told() -> bool:
        return wanted <= {
            (r.open.get("client", ""), reason) for r in lane.news() for reason in r.reasons
        }

    until(told, "a record of each refusal")
    assert any(r.kind == "intake" for r in lane.news())


def test_l8_a_stop_that_nobody_confirmed_and_one_that_was_refused_are_written_down(
    lane: RunningGate,
) -> None:
    lane.mark()
    late = {"role": ClientRole.OPERATOR, "client": "late", "timeout_ms": 1_500}
    stop = GateClient.connect(lane.stop_socket, **late)
    with stop:
        assert stop.stop("nobody is there")["stopped"] is False

    def news(kind: str) -> list[Any]:
        return [record for record in lane.news() if record.kind == kind]

    (record,) = until(lambda: news("stop"), "the record of the stop")
    assert record.open["by"] == f"u{os.geteuid()}.late"
    assert record.open["stood_ms"] == -1
    assert record.sealed["why"] == "nobody is there"
    (alert,) = until(lambda: news("alert"), "the alert")
    assert alert.open["what"] == "a stop was not confirmed"
    with pytest.raises(AuthenticityError):
        GateClient.connect(lane.stop_socket, role=ClientRole.PLANNER, client="forged")
    said = lane.run / "stop-lane.log"
    until(lambda: "ROLE_DENIED" in said.read_text(), "the lane's word on whom it refused")


def test_l14_what_came_once_does_not_come_again_after_a_crash() -> None:
    with RunningGate(robot=("--speed-up", "20"), estimator=True) as gate:
        mission = gate.mission()
        token = gate.token(mission)
        digest = gate.activate(token)["digest"]
        with gate.client(ClientRole.PLANNER, "llm") as planner:
            first = planner.propose(SCAN, key="once")
        with gate.client(ClientRole.ESTIMATOR, "again") as state:
            seen = snapshot_of(scenarios.world(), robot=scenarios.RID, epoch=1, seq=1)
            signer = folder_signer(gate.trust, "estimator-courier-1")
            old = sign_object(seen, Tag.STATE, signer)
            with pytest.raises(AuthGuardError, match="STATE_REPLAYED"):
                state.attest(old)  # an epoch of long ago
        gate.kill9()
        gate.start_gate()
        with gate.client(ClientRole.OPERATOR, "waits") as person:
            until(lambda: person.status()["mission"]["status"] == "suspended", "the recovery")
        resume = order(gate, mission, digest, Verb.RESUME)
        with gate.client(ClientRole.OPERATOR, "person") as person:
            person.command(resume)
            for spent, reason in ((resume, Reason.EXPIRED), (token, Reason.TRANSITION_REFUSED)):
                act = person.command if spent is resume else person.activate
                with pytest.raises(AuthGuardError) as caught:
                    act(spent)
                assert caught.value.reason is reason
        replayed = pytest.raises(AuthGuardError, match="STATE_REPLAYED")
        with gate.client(ClientRole.ESTIMATOR, "again") as state, replayed:
            state.attest(old)
        with gate.client(ClientRole.PLANNER, "llm") as planner:
            again = planner.propose(SCAN, key="once")
            assert again["repeated"] is True
            assert again["steps"][0]["seq"] == first["steps"][0]["seq"]
            with pytest.raises(RefusedError, match="KEY_REUSED"):
                planner.propose(b"scan( )", key="once")
        assert [r.decision for r in gate.records() if r.kind == "decision"] == ["accept"]


def test_l19_no_part_of_the_stop_lane_needs_a_store_or_a_decision() -> None:
    needed = imported("authguard_r.estop.startup")
    assert {"authguard_r.estop", "authguard_r.estop.protocol"} <= needed  # it was found
    assert "apsw" not in needed
    assert all(find_spec(f"authguard_r.{part}") for part in NOT_FOR_STOPS)  # each name is one
    slow = [
        name
        for name in needed
        for part in NOT_FOR_STOPS
        if f"{name}.".startswith(f"authguard_r.{part}.")
    ]
    assert slow == []


def test_l19_a_stop_does_not_need_the_gate() -> None:
    with RunningGate(robot=True) as gate:
        os.kill(gate.pid, signal.SIGSTOP)
        try:
            lane = GateClient.connect(gate.stop_socket, role=ClientRole.PLANNER, client="llm")
            with lane:
                assert lane.stop("the gate hangs")["stopped"] is True
        finally:
            os.kill(gate.pid, signal.SIGCONT)
        until(lambda: [r for r in gate.records() if r.kind == "stop"], "its record, later")
