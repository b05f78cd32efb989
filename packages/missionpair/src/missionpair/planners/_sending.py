# SPDX-License-Identifier: Apache-2.0
"""One question, sent to one address: bounded in time, size and attempts, answered by exact bytes.

The client libraries write the request; what comes back is taken from the wire, because they parse
arguments and so lose one that is given twice. Nothing of the environment is used but the key.
"""

from __future__ import annotations

import ssl
import time
from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any

import msgspec
from msgspec import Struct

from missionpair.briefing import PlannerError

if TYPE_CHECKING:
    import httpx2

    from missionpair.planners._meter import Meter
    from missionpair.planners._reach import ModelEndpoint

#: Longest reply body that is looked at, in bytes; the normalizer reads less.
MAX_BODY = 1 << 23
#: Statuses after which another attempt can help.
_PASSING = frozenset({408, 409, 425, 429, 500, 502, 503, 504, 529})
#: Headers that are sent; the libraries add more, also from the environment.
_SENT = frozenset(
    {"accept", "anthropic-version", "authorization", "connection", "content-length"}
    | {"content-type", "host", "user-agent", "x-api-key"}
)
_EXTRA = "missionpair[llm]"


class TooLargeError(Exception):
    """A reply is larger than anything that is looked at."""


class ReceivedReply(Struct, frozen=True):
    """What came back: the exact body, the time of the attempt, and the number of attempts."""

    body: bytes
    took_us: int
    attempts: int


class _Failure(Exception):  # noqa: N818 - an attempt that failed, to be judged here alone
    """One attempt failed.

    Args:
        message: what happened.
        code: as a planner's error has it.
        passing: another attempt can help.
        wait_s: what the server asks to wait; None where it says nothing.
        billed: it may have cost something.
    """

    def __init__(
        self,
        message: str,
        *,
        code: str,
        passing: bool,
        wait_s: float | None = None,
        billed: bool = False,
    ) -> None:
        super().__init__(message)
        self.message, self.code, self.passing = message, code, passing
        self.wait_s, self.billed = wait_s, billed


def library(name: str) -> Any:
    """Return an optional package.

    Raises:
        PlannerError: it is not installed.
    """
    try:
        return import_module(name)
    except ImportError as error:
        raise PlannerError(
            f"a model needs the package `{error.name or name}`: install `{_EXTRA}`",
            code="unreachable",
            where=name,
        ) from error


def send(
    reach: ModelEndpoint,
    meter: Meter,
    part: Any,
    post: Callable[[httpx2.Client], bytes],
    *,
    most_microusd: int,
    pause: Callable[[float], None] = time.sleep,
) -> ReceivedReply:
    """Return what a server answers, after as many attempts as it takes and may.

    Args:
        reach: where.
        meter: the caps; the most that an attempt can cost stays set aside with it.
        part: the client library, for its errors.
        post: sends the request and returns the body.
        most_microusd: the most that one attempt can cost.
        pause: waits so many seconds.

    Raises:
        PlannerError: no answer (`unreachable`), too many requests (`limit`), a cap (`cost`), a key
            or a request that the server refuses (`refused`), or no reply at all (`protocol`).
    """
    for attempt in range(1, reach.retries + 2):
        meter.set_aside(most_microusd)
        try:
            meter.take_turn()
        except BaseException:
            meter.give_back(most_microusd)
            raise
        began = time.perf_counter_ns()
        try:
            body = _attempt(reach, part, post)
        except _Failure as failure:
            if not failure.billed:
                meter.give_back(most_microusd)
            wait_s = reach.backoff_s * 2 ** (attempt - 1) if failure.wait_s is None else 0.0
            wait_s = max(wait_s, failure.wait_s or 0.0)
            if not failure.passing or attempt > reach.retries or wait_s > reach.patience_s:
                raise _given_up(reach, failure, attempt, wait_s) from None
            pause(wait_s)
        else:
            return ReceivedReply(body, (time.perf_counter_ns() - began) // 1_000, attempt)
    raise AssertionError("the last attempt returns or raises")


def _attempt(reach: ModelEndpoint, part: Any, post: Callable[[httpx2.Client], bytes]) -> bytes:
    """Send once; whatever a library raises becomes a failure without keys and bodies in it."""
    with _web(reach) as web:
        try:
            return post(web)
        except part.APITimeoutError:
            message = f"did not answer within {reach.timeout_s:g} s"
            raise _Failure(message, code="unreachable", passing=True, billed=True) from None
        except part.APIStatusError as error:
            raise _status(reach, error) from None
        except (part.APIError, TooLargeError, OSError, ValueError) as error:
            raise _broken(part, error) from None


def _broken(part: Any, error: Exception) -> _Failure:
    cause = error.__cause__ if isinstance(error, part.APIConnectionError) else error
    if isinstance(cause, TooLargeError):
        message = f"sent more than {MAX_BODY} bytes, or compressed them"
        return _Failure(message, code="protocol", passing=False, billed=True)
    if isinstance(error, part.APIConnectionError):
        billed = not isinstance(cause, library("httpx2").ConnectError)
        message = "broke the connection off" if billed else "cannot be reached"
        return _Failure(message, code="unreachable", passing=True, billed=billed)
    message = f"sent no reply of its protocol ({type(error).__name__})"
    return _Failure(message, code="protocol", passing=False, billed=True)


def _status(reach: ModelEndpoint, error: Any) -> _Failure:
    status = int(error.status_code)
    said = "" if status in {401, 403} else _said(reach, error.response.content)
    message = f"answered with status {status}{said}"
    passing = status in _PASSING
    code = "refused" if not passing else "limit" if status == 429 else "unreachable"
    wait_s = _asked_wait(error.response.headers) if passing else None
    return _Failure(message, code=code, passing=passing, wait_s=wait_s)


def _said(reach: ModelEndpoint, body: bytes) -> str:
    """Return what a server says is wrong, short and without the key."""
    try:
        error = msgspec.json.decode(body)["error"]
        text = error if isinstance(error, str) else error["message"]
    except (msgspec.DecodeError, KeyError, TypeError, RecursionError):
        return ""
    shown = ascii(str(text).replace(reach.key(), "[key]"))[1:-1][:200]
    return f": {shown}"


def _asked_wait(headers: Any) -> float | None:
    """Return how many seconds a server asks to wait."""
    try:
        wait_s = float(headers.get("retry-after", ""))
    except ValueError:  # a date, or nothing
        return None
    return wait_s if wait_s >= 0 else None


def _given_up(
    reach: ModelEndpoint, failure: _Failure, attempts: int, wait_s: float
) -> PlannerError:
    mends = {
        "limit": "cap `per_minute`, or try later",
        "refused": f"check `model` and the key in `{reach.key_env or 'key_env'}`",
        "protocol": "check that it speaks the protocol",
    }
    tries = "" if attempts == 1 else f" ({attempts} attempts)"
    if failure.passing and wait_s > reach.patience_s:
        tries = f" and asks to wait {wait_s:g} s"
    mend = mends.get(failure.code, "check `base_url`, and that it runs")
    return PlannerError(
        f"the model server at `{reach.base_url}` {failure.message}{tries}: {mend}",
        code=failure.code,
        where="base_url",
    )


def _web(reach: ModelEndpoint) -> httpx2.Client:
    """Return a client of the wire that takes nothing from the environment and goes nowhere else."""
    web = library("httpx2")
    client: httpx2.Client = web.Client(
        transport=_bounded(web, reach), trust_env=False, follow_redirects=False
    )
    return client


def _bounded(web: Any, reach: ModelEndpoint) -> Any:
    """Return a transport whose every reply has an end: in bytes, and in time."""

    class BoundedBody(web.SyncByteStream):  # type: ignore[misc] # optional
        def __init__(self, stream: Any, ends: float) -> None:
            self._stream, self._ends = stream, ends

        def __iter__(self) -> Iterator[bytes]:
            seen = 0
            for chunk in self._stream:
                seen += len(chunk)
                if seen > MAX_BODY:
                    raise TooLargeError
                if time.monotonic() > self._ends:  # a server that sends a byte now and then
                    raise web.ReadTimeout("the whole reply took too long")
                yield chunk

        def close(self) -> None:
            self._stream.close()

    class Transport(web.HTTPTransport):  # type: ignore[misc] # optional
        def handle_request(self, request: Any) -> Any:
            ends = time.monotonic() + reach.timeout_s
            sent = web.Request(  # a new one: the library reads the old one's headers later
                request.method,
                request.url,
                headers={k: v for k, v in request.headers.items() if k.lower() in _SENT},
                stream=request.stream,
                extensions=request.extensions,
            )
            reply = super().handle_request(sent)
            if reply.headers.get("content-encoding", "identity") != "identity":
                raise TooLargeError  # what it unpacks to has no bound
            return web.Response(
                reply.status_code,
                headers=reply.headers,
                stream=BoundedBody(reply.stream, ends),
                extensions=reply.extensions,
            )

    return Transport(verify=_certificates(), trust_env=False)


@cache
def _certificates() -> ssl.SSLContext:
    """Return who is believed to be whom; it takes longer to read than a local server to answer."""
    found: ssl.SSLContext = library("httpx2").create_ssl_context(trust_env=False)
    return found
