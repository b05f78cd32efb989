# SPDX-License-Identifier: Apache-2.0
"""The stop lane's laws, without a socket or a clock: bytes and instants in, bytes out."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from authguard_r.access.gate_config import Peer as Named
from authguard_r.access.peers import OVERFLOW_UID
from authguard_r.client.handshake import Handshake, require_welcome
from authguard_r.core.quantities import Now
from authguard_r.estop.protocol import Dropped, EStopDispatcher, EStopPeer
from authguard_r.estop.stop_queue import Backlog
from authguard_r.estop.stops import ControllerConnection, Stops
from authguard_r.keys.signer import folder_signer
from authguard_r.keys.trust import read_trust
from authguard_r.wire.frames import FrameReader, frame, raw_frame, read_body
from authguard_r.wire.messages import PROTOCOL, ClientRole, Kind, Stood, StopHeard, Welcome
from authguard_r.wire.stop_limits import LIMITS
from fixtures import estop_fixtures, scenarios
from fixtures.cases import case

ME, STRANGER, PLANNER, DRIVER = 1_000, 1_001, 1_002, 1_003
EPOCH = 77
CONFIG = estop_fixtures.config(
    Named(uid=ME, roles=(ClientRole.OPERATOR,)),
    Named(uid=PLANNER, roles=(ClientRole.PLANNER,)),
    Named(uid=DRIVER, roles=(ClientRole.CONTROLLER,)),
    connections=4,
)


class World:
    """One desk and its time; says what each client was sent."""

    def __init__(self, config: Any = CONFIG, journal: Backlog | None = None) -> None:
        self.ms = 5_000
        self.journal = journal if journal is not None else Backlog(EPOCH)
        signer = folder_signer(scenarios.trust_folder(), f"gate-{scenarios.RID}")
        self.session = EStopDispatcher(
            scenarios.RID, config, own_uid=ME, signer=signer, journal=self.journal
        )

    @property
    def now(self) -> Now:
        return Now(1_000_000 + self.ms, self.ms)

    def open(self, uid: int) -> EStopPeer:
        return self.session.open(uid, self.now)

    def join(self, uid: int, role: ClientRole, client: str | None = None) -> EStopPeer:
        peer = self.open(uid)
        self.say(peer, Kind.HELLO, hello(role, client or str(role)))
        kinds = [kind for kind, _, _ in said(peer)]
        assert kinds[0] is Kind.WELCOME, (kinds, self.session.dropped)
        return peer

    def robot(self) -> EStopPeer:
        return self.join(DRIVER, ClientRole.CONTROLLER)

    def robot_unseen(self) -> EStopPeer:
        """Return a controller with everything that it was sent since it came."""
        peer = self.open(DRIVER)
        self.say(peer, Kind.HELLO, hello(ClientRole.CONTROLLER, "robot"))
        return peer

    def planner(self, client: str = "planner") -> EStopPeer:
        return self.join(PLANNER, ClientRole.PLANNER, client)

    def say(self, peer: EStopPeer, kind: Kind, body: object, number: int = 0) -> None:
        self.session.received(peer, frame(kind, number, body), self.now)

    def stop(self, peer: EStopPeer, number: int = 1, why: str = "") -> None:
        self.say(peer, Kind.STOP, {"why": why}, number)

    def stand(self, peer: EStopPeer, number: int, stops: int = 1) -> None:
        self.say(peer, Kind.STOOD, {"stops": stops, "life": 8}, number)

    def later(self, ms: int) -> None:
        self.ms += ms
        self.session.tick(self.now)


def hello(role: ClientRole, client: str, nonce: str | None = None) -> dict[str, Any]:
    return {"protocol": PROTOCOL, "role": role, "client": client, "nonce": nonce}


def said(peer: EStopPeer) -> list[tuple[Kind, int, Any]]:
    """Return what the client was sent since the last look."""
    frames = FrameReader(lambda kind: 1 << 20).feed(bytes(peer.out))
    peer.out.clear()
    return [(item.kind, item.id, json.loads(item.body)) for item in frames]


def halts(peer: EStopPeer) -> list[int]:
    return [number for kind, number, _ in said(peer) if kind is Kind.HALT]


def reply(stopped: bool, controller: bool, after_ms: int) -> dict[str, Any]:
    return {"stopped": stopped, "controller": controller, "after_ms": after_ms}


def code(peer: EStopPeer) -> tuple[str, str]:
    """Return why the lane ended this connection."""
    kind, number, fault = said(peer)[-1]
    assert (kind, number) == (Kind.ERROR, 0)
    assert peer.is_ending
    return fault["code"], fault["where"]


# stops


def test_a_stop_reaches_the_controller_at_once_and_is_answered_when_it_stands() -> None:
    world = World()
    robot, planner = world.robot(), world.planner()
    world.stop(planner, 9, "smoke")
    assert halts(robot) == [1]
    assert said(planner) == []
    assert not planner.is_heard
    world.ms += 40
    world.stand(robot, 1, stops=6)
    assert said(planner) == [(Kind.REPLY, 9, reply(True, True, 40))]
    assert planner.is_heard
    assert world.journal.others.to_spool() == [
        StopHeard(
            epoch=EPOCH,
            n=1,
            by="planner",
            uid=PLANNER,
            role=ClientRole.PLANNER,
            time_ms=1_005_000,
            why="smoke",
            stood_ms=40,
            stops=6,
            life=8,
        )
    ]


def test_a_stop_without_a_controller_says_so_at_once() -> None:
    world = World()
    planner = world.planner()
    world.stop(planner)
    assert said(planner) == [(Kind.REPLY, 1, reply(False, False, 0))]
    assert [stop.stood_ms for stop in world.journal.others.to_spool()] == [None]


def test_a_stop_that_nobody_confirmed_is_the_first_that_the_next_controller_hears() -> None:
    world = World()
    planner = world.planner()
    world.stop(planner)
    robot = world.robot_unseen()
    kinds = [(kind, number) for kind, number, _ in said(robot)]
    assert kinds == [(Kind.WELCOME, 0), (Kind.HALT, 1)]
    world.stand(robot, 1)
    another = world.robot_unseen()
    assert [kind for kind, _, _ in said(another)] == [Kind.WELCOME]


def test_a_controller_that_comes_while_a_stop_is_under_way_is_told() -> None:
    world = World()
    first, planner = world.robot(), world.planner()
    world.stop(planner)
    second = world.robot_unseen()
    assert halts(second) == halts(first) == [1]


def test_a_controller_that_never_stands_is_told_again_and_the_stop_is_answered_in_time() -> None:
    world = World()
    robot, planner = world.robot(), world.planner()
    world.stop(planner)
    assert halts(robot) == [1]
    world.later(LIMITS.halt_again_ms - 1)
    assert halts(robot) == []
    world.later(1)
    assert halts(robot) == [1]
    world.later(LIMITS.stop_answer_ms - LIMITS.halt_again_ms - 1)
    assert said(planner) == []
    world.later(1)
    assert said(planner) == [(Kind.REPLY, 1, reply(False, True, LIMITS.stop_answer_ms))]
    assert halts(robot) == [1]
    world.later(LIMITS.halt_again_ms)
    assert halts(robot) == [1]
    assert world.session.is_lively
    world.stand(robot, 1)
    world.later(LIMITS.halt_again_ms)
    assert halts(robot) == []
    assert not world.session.is_lively


def test_halts_do_not_heap_up_for_a_controller_that_does_not_read() -> None:
    world = World()
    robot, planner = world.robot(), world.planner()
    world.stop(planner)
    for _ in range(50):
        world.later(LIMITS.halt_again_ms)
    assert halts(robot) == [1]


def test_a_stop_that_comes_while_one_is_under_way_is_not_answered_by_the_older_halt() -> None:
    world = World()
    robot, one, other = world.robot(), world.planner("one"), world.planner("other")
    world.stop(one)
    world.stop(other)
    assert halts(robot) == [1]
    world.stand(robot, 1)
    assert [kind for kind, _, _ in said(one)] == [Kind.REPLY]
    assert said(other) == []
    assert halts(robot) == [2]
    world.stand(robot, 1)  # the older answer again
    world.stand(robot, 0)  # a stop of the gate's
    world.stand(robot, 3)  # of a halt that was never sent
    assert said(other) == []
    world.stand(robot, 2)
    assert said(other) == [(Kind.REPLY, 1, reply(True, True, 0))]


def test_stops_that_come_together_share_one_further_halt() -> None:
    world = World(msgspec.structs.replace(CONFIG, connections=20))
    robot = world.robot()
    planners = [world.planner(f"p{number}") for number in range(10)]
    for planner in planners:
        world.stop(planner)
    world.stand(robot, 1)
    world.stand(robot, 2)
    assert halts(robot) == [1, 2]
    assert [len(said(planner)) for planner in planners] == [1] * 10
    assert [stop.by for stop in world.journal.others.to_spool()] == [f"p{n}" for n in range(10)]


def test_a_robot_with_two_controllers_stands_when_both_say_so() -> None:
    world = World()
    left, right, planner = world.robot(), world.robot(), world.planner()
    world.stop(planner)
    world.stand(left, 1)
    assert said(planner) == []
    world.stand(right, 1)
    assert said(planner)[0][2]["stopped"] is True


def test_a_controller_that_dies_has_not_confirmed_anything() -> None:
    world = World()
    robot, planner = world.robot(), world.planner()
    world.stop(planner)
    world.ms += 5
    world.session.close(robot, world.now)
    world.session.close(robot, world.now)
    assert said(planner) == [(Kind.REPLY, 1, reply(False, True, 5))]
    world.stop(planner)
    assert said(planner) == [(Kind.REPLY, 1, reply(False, False, 0))]


def test_a_client_that_is_gone_has_stopped_the_robot_all_the_same() -> None:
    world = World()
    robot, planner = world.robot(), world.planner()
    world.stop(planner)
    world.session.close(planner, world.now)
    world.stand(robot, 1)
    assert planner.out == b""
    assert len(world.journal) == 1


def test_stops_of_one_client_are_carried_out_one_after_the_other() -> None:
    world = World()
    planner, other = world.planner(), world.planner("other")
    world.session.received(planner, b"".join(frame(Kind.STOP, n, {}) for n in range(5)), world.now)
    assert [number for _, number, _ in said(planner)] == [0]
    assert world.session.has_work
    assert not planner.is_heard
    world.stop(other)
    for number in range(1, 5):
        world.session.work(world.now)
        assert [n for _, n, _ in said(planner)] == [number]
    assert not world.session.has_work
    assert planner.is_heard
    assert [s.by for s in world.journal.others.to_spool()] == ["planner", "other", *["planner"] * 4]


def test_a_bad_stop_behind_a_good_one_ends_the_connection_and_nothing_else() -> None:
    world = World()
    planner, other = world.planner(), world.planner("other")
    data = frame(Kind.STOP, 1, {}) + frame(Kind.STOP, 2, {"how": "hard"})
    world.session.received(planner, data, world.now)
    world.session.work(world.now)
    assert code(planner) == ("MALFORMED", "body")
    world.stop(other)
    assert said(other)[0][0] is Kind.REPLY


@given(st.lists(st.sampled_from(["stop a", "stop b", "stand", "late", "100ms", "1s", "dies"])))
def test_every_stop_is_answered_once_in_order_and_confirmed_only_by_a_later_halt(
    steps: list[str],
) -> None:
    """Whatever happens, a confirmed stop was followed by a `HALT` that the robot answered."""
    stops: Stops[int] = Stops()
    sent: list[int] = []
    asked: dict[int, int] = {}  # stop -> how many halts had been sent when it came
    answered: set[int] = set()
    over: list[Any] = []
    now, made = 0, 0
    brake = ControllerConnection(sent.append, lambda: True)
    stops.join(brake, now)
    for step in steps:
        if step.startswith("stop"):
            asked[made] = len(sent)
            stops.stop(made, now)
            made += 1
        elif step == "stand" and sent:
            answered.add(sent[-1])
            stops.stood(brake, sent[-1], said=Stood(stops=1), now_ms=now)
        elif step == "late" and sent:
            stops.stood(brake, sent[0], said=Stood(stops=1), now_ms=now)
            answered.add(sent[0])
        elif step in {"100ms", "1s"}:
            now += 100 if step == "100ms" else 1_000
            stops.remind(now)
        elif step == "dies" and not brake.is_gone:
            stops.leave(brake)
        over += stops.settled(now)
    over += stops.settled(now + LIMITS.stop_answer_ms)
    assert [settled.asked for settled in over] == list(range(made))
    for settled in over:
        if settled.stopped:
            assert any(number in answered for number in sent[asked[settled.asked] :])


# clients


@pytest.mark.parametrize(
    ("uid", "role"),
    [
        (PLANNER, ClientRole.CONTROLLER),
        (PLANNER, ClientRole.GATE),
        (PLANNER, ClientRole.OPERATOR),
        (DRIVER, ClientRole.GATE),
        (ME, ClientRole.CONTROLLER),
    ],
)
def test_a_forged_role_is_refused(uid: int, role: ClientRole) -> None:
    world = World()
    robot, forger = world.robot(), world.open(uid)
    world.say(forger, Kind.HELLO, hello(role, "robot"))
    assert code(forger) == ("ROLE_DENIED", "peer")
    world.stop(forger)
    assert halts(robot) == []
    assert world.session.dropped == {Dropped(uid, "ROLE_DENIED", "peer"): 1}


def test_a_configuration_cannot_make_another_user_the_gate() -> None:
    world = World(estop_fixtures.config(Named(uid=PLANNER, roles=(ClientRole.GATE,))))
    forger = world.open(PLANNER)
    world.say(forger, Kind.HELLO, hello(ClientRole.GATE, "gate"))
    assert code(forger) == ("ROLE_DENIED", "peer")
    assert not world.session.has_gate


@pytest.mark.parametrize("uid", [STRANGER, OVERFLOW_UID])
def test_a_user_that_is_not_named_may_not_even_stop(uid: int) -> None:
    world = World(estop_fixtures.config(Named(uid=OVERFLOW_UID, roles=(ClientRole.PLANNER,))))
    assert code(world.open(uid)) == ("ROLE_DENIED", "peer")


def test_connections_of_one_user_are_bounded_and_the_others_have_theirs() -> None:
    world = World()
    taken = [world.open(PLANNER) for _ in range(4)]
    assert code(world.open(PLANNER)) == ("BUSY", "connection")
    assert not world.open(DRIVER).is_ending
    world.session.close(taken[0], world.now)
    # the one that was refused still counts until it is closed
    assert world.open(PLANNER).is_ending


def test_connections_of_all_users_together_are_bounded() -> None:
    world = World(msgspec.structs.replace(CONFIG, connections=LIMITS.connections * 2))
    assert not any(world.open(PLANNER).is_ending for _ in range(LIMITS.connections))
    assert world.open(DRIVER).is_ending


def test_a_wrong_first_message_ends_that_connection_alone() -> None:
    for first, where in [
        (frame(Kind.STOP, 1, {}), "frame.kind"),
        (frame(Kind.PROPOSE, 1, {}), "frame.kind"),
        (b"\xff" * 9, "frame.kind"),
        (b"\0\0\x10\x01\x01\0\0\0\0", "frame.length"),
        (raw_frame(Kind.HELLO, 0, b"{"), "body"),
        (raw_frame(Kind.HELLO, 0, b'{"protocol":"authguard-r/gate/1"}'), "body"),
        (frame(Kind.HELLO, 0, {**hello(ClientRole.PLANNER, "p"), "more": 1}), "body"),
        (frame(Kind.HELLO, 0, hello(ClientRole.PLANNER, "p", "short")), "body"),
        (
            frame(Kind.HELLO, 0, {**hello(ClientRole.PLANNER, "p"), "protocol": "x/2"}),
            "hello.protocol",
        ),
        (frame(Kind.HELLO, 0, hello(ClientRole.PLANNER, "p")) * 2, "frame.kind"),
    ]:
        with case(first, where):
            world = World()
            other, wrong = world.planner(), world.open(PLANNER)
            world.session.received(wrong, first, world.now)
            assert code(wrong)[1] == where
            world.stop(other)
            assert said(other)[0][0] is Kind.REPLY


@given(st.lists(st.binary(max_size=40), max_size=8))
def test_no_bytes_at_all_do_more_than_end_their_connection(pieces: list[bytes]) -> None:
    world = World()
    robot, wrong = world.robot(), world.open(PLANNER)
    for piece in pieces:
        world.session.received(wrong, piece, world.now)
    assert halts(robot) == []
    assert not robot.is_ending


@pytest.mark.parametrize(
    ("role", "uid", "may"),
    [
        (ClientRole.PLANNER, PLANNER, {Kind.STOP}),
        (ClientRole.OPERATOR, ME, {Kind.STOP}),
        (ClientRole.CONTROLLER, DRIVER, {Kind.STOOD}),
        (ClientRole.GATE, ME, {Kind.HEARD, Kind.SYNC}),
    ],
)
def test_each_role_may_send_its_own_kinds_here(role: ClientRole, uid: int, may: set[Kind]) -> None:
    for kind in Kind:
        world = World()
        peer = world.join(uid, role)
        world.session.received(peer, raw_frame(kind, 1, b"[]"), world.now)
        assert code(peer)[1] == ("body" if kind in may else "frame.kind")


def test_a_connection_that_says_no_hello_in_time_is_ended() -> None:
    world = World()
    silent, half = world.open(PLANNER), world.open(PLANNER)
    world.session.received(half, b"\0\0", world.now)
    world.later(LIMITS.whole_within_ms - 1)
    world.session.received(half, b"\0", world.now)
    assert not silent.is_ending
    world.later(1)
    assert code(silent) == code(half) == ("MALFORMED", "frame")


def test_a_message_that_begins_and_does_not_end_ends_its_connection_and_silence_does_not() -> None:
    world = World()
    half, silent = world.planner("half"), world.planner("silent")
    whole = frame(Kind.STOP, 1, {"why": "slow"})
    world.session.received(half, whole[:5], world.now)
    world.later(LIMITS.whole_within_ms - 1)
    world.session.received(half, whole[5:6], world.now)
    world.session.received(half, whole[6:], world.now)
    assert said(half)[0][0] is Kind.REPLY
    world.session.received(half, whole[:5], world.now)
    world.later(LIMITS.whole_within_ms)
    assert code(half) == ("MALFORMED", "frame")
    world.later(3_600_000)
    assert not silent.is_ending


def test_a_client_that_does_not_read_is_ended_and_holds_a_bounded_heap() -> None:
    world = World()
    deaf = world.planner()
    for number in range(LIMITS.unread_bytes):
        world.stop(deaf, number)
        if deaf.is_ending:
            break
    assert len(deaf.out) <= LIMITS.unread_bytes + 512
    assert code(deaf) == ("BUSY", "connection")
    assert world.journal.next_n > 100


def test_the_lane_proves_with_the_gate_s_key_that_it_is_the_robot_s() -> None:
    world = World()
    robot = world.open(DRIVER)
    world.say(robot, Kind.HELLO, hello(ClientRole.CONTROLLER, "robot", estop_fixtures.NONCE))
    assert said(robot) == []
    world.session.work(world.now)
    (item,) = FrameReader(lambda kind: 1 << 20).feed(bytes(robot.out))
    trust = read_trust(scenarios.trust_folder())
    require_welcome(
        read_body(item.body, Welcome),
        Handshake(role=ClientRole.CONTROLLER, client="robot", verifier=trust, robot=scenarios.RID),
        nonce=estop_fixtures.NONCE,
        now=scenarios.NOW,
    )


def test_a_client_that_ends_before_its_proof_is_made_costs_none() -> None:
    world = World()
    robot = world.open(DRIVER)
    world.say(robot, Kind.HELLO, hello(ClientRole.CONTROLLER, "robot", estop_fixtures.NONCE))
    world.stand(robot, 1)  # a controller that is not welcomed yet has nothing to say
    world.session.close(robot, world.now)
    world.session.work(world.now)
    assert robot.out == b""
    planner = world.planner()
    world.stop(planner)
    assert said(planner)[0][2]["controller"] is False


# the gate


def gate(world: World) -> EStopPeer:
    peer = world.open(ME)
    world.say(peer, Kind.HELLO, hello(ClientRole.GATE, "gate"))
    return peer


def told(peer: EStopPeer) -> list[int]:
    return [body["n"] for kind, _, body in said(peer) if kind is Kind.EVENT]


def test_the_gate_hears_of_every_stop_in_order_and_what_it_recorded_is_forgotten() -> None:
    world = World()
    listening, planner = gate(world), world.planner()
    for _ in range(3):
        world.stop(planner)
    assert told(listening) == [1, 2, 3]
    world.say(listening, Kind.HEARD, {"n": 2})
    world.say(listening, Kind.HEARD, {"n": 2})  # says nothing new
    assert [stop.n for stop in world.journal.others.to_spool()] == [1, 3]
    assert len(world.journal) == 2
    hear(world, listening, [1, 3])
    assert len(world.journal) == 0
    assert not world.journal.others.is_fresh


def test_stops_made_while_no_gate_runs_are_told_to_the_next_one_again_and_again() -> None:
    world = World()
    planner = world.planner()
    for _ in range(LIMITS.window + 5):
        world.stop(planner)
    first = gate(world)
    assert told(first) == list(range(1, LIMITS.window + 1))
    world.session.close(first, world.now)
    assert not world.session.has_gate
    second = gate(world)
    assert told(second) == list(range(1, LIMITS.window + 1))
    world.say(second, Kind.HEARD, {"n": 7})
    ((_, _, folded),) = said(second)
    assert (folded["n"], folded["more"]) == (LIMITS.window + 1, 4)


def test_a_new_gate_takes_the_place_of_one_that_hangs() -> None:
    world = World()
    first, planner = gate(world), world.planner()
    second = gate(world)
    assert code(first) == ("BUSY", "connection")
    world.session.close(first, world.now)
    assert world.session.has_gate
    world.stop(planner)
    assert told(second) == [1]


@pytest.mark.parametrize("n", [1, 5])
def test_a_gate_that_has_recorded_what_was_never_sent_is_not_believed(n: int) -> None:
    world = World()
    listening = gate(world)
    world.say(listening, Kind.HEARD, {"n": n})
    assert code(listening) == ("MALFORMED", "heard.n")


def hear(world: World, listening: EStopPeer, numbers: Iterable[int]) -> None:
    for n in numbers:
        world.say(listening, Kind.HEARD, {"n": n})


def test_an_operator_s_stop_among_a_hundred_thousand_of_planners_is_sent_first() -> None:
    journal = Backlog(EPOCH)
    for n in range(1, 100_001):
        role = ClientRole.OPERATOR if n == 50_000 else ClientRole.PLANNER
        journal.add(heard(n, role=role, uid=PLANNER + n % 3))
    assert journal.next_n == 100_001
    assert [stop.n for stop in journal.first.to_spool()] == [50_000]
    sent = journal.to_send()
    assert sent[0].n == 50_000
    assert len(sent) == 1 + LIMITS.window
    assert len(journal) == 1 + LIMITS.window + 3
    counted = 0
    while sent:
        counted += sum(1 + stop.more for stop in sent)
        assert all(journal.heard(stop.n) for stop in sent)
        sent = journal.to_send()
    assert (counted, len(journal)) == (100_000, 0)


def test_an_operator_s_stop_is_sent_although_the_others_fill_their_window() -> None:
    world = World()
    listening, planner = gate(world), world.planner()
    for _ in range(LIMITS.window + 9):
        world.stop(planner)
    assert len(told(listening)) == LIMITS.window
    world.stop(world.join(ME, ClientRole.OPERATOR))
    assert told(listening) == [LIMITS.window + 10]


def test_no_other_stop_is_sent_before_every_operator_s_is() -> None:
    journal = Backlog(EPOCH)
    journal.add(heard(1))
    for n in range(2, LIMITS.first_window + 4):
        journal.add(heard(n, role=ClientRole.OPERATOR))
    assert [stop.n for stop in journal.to_send()] == list(range(2, LIMITS.first_window + 2))
    assert not journal.is_told
    assert not journal.heard(LIMITS.first_window + 2)  # never sent
    assert not journal.heard(1)
    assert journal.heard(2)
    assert [stop.n for stop in journal.to_send()] == [LIMITS.first_window + 2]
    assert journal.heard(4)
    assert [stop.n for stop in journal.to_send()] == [LIMITS.first_window + 3, 1]
    assert journal.is_told


def test_operators_stops_beyond_what_can_be_kept_are_counted_with_an_operator_s() -> None:
    known = (heard(n, role=ClientRole.OPERATOR) for n in range(1, LIMITS.first_stops + 3))
    journal = Backlog(EPOCH, tuple(known))
    assert len(journal) == LIMITS.first_stops
    journal.add(heard(journal.next_n, role=ClientRole.OPERATOR))
    assert [(stop.n, stop.more) for stop in journal.first.to_spool()] == [(LIMITS.first_stops, 3)]


def test_what_is_folded_says_what_is_true_of_all_and_is_not_changed_once_it_was_sent() -> None:
    journal = Backlog(EPOCH)
    for n in range(1, LIMITS.window + 1):
        journal.add(heard(n))
    add = [(5, 7), (9, 8), (4, None), (None, None), (3, 9)]
    for stood_ms, stops in add[:2]:
        journal.add(heard(journal.next_n, stood_ms=stood_ms, stops=stops, life=1))
    (folded,) = journal.others.to_spool()[LIMITS.window :]
    assert (folded.n, folded.more, folded.stood_ms, folded.stops) == (
        LIMITS.window + 1,
        1,
        9,
        8,
    )
    for stood_ms, stops in add[2:]:
        journal.add(heard(journal.next_n, stood_ms=stood_ms, stops=stops, life=(stops and 2) or 0))
    journal.to_send()
    journal.heard(1)
    (folded,) = journal.to_send()
    assert (folded.n, folded.more, folded.stood_ms, folded.stops) == (
        LIMITS.window + 1,
        4,
        None,
        9,
    )
    assert folded.life == 2  # of the count that is said, whatever else was folded
    journal.begin()  # another gate: it may know this one under its name
    journal.add(heard(journal.next_n))
    assert journal.others.to_spool()[-1].n == LIMITS.window + 6


def test_a_new_lane_counts_each_stop_that_it_was_left_once() -> None:
    old = Backlog(1)
    for n in range(1, LIMITS.window + 10):
        old.add(heard(n))
    left = tuple(old.others.to_spool())
    new = Backlog(2, left)
    assert not new.others.is_fresh
    new.add(heard(new.next_n, epoch=2))
    new.add(heard(new.next_n, epoch=2))
    assert [(stop.epoch, stop.more) for stop in new.others.to_spool()] == [(2, 1)]
    again = Backlog(3, (*left, *new.others.to_spool()))
    assert sum(1 + stop.more for stop in sent_by(again)) == LIMITS.window + 11


def sent_by(journal: Backlog) -> list[StopHeard]:
    """Return everything that a gate is sent that hears each."""
    every: list[StopHeard] = []
    while sent := journal.to_send():
        every += sent
        assert all(journal.heard(stop.n) for stop in sent)
    return every


@given(
    st.lists(
        st.sampled_from(["operator", "planner", "auditor", "send", "hear", "gate", "lane"]),
        max_size=200,
    )
)
def test_whatever_happens_every_stop_is_told_and_every_operator_s_by_itself(
    steps: list[str],
) -> None:
    journal, asked, waiting = Backlog(1), Counter[str](), list[StopHeard]()
    recorded: dict[tuple[int, int], StopHeard] = {}
    for step in steps:
        if step in {"operator", "planner", "auditor"}:
            asked[step] += 1
            journal.add(heard(journal.next_n, epoch=journal.epoch, role=ClientRole(step)))
        elif step == "send":
            waiting += journal.to_send()
            assert journal.is_told
        elif step == "hear" and waiting:
            stop = waiting.pop()
            recorded[stop.epoch, stop.n] = stop
            assert journal.heard(stop.n)
        elif step == "gate":
            journal.begin()
            waiting.clear()
        elif step == "lane":  # what it leaves is what was not recorded
            journal.begin()
            left = (*journal.first._unsent.values(), *journal.others._unsent.values())
            known = tuple(sorted(left, key=lambda stop: stop.n))
            journal, waiting = Backlog(journal.epoch + 1, known), []
    for stop in (*waiting, *sent_by(journal)):
        recorded[stop.epoch, stop.n] = stop
    told = Counter[str]()
    for stop in recorded.values():
        told[stop.role] += 1 + stop.more
        assert not (stop.role is ClientRole.OPERATOR and stop.more)
    assert told == asked


# SYNC


def replies(peer: EStopPeer) -> list[int]:
    return [number for kind, number, _ in said(peer) if kind is Kind.REPLY]


def test_a_sync_is_answered_at_once_when_no_stop_is_under_way() -> None:
    world = World()
    listening = gate(world)
    world.stop(world.planner())
    said(listening)
    world.say(listening, Kind.SYNC, {}, 7)
    world.say(listening, Kind.SYNC, {}, 8)
    assert said(listening) == [(Kind.REPLY, 7, {}), (Kind.REPLY, 8, {})]


def test_a_sync_waits_for_the_stops_that_came_before_it_and_for_none_that_came_later() -> None:
    world = World()
    robot, listening = world.robot(), gate(world)
    operator, planner = world.join(ME, ClientRole.OPERATOR), world.planner()
    world.stop(operator)
    world.say(listening, Kind.SYNC, {}, 1)
    world.stop(planner)
    world.say(listening, Kind.SYNC, {}, 2)
    assert [kind for kind, _, _ in said(listening)] == [Kind.WELCOME]
    world.stand(robot, 1)
    assert [(kind, n) for kind, n, _ in said(listening)] == [(Kind.EVENT, 0), (Kind.REPLY, 1)]
    world.later(
        LIMITS.stop_answer_ms
    )  # nobody confirms the other one: it does not hold up the gate for ever
    assert [(kind, n) for kind, n, _ in said(listening)] == [(Kind.EVENT, 0), (Kind.REPLY, 2)]


def test_a_sync_waits_until_every_operator_s_stop_was_sent() -> None:
    known = tuple(heard(n, role=ClientRole.OPERATOR) for n in range(1, LIMITS.first_window + 2))
    world = World(journal=Backlog(EPOCH, known))
    listening = gate(world)
    assert len(told(listening)) == LIMITS.first_window
    world.say(listening, Kind.SYNC, {}, 1)
    assert replies(listening) == []
    world.say(listening, Kind.HEARD, {"n": 1})
    assert [(kind, n) for kind, n, _ in said(listening)] == [(Kind.EVENT, 0), (Kind.REPLY, 1)]


def test_a_sync_of_a_gate_that_is_gone_is_not_answered_to_the_next_one() -> None:
    world = World()
    robot, first = world.robot(), gate(world)
    world.stop(world.planner())
    world.say(first, Kind.SYNC, {}, 1)
    second = gate(world)
    world.say(second, Kind.SYNC, {}, 2)
    world.session.close(second, world.now)
    third = gate(world)
    world.stand(robot, 1)
    assert replies(third) == []


def test_a_gate_that_is_not_welcomed_yet_has_no_answer() -> None:
    world = World()
    early = world.open(ME)
    world.say(early, Kind.HELLO, hello(ClientRole.GATE, "gate", estop_fixtures.NONCE))
    world.say(early, Kind.SYNC, {}, 1)
    assert said(early) == []


def test_the_gate_may_be_sent_more_at_once_than_a_client_and_has_a_bound_too() -> None:
    long = {"role": ClientRole.OPERATOR, "why": "\x01" * 200}
    known = tuple(heard(n, **long) for n in range(1, LIMITS.first_window + 1))
    world = World(journal=Backlog(EPOCH, known))
    listening = gate(world)
    assert LIMITS.unread_bytes < len(listening.out) < LIMITS.unread_gate_bytes
    number = 0
    while not listening.is_ending:
        number += 1
        world.say(listening, Kind.SYNC, {}, number)
    assert len(listening.out) <= LIMITS.unread_gate_bytes + 512


def heard(n: int, **changes: Any) -> StopHeard:
    made = StopHeard(
        epoch=1,
        n=n,
        by="planner",
        uid=PLANNER,
        role=ClientRole.PLANNER,
        time_ms=2,
        why="",
        stood_ms=None,
    )
    return msgspec.structs.replace(made, **changes)


def names(stops: Iterable[StopHeard]) -> list[tuple[int, int]]:
    return [(stop.epoch, stop.n) for stop in stops]


def test_a_new_lane_s_stops_have_another_name_than_the_old_one_s() -> None:
    world = World(journal=Backlog(EPOCH, (heard(3), heard(4))))
    world.stop(world.planner())
    listening = gate(world)
    events = [body for kind, _, body in said(listening) if kind is Kind.EVENT]
    assert [(e["epoch"], e["n"]) for e in events] == [(1, 3), (1, 4), (EPOCH, 5)]
    assert names(world.journal.others.to_spool()) == [(EPOCH, 5)]
