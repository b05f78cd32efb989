# SPDX-License-Identifier: Apache-2.0
"""A trust set-up in one folder: complete, private, marked as a demo, never over another."""

from __future__ import annotations

import os
import stat
from datetime import timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key

from authguard_r.core.errors import AuthenticityError, EnvironmentFault
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.keys.certificate import Role
from authguard_r.keys.setup import AUTHORITIES, Member, init_folder, write_revocations
from authguard_r.keys.signer import read_signer
from authguard_r.keys.trust import read_trust
from unit.keys.chains import DAY_MS, NOW, TODAY

MEMBERS = (
    Member(id="operator-1", role=Role.OPERATOR),
    Member(id="supervisor-1", role=Role.SUPERVISOR),
    Member(id="officer-1", role=Role.SAFETY_OFFICER),
    Member(id="site-1", role=Role.SITE_AUTHORITY),
    Member(id="gate-1", role=Role.GATE, robot="courier-1", profile="A" * 43),
    Member(id="estimator-1", role=Role.ESTIMATOR, robot="courier-1"),
    Member(id="witness-1", role=Role.WITNESS),
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    init_folder(tmp_path / "trust", MEMBERS, now=TODAY, days=30)
    return tmp_path / "trust"


def listing(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_every_role_has_exactly_one_authority() -> None:
    given = [role for roles in AUTHORITIES.values() for role in roles]
    assert sorted(given) == sorted(Role)


@pytest.mark.parametrize("member", MEMBERS, ids=lambda member: member.id)
def test_every_member_can_sign_and_is_who_the_set_up_says(folder: Path, member: Member) -> None:
    keys = folder / "keys"
    signer = read_signer(keys / f"{member.id}.key.pem", keys / f"{member.id}.cert.pem")
    trust = read_trust(folder)
    found = trust.verify(b"go", signature=signer.sign(b"go"), chain=signer.chain, now=NOW)
    assert (found.id, found.role) == (member.id, member.role)
    leaf = trust.identify(signer.chain, NOW)
    assert (leaf.robot, leaf.profile) == (member.robot, member.profile)


def test_every_key_is_its_owner_s_alone_whatever_the_umask(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        init_folder(tmp_path / "trust", MEMBERS, now=TODAY)
    finally:
        os.umask(before)
    keys = sorted((tmp_path / "trust").rglob("*.key.pem"))
    assert len(keys) == len(MEMBERS) + len(AUTHORITIES) + 1
    assert {stat.S_IMODE(path.stat().st_mode) for path in keys} == {0o600}
    assert stat.S_IMODE((tmp_path / "trust" / "keys").stat().st_mode) == 0o700


def test_every_private_key_is_another_one_and_lies_in_keys_only(folder: Path) -> None:
    files = listing(folder)
    secret = {name for name, data in files.items() if b"PRIVATE" in data}
    assert secret == {name for name in files if name.endswith(".key.pem")}
    assert all(name.startswith("keys/") for name in secret)
    seeds = {
        load_pem_private_key(files[name], None).private_bytes_raw()  # type: ignore[union-attr]
        for name in secret
    }
    assert len(seeds) == len(secret)


def test_the_root_says_demo(folder: Path) -> None:
    root = x509.load_pem_x509_certificate((folder / "root.pem").read_bytes())
    assert "demo" in root.subject.rfc4514_string()
    assert read_trust(folder).demo


@pytest.mark.parametrize("kind", ["file", "folder", "hidden file"])
def test_a_folder_that_holds_something_is_refused_and_nothing_is_written(
    tmp_path: Path, kind: str
) -> None:
    occupant = tmp_path / (".hidden" if kind == "hidden file" else "precious")
    if kind == "folder":
        occupant.mkdir()
    else:
        occupant.write_bytes(b"precious")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(EnvironmentFault) as caught:
        init_folder(tmp_path, MEMBERS, now=TODAY)
    assert caught.value.reason is Reason.STORE_UNAVAILABLE
    assert caught.value.where == str(tmp_path)
    assert sorted(tmp_path.rglob("*")) == before
    if kind != "folder":
        assert occupant.read_bytes() == b"precious"


def test_a_second_set_up_never_replaces_the_first(folder: Path) -> None:
    before = listing(folder)
    with pytest.raises(EnvironmentFault):
        init_folder(folder, MEMBERS, now=TODAY)
    assert listing(folder) == before


def test_an_empty_folder_that_is_there_already_is_used(tmp_path: Path) -> None:
    init_folder(tmp_path, (), now=TODAY)
    assert read_trust(tmp_path).demo


@pytest.mark.parametrize(
    ("days", "reason"),
    [
        (-2, Reason.CERTIFICATE_EXPIRED),
        (-1, None),
        (0, None),
        (28, None),
        (29, Reason.CERTIFICATE_EXPIRED),
    ],
)
def test_a_set_up_works_from_a_day_before_until_its_days_are_over(
    folder: Path, days: int, reason: Reason | None
) -> None:
    keys = folder / "keys"
    signer = read_signer(keys / "operator-1.key.pem", keys / "operator-1.cert.pem")
    now = Now(NOW.utc_ms + days * DAY_MS + (1 if days == 29 else 0), 0)
    trust = read_trust(folder)
    if reason is None:
        assert trust.identify(signer.chain, now).principal == "operator-1"
        return
    with pytest.raises(AuthenticityError) as caught:
        trust.identify(signer.chain, now)
    assert caught.value.reason is reason


def test_a_set_up_is_for_a_year_unless_said_otherwise(tmp_path: Path) -> None:
    init_folder(tmp_path, MEMBERS[:1], now=TODAY)
    signer = read_signer(
        tmp_path / "keys" / "operator-1.key.pem", tmp_path / "keys" / "operator-1.cert.pem"
    )
    found = read_trust(tmp_path).identify(signer.chain, NOW)
    assert found.not_after_ms == NOW.utc_ms + 364 * DAY_MS


def test_a_list_written_later_revokes_a_member(folder: Path) -> None:
    keys = folder / "keys"
    signer = read_signer(keys / "operator-1.key.pem", keys / "operator-1.cert.pem")
    serial = read_trust(folder).identify(signer.chain, NOW).serial
    authority = load_pem_private_key((keys / "people.key.pem").read_bytes(), None)
    write_revocations(
        folder,
        "people",
        authority,  # type: ignore[arg-type]
        serials=(serial, 5),
        now=TODAY + timedelta(hours=1),
        number=2,
        days=7,
    )
    with pytest.raises(AuthenticityError) as caught:
        read_trust(folder).identify(signer.chain, NOW)
    assert caught.value.reason is Reason.CERTIFICATE_REVOKED
    other = read_signer(keys / "supervisor-1.key.pem", keys / "supervisor-1.cert.pem")
    assert read_trust(folder).identify(other.chain, NOW).principal == "supervisor-1"


def test_the_certificates_in_the_folder_are_the_ones_that_sign(folder: Path) -> None:
    for name in AUTHORITIES:
        here = x509.load_pem_x509_certificate((folder / "authorities" / f"{name}.pem").read_bytes())
        chain = [
            x509.load_pem_x509_certificates(path.read_bytes())[1].public_bytes(Encoding.DER)
            for path in (folder / "keys").glob("*.cert.pem")
        ]
        assert here.public_bytes(Encoding.DER) in chain
