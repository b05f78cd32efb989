# SPDX-License-Identifier: Apache-2.0
"""When the gate's node is gone, the base stands and what ran is canceled, and nothing moves after.

Real processes, killed, stopped and dead-locked, with real topics and a real action server between
them. How fast it is, `benchmarks/ros_faults.py` measures; the bound here only makes the law
visible. Source: docs/spec/ros-stopping.md; lessons L1, L3, L19
"""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Iterator

import pytest

pytest.importorskip("rclpy", reason="an environment with ROS runs these (tests/ros/make.sh)")

from authguard_r.integrations.ros.nodes import actuator, deadman
from fixtures.ros_processes import Actor, Driving, Line, Robot, Watched, move, move_by_relay

#: From a fault to a base that stands and a goal that is canceled, in milliseconds.
SOON_MS = 1_000.0
ANOTHER = '"why": "another_publisher"'
#: So often a second publisher may begin on a machine that is late.
TRIES = 3
FAULTS = {
    "killed": "SIGKILL",
    "stopped by the kernel": "SIGSTOP",
    "a clean end": "leave",
    "a dead-locked executor": "deadlock",
    "a stuck loop of asyncio": "stick",
}


@pytest.fixture(scope="module")
def started() -> Iterator[Watched]:
    """A server, a base and a dead-man, which outlive each test's gate."""
    with Robot() as made:
        yield Watched(made)


@pytest.fixture
def watched(started: Watched) -> Iterator[Watched]:
    with started.robot.visit():
        yield started


@pytest.fixture
def robot() -> Iterator[Robot]:
    """A robot of a test's own, of which nothing runs."""
    with Robot() as made:
        yield made


def begins(
    watched: Watched, base: Actor, gate: Actor, *words: str, moves: bool = True
) -> tuple[Actor, Line]:
    """Have a second publisher begin beside the gate; return it and what the base says of it.

    Where the machine was late, and a deadline of the gate alone had passed first, begin anew with
    another one, a few times at most: the base keeps the reason for which it closed.
    """
    for _ in range(TRIES):
        second = watched.robot.start(*words, "waiting")
        if moves:
            move(base, gate)
        base.until_now(lambda line: line["event"] == "velocity" and not line["why"])
        begun = time.monotonic_ns()
        second.tell("begin")
        said = base.until(lambda line: line.get("why"), after=begun)
        if said["why"] not in {"deadline", "silence"}:
            return second, said
        gate.tell("drive 0")
        base.open(after=second.send(signal.SIGKILL))
    raise AssertionError(f"a second publisher is late, {TRIES} times of {TRIES}")


@pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS.keys())
def test_a_gate_that_does_not_live_stops_the_base_and_cancels_the_goal(
    watched: Watched, fault: str
) -> None:
    driving = Driving(watched)
    begun = driving.fault(fault)
    stopped, canceled = driving.stopped_ms(begun), driving.canceled_ms(begun)
    print(f"{fault}: stands after {stopped:.0f} ms, canceled after {canceled:.0f} ms")
    assert stopped < SOON_MS
    assert canceled < SOON_MS
    if fault in {"deadlock", "stick"}:
        assert driving.gate.process.poll() is None  # the process lives, and that is not enough


def test_an_executor_of_several_threads_is_as_dead_when_what_mediates_is_stuck(
    watched: Watched,
) -> None:
    driving = Driving(watched, gate=("several",))
    begun = driving.fault("deadlock")
    assert driving.stopped_ms(begun) < SOON_MS
    assert driving.canceled_ms(begun) < SOON_MS


def test_nothing_moves_after_death_until_a_new_life_has_stood_first(watched: Watched) -> None:
    driving = Driving(watched)
    begun = driving.fault("SIGKILL")
    driving.stopped_ms(begun)
    driving.canceled_ms(begun)
    died = len(driving.base.velocities())
    reborn = watched.robot.start("gate")
    driving.base.open(after=begun)
    assert set(driving.base.velocities()[died:]) == {0.0}
    move(driving.base, reborn, 0.2)


def test_a_gate_that_wakes_up_and_goes_on_as_before_moves_nothing(watched: Watched) -> None:
    """After `SIGCONT` it still says the velocity of a lease that nobody looked at meanwhile."""
    driving = Driving(watched, gate=("stubborn",))
    begun = driving.fault("SIGSTOP")
    driving.stopped_ms(begun)
    died = len(driving.base.velocities())
    driving.gate.send(signal.SIGCONT)
    driving.gate.event("lapsed", after=begun)
    driving.gate.until_more(50)  # it says it again and again
    assert set(driving.base.velocities()[died:]) <= {0.0}
    over = time.monotonic_ns()
    driving.gate.tell("drive 0")  # the lease is over: a fresh one may come
    driving.base.open(after=over)
    move(driving.base, driving.gate, 0.1)


def test_the_heartbeat_tells_its_owner_of_its_own_silence_before_it_speaks_again(
    watched: Watched,
) -> None:
    driving = Driving(watched)
    begun = driving.fault("SIGSTOP")
    driving.stopped_ms(begun)
    driving.gate.send(signal.SIGCONT)
    driving.gate.event("lapsed", after=begun)
    driving.base.open(after=begun)  # it stood by itself: it dropped what it had
    assert driving.base.velocities()[-1] == 0.0


def test_a_lease_that_ends_stands_the_base_without_a_latch(watched: Watched) -> None:
    driving = Driving(watched)
    begun = driving.fault("end")
    assert driving.stopped_ms(begun) < SOON_MS
    assert driving.canceled_ms(begun) < SOON_MS
    driving.gate.tell("drive 0.1")
    assert driving.base.velocity(0.1, after=begun)["why"] is None


def test_the_own_watch_alone_stops_the_base_where_dds_says_nothing(watched: Watched) -> None:
    driving = Driving(watched, base=watched.robot.start("base", "no-events"))
    begun = driving.fault("SIGKILL")
    assert driving.stopped_ms(begun) < SOON_MS
    assert driving.base.velocity(0.0, after=begun)["why"] == "silence"


def test_a_base_whose_own_executor_is_stuck_stands(watched: Watched) -> None:
    driving = Driving(watched, base=watched.robot.start("base"))
    begun = time.monotonic_ns()
    driving.base.tell("stick")
    assert driving.stopped_ms(begun) < SOON_MS


def test_a_driver_that_fails_is_told_to_stand(watched: Watched) -> None:
    driving = Driving(watched, base=watched.robot.start("base"))
    begun = time.monotonic_ns()
    driving.base.tell("fail")
    assert driving.base.velocity(0.0, after=begun)["why"] == "driver"


@pytest.mark.smoke
def test_l3_a_velocity_that_is_no_number_stops_the_base(watched: Watched) -> None:
    base, gate = watched.base, watched.robot.start("gate")
    for value in ("nan", "inf", "-inf"):
        move(base, gate)
        begun = time.monotonic_ns()
        gate.tell(f"drive {value}")
        assert base.velocity(0.0, after=begun)["why"] == "not_finite", value
        assert set(base.velocities(after=begun)) == {0.0}, value


def test_a_rogue_with_the_default_profile_is_not_matched(watched: Watched) -> None:
    begun = time.monotonic_ns()
    base, gate = watched.base, watched.robot.start("gate")
    base.open(after=begun)
    rogue = watched.robot.start("rogue", "default", "9")
    rogue.event("incompatible")
    rogue.until_more(50)
    move(base, gate)  # the base goes on to obey the gate alone
    assert set(base.velocities(after=begun)) == {0.0, 0.3}
    assert not [line for line in rogue.lines if line["event"] == "matched"]


def test_a_second_publisher_with_the_right_profile_latches_a_stop(watched: Watched) -> None:
    begun = time.monotonic_ns()
    base, gate = watched.base, watched.robot.start("gate")
    rogue, said = begins(watched, base, gate, "rogue", "right", "9")
    assert said["why"] == "another_publisher"
    rogue.until_more(50)
    gate.tell("drive 0")  # both publish: nothing is a fresh lease
    assert set(base.velocities(after=begun)) == {0.0, 0.3}
    after = [line["why"] for line in base.lines[1:] if line["ns"] >= said["ns"]]
    assert set(after) == {"another_publisher"}
    ended = rogue.send(signal.SIGKILL)
    base.open(after=ended)


def test_a_second_publisher_is_found_by_its_first_sample_where_dds_says_nothing(
    watched: Watched,
) -> None:
    base, gate = watched.robot.start("base", "no-events"), watched.robot.start("gate")
    _, said = begins(watched, base, gate, "rogue", "right", "9")
    assert said["why"] == "another_publisher"
    assert set(base.velocities()) == {0.0, 0.3}


def test_two_publishers_that_stand_are_no_lease_where_nobody_says_whose_a_sample_is(
    watched: Watched,
) -> None:
    """An older rclpy: the second one would be taken for the first, and then speed up."""
    base, gate = watched.robot.start("base", "no-ids"), watched.robot.start("gate")
    rogue, said = begins(watched, base, gate, "rogue", "right", "0", moves=False)
    assert said["why"] == "another_publisher"
    rogue.until_more(50)
    assert base.lines[-1]["why"] == "another_publisher"
    ended = rogue.send(signal.SIGKILL)
    base.open(after=ended)
    move(base, gate)


def test_two_gates_stop_the_base_and_cancel_the_goal(watched: Watched) -> None:
    driving = Driving(watched)
    told, begun = driving.deadman.count(ANOTHER), time.monotonic_ns()
    _, said = begins(watched, driving.base, driving.gate, "gate", moves=False)
    assert said["why"] == "another_publisher"
    driving.canceled_ms(begun)
    driving.deadman.says(ANOTHER, times=told + 1)


def test_a_dead_man_that_starts_without_a_heartbeat_cancels_what_runs(robot: Robot) -> None:
    server, gate = robot.start("server"), robot.start("gate", "mute")
    gate.tell("goal")
    server.event("goal began")
    begun = time.monotonic_ns()
    robot.run("deadman")
    server.event("goal canceled", after=begun)


def test_a_dead_man_whose_log_nobody_reads_cancels_all_the_same(robot: Robot) -> None:
    """What kills a gate's node may take the reader of both their logs, too."""
    server, gate = robot.start("server"), robot.start("gate")
    deadman = robot.run("deadman", unread=True)
    for _ in range(TRIES):
        begun = time.monotonic_ns()
        gate.tell("goal")
        server.event("goal began", after=begun)
        gate.until_more(100)  # it is armed, or else cancels at its start
        if server.lines[-1]["event"] == "goal began":
            break  # else the machine was late, and the goal is canceled already
    died = gate.send(signal.SIGKILL)
    server.event("goal canceled", after=died)
    assert deadman.process.poll() is None


def test_a_goal_that_a_server_takes_after_the_death_is_canceled_too(robot: Robot) -> None:
    """A server may accept late what a dead gate sent: one answer is not the end."""
    server, deadman = robot.start("server"), robot.run("deadman")
    deadman.says("lost")
    late = robot.start("gate", "mute")
    for _ in range(2):
        begun = time.monotonic_ns()
        late.tell("goal")
        server.event("goal began", after=begun)
        server.event("goal canceled", after=begun)


def test_a_server_that_refuses_to_cancel_is_asked_until_it_yields_and_then_no_more(
    robot: Robot,
) -> None:
    server, deadman = robot.start("refuser"), robot.run("deadman")
    gate = robot.start("gate")
    deadman.says("armed")
    begun = gate.send(signal.SIGKILL)
    server.event("asked", after=begun)
    reborn = robot.start("gate")
    deadman.says("armed", times=2)
    deadman.says("not canceled")
    server.event("asked", after=time.monotonic_ns())  # a new gate does not settle it
    server.tell("yield")
    server.until(lambda line: line.get("refused") is False)
    settled = time.monotonic_ns()
    reborn.until_more(100)
    assert [line for line in server.lines if line["ns"] > settled] == []


def test_a_server_that_answers_late_has_answered(robot: Robot) -> None:
    """Else it would be asked for ever, and a new gate's goals be canceled for an old one's."""
    server, deadman = robot.start("server", "slow", "brief"), robot.run("deadman")
    gate = robot.start("gate")
    deadman.says("armed")
    deadman.says('"found"')  # else it looks for servers once a second, and the goal is over by then
    gate.tell("goal")
    server.event("goal began")
    begun = gate.send(signal.SIGKILL)
    server.event("goal canceled", after=begun)
    reborn = robot.start("gate")
    for _ in range(10):  # what waits in the server is a few questions, and then no more
        began = time.monotonic_ns()
        reborn.tell("goal")
        server.event("goal began", after=began)
        if server.ended(after=began)["event"] == "goal succeeded":
            break
    server.event("goal succeeded")


def test_a_dead_man_without_the_events_of_dds_cancels_by_its_own_watch(robot: Robot) -> None:
    server, blind, gate = robot.start("server"), robot.start("blind"), robot.start("gate")
    blind.says("armed")
    blind.says('"found"')
    gate.tell("goal")
    server.event("goal began")
    begun = gate.send(signal.SIGKILL)
    assert (server.event("goal canceled", after=begun)["ns"] - begun) / 1e6 < SOON_MS
    blind.says('"why": "silence"')


def test_a_dead_man_says_nothing_and_calls_nothing_but_cancel(watched: Watched) -> None:
    seen = watched.robot.start("looker", "authguard_deadman").event("seen")
    topics = [name for name, _ in seen["topics"]]
    assert topics == ["/parameter_events"]  # every node of rclpy has it
    assert [name for name, _ in seen["clients"]] == ["/fibonacci/_action/cancel_goal"]
    assert seen["services"] == []


def test_a_relay_stands_before_a_base_that_knows_nothing_of_us(watched: Watched) -> None:
    robot = watched.robot
    wheels = robot.start("wheels", "/base/cmd_vel")
    relay, gate = robot.run("actuator", "move", "/base/cmd_vel"), robot.start("gate")
    move_by_relay(wheels, relay, gate)
    begun = gate.send(signal.SIGKILL)
    stopped = wheels.velocity(0.0, after=begun)
    assert (stopped["ns"] - begun) / 1e6 < SOON_MS


def test_a_relay_takes_only_what_the_map_gives_it(
    robot: Robot, capsys: pytest.CaptureFixture[str]
) -> None:
    for words, where in (
        (("count", "/base/cmd_vel"), "mediated"),
        (("move", "/elsewhere"), "processes./robot/base.publishes"),
    ):
        assert actuator.main([str(robot.map), *words, "--demo"]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert json.loads(line)["event"] == "refused"
        assert json.loads(line)["where"] == where


def test_words_of_ros_are_refused(robot: Robot, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--ros-args", "-r", "/authguard/heartbeat:=/elsewhere"]
    for module in (deadman, actuator):
        assert module.main([str(robot.map), *words, "--demo"]) == 2
        assert "expected MAP" in capsys.readouterr().err
