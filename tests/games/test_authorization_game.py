# SPDX-License-Identifier: Apache-2.0
"""Game^auth: an adversary with a signing oracle, the planner and every input channel.

It wins when the gate accepts under a mission that was never signed, or an action outside the
policy of one that was. Source: section "Authorization-Bypass Game", theorem "Authorization
soundness".
"""

from __future__ import annotations

from random import Random

import msgspec
import pytest

import worlds
from authguard_r.core.encoding import Tag, b64, decode, unb64
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.mission import Mission
from authguard_r.core.quantities import Now
from authguard_r.core.token import Token, verify_mission
from authguard_r.intake import ISSUER_ROLES
from authguard_r.keys.trust import read_trust
from cases import accepted_case, agree_accepts, broken_case

ROUNDS = 400


def accepts(token: bytes) -> bool:
    """Say whether the gate takes the token for a signed mission."""
    trust = read_trust(worlds.trust_folder())
    try:
        verify_mission(token, verifier=trust, now=Now(worlds.START_MS, 0), roles=ISSUER_ROLES)
    except AuthGuardError:
        return False
    return True


def queried() -> list[bytes]:
    """Return tokens for missions of the adversary's choice: its signing queries."""
    speeds = [["0.05 m/s", f"0.{n} m/s"] for n in (2, 4, 6)]
    return [worlds.token(worlds.mission(limits={"speed_mm_s": s})) for s in speeds]


def forged(rnd: Random, signed: list[bytes]) -> bytes:
    """Return something new made of what was signed: never one of the queries itself."""
    one, other = (decode(t.rstrip(b"\n"), Token) for t in rnd.sample(signed, 2))
    mission = decode(unb64(one.payload), Mission)
    trick = rnd.randrange(6)
    if trick == 0:  # another mission under an old signature
        return msgspec.json.encode(
            msgspec.structs.replace(one, payload=other.payload), order="sorted"
        )
    if trick == 1:  # one widened field
        changed = msgspec.structs.replace(mission, expiry="2099-01-01T00:00:00Z")
        payload = b64(msgspec.json.encode(changed, order="sorted"))
        return msgspec.json.encode(msgspec.structs.replace(one, payload=payload), order="sorted")
    if trick == 2:  # a bit of the payload
        raw = bytearray(unb64(one.payload))
        raw[rnd.randrange(len(raw))] ^= 1 << rnd.randrange(8)
        return msgspec.json.encode(
            msgspec.structs.replace(one, payload=b64(bytes(raw))), order="sorted"
        )
    if trick == 3:  # a bit of the signature or of a certificate
        token = bytearray(msgspec.json.encode(one, order="sorted"))
        token[rnd.randrange(len(token))] ^= 1 << rnd.randrange(7)
        return bytes(token)
    if trick == 4:  # another kind of signed object
        return msgspec.json.encode(msgspec.structs.replace(one, kind=Tag.SITE), order="sorted")
    spaced = msgspec.json.encode(one, order="sorted")  # a second spelling of the same thing
    return spaced.replace(b'":', b'": ', 1)


def test_no_mission_is_accepted_that_was_never_signed() -> None:
    rnd, signed = Random(1), queried()
    assert all(accepts(token) for token in signed)
    known = {token.rstrip(b"\n") for token in signed}
    for _ in range(ROUNDS):
        attempt = forged(rnd, signed)
        assert attempt in known or not accepts(attempt)


@pytest.mark.parametrize("changes", [1, 2, 3])
def test_no_action_outside_the_policy_of_a_signed_mission_is_accepted(changes: int) -> None:
    accepted = 0
    for seed in range(ROUNDS):
        ours, theirs = agree_accepts(broken_case(Random(seed), changes))
        assert not (ours and not theirs)
        accepted += ours
    assert accepted < ROUNDS


def test_every_action_inside_the_policy_is_accepted() -> None:
    assert all(agree_accepts(accepted_case(Random(seed))) == (True, True) for seed in range(ROUNDS))
