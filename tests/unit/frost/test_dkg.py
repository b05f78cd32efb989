# SPDX-License-Identifier: Apache-2.0
"""Key generation without a dealer: it makes a group, and who cheats in it has a name."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import msgspec
import pytest
from nacl.public import Box, PrivateKey, PublicKey

from authguard_r.core.encoding import b64, unb64
from authguard_r.core.errors import AuthenticityError, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.frost import curve, dkg
from authguard_r.frost.keys import public_key, require_share
from authguard_r.frost.messages import digest
from fixtures.threshold_groups import NAME, finished, generated, holds, one_more, people, signature

MESSAGE = b"m"


@pytest.mark.parametrize(("threshold", "count"), [(2, 2), (2, 3), (3, 5)])
def test_the_members_get_one_group_and_any_t_of_them_sign(threshold: int, count: int) -> None:
    secrets, offers, given = generated(threshold, count)
    shares = [finished(secret, offers, given) for secret in secrets]
    assert {digest(share.group) for share in shares} == {digest(shares[0].group)}
    assert shares[0].group.members == people(count)
    for share in shares:
        require_share(share)
    for chosen in combinations(shares, threshold):
        assert holds(shares[0].group, signature(chosen, MESSAGE), MESSAGE)


def test_nobody_alone_holds_the_key() -> None:
    secrets, offers, given = generated(2, 3)
    group = finished(secrets[0], offers, given).group
    for secret in secrets:
        assert curve.base(curve.scalar(secret.coefficients[0])) != public_key(group)


def cheat(seen: Any, place: int, **changes: Any) -> Any:
    """Return the offers with one changed."""
    return tuple(
        msgspec.structs.replace(offer, **changes) if offer.identifier == place else offer
        for offer in seen
    )


@pytest.mark.parametrize("changed", ["key", "proof", "box", "stolen"])
def test_an_offer_without_knowledge_of_its_secret_is_caught_and_named(changed: str) -> None:
    """A rogue key: the last to offer takes one that cancels out the others', and owns the group."""
    secrets, offers, _ = generated(2, 3)
    other = generated(2, 3)[1][2]
    changes: dict[str, dict[str, Any]] = {
        "key": {"commitment": other.commitment},
        "proof": {"proof_scalar": one_more(offers[2].proof_scalar)},
        "box": {"box": other.box},
        "stolen": {
            "commitment": offers[0].commitment,
            "proof_point": offers[0].proof_point,
            "proof_scalar": offers[0].proof_scalar,
            "box": offers[0].box,
        },
    }
    with pytest.raises(AuthenticityError, match="`member-3` does not prove") as caught:
        dkg.exchange(secrets[0], cheat(offers, 3, **changes[changed]))
    assert (caught.value.reason, caught.value.where) == (Reason.KEY_INVALID, "dkg.member-3")


@pytest.mark.parametrize("low", [bytes(32), (1).to_bytes(32, "little")])
def test_a_box_that_everybody_could_open_is_refused_and_its_maker_named(low: bytes) -> None:
    """A proof holds for any box key that its maker chose; of low order its shares are public."""
    secrets, offers, given = generated(2, 3)
    drawn, nonce = curve.scalar(secrets[2].coefficients[0]), curve.random_scalar()
    asked = dkg.challenge(3, curve.base(drawn), curve.base(nonce), unb64(offers[2].plan) + low)
    proof = {
        "box": b64(low),
        "proof_point": curve.spelled(curve.base(nonce)),
        "proof_scalar": curve.spelled(curve.add(nonce, curve.mul(drawn, asked))),
    }
    with pytest.raises(AuthenticityError, match="`member-3` has a box key of low order"):
        dkg.exchange(secrets[0], cheat(offers, 3, **proof))
    assert len(given) == 6


def test_an_offer_of_another_plan_or_size_is_caught_and_named() -> None:
    secrets, offers, _ = generated(2, 3)
    other = dkg.plan(NAME, people(3), threshold=2)
    replayed = (*offers[:2], dkg.begin(other, 3)[1])
    with pytest.raises(AuthenticityError, match="`member-3` is for another plan"):
        dkg.exchange(secrets[0], replayed)
    longer = cheat(offers, 3, commitment=(*offers[2].commitment, offers[0].commitment[0]))
    with pytest.raises(AuthenticityError, match="`member-3` commits to 3 coefficients, not 2"):
        dkg.exchange(secrets[0], longer)


def test_ones_own_offer_is_not_replaced_on_the_way() -> None:
    secrets, offers, _ = generated(2, 3)
    _, again = dkg.begin(secrets[0].plan, 1)
    with pytest.raises(AuthenticityError, match="`member-1` is not the one made with this secret"):
        dkg.exchange(secrets[0], (again, *offers[1:]))


def test_offers_and_contributions_are_one_of_each_member() -> None:
    secrets, offers, given = generated(2, 3)
    for wrong in (offers[:2], (*offers, offers[0]), (*offers[:2], offers[1])):
        with pytest.raises(MalformedError, match="one offer of each member"):
            dkg.exchange(secrets[0], wrong)
    mine = [item for item in given if item.recipient == 1]
    for lacking in (mine[:1], [*mine, mine[0]], [mine[0], mine[0]]):
        with pytest.raises(MalformedError, match="one contribution of each other member"):
            dkg.finish(secrets[0], offers, tuple(lacking))


def test_a_member_who_gives_a_false_share_is_caught_and_named() -> None:
    secrets, offers, given = generated(2, 3)
    box = Box(PrivateKey(unb64(secrets[1].box)), PublicKey(unb64(offers[0].box)))
    false = b64(box.encrypt(curve.random_scalar()))
    spoiled = [
        msgspec.structs.replace(item, sealed=false)
        if (item.sender, item.recipient) == (2, 1)
        else item
        for item in given
    ]
    with pytest.raises(AuthenticityError, match="`member-2` gave a share that does not fit"):
        finished(secrets[0], offers, spoiled)
    assert finished(secrets[2], offers, spoiled).identifier == 3


def test_a_contribution_that_somebody_else_wrote_does_not_open() -> None:
    """Nobody can put a false share into another one's name: the box is from key to key."""
    secrets, offers, given = generated(2, 3)
    forger = Box(PrivateKey(unb64(secrets[2].box)), PublicKey(unb64(offers[0].box)))
    for sealed in (b64(forger.encrypt(curve.random_scalar())), b64(bytes(72)), "A", ""):
        spoiled = [
            msgspec.structs.replace(item, sealed=sealed)
            if (item.sender, item.recipient) == (2, 1)
            else item
            for item in given
        ]
        with pytest.raises(AuthenticityError, match="`member-2` does not open"):
            finished(secrets[0], offers, spoiled)


def test_a_member_who_told_two_members_different_things_is_seen() -> None:
    secrets, offers, _ = generated(2, 3)
    _, second = dkg.begin(secrets[2].plan, 3)
    given = [
        *dkg.exchange(secrets[0], offers),
        *dkg.exchange(secrets[1], (*offers[:2], second)),
        *dkg.exchange(secrets[2], offers),
    ]
    with pytest.raises(AuthenticityError, match="`member-2` saw other offers than are here"):
        finished(secrets[0], offers, given)


def test_a_contribution_for_another_member_or_plan_is_refused() -> None:
    secrets, offers, given = generated(2, 3)
    mine = [item for item in given if item.recipient == 1]
    for changes in ({"recipient": 3}, {"plan": digest(offers[0])}):
        wrong = (msgspec.structs.replace(mine[0], **changes), mine[1])
        with pytest.raises(AuthenticityError, match="`member-2` is not for here"):
            dkg.finish(secrets[0], offers, wrong)


def test_no_share_travels_in_the_clear() -> None:
    secrets, _, given = generated(2, 3)
    drawn = tuple(curve.scalar(item) for item in secrets[0].coefficients)
    for item in given:
        if item.sender == 1:
            assert curve.polynomial_at(drawn, item.recipient) not in unb64(item.sealed)
    assert secrets[0].coefficients[0] not in repr(secrets[0])


def test_a_plan_that_cannot_be_is_not_made() -> None:
    with pytest.raises(ValueError, match="as many members"):
        dkg.plan(NAME, people(2), threshold=3)
    with pytest.raises(ValueError, match="from 1 to 2"):
        dkg.begin(dkg.plan(NAME, people(2), threshold=2), 3)
