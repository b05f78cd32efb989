# SPDX-License-Identifier: Apache-2.0
"""Whether a keystore lets the gate's process alone move the robot: every enclave in it is read.

It need not be one that we made: what counts is what its signed documents let through. What cannot
be read, or is not understood, is a fault. Spec page: docs/spec/ros-map.md#check
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from enum import StrEnum
from functools import partial
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import serialization
from cryptography.x509.oid import NameOID
from msgspec import Struct

from authguard_r.core.errors import AuthGuardError, EnvironmentFault, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.integrations.ros.documents import Opened, governance_faults, read_permissions
from authguard_r.integrations.ros.keystore import (
    CERTIFICATE,
    ENCLAVES,
    GOVERNANCE_P7S,
    IDENTITY,
    KEY,
    PERMISSIONS,
    PERMISSIONS_P7S,
    PUBLIC,
    robots_of,
)
from authguard_r.integrations.ros.map import RosMap
from authguard_r.integrations.ros.rights import RightKind, Rights, actuating, rights_of, telling
from authguard_r.integrations.ros.signed import open_text
from authguard_r.keys.loading import load_pem


class KeystoreCode(StrEnum):
    """What is wrong with a keystore."""

    MISSING = "ENCLAVE_MISSING"
    UNREADABLE = "UNREADABLE"
    FORGED = "SIGNATURE_INVALID"
    OPEN = "GOVERNANCE_OPEN"
    ACTUATES = "MAY_ACTUATE"
    FALSIFIES = "MAY_FALSIFY"
    LACKS = "RIGHT_MISSING"
    WIDER = "RIGHT_BEYOND_MAP"
    SHARED = "KEY_SHARED"
    EXPOSED = "KEY_EXPOSED"
    FOREIGN = "CERTIFICATE_FOREIGN"
    EXPIRED = "EXPIRED"
    PLAIN = "SECURITY_NOT_ENFORCED"
    STRANGE = "ENCLAVE_BEYOND_MAP"


class KeystoreFault(Struct, frozen=True, kw_only=True):
    """One thing that is wrong.

    Args:
        code: what.
        where: the enclave, or a file.
        message: in words, with what was expected.
    """

    code: KeystoreCode
    where: str
    message: str


class _Authorities(Struct, frozen=True):
    """The two certificates that everything of a keystore is held against."""

    identity: x509.Certificate
    permissions: x509.Certificate


class _Enclave(Struct, frozen=True, kw_only=True):
    """An enclave as it lies there."""

    name: str
    home: Path
    certificate: x509.Certificate


def check_keystore(
    ros: RosMap, folder: Path, *, now: datetime | None = None
) -> tuple[KeystoreFault, ...]:
    """Return every fault of a keystore for a map; none means that the gate alone moves the robot.

    Args:
        ros: the map.
        folder: the keystore, as `ROS_SECURITY_KEYSTORE` names it; private keys need not be there.
        now: the time that certificates have to hold at.

    Raises:
        EnvironmentFault: there is no keystore.
        MalformedError: its authorities' certificates are not valid.
    """
    if not (folder / ENCLAVES).is_dir():
        raise EnvironmentFault(
            f"expected a keystore, got `{folder}`",
            reason=Reason.FILE_UNAVAILABLE,
            where=str(folder),
        )
    ca = _authorities(folder)
    moment = now or datetime.now(UTC)
    rights = rights_of(ros)
    found, seen = _homes(folder / ENCLAVES)
    homes = {"/" + home.relative_to(folder / ENCLAVES).as_posix(): home for home in seen}
    found += [
        KeystoreFault(
            code=KeystoreCode.MISSING, where=name, message="expected an enclave of the map"
        )
        for name in sorted(rights.keys() - homes.keys())
    ]
    public: list[_Enclave] = []
    for name, home in homes.items():
        try:
            enclave = _opened(name, home)
        except AuthGuardError as error:
            found.append(_unread(error, name))
            continue
        public.append(enclave)
        found += _enclave_faults(enclave, ca, ros, rights.get(name), moment)
    return (*found, *_shared(public))


def check_enclave(
    ros: RosMap, folder: Path, name: str, *, now: datetime | None = None
) -> tuple[KeystoreFault, ...]:
    """Return every fault of one enclave of a keystore: what a process looks at in its own.

    Args:
        ros: the map.
        folder: the keystore.
        name: the enclave.
        now: the time that certificates have to hold at.
    """
    home, moment = folder / ENCLAVES / name.removeprefix("/"), now or datetime.now(UTC)
    wanted = rights_of(ros).get(name)
    try:
        enclave, ca = _opened(name, home), _authorities(folder)
    except AuthGuardError as error:
        return (_unread(error, name),)
    return tuple(_enclave_faults(enclave, ca, ros, wanted, moment))


def _enclave_faults(
    enclave: _Enclave, ca: _Authorities, ros: RosMap, wanted: Rights | None, now: datetime
) -> list[KeystoreFault]:
    """Return what is wrong with each part, independent of the other parts."""
    found: list[KeystoreFault] = []
    for part in (
        _identity(enclave, ca, now),
        _named(enclave, ros),
        _governed(enclave, ca, ros),
        _permitted(enclave, ca, ros, wanted, now),
    ):
        try:
            found += list(part)
        except AuthGuardError as error:
            found.append(_unread(error, enclave.name))
    return found


def _opened(name: str, home: Path) -> _Enclave:
    return _Enclave(name=name, home=home, certificate=_certificate(home / CERTIFICATE))


def _authorities(folder: Path) -> _Authorities:
    names = (IDENTITY, PERMISSIONS)
    return _Authorities(*(_certificate(folder / PUBLIC / f"{name}.cert.pem") for name in names))


def _unread(error: AuthGuardError, name: str) -> KeystoreFault:
    is_forged = error.reason is Reason.SIGNATURE_INVALID
    code = KeystoreCode.FORGED if is_forged else KeystoreCode.UNREADABLE
    return KeystoreFault(code=code, where=error.where or name, message=error.message)


def _homes(root: Path) -> tuple[list[KeystoreFault], list[Path]]:
    """Return every folder that ROS could take for an enclave: any file of one is enough.

    What cannot be looked into is a fault, and so is a link: ROS follows it to wherever it leads.
    """
    faults: list[KeystoreFault] = []
    found: list[Path] = []

    def unlisted(error: OSError) -> None:
        message = f"cannot be looked into: {error.strerror}"
        faults.append(
            KeystoreFault(code=KeystoreCode.UNREADABLE, where=str(error.filename), message=message)
        )

    for name, folders, files in os.walk(root, onerror=unlisted):
        for link in (f"{name}/{one}" for one in folders):
            if os.path.islink(link):  # noqa: PTH114 - of what cannot be asked, it is no error
                message = "expected a folder, got a link"
                faults.append(
                    KeystoreFault(code=KeystoreCode.UNREADABLE, where=link, message=message)
                )
        if {CERTIFICATE, KEY, PERMISSIONS_P7S} & set(files):
            found.append(Path(name))
    return faults, sorted(found)


def _identity(enclave: _Enclave, ca: _Authorities, now: datetime) -> Iterator[KeystoreFault]:
    """Yield what is wrong with who an enclave says that it is."""
    certificate, where = enclave.certificate, enclave.name
    names = [item.value for item in certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)]
    if names != [enclave.name]:
        yield KeystoreFault(
            code=KeystoreCode.FOREIGN, where=where, message=f"expected CN={enclave.name}"
        )
    try:
        certificate.verify_directly_issued_by(ca.identity)
    except (ValueError, TypeError, InvalidSignature):
        text = "expected a certificate of the identity authority"
        yield KeystoreFault(code=KeystoreCode.FOREIGN, where=where, message=text)
    if not certificate.not_valid_before_utc <= now <= certificate.not_valid_after_utc:
        yield KeystoreFault(
            code=KeystoreCode.EXPIRED, where=where, message="its certificate is not valid now"
        )
    for name, wanted in ((IDENTITY, ca.identity), (PERMISSIONS, ca.permissions)):
        if _certificate(enclave.home / f"{name}.cert.pem") != wanted:
            text = f"`{name}.cert.pem` is another authority's than the keystore's"
            yield KeystoreFault(code=KeystoreCode.FOREIGN, where=where, message=text)
    key = enclave.home / KEY
    if key.exists():
        if stat.S_IMODE(key.stat().st_mode) & 0o077:
            text = f"others than its owner can read `{key}`: chmod 600"
            yield KeystoreFault(code=KeystoreCode.EXPOSED, where=where, message=text)
        if _public_of(key) != _public(certificate):
            text = "its key is not its certificate's"
            yield KeystoreFault(code=KeystoreCode.FOREIGN, where=where, message=text)


def _named(enclave: _Enclave, ros: RosMap) -> Iterator[KeystoreFault]:
    """Yield an enclave of another robot, and the gate's if nothing says whose it is.

    Robots of one hospital have enclaves of one name: a keystore in the wrong place looks right.
    """
    robots = robots_of(enclave.certificate, where=str(enclave.home / CERTIFICATE))
    if robots and ros.robot not in robots:
        text = f"its certificate is of {', '.join(sorted(robots))}, expected `{ros.robot}`"
        yield KeystoreFault(code=KeystoreCode.FOREIGN, where=enclave.name, message=text)
    is_gate = enclave.name == ros.enclaves.gate
    if is_gate and not robots and ros.robot not in enclave.name.split("/"):
        text = f"neither its certificate nor its name says that it is `{ros.robot}`'s"
        yield KeystoreFault(code=KeystoreCode.FOREIGN, where=enclave.name, message=text)


def _governed(enclave: _Enclave, ca: _Authorities, ros: RosMap) -> Iterator[KeystoreFault]:
    path = enclave.home / GOVERNANCE_P7S
    text = open_text(_read(path), ca.permissions, where=str(path))
    for message in governance_faults(text, domain=ros.domain, where=str(path)):
        yield KeystoreFault(code=KeystoreCode.OPEN, where=enclave.name, message=message)


def _permitted(
    enclave: _Enclave, ca: _Authorities, ros: RosMap, wanted: Rights | None, now: datetime
) -> Iterator[KeystoreFault]:
    """Yield what an enclave may do that it must not, and what it needs and may not do."""
    path = enclave.home / PERMISSIONS_P7S
    text = open_text(_read(path), ca.permissions, where=str(path))
    grants = read_permissions(text, domain=ros.domain, where=str(path))
    for grant in grants:
        if grant.subject.replace(" ", "") != f"CN={enclave.name}":
            message = f"its permissions are for `{grant.subject}`"
            yield KeystoreFault(code=KeystoreCode.FOREIGN, where=enclave.name, message=message)
        if grant.until < now:
            yield KeystoreFault(
                code=KeystoreCode.EXPIRED, where=enclave.name, message="its permissions have ended"
            )
    moving = partial(_writing, KeystoreCode.ACTUATES, "moves the robot", actuating(ros))
    falsifying = partial(
        _writing, KeystoreCode.FALSIFIES, "says how the robot stands", telling(ros)
    )
    yield from moving(enclave.name, grants)
    yield from falsifying(enclave.name, grants)
    if wanted is None:
        message = "expected no enclave but the map's: the map does not name this one"
        yield KeystoreFault(code=KeystoreCode.STRANGE, where=enclave.name, message=message)
    else:
        yield from _differing(enclave.name, grants, wanted)


def _writing(
    code: KeystoreCode,
    does: str,
    topics: Mapping[str, frozenset[str]],
    name: str,
    grants: tuple[Opened, ...],
) -> Iterator[KeystoreFault]:
    """Yield topics that an enclave may write and must not."""
    for topic, allowed in sorted(topics.items()):
        if name not in allowed and any(grant.may(RightKind.WRITE, topic) for grant in grants):
            who = ", ".join(sorted(allowed)) or "no process"
            message = f"it may write `{topic}`, which {does}; expected {who} alone"
            yield KeystoreFault(code=code, where=name, message=message)


def _differing(name: str, grants: tuple[Opened, ...], wanted: Rights) -> Iterator[KeystoreFault]:
    for way in RightKind:
        for topic in sorted(wanted.of(way)):
            if not any(grant.may(way, topic) for grant in grants):
                message = f"it may not {way} `{topic}`, which the map has it do"
                yield KeystoreFault(code=KeystoreCode.LACKS, where=name, message=message)
        named = {
            topic
            for grant in grants
            for topic in (grant.publish if way is RightKind.WRITE else grant.subscribe)
        }
        for topic in sorted(named - wanted.of(way)):
            message = f"it may {way} `{topic}`, which the map does not have it do"
            yield KeystoreFault(code=KeystoreCode.WIDER, where=name, message=message)


def _shared(enclaves: list[_Enclave]) -> Iterator[KeystoreFault]:
    """Yield enclaves with one key: one of them is the other."""
    keys: dict[bytes, str] = {}
    for enclave in enclaves:
        public = _public(enclave.certificate)
        if public in keys:
            message = f"it has the key of `{keys[public]}`"
            yield KeystoreFault(code=KeystoreCode.SHARED, where=enclave.name, message=message)
        keys.setdefault(public, enclave.name)


def _certificate(path: Path) -> x509.Certificate:
    found = load_pem(_read(path), where=str(path))[0]
    try:
        _public(found)
    except (ValueError, UnsupportedAlgorithm) as error:
        raise MalformedError("expected a key of a known algorithm", where=str(path)) from error
    return found


def _public(certificate: x509.Certificate) -> bytes:
    return certificate.public_key().public_bytes(
        serialization.Encoding.DER, serialization.PublicFormat.SubjectPublicKeyInfo
    )


def _public_of(path: Path) -> bytes:
    """Return the public half of a private key's file."""
    try:
        key = serialization.load_pem_private_key(_read(path), password=None)
    except (ValueError, TypeError, UnsupportedAlgorithm) as error:
        raise MalformedError("expected a private key in the clear", where=str(path)) from error
    return key.public_key().public_bytes(
        serialization.Encoding.DER, serialization.PublicFormat.SubjectPublicKeyInfo
    )


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise EnvironmentFault(
            f"cannot read `{path}`: {error.strerror}",
            reason=Reason.FILE_UNAVAILABLE,
            where=str(path),
        ) from error
