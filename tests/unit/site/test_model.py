# SPDX-License-Identifier: Apache-2.0
"""The site's digests, and the facts that a decision reads for one robot."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from authguard_r.core.encoding import Tag, decode, digest, encode
from authguard_r.core.errors import EnvironmentFault, MalformedError
from authguard_r.core.geometry import polygon
from authguard_r.core.reasons import Reason
from authguard_r.site.model import (
    ActionModel,
    EmergencyPlaces,
    Person,
    PersonRole,
    Profile,
    Site,
    facts_of,
    profile_digest,
    site_digest,
    stopping_mm,
)
from fixtures import scenarios
from fixtures.cases import case

replace = msgspec.structs.replace
FLAGS = ("moves", "waits", "records", "stores", "transmits", "state_writing")


def profile(rid: str = "courier-1") -> str:
    return profile_digest(scenarios.site().robots[rid].profile)


# -- digests ---------------------------------------------------------------------------------------


def test_the_site_s_digest_is_that_of_its_canonical_bytes() -> None:
    assert site_digest(scenarios.site()) == digest(Tag.SITE, encode(scenarios.site()))
    assert decode(encode(scenarios.site()), Site) == scenarios.site()


def test_a_site_says_its_digest_only_as_long_as_nothing_in_it_changes() -> None:
    """A word means at execution what it meant when it was signed."""
    site = scenarios.site()
    dock = site.regions["dock"]
    changed = [
        replace(site, version=2),
        replace(site, doors=site.doors[1:]),
        replace(site, regions={**site.regions, "dock": replace(dock, floor=2)}),
        replace(site, regions={**site.regions, "dock": replace(dock, names=("Dock",))}),
        replace(site, regions={**site.regions, "dock": replace(dock, tags=("public",))}),
    ]
    assert len({site_digest(one) for one in (site, *changed)}) == len(changed) + 1


def test_two_robots_have_two_profiles_and_a_profile_is_no_site() -> None:
    assert profile("courier-1") != profile("lifter-1")
    shared = scenarios.site().robots["courier-1"].profile
    assert profile_digest(shared) == digest(Tag.PROFILE, encode(shared))
    assert profile_digest(shared) != digest(Tag.SITE, encode(shared))


def test_a_profile_that_can_do_one_thing_more_is_another_profile() -> None:
    base = scenarios.site().robots["courier-1"].profile
    stronger = [
        replace(base, max_speed_mm_s=base.max_speed_mm_s + 1),
        replace(base, max_force_mn=base.max_force_mn + 1),
        replace(base, max_payload_g=base.max_payload_g + 1),
        replace(base, tools={**base.tools, "navigate": ("base", "wheels")}),
    ]
    assert len({profile_digest(one) for one in (base, *stronger)}) == 5


def test_a_field_that_the_model_does_not_have_is_refused() -> None:
    data = encode(scenarios.site())
    with pytest.raises(MalformedError) as caught:
        decode(data.replace(b'"doors":', b'"door":[],"doors":', 1), Site)
    assert caught.value.reason is Reason.MALFORMED


def plain(path: str, value: Any) -> bytes:
    """Return the site's canonical bytes with the value at a path replaced."""
    whole = msgspec.json.decode(encode(scenarios.site()))
    *steps, last = path.split("/")
    inner = whole
    for step in steps:
        inner = inner[step]
    inner[last] = value
    return encode(whole)


def test_each_field_of_a_site_ends_where_its_type_ends() -> None:
    for path, last, beyond in [
        ("version", 0, -1),
        ("id", "a", "A"),
        ("regions/dock/floor", -3, "1"),
        ("regions/dock/points", [[0, 0]] * 3, [[0, 0]] * 2),
        ("regions/dock/points", [[0, 0]] * 256, [[0, 0]] * 257),
        ("regions/dock/approach", [0, 0], [0, 0, 0]),
        ("objects/sharps-bin/mass_g", 0, -1),
        ("robots/lifter-1/profile/max_speed_mm_s", 0, -1),
        ("robots/lifter-1/profile/max_force_mn", 2**53 - 1, "40 N"),
        ("vocabulary/wait/fields", ["route"], ["time"]),
        ("vocabulary/take_photo/privacy", 1, -1),
        ("vocabulary/take_photo/privacy", 3, 4),
        ("vocabulary/wait/params/duration_ms/rounding", "position", "up"),
    ]:
        with case(path, last, beyond):
            assert decode(plain(path, last), Site)
            with pytest.raises(MalformedError) as caught:
                decode(plain(path, beyond), Site)
            assert caught.value.reason is Reason.MALFORMED


def test_no_privacy_impact_is_written_by_leaving_it_out() -> None:
    with pytest.raises(MalformedError) as caught:
        decode(plain("vocabulary/wait/privacy", 0), Site)
    assert caught.value.reason is Reason.NOT_CANONICAL


def test_a_site_cannot_be_changed_once_it_is_read() -> None:
    site = scenarios.site()
    assert site.emergency is None
    for value, field in (
        (site, "version"),
        (site.regions["dock"], "points"),
        (site.objects["package-p1"], "kind"),
        (site.robots["courier-1"], "profile"),
        (site.robots["courier-1"].profile, "max_speed_mm_s"),
        (site.vocabulary["navigate"], "moves"),
        (site.vocabulary["navigate"].params["speed_mm_s"], "high"),
        (site.doors[0], "at"),
    ):
        with pytest.raises(AttributeError):
            setattr(value, field, None)


def test_what_a_site_leaves_out_is_not_in_its_digest() -> None:
    """A site that was signed before there were people and baselines keeps its digest."""
    spelled = msgspec.json.decode(encode(scenarios.site()))
    assert {"people", "emergency", "baseline", "words"}.isdisjoint(spelled)
    assert site_digest(scenarios.site()) == "IS9-R4CY81wwJMH8q863s0L6Ugh0qUvM5CMEUOxLUJo"
    envelope = {"max_accel_mm_s2", "brake_mm_s2", "reaction_ms", "controllers"}
    assert envelope.isdisjoint(spelled["robots"]["courier-1"]["profile"])
    bare = Profile(tools={}, max_speed_mm_s=1, max_force_mn=1, max_payload_g=1, controllers={})
    assert b"controllers" not in encode(bare)


@pytest.mark.parametrize(
    ("part", "value"),
    [
        ("people", {"ann": Person(roles=(PersonRole.OPERATOR,), names=("Ann",))}),
        ("emergency", EmergencyPlaces(places={"dock": "charging"})),
        ("baseline", ("announce",)),
    ],
)
def test_each_new_part_of_a_site_changes_its_digest_and_comes_back(part: str, value: Any) -> None:
    changed = replace(scenarios.site(), **{part: value})
    assert decode(encode(changed), Site) == changed
    assert site_digest(changed) != site_digest(scenarios.site())


def test_each_new_field_ends_where_its_type_ends() -> None:
    for path, last, beyond in [
        ("people", {"ann": {"roles": ["operator"]}}, {"ann": {"roles": ["owner"]}}),
        ("people", {"ann": {"roles": ["site_authority"]}}, {"Ann": {"roles": ["operator"]}}),
        ("emergency", {"places": {"dock": "charging"}}, {"places": {"dock": 1}}),
        ("emergency", {"places": {}}, {}),
        ("baseline", ["announce"], "announce"),
        ("regions/dock/within", "pharmacy", "Pharmacy"),
        ("robots/lifter-1/profile/brake_mm_s2", 1, 0),
        ("robots/lifter-1/profile/max_accel_mm_s2", 1, 0),
        ("robots/lifter-1/profile/reaction_ms", 0, -1),
        ("robots/lifter-1/profile/controllers", {"nav2": "A" * 43}, {"nav2": "A" * 44}),
    ]:
        with case(path, last, beyond):
            assert decode(plain(path, last), Site)
            with pytest.raises(MalformedError):
                decode(plain(path, beyond), Site)


@pytest.mark.parametrize(
    ("speed", "reaction", "brake", "way"),
    [(0, 100, 500, 0), (1000, 0, 500, 1000), (1000, 100, 500, 1100), (1, 1, 10**6, 2)],
)
def test_a_robot_stops_within_the_way_that_its_profile_says_never_shorter(
    speed: int, reaction: int, brake: int, way: int
) -> None:
    base = scenarios.site().robots["courier-1"].profile
    known = replace(base, reaction_ms=reaction, brake_mm_s2=brake)
    assert stopping_mm(known, speed) == way
    assert stopping_mm(replace(known, reaction_ms=None), speed) is None
    assert stopping_mm(replace(known, brake_mm_s2=None), speed) is None


# -- facts -----------------------------------------------------------------------------------------


def test_the_facts_are_the_site_s_own_words_for_one_robot() -> None:
    site = scenarios.site()
    facts = facts_of(site, rid="courier-1", profile=profile())
    assert facts.digest == site_digest(site)
    assert (facts.robot.rid, facts.robot.profile) == ("courier-1", profile())
    assert facts.robot.tools["navigate"] == {"base"}
    assert set(facts.robot.tools) == set(site.robots["courier-1"].profile.tools)
    assert facts.objects == {
        "package-p1": "medicine",
        "package-p2": "medicine",
        "sharps-bin": "hazardous",
    }
    for name, region in site.regions.items():
        assert facts.regions[name].area == polygon(region.map, region.floor, region.points)
        assert facts.regions[name].tags == set(region.tags)
    assert set(facts.regions) == set(site.regions)
    assert set(facts.vocabulary) == set(site.vocabulary)
    speed = facts.vocabulary["navigate"].params["speed_mm_s"]
    assert (speed.low, speed.high, speed.required, speed.monitored_by) == (
        1,
        3000,
        True,
        "speed_mm_s",
    )


def test_another_robot_has_other_facts() -> None:
    facts = facts_of(scenarios.site(), rid="lifter-1", profile=profile("lifter-1"))
    assert facts.robot.rid == "lifter-1"
    assert "take_photo" not in facts.robot.tools


@pytest.mark.parametrize(
    ("rid", "digest"),
    [
        ("courier-2", profile()),
        ("Courier-1", profile()),
        ("", profile()),
        ("lifter-1", profile("courier-1")),
        ("courier-1", profile("lifter-1")),
        ("courier-1", "A" * 43),
        ("courier-1", ""),
    ],
    ids=["unknown", "case", "empty", "other's profile", "profile of another", "zeros", "none"],
)
def test_a_robot_or_profile_that_the_site_does_not_know_has_no_facts(rid: str, digest: str) -> None:
    """A gate's certificate names both; a site that knows another robot is the wrong site."""
    with pytest.raises(EnvironmentFault) as caught:
        facts_of(scenarios.site(), rid=rid, profile=digest)
    assert caught.value.reason is Reason.PROFILE_MISMATCH
    assert caught.value.where == f"robots.{rid}"
    assert "hospital-floor-1" in caught.value.message


def test_a_robot_whose_profile_changed_has_no_facts_under_its_old_certificate() -> None:
    site = scenarios.site()
    robot = site.robots["courier-1"]
    faster = replace(robot, profile=replace(robot.profile, max_speed_mm_s=9999))
    changed = replace(site, robots={**site.robots, "courier-1": faster})
    with pytest.raises(EnvironmentFault):
        facts_of(changed, rid="courier-1", profile=profile())
    assert facts_of(changed, rid="courier-1", profile=profile_digest(faster.profile))


@pytest.mark.parametrize("flag", FLAGS)
def test_each_flag_of_an_action_type_reaches_the_decision_alone(flag: str) -> None:
    """A flag that were dropped here would switch its check off."""
    fields: dict[str, Any] = {flag: True}
    site = scenarios.site()
    vocabulary = {**site.vocabulary, "odd": ActionModel(fields=("source",), privacy=3, **fields)}
    facts = facts_of(replace(site, vocabulary=vocabulary), rid="courier-1", profile=profile())
    found = facts.vocabulary["odd"]
    assert {name: getattr(found, name) for name in FLAGS} == {n: n == flag for n in FLAGS}
    assert (found.fields, found.privacy, found.params) == ({"source"}, 3, {})


def test_an_action_type_says_nothing_that_it_was_not_told() -> None:
    bare = ActionModel(fields=())
    assert not any(getattr(bare, flag) for flag in FLAGS)
    assert (bare.privacy, bare.params) == (0, {})
