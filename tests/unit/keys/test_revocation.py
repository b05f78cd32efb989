# SPDX-License-Identifier: Apache-2.0
"""Signed revocation lists: whose, over which bytes, until when."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from authguard_r.core.encoding import Tag, b64, digest, encode, encode_fast, unb64
from authguard_r.core.errors import AuthenticityError, AuthGuardError, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.keys.revocation import Revocation, SignedRevocation, read_list, sign_list
from fixtures.cases import case
from unit.keys import chains

KEY = chains.key("People authority")
WHERE = "revocations/people"


def revocation(**changes: Any) -> Revocation:
    good = Revocation(
        authority="people",
        number=7,
        issued="2030-06-15T12:00:00Z",
        next_update="2030-06-22T12:00:00Z",
        serials=("17", "4"),
    )
    return msgspec.structs.replace(good, **changes)


def signed(payload: bytes, *, tag: Tag = Tag.REVOCATION) -> bytes:
    signature = KEY.sign(unb64(digest(tag, payload)))
    return encode_fast(SignedRevocation(payload=b64(payload), signature=b64(signature)))


def refused(data: bytes, reason: Reason, where: str = WHERE) -> AuthGuardError:
    with pytest.raises(AuthGuardError) as caught:
        read_list(data, authority="people", key=KEY.public_key())
    assert (caught.value.reason, caught.value.where) == (reason, where)
    return caught.value


def test_a_signed_list_is_read_as_it_was_written() -> None:
    found = read_list(sign_list(revocation(), KEY), authority="people", key=KEY.public_key())
    assert found.serials == {4, 17}
    assert found.number == 7
    assert found.next_update_ms == chains.NOW.utc_ms + 7 * chains.DAY_MS


def test_a_list_without_serials_revokes_nothing() -> None:
    data = sign_list(revocation(serials=()), KEY)
    assert read_list(data, authority="people", key=KEY.public_key()).serials == frozenset()


def test_an_older_number_is_only_data_here() -> None:
    """Which list replaces which is the folder keeper's affair; a reader has but one."""
    for number in (0, 1, 2**53 - 1):
        data = sign_list(revocation(number=number), KEY)
        assert read_list(data, authority="people", key=KEY.public_key()).number == number


def test_the_list_of_another_authority_is_refused_even_with_the_right_key() -> None:
    refused(sign_list(revocation(authority="machines"), KEY), Reason.MALFORMED)


@pytest.mark.parametrize("who", ["machines authority", "Test root"])
def test_a_list_signed_by_another_key_is_refused(who: str) -> None:
    assert isinstance(
        refused(sign_list(revocation(), chains.key(who)), Reason.SIGNATURE_INVALID),
        AuthenticityError,
    )


def test_a_signature_made_under_another_tag_is_refused() -> None:
    for tag in [tag for tag in Tag if tag is not Tag.REVOCATION]:
        with case(tag):
            payload = encode(revocation())
            refused(signed(payload, tag=tag), Reason.SIGNATURE_INVALID)
            assert read_list(signed(payload), authority="people", key=KEY.public_key()).number == 7


def test_a_list_with_one_serial_taken_out_is_refused() -> None:
    """The attack: un-revoke a stolen key."""
    whole = msgspec.json.decode(sign_list(revocation(), KEY), type=SignedRevocation)
    less = msgspec.structs.replace(whole, payload=b64(encode(revocation(serials=("17",)))))
    refused(encode_fast(less), Reason.SIGNATURE_INVALID)


def test_a_serial_that_is_no_decimal_is_refused() -> None:
    for serial in ["", "-4", "4.0", "0x11", " 4", "4 ", "1e3", "four", "\u00b2"]:
        with case(serial):
            refused(sign_list(revocation(serials=(serial,)), KEY), Reason.MALFORMED)


def test_a_next_update_that_names_no_instant_is_refused() -> None:
    data = sign_list(revocation(next_update="2030-02-30T12:00:00Z"), KEY)
    refused(data, Reason.SCHEMA_INVALID)


@pytest.mark.parametrize(
    "data",
    [b"", b"{}", b"null", b"[]", b"\xff", b'{"payload":"","signature":""}\n\n'],
    ids=["nothing", "no fields", "null", "a list", "no text", "two new lines"],
)
def test_bytes_that_are_no_signed_list_are_malformed(data: bytes) -> None:
    with pytest.raises(MalformedError) as caught:
        read_list(data, authority="people", key=KEY.public_key())
    assert caught.value.where.startswith(WHERE)


def test_a_field_beside_payload_and_signature_is_refused() -> None:
    plain = msgspec.json.decode(sign_list(revocation(), KEY))
    refused(encode({**plain, "alg": "none"}), Reason.MALFORMED)


def test_an_empty_signature_does_not_hold() -> None:
    refused(b'{"payload":"","signature":""}', Reason.SIGNATURE_INVALID)


def test_a_signed_payload_that_is_not_canonical_is_refused() -> None:
    payload = encode(revocation()).replace(b'"number":7', b'"number": 7')
    refused(signed(payload), Reason.NOT_CANONICAL)


def test_a_signed_payload_with_a_field_too_many_is_refused() -> None:
    payload = encode(revocation()).replace(b'"number":7', b'"number":7,"omit":true')
    refused(signed(payload), Reason.MALFORMED)


def test_a_payload_in_a_second_spelling_of_base64_is_refused() -> None:
    payload = encode(revocation())
    text = b64(payload)
    if len(payload) % 3 == 0:  # then there are no stray bits to set
        payload = encode(revocation(number=77))
        text = b64(payload)
    alphabet = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_"
    twin = text[:-1] + alphabet[alphabet.index(text[-1]) + 1]
    data = signed(payload).replace(text.encode(), twin.encode())
    refused(data, Reason.NOT_CANONICAL)
