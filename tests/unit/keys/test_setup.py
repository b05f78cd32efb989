# SPDX-License-Identifier: Apache-2.0
"""A trust set-up in one folder: complete, private, marked as a demo, never over another."""

from __future__ import annotations

import os
import stat
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key

from authguard_r.authoring.keys.setup import (
    AUTHORITIES,
    Member,
    add_member,
    init_folder,
    write_revocations,
)
from authguard_r.core.errors import AuthenticityError, EnvironmentFault
from authguard_r.core.identifiers import RegionId, RobotId
from authguard_r.core.principals import Scope
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.keys.certificate import Role
from authguard_r.keys.signer import read_signer
from authguard_r.keys.trust import read_trust
from unit.keys.chains import DAY_MS, NOW, TODAY

MEMBERS = (
    Member(id="operator-1", role=Role.OPERATOR, robots=None, regions=None),
    Member(id="supervisor-1", role=Role.SUPERVISOR, robots=None, regions=None),
    Member(id="officer-1", role=Role.SAFETY_OFFICER, robots=None, regions=None),
    Member(id="site-1", role=Role.SITE_AUTHORITY),
    Member(id="gate-1", role=Role.GATE, robots=("courier-1",), profile="A" * 43),
    Member(id="estimator-1", role=Role.ESTIMATOR, robots=("courier-1",)),
    Member(id="witness-1", role=Role.WITNESS),
    Member(id="scheduler-1", role=Role.SCHEDULER, robots=None, regions=None, template="B" * 43),
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
    found = trust.verify(b"go", signer.endorse(b"go"), NOW)
    assert (found.id, found.role) == (member.id, member.role)
    leaf = trust.identify(signer.chain, NOW)
    assert leaf.scope == Scope(
        robots=None if member.robots is None else frozenset(map(RobotId, member.robots)),
        regions=None if member.regions is None else frozenset(map(RegionId, member.regions)),
    )
    assert found.scope == leaf.scope
    assert (leaf.profile, leaf.template) == (member.profile, member.template)


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
    assert caught.value.reason is Reason.FILE_UNAVAILABLE
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


# one more member, and the template that a scheduler is bound to


def late(name: str = "late", role: Role = Role.SCHEDULER, **names: Any) -> Member:
    return Member(id=name, role=role, **names)


def test_a_member_that_comes_later_holds_like_the_others(folder: Path) -> None:
    before = listing(folder)
    add_member(folder, late(template="C" * 43), now=TODAY, days=5)
    after = listing(folder)
    assert {k: after[k] for k in before} == before
    assert set(after) - set(before) == {"keys/late.key.pem", "keys/late.cert.pem"}
    assert stat.S_IMODE((folder / "keys" / "late.key.pem").stat().st_mode) == 0o600
    trust = read_trust(folder)
    chain = read_signer(folder / "keys/late.key.pem", folder / "keys/late.cert.pem").chain
    assert trust.scheduled_template(chain, NOW) == "C" * 43
    assert trust.identify(chain, NOW).not_after_ms == NOW.utc_ms + 5 * DAY_MS


@pytest.mark.parametrize(
    "name", ["operator-1", "root", "people", "machines", "Late", "", "a.b", "../late", "a" * 65]
)
def test_a_later_member_takes_nobody_s_name(folder: Path, name: str) -> None:
    before = listing(folder)
    with pytest.raises(EnvironmentFault) as error:
        add_member(folder, late(name), now=TODAY, days=5)
    assert error.value.reason is Reason.SCHEMA_INVALID
    assert listing(folder) == before


@pytest.mark.parametrize("path", ["keys/people.key.pem", "authorities/people.pem"])
@pytest.mark.parametrize("data", [None, b"junk"])
def test_without_its_authority_nobody_is_added(folder: Path, path: str, data: bytes | None) -> None:
    if data is None:
        (folder / path).unlink()
    else:
        (folder / path).write_bytes(data)
    before = listing(folder)
    with pytest.raises(EnvironmentFault) as error:
        add_member(folder, late(), now=TODAY, days=5)
    assert error.value.reason is Reason.FILE_UNAVAILABLE
    assert listing(folder) == before


def test_an_authority_s_key_of_another_kind_adds_nobody(folder: Path) -> None:
    from cryptography.hazmat.primitives.asymmetric.ed448 import Ed448PrivateKey
    from cryptography.hazmat.primitives.serialization import NoEncryption, PrivateFormat

    other = Ed448PrivateKey.generate()
    pem = other.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    (folder / "keys" / "people.key.pem").write_bytes(pem)
    before = listing(folder)
    with pytest.raises(AuthenticityError) as error:
        add_member(folder, late(), now=TODAY, days=5)
    assert error.value.reason is Reason.KEY_INVALID
    assert listing(folder) == before


def test_only_an_estimator_s_certificate_says_whose_state_it_attests(folder: Path) -> None:
    trust = read_trust(folder)
    for member in MEMBERS:
        keys = folder / "keys"
        names = (keys / f"{member.id}.key.pem", keys / f"{member.id}.cert.pem")
        chain = read_signer(*names).chain
        if member.role is Role.ESTIMATOR:
            assert (trust.attested_robot(chain, NOW),) == member.robots
            continue
        with pytest.raises(AuthenticityError) as error:
            trust.attested_robot(chain, NOW)
        assert error.value.reason is Reason.ROLE_DENIED


def test_only_a_scheduler_s_certificate_that_names_one_template_fills_it(folder: Path) -> None:
    trust = read_trust(folder)
    for member in MEMBERS:
        keys = folder / "keys"
        names = (keys / f"{member.id}.key.pem", keys / f"{member.id}.cert.pem")
        chain = read_signer(*names).chain
        if member.template is not None:
            assert trust.scheduled_template(chain, NOW) == member.template
            continue
        with pytest.raises(AuthenticityError) as error:
            trust.scheduled_template(chain, NOW)
        assert error.value.reason is Reason.ROLE_DENIED
    add_member(folder, late(), now=TODAY, days=5)
    chain = read_signer(folder / "keys/late.key.pem", folder / "keys/late.cert.pem").chain
    with pytest.raises(AuthenticityError) as error:
        trust.scheduled_template(chain, NOW)
    assert error.value.reason is Reason.ROLE_DENIED


@pytest.mark.parametrize("role", [role for role in Role if role is not Role.SCHEDULER])
def test_a_template_on_anybody_else_s_certificate_is_refused_not_overlooked(
    folder: Path, role: Role
) -> None:
    """Whoever wrote it there meant to narrow what the holder may sign."""
    add_member(folder, late(role=role, template="C" * 43), now=TODAY, days=5)
    chain = read_signer(folder / "keys/late.key.pem", folder / "keys/late.cert.pem").chain
    with pytest.raises(AuthenticityError) as error:
        read_trust(folder).identify(chain, NOW)
    assert error.value.reason is Reason.CERTIFICATE_INVALID
