# SPDX-License-Identifier: Apache-2.0
"""Trust under two roots: every signed object needs a signature under each, of one principal.

Whoever breaks one of the two algorithms has every key of it: here he holds the second signature,
of any make, and is refused all the same.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import permutations
from pathlib import Path
from typing import Any

import pytest
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key

from authguard_r.authoring.keys.setup import Member, add_member, init_folder, write_revocations
from authguard_r.core.errors import AuthenticityError, EnvironmentFault
from authguard_r.core.principals import Endorsed
from authguard_r.core.quantities import Now
from authguard_r.core.reasons import Reason
from authguard_r.keys.algorithms import Algorithm, algorithm_of
from authguard_r.keys.certificate import Role
from authguard_r.keys.revocation import RevocationList
from authguard_r.keys.signer import FileSigner, read_signer
from authguard_r.keys.trust import Trust, read_certificates, read_trust
from fixtures.cases import case
from unit.keys import chains
from unit.keys.chains import DAY_MS, NOW, PRINCIPAL, TODAY, Held, eku, house_of, leaf_of, san

ONE, TWO = Algorithm.ED25519, Algorithm.ML_DSA_65
ROBOT, REGION = "urn:authguard-r:robot:", "urn:authguard-r:region:"
TEMPLATE = "urn:authguard-r:template:"
PROFILE = "urn:authguard-r:profile:"
ALL = "token.endorsements"
SECOND = f"{ALL}[1]"


def trust(
    *algorithms: Algorithm, days: dict[Algorithm, int] | None = None, **revoked: frozenset[int]
) -> Trust:
    """Return the trust in the roots of these algorithms, with lists for each."""
    lists: dict[bytes, RevocationList] = {}
    for algorithm in algorithms:
        until = NOW.utc_ms + (days or {}).get(algorithm, 30) * DAY_MS
        dead = revoked.get(algorithm.name, frozenset())
        site = house_of(algorithm)
        lists[site.root.der] = RevocationList(number=1, next_update_ms=until, serials=frozenset())
        lists[site.people.der] = RevocationList(number=1, next_update_ms=until, serials=dead)
    return Trust(tuple(house_of(a).root.certificate for a in algorithms), lists)


@cache
def both() -> Trust:
    return trust(ONE, TWO)


def endorsed(algorithm: Algorithm, held: Held | None = None, message: bytes = b"go") -> Endorsed:
    """Return the message signed by a leaf of this algorithm's set-up."""
    by = held or leaf_of(algorithm)
    return (by.der, house_of(algorithm).people.der), by.key.sign(message)


def refused(
    endorsements: tuple[Endorsed, ...],
    reason: Reason,
    where: str,
    *,
    under: Trust | None = None,
    now: Now = NOW,
) -> AuthenticityError:
    with pytest.raises(AuthenticityError) as caught:
        (under or both()).verify(b"go", endorsements, now)
    assert (caught.value.reason, caught.value.where) == (reason, where)
    return caught.value


# both


def test_two_signatures_under_two_roots_are_one_principal_s_in_either_order() -> None:
    for pair in list(permutations(Algorithm, 2)):
        with case(pair):
            first, second = endorsed(pair[0]), endorsed(pair[1])
            found = trust(*pair).verify(b"go", (first, second), NOW)
            assert found == trust(*pair).verify(b"go", (second, first), NOW)
            assert (found.id, found.role) == ("operator-1", "operator")


def test_both_endure_until_the_first_of_them_ends() -> None:
    for days in ({ONE: 3, TWO: 9}, {ONE: 9, TWO: 3}):
        found = trust(ONE, TWO, days=days).verify(b"go", (endorsed(ONE), endorsed(TWO)), NOW)
        assert found.usable_until_ms == NOW.utc_ms + 3 * DAY_MS


def test_more_signatures_than_roots_are_all_verified() -> None:
    whole = (endorsed(ONE), endorsed(TWO), endorsed(ONE), endorsed(TWO))
    assert both().verify(b"go", whole, NOW).id == "operator-1"
    bad = (endorsed(TWO)[0], b"")
    refused((*whole[:3], bad), Reason.SIGNATURE_INVALID, "signature")


@pytest.mark.parametrize("weak", [ONE, TWO])
def test_a_leaf_of_the_other_algorithm_makes_its_root_no_stronger(weak: Algorithm) -> None:
    """Else a leaf of the broken algorithm under the sound root would carry both signatures."""
    sound = TWO if weak is ONE else ONE
    leaf = chains.leaf(house_of(sound).people, own=chains.key_of(weak, "weak leaf"))
    pair = (endorsed(weak), endorsed(sound, leaf))
    refused(pair, Reason.CERTIFICATE_INVALID, "certificate")
    assert trust(sound).verify(b"go", pair[1:], NOW).id == "operator-1"  # under one root it may be


def test_either_root_that_is_for_demonstration_makes_it_a_demonstration() -> None:
    assert not both().demo
    demo = chains.root("A demo root", own=chains.key_of(TWO, "demo"))
    assert Trust((house_of(ONE).root.certificate, demo.certificate), {}).demo
    assert Trust((demo.certificate, house_of(ONE).root.certificate), {}).demo


# one of two


@pytest.mark.parametrize("only", [ONE, TWO])
def test_the_signature_under_one_root_alone_is_too_little(only: Algorithm) -> None:
    missing = house_of(TWO if only is ONE else ONE).root.certificate
    for count in (1, 2, 4):
        error = refused((endorsed(only),) * count, Reason.SIGNATURE_MISSING, ALL)
        assert missing.subject.rfc4514_string() in error.message


@pytest.mark.parametrize("only", [ONE, TWO])
def test_two_leaves_of_one_principal_under_one_root_are_one_root_s_word(only: Algorithm) -> None:
    again = leaf_of(only, own=chains.key_of(only, "spare"))
    refused((endorsed(only), endorsed(only, again)), Reason.SIGNATURE_MISSING, ALL)


def test_the_same_root_twice_wants_what_nobody_can_give() -> None:
    """A set-up that names one root in both places trusts nobody, instead of half."""
    top = house_of(ONE).root.certificate
    lists = trust(ONE)._lists
    refused((endorsed(ONE),) * 2, Reason.SIGNATURE_MISSING, ALL, under=Trust((top, top), lists))


@pytest.mark.parametrize("only", [ONE, TWO])
def test_under_one_root_the_other_s_chain_is_a_stranger_s(only: Algorithm) -> None:
    other = TWO if only is ONE else ONE
    for pair in ((endorsed(only), endorsed(other)), (endorsed(other), endorsed(only))):
        refused(pair, Reason.CERTIFICATE_INVALID, "certificate.authority", under=trust(only))


# the second signature, by whoever broke its algorithm

Forged = Callable[[Algorithm], Endorsed]


def _names(*uris: str) -> Any:
    return (san(PRINCIPAL + "operator-1", *uris), False)


def _impostor(algorithm: Algorithm, name: str | None = None) -> Endorsed:
    """Sign under a root made at home: with the name of the one that is missing, or with none."""
    own = chains.key_of(algorithm, "mallory")
    top = chains.root(name or f"Root {algorithm}", own=own)
    people = chains.authority(top, own=own)
    leaf = chains.leaf(people, own=own)
    return (leaf.der, people.der), own.sign(b"go")


SPOILED: dict[str, tuple[Forged, Reason, str]] = {
    "of no key": (
        lambda a: (endorsed(a)[0], b""),
        Reason.SIGNATURE_INVALID,
        "signature",
    ),
    "over another message": (
        lambda a: endorsed(a, message=b"stop"),
        Reason.SIGNATURE_INVALID,
        "signature",
    ),
    "by the other root's key": (
        lambda a: (endorsed(a)[0], leaf_of(TWO if a is ONE else ONE).key.sign(b"go")),
        Reason.SIGNATURE_INVALID,
        "signature",
    ),
    "of another principal": (
        lambda a: endorsed(a, leaf_of(a, "operator-2")),
        Reason.ISSUER_MISMATCH,
        SECOND,
    ),
    "in another role": (
        lambda a: endorsed(a, leaf_of(a, role=(eku(Role.SUPERVISOR), True))),
        Reason.ISSUER_MISMATCH,
        SECOND,
    ),
    "for one robot only": (
        lambda a: endorsed(a, leaf_of(a, names=_names(ROBOT + "courier-1", chains.EVERYWHERE[1]))),
        Reason.ISSUER_MISMATCH,
        SECOND,
    ),
    "for one region only": (
        lambda a: endorsed(a, leaf_of(a, names=_names(chains.EVERYWHERE[0], REGION + "dock"))),
        Reason.ISSUER_MISMATCH,
        SECOND,
    ),
    "with a profile": (
        lambda a: endorsed(a, leaf_of(a, names=_names(*chains.EVERYWHERE, PROFILE + "A" * 43))),
        Reason.ISSUER_MISMATCH,
        SECOND,
    ),
    "of a group": (
        lambda a: endorsed(
            a,
            leaf_of(
                a,
                names=_names(
                    *chains.EVERYWHERE,
                    "urn:authguard-r:threshold:1",
                    "urn:authguard-r:member:operator-1",
                ),
            ),
        ),
        Reason.ISSUER_MISMATCH,
        SECOND,
    ),
    "by a leaf that nobody certified": (
        lambda a: endorsed(a, leaf_of(a, by=chains.key_of(a, "mallory"))),
        Reason.CERTIFICATE_INVALID,
        "certificate.leaf",
    ),
    "under the other root's authority": (
        lambda a: (
            (leaf_of(a).der, house_of(TWO if a is ONE else ONE).people.der),
            leaf_of(a).key.sign(b"go"),
        ),
        Reason.CERTIFICATE_INVALID,
        "certificate.leaf",
    ),
    "under a root that says the other's name": (
        _impostor,
        Reason.CERTIFICATE_INVALID,
        "certificate.authority",
    ),
    "under a root of nobody": (
        lambda a: _impostor(a, "Nobody's root"),
        Reason.CERTIFICATE_INVALID,
        "certificate.authority",
    ),
}


def test_a_second_signature_that_is_not_the_principal_s_own_spoils_the_first() -> None:
    for how, (make, reason, where) in SPOILED.items():
        for spoiled in [ONE, TWO]:
            with case(how, spoiled):
                good = endorsed(TWO if spoiled is ONE else ONE)
                assert both().verify(b"go", (good, endorsed(spoiled)), NOW).id == "operator-1"
                refused((good, make(spoiled)), reason, where)
                refused((make(spoiled), good), reason, where)


def test_two_certificates_for_two_templates_are_not_one_scheduler_s() -> None:
    scheduler = (eku(Role.SCHEDULER), True)
    leaves: list[Endorsed] = []
    tops: list[Any] = []
    lists: dict[bytes, RevocationList] = {}
    for algorithm, digest in ((ONE, "A" * 43), (TWO, "B" * 43)):
        top = house_of(algorithm).root
        people = chains.authority(top, (Role.SCHEDULER,), own=chains.key_of(algorithm, "people"))
        own = chains.key_of(algorithm, "leaf")
        leaf = chains.leaf(people, own=own, role=scheduler, names=_names(TEMPLATE + digest))
        leaves.append(((leaf.der, people.der), own.sign(b"go")))
        for der in (top.der, people.der):
            end = NOW.utc_ms + DAY_MS
            lists[der] = RevocationList(number=1, next_update_ms=end, serials=frozenset())
        tops.append(top.certificate)
    refused(tuple(leaves), Reason.ISSUER_MISMATCH, SECOND, under=Trust(tuple(tops), lists))


@pytest.mark.parametrize("dead", [ONE, TWO])
def test_a_certificate_revoked_under_one_root_takes_the_other_with_it(dead: Algorithm) -> None:
    leaf = leaf_of(dead, serial=41)
    pair = (endorsed(dead, leaf), endorsed(TWO if dead is ONE else ONE))
    under = trust(ONE, TWO, **{dead.name: frozenset({41})})
    refused(pair, Reason.CERTIFICATE_REVOKED, "certificate", under=under)


@pytest.mark.parametrize("stale", [ONE, TWO])
def test_a_stale_list_under_one_root_refuses_both(stale: Algorithm) -> None:
    under = trust(ONE, TWO, days={stale: -1})
    refused((endorsed(ONE), endorsed(TWO)), Reason.REVOCATION_STALE, "revocations", under=under)


# the folder

MEMBERS = (
    Member(id="operator-1", role=Role.OPERATOR, robots=("courier-1",), regions=("dock", "lift")),
    Member(id="gate-1", role=Role.GATE, robots=("courier-1",), profile="A" * 43),
)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hybrid") / "trust"
    init_folder(folder, MEMBERS, now=TODAY, days=30, algorithms=(ONE, TWO))
    return folder


def held(folder: Path, name: str) -> FileSigner:
    return read_signer(folder / f"keys/{name}.key.pem", folder / f"keys/{name}.cert.pem")


def copied(made: Path, target: Path) -> Path:
    for path in made.rglob("*"):
        if path.is_file():
            (target / path.relative_to(made)).parent.mkdir(parents=True, exist_ok=True)
            (target / path.relative_to(made)).write_bytes(path.read_bytes())
    return target


def test_a_folder_of_two_roots_holds_both_halves_of_everything(made: Path) -> None:
    names = {str(p.relative_to(made)) for p in made.rglob("*") if p.is_file()}
    for suffix in ("", "-2"):
        for name in ("people", "site", "machines"):
            assert {f"authorities/{name}{suffix}.pem", f"revocations/{name}{suffix}.json"} < names
            assert f"keys/{name}{suffix}.key.pem" in names
        assert {f"revocations/root{suffix}.json", f"keys/root{suffix}.key.pem"} < names
    roots = read_certificates(made / "root.pem")
    assert [algorithm_of(r.public_key()) for r in roots] == [ONE, TWO]  # type: ignore[arg-type]
    assert len({root.subject for root in roots}) == 2
    assert read_trust(made).demo


@pytest.mark.parametrize("member", MEMBERS, ids=lambda member: member.id)
def test_a_member_of_two_roots_signs_twice_and_is_one(made: Path, member: Member) -> None:
    both_of = held(made, member.id).endorse(b"go")
    assert len(both_of) == 2
    assert both_of[0][0] == held(made, member.id).chain
    trusted = read_trust(made)
    found = trusted.verify(b"go", both_of, NOW)
    assert (found.id, found.role) == (member.id, member.role)
    assert found.scope.robots == frozenset(member.robots or ())
    assert found.scope.regions == frozenset(member.regions or ())
    kinds = [algorithm_of(trusted.identify(chain, NOW).key) for chain, _ in both_of]
    assert kinds == [ONE, TWO]
    for half in both_of:
        refused((half,), Reason.SIGNATURE_MISSING, ALL, under=trusted)


def test_a_later_member_gets_both_halves(made: Path, tmp_path: Path) -> None:
    folder = copied(made, tmp_path)
    add_member(folder, Member(id="late", role=Role.SUPERVISOR), now=TODAY, days=5)
    signed = held(folder, "late").endorse(b"go")
    assert read_trust(folder).verify(b"go", signed, NOW).id == "late"


@pytest.mark.parametrize("name", ["root-2", "people-2", "site-2", "machines-2", "gate-1"])
def test_a_later_member_takes_no_authority_s_name_of_either_root(
    made: Path, tmp_path: Path, name: str
) -> None:
    folder = copied(made, tmp_path)
    with pytest.raises(EnvironmentFault) as caught:
        add_member(folder, Member(id=name, role=Role.SUPERVISOR), now=TODAY, days=5)
    assert caught.value.reason is Reason.SCHEMA_INVALID


def test_without_one_half_of_its_authority_nobody_is_added(made: Path, tmp_path: Path) -> None:
    folder = copied(made, tmp_path)
    (folder / "keys" / "people-2.key.pem").unlink()
    with pytest.raises(EnvironmentFault):
        add_member(folder, Member(id="late", role=Role.SUPERVISOR), now=TODAY, days=5)
    assert not list(folder.glob("keys/late.*"))


def test_a_list_of_the_second_root_revokes_too(made: Path, tmp_path: Path) -> None:
    folder = copied(made, tmp_path)
    signed = held(folder, "operator-1").endorse(b"go")
    serial = read_trust(folder).identify(signed[1][0], NOW).serial
    key = load_pem_private_key((folder / "keys" / "people-2.key.pem").read_bytes(), None)
    write_revocations(folder, "people-2", key, serials=(serial,), now=TODAY, number=2, days=7)  # type: ignore[arg-type]
    refused(signed, Reason.CERTIFICATE_REVOKED, "certificate", under=read_trust(folder))


@pytest.mark.parametrize("part", ["revocations/root-2.json", "revocations/machines-2.json"])
def test_a_list_of_the_second_root_that_is_missing_is_named(
    made: Path, tmp_path: Path, part: str
) -> None:
    folder = copied(made, tmp_path)
    (folder / part).unlink()
    with pytest.raises(EnvironmentFault) as caught:
        read_trust(folder)
    assert caught.value.where == str(folder / part)


def test_the_lists_of_the_two_roots_do_not_change_places(made: Path, tmp_path: Path) -> None:
    folder = copied(made, tmp_path)
    lists = folder / "revocations"
    (lists / "people.json").write_bytes((lists / "people-2.json").read_bytes())
    with pytest.raises(AuthenticityError) as caught:
        read_trust(folder)
    assert (caught.value.reason, caught.value.where) == (
        Reason.SIGNATURE_INVALID,
        "revocations/people",
    )


@pytest.mark.parametrize(("name", "count"), [("root", 3), ("authorities/people", 2)])
def test_more_certificates_than_there_is_room_for_are_refused(
    made: Path, tmp_path: Path, name: str, count: int
) -> None:
    folder = copied(made, tmp_path)
    (root, _) = read_certificates(folder / "root.pem")
    (folder / f"{name}.pem").write_bytes(root.public_bytes(Encoding.PEM) * count)
    with pytest.raises(AuthenticityError) as caught:
        read_trust(folder)
    assert caught.value.reason is Reason.CERTIFICATE_INVALID
    assert f"got {count}" in caught.value.message


def test_a_root_taken_out_of_the_folder_makes_half_a_signature_whole_and_the_other_a_stranger_s(
    made: Path, tmp_path: Path
) -> None:
    """The trust folder is where the demand for both is written: it is its owner's alone."""
    folder = copied(made, tmp_path)
    first, _ = read_certificates(folder / "root.pem")
    (folder / "root.pem").write_bytes(first.public_bytes(Encoding.PEM))
    one, two = held(folder, "operator-1").endorse(b"go")
    under = read_trust(folder)
    assert under.verify(b"go", (one,), NOW).id == "operator-1"
    refused((one, two), Reason.CERTIFICATE_INVALID, "certificate.authority", under=under)


# the signer's files


@pytest.mark.parametrize("how", ["one key", "one chain", "keys swapped", "a key twice", "odd"])
def test_keys_and_chains_that_do_not_belong_to_each_other_are_refused(
    made: Path, tmp_path: Path, how: str
) -> None:
    key, cert = made / "keys/operator-1.key.pem", made / "keys/operator-1.cert.pem"
    keys = key.read_bytes().split(b"-----END PRIVATE KEY-----\n")[:-1]
    one, two = (half + b"-----END PRIVATE KEY-----\n" for half in keys)
    chain = [c.public_bytes(Encoding.PEM) for c in read_certificates(cert, most=4)]
    written = {
        "one key": (one, chain),
        "one chain": (one + two, chain[:2]),
        "keys swapped": (two + one, chain),
        "a key twice": (one + one, chain),
        "odd": (one + two, chain[:3]),
    }[how]
    (tmp_path / "key.pem").write_bytes(written[0])
    (tmp_path / "cert.pem").write_bytes(b"".join(written[1]))
    with pytest.raises(AuthenticityError) as caught:
        read_signer(tmp_path / "key.pem", tmp_path / "cert.pem")
    assert (caught.value.reason, caught.value.where) == (
        Reason.KEY_INVALID,
        str(tmp_path / "cert.pem"),
    )


def test_comments_between_keys_are_left_alone(made: Path, tmp_path: Path) -> None:
    data = (made / "keys/operator-1.key.pem").read_bytes()
    mark = b"-----BEGIN PRIVATE KEY-----"
    (tmp_path / "key.pem").write_bytes(data.replace(mark, b"# of operator-1\n" + mark))
    signer = read_signer(tmp_path / "key.pem", made / "keys/operator-1.cert.pem")
    assert read_trust(made).verify(b"go", signer.endorse(b"go"), NOW).id == "operator-1"
