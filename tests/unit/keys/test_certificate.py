# SPDX-License-Identifier: Apache-2.0
"""The certificate profile: a good chain is walked, and each fault alone is refused in its place."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from datetime import datetime, timedelta
from pathlib import Path

import msgspec
import pytest
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec, ed448, rsa, x25519
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID, ObjectIdentifier
from hypothesis import given, settings
from hypothesis import strategies as st

from authguard_r.core.errors import AuthenticityError
from authguard_r.core.identifiers import PrincipalId, RegionId, RobotId
from authguard_r.core.principals import Scope
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.keys import loading
from authguard_r.keys.certificate import (
    Leaf,
    LeafClaims,
    Role,
    build_authority,
    build_leaf,
    build_root,
    read_claims,
    walk,
)
from authguard_r.keys.clock_floor import chain_ms
from authguard_r.keys.loading import load
from authguard_r.keys.notes import leaf_key
from authguard_r.keys.trust import is_demo
from fixtures.amount import amount
from fixtures.cases import case
from unit.keys import chains
from unit.keys.chains import NOW, OIDS, PRINCIPAL, TODAY, Held, eku, house, san, usage

LEAF = "certificate.leaf"
AUTHORITY = "certificate.authority"
ROOT = "certificate.root"
ROBOT = "urn:authguard-r:robot:"
REGION = "urn:authguard-r:region:"
PROFILE = "urn:authguard-r:profile:"
DIGEST = "A" * 43


def walked(leaf: Held, authority: Held | None = None, root: Held | None = None) -> Leaf:
    return walk(
        leaf.der,
        (authority or house().people).der,
        roots=((root or house().root).certificate,),
        now=NOW,
    )


def refused(
    leaf: Held,
    authority: Held | None = None,
    root: Held | None = None,
    *,
    reason: Reason = Reason.CERTIFICATE_INVALID,
    where: str,
) -> AuthenticityError:
    with pytest.raises(AuthenticityError) as caught:
        walked(leaf, authority, root)
    assert caught.value.reason is reason
    assert caught.value.where == where
    return caught.value


#: The library's functions that load certificates.
_LOADS = re.compile(r"load_(der|pem)_x509_certificate")


def changed(der: bytes) -> Iterator[bytes]:
    """Yield the bytes with each bit changed, one at a time."""
    for place in range(len(der)):
        for bit in range(8):
            made = bytearray(der)
            made[place] ^= 1 << bit
            yield bytes(made)


@pytest.mark.parametrize("which", ["leaf", "authority"])
def test_every_changed_bit_of_what_a_chain_says_is_refused(which: str) -> None:
    """A stranger's certificate ends in a refusal; bits that pad a signature say nothing."""
    chain = [chains.leaf(house().people).der, house().people.der]
    place = ["leaf", "authority"].index(which)
    said, passed = load(chain[place], where=which).tbs_certificate_bytes, 0
    for der in changed(chain[place]):
        chain[place] = der
        try:
            walk(chain[0], chain[1], roots=(house().root.certificate,), now=NOW)
        except AuthenticityError:
            continue
        passed += 1
        assert load(der, where=which).tbs_certificate_bytes == said
    assert passed <= 7


@pytest.mark.filterwarnings("ignore:Parsed a serial number")
@pytest.mark.parametrize("read", [read_claims, lambda der: leaf_key((der,))], ids=["claims", "key"])
def test_a_reader_of_an_unverified_certificate_refuses_what_it_cannot_read(
    read: Callable[[bytes], object],
) -> None:
    refusals = 0
    for der in changed(chains.leaf(house().people).der):
        try:
            read(der)
        except AuthenticityError:
            refusals += 1
    assert refusals > 100


@pytest.mark.filterwarnings("ignore:Parsed a serial number")
def test_a_certificate_that_cannot_be_read_says_nothing_of_the_time() -> None:
    whole = chains.leaf(house().people).der
    assert chain_ms([whole]) > 0
    assert sum(chain_ms([der]) == 0 for der in changed(whole)) > 100


def test_a_key_of_an_unknown_algorithm_is_refused() -> None:
    whole = chains.leaf(house().people)
    der = whole.der.replace(bytes.fromhex("06032b6570032100"), bytes.fromhex("06032b6579032100"))
    assert der != whole.der
    with pytest.raises(AuthenticityError) as caught:
        leaf_key((der,))
    assert caught.value.reason is Reason.KEY_INVALID


def test_certificates_are_loaded_in_one_place() -> None:
    """Every part is read there; `signer` compares keys alone and refuses each error itself."""
    source = Path(loading.__file__).parents[1]
    places = {p.name for p in source.rglob("*.py") if re.search(_LOADS, p.read_text())}
    assert places == {"loading.py", "signer.py"}


# -- good chains -----------------------------------------------------------------------------------


def test_a_good_chain_says_whose_it_is_what_it_may_sign_and_until_when() -> None:
    leaf = chains.leaf(house().people, serial=77)
    found = walked(leaf)
    assert (found.principal, found.role, found.serial) == ("operator-1", Role.OPERATOR, 77)
    assert (found.robot, found.profile) == (None, None)
    assert found.authority_serial == house().people.certificate.serial_number
    assert found.key == leaf.key.public_key()
    assert found.not_after_ms == NOW.utc_ms + 30 * chains.DAY_MS


def test_claims_are_read_of_a_leaf_that_no_root_vouches_for() -> None:
    stranger = chains.authority(chains.root("A stranger"), (Role.OPERATOR,))
    with pytest.raises(AuthenticityError):
        walked(chains.leaf(stranger), stranger)
    claimed = read_claims(chains.leaf(stranger).der)
    assert claimed == LeafClaims(principal=PrincipalId("operator-1"), role=Role.OPERATOR)


@pytest.mark.parametrize(
    "make",
    [
        lambda: chains.leaf(house().people, role=(eku(Role.OPERATOR, Role.SUPERVISOR), True)),
        lambda: chains.leaf(house().people, role=None),
        lambda: chains.leaf(
            house().people, names=(san(PRINCIPAL + "operator-1", PRINCIPAL + "operator-2"), False)
        ),
        lambda: house().people,
    ],
)
def test_who_claims_several_names_or_roles_or_none_claims_nothing(
    make: Callable[[], Held],
) -> None:
    with pytest.raises(AuthenticityError) as caught:
        read_claims(make().der)
    assert (caught.value.reason, caught.value.where) == (Reason.CERTIFICATE_INVALID, LEAF)


def test_each_role_has_the_object_identifier_that_is_on_the_wire() -> None:
    for role in Role:
        with case(role):
            issuer = chains.authority(house().root, (role,))
            assert walked(chains.leaf(issuer, role=(eku(role), True)), issuer).role is role


def test_the_product_s_own_builders_make_chains_that_walk() -> None:
    for role in Role:
        with case(role):
            start = TODAY - timedelta(days=1)
            root_key, authority_key, key = (chains.key(name) for name in ("r", "a", "l"))
            root = build_root(root_key, name="Site root", now=start, days=30)
            issuer = build_authority(
                authority_key.public_key(),
                name="an authority",
                roles=(role,),
                issuer=root,
                key=root_key,
                now=start,
                days=20,
            )
            leaf = build_leaf(
                key.public_key(),
                principal="gate-1",
                role=role,
                issuer=issuer,
                key=authority_key,
                now=start,
                days=10,
                robots=("courier-1",),
                regions=("pharmacy", "office-1"),
                profile=DIGEST,
            )
            ders = [cert.public_bytes(Encoding.DER) for cert in (leaf, issuer)]
            found = walk(ders[0], ders[1], roots=(root,), now=NOW)
            assert (found.principal, found.role) == ("gate-1", role)
            assert (found.robot, found.profile) == ("courier-1", DIGEST)
            assert found.scope == Scope(
                robots=frozenset({RobotId("courier-1")}),
                regions=frozenset({RegionId("pharmacy"), RegionId("office-1")}),
            )
            assert found.not_after_ms == NOW.utc_ms + 9 * chains.DAY_MS
            assert len({cert.serial_number for cert in (root, issuer, leaf)}) == 3
            # exactly these extensions, so that other validators are told the same
            places = (REGION + "pharmacy", REGION + "office-1")
            names = san(PRINCIPAL + "gate-1", ROBOT + "courier-1", *places, PROFILE + DIGEST)
            expected: list[tuple[x509.Certificate, list[chains.Extra]]] = [
                (root, [(chains.ROOT_BASIC, True), chains.CERTIFIES]),
                (issuer, [(chains.AUTHORITY_BASIC, True), chains.CERTIFIES, (eku(role), True)]),
                (
                    leaf,
                    [(chains.LEAF_BASIC, True), chains.SIGNS, (eku(role), True), (names, False)],
                ),
            ]
            for certificate, extensions in expected:
                found_extensions = [(one.value, one.critical) for one in certificate.extensions]
                assert found_extensions == extensions
                assert certificate.not_valid_before_utc == start


@pytest.mark.parametrize("shortest", ["leaf", "authority", "root"])
def test_a_chain_ends_with_the_first_of_its_certificates(shortest: str) -> None:
    ends = {
        name: TODAY + timedelta(days=5 if name == shortest else 9)
        for name in ("leaf", "authority", "root")
    }
    root = chains.root(end=ends["root"])
    issuer = chains.authority(root, end=ends["authority"])
    found = walked(chains.leaf(issuer, end=ends["leaf"]), issuer, root)
    assert found.not_after_ms == NOW.utc_ms + 5 * chains.DAY_MS


def test_names_of_other_kinds_beside_the_principal_change_nothing() -> None:
    names = san(PRINCIPAL + "operator-1", "https://hospital.example/operator-1")
    found = walked(chains.leaf(house().people, names=(names, False)))
    assert (found.principal, found.robot, found.profile) == ("operator-1", None, None)


def test_an_extension_that_is_unknown_but_not_critical_changes_nothing() -> None:
    unknown = x509.UnrecognizedExtension(ObjectIdentifier("1.2.3.4"), b"\x05\x00")
    assert walked(chains.leaf(house().people, extra=((unknown, False),))).role is Role.OPERATOR


# -- faults of a leaf ------------------------------------------------------------------------------

UNKNOWN = x509.UnrecognizedExtension(ObjectIdentifier("1.2.3.4"), b"\x05\x00")
POLICY = x509.CertificatePolicies([x509.PolicyInformation(ObjectIdentifier("1.2.3.5"), None)])

BAD_LEAVES: dict[str, Callable[[], Held]] = {
    "two roles": lambda: chains.leaf(
        house().people, role=(eku(Role.OPERATOR, Role.SUPERVISOR), True)
    ),
    "no role": lambda: chains.leaf(house().people, role=None),
    "a purpose of another world": lambda: chains.leaf(
        house().people, role=(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.CLIENT_AUTH]), True)
    ),
    "any purpose": lambda: chains.leaf(
        house().people,
        role=(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.ANY_EXTENDED_KEY_USAGE]), True),
    ),
    "its role and another purpose": lambda: chains.leaf(
        house().people,
        role=(
            x509.ExtendedKeyUsage([OIDS[Role.OPERATOR], ExtendedKeyUsageOID.CODE_SIGNING]),
            True,
        ),
    ),
    "the arc without a number": lambda: chains.leaf(
        house().people, role=(x509.ExtendedKeyUsage([ObjectIdentifier(chains.ARC)]), True)
    ),
    "a number behind the role's": lambda: chains.leaf(
        house().people, role=(x509.ExtendedKeyUsage([ObjectIdentifier(f"{chains.ARC}.1.1")]), True)
    ),
    "a role that its authority may not give": lambda: chains.leaf(
        house().people, role=(eku(Role.SITE_AUTHORITY), True)
    ),
    "a gate made by the authority for people": lambda: chains.leaf(
        house().people, role=(eku(Role.GATE), True)
    ),
    "a certificate authority": lambda: chains.leaf(
        house().people, basic=(x509.BasicConstraints(ca=True, path_length=None), True)
    ),
    "a certificate authority of length 0": lambda: chains.leaf(
        house().people, basic=(x509.BasicConstraints(ca=True, path_length=0), True)
    ),
    "no basic constraints": lambda: chains.leaf(house().people, basic=None),
    "no key usage": lambda: chains.leaf(house().people, use=None),
    "may certify": lambda: chains.leaf(
        house().people, use=(usage(signs=True, certifies=True), True)
    ),
    "may not sign": lambda: chains.leaf(
        house().people, use=(usage(signs=False, certifies=False), True)
    ),
    "an unknown critical extension": lambda: chains.leaf(house().people, extra=((UNKNOWN, True),)),
    "a known extension that this profile does not know": lambda: chains.leaf(
        house().people, extra=((POLICY, True),)
    ),
    "no alternative name": lambda: chains.leaf(house().people, names=None),
    "an alternative name without a principal": lambda: chains.leaf(
        house().people, names=(san("https://hospital.example"), False)
    ),
    "the principal as a DNS name": lambda: chains.leaf(
        house().people,
        names=(x509.SubjectAlternativeName([x509.DNSName("operator-1")]), False),
    ),
    "two principals": lambda: chains.leaf(
        house().people, names=(san(PRINCIPAL + "operator-1", PRINCIPAL + "operator-2"), False)
    ),
    "one principal twice": lambda: chains.leaf(
        house().people, names=(san(PRINCIPAL + "operator-1", PRINCIPAL + "operator-1"), False)
    ),
    "the prefix in another case": lambda: chains.leaf(
        house().people, names=(san("URN:authguard-r:principal:operator-1"), False)
    ),
    "every robot and one of them": lambda: chains.leaf(
        house().people,
        names=(san(PRINCIPAL + "operator-1", chains.EVERYWHERE[0], ROBOT + "lifter-1"), False),
    ),
    "every region and one of them": lambda: chains.leaf(
        house().people,
        names=(san(PRINCIPAL + "operator-1", chains.EVERYWHERE[1], REGION + "dock"), False),
    ),
    "a robot that is no identifier": lambda: chains.leaf(
        house().people, names=(san(PRINCIPAL + "operator-1", ROBOT + "Courier 1"), False)
    ),
    "a robot without a name": lambda: chains.leaf(
        house().people, names=(san(PRINCIPAL + "operator-1", ROBOT), False)
    ),
    "a region that is no identifier": lambda: chains.leaf(
        house().people, names=(san(PRINCIPAL + "operator-1", REGION + "*"), False)
    ),
    "two profiles": lambda: chains.leaf(
        house().people,
        names=(san(PRINCIPAL + "operator-1", PROFILE + "A" * 43, PROFILE + "B" * 43), False),
    ),
    "a forged signature": lambda: chains.leaf(house().people, by=chains.key("mallory")),
    "another issuer's name": lambda: chains.leaf(house().people, issuer_name="Site authority"),
    "issued by the root": lambda: chains.leaf(house().root),
    "issued by itself": lambda: chains.leaf(
        house().people, by=chains.key("leaf operator-1"), issuer_name="operator-1"
    ),
}


THRESHOLD = "urn:authguard-r:threshold:"
MEMBERS = tuple(f"urn:authguard-r:member:supervisor-{number}" for number in (1, 2, 3))


def test_a_group_s_certificate_that_does_not_say_how_many_of_whom_is_refused() -> None:
    for names in [
        (THRESHOLD + "2",),
        MEMBERS,
        (THRESHOLD + "0", *MEMBERS),
        (THRESHOLD + "4", *MEMBERS),
        (THRESHOLD + "2", THRESHOLD + "2", *MEMBERS),
        (THRESHOLD + "02", *MEMBERS),
        (THRESHOLD + "-1", *MEMBERS),
        (THRESHOLD + "2\n", *MEMBERS),
        (THRESHOLD + "two", *MEMBERS),
        (THRESHOLD, *MEMBERS),
        (THRESHOLD + "2", MEMBERS[0], MEMBERS[0]),
        (THRESHOLD + "2", *MEMBERS, "urn:authguard-r:member:Nobody Here"),
    ]:
        with case(names):
            said = (san(PRINCIPAL + "board", *chains.EVERYWHERE, *names), False)
            refused(chains.leaf(house().people, "board", names=said), where=LEAF)


@pytest.mark.parametrize("threshold", [1, 2, 3])
def test_a_group_s_certificate_says_how_many_of_whom_sign_together(threshold: int) -> None:
    said = (PRINCIPAL + "board", *chains.EVERYWHERE, f"{THRESHOLD}{threshold}", *MEMBERS)
    found = walked(chains.leaf(house().people, "board", names=(san(*said), False)))
    assert found.threshold == threshold
    assert found.members == {"supervisor-1", "supervisor-2", "supervisor-3"}
    person = walked(chains.leaf(house().people))
    assert (person.threshold, person.members) == (1, frozenset())


def test_a_leaf_that_names_two_robots_is_for_both_and_is_no_one_robot_s() -> None:
    names = (PRINCIPAL + "operator-1", ROBOT + "courier-1", ROBOT + "lifter-1", REGION + "dock")
    found = walked(chains.leaf(house().people, names=(san(*names), False)))
    assert found.scope.robots == {"courier-1", "lifter-1"}
    assert found.scope.regions == {"dock"}
    assert found.robot is None


def test_a_leaf_that_names_nothing_is_for_nothing() -> None:
    found = walked(chains.leaf(house().people, names=(san(PRINCIPAL + "operator-1"), False)))
    assert found.scope == Scope(robots=frozenset(), regions=frozenset())
    assert not found.scope.covers(RobotId("courier-1"))


def test_a_leaf_with_one_fault_is_refused() -> None:
    for name, make in BAD_LEAVES.items():
        with case(name):
            refused(make(), where=LEAF)


def test_a_principal_that_is_no_identifier_is_refused() -> None:
    for principal in [
        "",
        "Operator-1",
        "operator 1",
        "-operator",
        "operator/1",
        "a" * 65,
        "operator-1\n",
        "../x",
    ]:
        with case(principal):
            names = (san(PRINCIPAL + principal), False)
            error = refused(chains.leaf(house().people, names=names), where=LEAF)
            assert PRINCIPAL in error.message


def test_the_longest_principal_passes() -> None:
    longest = "a" + "b" * 63
    assert (
        walked(chains.leaf(house().people, names=(san(PRINCIPAL + longest), False))).principal
        == longest
    )


@pytest.mark.parametrize(
    "public",
    [
        ec.generate_private_key(ec.SECP256R1()).public_key(),
        rsa.generate_private_key(65537, 2048).public_key(),
        ed448.Ed448PrivateKey.generate().public_key(),
        x25519.X25519PrivateKey.generate().public_key(),
    ],
    ids=["P-256", "RSA", "Ed448", "X25519"],
)
def test_a_leaf_with_a_key_of_another_algorithm_is_refused(public: object) -> None:
    leaf = chains.leaf(house().people, public=public)  # type: ignore[arg-type]
    refused(leaf, reason=Reason.KEY_INVALID, where=LEAF)


@pytest.mark.parametrize(
    "encoded",
    [
        "0100000000000000000000000000000000000000000000000000000000000000",
        "26e8958fc2b227b045c3f489f2ef98f0d5dfac05d3c63339b13802886d53fc05",
        "edffffffffffffffffffffffffffffffffffffffffffffffffffffffffffff7f",
    ],
    ids=["identity", "order 8", "not canonical"],
)
def test_an_unsound_key_in_a_signed_certificate_is_still_refused(encoded: str) -> None:
    public = Ed25519PublicKey.from_public_bytes(bytes.fromhex(encoded))
    refused(chains.leaf(house().people, public=public), reason=Reason.KEY_INVALID, where=LEAF)
    # in an authority the same; its leaf cannot be signed by it, so the leaf is never looked at
    issuer = chains.authority(house().root, public=public)
    refused(chains.leaf(house().people), issuer, reason=Reason.KEY_INVALID, where=AUTHORITY)


# -- faults of an authority ------------------------------------------------------------------------

BAD_AUTHORITIES: dict[str, Callable[[], Held]] = {
    "a leaf": lambda: chains.authority(house().root, basic=(chains.LEAF_BASIC, True)),
    "no basic constraints": lambda: chains.authority(house().root, basic=None),
    "path length 1": lambda: chains.authority(
        house().root, basic=(x509.BasicConstraints(ca=True, path_length=1), True)
    ),
    "no path length": lambda: chains.authority(
        house().root, basic=(x509.BasicConstraints(ca=True, path_length=None), True)
    ),
    "no key usage": lambda: chains.authority(house().root, use=None),
    "may not certify": lambda: chains.authority(
        house().root, use=(usage(signs=False, certifies=False), True)
    ),
    "may sign objects itself": lambda: chains.authority(
        house().root, use=(usage(signs=True, certifies=True), True)
    ),
    "names a purpose of another world": lambda: chains.authority(
        house().root,
        role=(
            x509.ExtendedKeyUsage([OIDS[Role.OPERATOR], ExtendedKeyUsageOID.SERVER_AUTH]),
            True,
        ),
    ),
    "an unknown critical extension": lambda: chains.authority(
        house().root, extra=((UNKNOWN, True),)
    ),
    "a forged signature": lambda: chains.authority(house().root, by=chains.key("mallory")),
    "of another root": lambda: chains.authority(chains.root("Another root")),
    "another issuer's name": lambda: chains.authority(house().root, issuer_name="Other root"),
}


def test_an_authority_with_one_fault_is_refused() -> None:
    for name, make in BAD_AUTHORITIES.items():
        with case(name):
            issuer = make()
            refused(chains.leaf(issuer), issuer, where=AUTHORITY)


def test_an_authority_that_names_no_roles_may_give_none() -> None:
    start, end = TODAY - timedelta(days=1), TODAY + timedelta(days=30)
    own = chains.key("People authority")
    bare = chains.certify(
        own.public_key(),
        subject="People authority",
        issuer="Test root",
        by=house().root.key,
        start=start,
        end=end,
        extensions=((chains.AUTHORITY_BASIC, True), (usage(signs=False, certifies=True), True)),
    )
    issuer = Held(own, bare)
    refused(chains.leaf(issuer), issuer, where=AUTHORITY)


def test_a_root_of_the_same_name_with_another_key_is_a_foreign_root() -> None:
    """The name proves nothing: the signature is held against the pinned key."""
    impostor = chains.root(own=chains.key("mallory"))
    issuer = chains.authority(impostor)
    refused(chains.leaf(issuer), issuer, where=AUTHORITY)
    assert walked(chains.leaf(issuer), issuer, impostor).principal == "operator-1"


def test_a_leaf_in_the_authority_s_place_is_refused() -> None:
    """A stolen leaf key must not make new principals."""
    stolen = chains.leaf(house().people)
    forged = chains.leaf(stolen, "supervisor-1", role=(eku(Role.SUPERVISOR), True))
    refused(forged, stolen, where=AUTHORITY)


def test_a_leaf_signed_straight_by_the_root_cannot_act_as_an_authority() -> None:
    direct = chains.leaf(house().root)
    forged = chains.leaf(direct, "supervisor-1", role=(eku(Role.SUPERVISOR), True))
    refused(forged, direct, where=AUTHORITY)


def test_a_chain_in_the_wrong_order_is_refused() -> None:
    refused(house().people, chains.leaf(house().people), where=AUTHORITY)


def test_the_root_in_the_authority_s_place_is_refused() -> None:
    refused(chains.leaf(house().root), house().root, where=AUTHORITY)


def test_an_authority_below_an_authority_is_refused() -> None:
    second = chains.authority(house().people, subject="Second authority")
    refused(chains.leaf(second), second, where=AUTHORITY)
    # and as a leaf, an authority is no leaf
    refused(second, where=LEAF)


def test_the_leaf_of_another_authority_is_refused() -> None:
    site = chains.authority(house().root, (Role.OPERATOR,), subject="Site authority")
    refused(chains.leaf(site), house().people, where=LEAF)


# -- time ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("part", ["root", "authority", "leaf"])
@pytest.mark.parametrize(
    ("start", "end"),
    [
        (TODAY - timedelta(days=9), TODAY - timedelta(seconds=1)),
        (TODAY + timedelta(seconds=1), TODAY + timedelta(days=9)),
    ],
    ids=["expired", "not yet valid"],
)
def test_a_chain_holds_only_while_each_of_its_certificates_does(
    part: str, start: datetime, end: datetime
) -> None:
    dates = {"start": start, "end": end}
    root = chains.root(**(dates if part == "root" else {}))
    issuer = chains.authority(root, **(dates if part == "authority" else {}))  # type: ignore[arg-type]
    leaf = chains.leaf(issuer, **(dates if part == "leaf" else {}))  # type: ignore[arg-type]
    refused(leaf, issuer, root, reason=Reason.CERTIFICATE_EXPIRED, where=f"certificate.{part}")


@pytest.mark.parametrize(
    ("offset_ms", "holds"), [(-1, False), (0, True), (60_000, True), (60_001, False)]
)
def test_both_ends_of_a_certificate_s_time_are_included_to_the_millisecond(
    offset_ms: int, holds: bool
) -> None:
    leaf = chains.leaf(house().people, start=TODAY, end=TODAY + timedelta(seconds=60))
    now = Now(NOW.utc_ms + offset_ms, 0)
    roots = (house().root.certificate,)
    if holds:
        assert walk(leaf.der, house().people.der, roots=roots, now=now).principal == "operator-1"
        return
    with pytest.raises(AuthenticityError) as caught:
        walk(leaf.der, house().people.der, roots=roots, now=now)
    assert caught.value.reason is Reason.CERTIFICATE_EXPIRED
    assert "2030-06-15T12:00:00Z" in caught.value.message
    assert "2030-06-15T12:01:00Z" in caught.value.message


# -- bytes that are no certificate -----------------------------------------------------------------


@pytest.mark.parametrize(
    "data",
    [b"", b"\0", b"junk", b"\x30\x80\x00\x00", b"\x30\x82\xff\xff" + bytes(65535), bytes(10**6)],
    ids=["nothing", "a zero", "text", "indefinite length", "zeros", "a megabyte"],
)
def test_bytes_that_are_no_certificate_are_refused(data: bytes) -> None:
    with pytest.raises(AuthenticityError) as caught:
        load(data, where=LEAF)
    assert (caught.value.reason, caught.value.where) == (Reason.CERTIFICATE_INVALID, LEAF)


def test_a_certificate_with_something_behind_it_is_refused() -> None:
    with pytest.raises(AuthenticityError) as caught:
        load(chains.leaf(house().people).der + b"\0", where=LEAF)
    assert caught.value.reason is Reason.CERTIFICATE_INVALID


def test_a_certificate_cut_short_anywhere_is_refused() -> None:
    der = chains.leaf(house().people).der
    for length in range(0, len(der), 7):
        with pytest.raises(AuthenticityError):
            load(der[:length], where=LEAF)


@settings(max_examples=amount(40, 200))
@given(st.data())
def test_a_certificate_with_one_byte_changed_is_refused(data: st.DataObject) -> None:
    """From the issuer's name on; what precedes it is version, serial and algorithm."""
    der = chains.leaf(house().people, serial=0x55AA55AA55AA).der
    first = der.index(bytes.fromhex("55aa55aa55aa300506032b6570")) + 13
    at = data.draw(st.integers(first, len(der) - 1))
    value = data.draw(st.integers(0, 255).filter(lambda byte: byte != der[at]))
    changed = der[:at] + bytes([value]) + der[at + 1 :]
    with pytest.raises(AuthenticityError) as caught:
        walk(changed, house().people.der, roots=(house().root.certificate,), now=NOW)
    assert caught.value.reason is Reason.CERTIFICATE_INVALID
    assert caught.value.where == LEAF


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("0603551d25", "0603551d0f"),  # two key usages
        ("861c75726e3a", "831c75726e3a"),  # no such name
        ("861c75726e3a", "861d75726e3a"),  # a name longer than its place
        ("6f70", "ffff"),  # a name that is no ASCII
    ],
    ids=["a repeated extension", "a broken name", "a name too long", "a name in other bytes"],
)
def test_a_signed_certificate_with_broken_extensions_is_refused(old: str, new: str) -> None:
    """The authority signed nonsense: refused, not believed in part."""
    leaf = chains.leaf(house().people, "op", names=(san(PRINCIPAL + "op"), False))
    tail = PRINCIPAL.encode() + bytes.fromhex(old) if old == "6f70" else bytes.fromhex(old)
    head = PRINCIPAL.encode() + bytes.fromhex(new) if old == "6f70" else bytes.fromhex(new)
    broken = chains.resigned(leaf.der, tail, head, by=house().people.key)
    with pytest.raises(AuthenticityError) as caught:
        walk(broken, house().people.der, roots=(house().root.certificate,), now=NOW)
    assert (caught.value.reason, caught.value.where) == (Reason.CERTIFICATE_INVALID, LEAF)


def test_signing_a_certificate_again_is_what_the_tests_above_rely_on() -> None:
    leaf = chains.leaf(house().people, "op")
    same = chains.resigned(leaf.der, b"principal:op", b"principal:oq", by=house().people.key)
    assert (
        walk(same, house().people.der, roots=(house().root.certificate,), now=NOW).principal == "oq"
    )


# -- people ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("common", "demo"),
    [
        ("AuthGuard-R demo root", True),
        ("DEMO", True),
        ("Hospital root", False),
    ],
)
def test_a_root_that_says_demo_is_known_as_one(common: str, demo: bool) -> None:
    assert is_demo(chains.root(common).certificate) is demo


def test_a_leaf_is_what_was_said_and_cannot_be_changed() -> None:
    found = walked(chains.leaf(house().people))
    with pytest.raises(AttributeError):
        found.role = Role.SUPERVISOR  # type: ignore[misc]
    assert msgspec.structs.replace(found, serial=1).serial == 1


def with_serial(der: bytes, first: int) -> bytes:
    """Return the certificate with another first byte of its serial number."""
    serial = x509.load_der_x509_certificate(der).serial_number
    spelled = serial.to_bytes((serial.bit_length() + 8) // 8, "big")
    at = der.index(spelled)
    return der[:at] + bytes([first]) + der[at + 1 :]


@pytest.mark.filterwarnings("ignore::cryptography.utils.CryptographyDeprecationWarning")
def test_a_serial_number_below_zero_is_refused() -> None:
    leaf = chains.leaf(house().people, serial=1 << 100)
    with pytest.raises(AuthenticityError, match="positive serial"):
        load(with_serial(leaf.der, 0x90), where=LEAF)


def test_a_library_that_warns_of_a_serial_number_refuses_it_too() -> None:
    leaf = chains.leaf(house().people, serial=1 << 100)
    with pytest.raises(AuthenticityError) as caught:
        load(with_serial(leaf.der, 0x90), where=LEAF)
    assert caught.value.reason is Reason.CERTIFICATE_INVALID
