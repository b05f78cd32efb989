# SPDX-License-Identifier: Apache-2.0
"""Signed revocation lists: each certificate authority says which of its leaves are dead.

A list that is missing or past its `next_update` refuses every certificate it should cover:
not knowing is not the same as knowing it is good. Spec page: docs/spec/token.md#revocation
"""

from __future__ import annotations

import re

from msgspec import Struct

from authguard_r.core.encoding import Tag, b64, decode, digest, encode, encode_fast, unb64
from authguard_r.core.errors import MalformedError
from authguard_r.core.identifiers import Base64Url, Count, Identifier, Timestamp
from authguard_r.core.quantities import to_ms
from authguard_r.keys.algorithms import PrivateKey, PublicKey, require_signature

_SERIAL = re.compile(r"[1-9][0-9]{0,48}")


class Revocation(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What one authority revoked.

    Args:
        authority: name of the authority (`root` for the root's own list of authorities).
        number: grows with each list; an older one never replaces a newer.
        issued: when it was signed.
        next_update: after this it is stale.
        serials: serial numbers, decimal, sorted as text.
    """

    authority: Identifier
    number: Count
    issued: Timestamp
    next_update: Timestamp
    serials: tuple[str, ...]


class SignedRevocation(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The list's bytes and its authority's signature over their digest."""

    payload: Base64Url
    signature: Base64Url


class RevocationList(Struct, frozen=True, kw_only=True):
    """An authentic list, ready for look-up.

    Args:
        number: grows with each list.
        next_update_ms: after this it is stale.
        serials: of the dead certificates.
        issued_ms: when it was signed.
        authority: the name that it says it is of.
        signed: the very bytes, to be handed on or kept.
    """

    number: int
    next_update_ms: int
    serials: frozenset[int]
    issued_ms: int = 0
    authority: str = ""
    signed: bytes = b""


def sign_list(revocation: Revocation, key: PrivateKey) -> bytes:
    """Return the signed list as a file's bytes."""
    payload = encode(revocation)
    signature = key.sign(unb64(digest(Tag.REVOCATION, payload)))
    signed = SignedRevocation(payload=b64(payload), signature=b64(signature))
    return encode_fast(signed) + b"\n"


def _are_serials(texts: tuple[str, ...]) -> bool:
    """True for distinct positive decimals as a certificate can have them, sorted as text."""
    plain = all(_SERIAL.fullmatch(text) for text in texts)
    return plain and list(texts) == sorted(set(texts))


def read_list(data: bytes, *, authority: str, key: PublicKey) -> RevocationList:
    """Return the list once its authority's signature over it holds.

    Raises:
        MalformedError: no canonical list, or one of another authority.
        AuthenticityError: the signature is not valid.
    """
    where = f"revocations/{authority}"
    signed = decode(data.removesuffix(b"\n"), SignedRevocation, where=where)
    payload = unb64(signed.payload, where=where)
    message = unb64(digest(Tag.REVOCATION, payload))
    require_signature(key, unb64(signed.signature, where=where), message, where=where)
    revocation = decode(payload, Revocation, where=where)
    if revocation.authority != authority or not _are_serials(revocation.serials):
        raise MalformedError(f"expected the list of `{authority}`", where=where)
    return RevocationList(
        number=revocation.number,
        next_update_ms=to_ms(revocation.next_update, where=where),
        serials=frozenset(int(serial) for serial in revocation.serials),
        issued_ms=to_ms(revocation.issued, where=where),
        authority=authority,
        signed=data,
    )


def claimed_authority(data: bytes) -> str:
    """Return the name of the authority that a list says it is of; it is not verified.

    Raises:
        MalformedError: it is no canonical list.
    """
    where = "revocations"
    signed = decode(data.removesuffix(b"\n"), SignedRevocation, where=where)
    return decode(unb64(signed.payload, where=where), Revocation, where=where).authority
