# SPDX-License-Identifier: Apache-2.0
"""Our fixed-depth profile against OpenSSL's path validation under X509_STRICT (L18).

OpenSSL knows no roles and no principals, so its yes is not ours. The law is one-sided: what we
accept, it accepts. Where it also knows the rule, both must refuse; the list of faults that only
we see is written out, so that a fault which leaves our checks does not leave unnoticed.

Each fault is shown once, under Ed25519. Random chains and the product's own are of every algorithm:
the OpenSSL under pyOpenSSL knows ML-DSA from 3.5 on.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from datetime import timedelta
from typing import Any

import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID, ObjectIdentifier
from OpenSSL import crypto

from authguard_r.core.errors import AuthenticityError
from authguard_r.keys.algorithms import Algorithm, PrivateKey
from authguard_r.keys.certificate import Role, build_authority, build_leaf, build_root, walk
from fixtures.amount import amount
from fixtures.cases import case
from unit.keys import chains
from unit.keys.chains import NOW, OIDS, TODAY, Held, eku, house, san, usage

Chain = tuple[Held, Held, Held]
LONG_AGO = {"start": TODAY - timedelta(days=9), "end": TODAY - timedelta(days=2)}
LATER = {"start": TODAY + timedelta(days=2), "end": TODAY + timedelta(days=9)}
UNKNOWN = (x509.UnrecognizedExtension(ObjectIdentifier("1.2.3.4"), b"\x05\x00"), True)


def ours(chain: Chain) -> bool:
    leaf, authority, root = chain
    try:
        walk(leaf.der, authority.der, roots=(root.certificate,), now=NOW)
    except AuthenticityError:
        return False
    return True


def openssl(chain: Chain, *, flags: int = crypto.X509StoreFlags.X509_STRICT) -> str:
    """Return what OpenSSL says of the chain, empty when it accepts."""
    leaf, authority, root = (crypto.X509.from_cryptography(held.certificate) for held in chain)
    store = crypto.X509Store()
    store.add_cert(root)
    store.set_flags(flags)
    store.set_time(TODAY)
    context = crypto.X509StoreContext(store, leaf, [authority])
    try:
        context.verify_certificate()
    except crypto.X509StoreContextError as error:
        return str(error)
    return ""


def good() -> Chain:
    return (chains.leaf(house().people), house().people, house().root)


def below(authority: Held) -> Chain:
    return (chains.leaf(authority), authority, house().root)


def with_leaf(leaf: Held) -> Chain:
    return (leaf, house().people, house().root)


def swapped() -> Chain:
    leaf, authority, root = good()
    return (authority, leaf, root)


def stolen() -> Chain:
    leaf = chains.leaf(house().people)
    return (chains.leaf(leaf, "supervisor-1"), leaf, house().root)


def dated(part: str, dates: dict[str, object]) -> Chain:
    root = chains.root(**(dates if part == "root" else {}))  # type: ignore[arg-type]
    issuer = chains.authority(root, **(dates if part == "authority" else {}))  # type: ignore[arg-type]
    leaf = chains.leaf(issuer, **(dates if part == "leaf" else {}))  # type: ignore[arg-type]
    return (leaf, issuer, root)


def foreign() -> Chain:
    other = chains.root("Another root")
    issuer = chains.authority(other)
    return (chains.leaf(issuer), issuer, house().root)


def impostor() -> Chain:
    issuer = chains.authority(chains.root(own=chains.key("mallory")))
    return (chains.leaf(issuer), issuer, house().root)


#: Both refuse.
SHARED: dict[str, Callable[[], Chain]] = {
    "leaf expired": lambda: dated("leaf", LONG_AGO),
    "leaf not yet valid": lambda: dated("leaf", LATER),
    "authority expired": lambda: dated("authority", LONG_AGO),
    "authority not yet valid": lambda: dated("authority", LATER),
    "root expired": lambda: dated("root", LONG_AGO),
    "root not yet valid": lambda: dated("root", LATER),
    "leaf forged": lambda: with_leaf(chains.leaf(house().people, by=chains.key("mallory"))),
    "authority forged": lambda: below(chains.authority(house().root, by=chains.key("mallory"))),
    "foreign root": foreign,
    "root of the same name": impostor,
    "leaf as authority": stolen,
    "authority without basic constraints": lambda: below(
        chains.authority(house().root, basic=None)
    ),
    "authority that is a leaf": lambda: below(
        chains.authority(house().root, basic=(chains.LEAF_BASIC, True))
    ),
    "authority without key usage": lambda: below(chains.authority(house().root, use=None)),
    "authority that may not certify": lambda: below(
        chains.authority(house().root, use=(usage(signs=False, certifies=False), True))
    ),
    "leaf that may certify": lambda: with_leaf(
        chains.leaf(house().people, use=(usage(signs=True, certifies=True), True))
    ),
    "authority with an unknown critical extension": lambda: below(
        chains.authority(house().root, extra=(UNKNOWN,))
    ),
    "leaf with an unknown critical extension": lambda: with_leaf(
        chains.leaf(house().people, extra=(UNKNOWN,))
    ),
    "leaf of another issuer's name": lambda: with_leaf(
        chains.leaf(house().people, issuer_name="Site authority")
    ),
}

#: We refuse; OpenSSL has no such rule.
STRICTER: dict[str, Callable[[], Chain]] = {
    "wrong order": swapped,
    "authority that may sign objects itself": lambda: below(
        chains.authority(house().root, use=(usage(signs=True, certifies=True), True))
    ),
    "no role": lambda: with_leaf(chains.leaf(house().people, role=None)),
    "two roles": lambda: with_leaf(
        chains.leaf(house().people, role=(eku(Role.OPERATOR, Role.SUPERVISOR), True))
    ),
    "a role that the authority may not give": lambda: with_leaf(
        chains.leaf(house().people, role=(eku(Role.GATE), True))
    ),
    "a purpose of another world": lambda: with_leaf(
        chains.leaf(
            house().people, role=(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.CLIENT_AUTH]), True)
        )
    ),
    "no principal": lambda: with_leaf(chains.leaf(house().people, names=None)),
    "two principals": lambda: with_leaf(
        chains.leaf(
            house().people, names=(san(chains.PRINCIPAL + "a", chains.PRINCIPAL + "b"), False)
        )
    ),
    "leaf without basic constraints": lambda: with_leaf(chains.leaf(house().people, basic=None)),
    "leaf without key usage": lambda: with_leaf(chains.leaf(house().people, use=None)),
    "authority without a path length": lambda: below(
        chains.authority(
            house().root, basic=(x509.BasicConstraints(ca=True, path_length=None), True)
        )
    ),
    "authority with path length 1": lambda: below(
        chains.authority(house().root, basic=(x509.BasicConstraints(ca=True, path_length=1), True))
    ),
}


def test_both_accept_the_good_chain() -> None:
    assert ours(good())
    assert openssl(good()) == ""


def test_both_refuse() -> None:
    for name, make in SHARED.items():
        with case(name):
            chain = make()
            assert not ours(chain)
            assert openssl(chain) != ""


def test_only_we_refuse() -> None:
    for name, make in STRICTER.items():
        with case(name):
            chain = make()
            assert not ours(chain)
            assert openssl(chain) == ""


@pytest.mark.complete
@pytest.mark.parametrize("algorithm", Algorithm)
def test_what_we_accept_openssl_accepts_too_over_random_chains(algorithm: Algorithm) -> None:
    """Every knob turned at random, several at once; about a tenth of the chains are good."""

    def own(name: str) -> PrivateKey:
        return chains.key_of(algorithm, name)

    pick = random.Random(20300615)

    def maybe(value: Any, *others: Any) -> Any:
        return pick.choice(others) if pick.random() < 0.18 else value

    accepted, rounds = 0, amount(75, 250)
    for _ in range(rounds):
        root = chains.root(own=own("root"), end=TODAY + timedelta(days=maybe(30, -1)))
        issuer = chains.authority(
            root,
            own=own("people"),
            by=maybe(None, own("mallory")),
            end=TODAY + timedelta(days=maybe(30, -1)),
            basic=maybe((chains.AUTHORITY_BASIC, True), None, (chains.LEAF_BASIC, True)),
            use=maybe((usage(signs=False, certifies=True), True), None),
            extra=maybe((), (UNKNOWN,)),
        )
        leaf = chains.leaf(
            issuer,
            own=own("leaf"),
            by=maybe(None, own("mallory")),
            end=TODAY + timedelta(days=maybe(30, -1)),
            basic=maybe((chains.LEAF_BASIC, True), None, (chains.AUTHORITY_BASIC, True)),
            use=maybe((usage(signs=True, certifies=False), True), None),
            role=maybe((eku(Role.OPERATOR), True), (eku(Role.GATE), True), None),
            extra=maybe((), (UNKNOWN,)),
        )
        chain = (leaf, issuer, root)
        if ours(chain):
            accepted += 1
            assert openssl(chain) == ""
    assert rounds // 25 <= accepted <= rounds * 2 // 5


@pytest.mark.parametrize("algorithm", Algorithm)
def test_the_product_s_own_chains_pass_openssl(algorithm: Algorithm) -> None:
    start = TODAY - timedelta(days=1)
    keys = [chains.key_of(algorithm, name) for name in ("r", "a", "l")]
    root = build_root(keys[0], name="Site root", now=start, days=30)
    issuer = build_authority(
        keys[1].public_key(),
        name="an authority",
        roles=(Role.OPERATOR,),
        issuer=root,
        key=keys[0],
        now=start,
        days=30,
    )
    leaf = build_leaf(
        keys[2].public_key(),
        principal="operator-1",
        role=Role.OPERATOR,
        issuer=issuer,
        key=keys[1],
        now=start,
        days=30,
        robots=None,
        regions=("pharmacy",),
    )
    chain = (Held(keys[2], leaf), Held(keys[1], issuer), Held(keys[0], root))
    assert ours(chain)
    assert openssl(chain, flags=0) == ""


def test_the_object_identifiers_are_inside_the_arc_of_random_uuids() -> None:
    """2.25 is open to everybody for 128-bit numbers (X.667), so nobody else has ours by chance."""
    number = int(chains.ARC.removeprefix("2.25."))
    assert 0 < number < 2**128
    assert len(set(OIDS.values())) == len(Role)
