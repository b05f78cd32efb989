# SPDX-License-Identifier: Apache-2.0
"""Groups that are dealt: every share fits, a dealer who cheats is caught by who gets the share."""

from __future__ import annotations

import msgspec
import pytest

from authguard_r.core.errors import AuthenticityError
from authguard_r.core.reasons import Reason
from authguard_r.frost import curve
from authguard_r.frost.keys import deal, member, public_key, require_share, verification_share
from fixtures.threshold_groups import NAME, dealt, one_more, people


def test_every_share_fits_and_no_two_groups_are_alike() -> None:
    first, second = dealt(3, 5), dealt(3, 5)
    for share in first.shares:
        require_share(share)
        own = curve.base(curve.scalar(share.secret))
        assert own == verification_share(first.group, share.identifier)
    assert public_key(first.group) != public_key(second.group)
    assert len({share.secret for share in (*first.shares, *second.shares)}) == 10


def test_a_cheating_dealer_is_caught_and_named() -> None:
    share = dealt(3, 5).shares[3]
    false = msgspec.structs.replace(share, secret=one_more(share.secret))
    with pytest.raises(AuthenticityError, match="the dealer gave `member-4` a share") as caught:
        require_share(false)
    assert caught.value.reason is Reason.KEY_INVALID
    assert share.secret not in str(caught.value)


def test_a_share_of_another_member_or_polynomial_does_not_fit() -> None:
    made, other = dealt(2, 3), dealt(2, 3)
    first, second = made.shares[:2]
    with pytest.raises(AuthenticityError, match="`member-1`"):
        require_share(msgspec.structs.replace(first, secret=second.secret))
    with pytest.raises(AuthenticityError, match="`member-1`"):
        require_share(msgspec.structs.replace(first, group=other.group))


@pytest.mark.parametrize(
    ("threshold", "members", "message"),
    [
        (4, people(3), "as many members as sign together"),
        (2, (*people(2), people(1)[0]), "distinct members"),
        (2, (*people(2), NAME), "distinct members"),
    ],
)
def test_a_group_that_cannot_be_is_not_made(
    threshold: int, members: tuple[str, ...], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        deal(NAME, members, threshold=threshold)  # type: ignore[arg-type]


def test_identifiers_are_places_from_one() -> None:
    made = dealt(2, 3)
    assert [member(made.group, share.identifier) for share in made.shares] == list(people(3))
    with pytest.raises(AuthenticityError, match="from 1 to 3, got 4"):
        member(made.group, 4)


def test_a_commitment_that_cancels_out_is_refused() -> None:
    """A dealer may choose coefficients whose sum at a member's place is the identity."""
    made = dealt(2, 3)
    minus = curve.Scalar(
        ((2**252 + 27742317777372353535851937790883648493) - 1).to_bytes(32, "little")
    )
    point = curve.point(made.group.commitment[1])
    against = curve.spelled(curve.times(minus, point))
    group = msgspec.structs.replace(made.group, commitment=(against, made.group.commitment[1]))
    share = msgspec.structs.replace(made.shares[0], group=group)
    with pytest.raises(AuthenticityError, match="the dealer gave `member-1`"):
        require_share(share)
    with pytest.raises(AuthenticityError, match="cancel each other out"):
        curve.times(curve.number(1), verification_share(group, 1))
    with pytest.raises(AuthenticityError, match="cancel each other out"):
        curve.base(curve.Scalar(bytes(32)))


def test_what_is_secret_is_not_printed() -> None:
    share = dealt(2, 3).shares[0]
    assert share.secret not in repr(share)
