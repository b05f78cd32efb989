# SPDX-License-Identifier: Apache-2.0
"""A whole robot as `deploy/` lays it out, with users by number: nothing is made on the machine."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

from authguard_r.access.gate_config import Peer, default_config
from authguard_r.authoring.keys.setup import AUTHORITIES, write_revocations
from authguard_r.core.encoding import Tag
from authguard_r.core.token import sign_object
from authguard_r.keys.certificate import Role, build_authority, build_leaf, build_root
from authguard_r.keys.signer import FileSigner
from authguard_r.safety import default_config as envelope
from authguard_r.site.model import profile_digest
from authguard_r.site.signed import sign_site
from authguard_r.wire.messages import ClientRole, Mode
from fixtures import scenarios


@dataclass(frozen=True)
class User:
    """Who a process is."""

    uid: int
    gid: int
    groups: tuple[int, ...]


CLIENTS, BODY = 72_001, 72_002
GATE = User(71_001, CLIENTS, (CLIENTS,))
ROBOT = User(71_002, BODY, (BODY, CLIENTS))
ESTIMATOR = User(71_003, BODY, (BODY, CLIENTS))
PLANNER = User(71_004, 71_004, (CLIENTS,))
OPERATOR = User(71_005, 71_005, (CLIENTS,))
#: In the group, and in no configuration.
STRANGER = User(71_006, 71_006, (CLIENTS,))
_ROLES = {
    ROBOT: ClientRole.CONTROLLER,
    ESTIMATOR: ClientRole.ESTIMATOR,
    PLANNER: ClientRole.PLANNER,
    OPERATOR: ClientRole.OPERATOR,
}


class Authorities:
    """A root that is no demonstration, and its role authorities."""

    def __init__(self, trust: Path) -> None:
        for name in ("authorities", "revocations"):
            (trust / name).mkdir(parents=True)
        self._start = datetime.now(UTC) - timedelta(days=1)
        self._issued: dict[str, tuple[Ed25519PrivateKey, x509.Certificate]] = {}
        key = Ed25519PrivateKey.generate()
        root = build_root(key, name="Hospital root", now=self._start, days=365)
        (trust / "root.pem").write_bytes(root.public_bytes(Encoding.PEM))
        self._revocations(trust, "root", key)
        for name, roles in AUTHORITIES.items():
            own = Ed25519PrivateKey.generate()
            made = build_authority(
                own.public_key(),
                name=name,
                roles=roles,
                issuer=root,
                key=key,
                now=self._start,
                days=365,
            )
            self._issued[name] = (own, made)
            (trust / "authorities" / f"{name}.pem").write_bytes(made.public_bytes(Encoding.PEM))
            self._revocations(trust, name, own)

    def _revocations(self, trust: Path, name: str, key: Ed25519PrivateKey) -> None:
        write_revocations(trust, name, key, serials=(), now=self._start, number=1, days=300)

    def issue(
        self, principal: str, role: Role, *, robot: str | None = None, profile: str | None = None
    ) -> tuple[Ed25519PrivateKey, bytes, FileSigner]:
        """Return a new key, its chain as PEM, and both as a signer."""
        name = next(name for name, roles in AUTHORITIES.items() if role in roles)
        own, authority = self._issued[name]
        key = Ed25519PrivateKey.generate()
        leaf = build_leaf(
            key.public_key(),
            principal=principal,
            role=role,
            issuer=authority,
            key=own,
            now=self._start,
            days=365,
            robots=None if robot is None else (robot,),
            regions=None,
            profile=profile,
        )
        chain = (leaf, authority)
        pem = b"".join(cert.public_bytes(Encoding.PEM) for cert in chain)
        ders = tuple(cert.public_bytes(Encoding.DER) for cert in chain)
        return key, pem, FileSigner(key, ders)


def lay_out(folder: Path) -> None:
    """Write /etc, /run and the store of the courier below a folder that root owns."""
    etc = folder / "etc"
    authorities = Authorities(etc / "trust")
    site, rid = scenarios.site(), scenarios.RID
    (_, _, site_authority) = authorities.issue("site-authority-1", Role.SITE_AUTHORITY)
    (_, _, officer) = authorities.issue("safety-officer-1", Role.SAFETY_OFFICER)
    (etc / "site.token").write_bytes(sign_site(site, site_authority))
    safety = envelope(site, rid)
    (etc / "safety.token").write_bytes(sign_object(safety, Tag.SAFETY, officer))
    peers = tuple(Peer(uid=user.uid, roles=(role,)) for user, role in _ROLES.items())
    config = default_config(rid, peers, Mode.ENFORCE)
    (etc / "gate.token").write_bytes(sign_object(config, Tag.GATE, site_authority))
    shutil.copy(scenarios.HOSPITAL / "binding.yaml", etc / "binding.yaml")
    for path in (folder, *etc.rglob("*"), etc):
        path.chmod(0o755 if path.is_dir() else 0o644)
    profile = profile_digest(site.robots[rid].profile)
    machines = (("gate", Role.GATE, GATE, profile), ("estimator", Role.ESTIMATOR, ESTIMATOR, None))
    for name, role, user, digest in machines:
        key, pem, _ = authorities.issue(f"{name}-{rid}", role, robot=rid, profile=digest)
        private = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
        own = _folder(etc / name, user, 0o700)
        (own / f"{name}.cert.pem").write_bytes(pem)
        (own / f"{name}.key.pem").write_bytes(private)
        for path in own.iterdir():
            os.chown(path, user.uid, user.gid)
            path.chmod(0o600)
    _folder(folder / "run", GATE, 0o750)
    _folder(folder / "store", GATE, 0o700)
    body = _folder(folder / "body", ROBOT, 0o750)
    for socket in ("gate.sock", "stop.sock"):
        (body / socket).symlink_to(folder / "run" / socket)


def _folder(path: Path, user: User, mode: int) -> Path:
    path.mkdir()
    os.chown(path, user.uid, user.gid)
    path.chmod(mode)
    return path
