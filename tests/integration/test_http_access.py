# SPDX-License-Identifier: Apache-2.0
"""Who may ask a decision point, by which way, and what is done with everybody else.

Source: docs/spec/http.md#who-may-ask
"""

from __future__ import annotations

import shutil
import socket
import ssl
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx2
import pytest

from authguard_r.authoring.keys.setup import demo_members, init_folder
from authguard_r.cli import call
from authguard_r.keys.algorithms import Algorithm
from authguard_r.wire.messages import Mode
from fixtures import commands, scenarios
from fixtures.decision_point import (
    BEARER,
    EVALUATION,
    GRANTED,
    TOKEN,
    Served,
    options,
    server_certificate,
    serving,
    tls_words,
    token_file,
    trusting,
)
from fixtures.gate_process import PATIENCE_S, RunningGate, until


@pytest.fixture(scope="module")
def gate() -> Iterator[RunningGate]:
    with RunningGate(simulate=True) as running:
        running.activate()
        yield running


@pytest.fixture(scope="module")
def plain(gate: RunningGate) -> Iterator[Served]:
    with serving(gate) as served:
        yield served


def shown(name: str, folder: Path | None = None) -> ssl.SSLContext:
    """Return what a client of this name shows and trusts."""
    key = (folder or scenarios.trust_folder()) / "keys" / name
    return trusting(Path(f"{key}.cert.pem"), Path(f"{key}.key.pem"))


@pytest.mark.smoke
@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"authorization": "Bearer x"},
        {"authorization": TOKEN},
        {"authorization": f"bearer {TOKEN}"},
        {"authorization": f"Bearer {TOKEN[:-1]}"},
        {"authorization": f"Basic {TOKEN}"},
        {"x-authorization": f"Bearer {TOKEN}"},
        {"cookie": f"token={TOKEN}"},
    ],
)
def test_without_the_token_nobody_learns_anything(plain: Served, headers: dict[str, str]) -> None:
    with plain.client(headers=headers) as client:
        for path in ("/openapi.json", "/v1/status", "/nowhere", f"/v1/status?token={TOKEN}"):
            answer = client.get(path)
            assert (answer.status_code, answer.headers["www-authenticate"]) == (401, "Bearer")
            assert answer.json()["code"] == "TOKEN_INVALID"
        assert client.post(EVALUATION, json=GRANTED).status_code == 401


def test_a_token_that_is_shown_twice_is_none(plain: Served) -> None:
    with plain.client(headers={}) as client:
        twice = [("authorization", f"Bearer {TOKEN}")] * 2
        assert client.get("/v1/status", headers=twice).status_code == 401


def test_a_page_of_somebody_elses_cannot_ask(plain: Served) -> None:
    """DNS rebinding: the browser's request names the page's own host, and its origin."""
    for host in ("evil.example", "127.0.0.1", "localhost:1", ""):
        assert plain.get("/v1/status", headers={"host": host}).status_code == 421
    port = plain.address[1]
    for host in (f"127.0.0.1:{port}", f"LOCALHOST:{port}", f"[::1]:{port}"):
        assert plain.get("/v1/status", headers={"host": host}).status_code == 200
    for origin in ("https://evil.example", plain.url, "null"):
        answer = plain.get("/v1/status", headers={"origin": origin})
        assert (answer.status_code, answer.json()["code"]) == (403, "ORIGIN_DENIED")
        assert not [name for name in answer.headers if name.startswith("access-control")]


def raw(served: Served, data: bytes, *, context: ssl.SSLContext | None = None) -> bytes:
    """Return everything that is answered to these bytes until the server hangs up."""
    made = socket.create_connection(served.address, timeout=PATIENCE_S)
    if context is not None:
        made = context.wrap_socket(made, server_hostname="127.0.0.1")
    with made as sock:
        sock.sendall(data)
        found = b""
        try:
            while got := sock.recv(1 << 16):
                found += got
        except ConnectionResetError:
            pass
        return found


def head(served: Served, *lines: str) -> bytes:
    host, port = served.address
    said = [*lines, f"Host: {host}:{port}", f"Authorization: Bearer {TOKEN}"]
    return ("\r\n".join(said) + "\r\n").encode()


def test_slow_and_long_heads_and_bodies_are_let_go(plain: Served) -> None:
    assert raw(plain, head(plain, "GET /v1/status HTTP/1.1")) == b""  # it never ends
    long = head(plain, "GET /v1/status HTTP/1.1", "Connection: close", "X: " + "x" * 40_000)
    long += b"\r\n"
    assert b" 431 " in raw(plain, long).split(b"\r\n")[0]
    assert b" 400 " in raw(plain, long[:-4]).split(b"\r\n")[0]  # nobody waits for its end
    body = "Content-Type: application/json\r\nContent-Length: 50"
    slow = head(plain, f"POST {EVALUATION} HTTP/1.1", body) + b"\r\n{"
    assert b" 408 " in raw(plain, slow).split(b"\r\n")[0]
    assert plain.get("/v1/status").status_code == 200


def test_a_client_that_goes_in_mid_body_leaves_nothing(plain: Served) -> None:
    body = "Content-Type: application/json\r\nContent-Length: 50"
    with socket.create_connection(plain.address, timeout=PATIENCE_S) as wire:
        wire.sendall(head(plain, f"POST {EVALUATION} HTTP/1.1", body) + b"\r\n{")
    lines = lambda: [r for r in plain.requests() if r["path"] == EVALUATION][-1:]  # noqa: E731
    line = until(lambda: [r for r in lines() if r["status"] == 400], "its line")[0]
    assert line["code"] == "MALFORMED"


def test_what_is_no_http_is_refused(plain: Served) -> None:
    assert b" 400 " in raw(plain, b"\x16\x03\x01nonsense\r\n\r\n").split(b"\r\n")[0]
    with pytest.raises((httpx2.ConnectError, httpx2.ReadError)):
        httpx2.get(plain.url.replace("http:", "https:"), verify=trusting())


def test_what_is_no_tls_is_let_go_and_older_tls_too(gate: RunningGate) -> None:
    with serving(gate, *tls_words()) as served:
        assert served.url.startswith("https://")
        said = raw(served, head(served, "GET /v1/status HTTP/1.1") + b"\r\n")
        assert b"HTTP" not in said
        older = trusting()
        older.maximum_version = ssl.TLSVersion.TLSv1_2
        with pytest.raises(httpx2.ConnectError):
            httpx2.get(f"{served.url}/v1/status", verify=older)
        with served.client(verify=trusting()) as client:
            for _ in range(2):
                assert client.get("/v1/status").status_code == 200
            long = client.get("/v1/records?count=1000")
            assert long.status_code == 200
            # behind TLS a name of any kind can lead here: the certificate says whose it is
            assert client.get("/v1/status", headers={"host": "pdp.example"}).status_code == 200
        with served.client(headers={}, verify=trusting()) as client:
            assert client.get("/v1/status").status_code == 401
        again = head(served, "GET /v1/status HTTP/1.1", "Connection: close") + b"\r\n"
        assert b" 200 " in raw(served, again, context=trusting()).split(b"\r\n")[0]


def test_a_certificate_of_the_trust_set_up_says_who_asks(gate: RunningGate) -> None:
    more = (*tls_words(), "--client-certificates")
    with serving(gate, *more, token=False) as served:
        with served.client(headers={}, verify=shown("operator-1")) as client:
            assert client.post(EVALUATION, json=GRANTED).status_code == 200
        assert until(served.requests, "its line")[-1]["who"] == "operator-1"
        for name, who in (("supervisor-1", 200), ("estimator-courier-1", 403)):
            with served.client(headers={}, verify=shown(name)) as client:
                assert client.get("/v1/status").status_code == who, name
        with (
            served.client(headers={"x-client": "operator-1"}, verify=trusting()) as client,
            pytest.raises((httpx2.ReadError, httpx2.RemoteProtocolError)),
        ):
            client.get("/v1/status")


def test_a_certificate_of_another_root_is_nobodys(gate: RunningGate, tmp_path: Path) -> None:
    foreign = tmp_path / "trust"
    init_folder(foreign, demo_members(scenarios.site(), (scenarios.RID,)), now=datetime.now(UTC))
    with (
        serving(gate, *tls_words(), "--client-certificates", token=False) as served,
        served.client(headers={}, verify=shown("operator-1", foreign)) as client,
    ):
        answer = client.get("/v1/status")
        assert (answer.status_code, answer.json()["where"]) == (401, "certificate")
        # it is the client's to send any chain: a leaf that it has no key of gets nowhere
        server = trusting(*server_certificate())
        with served.client(headers={}, verify=server) as other:
            assert other.get("/v1/status").status_code == 401


def test_a_revoked_certificate_ends_with_the_next_request(tmp_path: Path) -> None:
    copied = tmp_path / "trust"
    shutil.copytree(scenarios.trust_folder(), copied)
    with RunningGate(simulate=True, rid=scenarios.OTHER, trust=copied) as gate:
        more = (*tls_words(), "--client-certificates", "--client-role", "operator")
        with (
            serving(gate, *more, token=False) as served,
            served.client(headers={}, verify=shown("operator-2", copied)) as client,
        ):
            assert client.get("/v1/status").status_code == 200
            assert call(["keys", "revoke", str(copied), "operator-2"]) == 0
            answer = client.get("/v1/status")  # on the same connection
            assert (answer.status_code, answer.json()["code"]) == (401, "CERTIFICATE_REVOKED")
            with served.client(headers={}, verify=shown("supervisor-1", copied)) as other:
                assert other.get("/v1/status").json()["code"] == "ROLE_DENIED"


def test_token_and_certificate_are_both_asked_for_where_both_are_configured(
    gate: RunningGate,
) -> None:
    with serving(gate, *tls_words(), "--client-certificates") as served:
        for headers, status in ((BEARER, 200), ({}, 401)):
            with served.client(headers=headers, verify=shown("operator-1")) as client:
                assert client.get("/v1/status").status_code == status


def refused(gate: RunningGate, *more: object, token: bool = True) -> tuple[int, str]:
    """Return exit code and message of a server that does not come."""
    done = commands.ended(*options(gate, *more, token=token))
    return done.code, done.out + done.err


def test_nothing_is_served_wider_than_this_machine_without_tls(gate: RunningGate) -> None:
    for address in ("0.0.0.0:0", "[::]:0", "192.0.2.1:0"):
        code, said = refused(gate, "--listen", address)
        assert code == 4
        assert "--tls-cert" in said
    code, said = refused(gate, "--listen", "0.0.0.0:0", *tls_words())
    assert (code, "--url" in said) == (2, True)


@pytest.mark.parametrize(
    ("more", "token", "place"),
    [
        ((), False, "--token-file"),
        (("--client-certificates",), True, "--client-certificates"),
        (("--client-role", "operator"), True, "--client-role"),
        (("--tls-cert", "x"), True, "--tls-cert"),
        (("--shadow", "--propose"), True, "--propose"),
    ],
)
def test_what_does_not_go_together_is_said(
    gate: RunningGate, more: Any, token: bool, place: str
) -> None:
    code, said = refused(gate, *more, token=token)
    assert (code, place in said) == (2, True)


def test_a_secret_that_others_can_read_is_none(gate: RunningGate, tmp_path: Path) -> None:
    cert, key = server_certificate()
    open_key = tmp_path / "open.key"
    shutil.copy(key, open_key)
    open_key.chmod(0o640)
    code, said = refused(gate, "--tls-cert", cert, "--tls-key", open_key)
    assert (code, "chmod 600" in said) == (5, True)
    code, said = refused(gate, "--tls-cert", cert, "--tls-key", token_file(gate))
    assert (code, "--tls-cert" in said) == (4, True)


def test_a_set_up_of_two_roots_is_served_by_token_alone(gate: RunningGate, tmp_path: Path) -> None:
    both = tmp_path / "trust"
    init_folder(
        both,
        demo_members(scenarios.site(), (scenarios.RID,)),
        now=datetime.now(UTC),
        algorithms=(Algorithm.ED25519, Algorithm.ML_DSA_65),
    )
    more = ("--trust", both, *tls_words(), "--client-certificates")
    code, said = refused(gate, *more, token=False)
    assert (code, "--token-file" in said) == (5, True)


def test_a_gate_of_another_root_or_mode_is_not_asked(gate: RunningGate, tmp_path: Path) -> None:
    foreign = tmp_path / "trust"
    init_folder(foreign, demo_members(scenarios.site(), (scenarios.RID,)), now=datetime.now(UTC))
    assert refused(gate, "--trust", foreign)[0] == 4
    assert refused(gate, "--robot", scenarios.OTHER)[0] == 4
    code, said = refused(gate, "--shadow")
    assert (code, "enforce" in said) == (1, True)
    with RunningGate(mode=Mode.SHADOW, simulate=True, rid=scenarios.OTHER) as shadow:
        assert refused(shadow)[0] == 1
