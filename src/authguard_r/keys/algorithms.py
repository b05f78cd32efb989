# SPDX-License-Identifier: Apache-2.0
"""The signature algorithms of a certificate's key, behind one door.

The algorithm is the key's, and the key comes from a certificate: no message and no token has a
say in it (L14). Every key that enters is held to the checks that its algorithm needs.
Source: `eq:signature`, section "Post-Quantum Considerations". Spec page: docs/spec/token.md#keys
"""

from __future__ import annotations

from enum import StrEnum

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.asymmetric.mldsa import (
    MLDSA44PrivateKey,
    MLDSA44PublicKey,
    MLDSA65PrivateKey,
    MLDSA65PublicKey,
    MLDSA87PrivateKey,
    MLDSA87PublicKey,
)

from authguard_r.core.errors import AuthenticityError
from authguard_r.core.reasons import Reason
from authguard_r.keys.ed25519 import require_sound_point

PrivateKey = Ed25519PrivateKey | MLDSA44PrivateKey | MLDSA65PrivateKey | MLDSA87PrivateKey
PublicKey = Ed25519PublicKey | MLDSA44PublicKey | MLDSA65PublicKey | MLDSA87PublicKey


class Algorithm(StrEnum):
    """What a key signs with."""

    ED25519 = "ed25519"
    ML_DSA_44 = "ml-dsa-44"
    ML_DSA_65 = "ml-dsa-65"
    ML_DSA_87 = "ml-dsa-87"


_PAIRS: dict[Algorithm, tuple[type[PrivateKey], type[PublicKey]]] = {
    Algorithm.ED25519: (Ed25519PrivateKey, Ed25519PublicKey),
    Algorithm.ML_DSA_44: (MLDSA44PrivateKey, MLDSA44PublicKey),
    Algorithm.ML_DSA_65: (MLDSA65PrivateKey, MLDSA65PublicKey),
    Algorithm.ML_DSA_87: (MLDSA87PrivateKey, MLDSA87PublicKey),
}
#: What `isinstance` takes: every private key, every public key.
PRIVATE = tuple(private for private, _ in _PAIRS.values())
PUBLIC = tuple(public for _, public in _PAIRS.values())
#: What an ML-DSA public key begins with; t1, all that it says of the secret, comes after.
_SEED_BYTES = 32


def generate(algorithm: Algorithm) -> PrivateKey:
    """Return a fresh private key."""
    return _PAIRS[algorithm][0].generate()


def algorithm_of(key: PrivateKey | PublicKey) -> Algorithm:
    """Return what the key signs with."""
    return next(name for name, pair in _PAIRS.items() if isinstance(key, pair))


def require_sound(key: object, *, where: str) -> PublicKey:
    """Return `key` as a public key of one of these algorithms that passes its checks.

    An Ed25519 point must be canonical and not of low order, and an ML-DSA key must not be zero
    behind its seed: the library checks neither, and under such a key anyone can sign. The library
    looks at the length.

    Raises:
        AuthenticityError: another algorithm, or an unsound key (`KEY_INVALID`).
    """
    if isinstance(key, Ed25519PublicKey):
        require_sound_point(key.public_bytes_raw(), where=where)
    elif not isinstance(key, PUBLIC):
        raise _invalid(f"expected a key of {', '.join(Algorithm)}, got {type(key).__name__}", where)
    elif not any(key.public_bytes_raw()[_SEED_BYTES:]):
        raise _invalid("expected a key that is not zero", where)
    return key


def require_private(key: object, *, where: str) -> PrivateKey:
    """Return `key` as a private key of one of these algorithms.

    Raises:
        AuthenticityError: another algorithm (`KEY_INVALID`).
    """
    if not isinstance(key, PRIVATE):
        raise _invalid(f"expected a private key of {', '.join(Algorithm)}", where)
    return key


def require_one_algorithm(*keys: object) -> None:
    """Require keys of one algorithm, from a root to its leaf.

    Under several roots each answers for its own: a leaf of a broken algorithm under the sound root
    would carry both signatures.

    Raises:
        AuthenticityError: they are of several (`CERTIFICATE_INVALID`).
    """
    if len({algorithm_of(require_sound(key, where="certificate")) for key in keys}) > 1:
        raise AuthenticityError(
            "expected keys of the root's own algorithm",
            reason=Reason.CERTIFICATE_INVALID,
            where="certificate",
        )


def require_signature(key: PublicKey, signature: bytes, message: bytes, *, where: str) -> None:
    """Return when the signature holds.

    Raises:
        AuthenticityError: with `SIGNATURE_INVALID` when it does not.
    """
    try:
        key.verify(signature, message)
    except InvalidSignature as error:
        raise AuthenticityError(
            "the signature is not valid", reason=Reason.SIGNATURE_INVALID, where=where
        ) from error


def _invalid(message: str, where: str) -> AuthenticityError:
    return AuthenticityError(message, reason=Reason.KEY_INVALID, where=where)
