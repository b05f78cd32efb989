# SPDX-License-Identifier: Apache-2.0
"""Answers that somebody changed on the way, and what they may not do to a trust folder."""

from __future__ import annotations

import os
import shutil
import stat
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import msgspec
import pytest
from cryptography.hazmat.primitives.serialization import Encoding
from msgspec.structs import replace

from authguard_r.authoring.keys.authority import issue
from authguard_r.authoring.keys.install import OpenedAnswer, install_answer, open_answer
from authguard_r.authoring.keys.request import (
    CertificateAnswer,
    WantedCertificate,
    make_request,
    open_request,
)
from authguard_r.authoring.keys.setup import AUTHORITIES, init_folder, read_key, write_revocations
from authguard_r.core.encoding import b64, encode_fast
from authguard_r.core.errors import AuthenticityError, MalformedError
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.keys.algorithms import Algorithm, PrivateKey, generate
from authguard_r.keys.certificate import Role, build_authority
from authguard_r.keys.files import write_keys
from authguard_r.keys.loading import load
from authguard_r.keys.revocation import Revocation, sign_list
from authguard_r.keys.trust import Trust, read_certificates, read_file, read_trust

TODAY = datetime(2030, 6, 15, 12, 0, 0, tzinfo=UTC)
NOW = Now(int(TODAY.timestamp()) * 1000, 0)
HYBRID = (Algorithm.ED25519, Algorithm.ML_DSA_65)
PAIR = ("authorities/people.pem", "revocations/people.json")


@pytest.fixture
def auth(tmp_path: Path) -> Path:
    return made(tmp_path / "auth")


def made(folder: Path, **more: Any) -> Path:
    init_folder(folder, (), now=TODAY, title="Test root", **more)
    return folder


def answered(
    auth: Path, name: str = "operator-1", kinds: tuple[Algorithm, ...] = HYBRID[:1]
) -> Any:
    """Return an honest answer, as its struct."""
    wanted = WantedCertificate(
        principal=name, role=Role.OPERATOR, every_robot=True, every_region=True
    )
    request = open_request(make_request(wanted, tuple(map(generate, kinds))))
    return msgspec.json.decode(issue(auth, request, now=TODAY, days=30), type=CertificateAnswer)


def opened(answer: CertificateAnswer) -> OpenedAnswer:
    return open_answer(encode_fast(answer) + b"\n", NOW)


def recertify(auth: Path, key: PrivateKey, *, later: timedelta, roles: tuple[Role, ...]) -> bytes:
    """Let the root certify another key as the authority `people`; return the certificate."""
    (root,) = read_certificates(auth / "root.pem")
    certificate = build_authority(
        key.public_key(),
        name="people again",
        roles=roles,
        issuer=root,
        key=read_key(auth, "root"),
        now=TODAY - timedelta(days=1) + later,
        days=90,
    )
    return certificate.public_bytes(Encoding.DER)


def first_list(key: PrivateKey) -> str:
    told = Revocation(
        authority="people",
        number=1,
        issued="2030-06-15T12:00:00Z",
        next_update="2030-07-15T12:00:00Z",
        serials=(),
    )
    return sign_list(told, key).decode("ascii")


def people(folder: Path) -> bytes:
    return b"".join((folder / name).read_bytes() for name in PAIR)


def identified(folder: Path, answer: OpenedAnswer) -> str:
    trust: Trust = read_trust(folder)
    return str(trust.identify(answer.chains[0], NOW).principal)


def test_an_authority_and_its_list_of_another_root_are_refused_together(
    auth: Path, tmp_path: Path
) -> None:
    """Each fits the other; neither is under the root that a person compared."""
    mine, other = answered(auth), answered(made(tmp_path / "other"))
    for name in ("people", "site"):
        changed = replace(
            mine,
            authorities={**mine.authorities, name: other.authorities[name]},
            lists={**mine.lists, name: other.lists[name]},
        )
        with pytest.raises(AuthenticityError) as error:
            opened(changed)
        assert error.value.reason is Reason.CERTIFICATE_INVALID


@pytest.mark.parametrize(
    ("roles", "reason"),
    [
        ((Role.SITE_AUTHORITY,), Reason.CERTIFICATE_INVALID),
        ((Role.OPERATOR, Role.GATE), Reason.CERTIFICATE_INVALID),
        # its own roles: then it is only not the one that gave the certificate in the answer
        ((Role.OPERATOR,), Reason.REVOCATION_STALE),
    ],
)
def test_an_authority_of_the_same_root_gives_its_own_roles_alone(
    auth: Path, roles: tuple[Role, ...], reason: Reason
) -> None:
    """Whoever has the site's authority does not become the people's by calling itself so."""
    mine, key = answered(auth), generate(Algorithm.ED25519)
    der = recertify(auth, key, later=timedelta(0), roles=roles)
    changed = replace(
        mine,
        authorities={**mine.authorities, "people": b64(der)},
        lists={**mine.lists, "people": first_list(key)},
    )
    with pytest.raises(AuthenticityError) as error:
        opened(changed)
    assert error.value.reason is reason


@pytest.mark.parametrize("name", ["everybody", "people-2", "..", "people.old"])
def test_an_authority_that_no_set_up_has_is_refused(auth: Path, name: str) -> None:
    mine = answered(auth)
    changed = replace(
        mine,
        authorities={**mine.authorities, name: mine.authorities["people"]},
        lists={**mine.lists, name: mine.lists["people"]},
    )
    with pytest.raises(MalformedError):
        opened(changed)


def test_an_authority_is_of_the_root_of_its_place(tmp_path: Path) -> None:
    auth = made(tmp_path / "auth", algorithms=HYBRID)
    mine = answered(auth, kinds=HYBRID)
    assert len(opened(mine).leaves) == 2
    swapped = {**mine.authorities, "site": mine.authorities["site-2"]}
    lists = {**mine.lists, "site": mine.lists["site-2"]}
    with pytest.raises(AuthenticityError):
        opened(replace(mine, authorities=swapped, lists=lists))


def test_an_honest_answer_mends_a_folder_that_a_stranger_wrote_into(
    auth: Path, tmp_path: Path
) -> None:
    honest, trust = opened(answered(auth)), tmp_path / "trust"
    install_answer(trust, honest, NOW)
    before = people(trust)
    other = made(tmp_path / "other")
    for name in PAIR:
        (trust / name).write_bytes((other / name).read_bytes())
    with pytest.raises(AuthenticityError):
        identified(trust, honest)
    install_answer(trust, honest, NOW)
    assert people(trust) == before
    assert identified(trust, honest) == "operator-1"


@pytest.mark.parametrize("hours", [-1, 0, 1])
def test_an_authority_that_was_certified_anew_goes_in_with_its_list_and_never_back(
    auth: Path, tmp_path: Path, hours: int
) -> None:
    honest, trust = opened(answered(auth)), tmp_path / "trust"
    install_answer(trust, honest, NOW)
    before = people(trust)
    key = generate(Algorithm.ED25519)
    der = recertify(auth, key, later=timedelta(hours=hours), roles=AUTHORITIES["people"])
    place = auth / "keys/people.key.pem"
    place.unlink()
    write_keys(place, key)
    path = auth / "authorities/people.pem"
    path.write_bytes(load(der, where=path.name).public_bytes(Encoding.PEM))
    write_revocations(auth, "people", key, serials=(), now=TODAY, number=1, days=30)
    shutil.rmtree(auth / "issued")  # whoever the one before had named is certified anew
    second = opened(answered(auth, "operator-2"))
    install_answer(trust, second, NOW)
    read_trust(trust)  # authority and list fit each other, whichever it is
    assert (people(trust) != before) == (hours > 0)
    install_answer(trust, honest, NOW)
    assert (people(trust) != before) == (hours > 0)


@pytest.mark.parametrize("mask", [0o002, 0o077, 0o000])
def test_a_trust_folder_is_its_owners_to_write_and_everybodys_to_read(
    auth: Path, tmp_path: Path, mask: int
) -> None:
    honest, trust = opened(answered(auth)), tmp_path / "trust"
    before = os.umask(mask)
    try:
        install_answer(trust, honest, NOW)
    finally:
        os.umask(before)
    for path in (trust, *trust.rglob("*")):
        assert stat.S_IMODE(path.stat().st_mode) == (0o755 if path.is_dir() else 0o644), path
    trust.chmod(0o700)
    install_answer(trust, honest, NOW)
    assert stat.S_IMODE(trust.stat().st_mode) == 0o700  # one that is there is somebody's choice
    assert read_file(trust / "root.pem") == read_file(auth / "root.pem")
