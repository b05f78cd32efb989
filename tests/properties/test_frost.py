# SPDX-License-Identifier: Apache-2.0
"""Laws of signing together, over random groups, signers and messages."""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from authguard_r.core.errors import AuthenticityError, MalformedError, RefusedError
from authguard_r.frost import signing
from authguard_r.frost.messages import Group, NonceCommitment, Offer, SignatureShare, read
from fixtures.threshold_groups import (
    dealt,
    finished,
    generated,
    holds,
    one_more,
    prepared,
    signature,
)


@dataclass(frozen=True)
class Drawn:
    """A group's size and who of it signs."""

    threshold: int
    count: int
    signers: tuple[int, ...]


@st.composite
def drawn(draw: st.DrawFn, *, enough: bool = True) -> Drawn:
    count = draw(st.integers(2, 7))
    threshold = draw(st.integers(2, count))
    size = st.integers(threshold, count) if enough else st.integers(1, threshold - 1)
    places = st.permutations(range(1, count + 1))
    return Drawn(threshold, count, tuple(draw(places)[: draw(size)]))


@settings(max_examples=30)
@given(drawn(), st.binary(max_size=200))
def test_any_t_or_more_of_n_make_a_signature_that_another_library_takes(
    chosen: Drawn, message: bytes
) -> None:
    made = dealt(chosen.threshold, chosen.count)
    shares = [made.shares[place - 1] for place in chosen.signers]
    signed = signature(shares, message)
    assert len(signed) == 64
    assert holds(made.group, signed, message)
    assert not holds(made.group, signed, message + b"x")


@settings(max_examples=30)
@given(drawn(enough=False), st.binary(max_size=64))
def test_fewer_than_t_make_none(chosen: Drawn, message: bytes) -> None:
    made = dealt(chosen.threshold, chosen.count)
    with pytest.raises(RefusedError):
        prepared([made.shares[place - 1] for place in chosen.signers], message)


@settings(max_examples=20)
@given(drawn(), st.binary(max_size=64), st.data())
def test_whoever_cheats_is_the_one_who_is_named(
    chosen: Drawn, message: bytes, data: st.DataObject
) -> None:
    made = dealt(chosen.threshold, chosen.count)
    session, ready = prepared([made.shares[p - 1] for p in chosen.signers], message)
    parts = [signing.sign(session, share, nonces) for share, nonces in ready]
    place = data.draw(st.integers(0, len(parts) - 1))
    parts[place] = msgspec.structs.replace(parts[place], share=one_more(parts[place].share))
    with pytest.raises(AuthenticityError) as caught:
        signing.aggregate(session, tuple(parts))
    assert caught.value.where == made.group.members[parts[place].identifier - 1]


@settings(max_examples=8)
@given(drawn(), st.binary(max_size=64))
def test_a_group_without_a_dealer_signs_like_a_dealt_one(chosen: Drawn, message: bytes) -> None:
    secrets, offers, given_out = generated(chosen.threshold, chosen.count)
    shares = [finished(secrets[place - 1], offers, given_out) for place in chosen.signers]
    assert holds(shares[0].group, signature(shares, message), message)


@settings(max_examples=200)
@given(st.binary(max_size=300), st.sampled_from([Group, Offer, NonceCommitment, SignatureShare]))
def test_any_bytes_at_all_are_read_or_malformed(data: bytes, kind: type[msgspec.Struct]) -> None:
    with pytest.raises(MalformedError):
        read(data, kind, where="file")
