# SPDX-License-Identifier: Apache-2.0
"""Scalars, points and hashes of FROST(Ed25519, SHA-512), every operation libsodium's.

No arithmetic on the curve is ours. A point enters once libsodium says that it is canonical, on the
curve, in the group of prime order and not the identity (L15); a scalar when it is canonical and
not zero. Source: RFC 9591 section 6.1. Spec page: docs/spec/frost.md#numbers
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import reduce
from hashlib import sha512
from secrets import token_bytes
from typing import NewType

from nacl import bindings
from nacl.exceptions import CryptoError

from authguard_r.core.encoding import b64, unb64
from authguard_r.core.errors import AuthenticityError, AuthGuardError
from authguard_r.core.reasons import Reason

#: An integer below the group's order, 32 bytes, least significant first.
Scalar = NewType("Scalar", bytes)
#: A point of the group of prime order, 32 bytes.
Point = NewType("Point", bytes)

_CONTEXT = b"FROST-ED25519-SHA512-v1"
_ORDER = 2**252 + 27742317777372353535851937790883648493
_ZERO, _ONE = Scalar(bytes(32)), Scalar((1).to_bytes(32, "little"))


def scalar(text: str) -> Scalar:
    """Return the scalar that base64url spells; from anyone.

    Raises:
        ValueError: not 32 bytes, not canonical, or zero.
    """
    raw = _raw(text, "a scalar")
    if not 0 < int.from_bytes(raw, "little") < _ORDER:
        raise ValueError("expected a scalar from 1 to the group's order")
    return Scalar(raw)


def point(text: str) -> Point:
    """Return the point that base64url spells; from anyone.

    Raises:
        ValueError: not canonical, not on the curve, of low or mixed order, or the identity.
    """
    raw = _raw(text, "a point")
    if not bindings.crypto_core_ed25519_is_valid_point(raw):
        raise ValueError("expected a canonical point of the group of prime order")
    return Point(raw)


def box_key(text: str) -> bytes:
    """Return the X25519 key that base64url spells; from anyone. Whether it is sound, its use shows.

    Raises:
        ValueError: not 32 bytes.
    """
    return _raw(text, "a key")


def spelled(value: Scalar | Point) -> str:
    """Return scalar or point as base64url."""
    return b64(value)


def number(value: int) -> Scalar:
    """Return a small integer as a scalar."""
    return Scalar(value.to_bytes(32, "little"))


def random_scalar() -> Scalar:
    """Return a uniform scalar that is not zero."""
    drawn = _reduced(token_bytes(64))
    return drawn if drawn != _ZERO else random_scalar()


def add(a: Scalar, b: Scalar) -> Scalar:
    """Return a + b."""
    return Scalar(bindings.crypto_core_ed25519_scalar_add(a, b))


def mul(a: Scalar, b: Scalar) -> Scalar:
    """Return a * b."""
    return Scalar(bindings.crypto_core_ed25519_scalar_mul(a, b))


def total(scalars: Iterable[Scalar]) -> Scalar:
    """Return the sum."""
    return reduce(add, scalars, _ZERO)


def base(factor: Scalar) -> Point:
    """Return factor * B.

    Raises:
        AuthenticityError: the factor is zero.
    """
    try:
        return Point(bindings.crypto_scalarmult_ed25519_base_noclamp(factor))
    except CryptoError as error:
        raise _degenerate() from error


def times(factor: Scalar, to: Point) -> Point:
    """Return factor * P.

    Raises:
        AuthenticityError: the factor is zero or the point is no sound one.
    """
    try:
        return Point(bindings.crypto_scalarmult_ed25519_noclamp(factor, to))
    except CryptoError as error:
        raise _degenerate() from error


def plus(a: Point, b: Point) -> Point:
    """Return P + Q, which may be the identity.

    Raises:
        AuthenticityError: one of them is not on the curve.
    """
    try:
        return Point(bindings.crypto_core_ed25519_add(a, b))
    except CryptoError as error:  # pragma: no cover - points are checked where they enter
        raise _degenerate() from error


def gathered(points: Iterable[Point]) -> Point:
    """Return the sum of at least one point."""
    return reduce(plus, points)


def polynomial_at(coefficients: tuple[Scalar, ...], place: int) -> Scalar:
    """Return f(place); the first coefficient is f(0)."""
    at, result = number(place), _ZERO
    for coefficient in reversed(coefficients):
        result = add(mul(result, at), coefficient)
    return result


def committed_at(commitment: tuple[Point, ...], place: int) -> Point:
    """Return f(place) * B from the commitments to f's coefficients (Feldman).

    Raises:
        AuthenticityError: the commitments cancel each other out; none of an honest maker's do.
    """
    at, result = number(place), commitment[-1]
    for item in reversed(commitment[:-1]):
        result = plus(times(at, result), item)
    return result


def lagrange(place: int, places: tuple[int, ...]) -> Scalar:
    """Return the coefficient of f(place) in f(0), over distinct places from 1 on."""
    above, below = _ONE, _ONE
    for other in places:
        if other != place:
            above = mul(above, number(other))
            apart = bindings.crypto_core_ed25519_scalar_sub(number(other), number(place))
            below = mul(below, Scalar(apart))
    return mul(above, Scalar(bindings.crypto_core_ed25519_scalar_invert(below)))


def h1(data: bytes) -> Scalar:
    """Return the binding factor of its input."""
    return _reduced(sha512(_CONTEXT + b"rho" + data).digest())


def h2(data: bytes) -> Scalar:
    """Return the challenge, exactly that of RFC 8032."""
    return _reduced(sha512(data).digest())


def h3(data: bytes) -> Scalar:
    """Return a nonce."""
    return _reduced(sha512(_CONTEXT + b"nonce" + data).digest())


def h4(data: bytes) -> bytes:
    """Return the hash of the message."""
    return sha512(_CONTEXT + b"msg" + data).digest()


def h5(data: bytes) -> bytes:
    """Return the hash of the commitments."""
    return sha512(_CONTEXT + b"com" + data).digest()


def h_dkg(data: bytes) -> Scalar:
    """Return the challenge of a proof of knowledge in key generation."""
    return _reduced(sha512(_CONTEXT + b"dkg" + data).digest())


def holds(key: Point, signature: bytes, message: bytes) -> bool:
    """True when it is the key's plain Ed25519 signature over the message."""
    try:
        bindings.crypto_sign_open(signature + message, key)
    except CryptoError:
        return False
    return True


def _reduced(data: bytes) -> Scalar:
    return Scalar(bindings.crypto_core_ed25519_scalar_reduce(data))


def _raw(text: str, what: str) -> bytes:
    try:
        raw = unb64(text)
    except AuthGuardError as error:
        raise ValueError(f"expected {what} in base64url") from error
    if len(raw) != 32:
        raise ValueError(f"expected {what} of 32 bytes, got {len(raw)}")
    return raw


def _degenerate() -> AuthenticityError:
    return AuthenticityError(
        "expected numbers that do not cancel each other out", reason=Reason.KEY_INVALID
    )
