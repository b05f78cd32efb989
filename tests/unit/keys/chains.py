# SPDX-License-Identifier: Apache-2.0
"""Certificates of every shape, good and bad, made with `cryptography` alone.

The product's builders make good chains only. Here each knob of the profile can be turned by
itself, so that a test changes one thing. The object identifiers are written out once more: they
are on the wire, and a renumbering must break a test.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from functools import cache
from typing import Any

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.asymmetric.mldsa import (
    MLDSA44PrivateKey,
    MLDSA65PrivateKey,
    MLDSA87PrivateKey,
)
from cryptography.hazmat.primitives.asymmetric.types import CertificatePublicKeyTypes
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import NameOID, ObjectIdentifier

from authguard_r.core.quantities import Now
from authguard_r.keys.algorithms import Algorithm, PrivateKey
from authguard_r.keys.certificate import Role
from authguard_r.keys.revocation import RevocationList
from authguard_r.keys.signer import FileSigner
from authguard_r.keys.trust import Trust

ARC = "2.25.249240886789462354738743776298903117701"
OIDS = {
    Role.OPERATOR: ObjectIdentifier(f"{ARC}.1"),
    Role.SUPERVISOR: ObjectIdentifier(f"{ARC}.2"),
    Role.SAFETY_OFFICER: ObjectIdentifier(f"{ARC}.3"),
    Role.SITE_AUTHORITY: ObjectIdentifier(f"{ARC}.4"),
    Role.GATE: ObjectIdentifier(f"{ARC}.5"),
    Role.ESTIMATOR: ObjectIdentifier(f"{ARC}.6"),
    Role.WITNESS: ObjectIdentifier(f"{ARC}.7"),
    Role.SCHEDULER: ObjectIdentifier(f"{ARC}.8"),
}
EVERYWHERE = ("urn:authguard-r:every-robot", "urn:authguard-r:every-region")
PRINCIPAL = "urn:authguard-r:principal:"
TODAY = datetime(2030, 6, 15, 12, 0, 0, tzinfo=UTC)
NOW = Now(int(TODAY.timestamp()) * 1000, 10_000)
DAY_MS = 86_400_000
PEOPLE = (Role.OPERATOR, Role.SUPERVISOR, Role.SAFETY_OFFICER)

ROOT_BASIC = x509.BasicConstraints(ca=True, path_length=1)
AUTHORITY_BASIC = x509.BasicConstraints(ca=True, path_length=0)
LEAF_BASIC = x509.BasicConstraints(ca=False, path_length=None)

Extra = tuple[x509.ExtensionType, bool]


@dataclass(frozen=True)
class Held:
    """A certificate with the private key that it names."""

    key: PrivateKey
    certificate: x509.Certificate

    @property
    def der(self) -> bytes:
        return self.certificate.public_bytes(Encoding.DER)


@cache
def key(name: str) -> Ed25519PrivateKey:
    """One key for each name, the same all through a run."""
    return Ed25519PrivateKey.from_private_bytes(name.encode().ljust(32, b".")[:32])


_SEEDED = {
    Algorithm.ML_DSA_44: MLDSA44PrivateKey,
    Algorithm.ML_DSA_65: MLDSA65PrivateKey,
    Algorithm.ML_DSA_87: MLDSA87PrivateKey,
}


@cache
def key_of(algorithm: Algorithm, name: str) -> PrivateKey:
    """One key for each algorithm and name, the same all through a run."""
    if algorithm is Algorithm.ED25519:
        return key(name)
    return _SEEDED[algorithm].from_seed_bytes(name.encode().ljust(32, b".")[:32])


def usage(*, signs: bool, certifies: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=signs,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=certifies,
        crl_sign=certifies,
        encipher_only=False,
        decipher_only=False,
    )


def eku(*roles: Role) -> x509.ExtendedKeyUsage:
    return x509.ExtendedKeyUsage([OIDS[role] for role in roles])


SIGNS: Extra = (usage(signs=True, certifies=False), True)
CERTIFIES: Extra = (usage(signs=False, certifies=True), True)
OPERATES: Extra = (eku(Role.OPERATOR), True)


def san(*uris: str) -> x509.SubjectAlternativeName:
    return x509.SubjectAlternativeName([x509.UniformResourceIdentifier(uri) for uri in uris])


def name(common: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def certify(
    public: CertificatePublicKeyTypes,
    *,
    subject: str,
    issuer: str,
    by: PrivateKey,
    start: datetime = TODAY - timedelta(days=1),
    end: datetime = TODAY + timedelta(days=30),
    serial: int | None = None,
    extensions: tuple[Extra | None, ...] = (),
) -> x509.Certificate:
    """Return a certificate with exactly these extensions; `None` among them is left out."""
    builder = (
        x509.CertificateBuilder()
        .subject_name(name(subject))
        .issuer_name(name(issuer))
        .public_key(public)
        .serial_number(serial or x509.random_serial_number())
        .not_valid_before(start)
        .not_valid_after(end)
    )
    for extra in extensions:
        if extra is not None:
            builder = builder.add_extension(extra[0], critical=extra[1])
    return builder.sign(by, None)


def key_ids(public: CertificatePublicKeyTypes, issuer: PrivateKey) -> tuple[Extra, Extra]:
    """Subject and authority key identifiers, which RFC 5280 wants and the profile ignores."""
    return (
        (x509.SubjectKeyIdentifier.from_public_key(public), False),
        (x509.AuthorityKeyIdentifier.from_issuer_public_key(issuer.public_key()), False),
    )


def root(
    subject: str = "Test root",
    *,
    own: PrivateKey | None = None,
    start: datetime = TODAY - timedelta(days=1),
    end: datetime = TODAY + timedelta(days=30),
) -> Held:
    held = own or key(subject)
    ids = key_ids(held.public_key(), held)
    extensions = ((ROOT_BASIC, True), (usage(signs=False, certifies=True), True), *ids)
    certificate = certify(
        held.public_key(),
        subject=subject,
        issuer=subject,
        by=held,
        start=start,
        end=end,
        extensions=extensions,
    )
    return Held(held, certificate)


def authority(
    issuer: Held,
    roles: tuple[Role, ...] = PEOPLE,
    *,
    subject: str = "People authority",
    by: PrivateKey | None = None,
    own: PrivateKey | None = None,
    public: CertificatePublicKeyTypes | None = None,
    start: datetime = TODAY - timedelta(days=1),
    end: datetime = TODAY + timedelta(days=30),
    serial: int | None = None,
    basic: Extra | None = (AUTHORITY_BASIC, True),
    use: Extra | None = CERTIFIES,
    role: Extra | None = None,
    extra: tuple[Extra, ...] = (),
    issuer_name: str | None = None,
) -> Held:
    """A role authority; every argument is one knob, and its default is the good setting."""
    held = own or key(subject)
    public = public or held.public_key()
    signer = by or issuer.key
    certificate = certify(
        public,
        subject=subject,
        issuer=issuer_name or common_name(issuer.certificate.subject),
        by=signer,
        start=start,
        end=end,
        serial=serial,
        extensions=(
            basic,
            use,
            role or (eku(*roles), True),
            *key_ids(public, signer),
            *extra,
        ),
    )
    return Held(held, certificate)


def leaf(
    issuer: Held,
    principal: str = "operator-1",
    *,
    by: PrivateKey | None = None,
    own: PrivateKey | None = None,
    public: CertificatePublicKeyTypes | None = None,
    start: datetime = TODAY - timedelta(days=1),
    end: datetime = TODAY + timedelta(days=30),
    serial: int | None = None,
    basic: Extra | None = (LEAF_BASIC, True),
    use: Extra | None = SIGNS,
    role: Extra | None = OPERATES,
    names: Extra | str | None = "",
    extra: tuple[Extra, ...] = (),
    issuer_name: str | None = None,
) -> Held:
    """A leaf; every argument is one knob, and its default is the good setting."""
    held = own or key(f"leaf {principal}")
    public = public or held.public_key()
    signer = by or issuer.key
    uris = (san(PRINCIPAL + principal, *EVERYWHERE), False) if isinstance(names, str) else names
    certificate = certify(
        public,
        subject=principal or "nobody",
        issuer=issuer_name or common_name(issuer.certificate.subject),
        by=signer,
        start=start,
        end=end,
        serial=serial,
        extensions=(basic, use, role, uris, *key_ids(public, signer), *extra),
    )
    return Held(held, certificate)


def common_name(subject: x509.Name) -> str:
    return str(subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value)


@dataclass(frozen=True)
class TrustSetup:
    """One trust set-up in memory: root, an authority for people, and current lists."""

    root: Held
    people: Held

    def trust(self, *, revoked: dict[bytes, frozenset[int]] | None = None, days: int = 30) -> Trust:
        """Return the trust root, with serials revoked by the DER of the authority."""
        dead = revoked or {}
        until = NOW.utc_ms + days * DAY_MS
        lists = {
            der: RevocationList(number=1, next_update_ms=until, serials=dead.get(der, frozenset()))
            for der in (self.root.der, self.people.der)
        }
        return Trust((self.root.certificate,), lists)

    def signer(self, held: Held) -> FileSigner:
        return FileSigner(held.key, (held.der, self.people.der))

    def chain(self, held: Held) -> tuple[bytes, bytes]:
        return (held.der, self.people.der)


@cache
def house() -> TrustSetup:
    """The one good set-up; tests make variations of it."""
    top = root()
    return TrustSetup(top, authority(top))


@cache
def house_of(algorithm: Algorithm) -> TrustSetup:
    """A good set-up of one algorithm all the way down; its root has a name of its own."""
    top = root(f"Root {algorithm}", own=key_of(algorithm, "root"))
    return TrustSetup(top, authority(top, own=key_of(algorithm, "people")))


def leaf_of(algorithm: Algorithm, principal: str = "operator-1", **knobs: Any) -> Held:
    """A leaf under `house_of`, with a key of the same algorithm."""
    own = key_of(algorithm, f"leaf {principal}")
    return leaf(house_of(algorithm).people, principal, **{"own": own, **knobs})


# -- DER, for what no library agrees to write ------------------------------------------------------


def tlv(tag: int, body: bytes) -> bytes:
    length = len(body)
    if length < 0x80:
        return bytes([tag, length]) + body
    size = (length.bit_length() + 7) // 8
    return bytes([tag, 0x80 | size]) + length.to_bytes(size, "big") + body


def resigned(der: bytes, old: bytes, new: bytes, *, by: Ed25519PrivateKey) -> bytes:
    """Return the certificate with the only `old` in its signed part replaced, signed again."""
    tbs = x509.load_der_x509_certificate(der).tbs_certificate_bytes
    assert tbs.count(old) == 1
    assert len(old) == len(new)
    changed = tbs.replace(old, new)
    algorithm = bytes.fromhex("300506032b6570")
    return tlv(0x30, changed + algorithm + tlv(0x03, b"\0" + by.sign(changed)))
