# SPDX-License-Identifier: Apache-2.0
"""Files are written whole, never over a private key, and never for others to write."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from authguard_r.core.errors import EnvironmentFault
from authguard_r.keys.algorithms import Algorithm, generate
from authguard_r.keys.envelope import seal
from authguard_r.keys.files import (
    holds_key,
    holds_plain_key,
    read_private,
    write_keys,
    write_whole,
)
from authguard_r.keys.signer import read_keys

KINDS = (Algorithm.ED25519, Algorithm.ML_DSA_65)


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


@pytest.fixture
def key(tmp_path: Path) -> Path:
    path = tmp_path / "operator-1.key.pem"
    write_keys(path, *map(generate, KINDS))
    return path


@pytest.mark.parametrize("sealed", [False, True])
def test_no_file_takes_the_place_of_a_private_key(key: Path, *, sealed: bool) -> None:
    if sealed:
        write_whole(key, seal(key.read_bytes(), "words that nobody knows"), mode=0o600, over=True)
    before = key.read_bytes()
    link = key.with_name("link")
    link.symlink_to(key)
    for path in (key, link):
        with pytest.raises(EnvironmentFault, match="private key"):
            write_whole(path, b"x")
    assert (key.read_bytes(), link.is_symlink(), mode(key)) == (before, True, 0o600)


def test_what_may_not_be_read_is_a_key_by_its_name(
    key: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = key.with_name("other")
    other.write_bytes(b"x")

    def refused(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refused)  # root may read what nobody may
    assert (holds_key(key), holds_key(other)) == (True, False)
    assert not holds_key(key.with_name("absent.key.pem"))
    assert not holds_plain_key(key)


def test_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert not holds_key(tmp_path / "pipe")


def test_keys_are_written_whole_for_their_owner_and_never_over_anything(key: Path) -> None:
    keys = read_keys(key.read_bytes(), key)
    assert (len(keys), mode(key)) == (2, 0o600)
    dangling = key.with_name("dangling.key.pem")
    dangling.symlink_to(key.with_name("nowhere"))
    for path in (key, dangling, key.parent, key.with_name("none") / "k.key.pem"):
        with pytest.raises(EnvironmentFault):
            write_keys(path, *keys)
    assert {path.name for path in key.parent.iterdir()} == {key.name, dangling.name}


@pytest.mark.parametrize(("mask", "expected"), [(0o002, 0o644), (0o022, 0o644), (0o077, 0o600)])
def test_what_is_written_is_never_for_others_to_write(
    tmp_path: Path, mask: int, expected: int
) -> None:
    before = os.umask(mask)
    try:
        write_whole(tmp_path / "f", b"x")
        write_whole(tmp_path / "g", b"x", mode=0o644)
    finally:
        os.umask(before)
    assert (mode(tmp_path / "f"), mode(tmp_path / "g")) == (expected, 0o644)


@pytest.mark.parametrize("name", [".", "/", "f" * 300])
def test_a_name_that_no_file_can_have_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(EnvironmentFault):
        write_whole(Path(name), b"x")
    assert list(tmp_path.iterdir()) == []


def test_a_secret_is_read_from_a_file_that_its_owner_alone_reads(tmp_path: Path) -> None:
    path = tmp_path / "secret"
    with pytest.raises(EnvironmentFault, match="cannot read"):
        read_private(path, where="--token-file")
    path.write_bytes(b"words")
    path.chmod(0o604)
    with pytest.raises(EnvironmentFault, match="chmod 600"):
        read_private(path, where="--token-file")
    path.chmod(0o600)
    assert read_private(path, where="--token-file") == b"words"
