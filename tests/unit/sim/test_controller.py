# SPDX-License-Identifier: Apache-2.0
"""The controller's desk: what moves the robot, and everything that stops it."""

from __future__ import annotations

from math import hypot

import pytest

from authguard_r.client.controller import SAMPLE_MS, STEP_MS, MessageSource
from authguard_r.client.proof import Proven
from authguard_r.core.errors import MalformedError
from authguard_r.sim.body import SymbolicBody
from authguard_r.sim.robot import Faults
from authguard_r.wire.messages import Dispatch, Kind, Welcome
from fixtures import scenarios
from fixtures.cases import case
from unit.sim.controller_bench import BRAKE_MM_S2, LIFE, Bench, drive, framed, proven, ticket

STOPPED = ("ENDED", "aborted", "STOPPED")
LOST = ("ENDED", "aborted", "RENEWAL_LOST")


def moving(**changes: object) -> Bench:
    """Return a desk whose robot is on its way at 800 mm/s."""
    bench = Bench(**changes)  # type: ignore[arg-type]
    bench.dispatch()
    bench.wait(2_000)
    assert bench.speed == 800
    bench.sent.clear()
    return bench


def test_an_action_that_is_renewed_is_carried_out_and_reported() -> None:
    bench = Bench()
    bench.dispatch()
    bench.wait(60_000)
    assert bench.said(MessageSource.GATE) == [
        ("STOOD", "0", ""),
        ("BEGUN", "", ""),
        ("ENDED", "succeeded", ""),
    ]
    assert bench.robot.state.region == "pharmacy"
    ended = bench.sent[-1].body
    assert ended.used.motion_ms > 10_000
    assert bench.session.stands


def test_nothing_is_heard_before_the_server_has_proved_itself() -> None:
    bench = Bench(opened=())
    here = bench.place
    assert bench.dispatch() == []
    bench.renew()
    bench.halt()
    bench.wait(5_000)
    assert (bench.place, bench.sent, bench.session.stops) == (here, [], 0)


def test_the_stop_lane_moves_nothing() -> None:
    bench = Bench(opened=(MessageSource.STOP,))
    here = bench.place
    assert bench.dispatch(channel=MessageSource.STOP) == []
    bench.wait(5_000)
    assert (bench.place, bench.sent) == (here, [])


def test_the_stop_lane_cannot_keep_an_action_alive() -> None:
    bench = moving()
    order = Dispatch(
        ticket=ticket(1),
        action=scenarios.navigate("dock", "pharmacy"),
        max_ms=1,
        renew_within_ms=300,
        life=LIFE,
        stops=0,
    )
    for _ in range(30):
        bench.say(Kind.RENEW, {"ticket": ticket(1)}, MessageSource.STOP)
        bench.say(Kind.DISPATCH, order, MessageSource.STOP)
        bench.wait(20, renewing=None)
    assert (bench.session.stops, bench.speed < 800) == (1, True)


def test_a_gate_that_is_gone_is_not_heard_any_more() -> None:
    bench = Bench()
    bench.close()
    here = bench.place
    assert bench.dispatch() == []
    bench.wait(1_000)
    assert bench.place == here


def test_a_proof_for_another_robot_is_a_fault_of_ours() -> None:
    bench = Bench(opened=(), rid=scenarios.OTHER)
    with pytest.raises(RuntimeError):
        bench.session.opened(MessageSource.GATE, proven(), bench.now_ms)
    assert bench.dispatch() == []


def test_an_order_that_is_no_order_moves_nothing() -> None:
    bench = Bench()
    with pytest.raises(MalformedError):
        bench.say(Kind.DISPATCH, {"ticket": ticket(1), "action": "go"})
    with pytest.raises(MalformedError):
        bench.say(Kind.HALT, {"softly": True})
    bench.wait(1_000)
    assert bench.session.stands
    assert bench.session.stops == 0


def test_frames_of_other_kinds_are_not_obeyed() -> None:
    bench = Bench()
    bench.sent.clear()
    for kind in (Kind.REPLY, Kind.ERROR, Kind.EVENT, Kind.STOP):
        assert bench.say(kind, {}) == []
    assert bench.session.stops == 0


@pytest.mark.parametrize("every_ms", [1, 7, 20, 250])
def test_without_renewals_the_robot_brakes_by_itself(every_ms: int) -> None:
    bench = moving()
    bench.wait(280, renewing=None, every_ms=every_ms)
    assert bench.speed == 800
    bench.wait(20 + STEP_MS + 800 * 1_000 // BRAKE_MM_S2 + every_ms, renewing=None)
    assert bench.speed == 0
    assert bench.said(MessageSource.GATE) == [LOST, ("STOOD", "1", "")]
    assert bench.said(MessageSource.STOP) == []


def test_a_renewal_of_another_action_renews_nothing() -> None:
    bench = moving()
    bench.wait(400, renewing=2)
    assert bench.speed < 800
    assert bench.session.stops == 1


def test_the_way_of_braking_is_v_squared_over_two_a() -> None:
    for speed in [100, 333, 800, 1_500]:
        for every_ms in [1, 20, 500]:
            with case(speed, every_ms):
                bench = Bench(at="station-103")
                bench.dispatch(scenarios.navigate("station-103", "pharmacy", speed=speed))
                bench.wait(12_000_000 // speed)  # in the middle of the long corridor
                begun = bench.place
                bench.halt()
                speeds = [bench.speed]
                while not bench.session.stands:
                    bench.wait(every_ms, renewing=None, every_ms=every_ms)
                    speeds.append(bench.speed)
                way = hypot(bench.place[0] - begun[0], bench.place[1] - begun[1])
                assert speeds == sorted(speeds, reverse=True)
                assert abs(way - speed * speed / (2 * BRAKE_MM_S2)) <= speed * STEP_MS / 1_000 + 2
                assert bench.said(MessageSource.GATE)[-2:] == [STOPPED, ("STOOD", "1", "")]


def test_the_robot_stands_only_when_it_stands() -> None:
    bench = moving()
    assert bench.halt(MessageSource.STOP) == []
    needed = 800 * 1_000 // BRAKE_MM_S2
    bench.wait(needed - STEP_MS)
    assert bench.sent == []
    assert 0 < bench.speed < 800
    seen = bench.robot.sensed()
    assert seen is not None
    assert seen.readings["speed_mm_s"].value == bench.speed
    bench.wait(2 * STEP_MS)
    assert bench.said(MessageSource.GATE) == [STOPPED, ("STOOD", "1", "")]
    assert bench.said(MessageSource.STOP) == [("STOOD", "1", "")]
    assert [sent.id for sent in bench.sent] == [0, 9, 0]


def test_a_robot_whose_profile_says_nothing_of_brakes_stands_at_once() -> None:
    bench = moving(brake_mm_s2=None)
    bench.halt()
    assert bench.speed == 0
    assert bench.said() == [STOPPED, ("STOOD", "1", "")]


def test_a_stop_of_a_robot_that_stands_is_answered_and_counted() -> None:
    bench = Bench()
    bench.sent.clear()
    bench.halt(MessageSource.STOP, 5)
    bench.halt(MessageSource.GATE, 6)
    assert [(sent.channel, sent.id, sent.body.stops) for sent in bench.sent] == [
        (MessageSource.STOP, 5, 1),
        (MessageSource.GATE, 0, 1),
        (MessageSource.GATE, 6, 2),
    ]


def test_stops_that_come_while_one_is_carried_out_join_it() -> None:
    bench = moving()
    for number in (1, 2, 2, 2):
        bench.halt(MessageSource.STOP, number)
    bench.halt(MessageSource.GATE, 3)
    bench.wait(5_000)
    answers = [(s.channel, s.id, s.body.stops) for s in bench.sent if s.kind is Kind.STOOD]
    assert answers == [
        (MessageSource.STOP, 1, 1),
        (MessageSource.STOP, 2, 1),
        (MessageSource.GATE, 3, 1),
    ]


def test_an_action_that_was_decided_before_a_stop_is_refused_after_it() -> None:
    bench = Bench()
    bench.halt(MessageSource.STOP)  # the gate has not heard of it yet
    bench.sent.clear()
    bench.dispatch(stops=0)
    assert bench.said() == [("ENDED", "not_started", "STOPPED")]
    assert bench.sent[0].id == 77
    bench.dispatch(stops=1, number=2)
    assert bench.said()[1] == ("BEGUN", "", "")


def test_nothing_begins_while_the_robot_brakes() -> None:
    bench = moving()
    bench.halt()
    bench.dispatch(number=2, stops=99)
    assert bench.said() == [("ENDED", "not_started", "STOPPED")]
    bench.wait(5_000)
    assert bench.session.stands


@pytest.mark.parametrize("life", [0, LIFE - 1, LIFE + 1])
def test_a_count_of_stops_of_another_start_begins_nothing_however_large_it_is(life: int) -> None:
    bench = Bench()
    bench.halt(MessageSource.STOP)
    bench.sent.clear()
    bench.dispatch(life=life, stops=99)
    assert bench.said() == [("ENDED", "not_started", "STOPPED")]
    bench.wait(5_000)
    assert bench.robot.state.region == "dock"
    bench.dispatch(number=2, stops=1)
    assert bench.said()[1] == ("BEGUN", "", "")


def test_every_word_of_a_stop_says_of_which_start_it_is() -> None:
    bench = Bench()
    bench.halt()
    bench.halt(MessageSource.STOP)
    bench.wait(5_000)
    told = [sent.body.life for sent in bench.sent if sent.kind is Kind.STOOD]
    assert set(told) == {LIFE}


def test_a_second_action_is_refused_and_the_first_goes_on() -> None:
    bench = moving()
    bench.dispatch(scenarios.navigate("dock", "office-1"), number=2)
    assert bench.said() == [("ENDED", "not_started", "BUSY")]
    assert bench.sent[0].body.ticket == ticket(2)
    bench.wait(60_000)
    assert bench.robot.state.region == "pharmacy"


def test_a_release_is_carried_out_once() -> None:
    bench = moving()
    bench.dispatch()
    assert bench.said() == [("BEGUN", "", "")]
    bench.wait(60_000)
    here = bench.place
    bench.dispatch()
    bench.wait(5_000)
    assert bench.said()[1:] == [("ENDED", "succeeded", ""), ("ENDED", "succeeded", "")]
    assert bench.place == here


@pytest.mark.parametrize("faults", [Faults(controller_refuses=True), None])
def test_what_cannot_be_begun_was_not_started(faults: Faults | None) -> None:
    bench = Bench(faults=faults)
    bench.dispatch(None if faults else scenarios.navigate("dock", "moon"))
    assert bench.said()[-1] == ("ENDED", "not_started", "CONTROLLER_FAILED")
    assert bench.session.stands


def test_what_fails_says_so() -> None:
    bench = Bench(at="pharmacy", faults=Faults(grasp_fails=True))
    bench.dispatch(scenarios.Action(type="pick", tool="gripper", object="package-p1"))
    bench.wait(3_000)
    assert bench.said()[-1] == ("ENDED", "failed", "CONTROLLER_FAILED")


def test_what_takes_no_time_has_begun_and_ended() -> None:
    bench = Bench()
    bench.dispatch(scenarios.Action(type="announce", tool="speaker"))
    assert bench.said()[1:] == [("BEGUN", "", ""), ("ENDED", "succeeded", "")]


def test_a_lease_ends_without_anybody_saying_so() -> None:
    bench = Bench()
    bench.dispatch(max_ms=1_000)
    bench.wait(980)
    assert bench.speed == 800
    bench.wait(20 + STEP_MS)
    assert bench.speed < 800
    bench.wait(5_000)
    assert bench.said(MessageSource.GATE)[-2:] == [
        ("ENDED", "aborted", "LEASE_ENDED"),
        ("STOOD", "1", ""),
    ]


def test_a_robot_that_lost_its_gate_stands_and_tells_the_next_one() -> None:
    bench = moving()
    bench.close()
    bench.wait(20)
    assert bench.speed < 800  # it does not wait for the renewal to be missed
    bench.wait(5_000)
    assert bench.speed == 0
    assert bench.sent == []
    bench.open()
    assert bench.said() == [LOST, ("STOOD", "1", "")]


def test_a_gate_that_comes_back_while_the_robot_brakes_is_told_when_it_stands() -> None:
    bench = moving()
    bench.close()
    bench.wait(100)
    bench.open()
    assert bench.sent == []
    bench.dispatch(number=2, stops=1)
    assert bench.said() == [("ENDED", "not_started", "STOPPED")]
    bench.wait(5_000)
    assert bench.said()[1:] == [LOST, ("STOOD", "1", "")]


def test_the_last_outcome_is_told_to_each_new_gate() -> None:
    bench = Bench()
    bench.dispatch()
    bench.wait(60_000)
    bench.close()
    bench.sent.clear()
    bench.open()
    assert bench.said() == [("ENDED", "succeeded", ""), ("STOOD", "0", "")]


def test_the_loss_of_the_stop_lane_forgets_who_asked() -> None:
    bench = moving()
    bench.halt(MessageSource.STOP)
    bench.close(MessageSource.STOP)
    bench.open(MessageSource.STOP)
    bench.wait(5_000)
    assert bench.said(MessageSource.STOP) == []
    assert bench.said(MessageSource.GATE) == [STOPPED, ("STOOD", "1", "")]


def test_a_controller_that_ignores_stops_goes_on_and_never_says_that_it_stands() -> None:
    bench = moving(faults=Faults(ignores_stops=True))
    bench.halt(MessageSource.STOP)
    bench.halt()
    bench.close()
    bench.wait(1_000, renewing=None)
    assert bench.speed == 800
    assert bench.sent == []
    assert bench.session.stops == 0


def test_a_slow_controller_moves_at_once_and_answers_late() -> None:
    bench = Bench(faults=Faults(answers_late_ms=500))
    bench.dispatch()
    bench.wait(480)
    assert bench.speed == 800
    assert bench.sent == []
    bench.wait(40)
    assert bench.said() == [("STOOD", "0", ""), ("BEGUN", "", "")]


def test_a_stream_follows_its_samples_and_stands_without_them() -> None:
    bench = Bench(at="public-corridor")
    bench.dispatch(drive(0))
    bench.sample(linear_mm_s=300)
    assert bench.speed == 300
    start = bench.place
    bench.wait(100)
    assert bench.place == (start[0] + 30, start[1])
    bench.sample(lateral_mm_s=100, turn_urad_s=0, duration_ms=1)
    bench.wait(100)
    assert bench.place == (start[0] + 30, start[1] + 10)
    bench.wait(SAMPLE_MS)
    here = bench.place
    bench.wait(2_000)
    assert (bench.speed, bench.place) == (0, here)
    bench.sample(linear_mm_s=-300)
    bench.wait(100)
    assert bench.place == (here[0] - 30, here[1])
    bench.finish()
    bench.wait(2_000)
    assert bench.said()[-1] == ("ENDED", "succeeded", "")
    assert bench.session.stops == 0


def test_a_stream_turns() -> None:
    bench = Bench(at="public-corridor")
    bench.dispatch(drive(0))
    for _ in range(10):
        bench.sample(turn_urad_s=1_570_796)
        bench.wait(100)
    assert abs(bench.robot.state.heading_urad - 1_570_796) < 40_000
    start = bench.place
    bench.sample(linear_mm_s=200)
    bench.wait(200)
    assert abs(bench.place[0] - start[0]) <= 2
    assert abs(bench.place[1] - start[1] - 40) <= 2


def test_a_sample_of_another_action_or_for_no_stream_changes_nothing() -> None:
    bench = moving()
    here = bench.place
    bench.sample(linear_mm_s=-800)
    bench.finish()
    bench.sample(2, linear_mm_s=-800)
    bench.wait(100)
    assert bench.place == (here[0] - 80, here[1])
    assert bench.speed == 800


def test_a_sample_with_a_word_that_is_no_velocity_is_refused() -> None:
    bench = Bench(at="public-corridor")
    bench.dispatch(drive(0))
    with pytest.raises(MalformedError):
        bench.sample(linear_mm_s=100, warp=9)
    bench.wait(100)
    assert bench.speed == 0


def test_samples_renew_nothing() -> None:
    bench = Bench(at="public-corridor")
    bench.dispatch(drive(0))
    for _ in range(40):
        bench.sample(linear_mm_s=200)
        bench.wait(20, renewing=None)
    assert bench.said(MessageSource.GATE)[-2:] == [LOST, ("STOOD", "1", "")]


def test_a_stop_of_a_stream_brakes_along_its_way() -> None:
    bench = Bench(at="public-corridor")
    bench.dispatch(drive(600))
    bench.wait(500)
    start = bench.place
    bench.halt()
    bench.sample(linear_mm_s=900)
    bench.wait(5_000)
    assert abs(bench.place[0] - start[0] - 600 * 600 / (2 * BRAKE_MM_S2)) <= 15
    assert bench.said()[-2:] == [STOPPED, ("STOOD", "1", "")]


def test_a_wall_ends_a_stream() -> None:
    bench = Bench(at="public-corridor")
    bench.dispatch(drive(lateral_mm_s=1_000))
    for _ in range(400):
        bench.sample(lateral_mm_s=-1_000)
        bench.wait(20)
    assert ("ENDED", "failed", "CONTROLLER_FAILED") in bench.said()
    assert bench.speed == 0


def test_a_drive_ends_after_its_time() -> None:
    bench = Bench(at="public-corridor")
    start = bench.place
    bench.dispatch(drive(200, duration=1_000))
    bench.wait(2_000)
    assert bench.said()[-1] == ("ENDED", "succeeded", "")
    assert bench.place == (start[0] + 200, start[1])


@pytest.mark.parametrize("late", ["renewal", "sample"])
def test_what_waited_in_the_socket_renews_nothing_after_a_silence(late: str) -> None:
    """The silence before a message is judged before the message is."""
    bench = Bench(at="public-corridor")
    bench.dispatch(drive(200))
    bench.sample(linear_mm_s=200)
    bench.wait(200)
    before = bench.place
    bench.now_ms += 5_000
    if late == "renewal":
        bench.renew()
    else:
        bench.sample(linear_mm_s=200)
    bench.wait(1_000)
    assert bench.said(MessageSource.GATE)[-2:] == [LOST, ("STOOD", "1", "")]
    assert bench.speed == 0
    gone_mm = abs(bench.place[0] - before[0]) + abs(bench.place[1] - before[1])
    assert gone_mm < 200  # not the metre of five seconds


def test_what_came_in_time_renews_although_the_process_was_held_up() -> None:
    bench = moving()
    bench.now_ms += 200
    bench.renew()
    bench.now_ms += 200
    bench.renew()
    bench.sent += bench.session.tick(bench.now_ms)
    assert bench.speed == 800


def test_a_robot_in_a_hurry_moves_faster_and_its_gate_is_missed_as_soon() -> None:
    bench = Bench()
    bench.session.body = SymbolicBody(bench.robot, speed_up=10)
    bench.dispatch()
    bench.wait(200)
    assert bench.robot.elapsed_ms == 2_000
    bench.wait(300 + STEP_MS, renewing=None)
    assert bench.session.stops == 1


def test_only_a_proof_opens_a_channel() -> None:
    """The type says it; the frame of a welcome by itself is nothing."""
    bench = Bench(opened=())
    assert bench.session.handle(MessageSource.GATE, framed(Kind.WELCOME, {}), bench.now_ms) == ()
    assert Proven.__struct_fields__ == ("welcome",)
    assert Welcome.__struct_config__.frozen


def test_only_a_server_that_proved_itself_and_is_there_counts_as_heard() -> None:
    bench = Bench(opened=(MessageSource.GATE,))
    assert bench.session.hears(MessageSource.GATE)
    assert not bench.session.hears(MessageSource.STOP)
    bench.close()
    assert not bench.session.hears(MessageSource.GATE)
