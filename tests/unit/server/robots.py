# SPDX-License-Identifier: Apache-2.0
"""A gate's folders as they should be on a robot: a root that is no demonstration, one key."""

from __future__ import annotations

import os
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from msgspec.structs import replace

from authguard_r.access.gate_config import GateConfig, Peer, default_config
from authguard_r.authoring.keys.setup import write_revocations
from authguard_r.keys.certificate import Role, build_authority, build_leaf, build_root
from authguard_r.operations.checkup import GateSetup
from authguard_r.site.model import profile_digest
from authguard_r.wire.messages import ClientRole, Mode
from fixtures import scenarios

#: Who runs the gate here: never root, whoever runs the tests.
ME = os.geteuid() or 54_321
NOW = scenarios.NOW
_BEGIN = datetime.fromtimestamp(scenarios.START_MS / 1000, UTC)
DAY = timedelta(days=1)


def mine(path: Path, mode: int) -> Path:
    """Return a path that is the gate's user's, with that mode."""
    if os.geteuid() == 0:
        os.chown(path, ME, ME)
    path.chmod(mode)
    return path


def peers() -> tuple[Peer, ...]:
    """Return four users, each with one role; none of them is the gate's."""
    roles = (ClientRole.PLANNER, ClientRole.CONTROLLER, ClientRole.ESTIMATOR, ClientRole.OPERATOR)
    return tuple(Peer(uid=70_001 + n, roles=(role,)) for n, role in enumerate(roles))


def config(**changes: Any) -> GateConfig:
    """Return a configuration of the courier, with one thing changed."""
    return replace(default_config(scenarios.RID, peers(), Mode.ENFORCE), **changes)


def write_key(path: Path, key: Ed25519PrivateKey) -> Path:
    data = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    path.write_bytes(data)
    return mine(path, 0o600)


def robot(
    tmp_path: Path, *, role: Role = Role.GATE, days: int = 365, list_days: int = 300, **leaf: Any
) -> GateSetup:
    """Return a safe gate of the courier: trust without keys, its own key apart, store, run."""
    trust, own = tmp_path / "trust", tmp_path / "gate"
    for folder in (trust, own, tmp_path / "store", tmp_path / "run"):
        folder.mkdir()
    for name in ("authorities", "revocations"):
        (trust / name).mkdir()
    start = _BEGIN - DAY
    root_key, key = Ed25519PrivateKey.generate(), Ed25519PrivateKey.generate()
    machines_key = Ed25519PrivateKey.generate()
    root = build_root(root_key, name="Hospital root", now=start, days=365)
    machines = build_authority(
        machines_key.public_key(),
        name="machines",
        roles=(Role.GATE, Role.ESTIMATOR),
        issuer=root,
        key=root_key,
        now=start,
        days=365,
    )
    profile = profile_digest(scenarios.site().robots[scenarios.RID].profile)
    cert = build_leaf(
        key.public_key(),
        principal="gate-courier-1",
        role=role,
        issuer=machines,
        key=machines_key,
        now=start,
        days=days,
        **{"robots": (scenarios.RID,), "regions": (), "profile": profile, **leaf},
    )
    (trust / "root.pem").write_bytes(root.public_bytes(Encoding.PEM))
    (trust / "authorities" / "machines.pem").write_bytes(machines.public_bytes(Encoding.PEM))
    for name, signer, left in (("root", root_key, 300), ("machines", machines_key, list_days)):
        write_revocations(trust, name, signer, serials=(), now=start, number=1, days=left)
    write_key(own / "gate.key.pem", key)
    chain = cert.public_bytes(Encoding.PEM) + machines.public_bytes(Encoding.PEM)
    (own / "gate.cert.pem").write_bytes(chain)
    for path in (trust, own, *trust.rglob("*"), own / "gate.cert.pem", tmp_path / "run"):
        mine(path, 0o755 if path.is_dir() else 0o644)
    mine(tmp_path / "store", 0o700)
    return GateSetup(
        demo=False,
        uid=ME,
        trust=trust,
        key=own / "gate.key.pem",
        chain=own / "gate.cert.pem",
        site=scenarios.site(),
        binding=scenarios.binding(),
        config=config(),
        store=tmp_path / "store" / "robot.db",
        run=tmp_path / "run",
    )
