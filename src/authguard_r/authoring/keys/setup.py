# SPDX-License-Identifier: Apache-2.0
"""A working trust set-up in one folder, for trying things out.

Its root says `demo`, because one folder that holds every private key protects nothing: anyone who
can read it can act as every role. A gate outside demo mode refuses such a root. How-to:
docs/howto/keys.md
"""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    load_pem_private_key,
)
from msgspec import Struct

from authguard_r.core.errors import AuthenticityError, EnvironmentFault
from authguard_r.core.identifiers import RobotId, is_identifier
from authguard_r.core.quantities import to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.keys.algorithms import (
    Algorithm,
    PrivateKey,
    algorithm_of,
    generate,
    require_private,
)
from authguard_r.keys.certificate import Role, build_authority, build_leaf, build_root
from authguard_r.keys.envelope import is_sealed
from authguard_r.keys.files import write_keys, write_whole
from authguard_r.keys.loading import load_pem
from authguard_r.keys.revocation import Revocation, sign_list
from authguard_r.keys.signer import Passphrase, gate_name, open_key_file
from authguard_r.site.model import Site, profile_digest

#: What distinguishes the files of the second root, and of everything under it.
SUFFIXES = ("", "-2")
#: What the root of a set-up for trying things out is called.
DEMO = "AuthGuard-R demo root"
AUTHORITIES: dict[str, tuple[Role, ...]] = {
    # a scheduler picks among missions that an operator signed: who names operators names it
    "people": (Role.OPERATOR, Role.SUPERVISOR, Role.SAFETY_OFFICER, Role.SCHEDULER),
    "site": (Role.SITE_AUTHORITY,),
    "machines": (Role.GATE, Role.ESTIMATOR, Role.WITNESS),
}


class Member(Struct, frozen=True, kw_only=True):
    """One principal of a set-up.

    Args:
        id: its name.
        role: what it may sign.
        robots: those that it may sign for, a machine's own among them; None for every robot.
        regions: where; None for every region.
        profile: for a gate, the digest of its robot's capability profile.
        template: for a scheduler, the digest of its template.
    """

    id: str
    role: Role
    robots: tuple[str, ...] | None = ()
    regions: tuple[str, ...] | None = ()
    profile: str | None = None
    template: str | None = None


class Issued(Struct, frozen=True):
    """A certificate authority while a set-up is made."""

    key: PrivateKey
    certificate: x509.Certificate


#: Authorities by name, one such table for each algorithm that has to sign.
Authorities = dict[str, Issued]


def init_folder(
    folder: Path,
    members: tuple[Member, ...],
    *,
    now: datetime,
    days: int = 365,
    algorithms: tuple[Algorithm, ...] = (Algorithm.ED25519,),
    title: str = DEMO,
    authorities: tuple[str, ...] = tuple(AUTHORITIES),
) -> None:
    """Write roots, role authorities, revocation lists and every member's keys and certificates.

    Args:
        folder: must not exist or be empty.
        members: who gets a key.
        now: start of validity; a day earlier is written, so that a clock a little behind works.
        days: how long everything is valid.
        algorithms: one, or two that both have to sign everything (`hybrid`).
        title: the root's name; one that says `demo` is for demonstration only.
        authorities: which of them to certify.

    Raises:
        EnvironmentFault: the folder holds something already; nothing was written.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise EnvironmentFault(
            f"expected an empty folder, got `{folder}`",
            reason=Reason.FILE_UNAVAILABLE,
            where=str(folder),
        )
    _require_names(members, folder)
    for name in ("authorities", "keys", "revocations"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    (folder / "keys").chmod(0o700)
    lines: list[Authorities] = []
    roots = b""
    for suffix, algorithm in zip(SUFFIXES, algorithms, strict=False):
        root = _root(folder, suffix, algorithm, title=title, now=now, days=days)
        roots += root.certificate.public_bytes(Encoding.PEM)
        lines.append(
            {
                name: _authority(
                    folder, name + suffix, AUTHORITIES[name], root=root, now=now, days=days
                )
                for name in authorities
            }
        )
    (folder / "root.pem").write_bytes(roots)
    for member in members:
        issue_member(folder, member, lines, now=now - timedelta(days=1), days=days)


def _root(
    folder: Path, suffix: str, algorithm: Algorithm, *, title: str, now: datetime, days: int
) -> Issued:
    key = generate(algorithm)
    name = f"{title}{suffix and f' {algorithm}'}"
    root = build_root(key, name=name, now=now - timedelta(days=1), days=days)
    write_keys(folder / "keys" / f"root{suffix}.key.pem", key)
    write_revocations(folder, f"root{suffix}", key, serials=(), now=now, number=1, days=days - 1)
    return Issued(key, root)


def _require_names(members: tuple[Member, ...], folder: Path) -> None:
    """Refuse names that are no identifiers, come twice, or are an authority's, before writing."""
    names = [member.id for member in members]
    reserved = {name + suffix for name in ("root", *AUTHORITIES) for suffix in SUFFIXES}
    if not all(map(is_identifier, names)) or len({*names, *reserved}) != len(names) + len(reserved):
        raise EnvironmentFault(
            "expected distinct identifiers that no authority has",
            reason=Reason.SCHEMA_INVALID,
            where=str(folder),
        )


def issue_member(
    folder: Path, member: Member, lines: list[Authorities], *, now: datetime, days: int
) -> None:
    """Write one member's keys and certificate chains, one of each algorithm."""
    keys: list[PrivateKey] = []
    chains = b""
    for authorities in lines:
        issuer = authorities[authority_of(member.role)]
        keys.append(generate(algorithm_of(issuer.key)))
        leaf = build_leaf(
            keys[-1].public_key(),
            principal=member.id,
            role=member.role,
            issuer=issuer.certificate,
            key=issuer.key,
            now=now,
            days=days,
            robots=member.robots,
            regions=member.regions,
            profile=member.profile,
            template=member.template,
        )
        chains += leaf.public_bytes(Encoding.PEM)
        chains += issuer.certificate.public_bytes(Encoding.PEM)
    (folder / "keys" / f"{member.id}.cert.pem").write_bytes(chains)
    write_keys(folder / "keys" / f"{member.id}.key.pem", *keys)


def authority_of(role: Role) -> str:
    """Return the name of the authority that gives a role."""
    return next(name for name, roles in AUTHORITIES.items() if role in roles)


def add_member(folder: Path, member: Member, *, now: datetime, days: int) -> None:
    """Write one more member's key and chain into a set-up that holds its authorities' keys.

    Args:
        folder: as `init_folder` wrote it.
        member: a name that the folder does not have.
        now: start of validity.
        days: how long the certificate is valid; its authority's end comes first.

    Raises:
        EnvironmentFault: the name is no new identifier, or the authority's key is not here;
            nothing was written.
        AuthenticityError: the authority's key is of no known algorithm; nothing was written.
    """
    name = authority_of(member.role)
    reserved = {held + suffix for held in ("root", *AUTHORITIES) for suffix in SUFFIXES}
    taken = reserved | {p.name.split(".")[0] for p in folder.glob("keys/*.pem")}
    if member.id in taken or not is_identifier(member.id) or "." in member.id:
        raise EnvironmentFault(
            f"expected a new identifier without a dot, got `{member.id}`",
            reason=Reason.SCHEMA_INVALID,
            where=str(folder),
        )
    here = [s for s in SUFFIXES if not s or (folder / "authorities" / f"{name}{s}.pem").exists()]
    lines = [{name: read_authority(folder, name + suffix)} for suffix in here]
    issue_member(folder, member, lines, now=now, days=days)


def read_authority(folder: Path, name: str, passphrase: Passphrase | None = None) -> Issued:
    """Return an authority's key and certificate from a set-up that holds both.

    Raises:
        EnvironmentFault: one of them is not here, or cannot be read.
        AuthenticityError: its key is sealed and does not open, or is of no known algorithm.
    """
    key = read_key(folder, name, passphrase)
    try:
        pem = (folder / "authorities" / f"{name}.pem").read_bytes()
        return Issued(key, load_pem(pem, where=name)[0])
    except (OSError, AuthenticityError) as error:
        raise _without(folder, name) from error


def read_key(folder: Path, name: str, passphrase: Passphrase | None = None) -> PrivateKey:
    """Return an authority's or a root's private key from a set-up that holds it.

    Args:
        folder: the set-up.
        name: whose key.
        passphrase: asked once, and only for a sealed key; None when no person can be asked.

    Raises:
        EnvironmentFault: it is not here, or cannot be read.
        MalformedError: it is sealed and damaged.
        AuthenticityError: it is sealed and there is no passphrase, or a wrong one; or it is of no
            known algorithm.
    """
    path = _key_path(folder, name)
    try:
        data = path.read_bytes()
        key = None if is_sealed(data) else load_pem_private_key(data, None)
    except (OSError, ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise _without(folder, name) from error
    if key is None:
        return open_key_file(path, passphrase)[0]
    return require_private(key, where=f"keys/{name}.key.pem")


def require_key_here(folder: Path, name: str) -> None:
    """Require that a set-up holds an authority's certificate and private key; nothing is opened.

    Raises:
        EnvironmentFault: one of them is not here.
    """
    for path in (_key_path(folder, name), folder / "authorities" / f"{name}.pem"):
        if not path.exists():
            raise _without(folder, name)


def _key_path(folder: Path, name: str) -> Path:
    return folder / "keys" / f"{name}.key.pem"


def _without(folder: Path, name: str) -> EnvironmentFault:
    return EnvironmentFault(
        f"`{folder}` has no usable key of the `{name}` authority",
        reason=Reason.FILE_UNAVAILABLE,
        where=str(folder),
    )


def write_revocations(
    folder: Path,
    authority: str,
    key: PrivateKey,
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
    write_whole(folder / "revocations" / f"{authority}.json", sign_list(revocation, key))


def _authority(
    folder: Path, name: str, roles: tuple[Role, ...], *, root: Issued, now: datetime, days: int
) -> Issued:
    key = generate(algorithm_of(root.key))
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
    write_keys(folder / "keys" / f"{name}.key.pem", key)
    write_revocations(folder, name, key, serials=(), now=now, number=1, days=days - 1)
    return Issued(key, certificate)


def demo_members(site: Site, rids: tuple[RobotId, ...]) -> tuple[Member, ...]:
    """Return who gets a key in a one-folder set-up: people, and the machines of each robot."""
    people = (
        Member(id="operator-1", role=Role.OPERATOR, robots=None, regions=None),
        Member(id="supervisor-1", role=Role.SUPERVISOR, robots=None, regions=None),
        Member(id="supervisor-2", role=Role.SUPERVISOR, robots=None, regions=None),
        Member(id="safety-officer-1", role=Role.SAFETY_OFFICER, robots=None, regions=None),
        Member(id="site-authority-1", role=Role.SITE_AUTHORITY),
        Member(id="witness-1", role=Role.WITNESS),
    )
    machines: list[Member] = []
    for rid in rids:
        profile = profile_digest(site.robots[rid].profile)
        machines += [
            Member(id=gate_name(rid), role=Role.GATE, robots=(rid,), profile=profile),
            Member(id=f"estimator-{rid}", role=Role.ESTIMATOR, robots=(rid,)),
        ]
    return (*people, *machines)
