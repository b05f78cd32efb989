# SPDX-License-Identifier: Apache-2.0
"""Load a certificate, and refuse one with a part that cannot be read.

`certificate` checks what its holder may sign.

Spec page: docs/spec/token.md#certificates
"""

from __future__ import annotations

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.utils import CryptographyDeprecationWarning

from authguard_r.core.errors import AuthenticityError
from authguard_r.core.reasons import Reason
from authguard_r.keys.algorithms import PublicKey, require_sound

#: The library's errors for bytes that are not a certificate and for parts that it cannot read.
_UNREADABLE = (ValueError, x509.InvalidVersion, CryptographyDeprecationWarning)


def load(der: bytes, *, where: str) -> x509.Certificate:
    """Return the certificate in DER bytes; every part of it can be read.

    Raises:
        AuthenticityError: the bytes are not a certificate, or a part cannot be read.
    """
    try:
        certificate = x509.load_der_x509_certificate(der)
        positive = certificate.serial_number > 0
        # the library parses names on first use: read them here, so that no later use can fail
        _ = certificate.subject, certificate.issuer
        _ = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    except _UNREADABLE as error:
        raise _bad("expected a DER certificate", where) from error
    if not positive:
        raise _bad("expected a positive serial number", where)
    return certificate


def load_pem(text: bytes, *, where: str) -> tuple[x509.Certificate, ...]:
    """Return the certificates in PEM text, at least one.

    Raises:
        AuthenticityError: the text is not PEM, or one of its certificates cannot be read.
    """
    try:
        found = x509.load_pem_x509_certificates(text)
    except _UNREADABLE as error:
        raise _bad("expected a PEM certificate", where) from error
    return tuple(load(one.public_bytes(Encoding.DER), where=where) for one in found)


def key_of(certificate: x509.Certificate, *, where: str) -> PublicKey:
    """Return a certificate's public key after a check of its algorithm and value.

    The caller checks the chain: without it, the owner of the key is unknown.

    Raises:
        AuthenticityError: `KEY_INVALID`: the algorithm is not supported, or the key is unsound.
    """
    try:
        public = certificate.public_key()
    except (ValueError, UnsupportedAlgorithm) as error:
        raise AuthenticityError(
            "expected a key of a known algorithm", reason=Reason.KEY_INVALID, where=where
        ) from error
    return require_sound(public, where=where)


def _bad(message: str, where: str) -> AuthenticityError:
    return AuthenticityError(message, reason=Reason.CERTIFICATE_INVALID, where=where)
