# SPDX-License-Identifier: Apache-2.0
"""The certificate profile: root, role authority, leaf; never more, never fewer.

A leaf names one principal and one role. An authority names the roles that it may give. The role is
an object identifier in the extended key usage, the principal a URI in the alternative name; the
subject is for people. No path is built: there is one path, and it is walked. Spec page:
docs/spec/token.md#certificates
"""

from __future__ import annotations

import re
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from typing import Any, TypeVar

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.x509.oid import NameOID, ObjectIdentifier
from msgspec import Struct

from authguard_r.core.errors import AuthenticityError
from authguard_r.core.identifiers import Digest, PrincipalId, RegionId, RobotId, is_identifier
from authguard_r.core.principals import Scope
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.keys.algorithms import (
    PrivateKey,
    PublicKey,
    require_one_algorithm,
)
from authguard_r.keys.loading import key_of, load

N = TypeVar("N", PrincipalId, RobotId, RegionId)

#: An arc below 2.25 (a random UUID), which needs no registration.
_ARC = "2.25.249240886789462354738743776298903117701"
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_PRINCIPAL = "urn:authguard-r:principal:"
_ROBOT = "urn:authguard-r:robot:"
_REGION = "urn:authguard-r:region:"
#: Said in so many words: a certificate that names no robot is for none.
_EVERY_ROBOT = "urn:authguard-r:every-robot"
_EVERY_REGION = "urn:authguard-r:every-region"
_PROFILE = "urn:authguard-r:profile:"
_TEMPLATE = "urn:authguard-r:template:"
_THRESHOLD = "urn:authguard-r:threshold:"
_MEMBER = "urn:authguard-r:member:"


class Role(StrEnum):
    """What a certificate lets its holder sign."""

    OPERATOR = "operator"
    SUPERVISOR = "supervisor"
    SAFETY_OFFICER = "safety_officer"
    SITE_AUTHORITY = "site_authority"
    GATE = "gate"
    ESTIMATOR = "estimator"
    WITNESS = "witness"
    SCHEDULER = "scheduler"


_OID: dict[Role, ObjectIdentifier] = {
    role: ObjectIdentifier(f"{_ARC}.{number}") for number, role in enumerate(Role, 1)
}
_ROLE: dict[ObjectIdentifier, Role] = {oid: role for role, oid in _OID.items()}
_BASIC, _USAGE = x509.BasicConstraints.oid, x509.KeyUsage.oid
_EXTENDED_USAGE, _ALTERNATIVE_NAME = x509.ExtendedKeyUsage.oid, x509.SubjectAlternativeName.oid
_KNOWN_CRITICAL = frozenset({_BASIC, _USAGE, _EXTENDED_USAGE, _ALTERNATIVE_NAME})
#: The extensions of one certificate, read once; the library reads the value by the identifier.
_Extensions = dict[ObjectIdentifier, x509.Extension[Any]]


class Leaf(Struct, frozen=True, kw_only=True):
    """What a leaf certificate says, once its chain was walked.

    Args:
        principal: whose it is.
        role: what it may sign.
        scope: the robots and regions that it may sign for.
        profile: for a gate, the digest of that robot's capability profile.
        template: for a scheduler, the digest of the one mission template that it may fill.
        threshold: how many members have to act together to sign with a group's key; 1 for a person.
        members: the group's people; empty for a person.
        serial: its serial number, for revocation.
        authority_serial: its authority's serial number, for revocation.
        root: place of the root that its chain leads to, among those that were given.
        key: its public key, checked.
        not_after_ms: the end of the shorter-lived of leaf and authority.
    """

    principal: PrincipalId
    role: Role
    scope: Scope
    profile: Digest | None
    template: Digest | None
    threshold: int
    members: frozenset[PrincipalId]
    serial: int
    authority_serial: int
    root: int
    key: PublicKey
    not_after_ms: int

    @property
    def robot(self) -> RobotId | None:
        """The one robot that it names; None when it names none, several or every one."""
        robots = self.scope.robots or ()
        return next(iter(robots)) if len(robots) == 1 else None


class LeafClaims(Struct, frozen=True, kw_only=True):
    """What a leaf certificate claims; it is not verified, and it authorizes nothing.

    Args:
        principal: whose it says it is.
        role: what it says its holder may sign.
    """

    principal: PrincipalId
    role: Role


def build_root(key: PrivateKey, *, name: str, now: datetime, days: int) -> x509.Certificate:
    """Return the self-signed root; `name` is what people see (a demo root says so)."""
    builder = _base(_name(name), None, key.public_key(), now=now, days=days)
    builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=1), critical=True)
    return builder.add_extension(_usage(ca=True), critical=True).sign(key, None)


def build_authority(
    public: PublicKey,
    *,
    name: str,
    roles: tuple[Role, ...],
    issuer: x509.Certificate,
    key: PrivateKey,
    now: datetime,
    days: int,
) -> x509.Certificate:
    """Return a role authority that may issue leaves in `roles` and nothing else."""
    builder = _base(_name(name), issuer, public, now=now, days=days)
    builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    builder = builder.add_extension(_usage(ca=True), critical=True)
    usage = x509.ExtendedKeyUsage([_OID[role] for role in roles])
    return builder.add_extension(usage, critical=True).sign(key, None)


def build_leaf(
    public: PublicKey,
    *,
    principal: str,
    role: Role,
    issuer: x509.Certificate,
    key: PrivateKey,
    now: datetime,
    days: int,
    robots: tuple[str, ...] | None,
    regions: tuple[str, ...] | None,
    profile: str | None = None,
    template: str | None = None,
    threshold: int = 1,
    members: tuple[str, ...] = (),
) -> x509.Certificate:
    """Return a leaf that binds the key to one principal in one role.

    Args:
        public: the principal's key.
        principal: whose it is.
        role: what it may sign.
        issuer: its authority.
        key: the authority's.
        now: start of validity.
        days: how long it is valid; its authority's end comes first.
        robots: those that it may sign for; None for every robot.
        regions: where; None for every region.
        profile: for a gate, the digest of its robot's capability profile.
        template: for a scheduler, the digest of its template.
        threshold: for a group's key, how many members sign together.
        members: for a group's key, its people.
    """
    names = [_PRINCIPAL + principal]
    names += [_EVERY_ROBOT] if robots is None else [_ROBOT + robot for robot in robots]
    names += [_EVERY_REGION] if regions is None else [_REGION + region for region in regions]
    names += [_PROFILE + profile] if profile is not None else []
    names += [_TEMPLATE + template] if template is not None else []
    names += [f"{_THRESHOLD}{threshold}", *(_MEMBER + name for name in members)] if members else []
    builder = _base(_name(principal), issuer, public, now=now, days=days)
    builder = builder.add_extension(
        x509.BasicConstraints(ca=False, path_length=None), critical=True
    )
    builder = builder.add_extension(_usage(ca=False), critical=True)
    builder = builder.add_extension(x509.ExtendedKeyUsage([_OID[role]]), critical=True)
    uris = x509.SubjectAlternativeName([x509.UniformResourceIdentifier(n) for n in names])
    return builder.add_extension(uris, critical=False).sign(key, None)


def walk(
    leaf_der: bytes, authority_der: bytes, *, roots: tuple[x509.Certificate, ...], now: Now
) -> Leaf:
    """Return what the leaf says after walking root, authority, leaf.

    Which root, the authority's issuer says, and that root's signature shows. Revocation is the
    caller's (`trust`), for it needs lists.

    Raises:
        AuthenticityError: `CERTIFICATE_INVALID`, `CERTIFICATE_EXPIRED` or `KEY_INVALID`.
    """
    authority = load(authority_der, where="certificate.authority")
    leaf = load(leaf_der, where="certificate.leaf")
    moment = _EPOCH + timedelta(milliseconds=now.utc_ms)
    named = (n for n, root in enumerate(roots) if root.subject == authority.issuer)
    number = next(named, 0)  # of no root that is here: the first one did not sign it either
    root = roots[number]
    allowed = require_authority(authority, root, moment)
    _require_issued(leaf, authority, where="certificate.leaf")
    extensions = _require_profile(leaf, ca=False, path_length=None, where="certificate.leaf")
    _require_dates(leaf, moment, where="certificate.leaf")
    key = key_of(leaf, where="certificate.leaf")
    if len(roots) > 1:
        require_one_algorithm(key, authority.public_key(), root.public_key())
    roles = _roles(extensions, where="certificate.leaf")
    if len(roles) != 1 or not roles <= allowed:
        raise _bad("expected one role that its authority may give", "certificate.leaf")
    uris = _uris(extensions)
    profile = _optional(uris, _PROFILE)
    template, role = _optional(uris, _TEMPLATE), next(iter(roles))
    if template is not None and role is not Role.SCHEDULER:
        raise _bad("expected a template on a scheduler's certificate only", "certificate.leaf")
    members = _named(uris, _MEMBER, PrincipalId)
    end = min(leaf.not_valid_after_utc, authority.not_valid_after_utc, root.not_valid_after_utc)
    return Leaf(
        principal=PrincipalId(_only(uris, _PRINCIPAL)),
        role=role,
        scope=Scope(
            robots=_confined(uris, _EVERY_ROBOT, _named(uris, _ROBOT, RobotId)),
            regions=_confined(uris, _EVERY_REGION, _named(uris, _REGION, RegionId)),
        ),
        profile=None if profile is None else Digest(profile),
        template=None if template is None else Digest(template),
        threshold=_threshold(uris, members),
        members=members,
        serial=leaf.serial_number,
        authority_serial=authority.serial_number,
        root=number,
        key=key,
        not_after_ms=int(end.timestamp()) * 1000,
    )


def read_claims(leaf_der: bytes) -> LeafClaims:
    """Return what a leaf claims, without walking to any root: anyone can make such a leaf.

    Good for refusing early what every gate would refuse, never for accepting. Dates, authority,
    signature and revocation are not looked at.

    Raises:
        AuthenticityError: `CERTIFICATE_INVALID`: it claims no one principal in one role.
    """
    where = "certificate.leaf"
    extensions = _require_profile(
        load(leaf_der, where=where), ca=False, path_length=None, where=where
    )
    roles = _roles(extensions, where=where)
    if len(roles) != 1:
        raise _bad("expected one role", where)
    principal = PrincipalId(_only(_uris(extensions), _PRINCIPAL))
    return LeafClaims(principal=principal, role=next(iter(roles)))


def require_authority(
    authority: x509.Certificate, root: x509.Certificate, moment: datetime
) -> frozenset[Role]:
    """Return the roles that a role authority may give, once its root stands behind it.

    Raises:
        AuthenticityError: root or authority does not hold at that moment, or the root is another.
    """
    where = "certificate.authority"
    _require_issued(authority, root, where=where)
    extensions = _require_profile(authority, ca=True, path_length=0, where=where)
    _require_dates(root, moment, where="certificate.root")
    _require_dates(authority, moment, where=where)
    key_of(authority, where=where)
    return _roles(extensions, where=where)


def _require_issued(cert: x509.Certificate, issuer: x509.Certificate, *, where: str) -> None:
    try:
        cert.verify_directly_issued_by(issuer)
    except (ValueError, TypeError, InvalidSignature) as error:
        raise _bad("expected a certificate issued by the one above it", where) from error


def _require_profile(
    cert: x509.Certificate, *, ca: bool, path_length: int | None, where: str
) -> _Extensions:
    """Return what the extensions say, once they fit the certificate's place in the chain."""
    try:
        extensions = {e.oid: e for e in cert.extensions}
    except (ValueError, x509.DuplicateExtension, x509.UnsupportedGeneralNameType) as error:
        raise _bad("expected basic constraints and key usage", where) from error
    if any(e.critical and oid not in _KNOWN_CRITICAL for oid, e in extensions.items()):
        raise _bad("expected no critical extension that is unknown", where)
    basic, usage = extensions.get(_BASIC), extensions.get(_USAGE)
    if basic is None or usage is None:
        raise _bad("expected basic constraints and key usage", where)
    if basic.value.ca is not ca or basic.value.path_length != path_length:
        raise _bad("expected the basic constraints of its place in the chain", where)
    signs, certifies = usage.value.digital_signature, usage.value.key_cert_sign
    if (signs, certifies) != (not ca, ca):
        raise _bad("expected the key usage of its place in the chain", where)
    return extensions


def _require_dates(cert: x509.Certificate, moment: datetime, *, where: str) -> None:
    first, last = cert.not_valid_before_utc, cert.not_valid_after_utc
    if not first <= moment <= last:
        raise AuthenticityError(
            f"expected an instant from {first:%Y-%m-%dT%H:%M:%SZ} to {last:%Y-%m-%dT%H:%M:%SZ}",
            reason=Reason.CERTIFICATE_EXPIRED,
            where=where,
        )


def _roles(extensions: _Extensions, *, where: str) -> frozenset[Role]:
    usage = extensions.get(_EXTENDED_USAGE)
    if usage is None:
        raise _bad("expected an extended key usage that names roles", where)
    if not _ROLE.keys() >= set(usage.value):
        raise _bad("expected roles of this profile only", where)
    return frozenset([_ROLE[oid] for oid in usage.value])


def _uris(extensions: _Extensions) -> list[str]:
    names = extensions.get(_ALTERNATIVE_NAME)
    if names is None:
        raise _bad("expected an alternative name", "certificate.leaf")
    return list(names.value.get_values_for_type(x509.UniformResourceIdentifier))


def _only(uris: list[str], prefix: str) -> str:
    found = [uri.removeprefix(prefix) for uri in uris if uri.startswith(prefix)]
    if len(found) != 1 or not is_identifier(found[0]):
        raise _bad(f"expected one name `{prefix}...`", "certificate.leaf")
    return found[0]


def _optional(uris: list[str], prefix: str) -> str | None:
    found = [uri.removeprefix(prefix) for uri in uris if uri.startswith(prefix)]
    if len(found) > 1:
        raise _bad(f"expected at most one name `{prefix}...`", "certificate.leaf")
    return found[0] if found else None


def _named(uris: list[str], prefix: str, kind: Callable[[str], N]) -> frozenset[N]:
    """Return what is named one by one."""
    found = [uri.removeprefix(prefix) for uri in uris if uri.startswith(prefix)]
    if not all(map(is_identifier, found)):
        raise _bad(f"expected names `{prefix}...` that are identifiers", "certificate.leaf")
    return frozenset(map(kind, found))


def _confined(uris: list[str], every: str, named: frozenset[N]) -> frozenset[N] | None:
    """Return what is named, or None for all of them; both at once is nonsense."""
    if every not in uris:
        return named
    if named:
        raise _bad(f"expected `{every}` or names one by one, not both", "certificate.leaf")
    return None


def _threshold(uris: list[str], members: frozenset[PrincipalId]) -> int:
    """Return how many of a group sign together; a person is no group."""
    found = _optional(uris, _THRESHOLD)
    if found is None and not members:
        return 1
    if found is None or not re.fullmatch("[1-9][0-9]?", found) or int(found) > len(members):
        raise _bad("expected a group's members and how many of them sign", "certificate.leaf")
    return int(found)


def _name(common: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _usage(*, ca: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not ca,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=ca,
        crl_sign=ca,
        encipher_only=False,
        decipher_only=False,
    )


def _base(
    name: x509.Name, issuer: x509.Certificate | None, public: PublicKey, *, now: datetime, days: int
) -> x509.CertificateBuilder:
    """Return what every certificate says; none outlives the one above it."""
    start = now.astimezone(UTC).replace(microsecond=0)
    end = start + timedelta(days=days)
    return (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name if issuer is None else issuer.subject)
        .public_key(public)
        .serial_number(x509.random_serial_number())
        .not_valid_before(start)
        .not_valid_after(end if issuer is None else min(end, issuer.not_valid_after_utc))
    )


def _bad(message: str, where: str) -> AuthenticityError:
    return AuthenticityError(message, reason=Reason.CERTIFICATE_INVALID, where=where)
