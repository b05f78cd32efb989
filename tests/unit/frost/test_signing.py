# SPDX-License-Identifier: Apache-2.0
"""Signing together: t of n make a plain signature, fewer make none, and a cheater has a name."""

from __future__ import annotations

from itertools import combinations

import msgspec
import pytest

from authguard_r.core.errors import AuthenticityError, MalformedError, RefusedError
from authguard_r.core.reasons import Reason
from authguard_r.frost import curve, signing
from authguard_r.frost.messages import SignatureShare
from fixtures.threshold_groups import dealt, holds, one_more, prepared, signature

MESSAGE = bytes(range(32))


@pytest.mark.parametrize(("threshold", "count"), [(2, 3), (3, 5), (5, 7)])
def test_every_t_of_n_sign_and_every_t_less_one_are_refused(threshold: int, count: int) -> None:
    made = dealt(threshold, count)
    chosen = list(combinations(made.shares, threshold))
    assert len(chosen) == {(2, 3): 3, (3, 5): 10, (5, 7): 21}[threshold, count]
    for shares in chosen:
        assert holds(made.group, signature(shares, MESSAGE), MESSAGE)
    assert holds(made.group, signature(made.shares, MESSAGE), MESSAGE)
    for shares in combinations(made.shares, threshold - 1):
        with pytest.raises(RefusedError, match=rf"at least {threshold} members") as caught:
            prepared(shares, MESSAGE)
        assert caught.value.reason is Reason.SIGNATURE_MISSING


@pytest.mark.parametrize(("threshold", "count"), [(2, 3), (3, 5), (5, 7)])
def test_stolen_shares_below_t_make_no_signature_even_without_our_checks(
    threshold: int, count: int
) -> None:
    """A thief has no need of our refusal: he claims a lower threshold, and the numbers refuse."""
    made = dealt(threshold, count)
    for stolen in combinations(made.shares, threshold - 1):
        if len(stolen) < 2:
            alone = curve.times(
                curve.lagrange(stolen[0].identifier, (stolen[0].identifier,)),
                curve.base(curve.scalar(stolen[0].secret)),
            )
            assert alone != curve.point(made.group.commitment[0])
            continue
        lowered = msgspec.structs.replace(
            made.group,
            threshold=threshold - 1,
            commitment=made.group.commitment[: threshold - 1],
        )
        own = [msgspec.structs.replace(share, group=lowered) for share in stolen]
        session, ready = prepared(own, MESSAGE)
        parts = [signing.sign(session, share, nonces) for share, nonces in ready]
        forged = session.commitment + curve.total(curve.scalar(part.share) for part in parts)
        assert not holds(made.group, forged, MESSAGE)


def test_a_cheating_share_is_caught_and_its_giver_named() -> None:
    made = dealt(3, 5)
    session, ready = prepared(made.shares[1:4], MESSAGE)
    parts = [signing.sign(session, share, nonces) for share, nonces in ready]
    parts[1] = msgspec.structs.replace(parts[1], share=one_more(parts[1].share))
    with pytest.raises(AuthenticityError, match="`member-3` is not valid") as caught:
        signing.aggregate(session, tuple(parts))
    assert (caught.value.reason, caught.value.where) == (Reason.SIGNATURE_INVALID, "member-3")
    for part in (parts[0], parts[2]):
        signing.verify_share(session, part)


def test_two_cheats_that_cancel_out_give_a_signature_that_holds() -> None:
    """Who gives which part is not what is signed: the whole holds, and the group stands for it."""
    made = dealt(2, 3)
    session, ready = prepared(made.shares[:2], MESSAGE)
    first, second = (signing.sign(session, share, nonces) for share, nonces in ready)
    up = msgspec.structs.replace(first, share=one_more(first.share))
    down = msgspec.structs.replace(second, share=curve.spelled(_less(second)))
    assert holds(made.group, signing.aggregate(session, (up, down)), MESSAGE)
    with pytest.raises(AuthenticityError, match="`member-1` is not valid"):
        signing.verify_share(session, up)


def _less(part: SignatureShare) -> curve.Scalar:
    minus = curve.Scalar((_order() - 1).to_bytes(32, "little"))
    return curve.add(curve.scalar(part.share), minus)


def _order() -> int:
    from fixtures.threshold_groups import ORDER

    return ORDER


def test_a_share_for_another_message_is_caught_and_named() -> None:
    made = dealt(2, 3)
    session, ready = prepared(made.shares[:2], MESSAGE)
    commitments = tuple(nonces.commitment for _, nonces in ready)
    other = signing.begin(made.group, commitments, b"another message")
    parts = (signing.sign(session, *ready[0]), signing.sign(other, *ready[1]))
    with pytest.raises(AuthenticityError, match="`member-2` is for another message"):
        signing.aggregate(session, parts)


def test_a_share_is_not_another_members_share() -> None:
    made = dealt(2, 3)
    session, ready = prepared(made.shares[:2], MESSAGE)
    first, second = (signing.sign(session, share, nonces) for share, nonces in ready)
    taken = msgspec.structs.replace(first, identifier=2)
    with pytest.raises(AuthenticityError, match="`member-2` is not valid"):
        signing.verify_share(session, taken)
    with pytest.raises(AuthenticityError, match="`member-3` gave a share without a commitment"):
        signing.verify_share(session, msgspec.structs.replace(second, identifier=3))
    with pytest.raises(AuthenticityError, match="from 1 to 3, got 4"):
        signing.verify_share(session, msgspec.structs.replace(second, identifier=4))


def test_parts_are_one_of_each_who_committed() -> None:
    made = dealt(2, 3)
    session, ready = prepared(made.shares[:2], MESSAGE)
    first, second = (signing.sign(session, share, nonces) for share, nonces in ready)
    with pytest.raises(MalformedError, match="missing: `member-2`"):
        signing.aggregate(session, (first,))
    with pytest.raises(MalformedError, match="missing: `member-2`"):
        signing.aggregate(session, (first, first))
    with pytest.raises(MalformedError, match="missing: none"):
        signing.aggregate(session, (first, second, second))


def test_commitments_are_of_this_group_one_of_each_member() -> None:
    made, foreign = dealt(2, 3), dealt(2, 3)
    one, two = (signing.new_nonces(share).commitment for share in made.shares[:2])
    other = signing.new_nonces(foreign.shares[1]).commitment
    with pytest.raises(MalformedError, match="one commitment of a member"):
        signing.begin(made.group, (one, two, two), MESSAGE)
    with pytest.raises(AuthenticityError, match="`member-2` is for another group"):
        signing.begin(made.group, (one, other), MESSAGE)
    stranger = msgspec.structs.replace(two, identifier=9)
    with pytest.raises(AuthenticityError, match="from 1 to 3, got 9"):
        signing.begin(made.group, (one, stranger), MESSAGE)


def test_nobody_signs_in_a_session_that_changed_his_commitment() -> None:
    made = dealt(2, 3)
    session, ready = prepared(made.shares[:2], MESSAGE)
    fresh = signing.new_nonces(made.shares[0])
    with pytest.raises(RefusedError, match="this member's own commitment"):
        signing.sign(session, made.shares[0], fresh)
    with pytest.raises(RefusedError, match="this member's own commitment"):
        signing.sign(session, made.shares[0], ready[1][1])
    assert signing.sign(session, *ready[0]).identifier == 1


def test_the_order_in_which_files_arrive_changes_nothing() -> None:
    made = dealt(3, 5)
    session, ready = prepared(made.shares[:3], MESSAGE)
    turned = tuple(reversed(session.commitments))
    assert signing.begin(made.group, turned, MESSAGE) == session
    parts = [signing.sign(session, share, nonces) for share, nonces in ready]
    assert signing.aggregate(session, tuple(parts)) == signing.aggregate(
        session, tuple(reversed(parts))
    )


def test_a_signature_holds_for_no_other_message_or_group() -> None:
    made, other = dealt(2, 3), dealt(2, 3)
    signed = signature(made.shares[:2], MESSAGE)
    assert holds(made.group, signed, MESSAGE)
    assert not holds(made.group, signed, MESSAGE + b"\0")
    assert not holds(other.group, signed, MESSAGE)
    assert curve.holds(curve.point(made.group.commitment[0]), signed, MESSAGE)
