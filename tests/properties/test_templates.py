# SPDX-License-Identifier: Apache-2.0
"""Laws of templates: an accepted instance is its expansion, and lies within what was signed."""

from __future__ import annotations

from typing import Any

import msgspec
from hypothesis import given
from hypothesis import strategies as st

import authguard_reference.templates as oracle
from authguard_r.authoring.templates.card import every_mission
from authguard_r.core.encoding import Tag, digest_of, encode, encode_fast
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.mission import Mission
from authguard_r.core.principals import Principal
from authguard_r.core.quantities import to_ms, to_timestamp
from authguard_r.enforcement.templates import (
    Template,
    VerifiedTemplate,
    combinations,
    filled,
    instantiate,
    require_sound,
)
from authguard_r.keys.trust import read_trust
from fixtures import scenarios, templates
from fixtures.templates import SET, edited, instance, template, token

PLAIN = msgspec.json.decode(encode(template()))
NAMES = st.sampled_from(
    ["package-p1", "package-p2", "station-101", "station-103", "plant-room", "dock", "package_p1"]
)
VALUES = NAMES | st.integers(-2, 2)
FILLS = st.dictionaries(st.sampled_from(["package", "station", "tool"]), VALUES, max_size=3)
GOOD = st.fixed_dictionaries(
    {
        "package": st.sampled_from(["package-p1", "package-p2"]),
        "station": st.sampled_from(["station-101", "station-102", "station-103"]),
    }
)
MIDS = st.sampled_from(["deliver.1", "deliver.a.b", "deliver.", "deliver", "other.1", "deliver-1"])
OFFSETS = st.integers(-3_600, 3_600)
LENGTHS = st.sampled_from([-1, 0, 1, 1_499, 1_500, 1_501, 90_000])

ISSUER = Principal(
    id="operator-1",
    role="operator",
    scope=scenarios.EVERYWHERE,
    usable_until_ms=scenarios.START_MS + 10**9,
)
TRUST = read_trust(templates.one_folder())
HELD = VerifiedTemplate(template=template(), digest=templates.digest(), issuer=ISSUER)


def within(mission: Mission, card: tuple[Mission, ...]) -> bool:
    """True when the mission is one that the signer was shown, but for the instance's own words."""
    own = ("mid", "nonce", "not_before", "expiry")
    return any(
        encode(SET(mission, **{name: getattr(shown, name) for name in own})) == encode(shown)
        for shown in card
    )


@given(GOOD | FILLS, MIDS, OFFSETS, LENGTHS)
def test_an_instance_is_taken_exactly_when_the_signer_s_words_cover_it(
    fill: Any, mid: str, offset: int, length: int
) -> None:
    start = scenarios.START_MS + offset * 1_000
    window = {"not_before": to_timestamp(start), "expiry": to_timestamp(start + length * 1_000)}
    made = instance(fill=fill, mid=mid, **window)
    plain = msgspec.json.decode(encode_fast(made))
    covered = oracle.covers(PLAIN, templates.digest(), plain, length * 1_000) and length >= 0
    try:
        found = instantiate(token(made), HELD, verifier=TRUST, now=scenarios.NOW)
    except AuthGuardError:
        assert not covered
        return
    assert covered
    mission = found.mission.mission
    assert encode(mission) == encode(msgspec.convert(oracle.expand(PLAIN, plain), Mission))
    assert found.mission.digest == digest_of(Tag.MISSION, mission)
    assert within(mission, every_mission(template()))
    assert (mission.mid, mission.nonce, mission.version) == (made.mid, made.nonce, 1)
    assert mission.issuer == found.mission.issuer.id == "operator-1"
    last, first = (to_ms(t, where="") for t in (mission.expiry, mission.not_before))
    assert last - first <= template().for_ms


def leaves(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    if isinstance(value, dict) and set(value) != {"hole"}:
        return [p for k, v in value.items() for p in leaves(v, (*path, k))]
    if isinstance(value, list):
        return [p for n, v in enumerate(value) for p in leaves(v, (*path, n))]
    return [path]


@given(st.sampled_from(leaves(PLAIN["mission"])), st.sampled_from(["package", "station"]))
def test_wherever_a_hole_is_put_only_its_value_changes(path: tuple[Any, ...], name: str) -> None:
    """A hole that is taken never changes which grants there are, nor who must approve what."""
    changed: Template = edited((path, {"hole": name}))
    try:
        require_sound(changed)
        missions = [filled(changed, fill) for fill in combinations(changed)]
    except AuthGuardError:
        return
    shapes = {
        encode(
            [
                (g.id, g.type, g.tool, g.chooser, g.repeat, g.starts, g.max_ms, g.irreversible)
                for g in mission.actions
            ]
        )
        for mission in missions
    }
    policies = {encode((m.risk_policy, m.budgets, m.rid, m.issuer, m.site)) for m in missions}
    assert (len(shapes), len(policies)) == (1, 1)


@given(st.binary(max_size=200) | st.sampled_from([token(), templates.signed(), scenarios.token()]))
def test_any_bytes_at_all_are_an_instance_or_a_refusal(data: bytes) -> None:
    try:
        instantiate(data, HELD, verifier=TRUST, now=scenarios.NOW)
    except AuthGuardError:
        return
    assert data == token()
