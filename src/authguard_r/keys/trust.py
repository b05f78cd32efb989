# SPDX-License-Identifier: Apache-2.0
"""The trust root of one machine: root certificate and revocation lists, read from a folder.

Implements the core's `Verifier`. Certificates travel in tokens; nothing is looked up by a name
that a token chose. Spec page: docs/spec/token.md
"""

from __future__ import annotations

from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding
from msgspec import Struct
from msgspec.structs import replace

from authguard_r.core.errors import AuthenticityError, EnvironmentFault
from authguard_r.core.identifiers import Digest, RobotId
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.core.token import Principal
from authguard_r.keys.certificate import Leaf, Role, is_demo, walk
from authguard_r.keys.ed25519 import require_signature, require_sound
from authguard_r.keys.revocation import RevocationList, read_list

#: Chains that are kept once they were walked.
_MOST_KEPT = 256


class _Identified(Struct, frozen=True):
    """A chain that held at `since_ms`; it holds until the leaf's own end, dates being intervals."""

    leaf: Leaf
    since_ms: int


class Trust:
    """Who may say what: one root, its role authorities' revocation lists.

    Args:
        root: the root certificate.
        lists: authentic revocation lists by the DER of the authority they belong to; the root's
            own list, of authorities, under the root's DER.
    """

    def __init__(self, root: x509.Certificate, lists: dict[bytes, RevocationList]) -> None:
        require_sound(root.public_key(), where="root")
        self.root = root
        self._lists = lists
        self._root_der = root.public_bytes(Encoding.DER)
        self._identified: dict[tuple[bytes, ...], _Identified] = {}

    @property
    def demo(self) -> bool:
        """True when the root says that it is for demonstration only."""
        return is_demo(self.root)

    def identify(self, chain: tuple[bytes, ...], now: Now) -> Leaf:
        """Return what a chain's leaf says, with revocation checked.

        Raises:
            AuthenticityError: the chain does not hold at `now`.
        """
        known = self._identified.get(chain)
        if known is not None and known.since_ms <= now.utc_ms <= known.leaf.not_after_ms:
            return known.leaf
        leaf = self._identify(chain, now)
        if len(self._identified) >= _MOST_KEPT:
            self._identified.clear()
        self._identified[chain] = _Identified(leaf, now.utc_ms)
        return leaf

    def _identify(self, chain: tuple[bytes, ...], now: Now) -> Leaf:
        if len(chain) != 2:
            raise AuthenticityError(
                f"expected a chain of 2 certificates, got {len(chain)}",
                reason=Reason.CERTIFICATE_INVALID,
                where="certificate",
            )
        leaf = walk(chain[0], chain[1], root=self.root, now=now)
        first = self._require_current(self._root_der, leaf.authority_serial, now)
        second = self._require_current(chain[1], leaf.serial, now)
        return replace(leaf, not_after_ms=min(leaf.not_after_ms, first, second))

    def verify(
        self, message: bytes, *, signature: bytes, chain: tuple[bytes, ...], now: Now
    ) -> Principal:
        """Return who signed the message (`core.ports.Verifier`).

        Raises:
            AuthenticityError: chain, revocation or signature does not hold.
        """
        # (1) the certificate
        leaf = self.identify(chain, now)
        # (2) the signature
        require_signature(leaf.key, signature, message, where="signature")
        return Principal(id=leaf.principal, role=leaf.role, usable_until_ms=leaf.not_after_ms)

    def gate_identity(self, chain: tuple[bytes, ...], now: Now) -> tuple[RobotId, Digest]:
        """Return the robot and profile that a gate's own certificate names.

        Raises:
            AuthenticityError: the chain does not hold or is not a gate's.
        """
        leaf = self.identify(chain, now)
        if leaf.role is not Role.GATE or leaf.robot is None or leaf.profile is None:
            raise AuthenticityError(
                "expected a gate certificate that names its robot and profile",
                reason=Reason.ROLE_DENIED,
                where="certificate.leaf",
            )
        return leaf.robot, leaf.profile

    def _require_current(self, authority: bytes, serial: int, now: Now) -> int:
        known = self._lists.get(authority)
        if known is None or now.utc_ms > known.next_update_ms:
            raise AuthenticityError(
                "expected a revocation list that is not past its next update",
                reason=Reason.REVOCATION_STALE,
                where="revocations",
            )
        if serial in known.serials:
            raise AuthenticityError(
                "the certificate was revoked",
                reason=Reason.CERTIFICATE_REVOKED,
                where="certificate",
            )
        return known.next_update_ms


def read_trust(folder: Path) -> Trust:
    """Return the trust root in a folder written by `authguard keys init`.

    Raises:
        EnvironmentFault: a part is missing or cannot be read.
        MalformedError: a list is not one.
        AuthenticityError: a certificate or list does not hold.
    """
    root = _pem(folder / "root.pem")
    root_key = require_sound(root.public_key(), where="root.pem")
    lists = {
        root.public_bytes(Encoding.DER): read_list(
            read_file(folder / "revocations" / "root.json"), authority="root", key=root_key
        )
    }
    for path in sorted((folder / "authorities").glob("*.pem")):
        authority = _pem(path)
        key = require_sound(authority.public_key(), where=path.name)
        data = read_file(folder / "revocations" / f"{path.stem}.json")
        lists[authority.public_bytes(Encoding.DER)] = read_list(data, authority=path.stem, key=key)
    return Trust(root, lists)


def read_file(path: Path) -> bytes:
    """Return a file's bytes.

    Raises:
        EnvironmentFault: it cannot be read; says which and why.
    """
    try:
        return path.read_bytes()
    except OSError as error:
        raise EnvironmentFault(
            f"cannot read `{path}`: {error.strerror}",
            reason=Reason.STORE_UNAVAILABLE,
            where=str(path),
        ) from error


def _pem(path: Path) -> x509.Certificate:
    try:
        return x509.load_pem_x509_certificate(read_file(path))
    except ValueError as error:
        raise AuthenticityError(
            "expected a PEM certificate", reason=Reason.CERTIFICATE_INVALID, where=path.name
        ) from error
