# SPDX-License-Identifier: Apache-2.0
"""Whatever hangs or dies between a person and a robot: the robot stands, and no stop is lost.

Real processes; the mule has brakes. Each fault again and again, and how far the robot goes:
`benchmarks/stop_faults.py`. Spec page: docs/spec/gate-protocol.md#a-stop-at-the-gate
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from authguard_r.client import AsyncGateClient, GateClient, stopping
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.wire.frames import frame
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import ClientRole, Kind
from fixtures.gate_process import Line, RunningGate, Told, authguard, environment, until
from integration.stop_faults import (
    FAULTS,
    Asked,
    frozen,
    lane_of,
    leaves_a_stop,
    serves,
)
from integration.test_gate_bounds import (  # noqa: F401 - fixtures
    DRIVE,
    LOOK_MS,
    Yard,
    folder,
    now_ms,
    within,
    yard,
)
from integration.test_gate_watching import GO

WITHIN_MS = round(LIMITS.stop_within_s * 1_000)


@pytest.fixture(autouse=True)
def slow_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give a robot that starts anew longer than a person would wait: others load the machine."""
    monkeypatch.setattr(stopping, "GONE_S", 30.0)


def stops(at: Yard, why: str) -> list[Told]:
    """Return the records of a stop, waiting for the first."""
    found: list[Told] = until(
        lambda: [r for r in at.gate.news() if r.kind == "stop" and r.sealed.get("why") == why],
        f"the record of `{why}`",
    )
    return found


def look(at: Yard) -> Any:
    with at.gate.client(ClientRole.AUDITOR, "looks") as client:
        return client.status()


def is_suspended(at: Yard) -> bool:
    return bool(look(at)["mission"]["status"] == "suspended")


@pytest.mark.parametrize("name", FAULTS)
def test_a_stop_is_carried_out_and_recorded_once_whatever_hangs_or_dies(
    yard: Yard,  # noqa: F811
    name: str,
) -> None:
    fault: Callable[[Yard], Any] = FAULTS[name]
    serves(yard.gate)
    with yard.walk() as (walk, trail):
        with fault(yard):
            asked = Asked(yard.gate.run, name)
            rest = trail.rest(asked.at_ms)
        within(yard, rest, WITHIN_MS + yard.gate.config.renew_within_ms)
        reached = asked.confirmed()
        assert reached.answer is not None
        assert reached.role is ClientRole.OPERATOR
        assert reached.answer.stopped
        assert len(stops(yard, name)) == 1
        until(lambda: is_suspended(yard), "the suspension")
        trail.stays()
        walk.planner_dies()
    serves(yard.gate)
    assert len(stops(yard, name)) == 1  # nothing that was kept comes as another one


def test_a_stop_process_that_hangs_keeps_the_robot_from_moving(yard: Yard) -> None:  # noqa: F811
    """Nobody stopped it: the lease is not renewed, and nothing new begins."""
    serves(yard.gate)
    with yard.walk() as (walk, trail):
        lane, held_ms = lane_of(yard.gate), now_ms()
        with frozen(lane):
            within(yard, trail.rest(held_ms), WITHIN_MS + yard.gate.config.renew_within_ms)
            assert look(yard)["lane"]["alive"] is False
            until(lambda: lane_of(yard.gate) != lane, "another stop process")
        assert walk.ended()["execution"]["outcome"] == "aborted"
        serves(yard.gate)


def test_nothing_begins_while_the_stop_process_does_not_answer(yard: Yard) -> None:  # noqa: F811
    serves(yard.gate)
    with yard.mission() as trail, yard.gate.client(ClientRole.PLANNER, "early") as planner:
        # one that was stopped by hand is not replaced: nobody may kill it but the gate, and
        # another one is stopped as soon as it is there
        first = lane_of(yard.gate)
        os.kill(first, signal.SIGSTOP)
        until(lambda: not look(yard)["lane"]["alive"], "a gate that knows")
        begun = now_ms()
        answer = planner.propose(DRIVE, dialect="auto", key="early")
        (step,) = answer["steps"]
        if step["outcome"] == "accept":  # it waited until another stop process was there
            assert lane_of(yard.gate) != first
            assert now_ms() - begun >= LOOK_MS
        else:
            assert step["reasons"] == ["BUSY"]
            trail.stays()


def test_a_stop_that_was_received_is_carried_out_although_its_client_is_gone(
    yard: Yard,  # noqa: F811
) -> None:
    serves(yard.gate)
    with yard.walk() as (walk, trail):
        with frozen(lane_of(yard.gate), yard.gate.pid):
            leaves_a_stop(yard.gate.stop_socket, "left")
            leaves_a_stop(yard.gate.socket, "left")
        trail.rest(now_ms())
        assert len(stops(yard, "left")) == 1
        until(lambda: is_suspended(yard), "the suspension")
        walk.planner_dies()
    serves(yard.gate)


def test_a_person_is_told_which_part_does_not_answer_and_may_give_up(yard: Yard) -> None:  # noqa: F811
    serves(yard.gate)
    with yard.walk() as (walk, trail):
        words = authguard("stop", "--gate", yard.gate.run, "--reason", "given up", measured=False)
        with frozen(lane_of(yard.gate), yard.gate.pid):
            before = signal.signal(signal.SIGINT, signal.default_int_handler)
            hand = subprocess.Popen(  # what is ignored here would be ignored there
                words,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
                env=environment(measured=False),
            )
            signal.signal(signal.SIGINT, before)
            assert hand.stderr is not None
            line = hand.stderr.readline()
            trail.rest(now_ms())
            hand.send_signal(signal.SIGINT)
            out, _ = hand.communicate(timeout=60)
        assert "trying again" in line
        for text in (line, out):
            assert "the stop process" in text
            assert "the gate" in text
        assert hand.returncode == 5
        assert "NOT CONFIRMED" in out
        assert len(stops(yard, "given up")) == 1  # what was sent is carried out all the same
        walk.planner_dies()
    serves(yard.gate)


def test_a_stop_of_a_process_that_is_replaced_is_tried_again(yard: Yard) -> None:  # noqa: F811
    serves(yard.gate)
    with yard.mission():
        with frozen(lane_of(yard.gate)):
            words = authguard("stop", "--gate", yard.gate.run, "--json", measured=False)
            done = subprocess.run(
                words,
                check=False,
                capture_output=True,
                text=True,
                env=environment(measured=False),
                timeout=60,
            )
        assert done.returncode == 0, done
        said = json.loads(done.stdout)
        assert (said["stopped"], said["controller"], said["role"]) == (True, True, "operator")
    serves(yard.gate)


def test_a_stop_process_of_a_killed_gate_ends_with_the_next_one(yard: Yard) -> None:  # noqa: F811
    gate = yard.gate
    serves(gate)
    lane = lane_of(gate)
    gate.kill9()
    gate.start_gate()
    assert lane_of(gate) == lane  # adopted
    gate.stop_process("gate")
    until(lambda: not Path(f"/proc/{lane}").exists(), "its end")
    gate.start_gate()
    serves(gate)


# asked for again


def confirmations(at: Yard) -> list[Told]:
    """Return the records that say that a person's stop was confirmed which nobody had confirmed."""
    found = [r for r in at.gate.news() if r.kind == "stop" and r.open.get("confirms")]
    return [r for r in found if str(r.open["by"]).endswith(".hand")]


def test_a_stop_that_nobody_confirms_is_asked_for_until_the_robot_says_that_it_stands(
    yard: Yard,  # noqa: F811
) -> None:
    """Its controller hangs for longer than one try: the log has the stop once, and its end."""
    serves(yard.gate)
    with yard.mission(), frozen(yard.gate._started["robot"].pid):
        asked = Asked(yard.gate.run, "hangs")
        (first,) = stops(yard, "hangs")
        assert first.open["stood_ms"] == -1
        time.sleep(2)  # several tries
        assert asked.reached is None
        assert {"the stop process", "the gate"} <= set(asked.told)
        os.kill(yard.gate._started["robot"].pid, signal.SIGCONT)
        assert asked.confirmed().has_stopped
        (end,) = until(lambda: confirmations(yard), "the record of its end")
        assert end.open["by"] == first.open["by"]
        assert end.open["stood_ms"] >= 0
        assert len(stops(yard, "hangs")) == 1
        assert is_suspended(yard)
    serves(yard.gate)


def test_a_person_is_told_that_the_robot_does_not_say_that_it_stands_and_then_that_it_does(
    yard: Yard,  # noqa: F811
) -> None:
    serves(yard.gate)
    words = authguard("stop", "--gate", yard.gate.run, "--reason", "slow", measured=False)
    with yard.mission(), frozen(yard.gate._started["robot"].pid):
        begun_ms = now_ms()
        hand = subprocess.Popen(
            words,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment(measured=False),
        )
        assert hand.stderr is not None
        line = next(
            text for text in hand.stderr if "the gate: it sent the stop to the controller" in text
        )
        os.kill(yard.gate._started["robot"].pid, signal.SIGCONT)
        out, _ = hand.communicate(timeout=60)
    assert "did not confirm that the robot stands" in line
    assert hand.returncode == 0
    after_ms = int(out.partition("stands after ")[2].split()[0])
    assert 1_000 <= after_ms <= now_ms() - begun_ms  # since the person asked
    serves(yard.gate)


def test_a_robot_that_comes_back_in_time_confirms_the_stop(yard: Yard) -> None:  # noqa: F811
    serves(yard.gate)
    with yard.mission():
        yard.gate.stop_process("robot")
        asked = Asked(yard.gate.run, "away")
        until(lambda: asked.told, "a first answer")
        yard.gate.start_robot()
        assert asked.confirmed().has_stopped
        assert len(stops(yard, "away")) == 1
        until(lambda: is_suspended(yard), "the suspension")
    serves(yard.gate)


def test_who_asks_on_stops_a_mission_again_that_was_resumed_meanwhile(yard: Yard) -> None:  # noqa: F811
    serves(yard.gate)
    with yard.mission(), frozen(yard.gate._started["robot"].pid):
        asked = Asked(yard.gate.run, "still")
        until(lambda: is_suspended(yard), "the suspension")
        yard.order(Verb.RESUME)
        until(lambda: is_suspended(yard), "the next one")
        os.kill(yard.gate._started["robot"].pid, signal.SIGCONT)
        assert asked.confirmed().has_stopped
    serves(yard.gate)


# a client that is connected


@pytest.mark.parametrize("name", ["stop.sock", "gate.sock"])
@pytest.mark.parametrize("face", ["blocking", "looping"])
def test_a_client_stops_by_the_other_part_while_its_own_hangs(
    yard: Yard,  # noqa: F811
    name: str,
    face: str,
) -> None:
    gate, why = yard.gate, f"{face} {name}"
    serves(gate)
    path, role = gate.run / name, ClientRole.OPERATOR

    async def looping(pid: int) -> Any:
        async with await AsyncGateClient.connect(path, role=role, client="hand") as client:
            with frozen(pid):
                return await client.stop(why)

    with yard.walk() as (walk, trail):
        pid = lane_of(gate) if name == "stop.sock" else gate.pid
        asked_ms = now_ms()
        if face == "looping":
            said = asyncio.run(looping(pid))
        else:
            with GateClient.connect(path, role=role, client="hand") as client, frozen(pid):
                said = client.stop(why)
        assert (said["stopped"], said["controller"]) == (True, True)
        within(yard, trail.rest(asked_ms), WITHIN_MS)
        assert len(stops(yard, why)) == 1
        walk.planner_dies()
    serves(gate)
    assert len(stops(yard, why)) == 1


# stops at the gate itself


def at_the_gate(gate: RunningGate, role: ClientRole, number: int = 1, **stop: str) -> Any:
    """Stop at the gate's own socket; return the answer."""
    with Line(gate.socket).hello(role) as line:
        line.say(Kind.STOP, stop, number)
        return line.told(Kind.REPLY)


@pytest.mark.parametrize(
    ("role", "status"),
    [("operator", "suspended"), ("auditor", "active"), ("planner", "active")],
)
def test_the_gate_takes_a_stop_too_and_only_an_operator_s_suspends(
    yard: Yard,  # noqa: F811
    role: str,
    status: str,
) -> None:
    serves(yard.gate)
    with yard.walk() as (walk, trail):
        asked_ms = now_ms()
        said = at_the_gate(yard.gate, ClientRole(role), why="at the gate")
        within(yard, trail.rest(asked_ms), 0)
        assert (said["stopped"], said["controller"]) == (True, True)
        (record,) = stops(yard, "at the gate")
        assert record.open["stood_ms"] == said["after_ms"]
        assert "lane" not in record.open
        assert mission_of(yard) == status
        walk.planner_dies()


def mission_of(at: Yard) -> str:
    return str(look(at)["mission"]["status"])


def test_stops_that_come_while_one_is_under_way_are_answered_and_recorded_with_it(
    yard: Yard,  # noqa: F811
) -> None:
    serves(yard.gate)
    with yard.walk() as (walk, trail), Line(yard.gate.socket).hello(ClientRole.AUDITOR) as line:
        line.send(b"".join(frame(Kind.STOP, n, {"why": f"{n}"}) for n in range(1, 101)))
        trail.rest(now_ms())
        answered = [line.told(Kind.REPLY)["stopped"] for _ in range(64)]
        assert answered == [True] * 64
        stops(yard, "1")
        known = [r for r in yard.gate.news() if r.kind == "stop" and r.sealed["why"] != "looks"]
        assert [r.sealed["why"] for r in known] == ["1"]
        walk.planner_dies()


def test_a_stop_that_is_none_stops_nothing_and_is_refused(yard: Yard) -> None:  # noqa: F811
    serves(yard.gate)
    with Line(yard.gate.socket).hello(ClientRole.PLANNER) as line:
        line.say(Kind.STOP, {"how": "hard"}, 3)
        assert line.told(Kind.ERROR)["code"] == "MALFORMED"


def test_a_robot_inside_its_gate_is_stopped_at_the_gate() -> None:
    with RunningGate(simulate=True) as gate:
        gate.activate()
        planner = gate.client(ClientRole.PLANNER, "llm")
        told: list[Any] = []
        ask = threading.Thread(target=lambda: told.append(planner.propose(GO, key="one")))
        ask.start()
        with gate.client(ClientRole.AUDITOR, "looks") as auditor:
            until(lambda: auditor.status()["leases"], "a motion")
        answer = Asked(gate.run, "inside").confirmed().answer
        assert answer is not None
        assert answer.stopped
        ask.join(60)
        assert told[0]["steps"][0]["execution"]["outcome"] == "aborted"


def test_a_gate_without_a_controller_says_so_at_once() -> None:
    with RunningGate() as gate:
        said = at_the_gate(gate, ClientRole.OPERATOR)
        assert (said["stopped"], said["controller"]) == (False, False)
        assert said["after_ms"] < LIMITS.stop_answer_ms
        until(lambda: [r for r in gate.records() if r.kind == "stop"], "its record")
        done = subprocess.run(
            authguard("stop", "--gate", gate.run, measured=False),
            check=False,
            capture_output=True,
            text=True,
            env=environment(measured=False),
            timeout=60,
        )
        assert done.returncode == 5
        assert "the stop process: no controller is connected to it" in done.stderr
        assert "NOT CONFIRMED: no controller is connected" in done.stdout


# one name for two ways


def lane_too(gate: RunningGate, role: ClientRole, **stop: str) -> None:
    """Stop by the stop process, as a client that names its stop."""
    with Line(gate.stop_socket).hello(role) as line:
        line.say(Kind.STOP, stop, 1)
        assert line.told(Kind.REPLY)["stopped"] is True


def named(at: Yard, why: str) -> int:
    return len([r for r in at.gate.news() if r.kind == "stop" and r.sealed.get("why") == why])


def test_the_second_way_of_a_stop_is_no_second_stop(yard: Yard) -> None:  # noqa: F811
    serves(yard.gate)
    with yard.mission():
        for way in (at_the_gate, lane_too, lane_too, at_the_gate):
            way(yard.gate, ClientRole.AUDITOR, why="twice", key="same")
            until(lambda: stops(yard, "twice"), "a record")
        until(lambda: named(yard, "twice") == 2, "two stops of two ways each")


def test_who_repeats_a_name_the_same_way_hides_no_stop(yard: Yard) -> None:  # noqa: F811
    serves(yard.gate)
    with yard.mission():
        for number in range(1, 4):
            at_the_gate(yard.gate, ClientRole.PLANNER, why="again", key="same")
            until(lambda n=number: named(yard, "again") == n, "its record")


def test_a_planner_s_stop_hides_no_operator_s(yard: Yard) -> None:  # noqa: F811
    serves(yard.gate)
    with yard.mission():
        at_the_gate(yard.gate, ClientRole.PLANNER, why="mine", key="same")
        assert mission_of(yard) == "active"
        lane_too(yard.gate, ClientRole.OPERATOR, why="yours", key="same")
        until(lambda: is_suspended(yard), "the suspension")
        assert len(stops(yard, "yours")) == 1


def test_a_resume_that_came_after_the_stop_stays(yard: Yard) -> None:  # noqa: F811
    """The stop is recorded when the robot stands; that suspends nothing anew."""
    serves(yard.gate)
    with yard.mission():
        robot = yard.gate._started["robot"].pid
        with frozen(robot), Line(yard.gate.socket).hello(ClientRole.OPERATOR) as line:
            line.say(Kind.STOP, {"why": "early"}, 1)
            until(lambda: is_suspended(yard), "the suspension")
            time.sleep(0.05)
            yard.order(Verb.RESUME)
            assert mission_of(yard) == "active"
            line.told(Kind.REPLY)
        stops(yard, "early")
        assert mission_of(yard) == "active"
    serves(yard.gate)
