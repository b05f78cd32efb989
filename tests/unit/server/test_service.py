# SPDX-License-Identifier: Apache-2.0
"""The loop: who is served when, what the clocks do, and how it all comes to rest."""

from __future__ import annotations

import asyncio
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from authguard_r.client.controller import MessageSource
from authguard_r.core.encoding import Tag
from authguard_r.core.errors import EnvironmentFault, StoreError
from authguard_r.core.reasons import Reason
from authguard_r.core.token import open_token
from authguard_r.enforcement.leases import quietly
from authguard_r.enforcement.signed_orders import Verb
from authguard_r.keys.trust import read_trust
from authguard_r.store.memory import MemoryStore
from authguard_r.store.sqlite import open_store
from authguard_r.wire.frames import frame, raw_frame
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import (
    PROTOCOL,
    ClientRole,
    Evaluate,
    Hello,
    Kind,
    Mode,
    Order,
    OrderKind,
    Proof,
    Propose,
)
from fixtures import scenarios
from unit.server.demo_site import FORBIDDEN, GO, PATIENCE_S, SCAN, DemoGate, HandClock, reasons
from unit.sim.controller_bench import NONCE


def test_status_names_damage_to_issued_missions_beside_the_active_one() -> None:
    with DemoGate(robot=False, estimator=False) as house:
        house.activate()
        auditor = house.enter(ClientRole.AUDITOR)
        assert auditor.ask(Kind.STATUS)["damaged"] == []
        house.gate.ledger.run(lambda act: act.put("issued", "names", b"{"))
        house.service.queries.mission.changed()
        shown = auditor.ask(Kind.STATUS)
        (text,) = shown["damaged"]
        assert "STORE_CORRUPT: the list of issued missions is damaged" in text
        assert (shown["issued"], shown["mission"]["status"]) == ([], "active")


def test_who_asks_with_a_nonce_gets_a_proof_over_it() -> None:
    with DemoGate(robot=False, estimator=False) as house:
        guest = house.knock(ClientRole.PLANNER)
        hello = Hello(protocol=PROTOCOL, role=ClientRole.PLANNER, client="p", nonce=NONCE)
        guest.say(Kind.HELLO, hello)
        (told,) = guest.bodies(Kind.WELCOME)
        proof, _, signer = open_token(
            told["proof"].encode(),
            Proof,
            tag=Tag.HANDSHAKE,
            roles=frozenset({"gate"}),
            verifier=read_trust(house.folder),
            now=scenarios.NOW,
        )
        assert proof == Proof(robot=scenarios.RID, role=ClientRole.PLANNER, nonce=NONCE)
        assert signer.role == "gate"
        assert told["site"] == house.gate.facts.digest


def test_more_connections_of_one_user_than_there_may_be_are_refused_and_others_stay() -> None:
    with DemoGate(robot=False, estimator=False, connections=2) as house:
        one = house.enter(ClientRole.AUDITOR, "one")
        house.enter(ClientRole.AUDITOR, "two").leave()
        two = house.enter(ClientRole.AUDITOR, "three")
        third = house.knock(ClientRole.AUDITOR)
        assert third.bodies(Kind.ERROR)[0]["code"] == "BUSY"
        for client in (one, two):
            assert client.ask(Kind.STATUS)["robot"] == scenarios.RID


def test_a_fault_of_ours_in_a_turn_costs_that_client_alone() -> None:
    with DemoGate() as house:
        one, two = house.enter(ClientRole.PLANNER, "one"), house.enter(ClientRole.AUDITOR, "two")
        first = house.client(one)
        house.do(lambda: house.service._later(first, lambda: 1 // 0))
        one.pull()
        assert first.gone
        assert two.ask(Kind.STATUS)["robot"] == scenarios.RID
        reasons_ = [reason for r in house.log("refusal") for reason in r.open["reasons"]]
        assert "INTERNAL_FAULT" in reasons_


def test_proposals_that_are_shed_in_a_row_are_counted_and_one_refusal() -> None:
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        number = house.begin(planner, GO)
        for n in (91, 92):
            house.send(planner, raw_frame(Kind.PROPOSE, n, b"{"))
        assert house.service.queries.counted["shed"] == 2
        busy = [r for r in house.log("refusal") if r.open["reasons"] == ["BUSY"]]
        assert len(busy) == 1
        assert house.rest(planner, number)["steps"][0]["executed"]


# recovery


def unclean(path: Path) -> HandClock:
    """Leave a store whose gate died with a walk under way."""
    with DemoGate(store=open_store(path)) as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        house.begin(planner, GO)
        house.advance(500)
        house.crashes = True
        return house.clock


@pytest.mark.parametrize("by", ["proposal", "order", "what-if", "snapshot", "time"])
def test_what_the_last_run_left_open_is_settled_before_anything_new(
    tmp_path: Path, by: str
) -> None:
    clock = unclean(tmp_path / "robot.db")
    with DemoGate(
        store=open_store(tmp_path / "robot.db"), clock=clock, robot=False, estimator=False
    ) as house:
        assert house.standing.status == "active"
        if by == "proposal":
            planner = house.enter(ClientRole.PLANNER)
            planner.ask(Kind.PROPOSE, Propose(key="k", plan=SCAN))
        elif by == "order":
            operator = house.enter(ClientRole.OPERATOR)
            token = house.order(Verb.RESUME, issued_ms=house.clock.wall_ms() + 1)
            with pytest.raises(Exception, match="TRANSITION_REFUSED"):
                operator.ask(Kind.ORDER, Order(act=OrderKind.COMMAND, token=token))
        elif by == "what-if":
            house.enter(ClientRole.OPERATOR).ask(Kind.EVALUATE, Evaluate(plan=SCAN))
        elif by == "snapshot":
            house.estimator = house.enter(ClientRole.ESTIMATOR)
            house.attest()
        else:
            house.clock.ms += LIMITS.recovery_ms - 1
            house.do(house.service._listen)
            assert house.standing.status == "active"
            house.clock.ms += 1
            house.do(house.service._listen)
        assert house.standing.status == "suspended"
        assert len(house.standing.open) == 1
        managed = len(house.log("management"))
        house.advance(5_000)
        house.do(house.service._listen)
        assert len(house.log("management")) == managed  # once


def test_a_clean_end_leaves_nothing_to_settle(tmp_path: Path) -> None:
    with DemoGate(store=open_store(tmp_path / "robot.db")) as house:
        house.activate()
        clock = house.clock
    with DemoGate(store=open_store(tmp_path / "robot.db"), clock=clock) as house:
        assert house.standing.status == "active"
        planner = house.enter(ClientRole.PLANNER)
        assert house.propose(planner, SCAN)["steps"][0]["executed"]


def test_a_clock_behind_settles_nothing_and_is_tried_again(tmp_path: Path) -> None:
    clock = unclean(tmp_path / "robot.db")
    clock.wrong_ms = -3_600_000
    with DemoGate(store=open_store(tmp_path / "robot.db"), clock=clock, robot=False) as house:
        clock.ms += LIMITS.recovery_ms
        house.do(house.service._listen)
        assert [alert["what"] for alert in house.service.liveness.alerts] == ["the clock is behind"]
        clock.wrong_ms = 0
        house.do(house.service._listen)
        assert house.standing.status == "suspended"


# stops


def test_an_operators_stop_suspends_and_the_same_stop_twice_is_one() -> None:
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        number = house.begin(planner, GO)
        house.advance(500)
        for _ in range(2):
            house.stop(ClientRole.OPERATOR, 3, why="smoke", more=2)
        (record,) = house.log("stop")
        assert record.open["lane"] == [1, 3]
        assert (record.open["stood_ms"], record.open["more"]) == (40, 2)
        assert house.sealed(record.link.seq)["why"] == "smoke"
        (step,) = house.rest(planner, number)["steps"]
        assert reasons(step) == ["MISSION_SUSPENDED"]
        assert house.service.queries.stops == 1
        assert house.service.stops.settled


def test_a_stop_that_comes_late_or_from_a_lane_with_an_earlier_clock_is_a_stop() -> None:
    with DemoGate() as house:
        house.activate()
        house.stop(ClientRole.PLANNER, 7, epoch=1_000_000)
        house.stop(ClientRole.PLANNER, 6, epoch=1_000_000)
        house.stop(ClientRole.OPERATOR, 1, epoch=999_000)  # its machine's clock was set back
        lanes = [record.open["lane"] for record in house.log("stop")]
        assert lanes == [[1_000_000, 7], [1_000_000, 6], [999_000, 1]]
        assert house.standing.status == "suspended"


def broken(house: DemoGate, *, reads: bool = False) -> Any:
    """Return what mends the store again; nothing that has to be written is, from now on.

    Args:
        reads: everything else goes on.
    """
    store = house.gate.ledger.store
    works = store.run

    def gone(job: Any, *, essential: bool = False) -> Any:
        if reads and not essential:
            return works(job)
        raise StoreError("the disk is slow", reason=Reason.STORE_UNAVAILABLE)

    store.run = gone  # type: ignore[method-assign]
    return lambda: setattr(store, "run", works)


@pytest.mark.parametrize("why", ["store", "clock"])
def test_an_operators_stop_that_could_not_be_committed_is_owed_and_nothing_released(
    why: str,
) -> None:
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        if why == "store":
            mend = broken(house, reads=True)
        else:
            house.clock.wrong_ms = -3_600_000
        house.stop(ClientRole.OPERATOR, 1)
        assert not house.service.stops.settled
        here = house.place
        refused = house.propose(planner, SCAN)["steps"][0]
        assert refused["reasons"] == ["STOPPED"]
        assert house.place == here
        assert house.remote is not None
        assert not house.remote._flights
        if why == "store":
            mend()
        else:
            house.clock.wrong_ms = 0
        assert house.service.stops.settled
        assert house.standing.status == "suspended"
        assert house.propose(planner, SCAN)["steps"][0]["reasons"] == ["MISSION_SUSPENDED"]


def test_a_planners_stop_that_could_not_be_recorded_holds_nobody_up() -> None:
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        mend = broken(house)
        house.stop(ClientRole.PLANNER, 1)
        mend()
        assert house.service.stops.settled
        assert house.propose(planner, SCAN)["steps"][0]["execution"]["outcome"] == "succeeded"


def test_a_stop_that_nobody_confirmed_is_an_alert() -> None:
    with DemoGate(mode=Mode.SHADOW) as house:
        house.stop(ClientRole.PLANNER, 1, stood_ms=None)
        (record,) = house.log("alert")
        assert record.open["what"] == "a stop was not confirmed"
        assert house.log("stop")[0].open["stood_ms"] == -1


def test_a_lane_that_is_lost_is_an_alert_with_why() -> None:
    with DemoGate(robot=False) as house:
        fault = EnvironmentFault("gone", reason=Reason.SERVICE_UNAVAILABLE, where="stop lane")
        house.do(lambda: house.service.stops.stop_process_lost(None))
        house.do(lambda: house.service.stops.stop_process_lost(fault))
        silent = partial(house.service.stops.stop_process_silent, is_silent=True)
        house.do(partial(house.service.stops.stop_process_silent, is_silent=False))  # it is back
        house.do(lambda: house.service.stops.stop_process_lost(fault))
        alerts = list(house.service.liveness.alerts)
        assert [alert["what"] for alert in alerts] == ["the stop process is gone"] * 2
        assert [alert.get("over", False) for alert in alerts] == [True, False]
        assert "gone" in alerts[1]["why"]
        house.do(silent)
        recorded = [record.open["what"] for record in house.log("alert")]
        assert recorded[-1] == "the stop process does not answer"


# who gets nowhere, and who is silent


def test_refusals_in_a_row_are_an_alert_and_stop_the_robot() -> None:
    with DemoGate(refusals=3) as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        for _ in range(3):
            house.propose(planner, FORBIDDEN)
        assert [alert["what"] for alert in house.service.liveness.alerts] == ["no progress"]
        (stop,) = house.log("stop")
        assert stop.open["by"] == "gate"
        assert house.standing.status == "active"  # an alert takes no authority
        assert house.session is not None
        assert house.session.stops == 1


def test_in_shadow_nobody_is_stopped_for_getting_nowhere_and_silence_is_no_news() -> None:
    with DemoGate(mode=Mode.SHADOW, refusals=1) as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        house.propose(planner, FORBIDDEN)
        house.clock.ms += 10**6
        house.do(house.service._listen)
        assert list(house.service.liveness.alerts) == []
        assert house.log("stop") == []


def test_a_mission_without_a_controller_is_an_alert_and_a_silent_estimator_another() -> None:
    with DemoGate(robot=False) as house:
        house.activate()
        house.do(house.service._listen)
        house.clock.ms += 60_001
        house.do(house.service._listen)
        assert [alert["what"] for alert in house.service.liveness.alerts] == [
            "controller is not connected",
            "planner is silent",
            "estimator is silent",
        ]


def test_a_store_that_is_gone_does_not_end_the_listening() -> None:
    with DemoGate(robot=False) as house:
        house.activate()
        house.gate.ledger.store.close()
        house.service.queries.mission.changed()
        house.do(house.service._listen)
        house.do(lambda: quietly(house.gate.ledger.flush))
        house.crashes = True


# the clocks


def running(house: DemoGate, *, after: Any = None) -> None:
    """Run the service's clocks until somebody ends it."""

    async def whole() -> None:
        async with asyncio.timeout(30):
            serving = asyncio.create_task(house.service.run())
            if after is not None:
                await after()
            await serving

    house.do(whole)


def test_the_clocks_look_flush_and_listen_until_the_end() -> None:
    with DemoGate(robot=False, estimator=False) as house:
        planner = house.enter(ClientRole.PLANNER)
        house.begin(planner, FORBIDDEN)  # no mission: a refusal, which waits
        rows = house.gate.ledger.run(lambda act: act.head()[0])

        async def flushed() -> None:
            while house.gate.ledger.run(lambda act: act.head()[0]) == rows:
                await asyncio.sleep(0.01)
            house.service.ended.set()

        running(house, after=flushed)
        planner.pull()
        assert planner.line.recv(1) == b""  # everybody was let go


def test_a_clock_that_fails_ends_the_gate_and_the_robot_is_stopped_first() -> None:
    with DemoGate(stand_within_ms=100) as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        house.begin(planner, GO)
        house.advance(500)

        def fails(_: int) -> None:
            house.service._advance = None
            raise ZeroDivisionError

        house.service._advance = fails
        with pytest.raises(ZeroDivisionError):
            running(house)
        assert house.controller is not None
        assert len(house.controller.bodies(Kind.HALT)) == 1  # though nobody answered in time
        assert house.log("stop")[0].open["by"] == "gate"


async def answering(house: DemoGate) -> None:
    """Answer as the controller would, from its own process, until nothing moves."""
    loop = asyncio.get_running_loop()
    controller, session = house.controller, house.session
    assert controller is not None
    assert session is not None
    while len(house.service.leases):
        controller.pull()
        came, controller.got = controller.got, []
        for item in came:
            for sent in session.handle(MessageSource.GATE, item, house.clock.ms):
                data = frame(sent.kind, sent.id, sent.body)
                await loop.sock_sendall(controller.line, data)
        await asyncio.sleep(0.001)


def test_a_clean_end_stops_what_moves_and_writes_how_it_ended() -> None:
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        house.begin(planner, GO)
        house.advance(500)
        house.service.ended.set()
        assert house.controller is not None

        running(house, after=lambda: answering(house))
        (record,) = house.log("outcome")
        assert (record.link.decision, record.open["reasons"]) == ("aborted", ["STOPPED"])
        assert house.standing.open == ()


def test_nothing_is_decided_once_the_gate_ends_however_it_came() -> None:
    with DemoGate(stand_within_ms=30_000) as house:
        planner, late, reads = (house.enter(ClientRole.PLANNER, name) for name in "abc")
        house.activate()
        house.begin(planner, GO)
        house.advance(500)
        number = house.begin(reads, SCAN + b"\n" * 20_000)  # a process of its own reads it

        async def ends() -> None:
            loop = asyncio.get_running_loop()
            resting = asyncio.create_task(house.service._come_to_rest())
            while not house.service._closing:
                await asyncio.sleep(0)
            asked = Propose(key="late", plan=SCAN)
            await loop.sock_sendall(late.line, frame(Kind.PROPOSE, 77, asked))
            async with asyncio.timeout(PATIENCE_S):
                while not late.bodies(Kind.ERROR, 77) or not reads.bodies(Kind.REPLY, number):
                    await asyncio.sleep(0.005)
            await answering(house)
            await resting

        house.do(ends)
        (fault,) = late.bodies(Kind.ERROR, 77)
        assert (fault["code"], fault["where"]) == ("STOPPED", "gate")
        (answer,) = reads.bodies(Kind.REPLY, number)
        assert [step["reasons"] for step in answer["steps"]] == [["STOPPED"]]
        assert [r.link.decision for r in house.log("decision")] == ["accept"]
        assert [r.link.decision for r in house.log("outcome")] == ["aborted"]


def test_simulated_time_is_told_whether_something_moves() -> None:
    with DemoGate(robot=False, store=MemoryStore()) as house:
        moving: list[bool] = []
        house.service._advance = moving.append
        house.do(house.service._look)
        assert moving == [False]
        house.service._advance = None
