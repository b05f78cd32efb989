# SPDX-License-Identifier: Apache-2.0
"""A port and who may speak there: what every server of this package over HTTP has in common.

A Unix socket says whose process asks; a port does not. So nobody is served without a secret, and
nothing listens wider than this machine unless its caller has said how that is made safe.
Spec pages: docs/spec/mcp.md#http, docs/spec/http.md#who-may-ask
"""

from __future__ import annotations

import asyncio
import hmac
import ipaddress
import socket
from collections.abc import Awaitable, Callable, Iterable, Iterator, MutableMapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import uvicorn

from authguard_r.client.link import until_told
from authguard_r.core.errors import EnvironmentFault, MalformedError
from authguard_r.core.reasons import Reason
from authguard_r.keys.files import read_private

#: Answers that are under way are waited for so long at the end, in seconds.
END_S = 2
_LEAST_TOKEN = 22

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


def listening(address: str, *, wide: bool = False) -> socket.socket:
    """Return a socket that listens on `HOST:PORT`; port 0 takes a free one.

    Args:
        address: a numeric address with a port.
        wide: it may be one that other machines reach.

    Raises:
        MalformedError: no such address, or one that others than this machine reach.
        EnvironmentFault: something else listens there.
    """
    host, _, port = address.rpartition(":")
    try:
        is_own = ipaddress.ip_address(host.strip("[]")).is_loopback
        number = int(port)
    except ValueError as error:
        raise MalformedError("expected such as 127.0.0.1:8100", where="--listen") from error
    if not (is_own or wide) or not 0 <= number <= 0xFFFF:
        raise MalformedError("expected an address of this machine alone", where="--listen")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    # by its protocol's name, or asyncio leaves Nagle's algorithm on: 40 ms for an answer
    made = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        made.bind((host.strip("[]"), number))
        made.listen(128)
    except OSError as error:
        made.close()
        text = error.strerror or "cannot listen"
        raise EnvironmentFault(text, reason=Reason.STORE_UNAVAILABLE, where=address) from error
    return made


class _Server(uvicorn.Server):
    """A server that leaves signals to whoever runs it: a clean end is exit 0."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Capture none."""
        yield


async def serve_until_told(config: uvicorn.Config, made: socket.socket) -> None:
    """Serve until SIGTERM or SIGINT."""
    server = _Server(config)

    async def work(told: asyncio.Event) -> None:
        serving = asyncio.ensure_future(server.serve(sockets=[made]))
        await told.wait()
        server.should_exit = True
        await serving

    await until_told(work)
