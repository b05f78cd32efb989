# SPDX-License-Identifier: Apache-2.0
"""One request to a model's server: its end in time, its address, and strange replies."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from pytest_httpserver import HTTPServer
from werkzeug import Response

from authguard_r.authoring.model_client.exchange import (
    FaultKind,
    ModelAddress,
    ModelServerError,
    exchange,
    library,
    retried,
)
from authguard_r.authoring.model_client.protocols import OpenAIProtocol

KEY = "sk-test-not-a-secret-0123"


@pytest.fixture(autouse=True)
def key(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TEST_MODEL_KEY", KEY)


def send(base_url: str, *, within_s: float = 5.0) -> bytes:
    """Send one request of the chat completions protocol."""
    address = ModelAddress(base_url=base_url, model="m", timeout_s=5.0)
    return exchange(
        address,
        library("openai"),
        lambda web: OpenAIProtocol().post(
            library("openai"), web, address, {"model": "m", "messages": []}
        ),
        headers={"authorization": "Bearer none"},
        ends=time.monotonic() + within_s,
    )


@contextmanager
def dripping(first: bytes) -> Iterator[tuple[int, list[int]]]:
    """Yield a port that answers with `first` and then byte by byte, and the count of bytes."""
    sent, done = [0], threading.Event()

    def serve() -> None:
        wire, _ = listener.accept()
        with wire:
            try:
                wire.sendall(first)
                while sent[0] < 600 and not done.wait(0.05):
                    wire.sendall(b"x")
                    sent[0] += 1
            except OSError:  # the client has gone
                return

    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = threading.Thread(target=serve)
        thread.start()
        yield listener.getsockname()[1], sent
        done.set()
        thread.join()


@pytest.mark.parametrize(
    ("scheme", "first"),
    [
        ("http", b"HTTP/1.1 200 OK\r\nX-Long: "),
        ("https", b"\x16\x03\x03\x40\x00"),  # a TLS record of 16 KiB begins
    ],
)
def test_headers_or_a_handshake_that_drip_are_left_in_time(scheme: str, first: bytes) -> None:
    with dripping(first) as (port, sent):
        with pytest.raises(ModelServerError) as failed:
            send(f"{scheme}://127.0.0.1:{port}/v1", within_s=0.5)
        assert sent[0] < 100
    assert failed.value.kind is FaultKind.LATE


def test_a_connection_that_comes_too_late_sends_nothing(httpserver: HTTPServer) -> None:
    with pytest.raises(ModelServerError) as failed:
        send(httpserver.url_for("/v1"), within_s=-1)
    assert failed.value.kind is FaultKind.LATE
    assert httpserver.log == []


@pytest.mark.parametrize(
    "base_url",
    [
        "http://1.2.3.400/v1",
        "http://[::1]x/",
        "\thttp://127.0.0.1/v1",
        "ht\ntp://127.0.0.1/v1",
        "http://me@127.0.0.1/v1",
        "http://127.0.0.1/v1?key=x",
        "file:///etc/passwd",
        "",
    ],
)
def test_what_is_no_bare_http_address_is_refused(base_url: str) -> None:
    with pytest.raises(ModelServerError) as refused:
        ModelAddress(base_url=base_url, model="m").require()
    assert refused.value.kind is FaultKind.ADDRESS


@pytest.mark.parametrize("base_url", ["http://models.example/v1", "HTTP://models.example/v1"])
def test_a_key_does_not_travel_in_the_clear(base_url: str) -> None:
    with pytest.raises(ModelServerError) as refused:
        ModelAddress(base_url=base_url, model="m", key_env="TEST_MODEL_KEY").require()
    assert refused.value.kind is FaultKind.CLEARTEXT
    ModelAddress(base_url=base_url, model="m").require()


@pytest.mark.parametrize("status", [200, 400])
@pytest.mark.parametrize(
    ("body", "kind"),
    [
        (b'{"error":"\xff"}', "application/json"),
        (b'{"error":"x"}', "application/json; charset=rot13"),
        (b'{"error":"x"}', "application/json; charset=zlib"),
        (b"[" * 100_000, "application/json"),
    ],
)
def test_a_strange_reply_is_a_fault_of_the_server(
    status: int, body: bytes, kind: str, httpserver: HTTPServer
) -> None:
    strange = Response(body, status=status, headers={"Content-Type": kind})
    httpserver.expect_request("/v1/chat/completions").respond_with_response(strange)
    with pytest.raises(ModelServerError) as failed:
        OpenAIProtocol().read(send(httpserver.url_for("/v1")))
    assert failed.value.kind in {FaultKind.PROTOCOL, FaultKind.REFUSED}


def test_no_attempt_begins_after_the_time_is_over() -> None:
    pauses: list[float] = []

    def fail() -> None:
        raise ModelServerError("busy", FaultKind.LIMIT, passing=True, wait_s=30.0)

    with pytest.raises(ModelServerError) as failed:
        retried(fail, retries=5, ends=time.monotonic() + 20, pause=pauses.append)
    assert (failed.value.attempts, pauses) == (1, [])
