# SPDX-License-Identifier: Apache-2.0
"""A group's key that never exists in one place: every member deals, and the shares are summed.

Two rounds. In the first each commits to a polynomial and proves that it knows the secret in it, or
the last to speak could choose the group's key. In the second each gives each a share, encrypted,
with a digest of all offers, so that a member who sent two different offers is found. Source: RFC
9591 section 5.1 by reference, FROST paper figure 1. Spec page: docs/spec/frost.md#dkg
"""

from __future__ import annotations

from hashlib import sha256
from secrets import token_bytes

from nacl.exceptions import CryptoError
from nacl.public import Box, PrivateKey, PublicKey

from authguard_r.core.encoding import b64, encode, unb64
from authguard_r.core.errors import AuthenticityError, MalformedError
from authguard_r.core.identifiers import Digest, PrincipalId
from authguard_r.core.reasons import Reason
from authguard_r.frost.curve import (
    Point,
    Scalar,
    add,
    base,
    box_key,
    committed_at,
    gathered,
    h_dkg,
    mul,
    number,
    plus,
    point,
    polynomial_at,
    random_scalar,
    scalar,
    spelled,
    times,
    total,
)
from authguard_r.frost.keys import require_share
from authguard_r.frost.messages import (
    Contribution,
    Group,
    KeyGenerationPlan,
    Offer,
    Secret,
    Share,
    digest,
)


def plan(
    name: PrincipalId, members: tuple[PrincipalId, ...], *, threshold: int
) -> KeyGenerationPlan:
    """Return a plan for every member to begin with.

    Raises:
        ValueError: no group can be made of this.
    """
    return KeyGenerationPlan(
        id=name, threshold=threshold, members=members, nonce=b64(token_bytes(32))
    )


def begin(agreed: KeyGenerationPlan, identifier: int) -> tuple[Secret, Offer]:
    """Return a member's secret of this key generation, and its offer to every member.

    Raises:
        ValueError: the plan has no such member.
    """
    box = PrivateKey.generate()
    secret = Secret(
        plan=agreed,
        identifier=identifier,
        coefficients=tuple(spelled(random_scalar()) for _ in range(agreed.threshold)),
        box=b64(bytes(box)),
    )
    drawn = tuple(scalar(item) for item in secret.coefficients)
    opened, nonce = base(drawn[0]), random_scalar()
    context = _context(digest(agreed), bytes(box.public_key))
    asked = challenge(identifier, opened, base(nonce), context)
    offer = Offer(
        plan=digest(agreed),
        identifier=identifier,
        commitment=tuple(spelled(base(item)) for item in drawn),
        box=b64(bytes(box.public_key)),
        proof_point=spelled(base(nonce)),
        proof_scalar=spelled(add(nonce, mul(drawn[0], asked))),
    )
    return secret, offer


def exchange(secret: Secret, offers: tuple[Offer, ...]) -> tuple[Contribution, ...]:
    """Return what the member gives each other one, once every offer holds.

    Raises:
        AuthenticityError: an offer does not hold; names whose.
        MalformedError: not one offer of each member.
    """
    seen = require_offers(secret, offers)
    drawn = tuple(scalar(item) for item in secret.coefficients)
    boxes = {place: _box(secret, offer) for place, offer in seen.items()}
    return tuple(
        Contribution(
            plan=digest(secret.plan),
            transcript=transcript(offers),
            sender=secret.identifier,
            recipient=place,
            sealed=b64(boxes[place].encrypt(polynomial_at(drawn, place))),
        )
        for place in boxes
        if place != secret.identifier
    )


def finish(secret: Secret, offers: tuple[Offer, ...], given: tuple[Contribution, ...]) -> Share:
    """Return the member's share of the new group, once every contribution holds.

    Raises:
        AuthenticityError: an offer or a contribution does not hold; names whose.
        MalformedError: not one of each other member.
    """
    seen = require_offers(secret, offers)
    others = {place for place in seen if place != secret.identifier}
    if len(given) != len(others) or {item.sender for item in given} != others:
        raise MalformedError("expected one contribution of each other member", where="dkg")
    drawn = tuple(scalar(item) for item in secret.coefficients)
    parts = [_opened(secret, item, seen[item.sender], transcript(offers)) for item in given]
    agreed = secret.plan
    columns = zip(*(offer.commitment for offer in seen.values()), strict=True)
    share = Share(
        group=_group(agreed, [gathered(map(point, column)) for column in columns]),
        identifier=secret.identifier,
        secret=spelled(total([polynomial_at(drawn, secret.identifier), *parts])),
    )
    require_share(share, giver="the members together")
    return share


def require_offers(secret: Secret, offers: tuple[Offer, ...]) -> dict[int, Offer]:
    """Return the offers by identifier, once each proves that its maker knows what it commits to.

    Raises:
        AuthenticityError: one is for another plan, or its proof fails; names whose.
        MalformedError: not one of each member.
    """
    agreed = secret.plan
    seen = {offer.identifier: offer for offer in sorted(offers, key=lambda o: o.identifier)}
    if len(offers) != len(seen) or list(seen) != list(range(1, len(agreed.members) + 1)):
        raise MalformedError("expected one offer of each member", where="dkg")
    for place, offer in seen.items():
        fault = _fault(agreed, offer)
        if place == secret.identifier and offer.box != b64(
            bytes(PrivateKey(box_key(secret.box)).public_key)
        ):
            fault = "is not the one made with this secret"
        if fault is not None:
            raise _cheat(f"the offer of `{agreed.members[place - 1]}` {fault}", agreed, place)
    return seen


def transcript(offers: tuple[Offer, ...]) -> Digest:
    """Return the digest of all offers; members compare it over a channel that they trust."""
    ordered = sorted(offers, key=lambda offer: offer.identifier)
    data = b"authguard-r/frost/dkg-transcript/1\0" + encode(ordered)
    return Digest(b64(sha256(data).digest()))


def challenge(identifier: int, opened: Point, commitment: Point, context: bytes = b"") -> Scalar:
    """Return the challenge of a proof of knowledge."""
    return h_dkg(number(identifier) + opened + commitment + context)


def _fault(agreed: KeyGenerationPlan, offer: Offer) -> str | None:
    """Return what is wrong with an offer, as the end of a sentence."""
    if offer.plan != digest(agreed):
        return "is for another plan"
    if len(offer.commitment) != agreed.threshold:
        return f"commits to {len(offer.commitment)} coefficients, not {agreed.threshold}"
    opened, proof = point(offer.commitment[0]), point(offer.proof_point)
    context = _context(offer.plan, box_key(offer.box))
    asked = challenge(offer.identifier, opened, proof, context)
    if base(scalar(offer.proof_scalar)) != plus(proof, times(asked, opened)):
        return "does not prove that its maker knows the secret in it"
    return None


def _opened(secret: Secret, item: Contribution, offer: Offer, seen: Digest) -> Scalar:
    """Return the share in a contribution, held to its sender's commitment."""
    agreed, name = secret.plan, secret.plan.members[item.sender - 1]
    if (item.plan, item.recipient) != (digest(agreed), secret.identifier):
        raise _cheat(f"the contribution of `{name}` is not for here", agreed, item.sender)
    if item.transcript != seen:
        raise _cheat(f"`{name}` saw other offers than are here", agreed, item.sender)
    box = _box(secret, offer)
    try:
        part = scalar(b64(box.decrypt(unb64(item.sealed))))
    except (CryptoError, ValueError, MalformedError) as error:
        message = f"the contribution of `{name}` does not open with the key of its offer"
        raise _cheat(message, agreed, item.sender) from error
    if base(part) != committed_at(tuple(map(point, offer.commitment)), secret.identifier):
        raise _cheat(f"`{name}` gave a share that does not fit its offer", agreed, item.sender)
    return part


def _group(agreed: KeyGenerationPlan, commitment: list[Point]) -> Group:
    try:
        return Group(
            id=agreed.id,
            threshold=agreed.threshold,
            members=agreed.members,
            commitment=tuple(map(spelled, commitment)),
        )
    except ValueError as error:  # pragma: no cover - proofs of knowledge leave no way to it
        raise AuthenticityError(
            "the offers cancel each other out", reason=Reason.KEY_INVALID, where="dkg"
        ) from error


def _box(secret: Secret, offer: Offer) -> Box:
    """Return the box from a member to another.

    Raises:
        AuthenticityError: the other's key is of low order: with it anyone could open the box.
    """
    try:
        return Box(PrivateKey(box_key(secret.box)), PublicKey(box_key(offer.box)))
    except CryptoError as error:
        name = secret.plan.members[offer.identifier - 1]
        message = f"the offer of `{name}` has a box key of low order"
        raise _cheat(message, secret.plan, offer.identifier) from error


def _context(agreed: Digest, box: bytes) -> bytes:
    return unb64(agreed) + box


def _cheat(message: str, agreed: KeyGenerationPlan, place: int) -> AuthenticityError:
    where = f"dkg.{agreed.members[place - 1]}"
    return AuthenticityError(message, reason=Reason.KEY_INVALID, where=where)
