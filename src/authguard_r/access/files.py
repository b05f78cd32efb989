# SPDX-License-Identifier: Apache-2.0
"""Reads the site and the binding that a process is started with."""

from __future__ import annotations

import time
from pathlib import Path

from authguard_r.core.errors import AuthenticityError
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.keys.trust import Trust, read_file
from authguard_r.normalize.binding import Binding, load_binding
from authguard_r.normalize.shipped import binding_source
from authguard_r.site.model import Site
from authguard_r.site.signed import is_token, read_signed_site
from authguard_r.site.source import as_text, parse_site, require_sound


def trusted_site(path: Path, trust: Trust, now: Now | None = None) -> Site:
    """Return a sound site model: signed, or plain beside a trust root that says `demo`.

    Args:
        path: a YAML file or a signed token.
        trust: the trust root; a token's signature must hold.
        now: the instant at which certificates must be valid; the machine's when absent.

    Raises:
        MalformedError: no site model, or one with faults.
        AuthenticityError: the signature is not valid, or a required signature is missing.
        EnvironmentFault: the file cannot be read.
    """
    data = read_file(path)
    if is_token(data):
        at = Now(time.time_ns() // 1_000_000, 0) if now is None else now
        return read_signed_site(data, verifier=trust, now=at, where=str(path)).site
    if not trust.demo:
        raise AuthenticityError(
            "expected a signed site outside demonstration: `authguard site sign`",
            reason=Reason.SIGNATURE_INVALID,
            where=str(path),
        )
    plain = parse_site(as_text(data, where=str(path)), where=str(path))
    return require_sound(plain, where=str(path))


def read_binding(name: str | Path, site: Site) -> Binding:
    """Return a sound binding: a shipped one by its name, or the one in a file.

    Raises:
        MalformedError: no binding, or none for this site.
        EnvironmentFault: it cannot be read.
    """
    return load_binding(binding_source(str(name)), site=site, where=str(name))
