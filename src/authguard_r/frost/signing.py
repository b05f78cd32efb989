# SPDX-License-Identifier: Apache-2.0
"""One signature of t people in two rounds, and who is to blame when it fails.

Numbered as in RFC 9591: (5.1) commitments, (5.2) a share, (5.3) the aggregate, (5.4) the cheater.
Spec page: docs/spec/frost.md#signing
"""

from __future__ import annotations

from hashlib import sha256
from secrets import token_bytes

from msgspec import Struct

from authguard_r.core.encoding import b64, encode
from authguard_r.core.errors import AuthenticityError, MalformedError, RefusedError
from authguard_r.core.identifiers import Digest
from authguard_r.core.reasons import Reason
from authguard_r.frost.curve import (
    Point,
    Scalar,
    add,
    base,
    gathered,
    h1,
    h2,
    h3,
    h4,
    h5,
    holds,
    lagrange,
    mul,
    number,
    plus,
    point,
    scalar,
    spelled,
    times,
    total,
)
from authguard_r.frost.keys import member, public_key, verification_share
from authguard_r.frost.messages import Group, NonceCommitment, Nonces, Share, SignatureShare, digest


class SigningSession(Struct, frozen=True, kw_only=True):
    """What all shares of one signature have in common. Made by `begin` only.

    Args:
        group: the group.
        message: the bytes that are signed.
        commitments: of those who sign, in order.
        factors: their binding factors.
        commitment: R, the first half of the signature.
        challenge: c.
        name: digest of message and commitments.
    """

    group: Group
    message: bytes
    commitments: tuple[NonceCommitment, ...]
    factors: tuple[Scalar, ...]
    commitment: Point
    challenge: Scalar
    name: Digest

    @property
    def signers(self) -> tuple[int, ...]:
        """The identifiers of those who sign."""
        return tuple(item.identifier for item in self.commitments)


def new_nonces(share: Share, *, randomness: tuple[bytes, bytes] | None = None) -> Nonces:
    """(5.1) Return two fresh nonces with what they commit to; put them into a store at once.

    Args:
        share: the member's; hashed in, so that weak randomness alone gives nothing away.
        randomness: two times 32 bytes, for test vectors only.
    """
    first, second = randomness or (token_bytes(32), token_bytes(32))
    secret = scalar(share.secret)
    hiding, binding = h3(first + secret), h3(second + secret)
    commitment = NonceCommitment(
        group=digest(share.group),
        identifier=share.identifier,
        hiding=spelled(base(hiding)),
        binding=spelled(base(binding)),
    )
    return Nonces(commitment=commitment, hiding=spelled(hiding), binding=spelled(binding))


def begin(group: Group, commitments: tuple[NonceCommitment, ...], message: bytes) -> SigningSession:
    """Return the session of these commitments and this message.

    Args:
        group: the group.
        commitments: of those who will sign, from anyone.
        message: what is signed.

    Raises:
        MalformedError: two of one member, or more than members.
        AuthenticityError: one of another group or of no member.
        RefusedError: fewer than sign together.
    """
    ordered = tuple(sorted(commitments, key=lambda item: item.identifier))
    _require_commitments(group, ordered)
    points = tuple((point(item.hiding), point(item.binding)) for item in ordered)
    spread = b"".join(
        number(item.identifier) + hiding + binding
        for item, (hiding, binding) in zip(ordered, points, strict=True)
    )
    key = public_key(group)
    prefix = key + h4(message) + h5(spread)
    factors = tuple(h1(prefix + number(item.identifier)) for item in ordered)
    commitment = gathered(
        plus(hiding, times(factor, binding))
        for (hiding, binding), factor in zip(points, factors, strict=True)
    )
    hashed = sha256(b"authguard-r/frost/session/1\0" + sha256(message).digest() + encode(ordered))
    return SigningSession(
        group=group,
        message=message,
        commitments=ordered,
        factors=factors,
        commitment=commitment,
        challenge=h2(commitment + key + message),
        name=Digest(b64(hashed.digest())),
    )


def sign(session: SigningSession, share: Share, nonces: Nonces) -> SignatureShare:
    """(5.2) Return the member's part of the signature. The nonces are spent from here on.

    Raises:
        RefusedError: the session is not with these nonces, or of another group.
    """
    if nonces.commitment not in session.commitments or (
        (nonces.commitment.identifier, session.group) != (share.identifier, share.group)
    ):
        raise RefusedError(
            "expected a session with this member's own commitment",
            reason=Reason.SIGNATURE_INVALID,
            where="commitments",
        )
    factor = session.factors[session.commitments.index(nonces.commitment)]
    nonce = add(scalar(nonces.hiding), mul(scalar(nonces.binding), factor))
    weight = mul(lagrange(share.identifier, session.signers), scalar(share.secret))
    return SignatureShare(
        group=digest(session.group),
        session=session.name,
        identifier=share.identifier,
        share=spelled(add(nonce, mul(weight, session.challenge))),
    )


def verify_share(session: SigningSession, item: SignatureShare) -> None:
    """(5.4) Require that a member's part of the signature holds.

    Raises:
        AuthenticityError: it does not; names whose it is.
    """
    name = member(session.group, item.identifier)
    if item.identifier not in session.signers:
        raise _cheat(f"`{name}` gave a share without a commitment", name)
    if (item.group, item.session) != (digest(session.group), session.name):
        raise _cheat(f"the share of `{name}` is for another message or other commitments", name)
    place = session.signers.index(item.identifier)
    made = session.commitments[place]
    nonce = plus(point(made.hiding), times(session.factors[place], point(made.binding)))
    weight = mul(session.challenge, lagrange(item.identifier, session.signers))
    owed = times(weight, verification_share(session.group, item.identifier))
    if base(scalar(item.share)) != plus(nonce, owed):
        raise _cheat(f"the share of `{name}` is not valid", name)


def aggregate(session: SigningSession, shares: tuple[SignatureShare, ...]) -> bytes:
    """(5.3) Return the group's signature: 64 bytes, plain Ed25519.

    The whole is verified first, which costs one verification; only when it does not hold is each
    share looked at, to name whose it is.

    Raises:
        MalformedError: not one share of each who committed.
        AuthenticityError: a share does not hold; names whose.
    """
    if len(shares) != len(session.signers) or (
        {item.identifier for item in shares} != set(session.signers)
    ):
        missing = sorted(set(session.signers) - {item.identifier for item in shares})
        names = ", ".join(f"`{member(session.group, place)}`" for place in missing)
        raise MalformedError(
            f"expected one share of each who committed; missing: {names or 'none'}",
            where="signature shares",
        )
    signature = session.commitment + total(scalar(item.share) for item in shares)
    if holds(public_key(session.group), signature, session.message):
        return signature
    for item in shares:
        verify_share(session, item)
    raise _cheat("the signature is not valid", session.group.id)  # pragma: no cover - cannot be


def _require_commitments(group: Group, ordered: tuple[NonceCommitment, ...]) -> None:
    named = {item.identifier for item in ordered}
    if len(named) != len(ordered):
        raise MalformedError("expected one commitment of a member", where="commitments")
    here = digest(group)
    for item in ordered:
        name = member(group, item.identifier)
        if item.group != here:
            raise _cheat(f"the commitment of `{name}` is for another group", name)
    if len(ordered) < group.threshold:
        raise RefusedError(
            f"expected commitments of at least {group.threshold} members, got {len(ordered)}",
            reason=Reason.SIGNATURE_MISSING,
            where="commitments",
        )


def _cheat(message: str, name: str) -> AuthenticityError:
    return AuthenticityError(message, reason=Reason.SIGNATURE_INVALID, where=name)
