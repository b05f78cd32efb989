# SPDX-License-Identifier: Apache-2.0
"""Samples of a stream: within the signed limits and able to stop inside, or zero."""

from __future__ import annotations

from hashlib import sha256
from typing import Any

import msgspec
import pytest

from authguard_r.core.action import Action
from authguard_r.core.encoding import b64, encode_fast
from authguard_r.core.errors import ControllerError
from authguard_r.core.identifiers import Digest
from authguard_r.core.mission import Limit
from authguard_r.core.state import AttestedState
from authguard_r.server.streams import Streams, _Stream, is_stream
from authguard_r.wire.gate_limits import LIMITS
from authguard_r.wire.messages import ClientRole, Close, Kind, Sample
from fixtures import scenarios
from unit.server.demo_site import (
    GO,
    DemoGate,
    Guest,
    Refused,
    drive,
    driving,
    driving_mission,
    reasons,
    ticket_of,
)

OTHER = Limit(parameter="speed_mm_s", low=0, high=1)
ZERO = {"linear_mm_s": 0, "lateral_mm_s": 0, "turn_urad_s": 0}
SLOW = {**ZERO, "linear_mm_s": 120}


class Driven:
    """A house with one stream under way."""

    def __init__(self, house: DemoGate, **plan: int) -> None:
        self.house = house
        self.planner: Guest = house.enter(ClientRole.PLANNER)
        house.activate()
        self.number = house.begin(self.planner, drive(**plan))
        (event,) = self.planner.bodies(Kind.EVENT, self.number)
        self.ticket = Digest(event["ticket"])
        assert self.ticket == ticket_of(house)
        house.clock.ms += LIMITS.sample_gap_ms

    def sample(self, params: dict[str, int], by: Guest | None = None) -> tuple[bool, Any]:
        """Send a sample; return whether it went as it was, and what the controller got."""
        house = self.house
        house.pump()
        answer = (by or self.planner).ask(Kind.SAMPLE, Sample(ticket=self.ticket, params=params))
        assert house.controller is not None
        house.controller.pull()
        got = [
            msgspec.json.decode(item.body)
            for item in house.controller.got
            if item.kind is Kind.FORWARD
        ]
        house.pump()
        return answer["forwarded"], got[-1]["params"] if got else None

    def later(self, ms: int = LIMITS.sample_gap_ms) -> None:
        self.house.clock.ms += ms


def test_a_sample_within_its_limits_goes_to_the_controller_as_it_is() -> None:
    with driving() as house:
        driven = Driven(house)
        assert driven.sample(SLOW) == (True, SLOW)
        house.advance(1_000)
        assert house.place[0] > 36_000


@pytest.mark.parametrize(
    "params",
    [
        {**ZERO, "linear_mm_s": 501},
        {**ZERO, "lateral_mm_s": -501},
        {**ZERO, "turn_urad_s": 500_001},
        {"linear_mm_s": 100},
        {},
        {**ZERO, "duration_ms": 100},
        {**ZERO, "speed_mm_s": 100},
    ],
)
def test_a_sample_that_is_not_whole_or_not_within_its_limits_is_zero(
    params: dict[str, int],
) -> None:
    with driving() as house:
        driven = Driven(house)
        assert driven.sample(params) == (False, ZERO)


def test_a_mission_wide_limit_narrows_a_grants_and_none_at_all_is_zero() -> None:
    mission = driving_mission()
    (grant,) = mission.actions
    limits = (Limit(parameter="linear_mm_s", low=0, high=50), OTHER)
    with driving(mission=msgspec.structs.replace(mission, limits=limits)) as house:
        driven = Driven(house, ahead=50)
        assert driven.sample(SLOW) == (False, ZERO)
        driven.later()
        assert driven.sample({**ZERO, "linear_mm_s": 50})[0] is True
        stream = house.streams._open[driven.ticket]  # type: ignore[union-attr]
        stream.limits = ()
        driven.later()
        assert driven.sample(ZERO) == (False, ZERO)
    assert grant.type == "drive"


def test_a_sample_too_soon_is_shed_unforwarded() -> None:
    with driving() as house:
        driven = Driven(house)
        assert driven.sample(SLOW)[0] is True
        driven.later(LIMITS.sample_gap_ms - 1)
        assert driven.sample({**ZERO, "linear_mm_s": 121}) == (False, None)
        driven.later(1)
        assert driven.sample(SLOW)[0] is True


def test_a_sample_whose_stopping_place_is_outside_is_zero() -> None:
    # the corridor begins at 34 m: 500 mm/s take 250 mm to brake and 50 mm to react
    with driving() as house:
        driven = Driven(house, ahead=-400)
        while house.place[0] > 34_400:
            house.advance(50)
            assert house.place[0] > 34_000
        assert driven.sample({**ZERO, "linear_mm_s": -500}) == (False, ZERO)
        driven.later()
        assert driven.sample({**ZERO, "linear_mm_s": -100})[0] is True


def test_a_streams_first_velocity_is_held_to_its_stopping_place_like_any_other() -> None:
    with driving() as house:
        driven = Driven(house, ahead=-400)
        while house.place[0] > 34_400:
            house.advance(50)
        driven.planner.ask(Kind.CLOSE, Close(ticket=driven.ticket))
        house.rest(driven.planner, driven.number)
        house.advance(1_000)
        here = house.place
        assert here[0] > 34_000
        (step,) = house.propose(driven.planner, drive(ahead=-500, ms=5_000))["steps"]
        assert step["outcome"] == "accept"
        assert step["execution"]["outcome"] == "not_started"
        assert reasons(step) == ["OUTSIDE_REGIONS"]
        assert house.place == here
        (record,) = [r for r in house.log("outcome") if r.link.decision == "not_started"]
        assert record.open["reasons"] == ["OUTSIDE_REGIONS"]
        assert house.standing.uses["roam"].starts == 1  # the first one's alone
        (away,) = house.propose(driven.planner, drive(ahead=100, ms=500))["steps"]
        assert away["execution"]["outcome"] == "succeeded"


def test_without_a_known_place_no_stream_begins_and_anything_else_may() -> None:
    with driving() as house:
        driven = Driven(house)
        streams = house.streams
        assert streams is not None
        lease = streams._open[driven.ticket].lease
        streams._bounds._state = lambda: None
        action = Action(type="drive", tool="base", params={"linear_mm_s": 1, "duration_ms": 5})
        with pytest.raises(ControllerError) as refused:
            streams._bounds.admit(action, lease)
        assert (refused.value.reason, refused.value.where) == ("OUTSIDE_REGIONS", "params")
        streams._bounds.admit(scenarios.navigate("dock", "pharmacy"), lease)


def test_a_stream_is_closed_after_its_duration_and_takes_no_sample_then() -> None:
    with driving() as house:
        driven = Driven(house, ms=2_000)
        assert house.controller is not None
        house.session = None  # a controller that does not count by itself
        house.clock.ms += 1_980 - LIMITS.sample_gap_ms
        assert driven.sample(SLOW)[0] is True
        assert house.controller.bodies(Kind.CLOSE) == []
        driven.later(20)
        forwarded = len(house.controller.bodies(Kind.FORWARD))
        with pytest.raises(Refused) as refused:
            driven.sample(SLOW)
        assert (refused.value.code, refused.value.where) == ("LEASE_ENDED", "ticket")
        for _ in range(3):  # once is enough
            house.do(house.service._look)
        assert house.controller.bodies(Kind.CLOSE) == [{"ticket": driven.ticket}]
        assert len(house.controller.bodies(Kind.FORWARD)) == forwarded


def fits(
    streams: Streams, stream: _Stream, params: dict[str, int], state: AttestedState | None
) -> bool:
    """Return whether a sample passes in this state."""
    streams._bounds._state = lambda: state
    return streams._fits(stream, params)


def test_what_is_not_known_any_more_reaches_further() -> None:
    # at 36 500 + 150 mm of margin and 240 mm of braking there is a meter left, for two seconds
    with driving() as house:
        driven = Driven(house, ahead=100)
        house.advance(5_000)
        fast = {**ZERO, "linear_mm_s": 450}
        assert driven.sample(fast)[0] is True
        streams, state = house.streams, house.gate.enforcer.inputs.state
        assert streams is not None
        stream = streams._open[driven.ticket]
        house.clock.ms += 10_000
        assert fits(streams, stream, fast, state) is False
        assert fits(streams, stream, ZERO, state) is True
        assert fits(streams, stream, ZERO, None) is False
        assert state is not None
        lost = msgspec.structs.replace(state.snapshot, pose=None)
        assert fits(streams, stream, ZERO, msgspec.structs.replace(state, snapshot=lost)) is False
        away = msgspec.structs.replace(state.snapshot.pose, x_mm=10**6)  # type: ignore[type-var]
        gone = msgspec.structs.replace(state.snapshot, pose=away)
        assert fits(streams, stream, ZERO, msgspec.structs.replace(state, snapshot=gone)) is False


def test_without_regions_or_known_brakes_the_lease_alone_holds_a_stream() -> None:
    with driving() as house:
        driven = Driven(house)
        streams = house.streams
        assert streams is not None
        stream = streams._open[driven.ticket]
        nowhere = msgspec.structs.replace(stream.lease, regions=())
        assert streams._bounds.stays_inside(nowhere, SLOW) is True
        streams._bounds._stopping_mm = lambda _: None
        house.clock.ms += 10**6
        assert streams._bounds.stays_inside(stream.lease, SLOW) is True


def test_another_clients_stream_is_not_to_be_sampled_nor_ended() -> None:
    with driving() as house:
        driven = Driven(house)
        other = house.enter(ClientRole.PLANNER, "other")
        for kind, body in (
            (Kind.SAMPLE, Sample(ticket=driven.ticket, params=ZERO)),
            (Kind.CLOSE, Close(ticket=driven.ticket)),
        ):
            with pytest.raises(Refused) as refused:
                other.ask(kind, body)
            assert (refused.value.code, refused.value.where) == ("LEASE_ENDED", "ticket")
        assert house.controller is not None
        house.controller.pull()
        assert not [i for i in house.controller.got if i.kind in {Kind.FORWARD, Kind.CLOSE}]


def test_what_is_no_stream_is_not_to_be_sampled() -> None:
    with driving() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        with pytest.raises(Refused):
            planner.ask(Kind.SAMPLE, Sample(ticket=Digest("A" * 43), params=ZERO))
    with DemoGate() as house:
        planner = house.enter(ClientRole.PLANNER)
        house.activate()
        house.begin(planner, GO)
        with pytest.raises(Refused) as refused:
            planner.ask(Kind.SAMPLE, Sample(ticket=ticket_of(house), params=ZERO))
        assert refused.value.code == "LEASE_ENDED"


def test_one_record_a_second_says_what_went_by_and_a_last_one_comes_before_the_outcome() -> None:
    with driving() as house:
        driven = Driven(house)
        went: list[dict[str, int]] = []
        digest = sha256()
        for speed in (100, 700, 150, 60):
            went.append({**ZERO, "linear_mm_s": speed})
            driven.sample(went[-1])
            house.advance(250)
        driven.sample(went[-1])
        driven.sample(went[-1])  # at the same time
        for params in (*went, went[-1], went[-1]):
            digest.update(encode_fast(params))
        house.advance(LIMITS.stream_record_ms)
        house.advance(2 * LIMITS.stream_record_ms)
        driven.planner.ask(Kind.CLOSE, Close(ticket=driven.ticket))
        house.pump()
        (step,) = house.rest(driven.planner, driven.number)["steps"]
        assert step["execution"]["outcome"] == "succeeded"
        records = house.log("stream")
        counted = ("samples", "forwarded", "zeroed", "shed")
        total = {name: sum(r.open[name] for r in records) for name in counted}
        assert total == {"samples": 6, "forwarded": 4, "zeroed": 1, "shed": 1}
        assert [r.open["last"] for r in records] == [False] * (len(records) - 1) + [True]
        assert len(records) <= 4
        assert records[-1].open["digest"] == b64(digest.digest())
        extremes = [house.sealed(r.link.seq)["extremes"].get("linear_mm_s") for r in records]
        assert [min(e[0] for e in extremes if e), max(e[1] for e in extremes if e)] == [60, 150]
        log = house.log()
        assert [r.kind for r in log][-2:] == ["stream", "outcome"]
        assert records[0].open["client"].endswith(".planner")


def test_a_stream_that_nobody_samples_leaves_one_last_record() -> None:
    with driving() as house:
        driven = Driven(house, ahead=0, ms=3_000)
        (step,) = house.rest(driven.planner, driven.number)["steps"]
        assert step["execution"]["outcome"] == "succeeded"
        (record,) = house.log("stream")
        assert (record.open["samples"], record.open["last"]) == (0, True)


def test_a_stream_whose_planner_is_gone_ends_at_the_next_look_and_the_log_says_when() -> None:
    with driving() as house:
        driven = Driven(house, ms=20_000)
        assert driven.sample(SLOW)[0] is True
        driven.planner.leave()
        house.advance(1_000)
        (record,) = (r for r in house.log("stream") if r.open["last"])
        assert record.open["closed"] == "planner gone"
        assert 0 <= record.open["stood_ms"] <= 1_000
        assert [r.link.decision for r in house.log("outcome")] == ["succeeded"]


def test_a_velocity_that_its_planner_never_steered_goes_on_to_its_end_without_him() -> None:
    with driving() as house:
        driven = Driven(house, ahead=100, ms=3_000)
        driven.planner.leave()
        house.advance(2_000)
        assert house.log("outcome") == []
        house.advance(2_000)
        (record,) = house.log("stream")
        assert record.open["closed"] == "duration"


def test_a_stream_that_was_stopped_says_no_other_reason_for_its_end() -> None:
    with driving() as house:
        driven = Driven(house)
        house.stop(ClientRole.OPERATOR, 1)
        house.rest(driven.planner, driven.number)
        (record,) = (r for r in house.log("stream") if r.open["last"])
        assert "closed" not in record.open


def test_an_ended_stream_is_over_for_its_planner_too() -> None:
    with driving() as house:
        driven = Driven(house)
        house.stop(ClientRole.OPERATOR, 1)
        (step,) = house.rest(driven.planner, driven.number)["steps"]
        assert reasons(step) == ["MISSION_SUSPENDED"]
        with pytest.raises(Refused):
            driven.sample(ZERO)


@pytest.mark.parametrize(
    ("params", "expected"),
    [
        ({"linear_mm_s": 1, "duration_ms": 5}, True),
        ({"turn_urad_s": 1, "duration_ms": 5}, True),
        ({"linear_mm_s": 1}, False),
        ({"duration_ms": 5}, False),
        ({"force_mn": 5, "duration_ms": 5}, False),
    ],
)
def test_a_velocity_for_a_time_is_a_stream_and_nothing_else_is(
    params: dict[str, int], expected: bool
) -> None:
    assert is_stream(Action(type="drive", tool="base", params=params)) is expected
    assert not is_stream(scenarios.navigate("dock", "pharmacy"))
