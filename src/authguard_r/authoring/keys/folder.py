# SPDX-License-Identifier: Apache-2.0
"""The authority's folder: what lies in it, until when it counts, and one at a time changes it.

It holds the authorities' private keys, every certificate that they gave (`issued/`) and the lists.
Nothing else ever holds all of it. Spec page: docs/spec/token.md#trust-folder
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding
from msgspec import Struct

from authguard_r.core.errors import AuthenticityError, AuthGuardError, EnvironmentFault
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.keys.certificate import Leaf, walk
from authguard_r.keys.clock_floor import began_ms
from authguard_r.keys.trust import ROOT_LISTS, Trust, pairs, read_certificates, read_trust

#: Where the authority keeps every certificate that it gave.
ISSUED = "issued"


class IssuedCertificate(Struct, frozen=True, kw_only=True):
    """A certificate that an authority of the folder gave.

    Args:
        path: where it lies.
        leaf: what it says, and its own end or the earlier one of who gave it.
        authority: the name of the authority that gave it.
        revoked: it is on that authority's list.
    """

    path: Path
    leaf: Leaf
    authority: str
    revoked: bool


class Survey(Struct, frozen=True, kw_only=True):
    """What lies in the folder.

    Args:
        given: every certificate that was given, oldest file name first.
        unread: files in the folder that are not certificates, by path; to whom they were issued is
            unknown.
    """

    given: tuple[IssuedCertificate, ...]
    unread: dict[Path, AuthGuardError]


def survey(folder: Path) -> Survey:
    """Return every certificate that was given, and what could not be read.

    Raises:
        AuthGuardError: the folder is no set-up.
    """
    trust = read_trust(folder)
    names = {
        certificate.public_bytes(Encoding.DER): name
        for name, (certificate, _) in certified(folder).items()
    }
    found: list[IssuedCertificate] = []
    unread: dict[Path, AuthGuardError] = {}
    for kind in ("keys", ISSUED):
        for path in sorted(folder.glob(f"{kind}/*.cert.pem")):
            try:
                found += tuple(_given(path, trust, names))
            except AuthGuardError as error:
                unread[path] = error
    return Survey(given=tuple(found), unread=unread)


def given(folder: Path) -> tuple[IssuedCertificate, ...]:
    """Return every certificate that was given, oldest file name first.

    Raises:
        AuthGuardError: the folder is no set-up, or a file in it holds something else.
    """
    found = survey(folder)
    for path, error in found.unread.items():
        raise AuthenticityError(error.message, reason=error.reason, where=str(path)) from error
    return found.given


def _given(path: Path, trust: Trust, names: dict[bytes, str]) -> Iterator[IssuedCertificate]:
    for chain in pairs(read_certificates(path, most=4)):
        authority_der = chain[1].public_bytes(Encoding.DER)
        name = names.get(authority_der)
        if name is None:
            raise AuthenticityError(
                "expected a certificate of an authority that is here",
                reason=Reason.CERTIFICATE_INVALID,
                where=str(path),
            )
        leaf = as_given(chain, trust)
        revoked = leaf.serial in trust.lists[authority_der].serials
        yield IssuedCertificate(path=path, leaf=leaf, authority=name, revoked=revoked)


def as_given(chain: tuple[x509.Certificate, x509.Certificate], trust: Trust) -> Leaf:
    """Return what a certificate said when it was given, whether or not it still holds.

    Raises:
        AuthenticityError: it never held under these roots.
    """
    leaf, authority = (certificate.public_bytes(Encoding.DER) for certificate in chain)
    at = Now(began_ms((*chain, *trust.roots)), 0)
    return walk(leaf, authority, roots=trust.roots, now=at)


def certified(folder: Path) -> dict[str, tuple[x509.Certificate, str]]:
    """Return each authority's certificate and the list of the root that gave it, by its name."""
    roots = read_certificates(folder / "root.pem")
    found: dict[str, tuple[x509.Certificate, str]] = {}
    for path in sorted((folder / "authorities").glob("*.pem")):
        (certificate,) = read_certificates(path, most=1)
        named = (
            name
            for name, root in zip(ROOT_LISTS, roots, strict=False)
            if root.subject == certificate.issuer
        )
        found[path.stem] = certificate, next(named, ROOT_LISTS[0])
    return found


def require_lasting(folder: Path, names: Iterable[str], now: Now) -> None:
    """Require that what these sign counts for anything: they and their roots are not over.

    Raises:
        AuthenticityError: one is over, and everything that it gave with it.
    """
    roots = read_certificates(folder / "root.pem")
    ends = {name: root.not_valid_after_utc for name, root in zip(ROOT_LISTS, roots, strict=False)}
    for name, (certificate, root) in certified(folder).items():
        ends[name] = min(certificate.not_valid_after_utc, ends[root])
    for name in names:
        if now.utc_ms > ends[name].timestamp() * 1000:
            raise AuthenticityError(
                f"`{name}` is over since {ends[name]:%Y-%m-%dT%H:%M:%SZ}, with all that it gave: "
                "a new set-up takes its place",
                reason=Reason.CERTIFICATE_EXPIRED,
                where=str(folder),
            )


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Lock the folder: the next process that signs in it waits until this one is done.

    Two who read the same list would sign the same number, and one of them would lose what the other
    revoked.

    Raises:
        EnvironmentFault: it cannot be held.
    """
    try:
        held = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise EnvironmentFault(
            f"cannot open `{folder}`: {error.strerror}",
            reason=Reason.FILE_UNAVAILABLE,
            where=str(folder),
        ) from error
    try:
        fcntl.flock(held, fcntl.LOCK_EX)
        yield
    finally:
        os.close(held)
