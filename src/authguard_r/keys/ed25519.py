# SPDX-License-Identifier: Apache-2.0
"""Ed25519 points, with the checks that the library leaves out.

A key of low order verifies one signature for any message, and a non-canonical one gives a second
name to the same point; both are refused wherever a key enters (L15).
Spec page: docs/spec/token.md#keys
"""

from __future__ import annotations

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from authguard_r.core.errors import AuthenticityError
from authguard_r.core.reasons import Reason

_P = 2**255 - 19
_EIGHT = int.from_bytes(
    bytes.fromhex("26e8958fc2b227b045c3f489f2ef98f0d5dfac05d3c63339b13802886d53fc05"), "little"
)
#: y-coordinates of the eight points of low order.
_LOW_ORDER = frozenset({0, 1, _P - 1, _EIGHT, _P - _EIGHT})


def public_key(raw: bytes, *, where: str) -> Ed25519PublicKey:
    """Return the key that 32 bytes name.

    Raises:
        AuthenticityError: wrong length, not canonical, or of low order.
    """
    if len(raw) != 32:
        raise _invalid(f"expected 32 bytes, got {len(raw)}", where)
    require_sound_point(raw, where=where)
    return Ed25519PublicKey.from_public_bytes(raw)


def require_sound_point(raw: bytes, *, where: str) -> None:
    """Require that 32 bytes name a point that can be a key.

    Raises:
        AuthenticityError: not canonical, or of low order.
    """
    y = int.from_bytes(raw, "little") & (2**255 - 1)
    if y >= _P:
        raise _invalid("expected a canonical key", where)
    if y in _LOW_ORDER:
        raise _invalid("expected a key that is not of low order", where)


def _invalid(message: str, where: str) -> AuthenticityError:
    return AuthenticityError(message, reason=Reason.KEY_INVALID, where=where)
