# SPDX-License-Identifier: Apache-2.0
"""The files that move between signers: canonical JSON, closed structs, sound numbers.

Every struct is sound by construction: a number that is no sound point or scalar, an identifier
outside 1..n or a name that comes twice makes none. What a file says about others is checked by who
uses it (`keys`, `dkg`, `signing`). Spec page: docs/spec/frost.md#files
"""

from __future__ import annotations

from hashlib import sha256
from typing import Annotated, TypeVar

from msgspec import Meta, Struct

from authguard_r.core.action import ActionScope
from authguard_r.core.approval import Approval
from authguard_r.core.checks.approval import Situation
from authguard_r.core.encoding import Tag, b64, decode, digest_of, encode, unb64
from authguard_r.core.identifiers import Base64Url, Digest, PrincipalId
from authguard_r.frost.curve import box_key, point, scalar

#: Most members of a group: a mission's policy asks for no more.
MOST = 64

Identifier = Annotated[int, Meta(ge=1, le=MOST)]
Threshold = Annotated[int, Meta(ge=2, le=MOST)]
Number = Annotated[str, Meta(min_length=43, max_length=43)]
Members = Annotated[tuple[PrincipalId, ...], Meta(min_length=2, max_length=MOST)]
Numbers = Annotated[tuple[Number, ...], Meta(min_length=2, max_length=MOST)]
T = TypeVar("T", bound=Struct)


class Group(
    Struct,
    frozen=True,
    forbid_unknown_fields=True,
    kw_only=True,
    tag_field="kind",
    tag="frost/group/1",
):
    """A group's public side. Key and verification shares follow from the commitment.

    Args:
        id: the principal that the group signs as.
        threshold: t, how many sign together.
        members: the people; the first has identifier 1.
        commitment: t points: what the coefficients of the shared polynomial commit to.
    """

    id: PrincipalId
    threshold: Threshold
    members: Members
    commitment: Numbers

    def __post_init__(self) -> None:
        """Require a possible group."""
        _require_group(self.id, self.threshold, self.members)
        _require_points(self.commitment, self.threshold)


class Share(
    Struct,
    frozen=True,
    forbid_unknown_fields=True,
    kw_only=True,
    tag_field="kind",
    tag="frost/share/1",
):
    """One member's secret share, with the group that it is of. Secret.

    Args:
        group: the group.
        identifier: whose it is.
        secret: f(identifier).
    """

    group: Group
    identifier: Identifier
    secret: Number

    def __post_init__(self) -> None:
        """Require a member's number and a sound scalar; whether it fits, `keys` says."""
        _require_member(self.identifier, self.group.members)
        scalar(self.secret)

    def __repr__(self) -> str:
        """Return what may be shown; the secret may not."""
        return f"Share({self.group.id!r}, {self.identifier})"


class KeyGenerationPlan(
    Struct,
    frozen=True,
    forbid_unknown_fields=True,
    kw_only=True,
    tag_field="kind",
    tag="frost/dkg-plan/1",
):
    """What a key generation without a dealer is for; every member has the same one.

    Args:
        id: the principal that the group will sign as.
        threshold: how many will sign together.
        members: the people; the first has identifier 1.
        nonce: 32 random bytes, so that nothing of one key generation fits another.
    """

    id: PrincipalId
    threshold: Threshold
    members: Members
    nonce: Number

    def __post_init__(self) -> None:
        """Require a possible group."""
        _require_group(self.id, self.threshold, self.members)


class Offer(
    Struct,
    frozen=True,
    forbid_unknown_fields=True,
    kw_only=True,
    tag_field="kind",
    tag="frost/dkg-offer/1",
):
    """Round 1 of key generation: a member commits to a polynomial. Public.

    Args:
        plan: digest of the plan.
        identifier: who offers.
        commitment: t points.
        box: the member's X25519 key, to which round 2 is encrypted.
        proof_point: R of the proof of knowledge of the polynomial's secret.
        proof_scalar: its response.
    """

    plan: Digest
    identifier: Identifier
    commitment: Numbers
    box: Number
    proof_point: Number
    proof_scalar: Number

    def __post_init__(self) -> None:
        """Require sound numbers."""
        _require_points((*self.commitment, self.proof_point), len(self.commitment) + 1)
        scalar(self.proof_scalar)
        box_key(self.box)


class Contribution(
    Struct,
    frozen=True,
    forbid_unknown_fields=True,
    kw_only=True,
    tag_field="kind",
    tag="frost/dkg-contribution/1",
):
    """Round 2 of key generation: a share for one member, encrypted to it by the sender.

    Args:
        plan: digest of the plan.
        transcript: digest of the offers that the sender saw.
        sender: who gives it.
        recipient: for whom.
        sealed: the share, in a box from the sender's key to the recipient's.
    """

    plan: Digest
    transcript: Digest
    sender: Identifier
    recipient: Identifier
    sealed: Annotated[Base64Url, Meta(max_length=128)]


class Secret(
    Struct,
    frozen=True,
    forbid_unknown_fields=True,
    kw_only=True,
    tag_field="kind",
    tag="frost/dkg-secret/1",
):
    """What a member keeps between the rounds of key generation. Secret; destroyed at the end.

    Args:
        plan: the plan.
        identifier: whose it is.
        coefficients: the member's own polynomial.
        box: the private half of the member's X25519 key.
    """

    plan: KeyGenerationPlan
    identifier: Identifier
    coefficients: Numbers
    box: Number

    def __post_init__(self) -> None:
        """Require a member's number and as many scalars as sign together."""
        _require_member(self.identifier, self.plan.members)
        if len(self.coefficients) != self.plan.threshold:
            raise ValueError("expected as many coefficients as sign together")
        for item in self.coefficients:
            scalar(item)
        box_key(self.box)

    def __repr__(self) -> str:
        """Return what may be shown; the secrets may not."""
        return f"Secret({self.plan.id!r}, {self.identifier})"


class Ballot(
    Struct,
    frozen=True,
    forbid_unknown_fields=True,
    kw_only=True,
    tag_field="kind",
    tag="frost/ballot/1",
):
    """What a group is asked to sign: the approval, and what it is bound to.

    The approval holds digests of effect and situation; a digest cannot be read. Both travel beside
    it and must be those that the digests name, so what is shown is what is signed.

    Args:
        approval: what the signature is over.
        scope: what would be carried out.
        situation: which conditions held, and the line of `eq:threshold`.
    """

    approval: Approval
    scope: ActionScope
    situation: Situation

    def __post_init__(self) -> None:
        """Require that what can be shown is what would be signed."""
        if digest_of(Tag.SCOPE, self.scope) != self.approval.scope:
            raise ValueError("expected the action that the approval names by its digest")
        if digest_of(Tag.SITUATION, self.situation) != self.approval.situation:
            raise ValueError("expected the situation that the approval names by its digest")


class NonceCommitment(
    Struct,
    frozen=True,
    forbid_unknown_fields=True,
    kw_only=True,
    tag_field="kind",
    tag="frost/commitment/1",
):
    """Round 1 of a signature: what a member's two nonces commit to. Public; used once.

    Args:
        group: digest of the group.
        identifier: whose it is.
        hiding: a point.
        binding: a point.
    """

    group: Digest
    identifier: Identifier
    hiding: Number
    binding: Number

    def __post_init__(self) -> None:
        """Require sound points."""
        _require_points((self.hiding, self.binding), 2)


class Nonces(
    Struct,
    frozen=True,
    forbid_unknown_fields=True,
    kw_only=True,
    tag_field="kind",
    tag="frost/nonces/1",
):
    """The secrets behind one commitment. Two signatures with them give the share away.

    Args:
        commitment: the public half.
        hiding: a scalar.
        binding: a scalar.
    """

    commitment: NonceCommitment
    hiding: Number
    binding: Number

    def __post_init__(self) -> None:
        """Require sound scalars."""
        scalar(self.hiding)
        scalar(self.binding)

    def __repr__(self) -> str:
        """Return what may be shown; the secrets may not."""
        return f"Nonces({self.commitment!r})"


class SignatureShare(
    Struct,
    frozen=True,
    forbid_unknown_fields=True,
    kw_only=True,
    tag_field="kind",
    tag="frost/signature-share/1",
):
    """Round 2 of a signature: one member's part of it. Public.

    Args:
        group: digest of the group.
        session: digest of message and commitments that it was made for.
        identifier: who signs.
        share: a scalar.
    """

    group: Digest
    session: Digest
    identifier: Identifier
    share: Number

    def __post_init__(self) -> None:
        """Require a sound scalar."""
        scalar(self.share)


#: Every kind of file; the field `kind` distinguishes them.
File = (
    Group
    | Share
    | KeyGenerationPlan
    | Offer
    | Contribution
    | Secret
    | Ballot
    | NonceCommitment
    | Nonces
    | SignatureShare
)


def read(data: bytes, kind: type[T], *, where: str) -> T:
    """Return the object in a file; from anyone.

    Raises:
        MalformedError: it holds no sound one of this kind, with the place.
    """
    return decode(data.removesuffix(b"\n"), kind, where=where)


def written(value: Struct) -> bytes:
    """Return the canonical bytes of a file, with a final newline."""
    return encode(value) + b"\n"


def digest(value: Struct) -> Digest:
    """Return the digest by which other files name this one; its kind is part of it."""
    return Digest(b64(sha256(b"authguard-r/" + encode(value)).digest()))


def message_of(ballot: Ballot) -> bytes:
    """Return the 32 bytes that are signed: exactly those of an approval token."""
    return unb64(digest_of(Tag.APPROVAL, ballot.approval))


def _require_group(name: str, threshold: int, members: tuple[PrincipalId, ...]) -> None:
    if threshold > len(members):
        raise ValueError("expected at least as many members as sign together")
    if len({name, *members}) != len(members) + 1:
        raise ValueError("expected distinct members without the group itself")


def _require_member(identifier: int, members: tuple[PrincipalId, ...]) -> None:
    if identifier > len(members):
        raise ValueError(f"expected an identifier from 1 to {len(members)}")


def _require_points(numbers: tuple[str, ...], count: int) -> None:
    if len(numbers) != count:
        raise ValueError(f"expected {count} points, got {len(numbers)}")
    for item in numbers:
        point(item)
