# SPDX-License-Identifier: Apache-2.0
"""A port and who may speak there: what every server of this package over HTTP has in common.

A Unix socket says whose process asks; a port does not. So a caller without a secret is not served,
and nothing listens wider than this machine unless its caller has said how that is made safe. Spec
pages: docs/spec/listeners.md, docs/spec/http.md#who-may-ask
"""

from __future__ import annotations

import hmac
import ipaddress
import socket
from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from pathlib import Path
from typing import Any

from authguard_r.core.errors import EnvironmentFault, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.keys.files import read_private

#: Connections that the system keeps until they are taken in; the kernel may keep fewer.
QUEUE = 4_096
_LEAST_TOKEN = 22
_EXPECTED = "expected an address and a port, such as 127.0.0.1:8100"

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]


def read_bearer(path: Path) -> bytes:
    """Return the token in a file.

    Raises:
        EnvironmentFault: it cannot be read, or others than its owner can read it.
        MalformedError: it is too short to be a secret, or has characters that a header cannot.
    """
    token = read_private(path, where="--token-file").strip()
    if len(token) < _LEAST_TOKEN or not token.isascii() or b" " in token or not token.isalnum():
        text = f"expected at least {_LEAST_TOKEN} letters and digits"
        raise MalformedError(text, where=str(path))
    return token


def shows(headers: Iterable[tuple[bytes, bytes]], token: bytes) -> bool:
    """True when the headers of a request show the token, once."""
    shown = [value for name, value in headers if name.lower() == b"authorization"]
    return len(shown) == 1 and hmac.compare_digest(shown[0], b"Bearer " + token)


def listening(address: str, *, wide: bool = False, otherwise: str = "") -> socket.socket:
    """Return a socket that listens on `HOST:PORT`; port 0 takes a free one.

    Args:
        address: a numeric address with a port.
        wide: it may be one that other machines reach.
        otherwise: what makes it that, for the message.

    Raises:
        MalformedError: no such address, or one that others than this machine reach.
        EnvironmentFault: something else listens there.
    """
    host, _, port = address.rpartition(":")
    try:
        place = ipaddress.ip_address(host.removeprefix("[").removesuffix("]"))
        number = int(port)
    except ValueError as error:
        raise MalformedError(_EXPECTED, where="--listen") from error
    shown = f"[{place}]" if place.version == 6 else str(place)
    if f"{shown}:{number}" != address or not 0 <= number <= 0xFFFF:
        raise MalformedError(_EXPECTED, where="--listen")
    if not (place.is_loopback or wide):
        text = "expected an address of this machine alone" + (otherwise and f"; {otherwise}")
        raise MalformedError(text, where="--listen")
    family = socket.AF_INET6 if place.version == 6 else socket.AF_INET
    # by its protocol's name, or asyncio leaves Nagle's algorithm on: 40 ms for an answer
    made = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        made.bind((str(place), number))
        made.listen(QUEUE)
    except OSError as error:
        made.close()
        text = error.strerror or "cannot listen"
        raise EnvironmentFault(text, reason=Reason.SERVICE_UNAVAILABLE, where=address) from error
    return made
