# SPDX-License-Identifier: Apache-2.0
"""A working trust set-up in one folder, for trying things out.

Its root says `demo`, because one folder that holds every private key protects nothing: whoever
reads it is everybody. A gate outside demo mode refuses such a root.
How-to: docs/howto/keys.md
"""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
)
from msgspec import Struct

from authguard_r.core.errors import EnvironmentFault
from authguard_r.core.identifiers import is_identifier
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.keys.certificate import Role, build_authority, build_leaf, build_root
from authguard_r.keys.revocation import Revocation, sign_list

AUTHORITIES: dict[str, tuple[Role, ...]] = {
    "people": (Role.OPERATOR, Role.SUPERVISOR, Role.SAFETY_OFFICER),
    "site": (Role.SITE_AUTHORITY,),
    "machines": (Role.GATE, Role.ESTIMATOR, Role.WITNESS),
}


class Member(Struct, frozen=True, kw_only=True):
    """One principal of a set-up; gates and estimators name their robot."""

    id: str
    role: Role
    robot: str | None = None
    profile: str | None = None


class Issued(Struct, frozen=True):
    """A certificate authority while a set-up is made."""

    key: Ed25519PrivateKey
    certificate: x509.Certificate


def init_folder(
    folder: Path, members: tuple[Member, ...], *, now: datetime, days: int = 365
) -> None:
    """Write root, role authorities, revocation lists and every member's key and certificate.

    Args:
        folder: must not exist or be empty.
        members: who gets a key.
        now: start of validity; a day earlier is written, so that a clock a little behind works.
        days: how long everything is valid.

    Raises:
        EnvironmentFault: the folder holds something already; nothing was written.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise EnvironmentFault(
            f"expected an empty folder, got `{folder}`",
            reason=Reason.STORE_UNAVAILABLE,
            where=str(folder),
        )
    _require_names(members, folder)
    start = now - timedelta(days=1)
    root_key = Ed25519PrivateKey.generate()
    root = build_root(root_key, name="AuthGuard-R demo root", now=start, days=days)
    for name in ("authorities", "keys", "revocations"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    (folder / "keys").chmod(0o700)
    (folder / "root.pem").write_bytes(root.public_bytes(Encoding.PEM))
    _write_key(folder / "keys" / "root.key.pem", root_key)
    write_revocations(folder, "root", root_key, serials=(), now=now, number=1, days=days - 1)
    authorities = {
        name: _authority(folder, name, roles, root=Issued(root_key, root), now=now, days=days)
        for name, roles in AUTHORITIES.items()
    }
    for member in members:
        issue_member(folder, member, authorities, now=start, days=days)


def _require_names(members: tuple[Member, ...], folder: Path) -> None:
    """Refuse names that are no identifiers, come twice, or are an authority's, before writing."""
    names = [member.id for member in members]
    reserved = {"root", *AUTHORITIES}
    if not all(map(is_identifier, names)) or len({*names, *reserved}) != len(names) + len(reserved):
        raise EnvironmentFault(
            "expected distinct identifiers that no authority has",
            reason=Reason.SCHEMA_INVALID,
            where=str(folder),
        )


def issue_member(
    folder: Path, member: Member, authorities: dict[str, Issued], *, now: datetime, days: int
) -> None:
    """Write one member's key and its certificate chain."""
    issuer = next(authorities[name] for name, roles in AUTHORITIES.items() if member.role in roles)
    key = Ed25519PrivateKey.generate()
    leaf = build_leaf(
        key.public_key(),
        principal=member.id,
        role=member.role,
        issuer=issuer.certificate,
        key=issuer.key,
        now=now,
        days=days,
        robot=member.robot,
        profile=member.profile,
    )
    chain = leaf.public_bytes(Encoding.PEM) + issuer.certificate.public_bytes(Encoding.PEM)
    (folder / "keys" / f"{member.id}.cert.pem").write_bytes(chain)
    _write_key(folder / "keys" / f"{member.id}.key.pem", key)


def write_revocations(
    folder: Path,
    authority: str,
    key: Ed25519PrivateKey,
    *,
    serials: tuple[int, ...],
    now: datetime,
    number: int,
    days: int,
) -> None:
    """Write an authority's signed revocation list, replacing the one before."""
    revocation = Revocation(
        authority=authority,
        number=number,
        issued=to_timestamp(int(now.timestamp()) * 1000),
        next_update=to_timestamp(int((now + timedelta(days=days)).timestamp()) * 1000),
        serials=tuple(sorted(str(serial) for serial in serials)),
    )
    (folder / "revocations" / f"{authority}.json").write_bytes(sign_list(revocation, key))


def _authority(
    folder: Path, name: str, roles: tuple[Role, ...], *, root: Issued, now: datetime, days: int
) -> Issued:
    key = Ed25519PrivateKey.generate()
    certificate = build_authority(
        key.public_key(),
        name=f"AuthGuard-R {name} authority",
        roles=roles,
        issuer=root.certificate,
        key=root.key,
        now=now - timedelta(days=1),
        days=days,
    )
    (folder / "authorities" / f"{name}.pem").write_bytes(certificate.public_bytes(Encoding.PEM))
    _write_key(folder / "keys" / f"{name}.key.pem", key)
    write_revocations(folder, name, key, serials=(), now=now, number=1, days=days - 1)
    return Issued(key, certificate)


def _write_key(path: Path, key: Ed25519PrivateKey) -> None:
    """Write the key readable by its owner alone, from the first byte on."""
    path.touch(mode=0o600, exist_ok=False)
    path.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
