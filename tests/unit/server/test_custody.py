# SPDX-License-Identifier: Apache-2.0
"""Whoever else can read a key is the gate; whoever else can write a file decides what it says."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from authguard_r.operations.checkup.advice import AdviceCode, Level
from authguard_r.operations.checkup.custody import (
    file_advice,
    folder_advice,
    key_advice,
    role_of,
    stray_advice,
)
from fixtures import scenarios
from unit.server.robots import ME, mine, robot, write_key

as_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")


@pytest.fixture
def key(tmp_path: Path) -> Path:
    return write_key(tmp_path / "gate.key.pem", Ed25519PrivateKey.generate())


def test_a_key_of_its_user_alone_is_fine(key: Path) -> None:
    (found,) = key_advice(key, uid=ME)
    assert (found.level, found.code) == (Level.OK, AdviceCode.KEY_MODE)
    assert list(key_advice(key, uid=None)) == []


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o601, 0o644])
def test_a_key_that_others_can_touch_is_unsafe(key: Path, mode: int) -> None:
    key.chmod(mode)
    (found,) = key_advice(key, uid=ME)
    assert (found.level, found.code) == (Level.UNSAFE, AdviceCode.KEY_MODE)
    assert found.mend == f"chmod 600 {key}"
    (found,) = key_advice(key, uid=None)
    assert found.code is AdviceCode.KEY_MODE


def test_a_key_of_another_user_is_unsafe(key: Path) -> None:
    (found,) = key_advice(key, uid=ME + 1)
    assert (found.level, found.code) == (Level.UNSAFE, AdviceCode.KEY_OWNER)


def test_a_key_that_is_not_there_is_said(tmp_path: Path) -> None:
    (found,) = key_advice(tmp_path / "none", uid=ME)
    assert (found.level, found.code) == (Level.UNSAFE, AdviceCode.MISSING)
    (found,) = file_advice("x", tmp_path / "none", uid=ME)
    assert found.code is AdviceCode.MISSING


def test_a_file_that_others_can_write_is_unsafe(tmp_path: Path) -> None:
    path = tmp_path / "site.token"
    path.write_text("x")
    assert list(file_advice("site", mine(path, 0o644), uid=ME)) == []
    for mode in (0o646, 0o664, 0o666):
        (found,) = file_advice("site", mine(path, mode), uid=ME)
        assert (found.level, found.code) == (Level.UNSAFE, AdviceCode.WRITABLE)
    (found,) = file_advice("site", mine(path, 0o644), uid=ME, secret=True)
    assert (found.level, found.code) == (Level.WARNING, AdviceCode.READABLE)
    assert list(file_advice("site", mine(path, 0o600), uid=ME, secret=True)) == []


@as_root
def test_the_group_of_root_is_roots_and_a_file_of_another_user_is_anothers(tmp_path: Path) -> None:
    path = tmp_path / "site.token"
    path.write_text("x")
    path.chmod(0o664)
    os.chown(path, 0, 0)
    assert list(file_advice("site", path, uid=ME)) == []
    os.chown(path, ME + 1, 0)
    (found,) = file_advice("site", path, uid=ME)
    assert (found.level, found.code) == (Level.UNSAFE, AdviceCode.OWNER)


def test_a_folder_above_in_which_others_can_swap_things_is_unsafe(tmp_path: Path) -> None:
    deep = tmp_path / "a" / "b"
    deep.mkdir(parents=True)
    for folder in (tmp_path / "a", deep):
        mine(folder, 0o755)
    assert list(folder_advice([deep / "key"], uid=ME)) == []
    (tmp_path / "a").chmod(0o777)
    (found,) = folder_advice([deep / "key", deep / "cert"], uid=ME)
    assert (found.code, found.place) == (AdviceCode.WRITABLE, str(tmp_path / "a"))
    # with the sticky bit nobody touches what another put there
    (tmp_path / "a").chmod(0o1777)
    assert list(folder_advice([deep / "key"], uid=ME)) == []


def test_a_link_is_followed_and_its_own_folder_counts_too(tmp_path: Path) -> None:
    open_, closed = tmp_path / "open", tmp_path / "closed"
    for folder in (open_, closed):
        folder.mkdir()
        mine(folder, 0o755)
    (closed / "key").write_text("x")
    (open_ / "key").symlink_to(closed / "key")
    assert list(folder_advice([open_ / "key"], uid=ME)) == []
    for folder in (open_, closed):
        folder.chmod(0o777)
        (found,) = folder_advice([open_ / "key"], uid=ME)
        assert found.place == str(folder)
        folder.chmod(0o755)


def test_a_path_that_does_not_exist_yet_is_looked_at_as_far_as_it_does(tmp_path: Path) -> None:
    mine(tmp_path, 0o755)
    assert list(folder_advice([tmp_path / "none" / "x" / "y"], uid=ME)) == []


def test_every_other_private_key_is_a_stray(tmp_path: Path, key: Path) -> None:
    nested = tmp_path / "old" / "backup"
    nested.mkdir(parents=True)
    other = write_key(nested / "notes.txt", Ed25519PrivateKey.generate())
    (tmp_path / "public.pem").write_text("-----BEGIN CERTIFICATE-----")
    (found,) = stray_advice([tmp_path, nested], own=key, uid=ME)
    assert (found.level, found.code, found.place) == (
        Level.UNSAFE,
        AdviceCode.STRAY_KEY,
        str(other),
    )
    assert "nothing here says" in found.message


def test_a_set_up_in_one_folder_has_everybodys_keys(tmp_path: Path) -> None:
    folder = scenarios.trust_folder()
    own = folder / "keys" / f"gate-{scenarios.RID}.key.pem"
    found = list(stray_advice([folder], own=own, uid=ME))
    told = {Path(item.place).name: item.message for item in found}
    for name, role in (("operator-1", "operator"), ("site-authority-1", "site_authority")):
        assert f"of role `{role}`" in told[f"{name}.key.pem"]
    assert "nothing here says" in told["root.key.pem"]
    assert own.name not in told


@as_root
def test_an_estimators_key_of_its_own_user_is_no_stray(tmp_path: Path) -> None:
    name = f"estimator-{scenarios.RID}"
    for end in ("key.pem", "cert.pem"):
        data = (scenarios.trust_folder() / "keys" / f"{name}.{end}").read_bytes()
        (tmp_path / f"{name}.{end}").write_bytes(data)
    path = tmp_path / f"{name}.key.pem"
    own = tmp_path / "gate.key.pem"
    for owner, mode, strays in (
        (ME + 1, 0o600, 0),
        (ME + 1, 0o640, 1),
        (ME, 0o600, 1),
        (0, 0o600, 1),
    ):
        os.chown(path, owner, owner)
        path.chmod(mode)
        assert len(list(stray_advice([tmp_path], own=own, uid=ME))) == strays


@pytest.mark.skipif(os.geteuid() == 0, reason="root reads everything")
def test_a_key_that_may_not_be_read_is_known_by_its_name(tmp_path: Path) -> None:
    for name in ("a.key.pem", "b.txt"):
        (tmp_path / name).write_text("x")
        (tmp_path / name).chmod(0)
    (found,) = stray_advice([tmp_path], own=tmp_path / "own", uid=ME)
    assert found.place == str(tmp_path / "a.key.pem")


def test_what_nobody_named_claims_no_role(tmp_path: Path) -> None:
    assert role_of(None) is None
    assert role_of(tmp_path / "gone.key.pem") is None


def test_the_robot_of_these_tests_is_mine(tmp_path: Path) -> None:
    assert robot(tmp_path).uid == ME
