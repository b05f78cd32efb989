# SPDX-License-Identifier: Apache-2.0
"""The safety gate: one test for each rule both ways, and its independence from the mission."""

from __future__ import annotations

from functools import partial
from typing import Any

import msgspec
import pytest

from authguard_r.audit.record import NONE, read_record
from authguard_r.core.action import Action
from authguard_r.core.encoding import Tag
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.quantities import Now
from authguard_r.core.standing import Outcome
from authguard_r.core.state import AttestedState
from authguard_r.core.token import sign_object
from authguard_r.enforcement.evaluation import evaluate
from authguard_r.keys.trust import read_trust
from authguard_r.safety import EnvelopeGate, default_config, open_config
from authguard_r.sim.robot import snapshot_of
from authguard_r.site.model import facts_of, profile_digest
from authguard_r.site.words import standard_words
from fixtures import scenarios

CONFIG = default_config(scenarios.site(), scenarios.RID)


def assess(action: Action, state: AttestedState | None = None, **config: Any) -> list[str]:
    gate = EnvelopeGate(msgspec.structs.replace(CONFIG, **config))
    decision = gate.assess(action, state or scenarios.state(), scenarios.facts(), scenarios.NOW)
    assert decision.safe == (not decision.findings)
    return [str(finding.hazard) for finding in decision.findings]


def near(distance_mm: int) -> AttestedState:
    world = msgspec.structs.replace(scenarios.world(), human_distance_mm=distance_mm)
    return scenarios.attested(snapshot_of(world, robot=scenarios.RID, epoch=1, seq=1))


def grip(kind: str = "pick", force: int = 12_000, item: str = "package-p1") -> Action:
    return Action(type=kind, tool="gripper", object=item, source="dock", params={"force_mn": force})


@pytest.mark.parametrize(("speed", "hazards"), [(1_500, []), (1_501, ["SPEED"])])
def test_speed_up_to_the_envelope(speed: int, hazards: list[str]) -> None:
    assert assess(scenarios.navigate("dock", "pharmacy", speed=speed)) == hazards


def test_a_motion_that_does_not_say_how_fast_is_unsafe() -> None:
    assert assess(scenarios.navigate("dock", "pharmacy", params={})) == ["SPEED"]


WORDS_SITE = msgspec.structs.replace(
    scenarios.site(), vocabulary={**standard_words(), **scenarios.site().vocabulary}
)
WORDS_FACTS = facts_of(
    WORDS_SITE, rid=scenarios.RID, profile=profile_digest(WORDS_SITE.robots[scenarios.RID].profile)
)


def hazards_of(action: Action, state: AttestedState | None = None, **config: Any) -> list[str]:
    """Return the hazards of an action in the standard words."""
    known = msgspec.structs.replace(default_config(WORDS_SITE, scenarios.RID), **config)
    decision = EnvelopeGate(known).assess(
        action, state or scenarios.state(), WORDS_FACTS, scenarios.NOW
    )
    return [str(finding.hazard) for finding in decision.findings]


@pytest.mark.parametrize(
    ("linear", "lateral", "hazards"),
    [(1_500, 0, []), (-1_500, 0, []), (1_000, -500, []), (1_000, -501, ["SPEED"])],
)
def test_a_velocity_is_as_fast_as_its_parts_together(
    linear: int, lateral: int, hazards: list[str]
) -> None:
    params = {"linear_mm_s": linear, "lateral_mm_s": lateral, "turn_urad_s": 0, "duration_ms": 9}
    assert hazards_of(Action(type="drive", tool="base", params=params)) == hazards


def test_half_a_velocity_is_none() -> None:
    params = {"linear_mm_s": 1, "turn_urad_s": 0, "duration_ms": 9}
    assert hazards_of(Action(type="drive", tool="base", params=params)) == ["SPEED"]


def test_a_type_without_a_speed_goes_as_fast_as_the_configuration_says() -> None:
    turn = Action(type="turn", tool="base", params={"angle_urad": 1})
    assert hazards_of(turn) == []
    assert hazards_of(turn, paced={"turn": 1_501}) == ["SPEED"]
    assert hazards_of(turn, paced={}) == ["SPEED"]
    assert hazards_of(turn, near(1_000)) == ["HUMAN_PROXIMITY"]
    assert hazards_of(turn, near(1_000), paced={"turn": 300}) == []


def test_what_is_opened_is_not_lifted() -> None:
    assert hazards_of(Action(type="open", tool="hand", object="package-p1"), max_payload_g=1) == []
    lifted = Action(type="open", tool="hand", object="package-p1")
    assert hazards_of(lifted, max_payload_g=1, in_place=()) == ["PAYLOAD"]


@pytest.mark.parametrize(("force", "hazards"), [(40_000, []), (40_001, ["FORCE"])])
def test_force_up_to_the_envelope(force: int, hazards: list[str]) -> None:
    assert assess(grip(force=force)) == hazards


@pytest.mark.parametrize(("most", "hazards"), [(800, []), (799, ["PAYLOAD"])])
def test_payload_up_to_the_envelope(most: int, hazards: list[str]) -> None:
    assert assess(grip(), max_payload_g=most) == hazards


def test_an_object_of_unknown_mass_is_not_lifted() -> None:
    assert assess(grip(), masses_g={}) == ["PAYLOAD"]


@pytest.mark.parametrize(("goal", "hazards"), [("office-1", []), ("plant-room", ["KEEP_OUT"])])
def test_keep_out_regions_are_not_entered(goal: str, hazards: list[str]) -> None:
    assert assess(scenarios.navigate("dock", goal)) == hazards


def test_keep_out_regions_are_not_passed() -> None:
    way = scenarios.navigate("dock", "pharmacy", route=("plant-room",))
    assert assess(way) == ["KEEP_OUT"]


@pytest.mark.parametrize(
    ("distance", "speed", "hazards"),
    [(1_201, 301, []), (1_200, 300, []), (1_200, 301, ["HUMAN_PROXIMITY"])],
)
def test_near_people_the_robot_is_slow(distance: int, speed: int, hazards: list[str]) -> None:
    assert assess(scenarios.navigate("dock", "pharmacy", speed=speed), near(distance)) == hazards


def test_an_unknown_distance_to_people_is_no_distance() -> None:
    state = scenarios.state()
    blind = msgspec.structs.replace(state.snapshot, readings={})
    assert assess(scenarios.navigate("dock", "pharmacy"), scenarios.attested(blind)) == [
        "STATE_UNKNOWN"
    ]


@pytest.mark.parametrize(
    ("change", "hazards"),
    [
        ({"label": "camera"}, ["STATE_UNKNOWN"]),
        ({"age_ms": 1_001}, ["STATE_UNKNOWN"]),
        ({"age_ms": 1_000}, []),
    ],
)
def test_an_untrusted_or_old_distance_is_no_distance(
    change: dict[str, Any], hazards: list[str]
) -> None:
    snapshot = scenarios.state().snapshot
    seen = msgspec.structs.replace(snapshot.readings["human_distance_mm"], **change)
    snapshot = msgspec.structs.replace(
        snapshot, readings={**snapshot.readings, "human_distance_mm": seen}
    )
    state = scenarios.attested(snapshot)
    assert assess(scenarios.navigate("dock", "pharmacy"), state) == hazards


def test_another_robots_state_is_no_state() -> None:
    state = scenarios.state(rid=scenarios.OTHER)
    assert assess(scenarios.navigate("dock", "pharmacy"), state) == ["STATE_UNKNOWN"]


def test_nothing_is_picked_with_a_full_gripper_or_placed_from_an_empty_one() -> None:
    full, empty = scenarios.state(holding="package-p1"), scenarios.state()
    assert assess(grip("pick"), full) == ["NOT_EXECUTABLE"]
    assert assess(grip("pick"), empty) == []
    assert assess(grip("place"), full) == []
    assert assess(grip("place"), empty) == ["NOT_EXECUTABLE"]
    assert assess(grip("place", item="package-p2"), full) == ["NOT_EXECUTABLE"]


def test_an_unknown_type_or_another_robots_profile_is_unsafe() -> None:
    assert assess(Action(type="dance", tool="base")) == ["STATE_UNKNOWN"]
    assert assess(scenarios.navigate("dock", "pharmacy"), profile="A" * 43) == ["STATE_UNKNOWN"]


def test_a_repair_slows_down_and_changes_nothing_else() -> None:
    action = scenarios.navigate("dock", "pharmacy", speed=2_000)
    decision = EnvelopeGate(CONFIG).assess(action, near(500), scenarios.facts(), scenarios.NOW)
    assert decision.repair is not None
    assert decision.repair == msgspec.structs.replace(action, params={"speed_mm_s": 300})


def test_what_is_wrong_besides_speed_is_not_repaired() -> None:
    action = scenarios.navigate("dock", "plant-room", speed=2_000)
    assert (
        EnvelopeGate(CONFIG).assess(action, near(500), scenarios.facts(), scenarios.NOW).repair
        is None
    )


def test_a_verdict_has_no_truth_value() -> None:
    decision = EnvelopeGate(CONFIG).assess(
        grip(), scenarios.state(), scenarios.facts(), scenarios.NOW
    )
    with pytest.raises(TypeError):
        bool(decision)


@pytest.mark.parametrize(
    ("by", "reason"), [("safety-officer-1", ""), ("operator-1", "ROLE_DENIED")]
)
def test_only_a_safety_officer_signs_the_configuration(by: str, reason: str) -> None:
    folder = scenarios.trust_folder()
    token = sign_object(CONFIG, Tag.SAFETY, scenarios.folder_signer(folder, by))
    now = Now(scenarios.START_MS, 0)
    if not reason:
        assert open_config(token, verifier=read_trust(folder), now=now) == CONFIG
        return
    with pytest.raises(AuthGuardError, match=reason):
        open_config(token, verifier=read_trust(folder), now=now)


#: One proposal for each pair of verdicts: its goal, its speed, and how far the nearest person is.
PAIRS = {
    ("accept", True): ("pharmacy", 500, 5_000),
    ("reject", True): ("station-103", 500, 5_000),
    ("reject", False): ("plant-room", 500, 5_000),
    ("accept", False): ("pharmacy", 700, 500),
}


@pytest.mark.parametrize(("authorized", "safe"), PAIRS)
def test_all_four_pairs_of_verdicts_occur(authorized: str, safe: bool) -> None:
    """Source: section "Safety and Authorization Policies": the two predicates are independent."""
    goal, speed, distance = PAIRS[authorized, safe]
    verified, gate = scenarios.verified(), EnvelopeGate(CONFIG)
    asked = partial(
        evaluate,
        verified,
        scenarios.navigate("dock", goal, speed=speed),
        state=near(distance),
        facts=scenarios.facts(),
        now=scenarios.NOW,
        standing=scenarios.active(verified),
    )
    judged = asked(safety=gate)
    assert judged.safety is not None
    assert (str(judged.decision.verdict), judged.safety.safe) == (authorized, safe)
    assert judged.released == ((authorized, safe) == ("accept", True))
    assert not asked(safety=None).released  # the second gate was not asked


@pytest.mark.parametrize(("authorized", "safe"), PAIRS)
def test_the_robot_moves_only_when_both_gates_accept(authorized: str, safe: bool) -> None:
    goal, speed, distance = PAIRS[authorized, safe]
    world = msgspec.structs.replace(scenarios.world(), human_distance_mm=distance)
    sim = scenarios.simulation(start=world)
    before = sim.gate.management.activate(scenarios.token())
    report = scenarios.propose(sim, scenarios.navigate("dock", goal, speed=speed))
    released = (authorized, safe) == ("accept", True)
    assert report.outcome == (Outcome.SUCCEEDED if released else None)
    assert len(sim.robot.trace) == released
    standing = sim.gate.management.standing("deliver-p1")
    assert (standing == before) == (not released)
    record = read_record(sim.gate.ledger.store.rows()[report.seq].record, where="")
    assert (record.open["ticket"] != NONE) == released


@pytest.mark.parametrize("speed", [-1_500, -1_501, 1_500, 1_501])
def test_backwards_is_as_fast_as_forwards(speed: int) -> None:
    action = scenarios.navigate("dock", "pharmacy", speed=speed)
    assert ("SPEED" in assess(action)) == (abs(speed) > CONFIG.max_speed_mm_s)
