# SPDX-License-Identifier: Apache-2.0
"""How a key becomes a principal's without ever leaving its machine: request and answer, as files.

A request is a PKCS#10 request for each key, which proves that its maker holds the key, and what is
wanted. Each proof names the digest of what is wanted, so it cannot be changed on the way. An answer
is the certificates, and everything that a machine needs to verify them. Spec page:
docs/spec/token.md#requests
"""

from __future__ import annotations

from hashlib import sha256
from typing import Annotated, Literal

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import NameOID
from msgspec import Meta, Struct

from authguard_r.core.encoding import b64, decode, encode_fast, unb64
from authguard_r.core.errors import AuthenticityError, MalformedError
from authguard_r.core.identifiers import (
    Base64Url,
    Digest,
    Identifier,
    PrincipalId,
    RegionId,
    RobotId,
)
from authguard_r.core.principals import Endorsed
from authguard_r.core.reasons import Reason
from authguard_r.core.token import Endorsement
from authguard_r.keys.algorithms import PRIVATE, PublicKey, algorithm_of, require_sound
from authguard_r.keys.certificate import Role
from authguard_r.keys.pkcs11 import request_of
from authguard_r.keys.signer import FileSigner, SigningKey

_REQUEST = "authguard-r/key-request/1"
#: What the library says of bytes that are no request, or one that says something else.
_NO_REQUEST = (
    ValueError,
    UnsupportedAlgorithm,
    x509.DuplicateExtension,
    x509.ExtensionNotFound,
    x509.InvalidVersion,
    x509.UnsupportedGeneralNameType,
)
#: Whose signatures count for the robots and regions that their certificate names, and no others:
#: without both they could sign nothing. What the other roles sign is not confined.
CONFINED = frozenset({Role.OPERATOR, Role.SUPERVISOR, Role.SAFETY_OFFICER, Role.SCHEDULER})
#: What belongs to one robot; its certificate names that one.
OF_ONE_ROBOT = frozenset({Role.GATE, Role.ESTIMATOR})
_WANTED = "urn:authguard-r:wanted:"
_Proofs = Annotated[tuple[Base64Url, ...], Meta(min_length=1, max_length=2)]


class WantedCertificate(
    Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True
):
    """What a person asks a certificate for; the authority decides whether it issues it.

    Args:
        principal: whose key it is.
        role: what it shall sign.
        robots: those that it shall sign for, a machine's own among them.
        every_robot: all of them instead.
        regions: where.
        every_region: everywhere instead.
        profile: for a gate, the digest of its robot's capability profile.
        template: for a scheduler, the digest of its template.
    """

    principal: PrincipalId
    role: Role
    robots: tuple[RobotId, ...] = ()
    every_robot: bool = False
    regions: tuple[RegionId, ...] = ()
    every_region: bool = False
    profile: Digest | None = None
    template: Digest | None = None


class CertificateRequest(
    Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, omit_defaults=True
):
    """The file that goes to the authority.

    Args:
        format: name and version.
        wanted: see there.
        proofs: a PKCS#10 request of each key, DER, in the order of the roots.
        renews: signatures by the key that has the name now, when this one shall follow it.
    """

    format: Literal["authguard-r/key-request/1"]
    wanted: WantedCertificate
    proofs: _Proofs
    renews: tuple[Endorsement, ...] = ()


class OpenedRequest(Struct, frozen=True, kw_only=True):
    """A request whose maker holds the keys; who the maker is, is not verified.

    Args:
        wanted: what is asked for.
        keys: the keys, sound.
        message: what the key before signs.
        renews: its signatures, not looked at yet.
    """

    wanted: WantedCertificate
    keys: tuple[PublicKey, ...]
    message: bytes
    renews: tuple[Endorsed, ...]


class CertificateAnswer(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The file that comes back: certificates, and what a machine needs to verify them.

    Args:
        format: name and version.
        chains: leaf and authority of each key, DER.
        roots: the root certificates, DER.
        authorities: every role authority's certificate by its name, DER.
        lists: the signed revocation lists by their authority's name.
    """

    format: Literal["authguard-r/key-answer/1"]
    chains: Annotated[tuple[tuple[Base64Url, Base64Url], ...], Meta(min_length=1, max_length=2)]
    roots: _Proofs
    authorities: dict[Identifier, Base64Url]
    lists: dict[Identifier, str]


def make_request(
    wanted: WantedCertificate, keys: tuple[SigningKey, ...], *, before: FileSigner | None = None
) -> bytes:
    """Return the request's bytes.

    Args:
        wanted: what is asked for.
        keys: the new keys, in the order of the roots.
        before: the key that has the name now, when the new one shall follow it.
    """
    proofs = tuple(b64(_proof(wanted, key)) for key in keys)
    renews: tuple[Endorsement, ...] = ()
    if before is not None:
        renews = tuple(
            Endorsement(chain=tuple(b64(der) for der in chain), signature=b64(signature))
            for chain, signature in before.endorse(_message(wanted, proofs))
        )
    request = CertificateRequest(
        format="authguard-r/key-request/1", wanted=wanted, proofs=proofs, renews=renews
    )
    return encode_fast(request) + b"\n"


def open_request(data: bytes) -> OpenedRequest:
    """Return what a request asks for, once its maker is known to hold the keys.

    Raises:
        MalformedError: no canonical request, or one that no authority could grant.
        AuthenticityError: a proof does not hold, or is for something else.
    """
    request = decode(data.removesuffix(b"\n"), CertificateRequest, where="request")
    _require_sense(request.wanted)
    keys = tuple(
        _proven(unb64(proof, where="request.proofs"), request.wanted, where="request.proofs")
        for proof in request.proofs
    )
    if len(set(map(algorithm_of, keys))) < len(keys):
        raise MalformedError("expected keys of different algorithms", where="request.proofs")
    renews = tuple(
        (
            tuple(unb64(der, where="request.renews") for der in item.chain),
            unb64(item.signature, where="request.renews"),
        )
        for item in request.renews
    )
    message = _message(request.wanted, request.proofs)
    return OpenedRequest(wanted=request.wanted, keys=keys, message=message, renews=renews)


def fingerprint(roots: tuple[x509.Certificate, ...]) -> str:
    """Return what people compare: SHA-256 over the roots' DER, in hexadecimal."""
    return sha256(b"".join(root.public_bytes(Encoding.DER) for root in roots)).hexdigest()


def key_fingerprint(key: PublicKey) -> str:
    """Return SHA-256 over a public key, in hexadecimal: what two people read to each other."""
    return sha256(key.public_bytes_raw()).hexdigest()


def _proof(wanted: WantedCertificate, key: SigningKey) -> bytes:
    uri = x509.UniformResourceIdentifier(_WANTED + _wanted_digest(wanted))
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, wanted.principal)])
    builder = x509.CertificateSigningRequestBuilder().subject_name(name)
    builder = builder.add_extension(x509.SubjectAlternativeName([uri]), critical=False)
    if isinstance(key, PRIVATE):
        return builder.sign(key, None).public_bytes(Encoding.DER)
    return request_of(builder, key)


def _proven(der: bytes, wanted: WantedCertificate, *, where: str) -> PublicKey:
    """Return the key of a PKCS#10 request that its holder made for exactly this."""
    try:
        csr = x509.load_der_x509_csr(der)
        key = require_sound(csr.public_key(), where=where)
        holds = csr.is_signature_valid
        names = csr.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        said = names.get_values_for_type(x509.UniformResourceIdentifier)
    except _NO_REQUEST as error:
        raise _unproven("expected a PKCS#10 request", where) from error
    if not holds or said != [_WANTED + _wanted_digest(wanted)]:
        raise _unproven("expected a proof by the key for this request", where)
    return key


def _wanted_digest(wanted: WantedCertificate) -> str:
    return b64(sha256(f"{_REQUEST}\0".encode() + encode_fast(wanted)).digest())


def _message(wanted: WantedCertificate, proofs: tuple[str, ...]) -> bytes:
    """Return what the key before signs, to hand its name on to these keys and no others."""
    said = encode_fast({"proofs": proofs, "wanted": wanted})
    return sha256(f"{_REQUEST}/renews\0".encode() + said).digest()


def _require_sense(wanted: WantedCertificate) -> None:
    """Refuse what no certificate of the profile can say, before a person looks at it."""
    robots, role = len(wanted.robots), wanted.role
    for name, every in (("robots", wanted.every_robot), ("regions", wanted.every_region)):
        given: tuple[str, ...] = getattr(wanted, name)
        if (every and given) or list(given) != sorted(set(given)):
            raise MalformedError(
                "expected distinct names in order, or every one", where=f"request.{name}"
            )
    if role in OF_ONE_ROBOT and robots != 1:
        raise MalformedError("expected the one robot that it is of", where="request.robots")
    if (wanted.profile is not None) is not (role is Role.GATE):
        raise MalformedError("expected a gate's, and only a gate's", where="request.profile")
    if (wanted.template is not None) is not (role is Role.SCHEDULER):
        raise MalformedError("expected a scheduler's, and only its", where="request.template")


def _unproven(message: str, where: str) -> AuthenticityError:
    return AuthenticityError(message, reason=Reason.SIGNATURE_INVALID, where=where)


def make_answer(
    chains: tuple[tuple[bytes, bytes], ...],
    roots: tuple[x509.Certificate, ...],
    authorities: dict[str, bytes],
    lists: dict[str, bytes],
) -> bytes:
    """Return the answer's bytes.

    Args:
        chains: leaf and authority of each key, DER.
        roots: the root certificates.
        authorities: the role authorities' certificates by name, DER.
        lists: the signed revocation lists by their authority's name.
    """
    answer = CertificateAnswer(
        format="authguard-r/key-answer/1",
        chains=tuple((b64(leaf), b64(authority)) for leaf, authority in chains),
        roots=tuple(b64(root.public_bytes(Encoding.DER)) for root in roots),
        authorities={name: b64(der) for name, der in authorities.items()},
        lists={name: data.decode("ascii") for name, data in lists.items()},
    )
    return encode_fast(answer) + b"\n"
