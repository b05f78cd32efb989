# SPDX-License-Identifier: Apache-2.0
"""Keys at the door: what `public_key`, `require_sound` and `require_signature` let in (L15)."""

from __future__ import annotations

import pytest
from cryptography.hazmat.primitives.asymmetric import ec, ed448, rsa, x25519
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat
from hypothesis import given, settings
from hypothesis import strategies as st

from authguard_r.core.errors import AuthenticityError
from authguard_r.core.reasons import Reason
from authguard_r.keys.algorithms import require_signature, require_sound
from authguard_r.keys.ed25519 import public_key
from fixtures.cases import case

P = 2**255 - 19
D = -121665 * pow(121666, P - 2, P) % P
SIGN = 1 << 255

#: The eight points whose order divides 8, as everybody else writes them.
LOW_ORDER = {
    "order 1": "0100000000000000000000000000000000000000000000000000000000000000",
    "order 2": "ecffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff7f",
    "order 4, x even": "0000000000000000000000000000000000000000000000000000000000000000",
    "order 4, x odd": "0000000000000000000000000000000000000000000000000000000000000080",
    "order 8, y, x even": "26e8958fc2b227b045c3f489f2ef98f0d5dfac05d3c63339b13802886d53fc05",
    "order 8, y, x odd": "26e8958fc2b227b045c3f489f2ef98f0d5dfac05d3c63339b13802886d53fc85",
    "order 8, -y, x even": "c7176a703d4dd84fba3c0b760d10670f2a2053fa2c39ccc64ec7fd7792ac037a",
    "order 8, -y, x odd": "c7176a703d4dd84fba3c0b760d10670f2a2053fa2c39ccc64ec7fd7792ac03fa",
}

#: Second spellings of the same points: a sign where x is 0, or y not reduced.
LOW_ORDER_TWINS = {
    "order 1, sign of zero": "0100000000000000000000000000000000000000000000000000000000000080",
    "order 2, sign of zero": "ecffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff",
    "order 4, y = p": "edffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff7f",
    "order 4, y = p, sign": "edffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff",
    "order 1, y = p + 1": "eeffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff7f",
    "order 1, y = p + 1, sign": "eeffffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff",
}


def raw(key: Ed25519PrivateKey) -> bytes:
    return key.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw)


def y_of(encoded: bytes) -> int:
    return int.from_bytes(encoded, "little") % SIGN % P


def refused(data: bytes) -> AuthenticityError:
    with pytest.raises(AuthenticityError) as caught:
        public_key(data, where="certificate.leaf")
    assert caught.value.reason is Reason.KEY_INVALID
    assert caught.value.where == "certificate.leaf"
    return caught.value


def times_eight_is_identity(y: int) -> bool:
    """Double a point of this y three times, in y alone: no library, no product code."""
    for _ in range(3):
        # y(2P) = (y^2 + x^2) / (1 - d x^2 y^2), and x^2 = (y^2 - 1) / (d y^2 + 1)
        square = y * y % P
        x_square = (square - 1) * pow(D * square + 1, P - 2, P) % P
        y = (square + x_square) * pow(1 - D * x_square * square, P - 2, P) % P
    return y == 1


def test_the_list_of_low_order_points_is_the_whole_list() -> None:
    ys = {y_of(bytes.fromhex(text)) for text in LOW_ORDER.values()}
    assert all(times_eight_is_identity(y) for y in ys)
    assert len(LOW_ORDER) == 8
    assert len(ys) == 5  # x and -x share a y, except where x is 0
    assert not times_eight_is_identity(y_of(raw(Ed25519PrivateKey.from_private_bytes(bytes(32)))))


def test_a_low_order_key_is_refused() -> None:
    for name, text in LOW_ORDER.items():
        with case(name):
            assert "low order" in refused(bytes.fromhex(text)).message


@pytest.mark.parametrize("text", LOW_ORDER_TWINS.values(), ids=LOW_ORDER_TWINS)
def test_a_second_spelling_of_a_low_order_key_is_refused(text: str) -> None:
    refused(bytes.fromhex(text))


def test_a_low_order_key_would_have_accepted_a_forgery_for_any_message() -> None:
    """Why the list is needed: the library itself lets the identity key verify everything."""
    key = Ed25519PublicKey.from_public_bytes(bytes.fromhex(LOW_ORDER["order 1"]))
    forged = bytes.fromhex(LOW_ORDER["order 1"]) + bytes(32)
    for message in (b"", b"go", b"anything at all"):
        key.verify(forged, message)  # would raise InvalidSignature
    with pytest.raises(AuthenticityError) as caught:
        require_sound(key, where="certificate.leaf")
    assert caught.value.reason is Reason.KEY_INVALID


def test_every_key_that_is_not_reduced_is_refused() -> None:
    for excess in range(19):
        for sign in [0, SIGN]:
            with case(excess, sign):
                error = refused((P + excess + sign).to_bytes(32, "little"))
                assert "canonical" in error.message


@pytest.mark.parametrize("length", [0, 1, 31, 33, 64])
def test_a_key_of_another_length_is_refused(length: int) -> None:
    assert f"got {length}" in refused(b"\x07" * length).message


@settings(max_examples=40)
@given(st.binary(min_size=32, max_size=32))
def test_every_honest_key_is_accepted_as_it_is(seed: bytes) -> None:
    encoded = raw(Ed25519PrivateKey.from_private_bytes(seed))
    key = public_key(encoded, where="key")
    assert key.public_bytes(Encoding.Raw, PublicFormat.Raw) == encoded
    assert require_sound(key, where="key") is key


@pytest.mark.parametrize(
    "key",
    [
        rsa.generate_private_key(65537, 2048).public_key(),
        ec.generate_private_key(ec.SECP256R1()).public_key(),
        ed448.Ed448PrivateKey.generate().public_key(),
        x25519.X25519PrivateKey.generate().public_key(),
        Ed25519PrivateKey.generate(),
        b"\x07" * 32,
        None,
    ],
    ids=["RSA", "P-256", "Ed448", "X25519", "a private key", "bytes", "nothing"],
)
def test_a_key_of_another_kind_is_refused(key: object) -> None:
    with pytest.raises(AuthenticityError) as caught:
        require_sound(key, where="root")
    assert caught.value.reason is Reason.KEY_INVALID
    assert caught.value.where == "root"


@settings(max_examples=40)
@given(st.binary(max_size=80), st.integers(0, 511))
def test_a_signature_with_any_bit_flipped_does_not_hold(message: bytes, bit: int) -> None:
    key = Ed25519PrivateKey.from_private_bytes(b"s" * 32)
    signature = key.sign(message)
    require_signature(key.public_key(), signature, message, where="signature")
    flipped = bytearray(signature)
    flipped[bit // 8] ^= 1 << bit % 8
    with pytest.raises(AuthenticityError) as caught:
        require_signature(key.public_key(), bytes(flipped), message, where="signature")
    assert caught.value.reason is Reason.SIGNATURE_INVALID
    assert caught.value.where == "signature"


@pytest.mark.parametrize("length", [0, 1, 32, 63, 65, 128, 5000])
def test_a_signature_of_another_length_does_not_hold(length: int) -> None:
    key = Ed25519PrivateKey.from_private_bytes(b"s" * 32)
    with pytest.raises(AuthenticityError) as caught:
        require_signature(key.public_key(), bytes(length), b"go", where="signature")
    assert caught.value.reason is Reason.SIGNATURE_INVALID


def test_a_signature_with_the_group_order_added_does_not_hold() -> None:
    """Malleability: S + L gives the same point; RFC 8032 wants S < L."""
    key = Ed25519PrivateKey.from_private_bytes(b"s" * 32)
    signature = key.sign(b"go")
    order = 2**252 + 27742317777372353535851937790883648493
    twin = int.from_bytes(signature[32:], "little") + order
    with pytest.raises(AuthenticityError) as caught:
        require_signature(
            key.public_key(), signature[:32] + twin.to_bytes(32, "little"), b"go", where="signature"
        )
    assert caught.value.reason is Reason.SIGNATURE_INVALID
