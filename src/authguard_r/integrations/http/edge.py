# SPDX-License-Identifier: Apache-2.0
"""What every request passes before anything reads it, and the line that is written of it after.

Spec page: docs/spec/http.md#limits
"""

from __future__ import annotations

import re
import time
from typing import Any

from authguard_r.core.reasons import Reason
from authguard_r.integrations.http.clients import Authenticator
from authguard_r.integrations.http.faults import RequestError, of_fault
from authguard_r.integrations.http_listener.access import App, Receive, Scope, Send
from authguard_r.integrations.http_listener.admission import AdmissionLimits
from authguard_r.integrations.http_listener.connection import GoneError, let_in
from authguard_r.normalize.parse import MAX_TEXT
from authguard_r.wire.json_log import Lines

#: Of `authguard serve`.
LIMITS = AdmissionLimits(connections=512, body=MAX_TEXT)
#: Longest number that a client gives its request, in bytes.
MAX_ID = 256
#: Where a handler leaves the template of its path and the code of its refusal, for the line.
ROUTE, CODE = "authguard_r.route", "authguard_r.code"

_REQUEST_ID = b"x-request-id"
#: A request's number as the log takes it; anything else could be a planner's words.
_PLAIN = re.compile(r"\A[A-Za-z0-9._:-]{1,64}\Z")
_METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE"})
_ALWAYS = ((b"cache-control", b"no-store"), (b"x-content-type-options", b"nosniff"))


class Edge:
    """Stands before an application.

    Args:
        app: answers each caller that is let through.
        authenticator: says who may ask.
        hosts: names that a request may call this server by; None: any, behind TLS.
        lines: the log. Requests that were not let in share a bound.
    """

    def __init__(
        self, app: App, authenticator: Authenticator, hosts: frozenset[bytes] | None, lines: Lines
    ) -> None:
        self._app = app
        self._authenticator = authenticator
        self._hosts = hosts
        self._lines = lines

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request, and write down that it was."""
        answer = _Answer(scope, send)
        try:
            answer.who = self._require(scope)
            let_in(scope)
            await self._app(scope, receive, answer.send)
        except GoneError:
            return  # no question is asked for a caller who cannot be answered
        except RequestError as error:
            await answer.refuse(error)
        except Exception as error:  # noqa: BLE001 - a fault of ours is said, not thrown
            await answer.refuse(of_fault(error))
        finally:
            self._lines.write(answer.line(), kind=None if answer.who else "refused")

    def _require(self, scope: Scope) -> str:
        """Return who asks, once the request may be read.

        Raises:
            RequestError: it may not.
        """
        if _head_bytes(scope) > LIMITS.head:
            text = f"expected at most {LIMITS.head} bytes"
            raise RequestError(431, str(Reason.INPUT_TOO_LARGE), text, where="head")
        hosts = _values(scope, b"host")
        if self._hosts is not None and (len(hosts) != 1 or hosts[0].lower() not in self._hosts):
            text = "this server has another name: a page of another site may have sent this"
            raise RequestError(421, "HOST_UNKNOWN", text, where="host")
        if _values(scope, b"origin"):
            text = "pages in a browser are not served"
            raise RequestError(403, "ORIGIN_DENIED", text, where="origin")
        who = self._authenticator.admit(scope)
        numbers = _values(scope, _REQUEST_ID)
        if len(numbers) > 1 or any(len(number) > MAX_ID for number in numbers):
            text = f"expected one of at most {MAX_ID} bytes"
            raise RequestError(400, "MALFORMED", text, where="x-request-id")
        return who


class _Answer:
    """One answer on its way out.

    Args:
        scope: of its request.
        send: sends it.
    """

    def __init__(self, scope: Scope, send: Send) -> None:
        self._scope, self._send = scope, send
        self._began = time.monotonic()
        self._status = 0
        self._code = ""
        self.who = ""
        number = _values(scope, _REQUEST_ID)[:1]
        self._number = number if number and len(number[0]) <= MAX_ID else []

    async def send(self, message: Any) -> None:
        """Send a part of it, with the headers that every answer has."""
        if message["type"] == "http.response.start":
            self._status = message["status"]
            own = [(_REQUEST_ID, number) for number in self._number]
            message = {**message, "headers": [*message["headers"], *_ALWAYS, *own]}
        await self._send(message)

    async def refuse(self, error: RequestError) -> None:
        """Send a problem, unless an answer is on its way already."""
        self._code = error.code
        if self._status:
            return
        headers = {
            "content-type": "application/json",
            "content-length": str(len(error.body)),
            **error.headers,
        }
        raw = [(name.encode("ascii"), value.encode("latin-1")) for name, value in headers.items()]
        await self.send({"type": "http.response.start", "status": error.status, "headers": raw})
        await self.send({"type": "http.response.body", "body": error.body})

    def line(self) -> dict[str, Any]:
        """Return what the log says: nothing that a client could have spelled."""
        method = self._scope["method"]
        number = "".join(value.decode("latin-1") for value in self._number)
        return {
            "event": "request",
            "method": method if method in _METHODS else "-",
            "path": self._scope.get(ROUTE, "-"),
            "status": self._status,
            "request_id": number if _PLAIN.match(number) else "-",
            "who": self.who or "-",
            "ms": round((time.monotonic() - self._began) * 1_000, 1),
            "code": self._code or self._scope.get(CODE, ""),
        }


def _head_bytes(scope: Scope) -> int:
    own = len(scope["raw_path"]) + len(scope["query_string"])
    return own + sum(len(name) + len(value) for name, value in scope["headers"])


def _values(scope: Scope, wanted: bytes) -> list[bytes]:
    return [value for name, value in scope["headers"] if name == wanted]
