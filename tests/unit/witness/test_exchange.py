# SPDX-License-Identifier: Apache-2.0
"""Two readers of one request must not see two requests: what is doubtful ends the connection."""

from __future__ import annotations

import http.client
import io
import random

import pytest

from authguard_r.witness.exchange import MAX_HEAD, Broken, HttpRequest, RequestReader, answer_bytes
from authguard_r.witness.rules import MAX_BYTES
from fixtures.cases import case

POST = b"POST /add-checkpoint HTTP/1.1\r\nHost: w\r\nContent-Length: 3\r\n\r\nabc"


def read(data: bytes) -> HttpRequest | Broken | None:
    reader = RequestReader()
    reader.feed(data)
    return reader.next()


def test_a_request_is_read_however_it_is_cut() -> None:
    expected = HttpRequest(method="POST", target="/add-checkpoint", body=b"abc", stays=True)
    assert read(POST) == expected
    reader = RequestReader()
    for byte in POST[:-1]:
        reader.feed(bytes([byte]))
        assert reader.next() is None
        assert not reader.is_empty
    reader.feed(POST[-1:])
    assert reader.next() == expected
    assert reader.is_empty


def test_requests_on_one_line_are_read_in_order() -> None:
    reader = RequestReader()
    reader.feed(POST + POST.replace(b"abc", b"def") + b"GET / HTTP/1.1\r\n\r\n")
    found = [reader.next() for _ in range(4)]
    assert [one.body for one in found if isinstance(one, HttpRequest)] == [b"abc", b"def", b""]
    assert found[3] is None


BROKEN: dict[bytes, int] = {
    b"\r\n\r\n": 400,
    b"POST\r\n\r\n": 400,
    b"POST  / HTTP/1.1\r\n\r\n": 400,
    b"P(ST / HTTP/1.1\r\n\r\n": 400,
    b"POST /\x00 HTTP/1.1\r\n\r\n": 400,
    b"POST /\xff HTTP/1.1\r\n\r\n": 400,
    b"POST / HTTP/1.1 \r\n\r\n": 400,
    b"POST / HTTP/2.0\r\n\r\n": 505,
    b"\x16\x03\x01\x02\x00\r\n\r\n": 400,
    b"GET / HTTP/1.1\r\nno colon\r\n\r\n": 400,
    b"GET / HTTP/1.1\r\n: x\r\n\r\n": 400,
    b"GET / HTTP/1.1\r\nA : x\r\n\r\n": 400,
    b"GET / HTTP/1.1\r\nA: x\r\n folded\r\n\r\n": 400,
    b"GET / HTTP/1.1\r\nA: x\ny\r\n\r\n": 400,
    b"GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n": 400,
    b"POST / HTTP/1.1\r\n\r\n": 411,
    b"POST / HTTP/1.1\r\nContent-Length: 3\r\nContent-Length: 3\r\n\r\n": 400,
    b"POST / HTTP/1.1\r\nContent-Length: -3\r\n\r\n": 400,
    b"POST / HTTP/1.1\r\nContent-Length: +3\r\n\r\n": 400,
    b"POST / HTTP/1.1\r\nContent-Length: 3, 3\r\n\r\n": 400,
    b"POST / HTTP/1.1\r\nContent-Length: 0x3\r\n\r\n": 400,
    b"POST / HTTP/1.1\r\nContent-Length: \xb2\r\n\r\n": 400,
    b"POST / HTTP/1.1\r\nContent-Length: 9999999999\r\n\r\n": 400,
    b"POST / HTTP/1.1\r\nContent-Length: %d\r\n\r\n" % (MAX_BYTES + 1): 413,
    b"POST / HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n": 501,
    b"POST / HTTP/1.1\r\nTransfer-Encoding: chunked\r\nContent-Length: 3\r\n\r\n": 501,
    b"GET / HTTP/1.1\r\nA: " + b"x" * MAX_HEAD: 431,
    b"x" * MAX_HEAD: 431,
    b"x" * MAX_HEAD + b"\r\n\r\n": 431,
}


def test_what_is_doubtful_is_refused() -> None:
    for data, value in BROKEN.items():
        with case(data):
            assert read(data) == Broken(value)


def test_the_near_misses_are_read() -> None:
    whole = b"POST / HTTP/1.1\r\nCONTENT-LENGTH:\t3 \r\nA: \xe4\r\nA: again\r\n\r\nabc"
    assert read(whole) == HttpRequest(method="POST", target="/", body=b"abc", stays=True)
    most = b"POST / HTTP/1.1\r\nContent-Length: %d\r\n\r\n" % MAX_BYTES
    assert read(most) is None
    assert isinstance(read(most + b"x" * MAX_BYTES), HttpRequest)
    line = b"GET / HTTP/1.1\r\nA: %s\r\n\r\n"
    assert isinstance(read(line % (b"x" * (MAX_HEAD - len(line) + 2))), HttpRequest)
    assert read(b"x" * (MAX_HEAD - 1)) is None


@pytest.mark.parametrize(
    ("head", "stays"),
    [
        (b"HTTP/1.1", True),
        (b"HTTP/1.1\r\nConnection: Keep-Alive", True),
        (b"HTTP/1.1\r\nConnection: x, Close", False),
        (b"HTTP/1.0", False),
        (b"HTTP/1.0\r\nConnection: keep-alive", False),
    ],
)
def test_a_connection_stays_as_http_says(head: bytes, stays: bool) -> None:
    found = read(b"GET / " + head + b"\r\n\r\n")
    assert isinstance(found, HttpRequest)
    assert found.stays is stays


def test_who_waits_to_go_on_is_known_until_it_went_on() -> None:
    reader = RequestReader()
    head = b"POST / HTTP/1.1\r\nExpect: 100-Continue\r\nContent-Length: 1\r\n\r\n"
    reader.feed(head)
    assert reader.next() is None
    assert reader.waits
    reader.feed(b"x")
    assert isinstance(reader.next(), HttpRequest)
    assert not reader.waits
    reader.feed(head.replace(b"1.1", b"1.0"))
    assert reader.next() is None
    assert not reader.waits


@pytest.mark.parametrize(("status", "body"), [(200, b"x\n"), (405, b""), (422, b"no\n")])
def test_an_answer_is_read_by_another_reader(status: int, body: bytes) -> None:
    class Link:
        def __init__(self, data: bytes) -> None:
            self._data = data

        def makefile(self, *_: object) -> io.BytesIO:
            return io.BytesIO(self._data)

    data = answer_bytes(status, "text/plain", body, stays=status != 405)
    got = http.client.HTTPResponse(Link(data))  # type: ignore[arg-type]
    got.begin()
    assert (got.status, got.read(), got.headers["Content-Type"]) == (status, body, "text/plain")
    assert got.headers["Allow"] == ("POST" if status == 405 else None)
    assert got.headers["Connection"] == ("close" if status == 405 else "keep-alive")
    bodiless = answer_bytes(status, "text/plain", body, stays=True, bodiless=True)
    assert bodiless.endswith(b"\r\n\r\n")
    assert b"Content-Length: %d\r\n" % len(body) in bodiless


def test_no_bytes_at_all_make_a_traceback_or_fill_the_memory() -> None:
    dice = random.Random(7)
    for _ in range(3_000):
        data = bytearray(POST * 2)
        for _ in range(dice.randrange(1, 6)):
            data[dice.randrange(len(data))] = dice.choice(b"\r\n :0/\x00\xff\tP")
        reader = RequestReader()
        reader.feed(bytes(data))
        while isinstance(found := reader.next(), HttpRequest):
            assert len(found.body) <= MAX_BYTES
