# SPDX-License-Identifier: Apache-2.0
"""Bytes to a certificate, once every part of it can be read; what it may do, `certificate` says.

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

#: What the library raises for bytes that are no certificate, and for a part that it cannot read.
_UNREADABLE = (ValueError, x509.InvalidVersion, CryptographyDeprecationWarning)


def load(der: bytes, *, where: str) -> x509.Certificate:
    """Return the certificate in the bytes.

    Raises:
        AuthenticityError: they are none.
    """
    try:
        certificate = x509.load_der_x509_certificate(der)
        positive = certificate.serial_number > 0
        # the library parses a name only when it is asked for: a broken one is refused here
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
        AuthenticityError: it holds something else.
    """
    try:
        found = x509.load_pem_x509_certificates(text)
    except _UNREADABLE as error:
        raise _bad("expected a PEM certificate", where) from error
    return tuple(load(one.public_bytes(Encoding.DER), where=where) for one in found)


def key_of(certificate: x509.Certificate, *, where: str) -> PublicKey:
    """Return a certificate's public key, checked; whose it is, nobody has verified.

    Raises:
        AuthenticityError: `KEY_INVALID`: an algorithm that is not supported, or an unsound key.
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
