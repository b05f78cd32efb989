# SPDX-License-Identifier: Apache-2.0
"""The doctor where there is no gate: on a person's machine, and on the authority's."""

from __future__ import annotations

import json
import shutil
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from cryptography.hazmat.primitives.serialization import Encoding

from authguard_r.authoring.keys.setup import (
    Member,
    add_member,
    init_folder,
    read_authority,
    read_key,
)
from authguard_r.cli import call
from authguard_r.keys.certificate import Role, build_authority
from authguard_r.keys.trust import read_certificates

TODAY = datetime.now(UTC)
OPERATOR = Member(id="operator-1", role=Role.OPERATOR, robots=None, regions=None)


def doctor(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, list[dict[str, Any]]]:
    """Return the exit code, and every finding that is about keys and certificates."""
    code = call(["doctor", *map(str, words), "--json"])
    told = json.loads(capsys.readouterr().out)
    kinds = ("KEY", "CERTIFICATE", "STRAY", "TRUST")
    found = [item for item in told["advice"] if str(item["code"]).startswith(kinds)]
    return code, [item for item in found if item["level"] != "ok"]


def codes(found: list[dict[str, Any]]) -> list[tuple[str, str]]:
    return [(item["level"], item["code"]) for item in found]


@pytest.fixture
def authority(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An authority's machine, with nothing given yet."""
    monkeypatch.chdir(tmp_path)
    init_folder(Path("authority"), (), now=TODAY, title="Test root")
    return Path("authority")


def given(authority: Path, member: Member = OPERATOR, *, days: int = 300) -> Path:
    """Give a member a certificate, as `keys issue` keeps it; return where it lies."""
    add_member(authority, member, now=TODAY - timedelta(days=1), days=days)
    (authority / "issued").mkdir(exist_ok=True)
    target = authority / "issued" / f"{member.id}.{days}.cert.pem"
    shutil.move(authority / "keys" / f"{member.id}.cert.pem", target)
    return target


@pytest.fixture
def mine(authority: Path) -> Path:
    """A person's folder as the how-to makes it: key and certificate, and the trust folder."""
    return person(authority)


def person(authority: Path, *, days: int = 300) -> Path:
    folder = Path("mine")
    cert = given(authority, days=days)
    for name in ("authorities", "revocations"):
        shutil.copytree(authority / name, folder / "trust" / name)
    shutil.copy(authority / "root.pem", folder / "trust" / "root.pem")
    shutil.copy(cert, folder / "operator-1.cert.pem")
    shutil.move(authority / "keys/operator-1.key.pem", folder / "operator-1.key.pem")
    return folder


def test_a_persons_key_that_others_can_read_is_unsafe_wherever_one_asks(
    mine: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    key, cert = mine / "operator-1.key.pem", mine / "operator-1.cert.pem"
    whole = ("--trust", mine / "trust", "--key", key, "--cert", cert)
    for words in ((mine,), ("--trust", mine / "trust"), whole):
        key.chmod(0o600)
        code, found = doctor(capsys, *words)
        assert (code, codes(found)) == (0, [("warning", "KEY_PLAIN")]), words
        key.chmod(0o644)
        code, found = doctor(capsys, *words)
        assert (code, codes(found)) == (5, [("unsafe", "KEY_MODE"), ("warning", "KEY_PLAIN")])


def test_a_person_is_told_of_a_certificate_that_ends(
    authority: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = person(authority, days=20)
    for words in ((mine,), ("--trust", mine / "trust", "--cert", mine / "operator-1.cert.pem")):
        code, found = doctor(capsys, *words)
        assert (code, codes(found)[0]) == (0, ("warning", "CERTIFICATE")), found
        assert "keys rotate" in found[0]["mend"]


def test_whoever_is_no_gate_may_have_more_keys_beside_his_own(
    mine: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(mine / "operator-1.key.pem", mine / "operator-1.2.key.pem")
    words = ("--trust", mine / "trust", "--key", mine / "operator-1.key.pem")
    assert codes(doctor(capsys, *words)[1]) == [("warning", "KEY_PLAIN")]
    # beside a gate that is another's
    _, found = doctor(capsys, *words, "--store", mine / "robot.db")
    assert ("unsafe", "STRAY_KEY") in codes(found)


def test_a_gate_is_named_by_a_gates_certificate(
    mine: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--trust", mine / "trust", "--cert", mine / "operator-1.cert.pem")
    code, found = doctor(capsys, *words, "--store", mine / "robot.db")
    assert (code, "expected a gate's" in str(found)) == (5, True)
    (mine / "operator-1.cert.pem").write_text("junk")
    code, found = doctor(capsys, *words)
    assert (code, ("unsafe", "CERTIFICATE") in codes(found)) == (5, True)


def test_an_authoritys_key_is_said_where_nobody_named_a_gate(
    mine: Path, authority: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, found = doctor(capsys, "--trust", authority)
    assert (code, set(codes(found))) == (0, {("warning", "STRAY_KEY")})
    assert sorted(Path(item["place"]).name for item in found) == [
        f"{name}.key.pem" for name in ("machines", "people", "root", "site")
    ]
    for name in ("root.key.pem", "authorities/notes.txt"):
        shutil.copy(authority / "keys/root.key.pem", mine / "trust" / name)
        code, found = doctor(capsys, mine)
        strays = [item for item in found if item["code"] == "STRAY_KEY"]
        assert (code, [item["level"] for item in strays]) == (5, ["unsafe"])
        assert "of the authority `root`" in strays[0]["message"]
        (mine / "trust" / name).unlink()
    # a person's key in the trust folder is no authority's
    (mine / "trust/keys").mkdir()
    shutil.copy(mine / "operator-1.key.pem", mine / "trust/keys/other.key.pem")
    assert "STRAY_KEY" not in str(doctor(capsys, mine)[1])


@pytest.mark.parametrize(("days", "level"), [(14, "warning"), (-1, "unsafe"), (60, None)])
def test_a_root_that_ends_is_said_on_every_machine(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    days: int,
    level: str | None,
) -> None:
    monkeypatch.chdir(tmp_path)
    begin = TODAY - timedelta(days=300)
    init_folder(Path("authority"), (), now=begin, days=301 + days, title="Test root")
    code, found = doctor(capsys, "--trust", "authority")
    ends = [(item["part"], item["level"]) for item in found if item["code"] == "CERTIFICATE"]
    assert ends == ([] if level is None else [("root", level)])
    assert code == (5 if level == "unsafe" else 0)


def test_an_authority_that_ends_before_its_root_is_said(
    authority: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (root,) = read_certificates(authority / "root.pem")
    short = build_authority(
        read_authority(authority, "people").key.public_key(),
        name="people",
        roles=(Role.OPERATOR,),
        issuer=root,
        key=read_key(authority, "root"),
        now=TODAY - timedelta(days=1),
        days=10,
    )
    (authority / "authorities/people.pem").write_bytes(short.public_bytes(Encoding.PEM))
    code, found = doctor(capsys, "--trust", authority)
    ends = [(item["part"], item["place"]) for item in found if item["code"] == "CERTIFICATE"]
    assert (code, ends) == (0, [("authorities/people", "authority/authorities/people.pem")])
    # whoever it named is not told to rotate: nobody gives more than the authority has
    given(authority)
    _, found = doctor(capsys, "--trust", authority)
    assert ["keys init" in i["mend"] for i in found if i["part"].startswith("issued/")] == [True]


def test_of_what_was_given_the_last_of_each_name_is_looked_at(
    authority: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = given(authority, days=10)
    (authority / "keys/operator-1.key.pem").unlink()
    _, found = doctor(capsys, "--trust", authority)
    assert [i["place"] for i in found if i["code"] == "CERTIFICATE"] == [str(first)]
    given(authority, days=200)
    (authority / "keys/operator-1.key.pem").unlink()
    assert "CERTIFICATE" not in str(doctor(capsys, "--trust", authority)[1])
    other = Member(id="operator-2", role=Role.OPERATOR, robots=None, regions=None)
    given(authority, other, days=1)  # over: it stays there and nothing is wrong
    assert "CERTIFICATE" not in str(doctor(capsys, "--trust", authority)[1])
    (authority / "issued/junk.cert.pem").write_text("junk")
    code, found = doctor(capsys, "--trust", authority)
    told = [(i["part"], i["level"]) for i in found if i["code"] == "CERTIFICATE"]
    assert (code, told) == (5, [("issued/junk.cert.pem", "unsafe")])
