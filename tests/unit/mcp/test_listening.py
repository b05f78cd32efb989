# SPDX-License-Identifier: Apache-2.0
"""A port of this machine, for whoever knows the token, and for nobody else."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import MutableMapping
from pathlib import Path
from typing import Any

import pytest

from authguard_r.core.errors import EnvironmentFault, MalformedError
from authguard_r.mcp.listening import guarded, listening, read_bearer

TOKEN = b"a" * 40


def kept(tmp_path: Path, text: str, mode: int = 0o600) -> Path:
    path = tmp_path / "token"
    path.write_text(text)
    path.chmod(mode)
    return path


def test_a_token_is_one_word_of_a_file_that_its_owner_alone_reads(tmp_path: Path) -> None:
    assert read_bearer(kept(tmp_path, "a" * 40 + "\n")) == TOKEN
    with pytest.raises(EnvironmentFault, match="chmod 600"):
        read_bearer(kept(tmp_path, "a" * 40, 0o644))


@pytest.mark.parametrize("text", ["", "short", "a" * 21, "a" * 20 + " " + "b" * 20, "\u00e9" * 30])
def test_what_is_no_secret_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(MalformedError, match="at least 22 letters and digits"):
        read_bearer(kept(tmp_path, text))


@pytest.mark.parametrize(
    "address", ["0.0.0.0:0", "192.0.2.1:80", "[::]:0", "localhost:1", "127.0.0.1", "127.0.0.1:x",
                "127.0.0.1:70000"]
)  # fmt: skip
def test_nothing_listens_wider_than_this_machine(address: str) -> None:
    with pytest.raises(MalformedError) as refused:
        listening(address)
    assert refused.value.where == "--listen"


@pytest.mark.parametrize("address", ["127.0.0.1:0", "[::1]:0"])
def test_a_port_that_is_taken_is_said_so(address: str) -> None:
    host = address.rpartition(":")[0]
    with listening(address) as made:
        with pytest.raises(EnvironmentFault, match="in use"):
            listening(f"{host}:{made.getsockname()[1]}")
        with socket.create_connection(made.getsockname()[:2]):
            pass


def status(*shown: bytes, kind: str = "http") -> int | None:
    """Return the status of a request that shows these; None when the application was asked."""
    sent: list[MutableMapping[str, Any]] = []
    asked: list[str] = []

    async def app(scope: Any, receive: Any, send: Any) -> None:
        asked.append(scope["type"])

    async def send(message: MutableMapping[str, Any]) -> None:
        sent.append(message)

    async def receive() -> MutableMapping[str, Any]:
        return {}

    scope = {"type": kind, "headers": [(b"Authorization", value) for value in shown]}
    asyncio.run(guarded(app, TOKEN)(scope, receive, send))
    assert bool(asked) != bool(sent)
    return None if asked else int(sent[0]["status"])


def test_only_the_one_right_token_gets_through() -> None:
    right = b"Bearer " + TOKEN
    assert status(right) is None
    for wrong in ((), (TOKEN,), (b"bearer " + TOKEN,), (right[:-1],), (right, right), (b"",)):
        assert status(*wrong) == 401
    assert status(kind="lifespan") is None
    for kind in ("websocket", ""):
        assert status(right, kind=kind) == 401
