# SPDX-License-Identifier: Apache-2.0
"""The authority's machine: who gets a certificate.

A name has one key at a time, and a key one name for ever: who stands behind an action is counted by
names. Spec page: docs/spec/token.md#requests
"""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from authguard_r.authoring.keys.folder import (
    ISSUED,
    IssuedCertificate,
    alone,
    certified,
    given,
    require_lasting,
)
from authguard_r.authoring.keys.request import OpenedRequest, WantedCertificate, make_answer
from authguard_r.authoring.keys.setup import (
    AUTHORITIES,
    SUFFIXES,
    authority_of,
    read_authority,
    require_key_here,
)
from authguard_r.core.errors import (
    AuthenticityError,
    AuthGuardError,
    EnvironmentFault,
    RefusedError,
)
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.keys.algorithms import PublicKey, algorithm_of
from authguard_r.keys.certificate import Leaf, build_leaf
from authguard_r.keys.files import write_whole
from authguard_r.keys.loading import key_of
from authguard_r.keys.signer import Passphrase
from authguard_r.keys.trust import ROOT_LISTS, Trust, read_certificates, read_file, read_trust

#: A certificate counts from a little before it was given: clocks differ.
_EARLY = timedelta(hours=1)
#: A group's from a day before.
_EARLY_GROUP = timedelta(days=1)
#: Leaf and authority of each key.
_Chains = tuple[tuple[x509.Certificate, x509.Certificate], ...]


def issue(
    folder: Path,
    request: OpenedRequest,
    *,
    now: datetime,
    days: int,
    passphrase: Passphrase | None = None,
    out: Path | None = None,
) -> bytes:
    """Give what was asked for and return the answer; the caller has shown it to a person.

    Args:
        folder: a set-up with the authority's private keys.
        request: opened: its maker holds the keys.
        now: the start of validity, but for an hour.
        days: how long the certificate is valid; the end of who gives it comes first.
        passphrase: says the passphrase of an authority's key that is sealed.
        out: a file for the answer; when it cannot be written nothing was given.

    Raises:
        RefusedError: name or key belongs to another holder, or the name has another key, and that
            key did not sign the request.
        AuthenticityError: the algorithms are not those of the roots, the authority is over, the
            key was revoked, or what the key before signed does not hold.
        EnvironmentFault: the folder has no such authority, or not its private key.
    """
    with alone(folder):
        require_grantable(folder, request, now=now)
        chains = _chains(
            folder, request.wanted, request.keys, now=now - _EARLY, days=days, passphrase=passphrase
        )
        ders = tuple(
            (leaf.public_bytes(Encoding.DER), authority.public_bytes(Encoding.DER))
            for leaf, authority in chains
        )
        data = answer(folder, ders)
        place = folder / ISSUED
        place.mkdir(exist_ok=True)
        path = place / f"{request.wanted.principal}.{chains[0][0].serial_number}.cert.pem"
        write_whole(path, _pem(chains))
        try:
            if out is not None:
                write_whole(out, data)
        except AuthGuardError:
            path.unlink()  # it is free
            raise
    return data


def issue_group(
    folder: Path,
    wanted: WantedCertificate,
    key: PublicKey,
    *,
    threshold: int,
    members: tuple[str, ...],
    now: datetime,
    days: int,
    passphrase: Passphrase | None = None,
) -> Path:
    """Give a group of people its certificate and return where it lies, beside the keys.

    Args:
        folder: a set-up with the people authority's private key.
        wanted: the group's name, role and scope.
        key: the group's.
        threshold: how many members sign together.
        members: its people.
        now: the start of validity, but for a day.
        days: how long it is valid; the end of who gives it comes first.
        passphrase: says the passphrase of an authority's key that is sealed.

    Raises:
        AuthGuardError: as for `issue`; nothing was written.
    """
    with alone(folder):
        require_group(folder, wanted, key, now=now)
        chains = _chains(
            folder,
            wanted,
            (key,),
            now=now - _EARLY_GROUP,
            days=days,
            passphrase=passphrase,
            threshold=threshold,
            members=members,
        )
        path = _group_path(folder, wanted)
        write_whole(path, _pem(chains))
    return path


def _chains(
    folder: Path,
    wanted: WantedCertificate,
    keys: tuple[PublicKey, ...],
    *,
    now: datetime,
    days: int,
    passphrase: Passphrase | None,
    threshold: int = 1,
    members: tuple[str, ...] = (),
) -> _Chains:
    """Return leaf and authority of each key; this alone opens the authorities' private keys."""
    names = _issuers(folder, wanted)
    issuers = [read_authority(folder, name, passphrase) for name in names]
    return tuple(
        (
            build_leaf(
                key,
                principal=wanted.principal,
                role=wanted.role,
                issuer=issuer.certificate,
                key=issuer.key,
                now=now,
                days=days,
                robots=None if wanted.every_robot else wanted.robots,
                regions=None if wanted.every_region else wanted.regions,
                profile=wanted.profile,
                template=wanted.template,
                threshold=threshold,
                members=members,
            ),
            issuer.certificate,
        )
        for key, issuer in zip(keys, issuers, strict=True)
    )


def _pem(chains: _Chains) -> bytes:
    return b"".join(cert.public_bytes(Encoding.PEM) for chain in chains for cert in chain)


def answer(folder: Path, chains: tuple[tuple[bytes, bytes], ...]) -> bytes:
    """Return the answer with these chains, and all that a machine needs to verify them."""
    roots = read_certificates(folder / "root.pem")
    authorities = {
        name: certificate.public_bytes(Encoding.DER)
        for name, (certificate, _) in certified(folder).items()
    }
    names = (*(name for name, _ in zip(ROOT_LISTS, roots, strict=False)), *authorities)
    lists = {name: read_file(folder / "revocations" / f"{name}.json") for name in names}
    return make_answer(chains, roots, authorities, lists)


def require_grantable(folder: Path, request: OpenedRequest, *, now: datetime) -> None:
    """Require that the authority of this folder may give what is asked for; no key is opened.

    Raises:
        AuthGuardError: as for `issue`.
    """
    at = Now(int(now.timestamp()) * 1000, 0)
    _require_free(folder, request.wanted, request.keys, renews=bool(request.renews), now=at)
    if request.renews:
        _require_holder(read_trust(folder), request, at)


def require_group(
    folder: Path, wanted: WantedCertificate, key: PublicKey, *, now: datetime
) -> None:
    """Require that the authority of this folder may give a group this name and this key.

    Raises:
        AuthGuardError: as for `issue`.
    """
    for path in (_group_path(folder, wanted), folder / "keys" / f"{wanted.principal}.key.pem"):
        if path.exists():  # written over, it would count on and be on no record
            raise EnvironmentFault(
                f"expected no file `{path}`", reason=Reason.FILE_UNAVAILABLE, where=str(path)
            )
    at = Now(int(now.timestamp()) * 1000, 0)
    _require_free(folder, wanted, (key,), renews=False, now=at)


def _group_path(folder: Path, wanted: WantedCertificate) -> Path:
    return folder / "keys" / f"{wanted.principal}.cert.pem"


def wider(folder: Path, request: OpenedRequest, *, now: datetime) -> tuple[str, ...]:
    """Return what is asked for beyond what the name has now; nothing for a name that has nothing.

    A key that has the name may ask for its next certificate by itself, so only the person who
    issues it sees that it asks for more.

    Args:
        folder: a set-up.
        request: one that may be granted.
        now: what is over by then counts no more.
    """
    wanted = request.wanted
    return min(
        (
            tuple(
                f"{kind}: {_words(asked)} (has {_words(has)})"
                for kind, asked, has in (
                    ("robots", None if wanted.every_robot else wanted.robots, leaf.scope.robots),
                    (
                        "regions",
                        None if wanted.every_region else wanted.regions,
                        leaf.scope.regions,
                    ),
                    ("profile", (str(wanted.profile),), (str(leaf.profile),)),
                    ("template", (str(wanted.template),), (str(leaf.template),)),
                )
                if has is not None and (asked is None or not set(asked) <= set(has))
            )
            for leaf in _holders(given(folder), wanted, Now(int(now.timestamp()) * 1000, 0))
        ),
        key=len,
        default=(),
    )


def _words(names: Iterable[str] | None) -> str:
    return "EVERY ONE" if names is None else ", ".join(sorted(names)) or "none"


def _require_free(
    folder: Path, wanted: WantedCertificate, keys: tuple[PublicKey, ...], *, renews: bool, now: Now
) -> None:
    """Require that the name is free or has these keys, and that no other name has the keys."""
    here, issuers = certified(folder), _issuers(folder, wanted)
    for name in issuers:
        require_key_here(folder, name)
    require_lasting(folder, issuers, now)
    have = [algorithm_of(_public(here[name][0])) for name in issuers]
    if [algorithm_of(key) for key in keys] != have:
        raise AuthenticityError(
            f"expected a key of {' and one of '.join(have)}",
            reason=Reason.KEY_INVALID,
            where="request.proofs",
        )
    if wanted.principal in {name + end for name in ("root", *AUTHORITIES) for end in SUFFIXES}:
        raise _taken(f"`{wanted.principal}` is an authority's name")
    everything = given(folder)
    _require_own_keys(everything, wanted, keys)
    holders = _holders(everything, wanted, now)
    if any(leaf.role is not wanted.role for leaf in holders):
        raise _taken(f"`{wanted.principal}` is here in another role")
    if any(leaf.members for leaf in holders):
        raise _taken(f"`{wanted.principal}` is a group: it is revoked first")
    if not renews and any(leaf.key not in keys for leaf in holders):
        raise _taken(
            f"`{wanted.principal}` has another key: it signs the request (`keys rotate`), "
            "or is revoked first"
        )


def _require_own_keys(
    everything: tuple[IssuedCertificate, ...],
    wanted: WantedCertificate,
    keys: tuple[PublicKey, ...],
) -> None:
    """Require keys that no other name has or had, and that were not revoked.

    One key under two names would count as two people, and a key that was lost would come back with
    the request that it was certified by.
    """
    for item in everything:
        if item.leaf.key not in keys:
            continue
        if item.leaf.principal != wanted.principal:
            raise _taken(
                f"the key is `{item.leaf.principal}`'s: each name has a key of its own",
                where="request.proofs",
            )
        if item.revoked:
            raise AuthenticityError(
                "the key was revoked: the name gets a new one (`keys request`)",
                reason=Reason.CERTIFICATE_REVOKED,
                where="request.proofs",
            )


def _holders(
    everything: tuple[IssuedCertificate, ...], wanted: WantedCertificate, now: Now
) -> list[Leaf]:
    """Return the name's certificates that are neither revoked nor expired."""
    return [
        item.leaf
        for item in everything
        if item.leaf.principal == wanted.principal
        and not item.revoked
        and item.leaf.not_after_ms >= now.utc_ms
    ]


def _require_holder(trust: Trust, request: OpenedRequest, now: Now) -> None:
    """Require that the present holder of the name signed the request."""
    wanted = request.wanted
    before = trust.verify(request.message, request.renews, now)
    if (before.id, before.role) != (wanted.principal, wanted.role):
        raise AuthenticityError(
            f"expected the signature of `{wanted.principal}`, got `{before.id}`'s",
            reason=Reason.ISSUER_MISMATCH,
            where="request.renews",
        )


def _issuers(folder: Path, wanted: WantedCertificate) -> list[str]:
    """Return the names of the authorities that give a role, one under each root."""
    name = authority_of(wanted.role)
    names = [name + suffix for suffix in SUFFIXES]
    return [n for n in names if (folder / "authorities" / f"{n}.pem").exists()] or names[:1]


def _public(certificate: x509.Certificate) -> PublicKey:
    return key_of(certificate, where="authorities")


def _taken(message: str, where: str = "request.principal") -> RefusedError:
    return RefusedError(message, reason=Reason.ISSUER_MISMATCH, where=where)
