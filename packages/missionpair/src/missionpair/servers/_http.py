# SPDX-License-Identifier: Apache-2.0
"""A server on the loopback that answers like a model server, or fails like one.

Faults, as `faulty:FAULT`, or `faulty:FAULTxN` for the first N requests only: `429`, `500`,
`timeout`, `drip`, `cut`, `not-json`, `empty`, `schema`, `huge`, `packed`, `redirect`, `key`.
"""

from __future__ import annotations

import gzip
import json
import re
from abc import abstractmethod
from collections.abc import Callable
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Event, Lock, Thread
from types import TracebackType
from typing import Any, ClassVar, Self

from authguard_r.authoring.model_client.exchange import MAX_BODY
from missionpair.planners._reach import SCRIPTED
from missionpair.servers._scripted import Behavior, ScriptedAnswer, ScriptedQuestion, behavior_of

_LOOPBACK = "127.0.0.1"
_MAX_REQUEST = 1 << 23
_FAULT = re.compile(r"faulty:([a-z0-9-]+?)(?:x([0-9]{1,6}))?")
#: How long a silent server stays silent, in seconds, unless it is closed before.
_SILENCE_S = 600.0


class StandInServer:
    """One server with its stand-in; answers from the moment that it is made until `close`.

    Args:
        behavior: as `behavior_of` takes it, or `faulty:FAULT`; faults end in obedience.
        port: 0 takes any that is free.
        key: the key that is asked for; empty asks for none.

    Raises:
        ValueError: no such behavior.
        OSError: the port is taken.
    """

    #: The only path that is answered.
    path: ClassVar[str]
    #: What comes before the path in a client's base address.
    prefix: ClassVar[str]

    def __init__(self, behavior: str = "obedient", *, port: int = 0, key: str = "") -> None:
        faulty = _FAULT.fullmatch(behavior)
        if faulty is not None and faulty[1] not in _FAULTS:
            raise ValueError(f"no fault `{faulty[1]}`: {', '.join(_FAULTS)}")
        self._fault = _FAULTS[faulty[1]] if faulty is not None else None
        self._faults_left = int(faulty[2] or 1 << 30) if faulty is not None else 0
        self._behavior = behavior_of("obedient" if faulty is not None else behavior)
        self.key, self.requests = key, 0
        #: What was asked, newest last: method, path, headers and body.
        self.seen: list[tuple[str, str, dict[str, str], bytes]] = []
        self.closing, self._lock = Event(), Lock()
        self._server = ThreadingHTTPServer((_LOOPBACK, port), _handler(self))
        self._server.daemon_threads = True
        self._thread = Thread(target=self._server.serve_forever, args=(0.05,), daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def base_url(self) -> str:
        """The address for a client."""
        return f"http://{_LOOPBACK}:{self._server.server_address[1]}{self.prefix}"

    @property
    def model(self) -> str:
        """What the stand-in calls itself."""
        return self._behavior.model

    def close(self) -> None:
        """Stop answering."""
        self.closing.set()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def fault(self) -> Callable[[_Handler], None] | None:
        """Return how the next request fails; None when it does not."""
        with self._lock:
            self.requests += 1
            if self._fault is None or self._faults_left == 0:
                return None
            self._faults_left -= 1
            return self._fault

    def reply(self, headers: Any, body: bytes) -> tuple[int, bytes]:
        """Return status and reply to one request; any bytes get some answer."""
        try:
            asked = self.read(headers, json.loads(body))
        except (ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError):
            error = self.error("expected a request of the protocol", "invalid_request_error")
            return 400, json.dumps(error).encode()
        if not asked.model.startswith(SCRIPTED):
            text = f"there is no model `{asked.model}` here: only scripted stand-ins, {self.model}"
            return 404, json.dumps(self.error(text, "not_found_error")).encode()
        return 200, self.write(asked, self._behavior.answer(asked), self._behavior).encode()

    @abstractmethod
    def read(self, headers: Any, request: Any) -> ScriptedQuestion:
        """Return what a request asks; raises when it is not valid."""

    @abstractmethod
    def write(self, asked: ScriptedQuestion, answer: ScriptedAnswer, behavior: Behavior) -> str:
        """Return the reply, as JSON in ASCII."""

    @abstractmethod
    def error(self, message: str, kind: str) -> Any:
        """Return the reply of a failure."""

    @abstractmethod
    def is_allowed(self, headers: Any) -> bool:
        """True when the request brings the key that is asked for."""


class _Handler(BaseHTTPRequestHandler):
    """One connection."""

    stand_in: StandInServer
    protocol_version = "HTTP/1.1"
    server_version, sys_version = "missionpair-stand-in", ""

    def do_POST(self) -> None:
        """Answer one question."""
        size = self.headers.get("content-length", "")
        if not size.isdecimal() or int(size) > _MAX_REQUEST:
            self.answer(413, self.stand_in.error("too large", "request_too_large"))
            self.close_connection = True
            return
        body = self.rfile.read(int(size))
        self.stand_in.seen.append((self.command, self.path, dict(self.headers), body))
        if self.path != self.stand_in.path:
            self.answer(404, self.stand_in.error("no such path", "not_found_error"))
            return
        fault = self.stand_in.fault()
        if fault is not None:
            with suppress(OSError):  # who asked may be gone
                fault(self)
            return
        if not self.stand_in.is_allowed(self.headers):
            self.answer(401, self.stand_in.error("wrong key", "authentication_error"))
            return
        self.send(*self.stand_in.reply(self.headers, body))

    def do_GET(self) -> None:
        """Tell which models there are; a redirect that is followed ends here, too."""
        self.stand_in.seen.append((self.command, self.path, dict(self.headers), b""))
        self.answer(200, {"object": "list", "data": [{"id": self.stand_in.model}]})

    def answer(self, status: int, value: Any, **headers: str) -> None:
        """Send a JSON reply."""
        self.send(status, json.dumps(value).encode(), headers=headers)

    def send(
        self,
        status: int,
        body: bytes,
        *,
        size: int | None = None,
        headers: dict[str, str] | None = None,
    ) -> None:
        """Send any bytes; `size` may say that more of them come."""
        self.send_response(status)
        self.send_header("content-type", "application/json")
        self.send_header("content-length", str(len(body) if size is None else size))
        for name, value in (headers or {}).items():
            self.send_header(name.replace("_", "-"), value)
        self.end_headers()
        with suppress(OSError):  # who asked may be gone
            self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - the library's name
        """Say nothing: a request may hold a key."""


def _handler(server: StandInServer) -> type[_Handler]:
    return type("Handler", (_Handler,), {"stand_in": server})


# how it fails


def _busy(handler: _Handler) -> None:
    error = handler.stand_in.error("slow down", "rate_limit_error")
    handler.answer(429, error, retry_after="1")


def _broken(handler: _Handler) -> None:
    handler.answer(500, handler.stand_in.error("out of order", "api_error"))


def _silent(handler: _Handler) -> None:
    handler.stand_in.closing.wait(_SILENCE_S)
    handler.close_connection = True


def _drip(handler: _Handler) -> None:
    """Send a byte now and then, so that no silence is ever long."""
    handler.send(200, b"", size=1 << 20)
    while not handler.stand_in.closing.wait(0.02):
        handler.wfile.write(b" ")


def _cut(handler: _Handler) -> None:
    handler.send(200, b'{"choices": [{"index', size=4_096)
    handler.close_connection = True


def _not_json(handler: _Handler) -> None:
    handler.send(200, b"<html>Bad gateway</html>")


def _empty(handler: _Handler) -> None:
    handler.answer(200, {"type": "message", "model": "scripted-obedient", "choices": []})


def _schema(handler: _Handler) -> None:
    wrong = {"choices": [{"message": {"content": 7}}], "type": "message", "content": [7]}
    handler.answer(200, wrong)


def _huge(handler: _Handler) -> None:
    handler.send(200, b'"' + b"x" * (MAX_BODY + 1) + b'"')


def _packed(handler: _Handler) -> None:
    handler.send(
        200, gzip.compress(b'"' + b"x" * 4_096 + b'"'), headers={"content-encoding": "gzip"}
    )


def _redirect(handler: _Handler) -> None:
    handler.send(307, b"", headers={"location": "/elsewhere"})


def _key(handler: _Handler) -> None:
    """Refuse the key and repeat it, as some servers do."""
    told = handler.headers.get("authorization", "") + handler.headers.get("x-api-key", "")
    handler.answer(401, handler.stand_in.error(f"wrong key {told}", "authentication_error"))


_FAULTS: dict[str, Callable[[_Handler], None]] = {
    "429": _busy,
    "500": _broken,
    "timeout": _silent,
    "drip": _drip,
    "cut": _cut,
    "not-json": _not_json,
    "empty": _empty,
    "schema": _schema,
    "huge": _huge,
    "packed": _packed,
    "redirect": _redirect,
    "key": _key,
}
