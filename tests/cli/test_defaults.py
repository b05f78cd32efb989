# SPDX-License-Identifier: Apache-2.0
"""Defaults of options: the environment, and an `authguard.toml` that only its user can write."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from authguard_r.cli.app import AUTHGUARD
from authguard_r.operations.defaults import FILE, MAX_BYTES, NAMES, read_defaults, working_defaults
from fixtures import scenarios
from fixtures.commands import ended

SITE = scenarios.HOSPITAL / "site.yaml"


@pytest.fixture
def home(tmp_path: Path) -> Path:
    made = tmp_path / "home" / "ana"
    (made / "ward" / "shift").mkdir(parents=True)
    return made


def write(folder: Path, text: str = 'trust = "trust"', mode: int = 0o600) -> Path:
    path = folder / FILE
    path.write_text(text, encoding="utf-8")
    path.chmod(mode)
    return path


# which file counts


def test_the_nearest_file_counts_and_its_paths_begin_at_its_folder(home: Path) -> None:
    write(home, 'trust = "other"')
    path = write(home / "ward", 'trust = "trust"\nkey = "pkcs11:token=t"\nsite = "/srv/s.yaml"')
    found = read_defaults(home / "ward" / "shift", home)
    assert (found.path, found.ignored) == (path, "")
    assert found.values == {
        "trust": str(home / "ward" / "trust"),
        "key": "pkcs11:token=t",
        "site": "/srv/s.yaml",
    }


def test_the_home_folder_is_the_last_one_that_is_looked_at(home: Path) -> None:
    write(home.parent)
    assert read_defaults(home / "ward", home).path is None
    path = write(home)
    assert read_defaults(home / "ward", home).path == path


def test_outside_of_home_no_folder_around_it_is_looked_at(home: Path) -> None:
    elsewhere = home.parent.parent / "srv" / "robot"
    elsewhere.mkdir(parents=True)
    write(home.parent.parent)  # holds the home folder, too
    assert read_defaults(elsewhere, home).path is None
    path = write(elsewhere.parent)
    assert read_defaults(elsewhere, home).path == path


def test_a_home_folder_behind_a_link_bounds_the_search_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    work = tmp_path / "real" / "ana" / "work"
    work.mkdir(parents=True)
    write(tmp_path / "real")
    (tmp_path / "link").symlink_to(tmp_path / "real")
    monkeypatch.setenv("HOME", str(tmp_path / "link" / "ana"))
    monkeypatch.chdir(work)
    assert working_defaults().path is None


@pytest.mark.parametrize("mode", [0o620, 0o602, 0o666])
def test_a_file_that_others_may_write_gives_no_defaults(home: Path, mode: int) -> None:
    path = write(home, mode=mode)
    found = read_defaults(home, home)
    assert (found.path, dict(found.values)) == (None, {})
    assert found.ignored == f"{path} is not used: others may write it: chmod go-w"


@pytest.mark.skipif(os.geteuid() != 0, reason="gives a file to another user")
def test_the_file_of_another_user_gives_no_defaults_and_roots_does(home: Path) -> None:
    path = write(home)
    os.chown(path, 12_345, -1)
    assert "its owner is neither you nor root but user 12345" in read_defaults(home, home).ignored
    os.chown(path, 0, -1)
    assert read_defaults(home, home).path == path


def test_a_link_and_what_is_no_file_give_no_defaults(home: Path) -> None:
    real = write(home / "ward")
    (home / FILE).symlink_to(real)
    assert read_defaults(home, home).ignored
    (home / FILE).unlink()
    os.mkfifo(home / FILE)
    assert read_defaults(home, home).ignored.endswith("it is no plain file")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("trust = trust", "Invalid value"),
        ('robot = "courier-1"', f"unknown key `robot`; allowed: {', '.join(NAMES)}"),
        ("trust = 1", "`trust`: expected a text in quotes"),
        ('trust = ""', "`trust`: expected a text in quotes"),
        ("#" * (MAX_BYTES + 1), f"it has more than {MAX_BYTES} bytes"),
    ],
)
def test_a_file_that_cannot_be_read_gives_no_defaults_and_says_why(
    home: Path, text: str, why: str
) -> None:
    write(home / "ward", text)
    write(home)
    found = read_defaults(home / "ward", home)
    assert (found.path, dict(found.values)) == (None, {})  # the one above takes no place of it
    assert why in found.ignored


# what commands make of it


@pytest.fixture
def ward(home: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with everything that an operator signs with, and a compiled mission."""
    folder = home / "ward"
    monkeypatch.setenv("HOME", str(home))
    for name in NAMES:
        monkeypatch.delenv(f"AUTHGUARD_{name.upper()}", raising=False)
    monkeypatch.chdir(folder)
    shutil.copyfile(SITE, "site.yaml")
    shutil.copyfile(scenarios.HOSPITAL / "mission.yaml", "mission.yaml")
    assert ended("keys", "init", "trust", "--site", "site.yaml").code == 0
    words = ("mission", "compile", "mission.yaml", "--site", "site.yaml", "--out", "mission.json")
    assert ended(*words).code == 0
    lines = ("trust", "trust"), ("site", "site.yaml"), ("key", "trust/keys/operator-1.key.pem")
    write(folder, "\n".join(f'{name} = "{value}"' for name, value in lines))
    return folder


def test_an_operator_signs_with_the_mission_alone_and_sees_whose_root_and_key(ward: Path) -> None:
    code, _, err = ended("mission", "sign", "mission.json", "--yes")
    assert code == 0
    where = f"(from {ward / FILE})"
    assert err.splitlines() == [
        f"trust: {ward / 'trust'} {where}",
        f"key: {ward / 'trust/keys/operator-1.key.pem'} {where}",
    ]
    assert ended("mission", "verify", "mission.token")[:2] == (0, VERIFIED.format(*digest(ward)))


VERIFIED = """\
authentic: {0} version 1
signed by operator-1 (operator)
digest {1}
valid now
"""


def digest(ward: Path) -> tuple[str, str]:
    """Return the name and digest of the signed mission."""
    import json

    told = json.loads(ended("mission", "show", str(ward / "mission.token"), "--json").out)
    return told["mission"]["mid"], told["digest"]


def test_a_command_line_beats_the_environment_and_that_beats_the_file(
    ward: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keys = ward / "trust" / "keys"
    monkeypatch.setenv("AUTHGUARD_KEY", str(keys / "supervisor-1.key.pem"))
    code, _, err = ended("mission", "sign", "mission.json", "--yes")
    assert (code, "ROLE_DENIED" in err) == (1, True)
    assert f"key: {keys / 'supervisor-1.key.pem'} (from the environment)" in err
    words = ("mission", "sign", "mission.json", "--yes", "--key", keys / "operator-1.key.pem")
    code, _, err = ended(*words)
    assert (code, "key:" in err) == (0, False)


def test_a_file_that_does_not_count_is_named_and_the_option_is_missing(ward: Path) -> None:
    (ward / FILE).chmod(0o666)
    code, _, err = ended("mission", "sign", "mission.json", "--yes")
    assert code == 2
    assert err.startswith(f"{ward / FILE} is not used: others may write it")
    assert "Missing option '--key'" in err


def test_what_a_process_serves_is_never_taken_from_a_file_or_a_variable(
    ward: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AUTHGUARD_TRUST", str(ward / "trust"))
    assert "Missing option '--trust'" in ended("gate").err
    for words in AUTHGUARD.services:
        assert "AUTHGUARD" not in ended(*words.split(), "-h").out


def test_a_store_that_is_named_is_not_mixed_with_the_default_gate(
    ward: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AUTHGUARD_GATE", str(ward / "run"))
    code, _, err = ended("explain", "--store", "none.db")
    assert (code, "not together" in err) == (5, False)
