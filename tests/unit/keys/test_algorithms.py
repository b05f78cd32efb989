# SPDX-License-Identifier: Apache-2.0
"""Every signature algorithm behind its one door: a key signs for itself and for nothing else."""

from __future__ import annotations

from collections.abc import Callable
from itertools import permutations

import pytest
from cryptography.hazmat.primitives.asymmetric import ec, ed448, rsa
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from cryptography.hazmat.primitives.asymmetric.mldsa import (
    MLDSA44PublicKey,
    MLDSA65PublicKey,
    MLDSA87PublicKey,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from authguard_r.core.errors import AuthenticityError
from authguard_r.core.reasons import Reason
from authguard_r.keys.algorithms import (
    Algorithm,
    PublicKey,
    algorithm_of,
    generate,
    require_private,
    require_signature,
    require_sound,
)
from authguard_r.keys.certificate import walk
from fixtures.cases import case
from unit.keys import chains
from unit.keys.chains import NOW, house, house_of, key_of

each = pytest.mark.parametrize("algorithm", Algorithm)
#: Bytes of a public key and of a signature (RFC 8032; FIPS 204, table 2).
SIZES = {
    Algorithm.ED25519: (32, 64),
    Algorithm.ML_DSA_44: (1_312, 2_420),
    Algorithm.ML_DSA_65: (1_952, 3_309),
    Algorithm.ML_DSA_87: (2_592, 4_627),
}
FROM_BYTES: dict[Algorithm, Callable[[bytes], PublicKey]] = {
    Algorithm.ML_DSA_44: MLDSA44PublicKey.from_public_bytes,
    Algorithm.ML_DSA_65: MLDSA65PublicKey.from_public_bytes,
    Algorithm.ML_DSA_87: MLDSA87PublicKey.from_public_bytes,
}


def refused(key: PublicKey, signature: bytes, message: bytes = b"go") -> None:
    with pytest.raises(AuthenticityError) as caught:
        require_signature(key, signature, message, where="here")
    assert (caught.value.reason, caught.value.where) == (Reason.SIGNATURE_INVALID, "here")


@each
def test_a_fresh_key_signs_what_its_public_key_verifies(algorithm: Algorithm) -> None:
    own, other = generate(algorithm), generate(algorithm)
    public = require_sound(own.public_key(), where="key")
    signature = own.sign(b"go")
    require_signature(public, signature, b"go", where="here")
    assert (len(public.public_bytes_raw()), len(signature)) == SIZES[algorithm]
    assert public.public_bytes_raw() != other.public_key().public_bytes_raw()
    refused(other.public_key(), signature)


@each
def test_a_key_knows_its_algorithm(algorithm: Algorithm) -> None:
    own = generate(algorithm)
    assert algorithm_of(own) is algorithm_of(own.public_key()) is algorithm
    assert require_private(own, where="key") is own


@each
def test_a_signature_holds_for_its_own_message_alone(algorithm: Algorithm) -> None:
    own = key_of(algorithm, "one")
    signature = own.sign(b"go")
    for message in (b"", b"g", b"go\0", b"Go", bytes(32)):
        refused(own.public_key(), signature, message)


@each
@pytest.mark.parametrize("change", ["shorter", "longer", "empty", "zeros", "twice"])
def test_a_signature_of_another_length_does_not_hold(algorithm: Algorithm, change: str) -> None:
    own = key_of(algorithm, "one")
    good = own.sign(b"go")
    changed = {
        "shorter": good[:-1],
        "longer": good + b"\0",
        "empty": b"",
        "zeros": bytes(len(good)),
        "twice": good * 2,
    }
    refused(own.public_key(), changed[change])


@each
@settings(max_examples=60)
@given(data=st.data())
def test_a_signature_with_one_bit_flipped_does_not_hold(
    algorithm: Algorithm, data: st.DataObject
) -> None:
    own = key_of(algorithm, "one")
    good = own.sign(b"go")
    at = data.draw(st.integers(0, len(good) * 8 - 1))
    flipped = bytearray(good)
    flipped[at // 8] ^= 1 << at % 8
    refused(own.public_key(), bytes(flipped))


def test_the_signature_of_one_algorithm_never_holds_under_another_s_key() -> None:
    """The same seed for both: nothing but the algorithm is another one."""
    for of, under in list(permutations(Algorithm, 2)):
        with case(of, under):
            signature = key_of(of, "one").sign(b"go")
            refused(key_of(under, "one").public_key(), signature)


@pytest.mark.parametrize("algorithm", FROM_BYTES)
def test_a_signature_with_a_context_is_none_of_ours(algorithm: Algorithm) -> None:
    """We sign without one (FIPS 204, algorithm 2); a protocol that has one is another protocol."""
    own = key_of(algorithm, "one")
    refused(own.public_key(), own.sign(b"go", b"AuthGuard"))  # type: ignore[call-arg]


@pytest.mark.parametrize(
    "private",
    [
        ec.generate_private_key(ec.SECP256R1()),
        rsa.generate_private_key(65_537, 2_048),
        ed448.Ed448PrivateKey.generate(),
    ],
    ids=["P-256", "RSA", "Ed448"],
)
def test_a_key_of_an_unknown_algorithm_enters_nowhere(private: ec.EllipticCurvePrivateKey) -> None:
    for enter in (
        lambda: require_private(private, where="here"),
        lambda: require_sound(private.public_key(), where="here"),
    ):
        with pytest.raises(AuthenticityError) as caught:
            enter()
        assert (caught.value.reason, caught.value.where) == (Reason.KEY_INVALID, "here")
        assert "ml-dsa-87" in caught.value.message


def test_a_private_key_is_no_public_one_and_no_object_is_either() -> None:
    for thing in (key_of(Algorithm.ML_DSA_44, "one"), None, b"key", "ed25519"):
        with pytest.raises(AuthenticityError):
            require_sound(thing, where="here")
    for thing in (key_of(Algorithm.ML_DSA_44, "one").public_key(), None, b"key"):
        with pytest.raises(AuthenticityError):
            require_private(thing, where="here")


# keys under which everybody can sign (L15)


@pytest.mark.parametrize("algorithm", FROM_BYTES)
@pytest.mark.parametrize("seed", [bytes(32), b"\x01" * 32], ids=["all zero", "zero but its seed"])
def test_an_ml_dsa_key_that_says_nothing_of_a_secret_is_refused(
    algorithm: Algorithm, seed: bytes
) -> None:
    """With t1 = 0, whoever picks a short z has a signature: no secret is in the equation."""
    size = SIZES[algorithm][0]
    zero = FROM_BYTES[algorithm](seed + bytes(size - 32))
    with pytest.raises(AuthenticityError) as caught:
        require_sound(zero, where="here")
    assert (caught.value.reason, caught.value.where) == (Reason.KEY_INVALID, "here")
    one = FROM_BYTES[algorithm](seed + bytes(size - 33) + b"\x01")
    assert require_sound(one, where="here") is one


def test_a_weak_key_in_a_certificate_is_refused_in_its_place() -> None:
    for weak in ["ed25519", *FROM_BYTES]:
        for place in ["leaf", "authority"]:
            with case(weak, place):
                public: PublicKey
                if weak == "ed25519":
                    public = Ed25519PublicKey.from_public_bytes(b"\x01" + bytes(31))
                else:
                    size = SIZES[Algorithm(weak)][0]
                    public = FROM_BYTES[Algorithm(weak)](bytes(size))
                people, leaf = house().people, chains.leaf(house().people)
                if place == "leaf":
                    leaf = chains.leaf(house().people, public=public)
                else:
                    people = chains.authority(house().root, public=public)
                    leaf = chains.leaf(house().people, by=people.key)
                with pytest.raises(AuthenticityError) as caught:
                    walk(leaf.der, people.der, roots=(house().root.certificate,), now=NOW)
                assert (caught.value.reason, caught.value.where) == (
                    Reason.KEY_INVALID,
                    f"certificate.{place}",
                )


@each
def test_a_chain_of_one_algorithm_walks_and_says_its_key(algorithm: Algorithm) -> None:
    leaf = chains.leaf_of(algorithm)
    found = walk(
        leaf.der,
        house_of(algorithm).people.der,
        roots=(house_of(algorithm).root.certificate,),
        now=NOW,
    )
    assert algorithm_of(found.key) is algorithm
    assert (found.principal, found.root) == ("operator-1", 0)
