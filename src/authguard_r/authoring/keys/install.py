# SPDX-License-Identifier: Apache-2.0
"""A machine's trust folder: what an answer brings into it, held to the root, never backwards.

Spec page: docs/spec/token.md#trust-folder
"""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding
from msgspec import Struct

from authguard_r.authoring.keys.request import CertificateAnswer, fingerprint
from authguard_r.authoring.keys.setup import AUTHORITIES, SUFFIXES
from authguard_r.core.encoding import decode, unb64
from authguard_r.core.errors import AuthenticityError, MalformedError
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.keys.certificate import Leaf, require_authority
from authguard_r.keys.files import write_whole
from authguard_r.keys.loading import key_of, load
from authguard_r.keys.revocation import RevocationList, read_list
from authguard_r.keys.trust import ROOT_LISTS, Trust, read_trust

#: Every user may read what a machine trusts, and its owner alone may write it.
_FOLDER, _FILE = 0o755, 0o644


class OpenedAnswer(Struct, frozen=True, kw_only=True):
    """An answer that holds under its own roots; whether they are the right ones, a person says.

    Args:
        trust: its roots and lists.
        chains: leaf and authority of each key, DER.
        leaves: what they say.
        authorities: every role authority's certificate by its name.
        lists: the lists by their authority's name.
    """

    trust: Trust
    chains: tuple[tuple[bytes, bytes], ...]
    leaves: tuple[Leaf, ...]
    authorities: dict[str, x509.Certificate]
    lists: dict[str, RevocationList]


def open_answer(data: bytes, now: Now) -> OpenedAnswer:
    """Return an answer, once everything in it holds under the roots that it brings.

    Raises:
        MalformedError: no canonical answer, an authority that no set-up has, or an invalid list.
        AuthenticityError: a certificate or list does not hold at `now`, or an authority gives
            roles that are not its own.
    """
    answer = decode(data.removesuffix(b"\n"), CertificateAnswer, where="answer")
    roots = tuple(_certificate(text, where="answer.roots") for text in answer.roots)
    named = dict(zip(ROOT_LISTS, roots, strict=False))
    authorities = {
        name: _certificate(text, where=f"answer.authorities.{name}")
        for name, text in answer.authorities.items()
    }
    if set(answer.lists) != {*named, *authorities} or named.keys() & authorities.keys():
        raise MalformedError("expected the list of each authority", where="answer.lists")
    for name, authority in authorities.items():
        _require_own_root(name, authority, roots, now)
    lists = {
        name: _list(answer.lists[name], name, certificate)
        for name, certificate in {**named, **authorities}.items()
    }
    ders = {n: c.public_bytes(Encoding.DER) for n, c in {**named, **authorities}.items()}
    trust = Trust(roots, {ders[name]: found for name, found in lists.items()})
    chains = tuple(
        (unb64(leaf, where="answer.chains"), unb64(authority, where="answer.chains"))
        for leaf, authority in answer.chains
    )
    leaves = tuple(trust.identify(chain, now) for chain in chains)
    if [leaf.root for leaf in leaves] != list(range(len(roots))):
        raise MalformedError("expected a certificate under each root", where="answer.chains")
    return OpenedAnswer(
        trust=trust, chains=chains, leaves=leaves, authorities=authorities, lists=lists
    )


def install_answer(folder: Path, opened: OpenedAnswer, now: Now) -> None:
    """Write a trust folder, or bring the one that is there up to date; its root never changes.

    Args:
        folder: the trust folder; may be absent.
        opened: an answer whose root a person, or the folder, stands behind.
        now: when.

    Raises:
        AuthenticityError: the folder has another root; nothing was written.
        EnvironmentFault: it could not be written.
    """
    roots = opened.trust.roots
    held: dict[str, tuple[bytes, RevocationList]] = {}
    if (folder / "root.pem").exists():
        known = read_trust(folder)
        require_root(fingerprint(roots), fingerprint(known.roots), where=str(folder))
        held = {found.authority: (der, found) for der, found in known.lists.items()}
    for place in (folder, folder / "authorities", folder / "revocations"):
        _make(place)
    certificates = {**dict(zip(ROOT_LISTS, roots, strict=False)), **opened.authorities}
    for name, certificate in certificates.items():
        found = opened.lists[name]
        if name in held and not _follows(opened, name, held[name], now):
            continue
        # a list and the authority that signed it go together, or the folder is no trust folder
        write_whole(folder / "revocations" / f"{name}.json", found.signed, mode=_FILE)
        if name in opened.authorities:
            pem = certificate.public_bytes(Encoding.PEM)
            write_whole(folder / "authorities" / f"{name}.pem", pem, mode=_FILE)
    # the last: without it there is no trust folder
    all_roots = b"".join(root.public_bytes(Encoding.PEM) for root in roots)
    write_whole(folder / "root.pem", all_roots, mode=_FILE)


def install_list(folder: Path, data: bytes, now: Now) -> RevocationList:
    """Put an authority's next list in the place of the one that a trust folder holds.

    The very list that it holds is there already: nothing is written, and nothing is wrong.

    Raises:
        AuthGuardError: it is not of this folder's authorities, or not newer; nothing was written.
    """
    trust = read_trust(folder)
    there = trust.in_force(data, now)
    if there is not None:
        return there
    _, found = trust.read_newer(data, now)
    write_whole(folder / "revocations" / f"{found.authority}.json", found.signed, mode=_FILE)
    return found


def require_root(got: str, expected: str, *, where: str) -> None:
    """Require that a fingerprint is the expected one.

    Raises:
        AuthenticityError: it is another root's.
    """
    if got != expected:
        raise AuthenticityError(
            f"expected the root `{expected}`, got `{got}`",
            reason=Reason.CERTIFICATE_INVALID,
            where=where,
        )


def _require_own_root(
    name: str, authority: x509.Certificate, roots: tuple[x509.Certificate, ...], now: Now
) -> None:
    """Require that the root of its place gave an authority its name's roles, and no others."""
    where = f"answer.authorities.{name}"
    known = {
        kind + suffix: (root, roles)
        for suffix, root in zip(SUFFIXES, roots, strict=False)
        for kind, roles in AUTHORITIES.items()
    }
    if name not in known:
        raise MalformedError(f"expected one of {', '.join(known)}", where=where)
    root, own = known[name]
    moment = datetime.fromtimestamp(now.utc_ms / 1000, UTC)
    if not require_authority(authority, root, moment) <= frozenset(own):
        raise AuthenticityError(
            f"expected an authority that gives {', '.join(own)}",
            reason=Reason.CERTIFICATE_INVALID,
            where=where,
        )


def _follows(opened: OpenedAnswer, name: str, held: tuple[bytes, RevocationList], now: Now) -> bool:
    """Return whether an answer's authority and its list take the place of those in a folder."""
    der, known = held
    certificate = opened.authorities.get(name)
    if certificate is None or der == certificate.public_bytes(Encoding.DER):
        return known.number < opened.lists[name].number
    before = load(der, where=f"authorities/{name}.pem")
    try:
        _require_own_root(name, before, opened.trust.roots, now)
    except AuthenticityError:
        return True  # it ended, or another file was put there
    return before.not_valid_before_utc < certificate.not_valid_before_utc


def _make(place: Path) -> None:
    """Make a folder that its owner alone writes; one that is there stays as it is."""
    if not place.is_dir():
        place.mkdir(parents=True)
        place.chmod(_FOLDER)


def _certificate(text: str, *, where: str) -> x509.Certificate:
    return load(unb64(text, where=where), where=where)


def _list(text: str, name: str, authority: x509.Certificate) -> RevocationList:
    key = key_of(authority, where=f"answer.authorities.{name}")
    return read_list(text.encode("utf-8"), authority=name, key=key)
