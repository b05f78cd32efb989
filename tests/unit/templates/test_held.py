# SPDX-License-Identifier: Apache-2.0
"""What the store holds under a mission's digest is that mission, or the store's fault."""

from __future__ import annotations

import pytest

from authguard_r.core.encoding import Tag, digest_of, encode_fast
from authguard_r.core.errors import StoreError
from authguard_r.core.identifiers import Digest
from authguard_r.core.quantities import to_ms
from authguard_r.core.reasons import Reason
from authguard_r.core.token import VerifiedMission
from authguard_r.enforcement.templates import InstancePair, held_mission
from fixtures import scenarios, templates
from fixtures.cases import case

MISSION = scenarios.mission()
DIGEST = digest_of(Tag.MISSION, MISSION)


def pair(instance: bytes, template: bytes) -> bytes:
    texts = [token.decode("ascii").strip() for token in (instance, template)]
    return encode_fast(InstancePair(instance=texts[0], template=texts[1]))


def test_what_is_held_is_the_mission_and_no_authority() -> None:
    held = held_mission(scenarios.token(), DIGEST)
    assert (held.mission, held.digest) == (MISSION, DIGEST)
    assert held.expiry_ms == to_ms(MISSION.expiry, where="mission.expiry")
    assert not isinstance(held, VerifiedMission)


def test_a_pair_is_the_mission_that_its_template_was_filled_with() -> None:
    sim = templates.admitted()
    standing = sim.gate.management.activate(templates.token())
    held = held_mission(pair(templates.token(), templates.signed()), standing.digest)
    assert held.mission.mid == "deliver.1"


def test_anything_else_under_its_digest_is_the_stores_corruption() -> None:
    for data in [
        b"",
        b"{}",
        b'{"instance":',
        templates.signed(),
        pair(templates.token(), scenarios.token()),
        pair(scenarios.token(), templates.signed()),
        pair(templates.token(templates.instance(fill={})), templates.signed()),
        scenarios.token(scenarios.mission(mission="another")),
    ]:
        with case(data):
            with pytest.raises(StoreError) as error:
                held_mission(data, Digest(DIGEST))
            assert (error.value.reason, error.value.where) == (Reason.STORE_CORRUPT, "mission")
