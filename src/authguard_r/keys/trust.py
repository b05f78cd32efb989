# SPDX-License-Identifier: Apache-2.0
"""The trust roots of one machine: root certificates and revocation lists, read from a folder.

Implements the core's `Verifier`. Certificates travel in tokens; nothing is looked up by a name
that a token chose. Spec page: docs/spec/token.md
"""

from __future__ import annotations

from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding
from msgspec import Struct
from msgspec.structs import replace

from authguard_r.core.errors import AuthenticityError, EnvironmentFault, MalformedError
from authguard_r.core.identifiers import Digest, RobotId
from authguard_r.core.principals import Endorsed, Principal
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.keys.algorithms import require_signature
from authguard_r.keys.certificate import Leaf, Role, read_claims, walk
from authguard_r.keys.loading import key_of, load, load_pem
from authguard_r.keys.revocation import RevocationList, claimed_authority, read_list

#: Names of the roots' own revocation lists, in the order of the roots.
ROOT_LISTS = ("root", "root-2")
#: Chains that are kept once they were walked.
_MOST_KEPT = 256


class _Identified(Struct, frozen=True):
    """A chain that held at `since_ms`; it holds until the leaf's own end, dates being intervals."""

    leaf: Leaf
    since_ms: int


class Trust:
    """Who may say what: the roots, and their role authorities' revocation lists.

    Under two roots, every signed object carries two signatures of one principal, with one chain
    to each root: who breaks one algorithm has broken nothing (`hybrid`).

    Args:
        roots: the root certificates: one, or one of each algorithm that has to hold.
        lists: authentic revocation lists by the DER of the authority they belong to; a root's
            own list, of authorities, under the root's DER.
    """

    def __init__(
        self, roots: tuple[x509.Certificate, ...], lists: dict[bytes, RevocationList]
    ) -> None:
        for root in roots:
            key_of(root, where="root")
        self.roots = roots
        self._lists = lists
        self._root_ders = tuple(root.public_bytes(Encoding.DER) for root in roots)
        self._identified: dict[tuple[bytes, ...], _Identified] = {}

    @property
    def demo(self) -> bool:
        """True when the root says that it is for demonstration only."""
        return any(is_demo(root) for root in self.roots)

    @property
    def lists(self) -> dict[bytes, RevocationList]:
        """The lists in force, by the DER of their authority."""
        return dict(self._lists)

    def read_newer(self, data: bytes, now: Now) -> tuple[bytes, RevocationList]:
        """Return a list that may take the place of the one in force, and its authority's DER.

        Raises:
            MalformedError: no list, or of no authority that is here.
            AuthenticityError: its signature does not hold, it is stale already, or its number is
                not above that of the list in force (`REVOCATION_STALE`).
        """
        name = claimed_authority(data)
        der = next((d for d, known in self._lists.items() if known.authority == name), None)
        if der is None:
            raise MalformedError(
                f"expected the list of an authority that is trusted here, got `{name}`'s",
                where="revocations",
            )
        key = key_of(load(der, where=name), where=name)
        found, held = read_list(data, authority=name, key=key), self._lists[der].number
        if found.number <= held or found.next_update_ms < now.utc_ms:
            raise AuthenticityError(
                f"expected a list after number {held} that is not past its next update",
                reason=Reason.REVOCATION_STALE,
                where=f"revocations/{name}",
            )
        return der, found

    def in_force(self, data: bytes, now: Now) -> RevocationList | None:
        """Return the list in force that has these very bytes, unless it is stale; else None."""
        same = (known for known in self._lists.values() if known.signed == data)
        return next((known for known in same if now.utc_ms <= known.next_update_ms), None)

    def put_in_force(self, lists: dict[bytes, RevocationList]) -> None:
        """Let these lists count from now on, and forget whom the ones before let in.

        Args:
            lists: authentic lists by the DER of their authority; others stay as they are.
        """
        # the lists first: a thread that still uses the old cache then fills the old one only
        self._lists = {**self._lists, **lists}
        self._identified = {}

    @property
    def root(self) -> x509.Certificate:
        """The first root: what distinguishes a set-up."""
        return self.roots[0]

    def identify(self, chain: tuple[bytes, ...], now: Now) -> Leaf:
        """Return what a chain's leaf says, with revocation checked.

        Raises:
            AuthenticityError: the chain does not hold at `now`.
        """
        kept = self._identified  # a walk under older lists fills a cache that is not used
        known = kept.get(chain)
        if known is not None and known.since_ms <= now.utc_ms <= known.leaf.not_after_ms:
            return known.leaf
        leaf = self._identify(chain, now)
        if len(kept) >= _MOST_KEPT:
            kept.clear()
        kept[chain] = _Identified(leaf, now.utc_ms)
        return leaf

    def _identify(self, chain: tuple[bytes, ...], now: Now) -> Leaf:
        if len(chain) != 2:
            raise AuthenticityError(
                f"expected a chain of 2 certificates, got {len(chain)}",
                reason=Reason.CERTIFICATE_INVALID,
                where="certificate",
            )
        leaf = walk(chain[0], chain[1], roots=self.roots, now=now)
        first = self._require_current(self._root_ders[leaf.root], leaf.authority_serial, now)
        second = self._require_current(chain[1], leaf.serial, now)
        return replace(leaf, not_after_ms=min(leaf.not_after_ms, first, second))

    def verify(self, message: bytes, endorsements: tuple[Endorsed, ...], now: Now) -> Principal:
        """Return who signed the message, under every root (`core.ports.Verifier`).

        Raises:
            AuthenticityError: chain, revocation or signature does not hold, they are not of one
                principal (`ISSUER_MISMATCH`), or a root has none (`SIGNATURE_MISSING`).
        """
        leaves: list[Leaf] = []
        for number, (chain, signature) in enumerate(endorsements):
            # (1) the certificate
            leaf = self.identify(chain, now)
            # (2) the signature
            require_signature(leaf.key, signature, message, where="signature")
            if leaves and _whose(leaf) != _whose(leaves[0]):
                raise AuthenticityError(
                    "expected every signature to be of one principal",
                    reason=Reason.ISSUER_MISMATCH,
                    where=f"token.endorsements[{number}]",
                )
            leaves.append(leaf)
        self._require_roots(leaves)
        first = leaves[0]
        return Principal(
            id=first.principal,
            role=first.role,
            scope=first.scope,
            usable_until_ms=min(leaf.not_after_ms for leaf in leaves),
            threshold=first.threshold,
            members=first.members,
        )

    def _require_roots(self, leaves: list[Leaf]) -> None:
        reached = {leaf.root for leaf in leaves}
        for number, root in enumerate(self.roots):
            if number not in reached:
                raise AuthenticityError(
                    f"expected a signature under `{root.subject.rfc4514_string()}` too",
                    reason=Reason.SIGNATURE_MISSING,
                    where="token.endorsements",
                )

    def bearer(self, chain: tuple[bytes, ...]) -> tuple[str, bytes]:
        """Return whose name a chain's leaf has, and its public key; whether it holds, others say.

        Raises:
            AuthenticityError: its certificate cannot be verified.
        """
        where = "certificate.leaf"
        key = key_of(load(chain[0], where=where), where=where)
        return read_claims(chain[0]).principal, key.public_bytes_raw()

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

    def attested_robot(self, chain: tuple[bytes, ...], now: Now) -> RobotId:
        """Return the one robot that an estimator's certificate names.

        Raises:
            AuthenticityError: the chain does not hold or is not an estimator's.
        """
        leaf = self.identify(chain, now)
        if leaf.role is not Role.ESTIMATOR or leaf.robot is None:
            raise AuthenticityError(
                "expected an estimator certificate that names its robot",
                reason=Reason.ROLE_DENIED,
                where="certificate.leaf",
            )
        return leaf.robot

    def scheduled_template(self, chain: tuple[bytes, ...], now: Now) -> Digest:
        """Return the digest of the one mission template that a scheduler's certificate names.

        Raises:
            AuthenticityError: the chain does not hold or is not a scheduler's.
        """
        leaf = self.identify(chain, now)
        if leaf.role is not Role.SCHEDULER or leaf.template is None:
            raise AuthenticityError(
                "expected a scheduler certificate that names its template",
                reason=Reason.ROLE_DENIED,
                where="certificate.leaf",
            )
        return leaf.template

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


def _whose(leaf: Leaf) -> tuple[object, ...]:
    """Return everything that two certificates of one principal have in common."""
    bound = (leaf.profile, leaf.template, leaf.threshold, leaf.members)
    return leaf.principal, leaf.role, leaf.scope, *bound


def is_demo(root: x509.Certificate) -> bool:
    """True when the root says that it is for demonstration only."""
    return "demo" in root.subject.rfc4514_string().lower()


def read_trust(folder: Path) -> Trust:
    """Return the trust root in a folder written by `authguard keys init`.

    Raises:
        EnvironmentFault: a part is missing or cannot be read.
        MalformedError: a list is not one.
        AuthenticityError: a certificate or list does not hold.
    """
    roots = read_certificates(folder / "root.pem")
    lists: dict[bytes, RevocationList] = {}
    for root, name in zip(roots, ROOT_LISTS, strict=False):
        lists[root.public_bytes(Encoding.DER)] = _list(folder, name, root)
    for path in sorted((folder / "authorities").glob("*.pem")):
        (authority,) = read_certificates(path, most=1)
        lists[authority.public_bytes(Encoding.DER)] = _list(folder, path.stem, authority)
    return Trust(roots, lists)


def _list(folder: Path, name: str, authority: x509.Certificate) -> RevocationList:
    key = key_of(authority, where=f"{name}.pem")
    path = folder / "revocations" / f"{name}.json"
    return read_list(read_file(path), authority=name, key=key)


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
            reason=Reason.FILE_UNAVAILABLE,
            where=str(path),
        ) from error


def read_certificates(path: Path, *, most: int = 2) -> tuple[x509.Certificate, ...]:
    """Return the certificates in a PEM file, at least one and at most `most`.

    Raises:
        EnvironmentFault: it cannot be read.
        AuthenticityError: it holds something else.
    """
    found = load_pem(read_file(path), where=path.name)
    if len(found) > most:
        raise _invalid(f"expected at most {most} certificates, got {len(found)}", path)
    return found


def pairs(
    found: tuple[x509.Certificate, ...],
) -> tuple[tuple[x509.Certificate, x509.Certificate], ...]:
    """Return the chains of a file: leaf and authority of the first key, then of the second.

    Raises:
        AuthenticityError: a leaf is without its authority.
    """
    if len(found) % 2:
        raise AuthenticityError(
            "expected each certificate with its authority's",
            reason=Reason.CERTIFICATE_INVALID,
            where="certificate",
        )
    return tuple(zip(found[::2], found[1::2], strict=True))


def _invalid(message: str, path: Path) -> AuthenticityError:
    return AuthenticityError(message, reason=Reason.CERTIFICATE_INVALID, where=path.name)
