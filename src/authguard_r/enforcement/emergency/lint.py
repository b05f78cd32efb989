# SPDX-License-Identifier: Apache-2.0
"""Whether a policy is narrow: what it may not hold, however it was signed.

A policy with a finding is not taken in. Types are listed, not guessed: a word that the site made up
releases nothing and calls no person. Spec page: docs/spec/emergency.md#lint
"""

from __future__ import annotations

from collections.abc import Iterator

from msgspec import Struct

from authguard_r.core.identifiers import ActionType, ParameterId
from authguard_r.core.mission import Comparison
from authguard_r.enforcement.emergency.policy import Aim, Capability, EmergencyPolicy
from authguard_r.site.model import ActionModel, Profile, Site, profile_digest, site_digest

#: Types that let go of what the robot grips.
RELEASING = frozenset(map(ActionType, ("drop", "grip")))
#: Values that such a type must have: the gripper opens, it does not close.
RELEASED = {ParameterId("grip_no"): 0}
#: Types that make themselves heard; none has a text of the caller's.
CALLING = frozenset(map(ActionType, ("announce", "play_sound")))
#: How old a guard's reading and the place may be at most, in milliseconds.
MOST_AGE_MS = 5_000
SPEED = ParameterId("speed_mm_s")
_ORDERED = frozenset({Comparison.GE, Comparison.GT, Comparison.LE, Comparison.LT})


class Unsound(Struct, frozen=True):
    """One thing that a policy may not hold."""

    where: str
    message: str


def lint_policy(policy: EmergencyPolicy, site: Site) -> tuple[Unsound, ...]:
    """Return everything that is wrong with a policy at a site, empty when nothing is."""
    robot = site.robots.get(policy.robot)
    if robot is None:
        return (Unsound("emergency.robot", f"the site has no robot `{policy.robot}`"),)
    found = list(_bound(policy, site, robot.profile))
    ids = [capability.id for capability in policy.capabilities]
    if len(set(ids)) != len(ids):
        found.append(Unsound("emergency.capabilities", "expected each id once"))
    for number, capability in enumerate(policy.capabilities):
        where = f"emergency.capabilities[{number}]"
        found += [
            Unsound(f"{where}.{field}", message)
            for field, message in _capability(capability, site, robot.profile)
        ]
    return tuple(found)


def _bound(policy: EmergencyPolicy, site: Site, profile: Profile) -> Iterator[Unsound]:
    if policy.site != site_digest(site):
        yield Unsound("emergency.site", "expected the digest of this site")
    if policy.profile != profile_digest(profile):
        yield Unsound("emergency.profile", "expected the digest of the robot's profile")
    if policy.not_before >= policy.expiry:
        yield Unsound("emergency.expiry", "expected an instant after `not_before`")


def _capability(capability: Capability, site: Site, profile: Profile) -> Iterator[tuple[str, str]]:
    model = site.vocabulary.get(capability.type)
    if model is None:
        yield "type", f"the site has no type `{capability.type}`"
        return
    if capability.tool not in profile.tools.get(capability.type, ()):
        yield "tool", f"the robot has no `{capability.tool}` for `{capability.type}`"
    yield from _harmless(model)
    yield from _aimed(capability, model, site)
    yield from _params(capability, model, profile)
    yield from _guards(capability)
    yield from _places(capability, model, site)
    for field, words in (("callers", capability.callers), ("without", capability.without)):
        if list(words) != sorted(set(words)):
            yield field, "expected sorted words, each once"
    if capability.past_safety and model.moves:
        yield "past_safety", "the enforcer never starts a motion against the safety gate"


def _harmless(model: ActionModel) -> Iterator[tuple[str, str]]:
    """No capability records, transmits, waits on purpose or changes the robot's own belief."""
    for flag in ("records", "stores", "transmits", "state_writing", "waits"):
        if getattr(model, flag):
            yield "type", f"a type that says `{flag}` is no emergency's"
    if model.privacy:
        yield "type", "a type with a privacy impact is no emergency's"


def _aimed(capability: Capability, model: ActionModel, site: Site) -> Iterator[tuple[str, str]]:
    """The type fits the aim, and has no field that would be left open."""
    if capability.aim is Aim.SAFE_PLACE:
        places = site.emergency.places if site.emergency is not None else {}
        if not model.moves or "destination" not in model.fields:
            yield "type", "expected a type that goes to a destination"
        if capability.destination not in places:
            yield "destination", "expected one of the site's `emergency.places`"
    else:
        words = RELEASING if capability.aim is Aim.RELEASE_FORCE else CALLING
        if capability.type not in words or model.moves:
            yield "type", f"expected one of {', '.join(sorted(words))}"
        if capability.destination is not None or "destination" in model.fields:
            yield "destination", "only `safe_place` has one"
    if "object" in model.fields:
        yield "type", "a type with an object of its own is no emergency's"


def _params(
    capability: Capability, model: ActionModel, profile: Profile
) -> Iterator[tuple[str, str]]:
    """Every parameter is fixed, and none is more than the type or the robot allows."""
    for name, kind in model.params.items():
        value = capability.params.get(name)
        if value is None:
            yield f"params.{name}", "expected a value: nothing is left to the caller"
        elif not kind.low <= value <= kind.high:
            yield f"params.{name}", f"expected {kind.low} to {kind.high}"
        elif name == SPEED and value > profile.max_speed_mm_s:
            yield f"params.{name}", f"expected at most {profile.max_speed_mm_s}"
        elif capability.aim is Aim.RELEASE_FORCE and value != RELEASED.get(name, value):
            yield f"params.{name}", f"expected {RELEASED[name]}: it lets go"
    for name in capability.params:
        if name not in model.params:
            yield f"params.{name}", "the type has no such parameter"


def _guards(capability: Capability) -> Iterator[tuple[str, str]]:
    for number, guard in enumerate(capability.guards):
        if not 1 <= guard.max_age_ms <= MOST_AGE_MS:
            yield f"guards[{number}].max_age_ms", f"expected 1 to {MOST_AGE_MS}"
        if guard.comparison in _ORDERED and type(guard.value) is not int:
            yield f"guards[{number}].value", "expected an integer: only those are ordered"


def _places(capability: Capability, model: ActionModel, site: Site) -> Iterator[tuple[str, str]]:
    """What moves names where it may be, and knows how old the place may be."""
    for region in capability.regions:
        if region not in site.regions:
            yield "regions", f"the site has no region `{region}`"
    placed = bool(capability.regions) or model.moves
    if placed and not 1 <= capability.place_max_age_ms <= MOST_AGE_MS:
        yield "place_max_age_ms", f"expected 1 to {MOST_AGE_MS}"
    if model.moves and capability.destination not in capability.regions:
        yield "regions", "expected where the robot may be, its destination too"
