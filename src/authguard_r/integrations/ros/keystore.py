# SPDX-License-Identifier: Apache-2.0
"""A keystore as ROS 2 reads it: two authorities, and for each process a key, and what it may do.

Every right is worked out from the map. One authority certifies identities and another one
permissions: a holder of one of their keys alone cannot do either. Spec page:
docs/spec/ros-map.md#keystore
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID
from msgspec import Struct

from authguard_r.core.errors import EnvironmentFault, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.integrations.ros.documents import governance, permissions
from authguard_r.integrations.ros.map import RosMap
from authguard_r.integrations.ros.rights import Rights, rights_of
from authguard_r.integrations.ros.signed import sign_text
from authguard_r.keys.files import write_whole

#: How long the authorities and the enclaves' certificates hold, in days.
AUTHORITY_DAYS, ENCLAVE_DAYS = 3_650, 365
#: Folders of a keystore.
PUBLIC, PRIVATE, ENCLAVES = "public", "private", "enclaves"
IDENTITY, PERMISSIONS = "identity_ca", "permissions_ca"
#: Files of an enclave.
CERTIFICATE, KEY = "cert.pem", "key.pem"
GOVERNANCE_P7S, PERMISSIONS_P7S = "governance.p7s", "permissions.p7s"
#: A certificate names the robots that its process is of, as the gate's own certificates do.
_ROBOT = "urn:authguard-r:robot:"
_DAY = timedelta(days=1)


class Authority(Struct, frozen=True):
    """A certificate and its key."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey


def make_keystore(ros: RosMap, folder: Path, *, now: datetime | None = None) -> tuple[str, ...]:
    """Write a keystore for a map, with new keys; return the enclaves that it has.

    Args:
        ros: the map.
        folder: new or empty.
        now: the time of issue.

    Raises:
        EnvironmentFault: something lies there, or it cannot be written.
    """
    if folder.exists() and any(folder.iterdir()):
        raise EnvironmentFault(
            "expected a new or empty folder", reason=Reason.FILE_UNAVAILABLE, where=str(folder)
        )
    issued = (now or datetime.now(UTC)).replace(microsecond=0)
    identity = authority("AuthGuard-R identity", issued)
    allowing = authority("AuthGuard-R permissions", issued)
    for name, made in ((IDENTITY, identity), (PERMISSIONS, allowing)):
        write_whole(_home(folder, PRIVATE) / f"{name}.key.pem", key_bytes(made.key), mode=0o600)
        write_whole(_home(folder, PUBLIC) / f"{name}.cert.pem", pem(made.certificate), mode=0o644)
    rights = rights_of(ros)
    _write_enclaves(folder, ros, rights, identity=identity, allowing=allowing, issued=issued)
    return tuple(sorted(rights))


def _write_enclaves(
    folder: Path,
    ros: RosMap,
    rights: Mapping[str, Rights],
    *,
    identity: Authority,
    allowing: Authority,
    issued: datetime,
) -> None:
    """Write what each enclave needs, and nothing of another's."""
    ruled = governance(ros.domain)
    signed = sign_text(ruled, allowing.certificate, allowing.key)
    for enclave, its in rights.items():
        home = _home(folder, ENCLAVES, enclave.removeprefix("/"))
        made = leaf(enclave, ros.robot, identity, issued)
        until = made.certificate.not_valid_after_utc
        may = permissions(enclave, its, domain=ros.domain, since=issued - _DAY, until=until)
        files = {
            CERTIFICATE: pem(made.certificate),
            f"{IDENTITY}.cert.pem": pem(identity.certificate),
            f"{PERMISSIONS}.cert.pem": pem(allowing.certificate),
            "governance.xml": ruled,
            GOVERNANCE_P7S: signed,
            "permissions.xml": may,
            PERMISSIONS_P7S: sign_text(may, allowing.certificate, allowing.key),
        }
        write_whole(home / KEY, key_bytes(made.key), mode=0o600)
        for name, data in files.items():
            write_whole(home / name, data, mode=0o644)


def _home(folder: Path, *names: str) -> Path:
    home = folder.joinpath(*names)
    try:
        home.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise EnvironmentFault(
            f"cannot make `{home}`: {error.strerror}",
            reason=Reason.FILE_UNAVAILABLE,
            where=str(home),
        ) from error
    return home


def authority(name: str, issued: datetime) -> Authority:
    """Return a new authority, which signs itself."""
    key = ec.generate_private_key(ec.SECP256R1())
    subject = _name(name)
    until = issued + AUTHORITY_DAYS * _DAY
    made = _builder(subject, key, issued, until).issuer_name(subject)
    made = made.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    made = made.add_extension(_usage(signs_certificates=True), critical=True)
    return Authority(made.sign(key, hashes.SHA256()), key)


def leaf(enclave: str, robot: str, identity: Authority, issued: datetime) -> Authority:
    """Return a new key of an enclave, whose name and robot its certificate bears."""
    key = ec.generate_private_key(ec.SECP256R1())
    until = issued + ENCLAVE_DAYS * _DAY
    made = _builder(_name(enclave), key, issued, until)
    made = made.issuer_name(identity.certificate.subject)
    made = made.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
    made = made.add_extension(_usage(signs_certificates=False), critical=True)
    # beside the subject, which DDS compares as a whole
    named = x509.SubjectAlternativeName([x509.UniformResourceIdentifier(_ROBOT + robot)])
    made = made.add_extension(named, critical=False)
    return Authority(made.sign(identity.key, hashes.SHA256()), key)


def robots_of(certificate: x509.Certificate, *, where: str) -> frozenset[str]:
    """Return the robots that a certificate of an enclave names; one of another maker may name none.

    Raises:
        MalformedError: its extensions cannot be read.
    """
    try:
        found = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName)
    except x509.ExtensionNotFound:
        return frozenset()
    except (ValueError, x509.DuplicateExtension, x509.UnsupportedGeneralNameType) as error:
        raise MalformedError("expected extensions of a certificate", where=where) from error
    names = found.value.get_values_for_type(x509.UniformResourceIdentifier)
    return frozenset(name.removeprefix(_ROBOT) for name in names if name.startswith(_ROBOT))


def pem(certificate: x509.Certificate) -> bytes:
    """Return a certificate as a file has it."""
    return certificate.public_bytes(serialization.Encoding.PEM)


def key_bytes(key: ec.EllipticCurvePrivateKey) -> bytes:
    """Return a private key as ROS reads it: in the clear, so the file's mode is all there is."""
    return key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )


def _builder(
    subject: x509.Name, key: ec.EllipticCurvePrivateKey, issued: datetime, until: datetime
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(issued - _DAY)  # clocks of a robot's computers differ
        .not_valid_after(until)
    )


def _name(common: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=True,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        encipher_only=False,
        decipher_only=False,
    )
