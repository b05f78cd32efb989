# SPDX-License-Identifier: Apache-2.0
"""Where a witness is, and who: what a configuration may name.

The stop process reads the same configuration, so nothing here knows a store, a socket or a thread.
Spec page: docs/spec/rollback.md#witnesses
"""

from __future__ import annotations

from contextlib import suppress
from ipaddress import ip_address
from urllib.parse import urlsplit

from msgspec import Struct

from authguard_r.audit.note import NoteKey, read_key
from authguard_r.core.errors import MalformedError
from authguard_r.core.reasons import Reason

#: The signature types of a witness's key: Ed25519 and ML-DSA-44.
_COSIGNATURE_KINDS = frozenset({b"\x04", b"\x06"})


class WitnessPlace(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A witness as a gate's configuration names it.

    Args:
        url: its submission prefix, `https://`, or `http://` on this machine.
        key: its verifier key, `name+id+base64`.
    """

    url: str
    key: str


def require_place(place: WitnessPlace, *, where: str) -> NoteKey:
    """Return a witness's key, once its place is one that may be asked.

    Raises:
        MalformedError: no key that cosigns, or no address: HTTP without TLS leaves this machine.
    """
    key = read_key(place.key, where=f"{where}.key")
    if key.kind not in _COSIGNATURE_KINDS or key.text() != place.key:
        raise _unfit("expected a witness's verifier key", f"{where}.key")
    try:
        url = urlsplit(place.url)
        host, port = url.hostname or "", url.port
    except ValueError as error:
        raise _unfit("expected an address", f"{where}.url") from error
    plain = place.url.isascii() and place.url.isprintable() and " " not in place.url
    bare = not (url.query or url.fragment or url.username or url.password or port == 0)
    if not (plain and bare and host and (url.scheme == "https" or _is_here(url.scheme, host))):
        text = "expected https://HOST[:PORT][/PATH], or http:// with a loopback address"
        raise _unfit(text, f"{where}.url")
    return key


def _is_here(scheme: str, host: str) -> bool:
    """Return whether this is HTTP to a loopback address; a name can be resolved to any address."""
    with suppress(ValueError):
        return scheme == "http" and ip_address(host).is_loopback
    return False


def _unfit(message: str, where: str) -> MalformedError:
    return MalformedError(message, where=where, reason=Reason.SCHEMA_INVALID)
