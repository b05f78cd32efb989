# SPDX-License-Identifier: Apache-2.0
"""A decision point as it runs: `authguard serve` before a gate of a test, and clients of it.

with RunningGate(estimator=True, robot=True) as gate, serving(gate) as served:
    served.post("/access/v1/evaluation", question("scan"))
"""

from __future__ import annotations

import json
import signal
import ssl
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from functools import cache
from ipaddress import ip_address
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import httpx2
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, generate_private_key
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import NameOID

import worlds
from authguard_r.wire.messages import ClientRole
from gates import PATIENCE_S, RunningGate, authguard, environment, until

TOKEN = "t" * 40
BEARER = {"authorization": f"Bearer {TOKEN}"}
EVALUATION, EVALUATIONS = "/access/v1/evaluation", "/access/v1/evaluations"


def question(name: str, rid: str = worlds.RID, **arguments: Any) -> dict[str, Any]:
    """Return a question of the Authorization API."""
    return {
        "subject": {"type": "agent", "id": "planner-7"},
        "action": {"name": name, "properties": arguments},
        "resource": {"type": "robot", "id": rid},
    }


GRANTED = question("navigate_to", destination="Pharmacy")
HIJACKED = question("navigate_to", destination="Isolation Room")


class Served:
    """A decision point's process, and clients of it."""

    def __init__(self, process: subprocess.Popen[bytes], lines: Path) -> None:
        self.process, self._lines = process, lines
        self.url = str(until(self._serving, "the port")["url"])

    def _serving(self) -> dict[str, Any]:
        if self.process.poll() is not None:
            raise AssertionError(self._lines.read_text())
        return next((line for line in self.lines() if line["event"] == "serving"), {})

    @property
    def address(self) -> tuple[str, int]:
        """Where it listens."""
        host, port = self.url.split("//")[1].rsplit(":", 1)
        return host, int(port)

    def text(self) -> str:
        """Return its whole log."""
        return self._lines.read_text()

    def lines(self) -> list[dict[str, Any]]:
        """Return every whole line of its log."""
        whole, _, _ = self.text().rpartition("\n")
        return [json.loads(line) for line in whole.splitlines()]

    def requests(self) -> list[dict[str, Any]]:
        """Return the line of each request."""
        return [line for line in self.lines() if line["event"] == "request"]

    def client(self, *, headers: dict[str, str] | None = None, **more: Any) -> httpx2.Client:
        """Return a client that shows the token, unless it is told what to show."""
        shown = BEARER if headers is None else headers
        return httpx2.Client(base_url=self.url, headers=shown, timeout=PATIENCE_S, **more)

    def get(self, path: str, **more: Any) -> httpx2.Response:
        """Ask once."""
        with self.client() as client:
            return client.get(path, **more)

    def post(self, path: str, body: Any, **more: Any) -> httpx2.Response:
        """Ask once; bytes are sent as they are."""
        with self.client() as client:
            if not isinstance(body, bytes):
                return client.post(path, json=body, **more)
            headers = {"content-type": "application/json", **more.pop("headers", {})}
            return client.post(path, content=body, headers=headers, **more)

    def end(self) -> int:
        """End it; return its exit code."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        return self.process.wait(PATIENCE_S)


def words(gate: RunningGate, *more: object, token: bool = True) -> list[str]:
    """Return the command of a decision point before a gate."""
    said = authguard("serve", "--robot", gate.rid, "--run", gate.run, "--trust", gate.trust, *more)
    return [*said, *(("--token-file", str(token_file(gate))) if token else ())]


def token_file(gate: RunningGate) -> Path:
    """Return a file with the token."""
    path = gate.folder / "token"
    if not path.exists():
        path.write_text(TOKEN)
        path.chmod(0o600)
    return path


def starts(gate: RunningGate) -> list[int]:
    """Return how often each grant was used."""
    with gate.client(ClientRole.AUDITOR, "counts") as auditor:
        return [grant["starts"] for grant in auditor.status()["mission"]["grants"]]


@contextmanager
def serving(gate: RunningGate, *more: object, token: bool = True) -> Iterator[Served]:
    """Serve on a free port; ended, and looked at, when this ends."""
    folder = Path(mkdtemp(prefix="served-", dir=gate.folder))
    with (folder / "log").open("wb") as log:
        process = subprocess.Popen(
            words(gate, *more, token=token),
            stdin=subprocess.DEVNULL,
            stderr=log,
            env=environment(measured=False),
            cwd=worlds.ROOT,
        )
    try:
        served = Served(process, folder / "log")
        yield served
        assert served.end() == 0, served.text()
    finally:
        if process.poll() is None:
            process.kill()
        process.wait(PATIENCE_S)


@cache
def server_certificate() -> tuple[Path, Path]:
    """Return a server's certificate for loopback, of no root but itself, and its key."""
    folder = Path(mkdtemp(prefix="authguard-tls-"))
    key = generate_private_key(SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "decision point")])
    now = datetime.now(UTC)
    names = x509.SubjectAlternativeName([x509.IPAddress(ip_address("127.0.0.1"))])
    made = (
        x509.CertificateBuilder(name, name, key.public_key(), x509.random_serial_number())
        .not_valid_before(now - timedelta(hours=1))
        .not_valid_after(now + timedelta(hours=12))
        .add_extension(names, critical=False)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .sign(key, SHA256())
    )
    cert, secret = folder / "server.pem", folder / "server.key"
    cert.write_bytes(made.public_bytes(Encoding.PEM))
    form = (Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    secret.write_bytes(key.private_bytes(*form))
    secret.chmod(0o600)
    return cert, secret


def tls_words() -> tuple[object, ...]:
    """Return the options that serve with TLS."""
    cert, key = server_certificate()
    return ("--tls-cert", cert, "--tls-key", key)


def trusting(cert: Path | None = None, key: Path | None = None) -> ssl.SSLContext:
    """Return what a client needs: the server's certificate, and perhaps one of its own."""
    context = ssl.create_default_context(cafile=str(server_certificate()[0]))
    if cert is not None:
        context.load_cert_chain(cert, key)
    return context
