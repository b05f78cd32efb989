# SPDX-License-Identifier: Apache-2.0
"""One fault of a chain at a time, and near misses beside them."""

from __future__ import annotations

from typing import Any

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec, ed448, rsa, x25519
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from cryptography.hazmat.primitives.asymmetric.mldsa import MLDSA65PublicKey
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import ExtendedKeyUsageOID, ObjectIdentifier

from authguard_r.keys.certificate import Role
from making import chains
from making.book import (
    AUTHORITY,
    DIGEST,
    OPERATOR,
    OTHER,
    PEOPLE,
    POLICIES,
    PROFILE,
    REGION,
    ROBOT,
    TEMPLATE,
    TOP,
    UNKNOWN,
    Book,
    named,
)
from making.chains import authority, leaf, line, operator, root
from unit.keys import chains as knobs
from unit.keys.chains import ARC, EVERYWHERE, OIDS, PRINCIPAL, Held, eku, usage

P = 2**255 - 19
#: Order of the Ed25519 base point: a signature's second half has to be below it.
ORDER = 2**252 + 27742317777372353535851937790883648493
ORDER_8 = 0x05FC536D880238B13933C6D305ACDFD5F098EFF289F4C345B027B2C28F95E826


def purposes(*oids: Any) -> tuple[x509.ExtendedKeyUsage, bool]:
    """Return an extended key usage of these identifiers."""
    return x509.ExtendedKeyUsage([*oids]), True


def leaves(book: Book) -> None:
    """A leaf that its place in the chain does not allow, knob by knob."""
    changed: dict[str, dict[str, Any]] = {
        "a leaf of two roles": {"role": (eku(Role.OPERATOR, Role.SUPERVISOR), True)},
        "a leaf of no role": {"role": None},
        "a leaf for TLS clients": {"role": purposes(ExtendedKeyUsageOID.CLIENT_AUTH)},
        "a leaf for any purpose": {"role": purposes(ExtendedKeyUsageOID.ANY_EXTENDED_KEY_USAGE)},
        "a role and another purpose": {
            "role": purposes(OIDS[Role.OPERATOR], ExtendedKeyUsageOID.CODE_SIGNING)
        },
        "the arc without a number": {"role": purposes(ObjectIdentifier(ARC))},
        "the arc's number 0": {"role": purposes(ObjectIdentifier(f"{ARC}.0"))},
        "the arc's number 9": {"role": purposes(ObjectIdentifier(f"{ARC}.9"))},
        "a number behind the role's": {"role": purposes(ObjectIdentifier(f"{ARC}.1.1"))},
        "a role that its authority may not give": {"role": (eku(Role.SITE_AUTHORITY), True)},
        "a certificate authority as leaf": {
            "basic": (x509.BasicConstraints(ca=True, path_length=None), True)
        },
        "a certificate authority of length 0 as leaf": {"basic": (knobs.AUTHORITY_BASIC, True)},
        "a leaf without basic constraints": {"basic": None},
        "a leaf without key usage": {"use": None},
        "a leaf that may certify too": {"use": (usage(signs=True, certifies=True), True)},
        "a leaf that may certify only": {"use": (usage(signs=False, certifies=True), True)},
        "a leaf that may not sign": {"use": (usage(signs=False, certifies=False), True)},
        "an unknown critical extension": {"extra": ((UNKNOWN, True),)},
        "a critical extension of another profile": {"extra": ((POLICIES, True),)},
        "a leaf that another key signed": {"by": knobs.key("mallory")},
        "a leaf of another issuer's name": {"issuer_name": "Site authority"},
    }
    for name, change in changed.items():
        book.refuse(name, leaf(PEOPLE, name=name, **change))
    itself: dict[str, Any] = {"by": knobs.key("leaf operator-1"), "issuer_name": "operator-1"}
    book.refuse("a leaf that signed itself", leaf(PEOPLE, name="itself", **itself))
    book.refuse("a leaf that the root issued", leaf(TOP, name="of the root"))


def names(book: Book) -> None:
    """An alternative name that does not say just who, and for what."""
    whole: dict[str, Any] = {
        "no alternative name": None,
        "no principal": named(*EVERYWHERE),
        "two principals": named(OPERATOR, PRINCIPAL + "operator-2", *EVERYWHERE),
        "one principal twice": named(OPERATOR, OPERATOR, *EVERYWHERE),
        "the principal as a DNS name": (
            x509.SubjectAlternativeName([x509.DNSName("operator-1")]),
            False,
        ),
        "the prefix in another case": named("URN:authguard-r:principal:operator-1", *EVERYWHERE),
        "every robot and one of them": named(OPERATOR, EVERYWHERE[0], ROBOT + "lifter-1"),
        "every region and one of them": named(OPERATOR, EVERYWHERE[1], REGION + "dock"),
        "a robot that is no identifier": named(OPERATOR, ROBOT + "Courier 1"),
        "a robot without a name": named(OPERATOR, ROBOT),
        "a region that is no identifier": named(OPERATOR, REGION + "*"),
        "two profiles": named(OPERATOR, PROFILE + DIGEST, PROFILE + OTHER),
        "an operator of a template": named(OPERATOR, *EVERYWHERE, TEMPLATE + DIGEST),
    }
    for name, said in whole.items():
        book.refuse(name, leaf(PEOPLE, name=name, names=said))
    wrong = ["", "Operator-1", "operator 1", "-operator", "operator/1", "a" * 65, "../x"]
    for principal in wrong:
        name = f"the principal `{principal[:12]}`"
        said = named(PRINCIPAL + principal, *EVERYWHERE)
        book.refuse(name, leaf(PEOPLE, name=name, names=said))
    schedulers = authority(TOP, (Role.SCHEDULER,), "schedulers")
    twice = named(OPERATOR, *EVERYWHERE, TEMPLATE + DIGEST, TEMPLATE + OTHER)
    role = (eku(Role.SCHEDULER), True)
    book.refuse(
        "a scheduler of two templates",
        leaf(schedulers, name="two templates", role=role, names=twice),
        schedulers,
    )
    once = named(OPERATOR, *EVERYWHERE, TEMPLATE + DIGEST)
    held = leaf(schedulers, name="one template", role=role, names=once)
    book.accept("a scheduler's template", held, schedulers, role="scheduler", template=DIGEST)


def authorities(book: Book) -> None:
    """An authority that its place in the chain does not allow, knob by knob."""
    changed: dict[str, dict[str, Any]] = {
        "an authority that is no certificate authority": {"basic": (knobs.LEAF_BASIC, True)},
        "an authority without basic constraints": {"basic": None},
        "an authority of path length 1": {"basic": (knobs.ROOT_BASIC, True)},
        "an authority of no path length": {
            "basic": (x509.BasicConstraints(ca=True, path_length=None), True)
        },
        "an authority without key usage": {"use": None},
        "an authority that may not certify": {"use": (usage(signs=False, certifies=False), True)},
        "an authority that may sign objects itself": {
            "use": (usage(signs=True, certifies=True), True)
        },
        "an authority for servers too": {
            "role": purposes(OIDS[Role.OPERATOR], ExtendedKeyUsageOID.SERVER_AUTH)
        },
        "an authority with an unknown critical extension": {"extra": ((UNKNOWN, True),)},
        "an authority that another key signed": {"by": knobs.key("mallory")},
        "an authority of another issuer's name": {"issuer_name": "Other root"},
    }
    for name, change in changed.items():
        issuer = authority(TOP, name=name, **change)
        book.refuse(name, leaf(issuer, name=name), issuer, where=AUTHORITY)
    gates = authority(TOP, (Role.GATE,), "of gates")
    book.refuse("an operator of the authority of gates", leaf(gates, name="of gates"), gates)


def strangers(book: Book) -> None:
    """Roots that are not here, crossings between roots, and certificates in each other's place."""
    other = root("Another root")
    crossed = authority(other, name="people, cross-signed")
    one = leaf(PEOPLE)
    book.refuse("an authority cross-signed by a foreign root", one, crossed, where=AUTHORITY)
    book.accept("the cross-signed authority under that root", one, crossed, (other,))
    foreign = authority(other, name="foreign", own=knobs.key("foreign people"))
    stranger = leaf(foreign, name="foreign")
    book.refuse("a foreign root", stranger, foreign, where=AUTHORITY)
    impostor = root(key=knobs.key("mallory"))
    below = authority(impostor, name="below the impostor")
    book.refuse("a root of the same name", leaf(below, name="impostor"), below, where=AUTHORITY)
    cross = authority(TOP, name="the foreign root, cross-signed", subject="Another root")
    book.refuse("a foreign authority below a root that ours cross-signed", foreign, cross)
    stolen = leaf(PEOPLE, name="stolen")
    made = leaf(stolen, "supervisor-1", role=(eku(Role.SUPERVISOR), True))
    book.refuse("a leaf as certificate authority", made, stolen, where=AUTHORITY)
    book.refuse("the wrong order", PEOPLE, one, where=AUTHORITY)
    book.refuse(
        "the root in the authority's place", leaf(TOP, name="of root"), TOP, where=AUTHORITY
    )
    second = authority(PEOPLE, name="second", subject="Second authority")
    book.refuse(
        "an authority below an authority", leaf(second, name="second"), second, where=AUTHORITY
    )
    book.refuse("an authority in the leaf's place", second)
    site = authority(TOP, name="site", subject="Site authority")
    book.refuse("the leaf of another authority", leaf(site, name="of the site"))
    people = line(chains.M65)[1]
    held = operator(chains.M65)
    book.refuse("a chain of the other root alone", held, people, where=AUTHORITY)
    book.refuse("a chain of one certificate", one, roots=(TOP,), where="certificate")
    book.vectors[-1]["chain"].pop()
    whole = (one, PEOPLE, TOP)
    book.refuse("a chain that has its root with it", *whole, where="certificate")


def keys(book: Book) -> None:
    """Keys of other algorithms, and keys under which everybody can sign."""
    for name, public in foreign_keys().items():
        held = leaf(PEOPLE, name=name, public=public)
        book.refuse(f"a leaf's key of {name}", held, reason="KEY_INVALID")
    p256 = foreign_keys()["P-256"]
    issuer = authority(TOP, name="P-256", public=p256)
    unsound: dict[str, Any] = {"reason": "KEY_INVALID", "where": AUTHORITY}
    book.refuse("an authority's key of P-256", leaf(PEOPLE, name="x"), issuer, **unsound)
    top = root("A root of P-256", public=p256)
    book.refuse(
        "a root's key of P-256", leaf(PEOPLE), roots=(top,), reason="KEY_INVALID", where="root"
    )
    sign = 1 << 255
    points = {
        "0": 0,
        "0 with a sign": sign,
        "1": 1,
        "1 with a sign": 1 | sign,
        "p - 1": P - 1,
        "p - 1 with a sign": (P - 1) | sign,
        "order 8": ORDER_8,
        "order 8 with a sign": ORDER_8 | sign,
        "the other of order 8": P - ORDER_8,
        "the other of order 8 with a sign": (P - ORDER_8) | sign,
        "p": P,
        "p + 1": P + 1,
        "p + 3": P + 3,
        "the largest of 255 bits": 2**255 - 1,
    }
    for name, y in points.items():
        public = Ed25519PublicKey.from_public_bytes(y.to_bytes(32, "little"))
        held = leaf(PEOPLE, name=f"y = {name}", public=public)
        book.refuse(f"an Ed25519 key with y = {name}", held, reason="KEY_INVALID")
    low = Ed25519PublicKey.from_public_bytes((1).to_bytes(32, "little"))
    issuer = authority(TOP, name="y = 1", public=low)
    book.refuse("an authority's key of low order", leaf(PEOPLE), issuer, **unsound)
    base = Ed25519PublicKey.from_public_bytes(bytes.fromhex("58" + "66" * 31))
    book.accept("the base point as key", leaf(PEOPLE, name="base point", public=base))
    zero = MLDSA65PublicKey.from_public_bytes(b"s" * 32 + bytes(1920))
    held = leaf(PEOPLE, name="t1 = 0", public=zero)
    book.refuse("an ML-DSA key that is zero behind its seed", held, reason="KEY_INVALID")
    near = MLDSA65PublicKey.from_public_bytes(b"s" * 32 + bytes(1919) + b"\1")
    held = leaf(PEOPLE, name="t1 = 1", public=near)
    book.accept("an ML-DSA key that is not zero in one bit", held, algorithm="ml-dsa-65")


def foreign_keys() -> dict[str, Any]:
    """Return public keys that this profile does not know, the same each time."""
    modulus = {bits: (1 << (bits - 1)) + 3**400 * 2 + 1 for bits in (1024, 2048)}
    return {
        "P-256": ec.derive_private_key(7, ec.SECP256R1()).public_key(),
        "RSA of 1024 bits": rsa.RSAPublicNumbers(65537, modulus[1024]).public_key(),
        "RSA of 2048 bits": rsa.RSAPublicNumbers(65537, modulus[2048]).public_key(),
        "Ed448": ed448.Ed448PrivateKey.from_private_bytes(b"k" * 57).public_key(),
        "X25519": x25519.X25519PrivateKey.from_private_bytes(b"k" * 32).public_key(),
    }


def spelled(book: Book) -> None:
    """Bytes that are no certificate, or one in another spelling than DER's only one."""
    held = leaf(PEOPLE, name="spelled", serial=0x55AA55AA55AA)
    der, by = held.der, knobs.key("People authority")
    again = knobs.resigned(der, b"\x55\xaa\x55\xaa\x55\xaa", b"\x55\xaa\x55\xaa\x55\xaa", by=by)
    assert again == der
    body = der[4:]
    half = int.from_bytes(der[-32:], "little") + ORDER
    one = leaf(PEOPLE, name="a short serial", serial=0x5A)
    spellings: dict[str, bytes] = {
        "nothing": b"",
        "text": b"operator-1",
        "cut off by a byte": der[:-1],
        "cut off in the middle": der[: len(der) // 2],
        "a byte behind it": der + b"\0",
        "a certificate behind it": der + PEOPLE.der,
        "as PEM": held.certificate.public_bytes(Encoding.PEM),
        "a length in more bytes than it needs": b"\x30\x83\0" + der[2:4] + body,
        "an indefinite length": b"\x30\x80" + body + b"\0\0",
        "a truth value of 1": _resigned(
            der, b"\x01\x01\xff\x04\x02\x30\x00", b"\x01\x01\x01\x04\x02\x30\x00"
        ),
        "a serial number below zero": _resigned(der, b"\x55\xaa" * 3, b"\xd5\xaa" * 3),
        "the serial number zero": _resigned(one.der, b"\x02\x01\x5a", b"\x02\x01\x00"),
        "another algorithm outside than inside": der.replace(
            b"\x30\x05\x06\x03\x2b\x65\x70\x03\x41", b"\x30\x05\x06\x03\x2b\x65\x71\x03\x41"
        ),
        "a signature in a second spelling": der[:-32] + half.to_bytes(32, "little"),
        "the last bit of its signature": der[:-1] + bytes([der[-1] ^ 1]),
        "a repeated extension": _resigned(der, b"\x06\x03\x55\x1d\x25", b"\x06\x03\x55\x1d\x0f"),
    }
    for name, data in spellings.items():
        assert data not in (der, one.der), name
        book.refuse(f"bytes: {name}", data)
    book.accept("the certificate that those were", held)
    book.accept("the short serial number that one was", one)
    whole: dict[str, Held | bytes] = {
        "an authority cut off": PEOPLE.der[:-1],
        "a byte behind the authority": PEOPLE.der + b"\0",
    }
    for name, authority_der in whole.items():
        book.refuse(f"bytes: {name}", held, authority_der, where=AUTHORITY)


def _resigned(der: bytes, old: bytes, new: bytes) -> bytes:
    return knobs.resigned(der, old, new, by=knobs.key("People authority"))
