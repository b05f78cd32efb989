# SPDX-License-Identifier: Apache-2.0
"""Who may say what: chains with revocation, signatures, gates, and the folder they come from."""

from __future__ import annotations

import re
import shutil
from base64 import b64encode
from datetime import timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import Encoding

from authguard_r.core.errors import AuthenticityError, EnvironmentFault, MalformedError
from authguard_r.core.principals import Principal
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.keys.certificate import Role
from authguard_r.keys.revocation import RevocationList
from authguard_r.keys.trust import Trust, read_file, read_trust
from fixtures import scenarios
from unit.keys import chains
from unit.keys.chains import DAY_MS, NOW, TODAY, TrustSetup, eku, house, san

GATE_NAMES = (
    chains.PRINCIPAL + "gate-1",
    "urn:authguard-r:robot:courier-1",
    "urn:authguard-r:profile:" + "A" * 43,
)


def refused(
    trust: Trust, chain: tuple[bytes, ...], *, reason: Reason, where: str, now: Now = NOW
) -> AuthenticityError:
    with pytest.raises(AuthenticityError) as caught:
        trust.identify(chain, now)
    assert (caught.value.reason, caught.value.where) == (reason, where)
    return caught.value


# -- revocation ------------------------------------------------------------------------------------


def test_a_good_chain_is_usable_until_the_first_of_certificates_and_lists_ends() -> None:
    leaf = chains.leaf(house().people)
    for days in (3, 40):
        found = house().trust(days=days).identify(house().chain(leaf), NOW)
        assert found.not_after_ms == NOW.utc_ms + min(days, 30) * DAY_MS


@pytest.mark.parametrize("sooner", ["root", "people"])
def test_the_list_that_ends_first_ends_the_chain(sooner: str) -> None:
    ends = {"root": 9, "people": 9, sooner: 4}
    held = {"root": house().root, "people": house().people}
    lists = {
        held[name].der: RevocationList(
            number=1, next_update_ms=NOW.utc_ms + days * DAY_MS, serials=frozenset()
        )
        for name, days in ends.items()
    }
    trust = Trust((house().root.certificate,), lists)
    found = trust.identify(house().chain(chains.leaf(house().people)), NOW)
    assert found.not_after_ms == NOW.utc_ms + 4 * DAY_MS


def test_a_revoked_leaf_is_refused_and_the_one_beside_it_is_not() -> None:
    trust = house().trust(revoked={house().people.der: frozenset({41})})
    dead, alive = (chains.leaf(house().people, serial=serial) for serial in (41, 42))
    refused(trust, house().chain(dead), reason=Reason.CERTIFICATE_REVOKED, where="certificate")
    assert trust.identify(house().chain(alive), NOW).serial == 42


def test_a_revoked_authority_takes_all_its_leaves_with_it() -> None:
    people = house().people
    serial = people.certificate.serial_number
    trust = house().trust(revoked={house().root.der: frozenset({serial})})
    refused(
        trust,
        house().chain(chains.leaf(people)),
        reason=Reason.CERTIFICATE_REVOKED,
        where="certificate",
    )


def test_a_serial_revoked_by_one_authority_says_nothing_of_another_s() -> None:
    """Serial numbers are an authority's own: the leaf's is not looked up in the root's list."""
    leaf = chains.leaf(house().people, serial=41)
    trust = house().trust(revoked={house().root.der: frozenset({41})})
    assert trust.identify(house().chain(leaf), NOW).serial == 41
    own = house().people.certificate.serial_number
    trust = house().trust(revoked={house().people.der: frozenset({own})})
    assert trust.identify(house().chain(leaf), NOW).serial == 41


@pytest.mark.parametrize(("late_ms", "holds"), [(0, True), (1, False)])
@pytest.mark.parametrize("stale", ["root", "people"])
def test_a_list_past_its_next_update_refuses_what_it_should_cover(
    stale: str, late_ms: int, holds: bool
) -> None:
    held = {"root": house().root, "people": house().people}
    until = {"root": NOW.utc_ms + DAY_MS, "people": NOW.utc_ms + DAY_MS, stale: NOW.utc_ms}
    lists = {
        held[name].der: RevocationList(number=1, next_update_ms=end, serials=frozenset())
        for name, end in until.items()
    }
    trust = Trust((house().root.certificate,), lists)
    chain = house().chain(chains.leaf(house().people))
    now = Now(NOW.utc_ms + late_ms, 0)
    if holds:
        assert trust.identify(chain, now).not_after_ms == NOW.utc_ms
    else:
        refused(trust, chain, reason=Reason.REVOCATION_STALE, where="revocations", now=now)


@pytest.mark.parametrize("missing", ["root", "people"])
def test_a_missing_list_refuses_as_a_stale_one_does(missing: str) -> None:
    held = {"root": house().root, "people": house().people}
    lists = {
        held[name].der: RevocationList(
            number=1, next_update_ms=NOW.utc_ms + DAY_MS, serials=frozenset()
        )
        for name in held
        if name != missing
    }
    trust = Trust((house().root.certificate,), lists)
    chain = house().chain(chains.leaf(house().people))
    refused(trust, chain, reason=Reason.REVOCATION_STALE, where="revocations")


def test_an_authority_certified_anew_does_not_inherit_the_old_one_s_list() -> None:
    """Lists are found by the certificate's bytes, never by a name that a token chose."""
    second = chains.authority(house().root, serial=99)
    assert second.der != house().people.der
    chain = (chains.leaf(second).der, second.der)
    refused(house().trust(), chain, reason=Reason.REVOCATION_STALE, where="revocations")


@pytest.mark.parametrize("length", [0, 1, 3, 8])
def test_a_chain_of_another_length_is_refused(length: int) -> None:
    leaf = chains.leaf(house().people)
    chain = (leaf.der, house().people.der, house().root.der, *(b"" for _ in range(5)))[:length]
    error = refused(house().trust(), chain, reason=Reason.CERTIFICATE_INVALID, where="certificate")
    assert f"got {length}" in error.message


# -- the same chain again --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("leaf_days", "list_days", "reason"),
    [(5, 9, Reason.CERTIFICATE_EXPIRED), (9, 5, Reason.REVOCATION_STALE)],
    ids=["certificate", "list"],
)
def test_a_chain_that_held_holds_until_its_end_and_not_a_millisecond_longer(
    leaf_days: int, list_days: int, reason: Reason
) -> None:
    """A chain is remembered so that it need not be walked for every token; its dates are not."""
    trust = house().trust(days=list_days)
    end = TODAY + timedelta(days=leaf_days)
    chain = house().chain(chains.leaf(house().people, end=end))
    until = NOW.utc_ms + 5 * DAY_MS
    for utc_ms in (NOW.utc_ms, NOW.utc_ms + 1, until):
        assert trust.identify(chain, Now(utc_ms, 0)).not_after_ms == until
    with pytest.raises(AuthenticityError) as caught:
        trust.identify(chain, Now(until + 1, 0))
    assert caught.value.reason is reason
    assert trust.identify(chain, NOW).not_after_ms == until


def test_a_chain_that_held_does_not_hold_before_its_beginning() -> None:
    trust = house().trust()
    chain = house().chain(chains.leaf(house().people, start=TODAY))
    assert trust.identify(chain, NOW).principal == "operator-1"
    with pytest.raises(AuthenticityError) as caught:
        trust.identify(chain, Now(NOW.utc_ms - 1, 0))
    assert caught.value.reason is Reason.CERTIFICATE_EXPIRED


def test_a_chain_that_did_not_hold_is_asked_again() -> None:
    """A refusal is never remembered: a certificate that begins tomorrow holds tomorrow."""
    trust = house().trust()
    chain = house().chain(chains.leaf(house().people, start=TODAY + timedelta(days=1)))
    for _ in range(2):
        refused(trust, chain, reason=Reason.CERTIFICATE_EXPIRED, where="certificate.leaf")
    later = Now(NOW.utc_ms + DAY_MS, 0)
    assert trust.identify(chain, later).principal == "operator-1"


def test_one_good_half_of_a_remembered_chain_proves_nothing() -> None:
    trust = house().trust()
    leaf = chains.leaf(house().people)
    trust.identify(house().chain(leaf), NOW)
    forged = chains.leaf(house().people, by=chains.key("mallory"))
    refused(
        trust,
        (forged.der, house().people.der),
        reason=Reason.CERTIFICATE_INVALID,
        where="certificate.leaf",
    )
    refused(
        trust,
        (leaf.der, house().root.der),
        reason=Reason.CERTIFICATE_INVALID,
        where="certificate.authority",
    )


def test_two_trusts_do_not_share_what_they_remember() -> None:
    chain = house().chain(chains.leaf(house().people, serial=41))
    house().trust().identify(chain, NOW)
    revoked = house().trust(revoked={house().people.der: frozenset({41})})
    refused(revoked, chain, reason=Reason.CERTIFICATE_REVOKED, where="certificate")


def test_more_signers_than_are_remembered_are_each_who_they_are() -> None:
    """Memory is bounded: whoever shows a thousand good chains costs time, not space."""
    trust = house().trust()
    leaves = [chains.leaf(house().people, f"operator-{number}") for number in range(300)]
    for leaf in (*leaves, *leaves[:3]):
        found = trust.identify(house().chain(leaf), NOW)
        assert found.principal == chains.common_name(leaf.certificate.subject)
        assert len(trust._identified) <= 256


def test_a_chain_is_walked_once_as_long_as_nothing_changes() -> None:
    trust = house().trust()
    chain = house().chain(chains.leaf(house().people))
    assert trust.identify(chain, NOW) is trust.identify(chain, Now(NOW.utc_ms + 1, 0))


# -- signatures ------------------------------------------------------------------------------------


def test_a_signature_is_its_leaf_s_word() -> None:
    leaf = chains.leaf(house().people)
    found = house().trust(days=3).verify(b"go", ((house().chain(leaf), leaf.key.sign(b"go")),), NOW)
    assert found == Principal(
        id="operator-1",
        role="operator",
        scope=scenarios.EVERYWHERE,
        usable_until_ms=NOW.utc_ms + 3 * DAY_MS,
    )


@pytest.mark.parametrize("who", ["another leaf", "the authority", "the root", "nobody"])
def test_the_signature_of_another_key_does_not_hold(who: str) -> None:
    leaf = chains.leaf(house().people)
    signature = {
        "another leaf": chains.key("leaf operator-2").sign(b"go"),
        "the authority": house().people.key.sign(b"go"),
        "the root": house().root.key.sign(b"go"),
        "nobody": b"",
    }[who]
    with pytest.raises(AuthenticityError) as caught:
        house().trust().verify(b"go", ((house().chain(leaf), signature),), NOW)
    assert (caught.value.reason, caught.value.where) == (Reason.SIGNATURE_INVALID, "signature")


def test_a_chain_that_does_not_hold_is_named_before_its_signature_is_looked_at() -> None:
    """Paper order: step 1 comes before step 2."""
    leaf = chains.leaf(house().people, by=chains.key("mallory"))
    with pytest.raises(AuthenticityError) as caught:
        house().trust().verify(b"go", ((house().chain(leaf), b""),), NOW)
    assert caught.value.reason is Reason.CERTIFICATE_INVALID


# -- gates -----------------------------------------------------------------------------------------


def machines() -> tuple[TrustSetup, Trust]:
    issuer = chains.authority(
        house().root, (Role.GATE, Role.ESTIMATOR), subject="Machines authority"
    )
    site = TrustSetup(house().root, issuer)
    return site, site.trust()


def test_a_gate_is_the_robot_and_the_profile_in_its_certificate() -> None:
    site, trust = machines()
    gate = chains.leaf(
        site.people, "gate-1", role=(eku(Role.GATE), True), names=(san(*GATE_NAMES), False)
    )
    assert trust.gate_identity(site.chain(gate), NOW) == ("courier-1", "A" * 43)


@pytest.mark.parametrize(
    ("role", "names"),
    [
        (Role.ESTIMATOR, GATE_NAMES),
        (Role.GATE, GATE_NAMES[:1]),
        (Role.GATE, GATE_NAMES[:2]),
        (Role.GATE, (GATE_NAMES[0], GATE_NAMES[2])),
        (Role.GATE, (*GATE_NAMES, "urn:authguard-r:robot:lifter-1")),
        (Role.GATE, (GATE_NAMES[0], GATE_NAMES[2], "urn:authguard-r:every-robot")),
    ],
    ids=["another role", "neither", "no profile", "no robot", "two robots", "every robot"],
)
def test_a_certificate_that_is_no_whole_gate_s_is_no_gate(
    role: Role, names: tuple[str, ...]
) -> None:
    site, trust = machines()
    leaf = chains.leaf(site.people, "gate-1", role=(eku(role), True), names=(san(*names), False))
    assert trust.identify(site.chain(leaf), NOW).principal == "gate-1"
    with pytest.raises(AuthenticityError) as caught:
        trust.gate_identity(site.chain(leaf), NOW)
    assert (caught.value.reason, caught.value.where) == (Reason.ROLE_DENIED, "certificate.leaf")


def test_a_revoked_gate_is_no_gate() -> None:
    site, _ = machines()
    gate = chains.leaf(
        site.people,
        "gate-1",
        role=(eku(Role.GATE), True),
        names=(san(*GATE_NAMES), False),
        serial=8,
    )
    trust = site.trust(revoked={site.people.der: frozenset({8})})
    with pytest.raises(AuthenticityError) as caught:
        trust.gate_identity(site.chain(gate), NOW)
    assert caught.value.reason is Reason.CERTIFICATE_REVOKED


# -- roots -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "public",
    [
        Ed25519PublicKey.from_public_bytes(b"\x01" + bytes(31)),
        ec.generate_private_key(ec.SECP256R1()).public_key(),
    ],
    ids=["low order", "P-256"],
)
def test_a_root_with_an_unsound_key_is_refused_at_the_start(public: Ed25519PublicKey) -> None:
    bad = chains.certify(public, subject="Root", issuer="Root", by=chains.key("Root"))
    with pytest.raises(AuthenticityError) as caught:
        Trust((bad,), {})
    assert (caught.value.reason, caught.value.where) == (Reason.KEY_INVALID, "root")


def test_a_demo_root_is_known_as_one() -> None:
    assert read_trust(scenarios.trust_folder()).demo
    assert not house().trust().demo


# -- the folder ------------------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    copy = tmp_path / "trust"
    shutil.copytree(scenarios.trust_folder(), copy)
    return copy


def test_the_folder_of_keys_init_is_a_whole_trust_root(folder: Path) -> None:
    trust = read_trust(folder)
    for path in sorted((folder / "keys").glob("*.cert.pem")):
        chain = tuple(
            cert.public_bytes(Encoding.DER)
            for cert in chains.x509.load_pem_x509_certificates(path.read_bytes())
        )
        assert trust.identify(chain, scenarios.NOW).principal == path.name.removesuffix(".cert.pem")


@pytest.mark.parametrize("part", ["root.pem", "revocations/root.json", "revocations/people.json"])
def test_a_part_that_is_missing_is_a_fault_of_the_world_that_names_it(
    folder: Path, part: str
) -> None:
    (folder / part).unlink()
    with pytest.raises(EnvironmentFault) as caught:
        read_trust(folder)
    assert caught.value.reason is Reason.FILE_UNAVAILABLE
    assert caught.value.where == str(folder / part)


@pytest.mark.parametrize("part", ["root.pem", "authorities/people.pem"])
@pytest.mark.parametrize("data", [b"", b"junk", b"-----BEGIN CERTIFICATE-----\nAAAA\n"])
def test_a_certificate_that_is_none_is_refused(folder: Path, part: str, data: bytes) -> None:
    (folder / part).write_bytes(data)
    with pytest.raises(AuthenticityError) as caught:
        read_trust(folder)
    assert caught.value.reason is Reason.CERTIFICATE_INVALID
    assert caught.value.where == part.rpartition("/")[2]


@pytest.mark.parametrize("part", ["root.pem", "authorities/people.pem"])
@pytest.mark.parametrize(
    ("before", "value"),
    [
        ("a0030201", 6),  # version 7
        ("06035504030c", 0x80),  # a common name that is longer than its certificate
        ("06035504030c..", 0xFF),  # a common name that is no UTF-8
    ],
    ids=["version", "length", "name"],
)
def test_a_certificate_with_a_part_that_cannot_be_read_is_refused(
    folder: Path, part: str, before: str, value: int
) -> None:
    (whole,) = x509.load_pem_x509_certificates((folder / part).read_bytes())
    der = whole.public_bytes(Encoding.DER).hex()
    found = re.search(before, der)
    assert found is not None
    broken = bytearray.fromhex(der)
    broken[found.end() // 2] = value
    text = b64encode(broken).decode()
    (folder / part).write_text(f"-----BEGIN CERTIFICATE-----\n{text}\n-----END CERTIFICATE-----\n")
    with pytest.raises(AuthenticityError) as caught:
        read_trust(folder)
    assert caught.value.reason is Reason.CERTIFICATE_INVALID
    assert caught.value.where == part.rpartition("/")[2]


@pytest.mark.parametrize("part", ["root.pem", "authorities/people.pem"])
def test_a_certificate_in_the_folder_with_an_unsound_key_is_refused(
    folder: Path, part: str
) -> None:
    public = Ed25519PublicKey.from_public_bytes(b"\x01" + bytes(31))
    bad = chains.certify(public, subject="x", issuer="x", by=chains.key("x"))
    (folder / part).write_bytes(bad.public_bytes(Encoding.PEM))
    with pytest.raises(AuthenticityError) as caught:
        read_trust(folder)
    assert caught.value.reason is Reason.KEY_INVALID
    assert caught.value.where == part.rpartition("/")[2]


def test_the_list_of_another_authority_in_its_place_is_refused(folder: Path) -> None:
    lists = folder / "revocations"
    (lists / "people.json").write_bytes((lists / "machines.json").read_bytes())
    with pytest.raises(AuthenticityError) as caught:
        read_trust(folder)
    assert (caught.value.reason, caught.value.where) == (
        Reason.SIGNATURE_INVALID,
        "revocations/people",
    )


def test_a_list_that_is_none_is_refused(folder: Path) -> None:
    (folder / "revocations" / "site.json").write_bytes(b"{}")
    with pytest.raises(MalformedError) as caught:
        read_trust(folder)
    assert (caught.value.reason, caught.value.where) == (Reason.MALFORMED, "revocations/site")


def test_an_authority_without_a_file_here_has_no_list_and_is_refused(folder: Path) -> None:
    (folder / "authorities" / "people.pem").unlink()
    trust = read_trust(folder)
    chain = tuple(
        cert.public_bytes(Encoding.DER)
        for cert in chains.x509.load_pem_x509_certificates(
            (folder / "keys" / "operator-1.cert.pem").read_bytes()
        )
    )
    refused(trust, chain, reason=Reason.REVOCATION_STALE, where="revocations", now=scenarios.NOW)


def test_a_file_that_cannot_be_read_says_which_and_why(tmp_path: Path) -> None:
    with pytest.raises(EnvironmentFault) as caught:
        read_file(tmp_path)
    assert caught.value.reason is Reason.FILE_UNAVAILABLE
    assert str(tmp_path) in caught.value.message
    assert "directory" in caught.value.message
