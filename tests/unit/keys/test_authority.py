# SPDX-License-Identifier: Apache-2.0
"""The authority's machine: a key has one name, everything ends, one at a time changes it."""

from __future__ import annotations

import fcntl
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from cryptography.hazmat.primitives.serialization import Encoding
from msgspec.structs import replace

from authguard_r.authoring.keys.authority import issue, issue_group, wider
from authguard_r.authoring.keys.folder import given, survey
from authguard_r.authoring.keys.install import open_answer
from authguard_r.authoring.keys.request import (
    OpenedRequest,
    WantedCertificate,
    make_request,
    open_request,
)
from authguard_r.authoring.keys.revoking import renew_lists, revoke
from authguard_r.authoring.keys.setup import init_folder, read_authority
from authguard_r.core.errors import (
    AuthenticityError,
    AuthGuardError,
    EnvironmentFault,
    RefusedError,
)
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.keys.algorithms import Algorithm, PrivateKey, generate
from authguard_r.keys.certificate import Role, build_leaf
from authguard_r.keys.envelope import seal
from authguard_r.keys.signer import FileSigner
from authguard_r.keys.trust import read_certificates, read_trust
from fixtures.revocation_lists import next_lists

TODAY = datetime(2030, 6, 15, 12, 0, 0, tzinfo=UTC)
LIFE = 100
END = TODAY + timedelta(days=LIFE - 1)
OPERATOR = WantedCertificate(
    principal="operator-1", role=Role.OPERATOR, every_robot=True, every_region=True
)
BOARD = replace(OPERATOR, principal="board-1", role=Role.SUPERVISOR)
NARROW = WantedCertificate(
    principal="operator-1", role=Role.OPERATOR, robots=("a",), regions=("dock",)
)


@pytest.fixture
def auth(tmp_path: Path) -> Path:
    init_folder(tmp_path / "auth", (), now=TODAY, days=LIFE, title="Test root")
    return tmp_path / "auth"


def key() -> PrivateKey:
    return generate(Algorithm.ED25519)


def asked(
    wanted: WantedCertificate, mine: PrivateKey, before: FileSigner | None = None
) -> OpenedRequest:
    return open_request(make_request(wanted, (mine,), before=before))


def give(
    auth: Path, wanted: WantedCertificate, mine: PrivateKey, *, now: datetime = TODAY, **more: Any
) -> Any:
    """Return the leaf that a name was given."""
    data = issue(auth, asked(wanted, mine), now=now, **{"days": 30, **more})
    (leaf,) = open_answer(data, Now(int(now.timestamp()) * 1000, 0)).leaves
    return leaf


def dead(auth: Path, name: str, *, now: datetime = TODAY) -> Any:
    return revoke(auth, principal=name, serial=None, now=now, days=30)


def listed(auth: Path) -> tuple[int, frozenset[int]]:
    """Return number and serials of the people's list."""
    lists = {known.authority: known for known in read_trust(auth).lists.values()}
    return lists["people"].number, lists["people"].serials


def files(auth: Path) -> dict[str, bytes]:
    return {str(p.relative_to(auth)): p.read_bytes() for p in auth.rglob("*") if p.is_file()}


def refused(auth: Path, job: Callable[[], Any], kind: type[AuthGuardError] = RefusedError) -> Any:
    """Return why nothing was done; nothing was."""
    before = files(auth)
    with pytest.raises(kind) as error:
        job()
    assert files(auth) == before
    return error.value


# one key, one name


@pytest.mark.parametrize("state", ["valid", "revoked", "over"])
def test_a_key_has_one_name_for_ever(auth: Path, state: str) -> None:
    """Under two names, the issuer would be two of two people."""
    mine = key()
    give(auth, OPERATOR, mine)
    now = TODAY + timedelta(days=40) if state == "over" else TODAY
    if state == "revoked":
        dead(auth, "operator-1")
    shadow = replace(BOARD, principal="shadow")
    error = refused(auth, lambda: give(auth, shadow, mine, now=now))
    assert (error.reason, error.where) == (Reason.ISSUER_MISMATCH, "request.proofs")
    assert "operator-1" in error.message


def test_a_group_has_a_key_of_its_own(auth: Path) -> None:
    mine = key()
    give(auth, OPERATOR, mine)
    board = {"threshold": 2, "members": ("x", "y", "z"), "now": TODAY, "days": 3650}
    error = refused(auth, lambda: issue_group(auth, BOARD, mine.public_key(), **board))
    assert error.reason is Reason.ISSUER_MISMATCH
    path = issue_group(auth, BOARD, key().public_key(), **board)
    (leaf,) = [item.leaf for item in given(auth) if item.path == path]
    assert (leaf.principal, leaf.threshold, leaf.not_after_ms) == (
        "board-1",
        2,
        int(END.timestamp()) * 1000,
    )
    # a record that is written over would count on, and nobody could revoke it
    again = lambda: issue_group(auth, BOARD, key().public_key(), **board)  # noqa: E731
    assert refused(auth, again, EnvironmentFault).where == str(path)
    # and one member with the group's name would be the group
    assert "is a group" in refused(auth, lambda: give(auth, BOARD, key())).message


def test_a_revoked_key_does_not_come_back_with_its_old_request(auth: Path) -> None:
    mine = key()
    give(auth, OPERATOR, mine)
    dead(auth, "operator-1")
    error = refused(auth, lambda: give(auth, OPERATOR, mine), AuthenticityError)
    assert error.reason is Reason.CERTIFICATE_REVOKED
    assert give(auth, OPERATOR, key()).principal == "operator-1"


def test_a_key_that_was_not_revoked_is_certified_again(auth: Path) -> None:
    mine = key()
    first, second = give(auth, OPERATOR, mine), give(auth, OPERATOR, mine)
    assert first.serial != second.serial


# one at a time


def between(monkeypatch: pytest.MonkeyPatch, other: Callable[[], Any]) -> None:
    """Let another process come and go in the folder before the next one here has it."""
    take = fcntl.flock

    def late(held: int, how: int) -> None:
        monkeypatch.setattr(fcntl, "flock", take)
        other()
        take(held, how)

    monkeypatch.setattr(fcntl, "flock", late)


@pytest.mark.parametrize("name", ["revoke", "sign a list", "sign every list"])
def test_what_another_process_revoked_meanwhile_stays_revoked(
    auth: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    first = give(auth, OPERATOR, key())
    second = give(auth, replace(OPERATOR, principal="operator-2"), key())
    jobs: dict[str, tuple[Callable[[], Any], set[int]]] = {
        "revoke": (lambda: dead(auth, "operator-2"), {second.serial}),
        "sign a list": (lambda: next_lists(auth, {"people": {7}}, now=TODAY, days=3), {7}),
        "sign every list": (lambda: renew_lists(auth, now=TODAY, days=3), set()),
    }
    job, serials = jobs[name]
    between(monkeypatch, lambda: dead(auth, "operator-1"))
    job()
    assert listed(auth) == (3, {first.serial} | serials)


def test_a_name_that_another_process_gave_meanwhile_is_taken(
    auth: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    between(monkeypatch, lambda: give(auth, OPERATOR, key()))
    with pytest.raises(RefusedError, match="has another key"):
        give(auth, OPERATOR, key())
    assert len(given(auth)) == 1


def test_a_folder_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(EnvironmentFault, match="cannot open"):
        next_lists(tmp_path / "none", {}, now=TODAY, days=3)


# everything ends


def test_no_certificate_outlives_who_gave_it(auth: Path) -> None:
    leaf = give(auth, OPERATOR, key(), days=3650)
    (path,) = (auth / "issued").iterdir()
    own, authority = read_certificates(path)
    assert own.not_valid_after_utc == authority.not_valid_after_utc == END
    assert leaf.not_after_ms <= int(END.timestamp()) * 1000


def test_a_certificate_of_the_last_hours_can_be_revoked(auth: Path) -> None:
    """It was walked a day after its beginning, where its root was over, and stopped every list."""
    late = END - timedelta(hours=2)
    leaf = give(auth, OPERATOR, key(), now=late)
    assert dead(auth, "operator-1", now=late).lists["people"].serials == {leaf.serial}


def test_after_the_end_nothing_is_given_and_no_list_is_signed(auth: Path) -> None:
    give(auth, OPERATOR, key())
    late = END + timedelta(seconds=1)
    for job in (
        lambda: give(auth, OPERATOR, key(), now=late),
        lambda: dead(auth, "operator-1", now=late),
        lambda: renew_lists(auth, now=late, days=30),
        lambda: next_lists(auth, {"root": set()}, now=late, days=30),
    ):
        error = refused(auth, job, AuthenticityError)
        assert error.reason is Reason.CERTIFICATE_EXPIRED
        assert "is over since 2030-09-22T12:00:00Z" in error.message


# sealed keys


def test_an_authority_s_key_may_be_sealed(auth: Path) -> None:
    path = auth / "keys/people.key.pem"
    path.write_bytes(seal(path.read_bytes(), "three words and 4"))
    error = refused(auth, lambda: give(auth, OPERATOR, key()), AuthenticityError)
    assert (error.reason, "sealed" in error.message) == (Reason.KEY_INVALID, True)
    asked_for: list[str] = []

    def say(what: str) -> str:
        asked_for.append(what)
        return "three words and 4"

    leaf = give(auth, OPERATOR, key(), passphrase=say)
    done = revoke(auth, principal=None, serial=leaf.serial, now=TODAY, days=3, passphrase=say)
    assert done.lists["people"].serials == {leaf.serial}
    assert renew_lists(auth, now=TODAY, days=3, passphrase=say)["people"].number == 3
    assert asked_for == [str(path)] * 3  # once for each command


# what cannot be read


def junk(auth: Path) -> list[Path]:
    """Put what is no certificate among those that were given."""
    place = auth / "issued"
    (place / "a-noise.cert.pem").write_bytes(b"noise")
    (place / "b-empty.cert.pem").touch()
    (place / "c-folder.cert.pem").mkdir()
    issuer = read_authority(auth, "people")
    stray = build_leaf(
        key().public_key(),
        principal="x",
        role=Role.GATE,  # one that this authority may not give
        issuer=issuer.certificate,
        key=issuer.key,
        now=TODAY,
        days=1,
        robots=(),
        regions=(),
    )
    pem = b"".join(c.public_bytes(Encoding.PEM) for c in (stray, issuer.certificate))
    (place / "d-other-role.cert.pem").write_bytes(pem)
    return sorted(place.glob("?-*.cert.pem"))


def test_a_bad_file_stops_no_revocation_and_is_named(auth: Path) -> None:
    leaf = give(auth, OPERATOR, key())
    bad = junk(auth)
    assert list(survey(auth).unread) == bad
    done = dead(auth, "operator-1")
    assert (listed(auth), list(done.unread)) == ((2, {leaf.serial}), bad)
    # a serial number says it all
    done = revoke(auth, principal=None, serial=leaf.serial, now=TODAY, days=3)
    assert (listed(auth)[0], done.unread) == (3, ())
    assert "a-noise.cert.pem" in refused(auth, lambda: dead(auth, "operator-2")).message
    # but who cannot see what was given gives nothing
    error = refused(auth, lambda: give(auth, OPERATOR, key()), AuthenticityError)
    assert error.where == str(bad[0])


def test_a_serial_number_needs_no_file_and_no_unknown_authority(auth: Path) -> None:
    leaf = give(auth, OPERATOR, key())
    (path,) = (auth / "issued").iterdir()
    path.unlink()
    words = {"principal": None, "serial": leaf.serial, "now": TODAY, "days": 3}
    assert "nothing was given" in refused(auth, lambda: revoke(auth, **words)).message
    refused(auth, lambda: revoke(auth, **words, authority="nobody"))
    revoke(auth, **words, authority="people")
    assert listed(auth) == (2, {leaf.serial})


def test_a_machine_without_an_authority_s_key_signs_no_list(auth: Path) -> None:
    for path in (auth / "keys").iterdir():
        path.unlink()
    error = refused(auth, lambda: renew_lists(auth, now=TODAY, days=3), EnvironmentFault)
    assert "has no authority's private key" in error.message


# an answer that nobody gets


def test_what_could_not_be_written_was_not_given(auth: Path, tmp_path: Path) -> None:
    there = {"now": TODAY, "days": 30}
    request = asked(OPERATOR, key())
    job = lambda: issue(auth, request, **there, out=tmp_path / "none" / "x.json")  # noqa: E731
    refused(auth, job, EnvironmentFault)
    assert given(auth) == ()
    data = issue(auth, request, **there, out=tmp_path / "x.json")
    assert (tmp_path / "x.json").read_bytes() == data
    assert len(given(auth)) == 1


# more than before


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, ()),
        ({"robots": ()}, ()),
        ({"robots": ("a", "b")}, ("robots: a, b (has a)",)),
        ({"robots": (), "every_robot": True}, ("robots: EVERY ONE (has a)",)),
        (
            {"robots": ("b",), "regions": (), "every_region": True},
            ("robots: b (has a)", "regions: EVERY ONE (has dock)"),
        ),
    ],
)
def test_what_a_rotation_widens_is_named(
    auth: Path, changes: dict[str, Any], said: tuple[str, ...]
) -> None:
    mine = key()
    assert wider(auth, asked(NARROW, mine), now=TODAY) == ()  # a new name has nothing to widen
    data = issue(auth, asked(NARROW, mine), now=TODAY, days=30)
    before = FileSigner(mine, open_answer(data, Now(int(TODAY.timestamp()) * 1000, 0)).chains[0])
    for request in (
        asked(replace(NARROW, **changes), key(), before),
        asked(replace(NARROW, **changes), mine),
    ):
        assert wider(auth, request, now=TODAY) == said


def test_another_profile_or_template_is_named_and_every_one_covers_all(auth: Path) -> None:
    gate = WantedCertificate(principal="gate-1", role=Role.GATE, robots=("a",), profile="A" * 43)
    mine = key()
    give(auth, gate, mine)
    other = asked(replace(gate, profile="B" * 42 + "A"), mine)
    (said,) = wider(auth, other, now=TODAY)
    assert said.startswith("profile: B")
    give(auth, OPERATOR, theirs := key())
    assert wider(auth, asked(NARROW, theirs), now=TODAY) == ()
