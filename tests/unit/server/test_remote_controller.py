# SPDX-License-Identifier: Apache-2.0
"""The controller's end of the gate: what it fails to say in time is a reason to stop."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from authguard_r.client.controller import MessageSource
from authguard_r.client.proof import prove
from authguard_r.core.action import Action, ActionMeta
from authguard_r.core.encoding import b64
from authguard_r.core.errors import ControllerError
from authguard_r.core.identifiers import Digest
from authguard_r.core.lease import Lease
from authguard_r.core.provenance import Label
from authguard_r.core.standing import Outcome, Spend
from authguard_r.server.remote_controller import (
    DURATION,
    RemoteController,
    ShadowController,
    longest_ms,
)
from authguard_r.sim.robot import Faults
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import PROTOCOL, Begun, ClientRole, Ended, Halt, Hello, Kind, Stood
from fixtures import scenarios
from unit.server.demo_site import GO, SCAN, DemoGate, HandClock, reasons
from unit.sim.controller_bench import LIFE, NONCE, framed, handshake, welcome

ONE, TWO = (Digest(b64(bytes([n]) * 32)) for n in (1, 2))


def lease(ticket: Digest = ONE, until: int = 5_000) -> Lease:
    return Lease(
        mid="m",
        version=1,
        digest=TWO,
        grant="g",
        ticket=ticket,
        until_utc_ms=0,
        until_mono_ms=until,
        regions=(),
        bounds=(),
        guards=(),
        max_age_ms=1,
    )


class Bench:
    """A remote controller with what it sends."""

    def __init__(self, *, connected: bool = True) -> None:
        self.clock = HandClock()
        #: stands for the stop process, and for what may refuse a dispatch
        self.ask: Any = lambda _: False
        self.admit: Any = lambda _action, _lease: None
        self.remote = RemoteController(
            self.clock.mono_ms,
            renew_within_ms=300,
            admit=self._admitted,
            ask=self._asked,
        )
        self.sent: list[tuple[Kind, Any, int]] = []
        if connected:
            self.attach()

    def _admitted(self, action: Action, lease: Lease) -> None:
        self.admit(action, lease)

    def _asked(self, done: Any) -> bool:
        return bool(self.ask(done))

    def attach(self) -> None:
        self.remote.attach(lambda kind, body, number: self.sent.append((kind, body, number)))

    def tells(self) -> list[Any]:
        """Let a lane serve that is asked; return what the test calls for its answers."""
        asked: list[Any] = []

        def ask(done: Any) -> bool:
            asked.append(done)
            return True

        self.ask = ask
        return asked

    def dispatch(self, ticket: Digest = ONE, **more: Any) -> Any:
        return self.remote.dispatch(scenarios.navigate("dock", "pharmacy"), lease(ticket, **more))

    def stops(self) -> int:
        """Return the last stop that a dispatch says the gate has heard of."""
        self.dispatch(TWO)
        self.remote.forget(TWO)
        known: int = self.sent[-1][1].stops
        return known


def test_what_is_not_connected_is_not_begun_and_told_nothing() -> None:
    bench = Bench(connected=False)
    with pytest.raises(ControllerError):
        bench.dispatch()
    bench.remote.stop()
    bench.remote.renew(ONE)
    bench.remote.forward(ONE, {})
    bench.remote.close(ONE)
    assert (bench.sent, bench.remote.connected) == ([], False)


def test_the_first_controller_keeps_its_place() -> None:
    bench = Bench()
    with pytest.raises(ControllerError, match="already"):
        bench.attach()
    bench.remote.stop()
    assert [kind for kind, _, _ in bench.sent] == [Kind.HALT]


def test_a_dispatch_says_how_long_the_lease_lasts_from_now() -> None:
    bench = Bench()
    bench.clock.ms = 2_000
    bench.dispatch()
    assert bench.sent[-1][1].max_ms == 3_000
    bench.dispatch(until=1_000)
    assert bench.sent[-1][1].max_ms == 0  # it was over before


def test_equal_effects_are_equal_bytes_whoever_proposed_them_in_whatever_words() -> None:
    bench = Bench()
    plain = scenarios.navigate("dock", "pharmacy")
    for planner, evidence in (("u1.a", ONE), ("u2.b", TWO)):
        meta = ActionMeta(planner=planner, timestamp="2026-01-01T00:00:00Z", evidence=evidence)
        labels = {"destination": Label.CAMERA}
        action = msgspec.structs.replace(plain, provenance=labels, meta=meta)
        bench.remote.dispatch(action, lease(ONE))
    first, second = (msgspec.json.encode(body) for _, body, _ in bench.sent)
    assert first == second
    assert bench.sent[0][1].action == plain


def test_every_message_goes_to_the_controller_and_stops_are_numbered() -> None:
    bench = Bench()
    bench.remote.renew(ONE)
    bench.remote.forward(ONE, {"linear_mm_s": 1})
    bench.remote.close(ONE)
    bench.remote.stop()
    bench.remote.stop()
    assert [(kind, number) for kind, _, number in bench.sent] == [
        (Kind.RENEW, 0),
        (Kind.FORWARD, 0),
        (Kind.CLOSE, 0),
        (Kind.HALT, 1),
        (Kind.HALT, 2),
    ]


def test_the_first_word_on_how_an_action_ended_counts() -> None:
    bench = Bench()
    handle = bench.dispatch()
    assert (handle.outcome(), handle.used(), handle.why()) == (None, Spend(), "")
    used = Spend(motion_ms=5)
    bench.remote.hear(Begun(ticket=ONE))
    bench.remote.hear(Ended(ticket=ONE, outcome=Outcome.ABORTED, used=used, why="STOPPED"))
    bench.remote.hear(Ended(ticket=ONE, outcome=Outcome.SUCCEEDED))
    assert (handle.outcome(), handle.used(), handle.why()) == (Outcome.ABORTED, used, "STOPPED")


def test_words_on_an_action_that_nobody_released_are_nothing() -> None:
    bench = Bench()
    handle = bench.dispatch()
    bench.remote.hear(Ended(ticket=TWO, outcome=Outcome.SUCCEEDED))
    bench.remote.hear(Begun(ticket=TWO))
    assert handle.outcome() is None
    bench.remote.forget(ONE)
    bench.remote.forget(ONE)
    bench.remote.hear(Ended(ticket=ONE, outcome=Outcome.SUCCEEDED))
    assert handle.outcome() is None  # settled before: too late


def test_an_action_whose_begin_nobody_confirms_is_doubted() -> None:
    bench = Bench()
    silent, begun = bench.dispatch(ONE), bench.dispatch(TWO)
    bench.remote.hear(Begun(ticket=TWO))
    bench.clock.ms = LIMITS.begin_within_ms
    bench.remote.check()
    assert (silent.why(), begun.why()) == ("", "")
    bench.clock.ms += 1
    bench.remote.check()
    assert (silent.why(), begun.why()) == ("CONTROLLER_FAILED", "")


def test_a_connection_that_is_lost_leaves_what_ran_in_doubt() -> None:
    bench = Bench()
    handle = bench.dispatch()
    bench.remote.detach()
    assert (handle.why(), bench.remote.connected) == ("CONTROLLER_FAILED", False)


def test_what_a_controller_that_came_back_tells_nothing_of_is_unknown_once_it_stands() -> None:
    """Nothing may begin while nobody knows how the action before it ended."""
    bench = Bench()
    lost, told = bench.dispatch(), bench.dispatch(TWO)
    bench.remote.detach()
    assert (lost.outcome(), told.outcome()) == (None, None)
    bench.attach()
    bench.remote.hear(Ended(ticket=TWO, outcome=Outcome.ABORTED, why="RENEWAL_LOST"))
    assert (lost.outcome(), told.outcome()) == (None, Outcome.ABORTED)
    bench.remote.hear(Stood(stops=0, life=LIFE + 1))
    assert (lost.outcome(), lost.why()) == (Outcome.UNKNOWN, "CONTROLLER_FAILED")
    assert (told.outcome(), told.why()) == (Outcome.ABORTED, "RENEWAL_LOST")


def test_a_controller_that_says_that_it_stands_leaves_what_runs_on_its_connection() -> None:
    bench = Bench()
    handle = bench.dispatch()
    bench.remote.hear(Stood(stops=0, life=LIFE))
    assert (handle.outcome(), handle.why()) == (None, "")


# stops


def test_without_a_lane_to_ask_a_stop_is_known_when_it_was_told_of_or_had_time() -> None:
    bench = Bench()
    assert bench.stops() == 0
    bench.remote.hear(Stood(stops=1, life=LIFE))
    assert bench.stops() == 0
    bench.clock.ms = LIMITS.explain_within_ms - 1
    assert bench.stops() == 0
    bench.clock.ms += 1
    assert bench.stops() == 1  # the controller's own: nobody else was to tell of it
    bench.remote.hear(Stood(stops=2, life=LIFE))
    bench.remote.heard_of(LIFE, 2)
    assert bench.stops() == 2
    bench.remote.heard_of(LIFE, 1)
    bench.remote.hear(Stood(stops=2, life=LIFE))
    bench.clock.ms += LIMITS.explain_within_ms
    assert bench.stops() == 2


def test_a_controller_that_reconnects_is_counted_from_zero() -> None:
    bench = Bench()
    bench.remote.heard_of(LIFE, 7)
    bench.remote.hear(Stood(stops=9, life=LIFE))
    bench.remote.detach()
    bench.attach()
    bench.clock.ms += 10 * LIMITS.explain_within_ms
    assert bench.stops() == 0


def test_a_stop_is_named_only_by_the_word_of_a_lane_that_can_be_asked() -> None:
    bench = Bench()
    asked = bench.tells()
    bench.remote.hear(Stood(stops=1, life=LIFE))
    assert len(asked) == 1  # at once
    bench.clock.ms = 100 * LIMITS.explain_within_ms  # it owes the gate ten thousand stops
    assert bench.stops() == 0
    assert len(asked) == 2  # and again with each dispatch: a connection may have been lost
    asked[1]()
    assert bench.stops() == 1
    asked[0]()
    assert bench.stops() == 1
    bench.remote.hear(Stood(stops=1, life=LIFE))
    assert len(asked) == 2  # known: nothing to ask about
    bench.remote.hear(Stood(stops=2, life=LIFE))
    bench.remote.heard_of(LIFE, 2)  # the lane's own word on it
    assert bench.stops() == 2


def test_a_stop_of_an_earlier_start_that_is_retold_says_nothing_of_the_stops_of_this_one() -> None:
    """A lane keeps what no gate has recorded: its count may be of a controller that was."""
    bench = Bench()
    bench.tells()  # nobody has said yet whose stops these were
    bench.remote.hear(Stood(stops=3, life=LIFE + 1))
    bench.remote.heard_of(LIFE, 7)
    assert bench.stops() == 0
    assert bench.sent[-1][1].life == LIFE + 1
    bench.remote.heard_of(LIFE + 1, 3)
    assert bench.stops() == 3


def test_before_a_controller_has_said_which_start_it_is_no_count_is_its() -> None:
    bench = Bench()
    bench.remote.heard_of(0, 7)
    assert (bench.stops(), bench.sent[-1][1].life) == (0, 0)
    bench.remote.hear(Stood(stops=1))  # it does not tell its starts apart
    bench.clock.ms += LIMITS.explain_within_ms
    bench.remote.heard_of(0, 7)
    assert (bench.stops(), bench.sent[-1][1].life) == (0, 0)


def test_what_the_lane_answers_says_nothing_of_a_stop_that_came_after_the_question() -> None:
    bench = Bench()
    asked = bench.tells()
    bench.remote.hear(Stood(stops=1, life=LIFE))
    bench.remote.hear(Stood(stops=2, life=LIFE))
    asked[0]()  # it was asked before the second, which may be an operator's
    assert bench.stops() == 0
    asked[1]()
    assert bench.stops() == 2


def test_what_the_lane_answers_says_nothing_of_another_controllers_stops() -> None:
    bench = Bench()
    asked = bench.tells()
    bench.remote.hear(Stood(stops=9, life=LIFE))
    bench.remote.detach()
    bench.attach()
    asked[0]()
    assert bench.stops() == 0
    bench.remote.hear(Stood(stops=1, life=LIFE))
    asked[0]()
    assert bench.stops() == 0


def test_a_lane_that_is_gone_is_nobody_to_ask() -> None:
    bench = Bench()
    serves = [True, False]
    bench.ask = lambda _: serves.pop(0)
    bench.remote.hear(Stood(stops=1, life=LIFE))
    assert bench.stops() == 0
    bench.clock.ms += LIMITS.explain_within_ms
    assert bench.stops() == 1
    assert serves == []


@pytest.mark.parametrize(
    ("lasts", "until", "expected"),
    [(1_000, 60_000, 1_000 + LIMITS.stream_slack_ms), (1_000, 1_200, 1_200), (1_000, 0, 0)],
)
def test_a_stream_lasts_no_longer_than_was_asked_for(lasts: int, until: int, expected: int) -> None:
    action = Action(type="drive", tool="base", params={"linear_mm_s": 1, DURATION: lasts})
    assert longest_ms(action, lease(until=until), 0) == expected
    other = scenarios.navigate("dock", "pharmacy")
    assert longest_ms(other, lease(until=until), 0) == until


def test_what_is_not_admitted_is_not_dispatched() -> None:
    bench = Bench()

    def refuse(*_: object) -> None:
        raise ControllerError("not here")

    bench.admit = refuse
    with pytest.raises(ControllerError, match="not here"):
        bench.dispatch()
    assert (bench.sent, bench.remote._flights) == ([], {})


def test_a_controller_that_was_started_anew_begins_nothing_by_its_old_count() -> None:
    """Ten stops of an earlier start are told late, after a stop of this one that nobody knows."""
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        assert house.session is not None
        before = house.session.life
        assert house.controller is not None
        house.controller.leave()
        house.connect_robot()
        session = house.session
        session.opened(
            MessageSource.STOP, prove(welcome(), handshake(), nonce=NONCE, now=scenarios.NOW), 0
        )
        session.handle(
            MessageSource.STOP, framed(Kind.HALT, Halt(), 1), house.clock.ms
        )  # its word is lost
        house.stop(ClientRole.PLANNER, 1, stops=10, life=before)
        here = house.place
        (step,) = house.propose(planner, GO)["steps"]
        assert (step["execution"]["outcome"], reasons(step)) == ("not_started", ["STOPPED"])
        assert house.place == here


@pytest.mark.parametrize("first", ["stood", "lane"])
def test_what_was_decided_before_an_operators_stop_never_starts(first: str) -> None:
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        session = house.session
        assert session is not None
        session.opened(
            MessageSource.STOP, prove(welcome(), handshake(), nonce=NONCE, now=scenarios.NOW), 0
        )
        # the lane's stop is carried out; its word on whose it was is still on the way
        said = session.handle(MessageSource.STOP, framed(Kind.HALT, Halt(), 1), house.clock.ms)
        here = house.place
        if first == "stood":
            house._deliver(tuple(sent for sent in said if sent.channel is MessageSource.GATE))
        number = house.begin(planner, GO)
        (step,) = house.rest(planner, number)["steps"]
        assert step["outcome"] == "accept"
        assert (step["execution"]["outcome"], reasons(step)) == ("not_started", ["STOPPED"])
        house.stop(ClientRole.OPERATOR, 1, stops=1)
        assert house.standing.status == "suspended"
        assert house.standing.uses["go-to-pharmacy"].starts == 0
        assert house.propose(planner, SCAN)["steps"][0]["reasons"] == ["MISSION_SUSPENDED"]
        assert house.place == here


def test_a_planners_stop_holds_nobody_up_for_longer_than_its_word_takes() -> None:
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        session = house.session
        assert session is not None
        session.opened(
            MessageSource.STOP, prove(welcome(), handshake(), nonce=NONCE, now=scenarios.NOW), 0
        )
        said = session.handle(MessageSource.STOP, framed(Kind.HALT, Halt(), 1), house.clock.ms)
        house._deliver(tuple(sent for sent in said if sent.channel is MessageSource.GATE))
        house.stop(ClientRole.PLANNER, 1, stops=1)
        assert house.propose(planner, SCAN)["steps"][0]["execution"]["outcome"] == "succeeded"


# a controller that is no good


def test_a_controller_that_says_nothing_is_told_to_stop_and_its_action_is_unknown() -> None:
    with DemoGate(robot=False) as house:
        planner = house.enter(ClientRole.PLANNER)
        silent = house.enter(ClientRole.CONTROLLER)
        house.activate()
        number = house.begin(planner, GO)
        house.advance(LIMITS.begin_within_ms)
        assert silent.bodies(Kind.HALT) == []
        house.advance(100)
        assert len(silent.bodies(Kind.HALT)) == 1
        (step,) = house.rest(planner, number)["steps"]
        assert step["execution"]["outcome"] == "unknown"
        assert set(reasons(step)) == {"CONTROLLER_FAILED"}
        assert house.standing.status == "suspended"
        assert len(house.standing.open) == 1
        (record,) = house.log("outcome")
        assert record.open["stood_ms"] > house.config.stand_within_ms


def test_a_second_controller_is_sent_away_and_the_first_goes_on() -> None:
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        intruder = house.knock(ClientRole.CONTROLLER)
        hello = Hello(protocol=PROTOCOL, role=ClientRole.CONTROLLER, client="intruder")
        intruder.say(Kind.HELLO, hello)
        (fault,) = intruder.bodies(Kind.ERROR)
        assert fault["code"] == "CONTROLLER_FAILED"
        assert house.propose(planner, SCAN)["steps"][0]["execution"]["outcome"] == "succeeded"
        assert intruder.bodies(Kind.DISPATCH) == []


def test_a_controller_that_hangs_up_in_mid_motion_leaves_it_unknown() -> None:
    with DemoGate(stand_within_ms=500) as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        number = house.begin(planner, GO)
        house.advance(500)
        assert house.controller is not None
        house.session = None
        house.controller.leave()
        (step,) = house.rest(planner, number)["steps"]
        assert (step["execution"]["outcome"], set(reasons(step))) == (
            "unknown",
            {"CONTROLLER_FAILED"},
        )
        # one that comes back is another start, with its own count
        house.connect_robot()
        assert house.remote is not None
        assert house.remote.connected


def test_nothing_begins_when_a_controller_comes_back_sooner_than_it_would_be_given_up() -> None:
    """It is another start, and knows nothing of the action before: a person has to say."""
    with DemoGate(stand_within_ms=2_000) as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        number = house.begin(planner, GO)
        house.advance(500)
        assert house.controller is not None
        house.session = None
        house.controller.leave()
        house.connect_robot()
        began = house.clock.mono_ms()
        (step,) = house.rest(planner, number)["steps"]
        assert step["execution"]["outcome"] == "unknown"
        assert house.clock.mono_ms() - began < 2_000
        (refused,) = house.propose(planner, SCAN)["steps"]
        assert refused["reasons"] == ["MISSION_SUSPENDED"]


def test_a_controller_that_ignores_stops_does_not_hold_up_the_gate() -> None:
    deaf = Faults(ignores_stops=True, localization_stops_ms=1_000)
    with DemoGate(faults=deaf) as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        (step,) = house.rest(planner, house.begin(planner, GO))["steps"]
        assert step["execution"]["outcome"] in {"unknown", "succeeded"}
        assert reasons(step)[0] == "STATE_STALE"


# shadow


def test_in_shadow_nothing_is_released_to_anybody_and_success_is_assumed() -> None:
    shadow = ShadowController()
    handle = shadow.dispatch(scenarios.navigate("dock", "pharmacy"), lease())
    shadow.stop()
    assert (handle.outcome(), handle.used()) == (Outcome.SUCCEEDED, Spend())
    assert msgspec.structs.asdict(lease())["ticket"] == ONE
