# SPDX-License-Identifier: Apache-2.0
"""Keystores of ROS 2 for tests: the example's map, and what somebody with a key makes of it."""

from __future__ import annotations

from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

import yaml
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization

from authguard_r.ros.keystore import (
    CERTIFICATE,
    ENCLAVES,
    IDENTITY,
    PERMISSIONS,
    PRIVATE,
    PUBLIC,
    Authority,
    pem,
)
from authguard_r.ros.map import RosMap, parse_map
from authguard_r.ros.signed import sign_text
from worlds import ROOT

EXAMPLE = ROOT / "examples" / "ros" / "map.yaml"
NOW = datetime.now(UTC)


def plain_map() -> dict[str, Any]:
    """Return the example's map as plain data."""
    found: dict[str, Any] = yaml.safe_load(EXAMPLE.read_text())
    return found


def map_of(plain: dict[str, Any]) -> RosMap:
    """Return a map of plain data."""
    return parse_map(yaml.safe_dump(plain), where="map")


@cache
def example() -> RosMap:
    """Return the example's map."""
    return map_of(plain_map())


def permissions_authority(keystore: Path) -> Authority:
    """Return the authority that signs a keystore's documents."""
    return authority(keystore, PERMISSIONS)


def authority(keystore: Path, name: str) -> Authority:
    """Return an authority of a keystore."""
    key: Any = serialization.load_pem_private_key(
        (keystore / PRIVATE / f"{name}.key.pem").read_bytes(), None
    )
    certificate = (keystore / PUBLIC / f"{name}.cert.pem").read_bytes()
    return Authority(x509.load_pem_x509_certificate(certificate), key)


def certify(keystore: Path, enclave: str, *extensions: x509.ExtensionType) -> None:
    """Let the identity authority certify an enclave anew, with nothing but these extensions."""
    path, by = home(keystore, enclave) / CERTIFICATE, authority(keystore, IDENTITY)
    was = x509.load_pem_x509_certificate(path.read_bytes())
    made = (
        x509.CertificateBuilder()
        .subject_name(was.subject)
        .issuer_name(was.issuer)
        .public_key(was.public_key())
        .serial_number(was.serial_number)
        .not_valid_before(was.not_valid_before_utc)
        .not_valid_after(was.not_valid_after_utc)
    )
    for extension in extensions:
        made = made.add_extension(extension, critical=False)
    path.write_bytes(pem(made.sign(by.key, hashes.SHA256())))


def home(keystore: Path, enclave: str) -> Path:
    """Return an enclave's folder."""
    return keystore / ENCLAVES / enclave.removeprefix("/")


def resign(keystore: Path, enclave: str, document: str, change: dict[str, str]) -> None:
    """Let the permissions authority sign a changed document of an enclave."""
    folder, by = home(keystore, enclave), permissions_authority(keystore)
    text = (folder / f"{document}.xml").read_text()
    for old, new in change.items():
        assert old in text, old
        text = text.replace(old, new)
    signed = sign_text(text.encode(), by.certificate, by.key)
    (folder / f"{document}.p7s").write_bytes(signed)
