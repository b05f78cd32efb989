# SPDX-License-Identifier: Apache-2.0
"""HTTP/1.1 as far as a witness speaks it: bytes in, requests out, and the bytes of an answer.

Strict, bounded, without I/O. What is not understood ends the connection: two readers of one
request must not see two requests. Spec page: docs/spec/witness.md#http
"""

from __future__ import annotations

import re
from http import HTTPStatus

from msgspec import Struct

from authguard_r.witness.rules import MAX_BYTES

#: Longest request line and headers, in bytes.
MAX_HEAD = 1 << 13
_END = b"\r\n\r\n"
_TOKEN = re.compile(r"[!#$%&'*+.^_`|~0-9A-Za-z-]+")
_TARGET = re.compile(r"[!-~]+")
_VALUE = re.compile(r"[\t -~\x80-\xff]*")
_LENGTH = re.compile(r"[0-9]{1,9}")
_VERSIONS = {"HTTP/1.0": False, "HTTP/1.1": True}


class HttpRequest(Struct, frozen=True, kw_only=True):
    """A whole request.

    Args:
        method: as it was sent.
        target: as it was sent.
        body: as long as its length said.
        stays: the connection is kept for the next one.
    """

    method: str
    target: str
    body: bytes
    stays: bool


class Broken(Struct, frozen=True):
    """Bytes that are no request that is read here; the connection ends after the answer.

    Args:
        status: what to say.
    """

    status: int


class _Head(Struct, frozen=True, kw_only=True):
    method: str
    target: str
    length: int
    stays: bool
    expects: bool


class RequestReader:
    """Makes requests of one connection's bytes; holds no more than one of them and what came on."""

    def __init__(self) -> None:
        self._data = bytearray()
        self._head: _Head | None = None
        #: The sender waits for permission to go on (`Expect: 100-continue`).
        self.waits = False

    @property
    def is_empty(self) -> bool:
        """True when nothing of a next request has come."""
        return not self._data and self._head is None

    def feed(self, data: bytes) -> None:
        """Take what came."""
        self._data += data

    def next(self) -> HttpRequest | Broken | None:
        """Return the next request, what is wrong with it, or None until more comes."""
        if self._head is None:
            end = self._data.find(_END, 0, MAX_HEAD)
            if end < 0:
                return Broken(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE) if self._is_long else None
            read = _read_head(bytes(self._data[:end]))
            if isinstance(read, Broken):
                return read
            del self._data[: end + len(_END)]
            self._head = read
            self.waits = read.expects
        return self._whole(self._head)

    @property
    def _is_long(self) -> bool:
        return len(self._data) >= MAX_HEAD

    def _whole(self, head: _Head) -> HttpRequest | None:
        if len(self._data) < head.length:
            return None
        body = bytes(self._data[: head.length])
        del self._data[: head.length]
        self._head, self.waits = None, False
        return HttpRequest(method=head.method, target=head.target, body=body, stays=head.stays)


def answer_bytes(
    status: int, content: str, body: bytes, *, stays: bool, bodiless: bool = False
) -> bytes:
    """Return an answer's bytes.

    Args:
        status: its number.
        content: the body's type.
        body: what is sent.
        stays: the connection is kept.
        bodiless: the request was `HEAD`: the body is only counted.
    """
    lines = [
        f"HTTP/1.1 {status} {HTTPStatus(status).phrase}",
        f"Content-Type: {content}",
        f"Content-Length: {len(body)}",
        "Cache-Control: no-store",
        *(["Allow: POST"] if status == HTTPStatus.METHOD_NOT_ALLOWED else []),
        f"Connection: {'keep-alive' if stays else 'close'}",
    ]
    return "\r\n".join(lines).encode("ascii") + _END + (b"" if bodiless else body)


def _read_head(data: bytes) -> _Head | Broken:
    first, *lines = data.decode("latin-1").split("\r\n")
    words = first.split(" ")
    if len(words) != 3 or not _TOKEN.fullmatch(words[0]) or not _TARGET.fullmatch(words[1]):
        return Broken(HTTPStatus.BAD_REQUEST)
    if words[2] not in _VERSIONS:
        return Broken(HTTPStatus.HTTP_VERSION_NOT_SUPPORTED)
    headers = _headers(lines)
    if headers is None:
        return Broken(HTTPStatus.BAD_REQUEST)
    if "transfer-encoding" in headers:
        return Broken(HTTPStatus.NOT_IMPLEMENTED)
    length = headers.get("content-length", "" if words[0] == "POST" else "0")
    if not _LENGTH.fullmatch(length):
        return Broken(HTTPStatus.BAD_REQUEST if length else HTTPStatus.LENGTH_REQUIRED)
    if int(length) > MAX_BYTES:
        return Broken(HTTPStatus.REQUEST_ENTITY_TOO_LARGE)
    wants = {word.strip().lower() for word in headers.get("connection", "").split(",")}
    is_new = _VERSIONS[words[2]]
    return _Head(
        method=words[0],
        target=words[1],
        length=int(length),
        stays=is_new and "close" not in wants,
        expects=is_new and headers.get("expect", "").lower() == "100-continue",
    )


def _headers(lines: list[str]) -> dict[str, str] | None:
    """Return headers by their names in lower case; None when one is not valid, or comes twice."""
    found: dict[str, str] = {}
    for line in lines:
        name, colon, value = line.partition(":")
        key = name.lower()
        if not colon or not _TOKEN.fullmatch(name) or not _VALUE.fullmatch(value):
            return None
        if key in found and key in {"content-length", "transfer-encoding", "host"}:
            return None
        found[key] = value.strip("\t ")
    return found
