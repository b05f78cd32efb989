# SPDX-License-Identifier: Apache-2.0
"""What may be read: how things stand, in full for who may know, in numbers for who may not."""

from __future__ import annotations

from typing import Any

import msgspec

from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import ClientRole, Kind, Mode
from fixtures import scenarios
from unit.server.demo_site import FORBIDDEN, GO, SCAN, UNREADABLE, DemoGate, page


def test_status_without_a_mission_says_so() -> None:
    with DemoGate(robot=False, estimator=False) as house:
        status = house.enter(ClientRole.AUDITOR).ask(Kind.STATUS)
        assert status["mission"] is None
        assert (status["robot"], status["mode"], status["leases"]) == (scenarios.RID, "enforce", [])
        assert status["heard"] == {"planner_ms": None, "estimator_ms": None, "controller_ms": None}
        assert status["log"]["size"] == len(house.log())


def test_status_with_a_mission_says_how_far_it_is_and_what_runs() -> None:
    with DemoGate() as house:
        planner, auditor = house.enter(ClientRole.PLANNER), house.enter(ClientRole.AUDITOR)
        house.activate()
        house.begin(planner, GO)
        house.advance(500)
        house.stop(ClientRole.AUDITOR, 1, stops=None)
        status = auditor.ask(Kind.STATUS)
        mission = status["mission"]
        assert (mission["mid"], mission["status"]) == ("deliver-p1", "active")
        used = {grant["id"]: (grant["starts"], grant["of"]) for grant in mission["grants"]}
        assert (used["go-to-pharmacy"], used["pick-p1"]) == ((1, 3), (0, 2))
        (lease,) = status["leases"]
        assert [lease["ticket"]] == mission["open"]
        assert (lease["action"], lease["for_ms"]) == ("navigate", 500)
        assert lease["left_ms"] == 180_000 - 500
        assert status["stops"] == 1
        assert status["heard"]["planner_ms"] == 500
        roles = {client["role"]: client["idle_ms"] for client in status["clients"]}
        assert roles["planner"] == 500
        assert set(roles) == {"planner", "auditor", "controller", "estimator"}
        assert mission["closes"] is None


def test_status_says_when_a_mission_closes() -> None:
    with DemoGate(robot=False) as house:
        house.activate()
        ending = msgspec.convert(
            {
                **msgspec.to_builtins(house.standing),
                "status": "closing",
                "closes_ms": scenarios.START_MS,
            },
            type(house.standing),
        )
        house.gate.ledger.run(lambda act: act.hold(ending))
        house.service.queries.mission.changed()
        mission = house.enter(ClientRole.AUDITOR).ask(Kind.STATUS)["mission"]
        assert mission["status"] == "closing"
        assert mission["closes"].endswith("Z")
        assert house.service.queries.mission.runs


def test_metrics_count_and_hold_no_content_of_a_mission() -> None:
    with DemoGate() as house:
        planner, auditor = house.enter(ClientRole.PLANNER), house.enter(ClientRole.AUDITOR)
        house.activate()
        house.propose(planner, SCAN)
        for plan in (FORBIDDEN, UNREADABLE):
            house.propose(planner, plan)
        house.begin(planner, GO)
        house.advance(1_000)
        metrics: dict[str, Any] = auditor.ask(Kind.METRICS)
        assert metrics["decisions_total"] == {"accept": 2, "reject": 2}
        assert metrics["outcomes_total"] == {"succeeded": 1}
        assert (metrics["open_leases"], metrics["mission_active"]) == (1, 1)
        assert metrics["uptime_seconds"] == house.clock.ms // 1_000
        assert metrics["clients"]["planner"] == 1
        text = msgspec.json.encode(metrics).decode()
        for word in ("deliver", "pharmacy", "navigate", "scan", "package", "office", "look-out"):
            assert word not in text


def test_what_was_released_and_not_begun_counts_as_such() -> None:
    with DemoGate(robot=False) as house:
        planner, auditor = house.enter(ClientRole.PLANNER), house.enter(ClientRole.AUDITOR)
        house.activate()
        (step,) = house.propose(planner, SCAN)["steps"]
        assert step["execution"]["outcome"] == "not_started"
        assert auditor.ask(Kind.METRICS)["outcomes_total"] == {"not_started": 1}


def test_a_page_of_the_log_is_whole_records_and_never_longer_than_a_page() -> None:
    with DemoGate(mode=Mode.SHADOW) as house:
        planner, auditor = house.enter(ClientRole.PLANNER), house.enter(ClientRole.AUDITOR)
        house.activate()
        every = page(auditor)
        assert [row["seq"] for row in every] == list(range(len(house.log())))
        assert {"record", "sealed", "link"} <= every[0].keys()
        assert page(auditor, 1, 1)[0]["seq"] == 1
        assert page(auditor, 10**6) == []
        for number in range(30):  # each keeps its plan, sealed
            house.propose(planner, b"fly_to(" + str(number).encode() + b"x" * 100_000)
            house.until(lambda: len(house.log("refusal")) > number)  # noqa: B023
        long = page(auditor)
        assert len(long) < len(house.log())
        assert sum(len(msgspec.json.encode(row["sealed"])) for row in long) <= LIMITS.page_bytes
        rest = page(auditor, long[-1]["seq"] + 1)
        assert rest[0]["seq"] == long[-1]["seq"] + 1


def test_a_disk_that_cannot_be_asked_is_not_told_and_one_that_can_is() -> None:
    with DemoGate(robot=False) as house:
        assert house.enter(ClientRole.AUDITOR).ask(Kind.STATUS)["disk"] is None
    with DemoGate(robot=False, parts={"free_bytes": lambda: 7}) as house:
        auditor = house.enter(ClientRole.AUDITOR)
        reserve = house.service.config.reserve_bytes
        assert auditor.ask(Kind.STATUS)["disk"] == {"free_bytes": 7, "reserve_bytes": reserve}
        assert auditor.ask(Kind.METRICS)["disk_free_bytes"] == 7

    def gone() -> int:
        raise OSError

    with DemoGate(robot=False, parts={"free_bytes": gone}) as house:
        auditor = house.enter(ClientRole.AUDITOR)
        assert auditor.ask(Kind.STATUS)["disk"] is None
        assert "disk_free_bytes" not in auditor.ask(Kind.METRICS)


def test_status_and_metrics_say_whether_the_stop_lane_answers_where_there_is_one() -> None:
    with DemoGate(robot=False) as house:
        auditor = house.enter(ClientRole.AUDITOR)
        assert auditor.ask(Kind.STATUS)["lane"] is None
        assert "lane_alive" not in auditor.ask(Kind.METRICS)
    for alive in (True, False):
        with DemoGate(robot=False, parts={"stop_process_alive": lambda it=alive: it}) as house:
            auditor = house.enter(ClientRole.AUDITOR)
            assert auditor.ask(Kind.STATUS)["lane"] == {"alive": alive}
            assert auditor.ask(Kind.METRICS)["lane_alive"] == int(alive)


def test_metrics_say_who_is_there_and_how_long_ago_each_was_heard() -> None:
    with DemoGate() as house:
        auditor = house.enter(ClientRole.AUDITOR)
        house.enter(ClientRole.PLANNER)
        house.advance(2_000)
        metrics = auditor.ask(Kind.METRICS)
        assert metrics["controller_connected"] == 1
        assert metrics["heard_age_seconds"]["planner"] == 2
    with DemoGate(robot=False, estimator=False) as house:
        metrics = house.enter(ClientRole.AUDITOR).ask(Kind.METRICS)
        assert (metrics["controller_connected"], metrics["heard_age_seconds"]) == (0, {})


def test_a_clock_that_is_behind_hides_no_mission() -> None:
    """What was activated and released right before the clock stepped back is shown as it is."""
    with DemoGate() as house:
        planner, auditor = house.enter(ClientRole.PLANNER), house.enter(ClientRole.AUDITOR)
        house.clock.wrong_ms = -3_600_000
        assert auditor.ask(Kind.STATUS)["mission"] is None  # none was ever active
        house.clock.wrong_ms = 0
        house.activate()
        house.begin(planner, GO)
        house.clock.wrong_ms = -3_600_000
        mission = auditor.ask(Kind.STATUS)["mission"]
        assert (mission["mid"], mission["status"]) == ("deliver-p1", "active")
        held = house.gate.ledger.standing(house.mission.mid)
        assert held is not None
        assert mission["open"] == [release.ticket for release in held.open]
        assert len(mission["open"]) == 1
        assert auditor.ask(Kind.METRICS)["mission_active"] == 1
        house.gate.enforcer.inputs.forget()  # a mission that was not verified here is not shown
        house.service.queries.mission.changed()
        assert auditor.ask(Kind.STATUS)["mission"] is None
        house.clock.wrong_ms = 0
        assert auditor.ask(Kind.STATUS)["mission"]["open"] == mission["open"]


def test_a_suspension_that_is_written_late_is_shown_once_it_is() -> None:
    with DemoGate() as house:
        auditor = house.enter(ClientRole.AUDITOR)
        house.activate()
        house.clock.wrong_ms = -3_600_000
        house.stop(ClientRole.OPERATOR, 1)
        house.clock.wrong_ms = 0
        assert auditor.ask(Kind.STATUS)["mission"]["status"] == "active"
        assert house.service.stops.settled  # as the lane's connection asks again and again
        assert auditor.ask(Kind.STATUS)["mission"]["status"] == "suspended"
