# SPDX-License-Identifier: Apache-2.0
"""Groups that sign together, for tests: dealt, and walked through both rounds."""

from __future__ import annotations

from collections.abc import Iterable

import msgspec
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from authguard_r.core.encoding import b64, unb64
from authguard_r.core.identifiers import PrincipalId
from authguard_r.frost import curve, dkg, signing
from authguard_r.frost.keys import Dealt, deal, public_key
from authguard_r.frost.messages import Contribution, Group, Nonces, Offer, Secret, Share

NAME = PrincipalId("board-1")
#: Points that must not enter anywhere: spelled raw.
ORDER = 2**252 + 27742317777372353535851937790883648493
P = 2**255 - 19
EIGHT = "26e8958fc2b227b045c3f489f2ef98f0d5dfac05d3c63339b13802886d53fc05"
BASE = curve.base(curve.number(1))
BAD_POINTS = {
    "the identity": (1).to_bytes(32, "little"),
    "order two": (P - 1).to_bytes(32, "little"),
    "order four": bytes(32),
    "order eight": bytes.fromhex(EIGHT),
    "not canonical": (P + 3).to_bytes(32, "little"),
    "the identity, not canonical": (P + 1).to_bytes(32, "little"),
    "the identity with a sign": (1 | 1 << 255).to_bytes(32, "little"),
    "not on the curve": (2).to_bytes(32, "little"),
    # a sound point with one of order two added: every check but that of its order passes
    "mixed order": bytes(curve.plus(BASE, curve.Point((P - 1).to_bytes(32, "little")))),
    "too short": bytes(31),
}
BAD_SCALARS = {
    "zero": bytes(32),
    "the order": ORDER.to_bytes(32, "little"),
    "above the order": (ORDER + 1).to_bytes(32, "little"),
    "too long": bytes(33),
}


def people(count: int) -> tuple[PrincipalId, ...]:
    return tuple(PrincipalId(f"member-{place}") for place in range(1, count + 1))


def dealt(threshold: int, count: int) -> Dealt:
    return deal(NAME, people(count), threshold=threshold)


def prepared(
    shares: Iterable[Share], message: bytes
) -> tuple[signing.Session, list[tuple[Share, Nonces]]]:
    """Return a session with each signer's share and nonces: round 1 is over."""
    ready = [(share, signing.new_nonces(share)) for share in shares]
    commitments = tuple(nonces.commitment for _, nonces in ready)
    return signing.begin(ready[0][0].group, commitments, message), ready


def signature(shares: Iterable[Share], message: bytes) -> bytes:
    """Return the signature of these shares, after both rounds."""
    session, ready = prepared(shares, message)
    parts = tuple(signing.sign(session, share, nonces) for share, nonces in ready)
    for part in parts:
        signing.verify_share(session, part)
    return signing.aggregate(session, parts)


def holds(group: Group, made: bytes, message: bytes) -> bool:
    """True when another library takes it as the group's plain Ed25519 signature."""
    try:
        Ed25519PublicKey.from_public_bytes(public_key(group)).verify(made, message)
    except InvalidSignature:
        return False
    return True


def generated(
    threshold: int, count: int
) -> tuple[list[Secret], tuple[Offer, ...], list[Contribution]]:
    """Return both rounds of key generation, before anybody finishes."""
    agreed = dkg.plan(NAME, people(count), threshold=threshold)
    begun = [dkg.begin(agreed, place) for place in range(1, count + 1)]
    secrets, offers = [s for s, _ in begun], tuple(o for _, o in begun)
    return secrets, offers, [item for s in secrets for item in dkg.exchange(s, offers)]


def finished(secret: Secret, offers: tuple[Offer, ...], given: Iterable[Contribution]) -> Share:
    mine = tuple(item for item in given if item.recipient == secret.identifier)
    return dkg.finish(secret, offers, mine)


def one_more(number: str) -> str:
    """Return another sound scalar."""
    return b64(curve.add(curve.Scalar(unb64(number)), curve.number(1)))


def spoiled(value: msgspec.Struct, **changes: object) -> dict[str, object]:
    """Return a struct as plain data with something else in it."""
    plain = msgspec.to_builtins(value)
    assert isinstance(plain, dict)
    return {**plain, **changes}
