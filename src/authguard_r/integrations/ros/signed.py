# SPDX-License-Identifier: Apache-2.0
"""Signed XML of DDS Security: an S/MIME message, its text in the clear, its signature apart.

What DDS goes by is the text in the signed message, never a copy that lies beside it.
Spec page: docs/spec/ros-map.md#keystore
"""

from __future__ import annotations

import base64
import binascii
import re

from asn1crypto import cms
from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, padding, rsa
from cryptography.hazmat.primitives.serialization import Encoding, pkcs7
from msgspec import Struct

from authguard_r.core.errors import AuthenticityError, MalformedError
from authguard_r.core.reasons import Reason

#: Longest signed document, in bytes.
MAX_SIGNED = 1 << 20
_BOUNDARY = re.compile(rb'boundary="([^"\r\n]{1,70})"')
_DIGESTS: dict[str, hashes.HashAlgorithm] = {
    "sha256": hashes.SHA256(),
    "sha384": hashes.SHA384(),
    "sha512": hashes.SHA512(),
}


class _Signature(Struct, frozen=True):
    """What a signature says of itself.

    Args:
        digest: of the signed part, with which algorithm.
        hashed: that digest.
        attributes: what is really signed: the digest is one of them.
        value: over the attributes.
    """

    digest: str
    hashed: bytes
    attributes: bytes
    value: bytes


def sign_text(text: bytes, certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey) -> bytes:
    """Return a text as DDS Security takes it."""
    made = pkcs7.PKCS7SignatureBuilder().set_data(text)
    options = [pkcs7.PKCS7Options.Text, pkcs7.PKCS7Options.DetachedSignature]
    return made.add_signer(certificate, key, hashes.SHA256()).sign(Encoding.SMIME, options)


def open_text(data: bytes, authority: x509.Certificate, *, where: str) -> bytes:
    """Return the text of a signed message, once its authority has signed it.

    Args:
        data: the message.
        authority: whose signature it has to have.
        where: the file, for messages.

    Raises:
        MalformedError: no such message.
        AuthenticityError: the signature is another's, or of another text.
    """
    if len(data) > MAX_SIGNED:
        raise MalformedError("expected a shorter document", where=where)
    part, encoded = _parts(data, where=where)
    signature = _signature(encoded, where=where)
    digest = _DIGESTS.get(signature.digest)
    if digest is None:
        raise _forged("expected SHA-256 or longer", where)
    hashed = hashes.Hash(digest)
    hashed.update(part)
    if hashed.finalize() != signature.hashed:
        raise _forged("the text is not the one that was signed", where)
    try:
        _verify(authority, signature.value, signature.attributes, digest)
    except InvalidSignature as error:
        raise _forged("the permissions authority has not signed it", where) from error
    _, _, text = part.partition(b"\r\n\r\n")
    return text


def _parts(data: bytes, *, where: str) -> tuple[bytes, bytes]:
    """Return the signed part as it was signed, and the signature."""
    found = _BOUNDARY.search(data)
    if found is None:
        raise MalformedError("expected a signed message in two parts", where=where)
    line = b"--" + found[1]
    whole = data.replace(b"\r\n", b"\n").split(b"\n" + line)
    if len(whole) != 4 or not whole[3].startswith(b"--"):
        raise MalformedError("expected a signed message in two parts", where=where)
    text, signature = whole[1].removeprefix(b"\n"), whole[2].partition(b"\n\n")[2]
    try:
        encoded = base64.b64decode(b"".join(signature.split()), validate=True)
    except binascii.Error as error:
        raise MalformedError("expected a signature in base64", where=where) from error
    return text.replace(b"\n", b"\r\n"), encoded


def _signature(encoded: bytes, *, where: str) -> _Signature:
    try:
        content = cms.ContentInfo.load(encoded, strict=True)["content"]
        (signer,) = content["signer_infos"]
        attributes = signer["signed_attrs"]
        (hashed,) = [
            item["values"].native for item in attributes if item["type"].native == "message_digest"
        ]
        return _Signature(
            signer["digest_algorithm"]["algorithm"].native,
            bytes(*hashed),
            attributes.untag().dump(),
            signer["signature"].native,
        )
    except (ValueError, TypeError, KeyError, AttributeError) as error:  # asn1crypto has no one
        raise MalformedError("expected one signature", where=where) from error


def _verify(
    authority: x509.Certificate, signature: bytes, data: bytes, digest: hashes.HashAlgorithm
) -> None:
    key = authority.public_key()
    if isinstance(key, ec.EllipticCurvePublicKey):
        key.verify(signature, data, ec.ECDSA(digest))
    elif isinstance(key, rsa.RSAPublicKey):
        key.verify(signature, data, padding.PKCS1v15(), digest)
    else:
        raise InvalidSignature


def _forged(message: str, where: str) -> AuthenticityError:
    return AuthenticityError(message, reason=Reason.SIGNATURE_INVALID, where=where)
