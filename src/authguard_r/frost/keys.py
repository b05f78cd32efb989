# SPDX-License-Identifier: Apache-2.0
"""A group's key: dealt by one trusted person, and checked by each who gets a share.

A dealer knows the whole key; where that is not acceptable, `dkg` makes one without a dealer.
Source: RFC 9591 appendix C. Spec page: docs/spec/frost.md#keys
"""

from __future__ import annotations

from msgspec import Struct

from authguard_r.core.errors import AuthenticityError
from authguard_r.core.identifiers import PrincipalId
from authguard_r.core.reasons import Reason
from authguard_r.frost.curve import (
    Point,
    Scalar,
    base,
    committed_at,
    point,
    polynomial_at,
    random_scalar,
    scalar,
    spelled,
)
from authguard_r.frost.messages import Group, Share


class Dealt(Struct, frozen=True, kw_only=True):
    """What a dealer makes.

    Args:
        group: for every member.
        shares: one for each member, for that member alone.
    """

    group: Group
    shares: tuple[Share, ...]


def deal(
    name: PrincipalId,
    members: tuple[PrincipalId, ...],
    *,
    threshold: int,
    coefficients: tuple[Scalar, ...] | None = None,
) -> Dealt:
    """Return a new group with each member's share.

    Args:
        name: the principal that the group signs as.
        members: its people, in order.
        threshold: how many of them sign together.
        coefficients: of the polynomial, secret first; fresh ones when absent.

    Raises:
        ValueError: no group can be made of this.
    """
    drawn = coefficients or tuple(random_scalar() for _ in range(threshold))
    group = Group(
        id=name,
        threshold=threshold,
        members=members,
        commitment=tuple(spelled(base(item)) for item in drawn),
    )
    shares = tuple(
        Share(group=group, identifier=place, secret=spelled(polynomial_at(drawn, place)))
        for place in range(1, len(members) + 1)
    )
    return Dealt(group=group, shares=shares)


def require_share(share: Share, *, giver: str = "the dealer") -> None:
    """Require that a share is its member's part of the group's key (Feldman).

    Raises:
        AuthenticityError: it is not; names who gave it.
    """
    expected = verification_share(share.group, share.identifier)
    if base(scalar(share.secret)) != expected:
        raise AuthenticityError(
            f"{giver} gave `{member(share.group, share.identifier)}` a share that does not fit "
            "the group's commitment",
            reason=Reason.KEY_INVALID,
            where="share.secret",
        )


def public_key(group: Group) -> Point:
    """Return the group's Ed25519 key."""
    return point(group.commitment[0])


def verification_share(group: Group, identifier: int) -> Point:
    """Return the public half of a member's share.

    Raises:
        AuthenticityError: the group's commitment is degenerate.
    """
    return committed_at(tuple(point(item) for item in group.commitment), identifier)


def member(group: Group, identifier: int) -> PrincipalId:
    """Return who has the identifier.

    Raises:
        AuthenticityError: there is none of this name.
    """
    if identifier > len(group.members):
        raise AuthenticityError(
            f"expected an identifier from 1 to {len(group.members)}, got {identifier}",
            reason=Reason.KEY_INVALID,
            where="identifier",
        )
    return group.members[identifier - 1]
