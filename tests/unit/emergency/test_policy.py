# SPDX-License-Identifier: Apache-2.0
"""A policy counts when a safety officer signed it, and nothing in it is left open."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from authguard_r.core.errors import AuthGuardError, MalformedError
from authguard_r.core.identifiers import ActionType, RobotId
from authguard_r.core.quantities import Now, to_timestamp
from authguard_r.enforcement.emergency.lint import lint_policy
from authguard_r.enforcement.emergency.opened import open_emergency
from authguard_r.enforcement.emergency.policy import EmergencyPolicy
from authguard_r.keys.trust import read_trust
from authguard_r.site.model import Site
from authguard_r.site.words import standard_words
from fixtures import emergency_policies, scenarios
from fixtures.cases import case

GO, CALL, DROP = emergency_policies.GO_SAFE, emergency_policies.CALL, emergency_policies.LET_GO


def opened(value: EmergencyPolicy, *, by: str = "safety-officer-1", **changes: Any) -> Any:
    fields = {
        "verifier": read_trust(emergency_policies.trust_folder()),
        "now": scenarios.NOW,
        "site": emergency_policies.site(),
        "robot": scenarios.RID,
    }
    return open_emergency(emergency_policies.token(value, by=by), **{**fields, **changes})


def test_the_one_that_is_sound_and_signed_counts() -> None:
    value = emergency_policies.policy()
    assert opened(value).policy == value
    assert lint_policy(value, emergency_policies.site()) == ()


def test_one_that_does_not_count_is_refused() -> None:
    for changes, more, code in [
        ({}, {"by": "operator-1"}, "ROLE_DENIED"),
        ({}, {"by": "site-authority-1"}, "ROLE_DENIED"),
        ({"robot": scenarios.OTHER}, {}, "ROBOT_MISMATCH"),
        ({}, {"robot": RobotId("nobody")}, "ROBOT_MISMATCH"),
        ({"site": "A" * 43}, {}, "SITE_MISMATCH"),
        ({"profile": "A" * 43}, {}, "PROFILE_MISMATCH"),
        ({"expiry": to_timestamp(scenarios.START_MS - 60_000)}, {}, "EXPIRED"),
        ({"not_before": to_timestamp(scenarios.START_MS + 60_000)}, {}, "NOT_YET_VALID"),
    ]:
        with case(changes, more, code):
            with pytest.raises(AuthGuardError) as refused:
                opened(emergency_policies.policy(**changes), **more)
            assert refused.value.reason == code


def test_a_signer_of_other_regions_or_robots_signs_nothing_here() -> None:
    from authguard_r.core.principals import Scope

    class Confined:
        """A trust root whose safety officer is confined."""

        def __init__(self, scope: Scope) -> None:
            self._scope = scope
            self._inner = read_trust(emergency_policies.trust_folder())

        def verify(self, message: bytes, endorsements: Any, now: Now) -> Any:
            signer = self._inner.verify(message, endorsements, now)
            return msgspec.structs.replace(signer, scope=self._scope)

    near = Scope(robots=None, regions=frozenset({"station-103"}))
    foreign = Scope(robots=frozenset({scenarios.OTHER}), regions=None)
    for scope, where in ((near, "emergency.capabilities"), (foreign, "emergency.robot")):
        with pytest.raises(AuthGuardError) as refused:
            opened(emergency_policies.policy(), verifier=Confined(scope))
        assert (refused.value.reason, refused.value.where) == ("SIGNER_OUT_OF_SCOPE", where)


def test_a_policy_that_is_not_narrow_is_refused_however_it_is_signed() -> None:
    with pytest.raises(MalformedError) as refused:
        opened(emergency_policies.policy({**GO, "destination": "office-1"}))
    assert refused.value.where == "emergency.capabilities[0].destination"


@pytest.mark.parametrize(
    "broken",
    [
        {**GO, "guards": []},
        {**GO, "callers": []},
        {**GO, "max_ms": 600_001},
        {**GO, "per_hour": 61},
        {**GO, "object": "package-p1"},
        {**GO, "aim": "win"},
        {**GO, "without": ["safety"]},
    ],
)
def test_what_the_form_has_no_place_for_is_refused(broken: dict[str, Any]) -> None:
    with pytest.raises(msgspec.ValidationError):
        emergency_policies.policy(broken)


def wide() -> Site:
    """Return the site with every standard word, and a robot that can do all of them."""
    site = emergency_policies.site()
    words = {**standard_words(), **site.vocabulary}
    unlock = ActionType("unlatch")
    words[unlock] = words[ActionType("announce")]
    robot = site.robots[scenarios.RID]
    tools = {kind: ("any", *robot.profile.tools.get(kind, ())) for kind in words}
    profile = msgspec.structs.replace(robot.profile, tools=tools)
    robots = {**site.robots, scenarios.RID: msgspec.structs.replace(robot, profile=profile)}
    return msgspec.structs.replace(site, vocabulary=words, robots=robots)


def test_one_thing_that_is_left_open_is_found() -> None:
    for capability, field in [
        ({**GO, "type": "fly"}, "type"),
        ({**GO, "tool": "wings"}, "tool"),
        ({**GO, "type": "pick", "tool": "any"}, "type"),
        ({**GO, "type": "take_photo", "tool": "any"}, "type"),
        ({**GO, "type": "record_video", "tool": "any"}, "type"),
        ({**GO, "type": "set_pose", "tool": "any"}, "type"),
        ({**GO, "type": "wait", "tool": "any"}, "type"),
        ({**GO, "destination": "station-101"}, "destination"),
        ({**GO, "params": {}}, "params.speed_mm_s"),
        ({**GO, "params": {"speed_mm_s": 0}}, "params.speed_mm_s"),
        ({**GO, "params": {"speed_mm_s": 1_501}}, "params.speed_mm_s"),
        ({**GO, "params": {"speed_mm_s": 300, "force_mn": 1}}, "params.force_mn"),
        ({**GO, "regions": ["station-103"]}, "regions"),
        ({**GO, "regions": []}, "regions"),
        ({**GO, "regions": ["dock", "cellar"]}, "regions"),
        ({**GO, "place_max_age_ms": 0}, "place_max_age_ms"),
        ({**GO, "place_max_age_ms": 5_001}, "place_max_age_ms"),
        ({**GO, "past_safety": True}, "past_safety"),
        ({**GO, "callers": ["planner", "operator"]}, "callers"),
        ({**GO, "without": ["store", "store"]}, "without"),
        ({**GO, "guards": [emergency_policies.guard("x", "le", 1, 5_001)]}, "guards[0].max_age_ms"),
        ({**GO, "guards": [emergency_policies.guard("x", "le", True)]}, "guards[0].value"),
        ({**CALL, "type": "unlatch", "tool": "any"}, "type"),
        ({**CALL, "type": "door_lock", "tool": "any"}, "type"),
        ({**CALL, "destination": "dock"}, "destination"),
        ({**DROP, "type": "announce", "tool": "any"}, "type"),
        ({**DROP, "type": "throw", "tool": "any"}, "type"),
        ({**DROP, "type": "grip", "tool": "any", "params": {"grip_no": 1}}, "params.grip_no"),
    ]:
        with case(capability, field):
            site = wide()
            found = lint_policy(emergency_policies.policy(capability, at=site), site)
            assert f"emergency.capabilities[0].{field}" in [unsound.where for unsound in found]


def test_what_lets_go_is_sound() -> None:
    site = wide()
    opens = {**DROP, "type": "grip", "tool": "any", "params": {"grip_no": 0}}
    still = {**DROP, "id": "in-place", "regions": ["dock"], "place_max_age_ms": 500}
    past = {**CALL, "past_safety": True}
    assert lint_policy(emergency_policies.policy(opens, still, past, at=site), site) == ()


def test_a_site_without_emergency_places_has_nowhere_to_go() -> None:
    site = msgspec.structs.replace(emergency_policies.site(), emergency=None)
    found = lint_policy(emergency_policies.policy(GO, at=site), site)
    assert [unsound.where for unsound in found] == ["emergency.capabilities[0].destination"]


@pytest.mark.parametrize(
    ("changes", "where"),
    [
        ({"robot": "nobody"}, "emergency.robot"),
        ({"site": "A" * 43}, "emergency.site"),
        ({"profile": "A" * 43}, "emergency.profile"),
        ({"expiry": to_timestamp(0)}, "emergency.expiry"),
    ],
)
def test_what_binds_a_policy_is_looked_at_first(changes: dict[str, Any], where: str) -> None:
    found = lint_policy(emergency_policies.policy(**changes), emergency_policies.site())
    assert [unsound.where for unsound in found] == [where]


def test_two_capabilities_of_one_name_are_refused() -> None:
    found = lint_policy(emergency_policies.policy(GO, GO), emergency_policies.site())
    assert [unsound.where for unsound in found] == ["emergency.capabilities"]
