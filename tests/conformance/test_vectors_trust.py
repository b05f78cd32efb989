# SPDX-License-Identifier: Apache-2.0
"""The published certificates and revocation lists hold, or are refused where it is published.

The oracle knows neither; OpenSSL stands in for it: what we accept, its path validation accepts.
"""

from __future__ import annotations

import json
from datetime import UTC, datetime
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding
from OpenSSL import crypto

from authguard_r.core.encoding import unb64
from authguard_r.core.errors import AuthGuardError
from authguard_r.core.quantities import Now
from authguard_r.keys.algorithms import algorithm_of, require_sound
from authguard_r.keys.certificate import Leaf, Role
from authguard_r.keys.revocation import RevocationList, read_list
from authguard_r.keys.trust import ROOT_LISTS, Trust, is_demo
from fixtures.cases import case
from fixtures.vectors import load, named, refusal

Json = dict[str, Any]


CERTIFICATE, REVOCATION = load("certificate.json"), load("revocation.json")


def certificate(content: Json, name: str) -> x509.Certificate:
    return x509.load_der_x509_certificate(unb64(content["certificates"][name]))


def unrevoked(content: Json, vector: Json) -> Trust:
    """Return the trust in a vector's roots, under whose lists nothing is revoked, ever."""
    roots = tuple(certificate(content, name) for name in vector["roots"])
    empty = RevocationList(number=1, next_update_ms=1 << 60, serials=frozenset())
    issuers = {unb64(content["certificates"][name]) for name in vector["chain"][1:]}
    return Trust(
        roots, dict.fromkeys({*(r.public_bytes(Encoding.DER) for r in roots), *issuers}, empty)
    )


def chain(content: Json, vector: Json) -> tuple[bytes, ...]:
    return tuple(unb64(content["certificates"][name]) for name in vector["chain"])


def listed(names: frozenset[Any] | None) -> list[str] | None:
    return None if names is None else sorted(names)


def said(leaf: Leaf) -> Json:
    return {
        "principal": leaf.principal,
        "role": str(leaf.role),
        "robots": listed(leaf.scope.robots),
        "regions": listed(leaf.scope.regions),
        "profile": leaf.profile,
        "template": leaf.template,
        "threshold": leaf.threshold,
        "members": listed(leaf.members),
        "algorithm": str(algorithm_of(leaf.key)),
        "root": leaf.root,
        "serial": str(leaf.serial),
        "authority_serial": str(leaf.authority_serial),
        "not_after_ms": leaf.not_after_ms,
    }


def test_every_chain_says_what_is_published_or_is_refused_there() -> None:
    for vector in CERTIFICATE["vectors"]:
        with case(named(vector)):
            try:
                trust = unrevoked(CERTIFICATE, vector)
                found = said(trust.identify(chain(CERTIFICATE, vector), Now(vector["now_ms"], 0)))
            except AuthGuardError as error:
                found = refusal(error)
            assert found == vector["expect"]


#: Of a root we look at dates, key, name and signatures only: the trust folder vouches for it.
OURS_ALONE = "a root without any extension"
ACCEPTED = [v for v in CERTIFICATE["vectors"] if "reason" not in v["expect"]]


def test_every_chain_that_holds_passes_openssl_too() -> None:
    for vector in [v for v in ACCEPTED if v["name"] != OURS_ALONE]:
        with case(named(vector)):
            store = crypto.X509Store()
            for name in vector["roots"]:
                store.add_cert(crypto.X509.from_cryptography(certificate(CERTIFICATE, name)))
            store.set_time(datetime.fromtimestamp(vector["now_ms"] // 1000, UTC))
            leaf, issuer = (
                crypto.X509.from_cryptography(certificate(CERTIFICATE, name))
                for name in vector["chain"]
            )
            crypto.X509StoreContext(store, leaf, [issuer]).verify_certificate()


def test_every_machine_s_certificate_names_what_it_needs_or_is_denied() -> None:
    for vector in CERTIFICATE["machines"]:
        with case(vector):
            trust, now = unrevoked(CERTIFICATE, vector), Now(vector["now_ms"], 0)
            whole = chain(CERTIFICATE, vector)
            try:
                if vector["as"] == Role.GATE:
                    found = dict(
                        zip(("robot", "profile"), trust.gate_identity(whole, now), strict=True)
                    )
                elif vector["as"] == Role.ESTIMATOR:
                    found = {"robot": trust.attested_robot(whole, now)}
                else:
                    found = {"template": trust.scheduled_template(whole, now)}
            except AuthGuardError as error:
                found = refusal(error)
            assert found == vector["expect"]


def test_every_root_says_whether_it_is_for_demonstration() -> None:
    for vector in CERTIFICATE["demonstration"]:
        root = certificate(CERTIFICATE, vector["root"])
        assert is_demo(root) is vector["demo"], vector["root"]


def test_every_role_has_its_published_object_identifier_and_vector() -> None:
    assert set(CERTIFICATE["roles"]) == {str(role) for role in Role}
    for role, number in CERTIFICATE["roles"].items():
        (vector,) = [v for v in CERTIFICATE["vectors"] if v["name"] == f"the role {role}"]
        leaf = certificate(CERTIFICATE, vector["chain"][0])
        usage = leaf.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
        assert [oid.dotted_string for oid in usage] == [number]


def signed_lists(vector: Json) -> dict[bytes, RevocationList]:
    """Return the lists that a vector's machine holds, by the DER of their authority."""
    lists = {}
    for name, text in vector["lists"].items():
        cert = certificate(REVOCATION, REVOCATION["authorities"][name])
        key = require_sound(cert.public_key(), where=name)
        data = REVOCATION["lists"][text].encode()
        lists[cert.public_bytes(Encoding.DER)] = read_list(data, authority=name, key=key)
    return lists


def trust_of(vector: Json) -> Trust:
    roots = tuple(certificate(REVOCATION, name) for name in vector["roots"])
    return Trust(roots, signed_lists(vector))


def believed(trust: Trust, vector: Json) -> Json:
    """Return whom a chain speaks for and until when, or why it speaks for nobody."""
    try:
        leaf = trust.identify(chain(REVOCATION, vector), Now(vector["now_ms"], 0))
    except AuthGuardError as error:
        return refusal(error)
    return {"principal": leaf.principal, "usable_until_ms": leaf.not_after_ms}


def test_every_list_is_read_or_refused_as_published() -> None:
    for vector in REVOCATION["read"]:
        with case(named(vector)):
            name = vector["authority"]
            key = certificate(REVOCATION, vector["key"]).public_key()
            try:
                data = vector["text"].encode()
                found = read_list(data, authority=name, key=require_sound(key, where=name))
                got: Json = {
                    "number": found.number,
                    "issued_ms": found.issued_ms,
                    "next_update_ms": found.next_update_ms,
                    "serials": sorted(map(str, found.serials)),
                }
            except AuthGuardError as error:
                got = refusal(error)
            assert got == vector["expect"]


def test_every_chain_is_believed_under_the_published_lists_or_refused() -> None:
    for vector in REVOCATION["held"]:
        with case(named(vector)):
            assert believed(trust_of(vector), vector) == vector["expect"]


def test_every_list_takes_the_place_of_another_or_does_not_as_published() -> None:
    for vector in REVOCATION["newer"]:
        with case(vector):
            trust = trust_of(vector)
            before = {data: known.number for data, known in trust.lists.items()}
            believed(trust, vector)  # who was let in before is not let in for that
            try:
                data = REVOCATION["lists"][vector["offered"]].encode()
                der, found = trust.read_newer(data, Now(vector["now_ms"], 0))
                trust.put_in_force({der: found})
                got: Json = {"number": found.number}
            except AuthGuardError as error:
                got = refusal(error)
                assert {data: known.number for data, known in trust.lists.items()} == before
            assert got == vector["expect"]
            assert believed(trust, vector) == vector["then"]


@pytest.mark.parametrize("name", ["certificate.json", "revocation.json"])
def test_every_certificate_and_list_in_a_table_is_one_that_a_vector_speaks_of(name: str) -> None:
    content = load(name)
    tables = [content.pop(table) for table in ("certificates", "lists") if table in content]
    spoken = json.dumps(content)
    assert [n for table in tables for n in table if json.dumps(n) not in spoken] == []


def test_the_roots_have_their_lists_under_the_names_that_are_published() -> None:
    assert [name for name in REVOCATION["authorities"] if name in ROOT_LISTS] == list(ROOT_LISTS)
