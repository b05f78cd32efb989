# SPDX-License-Identifier: Apache-2.0
"""The authority's machine: who gets a certificate, which of them are dead, until when lists hold.

The folder holds the authorities' private keys, every certificate that they gave (`issued/`) and
the lists. Nothing else ever holds all of it. Spec page: docs/spec/token.md#requests
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from datetime import datetime, timedelta
from pathlib import Path

from cryptography.hazmat.primitives.serialization import Encoding
from msgspec import Struct

from authguard_r.core.errors import AuthenticityError, RefusedError
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.keys.algorithms import algorithm_of
from authguard_r.keys.certificate import Leaf, build_leaf, walk
from authguard_r.keys.files import write_whole
from authguard_r.keys.request import OpenedRequest, make_answer
from authguard_r.keys.revocation import RevocationList
from authguard_r.keys.setup import (
    AUTHORITIES,
    SUFFIXES,
    Issued,
    authority_of,
    read_authority,
    read_key,
    write_revocations,
)
from authguard_r.keys.trust import (
    ROOT_LISTS,
    Trust,
    pairs,
    read_certificates,
    read_file,
    read_trust,
)

#: A certificate counts from a little before it was given: clocks differ.
_EARLY = timedelta(hours=1)
_ISSUED = "issued"


class Given(Struct, frozen=True, kw_only=True):
    """A certificate that an authority of the folder gave.

    Args:
        path: where it lies.
        leaf: what it says.
        authority: the name of the authority that gave it.
        revoked: it is on that authority's list.
        not_after_ms: its own end.
    """

    path: Path
    leaf: Leaf
    authority: str
    revoked: bool
    not_after_ms: int


def given(folder: Path) -> tuple[Given, ...]:
    """Return every certificate that was given, oldest file name first.

    Raises:
        AuthGuardError: the folder is no set-up, or a file in it holds something else.
    """
    trust = read_trust(folder)
    names = {
        read_certificates(path, most=1)[0].public_bytes(Encoding.DER): path.stem
        for path in (folder / "authorities").glob("*.pem")
    }
    paths = [*sorted(folder.glob("keys/*.cert.pem")), *sorted(folder.glob(f"{_ISSUED}/*.cert.pem"))]
    return tuple(item for path in paths for item in _given(path, trust, names))


def _given(path: Path, trust: Trust, names: dict[bytes, str]) -> Iterator[Given]:
    for chain in pairs(read_certificates(path, most=4)):
        leaf_der, authority_der = (cert.public_bytes(Encoding.DER) for cert in chain)
        end = chain[0].not_valid_after_utc
        # as it was when it began: what it says counts here, not whether it still holds
        at = Now(int(chain[0].not_valid_before_utc.timestamp()) * 1000 + 86_400_000, 0)
        name = names.get(authority_der)
        if name is None:
            raise AuthenticityError(
                "expected a certificate of an authority that is here",
                reason=Reason.CERTIFICATE_INVALID,
                where=str(path),
            )
        leaf = walk(leaf_der, authority_der, roots=trust.roots, now=at)
        yield Given(
            path=path,
            leaf=leaf,
            authority=name,
            revoked=leaf.serial in trust.lists[authority_der].serials,
            not_after_ms=int(end.timestamp()) * 1000,
        )


def issue(folder: Path, request: OpenedRequest, *, now: datetime, days: int) -> bytes:
    """Give what was asked for and return the answer; the caller has shown it to a person.

    Args:
        folder: a set-up with the authority's private keys.
        request: opened: its maker holds the keys.
        now: the start of validity, but for an hour.
        days: how long the certificate is valid.

    Raises:
        RefusedError: the name has another key, and that key did not sign the request.
        AuthenticityError: the algorithms are not those of the roots, or what the key before signed
            does not hold.
        EnvironmentFault: the folder has no such authority, or not its private key.
    """
    require_grantable(folder, request, now=now)
    wanted = request.wanted
    issuers = _issuers(folder, authority_of(wanted.role))
    chains = tuple(
        (
            build_leaf(
                key,
                principal=wanted.principal,
                role=wanted.role,
                issuer=issuer.certificate,
                key=issuer.key,
                now=now - _EARLY,
                days=days,
                robots=None if wanted.every_robot else wanted.robots,
                regions=None if wanted.every_region else wanted.regions,
                profile=wanted.profile,
                template=wanted.template,
            ),
            issuer.certificate,
        )
        for key, issuer in zip(request.keys, issuers, strict=True)
    )
    place = folder / _ISSUED
    place.mkdir(exist_ok=True)
    pem = b"".join(cert.public_bytes(Encoding.PEM) for chain in chains for cert in chain)
    path = place / f"{wanted.principal}.{chains[0][0].serial_number}.cert.pem"
    write_whole(path, pem)
    ders = tuple(
        (leaf.public_bytes(Encoding.DER), authority.public_bytes(Encoding.DER))
        for leaf, authority in chains
    )
    return answer(folder, ders)


def answer(folder: Path, chains: tuple[tuple[bytes, bytes], ...]) -> bytes:
    """Return the answer with these chains, and all that a machine needs to believe them."""
    roots = read_certificates(folder / "root.pem")
    authorities = {
        path.stem: read_certificates(path, most=1)[0].public_bytes(Encoding.DER)
        for path in sorted((folder / "authorities").glob("*.pem"))
    }
    names = (*(name for name, _ in zip(ROOT_LISTS, roots, strict=False)), *authorities)
    lists = {name: read_file(folder / "revocations" / f"{name}.json") for name in names}
    return make_answer(chains, roots, authorities, lists)


def require_grantable(folder: Path, request: OpenedRequest, *, now: datetime) -> None:
    """Require that the authority of this folder may give what is asked for.

    Raises:
        AuthGuardError: as for `issue`.
    """
    wanted = request.wanted
    issuers = _issuers(folder, authority_of(wanted.role))
    have = [algorithm_of(issuer.key) for issuer in issuers]
    if [algorithm_of(key) for key in request.keys] != have:
        raise AuthenticityError(
            f"expected a key of {' and one of '.join(have)}",
            reason=Reason.KEY_INVALID,
            where="request.proofs",
        )
    if wanted.principal in {name + end for name in ("root", *AUTHORITIES) for end in SUFFIXES}:
        raise _taken(f"`{wanted.principal}` is an authority's name")
    at = Now(int(now.timestamp()) * 1000, 0)
    holders = [
        item.leaf
        for item in given(folder)
        if item.leaf.principal == wanted.principal
        and not item.revoked
        and item.not_after_ms >= at.utc_ms
    ]
    others = [leaf for leaf in holders if leaf.key not in request.keys]
    if any(leaf.role is not wanted.role for leaf in holders):
        raise _taken(f"`{wanted.principal}` is here in another role")
    if others and not request.renews:
        raise _taken(
            f"`{wanted.principal}` has another key: it signs the request (`keys rotate`), "
            "or is revoked first"
        )
    if request.renews:
        _require_holder(read_trust(folder), request, at)


def _require_holder(trust: Trust, request: OpenedRequest, now: Now) -> None:
    """Require that whoever has the name now signed the request."""
    wanted = request.wanted
    before = trust.verify(request.message, request.renews, now)
    if (before.id, before.role) != (wanted.principal, wanted.role):
        raise AuthenticityError(
            f"expected the signature of `{wanted.principal}`, got `{before.id}`'s",
            reason=Reason.ISSUER_MISMATCH,
            where="request.renews",
        )


def _issuers(folder: Path, name: str) -> tuple[Issued, ...]:
    names = [name + suffix for suffix in SUFFIXES]
    here = [n for n in names if (folder / "authorities" / f"{n}.pem").exists()]
    return tuple(read_authority(folder, n) for n in here or names[:1])


def revoke(
    folder: Path, *, principal: str | None, serial: int | None, now: datetime, days: int
) -> dict[str, RevocationList]:
    """Write the next list of each authority that gave a principal, or a serial number, something.

    Args:
        folder: a set-up with the authority's private keys.
        principal: everything that this one has; an authority's own name revokes that authority.
        serial: one certificate, whoever has it.
        now: when the lists are signed.
        days: until their next update.

    Returns:
        The new lists by their authority's name.

    Raises:
        RefusedError: there is no such certificate.
        EnvironmentFault: an authority's key is not here; nothing was written.
    """
    dead: dict[str, set[int]] = {}
    for item in given(folder):
        if principal == item.leaf.principal or serial == item.leaf.serial:
            dead.setdefault(item.authority, set()).add(item.leaf.serial)
    for name, root, number in _authorities(folder):
        if principal == name or serial == number:
            dead.setdefault(root, set()).add(number)
    if not dead:
        raise RefusedError(
            f"nothing was given to `{principal or serial}`",
            reason=Reason.CERTIFICATE_INVALID,
            where=str(folder),
        )
    return next_lists(folder, dead, now=now, days=days)


def _authorities(folder: Path) -> Iterator[tuple[str, str, int]]:
    """Yield each authority's name, its root's list and its serial number."""
    roots = read_certificates(folder / "root.pem")
    for path in sorted((folder / "authorities").glob("*.pem")):
        (certificate,) = read_certificates(path, most=1)
        named = (
            name
            for name, root in zip(ROOT_LISTS, roots, strict=False)
            if root.subject == certificate.issuer
        )
        yield path.stem, next(named, ROOT_LISTS[0]), certificate.serial_number


def next_lists(
    folder: Path, dead: dict[str, set[int]], *, now: datetime, days: int
) -> dict[str, RevocationList]:
    """Sign and write each named authority's next list: what it had, and these.

    Raises:
        EnvironmentFault: an authority's key is not here; nothing was written.
    """
    before = {known.authority: known for known in read_trust(folder).lists.values()}
    keys = {name: read_key(folder, name) for name in dead}
    for name, serials in dead.items():
        write_revocations(
            folder,
            name,
            keys[name],
            serials=tuple(before[name].serials | serials),
            now=now,
            number=before[name].number + 1,
            days=days,
        )
    after = {known.authority: known for known in read_trust(folder).lists.values()}
    return {name: after[name] for name in dead}


def signing_here(folder: Path) -> Iterable[str]:
    """Return the authorities whose private keys this folder holds, the roots among them."""
    known = (item.authority for item in read_trust(folder).lists.values())
    return [name for name in known if (folder / "keys" / f"{name}.key.pem").exists()]


def _taken(message: str) -> RefusedError:
    return RefusedError(message, reason=Reason.ISSUER_MISMATCH, where="request.principal")
