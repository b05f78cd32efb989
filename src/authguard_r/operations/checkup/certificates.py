# SPDX-License-Identifier: Apache-2.0
"""Until when a set-up is valid: roots, authorities, lists, and the certificates under them.

How-to: docs/howto/deploy.md
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from authguard_r.core.errors import AuthGuardError
from authguard_r.core.quantities import Now, to_timestamp
from authguard_r.core.reasons import Reason
from authguard_r.keys.certificate import Leaf
from authguard_r.keys.loading import load
from authguard_r.keys.trust import ROOT_LISTS, Trust, pairs, read_certificates
from authguard_r.operations.checkup.advice import Advice, AdviceCode, unsafe, warning

#: How long before its end a certificate is warned of.
SOON_MS = 30 * 86_400_000
#: A list is warned of when less than one in so many parts of its life is left.
_LEAST_PARTS = 4
_RENEW = "issue it again: authguard keys rotate"
_NEXT = "make the next set-up in time: authguard keys init DIR --no-demo"
_FRESH = "authguard keys lists, at its authority; then authguard advanced revocations install"
#: The state of every certificate that was given: a folder keeps them, and nothing is wrong.
_OVER = frozenset({Reason.CERTIFICATE_EXPIRED, Reason.CERTIFICATE_REVOKED, Reason.REVOCATION_STALE})


def list_advice(trust: Trust, folder: Path, now: Now) -> Iterator[Advice]:
    """Yield every list that is stale or soon will be; `read_trust` held each to its authority."""
    for known in trust.lists.values():
        where = folder / "revocations" / f"{known.authority}.json"
        part, told = f"revocations/{known.authority}", to_timestamp(known.next_update_ms)
        left_ms, life_ms = known.next_update_ms - now.utc_ms, known.next_update_ms - known.issued_ms
        if left_ms < 0:
            message = f"stale since {told}: the gate accepts nothing that it covers"
            yield unsafe(part, AdviceCode.REVOCATIONS, message, place=str(where), mend=_FRESH)
        elif left_ms * _LEAST_PARTS < life_ms:
            message = f"stale after {told}: less than a quarter of its life is left"
            yield warning(part, AdviceCode.REVOCATIONS, message, place=str(where), mend=_FRESH)


def authority_advice(trust: Trust, folder: Path, now: Now) -> Iterator[Advice]:
    """Yield every root that ended or soon will, and every authority that does so before it."""
    root_ends_ms = min(map(_end_ms, trust.roots))
    for der, known in trust.lists.items():
        is_root = known.authority in ROOT_LISTS
        end_ms = _end_ms(load(der, where=known.authority))
        if end_ms - now.utc_ms >= SOON_MS or (not is_root and end_ms >= root_ends_ms):
            continue
        part = known.authority if is_root else f"authorities/{known.authority}"
        place = str(folder / ("root.pem" if is_root else f"{part}.pem"))
        told = to_timestamp(end_ms)
        if end_ms < now.utc_ms:
            message = f"ended {told}: the gate accepts nothing under it"
            yield unsafe(part, AdviceCode.CERTIFICATE, message, place=place, mend=_NEXT)
        else:
            message = f"ends {told}, and everything under it then"
            yield warning(part, AdviceCode.CERTIFICATE, message, place=place, mend=_NEXT)


def certificate_advice(path: Path, trust: Trust, now: Now) -> Iterator[Advice]:
    """Yield what is wrong with a file of certificates in use, and when it ends."""
    part = f"keys/{path.name}"
    try:
        leaves = leaves_of(path, trust, now)
    except AuthGuardError as error:
        yield unsafe(
            part, AdviceCode.CERTIFICATE, str(error), place=str(path), mend="issue it again"
        )
        return
    if len({leaf.root for leaf in leaves}) != len(trust.roots):
        message = f"expected a chain to each of {len(trust.roots)} roots, got {len(leaves)}"
        yield unsafe(part, AdviceCode.CERTIFICATE, message, place=str(path), mend="issue it again")
        return
    yield from _ending(part, path, trust, now)


def issued_advice(paths: Iterable[Path], trust: Trust, now: Now) -> Iterator[Advice]:
    """Yield whose last certificate soon ends, of all that an authority gave."""
    last: dict[str, tuple[int, Path]] = {}
    for path in paths:
        try:
            leaves = leaves_of(path, trust, now)
        except AuthGuardError as error:
            if error.reason not in _OVER:
                part = f"issued/{path.name}"
                mend = "move it elsewhere"
                yield unsafe(part, AdviceCode.CERTIFICATE, str(error), place=str(path), mend=mend)
            continue
        name, end = leaves[0].principal, (_ends_ms(path, trust), path)
        known = last.get(name)
        last[name] = end if known is None else max(known, end)
    for _, path in last.values():
        yield from _ending(f"issued/{path.name}", path, trust, now)


def leaves_of(path: Path, trust: Trust, now: Now) -> tuple[Leaf, ...]:
    """Return what the certificates in a file say, one for each key.

    Raises:
        AuthGuardError: one does not hold at `now`, or the file cannot be read.
    """
    chains = pairs(_certificates(path))
    ders = (tuple(cert.public_bytes(Encoding.DER) for cert in chain) for chain in chains)
    return tuple(trust.identify(chain, now) for chain in ders)


def _ending(part: str, path: Path, trust: Trust, now: Now) -> Iterator[Advice]:
    until_ms = _ends_ms(path, trust)
    if until_ms - now.utc_ms < SOON_MS:
        above_ms = min(map(_end_ms, (*_certificates(path)[1::2], *trust.roots)))
        mend = _NEXT if above_ms == until_ms else _RENEW  # no more than the authority has
        message = f"usable only until {to_timestamp(until_ms)}"
        yield warning(part, AdviceCode.CERTIFICATE, message, place=str(path), mend=mend)


def _ends_ms(path: Path, trust: Trust) -> int:
    """Return when the first of a file's certificates, or of the roots', ends; lists apart."""
    return min(map(_end_ms, (*_certificates(path), *trust.roots)))


def _certificates(path: Path) -> tuple[x509.Certificate, ...]:
    return read_certificates(path, most=2 * len(ROOT_LISTS))


def _end_ms(certificate: x509.Certificate) -> int:
    return int(certificate.not_valid_after_utc.timestamp()) * 1000
