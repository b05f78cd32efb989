# SPDX-License-Identifier: Apache-2.0
"""How late it is at least, on a machine that has no clock when it starts.

Such a machine says 1970, and every certificate seems too young. A certificate that exists was
issued before now, so its beginning is over. Spec page: docs/spec/store.md#time
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress

from cryptography import x509

from authguard_r.core.encoding import unb64
from authguard_r.core.errors import AuthenticityError, MalformedError
from authguard_r.core.token import read_token
from authguard_r.keys.loading import load
from authguard_r.keys.trust import Trust


def began_ms(certificates: Iterable[x509.Certificate]) -> int:
    """Return when the last of them begins, 0 without any."""
    return max((_begins(certificate) for certificate in certificates), default=0)


def chain_ms(chain: Iterable[bytes]) -> int:
    """Return when the last certificate of a chain begins; an invalid one is skipped."""
    found = 0
    for der in chain:
        with suppress(AuthenticityError):
            found = max(found, _begins(load(der, where="certificate")))
    return found


def token_ms(data: bytes) -> int:
    """Return when the last certificate in a token begins; its signature is not verified."""
    try:
        chains = [endorsement.chain for endorsement in read_token(data).endorsements]
        return max((chain_ms(unb64(der) for der in chain) for chain in chains), default=0)
    except MalformedError:
        return 0


def boot_ms(wall_ms: int, trust: Trust, *known_ms: int) -> int:
    """Return the instant to judge a process's own parts by when it starts.

    It is the wall clock's, unless nothing could have been signed yet: then the latest instant that
    is known to be over. It decides whether a gate and its stop process serve, and nothing else:
    what is decided and recorded waits for a clock that is right.

    Args:
        wall_ms: the machine's clock.
        trust: the roots, which have a beginning.
        known_ms: beginnings of certificates, times that were committed or counted.
    """
    began = began_ms(trust.roots)
    return wall_ms if wall_ms >= began else max((began, *known_ms))


def _begins(certificate: x509.Certificate) -> int:
    return round(certificate.not_valid_before_utc.timestamp() * 1_000)
