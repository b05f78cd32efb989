# SPDX-License-Identifier: Apache-2.0
"""A port of this machine, for whoever knows the token, and for nobody else."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from authguard_r.core.errors import EnvironmentFault, MalformedError
from authguard_r.integrations.http_listener.access import listening, read_bearer
from fixtures.cases import case

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


@pytest.mark.parametrize("address", ["0.0.0.0:0", "[::]:0", "192.0.2.1:80", "[2001:db8::1]:80"])
def test_nothing_listens_wider_than_this_machine_unless_that_is_made_safe(address: str) -> None:
    with pytest.raises(MalformedError, match="this machine alone; by TLS") as refused:
        listening(address, otherwise="by TLS")
    assert refused.value.where == "--listen"


def test_an_address_has_one_spelling() -> None:
    for text in [
        *("", ":80", "127.0.0.1", "localhost:80", "127.0.0.1:65536", "127.0.0.1:-1", "a:b"),
        *("127.0.0.1:080", "127.0.0.1: 80", "::1:80", "[127.0.0.1]:80", "[::1:80"),
        "[0:0:0:0:0:0:0:1]:80",
    ]:
        with case(text), pytest.raises(MalformedError):
            listening(text, wide=True)


def test_a_wide_address_is_taken_where_that_is_made_safe() -> None:
    with listening("0.0.0.0:0", wide=True) as made:
        assert made.getsockname()[0] == "0.0.0.0"


@pytest.mark.parametrize("address", ["127.0.0.1:0", "[::1]:0"])
def test_a_port_that_is_taken_is_said_so(address: str) -> None:
    host = address.rpartition(":")[0]
    with listening(address) as made:
        with pytest.raises(EnvironmentFault, match="in use"):
            listening(f"{host}:{made.getsockname()[1]}")
        with socket.create_connection(made.getsockname()[:2]):
            pass
