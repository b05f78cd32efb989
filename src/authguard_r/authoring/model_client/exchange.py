# SPDX-License-Identifier: Apache-2.0
"""One request to one address: bounded in time and size, answered by the reply's exact bytes.

The client libraries write the request. The reply's bytes are kept as they came, because the
libraries parse arguments and so lose one that is given twice. Only the key is taken from the
environment.
"""

from __future__ import annotations

import math
import os
import socket
import ssl
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from enum import StrEnum
from functools import cache
from importlib import import_module
from ipaddress import ip_address
from threading import Timer
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec
from msgspec import Struct

if TYPE_CHECKING:
    import httpx2

T = TypeVar("T")
#: Longest reply body that is read, in bytes.
MAX_BODY = 1 << 23
#: Statuses after which another attempt can help.
_PASSING = frozenset({408, 409, 425, 429, 500, 502, 503, 504, 529})
#: Headers of every request. The libraries' own are dropped: some come from the environment.
_HEADERS = {
    "accept": "application/json",
    "accept-encoding": "identity",
    "content-type": "application/json",
    "user-agent": "authguard-r",
}


class FaultKind(StrEnum):
    """What went wrong with an exchange."""

    MISSING_PACKAGE = "missing package"
    ADDRESS = "address"
    CLEARTEXT = "cleartext"
    KEY = "key"
    LATE = "late"
    UNREACHABLE = "unreachable"
    LIMIT = "limit"
    REFUSED = "refused"
    TOO_LARGE = "too large"
    PROTOCOL = "protocol"


class ModelServerError(Exception):
    """A model's server gave no answer that can be used.

    Args:
        message: what happened, without the key; of a server, what it did.
        kind: what went wrong.
        passing: another attempt can help.
        wait_s: seconds that the server asks to wait; None where it asks for nothing.
        billed: the attempt may have cost something.
    """

    def __init__(
        self,
        message: str,
        kind: FaultKind,
        *,
        passing: bool = False,
        wait_s: float | None = None,
        billed: bool = False,
    ) -> None:
        super().__init__(message)
        self.message, self.kind, self.passing = message, kind, passing
        self.wait_s, self.billed = wait_s, billed
        #: attempts that were made, and the seconds before the next one, once no more are made
        self.attempts, self.next_s = 1, 0.0


class ModelAddress(Struct, frozen=True, kw_only=True):
    """One model at one server.

    Args:
        base_url: the only address that is contacted; redirects and proxies are not followed.
        model: the model's name there.
        key_env: name of the environment variable that holds the key; empty for a server that asks
            for none.
        timeout_s: seconds that one silence may last.
        retries: further attempts after 408, 429, 5xx, silence and broken connections.
        own: the address is not the vendor's.
    """

    base_url: str
    model: str
    key_env: str = ""
    timeout_s: float = 60.0
    retries: int = 2
    own: bool = True

    def key(self) -> str:
        """Return the key; a placeholder for a server that asks for none.

        Raises:
            ModelServerError: the variable holds none.
        """
        if not self.key_env:
            return "none"
        found = os.environ.get(self.key_env, "").strip()
        if not found or not found.isascii() or not found.isprintable():
            message = f"the environment variable `{self.key_env}` holds no key"
            raise ModelServerError(message, FaultKind.KEY)
        return found

    def require(self) -> None:
        """Hold the address and the key to what can be used.

        Raises:
            ModelServerError: it is no such address, it holds no key, or the key would travel
                without encryption.
        """
        url = _url(self.base_url)
        if self.key_env and url.scheme == "http" and not _is_loopback(url.host):
            message = f"the key of `{self.key_env}` would travel to `{url.host}` in the clear"
            raise ModelServerError(f"{message}: use https", FaultKind.CLEARTEXT)
        self.key()


def library(name: str) -> Any:
    """Return an optional package.

    Raises:
        ModelServerError: it is not installed.
    """
    try:
        return import_module(name)
    except ImportError as error:
        message = f"a model needs the package `{error.name or name}`"
        raise ModelServerError(message, FaultKind.MISSING_PACKAGE) from error


def retried(
    once: Callable[[], T],
    *,
    retries: int,
    backoff_s: float = 0.5,
    patience_s: float = 60.0,
    ends: float = math.inf,
    pause: Callable[[float], None] = time.sleep,
) -> tuple[T, int]:
    """Return what an attempt returns, and how many attempts it took.

    Args:
        once: one attempt.
        retries: further attempts.
        backoff_s: seconds before the second attempt, doubled before each further one.
        patience_s: longest wait between two attempts, seconds.
        ends: when the last attempt has to begin, on `time.monotonic`.
        pause: waits so many seconds.

    Raises:
        ModelServerError: the last attempt's.
    """
    attempt = 1
    while True:
        try:
            return once(), attempt
        except ModelServerError as error:
            wait_s = backoff_s * 2 ** (attempt - 1) if error.wait_s is None else error.wait_s
            error.attempts, error.next_s = attempt, wait_s
            late = wait_s > patience_s or time.monotonic() + wait_s >= ends
            if not error.passing or attempt > retries or late:
                raise
            pause(wait_s)
            attempt += 1


def exchange(
    address: ModelAddress,
    part: Any,
    post: Callable[[httpx2.Client], bytes],
    *,
    headers: Mapping[str, str],
    ends: float,
) -> bytes:
    """Send one request and return the reply's exact body.

    Args:
        address: where.
        part: the client library, for its errors.
        post: sends the request and returns the body.
        headers: the protocol's own, with the key.
        ends: when the whole reply has to be there, on `time.monotonic`.

    Raises:
        ModelServerError: no whole reply. No key and no body are in the error or behind it.
    """
    web = library("httpx2")
    transport = _bounded(web, headers, ends)
    with web.Client(transport=transport, trust_env=False, follow_redirects=False) as client:
        try:
            return post(client)
        except part.APIStatusError as error:
            raise _status(address, error) from None
        except Exception as error:  # noqa: BLE001 - a library fails in any way at a strange reply
            raise _broken(address, part, error, late=time.monotonic() >= ends) from None


def _broken(address: ModelAddress, part: Any, error: Exception, *, late: bool) -> ModelServerError:
    cause = error.__cause__ if isinstance(error, part.APIConnectionError) else error
    if isinstance(cause, ModelServerError):
        return cause
    if late:
        message = "did not finish its answer in time"
        return ModelServerError(message, FaultKind.LATE, passing=True, billed=True)
    if isinstance(error, part.APITimeoutError):
        message = f"did not answer within {address.timeout_s:g} s"
        return ModelServerError(message, FaultKind.UNREACHABLE, passing=True, billed=True)
    if isinstance(error, part.APIConnectionError):
        billed = not isinstance(cause, library("httpx2").ConnectError)
        message = "broke the connection off" if billed else "cannot be reached"
        return ModelServerError(message, FaultKind.UNREACHABLE, passing=True, billed=billed)
    message = f"sent no reply of its protocol ({type(error).__name__})"
    return ModelServerError(message, FaultKind.PROTOCOL, billed=True)


def _status(address: ModelAddress, error: Any) -> ModelServerError:
    status = int(error.status_code)
    said = "" if status in {401, 403} else _said(address, error.response.content)
    passing = status in _PASSING
    kind = FaultKind.UNREACHABLE if passing else FaultKind.REFUSED
    return ModelServerError(
        f"answered with status {status}{said}",
        FaultKind.LIMIT if status == 429 else kind,
        passing=passing,
        wait_s=_asked_wait(error.response.headers) if passing else None,
    )


def _said(address: ModelAddress, body: bytes) -> str:
    """Return what a server says is wrong, short and without the key."""
    try:
        error = msgspec.json.decode(body)["error"]
        text = str(error if isinstance(error, str) else error["message"])
    except (ValueError, KeyError, TypeError, RecursionError):
        return ""
    if address.key_env:
        text = text.replace(address.key(), "[key]")
    return f": {ascii(text)[1:-1][:200]}"


def _asked_wait(headers: Any) -> float | None:
    """Return how many seconds a server asks to wait."""
    try:
        wait_s = float(headers.get("retry-after", ""))
    except ValueError:  # a date, or nothing
        return None
    return wait_s if 0 <= wait_s < math.inf else None


def _url(base_url: str) -> Any:
    """Return an address that holds no credentials, as the HTTP client reads it.

    Raises:
        ModelServerError: it is no such address.
    """
    web = library("httpx2")
    with suppress(web.InvalidURL):
        url = web.URL(base_url)
        bare = not (url.userinfo or url.query or url.fragment or "@" in base_url)
        if url.scheme in {"http", "https"} and url.host and bare:
            return url
    # the address itself is not repeated: it may hold a password
    message = "expected an address such as http://127.0.0.1:8000/v1, without a name or a key in it"
    raise ModelServerError(message, FaultKind.ADDRESS)


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False


class _Deadline:
    """Closes a connection when its time is over, so that no read waits longer.

    Args:
        ends: when, on `time.monotonic`.
        late: raised at the connection's next step once the time is over.
    """

    def __init__(self, ends: float, late: Exception) -> None:
        self.left_s = max(ends - time.monotonic(), 0.001)
        self._ends, self._late = ends, late
        self._socket: socket.socket | None = None
        self._timer = Timer(self.left_s, self._close)
        self._timer.daemon = True

    def begin(self) -> None:
        self._timer.start()

    def end(self) -> None:
        self._timer.cancel()
        if self._socket is not None:
            self._socket.close()

    def require(self) -> None:
        if time.monotonic() >= self._ends:
            raise self._late

    def trace(self, event: str, info: dict[str, Any]) -> None:
        """Take the connection's socket; the transport calls this at each of its steps."""
        if event == "connection.connect_tcp.complete":
            # a copy: TLS takes the socket itself over, and a shutdown of either ends both
            self._socket = info["return_value"].get_extra_info("socket").dup()
        if not event.endswith(".failed") and "closed" not in event:
            self.require()  # what failed or is left may still be closed

    def _close(self) -> None:
        if self._socket is not None:
            with suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)


def _bounded(web: Any, headers: Mapping[str, str], ends: float) -> Any:
    """Return a transport whose every reply has an end: in bytes, and in time."""

    class BoundedBody(web.SyncByteStream):  # type: ignore[misc] # optional
        def __init__(self, stream: Any, deadline: _Deadline) -> None:
            self._stream, self._deadline = stream, deadline

        def __iter__(self) -> Iterator[bytes]:
            seen = 0
            for chunk in self._stream:
                seen += len(chunk)
                if seen > MAX_BODY:
                    raise _unread(f"sent more than {MAX_BODY} bytes", FaultKind.TOO_LARGE)
                self._deadline.require()
                yield chunk
            self._deadline.require()  # a closed connection may look like a reply's end

        def close(self) -> None:
            self._deadline.end()
            self._stream.close()

    class Transport(web.HTTPTransport):  # type: ignore[misc] # optional
        def handle_request(self, request: Any) -> Any:
            deadline = _Deadline(ends, web.ReadTimeout("the whole reply took too long"))
            waits = request.extensions.get("timeout", {})
            sent = web.Request(  # a new one: the library reads the old one's headers later
                request.method,
                request.url,
                headers={
                    "host": request.url.netloc.decode(),
                    "content-length": request.headers["content-length"],
                    **_HEADERS,
                    **headers,
                },
                stream=request.stream,
                extensions={
                    **request.extensions,
                    "trace": deadline.trace,
                    "timeout": {k: min(v or math.inf, deadline.left_s) for k, v in waits.items()},
                },
            )
            deadline.begin()
            try:
                reply = super().handle_request(sent)
            except BaseException:
                deadline.end()
                raise
            body = BoundedBody(reply.stream, deadline)
            if reply.headers.get("content-encoding", "identity") != "identity":
                body.close()  # what it unpacks to has no bound
                message = "compressed its reply: expected one that is not compressed"
                raise _unread(message, FaultKind.PROTOCOL)
            return web.Response(
                reply.status_code, headers=reply.headers, stream=body, extensions=reply.extensions
            )

    return Transport(verify=_certificates(), trust_env=False)


def _unread(message: str, kind: FaultKind) -> ModelServerError:
    return ModelServerError(message, kind, billed=True)


@cache
def _certificates() -> ssl.SSLContext:
    """Return the trusted authorities; reading them takes longer than a local server's answer."""
    found: ssl.SSLContext = library("httpx2").create_ssl_context(trust_env=False)
    return found
